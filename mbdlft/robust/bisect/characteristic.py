"""The characteristic polynomial of a system in s and in all parameters, as Bernstein coefficients.

With w = Delta z closed, Delta = diag(delta_k I_rk), the poles are the roots of

    p(s, delta) = det(I - D_zw Delta) det(s I - A(delta)),

a polynomial of degree n in s and of degree at most r_k in delta_k. On the axis s = j omega, with
omega = scale t/(1 - t), 0 <= t <= 1, the function (1 - t)^n p is a polynomial in t. A polynomial on a box
lies in the convex hull of its Bernstein coefficients there (Cargo, Shisha, The Bernstein form of a
polynomial, J. Res. NBS 70B, 1966; for parameters that are not repeated this is the mapping theorem of
Zadeh and Desoer). Zero at t = 1, omega infinite, means a model that is not well posed.

All numbers up to the coefficients are balls of FLINT: the doubles of the system are taken as exact, and
the error of each coefficient is known.
"""

from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial
from itertools import pairwise
from math import comb, prod
from typing import Any, NamedTuple

import flint
import numpy as np
from numpy.typing import NDArray

from mbdlft.base.array import Array
from mbdlft.base.errors import AnalysisError, WellPosednessError
from mbdlft.exact.rounding import EPS, eigenvalues_of
from mbdlft.robust.balls import balls, entries

Balls = NDArray[np.object_]
_BITS, _MOST_BITS = 128, 4096  # of balls: at first, and when doubling ends
# parts that the radius of a ball may be: of the largest coefficient of its power of t, and of all
_ENOUGH, _NOTHING = 2.0**-60, 2.0**-120


class Realization(NamedTuple):
    """A system without signals: xdot = A x + B w + E u, z = C x + D w + F u, y = G x + H w + J u.

    Names and sizes are those of the parameters and their repetitions, none of which is 0. Inputs u and
    outputs y are those whose gain is asked for; stability has none. Poles are asked for left of
    s = shift + (j - slope) omega (rad/s) and of its mirror image: both numbers are 0 for stability.
    """

    names: tuple[str, ...]
    sizes: tuple[int, ...]
    A: Array
    B: Array
    C: Array
    D: Array
    E: Array
    F: Array
    G: Array
    H: Array
    J: Array
    shift: float = 0.0
    slope: float = 0.0

    @property
    def coefficients(self) -> int:
        """Number of Bernstein coefficients of the characteristic polynomial."""
        return prod(size + 1 for size in self.sizes) * (len(self.A) + 1)

    def spread(self, delta: Array) -> Array:
        """The diagonal of Delta (..., N) at deltas (..., number of deltas)."""
        return np.repeat(delta, self.sizes, axis=-1)

    def into(self, delta: Array) -> Array:
        """(I - D Delta)^-1 [C F], (..., N, n + n_u): what states and inputs do to z; or LinAlgError."""
        loop = np.eye(len(self.D)) - self.D * self.spread(delta)[..., None, :]
        return np.asarray(np.linalg.solve(loop, np.hstack([self.C, self.F])))

    def out_of(self, delta: Array) -> Array:
        """[B; H] (I - Delta D)^-1, (..., n + n_y, N): what additions to w do; errors as of `into`."""
        loop = np.eye(len(self.D)) - self.spread(delta)[..., None] * self.D
        return np.asarray(np.linalg.solve(loop.mT, np.vstack([self.B, self.H]).T).mT)

    def by_parameter(self, terms: NDArray[Any]) -> NDArray[Any]:
        """Sums (..., number of deltas) of terms (..., N), one for each channel."""
        ends = np.cumsum([0, *self.sizes])
        sums = [np.sum(terms[..., a:b], axis=-1) for a, b in pairwise(ends)]
        return np.stack(sums, axis=-1) if sums else terms[..., :0]

    def slopes(self, delta: Array, left: NDArray[Any], right: NDArray[Any]) -> NDArray[Any]:
        """Derivatives (..., m, number of deltas) of l'[A E; G J] v at deltas, for m rows l and v.

        With L = [B; H] (I - Delta D)^-1 and K = (I - D Delta)^-1 [C F], that by delta_k is l'L_k K_k v,
        with the columns of L and the rows of K of block k. Rows may end after the states.
        """
        L = self.out_of(delta)[..., : left.shape[-1], :]
        return self.by_parameter((left @ L) * (right @ self.into(delta)[..., : right.shape[-1]].mT))


