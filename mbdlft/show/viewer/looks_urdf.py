"""The visual elements of a URDF file."""

from pathlib import Path
from typing import Any

import numpy as np

from mbdlft.base.array import Array
from mbdlft.robot.elements import Element, name_of, number, triple
from mbdlft.robot.turns import of_angles
from mbdlft.show.viewer.meshes import Look, placed, triangles_of


def urdf_looks(file: Path, robot: Element, notes: list[str]) -> list[Look]:
    """The shapes of all links; `notes` gets sentences on what is not shown.

    Raises
    ------
    SceneError
        A number is wrong.
    """
    looks = []
    for link in robot.named("link"):
        for visual in link.named("visual"):
            geometry = visual.only("geometry")
            for given in geometry.children if geometry else ():
                look = _look(file, name_of(link), given, notes)
                looks += [look._replace(place=_place(visual))] if look else []
    return looks


def _place(visual: Element) -> Array:
    """The matrix (4, 4) from a visual to its link: about x, then y, then z of the link, then shifted."""
    origin = visual.only("origin")
    where = "origin of a visual"
    turned, shifted = np.eye(3), np.zeros(3)
    if origin is not None and "rpy" in origin.attributes:
        turned = of_angles(triple(origin, "rpy", where))
    if origin is not None and "xyz" in origin.attributes:
        shifted = np.array(triple(origin, "xyz", where))
    return placed(turned, shifted)


def _look(file: Path, link: str, given: Element, notes: list[str]) -> Look | None:
    """A shape at the origin of its link; None for one that is not shown."""
    where = f"visual of link {link!r}"
    if given.tag == "mesh":
        name = given.attributes.get("filename", "")
        corners = triangles_of(file, name, notes)
        if corners is None:
            return None
        if "scale" in given.attributes:
            corners = corners * np.array(triple(given, "scale", f"mesh {name!r}"))
        return Look(link, np.eye(4), {}, corners)
    sizes: dict[str, Any] = {}
    if given.tag == "box":
        sizes["box"] = list(triple(given, "size", where))
    elif given.tag == "sphere":
        sizes["sphere"] = number(given, "radius", where)
    elif given.tag in ("cylinder", "capsule"):
        sizes[given.tag] = [number(given, key, where) for key in ("radius", "length")]
    else:
        notes.append(f"Shapes <{given.tag}> are not shown.")
        return None
    return Look(link, np.eye(4), sizes)
