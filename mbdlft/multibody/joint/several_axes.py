"""Joints that turn about several axes: universal, spherical, and free with six coordinates.

A spherical joint turns about a point by a small rotation vector q (3,), with

    effort = tau_c + J vdot + stiffness q + damping v

All vectors are in the axes of the child: its relative angular velocity v, the torque tau_c that it needs,
and the inertia J of the actuators, one for each axis.
"""

from typing import ClassVar, Self, final

import casadi as ca
import numpy as np
from pydantic import model_validator

from mbdlft.base.description import AXES, Axis, Quantity, Values, Vector
from mbdlft.base.errors import SceneError
from mbdlft.base.unit import Freedom
from mbdlft.multibody.joint.base import Joint, MovingJoint, sliding, turning, unit_vector
from mbdlft.multibody.joint.move import Ball, Hinge, Move, Slide, shifted, turned
from mbdlft.multibody.spatial import Coordinate

Pair = tuple[Quantity, Quantity]
Triple = tuple[Quantity, Quantity, Quantity]
Six = tuple[Quantity, Quantity, Quantity, Quantity, Quantity, Quantity]
_NONE = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


@final
class Universal(MovingJoint):
    """The child turns about `axis1`, and about `axis2`, which the first rotation turns.

    Each quantity is a pair: the first entry is for `axis1`, the second for `axis2`.
    """

    kind: ClassVar[str] = "universal"
    freedoms: ClassVar[tuple[Freedom, ...]] = (turning("1", ".1"), turning("2", ".2"))

    axis1: Axis = (1.0, 0.0, 0.0)
    axis2: Axis = (0.0, 1.0, 0.0)
    position: Pair = (0.0, 0.0)
    stiffness: Pair = (0.0, 0.0)
    damping: Pair = (0.0, 0.0)
    actuator_inertia: Pair = (0.0, 0.0)
    preload: Pair | None = None

    @model_validator(mode="after")
    def _axes_are_two(self) -> Self:
        if not np.any(np.cross(self.axis1, self.axis2)):
            raise SceneError(
                f"axis1 {list(self.axis1)} and axis2 {list(self.axis2)} are parallel, which is "
                "one rotation. Give two directions, or use a revolute joint."
            )
        return self

    def own_moves(self, values: Values, at: Coordinate) -> tuple[Move, ...]:
        axes = (unit_vector(self.axis1), unit_vector(self.axis2))
        moves: tuple[Move, ...] = ()
        for k, (label, axis) in enumerate(zip("12", axes, strict=True)):
            moves += turned(axis, values[f"position.{label}"])
            moves += (Hinge(axis, at.part(k), values[f"actuator_inertia.{label}"]),)
        return moves


@final
class Spherical(MovingJoint):
    """The child turns about the point where the ports meet; `orientation` is that of the equilibrium.

    Each quantity has three entries, for the axes x, y and z of the child.
    """

    kind: ClassVar[str] = "spherical"
    freedoms: ClassVar[tuple[Freedom, ...]] = tuple(
        turning(axis, f".{axis}", of="rotation") for axis in AXES
    )

    stiffness: Triple = (0.0, 0.0, 0.0)
    damping: Triple = (0.0, 0.0, 0.0)
    actuator_inertia: Triple = (0.0, 0.0, 0.0)
    preload: Triple | None = None

    def own_moves(self, values: Values, at: Coordinate) -> tuple[Move, ...]:
        inertia = ca.SX(ca.vertcat(*(values[f"actuator_inertia.{axis}"] for axis in AXES)))
        return (Ball(at, inertia),)


@final
class Free(MovingJoint):
    """The child moves freely: three translations, then a rotation by a small rotation vector.

    The translations (m) are along the axes of the parent's port; the components of the rotation vector
    (rad) are in the axes of the child. `position` (m) and `orientation` are those of the equilibrium.
    Each other quantity has six entries: x, y, z of the translation, then x, y, z of the rotation. Nothing
    holds a free body, so its `preload` is zero unless it is given.
    """

    kind: ClassVar[str] = "free"
    freedoms: ClassVar[tuple[Freedom, ...]] = (
        *(sliding(axis, f".{axis}") for axis in AXES),
        *(turning(f"r{axis}", f".{axis}", of="rotation") for axis in AXES),
    )

    position: Vector = (0.0, 0.0, 0.0)
    stiffness: Six = _NONE
    damping: Six = _NONE
    preload: Six = _NONE

    def moves(self, values: Values, at: Coordinate) -> tuple[Move, ...]:
        """The moves of the joint; the translations, in the axes of the parent's port, come first."""
        place = ca.SX(ca.vertcat(*(values[f"position.{axis}"] for axis in AXES)))
        slides = (Slide(ca.SX.eye(3)[:, k], at.part(k)) for k in range(3))
        turned = Joint.moves(self, values, at)
        return (*shifted(place), *slides, *turned)

    def own_moves(self, values: Values, at: Coordinate) -> tuple[Move, ...]:
        return (Ball(at.part(slice(3, 6)), ca.SX.zeros(3)),)
