"""Values C (s I - A)^-1 B + D at many s and many samples, by triangular forms. numpy only.

A sample is turned into a triangle once, A = Q T Q', and each s costs two substitutions: the second one
takes away what the first one left of the equations (Higham, Accuracy and Stability of Numerical
Algorithms, 2nd ed. 2002, section 12.1: with it each row is as accurate as by elimination). Samples at
which it changes much, as where the eigenvectors give no triangle, are solved for by elimination.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mbdlft.base.array import Array
from mbdlft.system.points import StateMatrices

Complex = NDArray[np.complex128]
_EPS = float(np.finfo(float).eps)
_ENTRIES = 2**15  # of the states at all frequencies, held at once: they stay near a core
_NEAR = 4.0 * _EPS  # of s: an eigenvalue as near as this is s
_CHANGE = 1e-8  # of the states: what the second substitution may change; the square of it is left


def balancing(A: Array) -> Array:
    """Powers of 2, d (n,), that make rows and columns of diag(d)^-1 A diag(d) similar in size.

    First entries are brought as near to each other as least squares of their logarithms do it: this does
    not depend on the units of the states, however weakly they are coupled. Then rows and columns whose
    sums differ are (Parlett and Reinsch, Numerische Mathematik 13, 1969, section 2; in the 1-norm).
    """
    size = np.abs(A)
    np.fill_diagonal(size, 0.0)
    scale = _leveling(size)
    size *= scale / scale[:, None]
    for _ in range(30):
        moved = False
        for k in range(len(A)):
            column, row = size[:, k].sum(), size[k].sum()
            if not (0.0 < column < np.inf and 0.0 < row < np.inf):
                continue
            factor = 2.0 ** round(0.5 * float(np.log2(row / column)))
            if column * factor + row / factor < 0.95 * (column + row):
                size[:, k] *= factor
                size[k] /= factor
                scale[k] *= factor
                moved = True
        if not moved:
            break
    return scale


def _leveling(size: Array) -> Array:
    """Powers of 2 near t that minimize the sum of (log size_ij + log t_j - log t_i)^2."""
    there = np.isfinite(size) & (size > 0.0)
    logarithms = np.log2(size, out=np.zeros(size.shape), where=there)
    counts = np.diag(np.sum(there, axis=0) + np.sum(there, axis=1)) - there - there.T.astype(float)
    excess = np.sum(logarithms, axis=1) - np.sum(logarithms, axis=0)
    scale: Array = np.exp2(np.round(np.linalg.lstsq(counts, excess)[0]))
    return scale


def resolvent(matrices: StateMatrices, s: Complex) -> Complex:
    """C (s I - A)^-1 B + D.

    Parameters
    ----------
    matrices : A, B, C, D, arrays (N, n, n), (N, n, nu), (N, ny, n), (N, ny, nu)
    s : complex array (N, F), of the unit of A

    Returns
    -------
    complex array (N, F, ny, nu)
        It is not finite where s is an eigenvalue of A, exactly or but for its last digits.
    """
    A, _, _, D = matrices
    found = np.empty((*s.shape, *D.shape[1:]), dtype=complex)
    if not (A.shape[1] and found.size):
        found[:] = D[:, None]
        return found
    with np.errstate(all="ignore"):  # what comes of a pole is told by what is not finite
        for part in _pieces(s.shape, A.shape[1] * max(D.shape[1:])):
            some = StateMatrices(*(matrix[part[0]] for matrix in matrices))
            values = found[part]
            lost = ~_by_triangles(some, s[part], values)
            for k in np.flatnonzero(lost):
                values[k] = _by_elimination(StateMatrices(*(m[k] for m in some)), s[part][k])
    return found


def _pieces(shape: tuple[int, ...], each: int) -> Iterator[tuple[slice, slice]]:
    """Slices of samples and of frequencies whose states fit into a cache."""
    samples, frequencies = shape
    most = max(1, min(frequencies, _ENTRIES // each))
    rows = max(1, _ENTRIES // (each * most))
    for k in range(0, samples, rows):
        for j in range(0, frequencies, most):
            yield slice(k, k + rows), slice(j, j + most)


def _by_triangles(matrices: StateMatrices, s: Complex, values: Complex) -> NDArray[np.bool_]:
    """Write the values (N, F, ny, nu), and say of which samples (N,) they are right."""
    A, B, C, D = matrices
    try:
        Q, _ = np.linalg.qr(np.linalg.eig(A)[1].astype(complex))
    except np.linalg.LinAlgError:
        return np.zeros(len(A), dtype=bool)
    Qh = np.conj(np.swapaxes(Q, 1, 2))
    T = Qh @ A @ Q
    shifted = s[:, None] - np.diagonal(T, axis1=1, axis2=2)[:, :, None]
    shifted[np.abs(shifted) <= _NEAR * np.abs(s[:, None])] = 0.0
    inverse = (1.0 / shifted)[..., None]
    X = _times(Q, _substituted(T, inverse, (Qh @ B)[:, :, None]))
    left = _times(A, X)
    left -= s[:, None, :, None] * X
    left += B[:, :, None]
    change = _substituted(T, inverse, _times(Qh, left))
    sizes = [np.max(np.abs(x.view(float)), axis=1) for x in (change, X)]
    good = ~np.any(sizes[0] > _CHANGE * sizes[1], axis=(1, 2))  # nan, where s is a pole, may stay
    both = _times(C, X)
    both += _times(C @ Q, change)
    np.add(np.swapaxes(both, 1, 2), D[:, None], out=values)
    return np.asarray(good)


def _substituted(T: Complex, inverse: Complex, right: NDArray[Any]) -> Complex:
    """Solution X (N, n, F, nu) of (s I - T) X = right, from the last row up.

    T (N, n, n) is an upper triangle, `inverse` (N, n, F, 1) is 1/(s - T_kk).
    """
    samples, n, frequencies, _ = inverse.shape
    X = np.empty((samples, n, frequencies, right.shape[-1]), dtype=complex)
    for k in range(n - 1, -1, -1):
        row = right[:, k]
        if k < n - 1:
            row = row + _times(T[:, k : k + 1, k + 1 :], X[:, k + 1 :])[:, 0]
        np.multiply(row, inverse[:, k], out=X[:, k])
    return X


def _times(matrix: NDArray[Any], X: Complex) -> Complex:
    """Products of matrices (N, m, n) and X (N, n, F, nu)."""
    product: Complex = matrix @ X.reshape(*X.shape[:2], -1)
    return product.reshape(*product.shape[:2], *X.shape[2:])


def _by_elimination(matrices: StateMatrices, s: Complex) -> Complex:
    """Values (F, ny, nu) of one sample at each s (F,)."""
    A, B, C, D = matrices
    shifted = s[:, None, None] * np.eye(len(A)) - A
    try:
        solved = np.linalg.solve(shifted, np.broadcast_to(B, (len(s), *B.shape)))
    except np.linalg.LinAlgError:  # at one of them
        if len(s) == 1:
            return np.full((1, *D.shape), np.nan, dtype=complex)
        return np.concatenate([_by_elimination(matrices, s[k : k + 1]) for k in range(len(s))])
    values: Complex = np.asarray(C @ solved + D, dtype=complex)
    return values
