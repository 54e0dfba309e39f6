"""Taylor models: a polynomial and a radius that enclose a function on a box, for many boxes at once.

A function u of x in [-1, 1]^q is enclosed by |u(x) - sum_a c_a x^a| <= r for all x. Operations keep
monomials up to an order and add to the radius what they drop and what floating point rounds away,
so the enclosure is guaranteed; a radius that is infinite or NaN says that nothing is known.

`not_negative` decides the sign of a function on a box by branch and bound: proved, refuted at a point, or
open in some boxes. On each box the lower bound is the least Bernstein coefficient, less all radii. A box
whose bound is below the slack is bisected, and its middle is tried as a point where the function is
negative.

Source: Makino, Berz, Taylor models and other validated functional inclusion methods, 2003.
"""

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from mbdlft.base.array import Array
from mbdlft.exact.operators import Operators

_UNIT = 2.0**-53  # rounding of one operation
_TINY = 1e-290  # above everything that underflow loses
_LIBRARY = 8 * _UNIT  # sine and cosine of numpy are right to 4 units in the last place


def up(value: Array) -> Array:
    """An upper bound of sums of fewer than 2^10 rounded operations on numbers that are not negative."""
    return np.nextafter(value * (1 + 2.0**-40) + _TINY, np.inf)


@dataclass(frozen=True, slots=True)
class Products:
    """Where x^a times each x^b that stays within the order goes: monomials b and their a + b."""

    factors: npt.NDArray[np.int_]
    targets: npt.NDArray[np.int_]


class Space:
    """Monomials of q variables up to an order, sorted by degree."""

    def __init__(self, variables: int, order: int) -> None:
        self.variables, self.order = variables, order
        powers = itertools.product(range(order + 1), repeat=variables)
        kept = sorted((a for a in powers if sum(a) <= order), key=lambda a: (sum(a), a))
        self.exponents = np.array(kept, dtype=int).reshape(len(kept), variables)
        self.degrees = self.exponents.sum(axis=1)
        self.starts = np.searchsorted(self.degrees, np.arange(order + 1))
        place = {a: k for k, a in enumerate(kept)}
        self.products: list[Products] = []
        for row, degree in zip(self.exponents, self.degrees, strict=True):
            factors = np.flatnonzero(self.degrees <= order - degree)
            sums = row + self.exponents[factors]
            self.products.append(Products(factors, np.array([place[tuple(s)] for s in sums], dtype=int)))

    def __len__(self) -> int:
        return len(self.exponents)

    @cached_property
    def bernstein(self) -> Array:
        """Coefficients of each monomial in Bernstein form on [-1, 1]^q; none is above 1 in size."""
        n = self.order
        table = np.array([[_bernstein(n, j, k) for k in range(n + 1)] for j in range(n + 1)])
        places = np.array(list(itertools.product(range(n + 1), repeat=self.variables)), dtype=int)
        matrix = np.ones((len(places), len(self)))
        for k in range(self.variables):
            matrix *= table[places[:, k]][:, self.exponents[:, k]]
        return matrix


@cache
def space(variables: int, order: int) -> Space:
    """The one space of a number of variables and an order."""
    return Space(variables, order)


def _bernstein(degree: int, index: int, power: int) -> float:
    """Polar form of x^power at `index` ones, the others being minus ones."""
    total = sum(
        math.comb(index, i) * math.comb(degree - index, power - i) * (-1) ** (power - i)
        for i in range(power + 1)
    )
    return float(total / math.comb(degree, power))


@dataclass(frozen=True, slots=True, eq=False)
class Taylor(Operators):
    """Enclosures of one function on N boxes: coefficients c (M, N) of M monomials, and radii r (N,)."""

    space: Space
    c: Array
    r: Array

    def __add__(self, other: "Taylor | float") -> "Taylor":
        o = self.of(other)
        c = self.c + o.c
        return Taylor(self.space, c, up(self.r + o.r + _UNIT * size(c)))

    def __neg__(self) -> "Taylor":
        return Taylor(self.space, -self.c, self.r)

    def __mul__(self, other: "Taylor | float | Array") -> "Taylor":
        if isinstance(other, Taylor):
            return _product(self, other)
        c = self.c * other
        return Taylor(self.space, c, up(self.r * np.abs(other) + _UNIT * size(c)))

    def __truediv__(self, other: "Taylor | float") -> "Taylor":
        return _quotient(self, self.of(other))

    def of(self, other: "Taylor | float") -> "Taylor":
        return other if isinstance(other, Taylor) else constant(self.space, other, len(self.r))


