"""A prismatic joint: one translation along an axis.

    effort = axis . f_c + m qddot + stiffness q + damping qdot

f_c is the force that the child needs, m the mass that the actuator moves along the axis relative to the
parent (a reflected inertia).
"""

from typing import ClassVar, final

from mbdlft.base.description import Quantity, Values
from mbdlft.base.signal import Freedom
from mbdlft.multibody.joint.base import AxisJoint, MovingJoint, sliding
from mbdlft.multibody.joint.move import Move, Slide, shifted
from mbdlft.multibody.spatial import Coordinate


@final
class Prismatic(AxisJoint, MovingJoint):
    """The child moves along `axis`.

    Units: `position` m, `stiffness` N/m, `damping` N s/m, `actuator_inertia` kg, `preload` N.
    """

    kind: ClassVar[str] = "prismatic"
    freedoms: ClassVar[tuple[Freedom, ...]] = (sliding(),)

    position: Quantity = 0.0
    stiffness: Quantity = 0.0
    damping: Quantity = 0.0
    actuator_inertia: Quantity = 0.0
    preload: Quantity | None = None

    def own_moves(self, values: Values, at: Coordinate) -> tuple[Move, ...]:
        axis = self.direction()
        return (
            *shifted(axis * values["position"]),
            Slide(axis, at.part(0), values["actuator_inertia"]),
        )
