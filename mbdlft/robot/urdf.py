"""The contents of a URDF file as they are written: links, joints, and counts of other elements.

MuJoCo compiles URDF as well; docs/architecture.md says why the file is read by hand.
"""

from mbdlft.base.errors import SceneError, unknown_name
from mbdlft.robot.description import (
    ENTRIES,
    WORLD,
    ZERO,
    Robot,
    RobotJoint,
    RobotLink,
    Triple,
    root_of,
    unique,
    unused,
)
from mbdlft.robot.elements import (
    XACRO,
    Element,
    attribute_numbers,
    check_range,
    checked_axis,
    mimic_of,
    name_of,
    needed,
    others,
)

JOINT_TYPES = ("continuous", "fixed", "floating", "planar", "prismatic", "revolute")
_USED = {
    "robot": (),
    "link": ("inertial",),
    "joint": ("parent", "child", "origin", "axis", "limit", "dynamics", "mimic"),
}


def read_urdf(top: Element) -> Robot:
    """Read a robot from the elements of a URDF file; its root is fixed on the ground."""
    _refuse_xacro(top)
    links = [_link(element) for element in top.named("link")]
    joints = [_joint(element) for element in top.named("joint")]
    if not links:
        raise SceneError(f"line {top.line}: the robot has no links.")
    by_name, joints_by_name = unique("link", links), unique("joint", joints)
    base = RobotJoint(unused("root_joint", joints_by_name), 0, "fixed", WORLD, root_of(by_name, joints))
    return Robot(
        name=top.attributes.get("name", ""),
        links=by_name,
        joints={base.name: base, **joints_by_name},
        others=others(top, _USED),
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
    center, rpy = origin_of(inertial, where)
    return RobotLink(
        name=name,
        line=element.line,
        inertial=True,
        mass=needed(mass, "value", where)[0],
        center=center,
        rpy=rpy,
        inertia={entry: needed(inertia, f"i{entry}", where)[0] for entry in ENTRIES},
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
    xyz, rpy = origin_of(element, where)
    # files often give 0 0 0 as the axis of a joint that has none
    axis = element.only("axis") if kind not in ("fixed", "floating") else None
    direction = (1.0, 0.0, 0.0) if axis is None else needed(axis, "xyz", where, 3)
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
        axis=checked_axis(direction, axis or element, where),
        lower=lower,
        upper=upper,
        effort=_number(limit, "effort", where),
        velocity=_number(limit, "velocity", where),
        damping=_number(dynamics, "damping", where) or 0.0,
        friction=_number(dynamics, "friction", where) or 0.0,
        mimic=mimic_of(element, attribute_numbers, where),
    )


def _number(owner: Element | None, key: str, where: str) -> float | None:
    return (attribute_numbers(owner, key, where) or (None,))[0]


def _range(limit: Element | None, kind: str, where: str) -> tuple[float, float] | tuple[None, None]:
    """Lower and upper limit; if only one is given, the other is zero, as URDF says."""
    lower, upper = _number(limit, "lower", where), _number(limit, "upper", where)
    if limit is None or kind not in ("revolute", "prismatic") or (lower is None and upper is None):
        return None, None
    low, high = lower or 0.0, upper or 0.0
    check_range(low, high, limit, where)
    return low, high


def origin_of(element: Element, where: str) -> tuple[Triple, Triple]:
    """Position xyz (m) and rotation rpy (rad) of the element's origin; zero if the file gives none."""
    origin = element.only("origin")
    xyz, rpy = (attribute_numbers(origin, key, where, 3) or ZERO for key in ("xyz", "rpy"))
    return (xyz[0], xyz[1], xyz[2]), (rpy[0], rpy[1], rpy[2])
