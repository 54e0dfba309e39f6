"""The description of a robot that the readers of all formats make: links, joints, loads, sensors.

A joint connects a point of its parent link with a point of its child link. With the notation of
`mbdlft.multibody.spatial`, the frame c of the child is, at a position of zero, in the frame p of the
parent at

    R_pc = R_z(yaw) R_y(pitch) R_x(roll),    r_pc = xyz - R_pc anchor
"""

from collections.abc import Mapping
from typing import NamedTuple

Triple = tuple[float, float, float]

WORLD = ""  # the parent of joints on the ground; no link has this name
ENTRIES = ("xx", "xy", "xz", "yy", "yz", "zz")
ZERO: Triple = (0.0, 0.0, 0.0)


class RobotLink(NamedTuple):
    """One link: `mass` (kg), `center` of mass (m) and `inertia` (kg m^2) about it.

    `rpy` (rad) turns the axes of the inertia against those of the link. `line` is the line in the file.
    """

    name: str
    line: int
    inertial: bool
    mass: float = 0.0
    center: Triple = ZERO
    rpy: Triple = ZERO
    inertia: Mapping[str, float] = dict.fromkeys(ENTRIES, 0.0)


class Mimic(NamedTuple):
    """The position of a joint follows that of another: multiplier * position of `leader` + offset."""

    leader: str
    multiplier: float
    offset: float


class RobotJoint(NamedTuple):
    """One joint.

    It stands at `xyz` (m) in its parent, turned by `rpy` (rad), and at `anchor` (m) in its child;
    `axis` is in the axes of the child. Its position in the file is `position` (rad or m). The limits of
    position (`lower`, `upper`, rad or m), `effort` (N m or N) and `velocity` (rad/s or m/s) are None if
    the file has none. `reflected_inertia` (kg m^2 or kg) is that of an actuator, felt behind its gear.
    `stiffness` and `damping` act on every coordinate of the joint; its spring is slack at the position
    `rest`.
    """

    name: str
    line: int
    kind: str
    parent: str
    child: str
    xyz: Triple = ZERO
    rpy: Triple = ZERO
    anchor: Triple = ZERO
    axis: Triple = (1.0, 0.0, 0.0)
    position: float = 0.0
    lower: float | None = None
    upper: float | None = None
    effort: float | None = None
    velocity: float | None = None
    stiffness: float = 0.0
    rest: float = 0.0
    damping: float = 0.0
    reflected_inertia: float = 0.0
    friction: float = 0.0
    mimic: Mimic | None = None


class RobotLoad(NamedTuple):
    """A load that acts on a link: a `force`, a `torque`, or `buoyancy`.

    A force or torque is along `direction`, in the axes of the link, and an input. `displaced` (kg) is
    the mass whose weight holds the link at its center of mass.
    """

    name: str
    kind: str
    link: str
    direction: Triple = ZERO
    displaced: float = 0.0


class RobotSensor(NamedTuple):
    """A sensor of the kind ``accelerometer`` or ``gyro`` at the origin of a link, in its axes."""

    name: str
    kind: str
    link: str


class RobotLoop(NamedTuple):
    """A joint that closes a loop, at points of two links (m): spherical, revolute or fixed.

    `axis` is that of a revolute one, in the axes of the parent.
    """

    name: str
    kind: str
    parent: str
    child: str
    at_parent: Triple
    at_child: Triple
    axis: Triple | None = None


class Robot(NamedTuple):
    """A robot: its links and joints by name, the ground being the parent `WORLD`.

    Attributes
    ----------
    name : str
    links, joints : by name
        A joint stands after the one that carries its parent.
    loads, sensors, loops : beside the joints
    gravity : three numbers (m/s^2), or None if the file does not say
    inputs : names of joints and loads that have an actuator; None if the file has no actuators
    rates : names of joints whose rate is measured
    others : counts by tag of the elements that say nothing about the dynamics
    ignored, assumed : sentences for the report
    """

    name: str
    links: Mapping[str, RobotLink]
    joints: Mapping[str, RobotJoint]
    loads: tuple[RobotLoad, ...] = ()
    sensors: tuple[RobotSensor, ...] = ()
    loops: tuple[RobotLoop, ...] = ()
    gravity: Triple | None = None
    inputs: tuple[str, ...] | None = None
    rates: tuple[str, ...] = ()
    others: Mapping[str, int] = {}
    ignored: tuple[str, ...] = ()
    assumed: tuple[str, ...] = ()
