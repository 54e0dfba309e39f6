"""A scene with its names looked up: tree, parameters, quantities as SX; its inputs and outputs.

Inputs u are efforts of joints, magnitudes of loads, voltages, forces of couplings, and multipliers;
outputs are what joints, sensors and bodies measure, and forces of couplings and contacts.

A planar mechanism in a plane that is not a coordinate plane is described in other axes.

Where all rotations of a tree are about parallel axes, one constant rotation Q of the axes of every body
makes the first of them the common one, and vectors along the links single components. What is
off the plane then is zero in the structure, as in a coordinate plane: v = Q v', J = Q J' Q'.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from mbdlft.base.array import Array
from mbdlft.base.description import AXES, Direction, Values
from mbdlft.base.errors import NotRationalError, SceneError
from mbdlft.base.parameter import Parameter
from mbdlft.base.unit import Signal
from mbdlft.multibody.assembly.closure import Closure, independent, multipliers, reactions
from mbdlft.multibody.assembly.coupled import Coupled, coupled, following, multipliers_of
from mbdlft.multibody.assembly.gyrostat import steady_momenta
from mbdlft.multibody.assembly.kinematics import View
from mbdlft.multibody.assembly.touching import contact_reactions
from mbdlft.multibody.assembly.tree import Link, Symbols, all_bodies, coordinate_owners, degrees, links_of
from mbdlft.multibody.body import Body, ElasticBody, Ground, PointMass, RigidBody
from mbdlft.multibody.body.rigid import DIAGONAL, PRODUCTS
from mbdlft.multibody.force import BodyWrench, Buoyancy, DirectedLoad, Spring, Tire
from mbdlft.multibody.joint import Fixed, Prismatic, Revolute, Rotation
from mbdlft.multibody.joint.kinds import AxisJoint
from mbdlft.multibody.scene.checks import check
from mbdlft.multibody.scene.quantities import owner_name
from mbdlft.multibody.scene.scene import UNKNOWN, Scene
from mbdlft.multibody.spatial import Coordinate, column
from mbdlft.problem.equations import Moved, rows_of
from mbdlft.problem.sx.constants import is_constant, literal, numbers_of, unit_vector

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
        return View(*self.seen(coordinates))

    def seen(self, coordinates: Mapping[str, Coordinate] | None = None) -> tuple[Any, ...]:
        """What a view is made of."""
        uniform = self.values[f"scene {self.scene.name!r}"]
        gravity, velocity = (
            column(uniform[f"{key}.{a}"] for a in AXES) for key in ("gravity", "velocity")
        )
        at = self.symbols.coordinates(self.links) if coordinates is None else coordinates
        return self.links, all_bodies(self.scene), self.values, at, gravity, velocity

    def back(self, measured: ca.SX) -> ca.SX:
        """Vectors (3 n,) in the axes of the user."""
        if self.axes is None:
            return measured
        vectors = ca.reshape(measured, 3, measured.numel() // 3)
        return ca.vec(ca.mtimes(ca.sparsify(ca.SX(self.axes)), vectors))


def resolve(scene: Scene) -> Resolved:
    """Look up names, units and the tree of a scene, check it, and evaluate its quantities once."""
    with following(scene) as placed:
        return _resolved(placed)


def _resolved(scene: Scene) -> Resolved:
    links = links_of(scene)
    check(scene)
    parameters = tuple(sorted(scene.parameters, key=lambda parameter: parameter.name))
    symbols = Symbols(scene, parameters, links)
    values = symbols.quantities(scene)
    if any("rate" in values[link.owner] for link in links):
        for owner, momenta in steady_momenta(scene, links, symbols, values).items():
            values[owner] = {**values[owner], **momenta}
    for tire in (load for load in scene.loads if isinstance(load, Tire)):
        named = owner_name(tire)
        values[named] = {**values[named], **tire.carcass(values[named])}
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
        not (scene.loops or scene.touches)
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


_APART = 1e-9  # of the reach of its ports: a spring that is shorter has no direction
GROUND_ACCELERATION = tuple(f"ground.acceleration.{axis}" for axis in AXES)


class Effort(NamedTuple):
    """One entry of u: its name, its trim value (None: unknown), whether it can be an input."""

    signal: Signal
    value: ca.SX | float | None
    is_input: bool = True
    is_default: bool = True


def list_efforts(r: Resolved, densities: Mapping[str, Any], closure: Closure) -> list[Effort]:
    """Entries of u: of joints, loads, the ground if it is asked for, static deflections, multipliers.

    `densities` are by name of the spring (None: unknown). Where deformations determine the multipliers,
    static deflections are unknown: those of elastic bodies in place of the forces that hold them, those
    of passive joints beside their efforts.
    """
    scene, values = r.scene, r.values
    efforts, deflections = list[Effort](), list[Effort]()
    for degree in degrees(r.links):
        moved = degree.kind == "motion"  # its three inputs are told apart by what they do
        imposed = degree.kind in ("imposed", "motion")
        value = 0.0 if imposed else values.get(degree.owner, {}).get(degree.label("preload"))
        # the force that holds a static deflection is internal
        is_input = degree.kind not in ("elastic", "patch")
        named = degree.measure(2) if imposed else degree.effort
        if len(efforts) in closure.yielding:
            measure = degree.measure(0)
            static = Signal(f"{measure.name}.static", measure.unit)
            if is_input:
                deflections.append(Effort(static, None, is_input=False, is_default=False))
            else:
                named = static
        efforts.append(Effort(named, value, is_input=is_input, is_default=is_input and not moved))
    for load in scene.loads:
        value = densities.get(load.name, values[owner_name(load)].get(load.magnitude_key))
        efforts.append(Effort(load.signal.of(load.name), value))
    efforts += [Effort(signal, 0.0) for link in r.links for signal in body_inputs(link.child)]
    asked = set(scene.inputs or ())
    for name, entry in zip(GROUND_ACCELERATION, scene.acceleration, strict=True):
        if entry == UNKNOWN or name in asked:
            value = None if entry == UNKNOWN else 0.0
            efforts.append(Effort(Signal(name, "m/s^2"), value, is_default=False))
    moving = [degree for degree in degrees(r.links) if degree.kind == "motion"]
    measures = [degree.measure(order) for degree in moving for order in range(2)]
    efforts += [Effort(measure, 0.0, is_default=False) for measure in measures]
    for coupling in scene.couplings:
        if coupling.stiffness is not None:
            value = values[owner_name(coupling)].get("preload")
            signal = coupling.signal(scene.joints)
            efforts.append(Effort(signal, value, is_input=False, is_default=False))
    of_rows = [signal for some in multipliers_of(scene) for signal in some] if closure.rows else []
    forces = [Effort(of_rows[k], None, is_input=False, is_default=False) for k in closure.rows]
    return efforts + deflections + forces


def moved_coordinates(links: tuple[Link, ...], inputs: Sequence[str]) -> tuple[Moved, ...]:
    """Coordinates of joints with ``imposed = "motion"``; `inputs` are the names of the entries of u."""
    moved: list[Moved] = []
    for k, degree in enumerate(degrees(links)):
        if degree.kind == "motion":
            first, second, third = (inputs.index(degree.measure(k).name) for k in range(3))
            moved.append(Moved(k, (first, second, third)))
    return tuple(moved)


def static_deflections(r: Resolved, closure: Closure, u: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Efforts (n,) of all coordinates by u, and their static deflections (n,).

    Only a statically indeterminate scene has deflections; the effort of an elastic coordinate is then
    that of its deflection, -K q, else it is the entry of u itself.
    """
    efforts: list[ca.SX] = []
    k, moved = 0, ca.SX(len(degrees(r.links)), 1)
    last, joints = u.numel() - len(closure.rows), [*closure.yielding]
    bodies = {link.child.name: link.child for link in r.links}
    for owned in coordinate_owners(r.links):
        rows = slice(k, k := k + len(owned.freedoms))
        of_owner = rows_of(u, range(rows.start, rows.stop))
        body = bodies.get(owned.name)
        if owned.kind == "elastic" and closure.yielding and isinstance(body, ElasticBody):
            moved[rows] = of_owner
            joints = [j for j in joints if not rows.start <= j < rows.stop]
            of_owner = -body.restoring(r.values.get(owned.owner, {}), of_owner)
        efforts.append(of_owner)
    for position, j in enumerate(joints):
        moved[j] = u[last - len(joints) + position]
    return ca.vertcat(*efforts), moved


