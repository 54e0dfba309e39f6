"""Controllers for all values of the parameters: tuned on few points, and proved on the whole box.

From the nominal point on, the worst points of the loop are looked for (those that are not stable first),
added to the points, and the values tuned again, until no worse point is found (Apkarian, Dao, Noll, IEEE
Transactions on Automatic Control 60, 2015). Values that are given and good in the whole box are tuned at
its worst points from the first, and not given up for worse ones. The search uses corners, random points,
and ascents with exact slopes. It proves nothing: at the end each goal is bounded for all values and all
frequencies by `worst_case_gain` and `worst_case`, and `verify` checks what is stored.
"""

import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from mbdlft.base.arguments import arguments_checked
from mbdlft.base.array import Array
from mbdlft.base.errors import AnalysisError, MbdlftWarning, StructureError, check_known
from mbdlft.base.parameter import is_finite, to_delta
from mbdlft.base.running import one_thread
from mbdlft.base.worker import processes_of
from mbdlft.robust.ascent import largest_peak, smallest_crossing
from mbdlft.robust.bisect.search import INTERRUPTED, check_numbers, crew_of
from mbdlft.robust.gain import worst_case_gain
from mbdlft.robust.realization import realization
from mbdlft.synthesis.evaluation import Look
from mbdlft.synthesis.goals import HINF, MARGIN, Goal
from mbdlft.synthesis.loop import Connections, Network, closed_loop, first_points, network, screened
from mbdlft.synthesis.lpv import reduced_values
from mbdlft.synthesis.reached import Progress, Tuning, as_matrices, as_tuning, least_values
from mbdlft.synthesis.starts import (
    Way,
    begun,
    begun_again,
    better_from,
    check_stabilizable,
    taken_on,
    tuned,
)
from mbdlft.synthesis.tuning import Tuned, Tuner

_ROUNDS, _GROWING_ROUNDS = 80, 6  # of the worst-case loop; of a part of the box
_MOST_LOST = 12  # rounds in a row that leave a point of the box without stability, and are the last
_MOST_POINTS = 45  # beyond which the idle ones leave, where no other is far worse
_FAR = 4.0  # times what is tuned: where the box has more, it grows
_SIZES, _SLOW_SIZES = (0.4, 0.7, 1.0), (0.15, 0.3, 0.45, 0.6, 0.8, 1.0)  # of parts of the box
_NEAR = 1.1  # times what is tuned: where the box has no more, gains bend in steps, and all parts count
_COSTLY = 1.01  # times what is tuned at nominal: where the box has more, searches begin anew
_SHARES, _FAR_TOO_BAD = 20, 4.0  # of ways to points without stability; times what is tuned
_RADII, _MOVES = (0.3, 0.12, 0.05), 60  # of random moves from the worst points; how many
_PARTS = 4  # of the points of the whole box, each with its worst
_IDLE = 4  # searches in vain that end a search for the worst at most: one for each parameter beyond two
_LOOK = 0.3  # units of work of a search as a proof begins with: it sees peaks that climbs do not
_WORSE = 2e-3  # of a goal: a point that is worse by less is not added
_FULL = 1.1  # times what no controller passes: above it one of full order is reduced
_ENOUGH = 1.04  # of what no controller passes at nominal (by 1 % at least): no more searches begin below
_DECIDES = 0.9  # of the largest value: points below it are idle


