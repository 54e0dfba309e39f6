"""Strapdown sensors: they feel gravity and the motion of the frame, in the axes of their own body."""

from typing import ClassVar, final

import casadi as ca

from mbdlft.base.description import Text
from mbdlft.base.signal import Signal
from mbdlft.multibody.sensor.base import Sensor, View, by_axis


@final
class Accelerometer(Sensor):
    """Specific force a - g of a port (m/s^2), in the axes of its body."""

    kind: ClassVar[str] = "accelerometer"
    components: ClassVar[tuple[Signal, ...]] = by_axis("m/s^2")

    port: Text

    def measure(self, view: View) -> ca.SX:
        return view.motion(self.port)[:, 2]


@final
class Gyro(Sensor):
    """Angular velocity of the body of a port (rad/s) in its axes, with the spin of the scene."""

    kind: ClassVar[str] = "gyro"
    components: ClassVar[tuple[Signal, ...]] = by_axis("rad/s")

    port: Text

    def measure(self, view: View) -> ca.SX:
        return view.motion(self.port)[:, 0]
