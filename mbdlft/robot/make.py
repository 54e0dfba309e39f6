"""Bodies, joints and what else a scene has, made of a robot and of its numbers by label.

A joint connects its origin, a port of the parent link, with its anchor, a port of the child link; its
orientation is R_z(yaw) R_y(pitch) R_x(roll). The user says which joints move and whether the root does.
"""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np

from mbdlft.base.description import AXES, Quantity, Vector
from mbdlft.base.errors import SceneError, check_known
from mbdlft.multibody.body import GROUND, Body, Ground, Inertia, RigidBody
from mbdlft.multibody.body.rigid import negative_mass
from mbdlft.multibody.force import Buoyancy, Force, Load, Torque
from mbdlft.multibody.joint import Fixed, Free, Joint, Planar, Prismatic, Revolute, Rotation, Spherical
from mbdlft.multibody.loop import Loop
from mbdlft.multibody.scene.quantities import Place, owner_name, value_at
from mbdlft.multibody.sensor import Accelerometer, Gyro, Sensor
from mbdlft.robot.description import ENTRIES, WORLD, JointLimit, Robot, RobotJoint, RobotLoad
from mbdlft.robot.values import AXIAL, HINGES, PLANAR, SPRINGS, Values

_BUILT_IN_PORTS = ("origin", "center_of_mass")
_AXES = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}
_ABOUT = {"yaw": _AXES["z"], "pitch": _AXES["y"], "roll": _AXES["x"]}
_INERTIAS = ("actuator_inertia", "reflected_inertia")


@dataclass(frozen=True, slots=True)
class Making:
    """All data from which the scene is made.

    `values` are numbers and expressions by label, `names` those in the scene by name in the file, and
    `moves` the names of the joints that move.
    """

    robot: Robot
    values: Values
    names: Mapping[str, str]
    moves: frozenset[str]

    def vector(self, label: str) -> Vector:
        """The three quantities ``label.x``, ``label.y``, ``label.z``."""
        x, y, z = (self.values[f"{label}.{axis}"] for axis in AXES)
        return x, y, z

    def body(self, link: str) -> str:
        """The body of a link, or the ground."""
        return self.names[link] if link else GROUND

    def port(self, joint: str) -> str:
        """The port that a joint has on its parent, and on its child if it needs one there."""
        name = self.names[joint]
        return f"{name}_port" if name in _BUILT_IN_PORTS else name

    def on_child(self, joint: RobotJoint) -> Vector | None:
        """The port that a joint has on its child (m); None if it is the origin of the child.

        A locked prismatic joint holds the child at minus its position along the axis from the anchor, so
        that the anchor is at the position.
        """
        anchor = self.vector(f"{joint.name}.anchor")
        position = self.values.get(f"{joint.name}.position", 0.0)
        if joint.kind != "prismatic" or joint.name in self.moves or position == 0.0:
            return anchor if any(anchor) else None
        length = math.hypot(*joint.axis)
        x, y, z = (
            f"{at!r} + {-entry / length!r}*({position})" if entry else at
            for at, entry in zip(anchor, joint.axis, strict=True)
        )
        return x, y, z

    def is_passive(self, joint: RobotJoint) -> bool:
        """Whether nothing but its spring can hold the joint: it has no drive, where loops are closed.

        Elsewhere the effort that holds a joint is found, so that a robot can stand in any position.
        """
        robot = self.robot
        return bool(robot.loops) and robot.inputs is not None and joint.name not in robot.inputs

    def preload(self, joint: RobotJoint) -> Quantity | None:
        """The effort of a joint with one coordinate at equilibrium; None if it is to be found."""
        preload = self.values.get(f"{joint.name}.preload")
        if preload is not None or not self.is_passive(joint):
            return preload
        stiffness, position = (self.values[f"{joint.name}.{key}"] for key in ("stiffness", "position"))
        if isinstance(stiffness, float | int) and isinstance(position, float | int):
            return -stiffness * (position - joint.slack)
        return f"-({stiffness})*(({position}) - {joint.slack!r})"


