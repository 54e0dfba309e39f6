"""Proved bounds of a nonlinear function of one argument: its sector and its slope.

    sector_low a <= f(a) <= sector_high a for a > 0,   slope_low <= (f(a) - f(b))/(a - b) <= slope_high

The function is evaluated in duals on boxes that cover the range: outward intervals of its values, and of
its difference quotients.

Source: H. K. Khalil, Nonlinear Systems, 3rd ed., definition 6.2 (sectors).
"""

import itertools
import math
import operator
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, NamedTuple

import numpy as np

from mbdlft.base.arguments import arguments_checked
from mbdlft.base.errors import AnalysisError, SceneError
from mbdlft.base.formula import ARITHMETIC
from mbdlft.exact import interval
from mbdlft.exact.interval import UNKNOWN, Interval, outward
from mbdlft.exact.numbers import decimal
from mbdlft.exact.operators import Operators
from mbdlft.system.theta import Table, ThetaFunction, named_tables

_LIBRARY = 2.0**-50  # functions of the library are right to some units in the last place
_FLAT = 350.0  # beyond it 1/cosh^2 is below 1e-303
_ZERO = Interval(0.0, 0.0)
_Chain = Callable[[Interval], Interval]
_sin, _cos, _atan, _sqrt = (interval.FUNCTIONS[name] for name in ("sin", "cos", "atan", "sqrt"))
_BOXES = 2048  # parts of a range: bounds of a slope are too wide by its change in one of them
_NOTHING = 1e-300  # what outward rounding makes of zero
_MOST_POWER = 64  # larger ones of fractions have too many digits


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
        return number if isinstance(number, Dual) else Dual(interval.decimal(float(number)), _ZERO)

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


def _chained(value: _Chain, slope: _Chain) -> Callable[[Any], Dual]:
    """A function with its derivative; where they are not defined nothing is known."""

    def of(a: Dual | float) -> Dual:
        a = Dual.of(a)
        try:
            values, factor = value(a.value), slope(a.value)
        except (ValueError, OverflowError, ArithmeticError):
            return Dual(UNKNOWN, UNKNOWN)
        return Dual(values, a.slope if a.slope == _ZERO else factor * a.slope)

    return of


def _monotone(function: Callable[[float], float]) -> _Chain:
    """An increasing function of the library on an interval."""

    def of(a: Interval) -> Interval:
        low, high = function(a.low), function(a.high)
        if a.low == a.high == 0.0:  # exact in the library
            return Interval(low, high)
        return outward(low - _LIBRARY * abs(low), high + _LIBRARY * abs(high))

    return of


_square: _Chain = lambda a: interval.FUNCTIONS["constpow"](a, 2)  # noqa: E731
_exp, _sinh, _tanh = map(_monotone, (math.exp, math.sinh, math.tanh))


def _cosh(a: Interval) -> Interval:
    low, high = math.cosh(a.smallest), math.cosh(a.largest)
    return outward(max(1.0, low - _LIBRARY * low), high + _LIBRARY * high)


def _bell(a: Interval) -> Interval:
    """1/cosh^2, without its overflow."""
    least, most = (1.0 / _square(_cosh(Interval.of(min(x, _FLAT)))) for x in (a.largest, a.smallest))
    return Interval(least.low if a.largest <= _FLAT else 0.0, most.high)


def _power(a: Any, exponent: Any) -> Dual:
    power = Dual.of(exponent).value
    if power.low != power.high or power.low != int(power.low):
        what = "a power has an exponent that is not an integer; write sqrt or exp."
        raise AnalysisError(f"sector: {what}")
    n, whole = int(power.low), interval.FUNCTIONS["constpow"]
    return _chained(lambda x: whole(x, n), lambda x: float(n) * whole(x, n - 1))(a)


def _size(number: Any) -> Dual:
    a = Dual.of(number)
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
    return True if first.high < second.low else False if first.low >= second.high else None


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
    "hypot": lambda a, b: DUAL["sqrt"](_power(a, 2.0) + _power(b, 2.0)),
}


def dual_functions(tables: Sequence[Table]) -> Mapping[str, Callable[..., Any]]:
    """The functions of formulas for duals, with those of tables."""
    return {**DUAL, **{name: _of_table(table) for name, table in named_tables(tables).items()}}


def _of_table(table: Table) -> Callable[[Any], Dual]:
    """A table is continuous, so difference quotients lie between the slopes of the pieces in the box."""

    def of(number: Any) -> Dual:
        a = Dual.of(number)
        pieces = _pieces(table, a.value)
        value, slope = pieces[0].value, pieces[0].slope
        for piece in pieces[1:]:
            value, slope = joined(value, piece.value), joined(slope, piece.slope)
        return Dual(value, a.slope if a.slope == _ZERO else slope * a.slope)

    return of


