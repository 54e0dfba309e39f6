"""A scene with its names looked up: tree, parameters, quantities as SX. Nothing here moves yet.

A planar mechanism in a plane that is not a coordinate plane is described in other axes.

Where all rotations of a tree are about parallel axes, one constant rotation Q of the axes of every body
makes the first of them the common one, and vectors along the links single components. What is
off the plane then is zero in the structure, as in a coordinate plane: v = Q v', J = Q J' Q'.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from mbdlft.base.array import Array
from mbdlft.base.description import AXES, Direction, Values
from mbdlft.base.parameter import Parameter
from mbdlft.multibody.assembly.closure import independent
from mbdlft.multibody.assembly.gyrostat import steady_momenta
from mbdlft.multibody.assembly.kinematics import View
from mbdlft.multibody.assembly.tree import Link, Symbols, all_bodies, links_of
from mbdlft.multibody.body import Ground, PointMass, RigidBody
from mbdlft.multibody.body.rigid import DIAGONAL, PRODUCTS
from mbdlft.multibody.force import Buoyancy, DirectedLoad, Spring
from mbdlft.multibody.joint import Fixed, Prismatic, Revolute, Rotation
from mbdlft.multibody.joint.kinds import AxisJoint
from mbdlft.multibody.scene.checks import check
from mbdlft.multibody.scene.scene import UNKNOWN, Scene
from mbdlft.multibody.spatial import Coordinate, column

_ROUNDING = 16.0 * float(np.finfo(float).eps)
_ENTRIES = tuple(f"inertia.{name}" for name in (*DIAGONAL, *PRODUCTS))
_PLACES = np.array([[0, 3, 4], [3, 1, 5], [4, 5, 2]])  # of the entries in the matrix
_FIRST = [0, 4, 8, 1, 2, 5]  # where the matrix, row by row, has each of them first


@dataclass(frozen=True, slots=True, eq=False)
class Resolved:
    """A checked scene: the user's, or the same in other axes."""

    scene: Scene
    links: tuple[Link, ...]  # from the ground outward
    parameters: tuple[Parameter, ...]  # sorted by name
    symbols: Symbols
    values: Mapping[str, Values]  # by owner and label, in SI units: numbers, SX of the parameters, turns
    axes: Array | None = None  # the rotation Q (3, 3) back to the axes of the user

    def view(self, coordinates: Mapping[str, Coordinate] | None = None) -> View:
        """The tree at coordinates by owner, those of the symbols by default."""
        uniform = self.values[f"scene {self.scene.name!r}"]
        gravity = column(uniform[f"gravity.{a}"] for a in AXES)
        at = self.symbols.coordinates(self.links) if coordinates is None else coordinates
        return View(self.links, all_bodies(self.scene), self.values, at, gravity)

    def back(self, measured: ca.SX) -> ca.SX:
        """Vectors (3 n,) in the axes of the user."""
        if self.axes is None:
            return measured
        vectors = ca.reshape(measured, 3, measured.numel() // 3)
        return ca.vec(ca.mtimes(ca.sparsify(ca.SX(self.axes)), vectors))


def resolve(scene: Scene) -> Resolved:
    """Look up names, units and the tree of a scene, check it, and evaluate its quantities once."""
    links = links_of(scene)
    check(scene)
    parameters = tuple(sorted(scene.parameters, key=lambda parameter: parameter.name))
    symbols = Symbols(scene, parameters, links)
    values = symbols.quantities(scene)
    for owner, momenta in steady_momenta(scene, links, symbols, values).items():
        values[owner] = {**values[owner], **momenta}
    return Resolved(scene, links, parameters, symbols, values)


def in_plane(r: Resolved) -> Resolved:
    """The same scene in axes along its plane, where it has one that is not a coordinate plane."""
    scene, values = r.scene, r.values
    normal = _common_axis(scene)
    if normal is None or not _can_be_turned(scene, values):
        return r
    groups = [
        (owner, labels)
        for owner, quantities in values.items()
        for labels in (*_vector_labels(quantities), _ENTRIES)
        if labels[0] in quantities
    ]
    folded = _folded([[values[owner][label] for label in labels] for owner, labels in groups], r.symbols)
    Q = _axes(normal, [coefficients for coefficients, _ in folded if len(coefficients) == 3])
    # J' = Q'J Q by entries
    conjugate = (np.kron(Q.T, Q.T) @ np.eye(6)[_PLACES.ravel()])[_FIRST]
    turned = {owner: dict(quantities) for owner, quantities in values.items()}
    for (owner, labels), (coefficients, terms) in zip(groups, folded, strict=True):
        turn = Q.T if len(labels) == 3 else conjugate
        sizes = np.abs(turn) @ np.abs(coefficients)
        turned[owner] |= zip(labels, _combined(turn @ coefficients, sizes, terms), strict=True)
    in_axes = _turned_scene(scene, Q)
    return Resolved(in_axes, links_of(in_axes), r.parameters, r.symbols, turned, Q)


def _common_axis(scene: Scene) -> Array | None:
    """The axis of all rotations, if there is one and it is not a coordinate axis."""
    axes: list[Direction] = []
    for joint in scene.joints:
        axes += [rotation.axis for rotation in joint.orientation]
        if isinstance(joint, Revolute) or (isinstance(joint, Fixed) and joint.position != 0.0):
            axes.append(joint.axis)
    units = [np.asarray(axis) / np.linalg.norm(axis) for axis in axes]
    if not units or np.count_nonzero(units[0]) == 1:
        return None
    parallel = all(np.max(np.abs(np.cross(units[0], unit))) <= _ROUNDING for unit in units)
    return units[0] if parallel else None


def _can_be_turned(scene: Scene, values: Mapping[str, Values]) -> bool:
    """Whether nothing in the scene has components of its own in the axes of a body."""
    inertias = [
        quantities for quantities in values.values() if any(label in quantities for label in _ENTRIES)
    ]
    return (
        not scene.loops
        and all(isinstance(body, RigidBody | PointMass | Ground) for body in scene.bodies)
        and all(isinstance(joint, Revolute | Prismatic | Fixed) for joint in scene.joints)
        and all(isinstance(load, DirectedLoad | Buoyancy | Spring) for load in scene.loads)
        and not any(name.startswith("ground.") for name in scene.inputs or ())
        and UNKNOWN not in scene.acceleration
        and all(label in quantities for quantities in inertias for label in _ENTRIES)
    )


def _vector_labels(quantities: Values) -> list[tuple[str, ...]]:
    """Labels of the components of vectors, three each."""
    ends = (label.removesuffix("x") for label in quantities if label.endswith(".x"))
    triples = (tuple(end + axis for axis in AXES) for end in ends)
    return [labels for labels in triples if all(label in quantities for label in labels)]


def _folded(groups: Sequence[Sequence[Any]], symbols: Symbols) -> list[tuple[Array, Sequence[Any]]]:
    """For each group of entries: coefficients (n, r) and terms with entries = coefficients terms.

    The terms are those entries that are independent functions of the parameters.
    """
    every = ca.SX(ca.vertcat(*(entry for entries in groups for entry in entries)))
    numbers = np.stack(symbols.evaluate(every))[:, :, 0].T
    ends = np.cumsum([len(entries) for entries in groups])
    return [
        _independent(group_numbers, entries)
        for group_numbers, entries in zip(np.split(numbers, ends[:-1]), groups, strict=True)
    ]


def _independent(numbers: Array, entries: Sequence[Any]) -> tuple[Array, Sequence[Any]]:
    """Of one group, with its values (n, N)."""
    size = np.max(np.abs(numbers), axis=1)
    some = np.flatnonzero(size)
    scaled = numbers[some] / size[some, None]
    rank, basis = independent(scaled.T, _ROUNDING * np.sqrt(min(scaled.shape)))
    coefficients = np.zeros((len(entries), rank))
    if rank:
        solved = np.linalg.lstsq(scaled[basis].T, scaled.T, rcond=None)[0].T
        coefficients[some] = solved * size[some, None] / size[some[basis]]
    return coefficients, [entries[k] for k in some[basis]]


def _combined(coefficients: Array, sizes: Array, terms: Sequence[Any]) -> list[Any]:
    """Sums of terms; `sizes` are those of the coefficients if nothing cancelled.

    A coefficient that is rounding is zero, and one that is a whole number but for rounding is that.
    """
    whole = np.round(coefficients)
    near = np.abs(coefficients - whole) <= _ROUNDING * sizes
    entries: list[Any] = []
    for row in np.where(near, whole, coefficients):
        used = [
            term if c == 1.0 else float(c) * term for c, term in zip(row, terms, strict=True) if c != 0.0
        ]
        entries.append(sum(used[1:], start=used[0]) if used else 0.0)
    return entries


def _axes(normal: Array, vectors: Sequence[Array]) -> Array:
    """Q (3, 3), its columns the new axes: the normal, and that in the plane along most vectors.

    Vectors are given as coefficients (3, r) of functions of the parameters; those with one count.
    """
    units = [vector[:, 0] / np.linalg.norm(vector) for vector in vectors if vector.shape[1] == 1]
    flat = [unit - normal * (normal @ unit) for unit in units]
    flat = [v / np.linalg.norm(v) for v in flat if np.linalg.norm(v) > _ROUNDING]
    if not flat:
        flat = [np.linalg.svd(normal[None])[2][1]]
    along = np.abs(np.array(flat) @ np.array(flat).T)
    aligned = np.sum((along <= _ROUNDING) | (along >= 1.0 - _ROUNDING), axis=1)
    first = flat[int(np.argmax(aligned))]
    return np.stack([normal, first, np.cross(normal, first)], axis=1)


def _turned_scene(scene: Scene, Q: Array) -> Scene:
    """The scene with the directions in it turned; its quantities stay as they are written."""

    def turned(direction: Direction) -> Direction:
        unit = np.asarray(direction) / np.linalg.norm(direction)
        return tuple(_combined((Q.T @ unit)[:, None], np.ones((3, 1)), [1.0]))

    joints = [
        joint.model_copy(
            update={
                "axis": turned(joint.axis),
                "orientation": tuple(
                    Rotation(axis=turned(rotation.axis), angle=rotation.angle)
                    for rotation in joint.orientation
                ),
            }
        )
        for joint in scene.joints
        if isinstance(joint, AxisJoint)
    ]
    loads = [
        load.model_copy(update={"direction": turned(load.direction)})
        if isinstance(load, DirectedLoad)
        else load
        for load in scene.loads
    ]
    spin = scene.spin and scene.spin.model_copy(update={"axis": turned(scene.spin.axis)})
    return scene.model_copy(update={"joints": tuple(joints), "loads": tuple(loads), "spin": spin})
