"""Margins and gains by multipliers: for blocks of all kinds, and for many parameters.

What is proved are sizes of the blocks that grow (`mbdlft.robust.mu.coverage`): first of the whole box,
then of its parts. They are bounded from above by deltas that make the loop singular, or, for parameters
only, that move a pole to the axis. A gain is one over such a size.

No model of a part of the box has a pole on the axis, or is singular, if multipliers prove so on intervals
that cover all frequencies. A part on which they do not suffice is cut along the parameter for which the
bounds of both halves are smallest. A half inherits the intervals of its part: only frequencies that are
open are looked at again. Parts cover the box, which is connected, and its middle is stable: so is all of
it. (Branch and bound for mu: Newlin, Young, Int. J. Robust and Nonlinear Control 7, 1997; here parts have
intervals of frequency in place of one frequency.) Parts are tried in batches that do not depend on how
many processes there are.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np

from mbdlft.base.array import Array
from mbdlft.base.running import after
from mbdlft.response.norms import peak_of
from mbdlft.response.staircase import Plant
from mbdlft.robust.ascent import NONE, Crossing, improved, largest_peak, smallest_crossing
from mbdlft.robust.bisect.boxes import Crew
from mbdlft.robust.bisect.characteristic import Realization
from mbdlft.robust.bisect.search import (
    UNSTABLE,
    Asked,
    Search,
    Signals,
    State,
    bounds_of,
    enlarged,
    last_of,
)
from mbdlft.robust.evidence import Bounds, Interval, IntervalProof, Multipliers
from mbdlft.robust.mu.coverage import (
    GAIN,
    Cover,
    Loop,
    Part,
    cost_at,
    covered,
    covers,
    ends_of,
    extent_of,
    first_frequencies,
    inside,
    looks,
    matrix_at,
    multipliers_of,
    scaled,
    shrunk,
)
from mbdlft.robust.mu.intervals import holds, interval_around
from mbdlft.robust.mu.multipliers import energies_of, fits
from mbdlft.robust.mu.small_delta import SmallDelta, best_near, by_name, changes, first_reached, nothing
from mbdlft.robust.realization import realization
from mbdlft.system.conversion import positions_of

_BATCH = 8  # parts at a time, whatever the number of workers: results do not depend on it
_SMALLEST = 2.0**-16  # of the box: a part of this size is not cut again
_TOLERANCE = 0.02  # of bounds of mu that decide whether a part is cut
_ROUGH = 3  # parts one in the other at which rounding may fail
_CANDIDATES, _IDLE = 4, 0.05  # parameters whose halves are tried; less of the largest part: not tried
_STEEP = 7.0  # exponent of a bound: parts double with each 10 % of it
_OFTEN = 4  # batches from one to the next that is looked at for a counterexample
_INSIDE = 1.0 - 1e-15  # a size is not above what was proved, however it was rounded
_RANGE = 1e6  # times the gain of nominal values: a size below one over that is not looked for
_INTO_GAP = 0.999  # part of the gap between what is reached and what is tried: all of it
_BALL = 0.1  # of the size that the norm proves, which is not asked for: eigenvalues need room
_SMALLER, _LEAST_BALL = 0.3, 1e-12  # factor from one such size to the next, and the least
_REACH = 0.1  # units of work of a search for small deltas
_LARGEST_SHARE = 0.5  # of the work, for the largest size: smaller ones need fewer frequencies


class Attempt(NamedTuple):
    """What came of an attempt to prove a box."""

    # covers of all parts, and the blocks that these are cut along, depth first; None: one resisted, or is
    # unstable
    covers: Sequence[tuple[Cover, int]] | None
    low: Array  # (number of blocks,), with `high`: a part that resisted
    high: Array
    at: float  # where it did (rad/s); NaN if none did
    work: float
    state: "State[Reached]"  # with the best deltas that were found near parts that resist


class _Node(NamedTuple):
    """A part, whether it is the lower (0) or upper half (1) of each part around it, and its history."""

    box: Part
    path: tuple[int, ...] = ()
    rough: int = 0  # parts around it at which rounding failed


def attempt(
    loop: Loop,
    k: float,
    work: float,
    near: Cover,
    reach: "Callable[[State[Reached], Array, float], State[Reached]]",
    state: "State[Reached]",
    crew: Crew,
) -> Attempt:
    """Try to prove the box of size k with so many units of work, beginning at the cover of a smaller box.

    `reach` gives the state after a search for a counterexample from real deltas and a frequency (rad/s):
    with one, its `upper` is k or less.
    """
    low, high = ends_of(loop, k)
    may_be_cut = bool(np.any(loop.real))
    whole = Part(low, high, ((0.0, np.inf),), near.peak, near.last, work, _TOLERANCE, may_be_cut)
    waiting = [_Node(whole)]
    covers: dict[tuple[int, ...], tuple[Cover, int]] = {}
    used, batches, widths = 0.0, 0, high - low
    while waiting:
        if used > work:
            box = waiting[-1].box
            return Attempt(None, box.low, box.high, box.at, used, state)
        batch, waiting = waiting[-_BATCH:], waiting[:-_BATCH]
        with after(used):
            looks: list[_Look] = crew(_looked_at, [(loop, node, widths) for node in batch])
        for node, look in zip(batch, looks, strict=True):
            used += look.work
            covers[node.path] = look.cover, look.axis
        resisting = [(node, look) for node, look in zip(batch, looks, strict=True) if look.cover.todo]
        if not resisting:
            continue
        (box, _, _), (cover, *_) = max(resisting, key=lambda pair: pair[1].cover.beta)
        if batches % _OFTEN == 0:
            state = reach(state, 0.5 * (box.low + box.high)[loop.real], cover.at)
            if state.upper <= k:
                return Attempt(None, box.low, box.high, cover.at, used, state)
        batches += 1
        for node, (cover, axis, _, starts) in resisting:
            if axis < 0:
                return Attempt(None, node.box.low, node.box.high, cover.at, used, state)
            inherited = node.box._replace(
                todo=cover.todo, at=cover.at, start=cover.last, reach=cover.reach, resists=False
            )
            halves = [
                inherited._replace(low=a, high=b)
                for a, b in _cut_in_two(node.box.low, node.box.high, axis)
            ]
            if starts:
                halves = [
                    half._replace(start=start, resists=start.beta > 1.0)
                    for half, start in zip(halves, starts, strict=True)
                ]
            rough = node.rough + (not cover.beta > 1.0)
            waiting += [_Node(half, (*node.path, side), rough) for side, half in enumerate(halves)][::-1]
    return Attempt([covers[path] for path in sorted(covers)], low, high, np.nan, used, state)


class _Look(NamedTuple):
    """What multipliers prove of a part, and where it is cut, if anywhere; -1: nowhere."""

    cover: Cover
    axis: int
    work: float
    starts: tuple[Multipliers, ...] = ()  # those of both halves at the frequency that resists, if known


def _looked_at(loop: Loop, node: _Node, widths: Array) -> _Look:
    """The cover of a part, and the parameter along which it is cut where it resists.

    That is the one whose halves need the fewest parts, as their bounds say, of those with the largest
    shares in the bound: shares tell what has no effect, but not what halves at a corner of the box have.
    """
    box, cover = node.box, covered(loop, node.box)
    width = box.high - box.low
    axes = np.flatnonzero(loop.real & (width > _SMALLEST * widths))
    is_rough = not cover.beta > 1.0
    if not (cover.todo and len(axes)) or np.isnan(cover.at) or (is_rough and node.rough >= _ROUGH):
        return _Look(cover, -1, cover.work)
    assert cover.last is not None, "a part that resists has been looked at"
    if len(axes) == 1 or is_rough:
        return _Look(cover, int(axes[np.argmax((width / widths)[axes])]), cover.work)
    M = matrix_at(loop, cover.at)
    inner, half = inside(loop, M, box.low, box.high)
    energies = energies_of(inner, cover.last.D, cover.last.G * half[:, None])
    by_block = np.bincount(loop.owner, energies, len(loop.blocks))
    axes = axes[np.argsort(-by_block[axes])][:_CANDIDATES]
    axes = axes[by_block[axes] > _IDLE * by_block[axes[0]]]
    best, fewest, work = _Look(cover, int(axes[0]), 0.0), np.inf, cover.work
    for axis in axes if len(axes) > 1 else ():
        halves, parts = list[Multipliers](), 0.0
        for ends in _cut_in_two(box.low, box.high, int(axis)):
            if parts < fewest:
                halves.append(multipliers_of(loop, M, ends, cover.last, box.tolerance))
                parts += _parts_of(halves[-1].beta)
                work += cost_at(loop)
        if parts < fewest:
            best, fewest = _Look(cover, int(axis), 0.0, tuple(halves)), parts
    return best._replace(work=work)


def _parts_of(beta: float) -> float:
    """How many parts a half needs, nearly: one if it is proved, and more the larger its bound is."""
    return 1.0 if beta <= 1.0 else 2.0 * beta**_STEEP


def _cut_in_two(low: Array, high: Array, axis: int) -> tuple[tuple[Array, Array], ...]:
    """Ends of both halves along a block, the lower first."""
    below, above = high.copy(), low.copy()
    below[axis] = above[axis] = 0.5 * (low[axis] + high[axis])
    return (low, below), (above, high)


def proof_of(loop: Loop, covers: Sequence[tuple[Cover, int]]) -> IntervalProof:
    """The proof of covers of parts, and the blocks that these are cut along, depth first."""
    return IntervalProof(
        tuple(number for cover, axis in covers for number in (len(cover.intervals), axis + 1)),
        tuple(interval for cover, _ in covers for interval in cover.intervals),
        tuple(scaled(pair, 1.0 / loop.scale) for cover, _ in covers for pair in cover.multipliers),
    )


def wrong_in(loop: Loop, k: float, proof: IntervalProof) -> str:
    """What is wrong with a proof for blocks of size k; empty if it is one. Nothing is searched."""
    if len(proof.log) % 2 or len(proof.intervals) != len(proof.multipliers):
        return "the list of parts is not whole"
    known: tuple[Interval, ...] = ()
    waiting, used = [(*ends_of(loop, k), known)], 0
    for count, cut in zip(proof.log[::2], proof.log[1::2], strict=True):
        if not waiting or count < 0 or used + count > len(proof.intervals):
            return "the list of parts is not whole"
        low, high, known = waiting.pop()
        extent = extent_of(loop, low, high)
        intervals = proof.intervals[used : used + count]
        for interval, multipliers in zip(intervals, proof.multipliers[used:], strict=False):
            if multipliers.beta != 1.0 or not fits(multipliers, loop.blocks):
                return f"the multipliers near {interval.at:.4g} rad/s are not of the structure of Delta"
            if not holds(loop.channels, scaled(multipliers, loop.scale), interval, extent):
                return (
                    f"the multipliers near {interval.at:.4g} rad/s do not prove their bound from "
                    f"{interval.low:.4g} to {interval.high:.4g} rad/s"
                )
        used, known = used + count, (*known, *intervals)
        if not cut:
            if not covers(tuple(sorted(known))):
                return "the intervals of a part do not cover all frequencies"
            continue
        axis = cut - 1
        if not 0 <= axis < len(loop.blocks) or loop.blocks[axis].kind != "real":
            return "a part is cut along a block that is not real"
        waiting += [(*ends, known) for ends in _cut_in_two(low, high, axis)[::-1]]
    return "the list of parts is not whole" if waiting or used != len(proof.intervals) else ""


class Reached(NamedTuple):
    """A small delta that makes a loop singular, or, where poles are followed, moves one to the axis."""

    loop: Loop
    delta: SmallDelta
    crossing: Crossing = NONE


class _Question(NamedTuple):
    """What is asked for of a loop; of a gain, `inner` is the loop without its block."""

    asked: Asked
    loop: Loop
    kind: str
    signals: Signals
    inner: Loop | None

    @property
    def is_gain(self) -> bool:
        return self.kind == "worst-case gain"

    @property
    def model(self) -> Realization:
        system = self.asked.system
        j = positions_of(list(self.signals[0]), [s.name for s in system.inputs], "inputs")
        i = positions_of(list(self.signals[1]), [s.name for s in system.outputs], "outputs")
        return realization(system, j, i, self.asked.leave_out, others_are_zero=True)


def by_multipliers(
    asked: Asked, loop: Loop, kind: str, signals: Signals = ((), ()), inner: Loop | None = None
) -> Bounds:
    """Bounds of a margin or a gain by multipliers; of a gain, `inner` is the loop without its block."""
    if kind == "worst-case gain":
        asked = asked._replace(largest=_largest_of_gain(loop))
    question = _Question(asked, loop, kind, signals, inner)
    start = State(Reached(loop, nothing(loop)))
    search = _search(question, start)
    if question.is_gain:
        return _answer(question, last_of(asked, start, search, _turned))
    return _answer(question, last_of(asked, start, search))


def with_ball(loop: Loop, bounds: Bounds) -> Bounds:
    """Bounds of which nothing is proved, with the size of the blocks that follows from a norm, if any.

    Let S be the root of k for blocks that grow, and 1 for others. D = S^-2 and G = 0 prove the size k if
    |S M(j omega) S| < 1 at all frequencies. Without blocks that are fixed that is k |M| < 1.
    """
    if not bounds.is_bare:
        return bounds
    grows = loop.grows[loop.owner]

    def norm_of(k: float) -> float:
        S = np.where(grows, np.sqrt(k), 1.0)
        A, B, C, D = loop.channels
        return peak_of(Plant(A, B * S, C * S[:, None], D * S * S[:, None]), _BALL)[1]

    k = 1.0
    if np.all(grows):
        level = norm_of(k)
        k = (1.0 - _BALL) / level if 0.0 < level < np.inf else 0.0
    else:
        while k > _LEAST_BALL and not norm_of(k) <= 1.0 - 0.5 * _BALL:
            k *= _SMALLER
    if not k > _LEAST_BALL:
        return bounds
    D = np.diag(np.where(grows, 1.0 / k, 1.0)).astype(complex)
    multipliers, extent = Multipliers(1.0, D, np.zeros_like(D)), extent_of(loop, *ends_of(loop, k))
    interval = interval_around(loop.channels, multipliers, 1.0, extent)
    if interval is None or interval.low > 0.0 or interval.high < np.inf:
        return bounds
    proof = IntervalProof((1, 0), (interval,), (scaled(multipliers, 1.0 / loop.scale),))
    if bounds.is_from_above:
        upper = 1.0 / k * (2.0 - _INSIDE)
        return replace(bounds, upper=upper, proof=proof) if upper >= bounds.lower else bounds
    k *= _INSIDE
    return replace(bounds, lower=k, proof=proof) if k <= bounds.upper else bounds


def _search(question: _Question, state: State[Reached]) -> Search[Reached]:
    """Sizes of the blocks that grow: `lower` and `upper` are sizes, also of a gain."""
    asked, loop = question.asked, question.loop
    if question.is_gain and question.inner is not None and question.inner.blocks:
        state = _with_fixed_blocks(question, question.inner, state)
        if state.upper == 0.0:
            return state
    state = _first(question, state)
    yield state
    most = min(asked.largest, state.upper * (1.0 - _INTO_GAP * asked.gap))
    with after(state.used):
        cover = shrunk(loop, most, asked.gap, _LARGEST_SHARE * state.left(asked))
    state = state._replace(used=state.used + cover.work)
    if not cover.todo:
        proof = proof_of(loop, [(cover, -1)])
        state = state._replace(lower=cover.k * _INSIDE, proof=proof)
        yield state
    if not _follows_poles(loop) and not state.is_closed(asked) and np.isfinite(cover.peak):
        state = _with_delta(asked, state, best_near(loop, state.worst.delta, cover.peak, starts=3))
        yield state
    resisted = cover.k if cover.todo and cover.k else np.inf
    tried = partial(_tried, question, cover)
    return (yield from enlarged(asked, state, tried, resisted=resisted, into_gap=_INTO_GAP))


def _follows_poles(loop: Loop) -> bool:
    """Whether poles can be followed in place of a search at frequencies."""
    return loop.is_plain and bool(np.all(loop.grows))


def _largest_of_gain(loop: Loop) -> float:
    """One over a gain that is nothing."""
    of_gain = loop.owner == len(loop.blocks) - 1
    sizes = [np.abs(matrix_at(loop, w)) for w in looks(first_frequencies(loop.channels.A))]
    size = float(np.max([matrix[np.ix_(of_gain, of_gain)] for matrix in sizes], initial=0.0))
    return _RANGE / (size or float(np.max(sizes, initial=0.0)) or 1.0)


def _with_fixed_blocks(question: _Question, inner: Loop, state: State[Reached]) -> State[Reached]:
    """The state after a search for deltas of the fixed blocks alone; `upper` is 0 if there are some."""
    used = state.used + _REACH
    if inner.is_plain:
        crossing = smallest_crossing(question.model, 1.0)
        reached, is_unstable = Reached(inner, nothing(inner), crossing), np.isfinite(crossing.size)
    else:
        reached = Reached(inner, first_reached(inner))
        is_unstable = reached.delta.bound >= 1.0
    if is_unstable:
        return state._replace(worst=reached, upper=0.0, used=used, reason=UNSTABLE)
    return state._replace(used=used)


def _first(question: _Question, state: State[Reached]) -> State[Reached]:
    """The state after searches from nominal values."""
    asked, loop, inner = question.asked, question.loop, question.inner
    state = state._replace(used=state.used + _REACH)
    if _follows_poles(loop):
        state = _with_crossing(state, smallest_crossing(question.model, asked.largest))
    else:
        state = _with_delta(asked, state, first_reached(loop))
    if question.is_gain and inner is not None and inner.is_plain:
        peak = largest_peak(question.model, 1.0)
        near = best_near(loop, state.worst.delta, peak.frequency, peak.delta)
        state = _with_delta(asked, state, near)
    return state


def _with_crossing(state: State[Reached], crossing: Crossing) -> State[Reached]:
    if not crossing.size < state.upper:
        return state
    return state._replace(worst=state.worst._replace(crossing=crossing), upper=crossing.size)


def _with_delta(asked: Asked, state: State[Reached], delta: SmallDelta) -> State[Reached]:
    if not (delta.bound > state.worst.delta.bound and 1.0 / delta.bound <= asked.largest):
        return state
    return state._replace(worst=state.worst._replace(delta=delta), upper=1.0 / delta.bound)


def _tried(question: _Question, cover: Cover, state: State[Reached], k: float) -> State[Reached]:
    """The state after an attempt to prove a size."""
    asked, loop = question.asked, question.loop
    reach, work = partial(_near_part, question, k), state.share(asked)
    with after(state.used):
        outcome = attempt(loop, k, work, cover, reach, state, asked.crew)
    before, state = state.upper, outcome.state._replace(used=outcome.state.used + outcome.work)
    if outcome.covers is not None:
        proof = proof_of(loop, outcome.covers)
        return state._replace(lower=k * _INSIDE, proof=proof)
    if not state.upper < before:
        return state._replace(reason=_resistance(question, outcome, k))
    return state


def _near_part(
    question: _Question, k: float, state: State[Reached], center: Array, omega: float
) -> State[Reached]:
    """The state after a search for a small delta near a part that resists."""
    asked, loop = question.asked, question.loop
    state = state._replace(used=state.used + _REACH)
    if _follows_poles(loop):
        known = state.worst.crossing
        return _with_crossing(state, improved(question.model, center, known, asked.largest))
    sizes = [
        k if grows else 1.0
        for block, grows in zip(loop.blocks, loop.grows, strict=True)
        if block.kind == "real"
    ]
    near = best_near(loop, state.worst.delta, omega, center / np.array(sizes))
    return _with_delta(asked, state, near)


def _resistance(question: _Question, outcome: Attempt, k: float) -> str:
    """What resisted a proof, and where."""
    ends = ", ".join(
        f"{block.name} in [{low:.3g}, {high:.3g}]"
        for block, low, high in zip(question.loop.blocks, outcome.low, outcome.high, strict=True)
        if block.kind == "real"
    )
    what = f"a gain of {1.0 / k:.4g}" if question.is_gain else f"{k:.4g} times the box"
    near = f"near {outcome.at:.4g} rad/s" if not np.isnan(outcome.at) else "with this work"
    return f"for {what} multipliers prove nothing {near}{f', {ends}' if ends else ''}"


def _answer(question: _Question, state: State[Reached]) -> Bounds:
    asked, (loop, small, crossing) = question.asked, state.worst
    if _follows_poles(loop):
        values, slope, frequency = crossing.delta, crossing.slope, crossing.frequency
        names = [block.name for block in loop.blocks]
        delta = dict(zip(names, values.tolist(), strict=True)) if len(values) else {}
        by_block = values * slope if len(slope) == len(values) else np.zeros(len(values))
    else:
        delta, frequency = by_name(loop, small.delta) if small.bound else {}, small.omega
        delta.pop(GAIN, None)
        by_block = changes(loop, small)[: len(delta)] if small.bound else np.zeros(0)
    is_open = not state.is_closed(asked) or not state.upper or np.isinf(state.upper)
    why, worst = _why(loop, state.reason) if is_open else "", (delta, frequency)
    bounds = bounds_of(asked, state, question.kind, worst, by_block, why, question.signals)
    if question.is_gain:
        lower, upper = _turned(state)
        return replace(bounds, lower=lower, upper=upper)
    fixed = [b.name for b, grows in zip(loop.blocks, loop.grows, strict=True) if not grows]
    return replace(bounds, fixed=tuple(fixed))


def _why(loop: Loop, reason: str) -> str:
    """The reason, and whether fewer repetitions would have helped."""
    full = sum(max(block.inputs, block.outputs) ** 2 for block in loop.blocks)
    if len(loop.structure.rows) == full:
        return reason
    return (
        f"{reason}; multipliers would have {full} entries, and are zero between pieces of the "
        "repeated blocks: fewer repetitions, or fewer parameters, would prove more"
    )


def _turned(state: State[Reached]) -> tuple[float, float]:
    """Bounds of a gain, of those of its size."""
    upper = 1.0 / state.lower * (2.0 - _INSIDE) if state.lower else np.inf
    return 1.0 / state.upper if state.upper else np.inf, upper
