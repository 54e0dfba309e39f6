"""XML elements with their lines in a file, and the numbers in their attributes.

The expat parser of the standard library reads the file: it knows the line of each element, accepts tags
with the prefix of xacro, and loads no other file.

Rotations as roll, pitch and yaw, with the right angles that they have.

R = R_z(yaw) R_y(pitch) R_x(roll)
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from xml.parsers import expat

import numpy as np

from mbdlft.base.array import Array
from mbdlft.base.errors import SceneError

Triple = tuple[float, float, float]


XACRO = (
    "This is a xacro file or a part of one. Expand it first: xacro robot.urdf.xacro > robot.urdf"
)


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


def optional_number(element: Element | None, key: str, where: str) -> float | None:
    """The number of an attribute, or None if there is none."""
    if element is None or key not in element.attributes:
        return None
    return number(element, key, where)


def number(element: Element, key: str, where: str) -> float:
    """The number of an attribute."""
    (value,) = _numbers(element, key, where, 1)
    return value


def triple(element: Element, key: str, where: str) -> Triple:
    """The three numbers of an attribute."""
    x, y, z = _numbers(element, key, where, 3)
    return x, y, z


def _numbers(element: Element, key: str, where: str, count: int) -> Sequence[float]:
    """The `count` finite numbers of an attribute."""
    place = f"line {element.line}: {where}: <{element.tag}>, {key}"
    if key not in element.attributes:
        raise SceneError(f"{place}: is missing; expected {_expected(count)}.")
    return _finite(element.attributes[key], place, count)


def content_numbers(element: Element, where: str, count: int) -> Sequence[float]:
    """The `count` finite numbers between the tags of an element."""
    return _finite(element.text.strip(), f"line {element.line}: {where}: <{element.tag}>", count)


def _expected(count: int) -> str:
    return "a finite number" if count == 1 else f"{count} finite numbers"


def _finite(text: str, place: str, count: int) -> Sequence[float]:
    """The `count` finite numbers of a text."""
    try:
        values = [float(part) for part in text.split()]
    except ValueError:
        values = []
    if len(values) != count or not all(math.isfinite(value) for value in values):
        advice = f" {XACRO}" if "${" in text or "$(" in text else ""
        raise SceneError(f"{place}: expected {_expected(count)}, got {text!r}.{advice}")
    return values


_STEEP = 1e-9  # cosine of a pitch near 90 deg, where yaw and roll turn about the same axis


def of_quaternion(quaternion: Array) -> Array:
    """The rotation (3, 3) of a quaternion (4,), w first; its length is ignored.

    Raises
    ------
    SceneError
        The quaternion is zero, or not finite.
    """
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
    """The rotation (3, 3) of roll, pitch and yaw (rad)."""
    turned = np.eye(3)
    for axis, angle in enumerate(rpy):
        i, j = (axis + 1) % 3, (axis + 2) % 3
        turn = np.eye(3)
        turn[[i, j], [i, j]] = math.cos(angle)
        turn[i, j], turn[j, i] = -math.sin(angle), math.sin(angle)
        turned = turn @ turned
    return turned


def between(a: Array, b: Array) -> Array:
    """The rotation (3, 3) by the least angle that turns the direction `a` (3,) into that of `b`.

    Raises
    ------
    SceneError
        One of them is zero, or not finite.
    """
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
    """Roll, pitch and yaw (rad) of a rotation (3, 3).

    The rotation of these angles is R up to rounding, also near a pitch of 90 deg, where each of roll and
    yaw alone is not determined: the yaw is zero there.
    """
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
