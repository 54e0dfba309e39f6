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

The matrix inequalities are solved by Clarabel, and what it finds is checked in balls: tr P_xx + tr X is
fixed, and t is the largest such that the form is below -t. There is always a solution, and t > 0 tells
whether it proves anything. Goulart, Chen, Clarabel: an interior-point solver for conic programs, arXiv
2405.12762 (2024).
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import flint
import numpy as np
import scipy.linalg
from numpy.typing import NDArray
from scipy import sparse

from mbdlft.base.array import Array
from mbdlft.robust.balls import balls, is_positive
from mbdlft.robust.bisect.characteristic import Realization

BITS = 192  # of balls: products of three doubles are exact
Index = NDArray[np.int64]
_FLOOR = 1e-3  # times t: X is above this
_EDGE = 1e-6  # of the form, where the least gain is asked for
_CHUNK = 2**22  # entries of dense coefficients at once
# units of work of a solution; for each of its rows cubed; and times entries that are not zero
_CALL, _ROWS, _ENTRIES = 0.05, 3.0e-10, 3.0e-8


class Form(NamedTuple):
    """Rows of what the form is made of, each times q (N,)."""

    V: Array  # (n + n_s, N): [x; zeta]
    W: Array  # (n + n_s, N): its derivative
    S: Array  # (m, N): what Delta and its derivative give: w, zeta if it is another one, a, b
    R: Array  # (m, N): what they get is R + K W
    K: Array  # (m, n + n_s)
    group: NDArray[np.int64]  # (m,): the parameter; beyond the number of parameters, its rate
    y: Array  # (n_y, N)
    u: Array  # (n_u, N)


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
    slow_rows = slow_fed[:0] if merged else slow_fed
    K = np.zeros((r + len(slow_rows) + len(slow) + len(moving), n + len(slow)))
    K[r + len(slow_rows) : r + len(slow_rows) + len(slow)] = np.hstack(
        [model.C[slow], model.D[np.ix_(slow, slow)]]
    )
    q = len(model.sizes)
    group = [owner, owner[slow][: len(slow_rows)], owner[slow], q + owner[moving]]
    return Form(
        V=np.vstack([x, zeta]),
        W=np.vstack([model.A @ x + model.B @ w + model.E @ u, rises]),
        S=np.vstack([w, zeta[: len(slow_rows)], a, b]),
        R=np.vstack([fed, slow_rows, 0.0 * a, slow_fed[np.searchsorted(slow, moving)]]),
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
        all(np.all(np.isfinite(matrix)) for matrix in (P, X, Y))
        and np.array_equal(P, P.T)
        and np.array_equal(X, X.T)
        and np.array_equal(Y, -Y.T)
        and not np.any(X[apart])
        and not np.any(Y[apart])
    )


def is_negative(form: Form, sizes: Array, gain: float, L: Array, P: Array, X: Array, Y: Array) -> bool:
    """Whether the form is proved to be negative definite, and X positive; `gain` is 0 for stability.

    P is that of L x and zeta. The form is looked at in the states L x: what turns them back into x may be
    anything, since a definite form in them shows that it is regular.
    """
    try:
        back = _beside(np.asarray(np.linalg.inv(L)), form.V.shape[1] - len(L))
    except np.linalg.LinAlgError:
        return False
    with flint.ctx.workprec(BITS):
        turn, states = balls(back), balls(_beside(L, len(form.V) - len(L)))
        V, W, S, R = (balls(rows) * turn for rows in form[:4])
        Z = balls(np.diag(sizes)) * (R + balls(form.K) * W)
        V, W = states * V, states * W
        middle = V.transpose() * balls(P) * W + Z.transpose() * balls(Y) * S
        weight = balls(X)
        whole = middle + middle.transpose()
        whole = whole + Z.transpose() * weight * Z - S.transpose() * weight * S
        if gain:
            y, u = balls(form.y) * turn, balls(form.u) * turn
            square = flint.arb(gain) * flint.arb(gain)
            whole = whole + y.transpose() * y - u.transpose() * u * square
        return is_positive(-whole) and all(
            is_positive(balls(X[np.ix_(group, group)])) for group in groups_of(form)
        )


