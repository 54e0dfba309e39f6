"""A spring and damper along a direction that the parent keeps, whatever the child does across it.

    f = f0 - k (s - s0) - c s_dot,        s = n . r

f is the force on the child along the unit vector n, which turns with the parent; r is the vector from
the port of the parent to that of the child, f0 and s0 are the values at equilibrium. The reaction acts
on the parent at the port of the child, as that of a guide without mass: the potential is that of s
alone. So a tire carries its wheel and does not push it aside, where a spring between two ports leans.
"""

from typing import ClassVar, final

import casadi as ca
from pydantic import field_validator

from mbdlft.base.description import Direction, Expected, Quantity, Text, Values
from mbdlft.base.signal import Signal
from mbdlft.multibody.force.base import BodyWrench, Load, Space, with_length
from mbdlft.multibody.spatial import move_wrench
from mbdlft.sx.constants import unit_vector


@final
class Strut(Load):
    """A spring with `stiffness` (N/m) and a damper with `damping` (N s/m) along `direction`.

    `direction` is in the axes of the body of `parent`, and turns with it. `force` (N) is what acts on the
    child along it at equilibrium; without it the trim solves for it. Motions across it make no force.
    """

    kind: ClassVar[str] = "strut"
    signal: ClassVar[Signal] = Signal("force", "N")
    magnitude_key: ClassVar[str] = "force"

    parent: Text
    child: Text
    direction: Direction
    stiffness: Quantity = 0.0
    damping: Quantity = 0.0
    force: Quantity | None = None

    _has_length = field_validator("direction")(with_length)

    def ports(self) -> dict[str, str]:
        return {"parent": self.parent, "child": self.child}

    def quantities(self) -> dict[str, Expected]:
        quantities = {
            "stiffness": Expected(self.stiffness, "N/m"),
            "damping": Expected(self.damping, "N s/m"),
        }
        if self.force is not None:
            quantities["force"] = Expected(self.force, "N")
        return quantities

    def wrenches(self, values: Values, magnitude: ca.SX, space: Space) -> list[BodyWrench]:
        along = unit_vector(self.direction)
        stretch, rate = (
            ca.dot(along, space.departure(self.parent, self.child, order)) for order in (0, 1)
        )
        size = magnitude - space.elastic * values["stiffness"] * stretch - values["damping"] * rate
        body, at = space.port(self.parent)
        other, there = space.port(self.child)
        force = along * size
        at = at + space.between(self.parent, self.child)
        on_child = space.across_now(force, body, other)
        return [
            BodyWrench(body, move_wrench(ca.horzcat(-force, ca.SX(3, 1)), at)),
            BodyWrench(other, move_wrench(ca.horzcat(on_child, ca.SX(3, 1)), there)),
        ]
