"""Clusters of reaction or momentum wheels as pieces of a scene.

    J = J_t 1 + (J_a - J_t) e e',        e e' = a a'/(a.a)        of a wheel along the axis a

With whole numbers or decimals for a, the entries are exact, so that a wheel is symmetric about its axis
whatever the inertias are. Source of the arrangements: Markley, Crassidis, Fundamentals of Spacecraft
Attitude Determination and Control (2014), section 7.3.4.
"""

from collections.abc import Sequence
from fractions import Fraction
from typing import NamedTuple, TypeVar

from mbdlft.base.description import AXES
from mbdlft.base.errors import SceneError
from mbdlft.exact.numbers import decimal
from mbdlft.multibody.body import Inertia, RigidBody
from mbdlft.multibody.joint import Revolute

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

    Raises
    ------
    SceneError
        The arrangement is unknown, or there are not as many ports or rates as wheels.
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
        joints.append(
            Revolute(
                name=f"{name}{k}",
                parent=port,
                child=f"{name}{k}_rotor",
                axis=axis,
                rate=rate,
                damping=damping,
            )
        )
    return WheelCluster(tuple(bodies), tuple(joints))


def _each(name: str, what: str, given: Sequence[T], count: int) -> Sequence[T]:
    if len(given) != count:
        raise SceneError(
            f"wheel cluster {name!r}: {len(given)} {what} for {count} wheels. Give one, or one for each."
        )
    return given


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
            entries[first + second] = (
                (axial if share == 1 else across if i == j else 0.0)
                if share in (0, 1)
                else f"({across}) + {text}"
                if i == j
                else text
            )
    return Inertia(**entries)
