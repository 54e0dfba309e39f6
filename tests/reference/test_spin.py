"""Spinning frames against closed forms: flapping and lagging booms, a pendulum on a turntable."""

import numpy as np
import pytest

import mbdlft
from tests.close import CLOSED_FORM, target

M = mbdlft.Parameter("m", 2.0, percent=50, unit="kg")
LENGTH = mbdlft.Parameter("L", 0.8, low=0.5, high=1.2, unit="m")
OFFSET = mbdlft.Parameter("e", 0.2, low=0.05, high=0.4, unit="m")
RATE = mbdlft.Parameter("rate", 2.0, low=0.5, high=4.0, unit="rad/s")
GRAVITY = 9.81
INERTIA = {"xx": 0.02, "yy": 0.3, "zz": 0.31}


def values_of(model: mbdlft.LFTModel) -> dict[str, np.ndarray]:
    """50 random points and all corners."""
    inside, outer = mbdlft.random(model.parameters, 50), mbdlft.corners(model.parameters)
    return {p.name: np.concatenate([inside[p.name], outer[p.name]]) for p in model.parameters}


def boom(axis: tuple[float, ...]) -> mbdlft.Scene:
    """A boom on a hinge at the distance e from the axis of the spin; about -y it flaps, z it lags."""
    return mbdlft.Scene(
        name="boom",
        spin=mbdlft.Spin(axis=(0, 0, 1), rate="rate"),
        parameters=[M, LENGTH, OFFSET, RATE],
        bodies=[
            mbdlft.Ground(ports={"hinge": ("e", 0, 0)}),
            mbdlft.RigidBody(
                name="boom", mass="m", center_of_mass=("L", 0, 0), inertia=mbdlft.Inertia(**INERTIA)
            ),
        ],
        joints=[mbdlft.Revolute(name="j", parent="ground.hinge", child="boom", axis=axis, preload=0)],
    )


@pytest.mark.parametrize("axis", [(0, -1, 0), (0, 0, 1)])
def test_flapping_and_lagging_boom(axis: tuple[float, ...]) -> None:
    """Flap: w^2 = W^2 (Jz - Jx + e m L)/J; lag: w^2 = W^2 e m L/J.

    J, Jx, Jz are about the hinge. For a thin boom, Jx = 0 and Jz = J: flap is W sqrt(1 + e m L/J).
    """
    model = mbdlft.to_lft(boom(axis), search=0.0)
    v = values_of(model)
    A = mbdlft.matrices_at(model, v).A
    steiner = v["m"] * v["L"] ** 2
    if axis[2]:
        J, restoring = INERTIA["zz"] + steiner, 0.0
    else:
        J, restoring = INERTIA["yy"] + steiner, INERTIA["zz"] - INERTIA["xx"] + steiner
    expected = v["rate"] ** 2 * (restoring + v["e"] * v["m"] * v["L"]) / J
    target(A[:, 1, 0], -expected, CLOSED_FORM)
    target(A[:, 1, 1], np.zeros(len(J)), CLOSED_FORM, scale=1.0)


def test_pendulum_seen_from_a_turntable() -> None:
    """s^2 + 2 i W s + g/L - W^2 = 0 for x + i y: frequencies W0 - W and W0 + W."""
    scene = mbdlft.Scene(
        name="foucault",
        gravity=(0, 0, -GRAVITY),
        spin=mbdlft.Spin(axis=(0, 0, 1), rate="rate"),
        parameters=[M, LENGTH, RATE],
        bodies=[mbdlft.PointMass(name="bob", mass="m", ports={"pivot": (0, 0, "L")})],
        joints=[
            mbdlft.Universal(
                name="j",
                parent="ground",
                child="bob.pivot",
                axis1=(1, 0, 0),
                axis2=(0, 1, 0),
                preload=(0, 0),
            )
        ],
    )
    model = mbdlft.to_lft(scene, search=0.0)
    v = values_of(model)
    A = mbdlft.matrices_at(model, v).A
    found = np.sort(np.abs(np.linalg.eigvals(A).imag), axis=1)[:, ::2]
    swing = np.sqrt(GRAVITY / v["L"])
    expected = np.sort(np.stack([np.abs(swing - v["rate"]), swing + v["rate"]], axis=1), axis=1)
    target(found, expected, CLOSED_FORM)
