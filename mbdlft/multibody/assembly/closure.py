"""Closed loops and rigid couplings: independent rows of the constraints, and coordinates that follow."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import casadi as ca
import numpy as np
from scipy.linalg import qr

from mbdlft.base.array import Array
from mbdlft.base.description import Values
from mbdlft.base.errors import SceneError, TrimError
from mbdlft.multibody.assembly.coupled import multipliers_of, relations, rigid
from mbdlft.multibody.assembly.kinematics import View
from mbdlft.multibody.assembly.touching import contact_rows
from mbdlft.multibody.assembly.tree import Symbols, degrees
from mbdlft.multibody.force import BodyWrench
from mbdlft.multibody.loop import Loop
from mbdlft.multibody.scene.quantities import owner_name
from mbdlft.multibody.scene.scene import Scene
from mbdlft.multibody.spatial import move_wrench
from mbdlft.problem.equations import CURVED
from mbdlft.problem.sx.constants import unit_vector

_GAP = 1e-9  # of the lengths of the scene: ports farther apart do not meet
_PASSIVE = 10.0  # weight of a coordinate that nothing holds among those that may follow
_PATCH = 1e3  # and of the patch of a tire, which has no mass
_RANK = 1e-9  # a constraint that is another one up to this part is redundant
_STEP = 1e-2  # rad or m, to a position nearby that is compared with the equilibrium
_NEARBY_RANK = 1e-5  # what is redundant at the equilibrium only is of the size of the step there
_NEWTON = 12


@dataclass(frozen=True, slots=True)
class Closure:
    """Which constraints are kept, and what they determine.

    In a statically indeterminate scene the efforts of passive joints cannot balance the multipliers, and
    deformations determine these: `yielding` are the coordinates of elastic bodies, and as many of passive
    joints as the constraints feel.
    """

    rows: tuple[int, ...]  # of the constraints that are kept, the holonomic ones first
    dependent: tuple[int, ...]  # positions of the coordinates that these determine
    holonomic: int = 0  # how many of the kept rows are
    rates: tuple[int, ...] = ()  # positions of the rates that all of them determine
    yielding: tuple[int, ...] = ()  # positions of coordinates
    shared: tuple[int, ...] = ()  # constraints that say the same: their forces are known as a sum only
    count: int = 0  # of all constraints, also those that are not kept


def multipliers(closure: Closure, last: ca.SX) -> ca.SX:
    """All multipliers, of which the last entries of a column are those of the rows that are kept."""
    every, first = ca.SX(closure.count, 1), last.numel() - len(closure.rows)
    for position, row in enumerate(closure.rows):
        every[row] = last[first + position]
    return every


def constraint(scene: Scene, view: View, order: int) -> ca.SX:
    """G w for the small motions w of one order: displacement, velocity or acceleration.

    First of the loops, then of the rigid couplings, then of contacts: what they hold, and, for rates and
    accelerations, how they roll.
    """
    rows = [ca.SX(0, 1)]
    for loop in scene.loops:
        values = view.owned(loop)
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
    small = ca.vertcat(*(coordinate[order] for coordinate in view.coordinates.values()))
    coupled = ca.mtimes(relations(scene, rigid(scene), view), small)
    of_contacts = contact_rows(touches, view, order) if (touches := scene.touches) else ()
    return ca.vertcat(*rows, coupled, *of_contacts)


def reactions(loops: Sequence[Loop], view: View, multipliers: ca.SX) -> list[BodyWrench]:
    """Wrenches of the multipliers, one for each row of loops in `constraint`, on both bodies."""
    wrenches, k = [], 0
    for loop in loops:
        values = view.owned(loop)
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


def second_axis(loop: Loop, values: Values, across: Callable[[ca.SX], ca.SX]) -> ca.SX:
    """The axis (3,) of a universal closure's child, in the axes of the closure; of others, nothing."""
    if loop.axis2 is None:
        return ca.SX(3, 1)
    return loop.in_own_axes(across(unit_vector(loop.axis2)), values)


def every_constraint(scene: Scene) -> Closure:
    """All constraints of a scene in which nothing rolls, also redundant ones."""
    if scene.rolling:
        first = owner_name(scene.rolling[0])
        raise TrimError(
            f"scene {scene.name!r}: positions are not searched for where bodies roll, as {first} does. "
            "Declare positions at which they stand on the ground."
        )
    count = len(multipliers_of(scene)[0])
    return Closure(tuple(range(count)), (), count, count=count)


