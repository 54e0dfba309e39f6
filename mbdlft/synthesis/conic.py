"""Descents in which every gain near the largest is quadratic, with both of its largest singular values.

A step d, in a box |e| <= radius of d = T e, makes t + c e small, as `sqp` does it, where of each gain

    (a + c)/2 + |((a - c)/2, Re b, Im b)| + |U d|^2/2 <= t,   a = a_0 + a_1 d, c = c_0 + c_1 d, b = b_1 d,

with U'U its second derivative, made positive: a cone program. What decides at the end of such a step is
foreseen, where linear pieces with one curvature for all of them (`sqp`) zigzag: so many gains are equal
at a minimum of worst cases, each with a curvature of its own. Pieces join a step where it passes them
(Fukushima, Luo, Tseng, SIAM Journal on Optimization 13, 2003: sequential quadratically constrained
quadratic programming).
"""

from collections.abc import Sequence
from math import sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbdlft.base.array import Array
from mbdlft.robust.moving.variation import conic_solution
from mbdlft.synthesis import descent
from mbdlft.synthesis.evaluation import Look, Piece, Place

_NEAR = 3e-3  # of the merit: pieces that are less below the largest are in the first program of a step
_MOST, _MORE, _AGAIN = 200, 60, 8  # pieces in it; that join it at once; how often
_FLAT = 1e-6  # of the largest curvature of a gain: smaller ones are left out
_ROUND = 100.0  # times the curvature from which on a direction is scaled, squared: c of T is 1/10
_LARGEST = 1e3  # radius
_STEPS = 8  # they are long: what is left is seen with the next worst point
_UNSOLVED = 2  # programs without an end before a descent ends
_RISEN, _FEW, _BESIDE = 0.998, 10, 1e-3  # places that are held: as those of `sqp`, and how many join
_PASSED = 1e-9  # of a merit: what a piece passes the largest by, and joins
_LEAST = 1e-6  # curvature of what is linear
_ITERATIONS = 80


class _Bend(NamedTuple):
    """U (r, values), and the second singular value c with what couples it; c_0 is -inf without one."""

    U: Array
    value: float
    slope: Array
    cross: NDArray[np.complex128]


class _Model:
    """Pieces at values x as functions of a step; bends of gains are computed where they are asked for."""

    def __init__(self, problem: descent.Problem, x: Array, look: Look, held: Sequence[Place]) -> None:
        self.problem, self.x = problem, x
        pieces, seen = list[Piece](), set[Place]()
        for piece in sorted(look.pieces, key=lambda p: -p.value):
            if piece[:3] not in seen:  # a second singular value is in the bend of the first
                pieces.append(piece)
            if piece.goal in problem.gains:
                seen.add(piece[:3])
        self.places: list[Place] = [(p.goal, p.point, p.frequency) for p in pieces]
        self.hard = np.array([problem.hard(p.goal) for p in pieces], dtype=bool)
        self.unit = np.where(self.hard, 1.0, problem.unit)
        self.values = np.array([p.value for p in pieces]) / self.unit
        slopes = np.array([p.slope for p in pieces]).reshape(len(pieces), len(x))
        self.slopes = slopes / self.unit[:, None]
        self.held = np.array([place in set(held) for place in self.places], dtype=bool)
        self.bent: dict[int, _Bend | None] = {}

    def largest(self, values: Array, among: Sequence[int] | None = None) -> tuple[float, float]:
        """The largest soft piece among some, or all, and the largest hard one, 1 at least."""
        chosen = slice(None) if among is None else list(among)
        values, hard = values[chosen], self.hard[chosen]
        return float(np.max(values[~hard], initial=-np.inf)), float(np.max(values[hard], initial=1.0))

    def merit(self, values: Array) -> float:
        """t + c e."""
        soft, hard = self.largest(values)
        return (soft if np.isfinite(soft) else 0.0) + self.problem.price * (hard - 1.0)

    def first(self) -> list[int]:
        """Pieces near the largest, and those that are held."""
        soft, hard = self.largest(self.values)
        near = np.where(self.hard, hard, soft) - self.values < _NEAR
        return [int(i) for i in np.flatnonzero(near | self.held)[:_MOST]]

    def bend(self, chosen: Sequence[int]) -> None:
        """The bends of chosen pieces are known from now on."""
        new = [i for i in chosen if i not in self.bent]
        self.bent.update(dict.fromkeys(new))
        gains = [i for i in new if self.places[i][0] in self.problem.gains]
        if not gains or self.problem.bends is None:
            return
        found = self.problem.bends(self.x, [self.places[i] for i in gains], ~self.held[gains])
        if found is None:
            return
        sizes, vectors = np.linalg.eigh(found.second)
        unit = self.unit[gains]
        for i, size, V, u, *pair in zip(gains, sizes, vectors, unit, *found[1:], strict=True):
            kept = size > _FLAT * max(size[-1], 0.0)
            self.bent[i] = _Bend((V[:, kept] * np.sqrt(size[kept] / u)).T, *(part / u for part in pair))

    def at(self, d: Array) -> Array:
        """All pieces after a step, those without bends as linear."""
        values = self.values + self.slopes @ d
        for i, bend in self.bent.items():
            if bend is not None:
                second, first = bend.value + bend.slope @ d, values[i]
                if np.isfinite(second):
                    size = np.hypot(0.5 * (first - second), abs(bend.cross @ d))
                    first = 0.5 * (first + second) + size
                values[i] = first + 0.5 * np.sum((bend.U @ d) ** 2)
        return values

    def directions(self) -> Array:
        """T (values, values), as of `sqp`, of the pieces whose bends are known."""
        whole = np.vstack([np.zeros((1, len(self.x))), *(b.U.T @ b.U for b in self.bent.values() if b)])
        squares, vectors = np.linalg.eigh(whole.T @ whole)
        return np.asarray(vectors / np.sqrt(1.0 + np.sqrt(_ROUND * np.maximum(squares, 0.0))))


