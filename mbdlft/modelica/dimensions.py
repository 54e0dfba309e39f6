"""Units of Modelica, such as ``N.m/(rad.s)``, as units of this package, and whether those of a model fit.

Equations are followed with units on the syntax tree, where every parameter still has its unit. A
written number, and what has no unit or one that is not known here, may carry any unit.
"""

import operator
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from fractions import Fraction
from functools import partial, reduce

from mbdlft.base.errors import SceneError
from mbdlft.base.unit import parse_unit
from mbdlft.dae.dae import OPEN, SECOND, Measure, compared, measure_of, plain
from mbdlft.modelica import tree
from mbdlft.modelica.tree import Expression, shorter, write

_FACTOR = re.compile(r"([^\W\d_]+|%|1)([+-]?\d+)?")


def unit_of(text: str) -> str | None:
    """The unit of this package, such as ``N m/rad/s``; None if it is not known here.

    Modelica Specification 3.6, section 19.1: one slash at most, products by dots, exponents without sign
    or caret, parentheses around the denominator.
    """
    above, slash, below = text.replace(" ", "").partition("/")
    factors = [*_factors(above, 1), *(_factors(below, -1) if slash else [])]
    if None in factors:
        return None
    known = [factor for factor in factors if factor is not None and factor[0] != "1"]
    upper = " ".join(_factor(symbol, exponent) for symbol, exponent in known if exponent > 0)
    lower = "".join(f"/{_factor(symbol, -exponent)}" for symbol, exponent in known if exponent < 0)
    written = (upper or "1") + lower
    try:
        parse_unit(written)
    except SceneError:
        return None
    return written


def _factor(symbol: str, exponent: int) -> str:
    return symbol if exponent == 1 else f"{symbol}^{exponent}"


def _factors(text: str, sign: int) -> list[tuple[str, int] | None]:
    """The factors of a product and their exponents; None for one that cannot be read."""
    if text.startswith("(") and text.endswith(")"):
        text = text[1:-1]
    matches = [_FACTOR.fullmatch(factor) for factor in text.split(".")]
    return [match and (match[1], sign * int(match[2] or 1)) for match in matches]


def check_units(model: tree.FlatModel, place: Callable[[int, str], str]) -> None:
    """What is added, compared or made equal has the same unit; arguments of functions have none."""
    known = {}
    for d in model.declarations:
        unit = d.attributes.get("unit")
        text = unit_of(unit.text) if isinstance(unit, tree.Text) and unit.text.strip() else None
        known[d.name] = OPEN if text is None else measure_of(text)
    bound = [
        tree.Equation(tree.Reference(d.name), d.binding, d.line)
        for d in model.declarations
        if d.binding is not None
    ]
    for e in (*bound, *_equations((*model.equations, *model.initial))):
        try:
            left, right = (_measure(side, known) for side in (e.left, e.right))
            if not left.fits(right):
                raise SceneError(
                    f"the left side is in {left}, the right side in {right}; units do not fit."
                )
        except SceneError as error:
            text = shorter(f"{write(e.left)} = {write(e.right)}")
            raise SceneError(place(e.line, f"{text!r}: {error}")) from None


def _equations(statements: Iterable[tree.Statement]) -> Iterator[tree.Equation]:
    """All equations, those of choices and loops, too."""
    for statement in statements:
        match statement:
            case tree.Equation():
                yield statement
            case tree.Loop(_, _, body, _):
                yield from _equations(body)
            case tree.Choice(branches, otherwise, _):
                for body in (*(body for _, body in branches), otherwise):
                    yield from _equations(body)


def _measure(expression: Expression, known: Mapping[str, Measure]) -> Measure:
    """The unit of an expression; `OPEN` where any unit fits."""

    def of(part: Expression) -> Measure:
        return _measure(part, known)

    match expression:
        case tree.Reference(name, _):
            return known.get(name) or known.get(write(expression), OPEN)
        case tree.Binary():
            first, operations = tree.spine(expression)
            measure = of(first)
            for sign, right in ((symbol.lstrip("."), right) for symbol, right in operations):
                measure = _power(measure, right) if sign == "^" else _BINARY[sign](measure, of(right))
            return measure
        case tree.Unary(_, operand):
            return of(operand)
        case tree.Call(function, arguments) if arguments:
            rule = _FUNCTIONS.get(function.rpartition(".")[2])
            measures = [of(argument) for argument in arguments]
            return rule(*measures) if rule is not None else OPEN
        case tree.If(branches, otherwise):
            for condition, _ in branches:
                of(condition)
            return _common(*(of(value) for _, value in branches), of(otherwise))
        case tree.Array(entries):
            of_entries = {of(entry) for entry in entries}
            return of_entries.pop() if len(of_entries) == 1 else OPEN
        case tree.Comprehension(value, _, _):
            return of(value)
        case _:
            return OPEN


def _common(*measures: Measure) -> Measure:
    """The unit of values that have to have the same."""
    return reduce(operator.add, measures, OPEN)


def _power(base: Measure, exponent: Expression) -> Measure:
    sign = 1
    if isinstance(exponent, tree.Unary):
        sign, exponent = -1, exponent.operand
    return base.power(sign * Fraction(exponent.text)) if isinstance(exponent, tree.Number) else OPEN


_BINARY: Mapping[str, Callable[[Measure, Measure], Measure]] = {
    **{"+": operator.add, "-": operator.add, "*": operator.mul, "/": operator.truediv},
    **dict.fromkeys(tree.RELATIONS, compared),
    **dict.fromkeys(("and", "or"), lambda a, b: OPEN),
}
_PLAIN = ("sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh", "exp", "log", "log10")
_SAME = ("noEvent", "abs", "max", "min", "sum", "transpose", "homotopy", "scalar", "vector")
_FUNCTIONS: dict[str, Callable[..., Measure]] = {
    **dict.fromkeys(_SAME, _common),
    **{name: partial(plain, function=name) for name in _PLAIN},
    "smooth": lambda order, value: value,
    "atan2": lambda y, x: plain(y / (y + x), "atan2"),
    "der": lambda a: a / SECOND,
    "sqrt": Measure.root,
    "cross": operator.mul,
}
