"""A sensor of the wrench in a joint: constraint loads, effort, spring and damper together."""

from typing import ClassVar, final

import casadi as ca

from mbdlft.base.description import Text
from mbdlft.base.signal import Signal
from mbdlft.multibody.sensor.base import Sensor, View, by_axis


@final
class JointWrench(Sensor):
    """A sensor of the force (N) and torque (N m) that a joint exerts on its child.

    Both are about the child's port and in its axes.
    """

    kind: ClassVar[str] = "joint_wrench"
    components: ClassVar[tuple[Signal, ...]] = (*by_axis("N", "force."), *by_axis("N m", "torque."))

    joint: Text

    def measure(self, view: View) -> ca.SX:
        return ca.vec(view.joint_wrench(self.joint))
