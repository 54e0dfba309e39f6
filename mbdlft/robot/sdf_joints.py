"""Joints of an SDF model.

The frame of a joint stands in its child link. Its axis is in the axes of this frame, unless it names
another one; before version 1.5 it is in the axes of the model.
"""

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from mbdlft.base.array import Array
from mbdlft.base.errors import SceneError, unknown_name
from mbdlft.robot.description import WORLD, Mimic, RobotJoint, RobotLink, RobotLoop
from mbdlft.robot.elements import Element, content_numbers, name_of
from mbdlft.robot.sdf_frames import Frames, flag, scopes
from mbdlft.robot.tree import Side, aligned, unique
from mbdlft.robot.turns import angles_of, three

KINDS = {
    "ball": "spherical", "continuous": "continuous", "fixed": "fixed", "prismatic": "prismatic",
    "revolute": "revolute",
}  # fmt: skip
_UNREAD = ("gearbox", "revolute2", "screw", "universal")
_NO_LIMIT = 1e16  # SDF: a limit of this size is none
_LOOPS = {
    "spherical": "spherical",
    "revolute": "revolute",
    "continuous": "revolute",
    "fixed": "fixed",
}
Joints = dict[str, RobotJoint]


def joints_of(
    model: Element, frames: Frames, links: Mapping[str, RobotLink], version: tuple[int, int]
) -> Joints:
    """The joints of a model and its nested models.

    Raises
    ------
    SceneError
        A joint is of a type that a scene does not have, has no link or an unknown one, or a wrong number.
    """
    return unique(
        "joint",
        [
            _joint(scope, element, frames, links, version)
            for scope, owner in scopes(model)
            for element in owner.named("joint")
        ],
    )


def _joint(
    scope: str,
    element: Element,
    frames: Frames,
    links: Mapping[str, RobotLink],
    version: tuple[int, int],
) -> RobotJoint:
    """The joint of an element <joint>."""
    name = f"{scope}{name_of(element)}"
    where = f"joint {name!r}"
    given = element.attributes.get("type", "")
    if given in _UNREAD:
        raise SceneError(
            f"line {element.line}: {where}: joints of the type {given!r} are not read. A scene has "
            "hinges, slides and balls; write it with them, or leave it out."
        )
    if given not in KINDS:
        raise SceneError(f"line {element.line}: {where}: {unknown_name('type', given, KINDS)}")
    parent, child = (
        _end(element, side, scope, frames, links, where) for side in ("parent", "child")
    )
    if not child:
        raise SceneError(f"line {element.line}: {where}: <child>: the world is a parent only.")
    place = frames.in_world(child) if not parent else frames.between(parent, child)
    anchor = frames.between(child, name).p
    joint = RobotJoint(
        name, element.line, KINDS[given], parent, child,
        xyz=three(place.p + place.R @ anchor), rpy=angles_of(place.R), anchor=three(anchor),
    )  # fmt: skip
    if KINDS[given] in ("fixed", "spherical"):
        return joint
    axis = element.only("axis")
    if axis is None:
        raise SceneError(f"line {element.line}: {where}: <axis> is missing.")
    return _with_axis(joint, axis, frames, scope, version)


def _end(
    element: Element,
    side: str,
    scope: str,
    frames: Frames,
    links: Mapping[str, RobotLink],
    where: str,
) -> str:
    """The link at one end, or the world."""
    end = element.only(side)
    name = end.text.strip() if end else ""
    if not name:
        raise SceneError(f"line {element.line}: {where}: <{side}> is missing.")
    if name == "world":
        return WORLD
    if scope + name not in links:
        known = [link.removeprefix(scope) for link in links]
        raise SceneError(
            f"line {element.line}: {where}, {side}: {unknown_name('link', name, known)}"
        )
    return scope + name


def _with_axis(
    joint: RobotJoint, axis: Element, frames: Frames, scope: str, version: tuple[int, int]
) -> RobotJoint:
    """The joint with its axis, limits, damper and spring."""
    where = f"joint {joint.name!r}"
    lower, upper, effort, velocity = (
        _limit(axis, key, where) for key in ("lower", "upper", "effort", "velocity")
    )
    if lower is not None and upper is not None and lower > upper:
        raise SceneError(
            f"line {axis.line}: {where}: the lower limit {lower:g} is above the upper one {upper:g}."
        )
    bounded = joint.kind != "continuous" and (lower is not None or upper is not None)
    kind = "continuous" if joint.kind == "revolute" and not bounded else joint.kind
    dynamics = axis.only("dynamics")
    damping, friction, stiffness, rest = (
        _number(dynamics, key, where) or 0.0
        for key in ("damping", "friction", "spring_stiffness", "spring_reference")
    )
    return joint._replace(
        kind=kind,
        axis=three(_direction(joint, axis, frames, scope, version)),
        lower=(-_NO_LIMIT if lower is None else lower) if bounded else None,
        upper=(_NO_LIMIT if upper is None else upper) if bounded else None,
        effort=effort,
        velocity=velocity,
        stiffness=stiffness,
        rest=rest,
        damping=damping,
        friction=friction,
        mimic=_mimic(axis.only("mimic"), scope, where),
    )


