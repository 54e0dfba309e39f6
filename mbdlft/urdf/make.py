"""Bodies and joints of a robot whose numbers are known by label.

position of a link in its parent     origin xyz, a port of the parent
axes of a joint in its parent        origin rpy: about z by yaw, then y by pitch, then x by roll
inertia of a link                    about its center of mass, in the axes of the link
"""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from mbdlft.base.description import AXES, Quantity, Vector
from mbdlft.multibody.body import GROUND, Body, Ground, Inertia, RigidBody
from mbdlft.multibody.body.rigid import negative_mass
from mbdlft.multibody.force import Force, Load, Torque
from mbdlft.multibody.joint import Fixed, Free, Joint, Planar, Prismatic, Revolute, Rotation
from mbdlft.multibody.scene.quantities import Place, owner_name, value_at
from mbdlft.urdf.file import ENTRIES, Robot, RobotJoint, RobotLink
from mbdlft.urdf.limits import JointLimit
from mbdlft.urdf.values import AXIAL, HINGES, PLANAR, SPRINGS, Values

_BUILT_IN_PORTS = ("origin", "center_of_mass")
_AXES = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}
_ABOUT = {"yaw": _AXES["z"], "pitch": _AXES["y"], "roll": _AXES["x"]}


@dataclass(frozen=True, slots=True)
class Making:
    """A robot, its numbers by label, its names in the scene, and the names of the joints that move.

    The first joint is that of the root on the ground.
    """

    robot: Robot
    values: Values
    names: Mapping[str, str]
    moves: frozenset[str]

    def vector(self, label: str) -> Vector:
        """The three quantities ``label.x``, ``label.y``, ``label.z``."""
        x, y, z = (self.values[f"{label}.{axis}"] for axis in AXES)
        return x, y, z

    def port(self, joint: RobotJoint) -> str:
        """The port that a joint has on its parent, and on its child if it needs one there."""
        name = self.names[joint.name]
        return f"{name}_port" if name in _BUILT_IN_PORTS else name

    def shift(self, joint: RobotJoint) -> Vector | None:
        """Where a locked prismatic joint holds its child: a point against the axis, in the child."""
        position = self.values.get(f"{joint.name}.position", 0.0)
        if joint.kind != "prismatic" or joint.name in self.moves or position == 0.0:
            return None
        length = math.hypot(*joint.axis)
        x, y, z = (f"{-entry / length!r}*({position})" if entry else 0.0 for entry in joint.axis)
        return x, y, z

    def on_ground(self, joint: RobotJoint) -> bool:
        """Whether it is the joint of the root."""
        return joint is next(iter(self.robot.joints.values()))


def bodies(making: Making) -> list[Body]:
    """The links; and the ground, if the root is not at its origin."""
    ground: dict[str, Vector] = {}
    ports: dict[str, dict[str, Vector]] = {link: {} for link in making.robot.links}
    for joint in making.robot.joints.values():
        place, shift = making.vector(f"{joint.name}.origin"), making.shift(joint)
        if any(place):
            side = ground if making.on_ground(joint) else ports[joint.parent]
            side[making.port(joint)] = place
        if shift:
            ports[joint.child][making.port(joint)] = shift
    links = [_body(making, link, ports[link.name]) for link in making.robot.links.values()]
    return [Ground(ports=ground), *links] if ground else [*links]


def _body(making: Making, link: RobotLink, ports: dict[str, Vector]) -> RigidBody:
    entries = {entry: making.values[f"{link.name}.inertia.{entry}"] for entry in ENTRIES}
    given = {name: entry for name, entry in entries.items() if name[0] == name[1] or entry != 0.0}
    return RigidBody(
        name=making.names[link.name],
        mass=making.values[f"{link.name}.mass"],
        center_of_mass=making.vector(f"{link.name}.center_of_mass"),
        inertia=Inertia(**given),
        ports=ports,
    )


def joint_of(making: Making, joint: RobotJoint) -> Joint:
    """A joint of the scene; one that does not move is fixed at its position."""
    parent = GROUND if making.on_ground(joint) else making.names[joint.parent]
    child = making.names[joint.child]
    if any(making.vector(f"{joint.name}.origin")):
        parent = f"{parent}.{making.port(joint)}"
    if making.shift(joint):
        child = f"{child}.{making.port(joint)}"
    angles = {turn: making.values[f"{joint.name}.origin.{turn}"] for turn in _ABOUT}
    fields: dict[str, Any] = {
        "name": making.names[joint.name],
        "parent": parent,
        "child": child,
        "orientation": tuple(
            Rotation(axis=_ABOUT[turn], angle=angle) for turn, angle in angles.items() if angle
        ),
    }
    if joint.kind == "fixed":
        return Fixed(**fields)
    if joint.kind == "floating":
        return Free(**fields)
    fields["axis"] = joint.axis
    if joint.kind == "planar":
        return Planar(
            **fields, position=tuple(making.values[f"{joint.name}.{key}"] for key in PLANAR)
        )
    position = making.values[f"{joint.name}.position"]
    if joint.name not in making.moves:
        return Fixed(**fields, position=position if joint.kind in HINGES else 0.0)
    fields |= {key: making.values[f"{joint.name}.{key}"] for key in SPRINGS}
    fields["preload"] = making.values.get(f"{joint.name}.preload")
    return (Revolute if joint.kind in HINGES else Prismatic)(**fields, position=position)


def holds(making: Making) -> list[Load]:
    """Forces and torques on a free root, along its own axes, that the trim finds."""
    root = making.names[making.robot.root]
    kinds: tuple[type[Force | Torque], ...] = (Force, Torque)
    return [
        kind(name=f"hold_{kind.kind}_{axis}", port=root, direction=direction)
        for kind in kinds
        for axis, direction in _AXES.items()
    ]


def limits(making: Making) -> dict[JointLimit, Quantity]:
    """Limits and positions of the joints that turn or slide, locked ones too."""
    return {
        JointLimit(
            making.names[joint.name],
            "m" if joint.kind == "prismatic" else "rad",
            joint.lower,
            joint.upper,
            joint.effort,
            joint.velocity,
        ): making.values[f"{joint.name}.position"]
        for joint in making.robot.joints.values()
        if joint.kind in AXIAL
    }


def unphysical(links: Iterable[Body], nominal: Mapping[str, Any]) -> dict[str, str]:
    """Bodies whose inertia no body can have, at nominal values of the names (SI), and why."""
    found = {}
    for body in links:
        values = {
            label: np.array([float(value_at(Place(owner_name(body), label), expected, nominal))])
            for label, expected in body.quantities().items()
        }
        problem = body.physical_problem(values)
        if problem and problem != negative_mass(values["mass"]):
            found[body.name] = problem
    return found


def unchecked(body: Body) -> Body:
    """The body with an inertia that may be one that no body can have."""
    if not isinstance(body, RigidBody):
        return body
    inertia = body.inertia.model_copy(update={"unchecked": True})
    return body.model_copy(update={"inertia": inertia})
