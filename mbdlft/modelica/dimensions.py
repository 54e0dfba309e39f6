"""Units as Modelica writes them, such as ``N.m/(rad.s)`` or ``kg.m2``, as units of this package.

Whether the units of a model fit: its equations are followed on the tree, dimensions for numbers.

This is done on the tree, where every parameter still has its unit. What has no unit, or one that is not
known here, and every number that is written, may carry any unit.
"""

import re
from collections.abc import Callable, Iterable, Iterator
from fractions import Fraction

from mbdlft.base.errors import SceneError
from mbdlft.base.unit import Exponents, dimension_name, parse_unit
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
from mbdlft.modelica.write import shorter, write

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


Dimensions = Exponents | None  # None: any

_NONE: Exponents = parse_unit("1").dimension
_SECOND: Exponents = parse_unit("s").dimension
_PLAIN = (
    *("sin", "cos", "tan", "asin", "acos", "atan"),
    *("sinh", "cosh", "tanh", "exp", "log", "log10"),
)
_SAME = ("noEvent", "abs", "max", "min", "sum", "transpose", "homotopy", "scalar", "vector")
_PLACE = Callable[[int, str], str]


def check_units(model: FlatModel, place: _PLACE) -> None:
    """What is added, compared or made equal has the same unit; arguments of functions have none."""
    checker = _Checker(model)
    for d in model.declarations:
        if d.binding is not None:
            side = f"{d.name} = {write(d.binding)}"
            _check(place, d.line, side, lambda d=d: checker.equal(Reference(d.name), d.binding))  # type: ignore[misc]
    for e in _equations((*model.equations, *model.initial)):
        side = f"{write(e.left)} = {write(e.right)}"
        _check(place, e.line, side, lambda e=e: checker.equal(e.left, e.right))  # type: ignore[misc]


def _check(place: _PLACE, line: int, what: str, do: Callable[[], object]) -> None:
    try:
        do()
    except SceneError as error:
        raise SceneError(place(line, f"{shorter(what)!r}: {error}")) from None


def _equations(statements: Iterable[Statement]) -> Iterator[Equation]:
    """All equations, those of choices and loops, too."""
    for statement in statements:
        match statement:
            case Equation():
                yield statement
            case Loop(_, _, body, _):
                yield from _equations(body)
            case Choice(branches, otherwise, _):
                for _, body in branches:
                    yield from _equations(body)
                yield from _equations(otherwise)


class _Checker:
    """Finds dimensions of expressions."""

    def __init__(self, model: FlatModel) -> None:
        self.given: dict[str, Dimensions] = {}
        for d in model.declarations:
            unit = d.attributes.get("unit")
            text = unit_of(unit.text) if isinstance(unit, Text) and unit.text.strip() else None
            self.given[d.name] = None if text is None else parse_unit(text).dimension

    def equal(self, left: Expression, right: Expression) -> None:
        """Raise a SceneError unless both sides have one unit."""
        a, b = self.of(left), self.of(right)
        if a is not None and b is not None and a != b:
            raise SceneError(
                f"the left side is in {dimension_name(a)}, the right side in {dimension_name(b)}; units "
                "do not fit."
            )

    def of(self, expression: Expression) -> Dimensions:
        """The dimensions of an expression; None if it may carry any unit."""
        match expression:
            case Reference(name, _):
                return self.given.get(name, self.given.get(write(expression)))
            case Binary():
                first, operations = spine(expression)
                dimensions = self.of(first)
                for operator, right in operations:
                    dimensions = self._binary(operator.lstrip("."), dimensions, right)
                return dimensions
            case Unary(_, operand):
                return self.of(operand)
            case Call(function, arguments):
                return self._call(function.rpartition(".")[2], arguments)
            case If(branches, otherwise):
                for condition, _ in branches:
                    self.of(condition)
                return self._common((*(value for _, value in branches), otherwise))
            case Array(entries):
                found_entries = {self.of(entry) for entry in entries}
                return found_entries.pop() if len(found_entries) == 1 else None
            case Comprehension(value, _, _):
                return self.of(value)
            case _:
                return None

    def _binary(self, operator: str, left: Dimensions, expression: Expression) -> Dimensions:
        if operator == "^":
            return _power(left, expression)
        right = self.of(expression)
        if operator in ("*", "/"):
            sign = 1 if operator == "*" else -1
            return _times(left, right, sign)
        if operator in ("and", "or"):
            return None
        common = _added(left, right)
        return None if operator in RELATIONS else common

    def _common(self, expressions: Iterable[Expression]) -> Dimensions:
        """That of expressions which are to have the same."""
        common: Dimensions = None
        for expression in expressions:
            common = _added(common, self.of(expression))
        return common

    def _call(self, function: str, arguments: tuple[Expression, ...]) -> Dimensions:
        if not arguments:
            return None
        if function == "smooth":
            return self.of(arguments[-1])
        if function in _SAME:
            return self._common(arguments)
        first = self.of(arguments[0])
        if function == "der":
            return _times(first, _SECOND, -1)
        if function in _PLAIN:
            if first is not None and any(first):
                raise SceneError(
                    f"{function} of a value in {dimension_name(first)}; it takes plain numbers and "
                    "angles."
                )
            return _NONE
        if function == "sqrt":
            return None if first is None else _halves(first)
        if function == "atan2":
            self._common(arguments)
            return _NONE
        if function == "cross" and len(arguments) == 2:
            return _times(first, self.of(arguments[1]), 1)
        return None


def _added(a: Dimensions, b: Dimensions) -> Dimensions:
    if a is None or b is None:
        return b if a is None else a
    if a != b:
        raise SceneError(
            f"{dimension_name(a)} and {dimension_name(b)} are added or compared; units do not fit."
        )
    return a


def _times(a: Dimensions, b: Dimensions, sign: int) -> Dimensions:
    if a is None or b is None:
        return None
    return tuple(x + sign * y for x, y in zip(a, b, strict=True))


def _power(base: Dimensions, exponent: Expression) -> Dimensions:
    sign = 1
    if isinstance(exponent, Unary):
        sign, exponent = -1, exponent.operand
    if base is None or not isinstance(exponent, Number):
        return None
    return _plain_exponents(tuple(sign * Fraction(exponent.text) * x for x in base))


def _halves(base: Exponents) -> Exponents:
    return _plain_exponents(tuple(Fraction(x) / 2 for x in base))


def _plain_exponents(exponents: tuple[Fraction, ...]) -> Exponents:
    return tuple(int(x) if x.denominator == 1 else x for x in exponents)
