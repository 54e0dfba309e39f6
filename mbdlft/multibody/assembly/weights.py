"""The inward pass at an equilibrium under a uniform load: weights meet it in the axes that feel them.

A joint that turns what it carries by a small q about e turns its weight: the force M g and the torque
c x g, with the mass M and the first moment c of what it carries. In the recursive Newton-Euler
algorithm these are sums of m R ... R g, turned back on the way in. To say R' R = 1 before the masses
are multiplied, only

    M q,   c q        and the axis e

go inward, and every lever feels the force f + M q e x g and the torque t + q e x (c x g), with the
load g in its own axes, and f and t as if the joint were not displaced. The axis is constant up to a
turn by a parameter about another one; there, or where it would get more components, the force and the
torque are added up. To the first order in q that is `pass_inward`, but the products come in an order
that needs fewer channels: docs/method.md, "Weights".

For axes that are not parallel there is another order of products. With the axes e of two hinges, a the
inner and b the outer one, the effort at one of them for a displacement of the other is

    K_ab = -(e_a x g) . (e_b x c) = e_a . (c x (g x e_b)) + (e_a . c)(e_b . g) - (e_a . g)(e_b . c).

The first two terms are a product of quaternions, e_a . vec(c g e_b), and pass inward for all hinges
together: with the height p = sum of (e . g) q of the hinges on the way outward, a mass needs a force,
with g x e q in it because the axes have turned, and beside it the scalar m p; in a lever r both become
the torque r x f + r s. A lever inside of b has not turned with it: there the force and the scalar of what
is outside are taken back, M q e x g and M q e . g, in the axes of the lever as long as e is constant.
The last term is a function of the angles before a times one of those after b. It is summed up outward
from a: a vector takes up the axes e_b times (e_a . g) q_b on its way, and meets levers and masses. So
each angle and length meets each hinge once; the torque c q x ..., three times.
"""

from collections.abc import Callable, Iterator, Mapping
from typing import NamedTuple

import casadi as ca
import numpy as np

from mbdlft.multibody.assembly.kinematics import Motions, Passed, Placed, body_efforts
from mbdlft.multibody.assembly.tree import Link, PortJoint
from mbdlft.multibody.body import GROUND, PointMass, RigidBody
from mbdlft.multibody.joint.move import Ball, Hinge, Move, Shifted, Slide, Turned
from mbdlft.multibody.spatial import move_wrench, traced
from mbdlft.problem.sx.constants import is_constant, is_zero, numbers_of, without_zeros

# On the way to some body. Of spatial chains with 4 to 6 hinges, all with 4 angles as parameters become
# smaller, 10 of 14 with 3 and 1 of 15 with 2; chains of 3 hinges do not.
_LEAST_HINGES, _LEAST_ANGLES = 4, 3
_MOST_HINGES = 64  # more take long

Turning = tuple[ca.SX, ca.SX]  # axis (3,) and small angle of a displacement


class Tilt(NamedTuple):
    """What joints about one axis (3,) have turned: M q (kg rad), and c q (3,) (kg m rad)."""

    axis: ca.SX
    mass: ca.SX
    moment: ca.SX


class Carried(NamedTuple):
    """What a joint carries, at one place on the way in."""

    inertial: ca.SX  # wrench (3, 2) of the motion, as if no joint were displaced on the way
    loads: ca.SX  # wrench (3, 2) of everything else
    mass: ca.SX  # kg
    moment: ca.SX  # first moment (3,) (kg m); in the order of products the sum of m p (N), a scalar
    tilts: tuple[Tilt, ...]  # one for each axis


def turns_of(move: Move) -> Iterator[Turning]:
    """Axes (3,) and small angles of the displacements of a move that turn what it carries."""
    if isinstance(move, Hinge) and not move.steady:
        yield move.axis, move.at.q
    elif isinstance(move, Ball):
        yield from zip(ca.horzsplit(ca.SX.eye(3)), ca.vertsplit(move.at.q), strict=True)


