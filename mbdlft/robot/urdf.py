"""The contents of a URDF file as they are written: links, joints, and counts of other elements."""

from collections import Counter

from mbdlft.base.errors import SceneError, unknown_name
from mbdlft.robot.description import (
    ENTRIES,
    WORLD,
    Mimic,
    Robot,
    RobotJoint,
    RobotLink,
    root_of,
    unique,
    unused,
)
from mbdlft.robot.elements import (
    XACRO,
    Element,
    Triple,
    name_of,
    number,
    optional_number,
    triple,
)

JOINT_TYPES = ("continuous", "fixed", "floating", "planar", "prismatic", "revolute")
_LINK_PARTS = ("inertial",)
_JOINT_PARTS = ("parent", "child", "origin", "axis", "limit", "dynamics", "mimic")


def read_urdf(top: Element) -> Robot:
    """Read a robot from the elements of a URDF file; its root is fixed on the ground.

    Raises
    ------
    SceneError
        It is not URDF, a number or an element is missing or wrong, a name is unknown or given twice, or
        the joints are not a tree with one root. The message names the line.
    """
    _refuse_xacro(top)
    links = [_link(element) for element in top.named("link")]
    joints = [_joint(element) for element in top.named("joint")]
    if not links:
        raise SceneError(f"line {top.line}: the robot has no links.")
    by_name, joints_by_name = unique("link", links), unique("joint", joints)
    base = RobotJoint(
        unused("root_joint", joints_by_name), 0, "fixed", WORLD, root_of(by_name, joints)
    )
    return Robot(
        name=top.attributes.get("name", ""),
        links=by_name,
        joints={base.name: base, **joints_by_name},
        others=_others(top),
    )


def _refuse_xacro(top: Element) -> None:
    """Raise a SceneError if the document is xacro."""
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
