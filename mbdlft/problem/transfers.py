"""Transfer functions: of matrices, and of the equations before they are solved.

With s = j omega, G = C (s I - A)^-1 B + D. The equations J_xdot s x + J_z z + J_x x + J_u u = 0 say the
same without their being solved for s x first: rounding of A, B, C and D is not in it.
"""

import numpy as np
from numpy.typing import NDArray

from mbdlft.base.array import Array

_COUNT = 8  # frequencies
_FROM, _TO = 0.097, 2.137  # times the slowest and the fastest pole; no ratio that designs have
_SLOWEST = 1e-4  # of the fastest pole: slower ones, as those of free motions, ask for no frequency
_BESIDE = 1.01  # times a pole: no frequency is nearer
_REST = 1e-4  # rad/s: slower ones may be rounding of nothing
QUIET = 1e-6  # of the largest of a row over the frequencies: 120 dB below, nobody looks
_ROUNDS = 2  # of scaling of rows and columns

Complex = NDArray[np.complex128]


def frequencies_of(A: Array) -> Array:
    """Frequencies (F,), rad/s, on a logarithmic scale around and beside the poles of A (N, n, n)."""
    poles = np.abs(np.linalg.eigvals(A)).ravel()
    fastest = float(np.max(poles, initial=0.0))
    if not _REST < fastest < np.inf:
        return np.logspace(-1.0, 4.0, _COUNT)
    poles = poles[poles > max(_SLOWEST * fastest, _REST)]
    found = np.geomspace(_FROM * np.min(poles), _TO * fastest, _COUNT)
    for k, w in enumerate(found):
        # the nearest free place, of so many that poles cannot take them all
        free = w * _BESIDE ** (2.0 * np.arange(len(poles) + 1))
        distance = np.min(np.abs(np.log(free[:, None] / poles)), axis=1)
        found[k] = free[np.argmax(distance >= np.log(_BESIDE))]
    return np.asarray(found)


def transfers(matrices: Array, states: int, frequencies: Array) -> Complex:
    """Transfer functions (N, F, n_y, n_u) of [A B ; C D] (N, ., .).

    Raises
    ------
    LinAlgError
        A frequency is a pole.
    """
    shift = np.eye(*matrices.shape[1:]) * (np.arange(matrices.shape[1]) < states)[:, None]
    both = matrices[:, None] - 1j * frequencies[:, None, None] * shift
    return _eliminated(both[..., :states, :], both[..., states:, :], states)


def implicit_transfers(jacobian: Array, sizes: tuple[int, int, int], frequencies: Array) -> Complex:
    """Transfer functions (N, F, n_y, n_u) of slopes (N, ., .) of [residual ; outputs].

    Their columns are by unknown signals, the derivatives of the states first, and by known ones, the
    states first; `sizes` are the numbers of unknown and known signals and of states.

    Raises
    ------
    LinAlgError
        A frequency is a pole.
    """
    unknown, known, states = sizes
    J = jacobian[:, None, :, : unknown + known]
    s = 1j * frequencies[:, None, None]
    others = np.concatenate([J[..., states:unknown], J[..., unknown + states :]], axis=-1)
    by_states = J[..., unknown : unknown + states] + s * J[..., :states]
    shape = (*by_states.shape[:-1], others.shape[-1])
    both = np.concatenate([by_states, np.broadcast_to(others, shape)], axis=-1)
    return _eliminated(both[..., :unknown, :], both[..., unknown:, :], unknown)


def largest_of_rows(found: Complex, truth: Complex) -> float:
    """Largest difference of transfer functions (N, F, n_y, n_u), relative to the row of the truth.

    The size of a row is its largest entry at that frequency, and at least `QUIET` of the largest of all
    frequencies. A row that is exactly zero in the truth has no size; its entries are compared as those
    of C and D.
    """
    own = np.max(np.abs(truth), axis=-1, initial=0.0)
    size = np.maximum(own, QUIET * np.max(own, axis=1, keepdims=True, initial=0.0))
    difference = np.max(np.abs(found - truth), axis=-1, initial=0.0)
    clear = size > 0.0
    return float(np.max(difference[clear] / size[clear], initial=0.0))


def _eliminated(top: Complex, bottom: Complex, count: int) -> Complex:
    """Rows [K L] = `top` and [M N] = `bottom` with the first `count` columns solved for: N - M K^-1 L."""
    K, L = top[..., :count], top[..., count:]
    M, N = bottom[..., :count], bottom[..., count:]
    if not count:
        return np.asarray(N, dtype=complex)
    rows, columns = np.ones(K.shape[:-1]), np.ones((*K.shape[:-2], count))
    for _ in range(_ROUNDS):
        size = np.abs(K) * rows[..., :, None] * columns[..., None, :]
        rows = rows * _power(np.max(size, axis=-1))
        size = np.abs(K) * rows[..., :, None] * columns[..., None, :]
        columns = columns * _power(np.max(size, axis=-2))
    scaled = K * rows[..., :, None] * columns[..., None, :]
    solved = np.linalg.solve(scaled, L * rows[..., :, None]) * columns[..., :, None]
    return np.asarray(N - M @ solved)


def _power(size: Array) -> Array:
    """The power of two that makes a size about 1; 1 for zero."""
    exponent = np.frexp(np.where(size > 0.0, size, 0.5))[1]
    return np.ldexp(1.0, -exponent)