def _beside(L: Array, more: int) -> Array:
    """L with ones behind it on the diagonal."""
    extended = np.eye(len(L) + more)
    extended[: len(L), : len(L)] = L
    return extended


def groups_of(form: Form) -> list[NDArray[np.int64]]:
    """Rows of S that belong together."""
    return [np.flatnonzero(form.group == g) for g in np.unique(form.group)]


class Unknowns(NamedTuple):
    """P (n + n_s, n + n_s), X (m, m), Y (m, m), up to a common factor, and t."""

    P: Array
    X: Array
    Y: Array
    t: float


class Places(NamedTuple):
    """Rows and columns (2, .) of the unknown entries, above the diagonal or on it."""

    P: Index
    X: Index
    Y: Index

    @property
    def ends(self) -> Index:
        """Where the unknowns of P, X, Y end."""
        return np.cumsum([where.shape[1] for where in self])


def places_of(form: Form) -> Places:
    """The unknown entries."""
    same = form.group[:, None] == form.group
    X, Y = (np.array(np.nonzero(np.triu(same, k))) for k in (0, 1))
    return Places(np.array(np.triu_indices(len(form.V))), X, Y)


def cost_of(form: Form) -> float:
    """Units of work of one solution: the factors of the solver, and what entries of the form fill."""
    N, places = form.V.shape[1], places_of(form)
    rows = 0.5 * N * (N + 1) + places.X.shape[1]
    W, Z = (
        np.count_nonzero(each, axis=1)
        for each in (form.W, np.abs(form.R) + np.abs(form.K) @ np.abs(form.W))
    )
    (i, j), (k, m), (a, b) = places
    entries = np.sum(W[i] + W[j]) + np.sum(Z[k] * Z[m]) + np.sum(Z[a] + Z[b])
    return float(_CALL + _ROWS * rows**3 + _ENTRIES * rows * entries)


def solved(form: Form, sizes: Array, states: int, gain: float = 0.0) -> Unknowns | None:
    """Unknowns with the form far below zero, if t > 0; None if the solver gave up.

    With the bound of a gain, P, X and Y have the size that they must have; it is 0 for stability.
    """
    places, N = places_of(form), form.V.shape[1]
    t = sparse.csc_matrix(vectors(np.eye(N)[None]).T)
    columns = sparse.hstack([_coefficients(form, sizes, places, gain), t])
    trace = np.append(_traces(places, states), [1.0, 0.0] if gain else [0.0])
    cost = np.zeros(len(trace))
    cost[-1] = -1.0
    total = trace, float(states + len(form.S))
    values = _solution(form, cost, columns, np.zeros((N, N)), places.ends[0], _FLOOR, total)
    return None if values is None else _unpacked(form, values, places, with_gain=gain > 0.0)


def around_nominal(form: Form, A: Array, B: Array, rates: Array) -> tuple[Array, Array, Array, float]:
    """P, X and Y of a form that is negative for small boxes, and a size of which that may be true.

    P is constant, A'P + P A = -1: 2 x'P B w <= |x|^2/2 + 2 |P B|^2 |w|^2. X is 4 |P B|^2 for w, and so
    small for what else Delta gives that bounds of rates take little of x and w.
    """
    n, m, count = len(A), len(form.S), B.shape[1]
    P, X = np.zeros((len(form.V), len(form.V))), np.zeros(m)
    solution = scipy.linalg.solve_continuous_lyapunov(A.T, -np.eye(n))
    P[:n, :n] = 0.5 * (solution + solution.T)
    X[:count] = 4.0 * float(np.linalg.norm(P[:n, :n] @ B, 2)) ** 2
    fed = sizes_of(form, 1.0, rates)[:, None] * (form.R + form.K @ form.W)
    X[count:] = 0.1 * min(1.0, X[0]) / max(1.0, float(np.linalg.norm(fed[count:])) ** 2)
    largest = float(np.linalg.norm(form.R[:count], 2)) * np.sqrt(max(1.0, X[0]))
    return P, np.diag(X), np.zeros((m, m)), 1.0 / largest if largest else np.inf


