"""Linearizations, trims and responses in doubles are within a hundred roundings of many digits."""

from fractions import Fraction

import mpmath
import numpy as np
import pytest

import mbdlft
from mbdlft.exact.rounding import EPS, MOST_ROUNDINGS
from mbdlft.multibody.to_problem import problem_of_scene
from tests.close import ROOM
from tests.oscillators import random_system


@pytest.mark.parametrize("name", ["two_link_arm", "four_bar", "gimbal"])
def test_linearizations_and_trims(name: str) -> None:
    problem = problem_of_scene(mbdlft.load_scene(f"scenarios/{name}.toml"))
    at, some = problem.reference(), [0, 1, -1]
    assert at.in_digits is not None
    assert at.trim_in_digits is not None
    rounding = EPS * np.maximum(at.scale, np.max(at.sizes(), axis=0))
    errors = np.abs(at.values[some] - at.in_digits(problem.points[some])) / rounding
    truth, scale = at.trim_in_digits()
    of_trim = np.abs(at.trimmed - truth) / (EPS * scale)
    assert ROOM * max(np.max(errors), np.max(of_trim)) <= MOST_ROUNDINGS


@pytest.mark.parametrize("seed", range(3))
def test_responses_over_time(seed: int) -> None:
    """exp of [A B ; 0 0] in 40 digits: a step; it is within roundings of what exp(|A| t) would add up."""
    system = random_system(seed, 4, 2, 2, direct=True)
    A, B, C, D = (np.asarray(x) for x in (system.A, system.B_u, system.C_y, system.D_yu))
    times = np.linspace(0.0, 3.0, 25)
    found = mbdlft.step_response(system, times=times).values[0]
    bordered = np.block([[A, B], [np.zeros((2, 6))]])
    read = np.hstack([C, D])
    with mpmath.workdps(40):
        for t, values in zip(times[[0, 7, 24]].tolist(), found[[0, 7, 24]], strict=True):
            whole = mpmath.expm(mpmath.matrix(bordered.tolist()) * t)
            expected = (mpmath.matrix(read.tolist()) * whole[:, 4:]).tolist()
            error = np.max(np.abs(values - np.array(expected, dtype=float)))

            assert ROOM * error <= MOST_ROUNDINGS * EPS * np.max(np.abs(found))


def test_the_trim_in_digits_has_them_whoever_asks_first() -> None:
    """Two weights on a beam at 45 deg that nearly balance: seven of 16 digits cancel."""
    turned = mbdlft.Rotation(axis=(0, 1, 0), angle=0.7853981633974483)
    inertia = mbdlft.Inertia(xx=0.1, yy=0.1, zz=0.1)
    arms = {"left": 0.7, "right": -0.7000001}
    scene = mbdlft.Scene(
        name="scales",
        gravity=(0.0, 0.0, -9.81),
        bodies=[
            mbdlft.RigidBody(name="beam", mass=0.2, inertia=inertia),
            *(
                mbdlft.RigidBody(name=name, mass=1.3, center_of_mass=(x, 0, 0), inertia=inertia)
                for name, x in arms.items()
            ),
        ],
        joints=[
            mbdlft.Revolute(name="pin", parent="ground", child="beam", axis=(0, 1, 0)),
            *(
                mbdlft.Fixed(name=f"{name} weld", parent="beam", child=name, orientation=[turned])
                for name in arms
            ),
        ],
    )
    in_digits = problem_of_scene(scene).reference().trim_in_digits
    assert in_digits is not None
    truth, _ = in_digits()
    torque = float(-Fraction("1.3") * Fraction("9.81") * Fraction("-0.0000001")) * np.sqrt(0.5)
    assert abs(abs(truth[0, 0]) - torque) <= 2.0 * EPS * torque