class Polynomials(NamedTuple):
    """Bernstein coefficients on the box |delta_k| <= k and omega in [0, inf].

    The first are those of the characteristic polynomial p, the others those of p G_ij, row by row.
    """

    values: NDArray[np.complex128]  # (1 + n_gain, r_1 + 1, ..., n + 1)
    error: Array  # (1 + n_gain, n + 1): what the values may be off, for each power of t
    scale: float  # frequency (rad/s) at t = 1/2
    outputs: int  # rows of the transfer G


def polynomials(model: Realization, k: float | Array) -> Polynomials:
    """Bernstein coefficients of p(j omega, delta), and of p G for each entry of the transfer G.

    The box is |delta| <= k, a number, or one for each delta. With another region than the left half
    plane, of p along its edge. A WellPosednessError says at which
    node of the box the model is singular.
    """
    scale, bits = _scale(model.A), _BITS
    while bits <= _MOST_BITS:
        with flint.ctx.workprec(bits):
            values, radii = _balls(model, k, partial(_rows, model, scale))
            radii = np.max(radii, axis=tuple(range(1, radii.ndim - 1))) * (1.0 + 4.0 * EPS)
        largest = np.max(np.abs(values), axis=tuple(range(1, values.ndim - 1)))
        whole = np.max(largest, axis=1, keepdims=True, initial=0.0)
        if np.all(radii <= np.maximum(_ENOUGH * largest, _NOTHING * whole)):
            powers, off = _powers(values.shape[-1], model.slope)
            sizes = np.abs(powers) * (1.0 + 4.0 * EPS)
            error = radii * sizes + off * sizes * largest
            return Polynomials(values * powers, error, scale, len(model.J))
        bits *= 2
    raise AnalysisError(
        f"the characteristic polynomial of {len(model.A)} states needs more than {_MOST_BITS} bits."
    )


def state_polynomials(model: Realization, k: float | Array, gain: float = 0.0) -> tuple[Array, Array]:
    """Bernstein coefficients of the entries of d A, and of d = det(I - D Delta), as the last of a row.

    With a gain g, those of d [A E 0; 0 -I/2 0; g G g J -I/2]: rows are states, inputs and outputs.
    Both arrays are (r_1 + 1, ..., rows^2 + 1); errors are at most 2 EPS of the second. The box, and
    errors, are as those of `polynomials`.
    """

    def row(whole: Balls, factor: Any) -> list[list[Any]]:
        n, (all_rows, columns) = len(model.A), whole.shape
        if gain:
            closed, whole = whole, np.full((columns + all_rows - n,) * 2, flint.arb(0))
            whole[:n, :columns], whole[columns:, :columns] = closed[:n], flint.arb(gain) * closed[n:]
            whole[range(n, len(whole)), range(n, len(whole))] = flint.arb(-0.5)
        else:
            whole = whole[:n, :n]
        return [[factor * x for x in whole.ravel()] + [factor]]

    with flint.ctx.workprec(_BITS):
        values, radii = _balls(model, k, row)
    return values[0], (np.abs(values[0]) + radii[0] / EPS) * (1.0 + 4.0 * EPS)


def is_stable_at(model: Realization, delta: Sequence[float] | Array) -> bool:
    """Whether all poles at these deltas are proved to lie in the region."""
    return verdict_of(lambda: straightened(_at(model, delta), model.slope)) is True


def is_unstable_at(
    model: Realization, delta: Sequence[float] | Array, most_bits: int = _MOST_BITS
) -> bool:
    """Whether a pole at these deltas is proved to lie outside, or det(I - D Delta) not to be positive."""
    return verdict_of(lambda: straightened(_at(model, delta), model.slope), most_bits) is False


def is_hurwitz(A: Array) -> bool:
    """Whether all eigenvalues of a matrix are proved to have negative real parts."""
    return verdict_of(lambda: list(balls(A).charpoly().coeffs())) is True


