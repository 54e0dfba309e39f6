"""The margin of robust stability: how many times the declared box of the parameters stays stable.

The margin is the largest k such that the system has all poles in the open left half-plane, and is well
posed, for all |delta_j| < k. It is bounded from above by deltas with a pole on or beyond the axis, which
are found by following poles, and from below by a proof for the box of size k
(`mbdlft.analyze.boxes`). Both are for every frequency; there is no grid.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from math import prod
from typing import Any

import numpy as np

from mbdlft.analyze.boxes import Outcome, prove
from mbdlft.analyze.characteristic import Realization, polynomials
from mbdlft.analyze.pole_migration import Crossing, abscissa, improved, smallest_crossing
from mbdlft.analyze.realization import (
    check_nominal,
    check_parameters,
    physical,
    realization,
    shares,
)
from mbdlft.base.array import Array
from mbdlft.base.errors import AnalysisError, WellPosednessError
from mbdlft.base.threads import one_thread
from mbdlft.system.system import System

GAP, WORK, LARGEST = 0.01, 30.0, 100.0
_MOST_COEFFICIENTS = 4e6  # of a polynomial in memory
_LOWER = 0.7  # a target that was not proved is taken nearer to what is: this part of the way
_SHARE = 0.5  # of the work that is left, for one target

Progress = Callable[[float, float], None]


@dataclass(frozen=True, slots=True, eq=False)
class BoxProof:
    """What proves a lower bound: cuts of the box of size k, as `mbdlft.analyze.boxes` explains them."""

    k: float
    log: tuple[int, ...]
    gain: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class RobustStability:
    """Bounds of the margin, in multiples of the declared box, deltas being in [-1, 1] there.

    Attributes
    ----------
    lower : float
        The system is stable and well posed for all |delta| <= lower: proved.
    upper : float
        Largest |delta| of `delta`, at which a pole lies on or beyond the axis: checked by evaluation;
        inf if no such point was found.
    worst : mapping of names to physical values, in the units of the parameters
        Of the parameters at `upper`; empty if upper is inf. Beyond the box they are where the map of the
        parameter leads.
    delta : mapping of names to deltas [1]
    frequency : float
        Of the pole at `worst` (rad/s); NaN if upper is inf.
    proved : bool
        Whether `lower` is proved for every frequency and every value, and is not 0.
    sensitivity : mapping of names to numbers that add up to 1
        By how many percent the margin falls, to first order, if one range grows by a percent.
    work : float
        Units of work that were used.
    reason : str
        Why the gap is larger than what was asked for; empty if it is not.
    proof : BoxProof or None
        With which `verify` proves `lower` again.
    """

    lower: float
    upper: float
    worst: Mapping[str, float]
    delta: Mapping[str, float]
    frequency: float
    proved: bool
    sensitivity: Mapping[str, float]
    work: float
    reason: str = ""
    proof: Any = None

    @property
    def gap(self) -> float:
        """(upper - lower)/upper."""
        return 1.0 - self.lower / self.upper if np.isfinite(self.upper) else 1.0


def robust_stability(
    system: System,
    *,
    gap: float = GAP,
    work: float = WORK,
    largest: float = LARGEST,
    progress: Progress | None = None,
) -> RobustStability:
    """Bounds of the margin of robust stability, guaranteed for all frequencies and all values.

    Parameters
    ----------
    system : System or LFTModel
        Nominally stable.
    gap : float
        The part of the margin by which its bounds may differ.
    work : float
        Units of work, each at most about a second of one core. With less, the bounds are farther apart.
        The result depends on it and not on the time that passes.
    largest : float
        Margins above this are not told apart.
    progress : function (lower, upper), optional
        Called whenever a bound has changed. If it, or Ctrl-C, raises KeyboardInterrupt, the best bounds
        so far are returned.

    Raises
    ------
    AnalysisError
        The nominal model is unstable, or has a pole on the axis, which the message names; there is no
        parameter; the model is too large.
    """
    _check_numbers(gap, work, largest)
    check_parameters(system, "robust_stability")
    check_nominal(system, "robust_stability")
    with one_thread():
        return _Search(system, realization(system), gap, work, largest, progress).result()


def _check_numbers(gap: float, work: float, largest: float) -> None:
    for name, value, low, high in (
        ("gap", gap, 0.0, 1.0),
        ("work", work, 0.0, np.inf),
        ("largest", largest, 0.0, np.inf),
    ):
        if isinstance(value, bool) or not isinstance(value, int | float) or not low < value < high:
            raise AnalysisError(
                f"robust_stability: {name}: expected a number between {low:g} and {high:g}, got {value!r}."
            )


@dataclass(slots=True)
class _Search:
    """The bounds so far, and the work that is left."""

    system: System
    model: Realization
    gap: float
    work: float
    largest: float
    progress: Progress | None
    lower: float = 0.0
    best: Crossing = field(init=False)
    proof: BoxProof | None = None
    used: float = 0.0
    reason: str = ""

    def result(self) -> RobustStability:
        self.best = Crossing(np.inf, np.zeros(len(self.model.sizes)), np.nan, np.zeros(0))
        try:
            self.best = smallest_crossing(self.model, self.largest)
            self.told()
            self.raise_lower()
        except KeyboardInterrupt:
            self.reason = "it was interrupted"
        return self.answer()

    def told(self) -> None:
        if self.progress is not None:
            self.progress(self.lower, self.best.size)

    def raise_lower(self) -> None:
        """Prove boxes of sizes nearer and nearer to the best crossing."""
        cost = _cost(self.model)
        if self.model.count > _MOST_COEFFICIENTS:
            self.reason = (
                f"the characteristic polynomial has {self.model.count:.2g} coefficients, more than "
                f"the {_MOST_COEFFICIENTS:.2g} that are carried"
            )
            return
        high = np.inf  # a size that was not proved
        while True:
            goal = min(self.best.size, self.largest) * (1.0 - 0.5 * self.gap)
            if self.lower >= min(self.best.size, self.largest) * (1.0 - self.gap):
                return
            k = goal if goal < high else self.lower + _LOWER * (high - self.lower)
            if self.used + cost > self.work or k <= self.lower * (1.0 + 0.1 * self.gap):
                self.reason = self.reason or f"the work of {self.work:g} units was used up"
                return
            outcome = self.tried(k, cost)
            if outcome is None:
                high = k
            elif outcome.log is not None:
                self.lower, self.proof = k, BoxProof(k, outcome.log)
            elif outcome.counterexample is not None:
                before = self.best.size
                delta = k * outcome.counterexample
                self.best = improved(self.model, delta, self.best, self.largest)
                if not self.best.size < before:
                    high = k
            else:
                high = k
                self.reason = _resistance(outcome, k, self.model)
            self.told()

    def tried(self, k: float, cost: float) -> Outcome | None:
        """What comes of the box of size k; None if the model is singular in it."""
        self.used += cost
        try:
            found = polynomials(self.model, k)
        except WellPosednessError as error:
            self.reason = f"at {k:.4g} times the box {error}"
            return None
        share = _SHARE if self.lower else _SHARE * _SHARE
        outcome = prove(
            self.model,
            k,
            found,
            share * max(self.work - self.used, 0.0),
            lambda delta: abscissa(self.model, k * delta) >= 0.0,
        )
        self.used += outcome.work
        return outcome

    def answer(self) -> RobustStability:
        names, best = self.model.names, self.best
        known = np.isfinite(best.size)
        parts = best.delta * best.slope if len(best.slope) == len(names) else np.zeros(len(names))
        is_open = known and self.lower < best.size * (1.0 - self.gap)
        return RobustStability(
            self.lower,
            best.size,
            physical(self.system, names, best.delta) if known else {},
            dict(zip(names, best.delta.tolist(), strict=True)) if known else {},
            best.frequency,
            self.lower > 0.0,
            shares(names, parts) if known else {},
            self.used,
            self.reason if is_open or not known else "",
            self.proof,
        )


def _cost(model: Realization) -> float:
    """Units of work of the Bernstein coefficients of a box."""
    nodes = prod(size + 1 for size in model.sizes)
    return float(nodes * (6e-5 + 4e-7 * len(model.A) ** 3))


def _resistance(outcome: Outcome, k: float, model: Realization) -> str:
    """What resisted a proof, and where."""
    assert outcome.open_box is not None
    box = outcome.open_box
    ends = ", ".join(
        f"{name} in [{k * (c - h):.3g}, {k * (c + h):.3g}]"
        for name, c, h in zip(model.names, box.center, box.half, strict=True)
    )
    return (
        f"at {k:.4g} times the box, neither stability nor an unstable point was found with this work "
        f"for deltas {ends}, near {outcome.frequency:.4g} rad/s"
    )


