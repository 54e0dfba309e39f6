"""Dense quadratic programs of the steps of a descent: some 80 unknowns, and as many bounds.

Least x'P x/2 + c x with G x <= h and |x_k| <= most_k, by Mehrotra's predictor and corrector (SIAM Journal
on Optimization 2, 1992): with slacks s and multipliers z, of rows and bounds together, a step solves

    (P + G'W G) dx = ...,    W = diag(z/s),

where bounds add to the diagonal only.
"""

from collections.abc import Sequence

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from mbdlft.base.array import Array

_ITERATIONS = 60
_CLOSE = 1e-9  # of what is larger than 1 beside it: residuals and gap at the end
_INSIDE = 0.995  # of the way to where a slack or a multiplier is zero


def least_quadratic(P: Array, cost: Array, G: Array, h: Array, most: Array) -> tuple[Array, Array]:
    """Where x'P x/2 + cost x is least (n,), and the multipliers (k,) of rows G x <= h.

    `most` (n,) are bounds of |x|, or infinite. What is reached, where no end is; NaN where nothing is.
    """
    near, m = np.flatnonzero(np.isfinite(most)), len(G)
    upper, lower = slice(m, m + len(near)), slice(m + len(near), None)
    h = np.concatenate([h, most[near], most[near]])

    def rows(x: Array) -> Array:
        return np.concatenate([G @ x, x[near], -x[near]])

    def columns(z: Array) -> Array:
        sums = G.T @ z[:m]
        sums[near] += z[upper] - z[lower]
        return np.asarray(sums)

    def factors(weights: Array) -> tuple[Array, bool]:
        whole = P + (G.T * weights[:m]) @ G
        whole[near, near] += weights[upper] + weights[lower]
        if not np.all(np.isfinite(whole)):  # some kernels of LAPACK do not see it
            raise np.linalg.LinAlgError
        made: tuple[Array, bool] = cho_factor(whole, check_finite=False)
        return made

    def toward(L: tuple[Array, bool], right: Array, here: Sequence[Array]) -> tuple[Array, Array, Array]:
        s, z, primal, dual = here
        dx = cho_solve(L, columns((right - z * primal) / s) - dual, check_finite=False)
        ds = -primal - rows(dx)
        return dx, ds, -(right + z * ds) / s

    try:
        x = cho_solve(factors(np.ones(len(h))), columns(h) - cost, check_finite=False)
    except np.linalg.LinAlgError:  # slopes are not finite
        return np.full(len(cost), np.nan), np.zeros(m)
    room = h - rows(x)
    s, z = room + max(0.0, -1.5 * np.min(room)), max(0.0, 1.5 * np.max(room)) - room
    s, z = s + 0.5 * (s @ z) / np.sum(z), z + 0.5 * (s @ z) / np.sum(s)
    for _ in range(_ITERATIONS):
        Px, primal, gap = P @ x, rows(x) + s - h, float(s @ z)
        dual = Px + cost + columns(z)
        pairs = (np.max(np.abs(primal)), np.max(np.abs(h))), (np.max(np.abs(dual)), np.max(np.abs(cost)))
        value = abs(float(cost @ x + 0.5 * x @ Px))
        if all(size <= _CLOSE * max(1.0, beside) for size, beside in (*pairs, (gap, value))):
            break
        try:
            L = factors(z / s)
        except np.linalg.LinAlgError:
            break
        here = s, z, primal, dual
        _, ds, dz = toward(L, s * z, here)
        length = min(_length(s, ds), _length(z, dz))
        ahead = float((s + length * ds) @ (z + length * dz)) / gap
        dx, ds, dz = toward(L, s * z + ds * dz - ahead**3 * gap / len(s), here)
        length = min(1.0, _INSIDE * min(_length(s, ds), _length(z, dz)))
        x, s, z = x + length * dx, s + length * ds, z + length * dz
    return x, z[:m]


def _length(values: Array, step: Array) -> float:
    """The part of a step, 1 at most, at which the first of positive values is zero."""
    falls = step < 0.0
    return float(np.min(-values[falls] / step[falls], initial=1.0))
