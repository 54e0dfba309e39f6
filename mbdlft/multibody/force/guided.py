"""Loads along a line that something guides: struts, supports, and wheels on tires or on rails.

A strut acts along a direction n that its parent keeps, whatever the child does across it:

    f = f0 - k (s - s0) - c s_dot,        s = n . r

f is the force on the child along n, r the vector from the port of the parent to that of the child, f0 and
s0 are the values at equilibrium. The reaction acts on the parent at the port of the child, as that of a
guide without mass: the potential is that of s alone. So a tire carries its wheel and does not push it
aside, where a spring between two ports leans.

A support is a strut on the ground that also holds its foot sideways, by springs and dampers. A tire is
one along the normal n of the road at the point where the wheel about e touches (see `contact`), with a
side force F along e by the slip a and the camber g of its wheel, which rolls ahead at the speed v:

    F = -C a - C_g g,             a = (e . P' - v th . n)/v,      g = th . h,       h = e x n
    F + (l/v) F' = -C a - C_g g   with a relaxation length l

P' is the velocity of the point that touches, th the small rotation. With l the carcass has a deflection
q = l F/C as its state, whose patch rolls on at the slope q/l (Pacejka, Tire and Vehicle Dynamics, 5.3).

A wheel on a rail creeps: it slips a little in the area that touches, by x ahead, y along its axis, and it
spins about the normal by s, each over the speed. Its radius grows by the conicity c per meter along e:

    x = (h . P' - v c e . C/R)/v,     y as the slip a of a tire,     s = n . th'/v + g/R
    F_h = -f_x x,     F_e = -f_y y - f_ys s,     M_n = f_ys y - f_s s

with the coefficients of Kalker's linear theory (Wickens, Fundamentals of Rail Vehicle Dynamics, 2003).
"""

import abc
from collections.abc import Mapping
from functools import partial
from typing import Annotated, ClassVar, final

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator

from mbdlft.base.description import Axis, Direction, Expected, Quantity, Text, Values, with_length
from mbdlft.base.unit import Signal
from mbdlft.multibody.force.kinds import BodyWrench, SpringLoad, pull
from mbdlft.multibody.spatial import Space, in_scene
from mbdlft.problem.sx.constants import unit_vector


class Guided(SpringLoad, abc.ABC):
    """A spring and damper along a line that the parent keeps, and what acts on the child across it."""

    signal: ClassVar[Signal] = Signal("force", "N")
    magnitude_key: ClassVar[str] = "force"

    force: Quantity | None = None

    @property
    @abc.abstractmethod
    def line(self) -> Direction:
        """The direction of the line, in the axes of the parent."""

    def across(self, values: Values, space: Space) -> ca.SX:
        """Force (3,) on the child across the line, in the axes of the parent."""
        return ca.SX(3, 1)

    def foot(self, values: Values, space: Space) -> ca.SX:
        """The point (3,) at which it acts, from the port of the child, in the axes of the child."""
        return ca.SX(3, 1)

    def size(self, values: Values, magnitude: ca.SX, space: Space) -> ca.SX:
        """The force along the line."""
        stretch, rate = (
            ca.dot(unit_vector(self.line), space.departure(self.parent, self.child, order))
            for order in (0, 1)
        )
        return ca.SX(magnitude - space.elastic * values["stiffness"] * stretch - values["damping"] * rate)

    def wrenches(self, values: Values, magnitude: ca.SX, space: Space) -> list[BodyWrench]:
        body, at = space.port(self.parent)
        other, there = space.port(self.child)
        force = unit_vector(self.line) * self.size(values, magnitude, space) + self.across(values, space)
        foot = self.foot(values, space)
        at = at + space.between(self.parent, self.child) + space.across_now(foot, other, body)
        on_child = space.across_now(force, body, other)
        return [pull(body, -force, at), pull(other, on_child, there + foot)]

    def outputs(self) -> tuple[Signal, ...]:
        return (self.signal,)

    def measure(self, values: Values, magnitude: ca.SX, space: Space) -> ca.SX:
        return self.size(values, magnitude, space)


@final
class Strut(Guided):
    """A spring with `stiffness` (N/m) and a damper with `damping` (N s/m) along `direction`.

    `direction` is in the axes of the body of `parent`, and turns with it. `force` (N) is what acts on the
    child along it at equilibrium; without it the trim solves for it. Motions across it make no force.
    """

    kind: ClassVar[str] = "strut"

    direction: Annotated[Direction, AfterValidator(partial(with_length, what="direction"))]

    @property
    def line(self) -> Direction:
        return self.direction


