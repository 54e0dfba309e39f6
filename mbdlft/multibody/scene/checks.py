"""Checks of a scene that need its values: units, physics, and denominators over the whole range.

Samples miss a disc of a hundredth of the range. So each mass, moment of inertia and number of a section
that must not be negative is enclosed over the range: proved, or refuted at a point, or open. What has no
parameters is a number. The conditions of an inertia are those of a distribution of mass that is not
negative: with J about the center of mass, the matrix P = tr(J)/2 - J of its second moments is positive
semidefinite: its principal minors are not negative. Then J is positive semidefinite, too, and its
principal moments satisfy the triangle inequality.
"""

import math
import re
import warnings
from collections.abc import Collection, Iterator, Mapping, Sequence
from itertools import product
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbdlft.base.description import AXES, Expected
from mbdlft.base.errors import MbdlftWarning, SceneError, WellPosednessError, check_known
from mbdlft.base.expression import (
    Binary,
    Expression,
    Number,
    check_degree,
    denominators,
    evaluate,
    names,
    write,
)
from mbdlft.base.parameter import Parameter
from mbdlft.base.unit import Signal
from mbdlft.exact.interval import FUNCTIONS, Interval, decimal, find_zero
from mbdlft.exact.taylor import BOXES, Sign, not_negative
from mbdlft.multibody.body import Body
from mbdlft.multibody.contact import Contact, Rolling
from mbdlft.multibody.coupling import Coupling
from mbdlft.multibody.force import Load, Support, Tire
from mbdlft.multibody.joint import Joint
from mbdlft.multibody.scene.quantities import (
    Place,
    angle_at,
    check_dimension,
    dimensions_of,
    expression_at,
    owner_name,
    owners,
    value_at,
)
from mbdlft.multibody.scene.scene import Scene

_RANDOM, _CORNERS = 64, 4096
_ROUNDING = 1e-12  # of the size at nominal: what rounding of the data may leave or make negative


class _Names(NamedTuple):
    """What the names in the quantities of a scene are."""

    scene: Scene
    constants: dict[str, float]  # in SI units
    plain: dict[str, Parameter]
    angles: dict[str, Parameter]

    @staticmethod
    def of(scene: Scene) -> "_Names":
        angles = {p.name: p for p in scene.parameters if p.is_angle}
        plain = {p.name: p for p in scene.parameters if p.name not in angles}
        return _Names(scene, scene.constant_values(), plain, angles)


def check(scene: Scene) -> None:
    """Raise an error for the first quantity of a scene that cannot be used."""
    known, dimensions = _Names.of(scene), dimensions_of(scene)
    sampled = {
        owner: _check_quantities(known, owner, quantities, dimensions)
        for owner, quantities in owners(scene)
    }
    _check_steady(scene, sampled[f"scene {scene.name!r}"])
    items: list[Body | Joint | Load | Coupling | Contact] = [*scene.bodies, *scene.joints]
    items += [*scene.loads, *scene.couplings, *scene.contacts]
    for item in items:
        problem = item.physical_problem(sampled[owner_name(item)])
        if problem:
            raise SceneError(f"{owner_name(item)}: {problem} Check the values and the ranges.")
    for text in (*_unproved(scene), *_gains_energy(scene, sampled), *weightless(scene)):
        warnings.warn(text, MbdlftWarning, stacklevel=2)


