"""Buoyancy: the weight of the displaced fluid, against gravity, at the center of buoyancy."""

from typing import ClassVar, final

import casadi as ca

from mbdlft.base.description import Expected, Quantity, Text, Values
from mbdlft.base.signal import Signal
from mbdlft.multibody.force.base import BodyWrench, Load, Space
from mbdlft.multibody.spatial import move_wrench


@final
class Buoyancy(Load):
    """A force of minus `displaced_mass` times gravity at `port`, the center of buoyancy.

    `displaced_mass` (kg) is the density of the fluid times the displaced volume.
    """

    kind: ClassVar[str] = "buoyancy"
    signal: ClassVar[Signal] = Signal("displaced_mass", "kg")
    magnitude_key: ClassVar[str] = "displaced_mass"

    port: Text
    displaced_mass: Quantity | None = None

    def ports(self) -> dict[str, str]:
        return {"port": self.port}

    def quantities(self) -> dict[str, Expected]:
        given = self.displaced_mass
        return {} if given is None else {"displaced_mass": Expected(given, "kg")}

    def wrenches(self, values: Values, magnitude: ca.SX, space: Space) -> list[BodyWrench]:
        body, r = space.port(self.port)
        force = -space.outward(space.gravity, body) * magnitude
        return [BodyWrench(body, move_wrench(ca.horzcat(force, ca.SX(3, 1)), r))]
