"""The tree with its moves at some coordinates: where bodies are, how they move, what they pass on.

Every vector of a body is in the axes of the body and counted from its inboard port, the one at which its
joint holds it. Motions go outward, wrenches inward: the recursive Newton-Euler algorithm.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import NamedTuple

import casadi as ca

from mbdlft.base.description import Values
from mbdlft.multibody.assembly.tree import Link, PortJoint
from mbdlft.multibody.body import GROUND, Body
from mbdlft.multibody.joint import Move
from mbdlft.multibody.scene.quantities import owner_name
from mbdlft.multibody.spatial import Coordinate, move_motion, move_wrench


@dataclass(frozen=True, slots=True, eq=False)
class Placed:
    """A tree at some coordinates.

    Attributes
    ----------
    links : from the ground outward
    moves : factors of the joint of each link, by child
    arms : (3,) from the inboard port of the parent to the joint of each link, by child (m)
    inboard : (3,) from the origin of each body to its inboard port, by body (m)
    elastic : coordinates of the elastic bodies, by body
    bodies : by name
    values : quantities by owner
    """

    links: tuple[Link, ...]
    moves: Mapping[str, tuple[Move, ...]]
    arms: Mapping[str, ca.SX]
    inboard: Mapping[str, ca.SX]
    elastic: Mapping[str, Coordinate]
    bodies: Mapping[str, Body]
    values: Mapping[str, Values]


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
        elastic[name] = coordinates[owner_name(link.child)]
        own = elastic[link.parent.name] if joint.kind == "port" else coordinates[link.owner]
        moves[name] = joint.moves(values[link.owner], own)
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


def motions(
    placed: Placed, ground: ca.SX, others: Mapping[str, ca.SX] = MappingProxyType({})
) -> Motions:
    """Motions of all bodies for a motion (3, 3) of the origin of the ground.

    `others` are motions of bodies from which links start that do not lead to the ground.
    """
    found = {GROUND: ground, **others}
    after: dict[str, list[ca.SX]] = {}
    for link in placed.links:
        name = link.child.name
        motion = move_motion(found[link.parent.name], placed.arms[name])
        after[name] = [motion := move.motion(motion) for move in placed.moves[name]]
        found[name] = motion
    return Motions(found, after)


def inertial_wrenches(placed: Placed, found: Motions) -> dict[str, ca.SX]:
    """Wrench (3, 2) that the motion of each body needs, about its inboard port."""
    return {
        link.child.name: link.child.wrench(
            found.bodies[link.child.name],
            placed.values.get(owner_name(link.child), {}),
            placed.inboard[link.child.name],
            placed.elastic[link.child.name],
        )
        for link in placed.links
    }


def body_efforts(placed: Placed, found: Motions) -> dict[str, ca.SX]:
    """Generalized forces (n,) that the coordinates of each body need; a rigid one has none."""
    return {
        owner_name(link.child): link.child.efforts(
            found.bodies[link.child.name],
            placed.values.get(owner_name(link.child), {}),
            placed.elastic[link.child.name],
        )
        for link in placed.links
    }


class Passed(NamedTuple):
    """What wrenches do on their way to the ground: efforts (n,) by joint and elastic body, wrenches of
    the joints on their children (3, 2) by child, and the wrench of the joints on the ground (3, 2)."""

    efforts: Mapping[str, ca.SX]
    joints: Mapping[str, ca.SX]
    ground: ca.SX


def pass_inward(placed: Placed, found: Motions, needed: Mapping[str, ca.SX]) -> Passed:
    """Inward pass of the wrenches `needed` by the bodies apart from their joints, by body."""
    total = {**needed, GROUND: ca.SX(3, 2)}
    joints: dict[str, ca.SX] = {}
    collected = body_efforts(placed, found)
    for link in reversed(placed.links):
        name = link.child.name
        joints[name] = wrench = total[name]
        own: list[ca.SX] = []
        for move, motion in zip(
            reversed(placed.moves[name]), reversed(found.moves[name]), strict=True
        ):
            wrench = move.carried(wrench, motion)
            own.insert(0, move.effort(wrench, motion))
            wrench = move.wrench(wrench)
        efforts = ca.vertcat(*own)
        if isinstance(link.joint, PortJoint):
            efforts = collected[link.owner] + efforts + pulled(placed, link.joint, joints[name])
        collected[link.owner] = efforts
        total[link.parent.name] += move_wrench(wrench, placed.arms[name])
    return Passed(collected, joints, total[GROUND])


def pulled(placed: Placed, joint: PortJoint, wrench: ca.SX) -> ca.SX:
    """Generalized forces (n,) by which the wrench (3, 2) through a port stiffens its body."""
    body, values = joint.body, placed.values.get(owner_name(joint.body), {})
    return body.pulled(joint.port, values, wrench[:, 0], placed.elastic[body.name])


def chain(placed: Placed, body: str) -> list[str]:
    """Names of the bodies from the ground (left out) to `body`."""
    parents = {link.child.name: link.parent.name for link in placed.links}
    names: list[str] = []
    while body != GROUND:
        names.insert(0, body)
        body = parents[body]
    return names


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
    first, second = chain(placed, source), chain(placed, target)
    while first and second and first[0] == second[0]:
        first, second = first[1:], second[1:]
    return first[::-1], second
