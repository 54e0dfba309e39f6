"""From starts to the best values: a rough descent from each, of which the best two are taken on.

The first start has the initial values, others are random. As many again are the best of these with other
signs and sizes: of two inputs, each may do what the other did. The best of all are taken on with other
numbers of pieces until that gains nothing. Where the whole box is not much worse than tuned, many gains
are equal: steps that know how each of them bends follow (`sqcqp`).
"""

from collections.abc import Callable, Iterator, Sequence
from copy import copy
from typing import NamedTuple

import numpy as np

from mbdlft.base.array import Array
from mbdlft.base.errors import AnalysisError
from mbdlft.robust.bisect.boxes import Crew
from mbdlft.robust.bisect.search import by_itself
from mbdlft.synthesis.conic import sqcqp
from mbdlft.synthesis.descent import bfgs, sqp
from mbdlft.synthesis.goals import H2
from mbdlft.synthesis.tuning import ROUNDS, STEPS, Plan, Tuned, Tuner, stabilized_beside

_FIRST_STEPS, _ROUGH = 80, 1e-5  # tolerance of the merit while points are added
_LEAST = 0.1  # of the first scale of a value: it is not smaller when it is turned
_BEST = 2  # of the first descents are taken on by a round, and the better one by more
# from the first start both, from the others one or the other
_PLANS: tuple[Plan, Plan] = ([(sqp, 0.9)], [(bfgs, 0.9), (sqp, 0.7)])
_TAKEN_ON: Plan = ((sqp, 0.8), (sqp, 0.7))  # of values that come from fewer points
_NEAR_END: Plan = ((sqp, 0.8), (sqcqp, 0.7))  # the same near the end, where many gains are equal
Told = Callable[[str], None]


class Way(NamedTuple):
    """How values are sought: from so many starts, by a seed; a crew takes some of them at once.

    What is found does not depend on the crew: starts after one that is good enough are not taken.
    """

    starts: int
    seed: int
    crew: Crew = by_itself
    at_once: int = 1


def begun(tuner: Tuner, starts: int, seed: int) -> Iterator[Array]:
    """Where searches begin: the initial values, then random ones in their ranges.

    Their sizes are those of the scales, up to a factor of ten either way for each value: scales are
    guesses, and other minima often lie where some values are much larger than others.
    """
    random = np.random.default_rng(seed)
    initial = np.array([value.initial for value in tuner.net.free])
    yield initial
    for _ in range(starts - 1):
        sizes = tuner.first_scale * 10.0 ** random.uniform(-1.0, 1.0, len(initial))
        x = initial + sizes * random.standard_normal(len(initial))
        yield np.clip(x, tuner.low, tuner.high)


def turned(tuner: Tuner, x: Array, count: int, seed: int) -> list[Array]:
    """Values x with random signs, and sizes up to a factor of ten either way, in their ranges.

    Other minima often have values of such sizes: of two inputs of a plant each may do what the other did.
    What leaves a range is reflected at its end, or anywhere in it.
    """
    random, low, high = np.random.default_rng([seed, 1]), tuner.low, tuner.high
    sizes, shape = np.maximum(np.abs(x), _LEAST * tuner.first_scale), (count, len(x))
    starts = random.choice([-1.0, 1.0], shape) * sizes * 10.0 ** random.uniform(-1.0, 1.0, shape)
    starts = 2.0 * np.clip(starts, low, high) - starts
    first, last = (np.where(np.isfinite(high - low), end, 0.0) for end in (low, high))
    anywhere = first + (last - first) * random.random(shape)  # of a range with two ends
    return [*np.clip(np.where((starts < low) | (starts > high), anywhere, starts), low, high)]


def _stable(tuner: Tuner, start: Array) -> tuple[Array, float]:
    with tuner.in_doubles(start):
        return copy(tuner).stabilized(start)


def _rough(tuner: Tuner, x: Array, plan: Plan) -> Tuned:
    with tuner.in_doubles(x):
        return copy(tuner).descended(x, plan, STEPS, is_first=True, tolerance=_ROUGH)


def _polished(tuner: Tuner, best: Tuned) -> tuple[Array, Array]:
    """Values after a first round, and the frequencies that the grid needs to have there."""
    own = copy(tuner)
    return own.polished(best, range(1)).x, own.asked.extra


End = tuple[Array, float, list[Tuned]]  # values, as stable as they get, their real part, where they lead


def _from_starts(tuner: Tuner, way: Way) -> Iterator[End]:
    """The ends of random starts, and then of as many that the best of these is turned to."""
    starts, found = [*begun(tuner, way.starts, way.seed)], list[Tuned]()
    half = len(starts) - len(starts) // 2
    for end in _ends(tuner, way, starts[:half], 0):
        found += end[2]
        yield end
    others = starts[half:]
    if found:
        others = turned(tuner, min(found, key=Tuned.rank).x, len(others), way.seed)
    yield from _ends(tuner, way, others, half)


