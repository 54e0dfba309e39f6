"""Intervals: an expression is evaluated over a whole range at once, and rounding is counted.

Every result is rounded outward: it holds all values that the operation has for real numbers in its
operands, where it is defined. An infinite end means that no bound is known on that side.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from mbdlft.base.errors import NotRationalError, SceneError
from mbdlft.exact.operators import Operators

_MOST_BOXES = 4096
_SMALLEST = 1e-9  # width of a box that is not halved again, relative to that of the range
_ROUNDING = 4.0 * float(np.finfo(float).eps)  # the same, relative to the ends: the least
_LIBRARY = 2.0**-50  # sines, cosines, tangents are right to 4 units in the last place; so is a turn


@dataclass(frozen=True, slots=True)
class Interval(Operators):
    """All values between low and high."""

    low: float
    high: float

    @staticmethod
    def of(number: "Interval | float") -> "Interval":
        """The interval of one number."""
        return number if isinstance(number, Interval) else Interval(number, number)

    @property
    def largest(self) -> float:
        """The largest size of a value."""
        return max(-self.low, self.high)

    @property
    def smallest(self) -> float:
        """The smallest size of a value."""
        return max(self.low, -self.high, 0.0)

    def __add__(self, other: "Interval | float") -> "Interval":
        o = Interval.of(other)
        return outward(self.low + o.low, self.high + o.high)

    def __neg__(self) -> "Interval":
        return Interval(-self.high, -self.low)

    def __mul__(self, other: "Interval | float") -> "Interval":
        o = Interval.of(other)  # an infinite end is no value: nothing times it is nothing
        ends = [a * b if a and b else 0.0 for a in (self.low, self.high) for b in (o.low, o.high)]
        return outward(min(ends), max(ends))

    def __truediv__(self, other: "Interval | float") -> "Interval":
        o = Interval.of(other)
        if o.low <= 0.0 <= o.high:
            return UNKNOWN
        ends = [0.0 if math.isinf(b) else a / b for a in (self.low, self.high) for b in (o.low, o.high)]
        return outward(min(ends), max(ends))


UNKNOWN = Interval(-math.inf, math.inf)


def decimal(value: float) -> Interval:
    """The interval of a number that was read from a text: it holds the decimals and the double."""
    return Interval.of(value) if value.is_integer() else outward(value, value)


def outward(low: float, high: float) -> Interval:
    """The interval of ends that were rounded to the nearest number."""
    return Interval(math.nextafter(low, -math.inf), math.nextafter(high, math.inf))


def _power(a: Interval, exponent: float) -> Interval:
    if exponent != int(exponent):
        raise NotRationalError(f"a power with the exponent {exponent!r}: expected an integer.")
    if exponent <= 0:
        return 1.0 / _power(a, -exponent) if exponent else Interval.of(1.0)
    even = exponent % 2 == 0
    ends = [Interval(x, x) for x in ((a.smallest, a.largest) if even else (a.low, a.high))]
    low, high = (math.prod([x] * (int(exponent) - 1), start=x) for x in ends)
    return Interval(max(low.low, 0.0) if even else low.low, high.high)


def _sqrt(a: Interval) -> Interval:
    if a.high < 0.0:
        raise SceneError(f"sqrt of negative numbers, {a.low} to {a.high}.")
    root = outward(math.sqrt(max(a.low, 0.0)), math.sqrt(a.high))
    return Interval(max(root.low, 0.0), root.high)


def _of_library(low: float, high: float) -> Interval:
    return outward(low - _LIBRARY * abs(low), high + _LIBRARY * abs(high))


def _wave(function: Callable[[float], float], a: Interval, phase: float) -> Interval:
    """All values of a function that is (-1)^k at (k + phase) pi, and monotone between these."""
    turns = _turns(a, phase)
    if turns is None:
        return Interval(-1.0, 1.0)
    values = [function(a.low), function(a.high), *(-1.0 if k % 2 else 1.0 for k in turns)]
    enclosure = _of_library(min(values), max(values))
    return Interval(max(enclosure.low, -1.0), min(enclosure.high, 1.0))


def _turns(a: Interval, phase: float) -> range | None:
    """Integers k with (k + phase) pi in the interval, or too close to tell; None for whole turns."""
    near = _LIBRARY * (a.largest + 1.0)
    if not (a.high - a.low) + near < 2.0 * math.pi:
        return None
    first, last = (end / math.pi - phase for end in (a.low - near, a.high + near))
    return range(math.ceil(first), math.floor(last) + 1)


def _both(which: Callable[..., float], a: Interval | float, b: Interval | float) -> Interval:
    a, b = Interval.of(a), Interval.of(b)
    return Interval(which(a.low, b.low), which(a.high, b.high))


FUNCTIONS: Mapping[str, Callable[..., Interval]] = {
    "constpow": _power,
    "sqrt": _sqrt,
    "sin": lambda a: _wave(math.sin, a, 0.5),
    "cos": lambda a: _wave(math.cos, a, 0.0),
    "atan": lambda a: _of_library(math.atan(a.low), math.atan(a.high)),
    "fabs": lambda a: Interval(a.smallest, a.largest),
    "fmin": lambda a, b: _both(min, a, b),
    "fmax": lambda a, b: _both(max, a, b),
}


def find_zero(
    function: Callable[[Mapping[str, Interval]], Interval], bounds: Mapping[str, tuple[float, float]]
) -> tuple[dict[str, float], bool] | None:
    """The middle of a part of a box (low, high) where a function of intervals may vanish, or None."""
    boxes = [tuple(bounds.values())]
    sizes = [
        max(_SMALLEST * (high - low), _ROUNDING * max(abs(low), abs(high))) for low, high in boxes[0]
    ]
    examined = 0
    while boxes:
        box = boxes.pop()
        examined += 1
        value = function({name: Interval(*ends) for name, ends in zip(bounds, box, strict=True)})
        if value.low > 0.0 or value.high < 0.0:
            continue
        small = all(high - low < size for (low, high), size in zip(box, sizes, strict=True))
        if small or examined > _MOST_BOXES:
            middle = [0.5 * (low + high) for low, high in box]
            return dict(zip(bounds, middle, strict=True)), small
        widest = int(np.argmax([high - low for low, high in box]))
        low, high = box[widest]
        boxes += [
            (*box[:widest], half, *box[widest + 1 :])
            for half in ((low, 0.5 * (low + high)), (0.5 * (low + high), high))
        ]
    return None
