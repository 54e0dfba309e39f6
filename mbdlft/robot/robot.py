"""The description of a robot that the readers of all formats make: links, joints, loads, sensors.

A joint connects a point of its parent link with a point of its child link. With the notation of
`mbdlft.multibody.spatial`, the frame c of the child is, at a position of zero, in the frame p of the
parent at

    R_pc = R_z(yaw) R_y(pitch) R_x(roll),    r_pc = xyz - R_pc anchor

The links and joints are a tree with unique names; links without mass are added to it where something
stands at a place of its own. Of a rotation near a pitch of 90 deg, roll and yaw are not determined one by
one: its yaw is zero.
"""

import math
from collections.abc import Container, Iterable, Mapping, Sequence
from graphlib import CycleError, TopologicalSorter
from typing import NamedTuple, TypeVar

import numpy as np

from mbdlft.base.array import Array
from mbdlft.base.errors import SceneError, check_known
from mbdlft.base.parameter import exact_cosine_sine
from mbdlft.multibody.body import GROUND

Triple = tuple[float, float, float]
WORLD = ""  # the parent of joints on the ground; no link has this name
ENTRIES = ("xx", "xy", "xz", "yy", "yz", "zz")
ZERO: Triple = (0.0, 0.0, 0.0)
_MOST_NAMES = 8  # in a sentence of the report
_STEEP = 1e-9  # cosine of a pitch near 90 deg, where yaw and roll turn about the same axis


class RobotLink(NamedTuple):
    """One link."""

    name: str
    line: int  # in the file
    inertial: bool
    mass: float = 0.0  # kg
    center: Triple = ZERO  # of mass (m)
    rpy: Triple = ZERO  # turns the axes of the inertia against those of the link (rad)
    inertia: Mapping[str, float] = dict.fromkeys(ENTRIES, 0.0)  # about the center of mass (kg m^2)


class Mimic(NamedTuple):
    """The position of a joint follows that of another: multiplier * position of `leader` + offset."""

    leader: str
    multiplier: float
    offset: float


class RobotJoint(NamedTuple):
    """One joint: units of its position are rad or m, of its effort N m or N; no limit is None."""

    name: str
    line: int
    kind: str
    parent: str
    child: str
    xyz: Triple = ZERO  # where it stands in its parent (m)
    rpy: Triple = ZERO  # how it is turned there (rad)
    anchor: Triple = ZERO  # where it stands in its child (m)
    axis: Triple = (1.0, 0.0, 0.0)  # in the axes of the child
    position: float = 0.0  # in the file
    lower: float | None = None  # limits of the position
    upper: float | None = None
    effort: float | None = None  # limit
    velocity: float | None = None  # limit
    stiffness: float = 0.0  # of every coordinate
    slack: float = 0.0  # the position at which the spring is slack
    damping: float = 0.0  # of every coordinate
    reflected_inertia: float = 0.0  # of an actuator, felt behind its gear (kg m^2 or kg)
    friction: float = 0.0
    mimic: Mimic | None = None


class JointLimit(NamedTuple):
    """Limits of a joint; None where the file has none.

    `lower` and `upper` limit the position in `unit` (rad or m), `effort` the effort (N m or N) and `rate`
    the velocity (rad/s or m/s).
    """

    joint: str
    unit: str
    lower: float | None
    upper: float | None
    effort: float | None
    rate: float | None


class RobotLoad(NamedTuple):
    """A load that acts on a link: an input ``force`` or ``torque``, or ``buoyancy``."""

    name: str
    kind: str
    link: str
    direction: Triple = ZERO  # of a force or torque, in the axes of the link
    displaced: float = 0.0  # kg, whose weight holds the link at its center of mass


class RobotSensor(NamedTuple):
    """A sensor of the kind ``accelerometer`` or ``gyro`` at the origin of a link, in its axes."""

    name: str
    kind: str
    link: str


class RobotLoop(NamedTuple):
    """A joint that closes a loop, at points of two links (m): spherical, revolute or fixed."""

    name: str
    kind: str
    parent: str
    child: str
    at_parent: Triple
    at_child: Triple
    axis: Triple | None = None  # of a revolute one, in the axes of the parent


