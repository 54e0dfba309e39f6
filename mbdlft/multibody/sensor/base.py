"""What every kind of sensor has: a name, and named components of what it measures."""

import abc
from collections.abc import Mapping
from typing import Any, ClassVar, NamedTuple, Protocol

import casadi as ca

from mbdlft.base.description import AXES, Description, Name, Text
from mbdlft.base.signal import Signal


class Small(NamedTuple):
    """Small rotation and displacement (3,) of a point, or their first or second time derivatives."""

    rotation: ca.SX
    displacement: ca.SX


class View(Protocol):
    """What a sensor sees; components are in the axes of a body, or of the scene for the ground."""

    def small(self, port: str, order: int) -> tuple[str, Small]:
        """Body of a port, and its displacement (order 0), velocity (1) or acceleration (2)."""

    def across(self, vector: ca.SX, source: str, target: str) -> ca.SX:
        """A vector (3,) in the axes of `source` in those of `target`, both at equilibrium."""

    def motion(self, port: str) -> ca.SX:
        """Motion (3, 3) of a port with gravity taken for an acceleration of the frame: see `spatial`."""

    def joint_wrench(self, joint: str) -> ca.SX:
        """Wrench (3, 2) of a joint on its child, about the child's port and in its axes."""

    def momentum(self, order: int) -> ca.SX:
        """Momentum [linear, angular] (3, 2) about the origin of the scene, of `small` (order + 1)."""

    def mass(self) -> ca.SX:
        """Total mass (kg)."""


class Sensor(Description, abc.ABC):
    """A sensor; every concrete kind is final. Its components are outputs of the model."""

    kind: ClassVar[str]
    components: ClassVar[tuple[Signal, ...]]

    name: Name

    @classmethod
    def where(cls, fields: Mapping[str, Any]) -> str:
        return f"sensor {fields.get('name', '')!r}"

    def signals(self) -> tuple[Signal, ...]:
        """Outputs, in the order of `measure`."""
        return tuple(Signal(f"{self.name}.{part.name}", part.unit) for part in self.components)

    @abc.abstractmethod
    def measure(self, view: View) -> ca.SX:
        """What is measured (n,), one entry for each component."""


class PortSensor(Sensor, abc.ABC):
    """A vector of one port, in the axes of `frame`: the ground, or a body at equilibrium."""

    port: Text
    frame: Text = "ground"


def by_axis(unit: str, prefix: str = "") -> tuple[Signal, ...]:
    """Components x, y, z."""
    return tuple(Signal(f"{prefix}{axis}", unit) for axis in AXES)
