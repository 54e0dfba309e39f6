"""The contents of a URDF file as they are written: links, joints, and counts of other elements."""

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from mbdlft.base.content import content_of
from mbdlft.base.errors import SceneError, unknown_name
from mbdlft.urdf.elements import (
    XACRO,
    Element,
    Triple,
    name_of,
    number,
    optional_number,
    parse,
    triple,
)

JOINT_TYPES = ("continuous", "fixed", "floating", "planar", "prismatic", "revolute")
ENTRIES = ("xx", "xy", "xz", "yy", "yz", "zz")
_LINK_PARTS = ("inertial",)
_JOINT_PARTS = ("parent", "child", "origin", "axis", "limit", "dynamics", "mimic")


class RobotLink(NamedTuple):
    """One link: `mass` (kg), `center` of mass (m) and `inertia` (kg m^2) about it.

    `rpy` (rad) turns the axes of the inertia against those of the link. `line` is the line in the file.
    """

    name: str
    line: int
    inertial: bool
    mass: float = 0.0
    center: Triple = (0.0, 0.0, 0.0)
    rpy: Triple = (0.0, 0.0, 0.0)
    inertia: Mapping[str, float] = dict.fromkeys(ENTRIES, 0.0)


class Mimic(NamedTuple):
    """The position of a joint follows that of another: multiplier * position of `leader` + offset."""

    leader: str
    multiplier: float
    offset: float


class RobotJoint(NamedTuple):
    """One joint.

    The limits of position (`lower`, `upper`, rad or m), `effort` (N m or N) and `velocity` (rad/s or m/s)
    are None if the file has none.
    """

    name: str
    line: int
    kind: str
    parent: str
    child: str
    xyz: Triple = (0.0, 0.0, 0.0)
    rpy: Triple = (0.0, 0.0, 0.0)
    axis: Triple = (1.0, 0.0, 0.0)
    lower: float | None = None
    upper: float | None = None
    effort: float | None = None
    velocity: float | None = None
    damping: float = 0.0
    friction: float = 0.0
    mimic: Mimic | None = None


class Robot(NamedTuple):
    """A robot: its root link, its links and joints by name, and counts of its other elements by tag."""

    name: str
    root: str
    links: Mapping[str, RobotLink]
    joints: Mapping[str, RobotJoint]
    others: Mapping[str, int]


def read_robot(content: bytes) -> Robot:
    """Read a robot from the bytes of a URDF file, in the encoding that they declare.

    Raises
    ------
    SceneError
        The file is not XML or not URDF, a number or an element is missing or wrong, a name is unknown
        or given twice, or the joints are not a tree with one root. The message names the line.
    """
    top = parse(content)
    _refuse_other_formats(top)
    links = [_link(element) for element in top.named("link")]
    joints = [_joint(element) for element in top.named("joint")]
    if not links:
        raise SceneError(f"line {top.line}: the robot has no links.")
    for what, items in (("link", links), ("joint", joints)):
        seen: dict[str, int] = {}
        for item in items:
            if item.name in seen:
                raise SceneError(
                    f"line {item.line}: {what} {item.name!r} is given twice; first in line "
                    f"{seen[item.name]}."
                )
            seen[item.name] = item.line
    by_name = {link.name: link for link in links}
    name = top.attributes.get("name", "")
    return Robot(
        name=name,
        root=_root(by_name, joints),
        links=by_name,
        joints={joint.name: joint for joint in joints},
        others=_others(top),
    )


def read_robot_file(path: str | Path) -> Robot:
    """Read a robot from a URDF file; errors name the file."""
    file = Path(path)
    content = content_of(file, SceneError)
    try:
        return read_robot(content)
    except SceneError as error:
        raise SceneError(f"{file}: {error}") from None


def _refuse_other_formats(top: Element) -> None:
    """Raise a SceneError if the document is xacro or not a robot."""
    if top.tag != "robot":
        raise SceneError(
            f"line {top.line}: expected a URDF file, whose first element is <robot>, got <{top.tag}>. "
            "Convert other formats (SDF, MJCF) to URDF first."
        )
    for element in (top, *top.children):
        if element.tag.startswith("xacro:"):
            raise SceneError(f"line {element.line}: got <{element.tag}>. {XACRO}")
    if not top.children and any(name.startswith("xmlns:xacro") for name in top.attributes):
        raise SceneError(f"line {top.line}: the robot has no links. {XACRO}")


def _link(element: Element) -> RobotLink:
    """The link of an element <link>."""
    name = name_of(element)
    inertial = element.only("inertial")
    if inertial is None:
        return RobotLink(name, element.line, inertial=False)
    where = f"inertial of link {name!r}"
    mass, inertia = inertial.only("mass"), inertial.only("inertia")
    if mass is None or inertia is None:
        missing = "mass" if mass is None else "inertia"
        raise SceneError(f"line {inertial.line}: {where}: <{missing}> is missing.")
    center, rpy = _origin(inertial, where)
    return RobotLink(
        name=name,
        line=element.line,
        inertial=True,
        mass=number(mass, "value", where),
        center=center,
        rpy=rpy,
        inertia={entry: number(inertia, f"i{entry}", where) for entry in ENTRIES},
    )


