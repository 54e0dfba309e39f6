"""What every kind of joint has: two ports, quantities, and how motions and wrenches cross it.

A joint places the frame of its child's port on its parent's port; at zero position their axes are
parallel. Its coordinate is the displacement from the equilibrium position.
"""

import abc
from collections.abc import Mapping
from typing import Any, ClassVar, NamedTuple

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from pydantic import field_validator

from mbdlft.description import Description, Direction, Expected, Text, Values
from mbdlft.errors import SceneError


class Coordinate(NamedTuple):
    """Symbols of one joint: displacement, rate, acceleration (none for a fixed joint)."""

    q: ca.SX
    v: ca.SX
    a: ca.SX


class Turn(NamedTuple):
    """One factor of an equilibrium rotation: cosine and sine of its angle."""

    cosine: ca.SX | float
    sine: ca.SX | float


class Joint(Description, abc.ABC):
    """A joint; every concrete kind is final. `parent` and `child` are ``body`` or ``body.port``."""

    kind: ClassVar[str]
    degrees_of_freedom: ClassVar[int]
    effort: ClassVar[tuple[str, str] | None]
    measures: ClassVar[tuple[tuple[str, str], ...]]

    name: Text
    parent: Text
    child: Text

    @classmethod
    def where(cls, fields: Mapping[str, Any]) -> str:
        return f"joint {fields.get('name', '')!r}"

    @abc.abstractmethod
    def quantities(self) -> dict[str, Expected]:
        """All quantities by label, each as given and with the unit it must fit."""

    @abc.abstractmethod
    def motion(
        self,
        motion: ca.SX,
        values: Values,
        turns: list[Turn],
        coordinate: Coordinate,
    ) -> ca.SX:
        """Motion (3, 3) of the child's port in its frame, from that of the parent's port."""

    @abc.abstractmethod
    def wrench(
        self,
        wrench: ca.SX,
        values: Values,
        turns: list[Turn],
        coordinate: Coordinate,
    ) -> ca.SX:
        """Wrench (3, 2) about the parent's port in its frame, from that about the child's port."""

    def physical_problem(self, values: Mapping[str, NDArray[np.float64]]) -> str | None:
        """Which condition of physics fails at one of the sampled values, or None."""
        lowest = float(np.min(values.get("actuator_inertia", np.zeros(1))))
        return f"the actuator_inertia is negative in the range: {lowest:g}." if lowest < 0 else None

    def carry(self, wrench: ca.SX, motion: ca.SX, values: Values) -> ca.SX:
        """Wrench (3, 2) about the child's port with that of the actuator's inertia added."""
        return wrench

    @abc.abstractmethod
    def resistance(self, wrench: ca.SX, values: Values, coordinate: Coordinate) -> ca.SX:
        """Effort (degrees_of_freedom,) for a wrench at the child's port, springs and dampers."""


class AxisJoint(Joint, abc.ABC):
    """A joint about or along one axis, a direction in the frame of either port."""

    axis: Direction

    @field_validator("axis")
    @classmethod
    def _has_length(cls, axis: Direction) -> Direction:
        if not np.any(axis):
            raise SceneError(
                f"axis has zero length, got {list(axis)}. Give a direction; its length is ignored."
            )
        return axis

    def direction(self) -> ca.SX:
        """The axis with unit length (3,); exact zeros stay structural."""
        axis = np.asarray(self.axis) / np.linalg.norm(self.axis)
        return ca.sparsify(ca.SX(axis))
