"""The truth: 50 digits at some of the samples, and 19 digits at all, proved by these.

The motion that is written down by hand in `benchmarks.speed.systems` is run with mpmath, and for all
samples at once with numbers of 80 bits (numpy.longdouble). Poles with 50 digits are balls that hold them
(FLINT); with 80 bits they are quotients of Rayleigh with eigenvectors of both sides, which with vectors
of 16 digits have all digits of the matrix.
"""

from dataclasses import dataclass
from itertools import permutations
from typing import Any

import flint
import mpmath as mp
import numpy as np

from benchmarks.speed.motion import Circle, Matrix, state_space
from benchmarks.speed.systems import System
from benchmarks.targets import EPS

DIGITS = 50
LONG = np.longdouble
NEGLIGIBLE = (
    1e-8  # an entry below this part of its row (of A, C) or column (of B, D) is compared with that
)
_PI = LONG("3.14159265358979323846264338327950288419716939937510582")
_PROVED = 10.0 * EPS  # below what any method in double precision gets where this is reached
_CHUNK = 1000  # samples that are compared at once
_BALL = 1e-20  # radius of a pole that was computed with 50 digits, relative to the largest


@dataclass(frozen=True)
class Truth:
    """[A B ; C D] (N, ., .) with 80 bits, and the poles, both known to `proved` relative to their sizes.

    Attributes
    ----------
    values : array (N, n_out, n_in) of longdouble
    squares : array (N, n) of longdouble
        Of the poles of an undamped system, whose poles are pairs of plus and minus; empty with damping.
    poles : array (N, 2 n) of complex longdouble, with damping
    subset : indices of the samples that 50 digits were computed at
    proved : float
        Largest difference from 50 digits at these, entries and poles, relative as errors are.
    """

    values: np.ndarray
    squares: np.ndarray
    poles: np.ndarray
    subset: np.ndarray
    proved: float
    states: int

    @property
    def rightmost(self) -> np.ndarray:
        """Largest real part of a pole at each sample (N,)."""
        if self.poles.size:
            return np.asarray(np.max(self.poles.real, axis=1), dtype=float)
        return np.asarray(np.sqrt(np.maximum(np.max(self.squares, axis=1), 0.0)), dtype=float)


def truth(system: System, samples: dict[str, np.ndarray], proofs: int) -> Truth:
    """The truth at samples; `proofs` of them, drawn at random, are computed with 50 digits.

    Raises
    ------
    AssertionError
        80 bits are not enough.
    """
    assert np.finfo(LONG).eps < EPS / 1000.0, "numpy.longdouble has no more digits than float"
    count = len(next(iter(samples.values())))
    subset = np.sort(np.random.default_rng(1).permutation(count)[:proofs])
    values, n = _long(system, samples)
    damped = bool(np.any(values[:, n : 2 * n, n : 2 * n]))
    A = values[:, : 2 * n, : 2 * n]
    squares = np.zeros((count, 0)) if damped else _rayleigh(A[:, n:, :n])
    poles = _rayleigh(A) if damped else np.zeros((count, 0))
    proved = 0.0
    sizes = entry_sizes(values, 2 * n)
    for k in subset:
        exact = _fifty(system, {name: float(x[k]) for name, x in samples.items()})
        with mp.workdps(DIGITS):
            difference = _differences(values[k], exact)
            proved = max(proved, float(np.max(difference / sizes)))
            part = range(2 * n) if damped else range(n)
            first = 0 if damped else n
            exact_poles = _enclosed([[exact[first + i][j] for j in part] for i in part])
        found = poles[k] if damped else squares[k]
        gap = _matched(found[None], exact_poles[None]) if damped else _sorted(found, exact_poles)
        proved = max(proved, float(np.max(gap)))
    assert proved < _PROVED, f"{system.name}: 80 bits differ from 50 digits by {proved:.1e}"
    return Truth(values, squares, poles, subset, proved, 2 * n)


def _long(system: System, samples: dict[str, np.ndarray]) -> tuple[np.ndarray, int]:
    """[A B ; C D] with 80 bits, and the number of coordinates."""
    wide = {name: np.asarray(value, dtype=LONG) for name, value in samples.items()}
    count = len(next(iter(wide.values())))
    circle = Circle(lambda x: np.cos(LONG(x)), lambda x: np.sin(LONG(x)))
    motion = system.motion(system.in_radians(wide, _PI / 180), circle)
    rows = state_space(motion)
    values = np.empty((count, len(rows), len(rows[0])), dtype=LONG)
    for i, row in enumerate(rows):
        for j, entry in enumerate(row):
            values[:, i, j] = entry
    return values, len(motion.M)


def _fifty(system: System, values: dict[str, float]) -> Matrix:
    """[A B ; C D] at one sample with 50 digits."""
    with mp.workdps(DIGITS):
        numbers = {name: mp.mpf(value) for name, value in values.items()}
        motion = system.motion(system.in_radians(numbers, mp.pi / 180), Circle(mp.cos, mp.sin))
        return state_space(motion)


