"""Contacts with a plane of the ground: wheels and balls that roll without slip, and knife edges.

With the normal n of the plane, the axis e of a wheel, its center C, its radius R and the radius r of its
tire (0: a knife edge; R: a ball), the wheel stands at

    P = C - R n + (R - r) (n . e) e

to the first order around an upright wheel, n . e = 0. The point of the wheel at P has the velocity of the
ground. The frame of the scene moves over the ground with the velocity V, and a wheel that turns at a
steady rate W there has R W e x n = V. With small motions c of C and th of the wheel,

    0 = n . c,        0 = t . (c' - R (th' + W th x e) x n)         for t in the plane

The first is holonomic, the others are not: they hold for rates only, and there are more positions than
rates. Their forces act at P (Lagrange and d'Alembert). A knife edge slides along its heading h alone:
with the side s = n x h, 0 = s . c' - (V . h) n . th (Neimark, Fufaev, Dynamics of Nonholonomic Systems).
"""

import abc
from collections.abc import Mapping
from typing import ClassVar, Self, final

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from pydantic import InstanceOf, model_validator

from mbdlft.base.description import Axis, Description, Direction, Expected, Name, Quantity, Text, Values
from mbdlft.base.errors import SceneError
from mbdlft.base.unit import Signal
from mbdlft.multibody.force import BodyWrench, Tire
from mbdlft.multibody.force.guided import radius_problem
from mbdlft.multibody.joint.kinds import plane
from mbdlft.multibody.spatial import Space, in_scene, move_wrench
from mbdlft.problem.sx.constants import unit_vector


class Contact(Description, abc.ABC):
    """A contact of the body of `port` with a plane of the ground across `normal`; every kind is final."""

    noun: ClassVar[str] = "contact"

    kind: ClassVar[str]

    name: Name
    port: Text
    normal: Axis = (0.0, 0.0, 1.0)

    def quantities(self) -> dict[str, Expected]:
        """All quantities by label, each as it was given and with the unit that its value must have."""
        return {}

    def physical_problem(self, values: Mapping[str, NDArray[np.float64]]) -> str | None:
        """The condition that fails at one of the sampled values (samples,), or None."""
        return None

    @property
    @abc.abstractmethod
    def direction(self) -> Direction | None:
        """The axis or heading, in the axes of the body, that is across the normal."""

    @property
    def tangents(self) -> tuple[ca.SX, ...]:
        """Directions (3,) of the plane, in the axes of the scene."""
        return plane(self.normal)

    @abc.abstractmethod
    def signals(self) -> tuple[tuple[Signal, ...], tuple[Signal, ...]]:
        """Multipliers (N) of holonomic constraints, and of those of rates."""

    @abc.abstractmethod
    def rows(self, values: Values, space: Space, order: int) -> tuple[ca.SX, ca.SX]:
        """Constraints of one order of small motions: holonomic ones, and for orders 1 and 2 the others.

        `values` has the quantities and the steady ``rate`` of the body.
        """

    @abc.abstractmethod
    def slip(self, values: Values, space: Space) -> ca.SX:
        """What the steady motion misses, a column of velocities (m/s)."""

    @abc.abstractmethod
    def reaction(self, values: Values, space: Space, held: ca.SX, rolling: ca.SX) -> BodyWrench:
        """The wrench on the body, by the multipliers of both kinds."""


@final
class Rolling(Contact):
    """A wheel about `axis` with its center at `port`, or a ball without `axis`, that rolls without slip.

    `axis` has the components of the axes of the body; at equilibrium it is across the `normal`. `radius`
    (m) is that of the whole wheel, `tire` (m) that of its cross-section: 0 for a knife edge. `plane` is a
    port of the ground on the plane.
    """

    kind: ClassVar[str] = "rolling"

    radius: Quantity
    axis: Axis | None = None
    tire: Quantity = 0.0
    plane: Text = "ground"

    @model_validator(mode="after")
    def _stands_on_the_ground(self) -> Self:
        if self.plane.partition(".")[0] != "ground":
            raise SceneError(
                f"plane: expected 'ground' or one of its ports, got {self.plane!r}: a plane that moves, "
                "such as one of a body, is not supported."
            )
        if self.axis is None and self.tire != 0.0:
            raise SceneError(f"tire: a ball has none, got {self.tire!r}. Give an axis, or leave it out.")
        return self

    @property
    def direction(self) -> Direction | None:
        return self.axis

    def quantities(self) -> dict[str, Expected]:
        return {"radius": Expected(self.radius, "m"), "tire": Expected(self.tire, "m")}

    def physical_problem(self, values: Mapping[str, NDArray[np.float64]]) -> str | None:
        return radius_problem(values, "tire")

    def signals(self) -> tuple[tuple[Signal, ...], tuple[Signal, ...]]:
        normal, *others = (Signal(f"{self.name}.force.{label}", "N") for label in ("normal", "1", "2"))
        return (normal,), tuple(others)

    def _steady(self, values: Values, space: Space, body: str) -> ca.SX:
        """Steady angular velocity (3,), in the axes of the scene."""
        if self.axis is None:
            return ca.SX(3, 1)
        return ca.SX(space.across(unit_vector(self.axis), body, "ground") * values["rate"])

    def rows(self, values: Values, space: Space, order: int) -> tuple[ca.SX, ca.SX]:
        normal = unit_vector(self.normal)
        body, moved, turned = in_scene(space, self.port, order)
        if order == 0:
            return ca.dot(normal, moved), ca.SX(0, 1)
        before = in_scene(space, self.port, order - 1)[2]
        turning = turned + ca.cross(before, self._steady(values, space, body))
        slip = moved - values["radius"] * ca.cross(turning, normal)
        return ca.dot(normal, moved), ca.vertcat(*(ca.dot(t, slip) for t in self.tangents))

    def slip(self, values: Values, space: Space) -> ca.SX:
        steady = self._steady(values, space, space.port(self.port)[0])
        return ca.SX(space.velocity - values["radius"] * ca.cross(steady, unit_vector(self.normal)))

    def reaction(self, values: Values, space: Space, held: ca.SX, rolling: ca.SX) -> BodyWrench:
        body, at = space.port(self.port)
        normal = unit_vector(self.normal)
        force = normal * held[0] + sum(
            (t * rolling[k] for k, t in enumerate(self.tangents)), start=ca.SX(3, 1)
        )
        up = space.outward(normal, body)
        down = -values["radius"] * up
        if self.axis is not None:
            axis = unit_vector(self.axis)
            down += (values["radius"] - values["tire"]) * ca.dot(axis, up) * axis
        pair = ca.horzcat(space.outward(force, body), ca.SX(3, 1))
        return BodyWrench(body, move_wrench(pair, at + down))