def _pieces(table: Table, box: Interval) -> list[Dual]:
    """Values and slopes of the pieces in a box; where it only touches one, the next one has the value."""
    pieces, is_point = [], box.low == box.high
    for k, ends in enumerate(itertools.pairwise((-math.inf, *table.breakpoints, math.inf)), -1):
        inside = Interval(max(box.low, ends[0]), min(box.high, ends[1]))
        if inside.low < inside.high or (is_point and inside.low == inside.high):
            is_cubic = table.slopes and 0 <= k < len(table.slopes)
            pieces.append((_cubic if is_cubic else _line)(table, k, inside))
    return pieces


def _line(table: Table, k: int, x: Interval) -> Dual:
    b, v = table.breakpoints, table.values
    if 0 <= k < len(b) - 1:
        slope = (Interval.of(v[k + 1]) - v[k]) / (Interval.of(b[k + 1]) - b[k])
    else:
        slope = Interval.of(table.below if k < 0 else table.above)
    return Dual(v[max(k, 0)] + slope * (x - b[max(k, 0)]), slope)


def _cubic(table: Table, k: int, x: Interval) -> Dual:
    b, v, (start, end) = table.breakpoints, table.values, table.slopes[k]
    h, rise = Interval.of(b[k + 1]) - b[k], Interval.of(v[k + 1]) - v[k]
    t = (x - b[k]) / h
    t = Interval(max(t.low, 0.0), min(t.high, 1.0))
    first, last = h * start - rise, h * end - rise
    bend = (1.0 - t) * first - t * last
    value = v[k] + t * rise + t * (1.0 - t) * bend
    slope = (rise + (1.0 - 2.0 * t) * bend - t * (1.0 - t) * (first + last)) / h
    return Dual(value, slope)


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


