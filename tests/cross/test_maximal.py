"""Rotors, gears and closures against their equations in maximal coordinates, in 150 digits."""

import pytest

import mbdlft
from tests.attack.mechanisms import check
from tests.cross.mixed_mechanisms import mixed
from tests.cross.test_mechanism import points_of


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


def test_a_geared_wheel_equals_maximal_coordinates() -> None:
    scene = geared_wheel()
    check(scene, mbdlft.to_lft(scene, search=0.0), points_of(scene)[:2])


@pytest.mark.long
@pytest.mark.parametrize("seed", sorted({*range(1, 15)} - {11}))  # 11: zeros are not seen in 5120 bits
def test_mixed_mechanisms_equal_maximal_coordinates(seed: int) -> None:
    scene = mixed(seed)
    check(scene, mbdlft.to_lft(scene, search=0.0, prove=0.0), points_of(scene)[:2])
