"""Values of an LFT with all deltas on circles of the complex plane, and what a change of it does to them.

With M = [A B ; C D], Y = [C Delta (I - A Delta)^-1, I] and W = [Delta (I - A Delta)^-1 B ; I] a change dM
changes the value to first order by Y dM W. Rows and columns are scaled to the size one, and the
deltas to the unit circle, where monomials are orthogonal.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import LinAlgError

from mbdlft.base.array import Array
from mbdlft.lft.lft import LFT, Block
from mbdlft.order.work import Work, product, solutions

Complex = NDArray[np.complex128]

_MORE_VALUES = 1.25  # as many as there are unknowns
_LEAST_POINTS = 20
_LARGEST, _INSIDE = 3.0, 0.8  # radius of a circle; part of the distance of the nearest pole
_BALANCES = 3  # of rows and columns in turn


class CircleValues(NamedTuple):
    """Values on circles, for rows and columns of size one.

    Attributes
    ----------
    points : (count, deltas), of absolute value one
    radii : of the circle of each delta
    values : (count, rows, columns), without those for delta = 0
    rows, columns : which of the LFT are there, and what they are multiplied with
    """

    points: Complex
    radii: Array
    values: Complex
    rows: tuple[NDArray[np.intp], Array]
    columns: tuple[NDArray[np.intp], Array]


class Fit(NamedTuple):
    """A candidate in scaled channels: root mean square of its difference, Y and W."""

    M: Array
    size: float
    difference: Complex
    Y: Complex
    W: Complex


def channels_at(M11: Array, M12: Array, deltas: NDArray[Any]) -> NDArray[Any]:
    """z = (I - M11 Delta)^-1 M12 (points, channels, inputs) at deltas (points, channels)."""
    loops = np.eye(len(M11)) - M11 * deltas[:, None, :]
    right = np.broadcast_to(M12, (len(deltas), *M12.shape)).astype(deltas.dtype)
    return np.asarray(np.linalg.solve(loops, right))


def pole_distance(loop: Array, largest: float) -> float:
    """Of the nearest pole of one delta from zero, when the others are zero; `largest` at most."""
    try:
        size = np.max(np.abs(np.linalg.eigvals(loop)), initial=0.0)
    except np.linalg.LinAlgError:  # the iteration has no end: no eigenvalue is above the norm
        size = np.linalg.norm(loop)
    return float(1.0 / max(1.0 / largest, size))


def circle_values(a: LFT, unknowns: int, random: np.random.Generator, work: Work) -> CircleValues:
    """Values at random points of the circles, enough for so many real unknowns.

    Raises
    ------
    LinAlgError
        A pole is at one of the points.
    """
    rows = np.flatnonzero(np.any(a.M21, axis=1))
    columns = np.flatnonzero(np.any(a.M12, axis=0))
    each = 2 * max(1, len(rows) * len(columns))
    count = int(_MORE_VALUES * unknowns / each) + _LEAST_POINTS
    loops = [a.M11[part, part] for part in a.slices().values()]
    radii = np.array([_INSIDE * pole_distance(loop, _LARGEST / _INSIDE) for loop in loops])
    points = np.exp(2j * np.pi * random.uniform(size=(count, len(a.blocks))))
    deltas = np.repeat(points * radii, [block.size for block in a.blocks], axis=1)
    z = channels_at(a.M11, a.M12[:, columns], deltas)
    work.add(solutions(count, a.order, len(columns)))
    values = (a.M21[rows] * deltas[:, None, :]) @ z
    if not np.all(np.isfinite(values)):
        raise LinAlgError
    high, wide = _factors(values)
    return CircleValues(points, radii, values * high[:, None] * wide, (rows, high), (columns, wide))


def _factors(values: Complex) -> tuple[Array, Array]:
    """Of rows and columns, that bring the root mean square of each to one."""
    squares = np.mean(np.abs(values) ** 2, axis=0)
    squares[np.sum(squares, axis=1) == 0.0] = 1.0  # rows and columns that cancel
    squares[:, np.sum(squares, axis=0) == 0.0] = 1.0
    high, wide = (np.ones(count) for count in squares.shape)
    for _ in range(_BALANCES):
        high = 1.0 / np.sqrt(np.mean(squares * wide**2, axis=1))
        wide = 1.0 / np.sqrt(np.mean(squares * high[:, None] ** 2, axis=0))
    return high, wide


def scaled(a: LFT, truth: CircleValues) -> Array:
    """M (without D) for the values of `truth`, and deltas on the unit circle."""
    root = np.sqrt(np.repeat(truth.radii, [block.size for block in a.blocks]))
    (rows, high), (columns, wide) = truth.rows, truth.columns
    inner = a.M11 * root * root[:, None]
    right = a.M12[:, columns] * root[:, None] * wide
    left = a.M21[rows] * root * high[:, None]
    return np.block([[inner, right], [left, np.zeros((len(rows), len(columns)))]])


def unscaled(M: Array, kept: tuple[Block, ...], a: LFT, truth: CircleValues) -> LFT:
    """The LFT of an M for the values of `truth`, with the blocks `kept` and the constant part of `a`."""
    root = np.sqrt(np.repeat(truth.radii, [block.size for block in kept]))
    n, (rows, high), (columns, wide) = len(root), truth.rows, truth.columns
    M12, M21 = np.zeros((n, a.shape[1])), np.zeros((a.shape[0], n))
    M12[:, columns] = M[:n, n:] / root[:, None] / wide
    M21[rows] = M[n:, :n] / root / high[:, None]
    return LFT(M[:n, :n] / root / root[:, None], M12, M21, a.M22, kept)


def fit_of(M: Array, kept: tuple[Block, ...], truth: CircleValues, work: Work) -> Fit:
    """An M with the blocks `kept`, its Y and its W.

    Raises
    ------
    LinAlgError
        A pole is at one of the points.
    """
    deltas = np.repeat(truth.points, [block.size for block in kept], axis=1)
    n = deltas.shape[1]
    count, outputs, inputs = truth.values.shape
    work.add(solutions(2 * count, n, (outputs + inputs) // 2) + product(count * outputs, n, inputs))
    W = deltas[:, :, None] * channels_at(M[:n, :n], M[:n, n:], deltas)
    Y = np.swapaxes(channels_at(M[:n, :n].T, M[n:, :n].T, deltas), 1, 2) * deltas[:, None, :]
    difference = M[n:, :n] @ W - truth.values
    size = math.sqrt(np.mean(np.abs(difference) ** 2))
    if not math.isfinite(size):
        raise LinAlgError
    ones = [np.broadcast_to(np.eye(side), (len(Y), side, side)) for side in difference.shape[1:]]
    return Fit(
        M,
        size,
        difference,
        np.concatenate([Y, ones[0]], axis=2),
        np.concatenate([W, ones[1]], axis=1),
    )
