"""Inputs u: efforts of joints, magnitudes of loads, voltages, multipliers of loops; and outputs.

Outputs are what joints, sensors and bodies measure.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from mbdlft.base.array import Array
from mbdlft.base.description import AXES, Values
from mbdlft.base.errors import NotRationalError, SceneError
from mbdlft.base.unit import Signal
from mbdlft.multibody.assembly.closure import Closure, reactions
from mbdlft.multibody.assembly.kinematics import View
from mbdlft.multibody.assembly.resolved import Resolved
from mbdlft.multibody.assembly.tree import Link, coordinate_owners, degrees
from mbdlft.multibody.body import Body, ElasticBody
from mbdlft.multibody.force import BodyWrench, Spring
from mbdlft.multibody.scene.quantities import owner_name
from mbdlft.multibody.scene.scene import UNKNOWN, Scene
from mbdlft.problem.equations import Moved, rows_of
from mbdlft.problem.sx.constants import is_constant, literal, numbers_of, unit_vector

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
    efforts: list[Effort] = []
    deflections: list[Effort] = []
    for degree in degrees(r.links):
        moved = degree.kind == "motion"  # its three inputs are told apart by what they do
        imposed = degree.kind in ("imposed", "motion")
        value = 0.0 if imposed else values.get(degree.owner, {}).get(degree.label("preload"))
        is_input = degree.kind != "elastic"  # the force that holds a static deflection is internal
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
    efforts += [
        Effort(degree.measure(order), 0.0, is_default=False)
        for degree in degrees(r.links)
        for order in range(2)
        if degree.kind == "motion"
    ]
    multipliers = [signal for loop in scene.loops for signal in loop.signals()]
    forces = [Effort(multipliers[k], None, is_input=False, is_default=False) for k in closure.rows]
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
    last = u.numel() - len(closure.rows)
    joints = [*closure.yielding]
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
    wrenches: list[BodyWrench] = []
    for k, load in enumerate(r.scene.loads, start=len(degrees(r.links))):
        wrenches += load.wrenches(view.owned(load), u[k], view)
    count = sum(len(loop.signals()) for loop in r.scene.loops)
    multipliers = ca.SX(count, 1)
    for position, row in enumerate(closure.rows):
        multipliers[row] = u[u.numel() - len(closure.rows) + position] + z[position]
    return wrenches + reactions(r.scene.loops, view, multipliers)


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
    r: Resolved, view: View, channels: BodyChannels
) -> tuple[ca.SX, tuple[Signal, ...], tuple[int, ...]]:
    """Outputs (n_y,) of joints, sensors that are asked for, and bodies; signals; which are default."""
    scene, symbols = r.scene, r.symbols
    entries: list[ca.SX] = []
    signals: list[Signal] = []
    default: list[int] = []
    steady = steady_angles(r.links)
    for row, degree in enumerate(degrees(r.links)):
        if degree.kind not in ("elastic", "motion"):
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
    expressions = ca.vertcat(*entries, channels.outputs)
    return expressions, (*signals, *channels.signals), tuple(default)