def constant(monomials: Space, value: float | Array, boxes: int) -> Taylor:
    """The enclosure of a number, or of one number for each box."""
    c = np.zeros((len(monomials), boxes))
    c[0] = value
    return Taylor(monomials, c, np.zeros(boxes))


def variable(monomials: Space, index: int, low: Array, high: Array) -> Taylor:
    """The variable p_index on the boxes [low, high], arrays (N,), as a function of x_index."""
    middle = 0.5 * (low + high)
    half = np.nextafter(np.maximum(high - middle, middle - low), np.inf)
    c = np.zeros((len(monomials), len(low)))
    c[0] = middle
    c[1:][(monomials.exponents[1:, index] == 1) & (monomials.degrees[1:] == 1)] = half
    return Taylor(monomials, c, np.zeros(len(low)))


def widened(a: Taylor, radius: float) -> Taylor:
    """a + [-radius, radius]."""
    return Taylor(a.space, a.c, up(a.r + radius))


def embedded(a: Taylor, larger: Space) -> Taylor:
    """The same enclosure with room for higher powers."""
    c = np.zeros((len(larger), a.c.shape[1]))
    c[: len(a.space)] = a.c
    return Taylor(larger, c, a.r)


def size(c: Array) -> Array:
    """Upper bound (N,) of |sum_a c_a x^a| by the sum of all |c_a|."""
    return up(np.abs(c).sum(axis=0))


def largest(a: Taylor) -> Array:
    """Upper bound (N,) of |u|: control points of the Bernstein form, and the radius."""
    points = np.abs(a.space.bernstein @ a.c).max(axis=0)
    rounding = (len(a.space) + a.space.variables + 2) * _UNIT * size(a.c)
    return up(points + rounding + a.r)


def sqrt(a: Taylor) -> Taylor:
    """Enclosure of the root: y from Newton's iteration, then |sqrt(u) - y| <= |u - y^2| / y."""
    y = constant(a.space, np.sqrt(a.c[0]), len(a.r))
    for _ in range(a.space.order.bit_length() + 1):
        y = _polynomial((y + a / y) * 0.5)
    defect = a - y * y
    positive = (_least(a) >= 0) & (_least(y) > 0)
    radius = up((size(defect.c) + defect.r) / _least(y))
    return Taylor(a.space, y.c, np.where(positive, radius, np.inf))


def sine_and_cosine(a: Taylor) -> tuple[Taylor, Taylor]:
    """Enclosures of sine and cosine: Taylor polynomials about the value at the middle of the box."""
    order, middle = a.space.order, a.c[0]
    varying = Taylor(a.space, np.vstack([0 * middle, a.c[1:]]), a.r)
    sine, cosine = np.sin(middle), np.cos(middle)
    sums = [constant(a.space, sine, len(a.r)), constant(a.space, cosine, len(a.r))]
    power, factorial = varying, 1.0
    derivatives = [sine, cosine, -sine, -cosine]
    for k in range(1, order + 1):
        factorial *= k
        for which in (0, 1):
            sums[which] = sums[which] + power * (derivatives[(k + which) % 4] / factorial)
        power = power * varying
    reach = up(size(varying.c) + varying.r)
    # the derivatives are rounded three times: in the library, by the factorial, by the quotient
    dropped = up(reach ** (order + 1) / math.factorial(order + 1) + 2 * _LIBRARY * np.exp(reach))
    s, c = (Taylor(a.space, f.c, up(f.r + dropped)) for f in sums)
    return s, c


FUNCTIONS: Mapping[str, Callable[[Taylor], Taylor]] = {
    "sqrt": sqrt,
    "sin": lambda a: sine_and_cosine(a)[0],
    "cos": lambda a: sine_and_cosine(a)[1],
}


def _polynomial(a: Taylor) -> Taylor:
    return Taylor(a.space, a.c, np.zeros_like(a.r))


def _least(a: Taylor) -> Array:
    """Lower bound (N,) of u."""
    varying = up(np.abs(a.c[1:]).sum(axis=0) + a.r)
    return np.asarray(np.nextafter(a.c[0] - varying, -np.inf))


