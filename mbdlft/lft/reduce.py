"""n-D reduction of an LFT and the lower bound on its order.

Reduction keeps, for each delta, the smallest subspaces S_k with range(B_k) in S_k and
A_kj S_j in S_k, and then the same for the transposed LFT. It is exact, and minimal if the deltas did
not commute: D'Andrea and Khatri (1997); Beck and Doyle (1999).

The lower bound fixes all deltas but one. What is left is a one-parameter realization, so the number
of repetitions of that delta in any exact LFT of the same matrix is at least its McMillan degree.

Ranks: every vector carries an estimate of its own rounding error, which grows as the subspaces are
built; a direction counts when it stands out of that error. There is no tolerance to choose.
"""

from collections.abc import Mapping
from itertools import accumulate, pairwise
from typing import NamedTuple

import numpy as np
from scipy.linalg.lapack import dgeqp3, dorgqr

from mbdlft.lft.lft import LFT, Array, Block, fix

_EPS = float(np.finfo(float).eps)
_KEEP = 2.0**8  # in a reduction, a direction counts above this multiple of its own error
_SURE = 2.0**20  # in a bound, it must be clear beyond doubt
_BOUND_POINTS = 2
_BALANCE_SWEEPS = 4


class _Core(NamedTuple):
    """The part of an LFT that a reduction works on; sizes of the blocks in order."""

    M11: Array
    M12: Array
    M21: Array
    sizes: tuple[int, ...]


def reduce_order(a: LFT, threshold: float = _KEEP) -> LFT:
    """The LFT of equal value whose order is minimal for deltas that do not commute."""
    sizes = tuple(block.size for block in a.blocks)
    core = _balance(_Core(a.M11, a.M12, a.M21, sizes))
    core = _compress(core, threshold)
    core = _transpose(_compress(_transpose(core), threshold))
    blocks = [Block(block.name, size) for block, size in zip(a.blocks, core.sizes, strict=True)]
    return LFT(core.M11, core.M12, core.M21, a.M22, tuple(blocks))


def lower_bound(a: LFT, seed: int = 0) -> dict[str, int]:
    """Proved minimum of the repetitions of each delta, in any exact LFT of the same matrix.

    When a numerical rank is not clear, the smaller value is given.
    """
    random = np.random.default_rng(seed)
    bound: dict[str, int] = {}
    for block in a.blocks:
        degrees = [0]
        for _ in range(_BOUND_POINTS if block.size else 0):
            others = {
                other.name: float(random.uniform(-0.9, 0.9))
                for other in a.blocks
                if other.name != block.name
            }
            degrees.append(reduce_order(fix(a, others), _SURE).order)
            if degrees[-1] == block.size:
                break
        bound[block.name] = max(degrees)
    return bound


def orders(a: LFT) -> Mapping[str, int]:
    """Repetitions of each delta."""
    return {block.name: block.size for block in a.blocks}


def _transpose(core: _Core) -> _Core:
    return _Core(core.M11.T, core.M21.T, core.M12.T, core.sizes)


def _balance(core: _Core) -> _Core:
    """Scale channels by powers of two so that what enters and what leaves each is of one size."""
    inner = core.M11**2
    first = np.sum(_unit_columns(core.M12) ** 2, axis=1)
    last = np.sum(_unit_columns(core.M21.T) ** 2, axis=1)
    scale = np.ones(len(inner))
    for _ in range(_BALANCE_SWEEPS):
        into, out = inner.sum(axis=1) + first, inner.sum(axis=0) + last
        used = (into > 0) & (out > 0)
        step = np.where(used, out, 1.0) / np.where(used, into, 1.0)
        step = 2.0 ** np.round(0.25 * np.log2(step))
        if (step == 1.0).all():
            break
        scale *= step
        step = step * step
        inner, first, last = step[:, None] * inner / step, step * first, last / step
    return _Core(
        scale[:, None] * core.M11 / scale, scale[:, None] * core.M12, core.M21 / scale, core.sizes
    )


