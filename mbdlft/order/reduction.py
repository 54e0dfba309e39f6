"""n-D reduction of LFTs, exact or in doubles, and coordinates in which doubles keep their digits.

Of exact numbers every rank is decided exactly (`exact/reachable.py`). Coordinates w = T w', T of each
delta, leave the value as it is. What enters and what leaves the channels of a delta,

    P = [M11 M12] [M11 M12]',    Q = [M11 ; M21]' [M11 ; M21]    (rows and columns of the delta),

become equal and diagonal, as Gramians do in a balanced realization (Moore 1981). Channels of beams with
their lengths as parameters lose eight digits otherwise: I - M11 Delta then has a condition of 1e7, and of
2 after this. Where that is not enough, the numbers of channels beside others say little of what they
carry: P and Q become those of the signals at some deltas, the columns of (I - M11 Delta)^-1 M12 and the
rows of M21 (I - Delta M11)^-1, as empirical Gramians are (Lall, Marsden, Glavaski 2002). T is a matrix of
doubles; what it makes of the LFT is computed in balls and rounded once.

A system that is wired of models in doubles has no exact numbers: it is reduced in doubles. There every
vector carries an estimate of its own rounding error, which grows as the subspaces are built; a direction
counts when it stands out of that error. There is no tolerance for the user to choose. The estimate grows
with every step although the vectors are made orthonormal again, so it is capped: a direction too many is
harmless, one too few would be an error.
"""

from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dgeqp3, dorgqr, dtrtrs

from mbdlft.base.array import Array
from mbdlft.base.errors import WellPosednessError
from mbdlft.base.reach import in_reach
from mbdlft.base.running import one_thread
from mbdlft.exact.matrices import (
    Balls,
    ExactMatrix,
    ball_matrix,
    balls_of,
    entries_of,
    middles_of,
    stacked,
)
from mbdlft.exact.numbers import TooFewBitsError, half_precision
from mbdlft.exact.reachable import reduced
from mbdlft.exact.rounding import EPS, balanced_channels, channel_scales, or_one, product
from mbdlft.lft.lft import LFT, Block, check_plain, consecutive
from mbdlft.lft.sampling import evaluate_at, rounding_sizes

_SWEEPS, _ROUNDS = 3, 8  # the first of the signals may lose digits that the next ones win back
_GAIN = 2.0**-6  # of what is lost, in other coordinates: less, and zeros are worth more
_SHOWN = 1e10  # times rounding: doubles show a gain of other coordinates up to that
_NEGLIGIBLE = 1e-8  # of the row and the column of an entry
_WIDE = 2.0**-60  # of its row and column: the radius of a number that is known well enough
_LEAST = 1e-13  # of the trace: a direction that is smaller is taken for that large


@dataclass(frozen=True, slots=True, eq=False)
class ExactLFT:
    """M22 + M21 Delta (I - M11 Delta)^-1 M12 in exact numbers, M = [M11 M12 ; M21 M22]."""

    M: ExactMatrix
    blocks: tuple[Block, ...]

    @property
    def order(self) -> int:
        """n, the sum of all repetitions."""
        return sum(block.size for block in self.blocks)

    @property
    def parts(self) -> list[slice]:
        """Rows of each block."""
        return consecutive(block.size for block in self.blocks)

    def rounded(self) -> LFT:
        """The LFT in doubles; see `ExactMatrix.values`."""
        n, values = self.order, self.M.values()
        return LFT(values[:n, :n], values[:n, n:], values[n:, :n], values[n:, n:], self.blocks)


def transposed(a: ExactLFT) -> ExactLFT:
    """The LFT of the transposed value."""
    return ExactLFT(a.M.T, a.blocks)


def eliminated(a: ExactLFT, count: int, rows: list[int]) -> ExactLFT:
    """The LFT with the first `count` inputs u solved for such that the first outputs vanish.

    With 0 = a u + b v, y = c u + d v the result has those of [u ; y] in `rows` as outputs. A
    ZeroDivisionError if a is singular at nominal.
    """
    n, M = a.order, a.M
    wanted = [*range(n), *(n + k for k in rows)]
    inner, others = slice(n, n + count), [*range(n), *range(n + count, M.shape[1])]
    solution = -M[inner, inner].solve(M[inner, others])  # of u, in w and v
    outside = [*range(n), *range(n + count, M.shape[0])]
    reduced = M[outside][:, others] + M[outside][:, inner] @ solution
    both = stacked([[reduced[:n]], [solution], [reduced[n:]]])
    return ExactLFT(both[wanted], a.blocks)


