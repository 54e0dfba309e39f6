"""A force of one magnitude along a direction, at a port: thrust (in the body) or a pull in the scene."""

from typing import ClassVar, final

import casadi as ca
import numpy as np

from mbdlft.base.description import Direction, Expected, Quantity, Values
from mbdlft.base.signal import Signal
from mbdlft.multibody.force.base import BodyWrench, DirectedLoad, Space
from mbdlft.multibody.spatial import move_wrench


@final
class Force(DirectedLoad):
    """`magnitude` (N) along `direction` at `port`; `frame` is ``body`` (follower) or ``ground``."""

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
    """Unit vector (3,) of a direction in the axes of a body."""
    unit = ca.sparsify(ca.SX(np.asarray(direction) / np.linalg.norm(direction)))
    return unit if frame == "body" else space.outward(unit, body)
