"""Truncation: a smaller LFT that is not exact, with a bound of its error on the whole range.

The channels of each delta are balanced: coordinates in which what reaches a direction and what is seen
of it have the same size, sigma. Directions that matter least are left out, as in balanced truncation of
uncertain systems: Beck, Doyle, Glover, Model reduction of multidimensional and uncertain systems, IEEE
TAC 41 (1996). The Gramians are means over sampled deltas, which gives good directions but proves
nothing. The error is bounded afterwards: with e = z - T z', what the truncation leaves of z,

    e      = M11 Delta e + (I - T T^+) (M11 T Delta' z' + M12 u)
    z'     =                            T^+ (M11 T Delta' z' + M12 u)
    y - y' = M21 Delta e

is an LFT with the same deltas, and `mbdlft/lft/box_gain.py` bounds it on the box.
"""

from dataclasses import replace
from numbers import Real
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbdlft.base.arguments import arguments_checked
from mbdlft.base.array import Array
from mbdlft.base.errors import AnalysisError, StructureError, WellPosednessError
from mbdlft.lft.box_gain import gain_bound
from mbdlft.lft.lft import LFT, Block, check_plain
from mbdlft.lft.sampling import chunks, evaluate_at
from mbdlft.system.evidence import truncated_certificate
from mbdlft.system.model import LFTModel

_SEED, _POINTS = 2, 128  # random points, and as many corners
_BOXES = 5  # into which the range may be cut for one bound
_CANDIDATES = 4  # directions that are tried before one is left out
_BEYOND = 4.0  # times the tolerance: the sampled error at which no more directions are left out
_ROUNDING = 1e-9  # of its terms: an entry below this is what cancellation has left
_TERM_POINTS = 8
_SWEEPS = 100  # over rows and columns, until their typical sizes fit each other
_LEAST = 1e-3  # of the tolerance: the least unit in which an error is bounded

Indices = NDArray[np.int64]


class _Step(NamedTuple):
    """The channels that stay, and the error at the sampled points."""

    kept: Indices
    error: float


@arguments_checked
def truncate(model: LFTModel, tolerance: float) -> LFTModel:
    """A smaller model whose matrices differ from the exact ones by a guaranteed bound at most.

    With r_i and c_j the typical sizes of the rows and columns of [A B ; C D] over the range (those of
    `typical_sizes`, so units do not matter), the largest singular value of the matrix of
    (exact - truncated)_ij / (r_i c_j) is at most `tolerance` for all parameters in their ranges; so no
    entry differs by more than tolerance r_i c_j. At nominal nothing differs, and constant entries never
    do. The trim stays exact.

    Parameters
    ----------
    model : LFTModel
        An exact one.
    tolerance : float
        [1], above 0.

    Returns
    -------
    LFTModel
        With `certificate.exact` False and the bound in `certificate.truncation_error`, or `model` itself
        if no smaller one was found within the tolerance.

    Raises
    ------
    StructureError
        The tolerance is not a positive number, or the model is not exact.
    AnalysisError
        The model cannot be shown to be well posed on its whole range, so there is no guarantee.
    WellPosednessError
        The model is singular at a point of its range.
    """
    where = f"model {model.name!r}"
    fitted = model.certificate.fit_error_bound > 0.0 and model.certificate.truncation_error == 0.0
    if not (model.certificate.exact or fitted):
        raise StructureError(
            f"{where}: it is not exact already, and errors of two truncations have no common scale. "
            "Truncate the exact model with the larger tolerance."
        )
    try:
        lft, error = truncate_lft(model.lft, tolerance)
    except (StructureError, AnalysisError, WellPosednessError) as problem:
        raise type(problem)(f"{where}: {problem}") from None
    if lft is model.lft:
        return model
    return replace(model, lft=lft, certificate=truncated_certificate(model, lft, error))


