"""What no controller can pass, and what a scheduled one reaches: two matrix inequalities.

A controller closes [xdot ; z ; y ; v] = M [x ; w ; u ; q], w = Delta z, with |delta_k| <= 1: measured
parameters that move in any way. Where it sees nothing, v = 0, some x'S x, D and G have to give

    2 x'S xdot + z'D z - w'D w + 2 z'G w + |y|^2/gamma - gamma |u|^2 < 0,      S, D > 0,  G = -G',

D and G commuting with Delta (D-G scalings of real parameters: Fan, Tits, Doyle, IEEE Transactions on
Automatic Control 36, 1991). Where it moves nothing, R and other D and G do the same for M'. With

    [ R I ; I S ] >= 0

these are sufficient for a controller that is an LFT in the same Delta, with as many repetitions and
states, and an energy gain below gamma (Packard, Systems and Control Letters 22, 1994; Apkarian, Gahinet,
IEEE Transactions on Automatic Control 40, 1995; of real parameters: Scorletti, El Ghaoui, International
Journal of Robust and Nonlinear Control 8, 1998). D and G of both sides are not coupled, as a' (D - G) b
with a = z + w, b = z - w is what they say: any two D - G are parts of one that is larger, and of its
inverse (`mbdlft.synthesis.lpv`).

Without Delta they are necessary, too (Gahinet, Apkarian, International Journal of Robust and Nonlinear
Control 4, 1994): the dual value of the least gamma is below that of every controller with the same
measurements, also of a fixed structure.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy import linalg, sparse

from mbdlft.base.array import Array
from mbdlft.lft.lft import consecutive
from mbdlft.lft.sampling import evaluate_at
from mbdlft.response.modes import balancing
from mbdlft.robust.moving.variation import conic_solution, vectors
from mbdlft.synthesis.goals import Goal
from mbdlft.synthesis.loop import Network, sizes_of, weighted

_SURE = 0.99  # of the dual value, which a solver knows to some digits: it is computed, not proved
_NOTHING = 1e-6  # a solver does not tell smaller values from zero, which is a bound, too
_SOLVED = ("Solved", "AlmostSolved")  # a value of any other status may be far above
_MISSED = 1e-2  # of the dual value; the unknowns at the least gamma may be larger than those found
_MOST_SKEW = 10.0  # of D: with larger G, plant and controller are hard to put together
_CLOSE = 1.0 - 1e-3  # of the least gamma: a bound that is as near is not looked for in another unit
_FAR = 4.0  # of gamma from its unit: further, the program is solved in another one
MOST_STATES = 30  # beyond it the program takes minutes


class Opened(NamedTuple):
    """M of a plant that a controller is to close, as above."""

    M: Array
    states: int
    sizes: tuple[int, ...]  # of the blocks of Delta
    nq: int
    nv: int

    @property
    def rows(self) -> list[slice]:
        """Those of xdot, z, y, v."""
        n, r = self.states, sum(self.sizes)
        return consecutive((n, r, len(self.M) - n - r - self.nv, self.nv))

    @property
    def transposed(self) -> "Opened":
        """That of M'."""
        return Opened(self.M.T, self.states, self.sizes, self.nv, self.nq)


def opened_plant(
    net: Network, goals: Sequence[Goal], measured: Sequence[str] = (), point: Array | None = None
) -> Opened:
    """The plant with the weighted channels of goals over their limits, each channel once.

    Parameters that are not measured are nominal, or all are at a point (number of parameters,) of deltas.
    """
    P, (nq, nv) = weighted(net, goals), net.base.shape
    a, n = P.lft, len(P.states)
    limits = [np.full(sizes_of(goal)[1], 1.0 / goal.limit) for goal in goals]
    scale = np.concatenate([np.ones(n), *limits, np.ones(nv)])[:, None]
    value = a.M22 if point is None else evaluate_at(a, point[None])[0]
    channels = [i for name in sorted(measured) for i in range(a.order)[a.slices()[name]]]
    inner = a.M11[np.ix_(channels, channels)]
    M = np.block([[scale * value, scale * a.M21[:, channels]], [a.M12[channels], inner]])
    (m, k), r = value.shape, len(channels)
    rows = [*range(n), *range(m, m + r), *_once(M, n, m - nv), *range(m - nv, m)]
    columns = [*range(n), *range(k, k + r), *_once(M.T, n, k - nq), *range(k - nq, k)]
    sizes = tuple(block.size for block in a.blocks if block.name in measured)
    return Opened(M[np.ix_(rows, columns)], n, sizes, nq, nv)


