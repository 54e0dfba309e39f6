"""A revolute joint: one rotation about an axis.

    omega_A = R' omega_B + axis qdot,    alpha_A = R' alpha_B + (R' omega_B) x axis qdot + axis qddot
    effort  = axis . torque_A + J axis . alpha_A + stiffness q + damping qdot

B is the parent's side, A the child's. J is the inertia of the actuator, a massless body that turns
with the child: equations (7) to (9) of Kassarian et al. 2023.
"""

from functools import cache
from typing import ClassVar, final

import casadi as ca

from mbdlft.description import Expected, Quantity, Values
from mbdlft.joint.base import AxisJoint, Coordinate, Turn
from mbdlft.spatial import rotate, rotate_back


@final
class Revolute(AxisJoint):
    """A rotation about `axis`; `position` (rad) at equilibrium, N m/rad, N m s/rad, kg m^2."""

    kind: ClassVar[str] = "revolute"
    degrees_of_freedom: ClassVar[int] = 1
    effort: ClassVar[tuple[str, str]] = ("torque", "N m")
    measures: ClassVar[tuple[tuple[str, str], ...]] = (
        ("angle", "rad"),
        ("rate", "rad/s"),
        ("acceleration", "rad/s^2"),
    )

    position: Quantity = 0.0
    stiffness: Quantity = 0.0
    damping: Quantity = 0.0
    actuator_inertia: Quantity = 0.0

    def quantities(self) -> dict[str, Expected]:
        return {
            "position": Expected(self.position, "rad"),
            "stiffness": Expected(self.stiffness, "N m/rad"),
            "damping": Expected(self.damping, "N m s/rad"),
            "actuator_inertia": Expected(self.actuator_inertia, "kg m^2"),
        }

    def motion(
        self,
        motion: ca.SX,
        values: Values,
        turns: list[Turn],
        coordinate: Coordinate,
    ) -> ca.SX:
        axis = self.direction()
        for turn in turns[1:]:
            motion = rotate_back(axis, *turn, motion)
        first = turns[0] if turns else Turn(1.0, 0.0)
        return ca.SX(_motion()(motion, axis, *first, *coordinate))

    def wrench(
        self,
        wrench: ca.SX,
        values: Values,
        turns: list[Turn],
        coordinate: Coordinate,
    ) -> ca.SX:
        axis = self.direction()
        first = turns[0] if turns else Turn(1.0, 0.0)
        wrench = _wrench()(wrench, axis, *first, coordinate.q)
        for turn in reversed(turns[1:]):
            wrench = rotate(axis, *turn, wrench)
        return wrench

    def carry(self, wrench: ca.SX, motion: ca.SX, values: Values) -> ca.SX:
        inertia = values["actuator_inertia"]
        if isinstance(inertia, float) and inertia == 0.0:
            return wrench
        return ca.SX(_carry()(wrench, motion, self.direction(), inertia))

    def resistance(self, wrench: ca.SX, values: Values, coordinate: Coordinate) -> ca.SX:
        springs = values["stiffness"] * coordinate.q + values["damping"] * coordinate.v
        return ca.mtimes(self.direction().T, wrench[:, 1]) + springs


@cache
def _motion() -> ca.Function:
    motion, axis = ca.SX.sym("motion", 3, 3), ca.SX.sym("axis", 3)
    c, s, q, v, a = (ca.SX.sym(name) for name in ("c", "s", "q", "v", "a"))
    turned = rotate_back(axis, ca.cos(q), ca.sin(q), rotate_back(axis, c, s, motion))
    omega, alpha, acceleration = ca.horzsplit(turned)
    relative = axis * v
    child = ca.horzcat(omega + relative, alpha + ca.cross(omega, relative) + axis * a, acceleration)
    return ca.Function("revolute_motion", [motion, axis, c, s, q, v, a], [child])


@cache
def _wrench() -> ca.Function:
    wrench, axis = ca.SX.sym("wrench", 3, 2), ca.SX.sym("axis", 3)
    c, s, q = (ca.SX.sym(name) for name in ("c", "s", "q"))
    turned = rotate(axis, c, s, rotate(axis, ca.cos(q), ca.sin(q), wrench))
    return ca.Function("revolute_wrench", [wrench, axis, c, s, q], [turned])


@cache
def _carry() -> ca.Function:
    wrench, motion = ca.SX.sym("wrench", 3, 2), ca.SX.sym("motion", 3, 3)
    axis, inertia = ca.SX.sym("axis", 3), ca.SX.sym("J")
    omega, alpha, _ = ca.horzsplit(motion)
    spin = inertia * ca.dot(axis, omega)
    torque = axis * (inertia * ca.dot(axis, alpha)) + ca.cross(omega, axis * spin)
    carried = ca.horzcat(wrench[:, 0], wrench[:, 1] + torque)
    return ca.Function("revolute_actuator", [wrench, motion, axis, inertia], [carried])
