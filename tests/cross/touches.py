"""Contacts with the ground in maximal coordinates: where a wheel touches, for any pose, and how it rolls.

A `Touch` stands where a `Link` does: its rows are velocities of the point of the body that touches, and
the displacements of the first ones only are held.
"""

from typing import Any, NamedTuple

import flint

from tests.cross.poses import TIME, Motion, Values, Vector, cross, dot, unit


class Wheel(NamedTuple):
    """A wheel that is a load, on the ground: what it pushes with, for any motion of its body.

    Its side is the level part of its axis; it slips by the velocity along the side of the point that
    touches, spin and all. It leans as its axis does, and it is lower by what its center has sunk.
    """

    kind: str
    at: Vector
    normal: Vector
    velocity: Vector
    axis: Vector
    values: dict[str, Any]  # radius, stiffness, ...

    def _place(self, C: Motion) -> tuple[Vector, Vector, Vector]:
        """From the body to the point that touches; the side, and the heading."""
        along, radius = C.turn * self.axis, self.values["radius"]
        up = self.normal - along * dot(self.normal, along)
        crown = self.values.get("crown", radius)
        down = up * (-(radius - crown) / dot(up, up).sqrt()) - self.normal * crown
        side = unit((along - self.normal * dot(along, self.normal)).entries())
        return C.turn * self.at + down, side, cross(side, self.normal)

    def carried(self, C: Motion, held: "Motion") -> Any:
        """The vertical force beyond that at the motion `held`."""
        sunk = dot(self.normal, C.point(self.at) - held.point(self.at))
        arm = C.turn * self.at
        return -self.values["stiffness"] * sunk - self.values["damping"] * dot(
            self.normal, C.velocity + cross(C.omega, arm)
        )

    def creep(self, C: Motion, held: "Motion") -> list[Any]:
        """Force ahead, force to the side, and torque about the normal."""
        x, (arm, side, heading) = self.values, self._place(C)
        speed = dot(self._place(held)[2], self.velocity)
        at_ground = self.velocity + C.velocity + cross(C.omega, arm)
        if self.kind == "tire":
            lean = dot(self.normal, C.turn * self.axis)
            return [0, -x["cornering"] * dot(side, at_ground) / speed - x["camber"] * lean, 0]
        moved = dot(self._place(held)[1], C.point(self.at) - held.point(self.at))
        rate = dot(heading, cross(C.omega, arm)) / x["radius"]  # of its spin: its larger rim runs faster
        ahead = (dot(heading, at_ground) + rate * x["conicity"] * moved) / speed
        aside, spin = dot(side, at_ground) / speed, dot(self.normal, C.omega) / speed
        both = x["lateral_spin"]
        return [
            -x["longitudinal"] * ahead,
            -x["lateral"] * aside - both * spin,
            both * aside - x["spin"] * spin,
        ]

    def pushed(self, C: Motion, force: Any, creep: Values) -> Values:
        """Force and torque about the origin of the body (6,)."""
        arm, side, heading = self._place(C)
        whole = self.normal * force + heading * creep[0] + side * creep[1]
        return [*whole.entries(), *(cross(arm, whole) + self.normal * creep[2]).entries()]


class Touch(NamedTuple):
    """A wheel (with an axis), a ball, or a knife edge (with a heading) of a body on the ground (-1)."""

    name: str
    child: int
    at: Vector  # center or edge, in the axes of the body
    normal: Vector
    tangents: tuple[Vector, ...]
    velocity: Vector  # of the scene over the ground
    radius: Any = 0
    tire: Any = 0
    axis: Vector | None = None
    heading: Vector | None = None
    parent: int = -1
    laws: tuple[Any, ...] = ()

    @property
    def names(self) -> list[str]:
        if self.heading is not None:
            return [f"{self.name}.force"]
        return [f"{self.name}.force.{label}" for label in ("normal", "1", "2")]

    @property
    def held(self) -> int:
        """How many of the rows are holonomic."""
        return 0 if self.heading is not None else 1

    def _down(self, C: Motion) -> tuple[Vector, Any]:
        """From the center to the middle of the tire, and the height of the center above the ground."""
        up = self.normal
        if self.axis is not None:
            along = C.turn * self.axis
            up = up - along * dot(up, along)
        size, r = dot(up, up).sqrt(), self.radius - self.tire
        return up * (-r / size), r * size + self.tire

    def _rows(self, C: Motion) -> list[tuple[Vector, Vector]]:
        """Directions, and their moments about the origin of the body."""
        arm = C.turn * self.at
        if self.heading is not None:
            side = unit(cross(self.normal, C.turn * self.heading).entries())
            return [(side, cross(arm, side))]
        arm = arm + self._down(C)[0] - self.normal * self.tire
        return [(t, cross(arm, t)) for t in (self.normal, *self.tangents)]

    def relation(self, P: Motion, C: Motion) -> Values:
        """The height above the plane through the origin of the scene, and nothing for the other rows."""
        if self.heading is not None:
            return [flint.arb(0)]
        height = dot(self.normal, C.point(self.at)) - self._down(C)[1]
        return [height, flint.arb(0), flint.arb(0)]

    def jacobian(self, P: Motion, C: Motion) -> list[Values]:
        none = [flint.arb(0)] * 6
        return [[*none, *t.entries(), *moment.entries()] for t, moment in self._rows(C)]

    def _rates(self, C: Motion) -> Values:
        return [dot(t, C.velocity + self.velocity) + dot(moment, C.omega) for t, moment in self._rows(C)]

    def in_time(self, P: Motion, C: Motion) -> Values:
        """Heights, rates, and accelerations as differences of the rates."""

        def later(t: Any) -> Values:
            velocity, omega = C.velocity + C.acceleration * t, C.omega + C.alpha * t
            return self._rates(C.after(t)._replace(velocity=velocity, omega=omega))

        slopes = [(b - a) / (2 * TIME) for a, b in zip(later(-TIME), later(TIME), strict=True)]
        return [*self.relation(P, C), *self._rates(C), *slopes]
