"""Slosh of a liquid in an upright cylindrical tank, as a pendulum or as a mass on a spring.

First lateral mode of a rigid circular cylinder of radius R with a flat bottom and liquid of height h:

    w^2 = (g x/R) tanh(x h/R),                  x = 1.8412, the first zero of J_1'
    m_1 = m 2 R tanh(x h/R)/(x (x^2 - 1) h),    m the mass of the liquid
    H_1 = h/2 - (2 R/x) tanh(x h/(2 R))         of m_1 above the center of the liquid, at rest on a spring
    L   = g/w^2 = (R/x) coth(x h/R)             of the pendulum, whose hinge is at H_1 + L

The rest, m - m_1, is below, so that the center of the liquid is kept. Sources: Abramson (editor), The
Dynamic Behavior of Liquids in Moving Containers, NASA SP-106 (1966), chapter 6; Dodge, The New "Dynamic
Behavior of Liquids in Moving Containers" (2000), table 3.1.
"""

from math import tanh
from typing import NamedTuple

from mbdlft.base.errors import SceneError
from mbdlft.multibody.body import Inertia, PointMass, RigidBody
from mbdlft.multibody.joint import Fixed, Prismatic, Universal

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
    """Mechanical analogy of the first mode in a cylinder of a radius filled to a height (m).

    Raises
    ------
    SceneError
        One of them is not positive.
    """
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

    Raises
    ------
    SceneError
        A size is not positive.
    """
    data = slosh_data(radius, height)
    moving, center = f"{data.share!r}*({mass})", height / 2.0
    still = f"(1 - {data.share!r})*({mass})"
    below = -data.share * data.height / (1.0 - data.share)
    inertia = Inertia(xx=0.0, yy=0.0, zz=0.0)
    rest = RigidBody(
        name=f"{name}_rest", mass=still, center_of_mass=(0, 0, center + below), inertia=inertia
    )
    held = Fixed(name=f"{name}_held", parent=parent, child=rest.name)
    top = center + data.height
    if acceleration is None:
        hinge = rest.model_copy(update={"ports": {"hinge": (0.0, 0.0, top + data.length)}})
        bob = PointMass(
            name=f"{name}_liquid", mass=moving, ports={"hinge": (0.0, 0.0, data.length)}
        )
        swing = Universal(
            name=name,
            parent=f"{rest.name}.hinge",
            child=f"{bob.name}.hinge",
            axis1=(1, 0, 0),
            axis2=(0, 1, 0),
            damping=(damping, damping),
            preload=(0.0, 0.0),
        )
        return SloshTank((hinge, bob), (held, swing))
    stiffness = f"{data.share * data.frequency_squared!r} [1/m]*({mass})*({acceleration})"
    placed = rest.model_copy(update={"ports": {"surface": (0.0, 0.0, top)}})
    between = RigidBody(name=f"{name}_slider", mass=0.0, inertia=inertia)
    bob = PointMass(name=f"{name}_liquid", mass=moving)
    along = {"stiffness": stiffness, "damping": damping, "preload": 0.0}
    first = Prismatic(
        name=f"{name}_x",
        parent=f"{rest.name}.surface",
        child=between.name,
        axis=(1, 0, 0),
        **along,
    )
    second = Prismatic(
        name=f"{name}_y", parent=between.name, child=bob.name, axis=(0, 1, 0), **along
    )
    return SloshTank((placed, between, bob), (held, first, second))