def _unit_columns(matrix: Array) -> Array:
    """Columns scaled to unit length; zero columns stay."""
    length = np.sqrt(np.sum(matrix**2, axis=0))
    return np.asarray(matrix / np.where(length > 0, length, 1.0))


def _compress(core: _Core, threshold: float) -> _Core:
    """Restrict each delta to its reachable subspace."""
    bases = _reachable(core, threshold)
    sizes = tuple(basis.shape[1] for basis in bases)
    T = np.zeros((len(core.M11), sum(sizes)))
    for basis, rows, columns in zip(bases, _parts(core.sizes), _parts(sizes), strict=True):
        T[rows, columns] = basis
    return _Core(T.T @ core.M11 @ T, T.T @ core.M12, core.M21 @ T, sizes)


def _parts(sizes: tuple[int, ...]) -> list[slice]:
    """Rows of each block."""
    ends = [0, *accumulate(sizes)]
    return [slice(a, b) for a, b in pairwise(ends)]


def _reachable(core: _Core, threshold: float) -> list[Array]:
    """Orthonormal bases of the smallest S_k with range(M12_k) in S_k and M11_kj S_j in S_k."""
    parts = _parts(core.sizes)
    start = _unit_columns(core.M12)
    rows = np.sqrt(np.sum(core.M11**2, axis=1) + np.sum(start**2, axis=1))
    noise = [_EPS * (float(np.max(rows[part], initial=0.0)) or 1.0) for part in parts]
    bases = [_Basis(part.stop - part.start) for part in parts]
    # candidates of each delta: columns, and the error of each column
    fresh = [
        basis.extend(start[part], np.full(start.shape[1], level), threshold)
        for basis, part, level in zip(bases, parts, noise, strict=True)
    ]
    while any(len(error) for _, error in fresh):
        sources = [
            (source, vectors, error)
            for (vectors, error), source in zip(fresh, parts, strict=True)
            if len(error)
        ]
        fresh = []
        for basis, part, level in zip(bases, parts, noise, strict=True):
            blocks = [core.M11[part, source] for source, _, _ in sources] if not basis.full else []
            coupled = [k for k, block in enumerate(blocks) if block.any()]
            if not coupled:
                fresh.append((basis.vectors[:, :0], basis.errors[:0]))
                continue
            columns = [blocks[k] @ sources[k][1] for k in coupled]
            errors = [
                level + float(np.sqrt((blocks[k] ** 2).sum())) * sources[k][2] for k in coupled
            ]
            fresh.append(basis.extend(np.hstack(columns), np.hstack(errors), threshold))
    return [basis.vectors for basis in bases]


class _Basis:
    """An orthonormal basis that grows, with the error of each vector."""

    def __init__(self, size: int) -> None:
        self.size = size
        self.vectors: Array = np.zeros((size, 0))
        self.errors: Array = np.zeros(0)

    @property
    def full(self) -> bool:
        return bool(self.vectors.shape[1] == self.size)

    def extend(self, columns: Array, errors: Array, threshold: float) -> tuple[Array, Array]:
        """Add the directions of `columns` that stand out of their errors; return what was added."""
        if self.full or not columns.shape[1]:
            return self.vectors[:, :0], self.errors[:0]
        known = self.vectors.shape[1]
        if known:
            for _ in range(2):  # twice is enough
                inside = self.vectors.T @ columns
                columns = columns - self.vectors @ inside
                errors = errors + np.abs(inside).T @ self.errors
        # lengths in units of the error; pivoting takes the clearest direction first
        factor, _, reflectors, _, _ = dgeqp3(columns / errors)
        clear = np.abs(np.diagonal(factor))
        count = min(int(np.sum(clear > threshold)), self.size - known)
        if count == 0:
            return self.vectors[:, :0], self.errors[:0]
        added, _, _ = dorgqr(factor[:, :count], reflectors[:count])
        self.vectors = np.hstack([self.vectors, added])
        self.errors = np.append(self.errors, np.maximum(1.0 / clear[:count], _EPS))
        return self.vectors[:, known:], self.errors[known:]
