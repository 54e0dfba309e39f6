"""Bodies, joints and what else a scene has, made of a robot and of its numbers by label.

A joint connects its origin, a port of the parent link, with its anchor, a port of the child link; its
orientation is R_z(yaw) R_y(pitch) R_x(roll). The user says which joints move and whether the root does.
"""

import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np

from mbdlft.base.description import AXES, Quantity, Vector
from mbdlft.base.errors import SceneError, check_known, unknown_name
from mbdlft.base.expression import evaluate
from mbdlft.base.parameter import Parameter
from mbdlft.multibody.body import GROUND, Body, Ground, Inertia, RigidBody
from mbdlft.multibody.force import Buoyancy, Force, Load, Torque
from mbdlft.multibody.joint import Fixed, Free, Joint, Planar, Prismatic, Revolute, Rotation, Spherical
from mbdlft.multibody.loop import Loop
from mbdlft.multibody.scene.checks import inertia_conditions, nominal_values
from mbdlft.multibody.scene.quantities import Place, owner_name, value_at
from mbdlft.multibody.scene.scene import Scene
from mbdlft.multibody.sensor import Accelerometer, Gyro, Sensor
from mbdlft.robot.robot import (
    ENTRIES,
    WORLD,
    JointLimit,
    Robot,
    RobotJoint,
    RobotLink,
    RobotLoad,
    of_angles,
    said,
    three,
)

Values = dict[str, Quantity]

HINGES = ("revolute", "continuous")
AXIAL = (*HINGES, "prismatic")  # the types with one coordinate
SPRINGS = ("stiffness", "damping", "actuator_inertia", "reflected_inertia")
SPRUNG = (*AXIAL, "spherical", "floating")  # those whose coordinates can have springs and dampers
PLANAR = ("position.x", "position.y", "position.angle")
TURNS = ("roll", "pitch", "yaw")
_ROUNDING = 1e-15  # rad: of a reader, which is no difference of the file
_UNITS = {"mass": "kg", "center_of_mass": "m", "inertia": "kg m^2", "origin": "m", "anchor": "m"}


def numbers(robot: Robot, right_angle: float, assumed: list[str]) -> Values:
    """The numbers of the file by label, with positions of zero.

    Sentences on what the file does not say are added to `assumed`. An angle that differs by less than
    `right_angle` (rad) from a multiple of a right angle is replaced by it.
    """
    values: Values = {}
    snapped: list[float] = []
    for link in robot.links.values():
        values[f"{link.name}.mass"] = link.mass
        values |= _labelled(f"{link.name}.center_of_mass", AXES, link.center)
        inertia = _inertia(link, right_angle, snapped)
        values |= _labelled(f"{link.name}.inertia", inertia, inertia.values())
    for joint in robot.joints.values():
        turns = [_angle(angle, right_angle, snapped) for angle in joint.rpy]
        values |= _labelled(f"{joint.name}.origin", (*AXES, *TURNS), (*joint.xyz, *turns))
        values |= _labelled(f"{joint.name}.anchor", AXES, joint.anchor)
        values |= {f"{joint.name}.{key}": value for key, value in _of_kind(joint).items()}
    if snapped:
        assumed.append(
            f"{len(snapped)} angles are multiples of 90 deg, from which the file differs by at most "
            f"{max(snapped):.1e} rad"
        )
    links, limited = robot.links.values(), ("revolute", "prismatic")
    free = (j.name for j in robot.joints.values() if j.kind in limited and j.lower is None)
    points = (link.name for link in links if link.mass and not any(link.inertia.values()))
    assumed += said(
        "links without <inertial> have no mass: {}", (k.name for k in links if not k.inertial)
    )
    assumed += said("joints without limits of position have none: {}", free)
    assumed += said("links with a mass and no inertia are point masses: {}", points)
    return values


def _labelled(owner: str, names: Iterable[str], entries: Iterable[Quantity]) -> Values:
    """Entries by the names that they have in an owner."""
    return {f"{owner}.{name}": entry for name, entry in zip(names, entries, strict=True)}


def _of_kind(joint: RobotJoint) -> Values:
    """Positions, springs, dampers and actuator inertias that the coordinates of a joint have."""
    values: Values = {}
    if joint.kind in AXIAL:
        values["position"] = joint.position
    if joint.kind in SPRUNG:
        values |= {"stiffness": joint.stiffness, "damping": joint.damping}
    if joint.kind in HINGES:
        values |= {"actuator_inertia": 0.0, "reflected_inertia": joint.reflected_inertia}
    elif joint.kind in ("prismatic", "spherical"):
        values["actuator_inertia"] = joint.reflected_inertia
    elif joint.kind == "planar":
        values |= dict.fromkeys(PLANAR, 0.0)
    return values


