"""A revolute joint: one rotation about an axis.

    effort = axis . tau_c + J axis . alpha_c + J_r qddot + stiffness q + damping qdot

tau_c is the torque that the child needs, J the inertia of the actuator, which turns with the child:
Kassarian et al. 2023, equation (7). An actuator with a gear is a rotor that turns `gear_ratio` times as
far as the child, relative to the parent: see `Hinge`. With a high gear only the reflected inertia J_r
is felt.
"""

from collections.abc import Mapping
from typing import ClassVar, Self, final

import numpy as np
from numpy.typing import NDArray
from pydantic import model_validator

from mbdlft.base.description import Expected, Quantity, Values
from mbdlft.base.errors import SceneError
from mbdlft.base.signal import Freedom
from mbdlft.multibody.joint.base import AxisJoint, MovingJoint, turning
from mbdlft.multibody.joint.move import Hinge, Move, steady_hinge, turned
from mbdlft.multibody.spatial import Coordinate


@final
class Revolute(AxisJoint, MovingJoint):
    """The child turns about `axis`.

    Units: `position` rad, `stiffness` N m/rad, `damping` N m s/rad, `actuator_inertia` kg m^2, `preload`
    N m. `gear_ratio` is the angle of the actuator over that of the joint. `actuator_inertia` is the
    inertia of the rotor itself, in front of the gear; the effort is the torque behind the gear.
    `reflected_inertia` (kg m^2) is felt by the joint alone, as that of a rotor behind a high gear.

    With a `rate` (rad/s) the joint turns steadily at equilibrium: what it carries must be symmetric about
    its axis, and the model has the deviation from this rate, and no angle unless an output asks for it.
    """

    kind: ClassVar[str] = "revolute"
    freedoms: ClassVar[tuple[Freedom, ...]] = (turning(),)

    position: Quantity = 0.0
    stiffness: Quantity = 0.0
    damping: Quantity = 0.0
    actuator_inertia: Quantity = 0.0
    gear_ratio: Quantity = 1.0
    reflected_inertia: Quantity = 0.0
    preload: Quantity | None = None
    rate: Quantity | None = None

    @model_validator(mode="after")
    def _turns_on(self) -> Self:
        if self.rate is None:
            return self
        for key, reason in (("position", "its angle grows on"), ("stiffness", "a spring winds up")):
            if getattr(self, key) != 0.0:
                raise SceneError(
                    f"{key}: a joint that turns at a steady rate has none, because {reason}; got "
                    f"{getattr(self, key)!r}. Leave out {key} or rate."
                )
        return self

    def own_quantities(self) -> dict[str, Expected]:
        quantities = super().own_quantities()
        if self.rate is not None:
            quantities["rate"] = Expected(self.rate, "rad/s")
        if self.gear_ratio != 1.0:  # without a gear nothing is multiplied
            quantities["gear_ratio"] = Expected(self.gear_ratio, "1")
        if self.reflected_inertia != 0.0:
            quantities["reflected_inertia"] = Expected(self.reflected_inertia, "kg m^2")
        return quantities

    def physical_problem(self, values: Mapping[str, NDArray[np.float64]]) -> str | None:
        ratio = values.get("gear_ratio", np.ones(1))
        if np.min(ratio) <= 0.0 <= np.max(ratio):
            return (
                f"the gear_ratio vanishes in the range [{np.min(ratio):g}, {np.max(ratio):g}]: the "
                "actuator would not turn. A negative one turns it the other way."
            )
        return super().physical_problem(values)

    def own_moves(self, values: Values, at: Coordinate) -> tuple[Move, ...]:
        axis = self.direction()
        return (
            *turned(axis, values["position"]),
            steady_hinge(
                Hinge(
                    axis,
                    at.part(0),
                    values["actuator_inertia"],
                    values.get("gear_ratio", 1.0),
                    reflected=values.get("reflected_inertia", 0.0),
                ),
                values,
            ),
        )
