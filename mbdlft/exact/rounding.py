"""Linear algebra in doubles that keeps the digits of every entry, and tells rounding from structure.

Every sum or solution comes with the size that it would have if nothing cancelled. An entry far below
that size is rounding, and is set to zero, so that it is not taken for structure.

Where the condition makes that rounding matter, products and solutions are computed in twice the working
precision, as unevaluated sums of two arrays of doubles. Factors are cut into slices of so few bits that
matrix products of slices are exact in double precision, whatever the order of summation (Ozaki, Ogita,
Oishi, Rump 2012); slices of products are added up with the rounding of each sum (Knuth).
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbdlft.base.array import Array
from mbdlft.base.errors import SizeError, WellPosednessError

ROUNDING = 2.0**-50  # what is dropped is no more than rounding can have made
NOISE = 2.0**-44  # part of its terms below which an entry may be nothing but rounding
# an error of a model of exact numbers is rounding, or a mistake: sums and solutions of n terms stay below
# this times 2.2e-16 times the sizes of their terms
MOST_ROUNDINGS = 100.0
EPS = float(np.finfo(float).eps)


def cleaned(values: Array, size: Array) -> Array:
    """Values with the entries that are rounding of terms of a size set to zero; same shapes."""
    return np.where(np.abs(values) <= ROUNDING * size, 0.0, values)


def product(left: Array, right: Array) -> Array:
    """left @ right, cleaned."""
    return cleaned(left @ right, np.abs(left) @ np.abs(right))


def solution_size(inverse: Array, matrix: Any, solution: Array, right: Array) -> Array:
    """Size of the terms of matrix^-1 right: |matrix^-1| (|matrix| |solution| + |right|)."""
    terms: Array = abs(matrix) @ np.abs(solution) + np.abs(right)
    return np.asarray(np.abs(inverse) @ terms)


def conditioning(values: Array, sizes: Array, scale: Array, least: Array) -> tuple[float, int]:
    """How much rounding of the data changes entries relative to themselves, and where that means little.

    `values` (N, ., .) are at N values of the parameters, `sizes` those if nothing cancelled. Where one
    of these is larger than `scale` (., .), the entry is negligible; a value below `least` (., .) is, at
    a point.

    The first is the largest size relative to the entry itself, at least 1; relative to `scale` for
    entries that are negligible or change their sign. The second is the number of entries that change
    their sign, or vanish at some of the points.
    """
    magnitudes = np.abs(values)
    clear = magnitudes > NOISE * sizes
    some, everywhere = np.any(clear, axis=0), np.all(clear, axis=0)
    one_sign = everywhere & (np.all(values > 0.0, axis=0) | np.all(values < 0.0, axis=0))
    counts = np.max(magnitudes, axis=0, initial=0.0) >= scale
    itself = np.maximum(np.where(clear, magnitudes, 1.0), least)
    condition = np.max((sizes / np.where(one_sign & counts, itself, scale))[:, some], initial=1.0)
    return float(condition), int(np.sum(some & ~one_sign & counts))


def equilibrate(values: NDArray[Any]) -> tuple[Array, Array]:
    """Factors of rows and columns that bring the largest entries to one."""
    size = np.max(np.abs(values), axis=0, initial=0.0)
    rows = 1.0 / or_one(np.max(size, axis=1, initial=0.0))
    return rows, 1.0 / or_one(np.max(size * rows[:, None], axis=0, initial=0.0))


def or_one(size: Array) -> Array:
    """Sizes to divide by: 1 for zero."""
    return np.where(size >= np.finfo(float).tiny, size, 1.0)  # what is smaller has no inverse


_MOST_SWEEPS = 30


def channel_scales(M11: Array, M12: Array, M21: Array) -> Array:
    """Powers of two (n,) with which what enters and what leaves each channel has one size."""
    coupled = M11 - np.diag(np.diagonal(M11))  # no scale changes the diagonal
    return balanced_channels(coupled, M12, M21, _MOST_SWEEPS)[0]


def balanced_channels(M11: Array, M12: Array, M21: Array, sweeps: int) -> tuple[Array, Array, Array]:
    """Powers of two for the channels, and the squares of what then enters and leaves each."""
    with np.errstate(all="ignore"):  # what overflows is refused below
        inner, first, last = M11**2, np.sum(M12**2, axis=1), np.sum(M21**2, axis=0)
        scale = np.ones(len(M11))
        into, out = inner.sum(axis=1) + first, inner.sum(axis=0) + last
        for _ in range(sweeps):
            used = (into > 0) & (out > 0)
            step = np.where(used, out, 1.0) / np.where(used, into, 1.0)
            step = 2.0 ** np.round(0.25 * np.log2(step))
            if (step == 1.0).all():
                break
            scale *= step
            step = step * step
            inner, first, last = step[:, None] * inner / step, step * first, last / step
            into, out = inner.sum(axis=1) + first, inner.sum(axis=0) + last
    if not np.all(np.isfinite(scale) & (scale > 0.0)):
        raise SizeError("LFT: the squares of its entries are too large, or too small, for doubles.")
    return scale, into, out


_DIGITS = 53  # binary, of a double
_SLICES = 5  # of a factor
_LEAST = -900  # power of two: what is some hundred bits smaller is nothing, and not divided by
_SETTLED = 2.0**-90  # of the largest entry of a column: what is smaller is not solved for
_MOST_STEPS = 12  # each adds the digits that the condition leaves of one solution


class Twofold(NamedTuple):
    """The unevaluated sum of two arrays of one shape; `low` is below the rounding of `high`."""

    high: Array
    low: Array


def exact_sum(a: Array, b: Array) -> Twofold:
    """a + b, rounded, and its rounding error (Knuth)."""
    total = a + b
    of_b = total - a
    return Twofold(total, (a - (total - of_b)) + (b - of_b))


def slices(matrix: Twofold, axis: int) -> list[Array]:
    """Arrays whose sum is the matrix but for 2^-95 of the largest along an axis, for 800 terms."""
    bits = (_DIGITS - (_SLICES * max(matrix.high.shape[axis], 1) - 1).bit_length()) // 2
    largest = np.max(np.abs(matrix.high), axis=axis, keepdims=True, initial=0.0)
    unit = np.ldexp(1.0, np.maximum(np.frexp(largest)[1], _LEAST))
    remainder, pieces = matrix.high, []
    for k in range(_SLICES):
        unit = np.ldexp(unit, -bits)
        piece = np.rint(remainder / unit) * unit
        remainder = remainder - piece
        if k == 1:  # by now there is room for what is below the rounding
            remainder = remainder + matrix.low
        pieces.append(piece)
    while pieces and not pieces[-1].any():
        pieces.pop()
    return pieces


def add_product(base: Twofold, left: list[Array], right: list[Array]) -> Twofold:
    """base + left right (..., n, m), the factors in slices along the terms of the sums."""
    high, low = base
    for level in range(_SLICES):
        pairs = [(i, level - i) for i in range(level + 1) if i < len(left)]
        pairs = [(i, j) for i, j in pairs if j < len(right)]
        if pairs:
            first = np.concatenate([left[i] for i, _ in pairs], axis=-1)
            second = np.concatenate([right[j] for _, j in pairs], axis=-2)
            high, error = exact_sum(high, first @ second)
            low = low + error
    return exact_sum(high, low)


def multiply_add(base: Array, left: Array, right: Twofold) -> Array:
    """base + left right, rounded once."""
    start, factor = Twofold(base, np.zeros_like(base)), Twofold(left, np.zeros_like(left))
    return add_product(start, slices(factor, -1), slices(right, -2)).high


def solve_twofold(matrix: Array, right: Array) -> Twofold:
    """matrix^-1 right, refined in twice the precision: small entries have their digits, too."""
    # powers of two change nothing, and make rows and columns of one size
    rows = _power(np.max(np.abs(matrix), axis=1, initial=0.0))
    scaled = matrix / rows[:, None]
    columns = _power(np.max(np.abs(scaled), axis=0, initial=0.0))
    scaled = scaled / columns
    pieces = slices(Twofold(-scaled, np.zeros_like(scaled)), -1)
    nothing = np.zeros_like(right)
    residual, solution = Twofold(right / rows[:, None], nothing), Twofold(nothing, nothing)
    settled: Array | float = 0.0
    for _ in range(_MOST_STEPS):
        step = np.asarray(np.linalg.solve(scaled, residual.high), dtype=float)
        high, error = exact_sum(solution.high, step)
        solution = exact_sum(high, solution.low + error)
        settled = _SETTLED * np.max(np.abs(high), axis=0, initial=0.0)
        if np.all(np.abs(step) <= settled):
            break
        residual = add_product(residual, pieces, slices(Twofold(step, nothing), -2))
    # what is smaller than the last step is nothing: an imposed coordinate takes no part in the rest
    kept = np.abs(solution.high) > settled
    high, low = (np.where(kept, part / columns[:, None], 0.0) for part in solution)
    return Twofold(high, low)


_SMALL, _TERMS = 4, 16  # a part of 2^-4 is squared; of its series the rest is below 2^-110


def exponential(matrices: Array) -> Twofold:
    """exp of matrices (..., n, n): the series of a small part, squared, all in twice the precision.

    Slow motions keep their digits beside fast ones, whose squares are larger by many orders.
    """
    size = float(np.max(np.sum(np.abs(matrices), axis=-2), initial=0.0))
    squarings = max(0, int(np.frexp(size)[1]) + _SMALL)
    one, nothing = np.broadcast_to(np.eye(matrices.shape[-1]), matrices.shape), np.zeros_like(matrices)
    part, factor = slices(Twofold(np.ldexp(matrices, -squarings), nothing), -1), 1.0
    total = Twofold(one, nothing)  # times the factorial of the terms: whole numbers
    for k in range(_TERMS, 0, -1):
        factor *= k
        total = add_product(Twofold(factor * one, nothing), part, slices(total, -2))
    quotient, whole = total.high / factor, slices(Twofold(factor * one, nothing), -2)
    rest = add_product(total, slices(Twofold(-quotient, nothing), -1), whole)
    total = exact_sum(quotient, rest.high / factor)
    for _ in range(squarings):
        total = square(total)
    return total


def square(matrices: Twofold) -> Twofold:
    """The products of matrices (..., n, n) with themselves, in twice the precision."""
    nothing = np.zeros_like(matrices.high)
    return add_product(Twofold(nothing, nothing), slices(matrices, -1), slices(matrices, -2))


def _power(sizes: Array) -> Array:
    """Powers of two near sizes; 1 for zero."""
    return np.ldexp(1.0, np.where(sizes > 0.0, np.frexp(sizes)[1], 0))


_WELL_CONDITIONED = 2.0**10  # double precision is enough: the square of this leaves ten digits


def through(base: Array, left: Array, matrix: Array, right: Array, what: str) -> tuple[Array, Array]:
    """base + left matrix^-1 right, and matrix^-1 right.

    What is solved in twice the working precision stays as it is, however small beside its terms: it is
    what accelerations of the tips of beams are made of. What is solved in double precision has nothing
    below the rounding of its terms, and that is set to zero.
    """
    if not matrix.size:
        return base, np.zeros((0, base.shape[1]))
    solved, low = _solve(matrix, right, what)
    if low.any():
        return _twofold_sum(base, left, Twofold(solved, low)), solved
    try:
        inverse = np.asarray(np.linalg.inv(matrix))
    except np.linalg.LinAlgError:  # its rows have sizes that underflow
        raise WellPosednessError(f"{what}: the matrix is singular to working precision.") from None
    size = solution_size(inverse, matrix, solved, right)
    solved = cleaned(solved, 0.25 * size)
    return cleaned(base + left @ solved, np.abs(base) + np.abs(left) @ size), solved


def _twofold_sum(base: Array, left: Array, solved: Twofold) -> Array:
    """base + left solved; twofold numbers are real, so a complex factor is two of them."""
    if base.dtype.kind != "c" and left.dtype.kind != "c":
        return multiply_add(base, left, solved)
    sums = [multiply_add(f(base), f(left), solved) for f in (np.real, np.imag)]
    return np.asarray(sums[0] + 1j * sums[1])


def solve_nominal(matrix: Array, right: Array, what: str) -> Array:
    """matrix^-1 right, or an error if the matrix is singular to working precision."""
    return _solve(matrix, right, what).high


def _solve(matrix: Array, right: Array, what: str) -> Twofold:
    """As `solve_nominal`, with the rounding of the solution where the condition makes it matter.

    One step of refinement makes the error small relative to the terms of each entry (Skeel 1980): the
    entries of M^-1 K of a finite-element model fall by many orders from the diagonal. On the way to a
    value the LFT undoes the nominal solution and takes another one, so errors of the size of the
    condition are multiplied by it once more: then twice the working precision is used.
    """
    if not matrix.size:
        return Twofold(*np.zeros((2, matrix.shape[0], right.shape[1])))
    scale = np.max(np.abs(matrix), axis=1, keepdims=True)
    scale[scale == 0.0] = 1.0
    try:
        number = condition(matrix / scale)
        singular = number > 1.0 / float(np.finfo(float).eps)
        is_real = matrix.dtype.kind != "c" and right.dtype.kind != "c"
        if not singular and number > _WELL_CONDITIONED and is_real:
            return solve_twofold(matrix, right)
        matrix, right = matrix / scale, right / scale
        first = np.linalg.solve(matrix, right)
        solution = np.asarray(first + np.linalg.solve(matrix, right - matrix @ first))
    except np.linalg.LinAlgError:
        singular = True
    if singular:
        raise WellPosednessError(f"{what}: the matrix is singular to working precision.")
    return Twofold(solution, np.zeros_like(solution))


def condition(matrix: Array) -> float:
    """Condition number in the 1-norm, with rows and columns of one size: units do not count."""
    scaled = matrix
    for axis in (1, 0):
        size = np.max(np.abs(scaled), axis=axis, keepdims=True, initial=0.0)
        scaled = scaled / np.where(size > 0.0, size, 1.0)
    return float(np.linalg.cond(scaled, 1))


def eigenvalues_of(matrices: NDArray[Any]) -> NDArray[Any]:
    """Eigenvalues (..., n) of matrices (..., n, n), also where the QR iteration of one has no end."""
    try:
        return np.asarray(np.linalg.eigvals(matrices))
    except np.linalg.LinAlgError:
        if not np.all(np.isfinite(matrices)):
            raise
        Q = _reflection(matrices.shape[-1])
        return np.asarray(np.linalg.eigvals(Q @ matrices @ Q))


def eigenvectors_of(matrix: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
    """Eigenvalues (n,), left and right eigenvectors (n, n) of a matrix, as `scipy.linalg.eig`."""
    from scipy.linalg import eig  # here because it is slow to import

    try:
        values, left, right = eig(matrix, left=True, check_finite=False)
    except np.linalg.LinAlgError:
        if not np.all(np.isfinite(matrix)):
            raise
        Q = _reflection(len(matrix))
        values, left, right = eig(Q @ matrix @ Q, left=True, check_finite=False)
        left, right = Q @ left, Q @ right
    return values, left, right


def _reflection(n: int) -> Array:
    """An orthogonal, symmetric matrix: in its coordinates shifts of QR meet no symmetry of a matrix."""
    normal = 1.0 / np.sqrt(1.0 + np.arange(n))
    return np.asarray(np.eye(n) - 2.0 * np.outer(normal, normal) / (normal @ normal))


def largest(differences: Array, scale: Array) -> float:
    """Largest size of differences (N, ...), each entry relative to its scale (...)."""
    return float(np.max(np.abs(differences) / scale, initial=0.0))