class _Step(NamedTuple):
    d: Array
    size: float
    merit: float  # that is predicted
    is_solved: bool


def sqcqp(
    problem: descent.Problem, x: Array, steps: int, tolerance: float, goal: float = -np.inf
) -> descent.Descended:
    """Steps with bends of all gains, from a stable start; it ends below a merit `goal`."""
    radius, slow, held, here = descent.RADIUS, 0, list[Place](), problem.evaluate(x)
    merit = problem.merit(here)
    for _ in range(min(steps, _STEPS) if np.isfinite(merit) else 0):
        model = _Model(problem, x, here, held)
        chosen = model.first()
        model.bend(chosen)
        T, there, least = model.directions(), None, tolerance * max(1e-3, abs(merit))
        for count in range(descent.TRIES):
            step, chosen = _stepped(model, chosen, T, radius)
            if merit - step.merit <= least:
                if step.is_solved or count >= _UNSOLVED:
                    break
                radius *= descent.REFUSED
                continue
            look = problem.evaluate(x + step.d, held)
            new = problem.merit(look)
            share = (merit - new) / (merit - step.merit) if np.isfinite(new) else -np.inf
            if share > descent.ACCEPTED:
                there = look
                break
            look = look._replace(pieces=tuple(sorted(look.pieces, key=lambda p: -p.value)))
            more = descent.joined(held, descent.risen(problem, look, _RISEN)[:_FEW], _BESIDE)
            radius = (descent.REFUSED if len(more) == len(held) else descent.RISING) * min(
                radius, step.size
            )
            if len(more) > len(held):
                held = more
                model = _Model(problem, x, problem.evaluate(x, held), held)
                chosen = model.first()
        if there is None:
            break
        radius = descent.next_radius(radius, share, step.size, _LARGEST)
        slow = slow + 1 if merit - new < descent.SMALL * least else 0
        x, merit, here = x + step.d, new, there
        if merit <= goal or slow >= descent.SLOW:
            break
    return descent.Descended(x, merit)


def _stepped(model: _Model, chosen: list[int], T: Array, radius: float) -> tuple[_Step, list[int]]:
    """A step of chosen pieces, and of those that it would pass."""
    for _ in range(_AGAIN):
        model.bend(chosen)
        d, size, is_solved = _program(model, chosen, T, radius)
        values = model.at(d)
        inside = np.zeros(len(values), dtype=bool)
        inside[chosen] = True
        soft, hard = model.largest(values, chosen)
        past = np.where(inside, -np.inf, values - np.where(model.hard, hard, soft))
        if not np.any(past > _PASSED):
            break
        chosen = [*chosen, *(int(i) for i in np.argsort(-past)[:_MORE] if past[i] > _PASSED)]
    return _Step(d, size, model.merit(values), is_solved), chosen


