"""Gain-scheduled controllers by matrix inequalities: LFTs in the measured parameters, of full order.

With S, R, D_1, G_1 and D_2, G_2 of both sides (`mbdlft.synthesis.bound`), H = D_1 - G_1 and
K = D_2 - G_2, what holds for the closed loop is

    [ S  T ; T' I ],  T T' = S - R^-1,          of the states of plant and controller,
    [ H  I ; W (H - K^-1)  W ],  W = (H' + K^-1)^-1,       of the channels of both.

The first one is symmetric and positive, and R is in its inverse. The second one has a positive symmetric
part for any H and K whose symmetric parts are, and K is in its inverse: it is D - G of the copies of each
parameter in plant and controller. The matrix of the controller is the Theta for which

    Psi + U Theta V + V'Theta'U' < 0

has the largest margin, in states in which X is I: then it is one of decay, and the gains stay small. (The
formula of Iwasaki, Skelton, Automatica 30, 1994, has entries of 5e8 for a structure with six modes, where
this program has 15.) No status of a solver is believed: the eigenvalues of this inequality are looked at,
and the gain of the closed loop is proved in balls, for all motions of the parameters.
"""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from scipy import linalg, sparse

from mbdlft.base.arguments import arguments_checked
from mbdlft.base.array import Array
from mbdlft.base.errors import AnalysisError, StructureError, check_known
from mbdlft.base.running import one_thread
from mbdlft.exact.rounding import EPS
from mbdlft.lft.lft import LFT, consecutive
from mbdlft.robust.evidence import Bounds, MotionProof
from mbdlft.robust.gain import worst_case_gain
from mbdlft.robust.moving.variation import conic_solution, vectors
from mbdlft.robust.proofs import verify
from mbdlft.synthesis.bound import (
    MOST_STATES,
    Opened,
    Side,
    balanced,
    least_gamma,
    opened_plant,
    program,
    sides_of,
)
from mbdlft.synthesis.goals import HINF, MARGIN, Goal
from mbdlft.synthesis.loop import Connections, network
from mbdlft.synthesis.pieces import TunableSystem
from mbdlft.synthesis.reached import Tuning, as_matrices, as_tuning, least_values
from mbdlft.synthesis.structure import fitted_values, reduced_structure, system_of, tunable_system
from mbdlft.system.model import Parameters, System

_SMALLEST = 1e-6  # gamma of plants whose goals can be made zero
_SINGULAR = 1e12  # condition of the loop of a controller and the direct path of the plant
_QUICK, _SLACK = 16, 0.03  # states of a plant whose controller takes a second; part above the least
_TRACES = (1.1, 10.0, 100.0, 1000.0)  # of the least trace: room for solutions to go away from the edge


@dataclass(frozen=True, slots=True, eq=False)
class ScheduledSynthesis:
    """A controller that is an LFT in measured parameters, and what is known of its loop.

    Attributes
    ----------
    structure : TunableSystem
        The controller with each entry free, for `tune` and `reduced_structure`, which begin at it; the
        controller is `tuning.controllers[0]`. It has as many states and repetitions as plant and weights.
    gamma : float
        For which its matrix inequality holds: the energy gain of all goals together, over their limits,
        while the measured parameters move in any way, and others are nominal.
    least : float
        No scalings of this kind give a smaller gamma; 0.0 if not known. Without measured parameters it is
        the least H-infinity norm. It is no bound of controllers for constant parameters.
    loop : System
        From the channels of all goals to those of all.
    motion : Bounds
        Its gain: `upper` is proved for any motion, `lower` is reached by constant values.
        `verify(loop, motion)` checks the proof.
    tuning : Tuning
        The goals one by one, for constant values of all parameters, as of `tune`.
    """

    structure: TunableSystem
    gamma: float
    least: float
    loop: System
    motion: Bounds
    tuning: Tuning


