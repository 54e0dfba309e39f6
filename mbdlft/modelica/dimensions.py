"""Units of Modelica, such as ``N.m/(rad.s)``, as units of this package, and whether those of a model fit.

Equations are evaluated in dimensions on the syntax tree, where every parameter still has its unit. A
written number, and what has no unit or one that is not known here, may carry any unit.
"""

import re
from collections.abc import Callable, Iterable, Iterator
from fractions import Fraction
from functools import reduce

from mbdlft.base.errors import SceneError
from mbdlft.base.unit import dimension_name, parse_unit
from mbdlft.dae.dae import OPEN, plain
from mbdlft.exact.operators import FUNCTIONS_OF_DIMENSIONS, Dimension
from mbdlft.modelica.printer import shorter, write
from mbdlft.modelica.tree import (
    RELATIONS,
    Array,
    Binary,
    Call,
    Choice,
    Comprehension,
    Equation,
    Expression,
    FlatModel,
    If,
    Loop,
    Number,
    Reference,
    Statement,
    Text,
    Unary,
    spine,
)

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


_NUMBER, _SECOND = (Dimension(parse_unit(unit).dimension) for unit in ("1", "s"))
_PLAIN = (
    *("sin", "cos", "tan", "asin", "acos", "atan"),
    *("sinh", "cosh", "tanh", "exp", "log", "log10"),
)
_SAME = ("noEvent", "abs", "max", "min", "sum", "transpose", "homotopy", "scalar", "vector")


def check_units(model: FlatModel, place: Callable[[int, str], str]) -> None:
    """What is added, compared or made equal has the same unit; arguments of functions have none."""
    checker = _Checker(model)
    bound = [
        Equation(Reference(d.name), d.binding, d.line)
        for d in model.declarations
        if d.binding is not None
    ]
    for e in (*bound, *_equations((*model.equations, *model.initial))):
        try:
            checker.equal(e.left, e.right)
        except SceneError as error:
            text = shorter(f"{write(e.left)} = {write(e.right)}")
            raise SceneError(place(e.line, f"{text!r}: {error}")) from None


def _equations(statements: Iterable[Statement]) -> Iterator[Equation]:
    """All equations, those of choices and loops, too."""
    for statement in statements:
        match statement:
            case Equation():
                yield statement
            case Loop(_, _, body, _):
                yield from _equations(body)
            case Choice(branches, otherwise, _):
                for body in (*(body for _, body in branches), otherwise):
                    yield from _equations(body)


class _Checker:
    """Finds dimensions of expressions; they are `OPEN` where any unit fits."""

    def __init__(self, model: FlatModel) -> None:
        self.dimensions: dict[str, Dimension] = {}
        for d in model.declarations:
            unit = d.attributes.get("unit")
            text = unit_of(unit.text) if isinstance(unit, Text) and unit.text.strip() else None
            known = text is not None
            self.dimensions[d.name] = Dimension(parse_unit(text).dimension) if known else OPEN

    def equal(self, left: Expression, right: Expression) -> None:
        """Raise a SceneError unless both sides have one unit."""
        a, b = self.of(left).exponents, self.of(right).exponents
        if a is not None and b is not None and a != b:
            raise SceneError(
                f"the left side is in {dimension_name(a)}, the right side in {dimension_name(b)}; units "
                "do not fit."
            )

    def of(self, expression: Expression) -> Dimension:
        """The dimension of an expression."""
        match expression:
            case Reference(name, _):
                return self.dimensions.get(name) or self.dimensions.get(write(expression), OPEN)
            case Binary():
                first, operations = spine(expression)
                dimension = self.of(first)
                for operator, right in operations:
                    dimension = self._binary(operator.lstrip("."), dimension, right)
                return dimension
            case Unary(_, operand):
                return self.of(operand)
            case Call(function, arguments) if arguments:
                return self._call(function.rpartition(".")[2], arguments)
            case If(branches, otherwise):
                for condition, _ in branches:
                    self.of(condition)
                return self._common((*(value for _, value in branches), otherwise))
            case Array(entries):
                of_entries = {self.of(entry) for entry in entries}
                return of_entries.pop() if len(of_entries) == 1 else OPEN
            case Comprehension(value, _, _):
                return self.of(value)
            case _:
                return OPEN

    def _binary(self, operator: str, left: Dimension, expression: Expression) -> Dimension:
        if operator == "^":
            return _power(left, expression)
        right = self.of(expression)
        if operator == "*":
            return left * right
        if operator == "/":
            return left / right
        if operator in ("and", "or"):
            return OPEN
        common = _same(left, right)
        return OPEN if operator in RELATIONS else common

    def _common(self, expressions: Iterable[Expression]) -> Dimension:
        """The dimension of expressions that have to have the same."""
        dimensions: Iterable[Dimension] = [OPEN, *map(self.of, expressions)]
        return reduce(_same, dimensions)

    def _call(self, function: str, arguments: tuple[Expression, ...]) -> Dimension:
        if function == "smooth":
            return self.of(arguments[-1])
        if function in _SAME:
            return self._common(arguments)
        if function == "atan2":
            self._common(arguments)
            return _NUMBER
        first = self.of(arguments[0])
        if function == "der":
            return first / _SECOND
        if function == "sqrt":
            return Dimension.of(FUNCTIONS_OF_DIMENSIONS["sqrt"](first))
        if function == "cross" and len(arguments) == 2:
            return first * self.of(arguments[1])
        return plain(first, function) if function in _PLAIN else OPEN


def _same(a: Dimension, b: Dimension) -> Dimension:
    if a is not OPEN and b is not OPEN and a != b:
        raise SceneError(
            f"{dimension_name(a.exponents or ())} and {dimension_name(b.exponents or ())} are added or "
            "compared; units do not fit."
        )
    return a + b


def _power(base: Dimension, exponent: Expression) -> Dimension:
    sign = 1
    if isinstance(exponent, Unary):
        sign, exponent = -1, exponent.operand
    if base.exponents is None or not isinstance(exponent, Number):
        return OPEN
    powers = [sign * Fraction(exponent.text) * x for x in base.exponents]
    return Dimension(tuple(int(x) if x.denominator == 1 else x for x in powers))
