"""LFTs of exact numbers: their n-D reduction, and coordinates in which their doubles keep their digits.

Every rank of the reduction is decided exactly (`exact/reachable.py`). Coordinates w = T w', T of each
delta, leave the value as it is. What enters and what leaves the channels of a delta,

    P = [M11 M12] [M11 M12]',    Q = [M11 ; M21]' [M11 ; M21]    (rows and columns of the delta),

become equal and diagonal, as Gramians do in a balanced realization (Moore 1981). Channels of beams with
their lengths as parameters lose eight digits otherwise: I - M11 Delta then has a condition of 1e7, and of
2 after this. T is a matrix of doubles; what it makes of the LFT is computed in balls and rounded once.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mbdlft.base.array import Array
from mbdlft.base.errors import WellPosednessError
from mbdlft.exact.matrices import (
    Balls,
    ExactMatrix,
    TooFewBitsError,
    ball_matrix,
    balls_of,
    entries_of,
    stacked,
)
from mbdlft.exact.reachable import reduced
from mbdlft.exact.rounding import channel_scales, or_one
from mbdlft.lft.lft import LFT, Block, consecutive
from mbdlft.lft.sampling import evaluate_at, rounding_sizes
from mbdlft.order.reduction_in_doubles import in_scales

_SWEEPS, _ROUNDS = 3, 8
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
        values, n = self.M.values(), self.order
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
    inner, others = slice(n, n + count), [*range(n), *range(n + count, M.shape[1])]
    solution = -M[inner, inner].solve(M[inner, others])  # of u, in w and v
    outside = [*range(n), *range(n + count, M.shape[0])]
    reduced = M[outside][:, others] + M[outside][:, inner] @ solution
    both = stacked([[reduced[:n]], [solution], [reduced[n:]]])
    return ExactLFT(both[[*range(n), *(n + k for k in rows)]], a.blocks)


def residues_alone(a: ExactLFT) -> ExactLFT:
    """What decides ranks and zeros, without the balls that carry values: it can go to another process."""
    M = a.M
    return ExactLFT(ExactMatrix(M.residues, np.empty((0, 0), object), M.prime), a.blocks)


def _in_touch(a: ExactLFT) -> ExactLFT:
    """The channels that an input reaches and that reach an output along entries that are not zero.

    It is much faster than a reduction, which would leave the others out, too.
    """
    n, some = a.order, a.M.residues != 0
    kept = np.ones(n, dtype=bool)
    for entries in (some, some.T):
        fresh = reached = entries[:n, n:].any(axis=1)
        while fresh.any():
            fresh = entries[:n, :n][:, fresh].any(axis=1) & ~reached
            reached = reached | fresh
        kept &= reached
    if kept.all():
        return a
    rows, columns = (np.append(kept, np.ones(count - n, dtype=bool)) for count in a.M.shape)
    sizes = [int(np.sum(kept[part])) for part in a.parts]
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
    for _ in range(_ROUNDS):
        if least <= most:
            break
        scale = channel_scales(rough.M11, rough.M12, rough.M21)
        T = _transformation(in_scales(rough)) / scale[:, None]
        if least < _SHOWN and _lost(_turned(rough, T), deltas) > _GAIN * least:
            break  # the data cancel, and not the channels
        M = _in_coordinates(M, T, a.parts)
        rough = _rounded(M, rough)
        lost = _lost(rough, deltas)
        if lost < least:
            best, least = rough, lost
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
    whole = np.sqrt(np.outer(np.max(size, axis=1, initial=0.0), np.max(size, axis=0, initial=0.0)))
    scale = or_one(np.where(size > _NEGLIGIBLE * whole, size, whole))
    return float(np.max(np.max(sizes, axis=0) / scale, initial=1.0))


def _in_coordinates(M: Balls, T: Array, blocks: Sequence[slice]) -> Balls:
    """[M11 M12 ; M21 M22] in coordinates T (n, n), block diagonal."""
    M = M.copy()
    for rows in blocks:
        if rows.start == rows.stop:
            continue
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
            T[rows, rows] = _of_block(into @ into.T, out.T @ out)
        M11 = np.asarray(np.linalg.solve(T, M11 @ T), dtype=float)
        M12 = np.asarray(np.linalg.solve(T, M12), dtype=float)
        M21 = np.asarray(M21 @ T, dtype=float)
        total = np.asarray(total @ T, dtype=float)
    return total


def _of_block(P: Array, Q: Array) -> Array:
    """T with T^-1 P T^-1' = T' Q T, diagonal."""
    size = len(P)
    P = P + _LEAST * (np.trace(P) or 1.0) * np.eye(size)
    Q = Q + _LEAST * (np.trace(Q) or 1.0) * np.eye(size)
    L, R = np.linalg.cholesky(P), np.linalg.cholesky(Q)
    _, values, right = np.linalg.svd(R.T @ L)
    return np.asarray(L @ right.T / np.sqrt(values))
