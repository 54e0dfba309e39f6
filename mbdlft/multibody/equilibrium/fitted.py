"""Positions as rational functions of the parameters, with a guaranteed bound."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from mbdlft.base.description import Quantity
from mbdlft.base.errors import TrimError, unknown_name
from mbdlft.base.expression import evaluate, parse
from mbdlft.base.parameter import Parameter
from mbdlft.base.unit import dimension_name, parse_unit
from mbdlft.exact.interval import FUNCTIONS, Interval, decimal
from mbdlft.multibody.equilibrium.conditions import Conditions, conditions
from mbdlft.multibody.equilibrium.displaced import Displaced, displace
from mbdlft.multibody.equilibrium.find import find_equilibrium
from mbdlft.multibody.equilibrium.fit import EquilibriumFit, fit_equilibrium
from mbdlft.multibody.equilibrium.write import (
    declared_positions,
    length_unit,
    with_entry,
    within_a_turn,
)
from mbdlft.multibody.force import Spring
from mbdlft.multibody.scene import Fit, Scene

_NAME = re.compile(r"(?<![\w.])[^\W\d]\w*")
_TANGENT = 1e3  # range of the tangents while they are symbols; nothing depends on it


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
    names = {joint.name for joint in scene.joints}
    for name in joints:
        if name not in names:
            raise TrimError(f"{what}: {unknown_name('joint', name, names)}")
    before = displace(scene)
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
    system = conditions(scene, before, displace(symbolic), tangents, nominal)
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
        found = fit_equilibrium(
            system.residual, nominal_p, low, high, system.start, 0.5 * tolerance, names=system.names
        )
    except TrimError as error:
        raise TrimError(f"{what}: {error}") from None
    return _fitted(scene, before, system, nominal, found, tolerance)


def _fitted(
    scene: Scene,
    before: Displaced,
    system: Conditions,
    nominal: Mapping[int, float],
    found: EquilibriumFit,
    tolerance: float,
) -> Scene:
    """The scene with the fitted expressions and their bounds."""
    found = replace(found, expressions=tuple(_plain(scene, text) for text in found.expressions))
    count, turning = len(system.tangents), len(system.angles)
    tangents = dict(zip(system.tangents, found.expressions, strict=False))
    angles = dict(zip(system.angles, found.expressions[count : count + turning], strict=True))
    width = 2.0 * found.bound
    bounds = {
        before.coordinates[k].signal.name: float(width[i]) for i, k in enumerate(system.tangents)
    }
    moved = _with_positions(scene, before, nominal, tangents)
    declared = declared_positions(before)
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
        if unit := length_unit(scene, c, stiffness):
            displaced = f"1.0{unit}*({displaced})"
        text = f"({c.quantity('preload')}) - ({stiffness})*({displaced})"
        joints[c.joint.name] = with_entry(joints[c.joint.name], "preload", c.freedom, text)
        bounds[c.effort.name] = _largest(scene, stiffness, float(error))
    loads = list(scene.loads)
    for i, (name, size) in enumerate(system.springs.items(), start=count + turning):
        k = next(k for k, load in enumerate(loads) if load.name == name)
        spring: dict[str, Any] = {loads[k].magnitude_key: f"{size!r}*({found.expressions[i]})"}
        if isinstance(loads[k], Spring):
            spring["rest_length"] = None
        loads[k] = loads[k].model_copy(update=spring)
        bounds[f"{name}.{loads[k].signal.name}"] = (
            Interval.of(size) * float(found.bound[i])
        ).largest
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
    return _NAME.sub(lambda found: units.get(found[0], found[0]), text)


def _fresh(scene: Scene, k: int) -> str:
    """A parameter name that the scene does not use."""
    name = f"tangent{k}"
    while name in {*(p.name for p in scene.parameters), *scene.constants}:
        name += "_"
    return name


def _with_positions(
    scene: Scene, d: Displaced, nominal: Mapping[int, float], expressions: Mapping[int, str]
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
