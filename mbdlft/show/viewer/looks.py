"""What the file of a robot says of the looks of its links: shapes and meshes, as pages draw them.

URDF and SDF files are read as they are written, and their meshes by the package trimesh; the geoms of an
MJCF file are those that the package mujoco compiles. Meshes are thinned until a page has room for them.
"""

import base64
import math
from collections.abc import Iterator, Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from mbdlft.base.array import Array
from mbdlft.base.errors import SceneError, naming
from mbdlft.multibody.body import GROUND
from mbdlft.robot import urdf
from mbdlft.robot.load import top_of
from mbdlft.robot.mjcf_model import Compiled, compiled
from mbdlft.robot.robot import between, body_name, of_angles, of_quaternion
from mbdlft.robot.sdf import chosen_model, version_of
from mbdlft.robot.sdf_frames import frames_of, scopes

_FINEST, _FINER = 256, 0.8  # cells along a mesh at most, and by what they get fewer
_MOST = 36_000  # triangles of a page: some 2 MB
_FEWEST = 60  # of a mesh, however many there are
_GROUPS = 3  # the first groups are those that MuJoCo's own viewer shows; the others collide
_UP = np.array([0.0, 0.0, 1.0])
# the sizes of shapes, each with the number of its entries
_SIZES: Mapping[str, tuple[tuple[str, int], ...]] = {
    "box": (("size", 3),), "sphere": (("radius", 1),), "ellipsoid": (("radii", 3),),
    "cylinder": (("radius", 1), ("length", 1)), "capsule": (("radius", 1), ("length", 1)),
    "cone": (("radius", 1), ("length", 1)),
}  # fmt: skip
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
    mesh, problem = _mesh_file(file, name), f"The mesh {name!r} is not there."
    if mesh is not None:
        try:
            corners = _read(mesh)
            if len(corners) and np.isfinite(corners).all():
                return corners
            problem = f"The mesh {name!r} has no triangles."
        except ImportError:
            problem = "Meshes need the package trimesh: pip install 'mbdlft[viewer]'."
        except Exception as error:  # a reader of ten formats has its own errors
            problem = f"The mesh {name!r} cannot be read: {error}."
    notes.append(problem)
    return None


@lru_cache(maxsize=64)  # legs and wheels have one mesh
def _read(file: Path) -> Array:
    """Corners (n, 3, 3) of the triangles of a file."""
    import trimesh

    return np.asarray(trimesh.load_mesh(file, process=False).triangles, dtype=float)


def _mesh_file(file: Path, name: str) -> Path | None:
    """The file of a mesh: beside the robot, or in a folder above it that has the package."""
    places = [file.parent / name.removeprefix("file://")]
    if name.startswith(_SCHEMES):
        inside = name.partition("://")[2]
        package, _, in_package = inside.partition("/")
        places = []
        for folder in file.resolve().parents:
            places += [folder / inside] + [folder / in_package] * (folder.name == package)
    return next((place for place in places if place.is_file()), None)


def thinned(corners: Array, most: int) -> Array:
    """At most about `most` triangles (n, 3, 3): corners in one cell of a grid become their mean.

    Triangles with two corners in one cell vanish. Source: Rossignac and Borrel, Multi-resolution 3D
    approximations for rendering complex scenes (1993), section 2.
    """
    points, kept = corners.reshape(-1, 3), corners
    low, size = points.min(axis=0), float(np.max(np.ptp(points, axis=0)))
    cells = min(float(_FINEST), 2.0 * math.sqrt(most) + 2.0)
    while len(kept) > most and cells > 1.0 and size > 0.0:
        x, y, z = np.floor((points - low) * (cells / size)).astype(np.int64).T
        wide = int(cells) + 2
        _, cell = np.unique((x * wide + y) * wide + z, return_inverse=True)
        sums = np.stack([np.bincount(cell, points[:, k]) for k in range(3)], axis=1)
        means = sums / np.bincount(cell)[:, None].astype(float)
        three = np.sort(cell.reshape(-1, 3), axis=1)
        three = three[(three[:, 0] != three[:, 1]) & (three[:, 1] != three[:, 2])]
        kept = means[np.unique(three, axis=0)]
        cells *= _FINER
    return np.asarray(kept, dtype=float)