def verdict_of(coefficients: Callable[[], list[Any] | None], most_bits: int = _MOST_BITS) -> bool | None:
    """Whether a polynomial is Hurwitz, by Routh's scheme; None if too many bits would be needed.

    A model that has none, None in its place, is not stable. A ZeroDivisionError asks for more bits.
    """
    bits, verdict = _BITS, None
    while verdict is None and bits <= most_bits:
        with flint.ctx.workprec(bits), suppress(ZeroDivisionError):
            verdict = _routh(coefficients())
        bits *= 2
    return verdict


def nearness(frequency: float, size: float) -> float:
    """How near to j frequency a pole is that is called there, in rad/s; the largest pole is of a size."""
    return 1e-3 * frequency + 1e-6 * size


def is_root_near(coefficients: list[Any], s: complex, distance: float) -> bool:
    """Whether a polynomial has a root so near to s: one is within n |p/p'| (Laguerre)."""
    p = flint.acb_poly(coefficients)
    return bool(abs(p(flint.acb(s))) * p.degree() < abs(p.derivative()(flint.acb(s))) * distance)


def _powers(count: int, slope: float) -> tuple[NDArray[np.complex128], float]:
    """Powers (count,) of j - slope, and a relative bound of the error of a product with one."""
    if not slope:
        return np.asarray(1j ** (np.arange(count) % 4), dtype=np.complex128), EPS
    with flint.ctx.workprec(_BITS):
        edge = flint.acb(-slope, 1)
        powers = [complex((edge**k).mid()) for k in range(count)]
    return np.array(powers, dtype=np.complex128), 8.0 * EPS


def straightened(coefficients: list[Any] | None, slope: float) -> list[Any] | None:
    """Coefficients of a real polynomial that is Hurwitz if the zeros of p are left of the two edges.

    With s = (1 + j slope) u the edge becomes the axis of u; the other one comes with the conjugate.
    """
    if coefficients is None or not slope:
        return coefficients
    turn = flint.acb(1, slope)
    upper = [turn**k * c for k, c in enumerate(coefficients)]
    lower = [turn.conjugate() ** k * c for k, c in enumerate(coefficients)]
    return [c.real for c in (flint.acb_poly(upper) * flint.acb_poly(lower)).coeffs()]


def _routh(coefficients: list[Any] | None) -> bool | None:
    """Whether a polynomial with these coefficients, lowest first, is Hurwitz; None: too few bits."""
    if coefficients is None:
        return False
    rows = [coefficients[::-1][k::2] for k in (0, 1)]
    zero = flint.arb(0)
    for _ in range(len(coefficients) - 1):
        upper, lower = rows
        if not upper[0] > 0:
            return None if 0 in upper[0] and upper[0].rad() > 0 else False
        if not lower or not lower[0] > 0:
            return None if lower and 0 in lower[0] and lower[0].rad() > 0 else False
        ratio = upper[0] / lower[0]
        next_lower = [
            a - ratio * (lower[i + 1] if i + 1 < len(lower) else zero) for i, a in enumerate(upper[1:])
        ]
        rows = [lower, next_lower]
    return True


def _scale(A: Array) -> float:
    """A power of two near the middle of the sizes of the poles (rad/s)."""
    sizes = np.abs(eigenvalues_of(A)) if len(A) else np.ones(1)
    sizes = sizes[sizes > 0.0]
    return float(2.0 ** np.round(np.mean(np.log2(sizes)))) if len(sizes) else 1.0


def _whole(model: Realization) -> Balls:
    """[D C F; B A E; H G J] as balls: channels first, in the order of the blocks."""
    rows = [[model.D, model.C, model.F], [model.B, model.A, model.E], [model.H, model.G, model.J]]
    whole = entries(balls(np.block(rows)))
    for k in range(len(model.D), len(model.D) + len(model.A) if model.shift else 0):
        whole[k, k] = whole[k, k] - flint.arb(model.shift)
    return whole


def _closed(whole: Balls, size: int, value: Any) -> tuple[Balls, Any]:
    """What is left when w = value z closes the first channels, and the determinant of that loop."""
    loop = balls(np.eye(size)) - balls(whole[:size, :size]) * value
    through = balls(whole[size:, :size]) * value * loop.solve(balls(whole[:size, size:]))
    return whole[size:, size:] + entries(through), loop.det()


