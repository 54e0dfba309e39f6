"""Modes of matrices of exact numbers, to many more digits than double precision has.

Polynomials up to a high degree are nearly dependent, and a spectrum of many decades loses the digits of
its small end. So FLINT encloses the modes in balls, with more bits until all are narrow.
"""

from typing import Any

import flint
import numpy as np
from numpy.typing import NDArray

from mbdlft.base.errors import AnalysisError

DIGITS = 400  # behind the point; products of modes cancel up to some 200 of them
BITS = (512, 1024, 2048, 4096, 8192)

Modes = tuple[Any, NDArray[np.float64]]


def exact_modes(mass: NDArray[np.object_], stiffness: NDArray[np.object_]) -> Modes:
    """X (n, n), of FLINT, with X' M X = 1 and X' K X = diag(values), and the values (n,), ascending.

    Parameters
    ----------
    mass, stiffness : (n, n) of Fraction, symmetric and positive definite, with distinct values

    Raises
    ------
    AnalysisError
        Two values are not told apart.
    """
    M, K = _rational(mass), _rational(stiffness)
    for bits in BITS:
        with flint.ctx.workprec(bits):
            found = _enclosed(M, K)
        if found is not None:
            return found
    raise AnalysisError(f"modes of {len(mass)} shapes: {BITS[-1]} bits do not tell them apart.")


def _enclosed(M: Any, K: Any) -> Modes | None:
    """As `exact_modes`; None if there are too few bits."""
    try:
        inverses, vectors = flint.acb_mat(K.solve(M)).eig(right=True)
    except ValueError:  # two of them are not told apart
        return None
    n, values = M.nrows(), [float(1 / inverse.real) for inverse in inverses]
    modes = []
    for k in np.argsort(values):
        phi = flint.arb_mat(n, 1, [vectors[i, int(k)].real for i in range(n)])
        phi = phi * (1 / (phi.transpose() * M * phi)[0, 0].sqrt())
        # phi and -phi are the same mode: it is positive, as the sum of its coefficients says
        modes.append((phi if sum(phi.entries()).mid() >= 0 else -phi).entries())
    X = flint.arb_mat(modes).transpose()
    if max(entry.rad() for entry in X.entries()) > flint.arb(2) ** -DIGITS:
        return None
    return X, np.sort(values)


def combined(
    left: Any, matrix: NDArray[np.object_], right: Any | None = None
) -> NDArray[np.float64]:
    """X' A Y of fractions A (n, m), with X and Y of `exact_modes`; each entry is rounded once."""
    with flint.ctx.workprec(BITS[-1]):
        found = left.transpose() * _rational(matrix)
        found = found if right is None else found * right
    entries = [float(entry) for entry in found.entries()]
    return np.array(entries).reshape(found.nrows(), found.ncols())


def _rational(matrix: NDArray[np.object_]) -> Any:
    """A matrix (n, m) of fractions as one of FLINT."""
    entries = [flint.fmpq(entry.numerator, entry.denominator) for entry in matrix.ravel()]
    return flint.fmpq_mat(len(matrix), matrix.shape[1], entries)
