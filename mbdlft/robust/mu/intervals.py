"""Intervals of frequency on which multipliers prove a bound of mu: no grid.

With multipliers D, G and beta, let M = M(j omega) and

    F(omega) = M' p D M + M' (q D - jG) + (q D + jG) M - beta^2 D.

p and q are numbers for each block. A real delta between a and b has (delta - a)(b - delta) >= 0, which is
p = -a b, q = (a + b)/2, beta = 1: the multipliers of its part of the box, with no need to move the system
there. Other blocks, of norm s, have p = s^2 and q = 0.

For stable A, F(omega) is singular exactly where N - j omega E is, with

    N = [ A  0  B ; -Q11  -A'  -Q12 ; Q12'  B'  R ],    E = diag(I, I, 0),
    [Q11 Q12; Q12' R] = T' [p D, q D - jG; q D + jG, -beta^2 D] T,   T = [C D_zw; 0 I],

whose eigenvalues are those of a Hamiltonian matrix. If F < 0 at one frequency, then F < 0 on the interval
around it up to the next eigenvalue on the imaginary axis; R < 0 is F < 0 at infinity. Doyle, Packard,
Zhou, Review of LFTs, LMIs and mu, CDC 1991, section 10, has the idea for D alone.

What is said is proved whatever rounding did, the doubles of A, B, C, D_zw, D, G, beta being exact:
eigenvalues are enclosed in discs (Gershgorin) of L N Y and L E Y for computed L, Y near to those of the
eigenvectors, with bounds of all rounding errors; F < 0 and R < 0 are checked by the eigenvalues of
Hermitian matrices with a margin for rounding. L and Y may be anything: they only make discs wide.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbdlft.base.array import Array
from mbdlft.robust.evidence import Interval, Multipliers

Complex = NDArray[np.complex128]
_EPS = float(np.finfo(float).eps)
_SLACK = 1e-8  # what an interval is made smaller by, so that other machines find it, too


class Channels(NamedTuple):
    """xdot = A x + B w, z = C x + D w, where w and z have the same length."""

    A: Array
    B: Array
    C: Array
    D: Array


class Extent(NamedTuple):
    """p and q of each channel (m,), the same in a block."""

    p: Array
    q: Array


class _Middle(NamedTuple):
    """p D, q D - jG, beta^2 D, and sizes of entries of the first two that rounding is relative to."""

    first: Complex
    mixed: Complex
    last: Complex
    first_size: Array
    mixed_size: Array


def channels_matrix(system: Channels, omega: float) -> tuple[Complex, Array]:
    """M(j omega) (m, m), and a bound of the error of each of its columns in the 2-norm."""
    n = len(system.A)
    if not n or not np.isfinite(omega):
        return system.D.astype(complex), np.zeros(system.D.shape[1])
    shifted = 1j * omega * np.eye(n) - system.A
    inverse = np.linalg.inv(shifted)
    X = inverse @ system.B
    gamma = 4.0 * (n + 4) * _EPS
    wrong = np.abs(np.eye(n) - inverse @ shifted) + gamma * np.abs(inverse) @ np.abs(shifted)
    share = float(np.linalg.norm(wrong))
    residual = np.abs(system.B - shifted @ X) + gamma * (np.abs(system.B) + np.abs(shifted) @ np.abs(X))
    if share >= 0.5:
        return system.D + system.C @ X, np.full(system.B.shape[1], np.inf)
    off = np.linalg.norm(np.abs(inverse) @ residual, axis=0) / (1.0 - share)
    rounding = gamma * (np.abs(system.C) @ np.abs(X) + np.abs(system.D))
    error = float(np.linalg.norm(system.C)) * off + np.linalg.norm(rounding, axis=0)
    return system.D + system.C @ X, error * (1.0 + 1e-9)


def _middle(multipliers: Multipliers, extent: Extent | None) -> _Middle:
    D, G = multipliers.D, multipliers.G
    p, q = (np.ones(len(D)), np.zeros(len(D))) if extent is None else extent
    first, turned = p[:, None] * D, q[:, None] * D
    sizes = np.abs(turned) + np.abs(G)
    return _Middle(first, turned - 1j * G, multipliers.beta * multipliers.beta * D, np.abs(first), sizes)


def is_negative_at(
    system: Channels, multipliers: Multipliers, omega: float, extent: Extent | None = None
) -> bool:
    """Whether F(omega) < 0 and D > 0 are proved; p = 1 and q = 0 without an extent."""
    D, middle = multipliers.D, _middle(multipliers, extent)
    M, columns = channels_matrix(system, omega)
    if not np.all(np.isfinite(columns)):
        return False
    LM = middle.mixed.conj().T @ M
    F = M.conj().T @ middle.first @ M + LM + LM.conj().T - middle.last
    m = len(D)
    sizes = np.abs(M) + columns
    off = np.outer(np.ones(m), columns)  # of each entry of M, as the norm of its column
    twice, half = middle.first_size @ off, middle.mixed_size @ off
    error = sizes.T @ twice + twice.T @ sizes + half + half.T
    half = middle.mixed_size @ sizes
    terms = sizes.T @ middle.first_size @ sizes + half + half.T + np.abs(middle.last)
    error = error + 8.0 * (m + 8) * _EPS * terms
    scale = 1.0 / np.sqrt(np.maximum(-np.diagonal(F).real, 1e-300))
    if not np.all(np.diagonal(F).real < 0.0):
        return False
    error = scale[:, None] * error * scale
    rounding = float(np.linalg.norm(error)) + 8.0 * m * m * _EPS
    scaled = scale[:, None] * F * scale
    return _largest(scaled) + rounding < 0.0 and _is_positive(D)


def _is_positive(D: Complex) -> bool:
    """Whether a Hermitian matrix is proved to be positive definite."""
    diagonal = np.diagonal(D).real
    if not np.all(diagonal > 0.0):
        return False
    scale = 1.0 / np.sqrt(diagonal)
    return -_largest(-scale[:, None] * D * scale) > 8.0 * len(D) ** 2 * _EPS


def _largest(F: Complex) -> float:
    return float(np.linalg.eigvalsh(0.5 * (F + F.conj().T))[-1])


def interval_around(
    system: Channels, multipliers: Multipliers, omega: float, extent: Extent | None = None
) -> Interval | None:
    """The largest interval that is proved, with omega in it; None if F(omega) < 0 is not proved."""
    if not is_negative_at(system, multipliers, omega, extent):
        return None
    if not len(system.A):
        return Interval(0.0, omega, np.inf)
    at_infinity = is_negative_at(system, multipliers, np.inf, extent)
    discs = _discs(system, multipliers, extent)
    if discs is None:
        return Interval(omega, omega, omega)
    centers, radii = discs
    touches = np.abs(centers.real) <= radii
    reach = np.sqrt(np.maximum(radii[touches] ** 2 - centers[touches].real ** 2, 0.0))
    low_ends, high_ends = centers[touches].imag - reach, centers[touches].imag + reach
    if np.any((low_ends <= omega) & (omega <= high_ends)):
        return Interval(omega, omega, omega)
    low = float(np.max(high_ends[high_ends < omega], initial=0.0))
    high = float(np.min(low_ends[low_ends > omega], initial=np.inf))
    if not np.isfinite(high) and not at_infinity:
        high = max(omega, 1e3 * float(np.max(np.abs(centers))))
    low, high = low * (1.0 + _SLACK), high * (1.0 - _SLACK)
    return Interval(low, omega, high) if low < omega < high else Interval(omega, omega, omega)


def holds(
    system: Channels, multipliers: Multipliers, interval: Interval, extent: Extent | None = None
) -> bool:
    """Whether multipliers prove their bound on an interval, all of it."""
    again = interval_around(system, multipliers, interval.at, extent)
    if again is None or not interval.low <= interval.at <= interval.high:
        return False
    low, high = again.low * (1.0 - 0.5 * _SLACK), again.high * (1.0 + 0.5 * _SLACK)
    return low <= interval.low and interval.high <= high


def _discs(
    system: Channels, multipliers: Multipliers, extent: Extent | None
) -> tuple[Complex, Array] | None:
    """Discs outside of which N - s E is not singular; None if rounding is too large."""
    A, B, C, D = system
    n, m = B.shape
    form, form_error = _form(C, D, _middle(multipliers, extent))
    Q11, Q12, R = form[:n, :n], form[:n, n:], form[n:, n:]
    N = np.block([[A, np.zeros((n, n)), B], [-Q11, -A.T, -Q12], [Q12.conj().T, B.T, R]])
    N_error = np.zeros(N.shape)
    N_error[n : 2 * n, :n], N_error[n : 2 * n, 2 * n :] = form_error[:n, :n], form_error[:n, n:]
    N_error[2 * n :, :n], N_error[2 * n :, 2 * n :] = form_error[n:, :n], form_error[n:, n:]
    top, right, below = N[: 2 * n, : 2 * n], N[: 2 * n, 2 * n :], N[2 * n :, : 2 * n]
    try:
        inner = np.linalg.inv(R)
        H = top - right @ inner @ below
        scale = balance(H)
        values, V = np.linalg.eig(H * scale / scale[:, None])
        V = scale[:, None] * V
        W = np.linalg.inv(V)
    except np.linalg.LinAlgError:
        return None
    L = np.block([[W, -W @ right @ inner], [np.zeros((m, 2 * n)), inner]])
    Y = np.block([[V, np.zeros((2 * n, m))], [-inner @ below @ V, np.eye(m)]])
    gamma = 8.0 * (2 * n + m + 4) * _EPS
    T = L @ N @ Y
    T_error = gamma * (np.abs(L) @ np.abs(N) @ np.abs(Y)) + np.abs(L) @ N_error @ np.abs(Y)
    S = L[:, : 2 * n] @ Y[: 2 * n]
    S_error = gamma * (np.abs(L[:, : 2 * n]) @ np.abs(Y[: 2 * n]))
    T = T - np.diag(np.concatenate([values, np.ones(m)]))
    S = S - np.eye(2 * n + m, 2 * n + m) * (np.arange(2 * n + m) < 2 * n)
    T_all, S_all = np.abs(T) + T_error, np.abs(S) + S_error
    sizes = np.concatenate([np.abs(values), np.ones(m)])
    weights = _weights(T_all + sizes[:, None] * S_all, sizes)
    fixed = (T_all @ weights) / weights * (1.0 + 1e-9)
    moving = (S_all @ weights) / weights * (1.0 + 1e-9)
    if not np.all(moving < 0.01) or not np.all(fixed[2 * n :] < 0.5) or np.any(moving[2 * n :] > 0.0):
        return None
    radii = fixed[: 2 * n] + moving[: 2 * n] * (np.abs(values) + fixed[: 2 * n]) / 0.98
    return values, radii * (1.0 + 1e-9)


def _weights(errors: Array, sizes: Array) -> Array:
    """Weights of columns with which the discs of all rows are of one relative size, nearly."""
    least = np.maximum(sizes, 1e-12 * np.max(sizes))
    weights = np.ones(len(sizes))
    for _ in range(6):
        weights = errors @ weights / least
        weights = np.maximum(weights / np.max(weights, initial=1e-300), 1e-30)
    return np.asarray(weights)


def balance(H: Complex | Array) -> Array:
    """Powers of two that make rows and columns of a matrix of one size, as a diagonal similarity."""
    scale, size = np.ones(len(H)), np.abs(H)
    np.fill_diagonal(size, 0.0)
    for _ in range(20):
        here = size * scale / scale[:, None]
        columns, rows = np.sum(here, axis=0), np.sum(here, axis=1)
        fits = (columns > 0.0) & (rows > 0.0)
        ratio = np.sqrt(np.where(fits, rows, 1.0) / np.where(fits, columns, 1.0))
        scale = scale * 2.0 ** np.round(0.5 * np.log2(ratio))
    return np.asarray(scale)


def _form(C: Array, D: Array, blocks: _Middle) -> tuple[Complex, Array]:
    """[Q11 Q12; Q12' R], and bounds of the errors of its entries."""
    m, n = C.shape
    T = np.block([[C, D], [np.zeros((m, n)), np.eye(m)]])
    middle = np.block([[blocks.first, blocks.mixed], [blocks.mixed.conj().T, -blocks.last]])
    sizes = np.block([[blocks.first_size, blocks.mixed_size], [blocks.mixed_size.T, np.abs(blocks.last)]])
    form = T.T @ middle @ T
    error = 8.0 * (2 * m + 4) * _EPS * (np.abs(T).T @ sizes @ np.abs(T))
    return 0.5 * (form + form.conj().T), error