def _at(model: Realization, delta: Sequence[float] | Array) -> list[Any] | None:
    """Coefficients of p(s, delta) over det(I - D Delta), lowest first; None: that is not positive.

    A ZeroDivisionError says that balls of these bits do not tell whether it is.
    """
    of_channels = balls(np.diag(model.spread(np.asarray(delta, dtype=float))))
    loop = balls(np.eye(len(model.D))) - balls(model.D) * of_channels
    factor = loop.det()
    if factor <= 0:
        return None
    if not factor > 0:
        raise ZeroDivisionError
    A = balls(model.A) + balls(model.B) * of_channels * loop.solve(balls(model.C))
    if model.shift:
        A = A - balls(model.shift * np.eye(len(model.A)))
    return list(A.charpoly().coeffs())


def _balls(
    model: Realization, k: float | Array, rows: Callable[[Balls, Any], list[list[Any]]]
) -> tuple[Array, Array]:
    """Middles and radii (number of rows, r_1 + 1, ..., length of a row) of Bernstein coefficients.

    `rows` are polynomials in the deltas, of [A E; G J] with w closed and det(I - D Delta).
    """
    shape = [size + 1 for size in model.sizes]
    ends, values = np.broadcast_to(k, len(shape)), list[Any]()

    def descend(whole: Balls, factor: Any, depth: int) -> None:
        if depth == len(shape):
            values.append(rows(whole, factor))
            return
        size = model.sizes[depth]
        for node in range(size + 1):
            value = flint.arb(float(ends[depth])) * flint.arb(flint.fmpq(2 * node - size, size))
            try:
                inner, loop = _closed(whole, size, value)
            except ZeroDivisionError:
                raise WellPosednessError(
                    f"the model is singular, or too near to it, at {float(value.mid()):.6g} times the "
                    f"half range of {model.names[depth]}."
                ) from None
            descend(inner, factor * loop, depth + 1)

    descend(_whole(model), flint.arb(1), 0)
    coefficients = np.array(values, dtype=object).reshape(*shape, *np.shape(values[0]))
    coefficients = np.moveaxis(coefficients, -2, 0)
    for axis, size in enumerate(model.sizes, start=1):
        if size > 1:
            coefficients = _converted(coefficients, axis, size)
    middles = np.array([float(x.mid()) for x in coefficients.ravel()]).reshape(coefficients.shape)
    radii = np.array([float(x.rad()) for x in coefficients.ravel()]).reshape(coefficients.shape)
    return middles, radii


def _rows(model: Realization, scale: float, whole: Balls, factor: Any) -> list[list[Any]]:
    """Coefficients of p and of p G_ij, lowest first, in the Bernstein basis of t but for powers of j."""
    n = len(model.A)
    A = balls(whole[:n, :n])
    p = list(A.charpoly().coeffs())
    rows = [p]
    for i in range(n, len(whole)):
        for j in range(n, whole.shape[1]):
            around = A - balls(whole[:n, j : j + 1]) * balls(whole[i : i + 1, :n])
            direct = flint.arb(1) - whole[i, j]
            rows.append([a - direct * b for a, b in zip(around.charpoly().coeffs(), p, strict=True)])
    weights = [factor * flint.arb(scale) ** i / comb(n, i) for i in range(n + 1)]
    return [[a * b for a, b in zip(row, weights, strict=True)] for row in rows]


def _converted(values: Balls, axis: int, size: int) -> Balls:
    """Values at size + 1 even nodes of an axis as Bernstein coefficients."""
    basis = [
        flint.fmpq(comb(size, i) * j**i * (size - j) ** (size - i), size**size)
        for j in range(size + 1)
        for i in range(size + 1)
    ]
    turn = flint.arb_mat(flint.fmpq_mat(size + 1, size + 1, basis).inv())
    moved = np.moveaxis(values, axis, 0)
    coefficients = entries(turn * balls(moved.reshape(size + 1, -1)))
    return np.moveaxis(coefficients.reshape(moved.shape), 0, axis)
