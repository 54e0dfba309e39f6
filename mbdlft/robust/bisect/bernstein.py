"""Polynomials of matrices in Bernstein form on a box: values, products, and whether one is positive.

A polynomial lies in the convex hull of its coefficients, so it is positive definite if all of these are.
They may be far from it: those of the Chebyshev polynomial of degree 8, as of the error of an
interpolation, reach 184. Halving the box along a delta brings them near to it, with the square of the
size; so pieces are halved where coefficients do not tell. Coefficients at the corners are values.
"""

from collections.abc import Sequence
from functools import cache
from math import comb

import numpy as np

from mbdlft.base.array import Array
from mbdlft.exact.rounding import EPS

_CACHED = 2**20  # doubles of a product of matrices
_MIXTURES = 8  # of the entries of a matrix, which tell along which delta a piece is halved


def at_nodes(values: Array, nodes: Sequence[Array]) -> Array:
    """Values at nodes of each delta, which go from 0 to 1 on the box."""
    for axis, t in enumerate(nodes):
        basis = polynomials_at(values.shape[axis] - 1, tuple(t.tolist()))
        values = np.moveaxis(np.tensordot(basis, values, (1, axis)), 0, axis)
    return values


def interpolated(values: Array, nodes: Sequence[Array]) -> Array:
    """Coefficients of the polynomial with values (..., k, k) at nodes of each delta."""
    for axis, t in enumerate(nodes):
        inverse = np.linalg.inv(polynomials_at(len(t) - 1, tuple(t.tolist())))
        values = np.moveaxis(np.tensordot(inverse, values, (1, axis)), 0, axis)
    return values


@cache
def polynomials_at(degree: int, nodes: tuple[float, ...]) -> Array:
    """Bernstein polynomials of a degree at nodes (number of nodes, degree + 1)."""
    return np.array(
        [[comb(degree, i) * t**i * (1.0 - t) ** (degree - i) for i in range(degree + 1)] for t in nodes]
    )


def product(P: Array, N: Array) -> Array:
    """Coefficients of the product of polynomials of matrices (..., k, k).

    The sum over the axis with most coefficients of P is one of products of matrices, too; coefficients of
    P along the other axes are rows of one factor, as long as its products stay in the cache.
    """
    q, k = P.ndim - 2, P.shape[-1]
    first = int(np.argmax(P.shape[:q]))
    P, N = np.moveaxis(P, first, 0), np.moveaxis(N, first, 0)
    shapes = P.shape[:q], N.shape[:q]
    both = tuple(a + b - 1 for a, b in zip(*shapes, strict=True))
    (count, *others), (length, *inner) = shapes
    places = [tuple(map(slice, at, np.add(at, inner))) for at in np.ndindex(*others)]
    rows = np.moveaxis(P * binomials(shapes[0])[..., None, None], 0, -2).reshape(-1, k, count, k)
    N = np.moveaxis(N * binomials(shapes[1])[..., None, None], -2, 1)
    backwards = N[::-1].reshape(length, k, -1)
    step = max(1, _CACHED // backwards[0].size)
    total = np.zeros((both[0], k, *both[1:], k))
    for at, sums in enumerate(total):
        low, high = max(0, at - length + 1), min(count, at + 1)
        columns = backwards[length - 1 - at + low : length - 1 - at + high].reshape((high - low) * k, -1)
        for start in range(0, len(places), step):
            left = rows[start : start + step, :, low:high].reshape(-1, len(columns))
            products = (left @ columns).reshape(-1, k, *inner, k)
            for place, term in zip(places[start : start + step], products, strict=False):
                sums[:, *place] += term
    result = np.moveaxis(total, 1, -2) / binomials(both)[..., None, None]
    return np.asarray(np.moveaxis(result, 0, first))


@cache
def binomials(shape: tuple[int, ...]) -> Array:
    """Products of binomial coefficients, which turn Bernstein coefficients into those of powers."""
    weights = np.ones(shape)
    for axis, size in enumerate(shape):
        row = np.array([float(comb(size - 1, i)) for i in range(size)])
        weights *= row.reshape([-1 if k == axis else 1 for k in range(len(shape))])
    return weights


def corners(S: Array) -> Array:
    """Values at the corners of the box."""
    return S[np.ix_(*[[0, -1]] * (S.ndim - 2))]


def are_positive(S: Array) -> bool:
    """Whether all of the symmetric matrices (..., n, n), with lower triangles as given, have a factor.

    They are proved to be positive if so much is taken from the diagonal as `factor_rounding` times a
    bound of the trace (Rump, BIT 46, 2006).
    """
    try:
        np.linalg.cholesky(S)
    except np.linalg.LinAlgError:
        return False
    return True


def factor_rounding(n: int) -> float:
    """What rounding of Cholesky's factor may hide, of the trace of a matrix (n, n)."""
    return 4.0 * (n + 2.0) * EPS


def pieces_positive(S: Array, most: int) -> tuple[bool, int]:
    """Whether a polynomial, with what rounding hides taken away, is positive; and pieces looked at.

    Entries of halves are means, with weights that are exact, of those of S: m of them are off by m EPS of
    the largest at most. That, and the rounding of a factor, is taken from the diagonals of halves.
    """
    n, count, waiting = S.shape[-1], 0, [S]
    size = float(np.linalg.norm(np.max(np.abs(S), axis=tuple(range(S.ndim - 2)))))
    off = 2.0 * (2.0 * max(S.shape) * EPS + n * factor_rounding(n)) * size
    mixtures = np.cos(np.outer(np.arange(n * n), 1.0 + np.arange(_MIXTURES)))
    while waiting:
        piece, count = waiting.pop(), count + 1
        if are_positive(piece):
            continue
        if count >= most or not are_positive(corners(piece)):
            return False, count
        mixed = piece.reshape(*piece.shape[:-2], n * n) @ mixtures
        bends = [
            m * np.max(np.abs(np.diff(mixed, 2, axis)), initial=0.0)
            for axis, m in enumerate(piece.shape[:-2])
        ]
        waiting += _halves(piece, int(np.argmax(bends)), off)
    return True, count


def _halves(S: Array, axis: int, off: float) -> list[Array]:
    """Both halves along a delta, the lower first, with so much taken from their diagonals."""
    n, m = S.shape[-1], S.shape[axis]
    both = np.tensordot(_halving(m - 1), S, (1, axis))
    both[..., range(n), range(n)] -= off
    return [np.moveaxis(half, 0, axis) for half in (both[:m], both[m:])]


@cache
def _halving(degree: int) -> Array:
    """Weights (2 (degree + 1), degree + 1) of coefficients in those of the lower, then the upper half."""
    lower = [[comb(i, j) * 0.5**i for j in range(degree + 1)] for i in range(degree + 1)]
    return np.vstack([lower, np.array(lower)[::-1, ::-1]])
