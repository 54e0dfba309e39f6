"""Meshes that the file of a robot names: found, read by the package trimesh, and thinned."""

import math
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from mbdlft.base.array import Array

_FINEST, _FINER = 256, 0.8  # cells along a mesh at most, and by what they get fewer
_SCHEMES = ("package://", "model://")


class Look(NamedTuple):
    """A shape of a link, or of the ground, whose name is empty.

    `place` (4, 4) is its matrix in the frame of the link. `sizes` are those of a primitive, by its kind;
    a mesh has `triangles`: corners (n, 3, 3) in m.
    """

    link: str
    place: Array
    sizes: dict[str, Any]
    triangles: Array | None = None


def placed(R: Array, r: Array) -> Array:
    """The matrix (4, 4) of a rotation and a shift."""
    place = np.eye(4)
    place[:3, :3], place[:3, 3] = R, r
    return place


def triangles_of(file: Path, name: str, notes: list[str]) -> Array | None:
    """Corners (n, 3, 3) of the triangles of a mesh that `file` names, or None and a note."""
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
    return corners


@lru_cache(maxsize=64)  # legs and wheels have one mesh
def _read(file: Path) -> Array:
    """Corners (n, 3, 3) of the triangles of a file."""
    import trimesh

    return np.asarray(trimesh.load_mesh(file, process=False).triangles, dtype=float)


def _found(file: Path, name: str) -> Path | None:
    """The file of a mesh: beside the robot, or in a folder above it that has the package."""
    plain = name.removeprefix("file://")
    if not name.startswith(_SCHEMES):
        at = file.parent / plain
        return at if at.is_file() else None
    inside = name.partition("://")[2]
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