def _angle(angle: float, right_angle: float, snapped: list[float]) -> Quantity:
    """The angle (rad), or the multiple of 90 deg nearly equal to it; `snapped` gets the change."""
    quarters = round(angle / (math.pi / 2.0))
    difference = abs(angle - quarters * math.pi / 2.0)
    if difference > right_angle:
        return angle
    if difference > _ROUNDING:
        snapped.append(difference)
    return f"{90 * quarters}*deg" if quarters else 0.0


def _inertia(link: RobotLink, right_angle: float, snapped: list[float]) -> Mapping[str, float]:
    """Entries of the inertia matrix in the axes of the link."""
    right = [round(angle / (math.pi / 2.0)) * math.pi / 2.0 for angle in link.rpy]
    is_right = [angle != 0.0 and _angle(angle, right_angle, snapped) != angle for angle in link.rpy]
    R_lc = of_angles(three(np.where(is_right, right, link.rpy)))
    if np.array_equal(R_lc, np.eye(3)):
        return link.inertia
    J_c = np.array([[link.inertia["".join(sorted(a + b))] for b in AXES] for a in AXES])
    J_l = R_lc @ J_c @ R_lc.T
    return {name: float(J_l[AXES.index(name[0]), AXES.index(name[1])]) + 0.0 for name in ENTRIES}


def varied(label: str, percent: float, file: Mapping[str, Quantity]) -> Parameter:
    """A parameter in a range of `percent` around a number of the file.

    Its name is the label with underscores for dots.
    """
    check_label("vary", label, file)
    number, match = file[label], re.search(rf"\.({'|'.join(_UNITS)})(\.[xyz]{{1,2}})?$", label)
    if match is None or not isinstance(number, float) or number == 0.0:
        raise SceneError(
            f"vary, {label!r}: expected a mass, an inertia or a length of the file that is not zero, got "
            f"{number!r}. Declare other parameters in `parameters`, and name them in `values`."
        )
    name = re.sub(r"\W", "_", label)
    return Parameter(
        name if name.isidentifier() else f"_{name}", number, percent=percent, unit=_UNITS[match[1]]
    )


def check_label(what: str, label: str, file: Mapping[str, Quantity]) -> None:
    """Raise a SceneError for a label that the robot does not have."""
    if label in file or (label.endswith(".preload") and f"{label[:-8]}.position" in file):
        return
    owners = {name for known in file for name in _owners(known)}
    nearby = [k for k in file if any(k.startswith(f"{name}.") for name in _owners(label))]
    if nearby:
        raise SceneError(f"{what}: {unknown_name('label', label, nearby)}")
    owner = label.partition(".")[0]
    raise SceneError(f"{what}, {label!r}: {unknown_name('link or joint', owner, owners)}")


def _owners(label: str) -> Iterable[str]:
    """Possible names of the link or joint of a label; names may have dots, so there can be two."""
    keys = "|".join((*_UNITS, "position", "preload", *SPRINGS))
    match = re.fullmatch(rf"(.+)\.(?:{keys})(?:\.\w+)?", label)
    return (match[1],) if match else (label.rpartition(".")[0], label.partition(".")[0])


def set_positions(robot: Robot, values: Values, chosen: set[str], assumed: list[str]) -> None:
    """Set the positions in `values` that the user did not choose and that are not zero.

    These are positions of mimic joints, and of joints whose limits exclude zero. `chosen` are the labels
    that the user chose; sentences on the positions are added to `assumed`.
    """
    for joint in robot.joints.values():
        label = f"{joint.name}.position"
        is_free = label not in chosen and joint.kind in AXIAL and joint.mimic is None
        if not (is_free and outside(joint)):
            continue
        if robot.loops:
            assumed.append(
                f"the limits of {joint.name} exclude the place where the file closes its loops; it stays "
                "there"
            )
            continue
        values[label] = middle = 0.5 * sum(end for end in (joint.lower, joint.upper) if end)
        assumed.append(
            f"the limits of {joint.name} exclude {joint.position:g}: its position is their middle, "
            f"{middle:.6g} {'m' if joint.kind == 'prismatic' else 'rad'}"
        )
    for joint in robot.joints.values():
        if joint.kind in AXIAL and joint.mimic and f"{joint.name}.position" not in chosen:
            values[f"{joint.name}.position"] = _follow(robot, joint, values, chosen, ())


def outside(joint: RobotJoint) -> bool:
    """Whether the position of a joint in its file is outside of its limits."""
    if joint.lower is None or joint.upper is None:
        return False
    return not joint.lower <= joint.position <= joint.upper


