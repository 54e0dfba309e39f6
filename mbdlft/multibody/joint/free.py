"""A free joint: no constraint, but three translations and a small rotation vector, so 12 states."""

from typing import ClassVar, final

import casadi as ca

from mbdlft.base.description import AXES, Quantity, Values, Vector
from mbdlft.base.signal import Freedom
from mbdlft.multibody.joint.base import Joint, MovingJoint, sliding, turning
from mbdlft.multibody.joint.move import Ball, Move, Slide, shifted
from mbdlft.multibody.spatial import Coordinate

Six = tuple[Quantity, Quantity, Quantity, Quantity, Quantity, Quantity]
_NONE = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


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
