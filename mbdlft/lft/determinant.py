"""Values of an LFT with the sign of its determinant, and whether that vanishes on the way there.

With the determinant of I - M11 Delta, values are solved for by loops. Channels depend on each other in
loops, and loops on other loops: with the strongly connected components of the graph of M11 in their
order, I - M11 Delta is block triangular for every Delta. Its determinant and eigenvalues are those of the
diagonal blocks, and solutions take these blocks only. In a chain of 15 links the largest of them has 115
of 915 channels.
"""

from collections.abc import Iterator
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mbdlft.base.array import Array
from mbdlft.exact.rounding import eigenvalues_of
from mbdlft.lft.lft import LFT, check_plain
from mbdlft.lft.sampling import CHUNK_ENTRIES, Sides
from mbdlft.lft.sparse import SparseLFT
from mbdlft.lft.sparse import values as values_of_sparse

Channels = NDArray[np.int64]
_MERGED = 48  # channels: smaller blocks cost more calls than operations
_ALONE = 64  # channels from which on points are solved for one by one, with one factorization each
_LINES, _FEWEST_LINES = 32, 4  # that are searched for a determinant that vanishes
_CHEAP = 256.0**3  # operations up to which so many lines cost less than all the rest of the check
_SMALL = 0.5  # norm of a power below which no eigenvalue reaches 1, with room for rounding
_SQUARINGS = 8
_REAL = 1e-6  # an eigenvalue with a smaller relative imaginary part may be a double real one


def components(readers: Channels, sources: Channels, count: int) -> list[Channels]:
    """Nodes that read from each other, in any number of steps; each after all that it reads from."""
    # imported here: values are read without scipy, too
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    graph = coo_array((np.ones(len(readers)), (readers, sources)), shape=(count, count))
    number, label = connected_components(graph.tocsr(), connection="strong")
    others = label[readers] != label[sources]
    readers, sources = label[readers[others]], label[sources[others]]
    depth = np.zeros(number, dtype=int)
    while True:
        deeper = depth.copy()
        np.maximum.at(deeper, readers, depth[sources] + 1)
        if np.array_equal(deeper, depth):
            break
        depth = deeper
    order = np.lexsort((label, depth[label]))
    return np.split(order, np.flatnonzero(np.diff(label[order])) + 1)


def diagonal_blocks(matrix: NDArray[Any]) -> list[Channels]:
    """Diagonal blocks of a square matrix in an order that makes it block lower triangular."""
    n = len(matrix)
    if n <= _MERGED:
        return [np.arange(n)] if n else []
    blocks = [np.zeros(0, dtype=int)]
    readers, sources = np.nonzero(matrix)
    for component in components(readers, sources, n):
        if len(blocks[-1]) + len(component) <= _MERGED:  # several small ones together
            blocks[-1] = np.concatenate([blocks[-1], component])
        else:
            blocks.append(component)
    return [block for block in blocks if len(block)]


def values_at(a: LFT, deltas: Array) -> tuple[Array, Array]:
    """Values at points (N, blocks), and signs of det(I - M11 Delta): at 0 values mean nothing."""
    check_plain(a, "the determinant at many points")
    if isinstance(a, SparseLFT):
        return values_of_sparse(a, deltas)
    values, signs = np.repeat(a.M22[None], len(deltas), axis=0), np.ones(len(deltas))
    sides = Sides(a)
    blocks = diagonal_blocks(sides.inner)
    order = np.concatenate([*blocks, np.zeros(0, dtype=int)]).astype(int)
    ends = np.cumsum([0, *map(len, blocks)]).tolist()
    inner, first = sides.inner[np.ix_(order, order)], sides.first[order]
    spread = np.repeat(deltas, [block.size for block in a.blocks], axis=1)[:, order]
    width = first.shape[1]
    for chunk in _few(len(deltas), max(first.size, _ALONE**2)):
        d = spread[chunk]
        signals = np.empty((a.order, len(d) * width))  # Delta z, all points side by side
        for start, stop in pairwise(ends):
            rows = slice(start, stop)
            right = np.broadcast_to(first[rows], (len(d), stop - start, width))
            used = np.flatnonzero(inner[rows, :start].any(axis=0))
            if len(used):
                read = inner[rows, used] @ signals[used]
                right = right + read.reshape(stop - start, len(d), width).transpose(1, 0, 2)
            z, sign = _solved(inner[rows, rows], d[:, rows], right)
            signs[chunk] *= sign
            signals[rows] = (d[:, rows, None] * z).transpose(1, 0, 2).reshape(stop - start, -1)
        changes = (sides.last[:, order] @ signals).reshape(len(sides.last), len(d), width)
        sides.add(values[chunk], changes.transpose(1, 0, 2))
    return values, signs


