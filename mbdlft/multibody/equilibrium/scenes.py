"""Scenes with the positions of an equilibrium, and the efforts of their springs there, written in.

Positions are numbers, or rational functions of the parameters with a guaranteed bound.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np

from mbdlft.base.arguments import arguments_checked
from mbdlft.base.array import Array
from mbdlft.base.description import Quantity
from mbdlft.base.errors import TrimError, check_known
from mbdlft.base.expression import evaluate, parse
from mbdlft.base.parameter import Parameter
from mbdlft.base.unit import dimension_name, parse_unit
from mbdlft.exact.interval import FUNCTIONS, Interval, decimal
from mbdlft.exact.rounding import eigenvalues_of
from mbdlft.multibody.assembly import assemble
from mbdlft.multibody.equilibrium import conditions
from mbdlft.multibody.equilibrium.equilibria import EquilibriumPoint, find_equilibrium
from mbdlft.multibody.equilibrium.fit import EquilibriumFit, fit_equilibrium
from mbdlft.multibody.force import Guided, Spring
from mbdlft.multibody.joint import Joint, Rotation, with_entry
from mbdlft.multibody.scene import Constant, Fit, Scene
from mbdlft.multibody.scene.quantities import has_unit
from mbdlft.problem.linearization import relinearize


@arguments_checked
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
    d = conditions.displace(scene)
    fits = set(point.positions) <= {c.signal.name for c in d.coordinates}
    if point.scene != scene.name or not fits or set(point.parameters) != {p.name for p in d.parameters}:
        raise TrimError(
            f"scene {scene.name!r}: the equilibrium is one of the scene {point.scene!r} with "
            f"{', '.join((*point.positions, *point.parameters))}."
        )
    declared, densities, preloads = _declared(d, scene, point)
    joints = []
    for joint in scene.joints:
        moved = {
            k: point.positions[c.signal.name]
            for k, c in enumerate(d.coordinates)
            if c.joint.name == joint.name and c.signal.name in point.positions
        }
        joints.append(_moved(scene, joint, d.coordinates, moved, declared) if moved else joint)
    loads = [
        load.model_copy(update={load.magnitude_key: densities[load.name]})
        if load.name in densities
        else load
        for load in scene.loads
    ]
    parameters = tuple(
        _with_nominal(p, point.parameters[p.name]) if p.name in point.found else p
        for p in scene.parameters
    )
    couplings = tuple(
        c.model_copy(update={"preload": preloads[c.name]}) if c.name in preloads else c
        for c in scene.couplings
    )
    update = {"joints": tuple(joints), "loads": tuple(loads), "couplings": couplings}
    return scene.model_copy(update={**update, "parameters": parameters})


@arguments_checked
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
    eigenvalues = eigenvalues_of(matrices[0][: len(equations.states), : len(equations.states)])
    return np.asarray(eigenvalues[np.argsort(-eigenvalues.real)])


def at_values(scene: Scene, point: EquilibriumPoint) -> Scene:
    """The scene with constants in place of parameters, with their values at the equilibrium."""
    constants = dict(scene.constants)
    for parameter in scene.parameters:
        constants[parameter.name] = Constant(value=point.parameters[parameter.name], unit=parameter.unit)
    return scene.model_copy(update={"constants": constants, "parameters": ()})


def _declared(
    d: conditions.Displaced, scene: Scene, point: EquilibriumPoint
) -> tuple[Array, dict[str, Quantity], dict[str, Quantity]]:
    """Declared positions (n,) (rad, m); at the point force densities of springs, forces of couplings."""
    springs = [
        load
        for load in scene.loads
        if isinstance(load, Spring | Guided) and getattr(load, load.magnitude_key) is not None
    ]
    lengths = ca.SX(ca.vertcat(*(d.lengths[spring.name] for spring in springs)))
    symbols, expressions = conditions.in_physical(d, [d.declared, lengths, ca.mtimes(d.relations, d.q)])
    function = ca.Function("declared", [symbols, d.q], expressions)
    values = [point.parameters[parameter.name] for parameter in d.parameters]
    declared, before, _ = (value.full().reshape(-1) for value in function(values, 0.0))
    q = displacements(d, point, declared)
    _, after, stretched = (value.full().reshape(-1) for value in function(values, q))
    efforts = {}
    for spring, a, b in zip(springs, before, after, strict=True):
        k, effort = spring.stiffness, getattr(spring, spring.magnitude_key)
        if isinstance(spring, Spring):
            efforts[spring.name] = _density(k, effort, float(a / b))
        else:
            efforts[spring.name] = _relaxed(effort, k, float(b - a), _length_unit(scene, k))
    preloads = dict[str, Quantity]()
    for c, e in zip(scene.couplings, stretched, strict=True):
        if c.preload is not None and c.stiffness is not None:
            unit = _length_unit(scene, c.stiffness, turns=c.measured_in(scene.joints) == "rad")
            preloads[c.name] = _relaxed(c.preload, c.stiffness, float(e), unit)
    return declared, efforts, preloads


def displacements(d: conditions.Displaced, point: EquilibriumPoint, declared: Array) -> Array:
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


def _density(k: Quantity, h: Quantity, ratio: float) -> Quantity:
    """Force density k - (k - h) l_declared/l of a spring, with `ratio` l_declared/l."""
    if ratio == 1.0:
        return h
    if isinstance(k, float) and isinstance(h, float):
        return k - (k - h) * ratio
    return f"({k}) - (({k}) - ({h}))*{ratio!r}"


def _moved(
    scene: Scene,
    joint: Joint,
    coordinates: tuple[conditions.JointCoordinate, ...],
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
            unit = _length_unit(scene, stiffness, turns=c.freedom.turns)
            relaxed = _relaxed(preload, stiffness, float(position - declared[k]), unit)
            joint = with_entry(joint, "preload", c.freedom, relaxed)
    vector = np.array([position for k, position in positions.items() if coordinates[k].is_ball])
    angle = float(np.linalg.norm(vector)) if len(vector) else 0.0
    if not angle > 0.0:
        return joint
    x, y, z = (float(entry) for entry in vector / angle)
    orientation = (*joint.orientation, Rotation(axis=(x, y, z), angle=angle))
    return joint.model_copy(update={"orientation": orientation})


def within_a_turn(angle: float) -> float:
    """The angle (rad) between minus and plus half a turn."""
    return float(np.remainder(angle + np.pi, 2.0 * np.pi) - np.pi)


def _length_unit(scene: Scene, stiffness: Quantity, *, turns: bool = False) -> str:
    """What stands behind the number of a displacement that a stiffness with a unit multiplies."""
    return " [m]" if not turns and has_unit(scene, stiffness) else ""


def _relaxed(preload: Quantity, stiffness: Quantity, q: float, unit: str) -> Quantity:
    """The quantity preload - stiffness q, with the unit behind q."""
    if isinstance(preload, float) and isinstance(stiffness, float):
        return preload - stiffness * q
    return f"({preload}) - ({stiffness})*({q!r}{unit})"


def _with_nominal(parameter: Parameter, value: float) -> Parameter:
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


_NAME = re.compile(r"(?<![\w.])[^\W\d]\w*")
_TANGENT = 1e3  # range of the tangents while they are symbols; nothing depends on it


@arguments_checked
def fit_positions(scene: Scene, joints: Sequence[str], tolerance: float) -> Scene:
    """The scene with positions that follow its equilibrium as rational functions of the parameters.

    The `position` of each of the joints becomes theta0 + 2*atan(r), or x0 + 2*r, with a rational
    expression r of the parameters. A `preload` beside a `stiffness` becomes the effort of the
    displaced spring, and springs between ports get the `force_density` that they have there. All that
    has a guaranteed bound for all values of the parameters, stored in ``scene.fit``. The model that
    `to_lft` makes is not exact; its certificate has the largest bound of a position.

    Parameters
    ----------
    scene : Scene
        Declared near the equilibrium at nominal: it is the one that `find_equilibrium` finds.
    joints : sequence of str
        Names of joints whose effort is given by a `preload`.
    tolerance : float
        Largest bound of a position (rad, m); of a force density, relative to the nominal stiffness.

    Returns
    -------
    Scene
        ``scene.fit.bounds`` are the bounds by coordinate (rad, m) and by effort (N m, N, N/m).

    Raises
    ------
    TrimError
        There is no equilibrium at nominal; it folds, bifurcates or ends in the range; or the
        tolerance cannot be met. The message says where.
    NotRationalError
        The equilibrium depends on a parameter that is an angle.
    """
    what = f"scene {scene.name!r}, fit of {', '.join(joints)}"
    if scene.fit is not None:
        raise TrimError(f"{what}: its positions are a fit already. Fit the scene as it was before.")
    check_known("joint", joints, {joint.name for joint in scene.joints}, what, TrimError)
    before = conditions.displace(scene)
    chosen = [k for k, c in enumerate(before.coordinates) if c.joint.name in joints]
    for k in chosen:
        c = before.coordinates[k]
        if c.is_ball or not c.is_passive:
            why = "turns about all axes" if c.is_ball else "has no preload, so its effort holds it"
            raise TrimError(f"{what}: {c.joint.name!r} {why}. Leave it out.")
    point = find_equilibrium(scene, positions=joints)
    if point.undetermined:
        raise TrimError(
            f"{what}: the nominal equilibrium does not determine {', '.join(point.undetermined)}: it is "
            "a fold or a bifurcation, or nothing holds them. Change the nominal values, or fit other "
            "joints."
        )
    nominal = {k: float(point.positions[before.coordinates[k].signal.name]) for k in chosen}
    tangents = {k: _fresh(scene, k) for k in chosen}
    symbolic = _with_positions(scene, before, nominal, tangents).model_copy(
        update={
            "parameters": (
                *scene.parameters,
                *(Parameter(name, 0.0, -_TANGENT, _TANGENT) for name in tangents.values()),
            )
        }
    )
    system = conditions.fit_conditions(scene, before, conditions.displace(symbolic), tangents, nominal)
    if not system.names:
        raise TrimError(
            f"{what}: these positions do not depend on parameters. at_equilibrium(scene, "
            "find_equilibrium(scene)) writes them as numbers, which is exact."
        )
    by_name = {p.name: p for p in scene.parameters}
    nominal_p, low, high = np.array(
        [
            [getattr(by_name[name], end) * by_name[name].factor for name in system.names]
            for end in ("nominal", "low", "high")
        ]
    )
    try:
        # of twice the tangent of half an angle, which is more than the angle itself
        fit = fit_equilibrium(
            system.residual, nominal_p, low, high, system.start, 0.5 * tolerance, names=system.names
        )
    except TrimError as error:
        raise TrimError(f"{what}: {error}") from None
    return _fitted(scene, before, system, nominal, fit, tolerance)


def _fitted(
    scene: Scene,
    before: conditions.Displaced,
    system: conditions.Conditions,
    nominal: Mapping[int, float],
    fit: EquilibriumFit,
    tolerance: float,
) -> Scene:
    """The scene with the fitted expressions and their bounds."""
    fit = replace(fit, expressions=tuple(_plain(scene, text) for text in fit.expressions))
    count, turning = len(system.tangents), len(system.angles)
    tangents = dict(zip(system.tangents, fit.expressions, strict=False))
    angles = dict(zip(system.angles, fit.expressions[count : count + turning], strict=True))
    width = 2.0 * fit.bound
    bounds = {before.coordinates[k].signal.name: float(width[i]) for i, k in enumerate(system.tangents)}
    moved = _with_positions(scene, before, nominal, tangents)
    symbols, expressions = conditions.in_physical(before, [before.declared])
    at_nominal = ca.Function("declared", [symbols], expressions)([p.nominal for p in before.parameters])
    declared = at_nominal.full()[:, 0]
    joints = {joint.name: joint for joint in moved.joints}
    for i, k in enumerate(system.tangents):
        c = before.coordinates[k]
        if not c.is_sprung:
            continue
        half, error = angles.get(k, tangents[k]), width[i]
        if k in angles:
            error = width[count + system.angles.index(k)]
        stiffness = c.quantity("stiffness")
        displaced = f"{float(nominal[k] - declared[k])!r} + 2*({half})"
        if unit := _length_unit(scene, stiffness, turns=c.freedom.turns):
            displaced = f"1.0{unit}*({displaced})"
        text = f"({c.quantity('preload')}) - ({stiffness})*({displaced})"
        joints[c.joint.name] = with_entry(joints[c.joint.name], "preload", c.freedom, text)
        bounds[c.effort.name] = _largest(scene, stiffness, float(error))
    loads = list(scene.loads)
    for i, (name, size) in enumerate(system.springs.items(), start=count + turning):
        k = next(k for k, load in enumerate(loads) if load.name == name)
        spring: dict[str, Any] = {loads[k].magnitude_key: f"{size!r}*({fit.expressions[i]})"}
        if isinstance(loads[k], Spring):
            spring["rest_length"] = None
        loads[k] = loads[k].model_copy(update=spring)
        bounds[f"{name}.{loads[k].signal.name}"] = (Interval.of(size) * float(fit.bound[i])).largest
    update = {
        "joints": tuple(joints.values()),
        "loads": tuple(loads),
        "fit": Fit(tolerance=float(tolerance), bounds=bounds),
    }
    return scene.model_copy(update=update)


def _plain(scene: Scene, text: str) -> str:
    """An expression of SI values with names made plain numbers: 1.0 [N^-1]*F in place of F."""
    units = {}
    for p in scene.parameters:
        dimension = parse_unit(p.unit).dimension
        if any(dimension):
            inverse = dimension_name(tuple(-exponent for exponent in dimension))
            units[p.name] = f"(1.0 [{inverse}]*{p.name})"
    return _NAME.sub(lambda match: units.get(match[0], match[0]), text)


def _fresh(scene: Scene, k: int) -> str:
    """A parameter name that the scene does not use."""
    name = f"tangent{k}"
    while name in {*(p.name for p in scene.parameters), *scene.constants}:
        name += "_"
    return name


def _with_positions(
    scene: Scene, d: conditions.Displaced, nominal: Mapping[int, float], expressions: Mapping[int, str]
) -> Scene:
    """The scene with positions theta0 + 2*atan(expression) or x0 + 2*(expression)."""
    joints = {joint.name: joint for joint in scene.joints}
    for k, expression in expressions.items():
        c = d.coordinates[k]
        text = f"{nominal[k]!r} + 2*({expression})"
        if c.freedom.turns:
            text = f"{within_a_turn(nominal[k])!r} + 2*atan({expression})"
        joints[c.joint.name] = with_entry(joints[c.joint.name], "position", c.freedom, text)
    return scene.model_copy(update={"joints": tuple(joints.values())})


def _largest(scene: Scene, source: Quantity, error: float) -> float:
    """A bound of an error times the size of a quantity over the range of the parameters."""
    box = {name: decimal(value) for name, value in scene.constant_values().items()}
    for p in scene.parameters:
        if not p.is_angle:
            box[p.name] = Interval(p.low, p.high) * p.factor
    size: Interval = evaluate(parse(source), box, decimal, FUNCTIONS)
    return (size * error).largest
