"""Laws of angles 2*atan(r): they are the angle, as an angle parameter is, and exactly."""

import pytest

import mbdlft
from mbdlft import Angle, Inertia, Parameter, PointMass, Revolute, RigidBody, Scene
from tests.cross.test_mechanism import equals_truth


def arm(position: float | str, parameters: list[Parameter], orientation: float | str = 0.0) -> Scene:
    """A link with a mass at its tip, on a tilted hinge."""
    return Scene(
        name="arm",
        gravity=(0, 0, -9.81),
        parameters=[Parameter("m", 2.0, percent=30, unit="kg"), *parameters],
        bodies=[
            RigidBody(
                name="link",
                mass=1.0,
                center_of_mass=(0.1, 0.4, 0),
                inertia=Inertia(xx=0.2, yy=0.3, zz=0.4),
                ports={"tip": (0, 0.8, 0.1)},
            ),
            PointMass(name="tip", mass="m"),
        ],
        joints=[
            Revolute(
                name="hinge",
                parent="ground",
                child="link",
                axis=(1, 0.2, 0),
                orientation=[mbdlft.Rotation(axis=(0, 0, 1), angle=orientation)],
                position=position,
            ),
            mbdlft.Fixed(name="weld", parent="link.tip", child="tip"),
        ],
    )


TANGENT = Parameter("t", 0.1, low=-0.6, high=0.7)


@pytest.mark.parametrize(
    ("position", "orientation"),
    [
        ("2*atan(t)", 0.0),
        ("-2*atan(t) + 30*deg", 0.0),
        ("4*atan(t)", 0.0),
        ("atan(t) + atan(t)", 0.0),
        ("2*atan(t) - 2*atan(0.5*t^2) + atan(0.3)", 0.0),
        ("2*atan((0.2 + t)/(1.5 - t*0.4))", 0.0),
        (0.3, "2*atan(t)"),
    ],
)
def test_models_equal_maximal_coordinates(position: float | str, orientation: float | str) -> None:
    assert equals_truth(arm(position, [TANGENT], orientation)).certificate.exact


def test_it_costs_as_much_as_an_angle() -> None:
    """2*atan(t) has the repetitions of an angle parameter with the half-angle substitution."""
    angle = Angle("t", 10.0, low=-60.0, high=70.0)
    written = mbdlft.to_lft(arm("2*atan(t)", [TANGENT]), search=0.0)
    declared = mbdlft.to_lft(arm("t", [angle]), search=0.0)
    assert dict(written.lft.blocks) == dict(declared.lft.blocks)


def test_text_round_trip() -> None:
    scene = arm("20*deg + 2*atan(t)", [TANGENT])
    assert mbdlft.scene_from_toml(mbdlft.scene_to_toml(scene)) == scene