def mjcf_looks(file: Path, top: urdf.Element, notes: list[str]) -> list[Look]:
    """The geoms of all bodies and of the world; `notes` gets sentences on what is not shown.

    Geoms of the groups 0, 1 and 2 are shown, or all of them if these have none; transparent ones are
    not.
    """
    model = compiled(file, top)
    visible = [k for k in range(model.arrays.ngeom) if _visible(model, k)]
    shown = [k for k in visible if model.arrays.geom_group[k] < _GROUPS] or visible
    looks = []
    for k in shown:
        body = int(model.arrays.geom_bodyid[k])
        place = placed(of_quaternion(model.arrays.geom_quat[k]), model.arrays.geom_pos[k])
        look = Look(model.body(body) if body else "", place, {})
        sizes = _sizes(model, k)
        if sizes:
            looks.append(look._replace(sizes=sizes))
        elif (corners := _triangles(model, k)) is not None:
            looks.append(look._replace(triangles=corners))
        else:
            kind = model.word("mjtGeom", model.arrays.geom_type[k]).lower()
            notes.append(f"Geoms of the type {kind} are not shown.")
    return looks


def _visible(model: Compiled, geom: int) -> bool:
    """Whether a geom is not transparent; the color of its material counts, if it has one."""
    material = int(model.arrays.geom_matid[geom])
    color = model.arrays.mat_rgba[material] if material >= 0 else model.arrays.geom_rgba[geom]
    return bool(color[3] > 0.0)


def _sizes(model: Compiled, geom: int) -> dict[str, Any]:
    """Sizes (m) of a geom; MuJoCo has halves of them. Nothing for what has others."""
    kind = model.word("mjtGeom", model.arrays.geom_type[geom])
    a, b, c = (float(entry) for entry in model.arrays.geom_size[geom])
    known: dict[str, Any] = {
        "BOX": {"box": [2.0 * a, 2.0 * b, 2.0 * c]},
        "SPHERE": {"sphere": a},
        "ELLIPSOID": {"ellipsoid": [a, b, c]},
        "CYLINDER": {"cylinder": [a, 2.0 * b]},
        "CAPSULE": {"capsule": [a, 2.0 * b]},
        "PLANE": {"plane": [2.0 * a, 2.0 * b]},
    }
    return dict(known.get(kind, {}))


def _field(model: Compiled, field: int) -> Array:
    """Corners (n, 3, 3) of the surface of a field of heights: two triangles for each of its cells."""
    rows, columns = int(model.arrays.hfield_nrow[field]), int(model.arrays.hfield_ncol[field])
    first = int(model.arrays.hfield_adr[field])
    wide, long, high, _ = model.arrays.hfield_size[field]
    heights = model.arrays.hfield_data[first : first + rows * columns].reshape(rows, columns)
    x, y = np.meshgrid(np.linspace(-wide, wide, columns), np.linspace(-long, long, rows))
    points = np.stack([x, y, high * heights], axis=-1)
    a, b, c, d = points[:-1, :-1], points[:-1, 1:], points[1:, :-1], points[1:, 1:]
    cells = np.stack([np.stack([a, b, c], axis=2), np.stack([b, d, c], axis=2)])
    return np.asarray(cells.reshape(-1, 3, 3), dtype=float)


def extruded(outline: Array, height: float) -> Array:
    """Corners (n, 3, 3) of a prism from z = 0 to a height, on a simple polygon (m, 2), either way round.

    The ends are cut into triangles ear by ear (Meisters, Polygons have ears, 1975).
    """
    low, high = (np.column_stack([outline, np.full(len(outline), z)]) for z in (0.0, height))
    after = np.roll(np.arange(len(outline)), -1)
    walls = [[low, low[after], high[after]], [low, high[after], high]]
    ends = _ears(outline)
    triangles = [np.stack(wall, axis=1) for wall in walls] + [low[ends], high[ends]]
    return np.concatenate(triangles)


