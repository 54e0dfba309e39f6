"""Shapes of bodies: those of the scene, or solids with mass and inertia of rigid bodies at nominal.

A box of the sides a, b, c has J_x = m (b^2 + c^2) / 12, so a^2 = 6 (J_y + J_z - J_x) / m; a cylinder of
the radius r and the length h along z has J_z = m r^2 / 2 and J_x = J_y = m (3 r^2 + h^2) / 12.
"""

from typing import Any

import casadi as ca
import numpy as np

from mbdlft.base.array import Array
from mbdlft.multibody.body import RigidBody, Shape
from mbdlft.multibody.body.rigid import DIAGONAL
from mbdlft.multibody.scene.quantities import owner_name
from mbdlft.robot.description import between
from mbdlft.show.viewer.drawing import Drawing
from mbdlft.show.viewer.looks import extent_of, placed

_UP = np.array([0.0, 0.0, 1.0])
_SAME = 1e-9  # of the largest moment: two that are equal as far as numbers of a file say
_FLAT = 1e-9  # of the largest side, squared: a plate has no thickness, up to rounding
_ENTRY = (("xx", "xy", "xz"), ("xy", "yy", "yz"), ("xz", "yz", "zz"))


def add_solids(drawing: Drawing) -> None:
    """Add the shape of each body: its own, or the solid of its mass and inertia if there is one."""
    items = {item["name"]: item for item in drawing.items if item["group"] in ("bodies", "world")}
    for body in drawing.poses.scene.bodies:
        geometry = None
        if body.shape is not None:
            geometry = _given(body.shape)
        elif isinstance(body, RigidBody) and set(DIAGONAL) <= set(body.inertia.given()):
            geometry = _solid(drawing, body)
        if geometry is not None:
            at = drawing.frame(body.name)
            shape = {"type": "mesh", "at": at, "geometry": geometry, "layer": "solids"}
            items[body.name]["shapes"].append(shape)


def _given(shape: Shape) -> dict[str, Any]:
    """The geometry of a shape of the scene, as pages draw it."""
    found = {kind: getattr(shape, kind) for kind in ("box", "cylinder", "sphere")}
    sizes = {
        kind: list(size) if isinstance(size, tuple) else size
        for kind, size in found.items()
        if size is not None
    }
    place = placed(between(_UP, np.array(shape.axis, dtype=float)), np.array(shape.at, dtype=float))
    return {**sizes, "place": place.ravel().tolist(), "extent": extent_of(sizes, place)}


def solid_of(mass: float, inertia: Array) -> tuple[dict[str, Any], Array] | None:
    """Sizes (m) by kind, and the axes (3, 3) as columns, of a solid with this mass and inertia (3, 3).

    The inertia is about the center of mass (kg m^2). None where no solid has it.
    """
    if not (mass > 0.0 and np.isfinite(inertia).all()):
        return None
    moments, axes = np.linalg.eigh(inertia)
    axes[:, 2] = np.cross(axes[:, 0], axes[:, 1])
    for k in (0, 2):  # the axis of a cylinder: the moments about the other two are equal
        i, j = (k + 1) % 3, (k + 2) % 3
        radius = 2.0 * moments[k] / mass
        length = 12.0 * moments[i] / mass - 3.0 * radius
        equal = abs(moments[i] - moments[j]) <= _SAME * moments[2] < abs(moments[0] - moments[2])
        if equal and radius > 0.0 and length >= -_FLAT * radius:
            turned = axes[:, [i, j, k]]
            return {"cylinder": [float(radius**0.5), float(max(length, _FLAT * radius) ** 0.5)]}, turned
    squares = 6.0 * (np.sum(moments) - 2.0 * moments) / mass
    if np.min(squares) < -_FLAT * np.max(squares):
        return None
    sides = np.sqrt(np.maximum(squares, _FLAT**2 * np.max(squares)))
    return ({"box": [float(side) for side in sides]}, axes) if np.max(sides) > 0.0 else None


def _solid(drawing: Drawing, body: RigidBody) -> dict[str, Any] | None:
    """The geometry of the solid of a body, as pages draw it."""
    values = drawing.poses.values[owner_name(body)]
    entries = [values.get(f"inertia.{name}", 0.0) for row in _ENTRY for name in row]
    center, about = (body.port_position(port, values) for port in ("center_of_mass", body.inertia.about))
    stacked = ca.vertcat(*(ca.SX(entry) for entry in entries), values["mass"], center, about)
    numbers = drawing.numbers(stacked)
    inertia, mass, r, p = numbers[:9].reshape(3, 3), float(numbers[9]), numbers[10:13], numbers[13:]
    d = r - p
    found = solid_of(mass, inertia - mass * ((d @ d) * np.eye(3) - np.outer(d, d)))
    if found is None:
        return None
    sizes, axes = found
    place = placed(axes, r)
    return {**sizes, "place": place.ravel().tolist(), "extent": extent_of(sizes, place)}
