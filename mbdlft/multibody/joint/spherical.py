"""A spherical joint: a rotation about a point, by a small rotation vector.

effort = torque + J vdot + stiffness q + damping v        in the axes of the child
"""

from typing import ClassVar, final

import casadi as ca

from mbdlft.base.description import AXES, Quantity, Values
from mbdlft.base.signal import Freedom
from mbdlft.multibody.joint.base import MovingJoint, turning
from mbdlft.multibody.joint.move import Ball, Move
from mbdlft.multibody.spatial import Coordinate

Triple = tuple[Quantity, Quantity, Quantity]


@final
class Spherical(MovingJoint):
    """About the point where the ports meet; `orientation` is the equilibrium. Quantities by axis."""

    kind: ClassVar[str] = "spherical"
    freedoms: ClassVar[tuple[Freedom, ...]] = tuple(
        turning(axis, f".{axis}", of="rotation") for axis in AXES
    )

    stiffness: Triple = (0.0, 0.0, 0.0)
    damping: Triple = (0.0, 0.0, 0.0)
    actuator_inertia: Triple = (0.0, 0.0, 0.0)
    preload: Triple | None = None

    def own_moves(self, values: Values, at: Coordinate) -> tuple[Move, ...]:
        inertia = ca.SX(ca.vertcat(*(values[f"actuator_inertia.{axis}"] for axis in AXES)))
        return (Ball(at, inertia),)
