"""A guaranteed bound of the size of an LFT on the whole box |delta_k| <= 1, deltas real and constant.

With w = Delta z, each block gives two facts for every real delta: z'D z - w'D w >= 0 and z'G w = 0, for
D = D' > 0 and G = -G'. So  |y|^2 <= g |u|^2  on the whole box if

    S = g [0 ; u]'[0 ; u] - y'y - (z'D z - w'D w + z'G w + w'G'z) > 0     as a quadratic form in (w, u).

Fan, Tits, Doyle, Robustness in the presence of mixed parametric uncertainty and unmodeled dynamics,
IEEE TAC 36 (1991). D and G are the symmetric and skew part of one matrix X for each block, and then the
last bracket is the symmetric part of (z - w)'X (z + w). The smallest g is found by a barrier method
(Boyd, Vandenberghe, Convex Optimization, 2004, chapter 11); however X was found, S > 0 is the proof,
and it is checked at the end with a margin for rounding. A box that resists is cut into two.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import LinAlgError, cho_factor, cho_solve

from mbdlft.base.array import Array
from mbdlft.exact.rounding import EPS
from mbdlft.lft.lft import LFT, check_plain, solve_nominal

_GAP = 0.01  # of g: how far from the best multipliers the search may stop
_VANISHED = 1e-16  # of the first g: below this the gain is taken for zero
_RAISE = 8.0  # factor of the weight of g from one center to the next
_NEWTON = 40  # steps to a center, at most
_CENTERED = 0.01  # square of the Newton decrement at which a center is near enough
_ENOUGH = 0.1  # of the fall that the slope promises
_NEAR = 1.5  # times the limit: a box whose bound is above this is not cut
_SHRINK = 40  # halvings of a step, at most
_GROWTH = 1e-3  # of the box: below this the search for well-posedness has come to its end
_LIFT = 1e-13  # of the curvature: the least that is added to it
_SMALL = 1e-6  # weight of |X|^2/2 in the objective: keeps multipliers that do nothing bounded


class _Form(NamedTuple):
    """S(g, X) = g E - Q - sym(U'X V), with E the identity on the last `inputs` entries.

    `rows` and `columns` are the places of the entries of X that are free: those inside the blocks.
    """

    U: Array
    V: Array
    Q: Array
    inputs: int
    rows: NDArray[np.int64]
    columns: NDArray[np.int64]

    def matrix(self, g: float, X: Array) -> Array:
        S = self.U.T @ X @ self.V
        S = -0.5 * (S + S.T) - self.Q
        last = np.arange(len(S) - self.inputs, len(S))
        S[last, last] += g
        return S


class Bound(NamedTuple):
    """An upper bound of the gain on a box, and what narrowing each block would take off it [1]."""

    gain: float
    slope: Array


def gain_bound(a: LFT, limit: float = np.inf, boxes: int = 1) -> float:
    """Upper bound of the largest singular value of the value of an LFT on the box |delta_k| <= 1.

    `limit` is the bound that is wanted: no box is cut whose bound is not above it, and a larger bound
    may be given as inf. So many boxes may be looked at, the first included. It is inf if no bound was
    found; otherwise I - M11 Delta is proved to be invertible on the box.
    """
    check_plain(a, "the bound of the gain")
    gain, waiting = 0.0, [a]
    for _ in range(boxes):
        if not waiting:
            return gain
        box = waiting.pop()
        bound = box_bound(box, _NEAR * limit)
        if bound.gain <= limit:
            gain = max(gain, bound.gain)
            continue
        sizes = [block.size for block in a.blocks]
        worst = int(np.argmax(bound.slope)) if sizes else 0
        if not sizes or bound.slope[worst] <= 0.0:
            return np.inf
        for side in (-0.5, 0.5):
            center, half = np.zeros(len(sizes)), np.ones(len(sizes))
            center[worst], half[worst] = side, 0.5
            waiting.append(restrict(box, center, half))
    return np.inf if waiting else gain


def restrict(a: LFT, center: Array, half: Array) -> LFT:
    """The LFT with delta_k replaced by center_k + half_k delta_k; both (number of blocks,) [1]."""
    sizes = [block.size for block in a.blocks]
    c, h = np.repeat(center, sizes), np.repeat(half, sizes)
    z = solve_nominal(
        np.eye(a.order) - a.M11 * c, np.hstack([a.M11 * h, a.M12]), "an LFT on a part of its range"
    )
    total = np.hstack([a.M21 * h, a.M22]) + (a.M21 * c) @ z
    n = a.order
    return LFT(z[:, :n], z[:, n:], total[:, :n], total[:, n:], a.blocks)


def box_bound(a: LFT, limit: float = np.inf) -> Bound:
    """The bound by one pair of multipliers for the whole box; inf if it is above `limit`."""
    n = a.order
    if not n or not a.M22.size:
        size = float(np.linalg.norm(a.M22, 2)) if a.M22.size else 0.0
        return Bound(size * (1.0 + 16.0 * EPS), np.zeros(len(a.blocks)))
    X, rho, P = _well_posed(a)
    if rho < 1.0:
        return Bound(np.inf, _slope(a, X, P))
    Z, W = np.hstack([a.M11, a.M12]), np.eye(n, n + a.shape[1])
    Y = np.hstack([a.M21, a.M22])
    form = _Form(Z - W, Z + W, Y.T @ Y, a.shape[1], *_places(a))
    # a multiple of X for which S > 0 with some g
    inner = form.matrix(0.0, X) + form.Q
    need = a.M21 @ np.linalg.solve(inner[:n, :n], a.M21.T)
    X = X * 2.0 * max(float(np.linalg.norm(need, 2)), EPS)
    S = form.matrix(0.0, X)
    g = 2.0 * float(np.max(np.abs(S[n:, :n] @ np.linalg.solve(S[:n, :n], S[:n, n:]) - S[n:, n:])))
    g = g * a.shape[1] + EPS
    count = len(S) + n  # the parameter of the barrier
    weight, least = count / g, _VANISHED * g
    while True:
        X, g, P = _center(form, X, g, weight)
        if g - 2.0 * count / weight > limit * limit:  # the best g cannot be far below
            return Bound(np.inf, _slope(a, X, P))
        if count / weight <= _GAP * g or g <= least:
            break
        weight *= _RAISE
    gain = np.sqrt(g) if proved(form, g, X) else np.inf
    return Bound(float(gain) if gain <= limit else np.inf, _slope(a, X, P))


def proved(form: _Form, g: float, X: Array) -> bool:
    """Whether S(g, X) > 0 and X + X' > 0 whatever rounding did to the computed S."""
    S = form.matrix(g, X)
    terms = np.abs(form.U).T @ np.abs(X) @ np.abs(form.V) + np.abs(form.Q) + g * np.eye(len(S))
    margin = 4.0 * len(S) * EPS * float(np.linalg.norm(terms))
    blocks = X + X.T
    least = float(np.linalg.eigvalsh(blocks)[0])
    rounding = len(X) * EPS * float(np.linalg.norm(blocks))
    return bool(np.linalg.eigvalsh(S)[0] > margin and least > rounding)


def _places(a: LFT) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Rows and columns of the entries of a block-diagonal matrix."""
    sizes = [block.size for block in a.blocks]
    owner = np.repeat(np.arange(len(sizes)), sizes)
    rows, columns = np.nonzero(owner[:, None] == owner)
    return rows, columns


def _well_posed(a: LFT) -> tuple[Array, float, Array]:
    """X that proves I - M11 Delta regular on |delta_k| <= rho, the rho it grew to, and S^-1."""
    n = a.order
    eye, places = np.eye(n), _places(a)
    X, rho = np.eye(n), 0.0
    while True:

        def form(size: float) -> _Form:
            return _Form(size * a.M11 - eye, size * a.M11 + eye, np.zeros((n, n)), 0, *places)

        low, high = rho, 1.0
        if _cholesky(form(1.0).matrix(0.0, X)) is not None:
            return X, 1.0, eye
        while high - low > 0.1 * _GROWTH + 0.1 * (low - rho):
            middle = 0.5 * (low + high)
            if _cholesky(form(middle).matrix(0.0, X)) is not None:
                low = middle
            else:
                high = middle
        step = 0.9 * (low - rho)
        rho += step
        X, _, P = _center(form(rho), X, 0.0, 1.0)
        if step < _GROWTH:
            return X, rho, P


def _center(form: _Form, X: Array, g: float, weight: float) -> tuple[Array, float, Array]:
    """Minimum of weight (g + small |X|^2/2) - log det S - log det(X + X'), and S^-1."""
    i, j, m = form.rows, form.columns, form.inputs
    spring = weight * (_SMALL if m else 1.0)

    def objective(g: float, X: Array) -> float:
        outer, inner = _cholesky(form.matrix(g, X)), _cholesky(X + X.T)
        if outer is None or inner is None:
            return np.inf
        diagonals = np.concatenate([np.diagonal(outer), np.diagonal(inner)])
        logarithms = float(np.sum(np.log(diagonals)))
        return weight * g * bool(m) + 0.5 * spring * float(np.sum(X * X)) - 2.0 * logarithms

    P = np.asarray(np.linalg.inv(form.matrix(g, X)), dtype=float)
    for _ in range(_NEWTON):
        R = np.linalg.inv(X + X.T)
        UP, VP = form.U @ P, form.V @ P
        cross = (VP @ form.U.T)[np.ix_(j, i)]
        diagonal_blocks = R[np.ix_(j, i)]
        count = len(i)
        H = np.zeros((count + 1, count + 1))
        H[:count, :count] = 0.5 * (
            cross * cross.T + (UP @ form.U.T)[np.ix_(i, i)] * (VP @ form.V.T)[np.ix_(j, j)]
        ) + 2.0 * (diagonal_blocks * diagonal_blocks.T + R[np.ix_(i, i)] * R[np.ix_(j, j)])
        H[np.arange(count), np.arange(count)] += spring
        slope = np.zeros(count + 1)
        slope[:count] = ((UP @ form.V.T) - 2.0 * R + spring * X)[i, j]
        H[count, count] = 1.0
        if m:
            slope[count] = weight - np.trace(P[-m:, -m:])
            H[count, count] = np.sum(P[-m:, -m:] ** 2)
            H[count, :count] = H[:count, count] = -(UP[:, -m:] @ VP[:, -m:].T)[i, j]
        step = newton_step(H, slope)
        fall = float(-slope @ step)
        move = np.zeros_like(X)
        move[i, j] = step[:count]
        value, length = objective(g, X), 1.0
        for _ in range(_SHRINK):
            new, new_g = X + length * move, g + length * float(step[count]) * bool(m)
            if objective(new_g, new) <= value - _ENOUGH * length * fall:
                break
            length *= 0.5
        else:
            break  # as near to the center as rounding allows
        X, g = new, new_g
        P = np.asarray(np.linalg.inv(form.matrix(g, X)), dtype=float)
        if fall < _CENTERED:
            break
    return X, g, P


def newton_step(H: Array, slope: Array) -> Array:
    """-H^-1 slope. A skew part that does nothing leaves H singular, so it is lifted until it is not."""
    if not np.all(np.diagonal(H) > 0.0):
        return np.zeros(len(H))  # rounding has eaten the curvature: there is nothing more to gain
    scale = 1.0 / np.sqrt(np.diagonal(H))
    scaled, lift = scale[:, None] * H * scale, _LIFT
    while True:
        lifted = scaled.copy()
        np.fill_diagonal(lifted, 1.0 + lift)
        try:
            factor = cho_factor(lifted, lower=True, overwrite_a=True, check_finite=False)
        except LinAlgError:
            lift *= _RAISE
            continue
        return np.asarray(-scale * cho_solve(factor, scale * slope))


def _slope(a: LFT, X: Array, P: Array) -> Array:
    """How much each block adds: the derivative of -log det S in the width of its interval."""
    Z = np.hstack([a.M11, a.M12])[:, : len(P)]
    W = np.eye(a.order, len(P))
    D, G = 0.5 * (X + X.T), 0.5 * (X - X.T)
    share = np.sum((D @ Z) * (Z @ P), axis=1) + np.sum((G @ W) * (Z @ P), axis=1)
    return np.array([float(np.sum(share[rows])) for rows in a.slices().values()])


def _cholesky(matrix: Array) -> Array | None:
    """The factor, or None if the matrix is not positive definite."""
    try:
        return np.asarray(np.linalg.cholesky(matrix), dtype=float)
    except np.linalg.LinAlgError:
        return None