def _joint(element: Element) -> RobotJoint:
    """The joint of an element <joint>."""
    name = name_of(element)
    where = f"joint {name!r}"
    kind = element.attributes.get("type", "")
    if kind not in JOINT_TYPES:
        raise SceneError(f"line {element.line}: {where}: {unknown_name('type', kind, JOINT_TYPES)}")
    ends = {}
    for side in ("parent", "child"):
        end = element.only(side)
        if end is None or "link" not in end.attributes:
            raise SceneError(f"line {element.line}: {where}: <{side} link=...> is missing.")
        ends[side] = end.attributes["link"]
    xyz, rpy = _origin(element, where)
    axis = element.only("axis")
    limit, dynamics = element.only("limit"), element.only("dynamics")
    lower, upper = _range(limit, kind, where)
    return RobotJoint(
        name=name,
        line=element.line,
        kind=kind,
        parent=ends["parent"],
        child=ends["child"],
        xyz=xyz,
        rpy=rpy,
        axis=_axis(axis, kind, where),
        lower=lower,
        upper=upper,
        effort=optional_number(limit, "effort", where),
        velocity=optional_number(limit, "velocity", where),
        damping=optional_number(dynamics, "damping", where) or 0.0,
        friction=optional_number(dynamics, "friction", where) or 0.0,
        mimic=_mimic(element.only("mimic"), where),
    )


def _range(limit: Element | None, kind: str, where: str) -> tuple[float, float] | tuple[None, None]:
    """Lower and upper limit; if only one is given, the other is zero, as URDF says."""
    lower, upper = optional_number(limit, "lower", where), optional_number(limit, "upper", where)
    if limit is None or kind not in ("revolute", "prismatic") or (lower is None and upper is None):
        return None, None
    low, high = lower or 0.0, upper or 0.0
    if low > high:
        raise SceneError(
            f"line {limit.line}: {where}: the lower limit {low:g} is above the upper one {high:g}."
        )
    return low, high


def _axis(axis: Element | None, kind: str, where: str) -> Triple:
    """The direction of the axis; that of a joint without axis is ignored, as files often give 0 0 0."""
    if axis is None or kind in ("fixed", "floating"):
        return (1.0, 0.0, 0.0)
    direction = triple(axis, "xyz", where)
    if not any(direction):
        raise SceneError(
            f"line {axis.line}: {where}: the axis has zero length. Give a direction; its length is "
            "ignored."
        )
    return direction


def _mimic(mimic: Element | None, where: str) -> Mimic | None:
    """The contents of an element <mimic>."""
    if mimic is None:
        return None
    if "joint" not in mimic.attributes:
        raise SceneError(f"line {mimic.line}: {where}: <mimic>: the attribute 'joint' is missing.")
    multiplier = optional_number(mimic, "multiplier", where)
    return Mimic(
        mimic.attributes["joint"],
        1.0 if multiplier is None else multiplier,
        optional_number(mimic, "offset", where) or 0.0,
    )


def _origin(element: Element, where: str) -> tuple[Triple, Triple]:
    """Position xyz (m) and rotation rpy (rad) of the element's origin; zero if the file gives none."""
    origin, zero = element.only("origin"), (0.0, 0.0, 0.0)
    if origin is None:
        return zero, zero
    xyz, rpy = (
        triple(origin, key, where) if key in origin.attributes else zero for key in ("xyz", "rpy")
    )
    return xyz, rpy


# the tree ------------------------------------------------------------------------------------


def _root(links: Mapping[str, RobotLink], joints: Sequence[RobotJoint]) -> str:
    """The name of the only link without a parent, from which joints lead to all other links."""
    above: dict[str, RobotJoint] = {}
    for joint in joints:
        for side, name in (("parent", joint.parent), ("child", joint.child)):
            if name not in links:
                raise SceneError(
                    f"line {joint.line}: joint {joint.name!r}, {side}: "
                    + unknown_name("link", name, links)
                )
        if joint.child in above:
            raise SceneError(
                f"line {joint.line}: link {joint.child!r} has two parents: it is the child of joints "
                f"{above[joint.child].name!r} and {joint.name!r}, so the joints close a loop. A robot is "
                "a tree; remove one of the two."
            )
        above[joint.child] = joint
    roots = [name for name in links if name not in above]
    for name in links:
        chain = [name]
        while chain[-1] in above:
            chain.append(above[chain[-1]].parent)
            if chain[-1] in chain[:-1]:
                loop = " -> ".join(reversed(chain[chain.index(chain[-1]) :]))
                raise SceneError(
                    f"line {above[chain[-1]].line}: the joints close a loop: {loop}. A robot is a tree; "
                    "open the loop at one joint."
                )
    if len(roots) > 1:
        raise SceneError(
            f"there are {len(roots)} links without a parent: {', '.join(roots)}. A robot is a tree with "
            "one root; connect the others to it, by a fixed joint if they are clamped on it."
        )
    return roots[0]


def _others(top: Element) -> Counter[str]:
    """Counts by tag of the elements that say nothing about the dynamics."""
    counts: Counter[str] = Counter()
    for element in top.children:
        if element.tag not in ("link", "joint"):
            counts[element.tag] += 1
            continue
        used = _LINK_PARTS if element.tag == "link" else _JOINT_PARTS
        counts.update(child.tag for child in element.children if child.tag not in used)
    return counts
