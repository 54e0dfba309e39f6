"""A spherical joint: a rotation about a point, by a small rotation vector q (3,).

    effort = tau_c + J vdot + stiffness q + damping v

All vectors are in the axes of the child: its relative angular velocity v, the torque tau_c that it needs,
and the inertia J of the actuators, one for each axis.
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
    """The child turns about the point where the ports meet; `orientation` is that of the equilibrium.

    Each quantity has three entries, for the axes x, y and z of the child.
    """

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
