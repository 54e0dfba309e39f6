"""Two descents for a largest of many smooth pieces: trust-region SQP, and BFGS with weak Wolfe steps.

SQP: with the pieces s_i (soft) and h_j (hard) near the largest, a step d solves

    min t + c e + d'H d/2,   s_i + g_i'd <= t,   h_j + g_j'd <= 1 + e,   e >= 0,   |d_k| <= radius,

within the ranges of the values; H is a Powell-damped BFGS matrix of the Lagrangian, whose pieces are
matched from step to step by goal, point and frequency (Fletcher, Practical Methods of Optimization, 1987,
chapter 14; Apkarian, Noll, IEEE Transactions on Automatic Control 51, 2006, for the pieces). It begins
with the second derivatives of gains, and is made of them anew where steps are refused.

Steps are d = T e, and e is bounded. T = (I + M/c)^-1/2 knows the second derivatives H_i of all gains near
the largest: M^2 = sum H_i^2, so |d'H_i d| <= d'M d, and no gain leaves its slope far in a step, although
one value may bend it a million times as much as another one does. What is left of that, a second step
corrects, which begins where a refused one ends (Fletcher, chapter 14.4).

The places where gains are largest after refused steps are *held*: gains there are pieces from now on, as
in exchange methods for semi-infinite programs (Hettich, Kortanek, SIAM Review 35, 1993). At many optima a
gain is flat over frequency: without them, new peaks rise between those that are pieces.

BFGS on the largest itself, whose slope is that of the largest piece, needs steps of the weak Wolfe kind
only (Lewis, Overton, Mathematical Programming 141, 2013). Values are divided by their scales.
"""

from collections.abc import Callable, Iterable, Sequence
from math import log
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from mbdlft.base.array import Array
from mbdlft.synthesis.curvature import Bends
from mbdlft.synthesis.evaluation import STABLE, Flags, Look, Place

_PIECES = 120  # in one step; more are those that matter least
TRIES = 12  # steps that are refused before a descent ends
SLOW, SMALL = 6, 10.0  # so many steps that gain less than so many tolerances end a descent
RADIUS, _LARGEST = 0.5, 10.0  # of scaled values
ACCEPTED, _GOOD, _POOR = 0.05, 0.7, 0.25  # shares of the gain that was predicted
_ALIKE = 0.7  # logarithm of the ratio of frequencies of one piece at two steps
_ARMIJO, _WOLFE = 1e-4, 0.9
_FIRST_SIZE = 1e-2  # of H before anything is known of it
_ACTIVE = 1e-6  # multipliers of pieces that count
_LEAST_CURVED = 1e-6  # the smallest eigenvalue of H
_CURVED, _NEAR = 0.1, 0.97  # c of T; part of the largest goal from which on gains count in it
_HELD, _RISEN = 60, 0.98  # places at most; part of the largest gain from which on they are held
_BESIDE = 0.01  # logarithm of the ratio of frequencies of places that are one
REFUSED, RISING = 0.3, 0.5  # what a step that is refused leaves of the radius; where places are added


class Evaluate(Protocol):
    """The goals at scaled values, with gains at places that are held."""

    def __call__(self, scaled: Array, held: Sequence[Place] = (), /) -> Look: ...


class Problem(NamedTuple):
    """What is made small: looks at scaled values, within ranges, with a price of hard goals."""

    evaluate: Evaluate
    low: Array
    high: Array
    hard: Callable[[int], bool]  # whether a goal is one
    price: float  # c
    unit: float = 1.0  # of soft values
    curvatures: Callable[[Array, Sequence[Place]], Array | None] | None = None  # of gains at places
    gains: frozenset[int] = frozenset()  # goals whose pieces are gains at frequencies
    bends: Callable[[Array, Sequence[Place], Flags], Bends | None] | None = None  # as of `sqcqp`

    def merit(self, look: Look) -> float:
        """t + c e."""
        if not np.isfinite(look.soft) and look.soft > 0.0:
            return np.inf
        soft = look.soft / self.unit if np.isfinite(look.soft) else 0.0
        return soft + self.price * max(0.0, look.hard - 1.0)


class Descended(NamedTuple):
    """Where a descent ended."""

    x: Array
    merit: float


class _Step(NamedTuple):
    """A step d of the size |e|, the multipliers of the pieces, and the merit that it predicts."""

    d: Array
    size: float
    multipliers: Array
    merit: float


