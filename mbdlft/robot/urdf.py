"""XML elements with their lines in a file, what URDF and SDF share, and robots of URDF files.

The expat parser of the standard library reads the file: it knows the line of each element, accepts tags
with the prefix of xacro, and loads no other file. The formats differ in where a number stands: URDF has
attributes, SDF has text between the tags of a child. A `Reader` is one of the two. MuJoCo compiles URDF
as well; docs/architecture.md says why the file is read by hand.
"""

import math
import re
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from xml.parsers import expat

from mbdlft.base.errors import SceneError, check_known
from mbdlft.robot import robot

NO_LIMIT = 1e16  # SDF: a limit of this size is none
XACRO = "This is a xacro file or a part of one. Expand it first: xacro robot.urdf.xacro > robot.urdf"


@dataclass(slots=True)
class Element:
    """One XML element with its line; `text` is all text between its children."""

    tag: str
    attributes: Mapping[str, str]
    line: int
    children: list["Element"] = field(default_factory=list)
    text: str = ""

    def named(self, tag: str) -> list["Element"]:
        """The children with this tag."""
        return [child for child in self.children if child.tag == tag]

    def only(self, tag: str) -> "Element | None":
        """The child with this tag, or None; two of them are a SceneError."""
        same_tag = self.named(tag)
        if len(same_tag) > 1:
            raise SceneError(
                f"line {same_tag[1].line}: <{tag}> of {self.called()} is given twice; first in line "
                f"{same_tag[0].line}."
            )
        return same_tag[0] if same_tag else None

    def called(self) -> str:
        """Tag and name, for error messages."""
        return f"{self.tag} {self.attributes.get('name', '')!r}".replace(" ''", "")


def parse(content: bytes) -> Element:
    """The top element of an XML document."""
    parser = expat.ParserCreate()
    top: list[Element] = []
    open_elements: list[Element] = []

    def start(tag: str, attributes: dict[str, str]) -> None:
        element = Element(tag, attributes, parser.CurrentLineNumber)
        (open_elements[-1].children if open_elements else top).append(element)
        open_elements.append(element)

    def characters(data: str) -> None:
        open_elements[-1].text += data

    parser.StartElementHandler = start
    parser.CharacterDataHandler = characters
    parser.buffer_text = True
    parser.EndElementHandler = lambda tag: open_elements.pop()
    try:
        parser.Parse(content, True)  # noqa: FBT003  # the last piece
    except expat.ExpatError as error:
        raise SceneError(
            f"line {error.lineno}: not valid XML: {expat.ErrorString(error.code)}."
        ) from None
    except (ValueError, LookupError) as error:  # of the encoding that the file declares
        raise SceneError(f"line 1: the encoding cannot be read: {error}. Use UTF-8.") from None
    return top[0]


def name_of(element: Element) -> str:
    """The name of a link or joint."""
    name = element.attributes.get("name", "")
    if not name.strip():
        raise SceneError(f"line {element.line}: a {element.tag} has no name.")
    return name


# (element or None, key, where, count = 1): finite numbers called `key`; None if there are none
Reader = Callable[..., Sequence[float] | None]


def attribute_numbers(
    owner: Element | None, key: str, where: str, count: int = 1
) -> Sequence[float] | None:
    """Numbers of an attribute, as URDF has them."""
    if owner is None or key not in owner.attributes:
        return None
    place = f"line {owner.line}: {where}: <{owner.tag}>, {key}"
    return _finite(owner.attributes[key], place, count)


def child_numbers(owner: Element | None, key: str, where: str, count: int = 1) -> Sequence[float] | None:
    """Numbers between the tags of a child, as SDF has them; ``inf`` is a number of 1e16."""
    child = owner.only(key) if owner else None
    if child is None:
        return None
    if count == 1 and (match := re.fullmatch(r"\s*([+-]?)inf(inity)?\s*", child.text, re.IGNORECASE)):
        return [-NO_LIMIT if match[1] == "-" else NO_LIMIT]
    return content_numbers(child, where, count)


def content_numbers(element: Element, where: str, count: int) -> Sequence[float]:
    """The `count` finite numbers between the tags of an element."""
    return _finite(element.text.strip(), f"line {element.line}: {where}: <{element.tag}>", count)


def needed(element: Element, key: str, where: str, count: int = 1) -> Sequence[float]:
    """The numbers of an attribute that must be there."""
    numbers = attribute_numbers(element, key, where, count)
    if numbers is None:
        place = f"line {element.line}: {where}: <{element.tag}>, {key}"
        raise SceneError(f"{place}: is missing; expected {_expected(count)}.")
    return numbers


def checked_axis(direction: Sequence[float], axis: Element, where: str) -> robot.Triple:
    """The direction of an axis, which has a length."""
    x, y, z = direction
    if not any(direction):
        raise SceneError(
            f"line {axis.line}: {where}: the axis has zero length. Give a direction; its length is "
            "ignored."
        )
    return x, y, z


def others(element: Element, used: Mapping[str, Sequence[str]]) -> Counter[str]:
    """Counts by tag of what says nothing about the dynamics: children of owners that do not use them."""
    counts: Counter[str] = Counter()
    for child in element.children:
        if child.tag in used:
            counts.update(others(child, used))
        elif child.tag not in used[element.tag]:
            counts[child.tag] += 1
    return counts


