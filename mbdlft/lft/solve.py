"""Linear equations at delta = 0, accurate in each entry, and what rounding has left set to zero."""

import numpy as np

from mbdlft.base.array import Array
from mbdlft.base.errors import WellPosednessError
from mbdlft.exact import twofold
from mbdlft.exact.rounding import cleaned, solution_size
from mbdlft.exact.twofold import Twofold

_WELL_CONDITIONED = 2.0**10  # double precision is enough: the square of this leaves ten digits


def through(
    base: Array, left: Array, matrix: Array, right: Array, what: str
) -> tuple[Array, Array]:
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
        return twofold.multiply_add(base, left, solved)
    parts = [twofold.multiply_add(f(base), f(left), solved) for f in (np.real, np.imag)]
    return np.asarray(parts[0] + 1j * parts[1])


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
            return twofold.solve(matrix, right)
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
