"""Intervals: an expression is evaluated over a whole range at once, and rounding is counted.

Every result is rounded outward: it holds all values that the operation has for real numbers in its
operands, where it is defined. An infinite end means that no bound is known on that side.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from mbdlft.base.errors import NotRationalError, SceneError

_MOST_BOXES = 4096
_SMALLEST = 1e-9  # width of a box that is not halved again, relative to that of the range
_ROUNDING = 4.0 * float(np.finfo(float).eps)  # the same, relative to the ends: the least
_LIBRARY = 2.0**-50  # sines, cosines, tangents are right to 4 units in the last place; so is a turn


@dataclass(frozen=True, slots=True)
class Interval:
    """All values between low and high."""

    low: float
    high: float

    @property
    def largest(self) -> float:
        """The largest size of a value."""
        return max(-self.low, self.high)

    @property
    def smallest(self) -> float:
        """The smallest size of a value."""
        return max(self.low, -self.high, 0.0)

    def __add__(self, other: "Interval | float") -> "Interval":
        o = interval(other)
        return outward(self.low + o.low, self.high + o.high)

    __radd__ = __add__

    def __neg__(self) -> "Interval":
        return Interval(-self.high, -self.low)

    def __sub__(self, other: "Interval | float") -> "Interval":
        return self + (-interval(other))

    def __rsub__(self, other: float) -> "Interval":
        return -self + other

    def __mul__(self, other: "Interval | float") -> "Interval":
        o = interval(other)  # an infinite end is no value: nothing times it is nothing
        ends = [a * b if a and b else 0.0 for a in (self.low, self.high) for b in (o.low, o.high)]
        return outward(min(ends), max(ends))

    __rmul__ = __mul__

    def __truediv__(self, other: "Interval | float") -> "Interval":
        o = interval(other)
        if o.low <= 0.0 <= o.high:
            return UNKNOWN
        ends = [
            0.0 if math.isinf(b) else a / b for a in (self.low, self.high) for b in (o.low, o.high)
        ]
        return outward(min(ends), max(ends))

    def __rtruediv__(self, other: float) -> "Interval":
        return interval(other) / self


UNKNOWN = Interval(-math.inf, math.inf)


def interval(value: Interval | float) -> Interval:
    """The interval of one number."""
    return value if isinstance(value, Interval) else Interval(value, value)


def decimal(value: float) -> Interval:
    """The interval of a number that was read from a text: it holds the decimals and the double."""
    return interval(value) if value.is_integer() else outward(value, value)


def outward(low: float, high: float) -> Interval:
    """The interval of ends that were rounded to the nearest number."""
    return Interval(math.nextafter(low, -math.inf), math.nextafter(high, math.inf))


def _power(a: Interval, exponent: float) -> Interval:
    if exponent != int(exponent):
        raise NotRationalError(f"a power with the exponent {exponent!r}: expected an integer.")
    if exponent <= 0:
        return 1.0 / _power(a, -exponent) if exponent else interval(1.0)
    even = exponent % 2 == 0
    ends = [Interval(x, x) for x in ((a.smallest, a.largest) if even else (a.low, a.high))]
    low, high = (math.prod([x] * (int(exponent) - 1), start=x) for x in ends)
    return Interval(max(low.low, 0.0) if even else low.low, high.high)


def _sqrt(a: Interval) -> Interval:
    if a.high < 0.0:
        raise SceneError(f"sqrt of negative numbers, {a.low} to {a.high}.")
    found = outward(math.sqrt(max(a.low, 0.0)), math.sqrt(a.high))
    return Interval(max(found.low, 0.0), found.high)


def _sin(a: Interval) -> Interval:
    return _wave(math.sin, a, 0.5)


def _cos(a: Interval) -> Interval:
    return _wave(math.cos, a, 0.0)


def _tan(a: Interval) -> Interval:
    poles = _turns(a, 0.5)
    return UNKNOWN if poles is None or len(poles) else _increasing(math.tan, a)


def _atan(a: Interval) -> Interval:
    return _increasing(math.atan, a)


FUNCTIONS: Mapping[str, Callable[..., Interval]] = {
    "constpow": _power,
    "sq": lambda a: _power(a, 2.0),
    "sqrt": _sqrt,
    "sin": _sin,
    "cos": _cos,
    "tan": _tan,
    "atan": _atan,
}


def _of_library(low: float, high: float) -> Interval:
    return outward(low - _LIBRARY * abs(low), high + _LIBRARY * abs(high))


def _increasing(function: Callable[[float], float], a: Interval) -> Interval:
    return _of_library(function(a.low), function(a.high))


def _wave(function: Callable[[float], float], a: Interval, phase: float) -> Interval:
    """All values of a function that is (-1)^k at (k + phase) pi, and monotone between these."""
    turns = _turns(a, phase)
    if turns is None:
        return Interval(-1.0, 1.0)
    values = [function(a.low), function(a.high), *(-1.0 if k % 2 else 1.0 for k in turns)]
    found = _of_library(min(values), max(values))
    return Interval(max(found.low, -1.0), min(found.high, 1.0))


def _turns(a: Interval, phase: float) -> range | None:
    """Integers k with (k + phase) pi in the interval, or too close to tell; None for whole turns."""
    near = _LIBRARY * (a.largest + 1.0)
    if not (a.high - a.low) + near < 2.0 * math.pi:
        return None
    first, last = (end / math.pi - phase for end in (a.low - near, a.high + near))
    return range(math.ceil(first), math.floor(last) + 1)


def find_zero(
    function: Callable[[Mapping[str, Interval]], Interval],
    bounds: Mapping[str, tuple[float, float]],
) -> tuple[dict[str, float], bool] | None:
    """Where a function may vanish in a box; None if it is shown not to.

    Parameters
    ----------
    function : from intervals by name to the interval of its values
    bounds : (low, high) by name

    Returns
    -------
    middle of a part of the box in which a zero could not be excluded, by name
    whether that part is as small as rounding allows; if not, there were too many parts to tell
    """
    boxes = [tuple(bounds.values())]
    sizes = [
        max(_SMALLEST * (high - low), _ROUNDING * max(abs(low), abs(high)))
        for low, high in boxes[0]
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
