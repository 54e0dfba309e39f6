"""Values of an LFT on the torus, its deltas on circles of the complex plane.

On the torus monomials are orthogonal, so functions of the deltas are told apart by their values. With
M = [A B ; C D], Y = [C Delta (I - A Delta)^-1, I] and W = [Delta (I - A Delta)^-1 B ; I] a change dM
changes the value to first order by Y dM W. Rows and columns are scaled to the size one, and deltas to the
unit circle.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import LinAlgError

from mbdlft.base.array import Array
from mbdlft.exact.rounding import eigenvalues_of
from mbdlft.lft.lft import LFT, Block
from mbdlft.order.work import Work, product, solutions

Complex = NDArray[np.complex128]

_MORE_VALUES = 1.25  # as many as there are unknowns
_LEAST_POINTS = 20
_LARGEST, _INSIDE = 3.0, 0.8  # radius of a circle; part of the distance of the nearest pole
_BALANCES = 3  # of rows and columns in turn


class CircleValues(NamedTuple):
    """Values (count, rows, columns), scaled, less those at 0, at points (count, deltas) of circles."""

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


_NUMBERS = 2**24  # of the loops that are solved at once: 270 MB


def channels_at(M11: Array, M12: Array, deltas: NDArray[Any]) -> NDArray[Any]:
    """z = (I - M11 Delta)^-1 M12 (points, channels, inputs) at deltas (points, channels)."""
    step = max(1, _NUMBERS // max(1, M11.size))
    chunks = [deltas[k : k + step] for k in range(0, max(1, len(deltas)), step)]
    loops = ((np.eye(len(M11)) - M11 * d[:, None, :], len(d)) for d in chunks)
    right = M12.astype(deltas.dtype)
    solved = [np.linalg.solve(loop, np.broadcast_to(right, (n, *M12.shape))) for loop, n in loops]
    return np.concatenate(solved)


def pole_distance(loop: Array, largest: float) -> float:
    """Of the nearest pole of one delta from zero, when the others are zero; `largest` at most."""
    try:
        size = np.max(np.abs(eigenvalues_of(loop)), initial=0.0)
    except np.linalg.LinAlgError:  # the iteration has no end: no eigenvalue is above the norm
        size = np.linalg.norm(loop)
    return float(1.0 / max(1.0 / largest, size))


def circle_values(
    a: LFT, source: LFT, unknowns: int, random: np.random.Generator, work: Work
) -> CircleValues:
    """Values at random points of circles, enough for so many real unknowns; a LinAlgError at a pole.

    They are computed from a `source` of the same value, with other deltas at 0; circles, rows and columns
    are those of `a`.
    """
    rows = np.flatnonzero(np.any(a.M21, axis=1))
    columns = np.flatnonzero(np.any(a.M12, axis=0))
    each = 2 * max(1, len(rows) * len(columns))
    count = int(_MORE_VALUES * unknowns / each) + _LEAST_POINTS
    loops = [a.M11[span, span] for span in a.slices().values()]
    radii = np.array([_INSIDE * pole_distance(loop, _LARGEST / _INSIDE) for loop in loops])
    points = np.exp(2j * np.pi * random.uniform(size=(count, len(a.blocks))))
    on_circles = {block.name: values for block, values in zip(a.blocks, (points * radii).T, strict=True)}
    at = np.array([on_circles.get(name, np.zeros(count)) for name, _ in source.blocks]).T
    deltas = np.repeat(at, [block.size for block in source.blocks], axis=1)
    z = channels_at(source.M11, source.M12[:, columns], deltas)
    work.add(solutions(count, source.order, len(columns)))
    values = (source.M21[rows] * deltas[:, None, :]) @ z
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
    first = a.M12[:, columns] * root[:, None] * wide
    last = a.M21[rows] * root * high[:, None]
    return np.block([[inner, first], [last, np.zeros((len(rows), len(columns)))]])


def unscaled(M: Array, kept: tuple[Block, ...], a: LFT, truth: CircleValues) -> LFT:
    """The LFT of an M for the values of `truth`, with the blocks `kept` and the constant part of `a`."""
    root = np.sqrt(np.repeat(truth.radii, [block.size for block in kept]))
    n, (rows, high), (columns, wide) = len(root), truth.rows, truth.columns
    M12, M21 = np.zeros((n, a.shape[1])), np.zeros((a.shape[0], n))
    M12[:, columns] = M[:n, n:] / root[:, None] / wide
    M21[rows] = M[n:, :n] / root / high[:, None]
    return LFT(M[:n, :n] / root / root[:, None], M12, M21, a.M22, kept)


def fit_of(M: Array, kept: tuple[Block, ...], truth: CircleValues, work: Work) -> Fit:
    """An M with the blocks `kept`, its Y and its W; a LinAlgError if a pole is at one of the points."""
    deltas = np.repeat(truth.points, [block.size for block in kept], axis=1)
    n = deltas.shape[1]
    count, outputs, inputs = truth.values.shape
    work.add(solutions(count, n, n) + product(4 * count * (outputs + inputs), n, n))
    through = deltas[:, :, None] * np.linalg.inv(np.eye(n) - M[:n, :n] * deltas[:, None, :])
    W, Y = through @ M[:n, n:], M[n:, :n] @ through
    difference = M[n:, :n] @ W - truth.values
    size = math.sqrt(np.mean(np.abs(difference) ** 2))
    if not math.isfinite(size):
        raise LinAlgError
    ones = [np.broadcast_to(np.eye(side), (len(Y), side, side)) for side in difference.shape[1:]]
    return Fit(
        M, size, difference, np.concatenate([Y, ones[0]], axis=2), np.concatenate([W, ones[1]], axis=1)
    )