def least_gain(form: Form, sizes: Array, states: int) -> float:
    """Nearly the least gain for which there are unknowns, for a gain near 1; inf if none was found."""
    places = places_of(form)
    supplied = sparse.csc_matrix(vectors(-(form.u.T @ form.u)[None]).T)
    columns = sparse.hstack([_coefficients(form, sizes, places, 0.0), supplied])
    side = _EDGE * np.eye(form.V.shape[1]) + form.y.T @ form.y
    cost = np.append(0.1 * _EDGE * _traces(places, states), 1.0)
    values = _solution(form, cost, columns, side, places.ends[0])
    return float(np.sqrt(values[-1])) if values is not None and values[-1] > 0.0 else float("inf")


def least_level(form: Form, sizes: Array, P: Array) -> tuple[float, Array, Array] | None:
    """Nearly the least g, with X and Y, for which y'y - g V'P V and the part of X and Y is negative.

    None if the solver gave up.
    """
    places = places_of(form)
    first = int(places.ends[0])
    level = sparse.csc_matrix(vectors(-(form.V.T @ P @ form.V)[None]).T)
    columns = sparse.hstack([_coefficients(form, sizes, places, 0.0)[:, first:], level])
    cost = np.zeros(columns.shape[1])
    cost[-1] = 1.0
    values = _solution(form, cost, columns, form.y.T @ form.y, 0)
    if values is None or not values[-1] > 0.0:
        return None
    unknowns = np.concatenate([np.zeros(first), values[:-1], [0.0]])
    solution = _unpacked(form, unknowns, places, with_gain=False)
    return None if solution is None else (float(values[-1]), solution.X, solution.Y)


def _solution(
    form: Form,
    cost: Array,
    columns: Any,
    side: Array,
    first: int,
    floor: float = 0.0,
    total: tuple[Array, float] | None = None,
) -> Array | None:
    """The x of least cost with side + columns x <= 0, X >= floor x[-1], and a total; or None.

    The entries of X begin at x[first]; the total of x with some weights is a number. None: the solver
    gave up.
    """
    import clarabel  # here because it is slow to import

    groups, X = groups_of(form), places_of(form).X
    blocks = [columns, *(_selected(group, X, first, len(cost), floor) for group in groups)]
    b = np.zeros(sum(block.shape[0] for block in blocks))
    b[: columns.shape[0]] -= vectors(side[None])[0]
    cones = [clarabel.PSDTriangleConeT(size) for size in (len(side), *map(len, groups))]
    if total is not None:
        blocks.insert(0, sparse.csc_matrix(total[0][None]))
        b, cones = np.append(total[1], b), [clarabel.ZeroConeT(1), *cones]
    values = np.array(conic_solution(cost, sparse.vstack(blocks), b, cones).x)
    return values if np.all(np.isfinite(values)) else None


def conic_solution(
    cost: Array,
    rows: Any,
    b: Array,
    cones: Sequence[Any],
    quadratic: Array | None = None,
    iterations: int | None = None,
) -> Any:
    """What Clarabel finds of least x'P x/2 + cost x with b - rows x in cones, in one thread.

    `quadratic` is the upper triangle of P; nothing: P = 0.
    """
    import clarabel  # here because it is slow to import

    settings = clarabel.DefaultSettings()
    settings.verbose, settings.max_threads = False, 1
    if iterations is not None:
        settings.max_iter = iterations
    P = sparse.csc_matrix((len(cost), len(cost)) if quadratic is None else quadratic)
    return clarabel.DefaultSolver(P, cost, sparse.csc_matrix(rows), b, cones, settings).solve()


