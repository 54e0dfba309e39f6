"""Sensors of the small motion of a port relative to the frame of the scene.

The measured quantities are deviations from the equilibrium, where they are zero. So to first order it
makes no difference whether the axes of `frame` move with a body or stay where they are at equilibrium.
"""

from typing import ClassVar, final

import casadi as ca

from mbdlft.base.signal import Signal
from mbdlft.multibody.sensor.base import PortSensor, View, by_axis


@final
class Position(PortSensor):
    """A sensor of the displacement of a port (m)."""

    kind: ClassVar[str] = "position"
    components: ClassVar[tuple[Signal, ...]] = by_axis("m")

    def measure(self, view: View) -> ca.SX:
        return translation(self, view, 0)


@final
class Velocity(PortSensor):
    """A sensor of the velocity of a port (m/s)."""

    kind: ClassVar[str] = "velocity"
    components: ClassVar[tuple[Signal, ...]] = by_axis("m/s")

    def measure(self, view: View) -> ca.SX:
        return translation(self, view, 1)


@final
class Acceleration(PortSensor):
    """A sensor of the acceleration of a port relative to the frame of the scene (m/s^2)."""

    kind: ClassVar[str] = "acceleration"
    components: ClassVar[tuple[Signal, ...]] = by_axis("m/s^2")

    def measure(self, view: View) -> ca.SX:
        return translation(self, view, 2)


@final
class SmallRotation(PortSensor):
    """A sensor of the small rotation vector of the body of a port (rad)."""

    kind: ClassVar[str] = "rotation"
    components: ClassVar[tuple[Signal, ...]] = by_axis("rad")

    def measure(self, view: View) -> ca.SX:
        return turn(self, view, 0)


@final
class AngularRate(PortSensor):
    """A sensor of the angular velocity of the body of a port (rad/s)."""

    kind: ClassVar[str] = "angular_rate"
    components: ClassVar[tuple[Signal, ...]] = by_axis("rad/s")

    def measure(self, view: View) -> ca.SX:
        return turn(self, view, 1)


@final
class AngularAcceleration(PortSensor):
    """A sensor of the angular acceleration of the body of a port (rad/s^2)."""

    kind: ClassVar[str] = "angular_acceleration"
    components: ClassVar[tuple[Signal, ...]] = by_axis("rad/s^2")

    def measure(self, view: View) -> ca.SX:
        return turn(self, view, 2)


def translation(sensor: PortSensor, view: View, order: int) -> ca.SX:
    """Displacement (order 0) or its derivatives (1, 2) by time, (3,), in the sensor's frame."""
    body, small = view.small(sensor.port, order)
    return view.across(small.displacement, body, sensor.frame)


def turn(sensor: PortSensor, view: View, order: int) -> ca.SX:
    """Small rotation (order 0) or its derivatives (1, 2) by time, (3,), in the sensor's frame."""
    body, small = view.small(sensor.port, order)
    return view.across(small.rotation, body, sensor.frame)
