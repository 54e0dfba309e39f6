"""The inward pass of `weights` in another order of products, for axes that are not parallel.

With the axes e of two hinges, a the inner and b the outer one, the load g (what a mass needs) and the
first moment c that b carries, the effort at one of them for a displacement of the other is

    K_ab = -(e_a x g) . (e_b x c) = e_a . (c x (g x e_b)) + (e_a . c)(e_b . g) - (e_a . g)(e_b . c).

The first two terms are a product of quaternions, e_a . vec(c g e_b), and pass inward for all hinges
together: with the height p = sum of (e . g) q of the hinges on the way outward, a mass needs a force,
with g x e q in it because the axes have turned, and beside it the scalar m p; in a lever r both become
the torque r x f + r s. A lever inside of b has not turned with it: there the force and the scalar of what
is outside are taken back, M q e x g and M q e . g, in the axes of the lever as long as e is constant.
The last term is a function of the angles before a times one of those after b. It is summed up outward
from a: a vector takes up the axes e_b times (e_a . g) q_b on its way, and meets levers and masses. So
each angle and length meets each hinge once; the torque c q x ... of `weights`, three times.

To the first order in the displacements this is `pass_weights_inward`: docs/method.md, "Weights".
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import casadi as ca

from mbdlft.multibody.assembly.kinematics import Motions, Placed
from mbdlft.multibody.assembly.tree import Link
from mbdlft.multibody.assembly.weights import (
    Tilt,
    Turning,
    added,
    constant_axis,
    is_parallel,
    load_fields,
    turned_tilts,
    turns_of,
)
from mbdlft.multibody.body import GROUND, PointMass, RigidBody
from mbdlft.multibody.joint.move import Hinge, Move, Shifted, Slide, Turned
from mbdlft.multibody.scene.quantities import owner_name
from mbdlft.multibody.spatial import move_wrench
from mbdlft.problem.sx.constants import is_constant

# On the way to some body. Of spatial chains with 4 to 6 hinges, all with 4 angles as parameters become
# smaller, 10 of 14 with 3 and 1 of 15 with 2; chains of 3 hinges do not.
_LEAST_HINGES, _LEAST_ANGLES = 4, 3
_MOST_HINGES = 64  # more take long


class _Carried(NamedTuple):
    """What a joint carries, at one place on the way in.

    Attributes
    ----------
    inertial, loads : SX (3, 2)
        Wrenches of the motion and of everything else.
    mass, scalar : SX
        M (kg), and the sum of m p (N).
    tilts : M q by axis; their first moments are not used
    """

    inertial: ca.SX
    loads: ca.SX
    mass: ca.SX
    scalar: ca.SX
    tilts: tuple[Tilt, ...]

    def felt(self, field: ca.SX) -> tuple[ca.SX, ca.SX]:
        """Force (3,) of the motion and scalar, where the load is `field` (3,) and nothing has turned."""
        force, scalar = self.inertial[:, 0], self.scalar
        for tilt in self.tilts:
            axis = tilt.axis
            force = force + tilt.mass * ca.cross(axis, field)
            scalar = scalar - tilt.mass * ca.dot(axis, field)
        return force, scalar


def gains_by_products(placed: Placed) -> bool:
    """Whether this order is possible in a tree, and may make a smaller model than that of `weights`.

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


def efforts_by_products(
    placed: Placed,
    found: Motions,
    inertial: Mapping[str, ca.SX],
    loads: Mapping[str, ca.SX],
    load: ca.SX,
) -> dict[str, ca.SX]:
    """Efforts of the joints, as those of `pass_weights_inward`; arguments as there."""
    tree = _Tree(placed, load)
    carried = {GROUND: _Carried(ca.SX(3, 2), ca.SX(3, 2), ca.SX(0), ca.SX(0), ())}
    for link in placed.links:
        name = link.child.name
        scalar = tree.masses[name] * tree.heights[name][-1]
        torque = tree.centers[name] * scalar
        carried[name] = _Carried(
            inertial[name] + ca.horzcat(ca.SX(3, 1), torque),
            loads[name],
            tree.masses[name],
            scalar,
            (),
        )
    efforts: dict[str, ca.SX] = {}
    for link in reversed(placed.links):
        name, parent = link.child.name, link.parent.name
        now = carried[name]
        own: list[ca.SX] = []
        for k in reversed(range(len(placed.moves[name]))):
            move, motion, field = (
                placed.moves[name][k],
                found.moves[name][k],
                tree.fields[name][k + 1],
            )
            now = now._replace(inertial=move.carried(now.inertial, motion))
            if move.degrees_of_freedom:
                force, _ = now.felt(field)
                wrench = ca.horzcat(force, now.inertial[:, 1]) + now.loads
                products = [tree.product(link, k, axis) for axis in _axes_of(move)]
                effort = move.effort(wrench, motion)
                own.insert(0, effort - ca.vertcat(*products) if products else effort)
            now = _before(move, now, field, tree.turns[name][k])
        efforts[link.owner] = ca.vertcat(*own)
        now = _levered(now, placed.arms[name], tree.fields[name][0])
        carried[parent] = _together(carried[parent], now)
    return efforts