@arguments_checked
def lpv_synthesis(
    systems: Sequence[Any],
    goals: Sequence[Goal],
    connections: Connections,
    *,
    inputs: Sequence[str] = (),
    leave_out: Sequence[str] = (),
    measured: Sequence[str] | None = None,
    slack: float = _SLACK,
    prove: bool = True,
    gap: float = 0.01,
    work: float = 30.0,
) -> ScheduledSynthesis:
    """A controller of full order that is scheduled by measured parameters, for gains of the loop.

    Goals count together: the gain from the inputs of all to the outputs of all, each over its limit, is
    made small. A channel that several goals have counts once.

    Parameters
    ----------
    systems, goals, connections, inputs, leave_out, prove, gap, work
        As for `tune`, with goals of H-infinity norms and margins. One of the systems is a controller with
        free values: its name and channels are taken, and not its structure.
    measured : sequence of str, optional
        Parameters that the controller knows at each moment; those of the role ``scheduled`` by default.
        Others are nominal in the synthesis; `tuning` and `structure` have them.
    slack : float
        Part by which gamma may be above the least one: near that, gains and poles of controllers grow.

    Raises
    ------
    StructureError
        There is not one controller with free values, a name is unknown, a goal is no gain, the slack is
        not between 0 and 1, there are design parameters or too many states.
    AnalysisError
        No controller was found: the message says what failed.
    """
    free = [s for s in systems if isinstance(s, TunableSystem)]
    other = next((goal for goal in goals if goal.kind not in (HINF, MARGIN)), None)
    if len(free) != 1 or other or not 0.0 < slack < 1.0:
        wrong = f"{len(free)} controllers, slack {slack!r}" + (f", goal {other.name!r}" if other else "")
        raise StructureError(
            "lpv_synthesis: expected one controller with free values, such as tunable_gain, whose "
            f"channels are taken, goals of the kinds {HINF} and {MARGIN}, and a slack between 0 and 1, "
            f"got {wrong}."
        )
    connected = partial(network, connections=connections, goals=goals, more=inputs, leave_out=leave_out)
    net = connected(as_matrices(systems))
    known = net.system.parameters
    names = [p.name for p in known if p.role == "scheduled"] if measured is None else list(measured)
    check_known("parameter", names, known.names, "lpv_synthesis: measured", StructureError)
    plant = opened_plant(net, goals, names)
    if plant.states > MOST_STATES or net.design:
        raise StructureError(
            f"lpv_synthesis: expected at most {MOST_STATES} states of plant and weights, got "
            f"{plant.states}, and no design parameters, got {', '.join(net.design) or 'none'}. Truncate "
            "the plant, take smaller weights; designed_scene gives design parameters values."
        )
    for side, M in zip(
        free[0].channels, (plant.M[plant.rows[3]], plant.M.T[plant.transposed.rows[3]]), strict=True
    ):
        if idle := [name for name, line in zip(side, M, strict=True) if not np.any(line)]:
            raise StructureError(
                f"lpv_synthesis: {', '.join(idle)} of {free[0].name!r}: the plant is not connected."
            )
    parameters = Parameters([p for p in known if p.name in names])
    with one_thread():
        made = _synthesized(plant, slack)
        controller = system_of(
            free[0].name, made.controller, plant.states, plant.sizes, parameters, free[0].channels
        )
        structure = tunable_system(controller)
        closed = connected([structure if s is free[0] else s for s in systems])
        x, nominal = np.array([v.initial for v in structure.free]), np.zeros((1, len(known)))
        least = least_values(net, goals, lambda: net)
        how = {"gap": gap, "work": work}
        tuning = as_tuning(closed, goals, x, nominal, least, how if prove else None)
    loop, motion = _moving(f"{net.system.name}: moving", plant, made, parameters, how)
    return ScheduledSynthesis(structure, made.gamma, made.least, loop, motion, tuning)


