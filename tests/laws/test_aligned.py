"""A planar mechanism costs what a planar one does, also in a plane that is not a coordinate plane.

1. The arm in skew planes has the channels and the order of the arm, and nearly its instructions.
2. Axes along the plane change no value: neither of joints, loads and springs, nor of sensors.
"""

from typing import Any

import numpy as np
import pytest

import mbdlft
from benchmarks.needs import TURNED, instructions, thick, turned
from mbdlft.multibody.assembly import resolved
from scenarios import two_link_arm
from tests.close import error, roundoff

SKEW = (TURNED, np.linalg.qr(np.array([[1.0, 2.0, -1.0], [0.5, -1.0, 3.0], [2.0, 0.3, 0.7]]))[0])


def rich() -> mbdlft.Scene:
    """A cart on an inclined rail with a pendulum: springs, forces, buoyancy, orientation, sensors."""
    normal, along = (SKEW[0][:, k] for k in range(2))
    across = np.cross(normal, along)
    sensors = [
        mbdlft.Position(name="tip", port="link.tip"),
        mbdlft.Position(name="seen", port="link.tip", frame="cart"),
        mbdlft.Accelerometer(name="accelerometer", port="link.tip"),
        mbdlft.Gyro(name="gyro", port="link"),
        mbdlft.Momentum(name="momentum"),
        mbdlft.CenterOfMass(name="center"),
        mbdlft.JointWrench(name="load", joint="pivot"),
    ]
    return mbdlft.Scene(
        name="rich",
        gravity=(0.5, -1.0, -9.0),
        acceleration=(0.1, "a", 0.0),
        constants={
            "area": mbdlft.Constant(value=1.0, unit="m^2"),
            "circle": mbdlft.Constant(value=1.0, unit="m^2/s^2"),
        },
        parameters=[
            mbdlft.Parameter("m", 2.0, percent=30, unit="kg"),
            mbdlft.Parameter("L", 0.8, percent=20, unit="m"),
            mbdlft.Parameter("a", 0.3, percent=20, unit="m/s^2"),
            mbdlft.Angle("t", 20.0, 0.0, 50.0),
        ],
        bodies=[
            mbdlft.Ground(ports={"wall": (1.0, 2.0, "L")}),
            mbdlft.PointMass(name="cart", mass="m"),
            mbdlft.RigidBody(
                name="link",
                mass=1.5,
                center_of_mass=("0.3*L", 0.1, "0.2*L + 0.05"),
                inertia=mbdlft.Inertia(xx=0.2, yy=0.3, zz="0.1*m*area", xy=0.01, xz=0.0, yz=-0.02),
                ports={"tip": tuple(f"{x!r}*L" for x in (along + 0.2 * across).tolist())},
            ),
        ],
        joints=[
            mbdlft.Prismatic(name="rail", parent="ground", child="cart", axis=tuple(along)),
            mbdlft.Revolute(
                name="pivot",
                parent="cart",
                child="link",
                axis=tuple(-normal),
                position="t",
                damping=0.1,
                orientation=[mbdlft.Rotation(axis=tuple(normal), angle=0.4)],
            ),
        ],
        loads=[
            mbdlft.Spring(
                name="spring",
                parent="ground.wall",
                child="link.tip",
                stiffness=20.0,
                damping=1.0,
                force_density=3.0,
            ),
            mbdlft.Force(name="thrust", port="link.tip", direction=tuple(across), magnitude=2.0),
            mbdlft.Force(name="pull", port="link", direction=(1, 2, 3), frame="ground", magnitude=1.0),
            mbdlft.Torque(name="motor", port="link", direction=tuple(normal), magnitude="0.2*m*circle"),
            mbdlft.Buoyancy(name="lift", port="link.tip", displaced_mass="0.1*m"),
        ],
        sensors=sensors,
    )


