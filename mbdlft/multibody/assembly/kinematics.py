"""The tree with its moves at some coordinates: where bodies are, how they move, what they pass on.

Every vector of a body is in the axes of the body and counted from its inboard port, the one at which its
joint holds it. Motions go outward, wrenches inward: the recursive Newton-Euler algorithm. `View` is what
loads and sensors see of it: positions, small motions, wrenches, momentum.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType
from typing import NamedTuple

import casadi as ca
import numpy as np

from mbdlft.base.array import Array
from mbdlft.base.description import Values
from mbdlft.multibody.assembly.tree import Link, PortJoint, find_port
from mbdlft.multibody.body import GROUND, Body
from mbdlft.multibody.contact import Contact
from mbdlft.multibody.force import BodyWrench, Load
from mbdlft.multibody.joint import Move
from mbdlft.multibody.joint.move import Hinge
from mbdlft.multibody.loop import Loop
from mbdlft.multibody.scene.quantities import owner_name
from mbdlft.multibody.spatial import Coordinate, Small, move_motion, move_wrench


@dataclass(frozen=True, slots=True, eq=False)
class Placed:
    """A tree at some coordinates."""

    links: tuple[Link, ...]  # from the ground outward
    moves: Mapping[str, tuple[Move, ...]]  # factors of the joint of each link, by child
    arms: Mapping[str, ca.SX]  # (3,) from the parent's inboard port to the joint, by child (m)
    inboard: Mapping[str, ca.SX]  # (3,) from the origin of each body to its inboard port (m)
    elastic: Mapping[str, Coordinate]  # of the elastic bodies
    bodies: Mapping[str, Body]
    values: Mapping[str, Values]  # quantities by owner

    def of(self, body: Body) -> Values:
        return self.values.get(owner_name(body), {})


def place(
    links: tuple[Link, ...],
    bodies: Mapping[str, Body],
    values: Mapping[str, Values],
    coordinates: Mapping[str, Coordinate],
) -> Placed:
    """The tree at coordinates by name: those of the joints, and those of the elastic bodies."""
    inboard: dict[str, ca.SX] = {GROUND: ca.SX(3, 1)}
    moves: dict[str, tuple[Move, ...]] = {}
    arms: dict[str, ca.SX] = {}
    elastic: dict[str, Coordinate] = {}
    for link in links:
        name, joint = link.child.name, link.joint
        arm, origin = position(link.parent, link.parent_port, values), inboard[link.parent.name]
        arms[name] = arm - origin if origin.nnz() else arm
        inboard[name] = position(link.child, link.child_port, values)
        elastic[name] = coordinates[link.child_owner]
        at = elastic[link.parent.name] if joint.kind == "port" else coordinates[link.owner]
        moves[name] = joint.moves(values[link.owner], at)
    return Placed(links, moves, arms, inboard, elastic, bodies, values)


def position(body: Body, port: str, values: Mapping[str, Values]) -> ca.SX:
    """Position (3,) of a port from the origin of its body (m)."""
    return body.port_position(port, values.get(owner_name(body), {}))


def port_arm(placed: Placed, body: str, port: str) -> ca.SX:
    """Position (3,) of a port from the inboard port of its body (m)."""
    return position(placed.bodies[body], port, placed.values) - placed.inboard[body]


class Motions(NamedTuple):
    """Motions (3, 3) by body, of the inboard port, and after each move of the joint that holds it."""

    bodies: Mapping[str, ca.SX]
    moves: Mapping[str, Sequence[ca.SX]]


def motions(placed: Placed, ground: ca.SX, others: Mapping[str, ca.SX] = MappingProxyType({})) -> Motions:
    """Motions of all bodies for those (3, 3) of the ground and of `others`, where other links start."""
    bodies = {GROUND: ground, **others}
    after: dict[str, list[ca.SX]] = {}
    for link in placed.links:
        name = link.child.name
        motion = move_motion(bodies[link.parent.name], placed.arms[name])
        after[name] = [motion := move.motion(motion) for move in placed.moves[name]]
        bodies[name] = motion
    return Motions(bodies, after)


def inertial_wrenches(placed: Placed, moving: Motions) -> dict[str, ca.SX]:
    """Wrench (3, 2) that the motion of each body needs, about its inboard port."""
    return {
        (name := link.child.name): link.child.wrench(
            moving.bodies[name], placed.of(link.child), placed.inboard[name], placed.elastic[name]
        )
        for link in placed.links
    }


def body_efforts(placed: Placed, moving: Motions) -> dict[str, ca.SX]:
    """Generalized forces (n,) that the coordinates of each body need; a rigid one has none."""
    return {
        owner_name(body := link.child): body.efforts(
            moving.bodies[body.name], placed.of(body), placed.elastic[body.name]
        )
        for link in placed.links
    }


class Passed(NamedTuple):
    """What wrenches do on their way to the ground: efforts (n,) by joint and elastic body, wrenches of
    the joints on their children (3, 2) by child, and the wrench of the joints on the ground (3, 2)."""

    efforts: Mapping[str, ca.SX]
    joints: Mapping[str, ca.SX]
    ground: ca.SX


def pass_inward(
    placed: Placed,
    moving: Motions,
    needed: Mapping[str, ca.SX],
    of_bodies: Mapping[str, ca.SX] | None = None,
) -> Passed:
    """Inward pass of the wrenches `needed` by the bodies apart from their joints, by body.

    `of_bodies` are their generalized forces, those of `body_efforts` if they are not given.
    """
    total = {**needed, GROUND: ca.SX(3, 2)}
    joints: dict[str, ca.SX] = {}
    collected = dict(body_efforts(placed, moving) if of_bodies is None else of_bodies)
    for link in reversed(placed.links):
        name = link.child.name
        joints[name] = wrench = total[name]
        of_moves: list[ca.SX] = []
        for move, motion in zip(reversed(placed.moves[name]), reversed(moving.moves[name]), strict=True):
            wrench = move.carried(wrench, motion)
            of_moves.insert(0, move.effort(wrench, motion))
            wrench = move.wrench(wrench)
        efforts = ca.vertcat(*of_moves)
        if isinstance(link.joint, PortJoint):
            efforts = collected[link.owner] + efforts
        collected[link.owner] = efforts
        total[link.parent.name] += move_wrench(wrench, placed.arms[name])
    return Passed(collected, joints, total[GROUND])


def across(placed: Placed, vector: ca.SX, source: str, target: str) -> ca.SX:
    """Components in the axes of `target` of a vector (3,) in those of `source`."""
    up, down = _path(placed, source, target)
    for name in up:
        for move in reversed(placed.moves[name]):
            vector = move.in_parent_axes(vector)
    for name in down:
        for move in placed.moves[name]:
            vector = move.in_child_axes(vector)
    return vector


def between(placed: Placed, a: tuple[str, str], b: tuple[str, str]) -> ca.SX:
    """Vector (3,) from port a to port b, (body, port) each, in the axes of the body of a (m)."""
    up, down = _path(placed, b[0], a[0])
    r = port_arm(placed, *b)
    for name in up:
        for move in reversed(placed.moves[name]):
            r = move.offset() + move.in_parent_axes(r)
        r = r + placed.arms[name]
    for name in down:
        r = r - placed.arms[name]
        for move in placed.moves[name]:
            r = move.in_child_axes(r - move.offset())
    return r - port_arm(placed, *a)


def _path(placed: Placed, source: str, target: str) -> tuple[list[str], list[str]]:
    """Links to go inward from `source`, then outward to `target`, by child."""
    parents = {link.child.name: link.parent.name for link in placed.links}
    up, down = [source], [target]
    for chain in (up, down):
        while chain[-1] != GROUND:
            chain.append(parents[chain[-1]])
    while up and down and up[-1] == down[-1]:
        up, down = up[:-1], down[:-1]
    return up, down[::-1]


class View:
    """The `Space` of loads and sensors, over one tree and one set of symbols.

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
        velocity: ca.SX,
    ) -> None:
        self.gravity = gravity
        self.velocity = velocity
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
        return self._with_accelerations(None)

    def owned(self, item: Load | Loop | Contact) -> Values:
        """Quantities of a load, loop or contact; messages name it from now on."""
        self.owner = owner_name(item)
        return self.now.values.get(self.owner, {})

    def find(self, port: str) -> tuple[str, str]:
        body, name = find_port(self.now.bodies, self.owner, "port", port)
        return body.name, name

    # of loads -------------------------------------------------------------------------------

    def wrenches(self, load: Load, magnitude: ca.SX) -> list[BodyWrench]:
        return load.wrenches(self.owned(load), magnitude, self)

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
        """Vectors (3, 1) from port a to port b at equilibrium by `evaluate`, and the largest length (m).

        The lengths are those from the ground to the ports and to the bodies on the way, and those in the
        bodies of the ports: a port at the origin of the scene is there by lengths that cancel.
        """
        arms = [self.between_at_rest("ground", port) for port in (a, b)]
        arms += [port_arm(self.rest, *self.find(port)) for port in (a, b)]
        bodies = {body for port in (a, b) for body in _path(self.rest, self.find(port)[0], GROUND)[0]}
        arms += [self.between_at_rest(GROUND, body) for body in sorted(bodies)]
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
        placed, moving = self._linear(order)
        moved = move_motion(moving.bodies[body], port_arm(placed, body, name))
        return body, Small(moved[:, 1], moved[:, 2])

    def across(self, vector: ca.SX, source: str, target: str) -> ca.SX:
        return across(self.rest, vector, source, target)

    def motion(self, port: str) -> ca.SX:
        body, name = self.find(port)
        return move_motion(self.motions.bodies[body], port_arm(self.now, body, name))

    def joint_wrench(self, joint: str) -> ca.SX:
        return self.passed.joints[self.joints[joint]]

    def momentum(self, order: int) -> ca.SX:
        placed, moving = self._linear(order)
        total = pass_inward(placed, moving, inertial_wrenches(placed, moving)).ground
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
        masses = (link.child.total_mass(self.now.of(link.child)) for link in self.now.links)
        return sum(masses, start=ca.SX(0))

    def _linear(self, order: int) -> tuple[Placed, Motions]:
        """The tree at rest, with small motions of one order in place of accelerations."""
        if order not in self._small:
            placed = self._with_accelerations(order)
            self._small[order] = placed, motions(placed, ca.SX(3, 3))
        return self._small[order]

    def _with_accelerations(self, order: int | None) -> Placed:
        """The tree with q = v = 0, and the coordinates of one order as accelerations (None: zero)."""
        coordinates = {}
        for name, at in self.coordinates.items():
            zero = ca.SX(at.q.numel(), 1)
            coordinates[name] = Coordinate(zero, zero, zero if order is None else at[order])
        return place(self.now.links, self.now.bodies, self.now.values, coordinates)
