"""Margins and gains by multipliers: for blocks of all kinds, and for many parameters.

What is proved are sizes of the blocks that grow (`mbdlft.robust.loop`): first of the whole box, then
of its parts (`mbdlft.robust.parts`). They are bounded from above by deltas that make the loop singular,
or, for parameters only, that move a pole to the axis. A gain is one over such a size.
"""

from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from mbdlft.base.array import Array
from mbdlft.base.spent import after
from mbdlft.robust.anytime import UNSTABLE, Search
from mbdlft.robust.characteristic import Realization
from mbdlft.robust.coverage import Cover, first_frequencies, looks, shrunk
from mbdlft.robust.evidence import Bounds
from mbdlft.robust.loop import GAIN, Loop, matrix_at
from mbdlft.robust.parts import Attempt, attempt, proof_of
from mbdlft.robust.peak import largest_peak
from mbdlft.robust.pole_migration import NONE, Crossing, improved, smallest_crossing
from mbdlft.robust.reach import (
    best_near,
    by_name,
    changes,
    first_reached,
    nothing,
)
from mbdlft.robust.realization import realization
from mbdlft.robust.small_delta import SmallDelta

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
