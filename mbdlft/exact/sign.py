"""Whether a function keeps from being negative in a box: proved, refuted at a point, or open in parts.

The function is enclosed by Taylor models, many parts of the box at once. A part is done with where the
lowest control point of the Bernstein form, less all radii, is not below the slack; else it is halved. The
middles of the parts are tried as points where the function is negative.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from mbdlft.base.array import Array
from mbdlft.exact import taylor
from mbdlft.exact.taylor import Space, Taylor

BOXES = 512  # parts that are looked at, unless another number is asked for
_SMALLEST = 2.0**-24  # of the range: the width of a part that is not halved again
_MOST_CONTROL_POINTS = 4096
_UNIT = 2.0**-53

Function = Callable[[Mapping[str, Any]], Any]  # of values by name, arrays (N,) or Taylor models
Part = tuple[tuple[float, float], ...]  # (low, high) of each variable


class Sign(NamedTuple):
    """What is known of the sign of a function in a box.

    Attributes
    ----------
    point : mapping of names to values, or None
        Where the function is negative by more than the slack.
    value : float
        Its value there; 0.0 without a point.
    open_parts : tuple of parts
        In which it was not shown to be above the slack; empty where that is proved everywhere.
    """

    point: Mapping[str, float] | None = None
    value: float = 0.0
    open_parts: tuple[Part, ...] = ()

    @property
    def is_proved(self) -> bool:
        """Whether the function is proved not to be negative by more than the slack."""
        return self.point is None and not self.open_parts


def not_negative(
    function: Function,
    bounds: Mapping[str, tuple[float, float]],
    slack: float = 0.0,
    boxes: int = BOXES,
) -> Sign:
    """Whether function >= -slack in the box of `bounds`, (low, high) by name, by at most `boxes`."""
    monomials = taylor.space(len(bounds), _order(len(bounds)))
    low, high = (np.array([[ends[k] for ends in bounds.values()]]) for k in (0, 1))
    width = high - low
    left = boxes
    ended: list[Part] = []
    while len(low):
        if left < len(low):
            return Sign(open_parts=(*_parts(low, high), *ended))
        left -= len(low)
        middles = 0.5 * (low + high)
        values = np.broadcast_to(function(dict(zip(bounds, middles.T, strict=True))), len(low))
        worst = int(np.argmin(np.where(np.isnan(values), np.inf, values)))
        if values[worst] < -slack:
            point = dict(zip(bounds, map(float, middles[worst]), strict=True))
            return Sign(point, float(values[worst]))
        least, shares = _enclosed(function, list(bounds), monomials, low, high)
        open_ = ~(least >= -slack)
        low, high, shares = low[open_], high[open_], shares[open_]
        along = np.argmax(shares * ((high - low) > _SMALLEST * width), axis=1)
        rows = np.arange(len(low))
        small = ((high - low) <= _SMALLEST * width)[rows, along]
        ended += _parts(low[small], high[small])
        low, high = _halved(low[~small], high[~small], along[~small])
    return Sign(open_parts=tuple(ended))


def _order(variables: int) -> int:
    """Order of the models: a product of three factors is exact where there are few variables."""
    return 4 if variables <= 2 else 3 if variables <= 5 else 2


def _enclosed(
    function: Function, names: Sequence[str], monomials: Space, low: Array, high: Array
) -> tuple[Array, Array]:
    """Lower bounds (N,) in parts (N, q), and how much each variable has to do with them (N, q)."""
    count = len(low)
    models = {
        name: taylor.variable(monomials, k, low[:, k], high[:, k]) for k, name in enumerate(names)
    }
    with np.errstate(all="ignore"):  # a quotient by zero has an infinite radius
        found = function(models)
        if not isinstance(found, Taylor):
            found = taylor.constant(monomials, found, count)
        least = lowest(found)
    sizes = np.abs(found.c)
    shares = np.stack(
        [sizes[monomials.exponents[:, k] > 0].sum(axis=0) for k in range(len(names))], axis=1
    )
    unknown = ~np.isfinite(least)
    shares[unknown] = (high - low)[unknown]
    return np.where(unknown, -np.inf, least), np.where(np.isfinite(shares), shares, 0.0)


def lowest(a: Taylor) -> Array:
    """Lower bound (N,) of u: the lowest control point of the Bernstein form, less the radius."""
    if (a.space.order + 1) ** a.space.variables > _MOST_CONTROL_POINTS:
        rest = taylor.up(np.abs(a.c[1:]).sum(axis=0) + a.r)
        return np.asarray(np.nextafter(a.c[0] - rest, -np.inf))
    points = (a.space.bernstein @ a.c).min(axis=0)
    rounding = (len(a.space) + a.space.variables + 2) * _UNIT * taylor.size(a.c)
    return np.asarray(np.nextafter(points - taylor.up(rounding + a.r), -np.inf))


def _halved(low: Array, high: Array, along: Array) -> tuple[Array, Array]:
    rows = np.arange(len(low))
    middle = 0.5 * (low[rows, along] + high[rows, along])
    first_high, second_low = high.copy(), low.copy()
    first_high[rows, along] = second_low[rows, along] = middle
    return np.concatenate([low, second_low]), np.concatenate([first_high, high])


def _parts(low: Array, high: Array) -> list[Part]:
    return [
        tuple((float(a), float(b)) for a, b in zip(*ends, strict=True))
        for ends in zip(low, high, strict=True)
    ]
