"""The ground: the frame of the scene, at rest in it. It exists in every scene under this name."""

from collections.abc import Mapping
from typing import Any, ClassVar, Literal, final

import casadi as ca

from mbdlft.body.base import Body

GROUND = "ground"


@final
class Ground(Body):
    """Describe it only to give it ports; positions from the origin of the scene frame (m)."""

    kind: ClassVar[str] = "ground"
    name: Literal["ground"] = "ground"

    def wrench(self, motion: ca.SX, values: Mapping[str, Any], inboard: ca.SX) -> None:
        """Nothing moves the ground."""
        return