def added(tilts: tuple[Tilt, ...], *more: Tilt) -> tuple[Tilt, ...]:
    """With more of them; those about one axis are one."""
    merged = list(tilts)
    for other in more:
        for k, tilt in enumerate(merged):
            if is_parallel(tilt.axis, other.axis):
                sign = float(np.sign(numbers_of(ca.dot(tilt.axis, other.axis))[0, 0]))
                mass, moment = tilt.mass + sign * other.mass, tilt.moment + sign * other.moment
                merged[k] = Tilt(tilt.axis, mass, moment)
                break
        else:
            merged.append(other)
    return tuple(merged)


def turned_tilts(move: Move, tilts: tuple[Tilt, ...]) -> tuple[tuple[Tilt, ...], tuple[Tilt, ...]]:
    """The tilts whose axes stay constant before a move, in the axes there; the others, as they are."""
    kept: list[Tilt] = []
    ended: list[Tilt] = []
    for tilt in tilts:
        before = None
        if isinstance(move, Turned):
            before = constant_axis(move, tilt.axis, move.in_parent_axes)
        # with more components, a chain with numbers for angles would have as many axes as joints
        if before is None or before.nnz() > tilt.axis.nnz():
            ended.append(tilt)
        else:
            kept.append(Tilt(before, tilt.mass, move.in_parent_axes(tilt.moment)))
    return tuple(kept), tuple(ended)


def constant_axis(move: Turned, axis: ca.SX, rotated: Callable[[ca.SX], ca.SX]) -> ca.SX | None:
    """An axis (3,) across a rotation, by `rotated`; None if it depends on parameters there."""
    if is_parallel(move.axis, axis):
        return axis
    there = rotated(axis)
    return without_zeros(there) if is_constant(there) else None


def is_parallel(first: ca.SX, second: ca.SX) -> bool:
    """Whether two constant vectors (3,) are along one line."""
    return is_zero(ca.cross(first, second))


def _with_weights(wrench: ca.SX, tilts: tuple[Tilt, ...], field: ca.SX) -> ca.SX:
    """A wrench (3, 2) with what the weights that have been turned add to it."""
    for tilt in tilts:
        wrench = wrench + _turned_weight(*tilt, field)
    return wrench


@traced
def _turned_weight(axis: ca.SX, mass: ca.SX, moment: ca.SX, field: ca.SX) -> ca.SX:
    """M q e x g, and q e x (c x g) = c q (e . g) - g (e . c q)."""
    torque = moment * ca.dot(axis, field) - ca.dot(axis, moment) * field
    return ca.horzcat(mass * ca.cross(axis, field), torque)


def _together(first: Carried, second: Carried) -> Carried:
    """What a body carries on two joints."""
    return Carried(
        first.inertial + second.inertial,
        first.loads + second.loads,
        first.mass + second.mass,
        first.moment + second.moment,
        added(first.tilts, *second.tilts),
    )