def _once(M: Array, first: int, end: int) -> list[int]:
    """Rows from the first to the end, but for those that are equal to an earlier one."""
    return sorted(first + np.unique(M[first:end], axis=0, return_index=True)[1])


def balanced(plant: Opened) -> tuple[Opened, Array, float]:
    """The plant in other units of states, channels and time: turn, and the rate of time."""
    M, k = plant.M.copy(), plant.states + sum(plant.sizes)
    size = np.linalg.norm(M[: plant.states], axis=1)
    rate = float(np.exp(np.mean(np.log(size[size > 0.0])))) if np.any(size) else 1.0
    M[: plant.states] /= rate
    sizes = np.zeros((k + 2, k + 2))  # y and u are one channel, as q and v
    sizes[:k, :k] = np.abs(M[:k, :k])
    for i, (row, column) in enumerate(zip(plant.rows[2:], plant.transposed.rows[2:], strict=True)):
        sizes[k + i, :k] = np.linalg.norm(M[row, :k], axis=0)
        sizes[:k, k + i] = np.linalg.norm(M[:k, column], axis=1)
    scale = balancing(sizes)
    M[:, :k] *= scale[:k] / scale[k]
    M[:k] /= (scale[:k] / scale[k])[:, None]
    return plant._replace(M=M), np.diag(scale[:k] / scale[k]), rate


class Side(NamedTuple):
    """S, D and G of one side."""

    S: Array
    D: Array
    G: Array


def sides_of(plant: Opened, x: Array) -> tuple[Side, Side]:
    """Both sides from unknowns: entries of S, D and G, in columns of upper triangles."""
    n, mask = plant.states, linalg.block_diag(*(np.ones((size, size)) for size in (0, *plant.sizes)))
    places = [np.nonzero(np.triu(ones, k)) for ones, k in ((np.ones((n, n)), 0), (mask, 0), (mask, 1))]
    parts = np.split(x, np.cumsum(2 * [len(rows) for rows, _ in places]))
    made = []
    for k, (rows, columns) in enumerate(2 * places):
        M = np.zeros((n, n) if k % 3 == 0 else mask.shape)
        M[columns, rows] = -parts[k] if k % 3 == 2 else parts[k]
        M[rows, columns] = parts[k]
        made.append(M)
    return Side(*made[:3]), Side(*made[3:])


def _blind(plant: Opened) -> list[list[Array]]:
    """(x, w, u) and (xdot, z, y) where the controller sees nothing."""
    rows, columns = plant.rows, plant.transposed.rows
    inside = linalg.null_space(plant.M[rows[3], : columns[3].start])
    given = plant.M[:, : columns[3].start] @ inside
    return [[inside[part] for part in columns[:3]], [given[part] for part in rows[:3]]]


def _negative(
    plant: Opened, blind: list[list[list[Array]]], x: Array, coupled: float, fixed: float = 1.0
) -> list[Array]:
    """Matrices that have to be negative, with `coupled` in the place of I; the last of x is gamma.

    What has none of the unknowns is multiplied by `fixed`.
    """
    found, (n, r) = list[Array](), (plant.states, sum(plant.sizes))
    sides = sides_of(plant, x)
    for (S, D, G), ((state, w, u), (rate, z, y)) in zip(sides, blind, strict=True):
        half = state.T @ S @ rate + z.T @ (0.5 * D @ z + G @ w)
        half -= 0.5 * (w.T @ D @ w + x[-1] * u.T @ u)
        found.append(np.block([[half + half.T, fixed * y.T], [fixed * y, -x[-1] * np.eye(len(y))]]))
        found.append(-np.block([[D, G / _MOST_SKEW], [-G / _MOST_SKEW, D]]).reshape(2 * r, 2 * r))
    eye = fixed * coupled * np.eye(n)
    return [*found, -np.block([[sides[1].S, eye], [eye, sides[0].S]])]


class Program(NamedTuple):
    """b - rows x in cones: the matrices are negative; `trace` times x is that of S, R and both D."""

    rows: Any
    b: Array
    cones: list[Any]
    trace: Array
    identity: Array  # in the place of all matrices but the last


