"""Poles, responses and norms of hard cases against 50 digits: near poles, little damping, bad scales."""

import mpmath as mp
import numpy as np
import pytest

from mbdlft import frequency_response, hinf_norm, poles, response_frequencies, step_response
from tests.close import CLOSED_FORM, PEAK, RESPONSE, poles_by_qr, target
from tests.oscillators import plain

DIGITS = 50


def two_modes(damping: float, apart: float, scale: float) -> tuple[np.ndarray, ...]:
    """Masses 1 and 1 between springs 1, apart and 1, states in units that differ by `scale`."""
    k = np.array([[1.0 + apart, -apart], [-apart, 1.0 + apart]])
    A = np.block([[np.zeros((2, 2)), np.eye(2)], [-k, -2.0 * damping * k]])
    units = np.array([1.0, scale, 1.0 / scale, 1.0])
    B, C = np.array([[0.0], [0.0], [1.0], [0.0]]), np.array([[1.0, 0.0, 0.0, 0.0]])
    return A * units[:, None] / units, B * units[:, None], C / units


@pytest.mark.parametrize("damping", [1e-2, 1e-4])
@pytest.mark.parametrize("apart", [0.5, 1e-6])
@pytest.mark.parametrize("scale", [1.0, 1e6])
def test_poles_have_the_digits_of_their_condition(damping: float, apart: float, scale: float) -> None:
    """In units of masses and springs, whatever those of the states.

    Balancing does not find these where near modes differ by 1e6; what it leaves then is graded, which QR
    keeps.
    """
    A, B, C = two_modes(damping, apart, scale)
    even = two_modes(damping, apart, 1.0)[0]
    found = poles(plain(A, B, C))[0]
    with mp.workdps(DIGITS):
        expected = mp.eig(mp.matrix(A.tolist()), left=False, right=False)
        sizes, left, right = mp.eig(mp.matrix(even.tolist()), left=True, right=True)
        left, right = (np.array(x.tolist(), dtype=complex) for x in (left.H, right))
        errors, sizes = poles_by_qr(even, left, right), np.array(sizes, dtype=complex)
        for value in map(complex, expected):
            nearest = found[np.argmin(np.abs(found - value))]
            target(nearest, value, float(errors[np.argmin(np.abs(sizes - value))]) / abs(value))


@pytest.mark.parametrize("damping", [1e-2, 1e-3, 1e-4])
@pytest.mark.parametrize("scale", [1.0, 1e6])
def test_peaks_of_near_modes_in_50_digits(damping: float, scale: float) -> None:
    """Two modes a hundredth apart: the highest value at the chosen frequencies is the peak."""
    A, B, C = two_modes(damping, 0.01, scale)
    system = plain(A, B, C)
    omega = response_frequencies(system)
    found = np.abs(frequency_response(system, {}, omega))[0, :, 0, 0]
    k = int(np.argmax(found))
    with mp.workdps(DIGITS):

        def gain(w: mp.mpf) -> mp.mpf:
            shifted = mp.mpc(0, 1) * w * mp.eye(4) - mp.matrix(A.tolist())
            return abs((mp.matrix(C.tolist()) * mp.lu_solve(shifted, mp.matrix(B.tolist())))[0])

        target(found[k], float(gain(mp.mpf(omega[0, k]))), RESPONSE)
        low, high = mp.mpf(omega[0, k - 1]), mp.mpf(omega[0, k + 1])
        for _ in range(60):  # the gain has one peak between neighbors: golden section
            span = (high - low) * (mp.sqrt(5) - 1) / 2
            if gain(high - span) > gain(low + span):
                high = low + span
            else:
                low = high - span
        peak = gain((low + high) / 2)
        target(found[k], float(peak), PEAK)
        norm = hinf_norm(system)
        assert norm.lower[0] <= float(peak) * (1.0 + RESPONSE)
        assert norm.upper[0] >= float(peak) * (1.0 - RESPONSE)


@pytest.mark.parametrize("scale", [1.0, 1e6])
def test_steps_of_badly_scaled_systems_in_50_digits(scale: float) -> None:
    A, B, C = two_modes(1e-4, 0.5, scale)
    times = np.array([0.0, 0.5, 7.0, 100.0])
    found = step_response(plain(A, B, C), {}, times).values[0, :, 0, 0]
    with mp.workdps(DIGITS):
        matrix = mp.matrix(A.tolist())
        settled = mp.lu_solve(matrix, mp.matrix(B.tolist()))
        expected = [
            float((mp.matrix(C.tolist()) * (mp.expm(matrix * t) - mp.eye(4)) * settled)[0])
            for t in map(float, times)
        ]
    target(found, expected, RESPONSE)


def test_poles_of_scaled_integrators_are_exactly_zero() -> None:
    A = np.zeros((3, 3))
    A[0, 1], A[1, 2], A[2, 2] = 1e6, 1e-6, -1e3
    found = poles(plain(A, [[0.0], [0.0], [1.0]], [[1.0, 0.0, 0.0]]))[0]
    target(np.sort(found.real), [-1e3, 0.0, 0.0], CLOSED_FORM)
