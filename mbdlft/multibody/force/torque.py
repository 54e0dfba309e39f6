"""A torque about a direction, on the body of a port."""

from typing import ClassVar, final

import casadi as ca

from mbdlft.base.description import Expected, Quantity, Values
from mbdlft.base.signal import Signal
from mbdlft.multibody.force.base import BodyWrench, DirectedLoad, Space
from mbdlft.multibody.force.force import directed


@final
class Torque(DirectedLoad):
    """A torque of `magnitude` (N m) about `direction` on the body of `port`.

    `frame` is ``body`` (the torque turns with the body) or ``ground`` (it keeps its direction).
    """

    kind: ClassVar[str] = "torque"
    signal: ClassVar[Signal] = Signal("torque", "N m")
    magnitude_key: ClassVar[str] = "magnitude"

    magnitude: Quantity | None = None

    def quantities(self) -> dict[str, Expected]:
        return {} if self.magnitude is None else {"magnitude": Expected(self.magnitude, "N m")}

    def wrenches(self, values: Values, magnitude: ca.SX, space: Space) -> list[BodyWrench]:
        body, _ = space.port(self.port)
        torque = directed(self.direction, self.frame, body, space) * magnitude
        return [BodyWrench(body, ca.horzcat(ca.SX(3, 1), torque))]
