"""The base classes of all kinds of loads: a name, quantities, one magnitude, and wrenches on bodies."""

import abc
from typing import ClassVar, NamedTuple, Protocol

import casadi as ca

from mbdlft.base.description import Description, Expected, Name, Values
from mbdlft.base.unit import Signal


class Space(Protocol):
    """The positions of the bodies that a load may ask for, displaced and at equilibrium.

    `gravity` (3,) is that of the scene, in its axes (m/s^2). `elastic` is 1; it is 0 where the magnitude
    of a spring already follows the law of the spring, so that its elongation must not be counted again.
    """

    gravity: ca.SX

    def port(self, port: str) -> tuple[str, ca.SX]:
        """Body of a port, and its position (3,) from the inboard port in the axes of the body (m)."""

    def outward(self, vector: ca.SX, body: str) -> ca.SX:
        """Components (3,) in the axes of a body of a vector that is constant in the axes of the scene."""

    def between(self, a: str, b: str) -> ca.SX:
        """Vector (3,) from port a to port b, in the axes of the body of a (m)."""

    def between_at_rest(self, a: str, b: str) -> ca.SX:
        """The same vector (3,) at equilibrium (m)."""

    def across_now(self, vector: ca.SX, source: str, target: str) -> ca.SX:
        """Components (3,) in the axes of the body `target` of a vector in those of the body `source`."""

    def departure(self, a: str, b: str, order: int) -> ca.SX:
        """Displacement (order 0) or velocity (1) of b relative to a, (3,), to first order.

        The components are in the axes that the body of a has at equilibrium.
        """

    elastic: float


class BodyWrench(NamedTuple):
    """A wrench (3, 2) on a body, about its inboard port and in its axes."""

    body: str
    wrench: ca.SX


class Load(Description, abc.ABC):
    """A load; every concrete kind is final. Its magnitude is an input of the model.

    `signal` names the magnitude and its unit, `magnitude_key` the field that gives its value at
    equilibrium. If this value is left out, the trim solves for it.
    """

    noun: ClassVar[str] = "load"

    kind: ClassVar[str]
    signal: ClassVar[Signal]
    magnitude_key: ClassVar[str]

    name: Name

    def quantities(self) -> dict[str, Expected]:
        """All quantities by label, each as it was given and with the unit that its value must have."""
        given = getattr(self, self.magnitude_key)
        return {} if given is None else {self.magnitude_key: Expected(given, self.signal.unit)}

    @abc.abstractmethod
    def ports(self) -> dict[str, str]:
        """The ports at which the load acts, by the name of the field."""

    @abc.abstractmethod
    def wrenches(self, values: Values, magnitude: ca.SX, space: Space) -> list[BodyWrench]:
        """Wrenches on the bodies; they are linear in the magnitude.

        `values` has one SX or float per label.
        """
