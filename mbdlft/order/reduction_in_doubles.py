"""n-D reduction in doubles, and relations in doubles solved for their unknown signals.

The subspaces are those of `mbdlft.order.reduction`. A system that is wired of models in doubles has no
exact numbers, and a search compares many candidates: both reduce here.

Ranks: every vector carries an estimate of its own rounding error, which grows as the subspaces are
built; a direction counts when it stands out of that error. There is no tolerance for the user to choose.
The estimate grows with every step although the vectors are made orthonormal again, so it is capped: a
direction too many is harmless, one too few would be an error.
"""

from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from math import sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dgeqp3, dorgqr, dtrtrs

from mbdlft.base.array import Array
from mbdlft.base.running import one_thread
from mbdlft.exact.rounding import EPS, balanced_channels, channel_scales, product
from mbdlft.lft.lft import LFT, Block, check_plain, consecutive, eliminate

_THRESHOLD = 2.0**8  # a direction counts when its length over its error is larger
_MOST_ERROR = 2.0**-40
_LARGE = 300  # channels; for fewer, changing the number of threads would cost more than it gains
_BALANCE_SWEEPS = 4
_ZERO = 2.0**-46  # an entry of a basis below this is rounding


class Core(NamedTuple):
    """What is reduced of an LFT, scaled; for each block the rounding of what enters and leaves."""

    M11: Array
    M12: Array
    M21: Array
    sizes: tuple[int, ...]
    error_in: tuple[float, ...]
    error_out: tuple[float, ...]


def reduce_order(a: LFT) -> LFT:
    """The LFT of equal value whose order is minimal for deltas that do not commute.

    An LFT that is minimal in this sense already comes back as it is. In a chain of small directions
    rounding grows from step to step; `reduce_exactly` has none.
    """
    check_plain(a, "the reduction")
    core, inputs, outputs = balance(a)
    with one_thread() if a.order > _LARGE else nullcontext():
        small = _transpose(_compress(_transpose(_compress(core))))
    if small.sizes == core.sizes:
        return a
    blocks = [Block(block.name, size) for block, size in zip(a.blocks, small.sizes, strict=True)]
    M12, M21 = small.M12 * inputs, outputs[:, None] * small.M21
    return LFT(small.M11, M12, M21, a.M22, tuple(blocks))


def _transpose(core: Core) -> Core:
    return Core(core.M11.T, core.M21.T, core.M12.T, core.sizes, core.error_out, core.error_in)


def balance(a: LFT) -> tuple[Core, Array, Array]:
    """The core with signals of length one and channels balanced, in powers of two; scales of signals."""
    inputs = _power_of_two(np.sum(a.M12**2, axis=0))
    outputs = _power_of_two(np.sum(a.M21**2, axis=1))
    M12, M21 = a.M12 / inputs, a.M21 / outputs[:, None]
    scale, into, out = balanced_channels(a.M11, M12, M21, _BALANCE_SWEEPS)
    sizes = tuple(block.size for block in a.blocks)
    errors = [
        tuple(
            EPS * (float(np.sqrt(np.max(size[part], initial=0.0))) or 1.0) for part in consecutive(sizes)
        )
        for size in (into, out)
    ]
    core = Core(
        scale[:, None] * a.M11 / scale, scale[:, None] * M12, M21 / scale, sizes, errors[0], errors[1]
    )
    return core, inputs, outputs


def in_scales(a: LFT) -> LFT:
    """The same LFT with what enters and what leaves each channel of one size; signals keep units."""
    scale = channel_scales(a.M11, a.M12, a.M21)
    return LFT(scale[:, None] * a.M11 / scale, scale[:, None] * a.M12, a.M21 / scale, a.M22, a.blocks)


def _power_of_two(squares: Array) -> Array:
    """The powers of two nearest to the roots of sums of squares; 1 for zero."""
    return np.asarray(2.0 ** np.round(0.5 * np.log2(np.where(squares > 0, squares, 1.0))))


def _compress(core: Core) -> Core:
    """Restrict each delta to its reachable subspace, in coordinates that are channels of the old LFT.

    S_k = range(T_k) with T_k the identity in the rows of the chosen channels: w = T w[chosen]. The new
    matrices are rows of the old ones times T, so zeros, units and scales survive, and with them the
    accuracy.
    """
    blocks = consecutive(core.sizes)
    chosen, bases = [], []
    for basis, block in zip(_reachable(core), blocks, strict=True):
        rows, graph = _as_graph(basis)
        chosen.append(block.start + rows)
        bases.append(graph)
    kept = np.concatenate([*chosen, np.zeros(0, dtype=int)]).astype(int)

    def restricted(matrix: Array) -> Array:
        # T is block diagonal: one product for each block
        columns = [
            matrix[:, block] if len(T) == T.shape[1] else product(matrix[:, block], T)
            for block, T in zip(blocks, bases, strict=True)
        ]
        return np.hstack([*columns, np.zeros((len(matrix), 0))])

    return Core(
        restricted(core.M11[kept]),
        core.M12[kept],
        restricted(core.M21),
        tuple(T.shape[1] for T in bases),
        core.error_in,
        core.error_out,
    )


