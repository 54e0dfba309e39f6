"""Proved bounds of a nonlinear function of one argument: its sector and its slope.

    sector_low a <= f(a) <= sector_high a for a > 0,   slope_low <= (f(a) - f(b))/(a - b) <= slope_high

The function and its derivative are followed in outward intervals on boxes that cover the range.

Source: H. K. Khalil, Nonlinear Systems, 3rd ed., definition 6.2 (sectors).
"""

import itertools
import math
import operator
from collections.abc import Callable, Mapping, Sequence
from fractions import Fraction
from typing import Any, NamedTuple

import numpy as np

from mbdlft.base.errors import AnalysisError, SceneError
from mbdlft.base.formula import ARITHMETIC
from mbdlft.exact.interval import Interval
from mbdlft.exact.numbers import decimal
from mbdlft.robust.dual import Dual, dual_functions
from mbdlft.system.theta import ThetaFunction, named_tables

_BOXES = 2048
_NOTHING = 1e-300  # what outward rounding makes of zero
_MOST_POWER = 64


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
    kinks = [x for table in function.tables for x in table.breakpoints if ends[0] < x < ends[1]]
    zero = [0.0] if ends[0] < 0.0 < ends[1] else []
    grid = np.union1d(np.linspace(*ends, max(1, int(boxes)) + 1), [*zero, *kinks]).tolist()
    values, slopes, ratios = [], [], []
    for a, b in itertools.pairwise(grid):
        found = _at(function, Interval(a, b))
        center = 0.5 * (a + b)
        middle = _at(function, Interval(center, center)).value
        slopes.append(found.slope)
        values.append(_both(found.value, middle + found.slope * (Interval(a, b) - center)))
        # f(x) = f(c) + s (x - c) with s among the slopes: f(x)/x = s + (f(c) - s c)/x
        behind = found.slope + (middle - found.slope * center) / Interval(a, b)
        ratios.append(_both(values[-1] / Interval(a, b), behind))
    passes = ends[0] <= 0.0 <= ends[1] and _is_zero_at_zero(function)
    return SectorBounds(
        *ends,
        sector=_sector(grid, ratios, slopes) if passes else (-math.inf, math.inf),
        slope=_hull(slopes),
        values=_hull(values),
    )


def slope_bounds(
    function: ThetaFunction,
    ranges: Sequence[tuple[float, float]],
    *,
    boxes: int = _BOXES,
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

    Raises
    ------
    AnalysisError
        The ranges are not those of the arguments, or one is not finite.
    """
    ends = [end for low, high in ranges for end in (low, high)]
    if len(ranges) != len(function.arguments) or not all(map(math.isfinite, ends)):
        raise AnalysisError(
            f"slopes of {function.name!r}: expected a finite range of each of the arguments "
            f"{', '.join(function.arguments)}, got {list(ranges)}."
        )
    parts = max(1, int(max(1, boxes) ** (1.0 / len(ranges))))
    grids = [np.linspace(low, high, parts + 1).tolist() for low, high in ranges]
    own = dual_functions(function.tables)
    found: list[list[Interval]] = [[] for _ in ranges]
    for box in itertools.product(*(itertools.pairwise(grid) for grid in grids)):
        for j, slopes in enumerate(found):
            duals = [
                Dual(Interval(a, b), Interval.of(float(i == j))) for i, (a, b) in enumerate(box)
            ]
            slopes.append(Dual.of(function(*duals, functions=own)).slope)
    return tuple(_hull(slopes) for slopes in found)


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
    grid: list[float], ratios: list[Interval], slopes: list[Interval]
) -> tuple[float, float]:
    """Bounds of f(a)/a, for f(0) = 0: ratios on boxes, and means of the slopes between zero and a.

    From zero outward, (sum of widths times slopes)/a at the ends of a box bounds it on the box.
    """
    middle = grid.index(0.0)
    found = []
    for side in (range(middle, len(ratios)), range(middle - 1, -1, -1)):
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
            found.append(means if touches else _both(means, ratios[k]))
    return _hull(found)


def _at(f: ThetaFunction, box: Interval) -> Dual:
    return Dual.of(f(Dual(box, Interval.of(1.0)), functions=dual_functions(f.tables)))


def _is_zero_at_zero(f: ThetaFunction) -> bool:
    """Whether f(0) is 0, in exact numbers, or, with functions that have none, but for an underflow."""
    own = {name: table.exactly for name, table in named_tables(f.tables).items()}
    try:
        return bool(f(Fraction(0), functions={**_EXACT, **own}) == 0)
    except (SceneError, ArithmeticError, _NotExactError):
        return _at(f, Interval(0.0, 0.0)).value.largest <= _NOTHING


class _NotExactError(Exception):
    """A function has no exact value."""


def _only_at(argument: int, value: int) -> Callable[[Fraction], Fraction]:
    """A function that is known at one number."""

    def of(a: Fraction) -> Fraction:
        if a != argument:
            raise _NotExactError
        return Fraction(value)

    return of


def _whole_power(a: Fraction, b: Fraction) -> Fraction:
    if b.denominator != 1 or abs(b) > _MOST_POWER:
        raise _NotExactError
    return a ** int(b)


_EXACT: Mapping[str, Callable[..., Any]] = {
    **ARITHMETIC,
    "number": decimal,
    "**": _whole_power,
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


def _hull(parts: list[Interval]) -> tuple[float, float]:
    return min(p.low for p in parts), max(p.high for p in parts)


def _both(a: Interval, b: Interval) -> Interval:
    """What is in two intervals that hold the same value; an end that is no number is left out."""
    low = max((x for x in (a.low, b.low) if not math.isnan(x)), default=-math.inf)
    high = min((x for x in (a.high, b.high) if not math.isnan(x)), default=math.inf)
    return Interval(low, high) if low <= high else a
