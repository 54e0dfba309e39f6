"""Affine deltas moved to the outputs or the inputs of what is inside of other deltas.

n-D reduction leaves the factors of a product in the order in which they came. A delta that enters
affinely, H = N + delta N', can stand on either side of N': the constants K with N' = K B are as many
columns as the values of N' span at all points, and B are rows of N', so

    [z ; y] = [0 B ; K N] [w ; u],   w = delta z.

Which other deltas are opened before, and so stay outside of B, decides about the order: a mass that
stands inside of the lengths needs no copy of them.
"""

from collections.abc import Iterable

import numpy as np
from scipy.linalg import qr

from mbdlft.base.array import Array
from mbdlft.exact.scale import equilibrate
from mbdlft.lft.evaluate import evaluate
from mbdlft.lft.lft import LFT, Block, constant, fix, select, stack_columns, stack_rows, transpose
from mbdlft.order.reduction_in_doubles import reduce_order
from mbdlft.order.work import Work, product, reduction, solutions

_POINTS = 24
_NOISE = 1e-10  # of the size of a row: a change below is rounding
_RANK = 1e-8  # of the largest pivot: a direction below is rounding


def move_affine(
    a: LFT,
    outside: Iterable[str],
    moved: Iterable[str],
    work: Work,
    most: int | None = None,
) -> LFT | None:
    """The same value, with affine deltas on one side of all but the deltas outside.

    Parameters
    ----------
    a : LFT
    outside : names of deltas that stay outside of the moved ones
    moved : names of deltas; those that do not enter affinely stay where they are
    work : Work
        Asked before each delta whether it is over; then None is returned.
    most : int
        Channels: None is returned where what is left on the way has more.

    Raises
    ------
    WellPosednessError
        As `fix`.
    """
    opened: list[Block] = []
    for name in outside:
        opened.append(Block(name, dict(a.blocks)[name]))
        a = open_block(a, name)
    for name in moved:
        if work.is_over:
            return None
        taken = at_one_side(a, name, work)
        if taken is not None:
            size, a = taken
            opened.append(Block(name, size))
            if most is not None and a.order > most:
                return None
    for block in reversed(opened):
        a = close_block(a, block)
    work.add(reduction(a.order))
    return reduce_order(a)


def open_block(a: LFT, name: str) -> LFT:
    """The LFT in the other deltas, (w, u) -> (z, y)."""
    part = a.slices()[name]
    k = np.arange(part.start, part.stop)
    rest = np.setdiff1d(np.arange(a.order), k)
    return LFT(
        a.M11[np.ix_(rest, rest)],
        np.hstack([a.M11[np.ix_(rest, k)], a.M12[rest]]),
        np.vstack([a.M11[np.ix_(k, rest)], a.M21[:, rest]]),
        np.block([[a.M11[np.ix_(k, k)], a.M12[k]], [a.M21[:, k], a.M22]]),
        tuple(block for block in a.blocks if block.name != name),
    )


def close_block(opened: LFT, block: Block) -> LFT:
    """The inverse of `open_block`: the first inputs and outputs become the block."""
    before = sum(other.size for other in opened.blocks if other.name < block.name)
    n, r = opened.order, block.size
    order = np.r_[np.arange(before), n + np.arange(r), np.arange(before, n)].astype(int)
    M11 = np.block([[opened.M11, opened.M12[:, :r]], [opened.M21[:r], opened.M22[:r, :r]]])
    M12 = np.vstack([opened.M12[:, r:], opened.M22[:r, r:]])
    M21 = np.hstack([opened.M21[r:], opened.M22[r:, :r]])
    blocks = tuple(sorted((*opened.blocks, block)))
    return LFT(M11[np.ix_(order, order)], M12[order], M21[:, order], opened.M22[r:, r:], blocks)


def is_polynomial(a: LFT, name: str) -> bool:
    """Whether a delta alone has no poles, as its channels do not feed themselves back."""
    part = a.slices()[name]
    paths = reach = (a.M11[part, part] != 0.0).astype(int)
    for _ in range(len(reach)):
        paths = np.minimum(paths @ reach, 1)
    return not paths.any()


def is_affine(a: LFT, name: str, work: Work) -> bool:
    """Whether the value is affine in a delta, at generic values of the others."""
    return bool(_slope(a, name, work) is not None)


def at_one_side(a: LFT, name: str, work: Work) -> tuple[int, LFT] | None:
    """The size of the block, and the LFT opened in it; None if the delta does not enter affinely.

    The factors of the delta are constants on that side on which fewer channels are enough.
    """
    change = _slope(a, name, work)
    if change is None:
        return None
    slope, rows, columns = change
    points, high, wide = slope.shape
    work.add(product(points * wide, high, high) + product(points * high, wide, wide))
    work.add(2.0 * reduction(a.order))
    outer, inner = _span(slope, rows), _span(slope.swapaxes(1, 2), columns)
    if inner.shape[1] < outer.shape[1]:
        return inner.shape[1], transpose(_at_outputs(transpose(a), name, inner))
    return outer.shape[1], _at_outputs(a, name, outer)


def _slope(a: LFT, name: str, work: Work) -> tuple[Array, Array, Array] | None:
    """Changes of the values with a delta (points, rows, columns) over scales of rows and columns.

    None if it is not the same on both sides of zero.
    """
    random = np.random.default_rng(0)
    points = {b.name: random.uniform(-0.9, 0.9, _POINTS) for b in a.blocks if b.name != name}
    work.add(solutions(3 * _POINTS, a.order, a.shape[1], is_complex=False))
    low, middle, high = (
        evaluate(a, {**points, name: np.full(_POINTS, value)}) for value in (-1.0, 0.0, 1.0)
    )
    size = np.max(np.abs(low) + np.abs(middle) + np.abs(high), axis=0)
    rows, columns = (1.0 / factor for factor in equilibrate(size[None]))
    scale = rows[:, None] * columns
    if np.max(np.abs(high + low - 2.0 * middle) / scale, initial=0.0) > _NOISE:
        return None
    slope = (high - low) / scale
    slope[np.abs(slope) <= _NOISE] = 0.0
    return slope, rows, columns


def _span(values: Array, scale: Array) -> Array:
    """K (rows, d), the identity in d rows, with values = K values[d rows] at all points.

    Values (points, rows, columns) are divided by a scale (rows), K is not.
    """
    all_columns = np.hstack(list(values))
    _, factor, pivots = qr(all_columns.T, mode="economic", pivoting=True)
    sizes = np.abs(np.diagonal(factor))
    d = int(np.sum(sizes > _RANK * np.max(sizes, initial=0.0)))
    rows = np.sort(pivots[:d])
    K = np.linalg.lstsq(all_columns[rows].T, all_columns.T)[0].T
    K[np.abs(K) <= _NOISE] = 0.0
    K[rows] = np.eye(d)
    return np.asarray(scale[:, None] * K / scale[rows])


def _at_outputs(a: LFT, name: str, K: Array) -> LFT:
    d = K.shape[1]
    rows = [int(np.flatnonzero(np.all(unit == K, axis=1))[0]) for unit in np.eye(d)]
    columns = range(a.shape[1])
    here, there = fix(a, {name: 0.0}), fix(a, {name: 1.0})
    slope = reduce_order(select(there, rows, columns) - select(here, rows, columns))
    opened = stack_rows(stack_columns(np.zeros((d, d)), slope), stack_columns(constant(K), here))
    return reduce_order(opened)