class _Pieces(NamedTuple):
    """Pieces as arrays; soft values are in the unit of the merit."""

    values: Array
    slopes: Array
    hard: NDArray[np.bool_]
    keys: list[tuple[int, int]]
    frequencies: Array


def _pieces(problem: Problem, look: Look) -> _Pieces:
    chosen = sorted(look.pieces, key=lambda p: -p.value)[:_PIECES]
    hard = np.array([problem.hard(p.goal) for p in chosen], dtype=bool)
    unit = np.where(hard, 1.0, problem.unit)
    return _Pieces(
        np.array([p.value for p in chosen]) / unit,
        np.array([p.slope for p in chosen]).reshape(len(chosen), len(problem.low)) / unit[:, None],
        hard,
        [(p.goal, p.point) for p in chosen],
        np.array([p.frequency for p in chosen]),
    )


def sqp(problem: Problem, x: Array, steps: int, tolerance: float, goal: float = -np.inf) -> Descended:
    """Trust-region SQP from a stable start; it ends below a merit `goal`."""
    H, radius, slow, held = _FIRST_SIZE * np.eye(len(x)), RADIUS, 0, list[Place]()
    here = problem.evaluate(x)
    merit, is_first = problem.merit(here), True
    if not np.isfinite(merit):
        return Descended(x, np.inf)
    pieces = _pieces(problem, here)
    for _ in range(steps):
        if not pieces.keys:  # nothing is moved
            break
        T = _directions(problem, x, pieces)
        knows = is_first and problem.curvatures is not None
        if knows and (step := _step(problem, H, pieces, x, T, radius)) is not None:
            H, is_known = _curvature(problem, x, pieces, step.multipliers, H)
            is_first = not is_known
        there, least = None, tolerance * max(1e-3, abs(merit))
        for count in range(TRIES):
            step = _step(problem, H, pieces, x, T, radius)
            if step is None or merit - step.merit <= least:
                break
            if held:
                held = joined(held, _active(problem, pieces, step.multipliers))
            there, d, share = _taken(problem, H, x, T, merit, step, held)
            if share > ACCEPTED:
                break
            radius = max(REFUSED * min(radius, step.size), 1e-12)
            H, _ = _curvature(problem, x, pieces, step.multipliers, H)
            if count and len(more := joined(held, risen(problem, there))) > len(held):
                held, radius = more, radius * RISING / REFUSED
                pieces = _pieces(problem, problem.evaluate(x, held))
            there = None
        if there is None or step is None:
            break
        before, pieces = pieces, _pieces(problem, there)
        H = _curved(H, before, pieces, step.multipliers, d, is_first=is_first)
        is_first = False
        radius = next_radius(radius, share, step.size, _LARGEST)
        new = problem.merit(there)
        slow = slow + 1 if merit - new < SMALL * least else 0
        x, merit = x + d, new
        if merit <= goal or slow >= SLOW:
            break
    return Descended(x, merit)


def next_radius(radius: float, share: float, size: float, largest: float) -> float:
    """The radius after a step of a size that has a share of the gain that was predicted."""
    if share > _GOOD and size > 0.9 * radius:
        return min(2.5 * radius, largest)
    return 0.5 * radius if share < _POOR else radius


def _taken(
    problem: Problem, H: Array, x: Array, T: Array, merit: float, step: _Step, held: Sequence[Place]
) -> tuple[Look, Array, float]:
    """What a step leads to, corrected where that helps, and its share of the gain that was predicted."""

    def at(d: Array) -> tuple[Look, Array, float]:
        there = problem.evaluate(x + d, held)
        new = problem.merit(there)
        return there, d, (merit - new) / (merit - step.merit) if np.isfinite(new) else -np.inf

    first = at(step.d)
    if first[2] > ACCEPTED or first[2] == -np.inf:
        return first
    more = _step(problem, H, _pieces(problem, first[0]), x + step.d, T, step.size)
    corrected = first if more is None else at(step.d + more.d)
    return corrected if corrected[2] > ACCEPTED else first


def _directions(problem: Problem, x: Array, pieces: _Pieces) -> Array:
    """T (values, values); the identity where no gain is near the largest."""
    level = [max(1.0 * hard, np.max(pieces.values[pieces.hard == hard], initial=0.0)) for hard in (0, 1)]
    near = pieces.values >= _NEAR * np.where(pieces.hard, level[1], level[0])
    second = _second(problem, x, list(_active(problem, pieces, near.astype(float))))
    if second is None:
        return np.eye(len(x))
    squares, vectors = np.linalg.eigh((stacked := second.reshape(-1, len(x))).T @ stacked)
    return np.asarray(vectors / np.sqrt(1.0 + np.sqrt(np.maximum(squares, 0.0)) / _CURVED))