def _solved(inner: Array, deltas: Array, right: Array) -> tuple[Array, Array]:
    """(I - inner Delta)^-1 right (N, n, k), anything where that is singular, and signs of det (N,)."""
    eye = np.eye(len(inner))
    if len(inner) < _ALONE:
        loops = eye - inner * deltas[:, None, :]
        signs, _ = np.linalg.slogdet(loops)
        loops[signs == 0.0] = eye
        return np.asarray(np.linalg.solve(loops, right), dtype=float), signs
    from scipy.linalg.lapack import dgetrf, dgetrs  # here: values are read without scipy, too

    solved, signs, loop = np.zeros(right.shape), np.zeros(len(deltas)), np.empty(inner.shape)
    for k, delta in enumerate(deltas):
        np.subtract(eye, np.multiply(inner, delta, out=loop), out=loop)
        # LAPACK reads by columns what is stored by rows: it factors the transposed matrix
        factors, pivots, _ = dgetrf(loop.T, overwrite_a=True)
        swaps = np.count_nonzero(pivots != np.arange(len(pivots)))
        signs[k] = (-1.0) ** swaps * np.prod(np.sign(np.diagonal(factors)))
        if signs[k]:
            solved[k] = dgetrs(factors, pivots, right[k], trans=1)[0]
    return solved, signs


def vanishes(a: LFT, deltas: Array) -> NDArray[np.bool_]:
    """Whether det(I - M11 Delta) is seen to vanish on the line from 0 to each of the points (N,).

    It does where an eigenvalue of M11 Delta is real and at least 1, even if the determinant does not
    change its sign. There is none where a power of the matrix is small; otherwise they are computed. Some
    of the lines are searched: 32, or as many as the blocks of a large model allow, at least 4; none of a
    sparse LFT, whose channels are too many.
    """
    if isinstance(a, SparseLFT):
        return np.zeros(len(deltas), dtype=bool)
    blocks = diagonal_blocks(a.M11)
    cost = float(sum(len(block) ** 3 for block in blocks))
    count = min(_LINES, max(_FEWEST_LINES, int(_LINES * _CHEAP / max(cost, 1.0))))
    lines = np.unique(np.linspace(0, len(deltas) - 1, count).astype(int))
    spread = np.repeat(deltas, [block.size for block in a.blocks], axis=1)[lines]
    vanishing = np.zeros(len(deltas), dtype=bool)
    for block in blocks:
        loop = a.M11[np.ix_(block, block)]
        for chunk in _few(len(lines), loop.size):
            vanishing[lines[chunk]] |= _reaches_one(loop * spread[chunk, None, block])
    return vanishing


def _reaches_one(matrices: Array) -> NDArray[np.bool_]:
    """Whether an eigenvalue of each of the matrices (N, n, n) is real and at least 1."""
    open_, powers = np.arange(len(matrices)), matrices
    for _ in range(_SQUARINGS):
        norms = np.max(np.sum(np.abs(powers), axis=2), axis=1)
        large = norms >= _SMALL
        open_, powers = open_[large], powers[large]
        if not len(open_) or not np.all(norms < 1.0 / _REAL):
            break
        powers = powers @ powers
    reaching = np.zeros(len(matrices), dtype=bool)
    if len(open_):
        try:
            eigenvalues = eigenvalues_of(matrices[open_])
        except np.linalg.LinAlgError:  # the iteration has no end: nothing is seen
            return reaching
        real = np.abs(eigenvalues.imag) <= _REAL * np.abs(eigenvalues)
        reaching[open_] = np.any(real & (eigenvalues.real >= 1.0), axis=1)
    return reaching


def _few(count: int, entries: int) -> Iterator[slice]:
    """Slices of `count` points that hold so many entries each."""
    size = max(1, CHUNK_ENTRIES // 2 // max(1, entries))
    return (slice(start, start + size) for start in range(0, count, size))
