"""Functions V that are polynomials in the states and in the parameters, and fall along all motions.

With N = d A and d = det(I - D Delta) > 0, polynomials in the deltas, and V = sum_t v_t x^t over the
products x^t of a degree 2 p of the states, with v_t polynomials in the deltas whose rates are bounded,

    d V' = sum_t v_t d (x^t)' + d sum_i delta_i' dV/ddelta_i = y'G y,

where y are the products of degree p, and G is any matrix whose entries for pairs of them with the
product x^t have the right sum. The left side is a form in x, a polynomial in the deltas and affine in
each rate: it is negative on the box if, at all ends of the rates, each of its Bernstein coefficients has
a G < 0 of its own. Then V falls along each motion. It is also positive: A(delta) is Hurwitz at 0, and
nowhere on the box has it a pole on the axis, as V would fall along a motion that is constant or periodic.
So all motions come to rest.

What a rate does to a mode has the sign of a cosine of twice the phase, of which a quadratic V takes the
amplitude 1, one of degree 4 1/sqrt(2), and any V the mean 2/pi. Forms of higher degree: Zelentsovsky,
IEEE TAC 39, 1994; Chesi, Garulli, Tesi, Vicino, Automatica 39, 2003. Matrices that stand for forms:
Parrilo, Mathematical Programming B 96, 2003.
"""

from collections.abc import Iterator
from itertools import combinations_with_replacement, product
from math import comb, factorial, prod
from typing import Any, NamedTuple

import flint
import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from mbdlft.base.array import Array
from mbdlft.base.errors import WellPosednessError
from mbdlft.exact.rounding import EPS
from mbdlft.robust.balls import balls, entries, is_positive
from mbdlft.robust.bisect.bernstein import binomials
from mbdlft.robust.bisect.characteristic import Realization, state_polynomials
from mbdlft.robust.evidence import PolynomialProof
from mbdlft.robust.moving.variation import BITS, conic_solution, vectors

# units of work of a solution; times rows of the inequalities cubed, and unknowns of V cubed
_CALL, _ROWS, _UNKNOWNS = 0.05, 4.0e-8, 4.0e-9


class Shape(NamedTuple):
    """Of a V: half its degree in the states, and that in each delta that does not move in any way."""

    degree: int
    order: int


SHAPES = (
    Shape(1, 2),
    Shape(2, 2),
    Shape(2, 4),
    Shape(3, 4),
    Shape(4, 6),
    Shape(8, 8),
    Shape(12, 8),
    Shape(16, 8),
)


def cost_of(model: Realization, rates: Array, shape: Shape) -> float:
    """Units of work of one solution."""
    n, orders = len(model.A), np.where(np.isinf(rates), 0, shape.order)
    products, unknowns = (comb(n + degree - 1, degree) for degree in (shape.degree, 2 * shape.degree))
    ends = 2.0 ** np.count_nonzero((orders > 0) & (rates > 0.0))
    count = ends * np.prod(np.add(orders, model.sizes) + 1.0)
    rows, columns = 0.5 * products * (products + 1.0), unknowns * np.prod(orders + 1.0)
    return float(_CALL + _ROWS * count * rows**3 + _UNKNOWNS * columns**3)


def solved(
    model: Realization, states: Array, rates: Array, k: float, shape: Shape
) -> PolynomialProof | None:
    """A proof for |delta| <= k and these rates (1/s), as far as doubles tell; None if none was found.

    V is looked for in the states L x.
    """
    orders = np.where(np.isinf(rates), 0, shape.order)
    try:
        N, d = _polynomials(model, states, k)
    except (WellPosednessError, ZeroDivisionError):
        return None
    N, d = N.astype(float), d.astype(float)
    size = float(np.max(np.abs(N)))
    sums, count = _sums(len(model.A), shape.degree), prod((orders + 1).tolist())
    weights, of_V = (_weights(len(model.A), degree) for degree in (shape.degree, 2 * shape.degree))
    unit = np.eye(count * len(of_V)).reshape(*(orders + 1), len(of_V), -1)
    unit *= of_V[:, None]
    speeds = _speeds(rates, orders, k) / size
    falls = _falls(N / size, d, speeds, unit, 2 * shape.degree)
    scale = np.broadcast_to(binomials(falls.shape[1:-2]), falls.shape[:-2]).ravel()
    falls = falls.reshape(len(scale), len(of_V), -1) / scale[:, None, None]
    columns, rows = np.tril_indices(len(sums))
    spread, free = _gram(sums[rows, columns], rows, columns, weights)
    blocks = sparse.vstack([sparse.csc_matrix(spread @ fall) for fall in falls])
    squares = sparse.hstack([blocks, sparse.kron(sparse.eye(len(scale)), free)]).tocsc()
    values = _least(squares, len(sums), len(scale))
    if values is None:
        return None
    G = np.zeros((len(scale), len(sums), len(sums)))
    off = np.where(rows == columns, 1.0, np.sqrt(0.5)) * weights[rows] * weights[columns]
    G[:, rows, columns] = (squares @ values).reshape(len(scale), -1) * off
    G[:, columns, rows] = G[:, rows, columns]
    V = values[: unit.shape[-1]].reshape(count, -1) * of_V
    return PolynomialProof(V, G * (scale * size)[:, None, None], states, shape.degree, orders)


