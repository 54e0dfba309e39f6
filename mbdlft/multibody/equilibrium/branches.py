"""Branches of the root of f(t, p) = 0, the equations of an equilibrium, and proofs of their bounds.

The branch of equilibria through a known one is followed along straight lines in the parameters. A bound
of |fit - root| on a box is proved by Krawczyk's test with Taylor models on pieces of the box. For one
value of p, and s = t - fit(p) in the box |s_i| <= radius_i, let A be any matrix. If

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
import numpy.typing as npt

from mbdlft.base.array import Array
from mbdlft.base.errors import TrimError
from mbdlft.base.expression import Expression, evaluate
from mbdlft.exact import taylor
from mbdlft.exact.operators import FUNCTIONS_OF_DOUBLES
from mbdlft.exact.taylor import Space, Taylor
from mbdlft.problem.sx.tapes import arithmetic, fold

_STEPS = 12  # of Newton's iteration; from a good start six are enough
_CONVERGED = 1e-9  # last step but one, relative to 1 + |t|; the last one squares it
_SHORTEST = 1e-7  # of a line: how closely a singular point is met
_FAR = 1e4  # tangent of half an angle: within 0.01 deg of 180 deg
_TRY = (
    "Make the range smaller, or let this unknown be a parameter and the trim solve for a quantity that "
    "enters linearly (an input; in a scene a load, a preload, a mass offset)."
)
_ARRAYS = arithmetic(np.float64, FUNCTIONS_OF_DOUBLES)


@dataclass(frozen=True, slots=True)
class System:
    """f(t, p) = 0 with n unknowns and q parameters."""

    name: str  # for messages
    names: tuple[str, ...]  # of the parameters
    residual: ca.Function  # (t, p) -> f (n,), dense
    jacobian: ca.Function  # (t, p) -> df/dt (n, n), dense

    @property
    def unknowns(self) -> int:
        return int(self.residual.numel_in(0))

    def at(self, p: Array) -> str:
        """Text of a parameter value for messages."""
        return ", ".join(f"{k} = {v:.6g}" for k, v in zip(self.names, p, strict=True))


def system(residual: ca.Function, names: Sequence[str]) -> System:
    """Tapes of a residual (t, p) -> f."""
    t = ca.SX.sym("t", residual.numel_in(0))
    p = ca.SX.sym("p", residual.numel_in(1))
    f = ca.densify(ca.vec(residual(t, p)))
    return System(
        residual.name(),
        tuple(names),
        ca.Function("f", [t, p], [f]),
        ca.Function("J", [t, p], [ca.densify(ca.jacobian(f, t))]),
    )


def values(s: System, t: Array, p: Array) -> tuple[Array, Array]:
    """f (N, n) and df/dt (N, n, n) at t (N, n) and p (N, q)."""
    n, count = s.unknowns, len(p)
    f, j = (
        np.array([np.broadcast_to(entry, count) for entry in fold(tape, _ARRAYS, t.T, p.T)[0]])
        for tape in (s.residual, s.jacobian)
    )
    return f.T, j.reshape(n, n, count).T


def newton(s: System, t: Array, p: Array) -> tuple[Array, npt.NDArray[np.bool_], Array]:
    """Roots (N, n) from starts t (N, n) at p (N, q), whether each converged, and df/dt (N, n, n) before.

    It converged if the steps shrank from the first one on, and the last is at rounding.
    """
    t, last = t.copy(), np.full(len(t), np.inf)
    good, done = np.ones(len(t), bool), np.zeros(len(t), bool)
    for _ in range(_STEPS):
        f, j = values(s, t, p)
        step = solve(j, f)
        length = np.max(np.abs(step) / (1 + np.abs(t)), axis=1, initial=0.0)
        good &= np.isfinite(length) & (done | (length <= 0.5 * last))
        t = np.where(good[:, None], t - np.where(np.isfinite(step), step, 0.0), t)
        done |= length <= _CONVERGED
        last = length
        if np.all(done | ~good):
            break
    return t, good & done, j


def solve(matrices: Array, vectors: Array) -> Array:
    """x (N, n) of A x = b; not a number where A is singular."""
    regular = np.linalg.det(matrices) != 0
    regular &= np.isfinite(matrices).all(axis=(1, 2)) & np.isfinite(vectors).all(axis=1)
    x = np.full(vectors.shape, np.nan)
    x[regular] = np.linalg.solve(matrices[regular], vectors[regular][:, :, None])[:, :, 0]
    return x


def start_branch(s: System, nominal: Array, start: Array) -> Array:
    """The root (n,) at the nominal values that `start` is near to."""
    roots, converged, jacobian = newton(s, start[None], nominal[None])
    if not converged[0]:
        raise TrimError(
            f"equilibrium of {s.name!r}: no root was found from start = {start.tolist()} at "
            f"{s.at(nominal)}. Give a start nearer to the equilibrium; if that does not help, "
            "the equilibrium is at a fold or a bifurcation there, or does not exist."
        )
    if not np.linalg.cond(jacobian[0]) <= 1 / _SHORTEST:
        raise TrimError(
            f"equilibrium of {s.name!r}: df/dt is singular at the start, {s.at(nominal)}, "
            f"t = {roots[0].tolist()}: a fold or a bifurcation. {_TRY}"
        )
    return np.asarray(roots[0])


def follow(s: System, nominal: Array, root: Array, points: Array) -> Array:
    """Roots (N, n) at `points` (N, q) on the branch of `root` at `nominal`.

    Each line from the nominal values is walked in steps that are halved until Newton's iteration
    contracts from the first step on and det(df/dt) keeps its sign.
    """
    count = len(points)
    way, stride = np.zeros(count), np.full(count, 0.25)
    t = np.repeat(root[None], count, axis=0)
    _, _, first = newton(s, root[None], nominal[None])
    sign = np.sign(np.linalg.det(first[0]))
    turned = np.zeros(count, bool)  # the last refusal was a root with another sign
    while np.any(way < 1):
        k = np.flatnonzero(way < 1)
        trial = np.minimum(way[k] + stride[k], 1.0)
        roots, converged, jacobian = newton(s, t[k], nominal + trial[:, None] * (points[k] - nominal))
        same = np.sign(np.linalg.det(np.nan_to_num(jacobian))) == sign
        jump = np.max(np.abs(roots - t[k]) / (1 + np.abs(t[k])), axis=1, initial=0.0)
        accepted = converged & same & (jump < 0.5)
        way[k] = np.where(accepted, trial, way[k])
        t[k] = np.where(accepted[:, None], roots, t[k])
        stride[k] *= np.where(accepted, 1.6, 0.5)
        turned[k] = np.where(accepted, turned[k], converged & ~same)
        lost = k[(stride[k] < _SHORTEST) & (way[k] < 1)]
        if len(lost):
            nearest = lost[np.argmin(way[lost])]
            where = nominal + way[nearest] * (points[nearest] - nominal)
            beyond = where + _SHORTEST * (points[nearest] - nominal)
            raise _end(s, where, beyond, t[nearest], turned=bool(turned[nearest]))
    return t


def _end(s: System, p: Array, beyond: Array, t: Array, *, turned: bool) -> TrimError:
    """Why a branch cannot be followed from p to `beyond`."""
    f, jacobian = values(s, t[None], beyond[None])
    if np.max(np.abs(t)) > _FAR:
        why = (
            f"goes to infinity (t = {t.tolist()}): no equilibrium is near beyond. In a scene, where t "
            "is the tangent of half an angle, a joint comes to 180 deg from its reference; then choose "
            "another reference"
        )
    elif turned:
        why = "bifurcates: df/dt is singular there and another branch crosses"
    elif np.isfinite(f).all() and np.isfinite(jacobian).all():
        why = "folds: df/dt is singular there and no root was found beyond"
    else:
        why = "ends: the residual is not finite beyond"
    return TrimError(
        f"equilibrium of {s.name!r}: near {s.at(p)}, t = {t.tolist()}, the branch {why}. {_TRY}"
    )


_ORDERS = {1: 12, 2: 8, 3: 7, 4: 5}  # of the residual, by the number of parameters; measured
_JACOBIAN_ORDER = 2
_BATCH = 256
_SMALLEST = 2.0**-24  # side of a piece that is not halved again, relative to the box
_TIGHT = 1.1  # a bound this much above the largest error that was found is good enough
_EXACT = 1e-3  # of the tolerance: errors below are not told apart from zero


@dataclass(frozen=True, slots=True)
class Proof:
    """What is proved, and where it stopped."""

    bound: Array  # (n,) largest proved error on the pieces that were done
    sampled: Array  # (n,) largest error at single points
    pieces: int  # number of pieces that were examined
    share: float  # part of the box that is done
    exceptions: Array  # (N, q) points with an error above the tolerance
    stuck: Array | None = None  # (q,) middle of a smallest piece on which nothing could be proved
    complete: bool = False  # the bound holds on the whole box


def prove(
    s: System,
    fits: Sequence[Expression],
    low: Array,
    high: Array,
    tolerance: Array,
    sampled: Array,
    probes: Array,
    most_pieces: int,
) -> Proof:
    """Bounds (n,) of |fit - root| on the box [low, high] (q,), by pieces that are halved.

    `fits` are expressions of the parameters. Bounds above the `tolerance` (n,) are refined, unless they
    are not far above the largest known errors, `sampled` (n,). The `probes` (N, q) are looked at first.
    """
    bound, none = np.zeros(s.unknowns), np.zeros((0, len(low)))
    here = _errors_at(s, fits, probes)
    wrong = ~np.all(here <= tolerance, axis=1)
    sampled = np.maximum(sampled, here[~wrong].max(axis=0, initial=0.0))
    if np.any(wrong):
        return Proof(bound, sampled, 0, 0.0, probes[wrong])
    radius = 2 * _TIGHT * np.maximum(sampled, _EXACT * tolerance)
    pieces, count, share = [np.array([low, high])], 0, 0.0
    while pieces:
        batch = np.array(pieces[-_BATCH:])
        del pieces[-_BATCH:]
        count += len(batch)
        errors, curvature = enclose(s, fits, batch[:, 0], batch[:, 1], radius)
        here = _errors_at(s, fits, batch.mean(axis=1))
        wrong = ~np.all(here <= tolerance, axis=1)
        sampled = np.maximum(sampled, here[~wrong].max(axis=0, initial=0.0))
        if np.any(_TIGHT * sampled > radius):  # larger than the samples told: begin again
            return prove(s, fits, low, high, tolerance, sampled, none, most_pieces)
        target = np.minimum(tolerance, _TIGHT * np.maximum(sampled, _EXACT * tolerance))
        done = np.all(errors <= (tolerance if count > most_pieces // 4 else target), axis=1)
        bound = np.maximum(bound, errors[done].max(axis=0, initial=0.0))
        sides = (batch[:, 1] - batch[:, 0]) / (high - low)
        share += float(np.prod(sides[done], axis=1).sum())
        if np.any(wrong & ~done):
            exceptions = batch[wrong & ~done].mean(axis=1)
            return Proof(bound, sampled, count, share, exceptions)
        small = ~done & np.all(sides < _SMALLEST, axis=1)
        if np.any(small) or count > most_pieces:
            stuck = batch[small][0].mean(axis=0) if np.any(small) else None
            return Proof(bound, sampled, count, share, none, stuck)
        for k in np.flatnonzero(~done):
            pieces += _halves(batch[k], sides[k], curvature[k])
    return Proof(bound, sampled, count, share, none, complete=True)


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
                defect = -sum((A[i][k] * jacobian[k][j] for k in range(1, n)), A[i][0] * jacobian[0][j])
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
    (entries,) = fold(tape, arithmetic(number, taylor.FUNCTIONS), t, p)
    return [entry if isinstance(entry, Taylor) else number(entry) for entry in entries]


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
    product = np.einsum("zij,jkmz->ikmz", X, step)
    zero = np.zeros_like(first.r)
    return [[Taylor(first.space, entry, zero) for entry in row] for row in product]


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
