"""Margins and gains by multipliers: for blocks of all kinds, and for many parameters.

What is proved are sizes of the blocks that grow (`mbdlft.robust.mu.coverage`): first of the whole box,
then of its parts. They are bounded from above by deltas that make the loop singular, or, for parameters
only, that move a pole to the axis. A gain is one over such a size.

No model of a part of the box has a pole on the axis, or is singular, if multipliers prove so on intervals
that cover all frequencies. A part on which they do not suffice is cut along the parameter for which the
bounds of both halves, with the multipliers of the part, are smallest. A half inherits the intervals of
its part: only frequencies that are open are looked at again. Parts cover the box, which is connected, and
its middle is stable: so is all of it. (Branch and bound for mu: Newlin, Young, Int. J. Robust and
Nonlinear Control 7, 1997; here parts have intervals of frequency in place of one frequency.) Parts are
tried in batches that do not depend on how many processes there are.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbdlft.base.array import Array
from mbdlft.base.running import after
from mbdlft.robust.bisect.characteristic import Realization
from mbdlft.robust.bisect.search import UNSTABLE, Search
from mbdlft.robust.crew import Crew
from mbdlft.robust.evidence import Bounds, Interval, IntervalProof, Multipliers
from mbdlft.robust.migration import NONE, Crossing, improved, smallest_crossing
from mbdlft.robust.mu.coverage import (
    GAIN,
    Complex,
    Cover,
    Loop,
    Part,
    covered,
    covers,
    ends_of,
    extent_of,
    first_frequencies,
    inside,
    looks,
    matrix_at,
    scaled,
    shrunk,
    unscaled,
)
from mbdlft.robust.mu.intervals import holds
from mbdlft.robust.mu.multipliers import best_square, fits
from mbdlft.robust.mu.small_delta import (
    SmallDelta,
    best_near,
    by_name,
    changes,
    first_reached,
    nothing,
)
from mbdlft.robust.peak import largest_peak
from mbdlft.robust.realization import realization

_BATCH = 8
_SMALLEST = 2.0**-16  # of the box: a part of this size is not cut again
_FACTORS = (1.0, 2.0, 4.0)  # of D of a parameter that is cut
_TOLERANCE = 0.02  # of bounds of mu that decide whether a part is cut
_ROUGH = 3  # parts one in the other at which rounding may fail
_OFTEN = 4  # batches from one to the next that is looked at for a counterexample


class Attempt(NamedTuple):
    """What came of an attempt to prove a box.

    Attributes
    ----------
    parts : _Node or None
        The tree of parts, if all are proved; None also if a counterexample was found.
    low, high : array (number of blocks,)
        A part that resisted.
    at : float
        Where it did (rad/s); NaN if none did.
    work : float
    """

    parts: "_Node | None"
    low: Array
    high: Array
    at: float
    work: float


@dataclass(slots=True)
class _Node:
    """A part, what covers it, and its halves; `rough`: parts above it at which rounding failed."""

    part: Part
    cover: Cover | None = None
    rough: int = 0
    cut: int = -1
    halves: "tuple[_Node, _Node] | None" = None


def attempt(
    loop: Loop,
    k: float,
    work: float,
    near: Cover,
    reach: Callable[[Array, float], bool],
    crew: Crew,
) -> Attempt:
    """Try to prove the box of size k.

    Parameters
    ----------
    loop : Loop
    k : float
    work : float
        Units.
    near : Cover
        Of a smaller box: where to begin.
    reach : function of real deltas and a frequency (rad/s)
        Looks for a counterexample from there; whether one was found.
    crew : Crew
        Who covers the parts.
    """
    low, high = ends_of(loop, k)
    root = _Node(Part(low, high, ((0.0, np.inf),), near.peak, near.last, work, _TOLERANCE))
    waiting, used, batches, widths = [root], 0.0, 0, high - low
    real = np.array([block.kind == "real" for block in loop.blocks], dtype=bool)
    while waiting:
        if used > work:
            part = waiting[-1].part
            return Attempt(None, part.low, part.high, part.at, used)
        batch, waiting = waiting[-_BATCH:], waiting[:-_BATCH]
        with after(used):
            covers_of = crew.map(covered, [(loop, node.part) for node in batch])
        worst = None
        for node, cover in zip(batch, covers_of, strict=True):
            node.cover, used = cover, used + cover.work
            if cover.todo and (worst is None or worst[1].beta < cover.beta):
                worst = node.part, cover
        if worst is None:
            continue
        center = 0.5 * (worst[0].low + worst[0].high)[real]
        if batches % _OFTEN == 0 and reach(center, worst[1].at):
            return Attempt(None, worst[0].low, worst[0].high, worst[1].at, used)
        batches += 1
        for node, cover in zip(batch, covers_of, strict=True):
            if not cover.todo:
                continue
            node.cut = _cut(loop, node, cover, real, widths)
            if node.cut < 0:
                return Attempt(None, node.part.low, node.part.high, cover.at, used)
            node.halves = _halves(node, cover)
            waiting += node.halves[::-1]
    return Attempt(root, low, high, np.nan, used)


def _cut(loop: Loop, node: _Node, cover: Cover, real: NDArray[np.bool_], widths: Array) -> int:
    """The parameter along which a part is cut; -1 if there is none."""
    part, own = node.part, node.part.high - node.part.low
    fits_in = np.flatnonzero(real & (own > _SMALLEST * widths))
    is_rough = not cover.beta > 1.0 and node.rough >= _ROUGH
    if not len(fits_in) or np.isnan(cover.at) or cover.last is None or is_rough:
        return -1
    if len(fits_in) == 1 or not cover.beta > 1.0:
        return int(fits_in[np.argmax((own / widths)[fits_in])])
    M, found = matrix_at(loop, cover.at), []
    for axis in fits_in:
        both = _cut_in_two(part.low, part.high, int(axis))
        bounds = [_bound(loop, M, low, high, cover.last, int(axis)) for low, high in both]
        found.append(max(bounds) + 1e-9 * min(bounds))
    return int(fits_in[int(np.argmin(found))])


def _bound(loop: Loop, M: Complex, low: Array, high: Array, known: Multipliers, axis: int) -> float:
    """A bound of mu^2 of a part, with multipliers of the one that it is a half of."""
    scaled_M, half = inside(loop, M, low, high)
    best = np.inf
    for factor in _FACTORS:
        weight = np.where(loop.owner == axis, factor, 1.0)
        try:
            best = min(best, best_square(scaled_M, weight[:, None] * known.D, known.G * half))
        except np.linalg.LinAlgError:
            continue
    return best


def _halves(node: _Node, cover: Cover) -> tuple[_Node, _Node]:
    """Both halves of a part, the lower first, with the frequencies that are open."""
    inherited = node.part._replace(todo=cover.todo, at=cover.at, start=cover.last)
    rough = node.rough + (not cover.beta > 1.0)
    first, second = (
        _Node(inherited._replace(low=low, high=high), rough=rough)
        for low, high in _cut_in_two(node.part.low, node.part.high, node.cut)
    )
    return first, second


def _cut_in_two(low: Array, high: Array, axis: int) -> tuple[tuple[Array, Array], ...]:
    """Ends of both halves along a block, the lower first."""
    below, above = high.copy(), low.copy()
    below[axis] = above[axis] = 0.5 * (low[axis] + high[axis])
    return (low, below), (above, high)


def proof_of(
    loop: Loop, k: float, parts: _Node | Cover, signals: tuple[tuple[str, ...], tuple[str, ...]]
) -> IntervalProof:
    """The proof of a tree of parts, or of the whole box."""
    log: list[int] = []
    intervals: list[Interval] = []
    multipliers: list[Multipliers] = []

    def add(cover: Cover, cut: int) -> None:
        log.extend((len(cover.intervals), cut + 1))
        intervals.extend(cover.intervals)
        multipliers.extend(unscaled(found, loop.scale) for found in cover.multipliers)

    waiting = [parts] if isinstance(parts, _Node) else []
    if isinstance(parts, Cover):
        add(parts, -1)
    while waiting:
        node = waiting.pop()
        if node.cover is not None:
            add(node.cover, node.cut)
        waiting += node.halves[::-1] if node.halves else ()
    fixed = [b.name for b, grows in zip(loop.blocks, loop.grows, strict=True) if not grows]
    return IntervalProof(
        k, tuple(log), tuple(intervals), tuple(multipliers), tuple(fixed), *signals
    )


def wrong_in(loop: Loop, proof: IntervalProof) -> str:
    """What is wrong with a proof; empty if it is one. Nothing is searched."""
    if len(proof.log) % 2 or len(proof.intervals) != len(proof.multipliers):
        return "the list of parts is not whole"
    known: tuple[Interval, ...] = ()
    waiting, used = [(*ends_of(loop, proof.k), known)], 0
    for count, cut in zip(proof.log[::2], proof.log[1::2], strict=True):
        if not waiting or count < 0 or used + count > len(proof.intervals):
            return "the list of parts is not whole"
        low, high, known = waiting.pop()
        extent = extent_of(loop, low, high)
        own = proof.intervals[used : used + count]
        for interval, found in zip(own, proof.multipliers[used:], strict=False):
            if found.beta != 1.0 or not fits(found, loop.blocks):
                return f"the multipliers near {interval.at:.4g} rad/s are not of the structure of Delta"
            if not holds(loop.channels, scaled(found, loop.scale), interval, extent):
                return (
                    f"the multipliers near {interval.at:.4g} rad/s do not prove their bound from "
                    f"{interval.low:.4g} to {interval.high:.4g} rad/s"
                )
        used, known = used + count, (*known, *own)
        if not cut:
            if not covers(tuple(sorted(known))):
                return "the intervals of a part do not cover all frequencies"
            continue
        axis = cut - 1
        if not 0 <= axis < len(loop.blocks) or loop.blocks[axis].kind != "real":
            return "a part is cut along a block that is not real"
        waiting += [(*ends, known) for ends in _cut_in_two(low, high, axis)[::-1]]
    return "the list of parts is not whole" if waiting or used != len(proof.intervals) else ""


_INSIDE = 1.0 - 1e-15  # a size is not above what was proved, however it was rounded
_RANGE = 1e6  # times the gain of nominal values: a size below one over that is not looked for
_INTO_GAP = 0.8  # part of the gap that is left between what is reached and what is tried first
_REACH = 0.1  # units of work of a search for small deltas
Signals = tuple[tuple[str, ...], tuple[str, ...]]


@dataclass(slots=True)
class MixedSearch(Search):
    """Sizes of the blocks that grow: `lower` and `upper` are sizes, also of a gain, until the answer.

    `inner` is the loop of a gain without its block.
    """

    loop: Loop = field(kw_only=True)
    kind: str = field(kw_only=True)
    signals: Signals = ((), ())
    inner: Loop | None = None
    best: SmallDelta = field(init=False)
    crossing: Crossing = NONE
    cover: Cover = field(init=False)

    @property
    def is_gain(self) -> bool:
        return self.kind == "worst-case gain"

    @property
    def follows_poles(self) -> bool:
        """Whether poles can be followed in place of a search at frequencies."""
        return self.loop.is_plain and bool(np.all(self.loop.grows))

    def told(self) -> None:
        if self.asked.progress is not None:
            self.asked.progress(*(_turned(self) if self.is_gain else (self.lower, self.upper)))

    def search(self) -> None:
        self.best = nothing(self.loop)
        largest = self.asked.largest
        if self.is_gain:
            largest = self._largest_of_gain()
            self.asked = self.asked._replace(largest=largest)
            if self._is_unstable():
                return
        self._reach_first()
        self.told()
        gap = self.asked.gap
        most = min(largest, self.upper * (1.0 - _INTO_GAP * gap))  # wide intervals need some room
        with after(self.used):
            self.cover = shrunk(self.loop, most, gap, self.left)
        self.used += self.cover.work
        if not self.cover.todo:
            self.lower = self.cover.k * _INSIDE
            self.proof = proof_of(self.loop, self.cover.k, self.cover, self.signals)
            self.told()
        if not self.follows_poles and not self.is_closed and np.isfinite(self.cover.peak):
            self._took(best_near(self.loop, self.best, self.cover.peak, starts=3))
            self.told()
        self.raise_lower()

    def _largest_of_gain(self) -> float:
        """One over a gain that is nothing."""
        own = self.loop.owner == len(self.loop.blocks) - 1
        first = first_frequencies(self.loop.channels.A)
        sizes = [np.abs(matrix_at(self.loop, w)) for w in looks(first)]
        size = float(np.max([part[np.ix_(own, own)] for part in sizes], initial=0.0))
        return _RANGE / (size or float(np.max(sizes, initial=0.0)) or 1.0)

    def _is_unstable(self) -> bool:
        """Whether the box of the blocks that are fixed has a model on or beyond the axis."""
        if self.inner is None or not self.inner.blocks:
            return False
        self.used += _REACH
        if self.inner.is_plain:
            self.crossing = smallest_crossing(self._model(), 1.0)
            is_unstable = bool(np.isfinite(self.crossing.size))
        else:
            self.best = first_reached(self.inner)
            is_unstable = self.best.bound >= 1.0
        if is_unstable:
            self.loop, self.upper = self.inner, 0.0
            self.reason = UNSTABLE
        else:
            self.best = nothing(self.loop)
        return is_unstable

    def _reach_first(self) -> None:
        self.used += _REACH
        if self.follows_poles:
            self._follow(smallest_crossing(self._model(), self.asked.largest))
        else:
            self._took(first_reached(self.loop))
        if self.is_gain and self.inner is not None and self.inner.is_plain:
            peak = largest_peak(self._model(), 1.0)
            self._took(best_near(self.loop, self.best, peak.frequency, peak.delta))

    def _model(self) -> Realization:
        system, gone = self.asked.system, self.asked.leave_out
        own = [s.name for s in system.inputs], [s.name for s in system.outputs]
        j, i = (
            [names.index(name) for name in asked]
            for names, asked in zip(own, self.signals, strict=True)
        )
        return realization(system, j, i, gone, others_are_zero=True)

    def _follow(self, crossing: Crossing) -> None:
        if crossing.size < self.upper:
            self.crossing, self.upper = crossing, crossing.size

    def _took(self, found: SmallDelta) -> None:
        if found.bound > self.best.bound and 1.0 / found.bound <= self.asked.largest:
            self.best, self.upper = found, 1.0 / found.bound

    def tried(self, k: float) -> bool:
        before, work, reach = self.upper, self.share * self.left, partial(self._reach, k)
        with after(self.used):
            found = attempt(self.loop, k, work, self.cover, reach, self.asked.crew)
        self.used += found.work
        if found.parts is not None:
            self.lower = k * _INSIDE
            self.proof = proof_of(self.loop, k, found.parts, self.signals)
            return True
        if not self.upper < before:
            self.reason = self._resistance(found, k)
        return self.upper < before

    def _reach(self, k: float, center: Array, omega: float) -> bool:
        """Look for a small delta near a part that resists; whether it is in the box of size k."""
        self.used += _REACH
        if self.follows_poles:
            largest = self.asked.largest
            self._follow(improved(self._model(), center, self.crossing, largest))
        else:
            real = [
                k if grows else 1.0
                for block, grows in zip(self.loop.blocks, self.loop.grows, strict=True)
                if block.kind == "real"
            ]
            self._took(best_near(self.loop, self.best, omega, center / np.array(real)))
        return self.upper <= k

    def _resistance(self, found: Attempt, k: float) -> str:
        """What resisted a proof, and where."""
        ends = ", ".join(
            f"{block.name} in [{low:.3g}, {high:.3g}]"
            for block, low, high in zip(self.loop.blocks, found.low, found.high, strict=True)
            if block.kind == "real"
        )
        what = f"a gain of {1.0 / k:.4g}" if self.is_gain else f"{k:.4g} times the box"
        near = f"near {found.at:.4g} rad/s" if not np.isnan(found.at) else "with this work"
        return f"for {what} multipliers prove nothing {near}{f', {ends}' if ends else ''}"

    def _why(self) -> str:
        """The reason, and whether fewer repetitions would have helped."""
        full = sum(max(block.inputs, block.outputs) ** 2 for block in self.loop.blocks)
        if len(self.loop.structure.rows) == full:
            return self.reason
        return (
            f"{self.reason}; multipliers would have {full} entries, and are zero between pieces of the "
            "repeated blocks: fewer repetitions, or fewer parameters, would prove more"
        )

    def answer(self) -> Bounds:
        best, loop = self.best, self.loop
        if self.follows_poles:
            names = [block.name for block in loop.blocks]
            values = self.crossing.delta
            delta = dict(zip(names, values.tolist(), strict=True)) if len(values) else {}
            slope = self.crossing.slope
            parts = values * slope if len(slope) == len(values) else np.zeros(len(values))
            frequency = self.crossing.frequency
        else:
            delta = by_name(loop, best.delta) if best.bound else {}
            delta.pop(GAIN, None)
            parts = changes(loop, best)[: len(delta)] if best.bound else np.zeros(0)
            frequency = best.omega
        is_open = not self.is_closed or not self.upper or np.isinf(self.upper)
        why, proved = self._why() if is_open else "", self.lower > 0.0
        found = self.bounds(self.kind, delta, frequency, parts, proved=proved, reason=why)
        if self.is_gain:
            lower, upper = _turned(self)
            return replace(found, lower=lower, upper=upper)
        fixed = [b.name for b, grows in zip(loop.blocks, loop.grows, strict=True) if not grows]
        return replace(found, fixed=tuple(fixed))


def _turned(search: Search) -> tuple[float, float]:
    """Bounds of a gain, of those of its size."""
    upper = 1.0 / search.lower * (2.0 - _INSIDE) if search.lower else np.inf
    return 1.0 / search.upper if search.upper else np.inf, upper
