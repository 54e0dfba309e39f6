"""A force along a direction at a port: a thrust turns with its body, a constant pull does not."""

from typing import ClassVar, final

import casadi as ca

from mbdlft.base.description import Direction, Expected, Quantity, Values
from mbdlft.base.signal import Signal
from mbdlft.multibody.force.base import BodyWrench, DirectedLoad, Space
from mbdlft.multibody.spatial import move_wrench
from mbdlft.sx.constants import unit_vector


@final
class Force(DirectedLoad):
    """A force of `magnitude` (N) along `direction` at `port`.

    `frame` is ``body`` (the force turns with the body) or ``ground`` (it keeps its direction).
    """

    kind: ClassVar[str] = "force"
    signal: ClassVar[Signal] = Signal("force", "N")
    magnitude_key: ClassVar[str] = "magnitude"

    magnitude: Quantity | None = None

    def quantities(self) -> dict[str, Expected]:
        return {} if self.magnitude is None else {"magnitude": Expected(self.magnitude, "N")}

    def wrenches(self, values: Values, magnitude: ca.SX, space: Space) -> list[BodyWrench]:
        body, r = space.port(self.port)
        force = directed(self.direction, self.frame, body, space) * magnitude
        return [BodyWrench(body, move_wrench(ca.horzcat(force, ca.SX(3, 1)), r))]


def directed(direction: Direction, frame: str, body: str, space: Space) -> ca.SX:
    """Unit vector (3,), in the axes of a body, along a direction of the frame ``body`` or ``ground``."""
    unit = unit_vector(direction)
    return unit if frame == "body" else space.outward(unit, body)
