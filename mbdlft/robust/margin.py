"""The margin of robust stability: how many times the declared box of the parameters stays stable.

The margin is the largest k such that the system has all poles in the open left half-plane, and is well
posed, for all |delta_j| < k. It is bounded from above by deltas with a pole on or beyond the axis, which
are found by following poles, and from below by a proof for the box of size k
(`mbdlft.robust.boxes`). Both are for every frequency; there is no grid. Where Delta has blocks that are
not real parameters, or the polynomial is too large, multipliers take their place
(`mbdlft.robust.mixed`).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

from mbdlft.base.array import Array
from mbdlft.base.errors import AnalysisError
from mbdlft.base.threads import one_thread
from mbdlft.robust.anytime import GAP, LARGEST, WORK, Asked, Progress, check_numbers
from mbdlft.robust.box_search import BoxSearch, cost_of, is_dear, resistance
from mbdlft.robust.characteristic import Realization
from mbdlft.robust.crew import crew_of
from mbdlft.robust.evidence import Bounds, BoxProof
from mbdlft.robust.loop import check_fixed, loop_of
from mbdlft.robust.mixed import MixedSearch
from mbdlft.robust.pole_migration import NONE, Crossing, abscissa, improved, smallest_crossing
from mbdlft.robust.realization import (
    check_parameters,
    realization,
    stable_states,
)
from mbdlft.robust.varying import MovingMargin, Rates, rates_of
from mbdlft.system.system import System


def robust_stability(
    system: System,
    *,
    gap: float = GAP,
    work: float = WORK,
    largest: float = LARGEST,
    rates: Rates = None,
    fixed: Sequence[str] = (),
    leave_out: Sequence[str] = (),
    progress: Progress | None = None,
    workers: int | None = 1,
    client: Any = None,
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
    fixed : sequence of str
        Parameters and blocks that stay within their declared ranges: the margin is how many times the
        ranges of the others may grow (skew mu).
    leave_out : sequence of str
        States on which nothing else depends, such as positions that no loop measures: their poles do
        not count.
    progress : function (lower, upper), optional
        Called whenever a bound has changed. If it, or Ctrl-C, raises KeyboardInterrupt, the best bounds
        so far are returned.
    workers : int, optional
        Processes for parts of the box; None: one for each core. The result does not depend on it.
    client : distributed.Client, optional
        A Dask cluster that computes instead of processes of this machine (extra `cluster`).

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
    what = "robust_stability"
    check_numbers(what, gap=gap, work=work, largest=largest)
    moving = rates_of(system, rates, what)
    check_parameters(system, what)
    kept = check_fixed(system, fixed)
    if moving and kept:
        raise AnalysisError(f"{what}: expected rates or fixed blocks, got both. Fix none.")
    if set(kept) >= {block.name for block in system.lft.blocks if block.inputs}:
        raise AnalysisError(f"{what}: expected a block that is not fixed.")
    stay = stable_states(system, leave_out, what)
    with one_thread(), crew_of(workers, client, what) as crew:
        asked = Asked(system, gap, work, progress, tuple(leave_out), largest, crew)
        if moving:
            model = realization(system, leave_out=leave_out)
            search = _MarginSearch(asked, model=model)
            search.took(smallest_crossing(model, largest))
            constant = search.answer()
            return MovingMargin(asked, model=model, rates=moving, constant=constant).result()
        if system.lft.is_plain and not kept:
            model = realization(system, leave_out=leave_out)
            if not is_dear(model, work):
                return _MarginSearch(asked, model=model).result()
        return MixedSearch(
            asked, loop=loop_of(system, stay, kept), kind="robust stability"
        ).result()


@dataclass(slots=True)
class _MarginSearch(BoxSearch):
    """The margin of a system with parameters only; `upper` is the size of the best crossing."""

    best: Crossing = NONE

    def search(self) -> None:
        self.took(smallest_crossing(self.model, self.asked.largest))
        self.told()
        self.raise_lower(cost_of(self.model))

    def took(self, best: Crossing) -> None:
        self.best, self.upper = best, best.size

    def tried(self, k: float) -> bool:
        found = self.expanded(k)
        if found is None:
            return False
        is_wrong = partial(_is_unstable, self.model, k)
        outcome = self.cut(k, found, is_wrong, share=self.share)
        if outcome.log is not None:
            self.lower, self.proof = k, BoxProof(k, outcome.log)
            return True
        before, point = self.upper, outcome.counterexample
        if point is None:
            point = outcome.open_box.center
            self.reason = resistance(outcome, k, self.model)
        self.took(improved(self.model, k * point, self.best, self.asked.largest))
        return self.upper < before

    def answer(self) -> Bounds:
        is_open, best = self.lower < self.upper * (1.0 - self.asked.gap), self.best
        worst, reason = (best.delta, best.frequency), self.reason if is_open else ""
        return self.said(
            "robust stability", worst, best.slope, proved=self.lower > 0.0, reason=reason
        )


def _is_unstable(model: Realization, k: float, delta: Array) -> bool:
    return abscissa(model, k * delta) >= 0.0
