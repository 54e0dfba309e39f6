"""Loads: a force, a torque, buoyancy, springs with dampers between two ports.

A load has a name, quantities, one magnitude, and wrenches on bodies.

A thrust turns with its body, a constant pull does not. Buoyancy is the weight of the displaced fluid,
against gravity, at the center of buoyancy. Of a spring,

    f_a = h r + ((k - h) r'dr + c r'dr_dot) r / (r'r)

f_a is the force on the port a, r the vector from a to the other port b, dr its change from the
equilibrium; k is the stiffness, c the damping. The force density h is the tension over the length at
equilibrium. With h, the geometric stiffness h and the elastic stiffness (k - h) r r'/(r'r) are rational
in the parameters: the length, a square root, does not appear.
"""

import abc
from collections.abc import Mapping
from functools import partial
from typing import Annotated, ClassVar, NamedTuple, Self, final

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, field_validator, model_validator

from mbdlft.base.description import (
    Description,
    Direction,
    Expected,
    Name,
    Quantity,
    Text,
    Values,
    with_length,
)
from mbdlft.base.errors import SceneError
from mbdlft.base.unit import Signal
from mbdlft.multibody.spatial import Space, move_wrench
from mbdlft.problem.sx.constants import unit_vector


class BodyWrench(NamedTuple):
    """A wrench (3, 2) on a body, about its inboard port and in its axes."""

    body: str
    wrench: ca.SX


def pull(body: str, force: ca.SX, r: ca.SX) -> BodyWrench:
    """A force (3,) at `r` (3,) from the inboard port of a body."""
    return BodyWrench(body, move_wrench(ca.horzcat(force, ca.SX(3, 1)), r))


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
        magnitude = getattr(self, self.magnitude_key)
        if magnitude is None:
            return {}
        return {self.magnitude_key: Expected(magnitude, self.signal.unit)}

    def ports(self) -> dict[str, str]:
        """The ports at which the load acts, by the name of the field."""
        return {key: getattr(self, key) for key in ("port", "parent", "child") if hasattr(self, key)}

    def physical_problem(self, values: Mapping[str, NDArray[np.float64]]) -> str | None:
        """The condition that fails at one of the sampled values (samples,), or None."""
        return None

    @abc.abstractmethod
    def wrenches(self, values: Values, magnitude: ca.SX, space: Space) -> list[BodyWrench]:
        """Wrenches on the bodies; they are linear in the magnitude.

        `values` has one SX or float per label.
        """

    def outputs(self) -> tuple[Signal, ...]:
        """Forces that can be outputs, without the name of the load."""
        return ()

    def measure(self, values: Values, magnitude: ca.SX, space: Space) -> ca.SX:
        """The values (n,) of the outputs."""
        return ca.SX(0, 1)


class DirectedLoad(Load, abc.ABC):
    """A force or torque along a direction that is constant in the body or in the scene.

    `frame` is ``body`` if the direction turns with the body of `port`, ``ground`` if it does not.
    """

    magnitude_key: ClassVar[str] = "magnitude"

    port: Text
    direction: Annotated[Direction, AfterValidator(partial(with_length, what="direction"))]
    frame: Text = "body"
    magnitude: Quantity | None = None

    @field_validator("frame")
    @classmethod
    def _is_known(cls, frame: str) -> str:
        if frame not in ("body", "ground"):
            raise SceneError(
                f"frame: expected 'body' (it turns with the body) or 'ground' (it keeps its direction), "
                f"got {frame!r}."
            )
        return frame

    def unit(self, body: str, space: Space) -> ca.SX:
        """Unit vector (3,) along the direction, in the axes of its body."""
        unit = unit_vector(self.direction)
        return unit if self.frame == "body" else space.outward(unit, body)


@final
class Force(DirectedLoad):
    """A force of `magnitude` (N) along `direction` at `port`.

    `frame` is ``body`` (the force turns with the body) or ``ground`` (it keeps its direction).
    """

    kind: ClassVar[str] = "force"
    signal: ClassVar[Signal] = Signal("force", "N")

    def wrenches(self, values: Values, magnitude: ca.SX, space: Space) -> list[BodyWrench]:
        body, r = space.port(self.port)
        force = self.unit(body, space) * magnitude
        return [pull(body, force, r)]


@final
class Torque(DirectedLoad):
    """A torque of `magnitude` (N m) about `direction` on the body of `port`.

    `frame` is ``body`` (the torque turns with the body) or ``ground`` (it keeps its direction).
    """

    kind: ClassVar[str] = "torque"
    signal: ClassVar[Signal] = Signal("torque", "N m")

    def wrenches(self, values: Values, magnitude: ca.SX, space: Space) -> list[BodyWrench]:
        body, _ = space.port(self.port)
        torque = self.unit(body, space) * magnitude
        return [BodyWrench(body, ca.horzcat(ca.SX(3, 1), torque))]


@final
class Buoyancy(Load):
    """A force of minus `displaced_mass` times gravity at `port`, the center of buoyancy.

    `displaced_mass` (kg) is the density of the fluid times the displaced volume.
    """

    kind: ClassVar[str] = "buoyancy"
    signal: ClassVar[Signal] = Signal("displaced_mass", "kg")
    magnitude_key: ClassVar[str] = "displaced_mass"

    port: Text
    displaced_mass: Quantity | None = None

    def wrenches(self, values: Values, magnitude: ca.SX, space: Space) -> list[BodyWrench]:
        body, r = space.port(self.port)
        force = -space.outward(space.gravity, body) * magnitude
        return [pull(body, force, r)]


class SpringLoad(Load, abc.ABC):
    """A spring with `stiffness` (N/m) and a damper with `damping` (N s/m) between two ports."""

    parent: Text
    child: Text
    stiffness: Quantity = 0.0
    damping: Quantity = 0.0

    def quantities(self) -> dict[str, Expected]:
        law = {"stiffness": Expected(self.stiffness, "N/m"), "damping": Expected(self.damping, "N s/m")}
        return law | super().quantities()


@final
class Spring(SpringLoad):
    """A spring with `stiffness` (N/m) and a damper with `damping` (N s/m) between two ports.

    `force_density` (N/m), tension over length, gives the tension at equilibrium. `rest_length` (m) may
    give it instead if the distance of the ports at equilibrium does not depend on parameters. With
    neither of them the trim solves for the force density.
    """

    kind: ClassVar[str] = "spring"
    signal: ClassVar[Signal] = Signal("force_density", "N/m")
    magnitude_key: ClassVar[str] = "force_density"

    force_density: Quantity | None = None
    rest_length: Quantity | None = None

    @model_validator(mode="after")
    def _one_law(self) -> Self:
        if self.force_density is not None and self.rest_length is not None:
            raise SceneError(
                "give rest_length or force_density, not both: each says what the tension is at "
                "equilibrium."
            )
        return self

    def quantities(self) -> dict[str, Expected]:
        length = self.rest_length
        return super().quantities() | ({} if length is None else {"rest_length": Expected(length, "m")})

    def wrenches(self, values: Values, magnitude: ca.SX, space: Space) -> list[BodyWrench]:
        wrenches = []
        for a, b in ((self.parent, self.child), (self.child, self.parent)):
            body, at = space.port(a)
            r = space.between_at_rest(a, b)
            along = (values["stiffness"] - magnitude) * ca.dot(r, space.departure(a, b, 0))
            along = space.elastic * along + values["damping"] * ca.dot(r, space.departure(a, b, 1))
            force = space.between(a, b) * magnitude + r * (along / ca.dot(r, r))
            wrenches.append(pull(body, force, at))
        return wrenches
