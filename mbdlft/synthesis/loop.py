"""Closed loops with free values: assembled by names, and their matrices with slopes at many points.

Plants, frames of controllers, and weights are one system P(delta) from the channels of all goals and q to
those of all goals and v; q = S(x) v closes it. With [xdot ; z ; v] = [X_0 L ; R D_22] [x ; w ; q],

    X(S) = X_0 + L (I - S D_22)^-1 S R,     dX = L_S dS R_S,
    L_S = L (I - S D_22)^-1,                R_S = (I + D_22 (I - S D_22)^-1 S) R.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any, NamedTuple

import numpy as np

from mbdlft.base.array import Array
from mbdlft.base.errors import StructureError
from mbdlft.base.unit import Signal
from mbdlft.exact.rounding import solve_nominal
from mbdlft.lft.lft import LFT, check_plain
from mbdlft.lft.sampling import evaluate_at
from mbdlft.response.staircase import Plant
from mbdlft.robust.realization import left_out, states_that_stay
from mbdlft.synthesis.goals import MARGIN, Goal, check_goals
from mbdlft.synthesis.pieces import FreeValue, TunableSystem
from mbdlft.system.blocks import TunableGain, tunable
from mbdlft.system.connection import connect, pairs_of
from mbdlft.system.conversion import check_once, operand
from mbdlft.system.model import System

_FIRST_CORNERS, _FEW = 4, 4  # of a part of the box; fewer scheduled parameters have a grid of points
_CORNERS, _RANDOM = 64, 96  # points of the box that are looked at in each round
Connections = Sequence[Sequence[str]] | Mapping[str, str | Sequence[str]]
Pairs = Sequence[tuple[str, list[str]]]  # the same: inputs, and what adds up to each


@dataclass(frozen=True, slots=True, eq=False)
class Network:
    """Systems and frames that are connected, before weights: from channels and q to channels and v."""

    system: System
    inputs: tuple[str, ...]  # the channels that goals name
    outputs: tuple[str, ...]
    base: Array  # and `moves`: as those of `TunableSystem`, of all controllers and design parameters
    moves: Array
    free: tuple[FreeValue, ...]
    controllers: tuple[TunableSystem, ...]
    design: Mapping[str, TunableGain]  # by the names of design parameters

    def matrix(self, x: Array) -> Array:
        """S at values (number of values,)."""
        return np.asarray(self.base + np.tensordot(x, self.moves, 1))

    @property
    def scheduled(self) -> Array:
        """1 for parameters with which controllers are scheduled, else 0."""
        names = {name for c in self.controllers for name in c.frame.parameters.names}
        return np.array([float(name in names) for name in self.system.parameters.names])


class _Opened(NamedTuple):
    """Channels that q = S v closes, by their names."""

    q: list[str]
    v: list[str]
    base: Array
    moves: Array
    free: tuple[FreeValue, ...]
    gain: TunableGain | None = None  # of a design parameter


def network(
    systems: Sequence[Any],
    connections: Connections,
    goals: Sequence[Goal],
    more: Sequence[str] = (),
    leave_out: Sequence[str] = (),
) -> Network:
    """Systems and controllers, connected as `connect` does it, with the channels of the goals.

    Inputs of systems that nothing drives, and `more` inputs of the whole, are zero; those of controllers
    are errors. States to leave out are gone.
    """
    check_goals(goals)
    made = [_parts_of(item, f"tune: systems[{k}]") for k, item in enumerate(systems)]
    parts, opened = [part for part, _ in made], [gap for _, gaps in made for gap in gaps]
    if not opened:
        raise StructureError(
            "tune: there is nothing to be tuned: no system is a controller with free values, such as of "
            "tunable_pid, and no parameter has the role 'design'."
        )
    check_once([part.name for part in parts], "tune, systems")
    inputs, outputs = (
        list(dict.fromkeys(name for goal in goals for name in getattr(goal, side)))
        for side in ("inputs", "outputs")
    )
    q = [name for part in opened for name in part.q]
    v = [name for part in opened for name in part.v]
    pairs = pairs_of(connections) or []
    idle = [*_idle(parts, pairs, [*inputs, *q]), *(name for name in more if name not in inputs)]
    try:
        whole = connect(parts, connections, inputs=[*inputs, *q, *idle], outputs=[*outputs, *v])
    except StructureError as error:
        advice = " An input of the whole that stands in no goal is one of `inputs`: inputs = ['r']."
        raise StructureError(f"{error}{advice * ('unknown output' in str(error))}") from None
    _check_connected(systems, pairs, idle, outputs)
    whole = whole[:, : len(inputs) + len(q)]
    base, moves = np.zeros((len(q), len(v))), list[Array]()
    i = j = 0
    for part in opened:
        rows, columns = slice(i, i + len(part.q)), slice(j, j + len(part.v))
        base[rows, columns] = part.base
        moves.append(np.zeros((len(part.moves), *base.shape)))
        moves[-1][:, rows, columns] = part.moves
        i, j = rows.stop, columns.stop
    free = tuple(value for part in opened for value in part.free)
    check_once([value.name for value in free], "tune, free values")
    return Network(
        _without(_plain(whole), leave_out),
        tuple(inputs),
        tuple(outputs),
        base,
        np.concatenate(moves),
        free,
        tuple(item for item in systems if isinstance(item, TunableSystem)),
        {part.gain.name: part.gain for part in opened if part.gain is not None},
    )


def _parts_of(item: Any, what: str) -> tuple[System, list[_Opened]]:
    """A system, or the frame of a controller, without the gains that are to be chosen."""
    if isinstance(item, TunableSystem):
        nq, nv = item.base.shape
        q = [f"{item.name}.{s.name}" for s in item.frame.inputs[-nq:]]
        v = [f"{item.name}.{s.name}" for s in item.frame.outputs[-nv:]]
        return item.frame, [_Opened(q, v, item.base, item.moves, item.free)]
    system, opened = _plain(operand(item, what)), []
    check_plain(system.lft, f"tune: {system.name!r}")
    if any(p.role == "design" for p in system.parameters):
        system, gains = (made := tunable(system)).plant, made.gains
        for gain in gains:
            n = gain.repetitions
            value = FreeValue(gain.name, 0.0, -1.0, 1.0, 0.5)
            q, v = ([f"{system.name}.{s}" for s in side] for side in (gain.inputs, gain.outputs))
            opened.append(_Opened(q, v, np.zeros((n, n)), np.eye(n)[None], (value,), gain))
    return system, opened


def _plain(system: System) -> System:
    """Without evidence, which is that of the parts."""
    return System(
        system.name, system.lft, system.states, system.inputs, system.outputs, system.parameters
    )


def _without(system: System, leave_out: Sequence[str]) -> System:
    """The system without states on which nothing else depends."""
    every, n = range(len(system.outputs)), len(system.states)
    stay = states_that_stay(system, left_out(system, leave_out, every), every)
    rows, columns = ([*stay, *range(n, size)] for size in system.lft.shape)
    a = system.lft
    kept = LFT(a.M11, a.M12[:, columns], a.M21[rows], a.M22[np.ix_(rows, columns)], a.blocks)
    return replace(system, lft=kept, states=tuple(system.states[k] for k in stay))


def _idle(parts: Sequence[System], pairs: Pairs, driven: Sequence[str]) -> list[str]:
    """Inputs of systems that neither connections nor goals drive."""
    known = {*driven, *(target for target, _ in pairs)}
    full = [(f"{part.name}.{s.name}", s.name) for part in parts for s in part.inputs]
    return [name for name, alone in full if not {name, alone} & known]


def _check_connected(
    systems: Sequence[Any], pairs: Pairs, idle: Sequence[str], outputs: Sequence[str]
) -> None:
    """A StructureError names a channel of a controller that nothing drives, or that drives nothing."""
    used = {name.removeprefix("-") for _, sources in pairs for name in sources}
    used |= {*outputs}
    for item in systems:
        if not isinstance(item, TunableSystem):
            continue
        fed, leading = ([(name, f"{item.name}.{name}") for name in side] for side in item.channels)
        lost = [f"nothing drives its input {full!r}" for _, full in fed if full in idle]
        lost += [
            f"its output {full!r} drives nothing" for name, full in leading if not {name, full} & used
        ]
        if lost:
            raise StructureError(
                f"tune: controller {item.name!r}: {lost[0]}. Name it in connections: nothing else is "
                "connected, also where signals have one name."
            )


def weighted(net: Network, goals: Sequence[Goal]) -> System:
    """The network with the weights of goals: inputs w of each goal and q, outputs z of each and v.

    [A B ; C D] of the whole is K + left [A B ; C D] right; the weights are in these matrices.
    """
    P, (nq, nv), n = net.system, net.base.shape, len(net.system.states)
    before = [_weight(g.before, [n + net.inputs.index(u) for u in g.inputs]) for g in goals]
    after = [_weight(g.after, [n + net.outputs.index(y) for y in g.outputs]) for g in goals]
    before.append((_static(nq), list(range(n + len(net.inputs), n + len(P.inputs)))))
    after.append((_static(nv), list(range(n + len(net.outputs), n + len(P.outputs)))))
    n_before, n_after = (sum(len(w.A) for w, _ in side) for side in (before, after))
    first, last = n + n_before, n + n_before + n_after  # the first of the states after, of w and z
    nw, nz = (sum(w.D.shape[k] for w, _ in side) for side, k in ((before, 1), (after, 0)))
    left, right = np.zeros((last + nz, n + len(P.outputs))), np.zeros((n + len(P.inputs), last + nw))
    left[:n, :n], right[:n, :n], K = np.eye(n), np.eye(n), np.zeros((last + nz, last + nw))
    x, w = n, last
    for weight, at in before:
        states, channels = slice(x, x + len(weight.A)), slice(w, w + weight.D.shape[1])
        K[states, states], K[states, channels] = weight.A, weight.B
        right[at, states], right[at, channels] = weight.C, weight.D
        x, w = states.stop, channels.stop
    x, z = first, last
    for weight, at in after:
        states, channels = slice(x, x + len(weight.A)), slice(z, z + weight.D.shape[0])
        K[states, states], K[channels, states] = weight.A, weight.C
        left[states, at], left[channels, at] = weight.B, weight.D
        x, z = states.stop, channels.stop
    for goal, (rows, columns) in zip(goals, places(goals), strict=True):
        if goal.kind == MARGIN:
            K[last:, last:][rows, columns] -= 0.5 * np.eye(len(goal.inputs))
    a = P.lft
    whole = LFT(a.M11, a.M12 @ right, left @ a.M21, K + left @ a.M22 @ right, a.blocks)
    more = (Signal(f"weights.{k + 1}", "1") for k in range(last - n))
    return _named(P, whole, (*P.states, *more))


def _weight(weight: System | None, at: list[int]) -> tuple[Plant, list[int]]:
    if weight is None:
        return _static(len(at)), at
    return Plant(weight.A, weight.B_u, weight.C_y, weight.D_yu), at


def _static(n: int) -> Plant:
    return Plant(np.zeros((0, 0)), np.zeros((0, n)), np.zeros((n, 0)), np.eye(n))


def _named(
    like: System,
    lft: LFT,
    states: tuple[Signal, ...],
    inputs: Sequence[str] | None = None,
    outputs: Sequence[str] | None = None,
) -> System:
    """A system with names of its inputs and outputs; else they are numbered."""
    w = [f"w.{k + 1}" for k in range(lft.shape[1] - len(states))] if inputs is None else inputs
    z = [f"z.{k + 1}" for k in range(lft.shape[0] - len(states))] if outputs is None else outputs
    first, last = (tuple(Signal(name, "1") for name in names) for names in (w, z))
    return System(like.name, lft, states, first, last, like.parameters)


def sizes_of(goal: Goal) -> tuple[int, int]:
    """Numbers of weighted inputs and outputs."""
    return (
        len(goal.inputs) if goal.before is None else len(goal.before.inputs),
        len(goal.outputs) if goal.after is None else len(goal.after.outputs),
    )


def places(goals: Sequence[Goal]) -> list[tuple[slice, slice]]:
    """Rows z and columns w of each goal in the weighted network."""
    found, i, j = [], 0, 0
    for goal in goals:
        nw, nz = sizes_of(goal)
        found.append((slice(i, i + nz), slice(j, j + nw)))
        i, j = i + nz, j + nw
    return found


def closed_loop(net: Network, goal: Goal | None, x: Array, name: str) -> System:
    """The loop with values: from the weighted inputs of a goal to its weighted outputs."""
    P, (nq, nv), S = weighted(net, [] if goal is None else [goal]), net.base.shape, net.matrix(x)
    a = P.lft
    whole = np.block([[a.M11, a.M12], [a.M21, a.M22]])
    rows, columns = len(whole) - nv, whole.shape[1] - nq
    D22 = whole[rows:, columns:]
    inner = solve_nominal(np.eye(nq) - S @ D22, S @ whole[rows:, :columns], f"tune: {name!r}")
    whole = whole[:rows, :columns] + whole[:rows, columns:] @ inner
    z, w = a.M11.shape
    closed = LFT(whole[:z, :w], whole[:z, w:], whole[z:, :w], whole[z:, w:], a.blocks)
    names = [_weighted_names(goal, side) for side in ("inputs", "outputs")]
    return replace(_named(P, closed, P.states, *names), name=name)


def _weighted_names(goal: Goal | None, side: str) -> tuple[str, ...] | None:
    """Names of the channels of a goal, which say whether there is a weight."""
    if goal is None:
        return ()
    weight, names = (goal.before if side == "inputs" else goal.after), getattr(goal, side)
    if weight is None:
        return tuple(names)
    count = sizes_of(goal)[side == "outputs"]
    return tuple(f"weighted {name}" for name in names) if count == len(names) else None


class Closed(NamedTuple):
    """Matrices of m loops, and those of their slopes: dX = L dS R, dL = L dS T, dR = T dS R."""

    A: Array  # (m, n, n)
    B: Array  # (m, n, nw)
    C: Array  # (m, nz, n)
    D: Array  # (m, nz, nw)
    L: Array  # (m, n + nz, nq)
    R: Array  # (m, nv, n + nw)
    T: Array  # (m, nv, nq)


@dataclass(frozen=True, slots=True, eq=False)
class Family:
    """The weighted network at some points of the box, ready to be closed; the points come first."""

    X: Array
    L: Array
    R: Array
    D22: Array
    states: int
    base: Array  # and `moves`: of the network
    moves: Array

    def at(self, points: Sequence[int]) -> "Family":
        """At some of the points."""
        X, L, R, D22 = (matrix[points] for matrix in (self.X, self.L, self.R, self.D22))
        return replace(self, X=X, L=L, R=R, D22=D22)

    def closed(self, x: Array) -> Closed | None:
        """The loops with values x; None if one is singular."""
        S, n = self.base + np.tensordot(x, self.moves, 1), self.states
        try:
            W = np.linalg.inv(np.eye(len(S)) - S @ self.D22)
        except np.linalg.LinAlgError:
            return None
        L, K = self.L @ W, W @ S
        X = self.X + self.L @ K @ self.R
        if not np.all(np.isfinite(X)):
            return None
        R = self.R + self.D22 @ K @ self.R
        return Closed(X[:, :n, :n], X[:, :n, n:], X[:, n:, :n], X[:, n:, n:], L, R, self.D22 @ W)


def family(net: Network, P: System, points: Array) -> Family:
    """The weighted network P at deltas (m, number of parameters)."""
    value = evaluate_at(P.lft, points)
    nq, nv = net.base.shape
    rows, columns = value.shape[1] - nv, value.shape[2] - nq
    return Family(
        value[:, :rows, :columns],
        value[:, :rows, columns:],
        value[:, rows:, :columns],
        value[:, rows:, columns:],
        len(P.states),
        net.base,
        net.moves,
    )


def first_points(net: Network, ends: Array, seed: int) -> Array:
    """A few corners of a part of the box; of parameters that are scheduled, if they are few, a grid."""
    scheduled = np.flatnonzero(net.scheduled * ends)
    grid = list(product((-1.0, 0.0, 1.0), repeat=len(scheduled) * (len(scheduled) < _FEW)))
    count = max(len(grid), _FIRST_CORNERS)
    corners = np.random.default_rng(seed).choice([-1.0, 1.0], (count, len(ends)))
    if len(grid) > 1:
        corners[:, scheduled] = np.resize(grid, (count, len(scheduled)))
    return np.unique(corners * ends, axis=0)


def screened(ends: Array, seed: int) -> Array:
    """Corners of a part of the box, all or some, random points, and some of its faces."""
    p, random = len(ends), np.random.default_rng(seed)
    if 2**p <= _CORNERS:
        corners = np.array(list(product((-1.0, 1.0), repeat=p)))
    else:
        corners = random.choice([-1.0, 1.0], (_CORNERS, p))
    inside = random.uniform(-1.0, 1.0, (_RANDOM, p))
    return np.unique(
        np.vstack([corners, inside, np.where(random.random(inside.shape) < 0.5, inside, np.sign(inside))])
        * ends,
        axis=0,
    )
