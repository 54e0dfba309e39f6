"""The equations of equilibrium f(t, p) = 0 with their Jacobian, as tapes; their roots, and branches.

The branch of equilibria through a known one is followed along straight lines in the parameters.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np
import numpy.typing as npt

from mbdlft.base.array import Array
from mbdlft.base.errors import TrimError
from mbdlft.exact.operators import FUNCTIONS_OF_DOUBLES
from mbdlft.problem.sx.tapes import arithmetic, fold

_STEPS = 12  # of Newton's iteration; from a good start six are enough
_CONVERGED = 1e-9  # last step but one, relative to 1 + |t|; the last one squares it
_SHORTEST = 1e-7  # of a line: how closely a singular point is met
_FAR = 1e4  # tangent of half an angle: within 0.01 deg of 180 deg
_TRY = (
    "Make the range smaller, or let the angle be a parameter and the trim solve for a quantity "
    "that enters linearly (a load, a preload, a mass offset)."
)
_ARRAYS = arithmetic(np.float64, FUNCTIONS_OF_DOUBLES)


@dataclass(frozen=True, slots=True)
class System:
    """f(t, p) = 0 with n unknowns and q parameters.

    Attributes
    ----------
    name : str
        For messages.
    names : names of the parameters
    residual, jacobian : casadi.Function
        (t, p) -> f (n,) and df/dt (n, n), dense.
    """

    name: str
    names: tuple[str, ...]
    residual: ca.Function
    jacobian: ca.Function

    @property
    def unknowns(self) -> int:
        """Number n of unknowns."""
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
    """Roots from starts t (N, n) at p (N, q).

    Returns
    -------
    roots : Array (N, n)
    converged : Array (N,) of bool
        The steps shrank from the first one on, and the last is at rounding.
    jacobian : Array (N, n, n)
        df/dt at the last point but one.
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
    found = np.full(vectors.shape, np.nan)
    found[regular] = np.linalg.solve(matrices[regular], vectors[regular][:, :, None])[:, :, 0]
    return found


def start_branch(s: System, nominal: Array, start: Array) -> Array:
    """The root (n,) at the nominal values that `start` is near to.

    Raises
    ------
    TrimError
        Newton's iteration does not converge, or df/dt is singular at the root.
    """
    roots, converged, jacobian = newton(s, start[None], nominal[None])
    if not converged[0]:
        raise TrimError(
            f"equilibrium of {s.name!r}: no root was found from start = {start.tolist()} at "
            f"{s.at(nominal)}. Give a start nearer to the equilibrium; if that does not help, "
            "the equilibrium is at a fold or a bifurcation there, or does not exist."
        )
    if not np.isfinite(np.linalg.cond(jacobian[0])) or np.linalg.cond(jacobian[0]) > 1 / _SHORTEST:
        raise TrimError(
            f"equilibrium of {s.name!r}: df/dt is singular at the start, {s.at(nominal)}, "
            f"t = {roots[0].tolist()}: a fold or a bifurcation. {_TRY}"
        )
    return np.asarray(roots[0])


def follow(s: System, nominal: Array, root: Array, points: Array) -> Array:
    """Roots (N, n) at `points` (N, q) on the branch of `root` at `nominal`.

    Each line from the nominal values is walked in steps that are halved until Newton's iteration
    contracts from the first step on and det(df/dt) keeps its sign.

    Raises
    ------
    TrimError
        The branch folds or bifurcates, or the residual is not finite, on the way to a point.
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
        roots, converged, jacobian = newton(
            s, t[k], nominal + trial[:, None] * (points[k] - nominal)
        )
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
            f"goes to infinity (t = {t.tolist()}): the joint comes to 180 deg from its reference. "
            "Choose another reference"
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