def _follow(
    robot: Robot, joint: RobotJoint, values: Values, chosen: set[str], seen: tuple[str, ...]
) -> Quantity:
    """Position of a mimic joint: multiplier * position of its leader + offset.

    `seen` are the mimic joints that led here.
    """
    label = f"{joint.name}.position"
    if joint.mimic is None or label in chosen:
        return values[label]
    name, multiplier, offset = joint.mimic
    where = f"line {joint.line}: joint {joint.name!r}, <mimic>"
    check_known("joint", [name], robot.joints, where)
    leader = robot.joints[name]
    if leader.kind not in AXIAL:
        raise SceneError(f"{where}: the joint {name!r} is {leader.kind}: it has no position to follow.")
    if name in (*seen, joint.name):
        raise SceneError(f"{where}: the joints {', '.join((*seen, joint.name))} mimic each other.")
    position = _follow(robot, leader, values, chosen, (*seen, joint.name))
    if isinstance(position, float | int):
        return multiplier * position + offset
    scaled = f"({position})" if multiplier == 1.0 else f"{multiplier:g}*({position})"
    return f"{scaled} + {offset!r}" if offset else scaled


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
        return self.names[link] if link else GROUND

    def port(self, joint: str) -> str:
        """The port that a joint has on its parent, and on its child if it needs one there."""
        name = self.names[joint]
        return f"{name}_port" if name in ("origin", "center_of_mass") else name

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

    def leader(self, joint: RobotJoint) -> str:
        """The name in the file of the joint that a joint follows, if both move; else empty."""
        leader = joint.mimic.leader if joint.mimic and joint.kind in AXIAL else ""
        return leader if {joint.name, leader} <= self.moves else ""

    def is_passive(self, joint: RobotJoint) -> bool:
        """Whether only its spring holds the joint: it follows others, or has no drive in a loop."""
        inputs, couplings = self.robot.inputs, self.robot.couplings
        held = (each.held for each in couplings if each.couples(self.moves))
        is_free = bool(self.robot.loops) and inputs is not None and joint.name not in inputs
        return is_free or bool(self.leader(joint)) or joint.name in held

    def preload(self, joint: RobotJoint) -> Quantity | None:
        """The effort of a joint with one coordinate at equilibrium; None if it is to be found."""
        preload = self.values.get(f"{joint.name}.preload")
        if preload is not None or not self.is_passive(joint):
            return preload
        stiffness, position = (self.values[f"{joint.name}.{key}"] for key in ("stiffness", "position"))
        if stiffness == 0.0:
            return 0.0
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


def unphysical(scene: Scene, links: Iterable[Body]) -> dict[str, str]:
    """Problems by name of the body, for bodies whose inertia no body can have at nominal."""
    problems, nominal = dict[str, str](), nominal_values(scene)
    for body in links:
        quantities = body.quantities()
        for label, expected in quantities.items():
            value_at(Place(owner_name(body), label), expected, nominal)  # an error names the place
        for condition in inertia_conditions(body, quantities, nominal):
            value = float(evaluate(condition.expression, nominal))
            if value < -condition.slack:
                problems.setdefault(body.name, f"{condition.what}: {value:.3g}.")
    return problems


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
    """Names of the joints that move; a joint that mimics 0 times another one does not."""
    items = ((name, j) for name, j in robot.joints.items() if j.kind != "fixed")
    able = {name: j for name, j in items if not (j.mimic and j.mimic.multiplier == 0.0)}
    if moving is None:
        return frozenset(able)
    always = frozenset(name for name, joint in able.items() if _is_base(joint))
    can = frozenset(able) - always
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
    parents, carrying = {joint.child: joint.parent for joint in robot.joints.values()}, set[str]()
    keys = ("mass", *(f"inertia.{entry}" for entry in ENTRIES))
    for link in [link for link in parents if any(values[f"{link}.{key}"] != 0.0 for key in keys)]:
        while link in parents and link not in carrying:  # it, and all that it moves with
            carrying.add(link)
            link = parents[link]
    for joint in robot.joints.values():
        inertias = (values.get(f"{joint.name}.{key}", 0.0) for key in _INERTIAS)
        is_without = joint.name in moves and joint.child not in carrying
        if is_without and all(inertia == 0.0 for inertia in inertias):
            carried = [joint.child]
            for link in carried:  # which grows on the way
                carried += [child for child, parent in parents.items() if parent == link]
            where = f"line {joint.line}: " if joint.line else ""
            raise SceneError(
                f"{where}joint {joint.name!r} moves nothing that has a mass or an inertia: "
                f"{', '.join(carried)}. Give one of these an <inertial>, or a value to "
                f"'{joint.child}.mass' and '{joint.child}.inertia.xx', ..., or to "
                f"'{joint.name}.actuator_inertia'; or leave the joint out of `moving`."
            )
