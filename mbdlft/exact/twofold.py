"""Products and solutions in twice the working precision, as sums of two arrays of doubles.

Factors are cut into slices of so few bits that matrix products of slices are exact in double precision,
whatever the order of summation (Ozaki, Ogita, Oishi, Rump 2012); slices of products are added up with
the rounding of each sum (Knuth). So all work is done by the fast products that there are.
"""

from typing import NamedTuple

import numpy as np

from mbdlft.base.array import Array

_DIGITS = 53  # binary, of a double
_SLICES = 5  # of a factor
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


def bits_of(terms: int) -> int:
    """Bits of slices for which sums of so many products, from every pair of slices, are exact."""
    return (_DIGITS - (_SLICES * max(terms, 1) - 1).bit_length()) // 2


def slices(matrix: Twofold, axis: int) -> list[Array]:
    """Arrays whose sum is the matrix, in units that fall by the same factor along an axis.

    What is left out is below 2^-95 of the largest entry along the axis, for up to 800 terms.
    """
    bits = bits_of(matrix.high.shape[axis])
    largest = np.max(np.abs(matrix.high), axis=axis, keepdims=True, initial=0.0)
    unit = np.ldexp(1.0, np.frexp(largest)[1])
    rest, found = matrix.high, []
    for k in range(_SLICES):
        unit = np.ldexp(unit, -bits)
        part = np.rint(rest / unit) * unit
        rest = rest - part
        if k == 1:  # by now there is room for what is below the rounding
            rest = rest + matrix.low
        found.append(part)
    while found and not found[-1].any():
        found.pop()
    return found


def add_product(base: Twofold, left: list[Array], right: list[Array]) -> Twofold:
    """base + left right, the factors in slices along the terms of the sums."""
    high, low = base
    for level in range(_SLICES):
        pairs = [(i, level - i) for i in range(level + 1) if i < len(left)]
        pairs = [(i, j) for i, j in pairs if j < len(right)]
        if pairs:
            first = np.hstack([left[i] for i, _ in pairs])
            high, error = exact_sum(high, first @ np.vstack([right[j] for _, j in pairs]))
            low = low + error
    return exact_sum(high, low)


def multiply_add(base: Array, left: Array, right: Twofold) -> Array:
    """base + left right, rounded once."""
    start, factor = Twofold(base, np.zeros_like(base)), Twofold(left, np.zeros_like(left))
    return add_product(start, slices(factor, 1), slices(right, 0)).high


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
    parts = slices(Twofold(-scaled, np.zeros_like(scaled)), 1)
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
        residual = add_product(residual, parts, slices(Twofold(step, nothing), 0))
    # what is smaller than the last step is nothing: an imposed coordinate takes no part in the rest
    kept = np.abs(solution.high) > settled
    high, low = (np.where(kept, part / columns[:, None], 0.0) for part in solution)
    return Twofold(high, low)


def _power(sizes: Array) -> Array:
    """Powers of two near sizes; 1 for zero."""
    return np.ldexp(1.0, np.where(sizes > 0.0, np.frexp(sizes)[1], 0))
