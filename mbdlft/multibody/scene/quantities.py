"""The quantities of a scene: their places, expressions and values, in any number system.

A quantity that is an angle is a sum of a constant, integer multiples of parameters that are angles, and
even multiples of arctangents of rational expressions r of other parameters. The cosine and sine of the
last are rational:

    cos(2 atan r) = (1 - r^2)/(1 + r^2),   sin(2 atan r) = 2 r/(1 + r^2)
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from types import MappingProxyType
from typing import Any, NamedTuple, TypeVar

import numpy as np

from mbdlft.base.description import ANY_UNIT, Expected, Quantity, vector_quantities
from mbdlft.base.errors import MbdlftError, NotRationalError, SceneError
from mbdlft.base.expression import (
    Binary,
    Call,
    Expression,
    Name,
    Negative,
    Number,
    evaluate,
    names,
    parse,
    walk,
    with_calls,
    write,
)
from mbdlft.base.unit import Exponents, dimension_name, parse_unit
from mbdlft.exact.operators import FUNCTIONS_OF_DIMENSIONS as DIMENSIONS
from mbdlft.exact.operators import Dimension, Operators
from mbdlft.multibody.body import Body
from mbdlft.multibody.contact import Contact
from mbdlft.multibody.coupling import Coupling
from mbdlft.multibody.force import Load
from mbdlft.multibody.joint import Joint
from mbdlft.multibody.loop import Loop
from mbdlft.multibody.scene.scene import UNKNOWN, Constant, Scene

T = TypeVar("T")

_PLAIN: Exponents = (0, 0, 0, 0, 0)  # of a plain number
_MOST_TURNS = 16
_INTEGER = (
    "an angle parameter can be multiplied by an integer only. Declare the fraction of the angle as the "
    "parameter."
)


class Place(NamedTuple):
    """The place of a quantity in its scene: its owner in words, and its label."""

    owner: str
    label: str

    def __str__(self) -> str:
        return f"{self.owner}, {self.label}"


@dataclass(frozen=True, slots=True)
class AngleSum(Operators):
    """An angle (rad): a constant, and multiples of parameters and of arctangents.

    The multiples are integers in the end; on the way, as in 0.2*th/0.1, they are fractions.
    """

    constant: float = 0.0
    multiples: Mapping[str, Any] = field(default_factory=dict)  # by name of the parameter
    arctangents: Mapping[Expression, Any] = field(default_factory=dict)  # by the expression r of atan(r)

    def whole(self) -> "AngleSum":
        """The sum with integer multiples; a NotRationalError if one is a fraction."""
        counts = [*self.multiples.values(), *self.arctangents.values()]
        if any(Fraction(count).denominator != 1 for count in counts):
            raise NotRationalError(_INTEGER)
        return AngleSum(
            self.constant,
            {name: int(count) for name, count in self.multiples.items()},
            {tangent: int(count) for tangent, count in self.arctangents.items()},
        )

    def __add__(self, other: "AngleSum | float") -> "AngleSum":
        if isinstance(other, float):
            return AngleSum(self.constant + other, self.multiples, self.arctangents)
        return AngleSum(
            self.constant + other.constant,
            _summed(self.multiples, other.multiples),
            _summed(self.arctangents, other.arctangents),
        )

    def __mul__(self, other: "AngleSum | float") -> "AngleSum":
        if not isinstance(other, float):
            raise NotRationalError(_INTEGER)
        return self._times(other, Fraction(repr(other)))

    def __neg__(self) -> "AngleSum":
        return self * -1.0

    def __truediv__(self, other: "AngleSum | float") -> "AngleSum":
        if not isinstance(other, float) or other == 0.0:
            raise NotRationalError(_INTEGER)
        return self._times(1.0 / other, 1 / Fraction(repr(other)))

    def __rtruediv__(self, other: object) -> "AngleSum":
        raise NotRationalError(_INTEGER)

    def _times(self, factor: float, exact: Fraction) -> "AngleSum":
        return AngleSum(
            self.constant * factor,
            {name: count * exact for name, count in self.multiples.items()},
            {tangent: count * exact for tangent, count in self.arctangents.items()},
        )


def _summed(first: Mapping[T, Any], second: Mapping[T, Any]) -> dict[T, Any]:
    merged = dict(first)
    for key, count in second.items():
        merged[key] = merged.get(key, 0) + count
    return merged


def owners(scene: Scene) -> Iterator[tuple[str, Mapping[str, Expected]]]:
    """The scene and its items, but for sensors, in words, with their quantities by label."""
    gravity = vector_quantities("gravity", scene.gravity, "m s^-2")
    x, y, z = (0.0 if entry == UNKNOWN else entry for entry in scene.acceleration)
    acceleration = vector_quantities("acceleration", (x, y, z), "m s^-2")
    spin = {"spin.rate": Expected(scene.spin.rate, "rad/s")} if scene.spin else {}
    velocity = vector_quantities("velocity", scene.velocity, "m/s")
    yield f"scene {scene.name!r}", gravity | acceleration | velocity | spin
    items: list[Body | Joint | Load | Loop | Contact] = [*scene.bodies, *scene.joints, *scene.loads]
    for item in [*items, *scene.loops, *scene.contacts]:
        yield owner_name(item), item.quantities()
    for coupling in scene.couplings:
        yield owner_name(coupling), coupling.quantities(scene.joints)


def unused_names(scene: Scene) -> tuple[str, ...]:
    """Parameters and constants that no quantity uses."""
    used = {
        name
        for _, quantities in owners(scene)
        for expected in quantities.values()
        for name in names(parse(expected.source))
    }
    declared = (*(p.name for p in scene.parameters), *scene.constants)
    return tuple(name for name in declared if name not in used)


def unused_ports(scene: Scene) -> tuple[str, ...]:
    """Declared ports, ``body.port``, that no joint, load, sensor, loop or inertia names."""
    named = {
        port
        for item in [*scene.joints, *scene.loads, *scene.sensors, *scene.loops, *scene.contacts]
        for key in ("parent", "child", "port")
        if (port := getattr(item, key, None))
    }
    abouts = {
        f"{body.name}.{inertia.about}"
        for body in scene.bodies
        if (inertia := getattr(body, "inertia", None)) is not None
    }
    declared = (f"{body.name}.{port}" for body in scene.bodies for port in body.ports)
    return tuple(port for port in declared if port not in named | abouts)


def owner_name(item: Body | Joint | Load | Loop | Coupling | Contact) -> str:
    """The words by which error messages name a body, a joint, a load, and so on."""
    return f"{item.noun} {item.name!r}"


def expression_at(place: Place, expected: Expected) -> Expression:
    """Expression of one quantity; an error names its place."""
    try:
        return parse(expected.source)
    except SceneError as error:
        raise SceneError(f"{place} = {expected.source!r}: {error}") from None


def value_at(
    place: Place,
    expected: Expected,
    values: Mapping[str, Any],
    number: Callable[[float], Any] = lambda value: value,
    functions: Mapping[str, Callable[..., Any]] = MappingProxyType({}),
) -> Any:
    """Value of one quantity, as by `evaluate`; an error names its place."""
    if isinstance(expected.source, float):
        return number(expected.source)
    expression = expression_at(place, expected)
    try:
        return evaluate(expression, values, number, functions)
    except MbdlftError as error:
        raise type(error)(f"{place} = {expected.source!r}: {error}") from None


def angle_at(scene: Scene, place: Place, expected: Expected) -> AngleSum:
    """Value of a quantity that is an angle (rad)."""
    angles = {p.name for p in scene.parameters if p.is_angle}
    others = {p.name for p in scene.parameters} - angles
    expression, arctangents = _without_arctangents(expression_at(place, expected), angles | others)
    for tangent in arctangents.values():
        turned = sorted(names(tangent) & angles)
        if turned:
            raise NotRationalError(
                f"{place} = {expected.source!r}: atan of the angle {turned[0]!r}. atan takes an "
                "expression of parameters that are not angles; angles stand by themselves."
            )
    wrong = sorted(names(expression) & others)
    if wrong:
        raise SceneError(
            f"{place} = {expected.source!r}: {wrong[0]!r} is not an angle. Give the parameter the "
            "unit 'deg' or 'rad' (in Python: declare it as an Angle). A rational expression r of "
            "other parameters makes the angle 2*atan(r)."
        )
    values = scene.constant_values() | {name: AngleSum(0.0, {name: 1}) for name in angles}
    values |= {name: AngleSum(0.0, {}, {r: 1}) for name, r in arctangents.items()}
    try:
        value = evaluate(expression, values)
        angle = value.whole() if isinstance(value, AngleSum) else AngleSum(float(value))
    except MbdlftError as error:
        raise type(error)(f"{place} = {expected.source!r}: {error}") from None
    if abs(angle.constant) > 2.0 * np.pi * (1.0 + 1e-12) and "[" not in str(expected.source):
        raise SceneError(
            f"{place} = {expected.source!r}: {angle.constant:g} rad is more than a full turn. Numbers "
            f"are in rad; write degrees as {angle.constant:g}*deg, or the unit: "
            f"{angle.constant:g} [rad]."
        )
    for name, count in angle.multiples.items():
        if abs(count) > _MOST_TURNS:
            raise SceneError(
                f"{place} = {expected.source!r}: {count} times {name!r}; each multiple is one more "
                f"rotation, and {_MOST_TURNS} is the most. Declare the multiple as a parameter."
            )
    for tangent, count in angle.arctangents.items():
        if count % 2:
            raise NotRationalError(
                f"{place} = {expected.source!r}: {count} times atan({write(tangent)}); only even "
                "multiples of atan have a rational cosine and sine. Write 2*atan(r) with r the tangent "
                "of half the angle."
            )
        if abs(count) > 2 * _MOST_TURNS:
            raise SceneError(
                f"{place} = {expected.source!r}: {count} times atan({write(tangent)}); each 2*atan is "
                f"one more rotation, and {_MOST_TURNS} is the most."
            )
    return angle


def _without_arctangents(
    expression: Expression, parameters: set[str]
) -> tuple[Expression, dict[str, Expression]]:
    """An expression with names in place of arctangents of `parameters`, and their arguments by name."""
    arguments: dict[str, Expression] = {}

    def replaced(call: Call) -> Expression | None:
        if call.function != "atan" or not names(call.argument) & parameters:
            return None
        name = f"atan({write(call.argument)})"
        arguments[name] = call.argument
        return Name(name)

    return with_calls(expression, replaced), arguments


# units -----------------------------------------------------------------------------------------


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


def check_dimension(
    place: Place, expected: Expected, expression: Expression, dimensions: Mapping[str, Any]
) -> None:
    """Raise a SceneError if the dimension of a quantity does not fit."""
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
            + _missing_unit(expected, expression, dimensions, value.exponents or _PLAIN)
        )


def _missing_unit(
    expected: Expected, expression: Expression, dimensions: Mapping[str, Any], got: Exponents
) -> str:
    """What may have been forgotten: the unit of a parameter, or that of a factor."""
    wanted = parse_unit(expected.unit).dimension
    factor = tuple(a - b for a, b in zip(wanted, got, strict=True))
    missing, plain = dimension_name(factor), Dimension(_PLAIN)
    bare = sorted(name for name in names(expression) if dimensions[name] == plain)
    if bare:
        listed, unit = " and ".join(map(repr, bare)), expected.unit if not any(got) else missing
        return (
            f" {listed} {'have' if bare[1:] else 'has'} no unit: declare "
            f"{'one of them' if bare[1:] else 'it'} with unit = {unit!r}, or give a number a unit, "
            f"such as 1 [{unit}]*{bare[0]}."
        )
    divisors = [
        node.right for node in walk(expression) if isinstance(node, Binary) and node.operator == "/"
    ]
    if any(isinstance(each, Number) and each.unit is not None for each in divisors):
        return (
            " A unit belongs to the number before it: behind a divisor it divides. Write the unit of the "
            f"whole behind the first number, such as 1.0 [{expected.unit}]/2.0."
        )
    if _has_factor(expression):
        return (
            " A number that multiplies a value with a unit is a plain factor. Where the factor has a "
            f"unit, write it behind the number, such as 2.0 [{missing}], or declare a constant with it."
        )
    return ""


def _has_factor(expression: Expression) -> bool:
    """Whether a number is a factor in an expression, as its user may have meant it with a unit."""
    products = (node for node in walk(expression) if isinstance(node, Binary) and node.operator in "*/")
    sides = (side for node in products for side in (node.left, node.right))
    return any(isinstance(side.operand if isinstance(side, Negative) else side, Number) for side in sides)
