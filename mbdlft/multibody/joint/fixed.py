"""A fixed joint: it has no degree of freedom and may turn the child by a constant angle about an axis."""

from typing import ClassVar, final

from mbdlft.base.description import Direction, Expected, Quantity, Values
from mbdlft.base.signal import Freedom
from mbdlft.multibody.joint.base import AxisJoint
from mbdlft.multibody.joint.move import Move, turned
from mbdlft.multibody.spatial import Coordinate


@final
class Fixed(AxisJoint):
    """The child's port is clamped on the parent's port, turned by `position` (rad) about `axis`."""

    kind: ClassVar[str] = "fixed"
    freedoms: ClassVar[tuple[Freedom, ...]] = ()

    axis: Direction = (1.0, 0.0, 0.0)
    position: Quantity = 0.0

    def own_quantities(self) -> dict[str, Expected]:
        return {"position": Expected(self.position, "rad")}

    def own_moves(self, values: Values, at: Coordinate) -> tuple[Move, ...]:
        return turned(self.direction(), values["position"])