def _product(a: Taylor, b: Taylor) -> Taylor:
    rows, others = np.flatnonzero(a.c.any(axis=1)), np.flatnonzero(b.c.any(axis=1))
    if len(rows) > len(others):
        a, b, rows = b, a, others
    c = np.zeros_like(b.c)
    for row in rows:
        where = a.space.products[row]
        c[where.targets] += a.c[row] * b.c[where.factors]
    by_degree = [np.add.reduceat(np.abs(u.c), a.space.starts, axis=0) for u in (a, b)]
    tails = np.cumsum(by_degree[1][::-1], axis=0)[::-1]
    dropped = (by_degree[0][1:] * tails[:0:-1]).sum(axis=0)
    u, v = size(a.c), size(b.c)
    rounding = (len(rows) + 2) * _UNIT * u * v
    return Taylor(a.space, c, up(dropped + rounding + u * b.r + v * a.r + a.r * b.r))


def _quotient(a: Taylor, b: Taylor) -> Taylor:
    """y from the recursion of power series, then |u/v - y| <= |u - y v| / |v|."""
    remainder, y = a.c.copy(), np.zeros_like(a.c)
    for k, where in enumerate(a.space.products):
        y[k] = remainder[k] / b.c[0]
        remainder[where.targets[1:]] -= y[k] * b.c[where.factors[1:]]
    quotient = Taylor(a.space, y, np.zeros_like(a.r))
    defect = a - quotient * b
    least = _least(Taylor(b.space, b.c * np.sign(b.c[0]), b.r))
    radius = up((size(defect.c) + defect.r) / np.where(least > 0, least, np.nan))
    return Taylor(a.space, y, np.where(least > 0, radius, np.inf))


BOXES = 512  # parts that are looked at, unless another number is asked for
_SMALLEST = 2.0**-24  # of the range: the width of a part that is not halved again
_MOST_CONTROL_POINTS = 4096

Function = Callable[[Mapping[str, Any]], Any]  # of values by name, arrays (N,) or Taylor models
Part = tuple[tuple[float, float], ...]  # (low, high) of each variable


class Sign(NamedTuple):
    """A point where a function is negative and its value, or boxes left open; neither: proved."""

    point: Mapping[str, float] | None = None
    value: float = 0.0
    open_parts: tuple[Part, ...] = ()

    @property
    def is_proved(self) -> bool:
        """Whether the function is proved not to be negative by more than the slack."""
        return self.point is None and not self.open_parts


def not_negative(
    function: Function, bounds: Mapping[str, tuple[float, float]], slack: float = 0.0, boxes: int = BOXES
) -> Sign:
    """Whether function >= -slack in the box of `bounds`, (low, high) by name, by at most `boxes`."""
    # a product of three factors is exact where there are few variables
    monomials = space(len(bounds), 4 if len(bounds) <= 2 else 3 if len(bounds) <= 5 else 2)
    low, high = (np.array([[ends[k] for ends in bounds.values()]]) for k in (0, 1))
    width = high - low
    boxes_left = boxes
    ended: list[Part] = []
    while len(low):
        if boxes_left < len(low):
            return Sign(open_parts=(*_parts(low, high), *ended))
        boxes_left -= len(low)
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


def _enclosed(
    function: Function, names: Sequence[str], monomials: Space, low: Array, high: Array
) -> tuple[Array, Array]:
    """Lower bounds (N,) in parts (N, q), and how much each variable has to do with them (N, q)."""
    count = len(low)
    models = {name: variable(monomials, k, low[:, k], high[:, k]) for k, name in enumerate(names)}
    with np.errstate(all="ignore"):  # a quotient by zero has an infinite radius
        model = function(models)
        if not isinstance(model, Taylor):
            model = constant(monomials, model, count)
        least = lowest(model)
    sizes = np.abs(model.c)
    shares = np.stack(
        [sizes[monomials.exponents[:, k] > 0].sum(axis=0) for k in range(len(names))], axis=1
    )
    unknown = ~np.isfinite(least)
    shares[unknown] = (high - low)[unknown]
    return np.where(unknown, -np.inf, least), np.where(np.isfinite(shares), shares, 0.0)


def lowest(a: Taylor) -> Array:
    """Lower bound (N,) of u: the lowest control point of the Bernstein form, less the radius."""
    if (a.space.order + 1) ** a.space.variables > _MOST_CONTROL_POINTS:
        return _least(a)
    points = (a.space.bernstein @ a.c).min(axis=0)
    rounding = (len(a.space) + a.space.variables + 2) * _UNIT * size(a.c)
    return np.asarray(np.nextafter(points - up(rounding + a.r), -np.inf))


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
