"""Proof of a bound of |fit - root| on a box: Krawczyk's test with Taylor models on pieces of it.

For one value of p, and s = t - fit(p) in the box |s_i| <= radius_i, let A be any matrix. If

    e + rho radius < radius,    e >= |A f(fit(p), p)|,    rho >= |I - A df/dt(fit(p) + s, p)|,

exactly one root has |s| <= radius, and it has |s| <= e + rho |s|. Both bounds are found for all p of
a piece at once. A is a polynomial in p near the inverse of df/dt, so rho is small and e is close to
the largest error. The radius is the same on all pieces, so the roots of adjoining pieces are the same
on the common face: one continuous branch on the whole box.

Source: Krawczyk 1969; Neumaier, Interval methods for systems of equations, 1990, chapter 5.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from mbdlft.base.array import Array
from mbdlft.base.expression import Expression, evaluate
from mbdlft.exact import taylor
from mbdlft.exact.taylor import Space, Taylor
from mbdlft.multibody.equilibrium.fit.system import System, newton
from mbdlft.problem.sx.tapes import arithmetic, fold

_ORDERS = {1: 12, 2: 8, 3: 7, 4: 5}  # of the residual, by the number of parameters; measured
_JACOBIAN_ORDER = 2
_BATCH = 256
_SMALLEST = 2.0**-24  # side of a piece that is not halved again, relative to the box
_TIGHT = 1.1  # a bound this much above the largest error that was found is good enough
_EXACT = 1e-3  # of the tolerance: errors below are not told apart from zero


@dataclass(frozen=True, slots=True)
class Proof:
    """What is proved, and where it stopped.

    Attributes
    ----------
    bound : Array (n,)
        Largest proved error on the pieces that were done.
    found : Array (n,)
        Largest error at single points.
    pieces : int
        Number of pieces that were examined.
    share : float
        Part of the box that is done.
    exceptions : Array (N, q)
        Points with an error above the tolerance.
    stuck : Array (q,) or None
        Middle of a smallest piece on which nothing could be proved.
    complete : bool
        The bound holds on the whole box.
    """

    bound: Array
    found: Array
    pieces: int
    share: float
    exceptions: Array
    stuck: Array | None = None
    complete: bool = False


def prove(
    s: System,
    fits: Sequence[Expression],
    low: Array,
    high: Array,
    tolerance: Array,
    found: Array,
    probes: Array,
    most_pieces: int,
) -> Proof:
    """Bounds (n,) of |fit - root| on the box [low, high] (q,), by pieces that are halved.

    Parameters
    ----------
    s : System
    fits : one expression of the parameters for each unknown
    low, high : Array (q,)
    tolerance : Array (n,)
        Bounds above it are refined.
    found : Array (n,)
        Largest errors that are known; bounds not far above them are not refined.
    probes : Array (N, q)
        Points that are looked at before anything is proved, which takes longer.
    most_pieces : int
    """
    bound, none = np.zeros(s.unknowns), np.zeros((0, len(low)))
    here = _errors_at(s, fits, probes)
    wrong = ~np.all(here <= tolerance, axis=1)
    found = np.maximum(found, here[~wrong].max(axis=0, initial=0.0))
    if np.any(wrong):
        return Proof(bound, found, 0, 0.0, probes[wrong])
    radius = 2 * _TIGHT * np.maximum(found, _EXACT * tolerance)
    pieces, count, share = [np.array([low, high])], 0, 0.0
    while pieces:
        batch = np.array(pieces[-_BATCH:])
        del pieces[-_BATCH:]
        count += len(batch)
        errors, curvature = enclose(s, fits, batch[:, 0], batch[:, 1], radius)
        here = _errors_at(s, fits, batch.mean(axis=1))
        wrong = ~np.all(here <= tolerance, axis=1)
        found = np.maximum(found, here[~wrong].max(axis=0, initial=0.0))
        if np.any(_TIGHT * found > radius):  # larger than the samples told: begin again
            return prove(s, fits, low, high, tolerance, found, none, most_pieces)
        target = np.minimum(tolerance, _TIGHT * np.maximum(found, _EXACT * tolerance))
        done = np.all(errors <= (tolerance if count > most_pieces // 4 else target), axis=1)
        bound = np.maximum(bound, errors[done].max(axis=0, initial=0.0))
        sides = (batch[:, 1] - batch[:, 0]) / (high - low)
        share += float(np.prod(sides[done], axis=1).sum())
        if np.any(wrong & ~done):
            exceptions = batch[wrong & ~done].mean(axis=1)
            return Proof(bound, found, count, share, exceptions)
        small = ~done & np.all(sides < _SMALLEST, axis=1)
        if np.any(small) or count > most_pieces:
            stuck = batch[small][0].mean(axis=0) if np.any(small) else None
            return Proof(bound, found, count, share, none, stuck)
        for k in np.flatnonzero(~done):
            pieces += _halves(batch[k], sides[k], curvature[k])
    return Proof(bound, found, count, share, none, complete=True)


def enclose(
    s: System, fits: Sequence[Expression], low: Array, high: Array, radius: Array
) -> tuple[Array, Array]:
    """Bounds (N, n) of |fit - root| on N boxes [low, high] (N, q), infinite where none is proved.

    Also how much each variable bends A f, (N, q), which tells how to halve a box.
    """
    n, q, count = s.unknowns, low.shape[1], len(low)
    fine, coarse = (taylor.space(q, order) for order in (_ORDERS.get(q, 5), _JACOBIAN_ORDER))
    with np.errstate(all="ignore"):  # a failure is a radius that is infinite or NaN
        entries = _on_boxes(s, s.jacobian, fits, low, high, coarse, radius)
        jacobian = [[entries[j * n + i] for j in range(n)] for i in range(n)]
        f = _on_boxes(s, s.residual, fits, low, high, fine, np.zeros(n))
        A = _inverse(jacobian)
        rho, e = np.zeros((count, n, n)), np.zeros((count, n))
        bends = np.zeros((count, q))
        weights = fine.exponents * 2.0 ** fine.degrees[:, None] * (fine.degrees[:, None] > 1)
        for i in range(n):
            for j in range(n):
                defect = -sum(
                    (A[i][k] * jacobian[k][j] for k in range(1, n)), A[i][0] * jacobian[0][j]
                )
                if i == j:
                    defect = defect + 1.0
                rho[:, i, j] = taylor.up(taylor.size(defect.c) + defect.r)
            products = [taylor.embedded(A[i][k], fine) * f[k] for k in range(n)]
            newton_step = sum(products[1:], products[0])
            e[:, i] = taylor.largest(newton_step)
            bends += (np.abs(newton_step.c).T @ weights) / radius[i]
        reach = taylor.up(e + rho @ radius)
        proved = np.all(reach < radius, axis=1)  # false for NaN
        for _ in range(3):
            reach = np.minimum(reach, taylor.up(e + (rho @ reach[:, :, None])[:, :, 0]))
    return np.where(proved[:, None], reach, np.inf), np.nan_to_num(bends, posinf=0.0)


def _on_boxes(
    s: System,
    tape: ca.Function,
    fits: Sequence[Expression],
    low: Array,
    high: Array,
    monomials: Space,
    radius: Array,
) -> list[Taylor]:
    """A tape at t = fit(p) + [-radius, radius] on boxes."""

    def number(value: float) -> Taylor:
        return taylor.constant(monomials, value, len(low))

    p = [taylor.variable(monomials, k, low[:, k], high[:, k]) for k in range(low.shape[1])]
    names = dict(zip(s.names, p, strict=True))
    t = [
        taylor.widened(number(0.0) + evaluate(fit, names), float(r))
        for fit, r in zip(fits, radius, strict=True)
    ]
    (found,) = fold(tape, arithmetic(number, taylor.FUNCTIONS), t, p)
    return [entry if isinstance(entry, Taylor) else number(entry) for entry in found]


def _inverse(matrix: list[list[Taylor]]) -> list[list[Taylor]]:
    """Polynomials near the inverse: one Newton-Schulz step X (2 I - matrix X) from the middle."""
    n, first = len(matrix), matrix[0][0]
    middle = np.array([[entry.c[0] for entry in row] for row in matrix]).transpose(2, 0, 1)
    regular = np.isfinite(middle).all(axis=(1, 2)) & (np.linalg.det(np.nan_to_num(middle)) != 0)
    X = np.full(middle.shape, np.nan)
    X[regular] = np.linalg.inv(middle[regular])
    c = np.array([[entry.c for entry in row] for row in matrix])  # (n, n, M, N)
    step = -np.einsum("ijmz,zjk->ikmz", c, X)
    step[range(n), range(n), 0] += 2.0
    found = np.einsum("zij,jkmz->ikmz", X, step)
    zero = np.zeros_like(first.r)
    return [[Taylor(first.space, entry, zero) for entry in row] for row in found]


def _errors_at(s: System, fits: Sequence[Expression], points: Array) -> Array:
    """|fit - root| (N, n) at points (N, q), not finite where no root is near."""
    names = dict(zip(s.names, points.T, strict=True))
    with np.errstate(all="ignore"):
        t = np.array([np.broadcast_to(evaluate(fit, names), len(points)) for fit in fits]).T
        roots, converged, _ = newton(s, t, points)
    return np.where(converged[:, None], np.abs(roots - t), np.inf)


def _halves(piece: Array, sides: Array, bends: Array) -> list[Array]:
    """A piece (2, q) cut across the variable that bends most; the longest side breaks ties."""
    total = float(bends.sum())
    share = bends / total if total > 0 else np.zeros_like(bends)
    k = int(np.argmax(np.where(sides < _SMALLEST, -1.0, share + 0.1 * sides / sides.max())))
    middle = 0.5 * (piece[0, k] + piece[1, k])
    lower, upper = piece.copy(), piece.copy()
    lower[1, k] = upper[0, k] = middle
    return [lower, upper]
