"""Worst-case gain and robust performance: bounds for all frequencies and all values of the parameters.

The worst-case gain is the largest H-infinity norm of a transfer over the declared box. It is bounded from
below by the gain at deltas that an ascent with exact slopes finds, and from above by a proof
(`mbdlft.analyze.boxes`). The margin of robust performance is the largest k for which the gain on the
box of size k is at most 1/k: then weights say what is asked for.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from mbdlft.analyze.boxes import Outcome, prove
from mbdlft.analyze.characteristic import Polynomials, Realization, polynomials
from mbdlft.analyze.margin import cost_of, resistance, too_large
from mbdlft.analyze.peak import NOTHING, Peak, largest_peak, peak_at, slope_at
from mbdlft.analyze.pole_migration import smallest_crossing
from mbdlft.analyze.realization import check_constant, check_nominal, physical, realization, shares
from mbdlft.analyze.result import GAP, LARGEST, WORK, Bounds, BoxProof, Progress, check_numbers
from mbdlft.analyze.varying import Rates, Varying, gain_of, rates_of
from mbdlft.base.errors import WellPosednessError
from mbdlft.base.threads import one_thread
from mbdlft.system.names import positions_of
from mbdlft.system.system import System

_SHARE = 0.5  # of the work that is left, for one bound
_WIDER = 2.0  # factor of the distance of a bound that resisted from the gain that was reached
_BISECTIONS = 40
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
    work : float
        Units of work, each at most about a second of one core. With less, the bounds are farther apart.
    rates : mapping of names to numbers, or number for all, optional
        As for `robust_stability`.
    leave_out : sequence of str
        States on which nothing else depends: their poles do not count.
    progress : function (lower, upper), optional
        Called whenever a bound has changed. If it, or Ctrl-C, raises KeyboardInterrupt, the best bounds
        so far are returned.

    Returns
    -------
    Bounds
        `upper` is proved, and stability with it; `lower` is reached at `worst`. Both are inf if the
        system is unstable at `worst`.

    Raises
    ------
    AnalysisError
        The nominal model is unstable, or has a pole on the axis, which the message names.
    StructureError
        A signal is unknown.
    """
    what = "worst_case_gain"
    check_numbers(what, gap=gap, work=work)
    moving = rates_of(system, rates, what)
    model, proof = _transfer(system, inputs, outputs, leave_out, what)
    gone = tuple(leave_out)
    with one_thread():
        search = _GainSearch(system, model, proof, gap, work, progress, gone)
        if not moving:
            return search.result()
        search.reach()
        signals = proof(1.0, (), 0.0)
        names = signals.inputs, signals.outputs
        return gain_of(Varying(system, model, moving, gap, work, progress, names), search.answer())


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
) -> Bounds:
    """Bounds of the largest k such that the gain is at most 1/k for all |delta| <= k.

    Parameters
    ----------
    system : System or LFTModel
        Nominally stable, with weights at its inputs and outputs: a gain of 1 is what is asked for.
    inputs, outputs : name, number, slice, or list of these, optional
        Signals of the transfer; all, if not given.
    gap, work, leave_out, progress
        As for `worst_case_gain`.
    largest : float
        Margins above this are not told apart.

    Returns
    -------
    Bounds
        `lower` is proved: on the box of this size the gain is at most 1/lower. At `worst` it is 1/upper
        or more, or the system is unstable.

    Raises
    ------
    AnalysisError
        The nominal model is unstable, or has a pole on the axis, which the message names.
    StructureError
        A signal is unknown.
    """
    what = "robust_performance"
    check_constant(system, "robust_performance")
    check_numbers(what, gap=gap, work=work, largest=largest)
    model, proof = _transfer(system, inputs, outputs, leave_out, what)
    gone = tuple(leave_out)
    with one_thread():
        return _PerformanceSearch(system, model, proof, gap, work, progress, gone, largest).result()


def _transfer(
    system: System, inputs: Any, outputs: Any, leave_out: Sequence[str], what: str
) -> tuple[Realization, Callable[[float, tuple[int, ...], float], BoxProof]]:
    """The transfer, stable at nominal, and what makes a proof of its k, log and gain."""
    own = [s.name for s in system.inputs], [s.name for s in system.outputs]
    j = positions_of(inputs, own[0], f"{what}: inputs of {system.name}")
    i = positions_of(outputs, own[1], f"{what}: outputs of {system.name}")
    names = tuple(own[0][k] for k in j), tuple(own[1][k] for k in i)
    model = realization(system, j, i, leave_out)
    check_nominal(system, model.A, leave_out, what)
    return model, lambda k, log, gain: BoxProof(k, log, gain, *names)


