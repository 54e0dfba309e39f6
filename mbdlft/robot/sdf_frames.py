"""Frames of an SDF model, where links, joints, frames and nested models are; and its joints.

A pose is relative to the frame that it names, or to a default one: of a link or a nested model the
frame of the model around it, of a joint its child link, of a frame the one that it is attached to.
Source: SDFormat documentation, Pose frame semantics.

The frame of a joint stands in its child link. Its axis is in the axes of this frame, unless it names
another one; before version 1.5 it is in the axes of the model.
"""

from collections.abc import Iterator, Mapping
from typing import NamedTuple

import numpy as np

from mbdlft.base.array import Array
from mbdlft.base.errors import SceneError, check_known, naming, unknown_name
from mbdlft.robot import robot, urdf

_WORDS = {"true": True, "1": True, "false": False, "0": False}
MODEL = "__model__"
_WORLD = ""  # the key of the pose of the model in the world
KINDS = {
    "ball": "spherical", "continuous": "continuous", "fixed": "fixed", "prismatic": "prismatic",
    "revolute": "revolute",
}  # fmt: skip
_UNREAD = ("gearbox", "revolute2", "screw", "universal")
_LOOPS = {"spherical": "spherical", "revolute": "revolute", "continuous": "revolute", "fixed": "fixed"}
Joints = dict[str, robot.RobotJoint]


class Pose(NamedTuple):
    """A place (3,) and a rotation (3, 3) of a frame in another one."""

    p: Array
    R: Array

    def then(self, other: "Pose") -> "Pose":
        """The pose of a frame that is given in this one."""
        with np.errstate(over="ignore", invalid="ignore"):  # what is not finite is refused
            return Pose(self.p + self.R @ other.p, self.R @ other.R)

    def inverse(self) -> "Pose":
        """The pose of the other frame in this one."""
        return Pose(-self.R.T @ self.p, self.R.T)


class Frame(NamedTuple):
    """A frame: its pose relative to another frame, by name; `line` is that of its element."""

    pose: Pose
    relative_to: str
    line: int


class Frames:
    """All frames of a model by name; those of nested models with the names of the models before them."""

    def __init__(self, frames: dict[str, Frame], version: tuple[int, int]) -> None:
        self._frames, self._version = frames, version

    def in_model(self, name: str, seen: tuple[str, ...] = ()) -> Pose:
        """The pose of a frame in that of the model."""
        if name == MODEL:
            return Pose(np.zeros(3), np.eye(3))
        frame = self._frames[name]
        if name in seen:
            raise SceneError(
                f"line {frame.line}: the poses of {', '.join(seen)} are relative to each other."
            )
        pose = self.in_model(frame.relative_to, (*seen, name)).then(frame.pose)
        if not np.all(np.isfinite(pose.p)):
            raise SceneError(f"line {frame.line}: {name!r} is too far away to be computed with.")
        return pose

    def in_world(self, name: str) -> Pose:
        """The pose of a frame in the world."""
        pose = self._frames[_WORLD].pose.then(self.in_model(name))
        if not np.all(np.isfinite(pose.p)):
            raise SceneError(f"{name!r} is too far away to be computed with.")
        return pose

    def between(self, a: str, b: str) -> Pose:
        """The pose of the frame b in the frame a."""
        if a == b:
            return Pose(np.zeros(3), np.eye(3))
        if b != MODEL and self._frames[b].relative_to == a:
            return self._frames[b].pose
        return self.in_model(a).inverse().then(self.in_model(b))

    def find(self, name: str, scope: str, where: str) -> str:
        """The full name of a frame that is named in a scope."""
        if name == MODEL:
            return scope.removesuffix("::") or MODEL
        if scope + name in self._frames:
            return scope + name
        known = [known for known in self._frames if known]
        raise SceneError(f"{where}: {unknown_name('frame', scope + name, known)}")

    def own(self, owner: urdf.Element, where: str) -> Pose:
        """The pose of an element that is relative to the element around it."""
        pose = owner.only("pose")
        relative = _relative(pose, self._version)
        if relative:
            raise SceneError(
                f"line {pose.line if pose else owner.line}: {where}: <pose>: a pose relative to "
                f"{relative!r} is not read here; write it relative to the link."
            )
        return _pose(pose, where)

    def inside(self, element: urdf.Element, link: str, scope: str, where: str) -> Pose:
        """The pose of an element of a link in the frame of the link; it may name another frame."""
        pose = element.only("pose")
        relative, place = _relative(pose, self._version), _pose(pose, where)
        if not relative:
            return place
        line = pose.line if pose else element.line
        return self.between(link, self.find(relative, scope, f"line {line}: {where}")).then(place)


def scopes(model: urdf.Element, scope: str = "") -> Iterator[tuple[str, urdf.Element]]:
    """The model and its nested models, each with what stands before the names inside."""
    yield scope, model
    for nested in model.named("model"):
        yield from scopes(nested, f"{scope}{urdf.name_of(nested)}::")


