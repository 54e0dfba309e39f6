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
"""

from collections.abc import Callable, Iterator, Mapping
from functools import cache
from typing import NamedTuple

import casadi as ca
import numpy as np

from mbdlft.multibody.assembly.kinematics import Motions, Passed, Placed, body_efforts, pulled
from mbdlft.multibody.assembly.tree import PortJoint
from mbdlft.multibody.body import GROUND
from mbdlft.multibody.joint.move import Ball, Hinge, Move, Shifted, Slide, Turned
from mbdlft.multibody.scene.quantities import owner_name
from mbdlft.multibody.spatial import move_wrench
from mbdlft.problem.sx.constants import is_constant, is_zero, numbers_of, without_zeros

Turning = tuple[ca.SX, ca.SX]  # axis (3,) and small angle of a displacement


class Tilt(NamedTuple):
    """What joints about one axis (3,) have turned: M q (kg rad), and c q (3,) (kg m rad)."""

    axis: ca.SX
    mass: ca.SX
    moment: ca.SX


class Carried(NamedTuple):
    """What a joint carries, at one place on the way in.

    Attributes
    ----------
    inertial, loads : SX (3, 2)
        Wrenches of the motion, as if no joint were displaced on the way, and of everything else.
    mass, moment : SX, SX (3,)
        Mass (kg) and first moment (kg m).
    tilts : one for each axis
    """

    inertial: ca.SX
    loads: ca.SX
    mass: ca.SX
    moment: ca.SX
    tilts: tuple[Tilt, ...]


def pass_weights_inward(
    placed: Placed,
    found: Motions,
    inertial: Mapping[str, ca.SX],
    loads: Mapping[str, ca.SX],
    load: ca.SX,
) -> Passed:
    """As `pass_inward`, to the first order in the displacements, in a frame that does not spin.

    Parameters
    ----------
    inertial, loads : wrenches (3, 2) by body, of the motion and of everything else
    load : SX (3,)
        Uniform acceleration of the ground (m/s^2): all weights come from it.
    """
    fields = load_fields(placed, load)
    carried = {GROUND: Carried(ca.SX(3, 2), ca.SX(3, 2), ca.SX(0), ca.SX(3, 1), ())}
    for link in placed.links:
        name = link.child.name
        values = placed.values.get(owner_name(link.child), {})
        carried[name] = Carried(
            inertial[name],
            loads[name],
            link.child.total_mass(values),
            link.child.first_moment(values, placed.inboard[name]),
            (),
        )
    joints: dict[str, ca.SX] = {}
    efforts = body_efforts(placed, found)
    for link in reversed(placed.links):
        name, parent = link.child.name, link.parent.name
        now, field = carried[name], fields[name]
        joints[name] = _felt(now, field[-1])
        own: list[ca.SX] = []
        for k in reversed(range(len(placed.moves[name]))):
            move, motion = placed.moves[name][k], found.moves[name][k]
            now = now._replace(inertial=move.carried(now.inertial, motion))
            if move.degrees_of_freedom:
                own.insert(0, move.effort(_felt(now, field[k + 1]), motion))
            now = _before(move, now, field[k + 1])
        needed = ca.vertcat(*own)
        if isinstance(link.joint, PortJoint):
            needed = efforts[link.owner] + needed + pulled(placed, link.joint, joints[name])
        efforts[link.owner] = needed
        shifted = _shifted(now, placed.arms[name], field[0])
        carried[parent] = _together(carried[parent], shifted)
    return Passed(efforts, joints, _felt(carried[GROUND], load))


def _before(move: Move, now: Carried, field: ca.SX) -> Carried:
    """What is carried before a move, from what is carried after it; `field` is the load (3,) after it."""
    if isinstance(move, Shifted):
        return _shifted(now, move.r, field)
    if now.loads.nnz():
        now = now._replace(loads=move.wrench(now.loads))
    if isinstance(move, Hinge | Ball):
        for axis, q in turns_of(move):  # before a displacement q
            tilt = Tilt(axis, now.mass * q, now.moment * q)
            now = now._replace(tilts=added(now.tilts, tilt))
        return now
    if isinstance(move, Slide):
        torque = ca.cross(move.offset(), now.mass * field)
        return now._replace(inertial=now.inertial + ca.horzcat(ca.SX(3, 1), torque))
    kept, ended = turned_tilts(move, now.tilts)
    inertial = move.wrench(_with_weights(now.inertial, ended, field))
    # a deformation turns nothing at rest
    moment = move.in_parent_axes(now.moment) if isinstance(move, Turned) else now.moment
    return now._replace(inertial=inertial, moment=moment, tilts=kept)


def turns_of(move: Move) -> Iterator[Turning]:
    """Axes (3,) and small angles of the displacements of a move that turn what it carries."""
    if isinstance(move, Hinge) and not move.steady:
        yield move.axis, move.at.q
    elif isinstance(move, Ball):
        yield from zip(ca.horzsplit(ca.SX.eye(3)), ca.vertsplit(move.at.q), strict=True)


def added(tilts: tuple[Tilt, ...], *more: Tilt) -> tuple[Tilt, ...]:
    """With more of them; those about one axis are one."""
    found = list(tilts)
    for other in more:
        for k, tilt in enumerate(found):
            if is_parallel(tilt.axis, other.axis):
                sign = float(np.sign(numbers_of(ca.dot(tilt.axis, other.axis))[0, 0]))
                mass, moment = tilt.mass + sign * other.mass, tilt.moment + sign * other.moment
                found[k] = Tilt(tilt.axis, mass, moment)
                break
        else:
            found.append(other)
    return tuple(found)


def turned_tilts(move: Move, tilts: tuple[Tilt, ...]) -> tuple[tuple[Tilt, ...], tuple[Tilt, ...]]:
    """Those that go on before a move, in the axes there, and those that end at it, as they are."""
    kept: list[Tilt] = []
    ended: list[Tilt] = []
    for tilt in tilts:
        before = _turned_axis(move, tilt.axis)
        if before is None:
            ended.append(tilt)
        else:
            kept.append(Tilt(before, tilt.mass, move.in_parent_axes(tilt.moment)))
    return tuple(kept), tuple(ended)


def _turned_axis(move: Move, axis: ca.SX) -> ca.SX | None:
    """An axis (3,) before a rotation; None if it depends on parameters, or gets more components.

    In a chain with numbers for angles there would be as many axes as joints.
    """
    if not isinstance(move, Turned):
        return None
    before = constant_axis(move, axis, move.in_parent_axes)
    if before is None or before.nnz() > axis.nnz():
        return None
    return before


def constant_axis(move: Turned, axis: ca.SX, rotated: Callable[[ca.SX], ca.SX]) -> ca.SX | None:
    """An axis (3,) across a rotation, by `rotated`; None if it depends on parameters there."""
    if is_parallel(move.axis, axis):
        return axis
    found = rotated(axis)
    return without_zeros(found) if is_constant(found) else None


def is_parallel(first: ca.SX, second: ca.SX) -> bool:
    """Whether two constant vectors (3,) are along one line."""
    return is_zero(ca.cross(first, second))


def _shifted(now: Carried, arm: ca.SX, field: ca.SX) -> Carried:
    """About the point at -arm (3,), in a lever that feels the load `field` (3,)."""
    if not arm.nnz():
        return now
    force = _with_weights(now.inertial, now.tilts, field)[:, 0]
    return now._replace(
        inertial=now.inertial + ca.horzcat(ca.SX(3, 1), ca.cross(arm, force)),
        loads=move_wrench(now.loads, arm) if now.loads.nnz() else now.loads,
        moment=now.moment + arm * now.mass,  # in this order: the mass meets the signal first
    )


def _with_weights(wrench: ca.SX, tilts: tuple[Tilt, ...], field: ca.SX) -> ca.SX:
    """A wrench (3, 2) with what the weights that have been turned add to it."""
    for tilt in tilts:
        wrench = wrench + _turned_weight()(*tilt, field)
    return wrench


@cache
def _turned_weight() -> ca.Function:
    """M q e x g, and q e x (c x g) = c q (e . g) - g (e . c q)."""
    axis, field = ca.SX.sym("axis", 3), ca.SX.sym("field", 3)
    mass, moment = ca.SX.sym("mass"), ca.SX.sym("moment", 3)
    torque = moment * ca.dot(axis, field) - ca.dot(axis, moment) * field
    weight = ca.horzcat(mass * ca.cross(axis, field), torque)
    return ca.Function("turned_weight", [axis, mass, moment, field], [weight])


def _felt(now: Carried, field: ca.SX) -> ca.SX:
    """The whole wrench (3, 2)."""
    return _with_weights(now.inertial + now.loads, now.tilts, field)


def _together(first: Carried, second: Carried) -> Carried:
    """What a body carries on two joints."""
    return Carried(
        first.inertial + second.inertial,
        first.loads + second.loads,
        first.mass + second.mass,
        first.moment + second.moment,
        added(first.tilts, *second.tilts),
    )


def load_fields(placed: Placed, load: ca.SX) -> dict[str, list[ca.SX]]:
    """The load in the axes before the moves of the joint of each body, and after each, at q = 0."""
    found: dict[str, list[ca.SX]] = {GROUND: [load]}
    for link in placed.links:
        own = [found[link.parent.name][-1]]
        for move in placed.moves[link.child.name]:
            last = own[-1]
            own.append(move.in_child_axes(last) if isinstance(move, Turned) else last)
        found[link.child.name] = own
    return found
