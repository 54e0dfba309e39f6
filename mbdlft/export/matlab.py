"""MATLAB and Octave: the numbers of a model in a .mat file (version 5), and m-files that use them.

All run in Octave; the uncertain elements need the Robust Control Toolbox of MATLAB. Each function of
Theta is written as statements that give its value and its slopes; tables stay tables.
"""

from collections.abc import Callable, Mapping, Sequence
from io import BytesIO
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from mbdlft.base.array import Array
from mbdlft.base.formula import formula_value
from mbdlft.base.parameter import DIVISORS, Parameter, to_internal
from mbdlft.base.unit import Signal
from mbdlft.dae.text import SYMBOLIC, column_of, formula_of
from mbdlft.export.names import (
    check_different,
    filled,
    identifier,
    identifiers,
    listed,
    one_line,
    places_of,
)
from mbdlft.lft.lft import LFT
from mbdlft.system.model import LFTModel, System
from mbdlft.system.theta import DeltaThetaModel, ThetaFunction, named_tables

_MATRICES = ("A", "B_w", "B_u", "C_z", "D_zw", "D_zu", "C_y", "D_yw", "D_yu")
TANGENT = {"identity": "", "half-angle": "tan_half_", "quarter-angle": "tan_quarter_"}
_HEADER = 116  # bytes of text at the beginning of a file of version 5


def matlab_image(items: dict[str, Any]) -> bytes:
    """The bytes of a .mat file of version 5; equal for equal items, without the time and the machine."""
    from scipy.io import savemat

    stream = BytesIO()
    savemat(stream, items, format="5", oned_as="column", do_compression=True)
    return b"MATLAB 5.0 MAT-file, written by mbdlft".ljust(_HEADER) + stream.getvalue()[_HEADER:]


def items_of_matlab(model: System) -> dict[str, Any]:
    """Variables of the .mat file of a model: matrices, and structures of columns."""
    names = identifiers([block.name for block in model.lft.blocks], f"model {model.name!r}: MATLAB")
    items: dict[str, Any] = {
        "format": "mbdlft-mat/1",
        "name": model.name,
        "description": model.description,
        **{name: getattr(model, name) for name in _MATRICES},
        "states": signals(model.states),
        "inputs": signals(model.inputs),
        "outputs": signals(model.outputs),
        "delta": _blocks(model.lft, model.parameters, names),
        "parameters": _parameters(model, names),
    }
    if isinstance(model, LFTModel):
        lft = model.trim.lft
        items["trim"] = {**signals(model.trim.signals), "nominal": column(model.trim.nominal)}
        if lft is not None:
            items["trim"]["lft"] = {
                "D_zw": lft.M11,
                "D_zu": lft.M12,
                "D_yw": lft.M21,
                "D_yu": lft.M22,
                "delta": _blocks(lft, model.parameters, names),
            }
    return items


def cells(texts: Sequence[str]) -> Any:
    """A column of texts, which MATLAB calls a cell array."""
    column = np.empty((len(texts), 1), dtype=object)
    column[:, 0] = texts
    return column


def column(numbers: Sequence[float]) -> Array:
    """Numbers as a column (n, 1)."""
    return np.asarray(numbers, dtype=float).reshape(-1, 1)


def signals(listed: Sequence[Signal]) -> dict[str, Any]:
    """Names and units of signals as columns."""
    return {"name": cells([s.name for s in listed]), "unit": cells([s.unit for s in listed])}


def _blocks(lft: LFT, parameters: Sequence[Parameter], names: dict[str, str]) -> dict[str, Any]:
    """The blocks of Delta; `parameter` is the number of each in the parameters from 1 on, or 0."""
    numbers = {p.name: k for k, p in enumerate(parameters, start=1)}
    return {
        "name": cells([b.name for b in lft.blocks]),
        "identifier": cells([names[b.name] for b in lft.blocks]),
        "kind": cells([b.kind for b in lft.blocks]),
        "rows": column([b.outputs for b in lft.blocks]),
        "columns": column([b.inputs for b in lft.blocks]),
        "parameter": column([numbers.get(b.name, 0) for b in lft.blocks]),
    }


def _parameters(model: System, names: dict[str, str]) -> dict[str, Any]:
    """The parameters, with the maps from physical values to deltas."""
    parameters = model.parameters
    elements = {p.name: TANGENT[p.substitution] + names[p.name] for p in parameters}
    others = {b.name: names[b.name] for b in model.lft.blocks if b.kind != "real"}
    check_different({**elements, **others}, f"model {model.name!r}: uncertain elements of MATLAB")
    table: dict[str, Any] = {
        "name": cells([p.name for p in parameters]),
        "identifier": cells([names[p.name] for p in parameters]),
        "element": cells([elements[p.name] for p in parameters]),
    }
    for name in ("unit", "role", "substitution"):
        table[name] = cells([getattr(p, name) for p in parameters])
    for name in ("nominal", "low", "high", "reference"):
        table[name] = column([getattr(p, name) for p in parameters])
    internal = [to_internal(p, [p.low, p.nominal, p.high]) for p in parameters]
    maps = [(p.map.b0, p.map.b1, p.map.a1) for p in parameters]
    return {
        **table,
        # what one unit is inside the tangent, rad; 1 without a substitution
        "factor": column([p.factor if p.is_angle else 1.0 for p in parameters]),
        "divisor": column([DIVISORS[p.substitution] for p in parameters]),
        "internal": np.array(internal).reshape(-1, 3),
        "map": np.array(maps).reshape(-1, 3),
        "gain": column([p.map.gain for p in parameters]),
    }


def m_texts(model: System, stem: str) -> tuple[str, str]:
    """The script of the .mat file, and the function that evaluates it at physical values.

    The script makes an uncertain system, or plain matrices.
    """
    table = "\n".join(table_of(model, "%   "))
    entries = {"stem": stem, "model": one_line(model.name), "table": table}
    return filled("model.m", entries), filled("model_at.m", entries)


def table_of(model: System, begin: str, shown: dict[str, str] | None = None) -> list[str]:
    """Lines of a comment: which name became which, ranges and units, and the signals."""
    rows = [("name there", "name in mbdlft", "low", "nominal", "high", "unit")]
    for p in model.parameters:
        name = (shown or {}).get(p.name, identifier(p.name))
        rows.append((name, p.name, f"{p.low:.7g}", f"{p.nominal:.7g}", f"{p.high:.7g}", p.unit))
    for block in model.lft.blocks:
        if block.kind != "real":
            size = f"{block.outputs} x {block.inputs}"
            rows.append((identifier(block.name), block.name, "", "0", "", f"{block.kind}, {size}"))
    widths = [max(map(len, entries)) + 2 for entries in zip(*rows, strict=True)]
    lines = ["".join(text.ljust(width) for text, width in zip(row, widths, strict=True)) for row in rows]
    if len(rows) == 1:
        lines = ["(no parameters)"]
    kinds = [("states", model.states), ("inputs", model.inputs), ("outputs", model.outputs)]
    if isinstance(model, LFTModel):
        kinds.append(("trim", model.trim.signals))
    for what, signals in kinds:
        listed = ", ".join(f"{s.name} ({s.unit})" for s in signals) or "none"
        lines.append(f"{what}: {listed}")
    return [f"{begin}{one_line(line)}".rstrip() for line in lines]


def items_of_theta(model: DeltaThetaModel) -> dict[str, Any]:
    """The structure `theta` of a .mat file, beside the variables of the linear part."""
    places = places_of(model, "MATLAB")
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
