"""Mass, center of mass and inertia of a body from its rigid-body mass matrix.

R' M R = [[m 1, -m [c]x], [m [c]x, J]]      about the origin

The columns of R are the rigid motions (`mbdlft.elastic.nodes.rigid_motions`), c is the center of mass,
[c]x the matrix of the cross product with c, and J the inertia about the origin.
"""

from typing import NamedTuple

import numpy as np

from mbdlft.base.array import Array
from mbdlft.base.errors import StructureError
from mbdlft.elastic.nodes import DIRECTIONS, Nodes, transport
from mbdlft.elastic.partition import Partition

_CONSISTENT = 1e-6  # error of entries of the mass matrix that is rounding: files have few digits
_ROUNDING = 1e-14  # rounding of a coordinate of the center, of the size of the structure
# rows and columns of the mass matrix where m c_x, m c_y and m c_z are, each with its sign
_CENTER = (((1, 5, 1.0), (2, 4, -1.0)), ((2, 3, 1.0), (0, 5, -1.0)), ((0, 4, 1.0), (1, 3, -1.0)))


class Rigid(NamedTuple):
    """Mass (kg), center of mass (3,) from the origin (m), inertia (3, 3) about the origin (kg m^2).

    Entries of the inertia that a structure without some displacements does not determine are nan.
    """

    mass: float
    center: Array
    inertia: Array


def rigid_properties(nodes: Nodes, at: Partition, bodily: Array) -> Rigid:
    """Rigid properties from `bodily`, R' M R (r, r) for the directions in which the structure can move.

    Raises
    ------
    StructureError
        No rigid body has this mass matrix, or it does not determine mass and center of mass.
    """
    full = np.full((6, 6), np.nan)
    full[np.ix_(at.directions, at.directions)] = bodily
    moved = [d for d in at.directions if d < 3]
    if not moved:
        raise StructureError(
            "the structure has no displacements at its parent, so its mass is not determined. Keep "
            "them in the matrices."
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
            "of the rows, and that no coordinate with mass was left out."
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
            f"{DIRECTIONS[j]}) is {full[i, j]:.6g} and would be {expected[i, j]:.6g}. Check the "
            "order of the rows, the coordinates and the axes of the nodes."
        )
    return rigid


def mass_matrix(rigid: Rigid) -> Array:
    """R' M R (6, 6) about the origin; nan where the inertia is not determined."""
    matrix = rigid.mass * transport(rigid.center)
    matrix[3:, :3] = matrix[:3, 3:].T
    matrix[3:, 3:] = rigid.inertia
    return matrix


def _center(nodes: Nodes, at: Partition, full: Array, axis: int) -> float:
    """Mass times the coordinate `axis` of the center of mass, from the origin (kg m).

    It is an entry of the mass matrix (6, 6) `full`. Where the structure lacks the motions of this entry,
    the nodes tell it if all of them have the same coordinate.
    """
    told = [sign * full[i, j] for i, j, sign in _CENTER[axis] if not np.isnan(full[i, j])]
    if told:
        return float(np.mean(told))
    along = np.asarray(nodes.coordinates)[:, axis] - at.origin[axis]
    if np.ptp(along) > 0.0:
        raise StructureError(
            "the structure has no displacements that tell where its center of mass is along "
            f"{DIRECTIONS[axis]}, and its nodes are at several places. Keep all displacements of "
            "the nodes in the matrices."
        )
    mass = np.nanmean(np.diag(full)[:3])
    return float(mass * along[0])