def program(plant: Opened, coupled: float = 1.0) -> Program:
    """The matrix inequalities."""
    import clarabel  # here because it is slow to import

    def at(x: Array, fixed: float) -> Array:
        return np.concatenate([vectors(M[None])[0] for M in _negative(plant, blind, x, coupled, fixed)])

    blind = [_blind(plant), _blind(plant.transposed)]
    pairs = [size * size for size in plant.sizes]
    units = np.eye(plant.states * (plant.states + 1) + 2 * sum(pairs) + 1)
    sizes = [len(M) for M in _negative(plant, blind, units[-1], coupled)]
    trace = [sum(np.trace(side.S) + np.trace(side.D) for side in sides_of(plant, x)) for x in units[:-1]]
    identity = [vectors(float(k < 4) * np.eye(size)[None])[0] for k, size in enumerate(sizes)]
    return Program(
        sparse.csc_matrix(np.column_stack([at(x, 0.0) for x in units])),
        -at(0.0 * units[0], 1.0),
        [clarabel.PSDTriangleConeT(size) for size in sizes if size],
        np.array(trace),
        np.concatenate(identity),
    )


class Least(NamedTuple):
    """The least gamma, and what its program cannot pass."""

    plant: Opened  # whose y and u are over the root of `unit`
    unit: float
    gamma: float
    bound: float  # 0 if not known


def least_gamma(plant: Opened, enough: float = np.inf) -> Least:
    """Solved again in another unit, where gamma is far from 1 and the bound below `enough` of it."""
    unit, least = 1.0, Least(plant, 1.0, 0.0, 0.0)
    for _ in range(2):
        M = plant.M.copy()
        M[plant.rows[2]] /= np.sqrt(unit)
        M[:, plant.transposed.rows[2]] /= np.sqrt(unit)
        within = plant._replace(M=M)
        problem = program(within)
        cost = np.zeros(problem.rows.shape[1])
        cost[-1] = 1.0
        solution = conic_solution(cost, problem.rows, problem.b, problem.cones)
        gamma, bound = float(solution.x[-1]) * unit, least.bound
        if str(solution.status) in _SOLVED:  # not where R or S has to grow without end
            # what misses the dual equations counts with the unknowns, as R and S may be large
            missed = np.abs(problem.rows.T @ np.array(solution.z) + cost) @ np.abs(np.array(solution.x))
            dual = float(solution.obj_val_dual)
            bound = max(least.bound, (dual - float(missed)) * unit if missed < _MISSED * dual else 0.0)
        least = Least(within, unit, gamma, bound if np.isfinite(bound) and bound > _NOTHING else 0.0)
        is_near = 1.0 / _FAR < gamma / unit < _FAR or bound > enough * gamma
        if is_near or not _NOTHING < gamma < 1.0 / _NOTHING:
            break
        unit = gamma
    return least


def full_order_bound(opened: Network, goals: Sequence[Goal], point: Array | None = None) -> float:
    """A lower bound of the value of norms together at a point, or at nominal; 0 for many states.

    In `opened`, controllers are matrices from all measurements to all actuators. The norms are those of
    all channels of the goals at once, over their limits.
    """
    plant = opened_plant(opened, goals, point=point)
    with np.errstate(over="ignore"):
        has_size = np.isfinite(np.linalg.norm(plant.M))
    if plant.states > MOST_STATES or not has_size:
        return 0.0
    return _SURE * max(_at_once(plant), least_gamma(balanced(plant)[0], _CLOSE).bound)


def _at_once(plant: Opened) -> float:
    """The gain of what no controller changes at once: where none moves y, and where none sees u."""
    (y, v), (u, q) = plant.rows[2:], plant.transposed.rows[2:]
    sides = ((plant.M[y, u].T, plant.M[y, q].T), (plant.M[y, u], plant.M[v, u]))
    gains = (np.linalg.norm(direct @ _kernel(own), 2) for direct, own in sides if direct.size)
    return max(map(float, gains), default=0.0)


def _kernel(matrix: Array) -> Array:
    """What is zero times a matrix, each row of which is in its own unit."""
    sizes = np.linalg.norm(matrix, axis=1)
    return np.asarray(linalg.null_space(matrix[sizes > 0.0] / sizes[sizes > 0.0, None]))
