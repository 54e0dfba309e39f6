"""The geoms of an MJCF file, as the package mujoco compiles them."""

from pathlib import Path
from typing import Any

import numpy as np

from mbdlft.base.array import Array
from mbdlft.robot.elements import Element
from mbdlft.robot.mjcf_model import Compiled, compiled
from mbdlft.robot.turns import of_quaternion
from mbdlft.show.viewer.meshes import Look, placed

_GROUPS = 3  # the first groups are those that MuJoCo's own viewer shows; the others collide


def mjcf_looks(file: Path, top: Element, notes: list[str]) -> list[Look]:
    """The geoms of all bodies and of the world; `notes` gets sentences on what is not shown.

    Geoms of the groups 0, 1 and 2 are shown, or all of them if these have none; transparent ones are
    not.

    Raises
    ------
    SceneError
        The package mujoco is not installed, or cannot compile the file.
    """
    model = compiled(file, top)
    seen = [k for k in range(model.count("ngeom")) if _visible(model, k)]
    chosen = [k for k in seen if model.of("geom_group")[k] < _GROUPS] or seen
    looks = []
    for k in chosen:
        body = int(model.of("geom_bodyid")[k])
        place = placed(of_quaternion(model.of("geom_quat")[k]), model.of("geom_pos")[k])
        look = Look(model.body(body) if body else "", place, {})
        sizes = _sizes(model, k)
        if sizes:
            looks.append(look._replace(sizes=sizes))
        elif (corners := _triangles(model, k)) is not None:
            looks.append(look._replace(triangles=corners))
        else:
            kind = model.word("mjtGeom", model.of("geom_type")[k]).lower()
            notes.append(f"Geoms of the type {kind} are not shown.")
    return looks


def _visible(model: Compiled, geom: int) -> bool:
    """Whether a geom is not transparent; the color of its material counts, if it has one."""
    material = int(model.of("geom_matid")[geom])
    color = model.of("mat_rgba")[material] if material >= 0 else model.of("geom_rgba")[geom]
    return bool(color[3] > 0.0)


def _sizes(model: Compiled, geom: int) -> dict[str, Any]:
    """Sizes (m) of a geom; MuJoCo has halves of them. Nothing for what has others."""
    kind = model.word("mjtGeom", model.of("geom_type")[geom])
    a, b, c = (float(entry) for entry in model.of("geom_size")[geom])
    known: dict[str, Any] = {
        "BOX": {"box": [2.0 * a, 2.0 * b, 2.0 * c]},
        "SPHERE": {"sphere": a},
        "ELLIPSOID": {"ellipsoid": [a, b, c]},
        "CYLINDER": {"cylinder": [a, 2.0 * b]},
        "CAPSULE": {"capsule": [a, 2.0 * b]},
        "PLANE": {"plane": [2.0 * a, 2.0 * b]},
    }
    return dict(known.get(kind, {}))


def _triangles(model: Compiled, geom: int) -> Array | None:
    """Corners (n, 3, 3) of the mesh of a geom, in its axes; None if it has no mesh."""
    mesh, kind = int(model.of("geom_dataid")[geom]), int(model.of("geom_type")[geom])
    if mesh < 0 or kind not in (model.code("mjtGeom", "MESH"), model.code("mjtGeom", "SDF")):
        return None
    point, face = (int(model.of(f"mesh_{key}adr")[mesh]) for key in ("vert", "face"))
    points = model.of("mesh_vert")[point : point + model.of("mesh_vertnum")[mesh]]
    faces = model.of("mesh_face")[face : face + model.of("mesh_facenum")[mesh]]
    return np.asarray(points[faces], dtype=float)