def check_springs(scene: Scene, view: View, evaluate: Callable[[ca.SX], Sequence[Array]]) -> None:
    """The ports of springs are apart at nominal and at other points of the range."""
    for load in scene.loads:
        if not isinstance(load, Spring):
            continue
        view.owned(load)
        gaps, reach = view.gaps(load.parent, load.child, evaluate)
        apart = [float(np.linalg.norm(gap)) for gap in gaps]
        if min(apart) <= _APART * reach:
            raise SceneError(
                f"{view.owner}: its ports are at one point, so it has no direction. Move one of the "
                f"ports {load.parent!r} and {load.child!r}, or the equilibrium."
            )


def force_density(spring: Spring, view: View) -> Any:
    """Tension over length of a spring at equilibrium; None if it is not given."""
    values = view.owned(spring)
    if spring.rest_length is None:
        return values.get(spring.magnitude_key)
    r = view.between_at_rest(spring.parent, spring.child)
    length2 = ca.dot(r, r)
    if not is_constant(length2):
        raise NotRationalError(
            f"{view.owner}: the distance of its ports depends on parameters, and its tension "
            "stiffness*(length - rest_length) has the square root of a polynomial. Give the tension over "
            "the length as force_density (N/m), or leave both out and let the trim solve for it."
        )
    length = literal(float(np.sqrt(numbers_of(length2)[0, 0])))
    return values["stiffness"] * (1.0 - values["rest_length"] / length)


