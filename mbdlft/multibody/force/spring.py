"""A spring and damper between two ports.

    f_a = h r + ((k - h) r'dr + c r'dr_dot) r / (r'r)

f_a is the force on the port a, r the vector from a to the other port b, dr its change from the
equilibrium; k is the stiffness, c the damping. The force density h is the tension over the length at
equilibrium. With h, the geometric stiffness h and the elastic stiffness (k - h) r r'/(r'r) are rational
in the parameters: the length, a square root, does not appear.
"""

from typing import ClassVar, Self, final

import casadi as ca
from pydantic import model_validator

from mbdlft.base.description import Expected, Quantity, Text, Values
from mbdlft.base.errors import SceneError
from mbdlft.base.signal import Signal
from mbdlft.multibody.force.base import BodyWrench, Load, Space
from mbdlft.multibody.spatial import move_wrench


@final
class Spring(Load):
    """A spring with `stiffness` (N/m) and a damper with `damping` (N s/m) between two ports.

    `force_density` (N/m), tension over length, gives the tension at equilibrium. `rest_length` (m) may
    give it instead if the distance of the ports at equilibrium does not depend on parameters. With
    neither of them the trim solves for the force density.
    """

    kind: ClassVar[str] = "spring"
    signal: ClassVar[Signal] = Signal("force_density", "N/m")
    magnitude_key: ClassVar[str] = "force_density"

    parent: Text
    child: Text
    stiffness: Quantity = 0.0
    damping: Quantity = 0.0
    force_density: Quantity | None = None
    rest_length: Quantity | None = None

    @model_validator(mode="after")
    def _one_law(self) -> Self:
        if self.force_density is not None and self.rest_length is not None:
            raise SceneError(
                "give rest_length or force_density, not both: each says what the tension is at "
                "equilibrium."
            )
        return self

    def ports(self) -> dict[str, str]:
        return {"parent": self.parent, "child": self.child}

    def quantities(self) -> dict[str, Expected]:
        quantities = {
            "stiffness": Expected(self.stiffness, "N/m"),
            "damping": Expected(self.damping, "N s/m"),
        }
        if self.force_density is not None:
            quantities["force_density"] = Expected(self.force_density, "N/m")
        if self.rest_length is not None:
            quantities["rest_length"] = Expected(self.rest_length, "m")
        return quantities

    def wrenches(self, values: Values, magnitude: ca.SX, space: Space) -> list[BodyWrench]:
        wrenches = []
        for a, b in ((self.parent, self.child), (self.child, self.parent)):
            body, at = space.port(a)
            r = space.between_at_rest(a, b)
            along = (values["stiffness"] - magnitude) * ca.dot(r, space.departure(a, b, 0))
            along = space.elastic * along + values["damping"] * ca.dot(r, space.departure(a, b, 1))
            force = space.between(a, b) * magnitude + r * (along / ca.dot(r, r))
            wrenches.append(BodyWrench(body, move_wrench(ca.horzcat(force, ca.SX(3, 1)), at)))
        return wrenches
