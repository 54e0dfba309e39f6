"""Fewer repetitions of an affine delta: the smallest rank of a matrix with free numbers in it.

The value is affine in one delta, and its channels are left out. What is left has Y and W as in
`mbdlft.order.circles`, and the slope of the value is

    Y E W,    E = B C,

with the columns B and the rows C that were left out. Any E with the same slope will do: E plus a
combination of matrices N with Y N W = 0. They exist because deltas commute: a delta of what is left
may be met before or after the one that is left out. The repetitions are the rank of E, so the smallest
rank is looked for: with the trailing singular vectors U and V of E, the next E has U' E V = 0 to first
order. That is Newton's method for singular values (Friedland, Nocedal, Overton 1987), damped.

C must not see what B feeds. This comes out by itself, or not; the caller compares values.
"""

import itertools
from collections.abc import Iterator, Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import LinAlgError, qr, solve_triangular

from mbdlft.base.array import Array
from mbdlft.lft.lft import LFT, Block
from mbdlft.order.circles import CircleValues, Fit, circle_values, fit_of, scaled, unscaled
from mbdlft.order.rewriting import is_affine
from mbdlft.order.work import Work, product, singular_values

_STARTS, _PER_ENTRY, _ENOUGH = 60, 0.1, 3  # of each rank, all from the same E; more for a large one
_SPREAD = (-0.4, 0.6)  # powers of ten: of a start around E, over its size
_NULL = 1e-10  # of the largest pivot: zero
_ABSENT = 1e-9  # of the largest function: zero
_EXACT = 1e-13  # singular values that are rounding, over the largest
_STEPS, _STALLED, _GAIN = 150, 10, 1.5  # at most; so many without this gain are the last
_DAMPING, _EASED, _RAISED, _RAISES = 0.1, 0.3, 5.0, 6
_LEAST_DAMPING, _RIDGE = 1e-9, 1e-14

Mask = NDArray[np.bool_]


class _Family(NamedTuple):
    """All E (sites of Y, sites of W) of one slope: `start` and the span of `free` (count, ..., ...)."""

    start: Array
    free: Array
    rows: tuple[NDArray[np.intp], Array]
    columns: tuple[NDArray[np.intp], Array]


def lower_ranks(
    a: LFT, bound: Mapping[str, int], least: int, entries: int, seed: int, work: Work
) -> Iterator[LFT]:
    """LFTs with fewer repetitions of an affine delta, as far as they are found; none below `least`.

    A delta that meets its bound is left as it is; those far above it come first. So is one with more than
    so many entries of E next to it: the null space takes a time like their cube, some seconds for 2000.
    An LFT has equal slope where that delta is zero, and equal value if its channels do not feed
    themselves: it is to be compared with `a`.
    """
    random, more = np.random.default_rng(seed), above_bound(a, bound)
    for name in sorted(more, key=lambda name: -more[name]):
        if work.is_over or not is_affine(a, name, work):
            continue
        try:
            fewer = min(more[name], a.order - least)
            yield from _smaller(a, name, fewer, entries, random, work)
        except (LinAlgError, np.linalg.LinAlgError):  # a pole at one of the points
            continue


def above_bound(a: LFT, bound: Mapping[str, int]) -> dict[str, int]:
    """How many repetitions of each delta may be left out, if any; one always stays."""
    more = {name: size - max(1, bound[name]) for name, size in a.blocks}
    return {name: count for name, count in more.items() if count > 0}


