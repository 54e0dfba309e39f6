"""The coordinates of a structure, sorted into interior, ports and parent; its matrices, checked, in SI.

The nodes of an interface (of a port, or of the parent) move like a rigid body. So the coordinates q (N,)
of the structure are q = T [q_n ; u_1 ; ... ; u_k ; u_r], with the interior coordinates q_n (n,), the
motions u_1 ... u_k of the ports, e numbers in all, and the motion u_r (r,) of the parent. A motion has
three displacements and three rotations in the axes of the coordinates of the nodes; directions in which
the structure cannot move at all (those out of the plane of a plane model) are left out of it.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp

from mbdlft.base.array import Array
from mbdlft.base.errors import StructureError
from mbdlft.base.unit import parse_unit
from mbdlft.elastic.nodes import DIRECTIONS, Indices, Interface, Nodes, places, rigid_motions, transport

_SYMMETRY = 1e-8  # asymmetry that is rounding, of the largest entry: files have few digits
# a smaller singular value is none: nodes on a line do not determine the rotation about it
_ROUNDING = 1e-9


class FiniteElements(NamedTuple):
    """Mass and stiffness matrix (N, N), dense or sparse, and the node table of their rows."""

    mass_matrix: Any
    stiffness_matrix: Any
    nodes: Nodes


def to_si(elements: FiniteElements, length: str = "mm", mass: str = "t") -> FiniteElements:
    """The same model in m, kg and s, from other units of length and mass with seconds.

    A unit of length is L meters and a unit of mass is m kilograms. With u = S u_SI, where S is 1/L for
    displacements and 1 for rotations, and energies in units of m L^2/s^2,

        M_SI = m L^2 S M S,   K_SI = m L^2 S K S

    Parameters
    ----------
    elements : FiniteElements
    length, mass : units, such as ``mm`` and ``t`` where forces are in N and moduli in MPa

    Raises
    ------
    StructureError
        `length` is not a unit of length, or `mass` is not one of mass.
    """
    L, m = _factor("length", length, "m"), _factor("mass", mass, "kg")
    nodes = elements.nodes
    component = np.asarray(nodes.dof)[:, 1]
    # a coordinate that belongs to no node (component 0) may have any scale
    scale = sp.diags_array(np.where(component <= 3, 1.0 / L, 1.0))
    matrices = [m * L**2 * (scale @ sp.csr_array(matrix) @ scale) for matrix in elements[:2]]
    coordinates = L * np.asarray(nodes.coordinates)
    mass_matrix, stiffness_matrix = matrices
    table = Nodes(nodes.numbers, coordinates, nodes.dof, nodes.axes)
    return FiniteElements(mass_matrix, stiffness_matrix, table)


def checked(what: str, matrix: Any, rows: int) -> Any:
    """The matrix as a symmetric csr_array (rows, rows): the mean of it and its transpose."""
    try:
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
    """The matrix T, and where interior, ports and parent are in it.

    Attributes
    ----------
    expand : T, sparse (N, n + e + r)
    interior : number n of interior coordinates
    ports : the slice of the n + e + r coordinates that is the motion of each port
    directions : which of the directions 0 to 5 the motions of the parent and of each port have, r of them
    positions : (3,) for each port, its position from the origin (m)
    rigid : (n + e + r, r), the coordinates in the rigid motions about the origin
    origin : (3,), the point of the parent in the coordinates of the nodes (m)
    rows : (n,), the row of the matrices that each interior coordinate has
    """

    expand: Any
    interior: int
    ports: Mapping[str, slice]
    directions: tuple[int, ...]
    positions: Mapping[str, Array]
    rigid: Array
    origin: Array
    rows: Indices

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
    return Partition(
        expand=sp.csr_array(sp.hstack(columns)),
        interior=len(rows),
        ports=where,
        directions=tuple(directions),
        positions=positions,
        rigid=np.vstack(rigid),
        origin=origin,
        rows=rows,
    )


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
    try:
        at = places(nodes, interface.nodes)
    except StructureError as error:
        raise StructureError(f"{what}: {error}") from None
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
