"""Closures of kinematic loops: constraints between two ports of the tree, with multipliers.

    0 = G q,  0 = G v,  0 = G vdot,      and G' lambda is added to the equations of motion

A closure keeps the displacement of the child's port relative to the parent's at zero: these are three
rows of G. A closure of the kind `revolute` also keeps the rotation across its axis at zero (two more
rows), one of the kind `fixed` the whole rotation (three more rows).
"""

from typing import ClassVar, Self, final

import casadi as ca
from pydantic import model_validator

from mbdlft.base.description import AXES, Description, Direction, Name, Text
from mbdlft.base.errors import SceneError, unknown_name
from mbdlft.base.signal import Signal
from mbdlft.multibody.joint.base import with_length
from mbdlft.multibody.joint.planar import plane

KINDS = ("fixed", "revolute", "spherical")


@final
class Loop(Description):
    """A joint that closes a loop: `kind` is ``spherical``, ``revolute`` (about `axis`) or ``fixed``.

    At equilibrium the two ports must be at the same place for all parameters. The components of `axis`
    are in the axes of the body of the parent's port.
    """

    noun: ClassVar[str] = "loop"

    name: Name
    kind: Text
    parent: Text
    child: Text
    axis: Direction | None = None

    @model_validator(mode="after")
    def _kind_and_axis(self) -> Self:
        if self.kind not in KINDS:
            raise SceneError(unknown_name("kind", self.kind, KINDS))
        if (self.axis is not None) != (self.kind == "revolute"):
            raise SceneError(
                f"a closure of the kind {self.kind!r} {'needs an' if self.axis is None else 'has no'} "
                "axis; 'revolute' has one."
            )
        if self.axis is not None:
            with_length("axis", self.axis)
        return self

    def turned_rows(self) -> ca.SX:
        """Directions (n, 3), in the axes of the parent, about which the closure allows no rotation."""
        if self.kind == "spherical":
            return ca.SX(0, 3)
        if self.axis is None:
            return ca.SX.eye(3)
        return ca.sparsify(ca.vertcat(*(direction.T for direction in plane(self.axis))))

    def signals(self) -> tuple[Signal, ...]:
        """The multipliers: force and torques that the parent exerts on the child."""
        forces = [Signal(f"{self.name}.force.{axis}", "N") for axis in AXES]
        rows = range(self.turned_rows().shape[0])
        return (*forces, *(Signal(f"{self.name}.torque.{k + 1}", "N m") for k in rows))
