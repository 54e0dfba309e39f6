"""Mass, center of mass and inertia of a body from its rigid-body mass matrix.

R' M R = [[m 1, -m [c]x], [m [c]x, J]]      about the origin
"""

from typing import NamedTuple

import numpy as np

from mbdlft.base.array import Array
from mbdlft.base.errors import StructureError
from mbdlft.elastic.nodes import DIRECTIONS, Nodes, transport
from mbdlft.elastic.partition import Partition

_CONSISTENT = 1e-6  # of the mass matrix; data are written with few digits
_ROUNDING = 1e-14  # of mass times size: what is left of products that cancel
# where a coordinate of the center stands in the coupling of displacements and rotations, and its sign
_CENTER = (((1, 5, 1.0), (2, 4, -1.0)), ((2, 3, 1.0), (0, 5, -1.0)), ((0, 4, 1.0), (1, 3, -1.0)))


class Rigid(NamedTuple):
    """Mass (kg), center of mass (3,) from the origin (m), inertia (3, 3) about the origin (kg m^2).

    Entries of the inertia that a structure without some displacements does not determine are nan.
    """

    mass: float
    center: Array
    inertia: Array


def rigid_properties(nodes: Nodes, at: Partition, bodily: Array) -> Rigid:
    """Rigid properties from R' M R (r, r) of the directions that the structure has.

    Raises
    ------
    StructureError
        They are not those of any rigid body, or not determined.
    """
    full = np.full((6, 6), np.nan)
    full[np.ix_(at.directions, at.directions)] = bodily
    moved = [d for d in at.directions if d < 3]
    if not moved:
        raise StructureError(
            "the structure has no displacements at its parent, so its mass is not determined. Keep "
            "them in the "
            "matrices."
        )
    masses = full[moved, moved]
    mass = float(np.mean(masses))
    if not mass > 0.0:
        raise StructureError(
            f"mass matrix: the mass of the structure is {mass:g} kg; expected more."
        )
    if np.max(np.abs(masses - mass)) > _CONSISTENT * mass:
        listed = ", ".join(f"{DIRECTIONS[d]}: {full[d, d]:.9g} kg" for d in moved)
        raise StructureError(
            f"mass matrix: the mass is not the same in all directions ({listed}). Check the order "
            "of the rows, and "
            "that no coordinate with mass was left out."
        )
    center = np.array([_center(nodes, at, full, k) for k in range(3)]) / mass
    size = float(np.max(np.abs(np.asarray(nodes.coordinates) - at.origin)))
    center[np.abs(center) < _ROUNDING * size] = 0.0
    inertia = full[3:, 3:]
    inertia[np.abs(inertia) < _ROUNDING * mass * size**2] = 0.0
    rigid = Rigid(mass, center, inertia)
    expected = mass_matrix(rigid)
    length = max(
        float(np.linalg.norm(center)), np.sqrt(np.nanmax(np.diag(full)[3:], initial=0.0) / mass)
    )
    scale = np.array([1.0] * 3 + [length if length > 0.0 else 1.0] * 3)
    difference = (full - expected) / (mass * np.outer(scale, scale))
    if np.nanmax(np.abs(difference)) > _CONSISTENT:
        i, j = np.unravel_index(int(np.nanargmax(np.abs(difference))), (6, 6))
        raise StructureError(
            f"mass matrix: not that of a body: in a rigid motion, the entry ({DIRECTIONS[i]}, "
            f"{DIRECTIONS[j]}) is "
            f"{full[i, j]:.6g} and would be {expected[i, j]:.6g}. Check the order of the rows, the "
            "coordinates and the axes "
            "of the nodes."
        )
    return rigid


def mass_matrix(rigid: Rigid) -> Array:
    """R' M R (6, 6) about the origin; nan where the inertia is not determined."""
    found = rigid.mass * transport(rigid.center)
    found[3:, :3] = found[:3, 3:].T
    found[3:, 3:] = rigid.inertia
    return found


def _center(nodes: Nodes, at: Partition, full: Array, axis: int) -> float:
    """Mass times a coordinate of the center: where the matrix tells, or all nodes have the same."""
    told = [sign * full[i, j] for i, j, sign in _CENTER[axis] if not np.isnan(full[i, j])]
    if told:
        return float(np.mean(told))
    along = np.asarray(nodes.coordinates)[:, axis] - at.origin[axis]
    if np.ptp(along) > 0.0:
        raise StructureError(
            "the structure has no displacements that tell where its center of mass is along "
            f"{DIRECTIONS[axis]}, and "
            "its nodes are at several places. Keep all displacements of the nodes in the matrices."
        )
    mass = np.nanmean(np.diag(full)[:3])
    return float(mass * along[0])