def _program(model: _Model, chosen: Sequence[int], T: Array, radius: float) -> tuple[Array, float, bool]:
    """A step d, the size |e| of its coordinates, and whether its program came to an end.

    Unknowns are e over the radius, t, the excess of hard goals, and |U d|^2/2 of each gain that bends.
    """
    import clarabel  # here because it is slow to import

    problem, x, n = model.problem, model.x, len(model.x)
    G, hard = model.slopes[chosen] @ T * radius, model.hard[chosen]
    unit = max(float(np.max(np.abs(G), initial=0.0)), 1e-12)
    level = np.max(model.values[~model.hard], initial=0.0)
    room = (np.where(hard, 1.0, level) - model.values[chosen]) / unit
    bends = [model.bent.get(i) for i in chosen]
    curved = [k for k, bend in enumerate(bends) if bend is not None]
    width = n + 2 + len(curved)
    most = np.where(hard[:, None], [0.0, -1.0], [-1.0, 0.0])
    G = np.hstack([G / unit, most, np.zeros((len(G), len(curved)))])
    flat = [k for k, bend in enumerate(bends) if bend is None]
    ends, side = descent.ranges(problem, x, T * radius)
    ends, side = np.vstack([np.eye(n), -np.eye(n), ends]), np.concatenate([np.ones(2 * n), side])
    rows = [G[flat], np.hstack([ends, np.zeros((len(ends), width - n))]), -np.eye(width)[[n + 1]]]
    sides = [room[flat], side, np.zeros(1)]
    if np.all(hard):  # t is nothing but zero
        rows.append(-np.eye(width)[[n]])
        sides.append(np.zeros(1))
    cones = [clarabel.NonnegativeConeT(sum(map(len, sides)))]
    for q, k in enumerate(curved, n + 2):
        bend, of_bend, value = bends[k], np.eye(width)[[q]], model.values[chosen[k]]
        assert bend is not None
        for part, side in _cones(bend, value, G[[k]], of_bend, (T * radius, unit), room[k]):
            rows.append(part)
            sides.append(side)
            cones.append(clarabel.SecondOrderConeT(len(side)))
    cost = np.zeros(width)
    cost[n : n + 2] = 1.0, problem.price
    P = np.zeros((width, width))
    P[:n, :n] = np.triu(T.T @ T) * (_LEAST * radius**2 / unit)
    solution = conic_solution(cost, np.vstack(rows), np.concatenate(sides), cones, P, _ITERATIONS)
    e = np.array(solution.x)[:n]
    if not np.all(np.isfinite(e)):
        return np.zeros(n), 0.0, False
    d = np.clip(T @ e * radius, problem.low - x, problem.high - x)
    is_solved = solution.status in (clarabel.SolverStatus.Solved, clarabel.SolverStatus.AlmostSolved)
    return d, float(np.max(np.abs(e))) * radius, is_solved


def _cones(
    bend: _Bend, value: float, G: Array, of_bend: Array, scale: tuple[Array, float], room: float
) -> list[tuple[Array, Array]]:
    """Rows and sides of |U d|^2/2 <= q, and of the pair, or the gain alone, with q at most t."""
    (T, unit), n = scale, scale[0].shape[1]

    def wide(rows: Array) -> Array:
        return np.hstack([rows @ T, np.zeros((len(rows), G.shape[1] - n))])

    U = wide(bend.U) * sqrt(2.0 / unit)
    curve = np.vstack([-of_bend, -of_bend, -U]), np.concatenate([[1.0, -1.0], np.zeros(len(U))])
    if not np.isfinite(bend.value):
        return [curve, (G + of_bend, np.array([room]))]
    c, b = wide(bend.slope[None]) / unit, wide(np.array([bend.cross.real, bend.cross.imag])) / unit
    own = G.copy()
    own[:, n:] = 0.0
    gap = 0.5 * (value - bend.value) / unit
    pair = np.vstack([G + 0.5 * (c - own) + of_bend, 0.5 * (c - own), -b])
    return [curve, (pair, np.array([room + gap, gap, 0.0, 0.0]))]
