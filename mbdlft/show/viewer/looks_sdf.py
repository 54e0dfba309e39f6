"""The visual elements of an SDF model."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from mbdlft.robot.elements import Element, content_numbers, name_of
from mbdlft.robot.sdf import chosen_model, version_of
from mbdlft.robot.sdf_frames import frames_of, scopes
from mbdlft.robot.turns import between
from mbdlft.show.viewer.meshes import Look, placed, triangles_of

# the sizes of shapes, each with the number of its entries
_SIZES: Mapping[str, tuple[tuple[str, int], ...]] = {
    "box": (("size", 3),), "sphere": (("radius", 1),), "ellipsoid": (("radii", 3),),
    "cylinder": (("radius", 1), ("length", 1)), "capsule": (("radius", 1), ("length", 1)),
    "cone": (("radius", 1), ("length", 1)),
}  # fmt: skip
_UP = np.array([0.0, 0.0, 1.0])


def sdf_looks(file: Path, top: Element, model: str | None, notes: list[str]) -> list[Look]:
    """The shapes of all links of a model; `notes` gets sentences on what is not shown.

    Raises
    ------
    SceneError
        A number is wrong, or a pose is relative to an unknown frame.
    """
    chosen, _ = chosen_model(top, model)
    frames = frames_of(chosen, version_of(top))
    looks = []
    for scope, owner in scopes(chosen):
        for link in owner.named("link"):
            name = f"{scope}{name_of(link)}"
            for visual in link.named("visual"):
                where = f"visual of link {name!r}"
                pose = frames.inside(visual, name, scope, where)
                place = placed(pose.R, pose.p)
                geometry = visual.only("geometry")
                for given in geometry.children if geometry else ():
                    look = _look(file, name, given, notes)
                    looks += [look._replace(place=place @ look.place)] if look else []
    return looks


def _look(file: Path, link: str, given: Element, notes: list[str]) -> Look | None:
    """A shape at the origin of its visual; None for one that is not shown."""
    where = f"visual of link {link!r}"
    if given.tag == "mesh":
        return _mesh(file, link, given, notes)
    if given.tag == "plane":
        normal, size = given.only("normal"), given.only("size")
        along = np.array(content_numbers(normal, where, 3)) if normal else _UP
        sizes = list(content_numbers(size, where, 2)) if size else [1.0, 1.0]
        return Look(link, placed(between(_UP, along), np.zeros(3)), {"plane": sizes})
    if given.tag not in _SIZES:
        if given.tag != "empty":
            notes.append(f"Shapes <{given.tag}> are not shown.")
        return None
    numbers: list[float] = []
    for key, count in _SIZES[given.tag]:
        part = given.only(key)
        if part is None:
            notes.append(f"A <{given.tag}> of link {link!r} has no <{key}> and is not shown.")
            return None
        numbers += content_numbers(part, where, count)
    return Look(link, np.eye(4), {given.tag: numbers if len(numbers) > 1 else numbers[0]})


def _mesh(file: Path, link: str, given: Element, notes: list[str]) -> Look | None:
    """A mesh; a part of one is not shown."""
    uri, scale = given.only("uri"), given.only("scale")
    name = uri.text.strip() if uri else ""
    if given.only("submesh"):
        notes.append(f"Of the mesh {name!r} a part is asked for, and it is not shown.")
        return None
    corners = triangles_of(file, name, notes)
    if corners is None:
        return None
    if scale:
        corners = corners * np.array(content_numbers(scale, f"mesh {name!r}", 3))
    return Look(link, np.eye(4), {}, corners)
