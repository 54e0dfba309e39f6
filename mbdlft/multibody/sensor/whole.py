"""Measures of the whole system: momentum and center of mass, in the axes of the scene."""

from typing import ClassVar, final

import casadi as ca

from mbdlft.base.signal import Signal
from mbdlft.multibody.sensor.base import Sensor, View, by_axis


@final
class Momentum(Sensor):
    """Linear (N s) and angular momentum (N m s) about the origin of the scene, relative to its frame.

    Actuators that turn with their child are in it; those that move relative to the parent are not.
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
    """Displacement of the center of mass of all bodies (m)."""

    kind: ClassVar[str] = "center_of_mass"
    components: ClassVar[tuple[Signal, ...]] = by_axis("m")

    def measure(self, view: View) -> ca.SX:
        return view.momentum(0)[:, 0] / view.mass()
