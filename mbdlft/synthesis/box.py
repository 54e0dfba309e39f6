"""Controllers for all values of the parameters: tuned on few points, and proved on the whole box.

From the nominal point on, the worst points of the loop are looked for (those that are not stable first),
added to the points, and the values tuned again, until no worse point is found (Apkarian, Dao, Noll, IEEE
Transactions on Automatic Control 60, 2015). The search uses corners, random points, and ascents with
exact slopes. It proves nothing: at the end each goal is bounded for all values and all frequencies by
`worst_case_gain` and `worst_case`, and `verify` checks what is stored.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from mbdlft.base.array import Array
from mbdlft.base.errors import AnalysisError, StructureError, check_known
from mbdlft.base.parameter import to_delta, to_physical
from mbdlft.base.running import one_thread
from mbdlft.robust.ascent import largest_peak, smallest_crossing
from mbdlft.robust.bisect.search import check_numbers
from mbdlft.robust.evidence import Bounds
from mbdlft.robust.gain import worst_case_gain
from mbdlft.robust.realization import realization
from mbdlft.robust.worst import worst_case
from mbdlft.synthesis.bound import full_order_bound
from mbdlft.synthesis.evaluation import Look
from mbdlft.synthesis.goals import DESIGN, H2, HINF, MARGIN, POLES, Goal
from mbdlft.synthesis.loop import Connections, Network, closed_loop, first_points, network, screened
from mbdlft.synthesis.pieces import TunableSystem, tunable_gain
from mbdlft.synthesis.tuning import Tuned, Tuner, begun_again, check_stabilizable, taken_on, tuned
from mbdlft.system.model import System

_ROUNDS, _GROWING_ROUNDS = 80, 6  # of the worst-case loop; of a part of the box
_MOST_LOST = 12  # rounds in a row that leave a point of the box without stability, and are the last
_MOST_POINTS = 45  # beyond which the idle ones leave
_FAR = 4.0  # times what is tuned: where the box has more, it grows
_SIZES, _SLOW_SIZES = (0.4, 0.7, 1.0), (0.15, 0.3, 0.45, 0.6, 0.8, 1.0)  # of parts of the box
_NEAR = 1.1  # times what is tuned: where the box has no more, steps know how each gain bends
_COSTLY = 1.1  # times what is tuned at nominal: where the box has more, searches begin anew
_SHARES, _FAR_TOO_BAD = 20, 4.0  # of ways to points without stability; times what is tuned
_RADII, _MOVES = (0.3, 0.12, 0.05), 60  # of random moves from the worst points; how many
_PARTS = 4  # of the points of the whole box, each with its worst
_IDLE = 4  # searches in vain that end a search for the worst at most: one for each parameter beyond two
_REACHED = 1.0 + 1e-3  # what is said to be reached: hard goals are constraints of a search
_WORSE = 2e-3  # of a goal: a point that is worse by less is not added
_ENOUGH = 1.04  # of what no controller passes at nominal (by 1 % at least): no more searches begin below
_DECIDES = 0.9  # of the largest value: points below it are idle
Progress = Callable[[str], None]


@dataclass(frozen=True, slots=True, eq=False)
class Reached:
    """What a goal came to; values are at most 1 where it is reached.

    Attributes
    ----------
    goal : Goal
    tuned : float, the largest at the points that it was tuned on
    worst : float, the largest that was found in the box
    proved : float
        Not passed for all values of the parameters and all frequencies; inf without a proof.
    least : float
        No controller of any order, with these measurements, has a smaller value at the nominal point;
        0.0 if not known.
    loop : System
        From the weighted inputs to the weighted outputs of the goal.
    bounds : tuple of Bounds
        With the proofs; `verify(loop, bounds)` checks one.
    """

    goal: Goal
    tuned: float
    worst: float
    proved: float
    least: float
    loop: System
    bounds: tuple[Bounds, ...]

    @property
    def found(self) -> str:
        """What searches came to: all that an archive says, as proofs are checked when they are read."""
        kind = "hard" if self.goal.hard else "soft"
        return f"{self.goal.name} ({kind}): tuned {self.tuned:.4g}, worst found {self.worst:.4g}"

    @property
    def is_reached(self) -> bool:
        """Whether the worst value that was found is at most 1, or it is soft and finite."""
        return self.worst <= _REACHED if self.goal.hard else np.isfinite(self.worst)

    @property
    def missing(self) -> str:
        """What is not reached, or, of a hard goal, not proved to be below 1; else empty."""
        about = f"{'hard ' * self.goal.hard}goal {self.goal.name!r}"
        if not np.isfinite(self.worst):
            place = self.bounds[0].worst if self.bounds else {}
            point = ", ".join(f"{name} {value:.6g}" for name, value in (place or {}).items())
            return f"{about}: the loop is unstable{point and ' at '}{point}"
        if not self.is_reached:
            return f"{about}: not reached, {self.worst:.6g} > 1"
        if not (self.goal.hard and self.bounds) or self.proved <= 1.0:
            return ""
        ends = f"proved {self.proved:.4g}" if np.isfinite(self.proved) else "no proof"
        return f"{about}: reached {self.worst:.4g}, {ends}: it is not proved below 1"

    def __str__(self) -> str:
        text = self.found
        if np.isfinite(self.proved):
            text += f", proved <= {self.proved:.4g} for all values and frequencies"
        elif self.bounds:
            text += f", not proved: {self.bounds[0].reason}"
        return text + (f"; no controller below {self.least:.4g}" if self.least else "")


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Tuning:
    """Controllers, and what is known of their loops.

    Attributes
    ----------
    controllers : tuple of System
    values : mapping of names of free values to numbers; design parameters in their units
    goals : tuple of Reached
    points : tuple of mappings of names to values
        Of the parameters, where the loop was tuned: the nominal point, and worst ones.
    loop : System
        Closed, from the inputs of all goals to their outputs, without weights.
    """

    controllers: tuple[System, ...]
    values: Mapping[str, float]
    goals: tuple[Reached, ...]
    points: tuple[Mapping[str, float], ...]
    loop: System

    @property
    def soft(self) -> float:
        """The largest value of a soft goal that was found in the box; 0 if there is none."""
        return max((r.worst for r in self.goals if not r.goal.hard), default=0.0)

    @property
    def hard(self) -> float:
        """The same of hard goals, which are reached where it is at most 1."""
        return max((r.worst for r in self.goals if r.goal.hard), default=0.0)

    @property
    def missing(self) -> tuple[str, ...]:
        """What hard goals lack, reached or proved, and goals whose loops are unstable; else empty."""
        return tuple(sentence for reached in self.goals if (sentence := reached.missing))

    def __repr__(self) -> str:
        return "\n".join((*map(str, self.goals), *self.missing))


def tune(
    systems: Sequence[Any],
    goals: Sequence[Goal],
    connections: Connections,
    *,
    inputs: Sequence[str] = (),
    initial: Mapping[str, float] | None = None,
    leave_out: Sequence[str] = (),
    starts: int = 8,
    seed: int = 0,
    prove: bool = True,
    gap: float = 0.01,
    work: float = 30.0,
    workers: int | None = 1,
    progress: Progress | None = None,
) -> Tuning:
    """Choose the free values of controllers for goals, at the worst values of the parameters.

    The largest value of the soft goals is made small, where all hard goals are at most 1. Without soft
    goals the largest of the hard ones is.

    Parameters
    ----------
    systems : sequence of System, python-control systems, and controllers with free values
        Such as of `tunable_pid`. Parameters of the role ``design`` are free values, too; goals hold for
        all values of the others.
    goals : sequence of Goal
        Of `gain_goal`, `margin_goal`, `pole_goal`.
    connections : as of `connect`
        Inputs of systems that nothing drives are zero.
    inputs : sequence of str
        Inputs of the whole that stand in `connections`, and in no goal; those of goals are known.
    initial : mapping of names of free values to numbers, optional
        Where the first search begins, such as `Tuning.values` of an earlier one; design parameters in
        their units. Values that are not named have the initial ones of their controllers.
    leave_out : sequence of names of states, or "cyclic" for all that are only integrated
        States on which nothing else depends, such as positions of a free body: they count in no goal, and
        need not be stable.
    starts : int
        The first from the initial values, others from random ones.
    seed : int
    prove : bool
        Whether goals are proved on the box; those of poles and gains can be.
    gap, work, workers : as for `worst_case_gain`, of each proof
    progress : function of a text, optional

    Returns
    -------
    Tuning
        Also if hard goals are not reached: `Tuning.hard` says so.

    Raises
    ------
    StructureError
        A name is unknown, or nothing is free.
    AnalysisError
        No values were found with which the loops are stable: the message names the pole, and the point.
        A goal is an H2 norm with a direct path.
    """
    if not (isinstance(starts, int) and starts > 0):
        raise StructureError(f"tune: expected starts from 1 up, got {starts!r}.")
    if not (isinstance(seed, int) and seed >= 0):
        raise StructureError(f"tune: expected a seed from 0 up, got {seed!r}.")
    check_numbers("tune", gap=gap, work=work)
    say = progress or (lambda text: None)
    connected = partial(network, connections=connections, goals=goals, more=inputs, leave_out=leave_out)
    net = _begun_at(connected(systems), initial or {})
    sought = goals if any(not g.hard for g in goals) else [replace(g, hard=False) for g in goals]
    with one_thread():
        points = np.zeros((1, len(net.system.parameters)))
        first = Tuner(net, sought, points)
        first.check_fixed()
        least = least_values(net, goals, lambda: connected(as_matrices(systems)))
        enough = _ENOUGH * max((b for b, g in zip(least, sought, strict=True) if not g.hard), default=0.0)
        best = tuned(first, starts, seed, say, enough, lambda best: len(_growing(net, sought, best)) > 1)
        with suppress(KeyboardInterrupt):  # the best that is known is proved
            for later in _at_worst_points(net, sought, best, points, (starts, seed), say):
                best, points = later
        how = {"gap": gap, "work": work, "workers": workers} if prove else None
        return as_tuning(net, goals, best.x, points, least, how, say)


def as_tuning(
    net: Network,
    goals: Sequence[Goal],
    x: Array,
    points: Array,
    least: Sequence[float],
    how: Mapping[str, Any] | None,
    say: Progress = lambda text: None,
) -> Tuning:
    """What values reach: at points, in the box, and proved on it if it is said `how`."""
    reached = []
    for goal, bound in zip(goals, least, strict=True):
        if how is not None:
            say(f"proof of {goal.name}")
        reached.append(_reached(net, goal, x, points, bound, how))
    values = _values(net, x)
    controllers = tuple(c.with_values({v.name: values[v.name] for v in c.free}) for c in net.controllers)
    loop = closed_loop(net, Goal(HINF, "loop", net.inputs, net.outputs), x, net.system.name)
    physical = tuple(_physical(net, point) for point in points)
    return Tuning(controllers, values, tuple(reached), physical, loop)


def _begun_at(net: Network, initial: Mapping[str, float]) -> Network:
    """The network with other initial values."""
    check_known("value", initial, [value.name for value in net.free], "tune: initial", StructureError)
    numbers = {
        name: float(to_delta(net.design[name].parameter, value)) if name in net.design else value
        for name, value in initial.items()
    }
    free = tuple(
        replace(v, initial=float(np.clip(numbers.get(v.name, v.initial), v.low, v.high)))
        for v in net.free
    )
    return replace(net, free=free)


def _at_worst_points(
    net: Network, goals: Sequence[Goal], best: Tuned, points: Array, how: tuple[int, int], say: Progress
) -> Iterator[tuple[Tuned, Array]]:
    """Values tuned at more and more of the worst points of the box, and these points.

    Where the loop is far from what is tuned, the box grows from its middle, first along the parameters
    that are scheduled. Each part of it begins at some of its corners. Where the box costs much beside
    nominal, searches begin anew at the points that were found: other minima may cost less.
    """
    (starts, seed), nominal = how, best.look.soft
    growing = _growing(net, goals, best)
    for ends in growing:
        if len(growing) > 1:
            more = np.vstack([points, first_points(net, ends, seed)])
            with suppress(AnalysisError):  # no values for all: the worst are looked for one by one
                best, points = taken_on(Tuner(net, goals, more), best.x, starts, seed), more
        for later in _until_none_is_worse(net, goals, best, points, (ends, seed, starts), say):
            best, points = later
            yield later
    if _COSTLY * nominal < best.look.soft < np.inf and starts > 1:
        other = begun_again(Tuner(net, goals, points), starts, seed)
        if other is not None and other.rank() < best.rank():
            say(f"{len(points)} points, other starts, {_said(other.look)}")
            where = np.ones(points.shape[1]), seed, starts
            *_, (other, more) = _until_none_is_worse(net, goals, other, points, where, say)
            if other.rank() < best.rank():
                yield other, more


def _until_none_is_worse(
    net: Network,
    goals: Sequence[Goal],
    best: Tuned,
    points: Array,
    where: tuple[Array, int, int],
    say: Progress,
) -> Iterator[tuple[Tuned, Array]]:
    """Values tuned at more points of a part of the box, until no worse one is found."""
    ends, seed, starts = where
    safe, lost, idle = (np.inf, best), 0, 0
    is_whole = bool(np.all(ends == 1.0))
    enough = min(max(1, len(ends) - 2), _IDLE) if is_whole else 1
    for count in range(_ROUNDS if is_whole else _GROWING_ROUNDS):
        new, worst = _worst_points(net, goals, best, points, (ends, seed + count, starts))
        lost = lost + 1 if worst == np.inf else 0
        safe = min(safe, (worst, best), key=lambda pair: pair[0])
        say(f"{len(points)} points, {_said(best.look)}, worst {worst:.4g}, {len(new)} worse")
        idle = 0 if len(new) else idle + 1
        if lost > _MOST_LOST or idle >= enough:
            yield best, points
            return
        if idle:
            continue
        if len(points) > _MOST_POINTS:
            points = points[Tuner(net, goals, points).deciding(best.x, _DECIDES)]
        points = np.vstack([points, new])
        is_near = is_whole and worst <= _NEAR * max(best.look.soft, best.look.hard)
        best = taken_on(Tuner(net, goals, points), best.x, starts, seed, is_near=is_near)
        yield best, points
    yield safe[1], points


def _growing(net: Network, goals: Sequence[Goal], best: Tuned) -> list[Array]:
    """Ends of the boxes on which values are tuned, one after the other."""
    names = net.system.parameters.names
    whole = np.ones(len(names))
    if not names:
        return []
    largest = max(value for value, _ in Tuner(net, goals, screened(whole, 0)).worst(best.x))
    if largest <= _FAR * max(1.0 if np.isfinite(best.look.hard) else 0.0, best.look.soft):
        return [whole]
    first = net.scheduled
    if not 0.0 < np.sum(first) < len(names):
        return [size * whole for size in _SIZES]
    return [size * first for size in _SIZES] + [first + size * (1.0 - first) for size in _SLOW_SIZES]


def _said(look: Look) -> str:
    hard = f", hard goals {look.hard:.4g}" if np.isfinite(look.hard) else ""
    return (f"soft goals {look.soft:.4g}" if np.isfinite(look.soft) else "") + hard


def _values(net: Network, x: Array) -> dict[str, float]:
    return {
        value.name: net.design[value.name].physical(number) if value.name in net.design else float(number)
        for value, number in zip(net.free, x, strict=True)
    }


def _physical(net: Network, point: Array) -> dict[str, float]:
    return {p.name: float(to_physical(p, d)) for p, d in zip(net.system.parameters, point, strict=True)}


def _worst_points(
    net: Network, goals: Sequence[Goal], best: Tuned, points: Array, where: tuple[Array, int, int]
) -> tuple[Array, float]:
    """Points of a part of the box that are worse than those known, and the worst value there.

    They are the worst of each goal, or those at which the loop is least stable; an AnalysisError names
    one at which no values make it stable.
    """
    ends, seed, starts = where
    is_whole = bool(np.all(ends == 1.0))
    some = screened(ends, seed)
    screen = Tuner(net, goals, some)
    if len(unstable := screen.least_stable(best.x)):
        for delta in unstable:
            check_stabilizable(Tuner(net, goals, delta[None]), best.x, starts, seed)
        return np.array([_on_the_way(net, goals, best, delta) for delta in unstable]), np.inf
    loops = [closed_loop(net, goal, best.x, "loop") for goal in goals]
    if is_whole:
        crossing = smallest_crossing(realization(loops[0], range(len(loops[0].inputs))), 1.0)
        if np.isfinite(crossing.size):
            unstable = _in_order(net, loops[0], crossing.delta)
            return _on_the_way(net, goals, best, unstable)[None], np.inf
    found, worst = list[Array](), 0.0
    random = np.random.default_rng(seed)
    parts = [Tuner(net, goals, some[k::_PARTS]) for k in range(_PARTS)] if is_whole else [screen]
    begun = zip(*(part.worst(best.x) for part in parts), strict=True)
    for goal, loop, tops in zip(goals, loops, begun, strict=True):
        climbed = []
        for value, delta in tops:
            for radius in _RADII:
                moved = delta + radius * ends * random.standard_normal((_MOVES, len(ends)))
                moved = np.where(random.random(moved.shape) < 0.5, moved, delta)
                beside = Tuner(net, [goal], np.clip(moved, -ends, ends)).worst(best.x)[0]
                value, delta = max((value, delta), beside, key=lambda pair: pair[0])
            climbed.append((value, delta))
        value, delta = max(climbed, key=lambda pair: pair[0])
        if is_whole and goal.kind in (HINF, MARGIN) and np.isfinite(value):
            model = realization(loop, range(len(loop.inputs)), range(len(loop.outputs)))
            of_model = [net.system.parameters.names.index(name) for name in model.names]
            peak = largest_peak(model, 1.0, (delta[of_model],))
            if peak.gain / goal.limit > value:
                value, delta = peak.gain / goal.limit, _in_order(net, loop, peak.delta)
        worst = max(worst, value)
        known = max(1.0, best.look.hard) if goal.hard else best.look.soft
        is_new = np.min(np.max(np.abs(points - delta), axis=1)) > 0.0
        if value > known * (1.0 + _WORSE) and is_new:
            found.append(delta)
    return np.unique(np.array(found).reshape(-1, points.shape[1]), axis=0), worst


def _on_the_way(net: Network, goals: Sequence[Goal], best: Tuned, unstable: Array) -> Array:
    """A point on the way from the middle to one without stability: the last that is not far too bad.

    From there values are tuned without a new search for stable ones, which would lose what they reach.
    """
    shares = np.linspace(0.0, 1.0, _SHARES + 1)[1:, None]
    most = _FAR_TOO_BAD * max(best.look.soft, best.look.hard, 1.0)
    chosen = unstable
    for share in shares[::-1]:
        values = [value for value, _ in Tuner(net, goals, share * unstable[None]).worst(best.x)]
        chosen = share * unstable
        if max(values) <= most:
            break
    return chosen


def _in_order(net: Network, loop: System, delta: Array) -> Array:
    """Deltas of the blocks of a loop that are not empty, in the order of the parameters."""
    blocks = [block.name for block in loop.lft.blocks if block.size]
    by_name = dict(zip(blocks, delta, strict=True))
    return np.array([by_name.get(name, 0.0) for name in net.system.parameters.names])


def _reached(
    net: Network, goal: Goal, x: Array, points: Array, least: float, how: Mapping[str, Any] | None
) -> Reached:
    """A goal at values: at the points, in the box, and proved."""
    loop = closed_loop(
        net, None if goal.kind in (POLES, DESIGN) else goal, x, f"{net.system.name}: {goal.name}"
    )
    (tuned_to, _), (found, _) = (
        Tuner(net, [goal], some).worst(x)[0] for some in (points, screened(np.ones(points.shape[1]), 0))
    )
    worst, proved = max(tuned_to, found), np.inf
    if goal.kind == DESIGN:  # nothing else than the values is in it
        return Reached(goal, worst, worst, worst, least, loop, ())
    bounds = () if how is None else tuple(_bounds(loop, goal, how))
    if bounds:
        claimed, attained = zip(*(_ratios(goal, b) for b in bounds), strict=True)
        worst = max(worst, *attained)
        proved = max(claimed) if np.isinf(goal.speed) else np.inf
    return Reached(goal, tuned_to, worst, proved, least, loop, bounds)


def as_matrices(systems: Sequence[Any]) -> list[Any]:
    """Systems with matrices in place of controllers with free values."""
    return [tunable_gain(s.name, *s.channels) if isinstance(s, TunableSystem) else s for s in systems]


def least_values(
    net: Network, goals: Sequence[Goal], with_matrices: Callable[[], Network]
) -> list[float]:
    """What no controllers with the same measurements pass at nominal; 0 where that is not known."""
    if net.design:
        return [0.0] * len(goals)
    opened = with_matrices()
    return [full_order_bound(opened, [g]) if g.kind in (HINF, MARGIN) else 0.0 for g in goals]


def _bounds(loop: System, goal: Goal, how: Mapping[str, Any]) -> list[Bounds]:
    if goal.kind in (HINF, MARGIN):
        return [worst_case_gain(loop, **how)]
    if goal.kind == H2:
        return [worst_case(loop, "H2 norm", **how)]
    asked = {"real part": goal.decay, "damping": goal.damping}
    return [worst_case(loop, what, **how) for what, number in asked.items() if number]


def _ratios(goal: Goal, bounds: Bounds) -> tuple[float, float]:
    """The value that is proved, and that which is reached."""
    if goal.kind in (HINF, MARGIN, H2):
        ends = bounds.upper / goal.limit, bounds.lower / goal.limit
    elif bounds.is_from_above:
        ends = _over(goal.decay, -bounds.upper), _over(goal.decay, -bounds.lower)
    else:
        ends = _over(goal.damping, bounds.lower), _over(goal.damping, bounds.upper)
    return (ends[0] if bounds.proved else np.inf), ends[1]


def _over(wanted: float, has: float) -> float:
    return wanted / has if has > 0.0 else np.inf
