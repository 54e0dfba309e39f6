"""A planar joint: two translations in a plane and a rotation about its normal."""

from typing import ClassVar, final

import casadi as ca
import numpy as np

from mbdlft.base.description import Direction, Quantity, Values
from mbdlft.base.signal import Freedom
from mbdlft.multibody.joint.base import AxisJoint, MovingJoint, sliding, turning
from mbdlft.multibody.joint.move import Hinge, Move, Slide, shifted, turned
from mbdlft.multibody.spatial import Coordinate

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
            axis = ca.sparsify(ca.SX(direction))
            moves += shifted(axis * values[f"position.{label}"])
            moves += (Slide(axis, at.part(k), values[f"actuator_inertia.{label}"]),)
        normal = self.direction()
        moves += turned(normal, values["position.angle"])
        return (*moves, Hinge(normal, at.part(2), values["actuator_inertia.angle"]))


def plane(normal: Direction) -> tuple[np.ndarray, np.ndarray]:
    """Two unit vectors x and y (3,) across `normal`; x, y and the normal are right-handed."""
    n = np.asarray(normal) / np.linalg.norm(normal)
    along = np.flatnonzero(n)
    if len(along) == 1:
        x = np.eye(3)[(along[0] + 1) % 3]
    else:
        k = int(np.argmin(np.abs(n)))
        x = np.eye(3)[k] - n[k] * n
        x = x / np.linalg.norm(x)
    return x, np.cross(n, x)
