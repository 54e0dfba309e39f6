"""A fixed joint: no degree of freedom; it may hold a rotation about an axis."""

from typing import ClassVar, final

import casadi as ca

from mbdlft.description import Direction, Expected, Quantity, Values
from mbdlft.joint.base import AxisJoint, Coordinate, Turn
from mbdlft.spatial import rotate, rotate_back


@final
class Fixed(AxisJoint):
    """The child's port is clamped on the parent's, turned by `position` (rad) about `axis`."""

    kind: ClassVar[str] = "fixed"
    degrees_of_freedom: ClassVar[int] = 0
    effort: ClassVar[None] = None
    measures: ClassVar[tuple[tuple[str, str], ...]] = ()

    axis: Direction = (1.0, 0.0, 0.0)
    position: Quantity = 0.0

    def quantities(self) -> dict[str, Expected]:
        return {"position": Expected(self.position, "rad")}

    def motion(
        self,
        motion: ca.SX,
        values: Values,
        turns: list[Turn],
        coordinate: Coordinate,
    ) -> ca.SX:
        for turn in turns:
            motion = rotate_back(self.direction(), *turn, motion)
        return motion

    def wrench(
        self,
        wrench: ca.SX,
        values: Values,
        turns: list[Turn],
        coordinate: Coordinate,
    ) -> ca.SX:
        for turn in reversed(turns):
            wrench = rotate(self.direction(), *turn, wrench)
        return wrench

    def resistance(self, wrench: ca.SX, values: Values, coordinate: Coordinate) -> ca.SX:
        return ca.SX(0, 1)
