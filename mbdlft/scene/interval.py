"""Intervals as a number system: an expression is evaluated over a whole range at once."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, slots=True)
class Interval:
    """All values between low and high."""

    low: float
    high: float

    def __add__(self, other: "Interval | float") -> "Interval":
        o = interval(other)
        return Interval(self.low + o.low, self.high + o.high)

    __radd__ = __add__

    def __neg__(self) -> "Interval":
        return Interval(-self.high, -self.low)

    def __sub__(self, other: "Interval | float") -> "Interval":
        return self + (-interval(other))

    def __rsub__(self, other: float) -> "Interval":
        return -self + other

    def __mul__(self, other: "Interval | float") -> "Interval":
        o = interval(other)
        ends = [a * b for a in (self.low, self.high) for b in (o.low, o.high)]
        return Interval(min(ends), max(ends))

    __rmul__ = __mul__

    def __truediv__(self, other: "Interval | float") -> "Interval":
        o = interval(other)
        if o.low <= 0.0 <= o.high:
            return Interval(-np.inf, np.inf)
        return self * Interval(1.0 / o.high, 1.0 / o.low)

    def __rtruediv__(self, other: float) -> "Interval":
        return interval(other) / self


def interval(value: Interval | float) -> Interval:
    """The interval of one number."""
    return value if isinstance(value, Interval) else Interval(value, value)
