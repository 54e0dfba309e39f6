"""Checks of a scene that need its values: units, physics, and denominators over the whole range."""

import warnings
from collections.abc import Iterator, Mapping, Sequence
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mbdlft.base.description import ANY_UNIT, AXES, Expected, Quantity
from mbdlft.base.errors import MbdlftWarning, SceneError, WellPosednessError, unknown_name
from mbdlft.base.expression import (
    Binary,
    Expression,
    Negative,
    Number,
    check_degree,
    denominators,
    evaluate,
    names,
    parse,
    walk,
    write,
)
from mbdlft.base.unit import Exponents, Signal, dimension_name, parse_unit
from mbdlft.exact.interval import FUNCTIONS, Interval, decimal, find_zero
from mbdlft.exact.operators import FUNCTIONS_OF_DIMENSIONS as DIMENSIONS
from mbdlft.exact.operators import Dimension
from mbdlft.multibody.body import Body
from mbdlft.multibody.force import Load
from mbdlft.multibody.joint import Joint
from mbdlft.multibody.scene.positive import check_positive
from mbdlft.multibody.scene.quantities import (
    Place,
    angle_at,
    expression_at,
    owner_name,
    owners,
    value_at,
)
from mbdlft.multibody.scene.scene import Constant, Scene

_RANDOM, _CORNERS = 64, 4096
_ROUNDING = 1e-12
_NONE: Exponents = (0, 0, 0, 0, 0)


def check(scene: Scene) -> None:
    """Raise an error for the first quantity of a scene that cannot be used.

    Raises
    ------
    SceneError
        A name is unknown, a unit does not fit, or a mass or inertia is not physical, or
        gravity is not steady in the spinning frame.
    NotRationalError
        A quantity is not rational in the parameters.
    WellPosednessError
        A denominator vanishes inside the range of the parameters.
    """
    dimensions = dimensions_of(scene)
    sampled = {
        owner: _check_quantities(scene, owner, quantities, dimensions)
        for owner, quantities in owners(scene)
    }
    _check_steady(scene, sampled[f"scene {scene.name!r}"])
    items: list[Body | Joint] = [*scene.bodies, *scene.joints]
    for item in items:
        problem = item.physical_problem(sampled[owner_name(item)])
        if problem:
            raise SceneError(f"{owner_name(item)}: {problem} Check the values and the ranges.")
    for text in (*_unproved(scene), *_gains_energy(scene, sampled)):
        warnings.warn(text, MbdlftWarning, stacklevel=2)


def _unproved(scene: Scene) -> Iterator[str]:
    """Sentences on masses and inertias whose sign is open in parts of the range."""
    for condition, used, sign in check_positive(scene):
        if sign.open_parts:
            units = {p.name: p.unit for p in scene.parameters}
            part = ", ".join(
                f"{name} in [{low:.6g}, {high:.6g}] {units[name]}".removesuffix(" 1")
                for name, (low, high) in zip(used, sign.open_parts[0], strict=True)
            )
            yield (
                f"{condition.owner}: not proved: whether {condition.what} is open in "
                f"{len(sign.open_parts)} parts of the range, such as {part}. It is not at the samples."
            )


def _gains_energy(
    scene: Scene, sampled: Mapping[str, Mapping[str, NDArray[np.float64]]]
) -> Iterator[str]:
    """Sentences on stiffnesses and damping that are negative somewhere: allowed, but rarely meant."""
    items: list[Joint | Load] = [*scene.joints, *scene.loads]
    for item in items:
        for label, values in sampled[owner_name(item)].items():
            lowest = float(np.min(values))
            if label.partition(".")[0] in ("stiffness", "damping") and lowest < 0.0:
                unit = item.quantities()[label].unit
                yield f"{owner_name(item)}: {label} is negative in the range: {lowest:g} {unit}."


def check_fit(scene: Scene, signals: Sequence[Signal]) -> None:
    """Raise a SceneError if the fit of the scene names what it does not have."""
    for name in scene.fit.bounds if scene.fit else ():
        known = [signal.name for signal in signals]
        if name not in known:
            raise SceneError(
                f"scene {scene.name!r}, fit: " + unknown_name("coordinate or effort", name, known)
            )


