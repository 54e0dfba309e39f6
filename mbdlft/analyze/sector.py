"""Proved bounds of a nonlinear function of one argument: its sector and its slope.

    sector_low a <= f(a) <= sector_high a for a > 0,   slope_low <= (f(a) - f(b))/(a - b) <= slope_high

The function and its derivative are followed in outward intervals on boxes that cover the range.

Source: H. K. Khalil, Nonlinear Systems, 3rd ed., definition 6.2 (sectors).
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from mbdlft.base.errors import AnalysisError
from mbdlft.base.formula import formula_value
from mbdlft.number.interval import FUNCTIONS as INTERVAL_FUNCTIONS
from mbdlft.number.interval import UNKNOWN, Interval, decimal, outward
from mbdlft.number.operators import Operators
from mbdlft.system.theta import ThetaFunction

_BOXES = 2048
_NOTHING = 1e-300  # what outward rounding makes of zero
_LIBRARY = 2.0**-50  # functions of the library are right to some units in the last place


class SectorBounds(NamedTuple):
    """Proved bounds over [low, high].

    Attributes
    ----------
    low, high : float, the range of the argument
    sector : (float, float)
        Of f(a)/a; infinite if f(0) is not zero, or f has a jump or a vertical slope at zero.
    slope : (float, float)
        Of difference quotients; infinite where the function may jump.
    values : (float, float)
        Of f.
    """

    low: float
    high: float
    sector: tuple[float, float]
    slope: tuple[float, float]
    values: tuple[float, float]


def sector_bounds(
    function: ThetaFunction,
    low: float | None = None,
    high: float | None = None,
    *,
    boxes: int = _BOXES,
) -> SectorBounds:
    """Proved sector and slope of a function of one argument over a range.

    Parameters
    ----------
    function : ThetaFunction
        Of one argument.
    low, high : float, optional
        The range; that of the function by default. It contains zero for a sector.
    boxes : int
        In how many parts the range is looked at: bounds are closer with more of them.

    Returns
    -------
    SectorBounds
        Outward: the true bounds are inside.

    Raises
    ------
    AnalysisError
        The function has several arguments, the range is not finite or not inside that of the function.
    """
    ends = _range(function, low, high)
    zero = [0.0] if ends[0] < 0.0 < ends[1] else []
    grid = np.union1d(np.linspace(*ends, max(1, int(boxes)) + 1), zero)
    values, slopes = [], []
    at_zero = _at(function, Interval(0.0, 0.0)) if ends[0] <= 0.0 <= ends[1] else None
    passes = at_zero is not None and at_zero.value.largest <= _NOTHING
    for a, b in zip(grid[:-1].tolist(), grid[1:].tolist(), strict=True):
        box = Interval(a, b)
        found = _at(function, box)
        middle = _at(function, Interval(0.5 * (a + b), 0.5 * (a + b)))
        near = middle.value + found.slope * Interval(-0.5 * (b - a), 0.5 * (b - a)) * 1.0000001
        values.append(_both(found.value, near))
        slopes.append(found.slope)
    return SectorBounds(
        *ends,
        sector=_sector(grid.tolist(), values, slopes) if passes else (-math.inf, math.inf),
        slope=_hull(slopes),
        values=_hull(values),
    )


def _range(f: ThetaFunction, low: float | None, high: float | None) -> tuple[float, float]:
    if len(f.arguments) != 1:
        raise AnalysisError(
            f"sector of {f.name!r}: it has {len(f.arguments)} arguments, expected one. Make the "
            "model with delta_theta(..., 'fewest'), or look at a function of one argument."
        )
    own = f.ranges[0]
    ends = (own[0] if low is None else float(low), own[1] if high is None else float(high))
    if not (math.isfinite(ends[0]) and math.isfinite(ends[1]) and ends[0] < ends[1]):
        raise AnalysisError(
            f"sector of {f.name!r}: the range [{ends[0]:g}, {ends[1]:g}] of {f.signals[0]} is not "
            "finite. Give low and high."
        )
    if ends[0] < own[0] or ends[1] > own[1]:
        raise AnalysisError(
            f"sector of {f.name!r}: the range [{ends[0]:g}, {ends[1]:g}] is not inside that of the "
            f"function, [{own[0]:g}, {own[1]:g}]."
        )
    return ends


def _sector(
    grid: list[float], values: list[Interval], slopes: list[Interval]
) -> tuple[float, float]:
    """Bounds of f(a)/a, for f(0) = 0: quotients on boxes, and means of the slopes between zero and a.

    From zero outward, (sum of widths times slopes)/a at the ends of a box bounds it on the box.
    """
    middle = grid.index(0.0)
    found = []
    for side in (range(middle, len(values)), range(middle - 1, -1, -1)):
        total, mean = Interval(0.0, 0.0), None
        for k in side:
            a, b = grid[k], grid[k + 1]
            end = b if a >= 0.0 else a
            total = total + slopes[k] * (Interval.of(b) - a)
            now = total / abs(end)
            both = now if mean is None else _hull([mean, now])
            means = both if isinstance(both, Interval) else Interval(*both)
            mean = now
            touches = a == 0.0 or b == 0.0
            found.append(means if touches else _both(means, values[k] / Interval(a, b)))
    return _hull(found)


def _at(f: ThetaFunction, box: Interval) -> "Dual":
    found = formula_value(f.text, {f.arguments[0]: Dual(box, Interval(1.0, 1.0))}, _FUNCTIONS)
    return Dual.of(found)


def _hull(parts: list[Interval]) -> tuple[float, float]:
    return min(p.low for p in parts), max(p.high for p in parts)


def _both(a: Interval, b: Interval) -> Interval:
    """What is in two intervals that hold the same value; an end that is no number is left out."""
    low = max((x for x in (a.low, b.low) if not math.isnan(x)), default=-math.inf)
    high = min((x for x in (a.high, b.high) if not math.isnan(x)), default=math.inf)
    return Interval(low, high) if low <= high else a


@dataclass(frozen=True, slots=True)
class Dual(Operators):
    """All values of a function on a box, and of its difference quotients there."""

    value: Interval
    slope: Interval

    @staticmethod
    def of(number: "Dual | float") -> "Dual":
        """A number does not depend on the argument."""
        return number if isinstance(number, Dual) else Dual(decimal(float(number)), _ZERO)

    def __add__(self, other: "Dual | float") -> "Dual":
        o = Dual.of(other)
        return Dual(self.value + o.value, self.slope + o.slope)

    def __neg__(self) -> "Dual":
        return Dual(-self.value, -self.slope)

    def __mul__(self, other: "Dual | float") -> "Dual":
        o = Dual.of(other)
        return Dual(self.value * o.value, self.slope * o.value + self.value * o.slope)

    def __truediv__(self, other: "Dual | float") -> "Dual":
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
    return Dual(value, _joined(a.slope, b.slope))


def _joined(a: Interval, b: Interval) -> Interval:
    return Interval(min(a.low, b.low), max(a.high, b.high))


def _where(condition: Any, first: Any, second: Any) -> Dual:
    a, b = Dual.of(first), Dual.of(second)
    if condition is True:
        return a
    if condition is False:
        return b
    return Dual(_joined(a.value, b.value), UNKNOWN)  # the function may jump


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


def _not(condition: bool | None) -> bool | None:  # noqa: FBT001
    return None if condition is None else not condition


_FUNCTIONS: Mapping[str, Callable[..., Any]] = {
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
    "not_": _not,
    "where": _where,
    "abs": _size,
    "sign": _sign,
    "min": _least,
    "max": lambda a, b: -_least(-Dual.of(a), -Dual.of(b)),
    "sin": _chained(_sin, _cos),
    "cos": _chained(_cos, lambda a: -_sin(a)),
    "tan": lambda a: _FUNCTIONS["sin"](a) / _FUNCTIONS["cos"](a),
    "atan": _chained(_atan, lambda a: 1.0 / (1.0 + _square(a))),
    "sqrt": _chained(_sqrt, lambda a: 0.5 / _sqrt(a)),
    "exp": _chained(_exp, _exp),
    "log": _chained(_monotone(math.log), lambda a: 1.0 / a),
    "sinh": _chained(_sinh, _cosh),
    "cosh": _chained(_cosh, _sinh),
    "tanh": _chained(_tanh, lambda a: 1.0 / _square(_cosh(a))),
}