def frames_of(model: urdf.Element, version: tuple[int, int]) -> Frames:
    """The frames of a model: their names differ, and each pose is relative to one of them."""
    placed = model.only("pose")
    if _relative(placed, version) not in ("", "world"):
        raise SceneError(
            f"line {model.line}: {model.called()}: <pose>: expected one relative to the world."
        )
    by_name = {_WORLD: Frame(_pose(placed, model.called()), MODEL, model.line)}
    wanted: list[tuple[str, str, str]] = []
    for scope, owner in scopes(model):
        if owner.attributes.get("placement_frame"):
            raise SceneError(f"line {owner.line}: {owner.called()}: placement_frame is not read.")
        for element in owner.children:
            if element.tag not in ("link", "joint", "frame", "model"):
                continue
            name = scope + urdf.name_of(element)
            if element.tag != "joint" and urdf.name_of(element) in (MODEL, "world"):
                raise SceneError(
                    f"line {element.line}: the name {urdf.name_of(element)!r} means the world or the "
                    f"model and cannot be that of a {element.tag}. Give it another name."
                )
            if name in by_name:
                raise SceneError(
                    f"line {element.line}: the name {name!r} is given twice; first in line "
                    f"{by_name[name].line}."
                )
            where = f"line {element.line}: {element.called()}"
            pose = element.only("pose")
            relative = _relative(pose, version) or _default(element)
            by_name[name] = Frame(_pose(pose, element.called()), relative, element.line)
            wanted.append((name, scope, where))
    frames = Frames(by_name, version)
    for name, scope, where in wanted:
        full = frames.find(by_name[name].relative_to, scope, where)
        by_name[name] = by_name[name]._replace(relative_to=full)
    for name, _, _ in wanted:
        frames.in_model(name)
    return frames


def _default(element: urdf.Element) -> str:
    """The frame to which a pose is relative if it does not say so."""
    child = element.only("child") if element.tag == "joint" else None
    name = child.text.strip() if child else ""
    if element.tag == "frame":
        name = element.attributes.get("attached_to", "")
    return name if name and (name != "world" or element.tag == "frame") else MODEL


def _relative(pose: urdf.Element | None, version: tuple[int, int]) -> str:
    """The frame that a pose names."""
    named = {} if pose is None else pose.attributes
    older = named.get("frame", "") if version < (1, 7) else ""
    return older or named.get("relative_to", "")


def _pose(pose: urdf.Element | None, where: str) -> Pose:
    """The numbers of a pose: a place (m) and roll, pitch, yaw (rad or deg), or a quaternion x y z w."""
    if pose is None or not pose.text.strip():
        return Pose(np.zeros(3), np.eye(3))
    if pose.attributes.get("rotation_format", "euler_rpy") == "quat_xyzw":
        *place, x, y, z, w = urdf.content_numbers(pose, where, 7)
        with naming(f"line {pose.line}: {where}: <pose>", SceneError):
            return Pose(np.array(place), robot.of_quaternion(np.array([w, x, y, z])))
    *place, roll, pitch, yaw = urdf.content_numbers(pose, where, 6)
    degrees = pose.attributes.get("degrees", "false") in ("true", "1")
    unit = np.pi / 180.0 if degrees else 1.0
    return Pose(np.array(place), robot.of_angles((unit * roll, unit * pitch, unit * yaw)))


def flag(owner: urdf.Element, tag: str, *, default: bool = False) -> bool:
    """Whether a child says true or false."""
    child = owner.only(tag)
    if child is None:
        return default
    word = child.text.strip().lower()
    if word not in _WORDS:
        raise SceneError(f"line {child.line}: <{tag}>: expected true or false, got {word!r}.")
    return _WORDS[word]


def _joint(
    scope: str,
    element: urdf.Element,
    frames: Frames,
    links: Mapping[str, robot.RobotLink],
    version: tuple[int, int],
) -> robot.RobotJoint:
    name = f"{scope}{urdf.name_of(element)}"
    where = f"joint {name!r}"
    kind = element.attributes.get("type", "")
    if kind in _UNREAD:
        raise SceneError(
            f"line {element.line}: {where}: joints of the type {kind!r} are not read. A scene has "
            "hinges, slides and balls; write it with them, or leave it out."
        )
    check_known("type", [kind], KINDS, f"line {element.line}: {where}")
    parent, child = (_end(element, side, scope, links, where) for side in ("parent", "child"))
    if not child:
        raise SceneError(f"line {element.line}: {where}: <child>: the world is a parent only.")
    if parent == child:
        raise SceneError(f"line {element.line}: {where}: its parent and its child are {child!r}.")
    place = frames.in_world(child) if not parent else frames.between(parent, child)
    anchor = frames.between(child, name).p
    joint = robot.RobotJoint(
        name, element.line, KINDS[kind], parent, child, xyz=robot.three(place.p + place.R @ anchor),
        rpy=robot.angles_of(place.R), anchor=robot.three(anchor),
    )  # fmt: skip
    if KINDS[kind] in ("fixed", "spherical"):
        return joint
    axis = element.only("axis")
    if axis is None:
        raise SceneError(f"line {element.line}: {where}: <axis> is missing.")
    return _with_axis(joint, axis, frames, scope, version)


