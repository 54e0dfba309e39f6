"""Spinning frames against closed forms: flapping and lagging booms, tops, pendulums on a turntable."""

import numpy as np
import pytest

import mbdlft
from tests.close import CLOSED_FORM, target

M = mbdlft.Parameter("m", 2.0, percent=50, unit="kg")
LENGTH = mbdlft.Parameter("L", 0.8, low=0.5, high=1.2, unit="m")
OFFSET = mbdlft.Parameter("e", 0.2, low=0.05, high=0.4, unit="m")
RATE = mbdlft.Parameter("rate", 2.0, low=0.5, high=4.0, unit="rad/s")
STIFFNESS = mbdlft.Parameter("k", 90.0, low=60.0, high=150.0, unit="N/m")
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


def test_pendulum_held_at_an_angle_in_a_turning_frame() -> None:
    """J qdd = W^2 m L^2 cos(2 th) q - m g L cos(th) q, torque m g L sin th - W^2 m L^2 sin th cos th.

    The pendulum is held by a torque at any angle th in the turning frame; gravity is along the axis.
    """
    scene = mbdlft.Scene(
        name="governor",
        gravity=(0, 0, -GRAVITY),
        spin=mbdlft.Spin(axis=(0, 0, 1), rate="rate"),
        parameters=[M, LENGTH, RATE, mbdlft.Angle("th", 40.0, low=10.0, high=80.0)],
        bodies=[mbdlft.PointMass(name="bob", mass="m", ports={"pivot": (0, 0, "L")})],
        joints=[
            mbdlft.Revolute(name="j", parent="ground", child="bob.pivot", axis=(0, -1, 0), position="th")
        ],
    )
    model = mbdlft.to_lft(scene, search=0.0)
    v = values_of(model)
    A, th = mbdlft.matrices_at(model, v).A, np.deg2rad(v["th"])
    turning, falling = v["rate"] ** 2, GRAVITY / v["L"]
    expected = turning * np.cos(2 * th) - falling * np.cos(th)
    target(A[:, 1, 0], expected, CLOSED_FORM, scale=float(np.max(turning + falling)))
    torque = falling * np.sin(th) - turning * np.sin(th) * np.cos(th)
    torque *= v["m"] * v["L"] ** 2
    target(mbdlft.trim_at(model, v)[:, 0], torque, CLOSED_FORM)


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


def test_bead_in_a_turning_slot() -> None:
    """m (xdd - 2 W yd - W^2 x) + k x = 0, m (ydd + 2 W xd - W^2 y) + k y = 0."""
    scene = mbdlft.Scene(
        name="slot",
        spin=mbdlft.Spin(axis=(0, 0, 1), rate="rate"),
        parameters=[M, RATE, STIFFNESS],
        bodies=[mbdlft.RigidBody(name="frame", mass=0), mbdlft.PointMass(name="bead", mass="m")],
        joints=[
            mbdlft.Prismatic(name="x", parent="ground", child="frame", axis=(1, 0, 0), stiffness="k"),
            mbdlft.Prismatic(name="y", parent="frame", child="bead", axis=(0, 1, 0), stiffness="k"),
        ],
    )
    model = mbdlft.to_lft(scene, search=0.0)
    v = values_of(model)
    A = mbdlft.matrices_at(model, v).A
    stiff, twice = v["rate"] ** 2 - v["k"] / v["m"], 2 * v["rate"]
    nothing = np.zeros(len(stiff))
    expected = [[stiff, nothing, nothing, twice], [nothing, stiff, -twice, nothing]]
    target(A[:, 2:], np.moveaxis(expected, 2, 0), CLOSED_FORM)


def test_nutation_of_a_free_top() -> None:
    """A symmetric body that turns freely: seen in its frame it nutates with |Jz - Jt|/Jt W.

    Its center moves on a straight line, which in the turning frame has the double frequency W.
    """
    scene = mbdlft.Scene(
        name="top",
        spin=mbdlft.Spin(axis=(0, 0, 1), rate="rate"),
        parameters=[M, RATE, mbdlft.Parameter("Jz", 3.0, low=2.2, high=3.8, unit="kg m^2")],
        bodies=[mbdlft.RigidBody(name="top", mass="m", inertia=mbdlft.Inertia(xx=2, yy=2, zz="Jz"))],
        joints=[mbdlft.Free(name="j", parent="ground", child="top")],
    )
    model = mbdlft.to_lft(scene, search=0.0)
    v = values_of(model)
    A = mbdlft.matrices_at(model, v).A
    names = [signal.name for signal in model.states]
    turning = [k for k, name in enumerate(names) if "rotation" in name or "rate" in name]
    # small rotations about x and y, and the equations of Euler for their rates
    across = [k for k in turning if not names[k].endswith(".z")]
    part = A[:, across][:, :, across]
    nutation, rate = (v["Jz"] - 2.0) / 2.0 * v["rate"], v["rate"]
    # det(s - A) = (s^2 + rate^2) (s^2 + nutation^2)
    for matrix, a, b in zip(part, rate, nutation, strict=True):
        expected = np.polymul([1.0, 0.0, a**2], [1.0, 0.0, b**2])
        target(np.poly(matrix), expected, CLOSED_FORM)
    spinning = [k for k in turning if names[k].endswith(".z")]
    exact = np.broadcast_to([[0.0, 1.0], [0.0, 0.0]], (len(A), 2, 2))
    target(A[:, spinning][:, :, spinning], exact, CLOSED_FORM)
