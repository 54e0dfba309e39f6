"""An eigenvalue with its vector, in balls, for all matrices whose entries are as near as rounding is.

With (v, lambda) for A to many digits, and R near to the inverse of the derivative J of

    f(v, lambda) = [(A - lambda) v; u'v - 1],

an eigenpair is in (v, lambda) + X if -R f + (I - R J) X is in X (Krawczyk; S. M. Rump, Verification
methods, Acta Numerica 19, 2010, section 13). Of eigenvalues that are not simple there is none.
"""

from typing import Any

import flint
import numpy as np
from numpy.typing import NDArray

from mbdlft.base.array import Array
from mbdlft.exact.rounding import EPS

ROUNDING = 16.0 * EPS  # times the number of states and the size of A: what rounding may do to A
_BITS, _REFINED, _INFLATED = 192, 4, 3  # of balls; steps to an eigenpair; boxes that are tried around it


def eigenpair(A: Array, pole: complex, v: NDArray[Any], u: NDArray[Any]) -> list[Any] | None:
    """v with u'v = 1 and the eigenvalue, n + 1 balls, near to those of doubles; None if none are proved.

    Entries of A (n, n) that are rounding of its norm may be anything up to their size.
    """
    n, scale = len(A), complex(np.conj(u) @ v)
    if scale == 0.0:
        return None
    with flint.ctx.workprec(_BITS):
        near = flint.acb_mat(A.astype(complex).tolist())
        all_near = with_rounding(A, EPS * n * float(np.linalg.norm(A)))
        left = flint.acb_mat([np.conj(u).astype(complex).tolist()])
        x = flint.acb_mat([[entry] for entry in [*(v / scale).tolist(), pole]])
        try:
            R = _derivative(near, x, left).inv().mid()  # once: it takes the longest
        except ZeroDivisionError:
            return None
        for _ in range(_REFINED):
            x = (x - R * _equation(near, x, left)).mid()
        first = X = -R * _equation(all_near, x, left)
        for _ in range(_INFLATED):
            X = flint.acb_mat(n + 1, 1, [_wider(entry) for entry in X.entries()])
            K = first + (_identity(n + 1) - R * _derivative(all_near, x + X, left)) * X
            if X.contains(K):
                return list((x + K).entries())
            X = K
    return None


def with_rounding(a: Array, nothing: float = 0.0) -> Any:
    """A matrix of balls around entries with their rounding; those below `nothing` may be zero."""
    radii = np.where(np.abs(a) <= nothing, 1.0, ROUNDING) * np.abs(a)
    entries = zip(a.astype(complex).ravel().tolist(), radii.ravel().tolist(), strict=True)
    balls = [flint.acb(flint.arb(x.real, r), flint.arb(x.imag, r if x.imag else 0)) for x, r in entries]
    rows, columns = a.shape
    return flint.acb_mat(rows, columns, balls)


def _equation(A: Any, x: Any, left: Any) -> Any:
    """f (n + 1, 1) of an eigenpair x = (v, lambda)."""
    n = A.nrows()
    v, pole = flint.acb_mat(n, 1, x.entries()[:n]), x[n, 0]
    return flint.acb_mat(n + 1, 1, [*(A * v - v * pole).entries(), (left * v)[0, 0] - 1])


def _derivative(A: Any, x: Any, left: Any) -> Any:
    """J (n + 1, n + 1)."""
    n = A.nrows()
    rows = [[A[i, j] - (x[n, 0] if i == j else 0) for j in range(n)] + [-x[i, 0]] for i in range(n)]
    return flint.acb_mat([*rows, [*left.entries(), 0]])


def _identity(n: int) -> Any:
    return flint.acb_mat(n, n, [int(i == j) for i in range(n) for j in range(n)])


def _wider(ball: Any) -> Any:
    """A ball around zero that is twice as large as what contains another one."""
    size = 2 * abs(ball).upper()
    return flint.acb(flint.arb(0, size), flint.arb(0, size))
