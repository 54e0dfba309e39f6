"""Rotors and gears against their equations in maximal coordinates, in 150 digits.

The truth moves: its rotors turn, with matrices of inertia that turn with them. It knows nothing of
symmetry, and agrees only because the linear model of what is symmetric does not depend on time.
"""

from collections.abc import Callable

import numpy as np
import pytest

import mbdlft
from tests import close
from tests.cross.steady_mechanisms import second_bearing, spinning
from tests.cross.test_mechanism import equals_truth, points_of


def geared_wheel() -> mbdlft.Scene:
    """A wheel on a swing behind a gear: its center lies on its axis, and off the point of its joint."""
    return mbdlft.Scene(
        name="geared_wheel",
        gravity=(0.3, 0.0, -9.81),
        parameters=[
            mbdlft.Parameter("W", 40.0, low=-20.0, high=90.0, unit="rad/s"),
            mbdlft.Parameter("n", 3.0, low=2.0, high=5.0),
        ],
        bodies=[
            mbdlft.RigidBody(
                name="swing",
                mass=3.0,
                center_of_mass=(0.1, 0.2, -0.5),
                inertia=mbdlft.Inertia(xx=0.4, yy=0.5, zz=0.3, xz=0.05),
                ports={"eye": (0.1, 0.0, -0.8)},
            ),
            mbdlft.RigidBody(
                name="wheel",
                mass=1.5,
                center_of_mass=(0.0, 0.0, 0.2),
                inertia=mbdlft.Inertia(xx=0.06, yy=0.06, zz=0.1),
            ),
        ],
        joints=[
            mbdlft.Universal(name="cross", parent="ground", child="swing", actuator_inertia=(0.2, 0.3)),
            mbdlft.Revolute(
                name="motor",
                parent="swing.eye",
                child="wheel",
                axis=(0, 0, 1),
                orientation=[mbdlft.Rotation(axis=(1, 1, 0), angle="40*deg")],
                rate="W",
                gear_ratio="n",
                actuator_inertia=0.02,
                reflected_inertia=0.01,
                damping=0.01,
            ),
        ],
        sensors=[mbdlft.Momentum(name="whole"), mbdlft.JointWrench(name="cut", joint="cross")],
        outputs=["motor.rate", "whole.angular.x", "whole.linear.y", "cut.torque.x", "cut.force.z"],
    )


def carried_rotor() -> mbdlft.Scene:
    """A frame that spins tilts a body, in which a geared joint turns an arm about a tilted axis."""

    def body(name: str, xx: float, yy: float, zz: float) -> mbdlft.RigidBody:
        return mbdlft.RigidBody(name=name, mass=1.0, inertia=mbdlft.Inertia(xx=xx, yy=yy, zz=zz))

    return mbdlft.Scene(
        name="carried_rotor",
        spin=mbdlft.Spin(axis=(0, 0, 1), rate="W"),
        parameters=[
            mbdlft.Parameter("W", 2.0, low=0.5, high=4.0, unit="rad/s"),
            mbdlft.Parameter("n", -20.0, low=-30.0, high=-10.0),
            mbdlft.Parameter("J", 0.01, percent=40, unit="kg m^2"),
            mbdlft.Angle("g", 20.0, low=-40.0, high=60.0),
        ],
        bodies=[body("body", 2.0, 3.0, 2.5), body("arm", 0.4, 0.7, 0.9)],
        joints=[
            mbdlft.Revolute(name="tilt", parent="ground", child="body", axis=(1, 0, 0), position="g"),
            mbdlft.Revolute(
                name="gear",
                parent="body",
                child="arm",
                axis=(0.0, 0.6, 0.8),
                position=0.6,
                actuator_inertia="J",
                gear_ratio="n",
            ),
        ],
    )


def tower() -> mbdlft.Scene:
    """A gimbal with two rotors across each other on a swing, under gravity, without loads."""
    wheel = {"xx": 0.06, "yy": 0.06, "zz": "J"}
    return mbdlft.Scene(
        name="tower",
        gravity=(0.5, 0, -9.81),
        parameters=[
            mbdlft.Parameter("W", 300.0, percent=40, unit="rpm"),
            mbdlft.Parameter("J", 0.1, percent=15, unit="kg m^2"),
            mbdlft.Angle("g", 20.0, low=-50.0, high=60.0),
        ],
        bodies=[
            mbdlft.RigidBody(
                name="swing",
                mass=6.0,
                center_of_mass=(0.1, 0.2, -0.5),
                inertia=mbdlft.Inertia(xx=0.4, yy=0.5, zz=0.3, xz=0.05),
                ports={"eye": (0.1, 0.0, -0.8)},
            ),
            mbdlft.RigidBody(name="ring", mass=1.0, inertia=mbdlft.Inertia(xx=0.03, yy=0.04, zz=0.05)),
            *(
                mbdlft.RigidBody(
                    name=name, mass=2.0, center_of_mass=(0, 0, 0.05), inertia=mbdlft.Inertia(**wheel)
                )
                for name in ("first", "second")
            ),
        ],
        joints=[
            mbdlft.Spherical(name="ball", parent="ground", child="swing"),
            mbdlft.Revolute(
                name="gimbal", parent="swing.eye", child="ring", axis=(1, 0, 0), position="g"
            ),
            mbdlft.Revolute(name="up", parent="ring", child="first", axis=(0, 0, 1), rate="W"),
            mbdlft.Revolute(
                name="across",
                parent="ring",
                child="second",
                axis=(0, 0, 1),
                orientation=[mbdlft.Rotation(axis=(0, 1, 0), angle="90*deg")],
                rate="-2*W",
                damping=0.01,
            ),
        ],
        outputs=["up.angle", "across.angle", "gimbal.angle"],
    )


SCENES: dict[str, Callable[[], mbdlft.Scene]] = {
    "carried rotor": carried_rotor,
    "geared wheel": geared_wheel,
    "second bearing": second_bearing,
    "tower": tower,
    **{f"spinning {seed}": (lambda seed=seed: spinning(seed)) for seed in range(40)},
}
FEW = ("carried rotor", "geared wheel", "second bearing", "spinning 9", "tower")


@pytest.mark.parametrize(
    "name", [name if name in FEW else pytest.param(name, marks=pytest.mark.long) for name in SCENES]
)
def test_rotors_equal_maximal_coordinates(name: str) -> None:
    equals_truth(SCENES[name]())


def test_angles_are_left_out_and_nothing_else_changes() -> None:
    """Without angles among the outputs the model has two states less: rows and columns of the same."""
    scene = tower()
    full = mbdlft.to_lft(scene, search=0.0)
    less = mbdlft.to_lft(scene.model_copy(update={"outputs": ("gimbal.angle", "up.rate")}), search=0.0)
    names = [signal.name for signal in full.states]
    left = [signal.name for signal in less.states]
    assert sorted(set(names) - set(left)) == ["across.angle", "up.angle"]
    kept = [names.index(name) for name in left]
    for point in points_of(scene):
        A, B, _, _ = mbdlft.matrices_at(full, point)
        a, b, _, _ = mbdlft.matrices_at(less, point)
        close.target(np.hstack([a, b]), np.hstack([A[np.ix_(kept, kept)], B[kept]]), close.CROSS)
        gone = [k for k in range(len(names)) if k not in kept]
        assert not np.any(A[:, gone])
