"""The tuner: free values of controllers for goals at the nominal point, or at several points of the box.

The loop is made stable, by SQP on the real parts of its poles, or by BFGS, which goes on where poles that
meet have no slopes. SQP or BFGS on the goals follows. Each variable is divided by a scale: that of its
value, changed where its slopes are small or large beside those of others.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from fractions import Fraction
from typing import Any, NamedTuple

import flint
import numpy as np
from numpy.typing import NDArray

from mbdlft.base.array import Array
from mbdlft.base.errors import AnalysisError
from mbdlft.base.parameter import to_physical
from mbdlft.exact.modular import multiplied, solved
from mbdlft.exact.numbers import Field
from mbdlft.exact.rounding import eigenvectors_of
from mbdlft.response.modes import pole_text
from mbdlft.response.norms import peak_of
from mbdlft.response.staircase import Plant
from mbdlft.robust.realization import AXIS, or_left_out
from mbdlft.synthesis.codesign import budgets
from mbdlft.synthesis.curvature import Bends, bends, curvatures
from mbdlft.synthesis.descent import Descended, Problem, bfgs, sqp
from mbdlft.synthesis.evaluation import STABLE, UNSTABLE, Asked, Flags, Look, Place, abscissas, look
from mbdlft.synthesis.goals import HINF, MARGIN, Goal
from mbdlft.synthesis.loop import Family, Network, family, places, weighted
from mbdlft.synthesis.pieces import in_modes

_DECAY, _STABLE, _NEAR = 1e-5, 1e-3, 0.05  # of the bandwidth: decay to be kept, aimed at, and of pieces
_BESIDE = 0.3  # of a scale: how far the second search for stable values begins from the first
_STABLE_STEPS, STEPS, ROUNDS = 80, 250, 8
_KEEPS = (0.9, 0.7, 0.8, 0.6)  # parts of the largest from which on peaks are pieces, by round
_TOLERANCE = 1e-7  # of the merit
_PRICES = (10.0, 100.0, 1000.0)  # of hard goals, until they are reached
_REACHED = 1e-4  # above 1: a hard goal that is no larger is reached
_SMALL = 0.1  # of the first scale of a value: it is not divided by less
_GAIN = 1e-6  # of a merit: two rounds that gain less are the last
_UNSTABLE = 2  # points that are added where loops are not stable
_MISSED = 1e-5  # of a norm: a peak that the grid did not see is added to it
_PEAK = 1e-9  # of a norm: its tolerance
# times what stable loops reach, while others are made stable; little enough to come back, and more than
# the 1.1 from which on the box counts as near
_KEPT = 1.3
_LIMIT = "give a range (`ranges`), or a goal that limits it, such as of the effort."
Engine = Callable[[Problem, Array, int, float], Descended]
Plan = Sequence[tuple[Engine, float]]  # engines, with the part from which on peaks are pieces


def _where(pole: complex, size: float) -> str:
    return "on the right" if pole.real > AXIS * size else "on the axis"


class Tuned(NamedTuple):
    """Values, and what they reach at the points they were tuned on."""

    x: Array
    look: Look

    def rank(self) -> tuple[float, float]:
        """For comparisons: first how far hard goals are missed, then the soft ones."""
        return max(0.0, self.look.hard - 1.0 - _REACHED), self.look.soft


def gained(old: Tuned, new: Tuned) -> float:
    """The larger gain: of what hard goals are missed by, or of the soft ones, beside what they are."""
    soft = (old.look.soft - new.look.soft) / max(abs(new.look.soft), 1e-300)
    return max(old.rank()[0] - new.rank()[0], soft)


class Tuner:
    """Loops at some points of the box, with the goals as functions of scaled values."""

    def __init__(self, net: Network, goals: Sequence[Goal], points: Array) -> None:
        self.net, self.goals, self.points = net, tuple(goals), points
        self.family: Family = family(net, weighted(net, goals), points)
        self.first_scale = self.scale = np.array([value.scale for value in net.free])
        self.low = np.array([value.low for value in net.free])
        self.high = np.array([value.high for value in net.free])
        sizes = np.abs(np.linalg.eigvals(self.family.X[0, : self.family.states, : self.family.states]))
        seen = sizes[sizes > 1e-6 * np.max(sizes, initial=0.0)]
        self.bandwidth = float(np.median(seen)) if len(seen) else 1.0
        self.asked = Asked(self.goals, _DECAY * self.bandwidth, budgets=budgets(net, goals))
        self.gains = frozenset(k for k, g in enumerate(goals) if g.kind in (HINF, MARGIN))
        self.has_states = any(controller.states for controller in net.controllers)

    def problem(self, keep: float, price: float, unit: float) -> Problem:
        """The goals, at scaled values."""

        def at(scaled: Array, held: Sequence[Place] = ()) -> Look:
            return self._scaled(self.look(scaled * self.scale, keep, held))

        def second(scaled: Array, held: Sequence[Place]) -> Array | None:
            found = curvatures(self.family, self.goals, scaled * self.scale, held)
            units = np.array([1.0 if self._is_hard(goal) else unit for goal, _, _ in held])
            return (
                None if found is None else found * np.outer(self.scale, self.scale) / units[:, None, None]
            )

        def bent(scaled: Array, held: Sequence[Place], moving: Flags) -> Bends | None:
            found = bends(self.family, self.goals, scaled * self.scale, held, moving)
            squares = np.outer(self.scale, self.scale)
            return found and Bends(
                found.second * squares, found.value, found.slope * self.scale, found.cross * self.scale
            )

        low, high = self.low / self.scale, self.high / self.scale
        return Problem(at, low, high, self._is_hard, price, unit, second, self.gains, bent)

    def look(self, x: Array, keep: float | None, held: Sequence[Place] = ()) -> Look:
        """The goals at values."""
        with self.in_doubles(x):
            return look(self.family, self.asked, x, keep, held)

    @contextmanager
    def in_doubles(self, x: Array) -> Iterator[None]:
        """An AnalysisError names the value that has gone too far where numbers overflow."""
        try:
            with np.errstate(over="ignore", invalid="ignore"):
                yield
        except np.linalg.LinAlgError:
            value = self.net.free[int(np.argmax(np.abs(x) / self.first_scale))]
            number = x[self.net.free.index(value)]
            raise AnalysisError(
                f"tune: {value.name} has come to {number:.3g}, where the loops have no numbers any more; "
                f"its scale is {value.scale:.3g}. Goals may become better without end as it grows: "
                f"{_LIMIT}"
            ) from None

    def endless(self, x: Array) -> str:
        """Which values are beyond their scales, and ten times as large better still; or nothing."""
        more, best, better = 10.0 * x, self.at(x), set[int]()
        is_far = (np.abs(x) > self.first_scale) & (self.low <= more) & (more <= self.high)
        far = np.flatnonzero(is_far)
        for some in (far, *far[:, None]):
            with suppress(AnalysisError):  # no numbers any more
                new = self.at(np.where(np.isin(range(len(x)), some), more, x))
                if new.rank() < best.rank() and gained(best, new) > _GAIN:
                    better |= set(some.tolist())
        numbers = ", ".join(f"{self.net.free[k].name} {x[k]:.3g}" for k in sorted(better))
        return numbers and f"tune: ten times as large, {numbers} would be better still: {_LIMIT}"

    def _is_hard(self, goal: int) -> bool:
        return goal == STABLE or self.goals[goal].hard

    def _scaled(self, found: Look) -> Look:
        return found._replace(pieces=tuple(p._replace(slope=p.slope * self.scale) for p in found.pieces))

    def stabilized(self, x: Array) -> tuple[Array, float]:
        """Values near x with which all loops are stable, and the largest real part of a pole there."""
        near, self.scale = _NEAR * self.bandwidth, self.first_scale

        def at(scaled: Array, held: Sequence[Place] = ()) -> Look:
            return self._scaled(abscissas(self.family, scaled * self.scale, near))

        problem = Problem(
            at, self.low / self.scale, self.high / self.scale, lambda _: False, 1.0, self.bandwidth
        )
        found = sqp(problem, x / self.scale, _STABLE_STEPS, 1e-6, -_STABLE)
        if found.merit >= 0.0:  # multiple poles, such as without any gain, have no slopes
            beside = x / self.scale + _BESIDE * np.random.default_rng(0).standard_normal(len(x))
            beside = np.clip(beside, problem.low, problem.high)
            again = bfgs(problem, beside, _STABLE_STEPS, 1e-6, -_STABLE)
            found = min(found, again, key=lambda descended: descended.merit)
        return found.x * self.scale, found.merit * self.bandwidth

    def at(self, x: Array) -> Tuned:
        """What values reach."""
        return Tuned(x, self.look(x, 1.0))

    def descended(
        self, x: Array, plan: Plan, steps: int, *, is_first: bool = False, tolerance: float = _TOLERANCE
    ) -> Tuned:
        """The goals made small from stable values: rounds of descents, with scales of the size of values.

        The price of hard goals rises until they are reached. States of controllers are modes, and their
        values are divided by their slopes.
        """
        best = self.at(x)
        for k, (engine, keep) in enumerate(plan):
            unit = best.look.soft if 0.0 < best.look.soft < np.inf else 1.0
            start = self._scaled_for(best, keep, unit, is_first=is_first and not k)
            for price in _PRICES:
                problem = self.problem(keep, price, unit)
                x = engine(problem, start / self.scale, steps, tolerance).x * self.scale
                best = min(best, self.at(x), key=Tuned.rank)
                start = best.x
                if best.rank()[0] == 0.0:
                    break
        return best

    def _scaled_for(self, best: Tuned, keep: float, unit: float, *, is_first: bool) -> Array:
        """Values of the same loops, from which a descent is easy; the scale is theirs."""
        self.scale = self.first_scale
        if not self.has_states:
            if not is_first:
                self.scale = np.maximum(np.abs(best.x), _SMALL * self.first_scale)
            return best.x
        x, names = best.x.copy(), [value.name for value in self.net.free]
        for controller in self.net.controllers:
            own = [names.index(value.name) for value in controller.free]
            x[own] = in_modes(controller, x[own])
        seen = self.look(x, keep)
        if not seen.is_stable:
            x, seen = best.x, self.look(best.x, keep)
        slopes = [np.abs(p.slope) / (1.0 if self._is_hard(p.goal) else unit) for p in seen.pieces]
        largest = np.max(slopes, axis=0, initial=0.0) * self.first_scale
        self.scale = self.first_scale / np.maximum(1.0, largest)
        return x

    def polished(self, best: Tuned, rounds: Sequence[int] = range(ROUNDS)) -> Tuned:
        """Values taken on until two rounds gain nothing; peaks between lines of the grid are seen."""
        idle = 0
        for k in rounds:
            new = self.descended(best.x, [(sqp, _KEEPS[k % len(_KEEPS)])], STEPS)
            is_complete = self.peaks_are_seen(new)
            new = self.at(new.x)
            idle = idle + 1 if gained(best, new) < _GAIN else 0
            best = new if not is_complete else min(best, new, key=Tuned.rank)
            if is_complete and idle >= 2:
                break
        return best

    def check_fixed(self) -> None:
        """An AnalysisError names a pole on the right, or zero, at the first point that nothing moves."""
        if len(poles := fixed_poles(self.family, self.first_scale)):
            pole = complex(poles[np.argmax(poles.real)])
            raise AnalysisError(
                f"tune: no values of these controllers make the loop stable{self._at_point(0)}: the pole "
                f"{pole_text(pole)} stays {_where(pole, 0.0)} for all of them (decided in exact "
                f"numbers). {self._advice(0, pole)}"
            )

    def unstable(self, x: Array) -> str:
        """Which pole no search brought to the left, and what hardly sees or moves it."""
        closed = self.family.closed(x)
        assert closed is not None, "a search has evaluated it"
        poles = np.linalg.eigvals(closed.A)
        i, k = np.unravel_index(np.argmax(poles.real), poles.shape)
        pole = complex(poles[i, k])
        numbers = zip(self.net.free, x, strict=True)
        return (
            f"tune: no values were found that make the loop stable{self._at_point(int(i))}: the pole "
            f"{pole_text(pole)} stays {_where(pole, float(np.max(np.abs(poles[i]))))}, at best with the "
            f"real part {pole.real:.3g}, at {', '.join(f'{v.name} {n:.4g}' for v, n in numbers)}. "
            f"{self._advice(int(i), pole, ', more states, or other starts')}"
        )

    def _at_point(self, i: int) -> str:
        """Such as `` at m 2``."""
        point = ", ".join(
            f"{p.name} {float(to_physical(p, d)):.6g}"
            for p, d in zip(self.net.system.parameters, self.points[i], strict=True)
        )
        return point and f" at {point}"

    def _advice(self, i: int, pole: complex, others: str = "") -> str:
        """How much of the direction of a mode of the open loop channels see and move, and what helps."""
        n, system = self.family.states, self.net.system
        values, left, right = eigenvectors_of(self.family.X[i, :n, :n])
        j = int(np.argmin(np.abs(values - pole)))
        moved, seen = (
            float(np.linalg.norm(matrix)) / max(float(np.linalg.norm(whole)), 1e-300)
            for matrix, whole in (
                (left[:, j].conj() @ self.family.L[i, :n], self.family.L[i, :n]),
                (self.family.R[i, :, :n] @ right[:, j], self.family.R[i, :, :n]),
            )
        )
        return (
            f"Of the open loop, the controllers see {seen:.2g} of this mode, and move {moved:.2g} of it. "
            f"Give a controller that measures or drives it (another sensor or actuator){others}"
            f"{or_left_out(system, range(len(system.outputs)))}."
        )

    def peaks_are_seen(self, tuned: Tuned) -> bool:
        """Whether the grid has the peak of every norm; if not, it has it from now on."""
        closed = self.family.closed(tuned.x)
        if closed is None or not tuned.look.is_stable:
            return True
        missed = []
        for goal, (rows, columns) in zip(self.goals, places(self.goals), strict=True):
            if goal.kind not in (HINF, MARGIN):
                continue
            for A, B, C, D in zip(*closed[:4], strict=True):
                plant = Plant(A, B[:, columns], C[rows], D[rows, columns])
                with self.in_doubles(tuned.x):
                    exact, _, frequency, _ = peak_of(plant, _PEAK)
                known = tuned.look.hard if goal.hard else tuned.look.soft
                if exact / goal.limit > known * (1.0 + _MISSED) and np.isfinite(frequency):
                    missed.append(frequency)
        if missed:
            self.asked = self.asked._replace(extra=np.union1d(self.asked.extra, missed))
        return not missed

    def worst(self, x: Array) -> list[tuple[float, Array]]:
        """The largest value of each goal at the points, and the point (number of parameters,)."""
        found = self.look(x, None)
        if not found.is_stable:
            return [(np.inf, self.points[found.point])] * len(self.goals)
        worst = []
        for k in range(len(self.goals)):
            of_goal = [(p.value, p.point) for p in found.pieces if p.goal == k]
            value, point = max(of_goal, default=(0.0, 0))  # of poles, if none is moved
            worst.append((value, self.points[point]))
        return worst

    def least_stable(self, x: Array) -> Array:
        """The points (k, number of parameters) at which loops are not stable: the worst few of them."""
        closed = self.family.closed(x)
        if closed is None:
            return self.points[:1]
        real = np.max(np.linalg.eigvals(closed.A).real, axis=1)
        order = np.argsort(-real)[:_UNSTABLE]
        return np.asarray(self.points[order[real[order] >= 0.0]])

    def deciding(self, x: Array, share: float) -> list[int]:
        """The nominal point, and those whose largest value is at least a share of the largest of all."""
        found = self.look(x, None)
        levels = [share * (max(1.0, found.hard) if g.hard else found.soft) for g in self.goals]
        return sorted({0, *(p.point for p in found.pieces if p.value >= levels[p.goal])})


def stabilized_beside(tuner: Tuner, x: Array) -> Array | None:
    """Values near x with which all loops are stable, where some are: what these reach is not lost.

    It may grow by a factor, and is a hard goal beside the poles of the others. None if that fails.
    """
    closed = tuner.family.closed(x)
    is_unstable = closed is None or np.max(np.linalg.eigvals(closed.A).real, axis=1) >= 0.0
    if np.all(is_unstable):
        return None
    others = tuner.family.at(np.flatnonzero(is_unstable).tolist())
    kept = Tuner(tuner.net, tuner.goals, tuner.points[~is_unstable])
    begun = kept.at(x)
    if not 0.0 < begun.look.soft < np.inf:
        return None
    start = kept._scaled_for(begun, _KEEPS[1], begun.look.soft, is_first=True)
    most = {False: _KEPT * begun.look.soft, True: _KEPT * max(1.0, begun.look.hard)}
    poles, near = len(tuner.goals), _NEAR * tuner.bandwidth

    def at(scaled: Array, held: Sequence[Place] = ()) -> Look:
        values = scaled * kept.scale
        reached, there = kept.look(values, _KEEPS[1]), abscissas(others, values, near)
        if not reached.is_stable:
            return UNSTABLE
        pieces = [p._replace(goal=poles) for p in there.pieces]
        for p in reached.pieces:
            limit = 1.0 if p.goal == STABLE else most[tuner.goals[p.goal].hard]
            pieces.append(p._replace(value=p.value / limit, slope=p.slope / limit))
        hard = max(reached.soft / most[False], reached.hard / most[True])
        return kept._scaled(Look(there.soft, hard, tuple(pieces), there.abscissa))

    low, high = tuner.low / kept.scale, tuner.high / kept.scale
    problem = Problem(at, low, high, lambda goal: goal != poles, _PRICES[0], tuner.bandwidth)
    ended = sqp(problem, start / kept.scale, _STABLE_STEPS, 1e-6, -_STABLE).x * kept.scale
    return ended if tuner.at(ended).look.is_stable else None


def fixed_poles(family: Family, scale: Array) -> NDArray[np.complex128]:
    """Poles (k,) on the right, or zero, of the loop at the first point with any values, of this scale.

    Such are modes that the controllers do not see or do not drive, and others that their structure leaves
    fixed (Wang, Davison, IEEE Transactions on Automatic Control 18, 1973). They are the roots that
    det(s I - A(x)) has for all x. Doubles count as they are written: how many there are, and how often 0
    is one, is decided modulo a prime, at random x. Where they are, eigenvalues say.
    """
    polynomials = [_characteristic(family, seed) for seed in (0, 1)]
    common = polynomials[0].gcd(polynomials[1])
    draws = [np.random.default_rng(seed).standard_normal(len(scale)) * scale for seed in (2, 3)]
    loops = [closed for draw in draws if (closed := family.closed(draw)) is not None]
    if not common.degree() or len(loops) < 2:
        return np.zeros(0, dtype=np.complex128)
    here, there = (np.linalg.eigvals(loop.A[0]).astype(np.complex128) for loop in loops)
    moved = np.min(np.abs(here[:, None] - there), axis=1)
    poles = here[np.argsort(moved)[: common.degree()]]
    zeros = next(k for k in range(common.degree() + 1) if common[k] != 0)
    poles[np.argsort(np.abs(poles))[:zeros]] = 0.0
    return np.asarray(poles[(poles == 0.0) | (poles.real > AXIS * np.max(np.abs(here)))])


def _characteristic(family: Family, seed: int) -> Any:
    """det(s I - A(x)) modulo a prime, at random x."""
    n, field = family.states, Field(())

    def residues(values: Array) -> NDArray[np.int64]:
        of_each = [field.residue(Fraction(float(x))) for x in values.ravel()]
        return np.array([int(x) for x in of_each], dtype=np.int64).reshape(values.shape)

    p = field.prime
    x = np.random.default_rng(seed).integers(1, 2**59, len(family.moves))
    S = residues(family.base)
    for value, move in zip(x.tolist(), family.moves, strict=True):
        i, j = np.nonzero(move)
        S[i, j] = [
            (int(s) + value * int(m)) % p for s, m in zip(S[i, j], residues(move[i, j]), strict=True)
        ]
    L, R, D = residues(family.L[0, :n]), residues(family.R[0, :, :n]), residues(family.D22[0])
    inner = (np.eye(len(S), dtype=np.int64) - multiplied(S, D, p)) % p
    gain = solved(inner, multiplied(S, R, p), p)
    A = (residues(family.X[0, :n, :n]) + multiplied(L, gain, p)) % p
    return flint.nmod_mat(n, n, A.ravel().tolist(), p).charpoly()