@arguments_checked
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
        Inputs of systems that nothing drives are zero; a channel of a controller that is not connected
        is an error.
    inputs : sequence of str
        Inputs of the whole that stand in `connections`, and in no goal; those of goals are known.
    initial : mapping of names of free values to numbers, optional
        Where the first search begins, such as `Tuning.values` of an earlier one; design parameters in
        their units. Values that are not named have the initial ones of their controllers. Where they
        are about as good in the whole box as at nominal, the search begins at its worst points.
    leave_out : sequence of names of states, or "cyclic" for all that are only integrated
        States on which nothing else depends, such as positions of a free body: they count in no goal, and
        need not be stable.
    starts : int
        The first from the initial values, as many as half from random ones, and the others from the
        best of these, with other signs and sizes. Where these are far above what no controller passes,
        one more begins at a controller of full order that is reduced (`lpv_synthesis`).
    seed : int
    prove : bool
        Whether goals are proved on the box; those of poles and gains can be.
    gap, work : as for `worst_case_gain`, of each proof
    workers : int, or None for one for each core
        Processes that take starts, searches for the worst of several goals, and proofs. What is found
        does not depend on it.
    progress : function of a text, optional

    Returns
    -------
    Tuning
        Also if hard goals are not reached: `Tuning.hard` says so.

    Raises
    ------
    StructureError
        A name is unknown, a controller is not connected, or nothing is free.
    AnalysisError
        No values were found with which the loops are stable: the message names the pole, and the point.
        A goal is an H2 norm with a direct path.

    Warns
    -----
    MbdlftWarning
        Values that no goal limits would be better still ten times as large.
    """
    if isinstance(starts, bool) or not (isinstance(starts, int | np.integer) and starts > 0):
        raise StructureError(f"tune: expected starts from 1 up, got {starts!r}.")
    if isinstance(seed, bool) or not (isinstance(seed, int | np.integer) and seed >= 0):
        raise StructureError(f"tune: expected a seed from 0 up, got {seed!r}.")
    check_numbers("tune", gap=gap, work=work)
    say = progress or (lambda text: None)
    connected = partial(network, connections=connections, goals=goals, more=inputs, leave_out=leave_out)
    net = _begun_at(connected(systems), initial or {})
    sought = goals if any(not g.hard for g in goals) else [replace(g, hard=False) for g in goals]
    processes = processes_of(workers, "tune")
    at_once = 2 * processes if processes > 1 else 1  # starts: the long ones then wait for fewer others
    with one_thread(), crew_of(workers, None, "tune") as crew:
        way = Way(starts, seed, crew, at_once)
        first = Tuner(net, sought, np.zeros((1, len(net.system.parameters))))
        first.check_fixed()
        least = least_values(net, goals, lambda: connected(as_matrices(systems)))
        soft = [bound for bound, goal in zip(least, sought, strict=True) if not goal.hard]
        nominal, known = max(soft, default=0.0), list[tuple[Tuned, Array]]()
        try:
            given = systems, sought, connections, inputs, leave_out
            task = _Task(net, sought, way, say, partial(reduced_values, *given))
            for later in _improved(task, first, nominal, is_given=bool(initial)):
                known = [later]
        except KeyboardInterrupt:  # the best that is known is proved
            if not known:
                raise
    [(best, points)] = known
    with one_thread():
        if text := Tuner(net, sought, points).endless(best.x):
            warnings.warn(text, MbdlftWarning, stacklevel=3)
        proofs = {"gap": gap, "work": work, "workers": workers} if prove else None
        return as_tuning(net, goals, best.x, points, least, proofs, say)


class _Task(NamedTuple):
    """What is tuned, the way of it, and what hears of it; whether values that are good are given."""

    net: Network
    goals: Sequence[Goal]
    way: Way
    say: Progress
    full_order: Callable[[], Mapping[str, float]] = dict  # values near those of full order
    is_given: bool = False

    def tuner(self, points: Array) -> Tuner:
        """What tunes at points."""
        return Tuner(self.net, self.goals, points)


def _improved(
    task: _Task, first: Tuner, nominal: float, *, is_given: bool
) -> Iterator[tuple[Tuned, Array]]:
    """Better and better values, and the points they were tuned at: the nominal one, then worst ones."""
    best, points = first.at(next(begun(first, 1, task.way.seed))), first.points
    if is_given and _is_good(task, best):
        task, points = task._replace(is_given=True), _deciding(task, best)
        yield best, points
    else:
        for best in tuned(
            first, task.way, task.say, _ENOUGH * nominal, lambda best: len(_growing(task, best)) > 1
        ):
            yield best, points
        is_far = best.look.soft > _FULL * nominal > 0.0 and task.way.starts > 1
        if is_far and (values := task.full_order()):
            x = np.array([values.get(value.name, value.initial) for value in task.net.free])
            best = better_from(first, x, best, task.way)
            task.say(f"from a controller of full order, best {best.look.soft:.4g}")
            yield best, points
        nominal = best.look.soft
    yield from _at_worst_points(task, (best, points), nominal)


def _begun_at(net: Network, initial: Mapping[str, float]) -> Network:
    """The network with other initial values."""
    check_known("value", initial, [value.name for value in net.free], "tune: initial", StructureError)
    for name, value in initial.items():
        if not is_finite(value):
            raise StructureError(f"tune: initial: {name!r}: expected a finite number, got {value!r}.")
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
    task: _Task, begun: tuple[Tuned, Array], nominal: float
) -> Iterator[tuple[Tuned, Array]]:
    """Values tuned at more and more of the worst points of the box, and these points.

    Where the loop is far from what is tuned, the box grows from its middle, first along the parameters
    that are scheduled. Each part of it begins at some of its corners. Where the box costs much beside
    nominal, searches begin anew at the points that were found: other minima may cost less.
    """
    best, points = begun
    growing = _growing(task, best)
    for ends in growing:
        if len(growing) > 1:
            more = np.vstack([points, first_points(task.net, ends, task.way.seed)])
            with suppress(AnalysisError):  # no values for all: the worst are looked for one by one
                best, points = taken_on(task.tuner(more), best.x, task.way), more
        for later in _until_none_is_worse(task, (best, points), ends):
            best, points = later
            yield later
    if not (_COSTLY * nominal < best.look.soft < np.inf and task.way.starts > 1):
        return
    other = begun_again(task.tuner(points), best.x, task.way)
    if other is not None and other.rank() < best.rank():
        task.say(f"{len(points)} points, other starts, {_said(other.look)}")
        ends = np.ones(points.shape[1])
        *_, (other, more) = _until_none_is_worse(task._replace(is_given=False), (other, points), ends)
        if other.rank() < best.rank():
            yield other, more


def _until_none_is_worse(
    task: _Task, begun: tuple[Tuned, Array], ends: Array
) -> Iterator[tuple[Tuned, Array]]:
    """Values tuned at more points of a part of the box, until no worse one is found.

    Where they are given, and good in the box, they are tuned until a descent gains little. Each begins at
    those that are best at the points: the last ones, or the ones with the least worst that is known. So
    what they reach stays.
    """
    best, points = begun
    safe, lost, idle, gains = (np.inf, best), 0, 0, task.is_given
    is_whole = bool(np.all(ends == 1.0))
    enough = min(max(1, len(ends) - 2), _IDLE) if is_whole else 1
    for count in range(_ROUNDS if is_whole else _GROWING_ROUNDS):
        new, worst = _worst_points(task, best, points, ends, task.way.seed + count)
        lost = lost + 1 if worst == np.inf else 0
        safe = min(safe, (worst, best), key=lambda pair: pair[0])
        task.say(f"{len(points)} points, {_said(best.look)}, worst {worst:.4g}, {len(new)} worse")
        idle = 0 if len(new) or gains else idle + 1
        if lost > _MOST_LOST or idle >= enough:
            yield (safe[1] if safe[0] < worst == np.inf else best), points
            return
        if idle:
            continue
        if len(points) > _MOST_POINTS and worst <= _FAR * max(best.look.soft, best.look.hard):
            points = points[task.tuner(points).deciding(best.x, _DECIDES)]
        points = np.vstack([points, new])
        is_near = is_whole and worst <= _NEAR * max(best.look.soft, best.look.hard)
        tuner, begin = task.tuner(points), best
        if task.is_given:
            begin = min((tuner.at(each.x) for each in (best, safe[1])), key=Tuned.rank)
        best = taken_on(tuner, begin.x, task.way, is_near=is_near)
        gains = task.is_given and best.look.soft < (1.0 - _WORSE) * begin.look.soft
        yield best, points
    yield safe[1], points


def _is_good(task: _Task, given: Tuned) -> bool:
    """Whether values are about as good in the whole box as at nominal."""
    is_finite = max(given.look.soft, given.look.hard) < np.inf
    return is_finite and len(_growing(task, given)) == 1


def _deciding(task: _Task, given: Tuned) -> Array:
    """The nominal point, and of a grid and of random points those that decide."""
    whole = np.ones(len(task.net.system.parameters))
    some = np.vstack([0.0 * whole, first_points(task.net, whole, 0), screened(whole, 0)])
    return some[task.tuner(some).deciding(given.x, _DECIDES)]


def _growing(task: _Task, best: Tuned) -> list[Array]:
    """Ends of the boxes on which values are tuned, one after the other."""
    names = task.net.system.parameters.names
    whole = np.ones(len(names))
    if not names:
        return []
    largest = max(value for value, _ in task.tuner(screened(whole, 0)).worst(best.x))
    if largest <= _FAR * max(1.0 if np.isfinite(best.look.hard) else 0.0, best.look.soft):
        return [whole]
    first = task.net.scheduled
    if not 0.0 < np.sum(first) < len(names):
        return [size * whole for size in _SIZES]
    return [size * first for size in _SIZES] + [first + size * (1.0 - first) for size in _SLOW_SIZES]


def _said(look: Look) -> str:
    hard = f", hard goals {look.hard:.4g}" if np.isfinite(look.hard) else ""
    return (f"soft goals {look.soft:.4g}" if np.isfinite(look.soft) else "") + hard


def _worst_points(task: _Task, best: Tuned, points: Array, ends: Array, seed: int) -> tuple[Array, float]:
    """Points of a part of the box that are worse than those known, and the worst value there.

    They are the worst of each goal, or those at which the loop is least stable; an AnalysisError names
    one at which no values make it stable.
    """
    is_whole, (net, goals, way, *_) = bool(np.all(ends == 1.0)), task
    some = screened(ends, seed)
    screen = task.tuner(some)
    if len(unstable := screen.least_stable(best.x)):
        for delta in unstable:
            check_stabilizable(task.tuner(delta[None]), best.x, way._replace(seed=seed))
        return np.array([_on_the_way(net, goals, best, points, delta) for delta in unstable]), np.inf
    if is_whole:
        loop = closed_loop(net, goals[0], best.x, "loop")
        model = realization(loop, range(len(loop.inputs)))
        crossing = smallest_crossing(model, 1.0)
        if np.isfinite(crossing.size):
            unstable = _in_order(net, dict(zip(model.names, crossing.delta, strict=True)))
            return _on_the_way(net, goals, best, points, unstable)[None], np.inf
    parts = [task.tuner(some[k::_PARTS]) for k in range(_PARTS)] if is_whole else [screen]
    tops = zip(*(part.worst(best.x) for part in parts), strict=True)
    of_goals = enumerate(zip(goals, tops, strict=True))
    climbs = [(net, goal, best.x, top, ends, (seed, k)) for k, (goal, top) in of_goals]
    found, worst = list[Array](), 0.0
    reached = {True: max(1.0, best.look.hard), False: best.look.soft}  # by hard goals, and by soft ones
    for goal, climbed in zip(goals, way.crew(_climbed, climbs), strict=True):
        worst, known, worse = max(worst, climbed[0][0]), reached[goal.hard], list[Array]()
        for value, delta in climbed if climbed[0][0] <= _NEAR * known else climbed[:1]:
            is_apart = all(np.max(np.abs(delta - other)) > _RADII[0] for other in worse)
            if value > known * (1.0 + _WORSE) and is_apart:
                worse.append(delta)
        found += [delta for delta in worse if np.min(np.max(np.abs(points - delta), axis=1)) > 0.0]
    if is_whole and not found and net.system.parameters:
        gains = [goal for goal in goals if goal.kind == HINF]
        searched = way.crew(_searched, [(net, goal, best.x) for goal in gains])
        for goal, (value, delta) in zip(gains, searched, strict=True):
            if value > reached[goal.hard] * (1.0 + _WORSE):
                found.append(delta)
                worst = max(worst, value)
    return np.unique(np.array(found).reshape(-1, points.shape[1]), axis=0), worst


def _climbed(
    net: Network,
    goal: Goal,
    x: Array,
    tops: Sequence[tuple[float, Array]],
    ends: Array,
    seed: tuple[int, int],
) -> list[tuple[float, Array]]:
    """Values of a goal with their points, the largest first: moved at random, and the first climbed."""
    random, climbed = np.random.default_rng(seed), list[tuple[float, Array]]()
    for value, delta in tops:
        for radius in _RADII:
            moved = delta + radius * ends * random.standard_normal((_MOVES, len(ends)))
            moved = np.where(random.random(moved.shape) < 0.5, moved, delta)
            beside = Tuner(net, [goal], np.clip(moved, -ends, ends)).worst(x)[0]
            value, delta = max((value, delta), beside, key=lambda pair: pair[0])
        climbed.append((value, delta))
    climbed.sort(key=lambda pair: -pair[0])
    value, delta = climbed[0]
    if np.all(ends == 1.0) and goal.kind in (HINF, MARGIN) and np.isfinite(value):
        loop = closed_loop(net, goal, x, "loop")
        model = realization(loop, range(len(loop.inputs)), range(len(loop.outputs)))
        of_model = [net.system.parameters.names.index(name) for name in model.names]
        peak = largest_peak(model, 1.0, (delta[of_model],))
        if peak.gain / goal.limit > value:
            by_name = dict(zip(model.names, peak.delta, strict=True))
            climbed[0] = peak.gain / goal.limit, _in_order(net, by_name)
    return climbed


def _searched(net: Network, goal: Goal, x: Array) -> tuple[float, Array]:
    """What the search with which a proof begins reaches of a gain, and where."""
    seen = worst_case_gain(closed_loop(net, goal, x, "loop"), work=_LOOK)
    if seen.reason == INTERRUPTED:
        raise KeyboardInterrupt
    return seen.lower / goal.limit, np.clip(_in_order(net, seen.delta), -1.0, 1.0)


def _on_the_way(
    net: Network, goals: Sequence[Goal], best: Tuned, points: Array, unstable: Array
) -> Array:
    """A point on the way from the middle to one without stability: the last that is not far too bad.

    From there values are tuned without a new search for stable ones, which would lose what they reach.
    Beyond a point that they were tuned at, it is the next at which loops are stable.
    """

    def worst(share: float) -> float:
        return max(value for value, _ in Tuner(net, goals, share * unstable[None]).worst(best.x))

    shares = np.linspace(0.0, 1.0, _SHARES + 1)
    most = _FAR_TOO_BAD * max(best.look.soft, best.look.hard, 1.0)
    k = next((k for k in range(_SHARES, 1, -1) if worst(shares[k]) <= most), 1)
    if k == _SHARES or not np.any(np.all(points == shares[k] * unstable, axis=1)):
        return np.asarray(shares[k] * unstable)
    known, beyond = shares[k : k + 2]
    while worst(beyond) == np.inf and known < (middle := 0.5 * (known + beyond)) < beyond:
        beyond = middle
    return np.asarray(beyond * unstable)


def _in_order(net: Network, by_name: Mapping[str, Any]) -> Array:
    """Deltas of the blocks of a loop in the order of the parameters; 0 of those it does not depend on."""
    return np.array([by_name.get(name, 0.0) for name in net.system.parameters.names])