def reduced_values(
    systems: Sequence[Any],
    goals: Sequence[Goal],
    connections: Connections,
    inputs: Sequence[str],
    leave_out: Sequence[str],
) -> dict[str, float]:
    """Values of a state-space controller that are near those of full order, reduced to its states.

    They are for goals of gains at nominal. There are none where that is not possible, or takes long.
    """
    free = [s for s in systems if isinstance(s, TunableSystem)]
    of_gain = [goal for goal in goals if goal.kind in (HINF, MARGIN)]
    if len(free) != 1 or not free[0].states or not of_gain:
        return {}
    nominal, old = [_at_nominal(s) if isinstance(s, System) else s for s in systems], free[0]
    with suppress(AnalysisError, StructureError):
        net = network(as_matrices(nominal), connections, of_gain, inputs, leave_out)
        plant = opened_plant(net, of_gain, [])
        if plant.states <= _QUICK:
            made = _synthesized(plant, _SLACK).controller
            controller = system_of(old.name, made, plant.states, [], Parameters(()), old.channels)
            own = [tunable_system(controller) if s is old else s for s in nominal]
            kept = {"states": old.states, "inputs": inputs, "leave_out": leave_out}
            small = reduced_structure(own, of_gain, connections, **kept)  # type: ignore[arg-type]
            return fitted_values(old, small.with_values({}))
    return {}


def _at_nominal(system: System) -> System:
    """Without its parameters: their deltas are zero."""
    M = system.lft.M22
    sides = np.zeros((0, 0)), np.zeros((0, M.shape[1])), np.zeros((M.shape[0], 0))
    signals = system.states, system.inputs, system.outputs
    return System(system.name, LFT(*sides, M, ()), *signals, Parameters(()))


class _Made(NamedTuple):
    """The matrix of a controller, and what proves its loop with the plant."""

    theta: Array  # (xdot, z, q) of (x, w, v - D q), D that of the plant
    controller: Array  # of (x, w, v)
    gamma: float
    least: float
    P: Array  # of `states` times the states of the loop
    X: Array  # and Y: of the channels of the plant, then of the controller
    Y: Array
    states: Array


def _synthesized(plant: Opened, slack: float) -> _Made:
    turned, turn, rate = balanced(plant)
    found = least_gamma(turned)
    level, coupled = max(found.gamma / found.unit, _SMALLEST) * (1.0 + slack), 1.0 + 0.5 * slack
    n, r, turned = plant.states, sum(plant.sizes), found.plant
    try:
        turned, more = _evened(turned, *_centered(turned, level, coupled))
        sides = _centered(turned, level, coupled)
        X, D, G = _extended(*sides)
        theta = _closing(turned, level, X, D, G, sides[1].S)
    except (np.linalg.LinAlgError, ValueError) as error:
        raise _failure(f"the programs came to no end ({error})") from None
    theta[:n] *= rate
    path = np.zeros(theta.T.shape)
    path[n + r :, n + r :] = plant.M[plant.rows[3], plant.transposed.rows[3]]
    loop = np.eye(len(theta)) + theta @ path
    if np.linalg.cond(loop) > _SINGULAR:
        raise _failure("the direct path from its outputs to its inputs makes the loop singular")
    gamma, back = level * found.unit, np.linalg.inv(turn @ more)
    states, channels = (linalg.block_diag(M, np.eye(len(M))) for M in (back[:n, :n], back[n:, n:]))
    D, G = (gamma * channels.T @ M @ channels for M in (D, G))
    P, theta_of_v = _symmetric(gamma / rate * X), np.asarray(np.linalg.solve(loop, theta))
    return _Made(theta, theta_of_v, gamma, found.bound, P, _symmetric(D), G - _symmetric(G), states)


