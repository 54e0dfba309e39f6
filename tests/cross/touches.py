"""Contacts with the ground in maximal coordinates: where a wheel touches, for any pose, and how it rolls.

A `Touch` stands where a `Link` does: its rows are velocities of the point of the body that touches, and
the displacements of the first ones only are held.
"""

from typing import Any, NamedTuple

import flint

from tests.cross.poses import TIME, Motion, Values, Vector, cross, dot, unit


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