def _in_touch(a: ExactLFT) -> ExactLFT:
    """The channels that an input reaches and that reach an output along entries that are not zero.

    It is much faster than a reduction, which would leave the others out, too.
    """
    n, some = a.order, a.M.residues != 0
    kept = np.ones(n, dtype=bool)
    for entries in (some, some.T):
        kept &= in_reach(entries[:n, :n], entries[:n, n:].any(axis=1))
    if kept.all():
        return a
    rows, columns = (np.append(kept, np.ones(count - n, dtype=bool)) for count in a.M.shape)
    sizes = [int(np.sum(kept[span])) for span in a.parts]
    blocks = (Block(block.name, size) for block, size in zip(a.blocks, sizes, strict=True))
    return ExactLFT(a.M[rows][:, columns], tuple(blocks))


def reduce_exactly(a: ExactLFT) -> ExactLFT:
    """The LFT of equal value whose order is minimal for deltas that do not commute."""
    a = _in_touch(a)
    M, sizes = reduced(a.M, [block.size for block in a.blocks])
    return ExactLFT(
        M, tuple(Block(block.name, size) for block, size in zip(a.blocks, sizes, strict=True))
    )


def in_good_coordinates(a: ExactLFT, deltas: Array, most: float) -> LFT:
    """The LFT in doubles; in balanced coordinates if rounding changes its values less in these.

    Up to `most` times rounding of an entry, at `deltas` (N, number of blocks), channels keep their zeros.
    """
    rough = a.rounded()
    best, M = in_scales(rough), a.M.balls
    least = _lost(best, deltas)
    is_far = least > _SHOWN
    for T_of in (_by_channels, _by_signals):
        for _ in range(_ROUNDS):
            if least <= most:
                break
            T = T_of(M, rough, deltas)
            gains = not most or least >= _SHOWN or _lost(_turned(rough, T), deltas) <= _GAIN * least
            if T_of is _by_channels and not gains:
                break  # the data cancel, and not the channels
            M = _in_coordinates(M, T, a.parts)
            rough = _rounded(M, rough)
            lost, before = _lost(rough, deltas), least
            if is_far and not _has_value(rough, M, deltas[0]):
                continue  # what far coordinates are rounded to may be well conditioned, and another LFT
            if lost < least:
                best, least = rough, lost
            if T_of is _by_signals and _GAIN * before < least < _SHOWN:
                break  # inverses of balls cost more than this gains
            if T_of is _by_channels and not most and lost >= before:
                break
        if most and least <= _SHOWN:  # 0: there are no zeros to keep
            break
    return best


def _turned(a: LFT, T: Array) -> LFT:
    """An LFT in coordinates T (n, n), in doubles."""
    inverse = np.linalg.inv(T)
    return LFT(inverse @ a.M11 @ T, inverse @ a.M12, a.M21 @ T, a.M22, a.blocks)


def _rounded(M: Balls, a: LFT) -> LFT:
    """[M11 M12 ; M21 .] of balls in doubles; none is wide beside its row or its column."""
    n, values = a.order, np.array([float(x) for x in M.ravel()]).reshape(M.shape)
    radii = np.array([float(x.rad()) for x in M.ravel()]).reshape(M.shape)
    rows, columns = (np.max(np.abs(values), axis=axis, keepdims=True, initial=0.0) for axis in (1, 0))
    if not np.all(radii <= _WIDE * np.minimum(rows, columns)):
        raise TooFewBitsError(f"a number is known up to {np.max(radii):.1e} only.")
    return LFT(values[:n, :n], values[:n, n:], values[n:, :n], a.M22, a.blocks)


def _lost(a: LFT, deltas: Array) -> float:
    """Largest error of an entry at some deltas by rounding of an LFT, relative to its rounding."""
    try:
        sizes, values = rounding_sizes(a, deltas), np.abs(evaluate_at(a, deltas))
    except (np.linalg.LinAlgError, WellPosednessError):
        return float("inf")
    size = np.max(values, axis=0, initial=0.0)
    whole = np.outer(*(np.sqrt(np.max(size, axis=axis, initial=0.0)) for axis in (1, 0)))
    scale = or_one(np.where(size > _NEGLIGIBLE * whole, size, whole))
    return float(np.max(np.max(sizes, axis=0) / scale, initial=1.0))


@half_precision()  # the reduction has lost more bits
def _in_coordinates(M: Balls, T: Array, blocks: Sequence[slice]) -> Balls:
    """[M11 M12 ; M21 M22] in coordinates T (n, n), block diagonal."""
    M = M.copy()
    for rows in (rows for rows in blocks if rows.start < rows.stop):
        block = ball_matrix(balls_of(T[rows, rows]))
        try:
            inverse = block.inv()
        except ZeroDivisionError:
            raise TooFewBitsError(
                "the balls of a change of coordinates contain a singular one."
            ) from None
        M[rows] = entries_of(inverse * ball_matrix(M[rows]))
        M[:, rows] = entries_of(ball_matrix(M[:, rows]) * block)
    return M