def _ends(tuner: Tuner, way: Way, starts: Sequence[Array], before: int) -> Iterator[End]:
    """The ends of starts after so many others.

    The first of all is taken with both plans, the others with one or the other.
    """
    done = 0
    while done < len(starts):
        some = starts[done : done + (way.at_once if before + done else 1)]
        ends = way.crew(_stable, [(tuner, start) for start in some])
        tasks = [
            (k, (tuner, x, plan))
            for k, (x, real) in enumerate(ends, before + done)
            for plan in (_PLANS if not k else (_PLANS[k % 2],))
            if real < 0.0
        ]
        reached = way.crew(_rough, [task for _, task in tasks])
        for k, (x, real) in enumerate(ends, before + done):
            yield x, real, [best for best, (start, _) in zip(reached, tasks, strict=True) if start == k]
        done += len(some)


def tuned(
    tuner: Tuner,
    way: Way,
    say: Told,
    enough: float = 0.0,
    is_rough: Callable[[Tuned], bool] = lambda best: False,
) -> Iterator[Tuned]:
    """The best of the starts so far, and at last the best of several taken on.

    No more searches begin when soft goals are at most `enough`. Nothing is taken on where it `is_rough`.
    An AnalysisError says that no start led to stable loops, and which pole is on the right.
    """
    found: list[Tuned] = []
    nearest = (np.inf, np.zeros(len(tuner.net.free)))
    for count, (x, real, reached) in enumerate(_from_starts(tuner, way), 1):
        found += reached
        if not reached:
            nearest = min(nearest, (real, x), key=lambda pair: pair[0])
            say(f"start {count} of {way.starts}, not stable: real part {real:.3g}")
            continue
        best = min(found, key=Tuned.rank)
        yield best
        say(f"start {count} of {way.starts}, best {best.look.soft:.4g}")
        if best.rank() <= (0.0, enough):
            break
    if not found:
        raise AnalysisError(tuner.unstable(nearest[1]))
    if not is_rough(best):
        best = tuner.polished(_polished_once(tuner, found, way), range(1, ROUNDS))
    for goal, (value, _) in zip(tuner.goals, tuner.worst(best.x), strict=True):
        if value == np.inf:
            raise AnalysisError(
                f"tune: goal {goal.name!r}: the H2 norm is infinite, as there is a direct path from its "
                "inputs to its outputs. Give a weight with more poles than zeros, before or after."
                if goal.kind == H2
                else f"tune: goal {goal.name!r}: it is not finite beside its limit, {goal.limit:g}."
            )
    yield best


def _polished_once(tuner: Tuner, found: Sequence[Tuned], way: Way) -> Tuned:
    """The best of the best ones after a round, with the frequencies that all of them need."""
    ends = way.crew(_polished, [(tuner, best) for best in sorted(found, key=Tuned.rank)[:_BEST]])
    tuner.asked = tuner.asked._replace(extra=np.unique(np.concatenate([seen for _, seen in ends])))
    return min((tuner.at(x) for x, _ in ends), key=Tuned.rank)


def check_stabilizable(tuner: Tuner, x: Array, way: Way) -> None:
    """An AnalysisError says that loops were made stable neither from values x nor from other starts.

    What no values can move at the first point is said before.
    """
    tuner.check_fixed()
    ends = []
    for start in (x, *begun(tuner, way.starts, way.seed)):
        values, real = tuner.stabilized(start)
        if real < 0.0:
            return
        ends.append((real, values))
    raise AnalysisError(tuner.unstable(min(ends, key=lambda end: end[0])[1]))


def taken_on(tuner: Tuner, x: Array, way: Way, *, is_near: bool = False) -> Tuned:
    """Values of other points, made stable at these and tuned; from new starts, where that fails."""
    stable = x if tuner.at(x).look.is_stable else stabilized_beside(tuner, x)
    if stable is None:
        stable, real = tuner.stabilized(x)
        if real >= 0.0:
            *_, best = tuned(tuner, way, lambda text: None)
            return best
    return tuner.descended(stable, _NEAR_END if is_near else _TAKEN_ON, _FIRST_STEPS, tolerance=_ROUGH)


def better_from(tuner: Tuner, x: Array, best: Tuned, way: Way) -> Tuned:
    """The best that is known, or that values x lead to; they are taken on where they come below it."""
    x, real = _stable(tuner, np.clip(x, tuner.low, tuner.high))
    found = way.crew(_rough, [(tuner, x, plan) for plan in _PLANS]) if real < 0.0 else []
    other = _polished_once(tuner, found, way) if found else best
    return tuner.polished(other, range(1, ROUNDS)) if other.rank() < best.rank() else best


def begun_again(tuner: Tuner, x: Array, way: Way) -> Tuned | None:
    """The best from random starts, and from others that values x are turned to.

    None if no loop became stable.
    """
    others = way.starts // 2
    starts = [*begun(tuner, way.starts - others, way.seed)][1:] + turned(tuner, x, others, way.seed)
    ends = way.crew(_stable, [(tuner, start) for start in starts])
    found = way.crew(_rough, [(tuner, x, _PLANS[0]) for x, real in ends if real < 0.0])
    return tuner.polished(min(found, key=Tuned.rank)) if found else None