@dataclass(slots=True)
class _GainSearch:
    """The bounds so far, and the work that is left."""

    system: System
    model: Realization
    proof_of: Callable[[float, tuple[int, ...], float], BoxProof]
    gap: float
    work: float
    progress: Progress | None
    leave_out: tuple[str, ...]
    best: Peak = NOTHING
    upper: float = np.inf
    proof: BoxProof | None = None
    used: float = 0.0
    reason: str = ""

    def result(self) -> Bounds:
        try:
            self.search()
        except KeyboardInterrupt:
            self.reason = "it was interrupted"
        return self.answer()

    def told(self) -> None:
        if self.progress is not None:
            self.progress(self.best.gain, self.upper)

    def reach(self) -> None:
        """The largest gain that a search finds."""
        crossing = smallest_crossing(self.model, 1.0)
        if np.isfinite(crossing.size):
            self.best = Peak(np.inf, crossing.frequency, crossing.delta)
            self.reason = "the system is unstable at the worst case"
            return
        self.best = largest_peak(self.model, 1.0)
        self.told()

    def search(self) -> None:
        self.reach()
        self.reason = self.reason or too_large(self.model)
        if self.reason or not np.isfinite(self.best.gain):
            return
        self.used += cost_of(self.model)
        try:
            found = polynomials(self.model, 1.0)
        except WellPosednessError as error:
            self.reason = str(error)
            return
        self.lower_upper(found)

    def lower_upper(self, found: Polynomials) -> None:
        """Prove bounds that are nearer and nearer to the largest gain that was reached."""
        distance = 0.5 * self.gap
        while self.upper * (1.0 - self.gap) > self.best.gain and np.isfinite(self.best.gain):
            goal = max(self.best.gain, 1e-300) * (1.0 + distance)
            if goal >= self.upper or self.used >= self.work:
                self.reason = self.reason or f"the work of {self.work:g} units was used up"
                return
            outcome = self.tried(found, goal)
            if outcome.log is not None:
                self.proof = self.proof_of(1.0, outcome.log, 1.0 / goal)
                self.upper = goal * _OUTSIDE
                distance = 0.5 * self.gap
            elif outcome.counterexample is not None:
                self.best = largest_peak(self.model, 1.0, (outcome.counterexample,))
            else:
                distance *= _WIDER * _WIDER
                self.reason = resistance(outcome, 1.0, self.model)
            self.told()

    def tried(self, found: Polynomials, goal: float) -> Outcome:
        outcome = prove(
            self.model,
            1.0,
            found,
            _SHARE * (self.work - self.used),
            lambda delta: peak_at(self.model, delta).gain >= goal,
            1.0 / goal,
        )
        self.used += outcome.work
        return outcome

    def answer(self) -> Bounds:
        names, best = self.model.names, self.best
        known = len(best.delta) == len(names) and not np.isnan(best.frequency)
        finite = known and np.isfinite(best.gain) and best.gain > 0.0
        parts = best.delta * slope_at(self.model, best) if finite else np.zeros(len(names))
        is_open = not self.upper * (1.0 - self.gap) <= best.gain or not finite
        return Bounds(
            "worst-case gain",
            best.gain,
            self.upper,
            physical(self.system, names, best.delta) if known else {},
            dict(zip(names, best.delta.tolist(), strict=True)) if known else {},
            best.frequency,
            bool(np.isfinite(self.upper)),
            shares(names, parts),
            self.used,
            self.reason if is_open else "",
            self.proof,
            self.leave_out,
        )


@dataclass(slots=True)
class _PerformanceSearch:
    """The bounds so far, and the work that is left."""

    system: System
    model: Realization
    proof_of: Callable[[float, tuple[int, ...], float], BoxProof]
    gap: float
    work: float
    progress: Progress | None
    leave_out: tuple[str, ...]
    largest: float
    lower: float = 0.0
    upper: float = np.inf
    best: Peak = NOTHING
    proof: BoxProof | None = None
    used: float = 0.0
    reason: str = ""

    def result(self) -> Bounds:
        try:
            self.reached()
            self.told()
            self.raise_lower()
        except KeyboardInterrupt:
            self.reason = "it was interrupted"
        return self.answer()

    def told(self) -> None:
        if self.progress is not None:
            self.progress(self.lower, self.upper)

    def reached(self) -> None:
        """The smallest k found at which the gain somewhere on the box is at least 1/k."""
        stable = min(smallest_crossing(self.model, self.largest).size, self.largest)
        low, high = 0.0, stable
        for _ in range(_BISECTIONS):
            k = 0.5 * (low + high)
            peak = largest_peak(self.model, k)
            if peak.gain * k >= 1.0:
                high = self.upper = k
                self.best = peak
            else:
                low = k
            if high - low <= 0.02 * self.gap * high:
                return

    def raise_lower(self) -> None:
        """Prove boxes of sizes nearer and nearer to what was reached."""
        self.reason, high = too_large(self.model), np.inf
        while not self.reason and self.lower < min(self.upper, self.largest) * (1.0 - self.gap):
            k = min(self.upper, self.largest) * (1.0 - 0.5 * self.gap)
            k = k if k < high else self.lower + 0.7 * (high - self.lower)
            cost = cost_of(self.model)
            if self.used + cost > self.work or k <= self.lower * (1.0 + 0.1 * self.gap):
                self.reason = f"the work of {self.work:g} units was used up"
                return
            self.used += cost
            outcome = self.tried(k)
            if outcome is not None and outcome.log is not None:
                self.lower, self.proof = k, self.proof_of(k, outcome.log, k)
            elif outcome is not None and outcome.counterexample is not None:
                self.upper, self.best = k, peak_at(self.model, k * outcome.counterexample)
            else:
                high = k
            self.told()

    def tried(self, k: float) -> Outcome | None:
        try:
            found = polynomials(self.model, k)
        except WellPosednessError:
            return None
        share = _SHARE if self.lower else _SHARE * _SHARE
        outcome = prove(
            self.model,
            k,
            found,
            share * (self.work - self.used),
            lambda delta: peak_at(self.model, k * delta).gain * k >= 1.0,
            k,
        )
        self.used += outcome.work
        return outcome

    def answer(self) -> Bounds:
        names, best = self.model.names, self.best
        known = len(best.delta) == len(names) and bool(np.isfinite(self.upper))
        finite = known and np.isfinite(best.gain) and best.gain > 0.0
        parts = best.delta * slope_at(self.model, best) if finite else np.zeros(len(names))
        return Bounds(
            "robust performance",
            self.lower,
            self.upper,
            physical(self.system, names, best.delta) if known else {},
            dict(zip(names, best.delta.tolist(), strict=True)) if known else {},
            best.frequency,
            self.lower > 0.0,
            shares(names, parts),
            self.used,
            self.reason,
            self.proof,
            self.leave_out,
        )
