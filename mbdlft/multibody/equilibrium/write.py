"""Scenes with the positions of an equilibrium, and the efforts of their springs there, written in."""

from typing import Any

import casadi as ca
import numpy as np

from mbdlft.base.array import Array
from mbdlft.base.description import Quantity
from mbdlft.base.errors import TrimError
from mbdlft.base.parameter import Parameter
from mbdlft.base.unit import Freedom
from mbdlft.multibody.assembly import assemble
from mbdlft.multibody.equilibrium.displaced import (
    Displaced,
    JointCoordinate,
    displace,
    in_physical,
)
from mbdlft.multibody.equilibrium.find import EquilibriumPoint
from mbdlft.multibody.force import Spring, Strut
from mbdlft.multibody.joint import Joint, Rotation
from mbdlft.multibody.scene import Constant, Scene
from mbdlft.multibody.scene.quantities import has_unit
from mbdlft.problem.linearization import relinearize


def at_equilibrium(scene: Scene, point: EquilibriumPoint) -> Scene:
    """Write the positions of an equilibrium into its scene, as numbers.

    A joint with a `stiffness` and a `preload` gets the preload (preload) - (stiffness) q, as its spring
    is displaced by q at the equilibrium. A spring with a given force density, or a strut with a given
    force, gets the one that its law has there. A parameter that was an unknown of the search gets the
    found value as its nominal. Parameters stay parameters. `to_lft` needs an equilibrium for all values
    of the parameters, so the positions must not depend on them.

    Parameters
    ----------
    scene : Scene
        The scene that `find_equilibrium` was given.
    point : EquilibriumPoint
        The equilibrium that it found.

    Raises
    ------
    TrimError
        The point is an equilibrium of another scene, or a parameter was found at an end of its range.
    """
    d = displace(scene)
    declared, densities = _declared(d, scene, point)
    by_name = {c.signal.name: k for k, c in enumerate(d.coordinates)}
    if point.scene != scene.name or not set(point.positions) <= set(by_name):
        raise TrimError(
            f"scene {scene.name!r}: the equilibrium is one of the scene {point.scene!r} with "
            f"{', '.join(point.positions)}."
        )
    joints = []
    for joint in scene.joints:
        own = {
            k: point.positions[c.signal.name]
            for k, c in enumerate(d.coordinates)
            if c.joint.name == joint.name and c.signal.name in point.positions
        }
        joints.append(_moved(scene, joint, d.coordinates, own, declared) if own else joint)
    loads = [
        load.model_copy(update={load.magnitude_key: densities[load.name]})
        if load.name in densities
        else load
        for load in scene.loads
    ]
    update: dict[str, Any] = {"joints": tuple(joints), "loads": tuple(loads)}
    update["parameters"] = tuple(
        _with_nominal(p, point.parameters[p.name]) if p.name in point.found else p
        for p in scene.parameters
    )
    return scene.model_copy(update=update)


def eigenvalues_at(scene: Scene, point: EquilibriumPoint) -> Array:
    """Eigenvalues (n_x,) of the linear model at an equilibrium (rad/s), the largest real part first.

    Parameters
    ----------
    scene : Scene
        The scene that `find_equilibrium` was given.
    point : EquilibriumPoint
        The equilibrium that it found.

    Raises
    ------
    WellPosednessError
        The mass matrix is singular.
    SceneError, TrimError
        As `assemble` and `to_lft` raise them, such as for a mechanism in a singular position.
    """
    equations = assemble(at_values(at_equilibrium(scene, point), point))
    matrices = relinearize(equations, (), (), np.zeros((1, 0))).linear.matrices
    eigenvalues = np.linalg.eigvals(matrices[0][: len(equations.states), : len(equations.states)])
    return np.asarray(eigenvalues[np.argsort(-eigenvalues.real)])


def at_values(scene: Scene, point: EquilibriumPoint) -> Scene:
    """The scene with constants in place of parameters, with their values at the equilibrium."""
    constants = dict(scene.constants)
    for parameter in scene.parameters:
        constants[parameter.name] = Constant(
            value=point.parameters[parameter.name], unit=parameter.unit
        )
    return scene.model_copy(update={"constants": constants, "parameters": ()})


def _declared(
    d: Displaced, scene: Scene, point: EquilibriumPoint
) -> tuple[Array, dict[str, Quantity]]:
    """Declared positions (n,) (rad, m), and the force densities of springs at the point, by name."""
    springs = [
        load
        for load in scene.loads
        if isinstance(load, Spring | Strut) and getattr(load, load.magnitude_key) is not None
    ]
    lengths = ca.SX(ca.vertcat(*(d.lengths[spring.name] for spring in springs)))
    symbols, expressions = in_physical(d, [d.declared, lengths])
    function = ca.Function("declared", [symbols, d.q], expressions)
    values = [point.parameters[parameter.name] for parameter in d.parameters]
    declared, before = (part.full().reshape(-1) for part in function(values, 0.0))
    _, after = (
        part.full().reshape(-1) for part in function(values, displacements(d, point, declared))
    )
    return declared, {
        spring.name: _density(spring, float(a / b))
        if isinstance(spring, Spring)
        else _relaxed(
            spring.force or 0.0,
            spring.stiffness,
            float(b - a),
            " [m]" if has_unit(scene, spring.stiffness) else "",
        )
        for spring, a, b in zip(springs, before, after, strict=True)
    }


