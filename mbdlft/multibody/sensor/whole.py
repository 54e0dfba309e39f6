"""Sensors of the whole system: momentum and center of mass, in the axes of the scene."""

from typing import ClassVar, final

import casadi as ca

from mbdlft.base.signal import Signal
from mbdlft.multibody.sensor.base import Sensor, View, by_axis


@final
class Momentum(Sensor):
    """A sensor of the linear (N s) and angular momentum (N m s) of all bodies.

    The momentum is about the origin of the scene and relative to its frame. It includes the inertia of
    actuators that turn with the child of their joint, but not of those that move relative to the parent.
    """

    kind: ClassVar[str] = "momentum"
    components: ClassVar[tuple[Signal, ...]] = (
        *by_axis("N s", "linear."),
        *by_axis("N m s", "angular."),
    )

    def measure(self, view: View) -> ca.SX:
        return ca.vec(view.momentum(1))


@final
class CenterOfMass(Sensor):
    """A sensor of the displacement of the center of mass of all bodies (m)."""

    kind: ClassVar[str] = "center_of_mass"
    components: ClassVar[tuple[Signal, ...]] = by_axis("m")

    def measure(self, view: View) -> ca.SX:
        return view.momentum(0)[:, 0] / view.mass()