def _unproved(scene: Scene) -> Iterator[str]:
    """Sentences on masses and inertias whose sign is open in parts of the range."""
    for condition, used, sign in check_positive(scene):
        if sign.open_parts:
            units = {p.name: p.unit for p in scene.parameters}
            box = ", ".join(
                f"{name} in [{low:.6g}, {high:.6g}] {units[name]}".removesuffix(" 1")
                for name, (low, high) in zip(used, sign.open_parts[0], strict=True)
            )
            yield (
                f"{condition.owner}: not proved: whether {condition.what} is open in "
                f"{len(sign.open_parts)} parts of the range, such as {box}. It is not at the samples."
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


def weightless(scene: Scene) -> Iterator[str]:
    """A sentence on what is there to carry a weight, where gravity was not said to be zero."""
    if {"gravity", "acceleration"} & scene.model_fields_set:
        return
    standing = [load for load in scene.loads if isinstance(load, Support | Tire) and load.force is None]
    rolling = [contact for contact in scene.contacts if isinstance(contact, Rolling)]
    for item in (*rolling, *standing)[:1]:
        yield (
            f"scene {scene.name!r}: there is no gravity, and {owner_name(item)} would carry a weight. "
            "It is zero unless it is given: gravity = [0, 0, -9.81]; [0, 0, 0] says that it is meant."
        )


def check_fit(scene: Scene, signals: Sequence[Signal]) -> None:
    """Raise a SceneError if the fit of the scene names what it does not have."""
    for name in scene.fit.bounds if scene.fit else ():
        known = [signal.name for signal in signals]
        check_known("coordinate or effort", [name], known, f"scene {scene.name!r}, fit")


def _check_quantities(
    known: _Names, owner: str, quantities: Mapping[str, Expected], dimensions: Mapping[str, Any]
) -> dict[str, NDArray[np.float64]]:
    """Values (SI) of the checked quantities of one owner at samples of the range; angles left out."""
    texts = [(k, e) for k, e in quantities.items() if not isinstance(e.source, float)]
    expressions = {k: expression_at(Place(owner, k), e) for k, e in texts}
    samples = _samples(known, {n for expression in expressions.values() for n in names(expression)})
    sampled: dict[str, NDArray[np.float64]] = {}
    for label, expected in quantities.items():
        place = Place(owner, label)
        if isinstance(expected.source, float) and expected.unit != "rad":
            sampled[label] = _at_all(samples, expected.source)
            continue
        if expected.unit == "rad":
            arctangents = angle_at(known.scene, place, expected).arctangents
            if not arctangents and label in expressions:
                check_dimension(place, expected, expressions[label], dimensions)
            for tangent in arctangents:  # plain numbers
                inside = Place(owner, f"{label}, atan")
                plain = Expected(write(tangent), "1")
                _checked(known, inside, plain, tangent, dimensions, samples)
            continue
        expression = expressions[label]
        for name in sorted(names(expression) & known.angles.keys()):
            raise SceneError(
                f"{place} = {expected.source!r}: {name!r} has unit {known.angles[name].unit!r}, which "
                "does not fit. An angle parameter can be the position of a joint, or in an orientation. "
                f"Elsewhere expressions are rational: declare a parameter t = tan({name}/2) in its "
                "place, with the cosine (1 - t^2)/(1 + t^2), the sine 2*t/(1 + t^2), and the angle "
                "2*atan(t)."
            )
        sampled[label] = _checked(known, place, expected, expression, dimensions, samples)
    return sampled


def _checked(
    known: _Names,
    place: Place,
    expected: Expected,
    expression: Expression,
    dimensions: Mapping[str, Any],
    samples: Mapping[str, Any],
) -> NDArray[np.float64]:
    """Values (SI) at the samples of a quantity that is not an angle, and checks of it."""
    try:
        check_degree(expression, dict.fromkeys((*known.plain, *known.angles), 1))
    except SceneError as error:
        raise SceneError(f"{place} = {expected.source!r}: {error}") from None
    with np.errstate(all="ignore"):  # what is not finite has its own message
        value = value_at(place, expected, samples)
    if divisors := denominators(expression):
        _check_denominators(known, place, divisors)
    if known.scene.fit is None:  # a fit is a polynomial of numbers, written by `fit_positions`
        check_dimension(place, expected, expression, dimensions)
    values = _at_all(samples, value)
    if not np.all(np.isfinite(values)):
        raise SceneError(f"{place} = {expected.source!r}: is not finite in the range.")
    return values


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


def _at_all(samples: Mapping[str, Any], value: Any) -> NDArray[np.float64]:
    """A value, or values, at each of the samples."""
    longest = next((e for e in samples.values() if isinstance(e, np.ndarray)), None)  # all are
    return np.broadcast_to(value, (1,) if longest is None else longest.shape)


def _samples(known: _Names, used: Collection[str]) -> Mapping[str, NDArray[np.float64] | float]:
    """Nominal, corners and random points of the range: an array (SI units) for each plain parameter
    that is used. All corners, if there are not too many.
    """
    active = [p for name, p in known.plain.items() if name in used]
    values: dict[str, Any] = dict(known.constants)
    values |= {name: p.nominal for name, p in known.plain.items()}  # those not used: for messages
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


def _check_denominators(known: _Names, place: Place, divisors: Sequence[Expression]) -> None:
    """Show by interval arithmetic that no denominator vanishes in the range, or raise."""
    plain = known.plain
    constants = {name: decimal(value) for name, value in known.constants.items()}
    factors = {name: p.factor for name, p in plain.items()}
    for denominator in divisors:
        used = sorted(names(denominator) & set(plain))
        if not used:
            continue

        def value(box: Mapping[str, Interval], divisor: Expression = denominator) -> Interval:
            si = {name: item * factors[name] for name, item in box.items()}
            enclosed: Interval = evaluate(divisor, {**constants, **si}, decimal, FUNCTIONS)
            return enclosed

        zero = find_zero(value, {name: (plain[name].low, plain[name].high) for name in used})
        if zero is not None:
            near = ", ".join(
                f"{name} = {at:g} {plain[name].unit}".removesuffix(" 1") for name, at in zero[0].items()
            )
            raise WellPosednessError(
                f"{place}: the denominator {write(denominator)} vanishes in the range, near "
                f"{near}, or comes too close to zero to tell. Narrow the range or write the "
                "quantity without the division."
            )


LABELS = ("mass", "inertia.xx", "inertia.yy", "inertia.zz", "actuator_inertia", "reflected_inertia")
_KEEPS_SIGN = re.compile(
    r"mass|length|density|area|(shear_)?modulus|I_[yz]|torsion_constant|shear_coefficient"
    r"|(mass|stiffness)_damping|mode\d+\.(frequency|damping)|actuator_inertia(\..+)?|reflected_inertia"
)
_TINY = 1e-280  # what is zero for all values is not negative
_ZERO = Number(0.0)


class Condition(NamedTuple):
    """An expression that must not be negative: whose it is, what it is, and its size at nominal."""

    owner: str
    what: str
    expression: Expression
    size: float

    @property
    def slack(self) -> float:
        """How far rounding of the data may make it negative."""
        return _ROUNDING * self.size + _TINY


class Outcome(NamedTuple):
    """A condition with what is known of its sign; its points and parts are in units of the parameters."""

    condition: Condition
    names: tuple[str, ...]
    sign: Sign


def check_positive(scene: Scene, boxes: int = BOXES) -> tuple[Outcome, ...]:
    """What is known of the conditions that depend on parameters after a look at `boxes` parts of each."""
    known = _Names.of(scene)
    nominal = _nominal_values(known)
    outcomes = []
    items: list[Body | Joint] = [*scene.bodies, *scene.joints]
    for condition in (c for item in items for c in conditions(item, nominal)):
        used = tuple(sorted(names(condition.expression) & known.plain.keys()))
        if not used:
            value = float(evaluate(condition.expression, nominal))
            sign = Sign() if value >= -condition.slack else Sign({}, value)
        else:
            sign = _sign(known, condition, {name: known.plain[name] for name in used}, boxes)
            outcomes.append(Outcome(condition, used, sign))
        if sign.point is not None:
            raise SceneError(_failure(condition, sign, known.plain))
    return tuple(outcomes)


def _sign(known: _Names, condition: Condition, parameters: Mapping[str, Parameter], boxes: int) -> Sign:
    """By intervals over the whole range, if they are enough; else at samples, and by parts."""
    factors = {name: p.factor for name, p in parameters.items()}
    bounds = {name: (p.low, p.high) for name, p in parameters.items()}
    constants = known.constants

    def value(at: Mapping[str, Any]) -> Any:
        return evaluate(condition.expression, {**constants, **{n: x * factors[n] for n, x in at.items()}})

    whole = {name: Interval(*ends) * factors[name] for name, ends in bounds.items()}
    values_of = {**{name: decimal(float(x)) for name, x in constants.items()}, **whole}
    if Interval.of(evaluate(condition.expression, values_of, decimal, FUNCTIONS)).low >= -condition.slack:
        return Sign()
    samples = _samples(known, bounds)
    values = _at_all(samples, evaluate(condition.expression, samples))
    worst = int(np.argmin(values))
    if values[worst] < -condition.slack:
        point = {name: float(np.asarray(samples[name])[worst]) / factors[name] for name in bounds}
        return Sign(point, float(values[worst]))
    return not_negative(value, bounds, condition.slack, boxes)


def _failure(condition: Condition, sign: Sign, parameters: Mapping[str, Parameter]) -> str:
    where = ", ".join(
        f"{name} = {at:.9g} {parameters[name].unit}".removesuffix(" 1")
        for name, at in (sign.point or {}).items()
    )
    where = f" in the range, at {where}: {sign.value:.3g}. Narrow the ranges, or correct the expression."
    values = where if sign.point else f": {sign.value:.3g}. Correct the values."
    return f"{condition.owner}: {condition.what}{values}"


def conditions(item: Body | Joint, nominal: Mapping[str, float]) -> Iterator[Condition]:
    """All conditions of a body or a joint, with sizes at nominal values (SI) by name."""
    quantities = item.quantities()
    for label, expected in quantities.items():
        if not _KEEPS_SIGN.fullmatch(label):
            continue
        expression = expression_at(Place(owner_name(item), label), expected)
        size = abs(float(evaluate(expression, nominal)))
        yield Condition(owner_name(item), f"{label} [{expected.unit}] is negative", expression, size)
    if isinstance(item, Body):
        yield from inertia_conditions(item, quantities, nominal)


def nominal_values(scene: Scene) -> dict[str, float]:
    """Values (SI) by name of the constants, and at nominal of the parameters that are no angles."""
    return _nominal_values(_Names.of(scene))


def _nominal_values(known: _Names) -> dict[str, float]:
    return known.constants | {name: p.nominal * p.factor for name, p in known.plain.items()}


def extreme_quantities(scene: Scene) -> str:
    """The quantity whose size at nominal is farthest from 1, and others at least half as far."""
    values, far = nominal_values(scene), dict[str, float]()
    for owner, quantities in owners(scene):
        for label, expected in quantities.items():
            expression = expression_at(Place(owner, label), expected)
            if expected.unit != "rad" and names(expression) <= values.keys():
                size = abs(float(evaluate(expression, values)))
                said = "" if isinstance(expected.source, float) else f"{expected.source!r} = "
                text = f"{owner}: {label} = {said}{size:g} {expected.unit}"
                far[text] = abs(math.log10(size or 1.0))
    farthest = max(far.values(), default=0.0)
    return ", ".join(sorted((t for t in far if 2.0 * far[t] >= farthest), key=lambda t: -far[t]))


def inertia_conditions(
    body: Body, quantities: Mapping[str, Expected], nominal: Mapping[str, float]
) -> Iterator[Condition]:
    """Those of the inertia of a body, if it has one that is to be checked."""
    inertia = getattr(body, "inertia", None)
    if inertia is None or inertia.unchecked:
        return
    owner = owner_name(body)
    expressions = {
        label: expression_at(Place(owner, label), expected)
        for label, expected in quantities.items()
        if expected.unit != "rad"
    }
    center = inertia.about == "center_of_mass"
    point = "center_of_mass" if center else body.port_label(inertia.about)
    about = [expressions[f"{point}.{a}"] if point else _ZERO for a in AXES]
    for what, expression, factors in _of_inertia(expressions, about):
        size = float(np.prod([abs(float(evaluate(factor, nominal))) for factor in factors]))
        yield Condition(owner, what, expression, size)


_Terms = Iterator[tuple[str, Expression, list[Expression]]]


def _of_inertia(expressions: Mapping[str, Expression], about: list[Expression]) -> _Terms:
    """Conditions of an inertia, and what their products are made of."""
    d = [_sum(expressions[f"center_of_mass.{a}"], about[k], "-") for k, a in enumerate(AXES)]
    J: dict[str, Expression] = {}
    for i, a in enumerate(AXES):
        for j, b in enumerate(AXES[i:], start=i):
            if (label := f"inertia.{a}{b}") in expressions:
                first, second = (_product(d[k], d[k]) for k in range(3) if k != i)
                steiner = _sum(first, second, "+") if i == j else _product(d[i], d[j])
                sign = "-" if i == j else "+"
                J[a + b] = _sum(expressions[label], _product(expressions["mass"], steiner), sign)
    if len(J) < 6:
        for name in ("xx", "yy", "zz"):
            if name in J:
                what = f"inertia.{name} [kg m^2] about the center of mass is negative"
                yield what, J[name], [expressions[f"inertia.{name}"]]
        return
    yield from _second_moments(J)


def _second_moments(J: Mapping[str, Expression]) -> _Terms:
    """Principal minors of P; P is made without halves."""
    x, y, z = J["xx"], J["yy"], J["zz"]
    P = (_without(y, z, x), _without(z, x, y), _without(x, y, z))
    trace = _sum(_sum(x, y, "+"), z, "+")
    for k, (name, entry) in enumerate(zip(("x", "y", "z"), P, strict=True)):
        first, second = [other for j, other in enumerate(("xx", "yy", "zz")) if j != k]
        what = f"inertia.{first} + inertia.{second} - inertia.{name * 2} [kg m^2] about the center of"
        yield f"{what} mass is negative (triangle inequality)", entry, [trace]
    twice = {name: _product(Number(2.0), J[name]) for name in ("xy", "xz", "yz")}
    xy, xz, yz = twice["xy"], twice["xz"], twice["yz"]
    if xy == xz == yz == _ZERO:
        return
    what = "a minor of the second moments of mass that follow from the inertia is negative"
    for i, j, entry in ((0, 1, xy), (0, 2, xz), (1, 2, yz)):
        if entry != _ZERO:
            minor = _sum(_product(P[i], P[j]), _product(entry, entry), "-")
            yield what, minor, [trace] * 2
    # the entries outside the diagonal are -2 J_ij, and their product is -8 J_xy J_xz J_yz
    inner = _sum(_product(P[1], P[2]), _product(yz, yz), "-")
    whole = _sum(_product(P[0], inner), _product(P[1], _product(xz, xz)), "-")
    whole = _sum(whole, _product(P[2], _product(xy, xy)), "-")
    whole = _sum(whole, _product(Number(2.0), _product(xy, _product(xz, yz))), "-")
    yield what, whole, [trace] * 3


def _without(a: Expression, b: Expression, c: Expression) -> Expression:
    """a + b - c, where one of the first two may be the last."""
    if c in (a, b):
        return b if a == c else a
    return _sum(_sum(a, b, "+"), c, "-")


def _sum(a: Expression, b: Expression, operator: str) -> Expression:
    """a + b or a - b; equal terms cancel, and zeros are left out."""
    if b == _ZERO:
        return a
    if operator == "-" and a == b:
        return _ZERO
    if operator == "+" and a == _ZERO:
        return b
    return Binary(operator, a, b)


def _product(a: Expression, b: Expression) -> Expression:
    """A product; with a zero it is zero."""
    return _ZERO if _ZERO in (a, b) else Binary("*", a, b)