def truncate_lft(a: LFT, tolerance: float) -> tuple[LFT, float]:
    """The smallest LFT that is found within a tolerance, and the bound of its error [1].

    Both are relative to `typical_sizes`, as in `truncate`. The LFT is one that `reduce_order` cannot make
    smaller: useless channels have no balanced coordinates. It comes back itself, with the bound 0.0, if
    nothing can be left out.
    """
    check_tolerance(tolerance)
    check_plain(a, "truncation")
    rows, columns = typical_sizes(a)
    scaled = LFT(a.M11, a.M12 / columns, a.M21 / rows[:, None], a.M22 / rows[:, None] / columns, a.blocks)
    points = _points(len(a.blocks))
    values = evaluate_at(scaled, points)
    balanced, sigma = balance(scaled, points)
    # what the change of coordinates does by rounding
    rounding = _distance(evaluate_at(balanced, points), values)
    steps = _path(balanced, sigma, points, values, tolerance)
    for step in reversed(steps):
        unit = max(step.error, _LEAST * tolerance)
        difference = error_lft(balanced, step.kept, unit)
        error = unit * gain_bound(difference, (tolerance - rounding) / unit, _BOXES) + rounding
        if error <= tolerance:
            small = keep(balanced, step.kept)
            return (
                LFT(small.M11, small.M12 * columns, rows[:, None] * small.M21, a.M22, small.blocks),
                float(error),
            )
    if steps and not np.isfinite(gain_bound(balanced, np.inf, _BOXES)):
        raise AnalysisError(
            "there is no guarantee for a truncation: the model could not be shown to be well posed on "
            f"the whole range, cut into {_BOXES} boxes. Narrow the ranges, or keep the exact model."
        )
    return a, 0.0


def check_tolerance(tolerance: float) -> None:
    """Raise a StructureError unless a tolerance is a positive number."""
    if not isinstance(tolerance, Real) or isinstance(tolerance, bool) or not 0.0 < tolerance < np.inf:
        raise StructureError(
            f"truncation needs a tolerance above 0, such as 0.01, got {tolerance!r}. Without "
            "truncation the model is exact."
        )


def typical_sizes(a: LFT) -> tuple[Array, Array]:
    """Sizes r (n_out,) of rows and c (n_in,) of columns: r_i c_j is typical of the entry (i, j).

    With size_ij the largest size of an entry at nominal, sampled points and corners, the root mean
    square of size_ij / (r_i c_j) is 1 over each row and each column; entries count that depend on the
    deltas and are not zero up to rounding. Other units of a signal change r or c by the same factor, and
    a tiny entry changes little. Rows and columns that do not depend on the deltas get 1.
    """
    points = np.vstack([np.zeros((1, len(a.blocks))), _points(len(a.blocks))])
    rows, columns = np.ones(a.shape[0]), np.ones(a.shape[1])
    i, j = np.flatnonzero(a.M21.any(axis=1)), np.flatnonzero(a.M12.any(axis=0))
    size = np.max(np.abs(evaluate_at(a, points)), axis=0)[np.ix_(i, j)]
    # entries that are nothing but rounding of terms that cancel do not count
    d = np.repeat(points[: _TERM_POINTS + 1], [block.size for block in a.blocks], axis=1)[:, None, :]
    inverse = np.abs(np.linalg.inv(np.eye(a.order) - a.M11[None] * d))
    terms = np.max(np.abs(a.M22) + (np.abs(a.M21)[None] * np.abs(d)) @ inverse @ np.abs(a.M12), axis=0)
    counts = size > _ROUNDING * terms[np.ix_(i, j)]
    squares = np.where(counts, size, 0.0) ** 2
    used = np.maximum(np.sum(counts, axis=1), 1), np.maximum(np.sum(counts, axis=0), 1)
    c = np.ones(len(j))
    for _ in range(_SWEEPS):
        r = np.sum(squares / c, axis=1) / used[0]
        r[r == 0.0] = 1.0
        c = np.sum(squares / r[:, None], axis=0) / used[1]
        c[c == 0.0] = 1.0
        rows[i], columns[j] = np.sqrt(r), np.sqrt(c)
    return rows, columns


