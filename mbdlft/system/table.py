"""Tables: a function of one argument by its values at breakpoints. numpy only."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from mbdlft.base.array import Array, ArrayLike
from mbdlft.base.errors import StructureError


@dataclass(frozen=True, slots=True)
class Table:
    """Values at breakpoints, joined by lines or cubic polynomials, and lines beyond the ends.

    Attributes
    ----------
    breakpoints : tuple of float (n,)
        Increasing; at least two.
    values : tuple of float (n,)
    below, above : float
        The slopes before the first and behind the last breakpoint.
    slopes : tuple of (left, right) (n - 1,), or empty
        Of cubic polynomials between the breakpoints, their slopes at both ends; lines without.

    Raises
    ------
    StructureError
        Sizes do not agree, a number is not finite, or breakpoints do not increase.
    """

    breakpoints: tuple[float, ...]
    values: tuple[float, ...]
    below: float
    above: float
    slopes: tuple[tuple[float, float], ...] = ()

    def __post_init__(self) -> None:
        n = len(self.breakpoints)
        if n < 2 or len(self.values) != n or len(self.slopes) not in (0, n - 1):
            raise StructureError(
                f"a table has {n} breakpoints, {len(self.values)} values and {len(self.slopes)} pairs of "
                "slopes: expected two breakpoints or more, a value for each, and a pair for each piece "
                "of a cubic table."
            )
        ends = [x for pair in self.slopes for x in pair]
        every = (*self.breakpoints, *self.values, self.below, self.above, *ends)
        if not all(map(math.isfinite, every)):
            raise StructureError("a table has a number that is not finite.")
        if not all(a < b for a, b in zip(self.breakpoints, self.breakpoints[1:], strict=False)):
            raise StructureError("the breakpoints of a table do not increase.")

    def __str__(self) -> str:
        return f"{'cubic' if self.slopes else 'linear'} table of {len(self.values)} points"

    @property
    def is_cubic(self) -> bool:
        """Whether cubic polynomials join the values."""
        return bool(self.slopes)

    def __call__(self, argument: ArrayLike) -> Array:
        """Values at arguments, numbers or arrays."""
        a = np.asarray(argument, dtype=float)
        b, v = np.array(self.breakpoints), np.array(self.values)
        k = np.clip(np.searchsorted(b, a, side="right") - 1, 0, len(b) - 2)
        h, rise = np.diff(b), np.diff(v)
        t = (a - b[k]) / h[k]
        inside = v[k] + t * rise[k]
        if self.slopes:
            left, right = np.array(self.slopes).T
            bend = (1.0 - t) * (h * left - rise)[k] - t * (h * right - rise)[k]
            inside = inside + t * (1.0 - t) * bend
        inside = np.where(a < b[0], v[0] + self.below * (a - b[0]), inside)
        return np.asarray(np.where(a > b[-1], v[-1] + self.above * (a - b[-1]), inside))

    def exactly(self, argument: Fraction) -> Fraction:
        """The value at a number, without rounding."""
        b, v = (tuple(map(Fraction, x)) for x in (self.breakpoints, self.values))
        if argument <= b[0]:
            return v[0] + Fraction(self.below) * (argument - b[0])
        if argument >= b[-1]:
            return v[-1] + Fraction(self.above) * (argument - b[-1])
        k = max(j for j in range(len(b) - 1) if b[j] <= argument)
        h, rise = b[k + 1] - b[k], v[k + 1] - v[k]
        t = (argument - b[k]) / h
        value = v[k] + t * rise
        if self.slopes:
            left, right = (Fraction(x) for x in self.slopes[k])
            value += t * (1 - t) * ((1 - t) * (h * left - rise) - t * (h * right - rise))
        return value


def named_tables(tables: Sequence[Table]) -> dict[str, Table]:
    """Tables by the names that they have in a text, `table1` and so on."""
    return {f"table{k}": table for k, table in enumerate(tables, start=1)}
