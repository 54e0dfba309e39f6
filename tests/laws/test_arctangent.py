"""Laws of angles 2*atan(r): they are the angle, as an angle parameter is, and exactly."""

import numpy as np
import pytest

import mbdlft
from mbdlft import Angle, Inertia, Parameter, PointMass, Revolute, RigidBody, Scene
from tests.close import SCENARIO, roundoff, target


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
    ("position", "angle"),
    [
        ("2*atan(t)", lambda t: 2 * np.arctan(t)),
        ("-2*atan(t) + 30*deg", lambda t: np.pi / 6 - 2 * np.arctan(t)),
        ("4*atan(t)", lambda t: 4 * np.arctan(t)),
        ("atan(t) + atan(t)", lambda t: 2 * np.arctan(t)),
        ("2*atan(t) - 2*atan(0.5*t^2) + atan(0.3)",
         lambda t: 2 * np.arctan(t) - 2 * np.arctan(0.5 * t**2) + np.arctan(0.3)),
        ("2*atan((0.2 + t)/(1.5 - t*0.4))", lambda t: 2 * np.arctan((0.2 + t) / (1.5 - 0.4 * t))),
    ],
)  # fmt: skip
def test_model_is_that_of_the_number(position: str, angle) -> None:  # type: ignore[no-untyped-def]
    """At random values the model is that of a scene with the angle as a number."""
    model = mbdlft.to_lft(arm(position, [TANGENT]), search=0.0)
    assert model.certificate.exact
    assert model.certificate.max_relative_error <= SCENARIO
    for t in (-0.55, 0.0, 0.1, 0.63):
        number = mbdlft.to_lft(arm(float(angle(t)), []), search=0.0)
        found = mbdlft.matrices_at(model, {"t": t, "m": 2.3})
        expected = mbdlft.matrices_at(number, {"m": 2.3})
        for a, b in zip(found, expected, strict=True):
            target(a, b, SCENARIO, scale=max(1.0, float(np.max(np.abs(b), initial=0.0))))
        torque = mbdlft.trim_at(model, {"t": t, "m": 2.3})
        target(torque, mbdlft.trim_at(number, {"m": 2.3}), SCENARIO, scale=30.0)


def test_it_costs_as_much_as_an_angle() -> None:
    """2*atan(t) has the repetitions of an angle parameter with the half-angle substitution."""
    angle = Angle("t", 10.0, low=-60.0, high=70.0)
    written = mbdlft.to_lft(arm("2*atan(t)", [TANGENT]), search=0.0)
    declared = mbdlft.to_lft(arm("t", [angle]), search=0.0)
    assert dict(written.lft.blocks) == dict(declared.lft.blocks)


def test_orientation_may_have_it() -> None:
    model = mbdlft.to_lft(arm(0.3, [TANGENT], "2*atan(t)"), search=0.0)
    number = mbdlft.to_lft(arm(0.3, [], float(2 * np.arctan(0.4))), search=0.0)
    found, expected = mbdlft.matrices_at(model, {"t": 0.4}), mbdlft.matrices_at(number, {})
    roundoff(found.A, expected.A, kappa=100.0)


def test_text_round_trip() -> None:
    scene = arm("20*deg + 2*atan(t)", [TANGENT])
    assert mbdlft.scene_from_toml(mbdlft.scene_to_toml(scene)) == scene