def ground_motion(
    scene: Scene, uniform: Values, load: ca.SX, listed: Sequence[Effort], u: ca.SX
) -> tuple[ca.SX, ca.SX]:
    """Motion (3, 3) of the origin of the ground, by the spin of the frame and its acceleration; and the
    acceleration (3,) that makes the weights: `load`, and what the trim solves for."""
    names = [effort.signal.name for effort in listed]
    spin = unit_vector(scene.spin.axis) * uniform["spin.rate"] if scene.spin else ca.SX(3, 1)
    asked = {name: u[names.index(name)] for name in GROUND_ACCELERATION if name in names}
    field = load
    for axis, entry in enumerate(scene.acceleration):
        if entry == UNKNOWN:
            field = field + ca.SX.eye(3)[:, axis] * asked[GROUND_ACCELERATION[axis]]
    if asked:
        load = load + ca.vertcat(*(asked.get(name, 0.0) for name in GROUND_ACCELERATION))
    return ca.horzcat(spin, ca.SX(3, 1), load), field


def acting(r: Resolved, view: View, closure: Closure, u: ca.SX, z: ca.SX) -> list[BodyWrench]:
    """Wrenches on bodies of all loads and loop closures."""
    loads = enumerate(r.scene.loads, start=len(degrees(r.links)))
    wrenches = [wrench for k, load in loads for wrench in view.wrenches(load, u[k])]
    every = multipliers(closure, u) + multipliers(closure, z)
    wrenches += reactions(r.scene.loops, view, every)
    if touches := r.scene.touches:
        held = len(multipliers_of(r.scene)[0])
        first = held - sum(len(contact.signals()[0]) for contact in touches)
        wrenches += contact_reactions(touches, view, every[first:held], every[held:])
    return wrenches


def couplings(
    r: Resolved, view: View, closure: Closure, u: ca.SX, z: ca.SX, names: Sequence[str]
) -> Coupled:
    """What couplings do; `names` are those of the entries of u."""
    scene, soft = r.scene, [c for c in r.scene.couplings if c.stiffness is not None]
    preloads = [u[names.index(c.signal(scene.joints).name)] for c in soft]
    first = sum(len(loop.signals()) for loop in scene.loops)
    at_rest, change = (multipliers(closure, entries)[first:] for entries in (u, z))
    shared = [k - first for k in closure.shared]
    return coupled(scene, view, at_rest + change, change, preloads, shared)


