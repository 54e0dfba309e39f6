"""What the file of a robot says of its looks: shapes and meshes of its links, as pages draw them.

Meshes are thinned until a page has room for them.
"""

import base64
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from mbdlft.base.array import Array
from mbdlft.base.errors import SceneError
from mbdlft.multibody.body import GROUND
from mbdlft.robot.read import top_of
from mbdlft.robot.tree import body_name
from mbdlft.show.viewer.looks_mjcf import mjcf_looks
from mbdlft.show.viewer.looks_sdf import sdf_looks
from mbdlft.show.viewer.looks_urdf import urdf_looks
from mbdlft.show.viewer.meshes import Look, thinned

_MOST = 36_000  # triangles of a page
_FEWEST = 60  # of a mesh, however many there are


class Looks(NamedTuple):
    """The geometry of bodies, by name, and what could not be read."""

    shapes: dict[str, list[dict[str, Any]]]
    notes: list[str]


def robot_looks(path: str | Path, model: str | None = None) -> Looks:
    """Shapes of the links of a URDF, SDF or MJCF file, by the names that their bodies have in a scene.

    Each has a ``place``, the 16 entries of its matrix in the frame of the link by rows; the sizes of a
    ``box``, a ``sphere``, a ``cylinder``, a ``capsule``, a ``cone``, an ``ellipsoid`` or a ``plane``
    (m), or the ``triangles`` of a mesh: corners as base64 of float32; and, if it moves and has an end,
    its ``extent`` in the frame of the link: the least and the largest coordinates (m).

    Parameters
    ----------
    path : file
    model : str, optional
        Which model of an SDF file that has several.

    Raises
    ------
    SceneError
        The file cannot be read, or a number in it is wrong. A mesh that cannot be read is a note.
    """
    file, notes = Path(path), list[str]()
    top = top_of(file)
    try:
        if top.tag == "sdf":
            looks = sdf_looks(file, top, model, notes)
        elif top.tag == "mujoco":
            looks = mjcf_looks(file, top, notes)
        else:
            looks = urdf_looks(file, top, notes)
    except SceneError as error:
        raise SceneError(f"{file}: {error}") from None
    return Looks(_drawn(looks), notes)


def _drawn(looks: Sequence[Look]) -> dict[str, list[dict[str, Any]]]:
    """The shapes as data, by body; all meshes together have not many triangles."""
    total = sum(len(look.triangles) for look in looks if look.triangles is not None)
    shapes: dict[str, list[dict[str, Any]]] = {}
    for look in looks:
        found: dict[str, Any] = {**look.sizes, "place": look.place.ravel().tolist()}
        corners = _corners(look.sizes)
        if look.triangles is not None:
            most = max(_FEWEST, _MOST * len(look.triangles) // max(total, 1))
            part = thinned(look.triangles, most)
            corners = part.reshape(-1, 3)
            text = base64.b64encode(part.astype("<f4").tobytes()).decode("ascii")
            found["triangles"] = text
        name = body_name(look.link) if look.link else GROUND
        if len(corners) and look.link:
            points = corners @ look.place[:3, :3].T + look.place[:3, 3]
            found["extent"] = [points.min(axis=0).tolist(), points.max(axis=0).tolist()]
        shapes.setdefault(name, []).append(found)
    return shapes


def _corners(sizes: dict[str, Any]) -> Array:
    """The corners (8, 3) of the box about a shape, or none of a plane (0, 3)."""
    kind = next(iter(sizes), "")
    given: Any = sizes.get(kind)
    if kind == "box":
        half = 0.5 * np.array(given)
    elif kind == "sphere":
        half = np.full(3, given)
    elif kind == "ellipsoid":
        half = np.array(given)
    elif kind in ("cylinder", "capsule", "cone"):
        radius, length = given
        half = np.array([radius, radius, 0.5 * length + (radius if kind == "capsule" else 0.0)])
    else:
        return np.zeros((0, 3))
    signs = np.stack(np.meshgrid(*3 * [[-1.0, 1.0]]), axis=-1).reshape(-1, 3)
    return np.asarray(signs * half, dtype=float)
