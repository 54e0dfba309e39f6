"""Values of a formula on a box together with its difference quotients, in outward intervals."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from mbdlft.base.errors import AnalysisError
from mbdlft.exact.interval import FUNCTIONS as INTERVAL_FUNCTIONS
from mbdlft.exact.interval import UNKNOWN, Interval, decimal, outward
from mbdlft.exact.operators import Operators
from mbdlft.system.theta import Table, named_tables

_LIBRARY = 2.0**-50  # functions of the library are right to some units in the last place
_FLAT = 350.0  # beyond it 1/cosh^2 is below 1e-303


@dataclass(frozen=True, slots=True)
class Dual(Operators):
    """All values of a function on a box, and of its difference quotients there."""

    value: Interval
    slope: Interval

    @staticmethod
    def of(number: "Dual | float | None") -> "Dual":
        """A number does not depend on the argument; None, a condition that is not known, jumps."""
        if number is None:
            return Dual(Interval(0.0, 1.0), UNKNOWN)
        return number if isinstance(number, Dual) else Dual(decimal(float(number)), _ZERO)

    def __add__(self, other: "Dual | float | None") -> "Dual":
        o = Dual.of(other)
        return Dual(self.value + o.value, self.slope + o.slope)

    def __neg__(self) -> "Dual":
        return Dual(-self.value, -self.slope)

    def __mul__(self, other: "Dual | float | None") -> "Dual":
        o = Dual.of(other)
        return Dual(self.value * o.value, self.slope * o.value + self.value * o.slope)

    def __truediv__(self, other: "Dual | float | None") -> "Dual":
        o = Dual.of(other)
        value = self.value / o.value
        return Dual(value, (self.slope - value * o.slope) / o.value)


_ZERO = Interval(0.0, 0.0)
_Chain = Callable[[Interval], Interval]


def _chained(value: _Chain, slope: _Chain) -> Callable[[Any], Dual]:
    """A function with its derivative; where they are not defined nothing is known."""

    def of(a: Dual | float) -> Dual:
        a = Dual.of(a)
        try:
            found, factor = value(a.value), slope(a.value)
        except (ValueError, OverflowError, ArithmeticError):
            return Dual(UNKNOWN, UNKNOWN)
        return Dual(found, a.slope if a.slope == _ZERO else factor * a.slope)

    return of


def _monotone(function: Callable[[float], float]) -> _Chain:
    """An increasing function of the library on an interval."""

    def of(a: Interval) -> Interval:
        low, high = function(a.low), function(a.high)
        if a.low == a.high == 0.0:  # exact in the library
            return Interval(low, high)
        return outward(low - _LIBRARY * abs(low), high + _LIBRARY * abs(high))

    return of


_square: _Chain = lambda a: INTERVAL_FUNCTIONS["constpow"](a, 2)  # noqa: E731
_sin, _cos, _atan, _sqrt = (INTERVAL_FUNCTIONS[name] for name in ("sin", "cos", "atan", "sqrt"))
_exp, _sinh, _tanh = map(_monotone, (math.exp, math.sinh, math.tanh))


def _cosh(a: Interval) -> Interval:
    low, high = math.cosh(a.smallest), math.cosh(a.largest)
    return outward(max(1.0, low - _LIBRARY * low), high + _LIBRARY * high)


def _bell(a: Interval) -> Interval:
    """1/cosh^2, without its overflow."""
    least, most = (
        1.0 / _square(_cosh(Interval.of(min(x, _FLAT)))) for x in (a.largest, a.smallest)
    )
    return Interval(least.low if a.largest <= _FLAT else 0.0, most.high)


def _hypotenuse(first: Any, second: Any) -> Dual:
    a, b = Dual.of(first), Dual.of(second)
    square = DUAL["**"]
    return Dual.of(DUAL["sqrt"](square(a, 2.0) + square(b, 2.0)))


def _power(a: Any, exponent: Any) -> Dual:
    power = Dual.of(exponent).value
    if power.low != power.high or power.low != int(power.low):
        raise AnalysisError(
            "sector: a power has an exponent that is not an integer; write sqrt or exp."
        )
    n = int(power.low)
    whole = INTERVAL_FUNCTIONS["constpow"]
    return _chained(lambda x: whole(x, n), lambda x: float(n) * whole(x, n - 1))(a)


def _size(given: Any) -> Dual:
    a = Dual.of(given)
    if a.value.low >= 0.0 or a.value.high <= 0.0:
        return a if a.value.low >= 0.0 else -a
    steep = a.slope.largest
    return Dual(Interval(0.0, a.value.largest), Interval(-steep, steep))


def _least(first: Any, second: Any) -> Dual:
    a, b = Dual.of(first), Dual.of(second)
    if a.value.high <= b.value.low:
        return a
    if b.value.high <= a.value.low:
        return b
    value = Interval(min(a.value.low, b.value.low), min(a.value.high, b.value.high))
    return Dual(value, joined(a.slope, b.slope))


def joined(a: Interval, b: Interval) -> Interval:
    """What is in either of two intervals, or between them."""
    return Interval(min(a.low, b.low), max(a.high, b.high))


def _where(condition: Any, first: Any, second: Any) -> Dual:
    a, b = Dual.of(first), Dual.of(second)
    known = _truth(condition)
    if known is not None:
        return a if known else b
    return Dual(joined(a.value, b.value), UNKNOWN)  # the function may jump


def _sign(a: Any) -> Dual:
    value = Dual.of(a).value
    if value.low > 0.0 or value.high < 0.0:
        return Dual.of(1.0 if value.low > 0.0 else -1.0)
    return Dual(Interval(-1.0, 1.0), UNKNOWN)


def _less(a: Any, b: Any) -> bool | None:
    """Whether a < b on the whole box; None if that is not known."""
    first, second = Dual.of(a).value, Dual.of(b).value
    if first.high < second.low:
        return True
    return False if first.low >= second.high else None


def _equal(a: Any, b: Any) -> bool | None:
    """Whether a = b on the whole box; None if that is not known."""
    first, second = Dual.of(a).value, Dual.of(b).value
    if first.high < second.low or second.high < first.low:
        return False
    return True if first.low == first.high == second.low == second.high else None


def _truth(condition: Any) -> bool | None:
    """A number is true where it is not zero."""
    return condition if isinstance(condition, bool | None) else _not(_equal(condition, 0.0))


def _not(condition: Any) -> bool | None:
    known = _truth(condition)
    return None if known is None else not known


def _and(first: Any, second: Any) -> bool | None:
    a, b = _truth(first), _truth(second)
    if a is False or b is False:
        return False
    return True if a and b else None


DUAL: Mapping[str, Callable[..., Any]] = {
    "number": Dual.of,
    "+": lambda a, b: Dual.of(a) + b,
    "-": lambda a, b: Dual.of(a) - Dual.of(b),
    "*": lambda a, b: Dual.of(a) * b,
    "/": lambda a, b: Dual.of(a) / Dual.of(b),
    "**": _power,
    "neg": lambda a: -Dual.of(a),
    "<": _less,
    ">": lambda a, b: _less(b, a),
    "<=": lambda a, b: _not(_less(b, a)),
    ">=": lambda a, b: _not(_less(a, b)),
    "==": _equal,
    "!=": lambda a, b: _not(_equal(a, b)),
    "not_": _not,
    "and_": _and,
    "or_": lambda a, b: _not(_and(_not(a), _not(b))),
    "where": _where,
    "abs": _size,
    "sign": _sign,
    "min": _least,
    "max": lambda a, b: -_least(-Dual.of(a), -Dual.of(b)),
    "sin": _chained(_sin, _cos),
    "cos": _chained(_cos, lambda a: -_sin(a)),
    "tan": lambda a: DUAL["sin"](a) / DUAL["cos"](a),
    "atan": _chained(_atan, lambda a: 1.0 / (1.0 + _square(a))),
    "sqrt": _chained(_sqrt, lambda a: 0.5 / _sqrt(a)),
    "exp": _chained(_exp, _exp),
    "log": _chained(_monotone(math.log), lambda a: 1.0 / a),
    "sinh": _chained(_sinh, _cosh),
    "cosh": _chained(_cosh, _sinh),
    "tanh": _chained(_tanh, _bell),
    "asinh": _chained(_monotone(math.asinh), lambda a: 1.0 / _sqrt(1.0 + _square(a))),
    "hypot": _hypotenuse,
}


def dual_functions(tables: Sequence[Table]) -> Mapping[str, Callable[..., Any]]:
    """The functions of formulas for duals, with those of tables."""
    return {**DUAL, **{name: _of_table(table) for name, table in named_tables(tables).items()}}


def _of_table(table: Table) -> Callable[[Any], Dual]:
    """A table is continuous, so difference quotients lie between the slopes of the pieces in the box."""

    def of(given: Any) -> Dual:
        a = Dual.of(given)
        parts = [part for part in _pieces(table, a.value) if part is not None]
        value, slope = parts[0].value, parts[0].slope
        for part in parts[1:]:
            value, slope = joined(value, part.value), joined(slope, part.slope)
        return Dual(value, a.slope if a.slope == _ZERO else slope * a.slope)

    return of


def _pieces(table: Table, box: Interval) -> list[Dual | None]:
    b, v = table.breakpoints, table.values
    found = [_line(box, -math.inf, b[0], b[0], v[0], Interval.of(table.below))]
    for k in range(len(b) - 1):
        if table.slopes:
            found.append(_cubic(table, k, box))
        else:
            chord = (Interval.of(v[k + 1]) - v[k]) / (Interval.of(b[k + 1]) - b[k])
            found.append(_line(box, b[k], b[k + 1], b[k], v[k], chord))
    return [*found, _line(box, b[-1], math.inf, b[-1], v[-1], Interval.of(table.above))]


def _part(box: Interval, low: float, high: float) -> Interval | None:
    """What of a box is in a piece; of one that it only touches, the piece beside knows the value."""
    own = Interval(max(box.low, low), min(box.high, high))
    is_point = box.low == box.high
    return own if own.low < own.high or (is_point and own.low == own.high) else None


def _line(
    box: Interval, low: float, high: float, at: float, value: float, slope: Interval
) -> Dual | None:
    own = _part(box, low, high)
    return None if own is None else Dual(value + slope * (own - at), slope)


def _cubic(table: Table, k: int, box: Interval) -> Dual | None:
    b, v, (left, right) = table.breakpoints, table.values, table.slopes[k]
    own = _part(box, b[k], b[k + 1])
    if own is None:
        return None
    h, rise = Interval.of(b[k + 1]) - b[k], Interval.of(v[k + 1]) - v[k]
    t = (own - b[k]) / h
    t = Interval(max(t.low, 0.0), min(t.high, 1.0))
    first, last = h * left - rise, h * right - rise
    bend = (1.0 - t) * first - t * last
    value = v[k] + t * rise + t * (1.0 - t) * bend
    slope = (rise + (1.0 - 2.0 * t) * bend - t * (1.0 - t) * (first + last)) / h
    return Dual(value, slope)
