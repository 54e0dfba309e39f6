"""The ground: the frame of the scene, at rest in it. It exists in every scene under this name."""

from typing import ClassVar, final

import casadi as ca

from mbdlft.base.description import Name, Values
from mbdlft.multibody.body.base import GROUND, Body
from mbdlft.multibody.spatial import Coordinate


@final
class Ground(Body):
    """The ground; a scene describes it only to give it ports, from the origin of the scene frame (m)."""

    kind: ClassVar[str] = GROUND
    name: Name = GROUND

    def wrench(self, motion: ca.SX, values: Values, inboard: ca.SX, at: Coordinate) -> ca.SX:
        """Zero: the ground does not move, so it needs no wrench."""
        return ca.SX(3, 2)
