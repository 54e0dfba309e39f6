"""Intervals as a number system: an expression is evaluated over a whole range at once."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

_MOST_BOXES = 4096
_SMALLEST = 1e-9  # width of a box that is not halved again, relative to that of the range
_ROUNDING = 4.0 * float(np.finfo(float).eps)  # the same, relative to the ends: the least


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


def find_zero(
    function: Callable[[Mapping[str, Interval]], Interval | float],
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
        value = interval(
            function({name: Interval(*ends) for name, ends in zip(bounds, box, strict=True)})
        )
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
