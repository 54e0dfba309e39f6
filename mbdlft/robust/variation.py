"""What proves stability, or a gain, for parameters that move: a quadratic form that is negative.

With w = Delta(t) z, z = C x + D w, let zeta = Delta_s (C_s x + D_ss zeta) be the channels of the
parameters whose rates are bounded. The function

    V = [x; zeta]' P [x; zeta] = x' P(Delta_s) x

is a rational function of these parameters, a constant one of the others. Its derivative needs

    zeta' = a + b,   a = Delta_s (C_s x' + D_ss zeta'),   b = Delta_s' (C_s x + D_ss zeta),

so all is quadratic in q = (x, w, zeta, a, b, u), and Delta and Delta' enter as s = Delta z and
b = Delta' z only. For a repeated real scalar with |delta| <= k,

    k^2 z'X z - s'X s + k (z'Y s - s'Y z) >= 0     for X = X' > 0, Y = -Y',

(D and G of real parameters: Fan, Tits, Doyle, IEEE TAC 36, 1991; for any motion, as X and Y are real and
constant). If the sum of V' and of these is negative definite in q, then

- Delta is well posed on the box: if I - D Delta were singular, a q of a alone, or of w and the a that
  follows from it, would make V' zero and the others not negative;
- P(Delta) > 0 on the box: it is at 0, where A is Hurwitz, and it is singular nowhere, as A'P + P A < 0;
- V falls along each motion: the system is exponentially stable. With y'y - gamma^2 u'u added, the energy
  of the output is at most gamma^2 times that of the input.

Rational functions V in this way: Dettori, Scherer, CDC 2000; Koroglu, Scherer, IEEE TAC 52 (2007).
"""

from typing import Any, NamedTuple

import flint
import numpy as np
from numpy.typing import NDArray

from mbdlft.base.array import Array
from mbdlft.robust.characteristic import Realization

_BITS = 192


class Form(NamedTuple):
    """Rows of what the form is made of, each times q (N,).

    Attributes
    ----------
    V, W : array (n + n_s, N)
        [x; zeta], and its derivative.
    S : array (m, N)
        What Delta and its derivative give: w, zeta if it is another one, a, b.
    R, K : array (m, N), (m, n + n_s)
        What they get is R + K W.
    group : int array (m,)
        The parameter; beyond the number of parameters, its rate.
    y, u : array (n_y, N), (n_u, N)
    """

    V: Array
    W: Array
    S: Array
    R: Array
    K: Array
    group: NDArray[np.int64]
    y: Array
    u: Array


def scaled(model: Realization, channels: Array, time: float) -> Realization:
    """The model with z/channels, w/channels and the time t * time: powers of two, nothing is rounded."""
    return model._replace(
        A=model.A / time,
        B=model.B * channels / time,
        C=model.C / channels[:, None],
        D=model.D * channels / channels[:, None],
        E=model.E / time,
        F=model.F / channels[:, None],
        H=model.H * channels,
    )


def form_of(model: Realization, rates: Array) -> Form:
    """The form for rates of the deltas (number of deltas,): 0, a bound (1/s), or inf."""
    owner = np.repeat(np.arange(len(model.sizes)), model.sizes)
    rate = np.asarray(rates, dtype=float)[owner]
    slow, fast = np.flatnonzero(np.isfinite(rate)), np.flatnonzero(np.isinf(rate))
    moving = np.flatnonzero(np.isfinite(rate) & (rate > 0.0))
    n, r, n_u = len(model.A), len(owner), model.E.shape[1]
    merged = not (np.any(model.D[np.ix_(slow, fast)]) or np.any(model.F[slow]))
    counts = (n, r, 0 if merged else len(slow), len(slow), len(moving), n_u)
    ends = np.cumsum(counts)
    eye = np.eye(int(ends[-1]))
    x, w, zeta, a, b, u = (eye[end - count : end] for end, count in zip(ends, counts, strict=True))
    if merged:
        zeta = w[slow]
    fed = model.C @ x + model.D @ w + model.F @ u  # rows of zeros and ones: nothing is rounded
    slow_fed = model.C[slow] @ x + model.D[np.ix_(slow, slow)] @ zeta
    rises = a.copy()
    rises[np.searchsorted(slow, moving)] += b
    own = slow_fed[:0] if merged else slow_fed
    K = np.zeros((r + len(own) + len(slow) + len(moving), n + len(slow)))
    K[r + len(own) : r + len(own) + len(slow)] = np.hstack(
        [model.C[slow], model.D[np.ix_(slow, slow)]]
    )
    q = len(model.sizes)
    group = [owner, owner[slow][: len(own)], owner[slow], q + owner[moving]]
    return Form(
        V=np.vstack([x, zeta]),
        W=np.vstack([model.A @ x + model.B @ w + model.E @ u, rises]),
        S=np.vstack([w, zeta[: len(own)], a, b]),
        R=np.vstack([fed, own, 0.0 * a, slow_fed[np.searchsorted(slow, moving)]]),
        K=K,
        group=np.concatenate(group).astype(np.int64),
        y=model.G @ x + model.H @ w + model.J @ u,
        u=u,
    )