def close_loops(scene: Scene, view: View, symbols: Symbols) -> Closure:
    """Which constraints are independent, and which coordinates they determine, at nominal."""
    evaluate = symbols.evaluate
    first, others = multipliers_of(scene)
    if not first and not others:
        return Closure((), ())
    q = ca.vertcat(*(coordinate.q for coordinate in view.coordinates.values()))
    v = ca.vertcat(*(coordinate.v for coordinate in view.coordinates.values()))
    matrices = evaluate(ca.jacobian(constraint(scene, view, 1), v))
    explained = _explained(scene, view, matrices)
    row = 0
    for loop in scene.loops:
        loop_rows = slice(row, row := row + len(loop.signals()))
        _check_that_it_closes(loop, view, symbols, explained[:, loop_rows])
    rows = independent(matrices[0][:row].T)[1] if row else []
    rows += range(row, row + len(rigid(scene)))  # they are independent of each other: all are kept
    for k in range(row + len(rigid(scene)), len(matrices[0])):
        if independent(matrices[0][[*rows, k]].T)[0] > len(rows):
            rows.append(k)
    rank, holonomic = len(rows), sum(k < len(first) for k in rows)
    named = {
        "loops": [loop.name for loop in scene.loops],
        "couplings": [coupling.name for coupling in rigid(scene)],
        "contacts": [contact.name for contact in scene.touches],
    }
    listed = " and ".join(f"{kind} {', '.join(names)}" for kind, names in named.items() if names)
    for matrix in matrices:
        if independent(matrix.T)[0] != rank or independent(matrix[rows].T)[0] != rank:
            raise SceneError(
                f"scene {scene.name!r}: the {rank} independent constraints of the {listed} are not "
                "independent everywhere in the range of the parameters: the mechanism passes a singular "
                "position, or constraints are redundant at nominal only. Move the nominal values or "
                "narrow the ranges."
            )
    if not scene.touches:
        _check_that_it_moves_alike(scene, view, evaluate, q, rank)
    # the states are those of joints that are held or driven, and near the ground, where that is well
    # conditioned: columns are compared with a weight, the last one first
    weights = np.array([_PASSIVE if is_passive else 1.0 for is_passive in _passive(view)])
    kinds = np.array([degree.kind for degree in degrees(view.now.links)])
    weights[kinds == "motion"], weights[kinds == "patch"] = 0.0, _PATCH
    G = matrices[0][rows]
    dependent = _determined(G[:holonomic], weights, ())
    rates = _determined(G, weights, dependent)
    if len(rates) < rank:
        raise SceneError(
            f"scene {scene.name!r}: the {listed} hold joints "
            "with imposed = 'motion', which move as their inputs say: nothing else is left that could "
            "follow. Let another joint give way, or impose an acceleration (imposed = true)."
        )
    shared = list[int]()
    if scene.touches:  # of others nobody asks
        every = matrices[0]
        shared = [k for k in range(len(every)) if independent(np.delete(every, k, axis=0).T)[0] == rank]
    count = len(first) + len(others)
    return Closure(tuple(rows), dependent, holonomic, rates, _yielding(view, G), tuple(shared), count)


def _determined(G: Array, weights: Array, known: tuple[int, ...]) -> tuple[int, ...]:
    """Columns that rows G determine, with `known` ones, which the first rows determine."""
    count = len(known)
    others = [k for k in range(len(weights)) if k not in known][::-1]
    left = G[count:, others]
    if count:
        left = left - G[count:, known] @ np.linalg.solve(G[:count, known], G[:count, others])
    if not len(left):
        return known
    return tuple(sorted([*known, *(others[k] for k in independent(left * weights[others])[1])]))


def _yielding(view: View, held: Array) -> tuple[int, ...]:
    """The coordinates that `Closure` calls so, from independent constraints (m, n) at nominal."""
    every = degrees(view.now.links)
    elastic = [k for k, degree in enumerate(every) if degree.kind == "elastic"]
    passive = [k for k, is_passive in enumerate(_passive(view)) if is_passive and k not in elastic]
    rank, chosen = independent(held[:, passive]) if passive else (0, [])
    if rank == len(held) or not elastic:
        return ()
    return tuple(sorted([*elastic, *(passive[k] for k in chosen)]))


def _check_that_it_moves_alike(
    scene: Scene, view: View, evaluate: Callable[[ca.SX], Sequence[Array]], q: ca.SX, rank: int
) -> None:
    """As many constraints are independent at a closed position nearby as at the equilibrium, at nominal.

    Where branches of the motion cross, fewer are, and the linearized constraints let more move than does.
    """
    if not scene.loops:
        return  # couplings are linear
    gap = ca.vertcat(*(gap_of(loop, view)[0] for loop in scene.loops))
    gap = ca.vertcat(gap, ca.mtimes(relations(scene, rigid(scene), view), q))
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