def _check_quantities(
    scene: Scene, owner: str, quantities: Mapping[str, Expected], dimensions: Mapping[str, Any]
) -> dict[str, NDArray[np.float64]]:
    """Values (SI) of the checked quantities of one owner at samples of the range; angles left out."""
    samples = _samples(scene, owner, quantities)
    found: dict[str, NDArray[np.float64]] = {}
    for label, expected in quantities.items():
        place = Place(owner, label)
        if isinstance(expected.source, float) and expected.unit != "rad":
            found[label] = _at_all(samples, expected.source)
            continue
        if expected.unit == "rad":
            _check_angle(scene, place, expected, dimensions, samples)
            continue
        expression = expression_at(place, expected)
        _check_angle_is_position(scene, place, expected, expression)
        _check_degree(scene, place, expected, expression)
        values = _sampled(place, expected, samples)
        _check_denominators(scene, place, expression)
        if scene.fit is None:  # a fit is a polynomial of numbers, written by `fit_positions`
            _check_dimension(place, expected, expression, dimensions)
        if not np.all(np.isfinite(values)):
            raise SceneError(f"{place} = {expected.source!r}: is not finite in the range.")
        found[label] = values
    return found


def _check_steady(scene: Scene, values: Mapping[str, NDArray[np.float64]]) -> None:
    """Gravity is steady in the frame of the scene: along the axis of its spin, or zero."""
    if scene.spin is None or not np.any(values["spin.rate"]):
        return
    axis = np.asarray(scene.spin.axis) / np.linalg.norm(scene.spin.axis)
    gravity = np.stack([values[f"gravity.{a}"] for a in AXES], axis=1)
    across = float(np.max(np.linalg.norm(np.cross(axis, gravity), axis=1)))
    if across > _ROUNDING * float(np.max(np.abs(gravity))):
        raise SceneError(
            f"scene {scene.name!r}: gravity has {across:.4g} m/s^2 across the axis of the spin "
            f"{list(scene.spin.axis)}. It would turn in the spinning frame of the scene, which has no "
            "steady equilibrium then. Expected gravity along the axis, or zero."
        )


def _check_angle(
    scene: Scene,
    place: Place,
    expected: Expected,
    dimensions: Mapping[str, Any],
    samples: Mapping[str, Any],
) -> None:
    """An angle, and the arguments of its arctangents, which are plain numbers."""
    arctangents = angle_at(scene, place, expected).arctangents
    if not arctangents and not isinstance(expected.source, float):
        _check_dimension(place, expected, expression_at(place, expected), dimensions)
    for tangent in arctangents:
        source = Expected(write(tangent), "1")
        inside = Place(place.owner, f"{place.label}, atan")
        _check_degree(scene, inside, source, tangent)
        _check_denominators(scene, inside, tangent)
        if scene.fit is None:
            _check_dimension(inside, source, tangent, dimensions)
        if not np.all(np.isfinite(_sampled(inside, source, samples))):
            raise SceneError(f"{inside} of {source.source!r}: is not finite in the range.")


def _sampled(place: Place, expected: Expected, samples: Mapping[str, Any]) -> NDArray[np.float64]:
    """Values (SI) of a quantity at the samples of the range."""
    with np.errstate(all="ignore"):  # what is not finite has its own message
        value = value_at(place, expected, samples)
    return _at_all(samples, value)


def _at_all(samples: Mapping[str, Any], value: Any) -> NDArray[np.float64]:
    """A value, or values, at each of the samples."""
    longest = next((e for e in samples.values() if isinstance(e, np.ndarray)), None)  # all are
    return np.broadcast_to(value, (1,) if longest is None else longest.shape)


def _samples(
    scene: Scene, owner: str, quantities: Mapping[str, Expected]
) -> Mapping[str, NDArray[np.float64] | float]:
    """Nominal, corners and random points of the range: an array (SI units) for each plain parameter
    that the quantities use. All corners, if there are not too many.
    """
    used = {
        name
        for label, expected in quantities.items()
        if not isinstance(expected.source, float)
        for name in names(expression_at(Place(owner, label), expected))
    }
    plain = [p for p in scene.parameters if not p.is_angle]
    active = [p for p in plain if p.name in used]
    values: dict[str, Any] = dict(scene.constant_values())
    values |= {p.name: p.nominal for p in plain}  # those that are not used: for messages
    if not active:
        return values
    generator = np.random.default_rng(0)
    if 2 ** len(active) <= _CORNERS:
        sides = np.array(list(product((0.0, 1.0), repeat=len(active))))
    else:
        sides = generator.integers(0, 2, (_CORNERS, len(active))).astype(float)
    weights = np.vstack([sides, generator.random((_RANDOM, len(active)))])
    for k, p in enumerate(active):
        nominal, low, high = p.nominal * p.factor, p.low * p.factor, p.high * p.factor
        values[p.name] = np.concatenate([[nominal], low + weights[:, k] * (high - low)])
    return values


def dimensions_of(scene: Scene) -> Mapping[str, Any]:
    """Dimensions of the names of a scene; plain numbers as they are."""
    values: dict[str, Any] = dict(scene.constant_values())
    for name, constant in scene.constants.items():
        if isinstance(constant, Constant):
            values[name] = Dimension(parse_unit(constant.unit).dimension)
    for parameter in scene.parameters:
        values[parameter.name] = Dimension(parse_unit(parameter.unit).dimension)
    return values