def _axes_of(move: Move) -> list[ca.SX]:
    """Axes (3,) about which a move has efforts: those of `turns_of`, and that of a steady rate."""
    if isinstance(move, Hinge) and move.steady:
        return [move.axis]
    return [axis for axis, _ in turns_of(move)]


class _Tree:
    """The tree with what the products need of each body.

    Attributes
    ----------
    fields : load (3,) before the moves of the joint of each body, and after each
    turns : what the load feels of each move of the joint of each body
    heights : p (m/s^2) before the moves of the joint of each body, and after each
    masses, centers : mass (kg) and center of mass (3,) from the inboard port (m)
    """

    def __init__(self, placed: Placed, load: ca.SX) -> None:
        self.placed = placed
        self.fields = load_fields(placed, load)
        self.heights: dict[str, list[ca.SX]] = {GROUND: [ca.SX(0)]}
        self.masses: dict[str, ca.SX] = {}
        self.centers: dict[str, ca.SX] = {}
        self.outward: dict[str, list[Link]] = {}
        self.turns: dict[str, list[list[Turning]]] = {}
        upright = {GROUND: True}
        for link in placed.links:
            name = link.child.name
            values = placed.values.get(owner_name(link.child), {})
            self.masses[name] = link.child.total_mass(values)
            center = "center_of_mass" if isinstance(link.child, RigidBody) else "origin"
            position = link.child.port_position(center, values)
            self.centers[name] = ca.SX(position - placed.inboard[name])
            self.outward.setdefault(link.parent.name, []).append(link)
            self.turns[name], upright[name] = self._felt(link, upright=upright[link.parent.name])
            heights = [self.heights[link.parent.name][-1]]
            for turns, field in zip(self.turns[name], self.fields[name][1:], strict=True):
                heights.append(
                    heights[-1] + sum((ca.dot(e, field) * q for e, q in turns), ca.SX(0))
                )
            self.heights[name] = heights

    def _felt(self, link: Link, *, upright: bool) -> tuple[list[list[Turning]], bool]:
        """Turns of the moves of a link that the load feels, and whether it has felt none up to there.

        Hinges along the load with only such ones inside of them turn nothing that it feels.
        """
        name = link.child.name
        found: list[list[Turning]] = []
        for move, field in zip(self.placed.moves[name], self.fields[name][1:], strict=True):
            turns = list(turns_of(move))
            across = (ca.sparsify(ca.cross(axis, field)) for axis, _ in turns)
            upright = upright and not any(vector.nnz() for vector in across)
            found.append([] if upright else turns)
        return found, upright

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
    return ca.dot(move.r, v) if isinstance(move, Shifted) else ca.SX(0)


def _before(move: Move, now: _Carried, field: ca.SX, turns: Sequence[Turning]) -> _Carried:
    """What is carried before a move, from what is carried after it.

    `field` is the load (3,) after it, `turns` is what the load feels of it.
    """
    if now.loads.nnz():
        now = now._replace(loads=move.wrench(now.loads))
    if isinstance(move, Shifted):
        return _levered(now, move.r, field, with_loads=False)
    if isinstance(move, Slide):
        torque = ca.cross(move.offset(), now.mass * field)
        return now._replace(inertial=now.inertial + ca.horzcat(ca.SX(3, 1), torque))
    if isinstance(move, Turned):
        kept, ended = turned_tilts(move, now.tilts)
        force, scalar = now._replace(tilts=ended).felt(field)
        inertial = move.wrench(ca.horzcat(force, now.inertial[:, 1]))
        return now._replace(inertial=inertial, scalar=scalar, tilts=kept)
    more = (Tilt(axis, now.mass * q, ca.SX(3, 1)) for axis, q in turns)
    return now._replace(tilts=added(now.tilts, *more))


def _levered(now: _Carried, arm: ca.SX, field: ca.SX, *, with_loads: bool = True) -> _Carried:
    """About the point at -arm (3,), in a lever that feels the load `field` (3,)."""
    if not arm.nnz():
        return now
    force, scalar = now.felt(field)
    torque = ca.cross(arm, force) + arm * scalar
    loads = move_wrench(now.loads, arm) if with_loads and now.loads.nnz() else now.loads
    return now._replace(inertial=now.inertial + ca.horzcat(ca.SX(3, 1), torque), loads=loads)


def _together(first: _Carried, second: _Carried) -> _Carried:
    """What a body carries on two joints."""
    return _Carried(
        first.inertial + second.inertial,
        first.loads + second.loads,
        first.mass + second.mass,
        first.scalar + second.scalar,
        added(first.tilts, *second.tilts),
    )