class RobotCoupling(NamedTuple):
    """A linear relation of joints that turn or slide, e = c1 q1 + c2 q2 + ... - `offset`.

    Rigid where `stiffness` is None: then e is 0, and the joint `held` has no other effort. Else the force
    along it is -stiffness e - damping e_dot.
    """

    name: str
    factors: Mapping[str, float]  # by joint
    stiffness: float | None = None
    damping: float = 0.0
    offset: float = 0.0
    held: str = ""

    def couples(self, moving: frozenset[str]) -> bool:
        """Whether two or more of its joints move."""
        return len(moving & self.factors.keys()) > 1


class Robot(NamedTuple):
    """A robot: its links and joints by name, the ground being the parent `WORLD`."""

    name: str
    links: Mapping[str, RobotLink]
    joints: Mapping[str, RobotJoint]  # each after the one that carries its parent
    loads: tuple[RobotLoad, ...] = ()
    sensors: tuple[RobotSensor, ...] = ()
    loops: tuple[RobotLoop, ...] = ()
    couplings: tuple[RobotCoupling, ...] = ()
    gravity: Triple | None = None  # m/s^2; None if the file does not say
    inputs: tuple[str, ...] | None = None  # joints and loads with actuators; None if the file has none
    rates: tuple[str, ...] = ()  # joints whose rate is measured
    others: Mapping[str, int] = {}  # counts by tag of what says nothing about the dynamics
    ignored: tuple[str, ...] = ()  # sentences for the report
    assumed: tuple[str, ...] = ()


Side = tuple[RobotLink, RobotJoint]
Item = TypeVar("Item", RobotLink, RobotJoint)


def unique(what: str, items: Sequence[Item]) -> dict[str, Item]:
    """The items by name; a SceneError if two have one name."""
    by_name: dict[str, Item] = {}
    for item in items:
        first = by_name.setdefault(item.name, item)
        if first is not item:
            raise SceneError(
                f"line {item.line}: {what} {item.name!r} is given twice; first in line {first.line}."
            )
    return by_name


def said(sentence: str, names: Iterable[str]) -> list[str]:
    """A sentence of the report with these names at its braces; none without names."""
    listed = ", ".join(names)
    return [sentence.format(listed)] if listed else []


def first_of(names: Sequence[str]) -> str:
    """The names, or the first of many."""
    more = f" and {len(names) - _MOST_NAMES} others" if len(names) > _MOST_NAMES else ""
    return ", ".join(names[:_MOST_NAMES]) + more


def unused(name: str, taken: Container[str]) -> str:
    """The name, with underscores after it until nothing else has it."""
    while name in taken:
        name += "_"
    return name


def body_name(link: str) -> str:
    """The name of the body of a link in a scene, where a dot separates a body from its port."""
    return f"{GROUND}_link" if link == GROUND else link.replace(".", "_")


def root_of(links: Mapping[str, RobotLink], joints: Sequence[RobotJoint]) -> str:
    """The name of the only link without a parent, from which joints lead to all other links."""
    above: dict[str, RobotJoint] = {}
    for joint in joints:
        for side, name in (("parent", joint.parent), ("child", joint.child)):
            check_known("link", [name], links, f"line {joint.line}: joint {joint.name!r}, {side}")
        if joint.child in above:
            raise SceneError(
                f"line {joint.line}: link {joint.child!r} has two parents: it is the child of joints "
                f"{above[joint.child].name!r} and {joint.name!r}, so the joints close a loop. A robot is "
                "a tree; remove one of the two."
            )
        above[joint.child] = joint
    roots = [name for name in links if name not in above]
    parents = {name: [above[name].parent] if name in above else [] for name in links}
    try:
        TopologicalSorter(parents).prepare()
    except CycleError as error:
        loop: list[str] = error.args[1]
        raise SceneError(
            f"line {above[loop[0]].line}: the joints close a loop: {' -> '.join(loop)}. A robot is a "
            "tree; open the loop at one joint."
        ) from None
    if len(roots) > 1:
        raise SceneError(
            f"there are {len(roots)} links without a parent: {', '.join(roots)}. A robot is a tree with "
            "one root; connect the others to it, by a fixed joint if they are clamped on it."
        )
    return roots[0]