def _step(problem: Problem, H: Array, pieces: _Pieces, x: Array, T: Array, radius: float) -> _Step | None:
    """The step with the least merit that is predicted."""
    import piqp  # here because few need it

    n, hard = len(x), pieces.hard
    ends, side = ranges(problem, x, T)
    rows = [
        np.hstack([pieces.slopes @ T, -(~hard[:, None]).astype(float), -hard[:, None].astype(float)]),
        np.hstack([ends, np.zeros((len(ends), 2))]),
    ]
    sides = np.concatenate([np.where(hard, 1.0, 0.0) - pieces.values, side])
    cost = np.concatenate([np.zeros(n), [1.0, problem.price]])
    P = np.zeros((n + 2, n + 2))
    P[:n, :n] = T.T @ H @ T
    if not all(np.all(np.isfinite(each)) for each in (P, *rows, sides)):
        return None
    solver = piqp.DenseSolver()  # a tenth of the time of a solver of sparse programs
    most = np.concatenate([np.full(n, radius), [np.inf, np.inf]])
    least = np.concatenate([-most[:n], [0.0 if np.all(hard) else -np.inf, 0.0]])
    solver.setup(P, cost, G=np.vstack(rows), h_u=sides, x_l=least, x_u=most)
    solver.solve()
    z = solver.result.x
    if not np.all(np.isfinite(z)):
        return None
    d = np.clip(T @ z[:n], problem.low - x, problem.high - x)
    size = float(np.max(np.abs(z[:n])))
    return _Step(d, size, solver.result.z_u[: len(hard)], float(z[n] + problem.price * z[n + 1]))


def ranges(problem: Problem, x: Array, T: Array) -> tuple[Array, Array]:
    """Rows (k, values) and sides (k,) of x + T e in the ranges of the values."""
    low, high = (np.flatnonzero(np.isfinite(end)) for end in (problem.low, problem.high))
    return np.vstack([T[high], -T[low]]), np.concatenate(
        [(problem.high - x)[high], (x - problem.low)[low]]
    )


def _active(problem: Problem, pieces: _Pieces, multipliers: Array) -> dict[Place, float]:
    """Places of gains with their multipliers."""
    places = dict[Place, float]()
    for i in np.flatnonzero(multipliers > _ACTIVE):
        goal, point = pieces.keys[i]
        if goal in problem.gains:
            place = (goal, point, float(pieces.frequencies[i]))
            places[place] = places.get(place, 0.0) + float(multipliers[i])
    return places


def risen(problem: Problem, look: Look, share: float = _RISEN) -> list[Place]:
    """Places where gains are at least a share of the largest."""
    gains = [p for p in look.pieces if p.goal in problem.gains]
    largest = max((p.value for p in gains), default=0.0)
    return [p[:3] for p in gains if p.value >= share * largest]


def joined(held: Sequence[Place], more: Iterable[Place], beside: float = _BESIDE) -> list[Place]:
    """Places with more of them; the oldest leave."""
    places = list(held)
    for goal, point, frequency in more:
        known = (f for k, i, f in places if (k, i) == (goal, point))
        if all(_apart(f, frequency) > beside for f in known):
            places.append((goal, point, frequency))
    return places[-_HELD:]


def _apart(one: float, other: float) -> float:
    """|log| of the ratio of two frequencies; what is outside of 1e-9 to 1e9 rad/s counts as these."""
    return abs(log(min(max(one, 1e-9), 1e9) / min(max(other, 1e-9), 1e9)))


def _second(problem: Problem, x: Array, places: Sequence[Place]) -> Array | None:
    """Second derivatives (k, values, values) of gains at places; None if there are none."""
    return None if problem.curvatures is None or not places else problem.curvatures(x, places)


def _curvature(
    problem: Problem, x: Array, pieces: _Pieces, multipliers: Array, H: Array
) -> tuple[Array, bool]:
    """The second derivative of the Lagrangian, made positive; H if no gain is in it, and False."""
    places = _active(problem, pieces, multipliers)
    second = _second(problem, x, list(places))
    if second is None:
        return H, False
    values, vectors = np.linalg.eigh(np.tensordot(list(places.values()), second, 1))
    return np.asarray(vectors * np.maximum(np.abs(values), _LEAST_CURVED) @ vectors.T), True