class Weights:
    """The inward pass to the first order in the displacements, in a frame that does not spin.

    All weights come from `load` (3,), the uniform acceleration of the ground (m/s^2).
    """

    def __init__(self, placed: Placed, load: ca.SX) -> None:
        self.placed = placed
        # (3,) the load in the axes before the moves of the joint of each body, and after each, at q = 0
        self.fields: dict[str, list[ca.SX]] = {GROUND: [load]}
        for link in placed.links:
            along = [self.fields[link.parent.name][-1]]
            for move in placed.moves[link.child.name]:
                last = along[-1]
                along.append(move.in_child_axes(last) if isinstance(move, Turned) else last)
            self.fields[link.child.name] = along

    def passed(
        self, moving: Motions, inertial: Mapping[str, ca.SX], loads: Mapping[str, ca.SX]
    ) -> Passed:
        """As `pass_inward`, of wrenches (3, 2) by body: `inertial` of the motion, `loads` of the rest."""
        placed, fields = self.placed, self.fields
        none = ca.SX(3, 2)
        carried = {
            link.child.name: self.carried(link, inertial[link.child.name], loads[link.child.name])
            for link in placed.links
        }
        carried[GROUND] = Carried(none, none, ca.SX(0), ca.SX(*self.moment), ())
        joints: dict[str, ca.SX] = {}
        efforts = body_efforts(placed, moving)
        for link in reversed(placed.links):
            name, parent = link.child.name, link.parent.name
            now = carried[name]
            joints[name] = self.felt(now, fields[name][-1])
            of_moves: list[ca.SX] = []
            for k in reversed(range(len(placed.moves[name]))):
                move, motion = placed.moves[name][k], moving.moves[name][k]
                now = now._replace(inertial=move.carried(now.inertial, motion))
                if move.degrees_of_freedom:
                    of_moves.insert(0, self.effort(link, k, now, motion))
                now = self.before(link, k, now)
            needed = ca.vertcat(*of_moves)
            if isinstance(link.joint, PortJoint):
                needed = efforts[link.owner] + needed
            efforts[link.owner] = needed
            levered = self.levered(now, placed.arms[name], fields[name][0])
            carried[parent] = _together(carried[parent], levered)
        return Passed(efforts, joints, self.felt(carried[GROUND], fields[GROUND][0]))

    moment = (3, 1)  # shape of `Carried.moment`

    def carried(self, link: Link, inertial: ca.SX, loads: ca.SX) -> Carried:
        values = self.placed.of(link.child)
        moment = link.child.first_moment(values, self.placed.inboard[link.child.name])
        return Carried(inertial, loads, link.child.total_mass(values), moment, ())

    def felt(self, now: Carried, field: ca.SX) -> ca.SX:
        """The whole wrench (3, 2) where the load is `field` (3,)."""
        return _with_weights(now.inertial + now.loads, now.tilts, field)

    def effort(self, link: Link, k: int, now: Carried, motion: ca.SX) -> ca.SX:
        """Efforts (n,) of move k of the joint of a link."""
        name = link.child.name
        return self.placed.moves[name][k].effort(self.felt(now, self.fields[name][k + 1]), motion)

    def before(self, link: Link, k: int, now: Carried) -> Carried:
        """What is carried before move k of the joint of a link, from what is carried after it."""
        move, field = self.placed.moves[link.child.name][k], self.fields[link.child.name][k + 1]
        if isinstance(move, Shifted):
            return self.levered(now, move.r, field)
        if now.loads.nnz():
            now = now._replace(loads=move.wrench(now.loads))
        if isinstance(move, Hinge | Ball):
            return self.before_turns(link, k, now)
        if isinstance(move, Slide):  # the torque of the displaced weight
            return _with_torque(now, ca.cross(move.offset(), now.mass * field))
        kept, ended = turned_tilts(move, now.tilts)
        return self.before_rotation(move, now, ended, field)._replace(tilts=kept)

    def before_turns(self, link: Link, k: int, now: Carried) -> Carried:
        """Before the displacements of a hinge or ball."""
        for axis, q in turns_of(self.placed.moves[link.child.name][k]):
            now = now._replace(tilts=added(now.tilts, Tilt(axis, now.mass * q, now.moment * q)))
        return now

    def before_rotation(self, move: Move, now: Carried, ended: tuple[Tilt, ...], field: ca.SX) -> Carried:
        """Before a constant rotation, or a deformation, which turns nothing at rest."""
        inertial = move.wrench(_with_weights(now.inertial, ended, field))
        moment = move.in_parent_axes(now.moment) if isinstance(move, Turned) else now.moment
        return now._replace(inertial=inertial, moment=moment)

    def levered(self, now: Carried, arm: ca.SX, field: ca.SX) -> Carried:
        """About the point at -arm (3,), in a lever that feels the load `field` (3,)."""
        if not arm.nnz():
            return now
        force = _with_weights(now.inertial, now.tilts, field)[:, 0]
        # in this order: the mass meets the signal first
        return _with_torque(now, ca.cross(arm, force), arm)._replace(moment=now.moment + arm * now.mass)