def balance(a: LFT, points: Array) -> tuple[LFT, Array]:
    """Balanced coordinates in each block, and the sigmas (order,), falling within each block.

    The Gramians are the means of z z' and f' f over points (N, number of blocks), where z is what inputs
    of size one do to the channels, and y = f e what an addition e to z does to the outputs.
    """
    sizes = [block.size for block in a.blocks]
    spread = np.repeat(points, sizes, axis=1)
    n = a.order
    reach, see = np.zeros((n, n)), np.zeros((n, n))
    for rows in chunks(len(points), n):
        d = spread[rows]
        inverse = np.linalg.inv(np.eye(n) - a.M11[None] * d[:, None, :])
        z = inverse @ a.M12
        f = (a.M21[None] * d[:, None, :]) @ inverse
        reach += np.einsum("nij,nkj->ik", z, z) / len(points)
        see += np.einsum("nij,nik->jk", f, f) / len(points)
    T, T_inverse, sigma = np.zeros((n, n)), np.zeros((n, n)), np.zeros(n)
    for rows in a.slices().values():  # T^-1 reach T^-T = T' see T = diag(sigma)
        reach_root, see_root = _root(reach[rows, rows]), _root(see[rows, rows])
        U, sigma[rows], Vt = np.linalg.svd(see_root.T @ reach_root)
        T[rows, rows] = reach_root @ Vt.T / np.sqrt(sigma[rows])
        T_inverse[rows, rows] = (U / np.sqrt(sigma[rows])).T @ see_root.T
    return LFT(T_inverse @ a.M11 @ T, T_inverse @ a.M12, a.M21 @ T, a.M22, a.blocks), sigma


def _root(gramian: Array) -> Array:
    """L with L L' = gramian; directions lost in rounding get a little, so that L is invertible."""
    if not gramian.size:
        return gramian
    values, vectors = np.linalg.eigh(gramian)
    least = len(values) * float(np.finfo(float).eps) * max(float(values[-1]), np.finfo(float).tiny)
    return np.asarray(vectors * np.sqrt(np.maximum(values, least)))


def keep(a: LFT, kept: Indices) -> LFT:
    """The LFT with only the given channels, sorted."""
    blocks = tuple(
        Block(name, int(np.sum((kept >= channels.start) & (kept < channels.stop))))
        for name, channels in a.slices().items()
    )
    return LFT(a.M11[np.ix_(kept, kept)], a.M12[kept], a.M21[:, kept], a.M22, blocks)


def error_lft(a: LFT, kept: Indices, unit: float = 1.0) -> LFT:
    """The LFT with value (value(a) - value(keep(a, kept))) / unit."""
    n, m = a.order, len(kept)
    left_out = np.ones((n, 1))
    left_out[kept] = 0.0
    M11 = np.block(
        [[a.M11, left_out * a.M11[:, kept] / unit], [np.zeros((m, n)), a.M11[np.ix_(kept, kept)]]]
    )
    M12 = np.vstack([left_out * a.M12 / unit, a.M12[kept]])
    M21 = np.hstack([a.M21, np.zeros((a.shape[0], m))])
    owner = np.repeat(np.arange(len(a.blocks)), [block.size for block in a.blocks])
    owner = np.concatenate([owner, owner[kept]])
    order = np.argsort(owner, kind="stable")
    counts = np.bincount(owner, minlength=len(a.blocks))
    blocks = tuple(Block(b.name, int(k)) for b, k in zip(a.blocks, counts, strict=True))
    return LFT(M11[np.ix_(order, order)], M12[order], M21[:, order], np.zeros(a.shape), blocks)


def _path(a: LFT, sigma: Array, points: Array, values: Array, tolerance: float) -> list[_Step]:
    """Channels left out one after the other, while the error at the points is within the tolerance.

    The order in which they go does not depend on the tolerance.
    """
    kept, steps = np.arange(a.order), []
    while len(kept):
        # the last of each block that is still there
        owner = np.searchsorted([channels.stop for channels in a.slices().values()], kept, side="right")
        last = np.flatnonzero(np.append(np.diff(owner) > 0, True))
        last = last[np.argsort(sigma[kept[last]], kind="stable")][:_CANDIDATES]
        choices = [np.delete(kept, k) for k in last]
        errors = [_distance(evaluate_at(keep(a, choice), points), values) for choice in choices]
        best = int(np.argmin(errors))
        if errors[best] > _BEYOND * tolerance:
            break
        kept = choices[best]
        steps.append(_Step(kept, errors[best]))
    return [step for step in steps if step.error <= tolerance]


def _distance(a: Array, b: Array) -> float:
    """Largest singular value of the differences of matrices (N, ., .)."""
    return float(np.max(np.linalg.norm(a - b, 2, axis=(1, 2)), initial=0.0))


def _points(count: int) -> Array:
    """Random points and corners of the unit box (N, count)."""
    points = np.random.default_rng(_SEED).uniform(-1.0, 1.0, (2 * _POINTS, count))
    points[_POINTS:] = np.sign(points[_POINTS:])
    return points
