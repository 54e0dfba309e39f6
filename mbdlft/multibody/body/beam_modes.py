"""Modes of matrices of exact numbers, to many more digits than double precision has.

Polynomials up to a high degree are nearly dependent, and a spectrum of many decades loses the digits of
its small end. Numbers are therefore integers times 2^-`BITS`, and a start in double precision is refined
by the iteration of Ogita and Aishima (2018), here for M and K, which doubles the number of digits.
"""

from fractions import Fraction

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

BITS = 512
_ENOUGH = 1 << (BITS - 160)  # a correction below 2^-160 is beyond every double
_MOST = 12  # the start has a few digits; each step doubles them

Fixed = NDArray[np.object_]  # of integers, times 2^-BITS


def fixed(matrix: NDArray[np.object_]) -> Fixed:
    """A matrix of fractions as integers times 2^-BITS."""
    scaled = [round(Fraction(entry) * (1 << BITS)) for entry in matrix.ravel()]
    return np.array(scaled, dtype=object).reshape(matrix.shape)


def fixed_product(a: Fixed, b: Fixed) -> Fixed:
    """The product of two matrices."""
    return np.asarray((a @ b) >> BITS)


def to_double(matrix: Fixed) -> NDArray[np.float64]:
    """Each entry rounded once."""
    rounded = [float(Fraction(entry, 1 << BITS)) for entry in matrix.ravel()]
    return np.array(rounded).reshape(matrix.shape)


def exact_modes(
    mass: NDArray[np.object_], stiffness: NDArray[np.object_]
) -> tuple[Fixed, NDArray[np.float64]]:
    """X (n, n) with X' M X = 1 and X' K X = diag(values), and the values (n,), ascending.

    Parameters
    ----------
    mass, stiffness : (n, n) of Fraction, symmetric and positive definite, with distinct values
    """
    M, K = fixed(mass), fixed(stiffness)
    X = _start(mass, M, K)
    one = 1 << BITS
    n = len(X)
    for _ in range(_MOST):
        R = -fixed_product(X.T, fixed_product(M, X))
        S = fixed_product(X.T, fixed_product(K, X))
        R[range(n), range(n)] += one
        values = [(S[i, i] << BITS) // (one - R[i, i]) for i in range(n)]
        E = np.empty((n, n), dtype=object)
        for i in range(n):
            for j in range(n):
                coupled = S[i, j] + ((values[j] * R[i, j]) >> BITS)
                E[i, j] = R[i, i] >> 1 if i == j else (coupled << BITS) // (values[j] - values[i])
        X = X + fixed_product(X, E)
        if max(abs(entry) for entry in E.ravel()) < _ENOUGH:
            break
    # phi and -phi are the same mode: at the end it is positive, as the sum of its coefficients says
    sign = np.array([1 if sum(column) >= 0 else -1 for column in X.T], dtype=object)
    return X * sign, to_double(np.array(values, dtype=object))


def _start(mass: NDArray[np.object_], M: Fixed, K: Fixed) -> Fixed:
    """Modes in double precision, after an orthogonalization M = L D L' in exact numbers."""
    n = len(mass)
    rest = np.array(mass, dtype=object)
    back = np.array([[Fraction(int(i == j)) for j in range(n)] for i in range(n)], dtype=object)
    pivots = []
    for k in range(n):  # elimination; `back` becomes L^-1
        pivots.append(rest[k, k])
        for i in range(k + 1, n):
            factor = rest[i, k] / rest[k, k]
            rest[i] = rest[i] - factor * rest[k]
            back[i] = back[i] - factor * back[k]
    scaled = np.array([entry / Fraction(float(p) ** 0.5) for p, row in zip(pivots, back, strict=True)
                       for entry in row], dtype=object)  # fmt: skip
    basis = fixed(scaled.reshape(n, n).T)
    inner = [to_double(fixed_product(basis.T, fixed_product(part, basis))) for part in (M, K)]
    size = 1.0 / np.sqrt(np.diag(inner[1]))
    weighed = [part * np.outer(size, size) for part in inner]
    # the inverse problem: its large values are the low modes, which are the accurate ones
    values, vectors = scipy.linalg.eigh(*weighed)
    vectors = size[:, None] * vectors[:, ::-1] / np.sqrt(values[::-1])
    doubles = np.array([Fraction(entry) for entry in vectors.ravel()], dtype=object)
    return fixed_product(basis, fixed(doubles.reshape(n, n)))