def _with_torque(now: Carried, torque: ca.SX, arm: ca.SX | None = None) -> Carried:
    """With a torque (3,) of the motion more, and the other loads moved by an arm (3,)."""
    loads = move_wrench(now.loads, arm) if arm is not None and now.loads.nnz() else now.loads
    return now._replace(inertial=now.inertial + ca.horzcat(ca.SX(3, 1), torque), loads=loads)


# the other order of products -----------------------------------------------------------------


def gains_by_products(placed: Placed) -> bool:
    """Whether this order is possible in a tree, and may make a smaller model.

    It may where enough hinges with axes that are not parallel lie on the way to a body, at enough angles
    that are parameters.
    """
    if not all(isinstance(link.child, (RigidBody, PointMass)) for link in placed.links):
        return False
    hinges, angles = {GROUND: 0}, {GROUND: 0}
    last: dict[str, ca.SX | None] = {GROUND: None}  # axis on the way, in the axes of the body
    planar = True
    for link in placed.links:
        name, parent = link.child.name, link.parent.name
        hinges[name], angles[name], axis = hinges[parent], angles[parent], last[parent]
        for move in placed.moves[name]:
            if isinstance(move, Turned):
                angles[name] += not is_constant(ca.SX(move.turn.cosine))
                axis = axis if axis is None else constant_axis(move, axis, move.in_child_axes)
            for hinge, _ in turns_of(move):
                first = hinges[name] == 0
                planar = planar and (first or (axis is not None and is_parallel(axis, hinge)))
                hinges[name], axis = hinges[name] + 1, hinge
        last[name] = axis
    return (
        not planar
        and _LEAST_HINGES <= max(hinges.values()) <= _MOST_HINGES
        and max(angles.values()) >= _LEAST_ANGLES
    )


def _axes_of(move: Move) -> list[ca.SX]:
    """Axes (3,) about which a move has efforts: those of `turns_of`, and that of a steady rate."""
    if isinstance(move, Hinge) and move.steady:
        return [move.axis]
    return [axis for axis, _ in turns_of(move)]