def _direction(
    joint: RobotJoint, axis: Element, frames: Frames, scope: str, version: tuple[int, int]
) -> Array:
    """The axis in the axes of the child."""
    where = f"joint {joint.name!r}"
    given = axis.only("xyz")
    direction = np.array(content_numbers(given, where, 3) if given else (0.0, 0.0, 1.0))
    if not np.any(direction):
        raise SceneError(f"line {axis.line}: {where}: the axis has zero length.")
    expressed = given.attributes.get("expressed_in", "") if given else ""
    if expressed:
        frame = frames.find(expressed, scope, f"line {axis.line}: {where}, expressed_in")
    elif version < (1, 5) or flag(axis, "use_parent_model_frame"):
        frame = frames.find("__model__", scope, where)
    else:
        frame = joint.name
    return np.asarray(frames.between(joint.child, frame).R @ direction)


def _limit(axis: Element, key: str, where: str) -> float | None:
    """A limit, or None if there is none."""
    value = _number(axis.only("limit"), key, where)
    if value is None or abs(value) >= _NO_LIMIT or (key in ("effort", "velocity") and value < 0.0):
        return None
    return value


def _number(owner: Element | None, tag: str, where: str) -> float | None:
    """The number of a child, or None if there is none."""
    child = owner.only(tag) if owner else None
    if child is None:
        return None
    if child.text.strip().lower().lstrip("+-") in ("inf", "infinity"):
        return math.copysign(_NO_LIMIT, -1.0 if child.text.strip().startswith("-") else 1.0)
    return content_numbers(child, where, 1)[0]


def _mimic(mimic: Element | None, scope: str, where: str) -> Mimic | None:
    """The contents of an element <mimic>: multiplier (leader - reference) + offset."""
    if mimic is None:
        return None
    if "joint" not in mimic.attributes:
        raise SceneError(f"line {mimic.line}: {where}: <mimic>: the attribute 'joint' is missing.")
    multiplier = _number(mimic, "multiplier", where)
    multiplier = 1.0 if multiplier is None else multiplier
    offset, reference = (_number(mimic, key, where) or 0.0 for key in ("offset", "reference"))
    leader = scope + mimic.attributes["joint"]
    return Mimic(leader, multiplier, offset - multiplier * reference)


# loops ---------------------------------------------------------------------------------------


class Closed(NamedTuple):
    """The joints that make trees, those that close loops, and links and joints that these stand on."""

    tree: Joints
    loops: tuple[RobotLoop, ...]
    sides: tuple[Side, ...]


def closing(joints: Joints, frames: Frames) -> Closed:
    """Part the joints: a second joint to a link closes a loop.

    Raises
    ------
    SceneError
        A joint that closes a loop is of a kind that cannot, or has a spring or a damper.
    """
    tree: Joints = {}
    loops: list[RobotLoop] = []
    sides: list[Side] = []
    carried: Joints = {}
    for joint in joints.values():
        if joint.child not in carried and joint.child not in _above(joint.parent, carried):
            tree[joint.name] = carried[joint.child] = joint
            continue
        if joint.kind not in _LOOPS or joint.stiffness or joint.damping:
            raise SceneError(
                f"line {joint.line}: joint {joint.name!r} closes a loop; expected a hinge, a ball or a "
                f"fixed joint without spring and damper, got {joint.kind!r}."
            )
        place = frames.between(joint.parent, joint.child) if joint.parent else None
        R = (place or frames.in_world(joint.child)).R
        kind = _LOOPS[joint.kind]
        axis = three(R @ np.array(joint.axis)) if kind == "revolute" else None
        ends = (joint.parent, joint.child, joint.xyz, joint.anchor)
        loop, own = aligned(RobotLoop(joint.name, kind, *ends, axis), R, joints)
        loops.append(loop)
        sides += own
    return Closed(tree, tuple(loops), tuple(sides))


def _above(link: str, carried: Mapping[str, RobotJoint]) -> Sequence[str]:
    """A link and those that carry it."""
    found = [link]
    while found[-1] in carried:
        found.append(carried[found[-1]].parent)
    return found
