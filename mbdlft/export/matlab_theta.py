"""MATLAB and Octave: an m-file with the derivatives and outputs of a Delta-Theta form.

Each function of Theta is written as statements that give its value and its slopes; tables stay tables.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from mbdlft.base.formula import formula_value
from mbdlft.dae.text import SYMBOLIC, column_of, formula_of
from mbdlft.export.matlab import cells, column, items_of_matlab
from mbdlft.export.names import Places, filled, listed, one_line, places_of
from mbdlft.system.theta import DeltaThetaModel, ThetaFunction, named_tables


def items_of_theta_matlab(model: DeltaThetaModel) -> dict[str, Any]:
    """Variables of the .mat file: those of the linear part, and the structure `theta`."""
    places = places_of(model, "MATLAB")
    return {**items_of_matlab(model.linear), "theta": _items(model, places)}


def _items(model: DeltaThetaModel, places: Places) -> dict[str, Any]:
    tables = [table for f in model.functions for table in f.tables]
    kind = [(name, object) for name in ("breakpoint", "value", "below", "above", "slope")]
    table_records = np.zeros((len(tables), 1), dtype=kind)
    for k, table in enumerate(tables):
        table_records[k, 0] = (
            column(table.breakpoints),
            column(table.values),
            table.below,
            table.above,
            np.array(table.slopes).reshape(-1, 2),
        )
    return {
        "name": cells(list(model.zeta)),
        "omega_name": cells(list(model.omega)),
        "text": cells([f.text for f in model.functions]),
        **{
            key: column([k + 1 for k in getattr(places, key)])
            for key in ("u", "one", "zeta", "y", "omega")
        },
        "low": column(places.low),
        "high": column(places.high),
        "initial": column(model.initial),
        "zeta_at_start": column(model.zeta_at_start),
        "table": table_records,
    }


def rates_text(model: DeltaThetaModel, stem: str) -> str:
    """The m-file with derivatives and outputs."""
    places = places_of(model, "MATLAB")
    entries = {
        "stem": stem,
        "model": one_line(model.name),
        "table": listed(model, "%   "),
        "nz": len(places.zeta),
        "no": len(places.omega),
        "bodies": "\n".join(_bodies(model)),
    }
    return filled("model_rates.m", entries)


def _bodies(model: DeltaThetaModel) -> list[str]:
    """Statements of all functions: zeta, and slopes by their arguments."""
    omega, lines, first_table = list(model.omega), list[str](), 0
    for row, function in enumerate(model.functions, start=1):
        columns = [omega.index(name) + 1 for name in function.signals]
        lines += [f"  {name} = {text};" for name, text in _body(function, columns, first_table)]
        lines.append(f"  zeta({row}) = value;")
        for j, k in enumerate(columns, start=1):
            lines.append(f"  slopes({row}, {k}) = slopes({row}, {k}) + d{j};")
        first_table += len(function.tables)
    return lines


def _body(function: ThetaFunction, columns: Sequence[int], first_table: int) -> list[tuple[str, str]]:
    """Names and texts: of a function, ``value``, and of its slopes, ``d1`` and so on.

    Its arguments are entries of omega, from 1 on; its tables are numbered from `first_table` on.
    """
    symbolic = _parts(function)
    symbols, names = [*symbolic.arguments], [f"omega({k})" for k in columns]
    statements: list[tuple[str, str]] = []
    for k, (number, argument) in enumerate(symbolic.tables):
        place, table = f"p{k + 1}", f"table({first_table + number + 1})"
        statements += _statements(argument, symbols, names, f"{place}_", place)
        for kind, values, is_slope in (("v", symbolic.values, "false"), ("s", symbolic.slopes, "true")):
            names.append(f"{kind}{k + 1}")
            symbols.append(values[k])
            statements.append((names[-1], f"table_value({table}, {place}, {is_slope})"))
    statements += _statements(symbolic.value, symbols, names, "f_", "value")
    for j, slope in enumerate(_total_slopes(symbolic), start=1):
        statements += _statements(slope, symbols, names, f"d{j}_", f"d{j}")
    return statements


class _Parts(NamedTuple):
    """A function as SX: tables have symbols for their values and slopes, of arguments before them."""

    arguments: list[ca.SX]
    tables: list[tuple[int, ca.SX]]
    values: list[ca.SX]
    slopes: list[ca.SX]
    value: ca.SX


def _parts(function: ThetaFunction) -> _Parts:
    arguments = [ca.SX.sym(name) for name in function.arguments]
    tables: list[tuple[int, ca.SX]] = []
    values: list[ca.SX] = []
    slopes: list[ca.SX] = []

    def of(number: int) -> Callable[[ca.SX], ca.SX]:
        def look_up(argument: ca.SX) -> ca.SX:
            tables.append((number, ca.SX(argument)))
            values.append(ca.SX.sym(f"v{len(tables)}"))
            slopes.append(ca.SX.sym(f"s{len(tables)}"))
            return values[-1]

        return look_up

    lookups = {name: of(k) for k, name in enumerate(named_tables(function.tables))}
    value = function(*arguments, functions={**SYMBOLIC, **lookups})
    return _Parts(arguments, tables, values, slopes, ca.SX(value))


def _total_slopes(symbolic: _Parts) -> list[ca.SX]:
    """Slopes by the arguments, through the tables."""
    a = column_of(symbolic.arguments)
    through: list[ca.SX] = []

    def total(expression: ca.SX) -> ca.SX:
        slopes = ca.densify(ca.jacobian(expression, a))
        for value, slope in zip(symbolic.values, through, strict=False):
            slopes = slopes + ca.densify(ca.jacobian(expression, value)) * slope
        return slopes

    for (_, argument), slope in zip(symbolic.tables, symbolic.slopes, strict=True):
        through.append(slope * total(argument))
    slopes = total(symbolic.value)
    return [slopes[0, j] for j in range(len(symbolic.arguments))]


def _statements(
    expression: ca.SX, symbols: Sequence[ca.SX], names: Sequence[str], prefix: str, result: str
) -> list[tuple[str, str]]:
    """Statements that give an expression the name `result`; parts of it have names with a prefix."""
    plain = [f"x{k}" for k in range(len(names))]  # names of formulas
    formula, tables = formula_of(ca.SX(expression), symbols, plain, tables=False)
    assert not tables
    statements: list[tuple[str, str]] = []

    def part(name: str, text: str) -> str:
        statements.append((f"{prefix}{len(statements) + 1}", text))
        return statements[-1][0]

    known = dict(zip(plain, names, strict=True))
    value = formula_value(formula, known, _FUNCTIONS, part)
    return [*statements, (result, value)]


def _infix(sign: str) -> Callable[[str, str], str]:
    return lambda a, b: f"({a} {sign} {b})"


def _call(name: str) -> Callable[..., str]:
    return lambda *arguments: f"{name}({', '.join(arguments)})"


def _number(value: float) -> str:
    """A double in 17 digits at most, which are read back as the same double."""
    text = repr(float(value))
    return f"({text})" if text.startswith("-") else text


_SAME = (
    *("sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh"),
    *("asinh", "acosh", "atanh", "exp", "log", "log1p", "expm1", "sqrt", "floor", "ceil"),
    *("atan2", "hypot", "abs", "min", "max", "sign"),
)
_FUNCTIONS: Mapping[str, Callable[..., str]] = {
    "number": _number,
    **{sign: _infix(sign) for sign in ("+", "-", "*", "/", "<", "<=", ">", ">=", "==")},
    **{name: _call(name) for name in _SAME},
    "neg": lambda a: f"(-{a})",
    "!=": _infix("~="),
    "**": _infix("^"),
    "and_": lambda a, b: f"({a} ~= 0 && {b} ~= 0)",
    "or_": lambda a, b: f"({a} ~= 0 || {b} ~= 0)",
    "not_": lambda a: f"({a} == 0)",
    "mod": _call("rem"),
    "copysign": lambda a, b: f"(abs({a}) * (1 - 2 * ({b} < 0)))",
    "where": _call("choose"),
}