def bodies(making: Making) -> list[Body]:
    """Bodies of all links, and the ground if it needs ports."""
    robot = making.robot
    ports: dict[str, dict[str, Vector]] = {link: {} for link in (WORLD, *robot.links)}
    for joint in robot.joints.values():
        place, anchor = making.vector(f"{joint.name}.origin"), making.on_child(joint)
        if any(place):
            ports[joint.parent][making.port(joint.name)] = place
        if anchor:
            ports[joint.child][making.port(joint.name)] = anchor
    for loop in robot.loops:
        ports[loop.parent][f"{making.port(loop.name)}_parent"] = loop.at_parent
        ports[loop.child][f"{making.port(loop.name)}_child"] = loop.at_child
    made: list[Body] = [Ground(ports=ports[WORLD])] if ports[WORLD] else []
    for link in robot.links:
        entries = {entry: making.values[f"{link}.inertia.{entry}"] for entry in ENTRIES}
        inertia = {name: entry for name, entry in entries.items() if name[0] == name[1] or entry != 0.0}
        body = RigidBody(
            name=making.names[link],
            mass=making.values[f"{link}.mass"],
            center_of_mass=making.vector(f"{link}.center_of_mass"),
            inertia=Inertia(**inertia),
            ports=ports[link],
        )
        made.append(body)
    return made


def joint_of(making: Making, joint: RobotJoint) -> Joint:
    """The joint of the scene for a joint of the robot; a joint that does not move becomes `Fixed`."""
    parent, child = making.body(joint.parent), making.body(joint.child)
    if any(making.vector(f"{joint.name}.origin")):
        parent = f"{parent}.{making.port(joint.name)}"
    if making.on_child(joint):
        child = f"{child}.{making.port(joint.name)}"
    angles = {turn: making.values[f"{joint.name}.origin.{turn}"] for turn in _ABOUT}
    fields: dict[str, Any] = {
        "name": making.names[joint.name],
        "parent": parent,
        "child": child,
        "orientation": tuple(
            Rotation(axis=_ABOUT[turn], angle=angle) for turn, angle in angles.items() if angle
        ),
    }
    moving = joint.name in making.moves
    labels = {key: f"{joint.name}.{key}" for key in SPRINGS}
    springs = {key: making.values[label] for key, label in labels.items() if label in making.values}
    if joint.kind == "fixed" or (joint.kind == "spherical" and not moving):
        return Fixed(**fields)
    if joint.kind == "floating":
        return Free(**fields, **{key: (value,) * 6 for key, value in springs.items()})
    if joint.kind == "spherical":
        still = {"preload": (0.0,) * 3} if making.is_passive(joint) else {}
        return Spherical(**fields, **still, **{key: (value,) * 3 for key, value in springs.items()})
    fields["axis"] = joint.axis
    if joint.kind == "planar":
        return Planar(**fields, position=tuple(making.values[f"{joint.name}.{key}"] for key in PLANAR))
    position = making.values[f"{joint.name}.position"]
    if not moving:
        return Fixed(**fields, position=position if joint.kind in HINGES else 0.0)
    fields |= springs | {"preload": making.preload(joint)}
    return (Revolute if joint.kind in HINGES else Prismatic)(**fields, position=position)


def holds(making: Making) -> list[Load]:
    """Forces and torques on each free link, along its own axes, whose magnitudes the trim finds."""
    free = [joint.child for joint in making.robot.joints.values() if joint.kind == "floating"]
    kinds: tuple[type[Force | Torque], ...] = (Force, Torque)
    loads: list[Load] = []
    for link, kind, (axis, direction) in product(free, kinds, _AXES.items()):
        port = making.names[link]
        name = f"{port}_hold_{kind.kind}_{axis}".removeprefix("" if len(free) > 1 else f"{port}_")
        loads.append(kind(name=name, port=port, direction=direction))
    return loads


def load_of(making: Making, load: RobotLoad) -> Load:
    """The load of the scene for a load of the robot; an actuator is at rest."""
    name, body = making.names[load.name], making.names[load.link]
    if load.kind == "buoyancy":
        return Buoyancy(name=name, port=f"{body}.center_of_mass", displaced_mass=load.displaced)
    kind = Force if load.kind == "force" else Torque
    return kind(name=name, port=body, direction=load.direction, magnitude=0.0)


def sensors(making: Making) -> list[Sensor]:
    """The sensors of the scene."""
    kinds, names = {"accelerometer": Accelerometer, "gyro": Gyro}, making.names
    return [kinds[s.kind](name=names[s.name], port=names[s.link]) for s in making.robot.sensors]