def _smaller(
    a: LFT, name: str, fewer: int, most_entries: int, random: np.random.Generator, work: Work
) -> Iterator[LFT]:
    """With fewer channels of one delta, the smallest first; `fewer` at most."""
    sites = _sites(a, name, most_entries)
    if sites is None:
        return
    block = a.slices()[name]
    count = block.stop - block.start
    truth = circle_values(a, int(np.prod([np.sum(side) for side in sites])), random, work)
    M = scaled(a, truth)
    rows, columns = (np.delete(np.arange(side), block) for side in M.shape)
    others = tuple(Block(b.name, 0 if b.name == name else b.size) for b in a.blocks)
    others_alone = fit_of(M[np.ix_(rows, columns)], others, truth, work)
    family = _family(others_alone, M[rows, block] @ M[block][:, columns], sites, work)
    members: list[tuple[int, Array]] = []
    starts = max(_STARTS, int(_PER_ENTRY * family.start.size))
    for rank in range(count - 1, count - 1 - fewer, -1):
        tried = (_of_rank(family, rank, random, work) for _ in range(starts) if not work.is_over)
        lower = list(itertools.islice(((rank, E) for E in tried if E is not None), _ENOUGH))
        if not lower:
            break
        members = [*lower, *members]
    for rank, E in members:
        yield _with_channels(a, name, M, family, (rows, columns), rank, E, truth)


def _with_channels(
    a: LFT,
    name: str,
    M: Array,
    family: _Family,
    others: tuple[NDArray[np.intp], NDArray[np.intp]],
    rank: int,
    E: Array,
    truth: CircleValues,
) -> LFT:
    """The LFT with B C = E as the channels of a delta."""
    block = a.slices()[name]
    left, sizes, right = np.linalg.svd(E)
    roots, channels = np.sqrt(sizes[:rank]), np.arange(block.start, block.start + rank)
    ends, begins = others[0][family.rows[0]], others[1][family.columns[0]]
    M = M.copy()
    M[block], M[:, block] = 0.0, 0.0
    M[np.ix_(ends, channels)] = left[:, :rank] * roots / family.rows[1][:, None]
    M[np.ix_(channels, begins)] = roots[:, None] * right[:rank] / family.columns[1]
    gone = range(block.start + rank, block.stop)
    M = np.delete(np.delete(M, gone, axis=0), gone, axis=1)
    kept = tuple(Block(b.name, rank if b.name == name else b.size) for b in a.blocks)
    return unscaled(M, kept, a, truth)


def _sites(a: LFT, name: str, most_entries: int) -> tuple[Mask, Mask] | None:
    """Rows and columns of M, without those of a delta, where its channels may end and begin."""
    block = a.slices()[name]
    inside = np.zeros(a.order, dtype=bool)
    inside[block] = True
    depends = a.M11 != 0.0
    before, after = _reached(depends, inside), _reached(depends.T, inside)
    ports = int(np.sum(np.any(a.M21, axis=1))), int(np.sum(np.any(a.M12, axis=0)))

    def sites(ends: Mask, begins: Mask) -> tuple[Mask, Mask]:
        """Those of the other channels, and all outputs or inputs."""
        rows, columns = (
            np.concatenate([side[~inside], np.ones(count, dtype=bool)])
            for side, count in zip((ends, begins), ports, strict=True)
        )
        return rows, columns

    def others_through(other: slice) -> int:
        """Channels that depend on those of a delta that stand before, or feed those that stand after."""
        first, last = np.zeros(a.order, dtype=bool), np.zeros(a.order, dtype=bool)
        first[other], last[other] = before[other], after[other]
        if not np.any(first | last):
            return 2 * a.order
        ways = (_reached(depends.T, first) & ~first, _reached(depends, last) & ~last)
        return max(int(np.sum(side)) for side in ways)

    near = sorted((span for other, span in a.slices().items() if other != name), key=others_through)
    ends, begins, chosen = after.copy(), before.copy(), None
    for added in (block, *near):
        ends[added], begins[added] = True, True
        more = sites(ends, begins)
        if np.sum(more[0]) * np.sum(more[1]) > most_entries:
            break
        chosen = more
    return chosen


def _reached(depends: Mask, start: Mask) -> Mask:
    """Channels that those of `start` depend on, in any number of steps, and they themselves."""
    reached = start
    while True:
        more = reached | np.any(depends[reached], axis=0)
        if np.array_equal(more, reached):
            return reached
        reached = more