def _by_channels(M: Balls, a: LFT, deltas: Array) -> Array:
    """T (n, n), block diagonal, by the numbers of the channels of an LFT in doubles."""
    return _transformation(in_scales(a)) / channel_scales(a.M11, a.M12, a.M21)[:, None]


def _transformation(a: LFT) -> Array:
    """T (n, n), block diagonal, for an LFT whose channels are scaled."""
    M11: Array = a.M11
    M12, M21 = a.M12, a.M21
    total: Array = np.eye(a.order)
    for _ in range(_SWEEPS):
        inputs = or_one(np.linalg.norm(M12, axis=0))
        outputs = or_one(np.linalg.norm(M21, axis=1))[:, None]
        T: Array = np.eye(a.order)
        for rows in a.slices().values():
            into = np.hstack([M11[rows], M12[rows] / inputs])
            out = np.vstack([M11[:, rows], M21[:, rows] / outputs])
            T[rows, rows] = balancing(into @ into.T, out.T @ out)
        M11 = np.asarray(np.linalg.solve(T, M11 @ T), dtype=float)
        M12 = np.asarray(np.linalg.solve(T, M12), dtype=float)
        M21 = np.asarray(M21 @ T, dtype=float)
        total = np.asarray(total @ T, dtype=float)
    return total


def _by_signals(M: Balls, a: LFT, deltas: Array) -> Array:
    """T (n, n), block diagonal, by the signals of an LFT of balls at some deltas."""
    T, signals = np.eye(a.order), [_signals(M, a, row) for row in deltas]
    into, out = np.hstack([x for x, _, _ in signals]), np.vstack([y for _, y, _ in signals])
    into = into / or_one(np.linalg.norm(into, axis=0))
    out = out / or_one(np.linalg.norm(out, axis=1))[:, None]
    for rows in a.slices().values():
        T[rows, rows] = balancing(into[rows] @ into[rows].T, out[:, rows].T @ out[:, rows])
    return T


def _signals(M: Balls, a: LFT, deltas: Array) -> tuple[Array, Array, Array]:
    """(I - M11 Delta)^-1 M12, M21 (I - Delta M11)^-1 and the value of an LFT of balls at (n_blocks,)."""
    n, spread = a.order, np.repeat(deltas, [block.size for block in a.blocks])
    delta, unit = (ball_matrix(balls_of(matrix)) for matrix in (np.diag(spread), np.eye(n)))
    M11, M12, M21 = (ball_matrix(block) for block in (M[:n, :n], M[:n, n:], M[n:, :n]))
    try:
        closed = (unit - M11 * delta).inv()
    except ZeroDivisionError:
        raise TooFewBitsError("the balls of I - M11 Delta contain a singular one.") from None
    into, out = closed * M12, M21 + M21 * delta * closed * M11
    return middles_of(into), middles_of(out), a.M22 + middles_of(M21 * delta * into)


@half_precision()  # as the coordinates
def _has_value(a: LFT, M: Balls, deltas: Array) -> bool:
    """Whether an LFT in doubles has the value of that of balls, up to 1e-4, at deltas (n_blocks,)."""
    try:
        value = _signals(M, a, deltas)[2]
        missed = np.abs(evaluate_at(a, deltas[None])[0] - value)
    except (TooFewBitsError, WellPosednessError):
        return False
    return bool(np.max(missed, initial=0.0) <= 1e-4 * np.max(np.abs(value), initial=0.0))


def balancing(P: Array, Q: Array) -> Array:
    """T with T^-1 P T^-1' = T' Q T, diagonal."""
    size = len(P)
    P = P + _LEAST * (np.trace(P) or 1.0) * np.eye(size)
    Q = Q + _LEAST * (np.trace(Q) or 1.0) * np.eye(size)
    L, R = np.linalg.cholesky(P), np.linalg.cholesky(Q)
    _, values, right = np.linalg.svd(R.T @ L)
    return np.asarray(L @ right.T / np.sqrt(values))


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
            EPS * (float(np.sqrt(np.max(size[span], initial=0.0))) or 1.0) for span in consecutive(sizes)
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
    norms = _norms_of_blocks(core.M11, core.sizes)
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
            gain = np.repeat(norms[k, sources], counts)
            coupled = gain.nonzero()[0]
            errors = core.error_in[k] + gain[coupled] * error[coupled]
            fresh.append(basis.extend(moved[rows, coupled], errors))
    return [basis.vectors for basis in bases]


def _norms_of_blocks(a: Array, sizes: Sequence[int]) -> Array:
    """Frobenius norms of the blocks of a matrix, (number of blocks, number of blocks)."""
    norms, some = np.zeros((len(sizes), len(sizes))), np.flatnonzero(sizes)
    if len(some):
        starts = np.cumsum([0, *sizes])[some]
        norms[np.ix_(some, some)] = np.add.reduceat(np.add.reduceat(a**2, starts), starts, axis=1)
    return np.sqrt(norms)


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
