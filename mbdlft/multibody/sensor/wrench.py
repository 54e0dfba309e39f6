"""The wrench through a joint: constraint loads with the effort, spring and damper."""

from typing import ClassVar, final

import casadi as ca

from mbdlft.base.description import Text
from mbdlft.base.signal import Signal
from mbdlft.multibody.sensor.base import Sensor, View, by_axis


@final
class JointWrench(Sensor):
    """Force (N) and torque (N m) of a joint on its child, about the child's port and in its axes."""

    kind: ClassVar[str] = "joint_wrench"
    components: ClassVar[tuple[Signal, ...]] = (*by_axis("N", "force."), *by_axis("N m", "torque."))

    joint: Text

    def measure(self, view: View) -> ca.SX:
        return ca.vec(view.joint_wrench(self.joint))
