"""Values of an LFT at some hundred points, with what its determinant does on the way there.

Channels depend on each other in loops, and loops on other loops: with the strongly connected components
of the graph of M11 in their order, I - M11 Delta is block triangular for every Delta. Its determinant
and eigenvalues are those of the diagonal blocks, and solutions take these blocks only. In a chain of 15
links the largest of them has 115 of 915 channels.
"""

from collections.abc import Iterator
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dgetrf, dgetrs
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from mbdlft.base.array import Array
from mbdlft.lft.evaluation import MUCH
from mbdlft.lft.lft import LFT, check_plain

Channels = NDArray[np.int64]
_ENTRIES = 2**21  # of matrices or signals of several points that are held at once
_MERGED = 48  # channels: smaller blocks cost more calls than operations
_ALONE = 64  # channels from which on points are solved for one by one, with one factorization each
_LINES, _FEWEST_LINES = 32, 4
_CHEAP = 256.0**3  # operations up to which so many lines cost less than all the rest of the check
_SMALL = (
    0.5  # a power of a matrix with a smaller norm: no eigenvalue reaches 1, with room for rounding
)
_SQUARINGS = 8
_REAL = 1e-6  # an eigenvalue with a smaller relative imaginary part may be a double real one


def diagonal_blocks(matrix: Array) -> list[Channels]:
    """Diagonal blocks of a square matrix in an order that makes it block lower triangular."""
    n = len(matrix)
    if n <= _MERGED:
        return [np.arange(n)] if n else []
    count, label = connected_components(csr_array(matrix != 0.0), connection="strong")
    linked = np.zeros((count, count), dtype=bool)
    readers, sources = np.nonzero(matrix)
    linked[label[readers], label[sources]] = True
    np.fill_diagonal(linked, val=False)
    readers, sources = np.nonzero(linked)
    depth = np.zeros(count, dtype=int)
    while True:  # a component comes after all that it reads from
        deeper = depth.copy()
        np.maximum.at(deeper, readers, depth[sources] + 1)
        if np.array_equal(deeper, depth):
            break
        depth = deeper
    order = np.lexsort((label, depth[label]))
    ends = [*(np.flatnonzero(np.diff(label[order])) + 1).tolist(), n]
    cuts = [0]
    for end, after in pairwise(ends):  # whole components, several small ones together
        if after - cuts[-1] > _MERGED:
            cuts.append(end)
    return [order[a:b] for a, b in pairwise([*cuts, n])]


def values_at(a: LFT, deltas: Array) -> tuple[Array, Array]:
    """Values and signs of the determinant at many points.

    Parameters
    ----------
    a : LFT
    deltas : array (N, number of blocks) [1]

    Returns
    -------
    array (N, n_out, n_in)
        Of no meaning where the determinant is zero.
    array (N,)
        1, 0 or -1: signs of det(I - M11 Delta).
    """
    check_plain(a, "the determinant at many points")
    values, signs = np.repeat(a.M22[None], len(deltas), axis=0), np.ones(len(deltas))
    # only what depends on delta, from the right, or from the left, transposed, as in `evaluate_at`
    rows, columns = np.flatnonzero(a.M21.any(axis=1)), np.flatnonzero(a.M12.any(axis=0))
    wide = MUCH * len(rows) < len(columns)
    inner, first = (a.M11.T, a.M21[rows].T) if wide else (a.M11, a.M12[:, columns])
    last = a.M12[:, columns].T if wide else a.M21[rows]
    blocks = diagonal_blocks(inner)
    order = np.concatenate([*blocks, np.zeros(0, dtype=int)]).astype(int)
    parts = [slice(b - len(block), b) for block, b in zip(blocks, _ends(blocks), strict=True)]
    inner, first, last = inner[np.ix_(order, order)], first[order], last[:, order]
    spread = np.repeat(deltas, [block.size for block in a.blocks], axis=1)[:, order]
    for chunk in _chunks(len(deltas), max(first.size, _ALONE**2)):
        d, width = spread[chunk], first.shape[1]
        signals = np.empty((a.order, len(d) * width))  # Delta z, all points side by side
        for part in parts:
            size = part.stop - part.start
            right = np.broadcast_to(first[part], (len(d), size, width))
            used = np.flatnonzero(inner[part, : part.start].any(axis=0))
            if len(used):
                read = inner[part, used] @ signals[used]
                right = right + read.reshape(size, len(d), width).transpose(1, 0, 2)
            found, sign = _solved(inner[part, part], d[:, part], right)
            signs[chunk] *= sign
            closed = d[:, part, None] * found
            signals[part] = closed.transpose(1, 0, 2).reshape(size, -1)
        change = (last @ signals).reshape(len(last), len(d), width)
        change = change.transpose(1, 2, 0) if wide else change.transpose(1, 0, 2)
        values[chunk][:, rows[:, None], columns] += change
    return values, signs