def _differences(values: np.ndarray, exact: Matrix) -> np.ndarray:
    """|values - exact|: longdouble and mpmath, both as they are."""
    return np.array(
        [
            [float(abs(_to_mp(x) - y)) for x, y in zip(row, right, strict=True)]
            for row, right in zip(values, exact, strict=True)
        ]
    )


def _to_mp(x: Any) -> Any:
    """A longdouble, real or complex, as two doubles that add up to it."""
    if np.iscomplexobj(x):
        return mp.mpc(_to_mp(x.real), _to_mp(x.imag))
    head = float(x)
    return mp.mpf(head) + mp.mpf(float(x - LONG(head)))


def _rayleigh(A: np.ndarray) -> np.ndarray:
    """Eigenvalues (N, n) of matrices with 80 bits; real and sorted if all of them are."""
    n = A.shape[-1]
    idle = ~np.any(A != 0.0, axis=(0, 1))  # a column of zeros: the eigenvalue 0, exactly
    used = np.flatnonzero(~idle)
    part = A[:, used[:, None], used]
    _, right = np.linalg.eig(part.astype(float))
    left = np.linalg.inv(right)
    kind = np.clongdouble if np.iscomplexobj(right) else LONG
    right, left = right.astype(kind), left.astype(kind)
    moved = np.einsum("kij,kjl->kil", part, right)
    found = np.einsum("kij,kji->ki", left, moved) / np.einsum("kij,kji->ki", left, right)
    whole = np.zeros((len(A), n), dtype=kind)
    whole[:, : len(used)] = found
    return whole if kind is np.clongdouble else np.sort(whole, axis=1)


def _enclosed(A: Matrix) -> np.ndarray:
    """Eigenvalues of a matrix of mpmath: balls that hold them (FLINT), rounded to 80 bits, sorted."""
    n = len(A)
    used = [j for j in range(n) if any(row[j] != 0 for row in A)]
    flint.ctx.dps = DIGITS
    part = [[flint.acb(flint.arb(mp.nstr(mp.mpf(A[i][j]), DIGITS))) for j in used] for i in used]
    balls = flint.acb_mat(part).eig()
    found = np.zeros(n, dtype=np.clongdouble)
    largest = max(float(abs(ball).mid()) for ball in balls)
    for k, ball in enumerate(balls):
        assert float(abs(ball).rad()) <= _BALL * largest, ball
        found[k] = _to_long(ball.real) + 1j * _to_long(ball.imag)
    return np.sort(found)


def _to_long(ball: Any) -> Any:
    """The middle of a ball, as two doubles that add up to it."""
    middle = ball.mid()
    head = float(middle)
    return LONG(head) + LONG(float(middle - flint.arb(head)))


# errors ------------------------------------------------------------------------------------------


def entry_sizes(values: np.ndarray, states: int) -> np.ndarray:
    """What errors of entries are relative to: their largest size over the samples.

    An entry that is negligible in its row (of A and C) or column (of B and D) is compared with that.
    """
    size = np.max(np.abs(values), axis=0).astype(float)
    whole = size.copy()
    whole[:, :states] = np.max(size[:, :states], axis=1, keepdims=True)
    whole[:, states:] = np.max(size[:, states:], axis=0, keepdims=True)
    whole[whole == 0.0] = np.max(size)
    return np.where(size > NEGLIGIBLE * whole, size, whole)


def entry_errors(found: np.ndarray, exact: Truth) -> np.ndarray:
    """Largest error of an entry of [A B ; C D] at each sample (N,)."""
    sizes = entry_sizes(exact.values, exact.states)
    errors = np.empty(len(found))
    for start in range(0, len(found), _CHUNK):
        part = slice(start, start + _CHUNK)
        difference = np.abs(found[part] - exact.values[part]).astype(float)
        errors[part] = np.max(difference / sizes, axis=(1, 2))
    return errors


def pole_errors(poles: np.ndarray, exact: Truth) -> np.ndarray:
    """Largest error of a pole (N, 2 n) at each sample (N,), relative to the largest pole.

    Without damping, that of its square relative to the largest square: a pair near zero is as far
    from zero as the root of any error.
    """
    if exact.squares.size:
        squares = poles**2
        order = np.argsort(squares.real, axis=1)
        squares = np.take_along_axis(squares, order, axis=1)
        expected = np.repeat(np.sort(exact.squares, axis=1), 2, axis=1)
        gap = np.max(np.abs(squares - expected), axis=1)
        return np.asarray(gap / np.max(np.abs(expected), axis=1), dtype=float)
    return np.asarray(_matched(poles, exact.poles), dtype=float)


def _sorted(squares: np.ndarray, expected: np.ndarray) -> np.ndarray:
    """Differences of real numbers, sorted, relative to the largest."""
    return np.abs(np.sort(squares) - np.sort(expected.real)) / np.max(np.abs(expected))


def _matched(poles: np.ndarray, expected: np.ndarray) -> np.ndarray:
    """The best of all ways to pair a few poles."""
    gaps = [
        np.max(np.abs(poles[:, list(order)] - expected), axis=1)
        for order in permutations(range(poles.shape[1]))
    ]
    return np.min(gaps, axis=0) / np.max(np.abs(expected), axis=1)
