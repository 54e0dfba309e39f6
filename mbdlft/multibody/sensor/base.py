"""The base classes of all kinds of sensors: a name, and named components of the measured quantity."""

import abc
from typing import ClassVar, NamedTuple, Protocol

import casadi as ca

from mbdlft.base.description import AXES, Description, Name
from mbdlft.base.unit import Signal


class Small(NamedTuple):
    """Small rotation and displacement (3,) of a point, or their first or second time derivatives."""

    rotation: ca.SX
    displacement: ca.SX


class View(Protocol):
    """The motions and wrenches that a sensor may ask for.

    Components of vectors are in the axes of a body; those of the ground are the axes of the scene.
    """

    def small(self, port: str, order: int) -> tuple[str, Small]:
        """Body of a port, and the port's displacement (order 0), velocity (1) or acceleration (2)."""

    def across(self, vector: ca.SX, source: str, target: str) -> ca.SX:
        """Components (3,) in the axes of body `target` of a vector (3,) in those of body `source`.

        The bodies are where they are at equilibrium.
        """

    def motion(self, port: str) -> ca.SX:
        """Motion (3, 3) of a port, as defined in `mbdlft.multibody.spatial`.

        Gravity is in it as an acceleration of the scene's frame by minus gravity.
        """

    def joint_wrench(self, joint: str) -> ca.SX:
        """Wrench (3, 2) that a joint exerts on its child, about the child's port and in its axes."""

    def momentum(self, order: int) -> ca.SX:
        """Momentum [linear, angular] (3, 2) about the origin of the scene, with small motions for rates.

        With `order` 1 the velocities of `small` make the momentum; with `order` 0 the displacements take
        their place.
        """

    def mass(self) -> ca.SX:
        """Total mass (kg)."""


class Sensor(Description, abc.ABC):
    """A sensor; every concrete kind is final. Its components are outputs of the model."""

    noun: ClassVar[str] = "sensor"

    kind: ClassVar[str]
    components: ClassVar[tuple[Signal, ...]]

    name: Name

    def signals(self) -> tuple[Signal, ...]:
        """Outputs, in the order of `measure`."""
        return tuple(Signal(f"{self.name}.{part.name}", part.unit) for part in self.components)

    @abc.abstractmethod
    def measure(self, view: View) -> ca.SX:
        """The measured quantity (n,), one entry for each component."""


def by_axis(unit: str, prefix: str = "") -> tuple[Signal, ...]:
    """Signals of the components x, y and z of a vector in one unit."""
    return tuple(Signal(f"{prefix}{axis}", unit) for axis in AXES)
