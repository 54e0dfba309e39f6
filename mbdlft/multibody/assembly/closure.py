"""Closed kinematic loops: independent rows of the constraints, and the coordinates that follow."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import casadi as ca
import numpy as np
from scipy.linalg import qr

from mbdlft.base.array import Array
from mbdlft.base.description import Values
from mbdlft.base.errors import SceneError
from mbdlft.multibody.assembly.kinematics import View
from mbdlft.multibody.assembly.tree import degrees
from mbdlft.multibody.force import BodyWrench
from mbdlft.multibody.loop import Loop
from mbdlft.multibody.scene.quantities import owner_name
from mbdlft.multibody.scene.scene import Scene
from mbdlft.multibody.spatial import move_wrench
from mbdlft.problem.equations import CURVED
from mbdlft.problem.sx.constants import unit_vector

_GAP = 1e-9  # of the lengths of the scene: ports farther apart do not meet
_PASSIVE = 10.0  # weight of a coordinate that nothing holds among those that may follow
_RANK = 1e-9  # a constraint that is another one up to this part is redundant
_STEP = 1e-2  # rad or m, to a position nearby that is compared with the equilibrium
_NEARBY_RANK = (
    1e-5  # constraints that are redundant at the equilibrium only are of the size of the step there
)
_NEWTON = 12


@dataclass(frozen=True, slots=True)
class Closure:
    """Which constraints are kept, and what they determine.

    Attributes
    ----------
    rows : of the constraints that are kept
    dependent : positions of the coordinates that they determine
    yielding : positions of coordinates, empty for a statically determinate scene
        The efforts of passive joints cannot balance the multipliers; deformations determine these. The
        coordinates are those of elastic bodies, and as many of passive joints as the constraints feel.
    """

    rows: tuple[int, ...]
    dependent: tuple[int, ...]
    yielding: tuple[int, ...] = ()


def constraint(loops: Sequence[Loop], view: View, order: int) -> ca.SX:
    """G w for the small motions w of one order: displacement, velocity or acceleration."""
    rows = []
    for loop in loops:
        view.owner, values = owner_name(loop), _own(loop, view)
        body, held = view.small(loop.parent, order)
        other, moved = view.small(loop.child, order)
        if loop.slides:
            apart = view.departure(loop.parent, loop.child, order)
            rows.append(ca.mtimes(loop.held(), loop.in_own_axes(apart, values)))
        else:
            rows.append(view.across(moved.displacement, other, body) - held.displacement)
        turned = view.across(moved.rotation, other, body) - held.rotation
        second = second_axis(loop, values, partial(view.across, source=other, target=body))
        rows.append(ca.mtimes(loop.turned_rows(second), loop.in_own_axes(turned, values)))
    return ca.vertcat(*rows) if rows else ca.SX(0, 1)


def reactions(loops: Sequence[Loop], view: View, multipliers: ca.SX) -> list[BodyWrench]:
    """Wrenches of the multipliers, one for each row of `constraint`, on both bodies of each loop."""
    wrenches, k = [], 0
    for loop in loops:
        view.owner, values = owner_name(loop), _own(loop, view)
        body, at = view.port(loop.parent)
        other, there = view.port(loop.child)
        second = second_axis(loop, values, partial(view.across_now, source=other, target=body))
        directions, held = loop.turned_rows(second), loop.held()
        forces, torques = held.shape[0], directions.shape[0]
        force = multipliers[k : k + forces]
        torque = ca.mtimes(directions.T, multipliers[k + forces : k + forces + torques])
        k += forces + torques
        if loop.slides:  # the parent is pushed where the child's port is now
            force = loop.in_parent_axes(ca.mtimes(held.T, force), values)
            at = at + view.between(loop.parent, loop.child)
        pair = ca.horzcat(force, loop.in_parent_axes(torque, values))
        on_child = ca.horzcat(*(view.across_now(pair[:, column], body, other) for column in range(2)))
        wrenches.append(BodyWrench(body, move_wrench(-pair, at)))
        wrenches.append(BodyWrench(other, move_wrench(on_child, there)))
    return wrenches


def _own(loop: Loop, view: View) -> Values:
    return view.now.values.get(owner_name(loop), {})


def second_axis(loop: Loop, values: Values, across: Callable[[ca.SX], ca.SX]) -> ca.SX:
    """The axis (3,) of the child of a universal closure, in the axes of the closure; of others, nothing.

    `across` gives components in the axes of the parent of a vector in those of the child.
    """
    if loop.axis2 is None:
        return ca.SX(3, 1)
    return loop.in_own_axes(across(unit_vector(loop.axis2)), values)


def close_loops(scene: Scene, view: View, evaluate: Callable[[ca.SX], Sequence[Array]]) -> Closure:
    """Which constraints are independent, and which coordinates they determine, at nominal.

    `evaluate` gives the values of an expression at nominal and at other points of the range.
    """
    if not scene.loops:
        return Closure((), ())
    q = ca.vertcat(*(coordinate.q for coordinate in view.coordinates.values()))
    matrices = evaluate(ca.jacobian(constraint(scene.loops, view, 0), q))
    explained = _explained(scene, view, matrices)
    row = 0
    for loop in scene.loops:
        loop_rows = slice(row, row := row + len(loop.signals()))
        _check_that_it_closes(loop, view, evaluate, explained[:, loop_rows])
    rank, rows = _independent(matrices[0].T)
    for matrix in matrices[1:]:
        if _independent(matrix.T)[0] != rank or _independent(matrix[rows].T)[0] != rank:
            raise SceneError(
                f"scene {scene.name!r}: the {rank} independent constraints of the loops "
                f"{', '.join(loop.name for loop in scene.loops)} are not independent everywhere in the "
                "range of the parameters: the mechanism passes a singular position, or constraints "
                "are redundant at nominal only. Move the nominal values or narrow the ranges."
            )
    _check_that_it_moves_alike(scene, view, evaluate, q, rank)
    # the states are those of joints that are held or driven, and near the ground, where that is well
    # conditioned: columns are compared with a weight, the last one first
    weights = np.array([_PASSIVE if is_passive else 1.0 for is_passive in _passive(view)])
    weights[[degree.kind == "motion" for degree in degrees(view.now.links)]] = 0.0
    follow, last = _independent((matrices[0][rows] * weights)[:, ::-1])
    if follow < rank:
        raise SceneError(
            f"scene {scene.name!r}: the loops {', '.join(loop.name for loop in scene.loops)} hold joints "
            "with imposed = 'motion', which move as their inputs say: nothing else is left that could "
            "follow. Let another joint give way, or impose an acceleration (imposed = true)."
        )
    dependent = tuple(sorted(len(weights) - 1 - k for k in last))
    return Closure(tuple(rows), dependent, _yielding(view, matrices[0][rows]))


def _yielding(view: View, held: Array) -> tuple[int, ...]:
    """The coordinates that `Closure` calls so, from independent constraints (m, n) at nominal."""
    every = degrees(view.now.links)
    elastic = [k for k, degree in enumerate(every) if degree.kind == "elastic"]
    passive = [k for k, is_passive in enumerate(_passive(view)) if is_passive and k not in elastic]
    rank, chosen = _independent(held[:, passive]) if passive else (0, [])
    if rank == len(held) or not elastic:
        return ()
    return tuple(sorted([*elastic, *(passive[k] for k in chosen)]))


def _check_that_it_moves_alike(
    scene: Scene, view: View, evaluate: Callable[[ca.SX], Sequence[Array]], q: ca.SX, rank: int
) -> None:
    """As many constraints are independent at a closed position nearby as at the equilibrium, at nominal.

    Where branches of the motion cross, fewer are, and the linearized constraints let more move than does.
    """
    gaps = [gap_of(loop, view) for loop in scene.loops]
    gap = ca.vertcat(*gaps)
    both = ca.horzcat(gap, ca.jacobian(gap, q))
    _, _, rows = np.linalg.svd(evaluate(ca.substitute(both, q, ca.DM.zeros(q.numel())))[0][:, 1:])
    free = rows[rank:].T
    if not free.size:
        return
    position = _STEP * free @ np.random.default_rng(0).uniform(0.5, 1.0, free.shape[1])
    for _ in range(_NEWTON):
        value = evaluate(ca.substitute(both, q, ca.DM(position)))[0]
        if np.max(np.abs(value[:, 0])) <= _GAP * _STEP:
            break
        position = position - np.linalg.lstsq(value[:, 1:], value[:, 0], rcond=_NEARBY_RANK)[0]
    else:
        return  # no closed position was found nearby: nothing to compare with
    sizes = np.linalg.svd(value[:, 1:], compute_uv=False)
    nearby = int(np.sum(sizes > _NEARBY_RANK * np.max(sizes, initial=0.0)))
    if nearby > rank and np.max(np.abs(position)) > _GAP:
        raise SceneError(
            f"scene {scene.name!r}: the equilibrium is a singular position of the loops "
            f"{', '.join(loop.name for loop in scene.loops)}: {rank} constraints are independent there "
            f"and {nearby} nearby, so branches of the motion meet and there is no linear model. Move "
            "the nominal values or the positions of the joints."
        )


def gap_of(loop: Loop, view: View) -> ca.SX:
    """Gap of the ports, and of the directions that are held, at displaced positions."""
    view.owner, values = owner_name(loop), _own(loop, view)
    body, other = (view.find(port)[0] for port in (loop.parent, loop.child))
    apart = loop.in_own_axes(view.between(loop.parent, loop.child), values)
    return ca.vertcat(
        ca.mtimes(loop.held(), apart), _skewed(loop, values, lambda v: view.across_now(v, body, other))
    )


def _skewed(loop: Loop, values: Values, across: Callable[[ca.SX], ca.SX]) -> ca.SX:
    """What directions (n,) that a closure holds differ by in the parent and in the child.

    `across` gives components in the axes of the child of a vector in those of the parent.
    """
    if loop.axis1 is not None and loop.axis2 is not None:
        first, second = unit_vector(loop.axis1), unit_vector(loop.axis2)
        cosine = ca.dot(across(loop.in_parent_axes(first, values)), second)
        return cosine - ca.dot(first, second)
    same = loop.same()
    differences = [
        across(loop.in_parent_axes(same[:, k], values)) - same[:, k] for k in range(same.shape[1])
    ]
    return ca.vertcat(ca.SX(0, 1), *differences)


def _explained(scene: Scene, view: View, matrices: Sequence[Array]) -> Array:
    """Gaps (N, rows) that the bounds of fitted positions allow at the points of the matrices."""
    bounds = scene.fit.bounds if scene.fit else {}
    every = degrees(view.now.links)
    errors = np.array([bounds.get(degree.measure(0).name, 0.0) for degree in every])
    errors = errors * (1.0 + CURVED * np.max(errors, initial=0.0))
    return np.asarray(np.abs(np.array(matrices)) @ errors)


def _passive(view: View) -> list[bool]:
    """Whether the effort of each coordinate is given, so that nothing holds it."""
    return [
        degree.kind == "elastic" or degree.label("preload") in view.now.values[degree.owner]
        for degree in degrees(view.now.links)
    ]


def _independent(columns: Array) -> tuple[int, list[int]]:
    """Rank of a matrix, and the positions of columns that make it."""
    _, triangle, order = qr(columns, mode="economic", pivoting=True)
    sizes = np.abs(np.diag(triangle))
    rank = int(np.sum(sizes > _RANK * np.max(sizes, initial=0.0)))
    return rank, sorted(int(k) for k in order[:rank])


def _gap_at_nominal(loop: Loop, view: View, evaluate: Callable[[ca.SX], Sequence[Array]]) -> str:
    """Where the two ports are at nominal, in the axes of the ground."""
    places = [
        ", ".join(f"{x:.4g}" for x in evaluate(view.between_at_rest("ground", port))[0][:, 0])
        for port in (loop.parent, loop.child)
    ]
    return f", at [{places[0]}] and [{places[1]}] m of the ground at nominal"


def _check_that_it_closes(
    loop: Loop, view: View, evaluate: Callable[[ca.SX], Sequence[Array]], explained: Array
) -> None:
    """The ports meet, and for a closure that holds directions these are parallel, at all points.

    `explained` (N, rows) are the gaps that fitted positions may leave.
    """
    view.owner, values = owner_name(loop), _own(loop, view)
    gaps, reach = view.gaps(loop.parent, loop.child, evaluate)
    if loop.slides:
        apart = view.between_at_rest(loop.parent, loop.child)
        gaps = evaluate(ca.mtimes(loop.held(), loop.in_own_axes(apart, values)))
    count = loop.held().shape[0]
    widest = max(float(np.linalg.norm(gap)) for gap in gaps)
    allowed = np.linalg.norm(explained[:, :count], axis=1)
    excess = np.max(np.linalg.norm(gaps, axis=(1, 2)) - allowed)
    if not excess <= _GAP * reach:
        raise SceneError(
            f"loop {loop.name!r}: the ports {loop.parent!r} and {loop.child!r} do not meet: they are "
            f"{widest:.3g} m apart{' across the axis' if loop.slides else ''} at nominal or elsewhere in "
            f"the range{_gap_at_nominal(loop, view, evaluate)}. Correct the positions of the joints; "
            "where a parameter changes the shape of the loop they must follow it."
        )
    body, other = (view.port(port)[0] for port in (loop.parent, loop.child))
    turned = _skewed(loop, values, lambda v: view.across(v, body, other))
    if turned.numel():
        skewed = max(float(np.max(np.abs(value))) for value in evaluate(turned))
        largest = float(np.max(np.linalg.norm(explained[:, count:], axis=1)))
        if not skewed <= _GAP + largest:
            raise SceneError(
                f"loop {loop.name!r}: a direction that it holds is not the same in {loop.parent!r} and "
                f"in {loop.child!r}: they differ by {skewed:.3g} rad at nominal or elsewhere in the "
                "range. Give the loop or the joints an orientation that makes them parallel."
            )
