"""A point mass: it needs the force m a at its origin, and no torque."""

from collections.abc import Mapping
from typing import ClassVar, final

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from mbdlft.base.description import Expected, Quantity, Values
from mbdlft.multibody.body.base import Body
from mbdlft.multibody.body.rigid import negative_mass
from mbdlft.multibody.spatial import Coordinate, move_motion, move_wrench


@final
class PointMass(Body):
    """A mass (kg) at the origin of the body frame."""

    kind: ClassVar[str] = "point_mass"
    mass: Quantity

    def own_quantities(self) -> dict[str, Expected]:
        return {"mass": Expected(self.mass, "kg")}

    def wrench(self, motion: ca.SX, values: Values, inboard: ca.SX, at: Coordinate) -> ca.SX:
        """Wrench (3, 2) of Newton's law, force = m a at the origin, moved to the inboard port."""
        acceleration = move_motion(motion, -inboard)[:, 2]
        return move_wrench(ca.horzcat(values["mass"] * acceleration, ca.SX(3, 1)), -inboard)

    def physical_problem(self, values: Mapping[str, NDArray[np.float64]]) -> str | None:
        return negative_mass(values["mass"])