def _curved(
    H: Array, old: _Pieces, new: _Pieces, multipliers: Array, d: Array, *, is_first: bool
) -> Array:
    """The damped BFGS matrix after a step, from slopes of pieces that are there before and after it."""
    y, matched = np.zeros(len(d)), 0.0
    by_key: dict[tuple[int, int], list[int]] = {}
    for k, key in enumerate(new.keys):
        by_key.setdefault(key, []).append(k)
    for i in np.flatnonzero(multipliers > _ACTIVE):
        alike = by_key.get(old.keys[i], ())
        distances = [(_apart(new.frequencies[j], old.frequencies[i]), j) for j in alike]
        if distances and min(distances)[0] < _ALIKE:
            y += multipliers[i] * (new.slopes[min(distances)[1]] - old.slopes[i])
            matched += multipliers[i]
    if not matched > 0.3 * np.sum(multipliers):
        return H
    if is_first and d @ y > 0.0:
        H = np.eye(len(d)) * float(np.clip(y @ y / (d @ y), 1e-4, 1e4))
    Hd = H @ d
    dHd, dy = float(d @ Hd), float(d @ y)
    if dy < 0.2 * dHd:  # Powell
        share = 0.8 * dHd / (dHd - dy)
        y = share * y + (1.0 - share) * Hd
        dy = float(d @ y)
    if not (dy > 1e-14 and dHd > 1e-16):
        return H
    H = H - np.outer(Hd, Hd) / dHd + np.outer(y, y) / dy
    return np.asarray(0.5 * (H + H.T))


def bfgs(problem: Problem, x: Array, steps: int, tolerance: float, goal: float = -np.inf) -> Descended:
    """BFGS with weak Wolfe steps on the merit; values outside of their ranges count as at the ends."""

    def at(x: Array) -> tuple[float, Array]:
        inside = np.clip(x, problem.low, problem.high)
        look = problem.evaluate(inside)
        merit = problem.merit(look)
        if not np.isfinite(merit):
            return np.inf, np.zeros(len(x))
        pieces, slope = _pieces(problem, look), np.zeros(len(x))
        for hard, price in ((False, 1.0), (True, problem.price if look.hard > 1.0 else 0.0)):
            of_kind = [k for k in np.flatnonzero(pieces.hard == hard) if pieces.keys[k][0] != STABLE]
            if of_kind and price:
                slope += price * pieces.slopes[max(of_kind, key=lambda k: pieces.values[k])]
        return merit, np.where(x == inside, slope, 0.0)

    merit, slope = at(x)
    inverse = np.eye(len(x))
    for step in range(steps if np.isfinite(merit) else 0):
        d = -inverse @ slope
        if not slope @ d < 0.0:
            inverse, d = np.eye(len(x)), -slope
        if not step:
            d = (
                d
                / max(float(np.linalg.norm(d)), 1e-300)
                * min(1.0, 0.05 * float(np.linalg.norm(x)) + 1e-3)
            )
        line = _weak_wolfe(at, x, merit, float(slope @ d), d)
        if not line.merit < merit:
            break
        s, y = line.length * d, line.slope - slope
        sy = float(s @ y)
        if sy > 1e-14 * np.linalg.norm(s) * np.linalg.norm(y):
            if not step:
                inverse = inverse * (sy / float(y @ y))
            V = np.eye(len(x)) - np.outer(s, y) / sy
            inverse = V @ inverse @ V.T + np.outer(s, s) / sy
        gain, x, merit, slope = merit - line.merit, x + s, line.merit, line.slope
        if merit <= goal or (gain < tolerance * abs(merit) and step > 20):
            break
    return Descended(np.clip(x, problem.low, problem.high), merit)


class _Line(NamedTuple):
    length: float
    merit: float
    slope: Array


def _weak_wolfe(
    at: Callable[[Array], tuple[float, Array]], x: Array, merit: float, rate: float, d: Array
) -> _Line:
    """A step along d that descends enough, and at whose end the descent is less steep, by bisection."""
    low, high, length = 0.0, np.inf, 1.0
    best = _Line(0.0, merit, np.zeros(len(x)))
    for _ in range(40):
        value, slope = at(x + length * d)
        if not value <= merit + _ARMIJO * length * rate:
            high = length
        else:
            best = _Line(length, value, slope)
            if slope @ d >= _WOLFE * rate:
                return best
            low = length
        length = 0.5 * (low + high) if np.isfinite(high) else 2.0 * low
        if high - low < 1e-14:
            break
    return best
