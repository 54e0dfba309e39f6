"""Functions of Theta in other languages: each as statements, its value, and its slopes."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import NamedTuple

import casadi as ca

from mbdlft.base.formula import formula_value
from mbdlft.dae.operations import column_of
from mbdlft.dae.text import SYMBOLIC, formula_of
from mbdlft.system.theta import DeltaThetaModel, ThetaFunction, named_tables


class Language(NamedTuple):
    """How formulas are written.

    Attributes
    ----------
    functions : mapping
        As those of `mbdlft.base.formula`, of texts.
    argument : function of the number of an argument in omega, from 0 on
    table : function of the number of a table in all of the model, from 0 on, the text of an argument, and
        whether the slope is asked for
    """

    functions: Mapping[str, Callable[..., str]]
    argument: Callable[[int], str]
    table: Callable[[int, str, bool], str]


class Body(NamedTuple):
    """A function as text: names with their values in order, the value, and slopes by each argument."""

    statements: tuple[tuple[str, str], ...]
    value: str
    slopes: tuple[str, ...]


class _Parts(NamedTuple):
    """A function as SX: tables have symbols for their values and slopes, of arguments before them."""

    arguments: list[ca.SX]
    tables: list[tuple[int, ca.SX]]
    values: list[ca.SX]
    slopes: list[ca.SX]
    value: ca.SX


def bodies_of(model: DeltaThetaModel, language: Language) -> Iterator[tuple[list[int], Body]]:
    """The functions of Theta in a language, each with the numbers of its arguments in omega."""
    omega, first = list(model.omega), 0
    for function in model.functions:
        own = [omega.index(name) for name in function.signals]
        yield own, _body(function, [language.argument(k) for k in own], first, language)
        first += len(function.tables)


def _body(function: ThetaFunction, names: list[str], first_table: int, language: Language) -> Body:
    """A function of arguments of these names; its tables are numbered from `first_table` on."""
    parts = _parts(function)
    symbols = [*parts.arguments]
    statements: list[tuple[str, str]] = []
    for k, (number, argument) in enumerate(parts.tables):
        place = f"p{k + 1}"
        statements += _statements(argument, symbols, names, f"{place}_", place, language)
        for kind, values, is_slope in (("v", parts.values, False), ("s", parts.slopes, True)):
            statements.append(
                (f"{kind}{k + 1}", language.table(first_table + number, place, is_slope))
            )
            symbols.append(values[k])
            names.append(f"{kind}{k + 1}")
    statements += _statements(parts.value, symbols, names, "f_", "value", language)
    slopes = _total_slopes(parts)
    for j, slope in enumerate(slopes):
        statements += _statements(slope, symbols, names, f"d{j + 1}_", f"d{j + 1}", language)
    return Body(tuple(statements), "value", tuple(f"d{j + 1}" for j in range(len(slopes))))


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

    own = {name: of(k) for k, name in enumerate(named_tables(function.tables))}
    value = function(*arguments, functions={**SYMBOLIC, **own})
    return _Parts(arguments, tables, values, slopes, ca.SX(value))


def _total_slopes(parts: _Parts) -> list[ca.SX]:
    """Slopes by the arguments, through the tables."""
    a = column_of(parts.arguments)
    through: list[ca.SX] = []

    def total(expression: ca.SX) -> ca.SX:
        found = ca.densify(ca.jacobian(expression, a))
        for value, slope in zip(parts.values, through, strict=False):
            found = found + ca.densify(ca.jacobian(expression, value)) * slope
        return found

    for (_, argument), slope in zip(parts.tables, parts.slopes, strict=True):
        through.append(slope * total(argument))
    found = total(parts.value)
    return [found[0, j] for j in range(len(parts.arguments))]


def _statements(
    expression: ca.SX,
    symbols: Sequence[ca.SX],
    names: Sequence[str],
    prefix: str,
    result: str,
    language: Language,
) -> list[tuple[str, str]]:
    """Statements that give an expression the name `result`; parts of it have names with a prefix."""
    plain = [f"x{k}" for k in range(len(names))]  # names of formulas
    found, tables = formula_of(ca.SX(expression), symbols, plain, tables=False)
    assert not tables
    statements: list[tuple[str, str]] = []

    def part(name: str, text: str) -> str:
        statements.append((f"{prefix}{len(statements) + 1}", text))
        return statements[-1][0]

    known = dict(zip(plain, names, strict=True))
    value = formula_value(found, known, language.functions, part)
    return [*statements, (result, value)]


def _infix(sign: str) -> Callable[[str, str], str]:
    return lambda a, b: f"({a} {sign} {b})"


def _call(name: str) -> Callable[..., str]:
    return lambda *parts: f"{name}({', '.join(parts)})"


def number(value: float) -> str:
    """A double in 17 digits at most, which are read back as the same double."""
    text = repr(float(value))
    return f"({text})" if text.startswith("-") else text


_SAME = (
    *("sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh"),
    *("asinh", "acosh", "atanh", "exp", "log", "log1p", "expm1", "sqrt", "floor", "ceil"),
    *("atan2", "hypot", "abs", "min", "max"),
)
_COMMON: Mapping[str, Callable[..., str]] = {
    "number": number,
    **{sign: _infix(sign) for sign in ("+", "-", "*", "/", "<", "<=", ">", ">=", "==")},
    "neg": lambda a: f"(-{a})",
    "and_": lambda a, b: f"({a} != 0 && {b} != 0)",
    "or_": lambda a, b: f"({a} != 0 || {b} != 0)",
    "not_": lambda a: f"({a} == 0)",
    **{name: _call(name) for name in _SAME},
}
C: Mapping[str, Callable[..., str]] = {
    **_COMMON,
    "!=": _infix("!="),
    "**": _call("pow"),
    "abs": _call("fabs"),
    "min": _call("fmin"),
    "max": _call("fmax"),
    "mod": _call("fmod"),
    "copysign": _call("copysign"),
    "sign": lambda a: f"(double)(({a} > 0.0) - ({a} < 0.0))",
    "where": lambda condition, a, b: f"({condition} != 0 ? {a} : {b})",
}
MATLAB: Mapping[str, Callable[..., str]] = {
    **_COMMON,
    "!=": _infix("~="),
    "**": _infix("^"),
    "and_": lambda a, b: f"({a} ~= 0 && {b} ~= 0)",
    "or_": lambda a, b: f"({a} ~= 0 || {b} ~= 0)",
    "mod": _call("rem"),
    "copysign": lambda a, b: f"(abs({a}) * (1 - 2 * ({b} < 0)))",
    "sign": _call("sign"),
    "where": _call("choose"),
}
JULIA: Mapping[str, Callable[..., str]] = {
    **_COMMON,
    "!=": _infix("!="),
    "**": _infix("^"),
    "atan2": _call("atan"),
    "mod": _call("rem"),
    "copysign": _call("copysign"),
    "sign": _call("sign"),
    "where": lambda condition, a, b: f"({condition} != 0 ? {a} : {b})",
}