@pytest.mark.parametrize("Q", SKEW)
def test_skew_plane_costs_planar_work(Q: np.ndarray) -> None:
    scene = two_link_arm.scene()
    in_space = {"thick": thick(scene), "skew": turned(scene, Q)}
    assert instructions(in_space["thick"]) == instructions(scene)
    assert instructions(in_space["skew"]) <= 1.1 * instructions(scene)
    planar = mbdlft.to_lft(scene, search=0.0)
    values = mbdlft.random(planar.parameters, 20)
    for described in in_space.values():
        model = mbdlft.to_lft(described, search=0.0)
        assert model.lft.blocks == planar.lft.blocks
        assert model.certificate.raw_order == planar.certificate.raw_order
        for found, expected in zip(
            mbdlft.matrices_at(model, values), mbdlft.matrices_at(planar, values), strict=True
        ):
            roundoff(found, expected)


def test_without_a_common_plane_a_skew_one_costs_more(monkeypatch: pytest.MonkeyPatch) -> None:
    """The measure sees the difference: the planted bug is that no plane is recognized."""
    scene = two_link_arm.scene()
    monkeypatch.setattr(resolved, "_common_axis", lambda *_: None)
    assert instructions(turned(scene, SKEW[0])) > 2 * instructions(scene)


def test_rotations_about_skew_axes_meet_two_components() -> None:
    """As many channels as about a coordinate axis, where the bodies are balls about the axes."""

    def spun(axis: tuple[float, float, float]) -> int:
        scene = mbdlft.Scene(
            name="ball",
            parameters=[mbdlft.Angle("t", 20.0, 0.0, 60.0)],
            bodies=[
                mbdlft.PointMass(name="a", mass=1.0, ports={"p": (0.1, 0.2, 0.3)}),
                mbdlft.RigidBody(name="b", mass=1.0, inertia=mbdlft.Inertia(xx=1, yy=1, zz=1)),
            ],
            joints=[
                mbdlft.Planar(name="base", parent="ground", child="a", axis=(0.0, 0.0, 1.0)),
                mbdlft.Revolute(
                    name="pivot", parent="a.p", child="b", axis=axis, position="t", damping=0.1
                ),
            ],
            gravity=(0.0, 0.0, 0.0),
        )
        return sum(mbdlft.to_lft(scene, search=0.0).certificate.raw_order)

    assert spun((1.0, 2.0, -2.0)) <= spun((1.0, 0.0, 0.0)) + 2


def without_plane(monkeypatch: pytest.MonkeyPatch, scene: mbdlft.Scene) -> mbdlft.LFTModel:
    with monkeypatch.context() as patch:
        patch.setattr(resolved, "_common_axis", lambda *_: None)
        return mbdlft.to_lft(scene, search=0.0)


def difference(a: mbdlft.LFTModel, b: mbdlft.LFTModel) -> float:
    """Largest difference of A, B, C, D relative to each of them, and of the trim."""
    assert (a.states, a.inputs, a.outputs) == (b.states, b.inputs, b.outputs)
    values = mbdlft.random(a.parameters, 10)
    pairs = zip(mbdlft.matrices_at(a, values), mbdlft.matrices_at(b, values), strict=True)
    trims = error(np.array(a.trim.nominal), np.array(b.trim.nominal))
    return max(trims, *(error(found, expected) for found, expected in pairs))


def test_axes_along_the_plane_change_no_value(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = rich()
    expected, found = without_plane(monkeypatch, scene), mbdlft.to_lft(scene, search=0.0)
    roundoff(difference(found, expected), 0.0, kappa=10.0)
    assert sum(found.certificate.raw_order) < sum(expected.certificate.raw_order)
    # sensors are turned back: without that they have other components
    monkeypatch.setattr(resolved.Resolved, "back", lambda self, measured: measured)
    assert difference(mbdlft.to_lft(scene, search=0.0), expected) > 0.1


def test_an_axis_that_is_a_little_off_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing is taken for planar that is not: a part of 1e-9 off the plane stays."""
    scene = turned(two_link_arm.scene(), SKEW[0])
    off = np.array(scene.joints[1].axis) + np.array([1e-9, 0.0, 0.0])
    joints = (scene.joints[0], scene.joints[1].model_copy(update={"axis": tuple(off)}))
    scene = scene.model_copy(update={"joints": (*joints, *scene.joints[2:])})
    called: list[Any] = []
    right = resolved._axes
    monkeypatch.setattr(resolved, "_axes", lambda *given: called.append(given) or right(*given))
    mbdlft.assemble(scene)
    assert not called
    mbdlft.assemble(turned(two_link_arm.scene(), SKEW[0]))
    assert called