@arguments_checked
def sector_bounds(
    function: ThetaFunction, low: float | None = None, high: float | None = None, *, boxes: int = _BOXES
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
    """
    if len(function.arguments) != 1:
        raise AnalysisError(
            f"sector of {function.name!r}: it has {len(function.arguments)} arguments, expected one. "
            "Make the model with delta_theta(..., 'fewest'), or look at a function of one argument."
        )
    least, most = function.ranges[0]
    ends = (least if low is None else low, most if high is None else high)
    ends = checked_range(function, 0, ends, f"sector of {function.name!r}", "Give low and high.")
    kinks = [x for table in function.tables for x in table.breakpoints if ends[0] < x < ends[1]]
    zero = [0.0] if ends[0] < 0.0 < ends[1] else []
    grid = np.union1d(np.linspace(*ends, max(1, int(boxes)) + 1), [*zero, *kinks]).tolist()
    values, slopes, ratios = [], [], []
    for a, b in itertools.pairwise(grid):
        dual = _at(function, Interval(a, b))
        center = 0.5 * (a + b)
        middle = _at(function, Interval(center, center)).value
        slopes.append(dual.slope)
        values.append(_both(dual.value, middle + dual.slope * (Interval(a, b) - center)))
        # f(x) = f(c) + s (x - c) with s among the slopes: f(x)/x = s + (f(c) - s c)/x
        behind = dual.slope + (middle - dual.slope * center) / Interval(a, b)
        ratios.append(_both(values[-1] / Interval(a, b), behind))
    passes = ends[0] <= 0.0 <= ends[1] and _is_zero_at_zero(function)
    return SectorBounds(
        *ends,
        sector=_sector(grid, ratios, slopes) if passes else (-math.inf, math.inf),
        slope=_hull(slopes),
        values=_hull(values),
    )


@arguments_checked
def slope_bounds(
    function: ThetaFunction, ranges: Sequence[tuple[float, float]], *, boxes: int = _BOXES
) -> tuple[tuple[float, float], ...]:
    """Proved bounds of the slope of a function by each of its arguments, over ranges of all of them.

    f(a) - f(b) = sum of k_j (a_j - b_j) with k_j between these bounds, for all a, b in the ranges.

    Parameters
    ----------
    function : ThetaFunction
    ranges : sequence of (low, high), finite, of the arguments
    boxes : int
        In how many parts the ranges are looked at in all.

    Returns
    -------
    tuple of (low, high)
        Infinite where the function may jump.
    """
    ends = [end for low, high in ranges for end in (low, high)]
    if len(ranges) != len(function.arguments) or not all(map(math.isfinite, ends)):
        raise AnalysisError(
            f"slopes of {function.name!r}: expected a finite range of each of the arguments "
            f"{', '.join(function.arguments)}, got {list(ranges)}."
        )
    count = max(1, int(max(1, boxes) ** (1.0 / len(ranges))))
    grids = [np.linspace(low, high, count + 1).tolist() for low, high in ranges]
    functions = dual_functions(function.tables)
    slopes_of: list[list[Interval]] = [[] for _ in ranges]
    for box in itertools.product(*(itertools.pairwise(grid) for grid in grids)):
        for j, slopes in enumerate(slopes_of):
            duals = [Dual(Interval(a, b), Interval.of(float(i == j))) for i, (a, b) in enumerate(box)]
            slopes.append(Dual.of(function(*duals, functions=functions)).slope)
    return tuple(_hull(slopes) for slopes in slopes_of)


def checked_range(
    f: ThetaFunction, j: int, ends: tuple[float, float], what: str, advice: str
) -> tuple[float, float]:
    """A range of an argument as floats; an error unless it is finite and inside that of the function."""
    (least, most), low, high = f.ranges[j], float(ends[0]), float(ends[1])
    text = f"{what}: the range [{low:g}, {high:g}] of {f.signals[j]}"
    if not (math.isfinite(low) and math.isfinite(high) and low < high):
        raise AnalysisError(f"{text} is not finite. {advice}")
    if low < least or high > most:
        raise AnalysisError(f"{text} is not inside that of the function, [{least:g}, {most:g}].")
    return low, high


def _sector(grid: list[float], ratios: list[Interval], slopes: list[Interval]) -> tuple[float, float]:
    """Bounds of f(a)/a, for f(0) = 0: ratios on boxes, and means of the slopes between zero and a.

    From zero outward, (sum of widths times slopes)/a at the ends of a box bounds it on the box.
    """
    middle = grid.index(0.0)
    bounds = []
    for side in (range(middle, len(ratios)), range(middle - 1, -1, -1)):
        total, mean = Interval(0.0, 0.0), None
        for k in side:
            a, b = grid[k], grid[k + 1]
            end = b if a >= 0.0 else a
            total = total + slopes[k] * (Interval.of(b) - a)
            now = total / abs(end)
            means = now if mean is None else joined(mean, now)
            mean = now
            touches = a == 0.0 or b == 0.0
            bounds.append(means if touches else _both(means, ratios[k]))
    return _hull(bounds)


def _at(f: ThetaFunction, box: Interval) -> Dual:
    return Dual.of(f(Dual(box, Interval.of(1.0)), functions=dual_functions(f.tables)))


def _is_zero_at_zero(f: ThetaFunction) -> bool:
    """Whether f(0) is 0, in exact numbers, or, with functions that have none, but for an underflow."""
    tables = {name: table.exactly for name, table in named_tables(f.tables).items()}
    try:
        return bool(f(Fraction(0), functions={**_EXACT, **tables}) == 0)
    except (SceneError, ArithmeticError):
        return _at(f, Interval(0.0, 0.0)).value.largest <= _NOTHING


def _only_at(argument: int, value: int) -> Callable[[Fraction], Fraction]:
    """A function that is known at one number."""
    return lambda a: Fraction(value) if a == argument else _unknown()


def _unknown() -> Fraction:
    raise ArithmeticError("no exact value")


_EXACT: Mapping[str, Callable[..., Any]] = {
    **ARITHMETIC,
    "number": decimal,
    "**": lambda a, b: a ** int(b) if b == int(b) and abs(b) <= _MOST_POWER else _unknown(),
    "neg": operator.neg,
    "abs": abs,
    "min": min,
    "max": max,
    "where": lambda condition, a, b: a if condition else b,
    "not_": operator.not_,
    **{name: _only_at(0, 0) for name in ("sin", "tan", "atan", "sinh", "tanh", "sqrt", "asinh")},
    **{name: _only_at(0, 1) for name in ("cos", "cosh", "exp")},
    "log": _only_at(1, 0),
}


def _hull(intervals: list[Interval]) -> tuple[float, float]:
    return min(p.low for p in intervals), max(p.high for p in intervals)


def _both(a: Interval, b: Interval) -> Interval:
    """What is in two intervals that hold the same value; an end that is no number is left out."""
    low = max((x for x in (a.low, b.low) if not math.isnan(x)), default=-math.inf)
    high = min((x for x in (a.high, b.high) if not math.isnan(x)), default=math.inf)
    return Interval(low, high) if low <= high else a
