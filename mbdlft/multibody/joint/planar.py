"""A planar joint: two translations in a plane and a rotation about its normal."""

from fractions import Fraction
from typing import ClassVar, final

import casadi as ca

from mbdlft.base.description import Direction, Quantity, Values
from mbdlft.base.signal import Freedom
from mbdlft.multibody.joint.base import AxisJoint, MovingJoint, sliding, turning
from mbdlft.multibody.joint.move import Hinge, Move, Slide, shifted, turned
from mbdlft.multibody.spatial import Coordinate
from mbdlft.number.exact import decimal
from mbdlft.sx.constants import unit_vector

Triple = tuple[Quantity, Quantity, Quantity]


@final
class Planar(AxisJoint, MovingJoint):
    """The child moves in the plane with the normal `axis`.

    It moves along the directions x and y of the plane (m), then turns about the normal (rad). x, y and
    the normal are right-handed. If the normal is a coordinate axis, x and y are the two coordinate axes
    that follow it (y and z for the normal x). Otherwise x is the direction of the plane nearest to a
    coordinate axis; if two are equally near, it is the one for the first coordinate axis.
    """

    kind: ClassVar[str] = "planar"
    freedoms: ClassVar[tuple[Freedom, ...]] = (
        sliding("x", ".x"),
        sliding("y", ".y"),
        turning("angle"),
    )

    axis: Direction = (0.0, 0.0, 1.0)
    position: Triple = (0.0, 0.0, 0.0)
    stiffness: Triple = (0.0, 0.0, 0.0)
    damping: Triple = (0.0, 0.0, 0.0)
    actuator_inertia: Triple = (0.0, 0.0, 0.0)
    preload: Triple | None = None

    def own_moves(self, values: Values, at: Coordinate) -> tuple[Move, ...]:
        moves: tuple[Move, ...] = ()
        for k, (label, direction) in enumerate(zip("xy", plane(self.axis), strict=True)):
            axis = ca.sparsify(direction)
            moves += shifted(axis * values[f"position.{label}"])
            moves += (Slide(axis, at.part(k), values[f"actuator_inertia.{label}"]),)
        normal = self.direction()
        moves += turned(normal, values["position.angle"])
        return (*moves, Hinge(normal, at.part(2), values["actuator_inertia.angle"]))


def plane(normal: Direction) -> tuple[ca.SX, ca.SX]:
    """Two unit vectors x and y (3,) across `normal`; x, y and the normal are right-handed."""
    n = [decimal(entry) for entry in normal]
    along = [k for k in range(3) if n[k]]
    if len(along) == 1:
        x = ca.SX.eye(3)[:, (along[0] + 1) % 3]
    else:
        k = min(range(3), key=lambda k: abs(n[k]))
        square = sum((entry * entry for entry in n), Fraction(0))
        x = unit_vector([(square if j == k else 0) - n[k] * n[j] for j in range(3)])
    return x, ca.sparsify(ca.cross(unit_vector(normal), x))