def _end(
    element: urdf.Element, side: str, scope: str, links: Mapping[str, robot.RobotLink], where: str
) -> str:
    """The link at one end, or the world."""
    end = element.only(side)
    name = end.text.strip() if end else ""
    if not name:
        raise SceneError(f"line {element.line}: {where}: <{side}> is missing.")
    if name == "world":
        return robot.WORLD
    known = [link[len(scope) :] for link in links if link.startswith(scope)]
    check_known("link", [name], known, f"line {element.line}: {where}, {side}")
    return scope + name


def _with_axis(
    joint: robot.RobotJoint, axis: urdf.Element, frames: Frames, scope: str, version: tuple[int, int]
) -> robot.RobotJoint:
    """The joint with its axis, limits, damper and spring."""
    where = f"joint {joint.name!r}"
    limits: list[float | None] = []
    for key in ("lower", "upper", "effort", "velocity"):
        (value,) = urdf.child_numbers(axis.only("limit"), key, where) or (urdf.NO_LIMIT,)
        is_none = abs(value) >= urdf.NO_LIMIT or (key in ("effort", "velocity") and value < 0.0)
        limits.append(None if is_none else value)
    lower, upper, effort, velocity = limits
    urdf.check_range(lower, upper, axis, where)
    bounded = joint.kind != "continuous" and (lower is not None or upper is not None)
    kind = "continuous" if joint.kind == "revolute" and not bounded else joint.kind
    dynamics = axis.only("dynamics")
    damping, friction, stiffness, slack = (
        (urdf.child_numbers(dynamics, key, where) or (0.0,))[0]
        for key in ("damping", "friction", "spring_stiffness", "spring_reference")
    )
    return joint._replace(
        kind=kind,
        axis=robot.three(_direction(joint, axis, frames, scope, version)),
        lower=(-urdf.NO_LIMIT if lower is None else lower) if bounded else None,
        upper=(urdf.NO_LIMIT if upper is None else upper) if bounded else None,
        effort=effort,
        velocity=velocity,
        stiffness=stiffness,
        slack=slack,
        damping=damping,
        friction=friction,
        mimic=urdf.mimic_of(axis, urdf.child_numbers, where, scope),
    )


def _direction(
    joint: robot.RobotJoint, axis: urdf.Element, frames: Frames, scope: str, version: tuple[int, int]
) -> Array:
    """The axis in the axes of the child."""
    where = f"joint {joint.name!r}"
    xyz = axis.only("xyz")
    numbers = urdf.content_numbers(xyz, where, 3) if xyz else (0.0, 0.0, 1.0)
    direction = np.array(urdf.checked_axis(numbers, axis, where))
    expressed = xyz.attributes.get("expressed_in", "") if xyz else ""
    if expressed:
        frame = frames.find(expressed, scope, f"line {axis.line}: {where}, expressed_in")
    elif version < (1, 5) or flag(axis, "use_parent_model_frame"):
        frame = frames.find("__model__", scope, where)
    else:
        frame = joint.name
    return np.asarray(frames.between(joint.child, frame).R @ direction)


class Closed(NamedTuple):
    """The joints that make trees, those that close loops, and links and joints that these stand on."""

    tree: Joints
    loops: tuple[robot.RobotLoop, ...]
    sides: tuple[robot.Side, ...]


def joints_of(
    model: urdf.Element, frames: Frames, links: Mapping[str, robot.RobotLink], version: tuple[int, int]
) -> Closed:
    """The joints of a model and its nested ones: a second joint to a link closes a loop."""
    owners = [(scope, element) for scope, owner in scopes(model) for element in owner.named("joint")]
    joints = robot.unique(
        "joint", [_joint(scope, element, frames, links, version) for scope, element in owners]
    )
    tree: Joints = {}
    loops: list[robot.RobotLoop] = []
    sides: list[robot.Side] = []
    carried: Joints = {}
    for joint in joints.values():
        above = [joint.parent]
        while above[-1] in carried:
            above.append(carried[above[-1]].parent)
        if joint.child not in (*carried, *above):
            tree[joint.name] = carried[joint.child] = joint
            continue
        if joint.kind not in _LOOPS or joint.stiffness or joint.damping:
            raise SceneError(
                f"line {joint.line}: joint {joint.name!r} closes a loop; expected a hinge, a ball or a "
                f"fixed joint without spring and damper, got {joint.kind!r}."
            )
        R = (
            frames.between(joint.parent, joint.child) if joint.parent else frames.in_world(joint.child)
        ).R
        kind = _LOOPS[joint.kind]
        axis = robot.three(R @ np.array(joint.axis)) if kind == "revolute" else None
        ends = (joint.parent, joint.child, joint.xyz, joint.anchor)
        loop, carriers = robot.aligned(robot.RobotLoop(joint.name, kind, *ends, axis), R, joints)
        loops.append(loop)
        sides += carriers
    return Closed(tree, tuple(loops), tuple(sides))
