"""Closures of kinematic loops: constraints between two ports of the tree, with multipliers.

    0 = G q,  0 = G v,  0 = G vdot,      and G' lambda is added to the equations of motion

The frame J of a closure is that of the parent's port, turned by its `orientation`. The rows of G keep

| kind          | displacement of the child's port in J | rotation of the child in J            |
|---------------|---------------------------------------|---------------------------------------|
| `fixed`       | all                                   | all                                   |
| `revolute`    | all                                   | across the axis                       |
| `spherical`   | all                                   |                                       |
| `universal`   | all                                   | about axis1 x axis2                   |
| `prismatic`   | across the axis                       | all                                   |
| `cylindrical` | across the axis                       | across the axis                       |
"""

from typing import ClassVar, Self, final

import casadi as ca
import numpy as np
from pydantic import model_validator

from mbdlft.base.description import (
    AXES,
    Description,
    Direction,
    Expected,
    Many,
    Name,
    Text,
    Values,
    with_length,
)
from mbdlft.base.errors import SceneError, check_known
from mbdlft.base.unit import Signal
from mbdlft.multibody.joint.kinds import Rotation, angles_of, plane, turns_of
from mbdlft.problem.sx.constants import unit_vector

KINDS = ("cylindrical", "fixed", "prismatic", "revolute", "spherical", "universal")
WITH_AXIS = ("cylindrical", "prismatic", "revolute")
SLIDING = ("cylindrical", "prismatic")


@final
class Loop(Description):
    """A joint that closes a loop, of one of the kinds ``fixed``, ``revolute``, ``spherical``,
    ``universal``, ``prismatic`` and ``cylindrical``.

    At equilibrium the two ports must be at the same place for all parameters, or on one line along the
    axis where the kind slides. The axes are those of a joint of this kind: the components of `axis` are
    the same in the axes of the child and in those of the parent's port after the `orientation`. Of a
    universal closure, `axis1` is an axis of the parent and `axis2` one of the child.
    """

    noun: ClassVar[str] = "loop"

    name: Name
    kind: Text
    parent: Text
    child: Text
    axis: Direction | None = None
    axis1: Direction | None = None
    axis2: Direction | None = None
    orientation: Many[Rotation] = ()

    @model_validator(mode="after")
    def _kind_and_axes(self) -> Self:
        check_known("kind", [self.kind], KINDS)
        wanted = {
            "axis": self.kind in WITH_AXIS,
            "axis1": self.kind == "universal",
            "axis2": self.kind == "universal",
        }
        for key, needed in wanted.items():
            axis = getattr(self, key)
            if (axis is not None) != needed:
                raise SceneError(
                    f"a closure of the kind {self.kind!r} {'needs' if needed else 'has no'} {key}; "
                    f"{', '.join(WITH_AXIS)} have an axis, universal has axis1 and axis2."
                )
            if axis is not None:
                with_length(axis, key)
        two = self.axis1 is not None and self.axis2 is not None
        if two and not np.any(np.cross(self.axis1 or (), self.axis2 or ())):
            raise SceneError("axis1 and axis2 are parallel: a universal joint turns about two.")
        return self

    def quantities(self) -> dict[str, Expected]:
        """The angles of the orientation by label (rad)."""
        return angles_of(self.orientation)

    def in_parent_axes(self, vectors: ca.SX, values: Values) -> ca.SX:
        """Components in the axes of the parent of vectors (3, n) in those of the closure."""
        for move in reversed(turns_of(self.orientation, values)):
            vectors = move.in_parent_axes(vectors)
        return vectors

    def in_own_axes(self, vectors: ca.SX, values: Values) -> ca.SX:
        """Components in the axes of the closure of vectors (3, n) in those of the parent."""
        for move in turns_of(self.orientation, values):
            vectors = move.in_child_axes(vectors)
        return vectors

    @property
    def slides(self) -> bool:
        return self.kind in SLIDING

    def held(self) -> ca.SX:
        """Directions (n, 3), in the axes of the closure, along which the ports keep together."""
        if not self.slides or self.axis is None:
            return ca.SX.eye(3)
        return ca.sparsify(ca.vertcat(*(direction.T for direction in plane(self.axis))))

    def same(self) -> ca.SX:
        """Directions (3, n) with the same components in the axes of the closure and of the child."""
        if self.kind in ("revolute", "cylindrical") and self.axis is not None:
            return unit_vector(self.axis)
        return ca.SX.eye(3) if self.kind in ("fixed", "prismatic") else ca.SX(3, 0)

    def turned_rows(self, second: ca.SX) -> ca.SX:
        """Directions (n, 3), in the axes of the closure, about which it allows no rotation.

        `second` (3,) is axis2 there, with unit length, for a universal closure.
        """
        if self.kind == "universal" and self.axis1 is not None:
            return ca.sparsify(ca.cross(unit_vector(self.axis1), second)).T
        if self.kind in ("revolute", "cylindrical") and self.axis is not None:
            return ca.sparsify(ca.vertcat(*(direction.T for direction in plane(self.axis))))
        return ca.SX.eye(3) if self.kind in ("fixed", "prismatic") else ca.SX(0, 3)

    def signals(self) -> tuple[Signal, ...]:
        """The multipliers: forces and torques that the parent exerts on the child."""
        names = ("1", "2") if self.slides else AXES
        forces = [Signal(f"{self.name}.force.{axis}", "N") for axis in names]
        rows = range(self.turned_rows(ca.SX(3, 1)).shape[0])
        return (*forces, *(Signal(f"{self.name}.torque.{k + 1}", "N m") for k in rows))
