"""The report of an import: what the scene does not have of the file, and the file not of the scene.

The limits of joints are in it; the equilibrium must be inside them for every value of the parameters.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product
from math import atan
from typing import NamedTuple

import numpy as np

from mbdlft.base.description import Expected, Quantity
from mbdlft.base.errors import SceneError
from mbdlft.base.expression import evaluate, names
from mbdlft.multibody.scene.quantities import Place, angle_at, expression_at
from mbdlft.multibody.scene.scene import Scene
from mbdlft.robot.description import Robot
from mbdlft.robot.values import AXIAL

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


@dataclass(frozen=True, slots=True)
class ImportReport:
    """The differences between the file of a robot and the scene that was made of it.

    Attributes
    ----------
    ignored : tuple of str
        Contents of the file that the scene does not have: geometry, friction, transmissions, ...
    assumed : tuple of str
        Contents of the scene that the file does not have: gravity, positions, right angles, names, ...
    limits : tuple of JointLimit
        Limits of the joints that turn or slide: position (rad or m), effort (N m or N), rate (rad/s
        or m/s).
    """

    ignored: tuple[str, ...]
    assumed: tuple[str, ...]
    limits: tuple[JointLimit, ...]

    def __str__(self) -> str:
        lines = [f"ignored: {line}" for line in self.ignored]
        return "\n".join(lines + [f"assumed: {line}" for line in self.assumed])


def ignored_of(robot: Robot, moves: frozenset[str]) -> tuple[str, ...]:
    """Sentences on the contents of the file that the scene does not have."""
    joints = [joint for joint in robot.joints.values() if joint.name in moves]
    ignored = [f"<{tag}>: {count}" for tag, count in robot.others.items()] + [*robot.ignored]
    rubbing = [joint.name for joint in joints if joint.friction]
    if rubbing:
        ignored.append(f"Coulomb friction of {', '.join(rubbing)}: it is not linear")
    bounded = [joint.name for joint in joints if joint.effort or joint.velocity]
    if bounded:
        ignored.append(
            f"limits of effort and velocity of {len(bounded)} joints; the report has them"
        )
    coupled = [joint.name for joint in joints if joint.mimic and joint.kind in AXIAL]
    if coupled:
        ignored.append(
            f"<mimic> of {', '.join(coupled)}: their positions follow their leaders, their motions are "
            "free; leave them out of `moving` to lock them"
        )
    planar = [joint.name for joint in joints if joint.kind == "planar" and joint.damping]
    if planar:
        ignored.append(f"damping of {', '.join(planar)}: give it in the scene")
    return tuple(ignored)


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
    """Least and largest equilibrium position (rad or m) at the corners of the range of the parameters.

    For a sum of angles these are the ends of its range.
    """
    place = Place(f"joint {joint!r}", "position")
    expression = expression_at(place, expected)
    angle = angle_at(scene, place, expected) if expected.unit == "rad" else None

    def position(values: Mapping[str, float]) -> float:
        if angle is None:
            return float(evaluate(expression, values))
        turned = sum(count * values[name] for name, count in angle.multiples.items())
        halves = angle.arctangents.items()
        return angle.constant + turned + sum(n * atan(evaluate(r, values)) for r, n in halves)

    used = [p for p in scene.parameters if p.name in names(expression)]
    ends = [[(p.name, end * p.factor) for end in (p.low, p.high)] for p in used]
    positions = [position(scene.constant_values() | dict(corner)) for corner in product(*ends)]
    return min(positions), max(positions)


def _both(value: float, unit: str) -> str:
    """A value as a text for a message, with that in degrees if it is an angle."""
    if unit != "rad":
        return f"{value:.6g} {unit}"
    return f"{value:.6g} rad = {np.degrees(value):.6g} deg"
