"""A universal joint: a rotation about an axis of the parent, then about one that the first turns."""

from typing import ClassVar, Self, final

import numpy as np
from pydantic import field_validator, model_validator

from mbdlft.base.description import Direction, Quantity, Values
from mbdlft.base.errors import SceneError
from mbdlft.base.signal import Freedom
from mbdlft.multibody.joint.base import MovingJoint, turning, unit_vector, with_length
from mbdlft.multibody.joint.move import Hinge, Move, turned
from mbdlft.multibody.spatial import Coordinate

Pair = tuple[Quantity, Quantity]


@final
class Universal(MovingJoint):
    """The child turns about `axis1`, and about `axis2`, which the first rotation turns.

    Each quantity is a pair: the first entry is for `axis1`, the second for `axis2`.
    """

    kind: ClassVar[str] = "universal"
    freedoms: ClassVar[tuple[Freedom, ...]] = (turning("1", ".1"), turning("2", ".2"))

    axis1: Direction = (1.0, 0.0, 0.0)
    axis2: Direction = (0.0, 1.0, 0.0)
    position: Pair = (0.0, 0.0)
    stiffness: Pair = (0.0, 0.0)
    damping: Pair = (0.0, 0.0)
    actuator_inertia: Pair = (0.0, 0.0)
    preload: Pair | None = None

    @field_validator("axis1", "axis2")
    @classmethod
    def _has_length(cls, axis: Direction) -> Direction:
        return with_length("axis", axis)

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