def _ears(outline: Array) -> Array:
    """Indices (m - 2, 3) of triangles that cover a simple polygon (m, 2)."""

    def twice(a: int, b: int, c: int) -> float:
        (p, q), (r, s) = outline[b] - outline[a], outline[c] - outline[a]
        return float(p * s - q * r)

    left, ears = list(range(len(outline))), list[tuple[int, int, int]]()
    x, y = outline.T
    if np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)) < 0.0:
        left.reverse()
    while len(left) > 2:
        corners = [(left[k - 1], left[k], left[(k + 1) % len(left)]) for k in range(len(left))]
        ear = next(
            (
                (a, b, c)
                for a, b, c in corners
                if twice(a, b, c) > 0.0
                and not any(
                    min(twice(a, b, p), twice(b, c, p), twice(c, a, p)) >= 0.0
                    for p in {*left} - {a, b, c}
                )
            ),
            corners[0],  # of a line, or of a polygon that crosses itself
        )
        ears.append(ear)
        left.remove(ear[1])
    return np.array(ears, dtype=int).reshape(-1, 3)


def _triangles(model: Compiled, geom: int) -> Array | None:
    """Corners (n, 3, 3) of the mesh or heights of a geom, in its axes; None if it has neither."""
    mesh, kind = int(model.arrays.geom_dataid[geom]), int(model.arrays.geom_type[geom])
    if mesh >= 0 and kind == model.code("mjtGeom", "HFIELD"):
        return _field(model, mesh)
    if mesh < 0 or kind not in (model.code("mjtGeom", "MESH"), model.code("mjtGeom", "SDF")):
        return None
    point, face = (int(getattr(model.arrays, f"mesh_{key}adr")[mesh]) for key in ("vert", "face"))
    points = model.arrays.mesh_vert[point : point + model.arrays.mesh_vertnum[mesh]]
    faces = model.arrays.mesh_face[face : face + model.arrays.mesh_facenum[mesh]]
    return np.asarray(points[faces], dtype=float)


def sdf_looks(file: Path, top: urdf.Element, model: str | None, notes: list[str]) -> list[Look]:
    """The shapes of all links of a model; `notes` gets sentences on what is not shown."""
    chosen, _ = chosen_model(top, model)
    frames = frames_of(chosen, version_of(top))
    looks: list[Look] = []
    for scope, owner in scopes(chosen):
        for link in owner.named("link"):
            name = f"{scope}{urdf.name_of(link)}"
            for visual in link.named("visual"):
                pose = frames.inside(visual, name, scope, f"visual of link {name!r}")
                place = placed(pose.R, pose.p)
                looks += _looks_of(file, name, visual, place, urdf.child_numbers, notes)
    return looks


def urdf_looks(file: Path, robot: urdf.Element, notes: list[str]) -> list[Look]:
    """The shapes of all links; `notes` gets sentences on what is not shown."""
    looks: list[Look] = []
    for link in robot.named("link"):
        for visual in link.named("visual"):
            xyz, rpy = urdf.origin_of(visual, "origin of a visual")
            place = placed(of_angles(rpy), np.array(xyz))
            looks += _looks_of(file, urdf.name_of(link), visual, place, urdf.attribute_numbers, notes)
    return looks


def _looks_of(
    file: Path, link: str, visual: urdf.Element, place: Array, read: urdf.Reader, notes: list[str]
) -> Iterator[Look]:
    """The shapes of a visual, which stands at `place` (4, 4) in its link; none for what is not shown."""
    geometry = visual.only("geometry")
    for shape in geometry.children if geometry else ():
        where = f"visual of link {link!r}"
        if shape.tag == "mesh":
            corners = _mesh_corners(file, shape, read, notes)
            if corners is not None:
                yield Look(link, place, {}, corners)
        elif shape.tag == "plane":
            normal = np.array(read(shape, "normal", where, 3) or _UP)
            turned = placed(between(_UP, normal), np.zeros(3))
            yield Look(link, place @ turned, {"plane": list(read(shape, "size", where, 2) or (1.0, 1.0))})
        elif shape.tag in _SIZES:
            sizes = {key: read(shape, key, where, count) for key, count in _SIZES[shape.tag]}
            missing = [key for key, numbers in sizes.items() if numbers is None]
            if missing:
                notes.append(f"A <{shape.tag}> of link {link!r} has no <{missing[0]}> and is not shown.")
                continue
            numbers = [number for size in sizes.values() for number in size or ()]
            yield Look(link, place, {shape.tag: numbers if len(numbers) > 1 else numbers[0]})
        elif shape.tag == "polyline" and shape.named("point"):
            points = np.array([urdf.content_numbers(point, where, 2) for point in shape.named("point")])
            (height,) = read(shape, "height", where) or (1.0,)
            yield Look(link, place, {}, extruded(points, height))
        elif shape.tag != "empty":
            notes.append(f"Shapes <{shape.tag}> are not shown.")