@final
class KnifeEdge(Contact):
    """A skate or keel at `port` that does not slip sideways: it moves along its `heading` alone.

    `heading` has the components of the axes of the body; at equilibrium it is across the `normal`. The
    height is not held.
    """

    kind: ClassVar[str] = "knife_edge"

    heading: Axis

    @property
    def direction(self) -> Direction | None:
        return self.heading

    def signals(self) -> tuple[tuple[Signal, ...], tuple[Signal, ...]]:
        return (), (Signal(f"{self.name}.force", "N"),)

    def _along(self, space: Space, body: str) -> ca.SX:
        return space.across(unit_vector(self.heading), body, "ground")

    def rows(self, values: Values, space: Space, order: int) -> tuple[ca.SX, ca.SX]:
        if order == 0:
            return ca.SX(0, 1), ca.SX(0, 1)
        normal = unit_vector(self.normal)
        body, moved, _ = in_scene(space, self.port, order)
        heading, turned = self._along(space, body), in_scene(space, self.port, order - 1)[2]
        aside = ca.dot(ca.cross(normal, heading), moved)
        return ca.SX(0, 1), aside - ca.dot(space.velocity, heading) * ca.dot(normal, turned)

    def slip(self, values: Values, space: Space) -> ca.SX:
        body, _ = space.port(self.port)
        return ca.dot(ca.cross(unit_vector(self.normal), self._along(space, body)), space.velocity)

    def reaction(self, values: Values, space: Space, held: ca.SX, rolling: ca.SX) -> BodyWrench:
        body, at = space.port(self.port)
        side = ca.cross(space.outward(unit_vector(self.normal), body), unit_vector(self.heading))
        return BodyWrench(body, move_wrench(ca.horzcat(side * rolling, ca.SX(3, 1)), at))


@final
class Patch(Contact):
    """The patch of a tire with a relaxation length; no kind of its own. See `mbdlft.multibody.force`.

    It slides along the axis of the wheel, on the spring of the carcass, and its point at the road moves
    on at the slope of the deflection over the relaxation length.
    """

    noun: ClassVar[str] = "load"
    kind: ClassVar[str] = "patch"

    tire: InstanceOf[Tire]

    @property
    def direction(self) -> Direction | None:
        return self.tire.axis

    def signals(self) -> tuple[tuple[Signal, ...], tuple[Signal, ...]]:
        return (), (Signal(f"{self.name}.side_force", "N"),)

    def rows(self, values: Values, space: Space, order: int) -> tuple[ca.SX, ca.SX]:
        if order == 0:
            return ca.SX(0, 1), ca.SX(0, 1)
        tire, (axis, _, speed) = self.tire, self.tire.along(space)
        patch, center = (in_scene(space, port, order - 1)[1] for port in (self.port, tire.child))
        slope = ca.dot(axis, patch - center) / values["relaxation"]
        slope += values["camber"] / values["cornering"] * tire.lean(space, order - 1)
        return ca.SX(0, 1), tire.slip(self.port, values, space, order) + speed * slope

    def slip(self, values: Values, space: Space) -> ca.SX:
        return ca.dot(self.tire.along(space)[0], space.velocity)

    def reaction(self, values: Values, space: Space, held: ca.SX, rolling: ca.SX) -> BodyWrench:
        pair = ca.horzcat(unit_vector(self.tire.axis) * rolling, ca.SX(3, 1))
        return BodyWrench(self.port, move_wrench(pair, self.tire.foot(values, space)))


KINDS: dict[str, type[Contact]] = {cls.kind: cls for cls in (KnifeEdge, Rolling)}