Forces = tuple[ca.SX, tuple[Signal, ...]]


def more_forces(r: Resolved, view: View, closure: Closure, u: ca.SX, z: ca.SX) -> tuple[Forces, Forces]:
    """Deviations of the forces of contacts, but for those that are shared; forces of loads, if asked."""
    held, others = multipliers_of(r.scene) if closure.count else ([], [])
    every, values = held + others, multipliers(closure, z)
    of_contacts = range(len(held) - sum(len(c.signals()[0]) for c in r.scene.touches), len(every))
    known = [k for k in of_contacts if k not in closure.shared]
    forces, signals, asked = [ca.SX(0, 1)], list[Signal](), set(r.scene.outputs or ())
    for k, load in enumerate(r.scene.loads, start=len(degrees(r.links))):
        named = [signal.of(load.name) for signal in load.outputs()]
        if {signal.name for signal in named} & asked:
            forces.append(load.measure(view.owned(load), u[k], view))
            signals += named
    on_ground = rows_of(values, known), tuple(every[k] for k in known)
    return on_ground, (ca.vertcat(*forces), tuple(signals))


class BodyChannels(NamedTuple):
    """Generalized forces (n,) of all coordinates by the inputs of bodies; what bodies measure."""

    forces: ca.SX
    outputs: ca.SX
    signals: tuple[Signal, ...]


def body_inputs(body: Body) -> list[Signal]:
    """Inputs of a body, with its name."""
    return [signal.of(body.name) for signal in body.inputs()]


def body_channels(r: Resolved, view: View, u: ca.SX, names: Sequence[str]) -> BodyChannels:
    """Forces and outputs of the bodies of a tree; `names` are those of the entries of u."""
    forces: list[ca.SX] = [ca.SX(0, 1)]
    outputs: list[ca.SX] = [ca.SX(0, 1)]
    signals: list[Signal] = []
    for link in r.links:
        body, quantities = link.child, view.now.of(link.child)
        forces.append(ca.SX(len(link.joint.freedoms), 1))
        voltages = ca.vertcat(ca.SX(0, 1), *(u[names.index(s.name)] for s in body_inputs(body)))
        forces.append(body.driven(quantities, voltages))
        outputs.append(body.measure(quantities, voltages, view.coordinates[link.child_owner]))
        signals += [signal.of(body.name) for signal in body.outputs()]
    return BodyChannels(ca.vertcat(*forces), ca.vertcat(*outputs), tuple(signals))


def steady_angles(links: tuple[Link, ...]) -> list[int]:
    """Positions among the displacements of the angles of joints with a rate."""
    steady = {link.owner for link in links if getattr(link.joint, "rate", None) is not None}
    return [k for k, degree in enumerate(degrees(links)) if degree.owner in steady]


def measures(
    r: Resolved, view: View, channels: BodyChannels, *forces: Forces
) -> tuple[ca.SX, tuple[Signal, ...], tuple[int, ...]]:
    """Outputs (n_y,) of joints, sensors that are asked for, bodies; `forces`; signals; the default."""
    scene, symbols = r.scene, r.symbols
    entries: list[ca.SX] = []
    signals: list[Signal] = []
    default: list[int] = []
    steady = steady_angles(r.links)
    for row, degree in enumerate(degrees(r.links)):
        if degree.kind not in ("elastic", "motion", "patch"):
            default.append(len(entries) + (row in steady))
        entries += [symbols.q[row], symbols.v[row], symbols.a[row]]
        signals += [degree.measure(order) for order in range(3)]
    for sensor in scene.sensors:
        named = sensor.signals()
        if scene.outputs is not None and not {s.name for s in named} & set(scene.outputs):
            continue
        view.owner = f"sensor {sensor.name!r}"
        default += range(len(signals), len(signals) + len(named))
        entries.append(r.back(sensor.measure(view)))
        signals += named
    default += range(len(signals), len(signals) + len(channels.signals))
    entries.append(channels.outputs)
    signals += channels.signals
    for entry, named in forces:
        entries, signals = [*entries, entry], [*signals, *named]
    return ca.vertcat(*entries), tuple(signals), tuple(default)