def _least(squares: Any, size: int, count: int) -> Array | None:
    """Unknowns for which the largest eigenvalue of all matrices is least, with a fixed sum of traces."""
    import clarabel  # here because it is slow to import

    eye = vectors(np.eye(size)[None])[0]
    trace = sparse.csc_matrix(np.tile(eye, count)[None]) @ squares
    margin = sparse.csc_matrix(np.tile(eye, count)[:, None])
    whole = sparse.vstack([sparse.hstack([trace, [[0.0]]]), sparse.hstack([squares, margin])])
    cost = np.append(np.zeros(squares.shape[1]), -1.0)
    b = np.append(-float(size * count), np.zeros(squares.shape[0]))
    cones = [clarabel.ZeroConeT(1), *[clarabel.PSDTriangleConeT(size)] * count]
    values = np.array(conic_solution(cost, whole, b, cones).x)
    return values[:-1] if np.all(np.isfinite(values)) and values[-1] > 0.0 else None


def wrong_in(model: Realization, rates: Array, k: float, proof: PolynomialProof) -> str:
    """What is wrong with a proof for |delta| <= k and these rates (1/s); empty if it is one."""
    n, q, orders = len(model.A), len(model.sizes), proof.orders
    are_whole = orders.shape == (q,) and orders.dtype.kind == "i" and isinstance(proof.degree, int)
    if not (are_whole and np.all((orders >= 0) & (orders < 2**20)) and proof.degree >= 1):
        return "its function is of no degrees that it may have"
    if np.any(orders[np.isinf(rates)]):
        return "its function depends on a parameter that moves in any way"
    products, of_V = (comb(n + degree - 1, degree) for degree in (proof.degree, 2 * proof.degree))
    degrees, speeds = (orders + 1).tolist(), _speeds(rates, orders, k)
    count = 2 ** np.count_nonzero(speeds) * prod((orders + np.array(model.sizes) + 1).tolist())
    arrays = proof.V, proof.G, proof.states
    if [each.shape for each in arrays] != [(prod(degrees), of_V), (count, products, products), (n, n)]:
        return "its matrices are not of its degrees"
    with flint.ctx.workprec(BITS):
        try:
            N, d = _polynomials(model, proof.states, k)
        except (WellPosednessError, ZeroDivisionError):
            return "the model is not well posed, or its states are not those of the system"
        if not all(x > 0 for x in d.ravel()):
            return f"the model is not proved to be well posed for {k:g} times the box"
        V = entries(balls(proof.V)).reshape(*degrees, of_V)
        falls = _falls(N, d, speeds, V, 2 * proof.degree)
        sums = _sums(n, proof.degree)
        if all(map(_is_negative, falls.reshape(count, of_V), proof.G, [sums] * count)):
            return ""
    return f"its function does not fall for {k:g} times the box"


def _is_negative(fall: NDArray[Any], G: Array, sums: NDArray[np.int64]) -> bool:
    """Whether a form with coefficients in balls is negative, by a matrix that nearly stands for it.

    What is missing in sums of entries is given to all of them in equal parts.
    """
    near = entries(balls(0.5 * (G + G.T)))
    missing, count = fall.copy(), np.bincount(sums.ravel())
    for t, entry in zip(sums.ravel(), near.ravel(), strict=True):
        missing[t] -= entry
    missing = np.array([x / int(c) for x, c in zip(missing, count, strict=True)])
    return is_positive(-flint.arb_mat(len(near), len(near), (near + missing[sums]).ravel().tolist()))


def _polynomials(model: Realization, states: Array, k: float) -> tuple[NDArray[Any], NDArray[Any]]:
    """Bernstein coefficients in balls of d L A L^-1 (r_1 + 1, ..., n, n) and of d; |delta| <= k."""
    values, sizes = state_polynomials(model, k)
    n, L = len(model.A), balls(states)
    back, N = L.inv(), np.empty((*values.shape[:-1], n, n), dtype=object)
    d = np.empty(values.shape[:-1], dtype=object)
    for at in np.ndindex(d.shape):
        pairs = zip(values[at].tolist(), sizes[at].tolist(), strict=True)
        *rows, d[at] = [flint.arb(x, 2.0 * EPS * size) for x, size in pairs]
        N[at] = entries(L * flint.arb_mat(n, n, rows) * back)
    return N, d