def _moving(
    name: str, plant: Opened, made: _Made, parameters: Parameters, how: Mapping[str, Any]
) -> tuple[System, Bounds]:
    """The loop from the inputs of all goals to the outputs of all, over their limits, and its gain.

    The proof is that of the synthesis, if balls agree.
    """
    M, left, right = _with_own(plant)
    closed, n = M + left @ made.theta @ right, 2 * plant.states
    # channels of each parameter, those of plant and controller, follow each other
    order = np.argsort(np.tile(np.repeat(np.arange(len(plant.sizes)), plant.sizes), 2), kind="stable")
    rows, columns = ([*range(n), *(n + order), *range(n + len(order), k)] for k in closed.shape)
    ends = [
        [f"{letter}.{k + 1}" for k in range(size - n - len(order))]
        for letter, size in zip("zw", closed.shape, strict=True)
    ]
    sizes = [2 * size for size in plant.sizes]
    loop = system_of(name, closed[np.ix_(rows, columns)], n, sizes, parameters, (ends[1], ends[0]))
    constant = worst_case_gain(loop, **how)
    if not len(order):
        return loop, constant
    X, Y = (matrix[np.ix_(order, order)] for matrix in (made.X, made.Y))
    proof = MotionProof(made.P, X, Y, made.states, np.ones(len(order)), 1.0)
    rates = dict.fromkeys(parameters.names, np.inf)
    bounds = replace(constant, upper=made.gamma, rates=rates, proof=proof, reason="")
    wrong = verify(loop, bounds)
    return loop, replace(bounds, upper=np.inf, proof=None, reason=wrong) if wrong else bounds


def _centered(plant: Opened, gamma: float, coupled: float) -> tuple[Side, Side]:
    """S and R with their D and G, small, and far from where the inequalities cease to hold."""
    import clarabel  # here because it is slow to import

    problem = program(plant, coupled)
    rows, b = problem.rows[:, :-1], problem.b - gamma * problem.rows[:, -1].toarray()[:, 0]
    smallest = conic_solution(problem.trace, rows, b, problem.cones)
    margin = sparse.csc_matrix(np.append(problem.identity, 0.0)[:, None])
    rows = sparse.hstack([sparse.vstack([rows, sparse.csc_matrix(problem.trace[None])]), margin])
    cost, cones = -np.eye(rows.shape[1])[-1], [*problem.cones, clarabel.NonnegativeConeT(1)]
    best = np.full(rows.shape[1], -np.inf)
    for room in _TRACES:  # the least trace is not found well where it is large
        most = room * (problem.trace @ np.array(smallest.x))
        x = np.array(conic_solution(cost, rows, np.append(b, most), cones).x)
        best = max(best, x, key=lambda x: x[-1])
        if best[-1] > 0.0:
            break
    return sides_of(plant, best[:-1])  # in other states more may be found


def _evened(plant: Opened, primal: Side, dual: Side) -> tuple[Opened, Array]:
    """The plant in states in which S and R are the same diagonal matrix, and channels where D are."""
    n, M, turn = plant.states, plant.M.copy(), np.eye(plant.states + sum(plant.sizes))
    both = [linalg.block_diag(side.S, side.D) for side in (primal, dual)]
    for own in consecutive((n, *plant.sizes)):
        left, right = (np.linalg.cholesky(matrix[own, own]) for matrix in both)
        U, sigma, V = np.linalg.svd(left.T @ right)
        turn[own, own] = (right @ V.T) / np.sqrt(sigma)
        M[:, own] = M[:, own] @ turn[own, own]
        M[own] = ((left @ U) / np.sqrt(sigma)).T @ M[own]
    return plant._replace(M=M), turn


def _extended(primal: Side, dual: Side) -> tuple[Array, Array, Array]:
    """X, D, G of plant and controller."""
    S, R, H, K = primal.S, dual.S, primal.D - primal.G, dual.D - dual.G
    values, vectors = np.linalg.eigh(_symmetric(S - np.linalg.inv(R)))
    T = vectors * np.sqrt(np.maximum(values, 0.0))
    X = np.block([[S, T], [T.T, np.eye(len(S))]])
    inverse = np.linalg.inv(K)
    W = np.linalg.inv(H.T + inverse)
    values, vectors = np.linalg.eigh(_symmetric(W))
    T = (vectors / np.sqrt(values)) @ vectors.T  # as W, it mixes nothing but one parameter
    whole = np.block([[H, T], [T.T @ W @ (H - inverse), T.T @ W @ T]])
    return X, _symmetric(whole), _symmetric(whole) - whole


