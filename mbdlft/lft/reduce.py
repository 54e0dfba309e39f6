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

import numpy as np
from scipy.linalg.lapack import dgeqp3, dorgqr

from mbdlft.lft.lft import LFT, Array, Block, fix

_EPS = float(np.finfo(float).eps)
_KEEP = 2.0**8  # in a reduction, a direction counts above this multiple of its own error
_SURE = 2.0**20  # in a bound, it must be clear beyond doubt
_BOUND_POINTS = 2
_BALANCE_SWEEPS = 4


def reduce_order(a: LFT, threshold: float = _KEEP) -> LFT:
    """The LFT of equal value whose order is minimal for deltas that do not commute."""
    balanced = _balance(a)
    reached = _compress(balanced, threshold)
    observed = _compress(_transposed(_balance(reached)), threshold)
    small = _transposed(observed)
    return LFT(small.M11, small.M12, small.M21, a.M22, small.blocks)


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


def _transposed(a: LFT) -> LFT:
    return LFT(a.M11.T, a.M21.T, a.M12.T, a.M22.T, a.blocks)


def _balance(a: LFT) -> LFT:
    """Scale channels by powers of two so that what enters and what leaves each is of one size."""
    M11, M12, M21 = a.M11, _unit_columns(a.M12), _unit_columns(a.M21.T).T
    scale = np.ones(a.order)
    for _ in range(_BALANCE_SWEEPS):
        into = np.sqrt(np.sum(M11**2, axis=1) + np.sum(M12**2, axis=1))
        out = np.sqrt(np.sum(M11**2, axis=0) + np.sum(M21**2, axis=0))
        used = (into > 0) & (out > 0)
        step = np.ones(a.order)
        step[used] = 2.0 ** np.round(0.5 * np.log2(out[used] / into[used]))
        if np.all(step == 1.0):
            break
        M11, M12, M21 = step[:, None] * M11 / step, step[:, None] * M12, M21 / step
        scale *= step
    return LFT(M11, scale[:, None] * a.M12, a.M21 / scale, a.M22, a.blocks)


def _unit_columns(matrix: Array) -> Array:
    """Columns scaled to unit length; zero columns stay."""
    length = np.sqrt(np.sum(matrix**2, axis=0))
    return np.asarray(matrix / np.where(length > 0, length, 1.0))


def _compress(a: LFT, threshold: float) -> LFT:
    """Restrict each delta to its reachable subspace."""
    bases = _reachable(a, threshold)
    T = np.zeros((a.order, sum(basis.shape[1] for basis in bases)))
    column = 0
    for basis, part in zip(bases, a.slices().values(), strict=True):
        T[part, column : column + basis.shape[1]] = basis
        column += basis.shape[1]
    blocks = tuple(
        Block(block.name, basis.shape[1]) for block, basis in zip(a.blocks, bases, strict=True)
    )
    return LFT(T.T @ a.M11 @ T, T.T @ a.M12, a.M21 @ T, a.M22, blocks)


def _reachable(a: LFT, threshold: float) -> list[Array]:
    """Orthonormal bases of the smallest S_k with range(M12_k) in S_k and M11_kj S_j in S_k."""
    parts = list(a.slices().values())
    start = _unit_columns(a.M12)
    rows = np.sqrt(np.sum(a.M11**2, axis=1) + np.sum(start**2, axis=1))
    noise = [_EPS * (float(np.max(rows[part], initial=0.0)) or 1.0) for part in parts]
    bases = [_Basis(part.stop - part.start) for part in parts]
    # candidates of each delta: columns, and the error of each column
    fresh = [
        basis.extend(start[part], np.full(start.shape[1], level), threshold)
        for basis, part, level in zip(bases, parts, noise, strict=True)
    ]
    while any(vectors.shape[1] for vectors, _ in fresh):
        following = []
        for basis, part, level in zip(bases, parts, noise, strict=True):
            columns, errors = [], []
            for (vectors, error), source in zip(fresh, parts, strict=True):
                if vectors.shape[1] and not basis.full:
                    block = a.M11[part, source]
                    columns.append(block @ vectors)
                    errors.append(level + np.linalg.norm(block) * error)
            if columns:
                following.append(basis.extend(np.hstack(columns), np.hstack(errors), threshold))
            else:
                following.append((np.zeros((basis.size, 0)), np.zeros(0)))
        fresh = following
    return [basis.vectors for basis in bases]


class _Basis:
    """An orthonormal basis that grows, with the error of each vector."""

    def __init__(self, size: int) -> None:
        self.size = size
        self.vectors: Array = np.zeros((size, 0))
        self.errors: Array = np.zeros(0)

    @property
    def full(self) -> bool:
        return self.vectors.shape[1] == self.size

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
