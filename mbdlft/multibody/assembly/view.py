"""What loads and sensors see of a placed tree: positions, small motions, wrenches, momentum."""

from collections.abc import Callable, Mapping, Sequence
from functools import cached_property

import casadi as ca
import numpy as np

from mbdlft.base.array import Array
from mbdlft.base.description import Values
from mbdlft.base.errors import SceneError, unknown_name
from mbdlft.multibody.assembly.placed import (
    Motions,
    Passed,
    Placed,
    across,
    between,
    inertial_wrenches,
    motions,
    pass_inward,
    place,
    port_arm,
)
from mbdlft.multibody.assembly.tree import Link, find_port
from mbdlft.multibody.body import GROUND, Body
from mbdlft.multibody.joint.move import Hinge
from mbdlft.multibody.scene.quantities import owner_name
from mbdlft.multibody.sensor import Small
from mbdlft.multibody.spatial import Coordinate, move_motion


class View:
    """The `Space` of loads and the `View` of sensors, over one tree and one set of symbols.

    Small motions of all orders are those of `vdot` at rest: at first order displacement, velocity and
    acceleration are the same linear function of q, v and vdot.
    """

    def __init__(
        self,
        links: tuple[Link, ...],
        bodies: Mapping[str, Body],
        values: Mapping[str, Values],
        coordinates: Mapping[str, Coordinate],
        gravity: ca.SX,
    ) -> None:
        self.gravity = gravity
        self.elastic = 1.0
        self.now = place(links, bodies, values, coordinates)
        self.coordinates = coordinates
        self.motions = Motions({}, {})
        self.momenta: Mapping[str, ca.SX] = {}  # (3,) of bodies that turn steadily (N m s)
        self.passed = Passed({}, {}, ca.SX(3, 2))
        self.joints = {link.joint.name: link.child.name for link in links}
        self.owner = ""  # of the port that is asked for, for messages
        self._small: dict[int, tuple[Placed, Motions]] = {}

    @cached_property
    def rest(self) -> Placed:
        """The tree at equilibrium; not every scene asks for it."""
        now = self.now
        rest = {name: _at_rest(coordinate, None) for name, coordinate in self.coordinates.items()}
        return place(now.links, now.bodies, now.values, rest)

    def find(self, port: str) -> tuple[str, str]:
        """Body and port by name."""
        body, name = find_port(self.now.bodies, self.owner, "port", port)
        return body.name, name

    # of loads -------------------------------------------------------------------------------

    def port(self, port: str) -> tuple[str, ca.SX]:
        body, name = self.find(port)
        return body, port_arm(self.now, body, name)

    def outward(self, vector: ca.SX, body: str) -> ca.SX:
        return across(self.now, vector, GROUND, body)

    def across_now(self, vector: ca.SX, source: str, target: str) -> ca.SX:
        """A vector (3,) in the axes of `source` in those of `target`, displaced as they are."""
        return across(self.now, vector, source, target)

    def between(self, a: str, b: str) -> ca.SX:
        return between(self.now, self.find(a), self.find(b))

    def between_at_rest(self, a: str, b: str) -> ca.SX:
        return between(self.rest, self.find(a), self.find(b))

    def gaps(
        self, a: str, b: str, evaluate: Callable[[ca.SX], Sequence[Array]]
    ) -> tuple[Sequence[Array], float]:
        """Vectors (3, 1) from port a to port b at equilibrium, and the largest length in them (m).

        The lengths are those from the ground to the ports, and those in the bodies of the ports: a port
        at the origin of the scene may be there by two lengths that cancel.

        `evaluate` gives the values of an expression at some points of the range.
        """
        arms = [self.between_at_rest("ground", port) for port in (a, b)]
        arms += [port_arm(self.rest, *self.find(port)) for port in (a, b)]
        reach = max(float(np.max(np.abs(value))) for arm in arms for value in evaluate(arm))
        return evaluate(self.between_at_rest(a, b)), reach

    def departure(self, a: str, b: str, order: int) -> ca.SX:
        body, small = self.small(a, order)
        other, moved = self.small(b, order)
        far = across(self.rest, moved.displacement, other, body) - small.displacement
        # the axes of a turn with it: seen from them b moves the other way
        return far - ca.cross(small.rotation, self.between_at_rest(a, b))

    # of sensors -----------------------------------------------------------------------------

    def small(self, port: str, order: int) -> tuple[str, Small]:
        body, name = self.find(port)
        placed, found = self._linear(order)
        moved = move_motion(found.bodies[body], port_arm(placed, body, name))
        return body, Small(moved[:, 1], moved[:, 2])

    def across(self, vector: ca.SX, source: str, target: str) -> ca.SX:
        if target not in self.rest.bodies:
            raise SceneError(
                f"{self.owner}, frame: " + unknown_name("body", target, self.rest.bodies)
            )
        return across(self.rest, vector, source, target)

    def motion(self, port: str) -> ca.SX:
        body, name = self.find(port)
        return move_motion(self.motions.bodies[body], port_arm(self.now, body, name))

    def joint_wrench(self, joint: str) -> ca.SX:
        if joint not in self.joints:
            raise SceneError(f"{self.owner}, joint: " + unknown_name("joint", joint, self.joints))
        return self.passed.joints[self.joints[joint]]

    def momentum(self, order: int) -> ca.SX:
        placed, found = self._linear(order)
        total = pass_inward(placed, found, inertial_wrenches(placed, found)).ground
        if order == 0:
            return total
        for link in self.now.links:  # what turns steadily has a momentum that is tilted
            name = link.child.name
            rotor = ca.SX(3, 1)
            for move in placed.moves[name]:
                if isinstance(move, Hinge) and move.steady:
                    rotor = move.axis * move.momentum
            momentum = rotor + self.momenta.get(name, ca.SX(3, 1))
            if momentum.nnz():
                _, tilted = self._linear(0)
                turned = ca.cross(tilted.bodies[name][:, 1], momentum)
                total += ca.horzcat(ca.SX(3, 1), across(placed, turned, name, GROUND))
        return total

    def mass(self) -> ca.SX:
        total = ca.SX(0)
        for link in self.now.links:
            values = self.now.values.get(owner_name(link.child), {})
            total = total + link.child.total_mass(values)
        return total

    def _linear(self, order: int) -> tuple[Placed, Motions]:
        """The tree at rest, with small motions of one order in place of accelerations."""
        if order not in self._small:
            now = self.now
            coordinates = {
                name: _at_rest(coordinate, order) for name, coordinate in self.coordinates.items()
            }
            placed = place(now.links, now.bodies, now.values, coordinates)
            self._small[order] = placed, motions(placed, ca.SX(3, 3))
        return self._small[order]


def _at_rest(coordinate: Coordinate, order: int | None) -> Coordinate:
    """q = v = 0, and the coordinates of one order as accelerations (none: zero)."""
    zero = ca.SX(coordinate.q.numel(), 1)
    return Coordinate(zero, zero, zero if order is None else coordinate[order])
