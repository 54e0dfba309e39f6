"""Products and solutions in twice the working precision, as sums of two arrays of doubles.

Factors are cut into slices of so few bits that matrix products of slices are exact in double precision,
whatever the order of summation (Ozaki, Ogita, Oishi, Rump 2012); slices of products are added up with
the rounding of each sum (Knuth). So all work is done by the fast products that there are.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
_DIGITS = 53  # binary, of a double
_WANTED = 106  # binary digits of a product, relative to the largest entries of a row and a column
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


def plus(a: Twofold, b: Array) -> Twofold:
    """a + b."""
    total, error = exact_sum(a.high, b)
    return Twofold(*exact_sum(total, a.low + error))


def slices(matrix: Array, axis: int, bits: int) -> list[Array]:
    """Arrays whose sum is the matrix, with entries of `bits` bits relative to the largest along an axis.

    What is below 2^-106 of the largest is left out.
    """
    found: list[Array] = []
    rest = matrix
    while len(found) * bits < _WANTED:
        largest = np.max(np.abs(rest), axis=axis, keepdims=True, initial=0.0)
        if not largest.any():
            break
        unit = np.ldexp(1.0, np.frexp(largest)[1] - bits)
        found.append(np.rint(rest / unit) * unit)
        rest = rest - found[-1]
    return found


def bits_of(terms: int) -> int:
    """Bits of slices for which sums of so many products of two are exact."""
    return (_DIGITS - max(terms - 1, 0).bit_length()) // 2


def add_product(base: Twofold, left: list[Array], right: list[Array], bits: int) -> Twofold:
    """base + left right, the factors in slices by rows and by columns."""
    most = -(-_WANTED // bits)
    pairs = [(i, j) for i in range(len(left)) for j in range(len(right)) if i + j < most]
    for i, j in sorted(pairs, key=sum):
        base = plus(base, left[i] @ right[j])
    return base


def multiply_add(base: Array, left: Array, *right: Array) -> Array:
    """base + left (sum of right), rounded once."""
    bits = bits_of(left.shape[1])
    parts = slices(left, 1, bits)
    total = Twofold(base, np.zeros_like(base))
    for factor in right:
        total = add_product(total, parts, slices(factor, 0, bits), bits)
    return total.high


def solve(matrix: Array, right: Array) -> Twofold:
    """matrix^-1 right; entries much smaller than others of their column have their digits, too.

    Iterative refinement with residuals and a solution of twice the working precision (Demmel, Hida,
    Kahan, Li, Mukherjee, Riedy 2006): only the rounding of the data is left.

    Raises
    ------
    numpy.linalg.LinAlgError
        The matrix is singular.
    """
    # powers of two change nothing, and make rows and columns of one size
    rows = _power(np.max(np.abs(matrix), axis=1, initial=0.0))
    scaled = matrix / rows[:, None]
    columns = _power(np.max(np.abs(scaled), axis=0, initial=0.0))
    scaled = scaled / columns
    bits = bits_of(len(matrix))
    parts = slices(-scaled, 1, bits)
    residual = Twofold(right / rows[:, None], np.zeros_like(right))
    solution = Twofold(np.zeros_like(right), np.zeros_like(right))
    for _ in range(_MOST_STEPS):
        step = np.asarray(np.linalg.solve(scaled, residual.high), dtype=float)
        solution = plus(solution, step)
        settled = _SETTLED * np.max(np.abs(solution.high), axis=0, initial=0.0)
        if np.all(np.abs(step) <= settled):
            break
        residual = add_product(residual, parts, slices(step, 0, bits), bits)
    # what is smaller than the last step is nothing: an imposed coordinate takes no part in the rest
    kept = np.abs(solution.high) > settled
    high, low = (np.where(kept, part / columns[:, None], 0.0) for part in solution)
    return Twofold(high, low)


def _power(sizes: Array) -> Array:
    """Powers of two near sizes; 1 for zero."""
    return np.ldexp(1.0, np.where(sizes > 0.0, np.frexp(sizes)[1], 0))