def has_unit(scene: Scene, source: Quantity) -> bool:
    """Whether a name or a number gives a quantity a unit; else it has the unit of its place."""
    value = evaluate(parse(source), dimensions_of(scene), functions=DIMENSIONS)
    return isinstance(value, Dimension) and value.exponents is not None


def _check_angle_is_position(
    scene: Scene, place: Place, expected: Expected, expression: Expression
) -> None:
    used = names(expression)
    for parameter in scene.parameters:
        if parameter.is_angle and parameter.name in used:
            raise SceneError(
                f"{place} = {expected.source!r}: {parameter.name!r} has unit {parameter.unit!r}, which "
                "does not fit. An angle parameter can be the position of a joint, or in an orientation."
            )


def _check_degree(scene: Scene, place: Place, expected: Expected, expression: Expression) -> None:
    try:
        check_degree(expression, {p.name: 1 for p in scene.parameters})
    except SceneError as error:
        raise SceneError(f"{place} = {expected.source!r}: {error}") from None


def _check_dimension(
    place: Place, expected: Expected, expression: Expression, dimensions: Mapping[str, Any]
) -> None:
    if expected.unit == ANY_UNIT:
        return
    try:
        value = evaluate(expression, dimensions, functions=DIMENSIONS)
    except SceneError as error:
        raise SceneError(f"{place} = {expected.source!r}: {error}") from None
    wanted = parse_unit(expected.unit).dimension
    if isinstance(value, Dimension) and value.exponents not in (None, wanted):
        raise SceneError(
            f"{place} = {expected.source!r}: the unit does not fit: expected {expected.unit}, "
            f"got {dimension_name(value.exponents)}."
            + _missing_unit(expected, expression, dimensions, value.exponents or _NONE)
        )


def _missing_unit(
    expected: Expected, expression: Expression, dimensions: Mapping[str, Any], got: Exponents
) -> str:
    """What may have been forgotten: the unit of a parameter, or that of a factor."""
    wanted = parse_unit(expected.unit).dimension
    rest = tuple(a - b for a, b in zip(wanted, got, strict=True))
    missing, plain = dimension_name(rest), Dimension(_NONE)
    bare = sorted(name for name in names(expression) if dimensions[name] == plain)
    if bare:
        found, unit = " and ".join(map(repr, bare)), expected.unit if not any(got) else missing
        return (
            f" {found} {'have' if bare[1:] else 'has'} no unit: declare "
            f"{'one of them' if bare[1:] else 'it'} with unit = {unit!r}, or give a number a unit, "
            f"such as 1 [{unit}]*{bare[0]}."
        )
    if _has_factor(expression):
        return (
            " A number that multiplies a value with a unit is a plain factor. Where the factor has a "
            f"unit, write it behind the number, such as 2.0 [{missing}], or declare a constant with it."
        )
    return ""


def _has_factor(expression: Expression) -> bool:
    """Whether a number is a factor in an expression, as its user may have meant it with a unit."""
    products = (
        node for node in walk(expression) if isinstance(node, Binary) and node.operator in "*/"
    )
    sides = (side for node in products for side in (node.left, node.right))
    return any(
        isinstance(side.operand if isinstance(side, Negative) else side, Number) for side in sides
    )


def _check_denominators(scene: Scene, place: Place, expression: Expression) -> None:
    """Show by interval arithmetic that no denominator vanishes in the range, or raise."""
    found_in = denominators(expression)
    if not found_in:
        return
    plain = {p.name: p for p in scene.parameters if not p.is_angle}
    constants = {name: decimal(value) for name, value in scene.constant_values().items()}
    factors = {name: p.factor for name, p in plain.items()}
    for denominator in found_in:
        used = sorted(names(denominator) & set(plain))
        if not used:
            continue

        def value(box: Mapping[str, Interval], divisor: Expression = denominator) -> Interval:
            si = {name: item * factors[name] for name, item in box.items()}
            found: Interval = evaluate(divisor, {**constants, **si}, decimal, FUNCTIONS)
            return found

        found = find_zero(value, {name: (plain[name].low, plain[name].high) for name in used})
        if found is not None:
            ranges = ", ".join(
                f"{name} = {at:g} {plain[name].unit}" for name, at in found[0].items()
            )
            raise WellPosednessError(
                f"{place}: the denominator {write(denominator)} vanishes in the range, near "
                f"{ranges}, or comes too close to zero to tell. Narrow the range or write the "
                "quantity without the division."
            )
