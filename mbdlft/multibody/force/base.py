"""What every kind of load has: a name, quantities, one magnitude, and wrenches on bodies."""

import abc
from collections.abc import Mapping
from typing import Any, ClassVar, NamedTuple, Protocol

import casadi as ca
from pydantic import field_validator

from mbdlft.base.description import Description, Direction, Expected, Name, Text, Values
from mbdlft.base.errors import SceneError
from mbdlft.base.signal import Signal


class Space(Protocol):
    """What a load sees of the bodies, at their displaced positions and at equilibrium."""

    gravity: ca.SX

    def port(self, port: str) -> tuple[str, ca.SX]:
        """Body of a port, and its position (3,) from the inboard port in the axes of the body (m)."""

    def outward(self, vector: ca.SX, body: str) -> ca.SX:
        """Components (3,) in the axes of a body of a vector fixed in the axes of the scene."""

    def between(self, a: str, b: str) -> ca.SX:
        """Vector (3,) from port a to port b, in the axes of the body of a (m)."""

    def between_at_rest(self, a: str, b: str) -> ca.SX:
        """The same at equilibrium."""

    def departure(self, a: str, b: str, order: int) -> ca.SX:
        """Displacement (order 0) or velocity (1) of b relative to a, first order, axes of a at rest."""

    elastic: float  # 1; 0 where the magnitude follows the law of a spring by itself


class BodyWrench(NamedTuple):
    """A wrench (3, 2) on a body, about its inboard port and in its axes."""

    body: str
    wrench: ca.SX


class Load(Description, abc.ABC):
    """A load; every concrete kind is final. Its magnitude is an input of the model.

    A magnitude that is left out is an unknown of the trim.
    """

    kind: ClassVar[str]
    signal: ClassVar[Signal]  # the magnitude
    magnitude_key: ClassVar[str]

    name: Name

    @classmethod
    def where(cls, fields: Mapping[str, Any]) -> str:
        return f"load {fields.get('name', '')!r}"

    @abc.abstractmethod
    def quantities(self) -> dict[str, Expected]:
        """All quantities by label, each as given and with the unit it must fit."""

    @abc.abstractmethod
    def ports(self) -> dict[str, str]:
        """The ports it acts at, by key."""

    @abc.abstractmethod
    def wrenches(self, values: Values, magnitude: ca.SX, space: Space) -> list[BodyWrench]:
        """Wrenches on the bodies, linear in the magnitude."""


class DirectedLoad(Load, abc.ABC):
    """A force or torque along a direction that is fixed in the body or in the scene."""

    port: Text
    direction: Direction
    frame: Text = "body"

    @field_validator("direction")
    @classmethod
    def _has_length(cls, direction: Direction) -> Direction:
        if not any(direction):
            raise SceneError(
                f"direction has zero length, got {list(direction)}. Give a direction; its length is "
                "ignored."
            )
        return direction

    @field_validator("frame")
    @classmethod
    def _is_known(cls, frame: str) -> str:
        if frame not in ("body", "ground"):
            raise SceneError(
                f"frame: expected 'body' (it turns with the body) or 'ground' (it keeps its direction), "
                f"got {frame!r}."
            )
        return frame

    def ports(self) -> dict[str, str]:
        return {"port": self.port}