def sizes_of(form: Form, k: float, rates: Array) -> Array:
    """Bounds of |delta| or of its rate, for each row of S (m,)."""
    q = len(rates)
    return np.array([k if g < q else rates[g - q] for g in form.group], dtype=float)


def is_structured(form: Form, P: Array, X: Array, Y: Array) -> bool:
    """Whether P and X are symmetric and Y is skew, and X and Y mix nothing but one parameter."""
    m, size = len(form.S), len(form.V)
    if P.shape != (size, size) or X.shape != (m, m) or Y.shape != (m, m):
        return False
    apart = form.group[:, None] != form.group
    return bool(
        all(np.all(np.isfinite(part)) for part in (P, X, Y))
        and np.array_equal(P, P.T)
        and np.array_equal(X, X.T)
        and np.array_equal(Y, -Y.T)
        and not np.any(X[apart])
        and not np.any(Y[apart])
    )


def is_negative(
    form: Form, sizes: Array, gain: float, L: Array, P: Array, X: Array, Y: Array
) -> bool:
    """Whether the form is proved to be negative definite, and X positive; `gain` is 0 for stability.

    P is that of L x and zeta. The form is looked at in the states L x: what turns them back into x may be
    anything, since a definite form in them shows that it is regular.
    """
    try:
        back = _beside(np.asarray(np.linalg.inv(L)), form.V.shape[1] - len(L))
    except np.linalg.LinAlgError:
        return False
    with flint.ctx.workprec(_BITS):
        turn, states = _balls(back), _balls(_beside(L, len(form.V) - len(L)))
        V, W, S, R = (_balls(part) * turn for part in form[:4])
        Z = _balls(np.diag(sizes)) * (R + _balls(form.K) * W)
        V, W = states * V, states * W
        middle = V.transpose() * _balls(P) * W + Z.transpose() * _balls(Y) * S
        weight = _balls(X)
        whole = middle + middle.transpose()
        whole = whole + Z.transpose() * weight * Z - S.transpose() * weight * S
        if gain:
            y, u = _balls(form.y) * turn, _balls(form.u) * turn
            square = flint.arb(gain) * flint.arb(gain)
            whole = whole + y.transpose() * y - u.transpose() * u * square
        return is_positive(-whole) and all(
            is_positive(_balls(X[np.ix_(own, own)])) for own in groups_of(form)
        )


def _beside(L: Array, more: int) -> Array:
    """L with ones behind it on the diagonal."""
    found = np.eye(len(L) + more)
    found[: len(L), : len(L)] = L
    return found


def groups_of(form: Form) -> list[NDArray[np.int64]]:
    """Rows of S that belong together."""
    return [np.flatnonzero(form.group == g) for g in np.unique(form.group)]


def _balls(a: Array) -> Any:
    return flint.arb_mat(a.shape[0], a.shape[1], a.ravel().tolist())


def is_positive(matrix: Any) -> bool:
    """Whether a symmetric matrix of balls is positive definite: L M L' is dominated by its diagonal.

    L is the inverse of a factor in doubles; it may be anything.
    """
    n = matrix.nrows()
    if not n:
        return True
    middle = np.array([[float(matrix[i, j].mid()) for j in range(n)] for i in range(n)])
    diagonal = np.diagonal(middle)
    if not np.all(diagonal > 0.0):
        return False
    scale = 2.0 ** np.round(-0.5 * np.log2(diagonal))
    try:
        factor = np.linalg.cholesky(scale[:, None] * middle * scale)
    except np.linalg.LinAlgError:
        return False
    L = _balls(np.linalg.inv(factor) * scale)
    near_one = L * matrix * L.transpose()
    for i in range(n):
        others = sum((abs(near_one[i, j]) for j in range(n) if j != i), flint.arb(0))
        if not near_one[i, i] > others:
            return False
    return True
