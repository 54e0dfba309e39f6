"""Limits of joints: the equilibrium must be inside the limits for every value of the parameters."""

from collections.abc import Mapping
from itertools import product
from typing import NamedTuple

import numpy as np

from mbdlft.base.description import Expected, Quantity
from mbdlft.base.errors import SceneError
from mbdlft.base.expression import names
from mbdlft.base.parameter import Parameter
from mbdlft.base.unit import parse_unit
from mbdlft.multibody.scene.quantities import Place, angle_at, expression_at, value_at
from mbdlft.multibody.scene.scene import Scene

_ROUNDING = 1e-12  # a position may leave a limit by this part of it


class JointLimit(NamedTuple):
    """Limits of a joint; None where the file has none.

    `lower` and `upper` limit the position in `unit` (rad or m), `effort` the effort (N m or N) and `rate`
    the velocity (rad/s or m/s).
    """

    joint: str
    unit: str
    lower: float | None
    upper: float | None
    effort: float | None
    rate: float | None


def check_limits(scene: Scene, positions: Mapping[JointLimit, Quantity]) -> None:
    """Raise a SceneError for the first joint whose position leaves its limits for some parameters."""
    for limit, position in positions.items():
        if limit.lower is None or limit.upper is None:
            continue
        low, high = position_range(scene, limit.joint, Expected(position, limit.unit))
        below, above = (_ROUNDING * abs(end) for end in (limit.lower, limit.upper))
        if low < limit.lower - below or high > limit.upper + above:
            raise SceneError(
                f"joint {limit.joint!r}, position = {position!r}: its values [{_both(low, limit.unit)}, "
                f"{_both(high, limit.unit)}] leave the limits of the file "
                f"[{_both(limit.lower, limit.unit)}, {_both(limit.upper, limit.unit)}]. Narrow the range "
                "of its parameters, or change the limits in the file."
            )


def position_range(scene: Scene, joint: str, expected: Expected) -> tuple[float, float]:
    """Least and largest equilibrium position (rad or m) over the ranges of the parameters.

    The range of a sum of angles is exact; other positions are evaluated at the corners.
    """
    place = Place(f"joint {joint!r}", "position")
    parameters = {p.name: p for p in scene.parameters}
    if expected.unit == "rad":
        angle = angle_at(scene, place, expected)
        ends = [
            sorted(count * bound for bound in _bounds(parameters[name]))
            for name, count in angle.multiples.items()
        ]
        return (
            angle.constant + sum(end[0] for end in ends),
            angle.constant + sum(end[1] for end in ends),
        )
    used = sorted(names(expression_at(place, expected)) & set(parameters))
    values_at_corners = [
        float(
            value_at(
                place, expected, scene.constant_values() | dict(zip(used, corner, strict=True))
            )
        )
        for corner in product(*(_bounds(parameters[name]) for name in used))
    ]
    return min(values_at_corners), max(values_at_corners)


def _bounds(parameter: Parameter) -> tuple[float, float]:
    """Low and high of a parameter in SI units."""
    factor = parse_unit(parameter.unit).factor
    return parameter.low * factor, parameter.high * factor


def _both(value: float, unit: str) -> str:
    """A value as a text for a message, with that in degrees if it is an angle."""
    if unit != "rad":
        return f"{value:.6g} {unit}"
    return f"{value:.6g} rad = {np.degrees(value):.6g} deg"