@final
class Support(Guided):
    """A foot at `child` on a plane of the ground, or of another `parent`, across `normal`.

    `force` (N) carries the child at equilibrium; without it the trim solves for it. With a
    `side_stiffness` (N/m) and `side_damping` (N s/m) the foot is held along the plane, too, where it
    stands: a point; without them it slides.
    """

    kind: ClassVar[str] = "support"

    parent: Text = "ground"
    normal: Axis = (0.0, 0.0, 1.0)
    side_stiffness: Quantity = 0.0
    side_damping: Quantity = 0.0

    @property
    def line(self) -> Direction:
        return self.normal

    def quantities(self) -> dict[str, Expected]:
        sides = {"side_stiffness": Expected(self.side_stiffness, "N/m")}
        return super().quantities() | sides | {"side_damping": Expected(self.side_damping, "N s/m")}

    def across(self, values: Values, space: Space) -> ca.SX:
        ends = self.parent, self.child
        moved = space.between(*ends) - space.between_at_rest(*ends)
        rate = space.departure(*ends, 1)
        pull = -values["side_stiffness"] * moved - values["side_damping"] * rate
        normal = unit_vector(self.normal)
        return ca.SX(pull - normal * ca.dot(normal, pull))


def radius_problem(values: Mapping[str, NDArray[np.float64]], section: str) -> str | None:
    """What is wrong with the sampled radii (samples,) of a wheel and of its `section`, if it has one."""
    radius, inner = values["radius"], values.get(section, np.zeros(1))
    if np.min(radius) <= 0.0:
        return f"the radius must be positive, and it is {np.min(radius):g} m in the range."
    if np.min(inner) < 0.0 or np.min(radius - inner) < 0.0:
        return f"the {section} must have a radius from 0 to that of the wheel in the whole range."
    return None


class Wheel(Guided, abc.ABC):
    """A wheel about `axis` with its center at `child`, which rolls on a plane across `normal`.

    `parent` is the road or rail: the ground, or a body whose motion is imposed. `radius` (m) is the
    height of the center at equilibrium. It rolls along `axis` x `normal`, at the velocity of the scene.
    Vertical are the `stiffness` (N/m), `damping` (N s/m), and the `force` (N) at equilibrium, for which
    the trim solves where it is left out.
    """

    parent: Text = "ground"
    normal: Axis = (0.0, 0.0, 1.0)
    axis: Axis
    radius: Quantity

    @property
    def line(self) -> Direction:
        return self.normal

    def quantities(self) -> dict[str, Expected]:
        return super().quantities() | {"radius": Expected(self.radius, "m")}

    def physical_problem(self, values: Mapping[str, NDArray[np.float64]]) -> str | None:
        return radius_problem(values, "crown")

    def along(self, space: Space) -> tuple[ca.SX, ca.SX, ca.SX]:
        """Axis and heading (3,) of the wheel in the axes of the scene, and the speed along it."""
        body, _ = space.port(self.child)
        axis = space.across(unit_vector(self.axis), body, "ground")
        heading = ca.cross(axis, unit_vector(self.normal))
        return axis, heading, ca.dot(heading, space.velocity)

    def at_ground(self, port: str, values: Values, space: Space, order: int) -> ca.SX:
        """Velocity (3,) over the road of the point below a port (order 1), or acceleration (2)."""
        turned = in_scene(space, port, order)[2]
        moved = self.over_road(port, space, order)
        return ca.SX(moved - values["radius"] * ca.cross(turned, unit_vector(self.normal)))

    def over_road(self, port: str, space: Space, order: int) -> ca.SX:
        """Displacement (3,) of a port over that of the road, or a derivative."""
        moved, of_road = (in_scene(space, each, order)[1] for each in (port, self.parent))
        return moved - of_road

    def slip(self, port: str, values: Values, space: Space, order: int) -> ca.SX:
        """Velocity (order 1) or acceleration (2) across the heading of the point that touches."""
        normal, (axis, _, speed) = unit_vector(self.normal), self.along(space)
        turned = in_scene(space, port, order - 1)[2]
        return ca.SX(
            ca.dot(axis, self.at_ground(port, values, space, order)) - speed * ca.dot(normal, turned)
        )

    def lean(self, space: Space, order: int) -> ca.SX:
        """The camber, or a derivative."""
        return ca.dot(self.along(space)[1], in_scene(space, self.child, order)[2])

    def foot(self, values: Values, space: Space) -> ca.SX:
        body, _ = space.port(self.child)
        axis, up = unit_vector(self.axis), space.outward(unit_vector(self.normal), body)
        across = (values["radius"] - values.get("crown", values["radius"])) * ca.dot(axis, up)
        return ca.SX(across * axis - values["radius"] * up)

    def in_road(self, vector: ca.SX, space: Space) -> ca.SX:
        """Components (3,) in the axes of the parent of a vector in those of the scene."""
        return ca.SX(space.across(vector, "ground", space.port(self.parent)[0]))


