"""Values of expressions of Modelica: exact numbers, CasADi expressions, truths, texts, arrays of these.

A number is a fraction, so that decimals and what is computed of them are not rounded; it becomes a
constant of CasADi where it meets a variable. An array is a tuple, a matrix a tuple of tuples.
"""

import math
import operator as operators
from collections.abc import Callable, Mapping
from fractions import Fraction
from functools import partial
from typing import Any

import casadi as ca

from mbdlft.base.errors import SceneError
from mbdlft.dae.text import FUNCTIONS
from mbdlft.exact.numbers import decimal
from mbdlft.problem.sx.constants import FUNCTIONS as OF_CONSTANTS
from mbdlft.problem.sx.constants import is_constant, literal, numbers_of, pi_times

Value = Any  # Fraction, SX (1, 1), bool, str, or a tuple of values

_MOST_POWER, _MOST_PRODUCTS, _MOST_BITS = 1000, 16, 20_000
_PLAIN = ("sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh", "exp", "log", "sqrt")
_EXTENDED: Mapping[str, Callable[[ca.SX], ca.SX]] = {
    **{name: FUNCTIONS[name] for name in _PLAIN},
    "abs": FUNCTIONS["fabs"],
    "sign": FUNCTIONS["sign"],
}
UNARY = (*_EXTENDED, "log10")
_ROUNDING: Mapping[str, Callable[[Fraction], int]] = {
    "floor": math.floor,
    "ceil": math.ceil,
    "integer": math.floor,
}


def to_sx(value: Value) -> ca.SX:
    """A number or an expression as an expression."""
    if isinstance(value, Fraction):
        return ca.SX(literal(in_range(value)))
    if isinstance(value, ca.SX):
        return value
    raise SceneError(f"expected a number, got {described(value)}.")


def in_range(number: Fraction) -> Fraction:
    """A number, if there is a double near it: it is neither too large nor too small for one."""
    try:
        if number and not float(number):
            raise OverflowError
    except OverflowError:
        digits = math.log10(abs(number.numerator)) - math.log10(number.denominator)
        raise SceneError(f"no double is near a number, which is about 10^{digits:.1f}.") from None
    return number


def described(value: Value) -> str:
    """What a value is, for messages."""
    if isinstance(value, tuple):
        return f"an array of {len(value)}"
    if isinstance(value, dict):
        return f"a record of {', '.join(value)}"
    if isinstance(value, str):
        return f"the text {value!r}"
    return str(value).lower() if isinstance(value, bool) else str(value)


def number_of(value: Value) -> Fraction | None:
    """The number that a value is, to a double where it is not rational; None if it depends on symbols."""
    if isinstance(value, Fraction):
        return value
    if isinstance(value, ca.SX) and is_constant(value):
        number = float(numbers_of(value)[0, 0])
        if math.isfinite(number):
            return decimal(number)
    return None


def each(function: Callable[..., Value], *values: Value) -> Value:
    """A function of scalars, of the entries of arrays of one size; scalars are those of every entry."""
    records = [value for value in values if isinstance(value, dict)]
    if records:
        if any(not isinstance(x, dict) or x.keys() != records[0].keys() for x in values):
            raise SceneError("a record and what is no record, or another one.")
        return {field: each(function, *(value[field] for value in values)) for field in records[0]}
    sizes = {len(value) for value in values if isinstance(value, tuple)}
    if not sizes:
        return function(*values)
    if len(sizes) > 1:
        raise SceneError(f"arrays of {' and '.join(map(str, sorted(sizes)))} entries do not fit.")
    (size,) = sizes
    return tuple(
        each(function, *(v[k] if isinstance(v, tuple) else v for v in values)) for k in range(size)
    )


def negative(value: Value) -> Value:
    """-value."""
    return each(lambda a: -a if isinstance(a, Fraction) else -to_sx(a), value)


