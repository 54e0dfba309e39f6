"""A prismatic joint: one translation along an axis.

    a_A    = a_P + 2 omega x axis qdot + axis qddot,   P on the parent, at (position + q) axis
    effort = axis . force_A + m qddot + stiffness q + damping qdot

m is the mass that the actuator moves along the axis relative to the parent (a reflected inertia).
"""

from functools import cache
from typing import ClassVar, final

import casadi as ca

from mbdlft.description import Expected, Quantity, Values
from mbdlft.joint.base import AxisJoint, Coordinate, Turn
from mbdlft.spatial import move_motion, move_wrench


@final
class Prismatic(AxisJoint):
    """A translation along `axis`; `position` (m) at equilibrium, N/m, N s/m, kg."""

    kind: ClassVar[str] = "prismatic"
    degrees_of_freedom: ClassVar[int] = 1
    effort: ClassVar[tuple[str, str]] = ("force", "N")
    measures: ClassVar[tuple[tuple[str, str], ...]] = (
        ("position", "m"),
        ("velocity", "m/s"),
        ("acceleration", "m/s^2"),
    )

    position: Quantity = 0.0
    stiffness: Quantity = 0.0
    damping: Quantity = 0.0
    actuator_inertia: Quantity = 0.0

    def quantities(self) -> dict[str, Expected]:
        return {
            "position": Expected(self.position, "m"),
            "stiffness": Expected(self.stiffness, "N/m"),
            "damping": Expected(self.damping, "N s/m"),
            "actuator_inertia": Expected(self.actuator_inertia, "kg"),
        }

    def motion(
        self,
        motion: ca.SX,
        values: Values,
        turns: list[Turn],
        coordinate: Coordinate,
    ) -> ca.SX:
        return ca.SX(_motion()(motion, self.direction(), values["position"], *coordinate))

    def wrench(
        self,
        wrench: ca.SX,
        values: Values,
        turns: list[Turn],
        coordinate: Coordinate,
    ) -> ca.SX:
        return ca.SX(_wrench()(wrench, self.direction(), values["position"], coordinate.q))

    def resistance(self, wrench: ca.SX, values: Values, coordinate: Coordinate) -> ca.SX:
        springs = values["stiffness"] * coordinate.q + values["damping"] * coordinate.v
        actuator = values["actuator_inertia"] * coordinate.a
        return ca.mtimes(self.direction().T, wrench[:, 0]) + springs + actuator


@cache
def _motion() -> ca.Function:
    motion, axis = ca.SX.sym("motion", 3, 3), ca.SX.sym("axis", 3)
    position, q, v, a = (ca.SX.sym(name) for name in ("position", "q", "v", "a"))
    # r = axis position + axis q, kept apart: the order of factors is that of the matrix product
    moved = move_motion(move_motion(motion, axis * position), axis * q)
    omega, alpha, acceleration = ca.horzsplit(moved)
    child = ca.horzcat(omega, alpha, acceleration + 2 * ca.cross(omega, axis * v) + axis * a)
    return ca.Function("prismatic_motion", [motion, axis, position, q, v, a], [child])


@cache
def _wrench() -> ca.Function:
    wrench, axis = ca.SX.sym("wrench", 3, 2), ca.SX.sym("axis", 3)
    position, q = ca.SX.sym("position"), ca.SX.sym("q")
    moved = move_wrench(move_wrench(wrench, axis * q), axis * position)
    return ca.Function("prismatic_wrench", [wrench, axis, position, q], [moved])