@final
class Tire(Wheel):
    """The tire of a wheel about `axis` with its center at `child`, on a road across `normal`.

    `parent` is the road: the ground, or a body whose motion is imposed. `radius` (m) is the height of the
    center at equilibrium, `crown` (m) the radius of the cross-section. The tire has a vertical
    `stiffness` (N/m) and `damping` (N s/m), and the `force` (N) at equilibrium, for which the trim solves
    where it is left out. Sideways it has the `cornering` and `camber` stiffness (N/rad); with a
    `relaxation` length (m) the deflection is a state, and the speed may be zero. Ahead, along `axis` x
    `normal`, it rolls freely.
    """

    kind: ClassVar[str] = "tire"

    cornering: Quantity
    camber: Quantity = 0.0
    crown: Quantity = 0.0
    relaxation: Quantity | None = None

    @property
    def patch(self) -> str:
        """The name of the frame of its patch, where it has one."""
        return f"{self.name}..patch" if self.relaxation is not None else ""

    def quantities(self) -> dict[str, Expected]:
        sides = {key: Expected(getattr(self, key), "N/rad") for key in ("cornering", "camber")}
        sides["crown"] = Expected(self.crown, "m")
        if self.relaxation is not None:
            sides["relaxation"] = Expected(self.relaxation, "m")
        return super().quantities() | sides

    def carcass(self, values: Values) -> Values:
        """Quantities of the coordinate of the patch, where there is one."""
        if not self.patch:
            return {}
        return {"stiffness.side": values["cornering"] / values["relaxation"], "preload.side": 0.0}

    def physical_problem(self, values: Mapping[str, NDArray[np.float64]]) -> str | None:
        for key in ("cornering", "relaxation"):
            if key in values and np.min(values[key]) <= 0.0:
                return f"the {key} must be positive, and it is {np.min(values[key]):g} in the range."
        return super().physical_problem(values)

    def side(self, values: Values, space: Space) -> ca.SX:
        """The side force along the axis of a tire without relaxation."""
        slip = self.slip(self.child, values, space, 1) / self.along(space)[2]
        return ca.SX(-values["cornering"] * slip - values["camber"] * self.lean(space, 0))

    def across(self, values: Values, space: Space) -> ca.SX:
        if self.patch:
            return ca.SX(3, 1)
        return self.in_road(self.along(space)[0] * self.side(values, space), space)

    def outputs(self) -> tuple[Signal, ...]:
        return (self.signal,) if self.patch else (self.signal, Signal("side_force", "N"))

    def measure(self, values: Values, magnitude: ca.SX, space: Space) -> ca.SX:
        size = self.size(values, magnitude, space)
        return size if self.patch else ca.vertcat(size, self.side(values, space))


@final
class Creep(Wheel):
    """A wheel about `axis` with its center at `child` on a rail, with the forces of linear creep.

    `parent`, `normal`, `radius` and what is vertical are as for a tire. `longitudinal` and `lateral` (N)
    are the creep coefficients, `lateral_spin` (N m) and `spin` (N m^2) those with the spin creep. The
    radius grows by the `conicity` for each meter that the wheel moves along its axis: two wheels of one
    axle have opposite ones.
    """

    kind: ClassVar[str] = "creep"

    longitudinal: Quantity
    lateral: Quantity
    conicity: Quantity = 0.0
    lateral_spin: Quantity = 0.0
    spin: Quantity = 0.0

    def quantities(self) -> dict[str, Expected]:
        units = {
            "longitudinal": "N",
            "lateral": "N",
            "conicity": "1",
            "lateral_spin": "N m",
            "spin": "N m^2",
        }
        return super().quantities() | {key: Expected(getattr(self, key), x) for key, x in units.items()}

    def creepages(self, values: Values, space: Space) -> tuple[ca.SX, ca.SX, ca.SX]:
        """Slip ahead, slip along the axis (1), and spin (1/m)."""
        axis, heading, speed = self.along(space)
        touching = self.at_ground(self.child, values, space, 1)
        grown = values["conicity"] * ca.dot(axis, self.over_road(self.child, space, 0)) / values["radius"]
        turning = ca.dot(unit_vector(self.normal), in_scene(space, self.child, 1)[2]) / speed
        turning += self.lean(space, 0) / values["radius"]  # its axis tilts, about which it turns on
        ahead = ca.dot(heading, touching) / speed - grown
        return ahead, self.slip(self.child, values, space, 1) / speed, turning

    def creep(self, values: Values, space: Space) -> tuple[ca.SX, ca.SX, ca.SX]:
        """Force ahead, force along the axis, and torque about the normal."""
        x, y, spin = self.creepages(values, space)
        both = values["lateral_spin"]
        return (
            -values["longitudinal"] * x,
            -values["lateral"] * y - both * spin,
            both * y - values["spin"] * spin,
        )

    def across(self, values: Values, space: Space) -> ca.SX:
        axis, heading, _ = self.along(space)
        ahead, aside, _ = self.creep(values, space)
        return self.in_road(heading * ahead + axis * aside, space)

    def wrenches(self, values: Values, magnitude: ca.SX, space: Space) -> list[BodyWrench]:
        torque = unit_vector(self.normal) * self.creep(values, space)[2]
        signs = -1.0, 1.0  # of the reaction, and of what acts on the wheel
        return [
            BodyWrench(body, pair + ca.horzcat(ca.SX(3, 1), sign * space.across(torque, "ground", body)))
            for sign, (body, pair) in zip(signs, super().wrenches(values, magnitude, space), strict=True)
        ]

    def outputs(self) -> tuple[Signal, ...]:
        return (self.signal, Signal("force_ahead", "N"), Signal("side_force", "N"))

    def measure(self, values: Values, magnitude: ca.SX, space: Space) -> ca.SX:
        return ca.vertcat(self.size(values, magnitude, space), *self.creep(values, space)[:2])
