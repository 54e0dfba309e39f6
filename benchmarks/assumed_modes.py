"""The rival of the two-port model on the rotatory spacecraft: assumed modes, in 50 digits.

The displacement of an appendage is (r + x) theta + sum phi_j(x) q_j with the functions of equation (6.18)
of J. A. Perez, PhD thesis (ISAE, Toulouse, 2016),

    phi_j = 1 - cos(j pi x/L) + (-1)^(j+1)/2 (j pi x/L)^2,

whose matrices are so ill-conditioned that double precision would not do.
"""

from collections.abc import Callable
from typing import Any

import mpmath
import numpy as np
from mpmath.calculus.quadrature import GaussLegendre

from benchmarks.cases import flexible as data

_DIGITS, _DEGREE = 50, 6  # 96 points of Gauss: all integrals are accurate to rounding
Function = Callable[[Any], Any]


def frequencies(count: int) -> tuple[float, ...]:
    """Six frequencies (rad/s): three pairs, of the hub at rest and of the hub in motion."""
    with mpmath.workdps(_DIGITS):
        rest, moving = (_modes(count, hub)[:4] for hub in (False, True))
    moving = [value for value in moving if value > data.RIGID]
    return tuple(np.array([rest[:3], moving[:3]]).T.ravel())


def _modes(count: int, hub: bool) -> list[float]:  # noqa: FBT001
    """Frequencies of one appendage, with a quarter of the hub or clamped."""
    length, radius = mpmath.mpf(data.LENGTH), mpmath.mpf(data.HUB_RADIUS)
    bending = data.MODULUS * data.HEIGHT * mpmath.mpf(data.THICKNESS) ** 3 / 12
    functions = [_assumed(j, length) for j in range(1, count + 1)]
    if hub:
        functions.append((lambda x: radius + x, lambda x: mpmath.mpf(1), lambda x: mpmath.mpf(0)))
    nodes = GaussLegendre(mpmath.mp).calc_nodes(_DEGREE, mpmath.mp.prec)
    points = [(length * (x + 1) / 2, length * w / 2) for x, w in nodes]
    n = len(functions)
    values = [[f[0](x) for x, _ in points] for f in functions]
    curved = [[f[2](x) for x, _ in points] for f in functions]
    M, K = mpmath.matrix(n), mpmath.matrix(n)
    for i in range(n):
        for j in range(n):
            ends = [(functions[k][0](length), functions[k][1](length)) for k in (i, j)]
            M[i, j] = data.DENSITY * _sum(points, values[i], values[j])
            M[i, j] += data.TIP_MASS * ends[0][0] * ends[1][0]
            M[i, j] += data.TIP_INERTIA * ends[0][1] * ends[1][1]
            K[i, j] = bending * _sum(points, curved[i], curved[j])
    if hub:
        M[n - 1, n - 1] += mpmath.mpf(data.HUB_INERTIA) / 4
    factor = mpmath.inverse(mpmath.cholesky(M))
    squares = mpmath.eigsy(factor * K * factor.T, eigvals_only=True)
    return sorted(float(mpmath.sqrt(abs(value))) for value in squares)


def _assumed(j: int, length: Any) -> tuple[Function, Function, Function]:
    """phi_j and its first two derivatives."""
    k, half = j * mpmath.pi / length, mpmath.mpf((-1) ** (j + 1)) / 2
    return (
        lambda x: 1 - mpmath.cos(k * x) + half * (k * x) ** 2,
        lambda x: k * mpmath.sin(k * x) + 2 * half * k**2 * x,
        lambda x: k**2 * mpmath.cos(k * x) + 2 * half * k**2,
    )


def _sum(points: list[tuple[Any, Any]], a: list[Any], b: list[Any]) -> Any:
    return mpmath.fsum(w * x * y for (_, w), x, y in zip(points, a, b, strict=True))
