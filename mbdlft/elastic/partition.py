"""The coordinates of a structure, sorted into interior, ports and parent; its matrices, checked, in SI.

The nodes of an interface (of a port, or of the parent) move like a rigid body. So the coordinates q (N,)
of the structure are q = T [q_n ; u_1 ; ... ; u_k ; u_r], with the interior coordinates q_n (n,), the
motions u_1 ... u_k of the ports, e numbers in all, and the motion u_r (r,) of the parent. A motion has
three displacements and three rotations in the axes of the coordinates of the nodes; directions in which
the structure cannot move at all (those out of the plane of a plane model) are left out of it.

The rigid properties are those of the rigid-body mass matrix about the origin,

    R' M R = [[m 1, -m [c]x], [m [c]x, J]]

The columns of R are the rigid motions (`mbdlft.elastic.nodes.rigid_motions`), c is the center of mass,
[c]x the matrix of the cross product with c, and J the inertia about the origin.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp

from mbdlft.base.arguments import arguments_checked
from mbdlft.base.array import Array
from mbdlft.base.errors import StructureError, naming
from mbdlft.base.unit import parse_unit
from mbdlft.elastic.nodes import DIRECTIONS, Indices, Interface, Nodes, places, rigid_motions, transport

_SYMMETRY = 1e-8  # asymmetry that is rounding, of the largest entry: files have few digits
# a smaller singular value is none: nodes on a line do not determine the rotation about it
_ROUNDING = 1e-9
_CONSISTENT = 1e-6  # error of entries of the mass matrix that is rounding: files have few digits
_NO_OFFSET = 1e-14  # rounding of a coordinate of the center, of the size of the structure
# rows and columns of the mass matrix where m c_x, m c_y and m c_z are, each with its sign
_CENTER = (((1, 5, 1.0), (2, 4, -1.0)), ((2, 3, 1.0), (0, 5, -1.0)), ((0, 4, 1.0), (1, 3, -1.0)))


class FiniteElements(NamedTuple):
    """Mass and stiffness matrix (N, N), dense or sparse, and the node table of their rows."""

    mass_matrix: Any
    stiffness_matrix: Any
    nodes: Nodes


@arguments_checked
def to_si(elements: FiniteElements, length: str = "mm", mass: str = "t") -> FiniteElements:
    """The same model in m, kg and s, from other units of length and mass with seconds.

    A unit of length is L meters and a unit of mass is m kilograms. With u = S u_SI, where S is 1/L for
    displacements and 1 for rotations, and energies in units of m L^2/s^2,

        M_SI = m L^2 S M S,   K_SI = m L^2 S K S

    Parameters
    ----------
    elements : FiniteElements
    length, mass : units, such as ``mm`` and ``t`` where forces are in N and moduli in MPa
    """
    L, m = _factor("length", length, "m"), _factor("mass", mass, "kg")
    nodes = elements.nodes
    component = np.asarray(nodes.dof)[:, 1]
    # a coordinate that belongs to no node (component 0) may have any scale
    scale = sp.diags_array(np.where(component <= 3, 1.0 / L, 1.0))
    M, K = (
        m * L**2 * (scale @ _real(what, matrix, len(component)) @ scale)
        for what, matrix in zip(("mass", "stiffness"), elements[:2], strict=True)
    )
    return FiniteElements(M, K, replace(nodes, coordinates=L * np.asarray(nodes.coordinates)))


def _real(what: str, matrix: Any, rows: int) -> Any:
    """The matrix as a csr_array (rows, rows) of finite numbers."""
    try:
        if np.iscomplexobj(matrix):  # numpy would drop the imaginary parts
            raise TypeError("it is complex")
        full = sp.csr_array(matrix, dtype=float)
    except (TypeError, ValueError) as error:
        raise StructureError(f"{what} matrix: expected a matrix of real numbers: {error}.") from None
    if full.ndim != 2 or full.shape != (rows, rows):
        raise StructureError(
            f"{what} matrix: expected {rows} x {rows}, one row for each dof of the node table, got "
            f"{' x '.join(map(str, full.shape))}. Give `dof` in the order of the rows."
        )
    if not np.all(np.isfinite(full.data)):
        raise StructureError(f"{what} matrix: expected finite entries, got nan or inf.")
    return full


def checked(what: str, matrix: Any, rows: int) -> Any:
    """The matrix as a symmetric csr_array (rows, rows): the mean of it and its transpose."""
    full = _real(what, matrix, rows)
    difference = abs(full - full.T)
    largest = abs(full).max() if full.nnz else 0.0
    if difference.nnz and difference.max() > _SYMMETRY * largest:
        entries = difference.tocoo()
        worst = int(np.argmax(entries.data))
        i, j = int(entries.row[worst]), int(entries.col[worst])
        raise StructureError(
            f"{what} matrix: not symmetric: entry ({i + 1}, {j + 1}) is {full[i, j]:g} and "
            f"({j + 1}, {i + 1}) is {full[j, i]:g}. A file may have one triangle only: add the "
            "transpose of what is off the diagonal."
        )
    return sp.csr_array(0.5 * (full + full.T))


def _factor(what: str, unit: str, si: str) -> float:
    """The unit over the SI unit `si` of the same dimension."""
    parsed = parse_unit(unit)
    if parsed.dimension != parse_unit(si).dimension:
        raise StructureError(f"to_si: {what}: expected a unit of {what} such as {si!r}, got {unit!r}.")
    return parsed.factor


@dataclass(frozen=True, slots=True, eq=False)
class Partition:
    """The matrix T, and where interior, ports and parent are in it."""

    expand: Any  # T, sparse (N, n + e + r)
    interior: int  # number n of interior coordinates
    ports: Mapping[str, slice]  # of the n + e + r coordinates, the motion of each port
    directions: tuple[int, ...]  # which of 0 to 5 the motions of the parent and of each port have, r
    positions: Mapping[str, Array]  # (3,) of each port from the origin (m)
    rigid: Array  # (n + e + r, r) the coordinates in the rigid motions about the origin
    origin: Array  # (3,) the point of the parent in the coordinates of the nodes (m)
    rows: Indices  # (n,) the row of the matrices that each interior coordinate has

    @property
    def free(self) -> int:
        """Number of coordinates that move when the parent is held."""
        return int(self.rigid.shape[0]) - len(self.directions)


def partitioned(nodes: Nodes, parent: Any, ports: Mapping[str, Any]) -> Partition:
    """Partition of the coordinates; `parent` and `ports` as in `modal_model`."""
    held = _interface("parent", parent)
    at = {name: _interface(f"port {name!r}", place) for name, place in ports.items()}
    dof = np.asarray(nodes.dof)
    owner: dict[int, str] = {}
    for what, interface in (("parent", held), *((f"port {name!r}", at[name]) for name in at)):
        for number in interface.nodes:
            if number in owner:
                raise StructureError(f"node {number} belongs to {owner[number]} and to {what}.")
            owner[number] = what
    origin, parent_rows, directions, motion = _moved("parent", nodes, held)
    positions, where = {}, {}
    blocks: list[tuple[Indices, Array]] = []  # rows of the nodes of each interface, and their motion
    rows = np.flatnonzero(~np.isin(dof[:, 0], list(owner)) | (dof[:, 1] == 0))
    k = len(rows)
    rigid = [rigid_motions(nodes, origin)[rows][:, directions]]
    for name, interface in at.items():
        point, its_rows, its_directions, its_motion = _moved(f"port {name!r}", nodes, interface)
        missing = [DIRECTIONS[d] for d in directions if d not in its_directions]
        if missing:
            raise StructureError(
                f"port {name!r}: its nodes have no {' and no '.join(missing)}, so modes have no "
                "shape there. Give several nodes that are not on a line (they are made rigid), or "
                "a node with rotations."
            )
        extra = [DIRECTIONS[d] for d in its_directions if d not in directions]
        if extra:
            raise StructureError(
                f"parent: it does not hold {', '.join(extra)}, in which the port {name!r} can "
                "move. Give several nodes that are not on a line (they are made rigid), or a node "
                "with rotations."
            )
        positions[name] = point - origin
        where[name] = slice(k, k := k + len(its_directions))
        blocks.append((its_rows, its_motion))
        rigid.append(transport(point - origin)[np.ix_(its_directions, directions)])
    rigid.append(np.eye(len(directions)))
    selection = sp.csr_array((np.ones(len(rows)), (rows, range(len(rows)))), (len(dof), len(rows)))
    columns = [selection]
    for its_rows, block in (*blocks, (parent_rows, motion)):
        placed = np.zeros((len(dof), block.shape[1]))
        placed[its_rows] = block
        columns.append(sp.csr_array(placed))
    T = sp.csr_array(sp.hstack(columns))
    return Partition(T, len(rows), where, tuple(directions), positions, np.vstack(rigid), origin, rows)


def _interface(what: str, place: Any) -> Interface:
    """An interface from a node number, several, or an `Interface`; each node is in it once."""
    if isinstance(place, Interface):
        interface = place
    elif isinstance(place, int | np.integer) and not isinstance(place, bool):
        interface = Interface((int(place),))
    else:
        interface = Interface(place)
    try:
        numbers = tuple(int(n) for n in interface.nodes if int(n) == n)
    except (TypeError, ValueError):
        numbers = ()
    if not numbers or len(numbers) < len(tuple(interface.nodes)):
        raise StructureError(
            f"{what}: expected the number of a node, several numbers, or an Interface, got {place!r}."
        )
    return Interface(tuple(dict.fromkeys(numbers)), interface.point)


def _moved(what: str, nodes: Nodes, interface: Interface) -> tuple[Array, Indices, list[int], Array]:
    """Point of an interface, the rows of its nodes, its directions, and the motion of the rows (., d)."""
    with naming(what, StructureError):
        at = places(nodes, interface.nodes)
    coordinates = np.asarray(nodes.coordinates)[at]
    point = np.mean(coordinates, axis=0) if interface.point is None else np.array(interface.point)
    if point.shape != (3,) or not np.all(np.isfinite(point)):
        raise StructureError(f"{what}: point: expected three coordinates (m), got {interface.point!r}.")
    dof = np.asarray(nodes.dof)
    rows = np.flatnonzero(np.isin(dof[:, 0], interface.nodes) & (dof[:, 1] > 0))
    if not len(rows):
        raise StructureError(
            f"{what}: node {interface.nodes[0]} has no coordinate in the matrices. It may have "
            "been constrained or condensed away: keep it when the matrices are written."
        )
    motion = rigid_motions(nodes, point)[rows]
    size = max(float(np.max(np.linalg.norm(coordinates - point, axis=1))), 0.0)
    scale = np.array([1.0] * 3 + [size if size > 0.0 else 1.0] * 3)
    extent = np.max(np.abs(motion), axis=0) / scale
    directions = [d for d in range(6) if extent[d] > _ROUNDING]
    values = np.linalg.svd(motion[:, directions] / scale[directions], compute_uv=False)
    if len(values) < len(directions) or values[-1] < _ROUNDING * values[0]:
        raise StructureError(
            f"{what}: its nodes do not determine all of the motions "
            f"{', '.join(DIRECTIONS[d] for d in directions)}: they are on a line, or at one point. "
            "Give more nodes, or a node with rotations."
        )
    return point, rows, directions, motion[:, directions]


# rigid properties ------------------------------------------------------------------------------


class Rigid(NamedTuple):
    """Mass (kg), center of mass (3,) from the origin (m), inertia (3, 3) about the origin (kg m^2).

    Entries of the inertia that a structure without some displacements does not determine are nan.
    """

    mass: float
    center: Array
    inertia: Array


def rigid_properties(nodes: Nodes, at: Partition, bodily: Array) -> Rigid:
    """Rigid properties from `bodily`, R' M R (r, r) for the directions that the structure can move in."""
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
        raise StructureError(f"mass matrix: the mass of the structure is {mass:g} kg; expected more.")
    if np.max(np.abs(masses - mass)) > _CONSISTENT * mass:
        listed = ", ".join(f"{DIRECTIONS[d]}: {full[d, d]:.9g} kg" for d in moved)
        raise StructureError(
            f"mass matrix: the mass is not the same in all directions ({listed}). Check the order "
            "of the rows, and that no coordinate with mass was left out."
        )
    center = np.array([_center(nodes, at, full, k) for k in range(3)]) / mass
    size = float(np.max(np.abs(np.asarray(nodes.coordinates) - at.origin)))
    center[np.abs(center) < _NO_OFFSET * size] = 0.0
    inertia = full[3:, 3:]
    inertia[np.abs(inertia) < _NO_OFFSET * mass * size**2] = 0.0
    rigid = Rigid(mass, center, inertia)
    expected = mass_matrix(rigid)
    length = max(float(np.linalg.norm(center)), np.sqrt(np.nanmax(np.diag(full)[3:], initial=0.0) / mass))
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
    moments = [sign * full[i, j] for i, j, sign in _CENTER[axis] if not np.isnan(full[i, j])]
    if moments:
        return float(np.mean(moments))
    along = np.asarray(nodes.coordinates)[:, axis] - at.origin[axis]
    if np.ptp(along) > 0.0:
        raise StructureError(
            "the structure has no displacements that tell where its center of mass is along "
            f"{DIRECTIONS[axis]}, and its nodes are at several places. Keep all displacements of "
            "the nodes in the matrices."
        )
    mass = np.nanmean(np.diag(full)[:3])
    return float(mass * along[0])