def binary(operator: str, left: Value, right: Value) -> Value:
    """left (operator) right; ``*`` of arrays is the product of matrices and vectors."""
    arrays = isinstance(left, tuple) and isinstance(right, tuple)
    if operator == "*" and arrays:
        return _product(left, right)
    if operator in ("/", "^") and isinstance(right, tuple):
        raise SceneError(f"{operator} by an array; write .{operator} for that of its entries.")
    if operator in ("+", "-") and isinstance(left, tuple) != isinstance(right, tuple):
        raise SceneError(f"an array {operator} a number; write .{operator} for that of its entries.")
    if operator in _RELATIONS:
        return _relation(operator, left, right)
    if operator in ("and", "or"):
        return each(partial(_logical, operator), left, right)
    return each(_SCALAR[operator.lstrip(".")], left, right)


def opposite(value: Value) -> Value:
    """not value, of each entry of an array."""
    return each(lambda x: not x if isinstance(x, bool) else ca.logic_not(_truth(x)), value)


def chosen(condition: Value, then: Value, otherwise: Value) -> Value:
    """if condition then ... else ...; the condition is no constant."""

    def of(a: Value, b: Value) -> ca.SX:
        if isinstance(a, str) or isinstance(b, str):
            both = f"{described(a)} and {described(b)}"
            raise SceneError(f"signals choose between {both}, which are no numbers. Take an Integer.")
        return ca.if_else(_truth(condition), to_sx(a), to_sx(b))

    return each(of, then, otherwise)


def rounded(function: str, value: Value) -> Value:
    """floor, ceil or integer of a number."""
    number = number_of(value)
    if number is None:
        raise SceneError(f"{function} of what is no number makes events; they are not supported.")
    return Fraction(_ROUNDING[function](number))


def extreme(left: Value, right: Value, *, largest: bool) -> Value:
    """max or min of two."""
    if isinstance(left, Fraction) and isinstance(right, Fraction):
        return max(left, right) if largest else min(left, right)
    return (ca.fmax if largest else ca.fmin)(to_sx(left), to_sx(right))


def arctangent(y: Value, x: Value) -> Value:
    """atan2(y, x)."""
    a, b = number_of(y), number_of(x)
    if a is not None and b is not None:
        return decimal(math.atan2(a, b))
    return ca.atan2(to_sx(y), to_sx(x))


def total(values: Value) -> Value:
    """The sum of all entries of an array."""
    sum_: Value = Fraction(0)
    for entry in values if isinstance(values, tuple) else (values,):
        sum_ = _add(sum_, total(entry) if isinstance(entry, tuple) else entry)
    return sum_


def spaced(first: Value, last: Value, count: Value) -> Value:
    """`count` values from the first to the last, at equal distances."""
    number = number_of(count)
    if number is None or not 2 <= number <= _MOST_POWER:
        raise SceneError(f"linspace of {described(count)} values.")
    step = _over(_SCALAR["-"](last, first), number - 1)
    return tuple(_add(first, _times(Fraction(k), step)) for k in range(int(number)))


def _product(left: tuple[Value, ...], right: tuple[Value, ...]) -> Value:
    if left and isinstance(left[0], tuple):
        return tuple(_product(row, right) for row in left)
    if len(left) != len(right) or not left:
        raise SceneError(f"a row of {len(left)} times a column of {len(right)} entries.")
    if any(isinstance(row, tuple) for row in right):
        if len({len(row) if isinstance(row, tuple) else -1 for row in right}) > 1:
            raise SceneError("the rows of a matrix have different sizes.")
        return tuple(_product(left, column) for column in zip(*right, strict=True))
    return total(tuple(_times(a, b) for a, b in zip(left, right, strict=True)))


def _exactly(operation: Callable[[Any, Any], Any]) -> Callable[[Value, Value], Value]:
    """An operation of numbers as fractions, and of others as expressions."""

    def of(a: Value, b: Value) -> Value:
        both = isinstance(a, Fraction) and isinstance(b, Fraction)
        return operation(a, b) if both else operation(to_sx(a), to_sx(b))

    return of


_add, _times, _quotient = map(_exactly, (operators.add, operators.mul, operators.truediv))