def _as_graph(basis: Array) -> tuple[NDArray[np.int64], Array]:
    """Well-conditioned rows of an orthonormal basis, and the basis that is the identity in them."""
    n, size = basis.shape
    if size in (0, n):
        return np.arange(size), np.eye(n)[:, :size]
    factor, pivots, _, _, _ = dgeqp3(basis.T)
    rows = pivots[:size].astype(int) - 1
    others = pivots[size:].astype(int) - 1
    factors, _ = dtrtrs(factor[:, :size], factor[:, size:])
    graph = np.zeros_like(basis)
    graph[rows] = np.eye(size)
    factors[np.abs(factors) < _ZERO * np.max(np.abs(factors), initial=1.0)] = 0.0
    graph[others] = factors.T
    order = np.argsort(rows)
    return rows[order], graph[:, order]


def _reachable(core: Core) -> list[Array]:
    """Orthonormal bases of the smallest S_k with range(M12_k) in S_k and M11_kj S_j in S_k."""
    blocks = consecutive(core.sizes)
    bases = [_Basis(rows.stop - rows.start) for rows in blocks]
    norms: dict[tuple[int, int], float] = {}

    def norm(into: int, out_of: int) -> float:
        """Frobenius norm of a block of M11; many of them are never asked for."""
        if (into, out_of) not in norms:
            block = core.M11[blocks[into], blocks[out_of]]
            norms[into, out_of] = sqrt((block**2).sum()) if block.any() else 0.0
        return norms[into, out_of]

    # candidates of each delta: columns, and the error of each column
    fresh = [
        basis.extend(core.M12[rows], np.full(core.M12.shape[1], level))
        for basis, rows, level in zip(bases, blocks, core.error_in, strict=True)
    ]
    while sources := [k for k, (_, error) in enumerate(fresh) if len(error)]:
        moved = np.hstack([core.M11[:, blocks[k]] @ fresh[k][0] for k in sources])
        error = np.concatenate([fresh[k][1] for k in sources])
        counts = [len(fresh[k][1]) for k in sources]
        fresh = []
        for k, (basis, rows) in enumerate(zip(bases, blocks, strict=True)):
            if basis.full:
                fresh.append(basis.nothing)
                continue
            gain = np.repeat([norm(k, source) for source in sources], counts)
            coupled = gain.nonzero()[0]
            errors = core.error_in[k] + gain[coupled] * error[coupled]
            fresh.append(basis.extend(moved[rows, coupled], errors))
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

    @property
    def nothing(self) -> tuple[Array, Array]:
        """No vectors, with no errors."""
        return self.vectors[:, :0], self.errors[:0]

    def extend(self, columns: Array, errors: Array) -> tuple[Array, Array]:
        """Add the directions of `columns` that stand out of their errors; return what was added."""
        if self.full or not columns.shape[1]:
            return self.nothing
        known = self.vectors.shape[1]
        if known:
            for _ in range(2):  # twice is enough
                inside = self.vectors.T @ columns
                columns = columns - self.vectors @ inside
                errors = errors + np.abs(inside).T @ self.errors
        errors = np.minimum(errors, _MOST_ERROR)
        # lengths in units of the error; pivoting takes the clearest direction first
        added, lengths = _directions(columns / errors, self.size - known)
        if not len(lengths):
            return self.nothing
        self.vectors = np.hstack([self.vectors, added])
        self.errors = np.concatenate([self.errors, np.maximum(1.0 / np.array(lengths), EPS)])
        return self.vectors[:, known:], self.errors[known:]


def _directions(columns: Array, most: int) -> tuple[Array, Sequence[float]]:
    """Orthonormal vectors of the clear directions of columns, and their lengths, the longest first."""
    factor, _, reflectors, _, _ = dgeqp3(columns)
    clear = np.abs(np.diagonal(factor))
    count = min(int(np.sum(clear > _THRESHOLD)), most)
    if count == 0:
        return columns[:, :0], []
    added, _, _ = dorgqr(factor[:, :count], reflectors[:count])
    return added, clear[:count]


@dataclass(frozen=True, slots=True)
class Closing:
    """How relations are solved in doubles for unknown signals, of which derivatives come first."""

    unknown: int
    derivatives: int
    outputs: int

    def solved(self, opened: LFT) -> LFT:
        """Not reduced."""
        solved = eliminate(opened, self.unknown)
        rows = [*range(self.derivatives), *range(self.unknown, self.unknown + self.outputs)]
        return LFT(solved.M11, solved.M12, solved.M21[rows], solved.M22[rows], solved.blocks)

    def __call__(self, opened: LFT) -> LFT:
        """Reduced."""
        return reduce_order(self.solved(opened))