def _mesh_corners(file: Path, mesh: urdf.Element, read: urdf.Reader, notes: list[str]) -> Array | None:
    """Corners (n, 3, 3) of the triangles of a mesh, scaled; None for one that is not shown."""
    uri = mesh.only("uri")
    name = uri.text.strip() if uri else mesh.attributes.get("filename", "")
    if mesh.only("submesh"):
        notes.append(f"Of the mesh {name!r} a part is asked for, and it is not shown.")
        return None
    corners = triangles_of(file, name, notes)
    scale = read(mesh, "scale", f"mesh {name!r}", 3)
    return corners if corners is None or scale is None else corners * np.array(scale)


class Looks(NamedTuple):
    """The geometry of bodies, by name, and what could not be read."""

    shapes: dict[str, list[dict[str, Any]]]
    notes: list[str]


def robot_looks(path: str | Path, model: str | None = None) -> Looks:
    """Shapes of the links of a URDF, SDF or MJCF file, by the names that their bodies have in a scene.

    Each has a ``place``, the 16 entries of its matrix in the frame of the link by rows; its sizes (m) by
    kind, or the ``triangles`` of a mesh: corners as base64 of float32; and, if it moves and has an end,
    its ``extent`` in the frame of the link: the least and the largest coordinates (m).
    """
    file, notes = Path(path), list[str]()
    top = top_of(file)
    with naming(file, SceneError):
        if top.tag == "sdf":
            looks = sdf_looks(file, top, model, notes)
        elif top.tag == "mujoco":
            looks = mjcf_looks(file, top, notes)
        else:
            looks = urdf_looks(file, top, notes)
    return Looks(_drawn(looks), notes)


def _drawn(looks: Sequence[Look]) -> dict[str, list[dict[str, Any]]]:
    """The shapes as data, by body; all meshes together have not many triangles."""
    total = sum(len(look.triangles) for look in looks if look.triangles is not None)
    shapes: dict[str, list[dict[str, Any]]] = {}
    for look in looks:
        shape: dict[str, Any] = {**look.sizes, "place": look.place.ravel().tolist()}
        corners = _corners(look.sizes)
        if look.triangles is not None:
            most = max(_FEWEST, _MOST * len(look.triangles) // max(total, 1))
            triangles = thinned(look.triangles, most)
            corners = triangles.reshape(-1, 3)
            text = base64.b64encode(triangles.astype("<f4").tobytes()).decode("ascii")
            shape["triangles"] = text
        name = body_name(look.link) if look.link else GROUND
        if len(corners) and look.link:
            shape["extent"] = _extent(corners, look.place)
        shapes.setdefault(name, []).append(shape)
    return shapes


def extent_of(sizes: dict[str, Any], place: Array) -> list[list[float]]:
    """The least and the largest corner (m) of a primitive at a place (4, 4), in the axes of its body."""
    return _extent(_corners(sizes), place)


def _extent(corners: Array, place: Array) -> list[list[float]]:
    points = corners @ place[:3, :3].T + place[:3, 3]
    return [points.min(axis=0).tolist(), points.max(axis=0).tolist()]


def _corners(sizes: dict[str, Any]) -> Array:
    """The corners (8, 3) of the box about a shape, or none of a plane (0, 3)."""
    kind = next(iter(sizes), "")
    size: Any = sizes.get(kind)
    if kind == "box":
        half = 0.5 * np.array(size)
    elif kind == "sphere":
        half = np.full(3, size)
    elif kind == "ellipsoid":
        half = np.array(size)
    elif kind in ("cylinder", "capsule", "cone"):
        radius, length = size
        half = np.array([radius, radius, 0.5 * length + (radius if kind == "capsule" else 0.0)])
    else:
        return np.zeros((0, 3))
    signs = np.stack(np.meshgrid(*3 * [[-1.0, 1.0]]), axis=-1).reshape(-1, 3)
    return np.asarray(signs * half, dtype=float)
