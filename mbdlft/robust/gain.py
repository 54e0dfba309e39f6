"""Worst-case gain and robust performance: bounds for all frequencies and all values of the parameters.

The worst-case gain is the largest H-infinity norm of a transfer over the declared box. It is bounded from
below by the gain at deltas that an ascent with exact slopes finds, and from above by a proof
(`mbdlft.robust.bisect.boxes`). The margin of robust performance is the largest k for which the gain on
the box of size k is at most 1/k: then weights say what is asked for.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from mbdlft.base.array import Array
from mbdlft.base.errors import AnalysisError
from mbdlft.base.running import one_thread
from mbdlft.robust.bisect.characteristic import Polynomials, Realization
from mbdlft.robust.bisect.search import (
    GAP,
    LARGEST,
    UNSTABLE,
    WORK,
    Asked,
    BoxSearch,
    Progress,
    check_numbers,
    cost_of,
    is_dear,
    resistance,
    too_large,
)
from mbdlft.robust.crew import crew_of
from mbdlft.robust.evidence import Bounds, BoxProof
from mbdlft.robust.migration import smallest_crossing
from mbdlft.robust.moving.varying import MovingGain, Rates, rates_of
from mbdlft.robust.mu.coverage import GAIN, loop_of
from mbdlft.robust.mu.mixed import MixedSearch, Signals
from mbdlft.robust.peak import NOTHING, Peak, largest_peak, peak_at, slope_at
from mbdlft.robust.realization import (
    check_constant,
    realization,
    stable_states,
    states_that_stay,
)
from mbdlft.system.conversion import positions_of
from mbdlft.system.model import System

_WIDER = 2.0  # factor of the distance of a bound that resisted from the gain that was reached
_BISECTIONS = 40
_ZERO = 1e-300  # a gain that is proved to be smaller is not looked at any more
_OUTSIDE = 1.0 + 1e-15  # a bound is not below 1 over what was proved, however that was rounded


def worst_case_gain(
    system: System,
    inputs: Any = slice(None),
    outputs: Any = slice(None),
    *,
    gap: float = GAP,
    work: float = WORK,
    rates: Rates = None,
    leave_out: Sequence[str] = (),
    progress: Progress | None = None,
    workers: int | None = 1,
    client: Any = None,
) -> Bounds:
    """Bounds of the largest H-infinity norm from inputs to outputs over the declared box.

    With `rates`, `upper` is a bound of the root of the energy of the outputs over that of the inputs,
    from rest, for all motions of the parameters in the box that are not faster.

    Parameters
    ----------
    system : System or LFTModel
        Nominally stable.
    inputs, outputs : name, number, slice, or list of these, optional
        Signals of the transfer; all, if not given. The gain has the units of these signals.
    gap : float
        The part of the gain by which its bounds may differ.
    work, rates, leave_out, progress, workers, client
        As for `robust_stability`.

    Returns
    -------
    Bounds
        `upper` is proved, and stability with it; `lower` is reached at `worst`. Both are inf if the
        system is unstable at `worst`.

    Raises
    ------
    AnalysisError
        The nominal model is unstable, or has a pole on the axis, which the message names; there are no
        inputs or no outputs.
    StructureError
        A signal is unknown.
    """
    what = "worst_case_gain"
    check_numbers(what, gap=gap, work=work)
    moving = rates_of(system, rates, what)
    chosen = _chosen(system, inputs, outputs, leave_out, what, work)
    with one_thread(), crew_of(workers, client, what) as crew:
        asked = Asked(system, gap, work, progress, tuple(leave_out), crew=crew)
        if not moving and chosen.model is None:
            return _by_multipliers(asked, chosen, "worst-case gain")
        model = chosen.model or realization(system, chosen.inputs, chosen.outputs, leave_out)
        search = _GainSearch(asked, model=model, signals=chosen.names)
        if not moving:
            return search.result()
        search.reach()
        own: dict[str, Any] = {"model": model, "rates": moving, "signals": chosen.names}
        return MovingGain(asked, **own, constant=search.answer()).result()


def robust_performance(
    system: System,
    inputs: Any = slice(None),
    outputs: Any = slice(None),
    *,
    gap: float = GAP,
    work: float = WORK,
    largest: float = LARGEST,
    leave_out: Sequence[str] = (),
    progress: Progress | None = None,
    workers: int | None = 1,
    client: Any = None,
) -> Bounds:
    """Bounds of the largest k such that the gain is at most 1/k for all |delta| <= k.

    Parameters
    ----------
    system : System or LFTModel
        Nominally stable, with weights at its inputs and outputs: a gain of 1 is what is asked for.
    inputs, outputs : name, number, slice, or list of these, optional
        Signals of the transfer; all, if not given.
    gap, work, largest, leave_out, progress, workers, client
        As for `robust_stability`.

    Returns
    -------
    Bounds
        `lower` is proved: on the box of this size the gain is at most 1/lower. At `worst` it is 1/upper
        or more, or the system is unstable.

    Raises
    ------
    AnalysisError
        The nominal model is unstable, or has a pole on the axis, which the message names; there are no
        inputs or no outputs.
    StructureError
        A signal is unknown.
    """
    what = "robust_performance"
    check_constant(system, "robust_performance")
    check_numbers(what, gap=gap, work=work, largest=largest)
    chosen = _chosen(system, inputs, outputs, leave_out, what, work)
    with one_thread(), crew_of(workers, client, what) as crew:
        asked = Asked(system, gap, work, progress, tuple(leave_out), largest, crew)
        if chosen.model is None:
            return _by_multipliers(asked, chosen, "robust performance")
        return _PerformanceSearch(asked, model=chosen.model, signals=chosen.names).result()


class _Chosen(NamedTuple):
    """Signals of a transfer, and its model; None if multipliers are the way to prove it."""

    inputs: list[int]
    outputs: list[int]
    names: Signals
    model: Realization | None


def _chosen(
    system: System, inputs: Any, outputs: Any, leave_out: Sequence[str], what: str, work: float
) -> _Chosen:
    """A transfer that is stable at nominal."""
    own = [s.name for s in system.inputs], [s.name for s in system.outputs]
    j = positions_of(inputs, own[0], f"{what}: inputs of {system.name}")
    i = positions_of(outputs, own[1], f"{what}: outputs of {system.name}")
    if not (i and j):
        raise AnalysisError(
            f"{what}: model {system.name!r}: without inputs or outputs there is no gain. Choose some "
            "when the model is made."
        )
    names = tuple(own[0][k] for k in j), tuple(own[1][k] for k in i)
    stable_states(system, leave_out, what, i)
    model = realization(system, j, i, leave_out) if system.lft.is_plain else None
    if model is not None and system.order and is_dear(model, work):
        model = None
    return _Chosen(j, i, names, model)


def _by_multipliers(asked: Asked, chosen: _Chosen, kind: str) -> Bounds:
    """Bounds of a gain, or of the margin of performance, of a system with blocks of all kinds."""
    system = asked.system
    stay = states_that_stay(system, asked.leave_out, chosen.outputs)
    loop = loop_of(system, stay, (), chosen.inputs, chosen.outputs)
    inner = None
    if kind == "worst-case gain":
        grows = np.array([block.name == GAIN for block in loop.blocks], dtype=bool)
        loop, inner = loop._replace(grows=grows), loop_of(system, stay)
    search = MixedSearch(asked, loop=loop, kind=kind, signals=chosen.names, inner=inner)
    return search.result()


def _is_above(model: Realization, k: float, gain: float, delta: Array) -> bool:
    return peak_at(model, k * delta).gain * gain >= 1.0


@dataclass(slots=True)
class _PeakSearch(BoxSearch):
    """What the searches for a gain and for a margin of performance share: the best peak so far."""

    signals: Signals = field(kw_only=True)
    best: Peak = NOTHING

    def told_of(self, kind: str, *, proved: bool, reason: str) -> Bounds:
        """The result with the best peak."""
        best, slope = self.best, np.zeros(0)
        if len(best.delta) == len(self.model.names) and 0.0 < best.gain < np.inf:
            slope = slope_at(self.model, best)
        worst = best.delta, best.frequency
        return self.said(kind, worst, slope, proved=proved, reason=reason)


@dataclass(slots=True)
class _GainSearch(_PeakSearch):
    """The largest gain; `lower` is that of the best peak."""

    def search(self) -> None:
        self.reach()
        self.reason = self.reason or too_large(self.model)
        if self.reason or not np.isfinite(self.lower):
            return
        found = self.expanded(1.0)
        if found is not None:
            self.lower_upper(found)

    def reach(self) -> None:
        """The largest gain that a search finds."""
        crossing = smallest_crossing(self.model, 1.0)
        if np.isfinite(crossing.size):
            self.took(Peak(np.inf, crossing.frequency, crossing.delta))
            self.reason = UNSTABLE
            return
        self.took(largest_peak(self.model, 1.0))
        self.told()

    def took(self, best: Peak) -> None:
        self.best, self.lower = best, best.gain

    def lower_upper(self, found: Polynomials) -> None:
        """Prove bounds that are nearer and nearer to the largest gain that was reached."""
        gap = self.asked.gap
        distance = 0.5 * gap
        while self.upper * (1.0 - gap) > max(self.lower, _ZERO) and np.isfinite(self.lower):
            goal = max(self.lower, _ZERO) * (1.0 + distance)
            if goal >= self.upper or self.used >= self.asked.work:
                self.reason = self.used_up()
                return
            is_wrong = partial(_is_above, self.model, 1.0, 1.0 / goal)
            outcome = self.cut(1.0, found, is_wrong, 1.0 / goal)
            if outcome.log is not None:
                self.proof = BoxProof(1.0, outcome.log, 1.0 / goal, *self.signals)
                self.upper = goal * _OUTSIDE
                distance = 0.5 * gap
            elif outcome.counterexample is not None:
                self.took(largest_peak(self.model, 1.0, (outcome.counterexample,)))
            else:
                distance *= _WIDER * _WIDER
                self.reason = resistance(outcome, 1.0, self.model)
            self.told()

    def answer(self) -> Bounds:
        is_open = not self.upper * (1.0 - self.asked.gap) <= self.lower or self.lower == 0.0
        proved = bool(np.isfinite(self.upper))
        reason = self.reason if is_open or np.isinf(self.lower) else ""
        return self.told_of("worst-case gain", proved=proved, reason=reason)


@dataclass(slots=True)
class _PerformanceSearch(_PeakSearch):
    """The margin of performance."""

    def search(self) -> None:
        self.reach()
        self.told()
        self.reason = too_large(self.model)
        if not self.reason:
            self.raise_lower(cost_of(self.model))

    def reach(self) -> None:
        """The smallest k found at which the gain somewhere on the box is at least 1/k."""
        stable = min(smallest_crossing(self.model, self.asked.largest).size, self.asked.largest)
        low, high = 0.0, stable
        for _ in range(_BISECTIONS):
            k = 0.5 * (low + high)
            peak = largest_peak(self.model, k)
            if peak.gain * k >= 1.0:
                high = self.upper = k
                self.best = peak
            else:
                low = k
            if high - low <= 0.02 * self.asked.gap * high:
                return

    def tried(self, k: float) -> bool:
        found = self.expanded(k)
        if found is None:
            return False
        is_wrong = partial(_is_above, self.model, k, k)
        outcome = self.cut(k, found, is_wrong, k, share=self.share)
        if outcome.log is not None:
            self.lower, self.proof = k, BoxProof(k, outcome.log, k, *self.signals)
        elif outcome.counterexample is not None:
            self.upper, self.best = k, peak_at(self.model, k * outcome.counterexample)
        return outcome.log is not None or outcome.counterexample is not None

    def answer(self) -> Bounds:
        reason = "" if self.is_closed else self.reason
        return self.told_of("robust performance", proved=self.lower > 0.0, reason=reason)
