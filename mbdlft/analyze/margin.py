"""The margin of robust stability: how many times the declared box of the parameters stays stable.

The margin is the largest k such that the system has all poles in the open left half-plane, and is well
posed, for all |delta_j| < k. It is bounded from above by deltas with a pole on or beyond the axis, which
are found by following poles, and from below by a proof for the box of size k
(`mbdlft.analyze.boxes`). Both are for every frequency; there is no grid. Where Delta has blocks that are
not real parameters, or the polynomial is too large, multipliers take their place
(`mbdlft.analyze.multiplier_margin`).
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from math import prod

import numpy as np

from mbdlft.analyze.boxes import Outcome, prove
from mbdlft.analyze.characteristic import Realization, polynomials
from mbdlft.analyze.multiplier_margin import by_multipliers
from mbdlft.analyze.pole_migration import Crossing, abscissa, improved, smallest_crossing
from mbdlft.analyze.realization import (
    check_nominal,
    check_parameters,
    physical,
    realization,
    shares,
    states_that_stay,
)
from mbdlft.analyze.result import (
    GAP,
    LARGEST,
    WORK,
    Bounds,
    BoxProof,
    Progress,
    check_numbers,
)
from mbdlft.analyze.varying import Rates, Varying, margin_of, rates_of
from mbdlft.base.errors import WellPosednessError
from mbdlft.base.threads import one_thread
from mbdlft.system.system import System

_MOST_COEFFICIENTS = 4e6  # of a polynomial in memory
_DEAR = 20.0  # units of work: above this a polynomial costs more than multipliers
_LOWER = 0.7  # a target that was not proved is taken nearer to what is: this part of the way
_SHARE = 0.5  # of the work that is left, for one target


def robust_stability(
    system: System,
    *,
    gap: float = GAP,
    work: float = WORK,
    largest: float = LARGEST,
    rates: Rates = None,
    leave_out: Sequence[str] = (),
    progress: Progress | None = None,
) -> Bounds:
    """Bounds of the margin of robust stability, guaranteed for all frequencies and all values.

    With `rates`, for all motions of the parameters that are not faster: then `lower` is proved by a
    quadratic form that falls along each of them, and `upper` is that of constant values, or of a
    periodic motion.

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
    rates : mapping of names to numbers, or number for all, optional
        Bounds of how fast parameters move, in their units per second: 0, the default, for constants; inf
        for any motion.
    leave_out : sequence of str
        States on which nothing else depends, such as positions that no loop measures: their poles do
        not count.
    progress : function (lower, upper), optional
        Called whenever a bound has changed. If it, or Ctrl-C, raises KeyboardInterrupt, the best bounds
        so far are returned.

    Returns
    -------
    Bounds
        `lower` is proved; at `worst`, which is `upper` away, a pole lies on or beyond the axis.

    Raises
    ------
    AnalysisError
        The nominal model is unstable, or has a pole on the axis, which the message names; there is no
        parameter; the model is too large; a rate is of no parameter, or no bound.
    """
    check_numbers("robust_stability", gap=gap, work=work, largest=largest)
    moving = rates_of(system, rates, "robust_stability")
    check_parameters(system, "robust_stability")
    stay = states_that_stay(system, leave_out)
    check_nominal(system, system.A[np.ix_(stay, stay)], leave_out, "robust_stability")
    gone = tuple(leave_out)
    with one_thread():
        if moving:
            model = realization(system, leave_out=leave_out)
            search = _Search(system, model, gap, work, largest, progress, gone)
            search.best = smallest_crossing(model, largest)
            asked = Varying(system, model, moving, gap, work, progress)
            return margin_of(asked, search.answer(), largest)
        if system.lft.is_plain:
            model = realization(system, leave_out=leave_out)
            if not too_large(model) and cost_of(model) <= min(_DEAR, work):
                return _Search(system, model, gap, work, largest, progress, gone).result()
        return by_multipliers(system, stay, gap, work, largest, progress, gone)


@dataclass(slots=True)
class _Search:
    """The bounds so far, and the work that is left."""

    system: System
    model: Realization
    gap: float
    work: float
    largest: float
    progress: Progress | None
    leave_out: tuple[str, ...]
    lower: float = 0.0
    best: Crossing = field(init=False)
    proof: BoxProof | None = None
    used: float = 0.0
    reason: str = ""

    def result(self) -> Bounds:
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
        cost = cost_of(self.model)
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
            else:
                before, point = self.best.size, outcome.counterexample
                if point is None:
                    point = outcome.open_box.center
                    self.reason = resistance(outcome, k, self.model)
                self.best = improved(self.model, k * point, self.best, self.largest)
                if not self.best.size < before:
                    high = k
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

    def answer(self) -> Bounds:
        names, best = self.model.names, self.best
        known = np.isfinite(best.size)
        parts = best.delta * best.slope if len(best.slope) == len(names) else np.zeros(len(names))
        is_open = known and self.lower < best.size * (1.0 - self.gap)
        return Bounds(
            "robust stability",
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
            self.leave_out,
        )


def cost_of(model: Realization) -> float:
    """Units of work of the Bernstein coefficients of a box."""
    nodes = prod(size + 1 for size in model.sizes) * (1 + model.J.size)
    return float(nodes * (6e-5 + 4e-7 * len(model.A) ** 3))


def too_large(model: Realization) -> str:
    """Why a model cannot be proved this way, or nothing."""
    count = model.coefficients * (1 + model.J.size)
    if count <= _MOST_COEFFICIENTS:
        return ""
    return (
        f"the characteristic polynomial has {count:.2g} coefficients, more than the "
        f"{_MOST_COEFFICIENTS:.2g} that are carried"
    )


def resistance(outcome: Outcome, k: float, model: Realization) -> str:
    """What resisted a proof, and where."""
    box = outcome.open_box
    ends = ", ".join(
        f"{name} in [{k * (c - h):.3g}, {k * (c + h):.3g}]"
        for name, c, h in zip(model.names, box.center, box.half, strict=True)
    )
    return (
        f"at {k:.4g} times the box, neither stability nor an unstable point was found with this work "
        f"for deltas {ends}, near {outcome.frequency:.4g} rad/s"
    )
