"""Bodies and joints of a scene, made of a robot and of its numbers by label.

A joint of the file places the frame c of its child link in the frame p of its parent link (the notation
is that of `mbdlft.multibody.spatial`):

    r_pc = origin xyz, a port of the parent
    R_pc = R_z(yaw) R_y(pitch) R_x(roll), the orientation of the joint
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
    """All data from which the scene is made.

    Attributes
    ----------
    robot : Robot
        Its first joint connects the root with the ground.
    values : numbers and expressions by label
    names : names in the scene by name in the file
    moves : names of the joints that move
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
        """The port of the child (m) at which a locked prismatic joint holds it; None for other joints.

        It is at minus the position along the axis, so that the origin of the child is at the position.
        """
        position = self.values.get(f"{joint.name}.position", 0.0)
        if joint.kind != "prismatic" or joint.name in self.moves or position == 0.0:
            return None
        length = math.hypot(*joint.axis)
        x, y, z = (f"{-entry / length!r}*({position})" if entry else 0.0 for entry in joint.axis)
        return x, y, z

    def on_ground(self, joint: RobotJoint) -> bool:
        """Whether this joint connects the root with the ground."""
        return joint is next(iter(self.robot.joints.values()))


def bodies(making: Making) -> list[Body]:
    """Bodies of all links, and the ground if it needs a port for the root."""
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
    """The body of a link."""
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
    """The joint of the scene for a joint of the robot; a joint that does not move becomes `Fixed`."""
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
    """Forces and torques on a free root, along its own axes, whose magnitudes the trim finds."""
    root = making.names[making.robot.root]
    kinds: tuple[type[Force | Torque], ...] = (Force, Torque)
    return [
        kind(name=f"hold_{kind.kind}_{axis}", port=root, direction=direction)
        for kind in kinds
        for axis, direction in _AXES.items()
    ]


def limits(making: Making) -> dict[JointLimit, Quantity]:
    """Limits and positions of the joints that turn or slide, also of locked joints."""
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
    """Problems by name of the body, for bodies whose inertia no body can have.

    `nominal` are the nominal values of parameters and constants (SI).
    """
    problems = {}
    for body in links:
        values = {
            label: np.array([float(value_at(Place(owner_name(body), label), expected, nominal))])
            for label, expected in body.quantities().items()
        }
        problem = body.physical_problem(values)
        if problem and problem != negative_mass(values["mass"]):
            problems[body.name] = problem
    return problems


def unchecked(body: Body) -> Body:
    """The body with its inertia marked as unchecked."""
    if not isinstance(body, RigidBody):
        return body
    inertia = body.inertia.model_copy(update={"unchecked": True})
    return body.model_copy(update={"inertia": inertia})