def welded(link: str, weld: str, parent: str, place: Array, R: Array, line: int = 0) -> Side:
    """A link without mass at a place (3,) of its parent, with the axes R (3, 3), and the joint `weld`."""
    joint = RobotJoint(weld, line, "fixed", parent, link, three(place), angles_of(R))
    return RobotLink(link, line, inertial=True), joint


def aligned(loop: RobotLoop, R_pc: Array, taken: Container[str]) -> tuple[RobotLoop, list[Side]]:
    """The loop, on a link without mass that is welded to its child and has the axes of its parent.

    R_pc (3, 3) are the axes of the child in those of the parent. A loop of the kind ``spherical``, or
    one between equal axes, stays as it is; then there is no link.
    """
    if loop.kind == "spherical" or np.array_equal(R_pc, np.eye(3)):
        return loop, []
    name = unused(f"{loop.name}_side", taken)
    at = np.array(loop.at_child)
    side = welded(name, unused(f"weld_{name}", taken), loop.child, at, R_pc.T)
    return loop._replace(child=name, at_child=ZERO), [side]


def of_quaternion(quaternion: Array) -> Array:
    """The rotation (3, 3) of a quaternion (4,), w first; its length is ignored, but must not be zero."""
    size = float(np.max(np.abs(quaternion)))
    if not 0.0 < size < np.inf:
        listed = " ".join(f"{entry:g}" for entry in quaternion)
        raise SceneError(f"the quaternion {listed} is no rotation; its length must not be zero.")
    entries = np.asarray(quaternion, dtype=float) / size  # no overflow
    w, x, y, z = entries / np.linalg.norm(entries)
    return np.array(
        [
            [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
            [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
            [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
        ]
    )


def of_angles(rpy: Triple) -> Array:
    """R_z(yaw) R_y(pitch) R_x(roll) (3, 3) of angles in rad, exact where they are right angles."""
    turned = np.eye(3)
    for axis, angle in enumerate(rpy):
        i, j = (axis + 1) % 3, (axis + 2) % 3
        cosine, sine = exact_cosine_sine(angle)
        turn = np.eye(3)
        turn[i, i], turn[i, j], turn[j, i], turn[j, j] = cosine, -sine, sine, cosine
        turned = turn @ turned
    return turned


def between(a: Array, b: Array) -> Array:
    """The rotation (3, 3) by the least angle that turns the direction `a` (3,) into that of `b`."""
    with np.errstate(all="ignore"):
        u, v = (vector / np.max(np.abs(vector)) for vector in (a, b))
        u, v = u / np.linalg.norm(u), v / np.linalg.norm(v)
    if not np.isfinite([u, v]).all():
        raise SceneError("a direction has no length; expected three numbers that are not all zero.")
    half = u + v
    if np.linalg.norm(half) < _STEEP:  # opposite: half a turn about any axis across
        across = np.cross(u, np.eye(3)[np.argmin(np.abs(u))])
        across /= np.linalg.norm(across)
        return 2.0 * np.outer(across, across) - np.eye(3)
    half /= np.linalg.norm(half)
    # a half turn about a, then one about the direction in the middle
    return (2.0 * np.outer(half, half) - np.eye(3)) @ (2.0 * np.outer(u, u) - np.eye(3))


def angles_of(R: Array) -> Triple:
    """Roll, pitch and yaw (rad) of a rotation (3, 3), whose rotation is R up to rounding at any pitch."""
    cosine = math.hypot(R[0, 0], R[1, 0])
    pitch = math.atan2(-R[2, 0], cosine)
    yaw = math.atan2(R[1, 0], R[0, 0]) if cosine > _STEEP else 0.0
    along = np.array([-math.sin(yaw), math.cos(yaw), 0.0])  # the second row of R_z(-yaw)
    roll = math.atan2(-(along @ R[:, 2]), along @ R[:, 1])
    return roll, pitch, yaw


def three(vector: Array) -> Triple:
    """The entries of a vector (3,) as numbers, without negative zeros."""
    x, y, z = (float(entry) + 0.0 for entry in vector)
    return x, y, z