def loops(making: Making) -> list[Loop]:
    """The joints that close loops."""
    return [
        Loop(
            name=making.names[loop.name],
            kind=loop.kind,
            parent=f"{making.body(loop.parent)}.{making.port(loop.name)}_parent",
            child=f"{making.body(loop.child)}.{making.port(loop.name)}_child",
            axis=loop.axis,
        )
        for loop in making.robot.loops
    ]


def limits(making: Making) -> dict[JointLimit, Quantity]:
    """Limits and positions of the joints that turn or slide, also of locked joints."""
    positions = {}
    for joint in making.robot.joints.values():
        if joint.kind in AXIAL:
            unit = "m" if joint.kind == "prismatic" else "rad"
            ends = (joint.lower, joint.upper, joint.effort, joint.velocity)
            limit = JointLimit(making.names[joint.name], unit, *ends)
            positions[limit] = making.values[f"{joint.name}.position"]
    return positions


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


def on_the_ground(robot: Robot, base: str | None) -> Robot:
    """The robot with its links on the ground fixed there or free, as `base` says."""
    if base is None:
        return robot
    kinds = {"fixed": "fixed", "free": "floating"}
    if base not in kinds:
        raise SceneError(f"base: expected 'fixed' or 'free', got {base!r}.")
    chosen = {name: j._replace(kind=kinds[base]) for name, j in robot.joints.items() if _is_base(j)}
    if not chosen:
        roots = [joint.name for joint in robot.joints.values() if joint.parent == WORLD]
        raise SceneError(
            f"base: nothing is clamped on the ground or free: the root moves on {', '.join(roots)}. "
            "Leave out `base`."
        )
    return robot._replace(joints={**robot.joints, **chosen})


def _is_base(joint: RobotJoint) -> bool:
    """Whether the joint clamps a link on the ground or leaves it free."""
    return joint.parent == WORLD and joint.kind in ("fixed", "floating")


def moves_of(robot: Robot, moving: Iterable[str] | None) -> frozenset[str]:
    """Names of the joints that move."""
    able = {name: joint for name, joint in robot.joints.items() if joint.kind != "fixed"}
    always = frozenset(name for name, joint in able.items() if _is_base(joint))
    can = frozenset(able) - always
    if moving is None:
        return can | always
    if isinstance(moving, str):
        raise SceneError(f"moving: expected a list of names of joints, got the text {moving!r}.")
    chosen = frozenset(moving)
    check_known("joint that can move", sorted(chosen), can, "moving")
    for name in sorted(can - chosen):
        if robot.joints[name].kind not in (*AXIAL, "spherical"):
            raise SceneError(
                f"moving: the {robot.joints[name].kind} joint {name!r} cannot be locked; name it too, or "
                "make it a fixed joint in the file."
            )
    return chosen | always


def refuse_massless(robot: Robot, values: Values, moves: frozenset[str]) -> None:
    """Raise a SceneError for a moving joint if all links that move with it are without mass.

    A loop may move masses on its other side; then the equations say whether they can be solved.
    """
    if robot.loops:
        return
    children: dict[str, list[RobotJoint]] = {}
    for joint in robot.joints.values():
        children.setdefault(joint.parent, []).append(joint)
    for joint in robot.joints.values():
        inertias = (values.get(f"{joint.name}.{key}", 0.0) for key in _INERTIAS)
        if joint.name not in moves or any(inertia != 0.0 for inertia in inertias):
            continue
        pending, carried = [joint.child], []
        while pending:
            carried.append(pending.pop())
            pending += [other.child for other in children.get(carried[-1], [])]
        keys = ("mass", *(f"inertia.{entry}" for entry in ENTRIES))
        if all(values[f"{link}.{key}"] == 0.0 for link in carried for key in keys):
            where = f"line {joint.line}: " if joint.line else ""
            raise SceneError(
                f"{where}joint {joint.name!r} moves nothing that has a mass or an inertia: "
                f"{', '.join(carried)}. Give one of these an <inertial>, or a value to "
                f"'{joint.child}.mass' and '{joint.child}.inertia.xx', ..., or to "
                f"'{joint.name}.actuator_inertia'; or leave the joint out of `moving`."
            )
