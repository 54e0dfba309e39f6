"""Devices as pieces of a scene: an array drive, wheel clusters, liquid in a tank.

A wheel along the axis a has the inertia

    J = J_t 1 + (J_a - J_t) e e',        e e' = a a'/(a.a)

With whole numbers or decimals for a, the entries are exact, so that a wheel is symmetric about its axis
whatever the inertias are. Source of the arrangements: Markley, Crassidis, Fundamentals of Spacecraft
Attitude Determination and Control (2014), section 7.3.4.

Liquid sloshes in its first lateral mode, in a rigid upright cylinder of radius R with a flat bottom and
liquid of height h, as a pendulum or as a mass on a spring:

    w^2 = (g x/R) tanh(x h/R),                  x = 1.8412, the first zero of J_1'
    m_1 = m 2 R tanh(x h/R)/(x (x^2 - 1) h),    m the mass of the liquid
    H_1 = h/2 - (2 R/x) tanh(x h/(2 R))         of m_1 above the center of the liquid, at rest on a spring
    L   = g/w^2 = (R/x) coth(x h/R)             of the pendulum, whose hinge is at H_1 + L

The rest, m - m_1, is below, so that the center of the liquid is kept. Sources: Abramson (editor), The
Dynamic Behavior of Liquids in Moving Containers, NASA SP-106 (1966), chapter 6; Dodge, The New "Dynamic
Behavior of Liquids in Moving Containers" (2000), table 3.1.
"""

from collections.abc import Sequence
from fractions import Fraction
from math import tanh
from typing import NamedTuple, TypeVar

from mbdlft.base.description import AXES
from mbdlft.base.errors import SceneError
from mbdlft.base.expression import Number, parse
from mbdlft.exact.numbers import decimal
from mbdlft.multibody.body import Inertia, PointMass, RigidBody
from mbdlft.multibody.joint import Fixed, Prismatic, Revolute, Rotation, Universal


class ArrayDrive(NamedTuple):
    """Pieces of a scene: one body without mass, and the joints before and behind it."""

    body: RigidBody
    motor: Revolute
    shaft: Revolute


def array_drive(
    name: str,
    parent: str,
    child: str,
    axis: Sequence[float],
    *,
    rotor_inertia: float | str,
    gear_ratio: float | str,
    stiffness: float | str,
    damping: float | str = 0.0,
    friction: float | str = 0.0,
    position: float | str = 0.0,
    orientation: tuple[Rotation, ...] = (),
) -> ArrayDrive:
    """A motor on `parent`, a gear without backlash, and a shaft with stiffness that carries `child`.

    With q the angle behind the gear and e the twist of the shaft,

        J n (alpha_parent + n qddot) = torque of the motor behind the gear + k e + d edot - c qdot

    Parameters
    ----------
    name : str
        Of the joint of the motor; its effort ``NAME.torque`` (N m) acts behind the gear and is n times
        that of the motor itself. The shaft is ``NAME_shaft``, the body between them ``NAME_gear``.
    parent, child : str
        Ports, ``body`` or ``body.port``.
    axis : three numbers
    rotor_inertia : number or expression, J of the rotor about the axis (kg m^2)
    gear_ratio : number or expression, n: turns of the rotor for one of the array
    stiffness, damping : numbers or expressions, k (N m/rad) and d (N m s/rad) of the shaft and the gear
    friction : number or expression, viscous, c (N m s/rad) behind the gear
    position : number or expression (rad), of the array; it may be an `Angle`
    orientation : rotations before the joint, as of any joint

    Returns
    -------
    ArrayDrive
        `body`, `motor`, `shaft`: for the bodies and joints of a `Scene`.
    """
    between = f"{name}_gear"
    return ArrayDrive(
        body=RigidBody(name=between, mass=0.0, inertia=Inertia(xx=0.0, yy=0.0, zz=0.0)),
        motor=Revolute(
            name=name,
            parent=parent,
            child=between,
            axis=axis,
            orientation=orientation,
            position=position,
            damping=friction,
            actuator_inertia=rotor_inertia,
            gear_ratio=gear_ratio,
        ),
        shaft=Revolute(
            name=f"{name}_shaft",
            parent=between,
            child=child,
            axis=axis,
            stiffness=stiffness,
            damping=damping,
        ),
    )


T = TypeVar("T")