class Products(Weights):
    """The same in the other order of products; `Carried.moment` is the scalar m p."""

    moment = (1, 1)

    def __init__(self, placed: Placed, load: ca.SX) -> None:
        super().__init__(placed, load)
        self.heights: dict[str, list[ca.SX]] = {GROUND: [ca.SX(0)]}  # p (m/s^2), as `fields`
        self.masses: dict[str, ca.SX] = {}
        self.centers: dict[str, ca.SX] = {}  # (3,) from the inboard port (m)
        self.outward: dict[str, list[Link]] = {}
        self.turns: dict[str, list[list[Turning]]] = {}  # what the load feels of each move
        upright = {GROUND: True}
        for link in placed.links:
            name = link.child.name
            self.masses[name] = link.child.total_mass(placed.of(link.child))
            center = "center_of_mass" if isinstance(link.child, RigidBody) else "origin"
            position = link.child.port_position(center, placed.of(link.child))
            self.centers[name] = ca.SX(position - placed.inboard[name])
            self.outward.setdefault(link.parent.name, []).append(link)
            self.turns[name], upright[name] = self._felt(link, upright=upright[link.parent.name])
            heights = [self.heights[link.parent.name][-1]]
            for turns, field in zip(self.turns[name], self.fields[name][1:], strict=True):
                heights.append(heights[-1] + sum((ca.dot(e, field) * q for e, q in turns), ca.SX(0)))
            self.heights[name] = heights

    def carried(self, link: Link, inertial: ca.SX, loads: ca.SX) -> Carried:
        name = link.child.name
        scalar = self.masses[name] * self.heights[name][-1]
        now = Carried(inertial, loads, self.masses[name], scalar, ())
        return _with_torque(now, self.centers[name] * scalar)

    def felt(self, now: Carried, field: ca.SX) -> ca.SX:
        return ca.horzcat(_force_and_scalar(now, field)[0], now.inertial[:, 1]) + now.loads

    def effort(self, link: Link, k: int, now: Carried, motion: ca.SX) -> ca.SX:
        effort = super().effort(link, k, now, motion)
        axes = _axes_of(self.placed.moves[link.child.name][k])
        products = [self.product(link, k, axis) for axis in axes]
        return effort - ca.vertcat(*products) if products else effort

    def before_turns(self, link: Link, k: int, now: Carried) -> Carried:
        turns = self.turns[link.child.name][k]
        more = (Tilt(axis, now.mass * q, ca.SX(3, 1)) for axis, q in turns)
        return now._replace(tilts=added(now.tilts, *more))

    def before_rotation(self, move: Move, now: Carried, ended: tuple[Tilt, ...], field: ca.SX) -> Carried:
        force, scalar = _force_and_scalar(now._replace(tilts=ended), field)
        return now._replace(inertial=move.wrench(ca.horzcat(force, now.inertial[:, 1])), moment=scalar)

    def levered(self, now: Carried, arm: ca.SX, field: ca.SX) -> Carried:
        if not arm.nnz():
            return now
        force, scalar = _force_and_scalar(now, field)
        return _with_torque(now, ca.cross(arm, force) + arm * scalar, arm)

    def _felt(self, link: Link, *, upright: bool) -> tuple[list[list[Turning]], bool]:
        """Turns of the moves of a link that the load feels, and whether it has felt none so far.

        A hinge along the load turns nothing that the load feels, unless a hinge inside of it is felt.
        """
        name = link.child.name
        felt: list[list[Turning]] = []
        for move, field in zip(self.placed.moves[name], self.fields[name][1:], strict=True):
            turns = list(turns_of(move))
            across = (ca.sparsify(ca.cross(axis, field)) for axis, _ in turns)
            upright = upright and not any(vector.nnz() for vector in across)
            felt.append([] if upright else turns)
        return felt, upright

    def product(self, link: Link, k: int, axis: ca.SX) -> ca.SX:
        """Sum of (e_a . g)(e_b . c) q_b over the hinges b outside move k of a link, about `axis` e_a.

        And (e_a . c) p of the hinges up to a: the first two terms have it, K_ab has not.
        """
        name = link.child.name
        slope = ca.dot(axis, self.fields[name][k + 1])
        return self._moment(link, k + 1, axis * self.heights[name][k + 1], slope, ca.SX(0))

    def _moment(self, link: Link, first: int, v: ca.SX, slope: ca.SX, reached: ca.SX) -> ca.SX:
        """First moment of what is outside of some moves of a link, along a vector v (3,).

        It takes up the hinges on its way; `reached` is the position so far, along it.
        """
        name = link.child.name
        moves, turns = self.placed.moves[name], self.turns[name]
        for move, turned in zip(moves[first:], turns[first:], strict=True):
            reached = reached + _along(move, v)
            v = move.in_child_axes(v) if isinstance(move, Turned) else v
            for axis, q in turned:
                v = v + axis * (slope * q)
        total = self.masses[name] * (reached + ca.dot(self.centers[name], v))
        for outer in self.outward.get(name, []):
            arm = self.placed.arms[outer.child.name]
            total = total + self._moment(outer, 0, v, slope, reached + ca.dot(arm, v))
        return total


def _along(move: Move, v: ca.SX) -> ca.SX:
    """Length of a move along a vector v (3,)."""
    return ca.dot(move.r, v) if isinstance(move, Shifted) else ca.SX(0)


def _force_and_scalar(now: Carried, field: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Force (3,) of the motion and scalar, where the load is `field` (3,) and nothing has turned."""
    force, scalar = now.inertial[:, 0], now.moment
    for tilt in now.tilts:
        force = force + tilt.mass * ca.cross(tilt.axis, field)
        scalar = scalar - tilt.mass * ca.dot(tilt.axis, field)
    return force, scalar
