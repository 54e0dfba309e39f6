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

All is in balls, the doubles of A, B, C, D_zw, D, G, beta and of the ends of deltas being exact: F and R
are negative definite; eigenvalues are enclosed in discs (Gershgorin) of L N Y and L E Y, where L and Y,
near to the matrices of eigenvectors, may be anything: they only make discs wide. They are doubles, and
have 256 bits where doubles give no discs: eigenvalues of slow poles, such as -1e-8 of a weight that
nearly integrates, are below the rounding of H in doubles.
"""

from typing import Any, NamedTuple

import flint
import numpy as np
from numpy.typing import NDArray

from mbdlft.base.array import Array
from mbdlft.exact.matrices import middles_of
from mbdlft.exact.rounding import EPS
from mbdlft.robust.balls import adjoint, balls, entries, is_positive, joined, largest
from mbdlft.robust.evidence import Interval, Multipliers

Complex = NDArray[np.complex128]
_BITS = 128  # of balls: products of doubles lose nothing, and a matrix beside a pole little
_FINE_BITS = 256  # where doubles do not separate eigenvalues from the axis
_SLACK = 1e-8  # what an interval is made smaller by, so that other machines find it, too
_UP = 1.0 + 1e-9  # times sums of bounds: more than their rounding


class Channels(NamedTuple):
    """xdot = A x + B w, z = C x + D w, where w and z have the same length."""

    A: Array
    B: Array
    C: Array
    D: Array


class Extent(NamedTuple):
    """Ends (m,) of the deltas of each channel, the same in a block; minus and plus a norm."""

    low: Array
    high: Array


def channels_matrix(system: Channels, omega: float) -> Complex:
    """M(j omega) (m, m) in doubles."""
    n = len(system.A)
    if not n or not np.isfinite(omega):
        return system.D.astype(complex)
    return np.asarray(system.D + system.C @ np.linalg.solve(1j * omega * np.eye(n) - system.A, system.B))


def matrix_in_balls(system: Channels, omega: float) -> Any:
    """M(j omega) (m, m) in balls; ZeroDivisionError if j omega is not told from a pole."""
    D, n = flint.acb_mat(balls(system.D)), len(system.A)
    if not n or not np.isfinite(omega):
        return D
    shifted = balls(1j * omega * np.eye(n)) - flint.acb_mat(balls(system.A))
    return D + balls(system.C) * shifted.solve(flint.acb_mat(balls(system.B)))


def _middle(multipliers: Multipliers, extent: Extent | None) -> tuple[Any, Any, Any]:
    """p D, q D - jG and beta^2 D; p = 1 and q = 0 without an extent."""
    D, G = (balls(X.astype(complex)) for X in (multipliers.D, multipliers.G))
    last = D * (flint.arb(multipliers.beta) * flint.arb(multipliers.beta))
    if extent is None:
        return D, G * flint.acb(0, -1), last
    low, high = (balls(np.diag(ends)) for ends in extent)
    return -low * high * D, (low + high) * flint.arb(0.5) * D - G * flint.acb(0, 1), last


def is_negative_at(
    system: Channels, multipliers: Multipliers, omega: float, extent: Extent | None = None
) -> bool:
    """Whether F(omega) < 0 and D > 0 are proved."""
    with flint.ctx.workprec(_BITS):
        first, mixed, last = _middle(multipliers, extent)
        try:
            M = matrix_in_balls(system, omega)
        except ZeroDivisionError:
            return False
        half = adjoint(M) * mixed
        F = adjoint(M) * first * M + half + adjoint(half) - last
        return is_positive(-F) and is_positive(balls(multipliers.D))


def interval_around(
    system: Channels, multipliers: Multipliers, omega: float, extent: Extent | None = None
) -> Interval | None:
    """The largest interval that is proved, with omega in it; None if F(omega) < 0 is not proved."""
    if not is_negative_at(system, multipliers, omega, extent):
        return None
    if not len(system.A):
        return Interval(0.0, omega, np.inf)
    discs = _discs(system, multipliers, extent, _BITS)
    if discs is None:
        discs = _discs(system, multipliers, extent, _FINE_BITS)
    return _between(discs, system, multipliers, omega, extent)


def _between(
    discs: tuple[Complex, Array] | None,
    system: Channels,
    multipliers: Multipliers,
    omega: float,
    extent: Extent | None,
) -> Interval:
    """The largest interval with omega in it that none of the discs reaches on the axis."""
    if discs is None:
        return Interval(omega, omega, omega)
    centers, radii = discs
    touches = np.abs(centers.real) <= radii
    beside = np.abs(centers[touches].real)
    reach = np.sqrt((radii[touches] - beside) * (radii[touches] + beside)) * _UP
    low_ends, high_ends = centers[touches].imag - reach, centers[touches].imag + reach
    if np.any((low_ends <= omega) & (omega <= high_ends)):
        return Interval(omega, omega, omega)
    low = float(np.max(high_ends[high_ends < omega], initial=0.0))
    high = float(np.min(low_ends[low_ends > omega], initial=np.inf))
    if not np.isfinite(high) and not is_negative_at(system, multipliers, np.inf, extent):
        high = max(omega, 1e3 * float(np.max(np.abs(centers))))
    low, high = low * (1.0 + _SLACK), high * (1.0 - _SLACK)
    return Interval(low, omega, high) if low < omega < high else Interval(omega, omega, omega)


def holds(
    system: Channels, multipliers: Multipliers, interval: Interval, extent: Extent | None = None
) -> bool:
    """Whether multipliers prove their bound on an interval, all of it."""
    if not 0.0 <= interval.low <= interval.at <= interval.high:
        return False
    if not is_negative_at(system, multipliers, interval.at, extent):
        return False
    if not len(system.A):
        return True
    for bits in (_BITS, _FINE_BITS):  # whichever the search took
        discs = _discs(system, multipliers, extent, bits)
        again = _between(discs, system, multipliers, interval.at, extent)
        low, high = again.low * (1.0 - 0.5 * _SLACK), again.high * (1.0 + 0.5 * _SLACK)
        if low <= interval.low and interval.high <= high:
            return True
    return False


def _discs(
    system: Channels, multipliers: Multipliers, extent: Extent | None, bits: int
) -> tuple[Complex, Array] | None:
    """Discs outside of which N - s E is not singular; None if they are too wide."""
    n, m = system.B.shape
    with flint.ctx.workprec(bits):
        N = _pencil(system, *_middle(multipliers, extent))
        near = _near_eigenvectors(middles_of(N), n) if bits == _BITS else _fine_eigenvectors(N, n)
        if near is None:
            return None
        exact_values, L, Y = near
        values = np.array([complex(x) for x in exact_values])
        T_all = L * N * Y
        for k in range(2 * n + m):
            T_all[k, k] -= exact_values[k] if k < 2 * n else 1
        upper_L, upper_Y = entries(L)[: 2 * n, : 2 * n], entries(Y)[: 2 * n, : 2 * n]
        S = joined([[upper_L]]) * joined([[upper_Y]]) - balls(np.eye(2 * n, dtype=complex))
        T, S_all = largest(T_all), np.zeros((2 * n + m, 2 * n + m))
        S_all[: 2 * n, : 2 * n] = largest(S)
    sizes = np.concatenate([np.abs(values), np.ones(m)])
    weights = _weights(T + sizes[:, None] * S_all, sizes)
    fixed = (T @ weights) / weights * _UP
    moving = (S_all @ weights) / weights * _UP
    if not np.all(moving < 0.01) or not np.all(fixed[2 * n :] < 0.5):
        return None
    # a row of T - s S with s in no disc is dominated by its diagonal, values - s
    radii = fixed[: 2 * n] + moving[: 2 * n] * (np.abs(values) + fixed[: 2 * n]) / 0.98
    return values, (radii + EPS * np.abs(values)) * _UP


def _pencil(system: Channels, first: Any, mixed: Any, last: Any) -> Any:
    """N (2n + m, 2n + m)."""
    A, B, C, D = system
    n, m = B.shape
    T = balls(np.block([[C, D], [np.zeros((m, n)), np.eye(m)]]).astype(complex))
    middle = [[first, mixed], [adjoint(mixed), -last]]
    Q = entries(T.transpose() * joined([[entries(block) for block in row] for row in middle]) * T)
    Q11, Q12, Q21, R = Q[:n, :n], Q[:n, n:], Q[n:, :n], Q[n:, n:]
    return joined([[A, np.zeros((n, n)), B], [-Q11, -A.T, -Q12], [Q21, B.T, R]])


def _near_eigenvectors(N: Complex, n: int) -> tuple[list[Any], Any, Any] | None:
    """Eigenvalues (2n,) of N - s E, and L, Y with L N Y and L E Y near to diagonal matrices: doubles."""
    top, right, below = N[: 2 * n, : 2 * n], N[: 2 * n, 2 * n :], N[2 * n :, : 2 * n]
    m = right.shape[1]
    try:
        inner = np.linalg.inv(N[2 * n :, 2 * n :])
        H = top - right @ inner @ below
        scale = balance(H)
        values, V = np.linalg.eig(H * scale / scale[:, None])
        V = scale[:, None] * V
        W = np.linalg.inv(V)
    except np.linalg.LinAlgError:
        return None
    L = np.block([[W, -W @ right @ inner], [np.zeros((m, 2 * n)), inner]])
    Y = np.block([[V, np.zeros((2 * n, m))], [-inner @ below @ V, np.eye(m)]])
    return [flint.acb(value) for value in values.tolist()], balls(L), balls(Y)


def _fine_eigenvectors(N: Any, n: int) -> tuple[list[Any], Any, Any] | None:
    """The same with the bits of balls."""
    whole = entries(N.mid())
    top, right, below, corner = (
        joined([[block]])
        for block in (
            whole[: 2 * n, : 2 * n],
            whole[: 2 * n, 2 * n :],
            whole[2 * n :, : 2 * n],
            whole[2 * n :, 2 * n :],
        )
    )
    m = corner.nrows()
    try:
        inner = corner.inv().mid()
        values, V = (top - right * inner * below).mid().eig(right=True, algorithm="approx")
        V = V.mid()
        W = V.inv().mid()
    except (ValueError, ZeroDivisionError):
        return None
    beside, under = -W * right * inner, -inner * below * V
    L = joined([[entries(W), entries(beside.mid())], [np.zeros((m, 2 * n)), entries(inner)]])
    Y = joined([[entries(V), np.zeros((2 * n, m))], [entries(under.mid()), np.eye(m)]])
    return [value.mid() for value in values], L, Y


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
