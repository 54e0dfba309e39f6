"""Transmission zeros against closed forms, python-control, and 50 digits."""

import control
import mpmath as mp
import numpy as np
import pytest

import mbdlft
from mbdlft import System, zeros
from tests.close import CLOSED_FORM, ZEROS, target
from tests.oscillators import matrices, oscillator, plain, random_system, two_masses


def test_two_masses_have_the_zeros_of_the_clamped_ones() -> None:
    """Where the force acts: m2 s^2 + c s + k = 0. At the other mass: c s + k = 0. At both: none."""
    m, k, c = [2.0, 3.0], 1e6, 0.1
    masses = two_masses(m, k, c)
    (first,) = zeros(masses, outputs="y0", inputs="u0")
    expected = -c / 6.0 + 1j * np.sqrt(k / 3.0 - (c / 6.0) ** 2)
    target(first, [expected, np.conj(expected)], CLOSED_FORM)
    (other,) = zeros(masses, outputs=["y1"])
    target(other, [-k / c], ZEROS)
    assert zeros(masses)[0].size == 0


@pytest.mark.parametrize("scale", [1.0, 1e6, 1e-6])
@pytest.mark.parametrize("direct", [False, True])
def test_random_square_systems_against_python_control(scale: float, direct: bool) -> None:
    for seed in range(6):
        system = random_system(seed, 7, 2, 2, direct=direct)
        A, B, C, D = matrices(system)
        expected = np.sort_complex(control.ss(A, B, C, D).zeros())
        units = np.array([scale, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0 / scale])
        other = plain(A * units[:, None] / units, B * units[:, None] * scale, C / units, D * scale)
        assert len(expected) == (7 if direct else 5)
        found = zeros(other)[0]
        apart = np.abs(found[:, None] - expected)
        target(found[np.argmin(apart, axis=0)], expected, ZEROS)
        assert len(set(np.argmin(apart, axis=0))) == len(found) == len(expected)


def test_wide_systems_have_the_zeros_that_were_put_in() -> None:
    """Behind a filter with a zero, in all its inputs, every transfer has that zero."""
    system = random_system(1, 5, 2, 3)
    assert zeros(system)[0].size == 0
    filtered = mbdlft.series(control.tf([1.0, -3.0], [1.0, 4.0]) * np.eye(1), random_system(2, 4, 2, 1))
    found = zeros(filtered)[0]
    assert found.size == 1
    target(found, [3.0], ZEROS)


def test_hidden_modes_are_no_zeros() -> None:
    """A mode that the input does not reach, one that the output does not see, and a zero at -5."""
    A = np.diag([-1.0, -2.0, -3.0, -4.0])
    hidden = plain(A, [[1.0], [0.0], [1.0], [1.0]], [[2.0, 1.0, 0.0, -1.0]])
    (found,) = zeros(hidden)  # 2/(s+1) - 1/(s+4) = (s + 7)/((s+1)(s+4))
    target(found, [-7.0], CLOSED_FORM)
    turn = np.linalg.qr(np.random.default_rng(0).normal(size=(4, 4)))[0]
    B, C = matrices(hidden)[1:3]
    target(zeros(plain(turn @ A @ turn.T, turn @ B, C @ turn.T))[0], [-7.0], ZEROS)


def test_zeros_are_where_the_pencil_loses_rank_in_50_digits() -> None:
    model = mbdlft.to_lft(mbdlft.load_scene("scenarios/two_link_arm.toml"), search=0.0)
    values = mbdlft.corners(model.parameters)
    some = {name: column[::17] for name, column in values.items()}
    found = zeros(model, some, outputs="shoulder.angle", inputs="shoulder.torque")
    A, B, C, _ = mbdlft.matrices_at(model, some)
    assert len(found) == 8
    with mp.workdps(50):
        for k, row in enumerate(found):
            assert len(row) == 2
            for zero in row:
                target(complex(_refined(A[k], B[k, :, :1], C[k, :1], complex(zero))), zero, ZEROS)


def _refined(A: np.ndarray, B: np.ndarray, C: np.ndarray, start: complex) -> mp.mpc:
    """Root of det [A - s, B; C, 0] near a start."""

    def determinant(s: mp.mpc) -> mp.mpc:
        top = np.hstack([A, B]).tolist()
        pencil = mp.matrix([*top, [*C[0].tolist(), 0.0]])
        for i in range(len(A)):
            pencil[i, i] -= s
        return mp.det(pencil)

    return mp.findroot(determinant, (start * (1 + 1e-6), start), solver="secant")


def test_systems_without_zeros() -> None:
    assert zeros(oscillator(0.1))[0].size == 0
    nothing: System = plain([[-1.0]], [[0.0]], [[1.0]])
    assert zeros(nothing)[0].size == 0
