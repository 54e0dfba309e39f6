"""A spring and damper between two ports.

    f_a = h r + ((k - h) r'dr + c r'dr_dot) r / (r'r),      r from a to b, f_a the force on a

h = tension/length at equilibrium is the force density: with it the geometric stiffness h and the elastic
stiffness (k - h) r r'/(r'r) are rational in the parameters, and no length, a square root, is needed.
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
    """From port `parent` to port `child`: `stiffness` (N/m), `damping` (N s/m).

    Its tension at equilibrium is given by `force_density` (N/m), tension over length, or by
    `rest_length` (m) where the ports have one distance for all parameters; with neither the
    trim solves for the force density.
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
        found = {
            "stiffness": Expected(self.stiffness, "N/m"),
            "damping": Expected(self.damping, "N s/m"),
        }
        if self.force_density is not None:
            found["force_density"] = Expected(self.force_density, "N/m")
        if self.rest_length is not None:
            found["rest_length"] = Expected(self.rest_length, "m")
        return found

    def wrenches(self, values: Values, magnitude: ca.SX, space: Space) -> list[BodyWrench]:
        found = []
        for a, b in ((self.parent, self.child), (self.child, self.parent)):
            body, at = space.port(a)
            r = space.between_at_rest(a, b)
            along = (values["stiffness"] - magnitude) * ca.dot(r, space.departure(a, b, 0))
            along = space.elastic * along + values["damping"] * ca.dot(r, space.departure(a, b, 1))
            force = space.between(a, b) * magnitude + r * (along / ca.dot(r, r))
            found.append(BodyWrench(body, move_wrench(ca.horzcat(force, ca.SX(3, 1)), at)))
        return found