def _ends(blocks: list[Channels]) -> list[int]:
    return [int(end) for end in np.cumsum([len(block) for block in blocks])]


def _solved(inner: Array, deltas: Array, right: Array) -> tuple[Array, Array]:
    """(I - inner Delta)^-1 right (N, n, k), anything where that is singular, and signs of det (N,)."""
    eye = np.eye(len(inner))
    if len(inner) < _ALONE:
        loops = eye - inner * deltas[:, None, :]
        signs, _ = np.linalg.slogdet(loops)
        loops[signs == 0.0] = eye
        return np.asarray(np.linalg.solve(loops, right), dtype=float), signs
    found, signs, loop = np.zeros(right.shape), np.zeros(len(deltas)), np.empty(inner.shape)
    for k, delta in enumerate(deltas):
        np.subtract(eye, np.multiply(inner, delta, out=loop), out=loop)
        # LAPACK reads by columns what is stored by rows: it factors the transposed matrix
        factors, pivots, _ = dgetrf(loop.T, overwrite_a=True)
        swaps = np.count_nonzero(pivots != np.arange(len(pivots)))
        signs[k] = (-1.0) ** swaps * np.prod(np.sign(np.diagonal(factors)))
        if signs[k]:
            found[k] = dgetrs(factors, pivots, right[k], trans=1)[0]
    return found, signs


def vanishes(a: LFT, deltas: Array) -> NDArray[np.bool_]:
    """Whether det(I - M11 Delta) is seen to vanish on the line from 0 to each of the points (N,).

    It does where an eigenvalue of M11 Delta is real and at least 1, even if the determinant does not
    change its sign. There is none where a power of the matrix is small; otherwise they are computed. Some
    of the lines are searched: 32, or as many as the blocks of a large model allow, at least 4.
    """
    blocks = diagonal_blocks(a.M11)
    cost = float(sum(len(block) ** 3 for block in blocks))
    count = min(_LINES, max(_FEWEST_LINES, int(_LINES * _CHEAP / max(cost, 1.0))))
    lines = np.unique(np.linspace(0, len(deltas) - 1, count).astype(int))
    spread = np.repeat(deltas, [block.size for block in a.blocks], axis=1)[lines]
    found = np.zeros(len(deltas), dtype=bool)
    for block in blocks:
        own = a.M11[np.ix_(block, block)]
        for chunk in _chunks(len(lines), own.size):
            found[lines[chunk]] |= _reaches_one(own * spread[chunk, None, block])
    return found


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
    found = np.zeros(len(matrices), dtype=bool)
    if len(open_):
        eigenvalues = _eigenvalues(matrices[open_])
        real = np.abs(eigenvalues.imag) <= _REAL * np.abs(eigenvalues)
        found[open_] = np.any(real & (eigenvalues.real >= 1.0), axis=1)
    return found


def _eigenvalues(matrices: Array) -> NDArray[Any]:
    """Eigenvalues (N, n); none is a number where the iteration of LAPACK has no end."""
    try:
        return np.asarray(np.linalg.eigvals(matrices))
    except np.linalg.LinAlgError:
        if len(matrices) == 1:
            return np.full(matrices.shape[:2], np.nan)
        return np.concatenate([_eigenvalues(matrix[None]) for matrix in matrices])


def _chunks(count: int, entries: int) -> Iterator[slice]:
    """Slices of `count` points; those of a slice hold so many entries each at once."""
    size = max(1, _ENTRIES // max(1, entries))
    for start in range(0, count, size):
        yield slice(start, start + size)
