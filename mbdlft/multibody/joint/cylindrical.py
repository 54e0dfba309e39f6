"""A cylindrical joint: a translation along an axis and a rotation about it."""

from typing import ClassVar, final

from mbdlft.base.description import Quantity, Values
from mbdlft.base.signal import Freedom
from mbdlft.multibody.joint.base import AxisJoint, MovingJoint, sliding, turning
from mbdlft.multibody.joint.move import Hinge, Move, Slide, shifted, steady_hinge, turned
from mbdlft.multibody.spatial import Coordinate

Pair = tuple[Quantity, Quantity]


@final
class Cylindrical(AxisJoint, MovingJoint):
    """The child moves along `axis` (m) and then turns about it (rad).

    Each quantity is a pair: the first entry is for the translation, the second for the rotation.
    """

    kind: ClassVar[str] = "cylindrical"
    freedoms: ClassVar[tuple[Freedom, ...]] = (sliding("position"), turning("angle"))

    position: Pair = (0.0, 0.0)
    stiffness: Pair = (0.0, 0.0)
    damping: Pair = (0.0, 0.0)
    actuator_inertia: Pair = (0.0, 0.0)
    preload: Pair | None = None

    def own_moves(self, values: Values, at: Coordinate) -> tuple[Move, ...]:
        axis = self.direction()
        return (
            *shifted(axis * values["position.position"]),
            Slide(axis, at.part(0), values["actuator_inertia.position"]),
            *turned(axis, values["position.angle"]),
            steady_hinge(Hinge(axis, at.part(1), values["actuator_inertia.angle"]), values),
        )