WHEEL_AXES: dict[str, tuple[Sequence[float], ...]] = {
    "orthogonal": ((1, 0, 0), (0, 1, 0), (0, 0, 1)),
    "nasa": ((1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 1)),
    "pyramid": ((1, 0, 1), (0, 1, 1), (-1, 0, 1), (0, -1, 1)),
}


class WheelCluster(NamedTuple):
    """Pieces of a scene: wheels, and the joints on which they turn."""

    bodies: tuple[RigidBody, ...]
    joints: tuple[Revolute, ...]


def wheel_cluster(
    name: str,
    parent: str | Sequence[str],
    axes: str | Sequence[Sequence[float]],
    *,
    mass: float | str,
    axial: float | str,
    across: float | str,
    rates: float | str | Sequence[float | str] = 0.0,
    damping: float | str = 0.0,
) -> WheelCluster:
    """Wheels ``NAME1``, ``NAME2``, ... on one body, each with a steady rate about its axis.

    Parameters
    ----------
    name : str
        The wheels are the bodies ``NAME1_rotor`` on the joints ``NAME1``; their torques
        ``NAME1.torque`` (N m) are the inputs.
    parent : port, or one for each wheel, of the body that carries them
    axes : directions in the axes of the parent, or an arrangement
        ``orthogonal``; ``nasa``, the standard of NASA with a fourth wheel at equal angles to three
        orthogonal ones; ``pyramid``, four wheels at 45 degrees from z.
    mass : number or expression (kg), of one wheel
    axial, across : numbers or expressions (kg m^2), about the axis and across it
    rates : number or expression (rad/s), or one for each wheel
    damping : number or expression (N m s/rad), of each bearing

    Returns
    -------
    WheelCluster
        `bodies` and `joints`, for those of a `Scene`.
    """
    if isinstance(axes, str) and axes not in WHEEL_AXES:
        raise SceneError(
            f"wheel cluster {name!r}: unknown arrangement {axes!r}. Known: {', '.join(WHEEL_AXES)}; or "
            "give a list of directions."
        )
    directions = WHEEL_AXES[axes] if isinstance(axes, str) else tuple(axes)
    count = len(directions)
    ports = _each(name, "ports", (parent,) * count if isinstance(parent, str) else parent, count)
    many = isinstance(rates, Sequence) and not isinstance(rates, str)
    turning = _each(name, "rates", rates if many else (rates,) * count, count)  # type: ignore[arg-type]
    bodies, joints = [], []
    for k, (axis, port, rate) in enumerate(zip(directions, ports, turning, strict=True), start=1):
        bodies.append(
            RigidBody(name=f"{name}{k}_rotor", mass=mass, inertia=_inertia(axis, axial, across))
        )
        ends = {"parent": port, "child": f"{name}{k}_rotor"}
        joints.append(Revolute(name=f"{name}{k}", **ends, axis=axis, rate=rate, damping=damping))
    return WheelCluster(tuple(bodies), tuple(joints))


def _each(name: str, what: str, items: Sequence[T], count: int) -> Sequence[T]:
    if len(items) != count:
        raise SceneError(
            f"wheel cluster {name!r}: {len(items)} {what} for {count} wheels. Give one, or one for each."
        )
    return items


def _inertia(axis: Sequence[float], axial: float | str, across: float | str) -> Inertia:
    """About the axis; the entries are written with fractions, which are exact."""
    a = [decimal(entry) for entry in axis]
    square = sum((entry * entry for entry in a), Fraction(0))
    if not square:
        raise SceneError(f"axis has zero length, got {list(axis)}. Give a direction.")
    entries: dict[str, float | str] = {}
    for i, first in enumerate(AXES):
        for j, second in enumerate(AXES[i:], start=i):
            share = a[i] * a[j] / square
            text = f"({share.numerator}/{share.denominator})*(({axial}) - ({across}))"
            if share in (0, 1):
                entries[first + second] = axial if share else across if i == j else 0.0
            else:
                entries[first + second] = f"({across}) + {text}" if i == j else text
    return Inertia(**entries)


ZERO = 1.841183781340659  # of the derivative of the Bessel function J_1


class SloshData(NamedTuple):
    """Of the first lateral mode: the share of the mass that sloshes, its height above the center of the
    liquid on a spring (m), the length of the pendulum (m), and w^2/g (1/m)."""

    share: float
    height: float
    length: float
    frequency_squared: float


