"""Small scenes to break: the two-link arm with a text replaced, a cart on a rail, a spinner."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from mbdlft import Inertia, Parameter, PointMass, Prismatic, Revolute, RigidBody, Scene, assemble
from mbdlft.multibody.scene import scene_from_toml
from mbdlft.problem.equations import Equations

ARM = (Path(__file__).parents[2] / "scenarios" / "two_link_arm.toml").read_text(encoding="utf-8")


def changed(old: str, new: str, text: str = ARM) -> str:
    """The text of the arm with the first `old` replaced."""
    assert old in text
    return text.replace(old, new, 1)


def arm(old: str, new: str) -> Equations:
    """Equations of the arm with the first `old` replaced in its file."""
    return assemble(scene_from_toml(changed(old, new)))


def cart(
    mass: float | str = 2.0,
    parameters: Sequence[Parameter] = (),
    joint: dict[str, Any] | None = None,
    **fields: Any,
) -> Scene:
    """A point mass with a spring on a rail along y."""
    rail = {"parent": "ground", "child": "cart", "axis": (0, 1, 0), "stiffness": 3.0}
    return Scene(
        **{"name": "cart_on_rail", **fields},
        parameters=parameters,
        bodies=[PointMass(name="cart", mass=mass)],
        joints=[Prismatic(name="rail", **{**rail, **(joint or {})})],
    )


def spinner(parameters: Sequence[Parameter] = (), mass: float | str = 1.0, **inertia: Any) -> Scene:
    """A rigid body with this inertia on a revolute joint about x."""
    return Scene(
        name="spinner",
        parameters=parameters,
        bodies=[RigidBody(name="rotor", mass=mass, inertia=Inertia(**inertia))],
        joints=[Revolute(name="axle", parent="ground", child="rotor", axis=(1, 0, 0))],
    )
