"""The equations of equilibrium f(t, p) = 0 with their Jacobian, as tapes, and their roots."""

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np
import numpy.typing as npt

from mbdlft.base.array import Array
from mbdlft.number import double
from mbdlft.sx.fold import arithmetic, fold

_STEPS = 12  # of Newton's iteration; from a good start six are enough
_CONVERGED = 1e-9  # last step but one, relative to 1 + |t|; the last one squares it
_ARRAYS = arithmetic(np.float64, double.FUNCTIONS)


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
