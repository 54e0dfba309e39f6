"""Sensors: a name, and named components of the measured quantity. A new kind is one class and one line in
`KINDS`.

The small motion of a port is relative to the frame of the scene, and a deviation from the equilibrium,
where it is zero. So to first order it makes no difference whether the axes of `frame` move with a body or
stay where they are at equilibrium. Accelerometers and gyros are fixed to a body: they also measure
gravity and the motion of the scene's frame. Momentum and center of mass are in the axes of the scene. In
the wrench of a joint are constraint loads, effort, spring and damper together.
"""

import abc
from typing import ClassVar, final

import casadi as ca

from mbdlft.base.description import AXES, Description, Name, Text
from mbdlft.base.unit import Signal
from mbdlft.multibody.spatial import Space


class Sensor(Description, abc.ABC):
    """A sensor; every concrete kind is final. Its components are outputs of the model."""

    noun: ClassVar[str] = "sensor"

    kind: ClassVar[str]
    components: ClassVar[tuple[Signal, ...]]

    name: Name

    def signals(self) -> tuple[Signal, ...]:
        """Outputs, in the order of `measure`."""
        return tuple(component.of(self.name) for component in self.components)

    @abc.abstractmethod
    def measure(self, view: Space) -> ca.SX:
        """The measured quantity (n,), one entry for each component."""


def by_axis(unit: str, prefix: str = "") -> tuple[Signal, ...]:
    """Signals of the components x, y and z of a vector in one unit."""
    return tuple(Signal(f"{prefix}{axis}", unit) for axis in AXES)


class PortSensor(Sensor, abc.ABC):
    """A sensor of the small motion of one port: of its place, or of the rotation of its body.

    The components are in the axes of `frame`: the ground, or a body as it is placed at equilibrium. A
    kind says which derivative by time it measures, its `order`, and whether that `turns`.
    """

    order: ClassVar[int]
    turns: ClassVar[bool]

    port: Text
    frame: Text = "ground"

    def measure(self, view: Space) -> ca.SX:
        body, small = view.small(self.port, self.order)
        vector = small.rotation if self.turns else small.displacement
        return view.across(vector, body, self.frame)


@final
class Position(PortSensor):
    """A sensor of the displacement of a port (m)."""

    kind: ClassVar[str] = "position"
    components: ClassVar[tuple[Signal, ...]] = by_axis("m")
    order, turns = 0, False


@final
class Velocity(PortSensor):
    """A sensor of the velocity of a port (m/s)."""

    kind: ClassVar[str] = "velocity"
    components: ClassVar[tuple[Signal, ...]] = by_axis("m/s")
    order, turns = 1, False


@final
class Acceleration(PortSensor):
    """A sensor of the acceleration of a port relative to the frame of the scene (m/s^2)."""

    kind: ClassVar[str] = "acceleration"
    components: ClassVar[tuple[Signal, ...]] = by_axis("m/s^2")
    order, turns = 2, False


@final
class SmallRotation(PortSensor):
    """A sensor of the small rotation vector of the body of a port (rad)."""

    kind: ClassVar[str] = "rotation"
    components: ClassVar[tuple[Signal, ...]] = by_axis("rad")
    order, turns = 0, True


@final
class AngularRate(PortSensor):
    """A sensor of the angular velocity of the body of a port (rad/s)."""

    kind: ClassVar[str] = "angular_rate"
    components: ClassVar[tuple[Signal, ...]] = by_axis("rad/s")
    order, turns = 1, True


@final
class AngularAcceleration(PortSensor):
    """A sensor of the angular acceleration of the body of a port (rad/s^2)."""

    kind: ClassVar[str] = "angular_acceleration"
    components: ClassVar[tuple[Signal, ...]] = by_axis("rad/s^2")
    order, turns = 2, True


@final
class Accelerometer(Sensor):
    """A sensor of the specific force a - g at a port (m/s^2), in the axes of the body of the port."""

    kind: ClassVar[str] = "accelerometer"
    components: ClassVar[tuple[Signal, ...]] = by_axis("m/s^2")

    port: Text

    def measure(self, view: Space) -> ca.SX:
        return view.motion(self.port)[:, 2]


@final
class Gyro(Sensor):
    """A sensor of the angular velocity of a port's body (rad/s), in its axes.

    The spin of the scene is part of the measured angular velocity.
    """

    kind: ClassVar[str] = "gyro"
    components: ClassVar[tuple[Signal, ...]] = by_axis("rad/s")

    port: Text

    def measure(self, view: Space) -> ca.SX:
        return view.motion(self.port)[:, 0]


@final
class Momentum(Sensor):
    """A sensor of the linear (N s) and angular momentum (N m s) of all bodies.

    The momentum is about the origin of the scene and relative to its frame. It includes the inertia of
    actuators that turn with the child of their joint, but not of those that move relative to the parent.
    """

    kind: ClassVar[str] = "momentum"
    components: ClassVar[tuple[Signal, ...]] = (*by_axis("N s", "linear."), *by_axis("N m s", "angular."))

    def measure(self, view: Space) -> ca.SX:
        return ca.vec(view.momentum(1))


@final
class CenterOfMass(Sensor):
    """A sensor of the displacement of the center of mass of all bodies (m)."""

    kind: ClassVar[str] = "center_of_mass"
    components: ClassVar[tuple[Signal, ...]] = by_axis("m")

    def measure(self, view: Space) -> ca.SX:
        return view.momentum(0)[:, 0] / view.mass()


@final
class JointWrench(Sensor):
    """A sensor of the force (N) and torque (N m) that a joint exerts on its child.

    Both are about the child's port and in its axes.
    """

    kind: ClassVar[str] = "joint_wrench"
    components: ClassVar[tuple[Signal, ...]] = (*by_axis("N", "force."), *by_axis("N m", "torque."))

    joint: Text

    def measure(self, view: Space) -> ca.SX:
        return ca.vec(view.joint_wrench(self.joint))


KINDS: dict[str, type[Sensor]] = {
    cls.kind: cls
    for cls in (
        Acceleration,
        Accelerometer,
        AngularAcceleration,
        AngularRate,
        CenterOfMass,
        Gyro,
        JointWrench,
        Momentum,
        Position,
        SmallRotation,
        Velocity,
    )
}