def mimic_of(owner: Element, read: Reader, where: str, scope: str = "") -> robot.Mimic | None:
    """The contents of an element <mimic>: multiplier (leader - reference) + offset."""
    mimic = owner.only("mimic")
    if mimic is None:
        return None
    if "joint" not in mimic.attributes:
        raise SceneError(f"line {mimic.line}: {where}: <mimic>: the attribute 'joint' is missing.")
    ((multiplier,), (offset,), (reference,)) = (
        read(mimic, key, where) or (default,)
        for key, default in (("multiplier", 1.0), ("offset", 0.0), ("reference", 0.0))
    )
    return robot.Mimic(scope + mimic.attributes["joint"], multiplier, offset - multiplier * reference)


def check_range(lower: float | None, upper: float | None, owner: Element, where: str) -> None:
    """Raise a SceneError if the lower limit is above the upper one."""
    if lower is not None and upper is not None and lower > upper:
        raise SceneError(
            f"line {owner.line}: {where}: the lower limit {lower:g} is above the upper one {upper:g}."
        )


def _expected(count: int) -> str:
    return "a finite number" if count == 1 else f"{count} finite numbers"


def _finite(text: str, place: str, count: int) -> Sequence[float]:
    """The `count` finite numbers of a text."""
    try:  # Python reads 1_0 as 10, and digits of all scripts
        values = [float(word) for word in text.split()] if text.isascii() and "_" not in text else []
    except ValueError:
        values = []
    if len(values) != count or not all(math.isfinite(value) for value in values):
        advice = f" {XACRO}" if "${" in text or "$(" in text else ""
        raise SceneError(f"{place}: expected {_expected(count)}, got {text!r}.{advice}")
    return values


JOINT_TYPES = ("continuous", "fixed", "floating", "planar", "prismatic", "revolute")
_USED = {
    "robot": (),
    "link": ("inertial",),
    "joint": ("parent", "child", "origin", "axis", "limit", "dynamics", "mimic"),
}


def read_urdf(top: Element) -> robot.Robot:
    """Read a robot from the elements of a URDF file; its root is fixed on the ground."""
    for element in (top, *top.children):
        if element.tag.startswith("xacro:"):
            raise SceneError(f"line {element.line}: got <{element.tag}>. {XACRO}")
    links = [_link(element) for element in top.named("link")]
    joints = [_joint(element) for element in top.named("joint")]
    if not links:
        advice = f" {XACRO}" if any(name.startswith("xmlns:xacro") for name in top.attributes) else ""
        raise SceneError(f"line {top.line}: the robot has no links.{advice}")
    by_name, joints_by_name = robot.unique("link", links), robot.unique("joint", joints)
    base = robot.RobotJoint(
        robot.unused("root_joint", joints_by_name),
        0,
        "fixed",
        robot.WORLD,
        robot.root_of(by_name, joints),
    )
    return robot.Robot(
        name=top.attributes.get("name", ""),
        links=by_name,
        joints={base.name: base, **joints_by_name},
        others=others(top, _USED),
    )


def _link(element: Element) -> robot.RobotLink:
    name = name_of(element)
    inertial = element.only("inertial")
    if inertial is None:
        return robot.RobotLink(name, element.line, inertial=False)
    where = f"inertial of link {name!r}"
    mass, inertia = inertial.only("mass"), inertial.only("inertia")
    if mass is None or inertia is None:
        missing = "mass" if mass is None else "inertia"
        raise SceneError(f"line {inertial.line}: {where}: <{missing}> is missing.")
    center, rpy = origin_of(inertial, where)
    return robot.RobotLink(
        name=name,
        line=element.line,
        inertial=True,
        mass=needed(mass, "value", where)[0],
        center=center,
        rpy=rpy,
        inertia={entry: needed(inertia, f"i{entry}", where)[0] for entry in robot.ENTRIES},
    )


def _joint(element: Element) -> robot.RobotJoint:
    name = name_of(element)
    where = f"joint {name!r}"
    kind = element.attributes.get("type", "")
    check_known("type", [kind], JOINT_TYPES, f"line {element.line}: {where}")
    ends = {}
    for side in ("parent", "child"):
        end = element.only(side)
        if end is None or "link" not in end.attributes:
            raise SceneError(f"line {element.line}: {where}: <{side} link=...> is missing.")
        ends[side] = end.attributes["link"]
    xyz, rpy = origin_of(element, where)
    # files often give 0 0 0 as the axis of a joint that has none
    axis = element.only("axis") if kind not in ("fixed", "floating") else None
    direction = needed(axis, "xyz", where, 3) if axis else (1.0, 0.0, 0.0)
    limit, dynamics = element.only("limit"), element.only("dynamics")
    lower, upper = _number(limit, "lower", where), _number(limit, "upper", where)
    if limit is None or kind not in ("revolute", "prismatic") or lower is upper is None:
        lower = upper = None
    else:  # if only one is given, the other is zero, as URDF says
        lower, upper = lower or 0.0, upper or 0.0
        check_range(lower, upper, limit, where)
    return robot.RobotJoint(
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


def origin_of(element: Element, where: str) -> tuple[robot.Triple, robot.Triple]:
    """Position xyz (m) and rotation rpy (rad) of the element's origin; zero if the file gives none."""
    origin = element.only("origin")
    xyz, rpy = (attribute_numbers(origin, key, where, 3) or robot.ZERO for key in ("xyz", "rpy"))
    return (xyz[0], xyz[1], xyz[2]), (rpy[0], rpy[1], rpy[2])
