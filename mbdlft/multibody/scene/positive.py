"""Masses, moments of inertia and section data that must not be negative, over the whole range.

Samples miss a disc of a hundredth of the range. Here each condition is an expression of the parameters
that is enclosed over the range: proved, or refuted at a point, or open. The conditions of an inertia
are those of a distribution of mass that is not negative: with J about the center of mass, the matrix
P = tr(J)/2 - J of its second moments is positive semidefinite, so its principal minors are not negative.
That makes J positive semidefinite, too, and its principal moments satisfy the triangle inequality.
"""

import re
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

from mbdlft.base.description import AXES
from mbdlft.base.errors import SceneError
from mbdlft.base.expression import Binary, Expression, Number, evaluate, names
from mbdlft.base.parameter import Parameter
from mbdlft.exact.interval import FUNCTIONS, Interval, decimal
from mbdlft.exact.taylor import BOXES, Sign, not_negative
from mbdlft.multibody.body import Body
from mbdlft.multibody.joint import Joint
from mbdlft.multibody.scene.quantities import Place, expression_at, owner_name
from mbdlft.multibody.scene.scene import Scene

LABELS = ("mass", "inertia.xx", "inertia.yy", "inertia.zz", "actuator_inertia", "reflected_inertia")
_KEEPS_SIGN = re.compile(
    r"mass|length|density|area|(shear_)?modulus|I_[yz]|torsion_constant|shear_coefficient"
    r"|(mass|stiffness)_damping|mode\d+\.(frequency|damping)|actuator_inertia(\..+)?|reflected_inertia"
)
_ROUNDING = 1e-12  # of the size at nominal: what rounding may make negative
_TINY = 1e-280  # what is zero for all values is not negative
_ZERO = Number(0.0)


class Condition(NamedTuple):
    """An expression that must not be negative: whose it is, what it is, and its size at nominal."""

    owner: str
    what: str
    expression: Expression
    size: float


class Outcome(NamedTuple):
    """A condition with what is known of its sign; its points and parts are in units of the parameters."""

    condition: Condition
    names: tuple[str, ...]
    sign: Sign


def check_positive(scene: Scene, boxes: int = BOXES) -> tuple[Outcome, ...]:
    """What is known of the conditions that depend on parameters, after looking at so many parts of each.

    Raises
    ------
    SceneError
        One of them fails at a point of the range.
    """
    parameters = {p.name: p for p in scene.parameters if not p.is_angle}
    found = []
    items: list[Body | Joint] = [*scene.bodies, *scene.joints]
    for item in items if parameters else ():
        for condition in _conditions(scene, item):
            used = tuple(sorted(names(condition.expression) & parameters.keys()))
            if used:
                own = {name: parameters[name] for name in used}
                sign = _sign(condition, own, scene.constant_values(), boxes)
                if sign.point is not None:
                    raise SceneError(_failure(condition, sign, own))
                found.append(Outcome(condition, used, sign))
    return tuple(found)


def _sign(
    condition: Condition,
    parameters: Mapping[str, Parameter],
    constants: Mapping[str, float],
    boxes: int,
) -> Sign:
    """By intervals over the whole range, if they are enough; else by parts."""
    factors = {name: p.factor for name, p in parameters.items()}
    bounds = {name: (p.low, p.high) for name, p in parameters.items()}
    slack = _ROUNDING * condition.size + _TINY

    def value(at: Mapping[str, Any]) -> Any:
        return evaluate(
            condition.expression, {**constants, **{n: x * factors[n] for n, x in at.items()}}
        )

    whole = {name: Interval(*ends) * factors[name] for name, ends in bounds.items()}
    known = {**{name: decimal(float(x)) for name, x in constants.items()}, **whole}
    if Interval.of(evaluate(condition.expression, known, decimal, FUNCTIONS)).low >= -slack:
        return Sign()
    return not_negative(value, bounds, slack, boxes)


def _failure(condition: Condition, sign: Sign, parameters: Mapping[str, Parameter]) -> str:
    where = ", ".join(
        f"{name} = {at:.9g} {parameters[name].unit}".removesuffix(" 1")
        for name, at in (sign.point or {}).items()
    )
    return (
        f"{condition.owner}: {condition.what} in the range, at {where}: {sign.value:.3g}. Narrow the "
        "ranges, or correct the expression."
    )


def _conditions(scene: Scene, item: Body | Joint) -> Iterator[Condition]:
    """All conditions of a body or a joint."""
    owner = owner_name(item)
    own = {
        label: expression_at(Place(owner, label), expected)
        for label, expected in item.quantities().items()
        if expected.unit != "rad"
    }
    nominal = dict(scene.constant_values())
    for p in scene.parameters:
        if not p.is_angle:
            nominal[p.name] = p.nominal * p.factor

    def size(expression: Expression) -> float:
        return abs(float(evaluate(expression, nominal)))

    for label, expression in own.items():
        if _KEEPS_SIGN.fullmatch(label):
            unit = item.quantities()[label].unit
            what = f"{label} [{unit}] is negative"
            yield Condition(owner, what, expression, size(expression))
    inertia = getattr(item, "inertia", None)
    if isinstance(item, Body) and inertia is not None and not inertia.unchecked:
        center = inertia.about == "center_of_mass"
        point = "center_of_mass" if center else item.port_label(inertia.about)
        about = [own[f"{point}.{a}"] if point else _ZERO for a in AXES]
        for what, expression, factors in _of_inertia(own, about):
            product = 1.0
            for factor in factors:
                product *= size(factor)
            yield Condition(owner, what, expression, product)


_Terms = Iterator[tuple[str, Expression, list[Expression]]]


def _of_inertia(own: Mapping[str, Expression], about: list[Expression]) -> _Terms:
    """Conditions of an inertia, and what their products are made of."""
    d = [_sum(own[f"center_of_mass.{a}"], about[k], "-") for k, a in enumerate(AXES)]
    J: dict[str, Expression] = {}
    for i, a in enumerate(AXES):
        for j, b in enumerate(AXES[i:], start=i):
            if (label := f"inertia.{a}{b}") in own:
                first, second = (_product(d[k], d[k]) for k in range(3) if k != i)
                steiner = _sum(first, second, "+") if i == j else _product(d[i], d[j])
                sign = "-" if i == j else "+"
                J[a + b] = _sum(own[label], _product(own["mass"], steiner), sign)
    if len(J) < 6:
        for name in ("xx", "yy", "zz"):
            if name in J:
                what = f"inertia.{name} [kg m^2] about the center of mass is negative"
                yield what, J[name], [own[f"inertia.{name}"]]
        return
    yield from _second_moments(J)


def _second_moments(J: Mapping[str, Expression]) -> _Terms:
    """Principal minors of P; P is made without halves."""
    x, y, z = J["xx"], J["yy"], J["zz"]
    P = (_without(y, z, x), _without(z, x, y), _without(x, y, z))
    trace = _sum(_sum(x, y, "+"), z, "+")
    for k, (name, entry) in enumerate(zip(("x", "y", "z"), P, strict=True)):
        left, right = [other for j, other in enumerate(("xx", "yy", "zz")) if j != k]
        what = f"inertia.{left} + inertia.{right} - inertia.{name * 2} [kg m^2] about the center of"
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
