"""Node tables: which node, direction and axes each row of a finite-element matrix belongs to.

Components are numbered as usual in the field: 1, 2, 3 are displacements (m) along x, y, z, 4, 5, 6
rotations (rad) about them. Component 0 is a coordinate that belongs to no node and is zero in every rigid
motion, such as a modal coordinate of a superelement.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mbdlft.base.array import Array, ArrayLike
from mbdlft.base.errors import StructureError

Indices = NDArray[np.int64]

COMPONENTS = (1, 2, 3, 4, 5, 6)
DIRECTIONS = ("x", "y", "z", "rx", "ry", "rz")
_ROUNDING = 1e-9  # how far axes may be from orthonormal: they may be given with few digits


@dataclass(frozen=True, slots=True, eq=False)
class Nodes:
    """The node table of a finite-element model.

    Parameters
    ----------
    numbers : int (n,)
    coordinates : float (n, 3)
        Positions (m).
    dof : int (N, 2), optional
        Number of the node and component of each row of the matrices, in their order; by default all
        six components of every node.
    axes : float (n, 3, 3), optional
        Columns are the axes of the displacements of each node; by default those of the
        coordinates.
    """

    numbers: ArrayLike
    coordinates: ArrayLike
    dof: ArrayLike | None = None
    axes: ArrayLike | None = None

    def __post_init__(self) -> None:
        numbers = _integers("numbers", self.numbers, 1)
        n = len(numbers)
        coordinates = finite("node table: coordinates", self.coordinates, (n, 3))
        if not n:
            raise StructureError("node table: expected at least one node, got none.")
        unique, counts = np.unique(numbers, return_counts=True)
        if np.any(counts > 1):
            raise StructureError(f"node table: node {unique[counts > 1][0]} is given twice.")
        dof = _integers("dof", every_dof(numbers) if self.dof is None else self.dof, 2)
        axes = np.broadcast_to(np.eye(3), (n, 3, 3)) if self.axes is None else self.axes
        axes = finite("node table: axes", axes, (n, 3, 3))
        _check_dof(dof, numbers)
        turned = np.swapaxes(axes, 1, 2) @ axes
        wrong = np.max(np.abs(turned - np.eye(3)), axis=(1, 2)) > _ROUNDING
        wrong |= np.linalg.det(axes) < 0.0
        if np.any(wrong):
            raise StructureError(
                f"node table: the axes of node {numbers[wrong][0]} are not right-handed and "
                "orthonormal. Columns are unit vectors in the axes of the coordinates."
            )
        table = {"numbers": numbers, "coordinates": coordinates, "dof": dof, "axes": axes}
        for name, value in table.items():
            value.setflags(write=False)
            object.__setattr__(self, name, value)

    def __len__(self) -> int:
        return len(np.asarray(self.numbers))


@dataclass(frozen=True, slots=True)
class Interface:
    """Several nodes made rigid, and the point (m) that moves with them: the origin or a port of the body.

    By default the point is the mean of the coordinates of the nodes.
    """

    nodes: Sequence[int]
    point: tuple[float, float, float] | None = None


def every_dof(numbers: ArrayLike, components: Sequence[int] = COMPONENTS) -> Indices:
    """Rows (N, 2) of a table `dof` with the same components at every node, node by node.

    Parameters
    ----------
    numbers : int (n,)
    components : components of each node, some of 1 to 6, in the order of the rows
    """
    table = [[number, c] for number in np.asarray(numbers).tolist() for c in components]
    return np.array(table, dtype=np.int64).reshape(-1, 2)


def rigid_motions(nodes: Nodes, origin: ArrayLike) -> Array:
    """R (N, 6): values of all coordinates in six rigid motions about `origin` (3,).

    The columns are unit displacements t of the body and unit rotations theta about `origin`. A node at r
    moves by u = t + theta x (r - origin), here in the axes of the node. Equation (4.26) of the source in
    `tests/reference/flexible.py` has the same matrix.
    """
    dof = np.asarray(nodes.dof)
    place = places(nodes, dof[:, 0], 0)
    axes = np.asarray(nodes.axes)[place]
    move = transport(np.asarray(nodes.coordinates)[place] - np.asarray(origin, dtype=float))
    back = np.swapaxes(axes, 1, 2)
    turned = np.concatenate([back @ move[:, :3], back @ move[:, 3:]], axis=1)
    motions = turned[np.arange(len(dof)), np.maximum(dof[:, 1] - 1, 0)]
    motions[dof[:, 1] == 0] = 0.0
    return np.asarray(motions)


def transport(r: ArrayLike) -> Array:
    """(..., 6, 6): maps a small motion of a rigid body's origin to that of its point at r (..., 3)."""
    x, y, z = np.moveaxis(np.asarray(r, dtype=float), -1, 0)
    matrix = np.zeros((*x.shape, 6, 6))
    matrix[..., range(6), range(6)] = 1.0
    matrix[..., 0, 4], matrix[..., 0, 5] = z, -y
    matrix[..., 1, 3], matrix[..., 1, 5] = -z, x
    matrix[..., 2, 3], matrix[..., 2, 4] = y, -x
    return matrix