def _speeds(rates: Array, orders: NDArray[np.int64], k: float) -> Array:
    """Bounds of rates on a box from 0 to 1, a little above; 0 of what V does not depend on."""
    return np.where((orders > 0) & np.isfinite(rates), rates, 0.0) / (2.0 * k) * (1.0 + 4.0 * EPS)


def _falls(N: NDArray[Any], d: NDArray[Any], speeds: Array, V: NDArray[Any], degree: int) -> NDArray[Any]:
    """Bernstein coefficients of d V' times binomials (2^moving, m_1 + r_1 + 1, ..., like v[0]).

    V has its coefficients (m_1 + 1, ..., products of the degree, ...); all in doubles, or in balls.
    """
    still = _times(_lifted(N, degree), V)
    ends = [still]
    for axis, speed in enumerate(speeds):
        if speed:
            turned = _times(d[..., None, None] * np.eye(V.shape[d.ndim]), speed * _slope(V, axis))
            ends = [end + sign * turned for end in ends for sign in (-1, 1)]
    return np.array(ends)


def _times(M: NDArray[Any], V: NDArray[Any]) -> NDArray[Any]:
    """Bernstein coefficients, times binomials, of matrices (..., k, k) times what they act on."""
    q = M.ndim - 2
    orders, degrees = V.shape[:q], M.shape[:q]
    total = np.zeros((*np.add(orders, degrees) - 1, *V.shape[q:]), dtype=V.dtype)
    mine, others = binomials(degrees), binomials(orders)
    for a, j in product(np.ndindex(degrees), np.ndindex(orders)):
        total[*np.add(a, j)] += float(mine[a] * others[j]) * (M[a] @ V[j])
    return total


def _slope(V: NDArray[Any], axis: int) -> NDArray[Any]:
    """The derivative by a delta from 0 to 1, of the same degree."""
    m = V.shape[axis] - 1
    j = np.arange(m + 1.0)
    turn = np.diag(2.0 * j - m) + np.diag(m - j[:-1], 1) - np.diag(j[1:], -1)
    return np.moveaxis(np.tensordot(turn.astype(V.dtype), V, (1, axis)), 0, axis)


def _lifted(N: NDArray[Any], degree: int) -> NDArray[Any]:
    """What turns coefficients of a form of a degree into those of its derivative along N x."""
    n = N.shape[-1]
    place = {a: t for t, a in enumerate(_exponents(n, degree))}
    lifted = np.zeros((*N.shape[:-2], len(place), len(place)), dtype=N.dtype)
    for a, t in place.items():
        for i, k in product(np.flatnonzero(a).tolist(), range(n)):
            moved = tuple(e - (s == i) + (s == k) for s, e in enumerate(a))
            lifted[..., place[moved], t] += a[i] * N[..., i, k]
    return lifted


def _exponents(n: int, degree: int) -> Iterator[tuple[int, ...]]:
    """Exponents of the products of a degree of n states."""
    for chosen in combinations_with_replacement(range(n), degree):
        yield tuple(np.bincount(chosen, minlength=n).tolist())


def _sums(n: int, degree: int) -> NDArray[np.int64]:
    """Which product of twice the degree each pair of products has."""
    place = {a: t for t, a in enumerate(_exponents(n, 2 * degree))}
    all_of = np.array(list(_exponents(n, degree)))
    return np.array([[place[tuple((a + b).tolist())] for b in all_of] for a in all_of])


def _weights(n: int, degree: int) -> Array:
    """What products are multiplied with so that they turn as vectors do: roots of multinomials."""
    return np.sqrt([factorial(degree) / prod(map(factorial, a)) for a in _exponents(n, degree)])


def _gram(
    sums: NDArray[np.int64], rows: NDArray[np.int64], columns: NDArray[np.int64], weights: Array
) -> tuple[Any, Any]:
    """A matrix for each form, as columns of vectors, and a basis of matrices that stand for 0."""
    times = np.where(rows == columns, 1.0, 2.0)
    scale = np.sqrt(times) / (weights[rows] * weights[columns])
    at = np.arange(len(sums))
    count = np.bincount(sums, times)[sums]
    order = np.argsort(sums, kind="stable")
    pairs = np.stack([order[:-1], order[1:]])[:, sums[order[:-1]] == sums[order[1:]]]
    sides = (scale / times)[pairs] * np.array([[1.0], [-1.0]])
    sides /= np.max(np.abs(sides), axis=0)
    free = np.arange(pairs.shape[1])
    return (
        sparse.csr_matrix((scale / count, (at, sums))),
        sparse.csc_matrix(
            (sides.ravel(), (pairs.ravel(), np.tile(free, 2))), shape=(len(sums), len(free))
        ),
    )