def _with_own(plant: Opened) -> tuple[Array, Array, Array]:
    """M + left Theta right: (xdot, z, y) of plant and controller by (x, w, u), where D is 0."""
    n, r = plant.states, sum(plant.sizes)
    rows, columns = plant.rows, plant.transposed.rows
    own = [*range(n, 2 * n), *range(2 * n + r, 2 * (n + r))]  # rows and columns of the controller
    out, into = (np.delete(np.arange(side[3].start + n + r), own) for side in (rows, columns))
    M = np.zeros((len(out) + n + r, len(into) + n + r))
    left, right = np.zeros((len(M), n + r + plant.nq)), np.zeros((n + r + plant.nv, M.shape[1]))
    M[np.ix_(out, into)] = plant.M[: rows[3].start, : columns[3].start]
    left[own, range(n + r)] = right[range(n + r), own] = 1.0
    left[out, n + r :] = plant.M[: rows[3].start, columns[3]]
    right[n + r :, into] = plant.M[rows[3], : columns[3].start]
    return M, left, right


def _closing(plant: Opened, gamma: float, X: Array, D: Array, G: Array, R: Array) -> Array:
    """The matrix of the controller for which the inequality of the closed loop has the largest margin."""
    import clarabel  # here because it is slow to import

    M, left, right = _with_own(plant)
    x, w = len(X), len(D)
    ny, nu = (size - x - w for size in M.shape)
    height = w + ny
    last = linalg.block_diag(np.linalg.inv(D), gamma * np.eye(ny))
    supplied = linalg.block_diag(np.zeros((x, x)), D, gamma * np.eye(nu), last)

    def multiplied(closed: Array) -> Array:  # rows of xdot, z, y, as they enter the inequality
        above = linalg.block_diag(X, G.T, np.zeros((nu, 0))) @ closed[: x + w]
        return np.vstack([above, closed[x:]])

    def inequality(closed: Array) -> Array:
        whole = np.hstack([multiplied(closed), np.zeros((len(supplied), height))])
        return np.asarray(whole + whole.T - supplied)

    # states in which X is I, so that the margin is one of decay: X has R^-1 beside T T'
    n, root = x // 2, np.eye(len(supplied))
    root[:n, :n] = np.linalg.cholesky(R)
    root[n:x, :n] = -X[n:, :n] @ root[:n, :n]
    (U, acting, turn), (back, seen, V) = (
        np.linalg.svd(matrix, full_matrices=False)
        for matrix in (root.T @ multiplied(left), np.pad(right, ((0, 0), (0, height))) @ root)
    )
    # actuators may do the same, and sensors see the same
    k, m = (int(np.sum(sizes > len(root) * EPS * sizes[0])) for sizes in (acting, seen))
    U, V = U[:, :k], V[:m]
    each = np.einsum("ik,lj->klij", U, V).reshape(-1, *root.shape)
    rows = np.vstack([vectors(each + each.transpose(0, 2, 1)), vectors(np.eye(len(root))[None])])
    cost, b = np.zeros(len(rows)), -vectors((root.T @ inequality(M) @ root)[None])[0]
    cost[-1] = -1.0
    solution = conic_solution(cost, rows.T, b, [clarabel.PSDTriangleConeT(len(root))])
    theta = (
        (turn[:k].T / acting[:k]) @ np.array(solution.x[:-1]).reshape(k, m) @ (back[:, :m] / seen[:m]).T
    )
    closed = root.T @ inequality(M + left @ theta @ right) @ root
    of_states = root[:x, :x].T @ X @ root[:x, :x]
    largest = max(np.max(np.linalg.eigvalsh(A), initial=-np.inf) for A in (closed, -of_states, -D))
    if largest >= 0.0:
        raise _failure(
            "numbers of the solver do not satisfy the matrix inequality of the closed loop, whose "
            f"largest eigenvalue is {largest:.2g}"
        )
    return np.asarray(theta)


def _symmetric(matrix: Array) -> Array:
    return np.asarray(0.5 * (matrix + matrix.T))


def _failure(why: str) -> AnalysisError:
    return AnalysisError(
        f"lpv_synthesis: no controller was found: {why}. See that the controller moves and sees every "
        "mode on the right, in the whole range of the measured parameters; take a larger slack, a "
        "smaller range, or fewer measured parameters."
    )