def places(nodes: Nodes, numbers: ArrayLike, missing: int | None = None) -> Indices:
    """Position of each number in the node table; of an unknown one `missing`, or a `StructureError`."""
    known = {int(number): k for k, number in enumerate(np.asarray(nodes.numbers))}
    try:
        positions = [
            known[int(n)] if missing is None else known.get(int(n), missing)
            for n in np.asarray(numbers).ravel()
        ]
    except KeyError as error:
        raise StructureError(node_not_found(int(error.args[0]), known)) from None
    return np.array(positions, dtype=np.int64)


def node_not_found(number: int, known: dict[int, int]) -> str:
    """Sentence for a node that is not in the table, with the range of the numbers in the table."""
    nearest = sorted(known, key=lambda n: (abs(n - number), n))[:5]
    return (
        f"node {number} is not in the node table, which has {len(known)} nodes from {min(known)} to "
        f"{max(known)}. Nearest numbers: {', '.join(map(str, sorted(nearest)))}."
    )


def _check_dof(dof: Indices, numbers: Indices) -> None:
    """Raise a StructureError unless the rows of `dof` (N, 2) are different components of these nodes."""
    if dof.shape[1:] != (2,):
        raise StructureError(
            "node table: dof: expected a row of two (node, component) for each row of the "
            f"matrices, got the shape {dof.shape}."
        )
    if len(dof) and (np.min(dof[:, 1]) < 0 or np.max(dof[:, 1]) > 6):
        wrong = dof[(dof[:, 1] < 0) | (dof[:, 1] > 6)][0]
        raise StructureError(
            f"node table: dof: component {wrong[1]} of node {wrong[0]}; expected 1, 2, 3 "
            "(displacements), 4, 5, 6 (rotations), or 0 for a coordinate of no node."
        )
    at_nodes = dof[dof[:, 1] > 0]
    unknown = np.setdiff1d(at_nodes[:, 0], numbers)
    if len(unknown):
        known = {int(n): k for k, n in enumerate(numbers)}
        raise StructureError("node table: dof: " + node_not_found(int(unknown[0]), known))
    rows, counts = np.unique(at_nodes, axis=0, return_counts=True)
    if np.any(counts > 1):
        node, component = rows[counts > 1][0]
        raise StructureError(f"node table: dof: component {component} of node {node} is there twice.")


def _integers(what: str, values: ArrayLike, dimensions: int) -> Indices:
    """A copy of an array of whole numbers with this number of dimensions."""
    array = np.asarray(values)
    if array.ndim != dimensions or not (np.issubdtype(array.dtype, np.integer) or not array.size):
        raise StructureError(
            f"node table: {what}: expected whole numbers in {dimensions} dimension"
            f"{'s' if dimensions > 1 else ''}, got {array.dtype} of shape {array.shape}."
        )
    if array.size and np.max(array) > np.iinfo(np.int64).max:  # it would become negative
        raise StructureError(f"node table: {what}: {np.max(array)} is too large.")
    return np.array(array, dtype=np.int64)


def finite(what: str, values: ArrayLike, shape: tuple[int, ...]) -> Array:
    """A copy of an array of finite numbers of this shape."""
    try:
        array = np.array(values, dtype=float)
    except (TypeError, ValueError):
        raise StructureError(f"{what}: expected numbers of shape {shape}.") from None
    if array.shape != shape:
        raise StructureError(f"{what}: expected the shape {shape}, got {array.shape}.")
    if not np.all(np.isfinite(array)):
        raise StructureError(f"{what}: expected finite numbers, got nan or inf.")
    return array