def _family(left: Fit, E: Array, sites: tuple[Mask, Mask], work: Work) -> _Family:
    """All E of one slope, with entries only at the sites, for functions of size one."""
    rows, row_sizes = _present(np.sqrt(np.mean(np.abs(left.Y) ** 2, axis=(0, 1))), sites[0])
    columns, column_sizes = _present(np.sqrt(np.mean(np.abs(left.W) ** 2, axis=(0, 2))), sites[1])
    Y, W = left.Y[:, :, rows] / row_sizes, left.W[:, columns] / column_sizes[:, None]
    products = np.einsum("poi,pbu->pouib", Y, W).reshape(-1, len(rows) * len(columns))
    count, entries = products.shape
    work.add(product(2 * count, entries, entries) + 2.0 * product(entries, entries, entries))
    null = _null_space(np.concatenate([products.real, products.imag]))
    start = E[np.ix_(rows, columns)] * row_sizes[:, None] * column_sizes
    return _Family(
        start, null.T.reshape(-1, len(rows), len(columns)), (rows, row_sizes), (columns, column_sizes)
    )


def _null_space(matrix: Array) -> Array:
    """Orthonormal vectors (columns, count) of the null space, by pivots: faster than an SVD."""
    triangle, pivots = qr(np.linalg.qr(matrix, mode="r"), mode="r", pivoting=True)
    sizes = np.abs(np.diag(triangle))
    rank = int(np.sum(sizes > _NULL * sizes[0]))
    null = np.zeros((len(pivots), len(pivots) - rank))
    null[pivots[:rank]] = -solve_triangular(triangle[:rank, :rank], triangle[:rank, rank:])
    null[pivots[rank:]] = np.eye(len(pivots) - rank)
    return np.linalg.qr(null)[0]


def _present(sizes: Array, sites: Mask) -> tuple[NDArray[np.intp], Array]:
    present = np.flatnonzero(sites & (sizes > _ABSENT * np.max(sizes, initial=0.0)))
    return present, sizes[present]


def _of_rank(family: _Family, rank: int, random: np.random.Generator, work: Work) -> Array | None:
    """A member of a rank, from a start near the one that is there; None if there is none near."""
    count = len(family.free)
    if not count:
        return None
    size = np.linalg.norm(family.start) * 10.0 ** random.uniform(*_SPREAD) / np.sqrt(count)
    E = family.start + np.tensordot(size * random.standard_normal(count), family.free, 1)
    U, sizes, Vt = np.linalg.svd(E)
    tail, damping = float(np.linalg.norm(sizes[rank:])), _DAMPING
    rests = [tail]
    high, wide = E.shape
    of_try = product(count, count, count) + product(count, high, wide) + singular_values(high, wide)
    of_slopes = count * ((high - rank) * (high + count * (wide - rank)) * wide)
    for _ in range(_STEPS):
        work.add(of_slopes)
        slopes = ((U[:, rank:].T @ family.free) @ Vt[rank:].T).reshape(count, -1)
        normal, slope = slopes @ slopes.T, slopes @ (U[:, rank:].T @ E @ Vt[rank:].T).ravel()
        for _ in range(_RAISES):
            ridge = (damping * tail + _RIDGE) * np.eye(count)
            after = E - np.tensordot(np.linalg.solve(normal + ridge, slope), family.free, 1)
            U_after, sizes_after, Vt_after = np.linalg.svd(after)
            work.add(of_try)
            rest_after = float(np.linalg.norm(sizes_after[rank:]))
            if rest_after < tail:
                break
            damping *= _RAISED
        else:
            break
        E, U, sizes, Vt, tail = after, U_after, sizes_after, Vt_after, rest_after
        damping = max(_EASED * damping, _LEAST_DAMPING)
        rests.append(tail)
        if tail < _EXACT * sizes[0]:
            return E
        if len(rests) > _STALLED and rests[-_STALLED] < _GAIN * tail:
            break
    return None
