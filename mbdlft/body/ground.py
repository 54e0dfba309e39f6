"""The ground: the frame of the scene, at rest in it. It exists in every scene under this name."""

from typing import ClassVar, Literal, final

import casadi as ca

from mbdlft.body.base import Body
from mbdlft.description import Values

GROUND = "ground"


@final
class Ground(Body):
    """Describe it only to give it ports; positions from the origin of the scene frame (m)."""

    kind: ClassVar[str] = "ground"
    name: Literal["ground"] = "ground"

    def wrench(self, motion: ca.SX, values: Values, inboard: ca.SX) -> ca.SX:
        """Nothing moves the ground: it needs no wrench."""
        return ca.SX(3, 2)
