"""What a URDF file says of the looks of a robot: boxes, balls, cylinders and meshes of its links.

Meshes are read by the package trimesh, and thinned until a page has room for them.
"""

import base64
import math
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from mbdlft.base.array import Array
from mbdlft.base.content import content_of
from mbdlft.base.errors import SceneError
from mbdlft.robot.elements import Element, name_of, number, parse, triple

_MOST = 36_000  # triangles of a page
_FEWEST = 60  # of a mesh, however many there are
_FINEST, _FINER = 256, 0.8  # cells along a mesh at most, and by what they get fewer
_PACKAGE = "package://"


class Looks(NamedTuple):
    """The geometry of links, by name, and what could not be read."""

    shapes: dict[str, list[dict[str, Any]]]
    notes: list[str]


def robot_looks(path: str | Path) -> Looks:
    """Geometry of the visual elements of a URDF file, by link.

    Each has a ``place``, the 16 entries of its matrix in the frame of the link by rows, and the sizes of
    a ``box``, a ``sphere``, a ``cylinder`` (m), or the ``triangles`` of a mesh: corners as base64 of
    float32.

    Raises
    ------
    SceneError
        The file cannot be read, or a number in it is wrong. A mesh that cannot be read is a note.
    """
    file = Path(path)
    looks = Looks({}, [])
    meshes: list[tuple[str, Array, Array]] = []
    try:
        for link, element in _visuals(parse(content_of(file, SceneError))):
            place = _place(element)
            geometry = element.only("geometry")
            for given in geometry.children if geometry else ():
                if given.tag == "mesh":
                    triangles = _triangles(file, given, looks.notes)
                    if triangles is not None:
                        meshes.append((link, place, triangles))
                elif (sizes := _primitive(given, link)) is not None:
                    found = {**sizes, "place": place.ravel().tolist()}
                    looks.shapes.setdefault(link, []).append(found)
    except SceneError as error:
        raise SceneError(f"{file}: {error}") from None
    total = sum(len(triangles) for _, _, triangles in meshes)
    for link, place, triangles in meshes:
        part = thinned(triangles, max(_FEWEST, _MOST * len(triangles) // max(total, 1)))
        looks.shapes.setdefault(link, []).append(
            {
                "triangles": base64.b64encode(part.astype("<f4").tobytes()).decode("ascii"),
                "place": place.ravel().tolist(),
            }
        )
    return looks


def _visuals(robot: Element) -> Iterator[tuple[str, Element]]:
    """The visual elements with the names of their links."""
    for link in robot.named("link"):
        for visual in link.named("visual"):
            yield name_of(link), visual


def _place(visual: Element) -> Array:
    """The matrix (4, 4) from a visual to its link: about x, then y, then z of the link, then shifted."""
    place, origin = np.eye(4), visual.only("origin")
    if origin is None:
        return place
    where = "origin of a visual"
    if "rpy" in origin.attributes:
        (a, b, c) = triple(origin, "rpy", where)
        about = [(2, c), (1, b), (0, a)]
        place[:3, :3] = np.linalg.multi_dot([_turned(axis, angle) for axis, angle in about])
    if "xyz" in origin.attributes:
        place[:3, 3] = triple(origin, "xyz", where)
    return place


def _turned(axis: int, angle: float) -> Array:
    """The rotation (3, 3) by an angle (rad) about a coordinate axis."""
    i, j = (axis + 1) % 3, (axis + 2) % 3
    turned = np.eye(3)
    turned[[i, j], [i, j]] = math.cos(angle)
    turned[i, j], turned[j, i] = -math.sin(angle), math.sin(angle)
    return turned


def _primitive(given: Element, link: str) -> dict[str, Any] | None:
    """Sizes of a box, a ball or a cylinder; None for what pages do not know."""
    where = f"visual of link {link!r}"
    if given.tag == "box":
        return {"box": list(triple(given, "size", where))}
    if given.tag == "sphere":
        return {"sphere": number(given, "radius", where)}
    if given.tag == "cylinder":
        return {"cylinder": [number(given, key, where) for key in ("radius", "length")]}
    return None


def _triangles(file: Path, given: Element, notes: list[str]) -> Array | None:
    """Corners (n, 3, 3) of the triangles of a mesh, scaled (m); None, and a note, if there are none."""
    name = given.attributes.get("filename", "")
    found = _found(file, name)
    if found is None:
        notes.append(f"The mesh {name!r} is not there.")
        return None
    try:
        corners = _read(found)
    except ImportError:
        notes.append("Meshes need the package trimesh: pip install 'mbdlft[viewer]'.")
        return None
    except Exception as error:  # a reader of ten formats has its own errors
        notes.append(f"The mesh {name!r} cannot be read: {error}.")
        return None
    if not len(corners) or not np.isfinite(corners).all():
        notes.append(f"The mesh {name!r} has no triangles.")
        return None
    scale = given.attributes.get("scale")
    factors = np.ones(3) if scale is None else np.array(triple(given, "scale", f"mesh {name!r}"))
    return np.asarray(corners * factors, dtype=float)


@lru_cache(maxsize=64)  # legs and wheels have one mesh
def _read(file: Path) -> Array:
    """Corners (n, 3, 3) of the triangles of a file."""
    import trimesh

    return np.asarray(trimesh.load_mesh(file, process=False).triangles, dtype=float)


def _found(file: Path, name: str) -> Path | None:
    """The file of a mesh: beside the robot, or in a folder above it that has the package."""
    plain = name.removeprefix("file://")
    if not name.startswith(_PACKAGE):
        at = file.parent / plain
        return at if at.is_file() else None
    inside = name.removeprefix(_PACKAGE)
    package, _, rest = inside.partition("/")
    for folder in file.resolve().parents:
        places = [folder / inside] + ([folder / rest] if folder.name == package else [])
        for place in places:
            if place.is_file():
                return place
    return None


def thinned(corners: Array, most: int) -> Array:
    """At most about `most` triangles (n, 3, 3): corners in one cell of a grid become their mean.

    Triangles with two corners in one cell vanish. Source: Rossignac and Borrel, Multi-resolution 3D
    approximations for rendering complex scenes (1993), section 2.
    """
    points, found = corners.reshape(-1, 3), corners
    low, size = points.min(axis=0), float(np.max(np.ptp(points, axis=0)))
    cells = min(float(_FINEST), 2.0 * math.sqrt(most) + 2.0)
    while len(found) > most and cells > 1.0 and size > 0.0:
        x, y, z = np.floor((points - low) * (cells / size)).astype(np.int64).T
        wide = int(cells) + 2
        _, cell = np.unique((x * wide + y) * wide + z, return_inverse=True)
        sums = np.stack([np.bincount(cell, points[:, k]) for k in range(3)], axis=1)
        means = sums / np.bincount(cell)[:, None].astype(float)
        three = np.sort(cell.reshape(-1, 3), axis=1)
        three = three[(three[:, 0] != three[:, 1]) & (three[:, 1] != three[:, 2])]
        found = means[np.unique(three, axis=0)]
        cells *= _FINER
    return np.asarray(found, dtype=float)
