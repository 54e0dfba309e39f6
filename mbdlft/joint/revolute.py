"""A revolute joint: one rotation about an axis.

    effort = axis . torque + J axis . alpha + stiffness q + damping qdot

J is the inertia of the actuator, which turns with the child: Kassarian et al. 2023, equation (7).
"""

from typing import ClassVar, final

from mbdlft.description import Quantity, Values
from mbdlft.joint.base import AxisJoint, MovingJoint, turning
from mbdlft.joint.move import Hinge, Move, turned
from mbdlft.signal import Freedom
from mbdlft.spatial import Coordinate


@final
class Revolute(AxisJoint, MovingJoint):
    """A rotation about `axis`; `position` (rad), N m/rad, N m s/rad, kg m^2, `preload` (N m)."""

    kind: ClassVar[str] = "revolute"
    freedoms: ClassVar[tuple[Freedom, ...]] = (turning(),)

    position: Quantity = 0.0
    stiffness: Quantity = 0.0
    damping: Quantity = 0.0
    actuator_inertia: Quantity = 0.0
    preload: Quantity | None = None

    def own_moves(self, values: Values, at: Coordinate) -> tuple[Move, ...]:
        axis = self.direction()
        return (
            *turned(axis, values["position"]),
            Hinge(axis, at.part(0), values["actuator_inertia"]),
        )