def _traces(places: Places, states: int) -> Array:
    """1 for unknowns on the diagonals of P_xx and X, else 0."""
    of_P = (places.P[0] == places.P[1]) & (places.P[0] < states)
    return np.concatenate([of_P, places.X[0] == places.X[1], np.zeros(places.Y.shape[1])])


def _unpacked(form: Form, values: Array, places: Places, *, with_gain: bool) -> Unknowns | None:
    m, size = len(form.S), len(form.V)
    P, X, Y = np.zeros((size, size)), np.zeros((m, m)), np.zeros((m, m))
    p, x, y, scalars = np.split(values, places.ends)
    unknowns = ((P, places.P, p, 1.0), (X, places.X, x, 1.0), (Y, places.Y, y, -1.0))
    for matrix, where, entries, sign in unknowns:
        matrix[where[1], where[0]] = sign * entries
        matrix[where[0], where[1]] = entries
    weight = float(scalars[0]) if with_gain else 1.0
    return Unknowns(P / weight, X / weight, Y / weight, float(scalars[-1])) if weight > 0.0 else None


def _coefficients(form: Form, sizes: Array, places: Places, gain: float) -> Any:
    """Derivatives of the form by the unknowns, as columns of its entries."""
    V, W, S = form.V, form.W, form.S
    Z = sizes[:, None] * (form.R + form.K @ W)

    def of_P(i: Index, j: Index) -> Array:
        return (_outer(V[i], W[j]) + _outer(V[j], W[i])) * _half(i, j)

    def of_X(i: Index, j: Index) -> Array:
        return (_outer(Z[i], Z[j]) - _outer(S[i], S[j])) * _half(i, j)

    def of_Y(i: Index, j: Index) -> Array:
        return _outer(Z[i], S[j]) - _outer(Z[j], S[i])

    made = ((of_P, places.P), (of_X, places.X), (of_Y, places.Y))
    columns = [_columns(make, where, V.shape[1]) for make, where in made]
    if gain:
        supplied = form.y.T @ form.y - gain**2 * form.u.T @ form.u
        columns.append(sparse.csc_matrix(vectors(supplied[None]).T))
    return sparse.hstack(columns)


def _columns(make: Callable[[Index, Index], Array], where: Index, N: int) -> Any:
    """Columns of the symmetric parts of what is made for pairs of rows and columns."""
    step = max(1, _CHUNK // (N * N))
    columns = [sparse.csc_matrix((N * (N + 1) // 2, 0))]
    for start in range(0, where.shape[1], step):
        matrices = make(*where[:, start : start + step])
        columns.append(sparse.csc_matrix(vectors(matrices + np.swapaxes(matrices, 1, 2)).T))
    return sparse.hstack(columns)


def _outer(a: Array, b: Array) -> Array:
    return a[:, :, None] * b[:, None, :]


def _half(i: Index, j: Index) -> Array:
    return np.where(i == j, 0.5, 1.0)[:, None, None]


def vectors(matrices: Array) -> Array:
    """Symmetric matrices (k, N, N) as vectors (k, N (N + 1)/2) with the same inner product."""
    columns, rows = np.tril_indices(matrices.shape[1])
    return matrices[:, rows, columns] * np.where(rows == columns, 1.0, np.sqrt(2.0))


def _selected(group: Index, X: Index, first: int, count: int, floor: float) -> Any:
    """Minus the entries of X of one group, of all unknowns, and a floor of the last times 1."""
    columns, rows = np.tril_indices(len(group))
    inside = np.flatnonzero(np.isin(X[0], group))
    order = np.lexsort((X[0][inside], X[1][inside]))  # by columns, as in `vectors`
    weights = -np.where(rows == columns, 1.0, np.sqrt(2.0))
    at = np.arange(len(inside))
    diagonal = at[rows == columns] if floor else at[:0]
    values = np.append(weights, np.full(len(diagonal), floor))
    last = np.full(len(diagonal), count - 1)
    where = np.append(at, diagonal), np.append(first + inside[order], last)
    return sparse.csc_matrix((values, where), shape=(len(inside), count))