def _over(a: Value, b: Value) -> Value:
    if isinstance(b, Fraction) and b == 0:
        raise SceneError("division by zero.")
    return _quotient(a, b)


def _power(a: Value, b: Value) -> Value:
    if isinstance(b, Fraction) and abs(b) > _MOST_POWER:
        raise SceneError(f"the power {float(b):g} is too large.")
    if not isinstance(b, Fraction):
        return ca.power(to_sx(a), to_sx(b))
    if b.denominator == 2 and abs(b) == Fraction(1, 2):
        root = applied("sqrt", a)
        return root if b > 0 else _over(Fraction(1), root)
    if b.denominator != 1:
        number = number_of(a)
        if number is not None and number >= 0:
            return decimal(float(number) ** float(b))
        return ca.power(to_sx(a), to_sx(b))
    if b < 0:
        return _over(Fraction(1), _power(a, -b))
    if isinstance(a, Fraction):
        size = max(a.numerator.bit_length(), a.denominator.bit_length())
        if size * b > _MOST_BITS:
            raise SceneError(f"the power {b} of a number of {size} bits is too large.")
        return a ** int(b)
    if b > _MOST_PRODUCTS:
        return ca.power(to_sx(a), float(b))
    power: Value = Fraction(1)
    for k in range(int(b)):
        power = a if k == 0 else _times(power, a)
    return power


_SCALAR: Mapping[str, Callable[[Value, Value], Value]] = {
    "+": _add,
    "-": lambda a, b: _add(a, negative(b)) if isinstance(b, Fraction) else to_sx(a) - to_sx(b),
    "*": _times,
    "/": _over,
    "^": _power,
}
_RELATIONS: Mapping[str, Callable[[Any, Any], Any]] = {
    **{"<": operators.lt, "<=": operators.le, "==": operators.eq, "<>": operators.ne},
    ">": lambda a, b: b < a,
    ">=": lambda a, b: b <= a,
}


def _relation(operator: str, left: Value, right: Value) -> Value:
    """A relation of two scalars: a truth if both are constants."""
    compare = _RELATIONS[operator]
    if isinstance(left, bool | str) and type(left) is type(right):
        return bool(compare(left, right))
    for truth, other in ((left, right), (right, left)):
        if isinstance(truth, bool) and isinstance(other, ca.SX) and operator in ("==", "<>"):
            return other if truth == (operator == "==") else opposite(other)
    a, b = number_of(left), number_of(right)
    if a is not None and b is not None:
        return bool(compare(a, b))
    return compare(to_sx(left), to_sx(right))


def _truth(value: Value) -> ca.SX:
    if isinstance(value, bool):
        return ca.SX(int(value))
    if isinstance(value, ca.SX):
        return value
    raise SceneError(f"expected a condition, got {described(value)}.")


def _logical(operator: str, left: Value, right: Value) -> Value:
    if isinstance(left, bool) and isinstance(right, bool):
        return (left and right) if operator == "and" else (left or right)
    return (ca.logic_and if operator == "and" else ca.logic_or)(_truth(left), _truth(right))


def applied(function: str, value: Value) -> Value:
    """A function of one scalar."""
    number = number_of(value)
    if number is None:
        if function == "log10":
            return ca.log(to_sx(value)) / to_sx(decimal(math.log(10.0)))
        return _EXTENDED[function](to_sx(value))
    if function == "abs":
        return abs(value) if isinstance(value, Fraction) else value * (1 if number >= 0 else -1)
    if function == "sign":
        return Fraction((number > 0) - (number < 0))
    if function == "asin" and abs(number) == 1:  # pi/2, as libraries define pi
        return pi_times(number / 2)
    if function in OF_CONSTANTS:
        constant = OF_CONSTANTS[function](to_sx(value))
        return decimal(constant) if isinstance(constant, float) else constant
    try:
        return decimal(getattr(math, function)(float(number)))
    except (ValueError, OverflowError):
        raise SceneError(f"{function} of {float(number):g} is not a number.") from None