class SloshTank(NamedTuple):
    """Pieces of a scene."""

    bodies: tuple[RigidBody | PointMass, ...]
    joints: tuple[Fixed | Universal | Prismatic, ...]


def slosh_data(radius: float, height: float) -> SloshData:
    """Mechanical analogy of the first mode in a cylinder of a radius filled to a height (m)."""
    if not (radius > 0.0 and height > 0.0):
        raise SceneError(
            f"slosh: expected a radius and a height that are positive, got {radius:g} m and {height:g} m."
        )
    deep = tanh(ZERO * height / radius)
    return SloshData(
        share=2.0 * radius * deep / (ZERO * (ZERO**2 - 1.0) * height),
        height=height / 2.0 - 2.0 * radius / ZERO * tanh(ZERO * height / (2.0 * radius)),
        length=radius / (ZERO * deep),
        frequency_squared=ZERO / radius * deep,
    )


def slosh_tank(
    name: str,
    parent: str,
    *,
    radius: float,
    height: float,
    mass: float | str,
    damping: float | str = 0.0,
    acceleration: float | str | None = None,
) -> SloshTank:
    """The liquid of a tank that stands along z of its carrier, as a pendulum, or on springs.

    Parameters
    ----------
    name : str
        The liquid that does not slosh is ``NAME_rest``, held at its center by the joint ``NAME_held``;
        what sloshes is ``NAME_liquid`` on the joint ``NAME``, a universal one about x and y, or
        prismatic ones ``NAME_x`` and ``NAME_y``.
    parent : port at the middle of the bottom of the tank, z upward
    radius, height : of the tank and of the liquid (m); numbers
    mass : number or expression (kg), of the liquid
    damping : number or expression (N m s/rad), or (N s/m) with springs
    acceleration : number or expression (m/s^2), optional
        Felt along z. Without it the liquid is a pendulum, which finds it in the equilibrium of the scene;
        with it, a mass on springs m_1 w^2.

    Returns
    -------
    SloshTank
        `bodies` and `joints`, for those of a `Scene`.
    """
    data = slosh_data(radius, height)
    mass, acceleration = _with_unit(mass, "kg"), acceleration and _with_unit(acceleration, "m/s^2")
    moving, center = f"{data.share!r}*({mass})", height / 2.0
    still = f"(1 - {data.share!r})*({mass})"
    below = -data.share * data.height / (1.0 - data.share)
    inertia = Inertia(xx=0.0, yy=0.0, zz=0.0)
    settled = RigidBody(
        name=f"{name}_rest", mass=still, center_of_mass=(0, 0, center + below), inertia=inertia
    )
    held = Fixed(name=f"{name}_held", parent=parent, child=settled.name)
    top = center + data.height
    if acceleration is None:
        hinge = settled.model_copy(update={"ports": {"hinge": (0.0, 0.0, top + data.length)}})
        bob = PointMass(name=f"{name}_liquid", mass=moving, ports={"hinge": (0.0, 0.0, data.length)})
        swing = Universal(
            name=name,
            parent=f"{settled.name}.hinge",
            child=f"{bob.name}.hinge",
            axis1=(1, 0, 0),
            axis2=(0, 1, 0),
            damping=(damping, damping),
            preload=(0.0, 0.0),
        )
        return SloshTank((hinge, bob), (held, swing))
    stiffness = f"{data.share * data.frequency_squared!r} [1/m]*({mass})*({acceleration})"
    placed = settled.model_copy(update={"ports": {"surface": (0.0, 0.0, top)}})
    between = RigidBody(name=f"{name}_slider", mass=0.0, inertia=inertia)
    bob = PointMass(name=f"{name}_liquid", mass=moving)
    along = {"stiffness": stiffness, "damping": damping, "preload": 0.0}
    first = Prismatic(
        name=f"{name}_x", parent=f"{settled.name}.surface", child=between.name, axis=(1, 0, 0), **along
    )
    second = Prismatic(name=f"{name}_y", parent=between.name, child=bob.name, axis=(0, 1, 0), **along)
    return SloshTank((placed, between, bob), (held, first, second))


def _with_unit(value: float | str, unit: str) -> str:
    """A quantity for products: a plain number has the unit written behind it."""
    expression = parse(value)
    is_plain = isinstance(expression, Number) and expression.unit is None
    return f"{value} [{unit}]" if is_plain else str(value)
