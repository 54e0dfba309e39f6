"""Controllers that are LFTs as structures with free values: smaller ones, and ones of another structure.

The matrix M of a controller, (xdot, z, y) = M (x, w, u) with w = Delta z, is reduced in the closed loop.
With v = (x, w, u), q = M v, the responses v/u_goal and y_goal/q of the loop with the controller give the
Gramians of states and of channels,

    P = sum of (x/u_goal)(x/u_goal)*,      Q = sum of (y_goal/xdot)*(y_goal/xdot)

over points and frequencies, and the same of z and w. States, and the channels of each parameter, are
balanced with them, and those that matter least to the goals are left out (weights of the closed loop:
Enns, CDC 1984; balanced LFTs: Beck, Doyle, Glover, IEEE Transactions on Automatic Control 41, 1996).
Nothing is proved of what is left out: the reduced controller is a start, and `tune` tells what its loop
reaches.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from scipy import linalg

from mbdlft.base.arguments import arguments_checked
from mbdlft.base.array import Array
from mbdlft.base.errors import AnalysisError, StructureError, check_known
from mbdlft.base.unit import Signal
from mbdlft.lft.lft import LFT, Block, check_plain, consecutive
from mbdlft.lft.sampling import evaluate_at
from mbdlft.synthesis.goals import HINF, MARGIN, Goal
from mbdlft.synthesis.loop import Connections, Network, family, network, screened, sizes_of, weighted
from mbdlft.synthesis.pieces import FreeValue, TunableSystem
from mbdlft.system.model import Parameters, System

_SMALL = 0.1  # of what row and column have: the least scale of an entry
_FREQUENCIES, _BESIDE = 60, 10.0  # how many, from the slowest pole over this to the fastest times this
_NOTHING = 1e-12  # of the largest: what is balanced is not there


def system_of(
    name: str,
    M: Array,
    states: int,
    sizes: Sequence[int],
    parameters: Parameters,
    ends: tuple[Sequence[str], Sequence[str]],
) -> System:
    """A system of its matrix and the names of its inputs and outputs."""
    z = np.arange(states, states + sum(sizes))
    i, j = (np.delete(np.arange(size), z) for size in M.shape)
    blocks = tuple(map(Block, parameters.names, sizes))
    lft = LFT(M[np.ix_(z, z)], M[np.ix_(z, j)], M[np.ix_(i, z)], M[np.ix_(i, j)], blocks)
    names = [f"{name}.x{k + 1}" for k in range(states)], *ends
    x, u, y = (tuple(Signal(each, "1") for each in side) for side in names)
    return System(name, lft, x, u, y, parameters)


@arguments_checked
def tunable_system(controller: System) -> TunableSystem:
    """A controller with all entries of its matrices free, its order and repetitions kept.

    Parameters
    ----------
    controller : System
        Whose parameters are measured.

    Returns
    -------
    TunableSystem
        With the values ``M[row,column]`` of (xdot, z, y) = M (x, w, u), w = Delta z, which begin at those
        of the controller.
    """
    a, n, r = controller.lft, len(controller.states), controller.order
    check_plain(a, f"tunable_system: {controller.name!r}")
    nu, ny = len(controller.inputs), len(controller.outputs)
    M = np.block(
        [
            [a.M22[:n, :n], a.M21[:n], a.M22[:n, n:]],
            [a.M12[:, :n], a.M11, a.M12[:, n:]],
            [a.M22[n:, :n], a.M21[n:], a.M22[n:, n:]],
        ]
    )
    # (xdot, y, v) of (x, u, q): the frame has integrators and Delta
    (nq, nv), q, v = M.shape, n + nu, n + ny
    frame = np.zeros((v + nv, q + nq))
    frame[:n, q : q + n] = frame[v : v + n, :n] = np.eye(n)
    frame[n:v, q + n + r :], frame[v + n + r :, n:q] = np.eye(ny), np.eye(nu)
    into, out = np.eye(q + nq)[q + n : q + n + r], np.eye(v + nv)[:, v + n : v + n + r]
    more = [tuple(Signal(f"{s}.{k + 1}", "1") for k in range(size)) for s, size in (("q", nq), ("v", nv))]
    inner = System(
        controller.name,
        LFT(np.zeros((r, r)), into, out, frame, a.blocks),
        controller.states,
        (*controller.inputs, *more[0]),
        (*controller.outputs, *more[1]),
        controller.parameters,
    )
    sizes = np.sqrt(np.outer(*(np.max(np.abs(M), axis=axis, initial=0.0) for axis in (1, 0))))
    free = tuple(
        FreeValue(f"{controller.name}.M[{i + 1},{j + 1}]", float(M[i, j]), -np.inf, np.inf, scale or 1.0)
        for (i, j), scale in np.ndenumerate(np.maximum(np.abs(M), _SMALL * sizes))
    )
    moves = np.eye(nq * nv).reshape(nq * nv, nq, nv)
    return TunableSystem(controller.name, inner, np.zeros((nq, nv)), moves, free)


@arguments_checked
def reduced_structure(
    systems: Sequence[Any],
    goals: Sequence[Goal],
    connections: Connections,
    *,
    states: int,
    repetitions: int | Mapping[str, int] | None = None,
    inputs: Sequence[str] = (),
    leave_out: Sequence[str] = (),
) -> TunableSystem:
    """The controller of `tunable_system` or `lpv_synthesis` with fewer states and repetitions.

    Parameters
    ----------
    systems, goals, connections, inputs, leave_out
        As for `tune`, with this controller as the one that has free values: they are at their initial
        values. Goals of H-infinity norms and margins say what matters.
    states : int, that stay
    repetitions : int, or mapping of names of parameters to int, optional
        That stay of each parameter; all by default.

    Raises
    ------
    StructureError
        There is not one such controller, or a number or a name is wrong.
    AnalysisError
        The loop is not stable at a point of the box.
    """
    free = [s for s in systems if isinstance(s, TunableSystem)]
    if len(free) != 1 or free[0].free[0].name != f"{free[0].name}.M[1,1]" or states < 0:
        raise StructureError(
            "reduced_structure: expected one controller with free values, of tunable_system or "
            f"lpv_synthesis, and states from 0, got {[s.name for s in free]} and {states!r}."
        )
    old, blocks = free[0], free[0].frame.lft.blocks
    fewer = {b.name: repetitions if isinstance(repetitions, int) else b.size for b in blocks}
    if isinstance(repetitions, Mapping):
        check_known("parameter", repetitions, fewer, "reduced_structure", StructureError)
        fewer.update(repetitions)
    net = network(systems, connections, [g for g in goals if g.kind in (HINF, MARGIN)], inputs, leave_out)
    M = net.matrix(np.array([value.initial for value in net.free]))
    parts = [len(old.frame.states), *(block.size for block in blocks)]
    P, Q = _gramians(net, goals, M, parts[0], sum(parts))
    into, out = list[Array](), list[Array]()
    for own, count in zip(consecutive(parts), (parts[0], *fewer.values()), strict=True):
        left, right = (_root(gramian[own, own]) for gramian in (Q, P))
        U, sigma, V = np.linalg.svd(left.T @ right)
        sigma = sigma[sigma > _NOTHING * np.max(sigma, initial=0.0)][:count]
        into.append((right @ V[: len(sigma)].T) / np.sqrt(sigma))
        out.append(((left @ U[:, : len(sigma)]) / np.sqrt(sigma)).T)
    nu, ny = (len(side) for side in old.channels)
    small = linalg.block_diag(*out, np.eye(ny)) @ M @ linalg.block_diag(*into, np.eye(nu))
    stay = [min(states, len(out[0])), *(len(matrix) for matrix in out[1:])]
    # states that go are at rest (Liu, Anderson, International Journal of Control 50, 1989)
    rest = np.s_[stay[0] : len(out[0])]
    held = np.linalg.solve(small[rest, rest], np.delete(small[rest], rest, axis=1))
    small = np.delete(np.delete(small, rest, axis=1) - small[:, rest] @ held, rest, axis=0)
    return tunable_system(
        system_of(old.name, small, stay[0], stay[1:], old.frame.parameters, old.channels)
    )


def _gramians(
    net: Network, goals: Sequence[Goal], M: Array, states: int, inner: int
) -> tuple[Array, Array]:
    """P and Q of the states and channels of the controller, over points and frequencies."""
    of_loop = [goal for goal in goals if goal.kind in (HINF, MARGIN)]
    whole = weighted(net, of_loop)
    loops = family(net, whole, screened(np.ones(len(whole.parameters)), 0))
    closed = loops.closed(np.array([value.initial for value in net.free]))
    poles = np.zeros(1) if closed is None else np.linalg.eigvals(closed.A)
    if closed is None or np.max(poles.real, initial=-1.0) >= 0.0:
        raise AnalysisError(
            "reduced_structure: the loop is not stable in the whole box: there are no responses. Hold "
            "parameters that the controller does not measure at nominal, or take smaller ranges."
        )
    limits = np.concatenate([np.full(sizes_of(goal)[1], 1.0 / goal.limit) for goal in of_loop])
    n, ends = loops.states, np.abs(poles[np.abs(poles) > 0.0])
    P, Q = np.zeros((inner, inner)), np.zeros((inner, inner))
    for w in np.geomspace(np.min(ends) / _BESIDE, np.max(ends) * _BESIDE, _FREQUENCIES):
        s, (A, B, C, _, L, R, _) = 1j * w * np.eye(n), closed
        v = R[..., :n] @ np.linalg.solve(s - A, B) + R[..., n:]
        y = limits[:, None] * (C @ np.linalg.solve(s - A, L[:, :n]) + L[:, n:])
        reached, seen = v[:, :inner].copy(), y @ M[:, :inner]
        reached[:, states:], seen[..., :states] = (M @ v)[:, states:inner], y[..., :states]
        P += np.einsum("mij,mkj->ik", reached, reached.conj()).real
        Q += np.einsum("mji,mjk->ik", seen.conj(), seen).real
    return P, Q


def _root(gramian: Array) -> Array:
    values, vectors = np.linalg.eigh(gramian)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))


@arguments_checked
def fitted_values(structure: TunableSystem, controller: System) -> dict[str, float]:
    """Values with which a structure is near a controller with the same states, over the box.

    [A B ; C D] of both are compared at points of the box, by the sizes of rows and columns.

    Parameters
    ----------
    structure : TunableSystem
        Such as `scheduled` makes it, of as many states: gains that are polynomials in the parameters.
    controller : System
        With the same channels, and parameters that are those of the structure.

    Returns
    -------
    dict of names of values to numbers, as `initial` of `tune`
    """
    (nu, ny), n = (len(side) for side in structure.channels), len(structure.frame.states)
    same = (nu, ny, n, structure.frame.parameters.names)
    has = (
        len(controller.inputs),
        len(controller.outputs),
        len(controller.states),
        controller.parameters.names,
    )
    points = screened(np.ones(len(same[3])), 0)
    frame = evaluate_at(structure.frame.lft, points)
    rows, columns = n + ny, n + nu
    if same != has or np.any(frame[:, rows:, columns:]):
        raise StructureError(
            f"fitted_values: {structure.name!r} has inputs, outputs, states and parameters {same}, the "
            f"controller {has}; expected the same, and no products of values."
        )
    target = evaluate_at(controller.lft, points)
    L, R = frame[:, :rows, columns:], frame[:, rows:, :columns]
    moves = np.einsum("miq,kqv,mvj->kmij", L, structure.moves, R)
    missing = target - frame[:, :rows, :columns] - L @ structure.base @ R
    size = np.sqrt(np.mean(target**2, axis=0))
    scale = np.sqrt(np.outer(np.max(size, axis=1), np.max(size, axis=0))) + _NOTHING * np.max(size)
    x = np.linalg.lstsq((moves / scale).reshape(len(moves), -1).T, (missing / scale).ravel(), rcond=None)[
        0
    ]
    return {value.name: float(number) for value, number in zip(structure.free, x, strict=True)}