def declared_positions(d: Displaced) -> Array:
    """Declared positions (n,) at nominal (rad, m)."""
    symbols, declared = in_physical(d, [d.declared])
    function = ca.Function("declared", [symbols], declared)
    return np.asarray(function([p.nominal for p in d.parameters]).full()[:, 0])


def displacements(d: Displaced, point: EquilibriumPoint, declared: Array) -> Array:
    """Displacements q (n,) of a point from the declared positions; 2 tan(angle/2) axis for rotations."""
    q = np.zeros(len(d.coordinates))
    for k, c in enumerate(d.coordinates):
        if c.signal.name in point.positions:
            q[k] = point.positions[c.signal.name] - (0.0 if c.is_ball else declared[k])
    balls = [k for k, c in enumerate(d.coordinates) if c.is_ball]
    for k in range(0, len(balls), 3):
        angle = float(np.linalg.norm(q[balls[k : k + 3]]))
        if angle > 0.0:
            q[balls[k : k + 3]] *= 2.0 * np.tan(angle / 2.0) / angle
    return q


def _density(spring: Spring, ratio: float) -> Quantity:
    """Force density k - (k - h) l_declared/l of a spring, with `ratio` l_declared/l."""
    k, h = spring.stiffness, spring.force_density
    if ratio == 1.0:
        return h if h is not None else 0.0
    if isinstance(k, float) and isinstance(h, float):
        return k - (k - h) * ratio
    return f"({k}) - (({k}) - ({h}))*{ratio!r}"


def _moved(
    scene: Scene,
    joint: Joint,
    coordinates: tuple[JointCoordinate, ...],
    positions: dict[int, float],
    declared: Array,
) -> Joint:
    """The joint with new positions, by index of the coordinate; `declared` (n,) are the old ones."""
    for k, position in positions.items():
        c = coordinates[k]
        if c.is_ball:
            continue
        place = within_a_turn(position) if c.freedom.turns else position
        joint = with_entry(joint, "position", c.freedom, place)
        if c.is_sprung and c.is_passive:
            preload, stiffness = c.quantity("preload"), c.quantity("stiffness")
            unit = length_unit(scene, c, stiffness)
            relaxed = _relaxed(preload, stiffness, float(position - declared[k]), unit)
            joint = with_entry(joint, "preload", c.freedom, relaxed)
    vector = np.array([position for k, position in positions.items() if coordinates[k].is_ball])
    angle = float(np.linalg.norm(vector)) if len(vector) else 0.0
    if not angle > 0.0:
        return joint
    x, y, z = (float(entry) for entry in vector / angle)
    orientation = (*joint.orientation, Rotation(axis=(x, y, z), angle=angle))
    return joint.model_copy(update={"orientation": orientation})


def with_entry(joint: Joint, key: str, freedom: Freedom, value: Quantity) -> Joint:
    """The joint with a new value of one quantity of one coordinate."""
    if len(joint.freedoms) == 1:
        return joint.model_copy(update={key: value})
    entries = list(getattr(joint, key))
    entries[joint.freedoms.index(freedom)] = value
    return joint.model_copy(update={key: tuple(entries)})


def within_a_turn(angle: float) -> float:
    """The angle (rad) between minus and plus half a turn."""
    return float(np.remainder(angle + np.pi, 2.0 * np.pi) - np.pi)


def length_unit(scene: Scene, c: JointCoordinate, stiffness: Quantity) -> str:
    """What stands behind the number of a displacement that a stiffness with a unit multiplies."""
    return " [m]" if not c.freedom.turns and has_unit(scene, stiffness) else ""


def _relaxed(preload: Quantity, stiffness: Quantity, q: float, unit: str) -> Quantity:
    """The quantity preload - stiffness q, with the unit behind q."""
    if isinstance(preload, float) and isinstance(stiffness, float):
        return preload - stiffness * q
    return f"({preload}) - ({stiffness})*({q!r}{unit})"


def _with_nominal(parameter: Parameter, value: float) -> Parameter:
    """The parameter with a new nominal value."""
    p = parameter
    if not p.low < value < p.high:
        raise TrimError(
            f"parameter {p.name!r} was found at {value:g} {p.unit}, an end of its range: that cannot be "
            "its nominal. Widen the range."
        )
    return Parameter(
        p.name, value, p.low, p.high, unit=p.unit, role=p.role, substitution=p.substitution,
        reference=p.reference,
    )  # fmt: skip
