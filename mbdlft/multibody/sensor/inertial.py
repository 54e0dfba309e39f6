"""Inertial sensors, fixed to a body: they also measure gravity and the motion of the scene's frame."""

from typing import ClassVar, final

import casadi as ca

from mbdlft.base.description import Text
from mbdlft.base.signal import Signal
from mbdlft.multibody.sensor.base import Sensor, View, by_axis


@final
class Accelerometer(Sensor):
    """A sensor of the specific force a - g at a port (m/s^2), in the axes of the body of the port."""

    kind: ClassVar[str] = "accelerometer"
    components: ClassVar[tuple[Signal, ...]] = by_axis("m/s^2")

    port: Text

    def measure(self, view: View) -> ca.SX:
        return view.motion(self.port)[:, 2]


@final
class Gyro(Sensor):
    """A sensor of the angular velocity of a port's body (rad/s), in its axes.

    The spin of the scene is part of the measured angular velocity.
    """

    kind: ClassVar[str] = "gyro"
    components: ClassVar[tuple[Signal, ...]] = by_axis("rad/s")

    port: Text

    def measure(self, view: View) -> ca.SX:
        return view.motion(self.port)[:, 0]