def gap_of(loop: Loop, view: View) -> tuple[ca.SX, ca.SX]:
    """Gap (n,) of a loop at displaced positions, one for each multiplier, and cosines that must be 1.

    The gap of a loop with one axis is the part of the child's axis across that of the parent; that of one
    that allows no rotation is sin(angle) times the axis of the rotation from the child to the closure. A
    gap is also zero where its cosine is -1: there one side is turned the wrong way round.
    """
    values = view.owned(loop)
    body, other = (view.find(port)[0] for port in (loop.parent, loop.child))

    def seen(vectors: ca.SX) -> ca.SX:
        in_parent = (view.across_now(v, other, body) for v in ca.horzsplit(vectors))
        return loop.in_own_axes(ca.horzcat(*in_parent), values)

    apart = ca.mtimes(loop.held(), loop.in_own_axes(view.between(loop.parent, loop.child), values))
    same = loop.same()
    if loop.axis1 is not None and loop.axis2 is not None:
        first, second = unit_vector(loop.axis1), unit_vector(loop.axis2)
        cosine = ca.dot(first, seen(second))
        return ca.vertcat(apart, cosine - ca.dot(first, second)), ca.SX(0, 1)
    if not same.shape[1]:
        return apart, ca.SX(0, 1)
    turned = seen(same)
    if same.shape[1] == 1:
        return ca.vertcat(apart, ca.mtimes(loop.turned_rows(ca.SX(3, 1)), turned)), ca.dot(same, turned)
    twice_sine = ca.vertcat(*(turned[i, j] - turned[j, i] for i, j in ((2, 1), (0, 2), (1, 0))))
    return ca.vertcat(apart, 0.5 * twice_sine), 0.5 * (ca.trace(turned) - 1.0)


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


def independent(columns: Array, smallest: float = _RANK) -> tuple[int, list[int]]:
    """Rank of a matrix, with pivots above `smallest` of the largest, and columns that make it."""
    _, triangle, order = qr(columns, mode="economic", pivoting=True)
    sizes = np.abs(np.diag(triangle))
    rank = int(np.sum(sizes > smallest * np.max(sizes, initial=0.0)))
    return rank, sorted(int(k) for k in order[:rank])


def _check_that_it_closes(loop: Loop, view: View, symbols: Symbols, explained: Array) -> None:
    """The ports meet and held directions are parallel, but for the `explained` gaps (N, rows)."""
    evaluate = symbols.evaluate
    _, reach = view.gaps(loop.parent, loop.child, evaluate)
    gap, cosines = gap_of(loop, view)
    q = ca.vertcat(*(coordinate.q for coordinate in view.coordinates.values()))
    at_rest = ca.substitute(ca.vertcat(gap, 1.0 - cosines), q, ca.SX.zeros(q.numel()))
    count = loop.held().shape[0]
    apart, skewed = np.split(np.stack(evaluate(at_rest))[:, :, 0], [count], axis=1)
    excess = np.linalg.norm(apart, axis=1) - np.linalg.norm(explained[:, :count], axis=1)
    if not np.max(excess) <= _GAP * reach:
        worst = 0 if not excess[0] <= _GAP * reach else int(np.argmax(excess))
        at, there = (
            ", ".join(f"{x:.10g}" for x in evaluate(view.between_at_rest("ground", port))[worst][:, 0])
            for port in (loop.parent, loop.child)
        )
        where, advice = "at nominal", "Correct the positions of the joints: find_equilibrium finds some"
        if worst:
            of = zip(symbols.parameters, evaluate(symbols.p)[worst][:, 0], strict=True)
            seen = [p.name for p in symbols.parameters if symbols.is_in(at_rest, p.name)]
            values = [f"{p.name} = {x:.10g} {p.unit}".strip() for p, x in of if p.name in seen]
            where = f"at {', '.join(values)}"
            advice = (
                "They meet at nominal: positions of joints must follow the parameters that change the "
                "shape of the loop; fit_positions(scene, joints, tolerance) makes them do so"
            )
        raise SceneError(
            f"loop {loop.name!r}: the ports {loop.parent!r} and {loop.child!r} do not meet: they are "
            f"{np.linalg.norm(apart[worst]):.3g} m apart{' across the axis' if loop.slides else ''} "
            f"{where}, at [{at}] and [{there}] m of the ground. {advice}."
        )
    largest = float(np.max(np.linalg.norm(explained[:, count:], axis=1)))
    if not float(np.max(np.abs(skewed), initial=0.0)) <= _GAP + largest:
        sines, from_one = np.split(skewed, [gap.numel() - count], axis=1)
        angles = np.arctan2(np.linalg.norm(sines, axis=1), 1.0 - np.sum(from_one, axis=1))
        raise SceneError(
            f"loop {loop.name!r}: a direction that it holds is not the same in {loop.parent!r} and "
            f"in {loop.child!r}: they differ by {angles[0]:.3g} rad at nominal, and by up to "
            f"{np.max(angles):.3g} rad where the range was looked at. Give the loop or the joints an "
            "orientation that makes them parallel."
        )
