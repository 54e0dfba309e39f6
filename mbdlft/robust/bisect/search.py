"""What searches for bounds share: arguments, the best bounds so far, and proofs by cuts of boxes."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from math import prod
from typing import Any, NamedTuple

import numpy as np

from mbdlft.base.array import Array
from mbdlft.base.errors import AnalysisError, WellPosednessError
from mbdlft.base.running import after, budget
from mbdlft.robust.bisect.boxes import Check, Outcome, prove
from mbdlft.robust.bisect.characteristic import Polynomials, Realization, polynomials
from mbdlft.robust.crew import ALONE, Crew
from mbdlft.robust.evidence import Bounds as Bounds
from mbdlft.robust.evidence import Proof
from mbdlft.robust.realization import physical, shares
from mbdlft.system.model import System

UNSTABLE = (
    "the system is unstable at the worst case, a value inside the ranges; robust_stability says how much "
    "of the ranges is stable"
)
GAP, WORK, LARGEST = 0.01, 30.0, 100.0
SHARE = 0.5  # of the work that is left, for one target
_LOWER = 0.7  # a target that was not proved is taken nearer to what is: this part of the way


Progress = Callable[[float, float], None]


def check_numbers(what: str, **numbers: float) -> None:
    """Raise an AnalysisError unless the gap is below 1 and all are positive and finite."""
    for name, value in numbers.items():
        most = 1.0 if name == "gap" else float("inf")
        if isinstance(value, bool) or not isinstance(value, int | float) or not 0.0 < value < most:
            raise AnalysisError(
                f"{what}: {name}: expected a number between 0 and {most:g}, got {value!r}."
            )


class Asked(NamedTuple):
    """What is asked for; arguments are those of `robust_stability`."""

    system: System
    gap: float
    work: float
    progress: Progress | None = None
    leave_out: tuple[str, ...] = ()
    largest: float = LARGEST
    crew: Crew = ALONE


@dataclass(slots=True)
class Search:
    """The bounds so far, and the work that was used.

    A search overrides `search`, which makes the bounds better and may be interrupted at any time,
    `answer`, and `tried` if it calls `raise_lower`.
    """

    asked: Asked
    lower: float = 0.0
    upper: float = float("inf")
    proof: Proof | None = None
    used: float = 0.0
    reason: str = ""

    def result(self) -> Bounds:
        """The bounds when the search has ended, or was interrupted."""
        try:
            with budget(self.asked.work):
                self.search()
        except KeyboardInterrupt:
            self.reason = "it was interrupted"
        return self.answer()

    def search(self) -> None:
        """Make the bounds better."""
        raise NotImplementedError

    def answer(self) -> Bounds:
        """The result."""
        raise NotImplementedError

    def told(self) -> None:
        """Tell the user how far it is."""
        if self.asked.progress is not None:
            self.asked.progress(self.lower, self.upper)

    @property
    def left(self) -> float:
        """Units of work that are left."""
        return max(self.asked.work - self.used, 0.0)

    @property
    def is_closed(self) -> bool:
        """Whether the gap of a margin is not larger than what was asked for."""
        return self.lower >= min(self.upper, self.asked.largest) * (1.0 - self.asked.gap)

    def next_size(self, high: float) -> float:
        """The next size of a margin to be tried, below one that was not proved; 0: none is worth it."""
        goal = min(self.upper, self.asked.largest) * (1.0 - 0.5 * self.asked.gap)
        k = goal if goal < high else self.lower + _LOWER * (high - self.lower)
        return k if k > self.lower * (1.0 + 0.1 * self.asked.gap) else 0.0

    @property
    def share(self) -> float:
        """The part of the work that is left for one size: less of it while nothing is proved."""
        return SHARE if self.lower else SHARE * SHARE

    def raise_lower(self, cost: float = 0.0) -> None:
        """Try sizes that are nearer and nearer to `upper`; each costs at least so much work."""
        high = np.inf  # a size that was not proved
        while not self.is_closed:
            k = self.next_size(high)
            if self.used + cost > self.asked.work or not k:
                self.reason = self.used_up()
                return
            if not self.tried(k):
                high = k
            self.told()

    def tried(self, k: float) -> bool:
        """Try to prove a size; whether that made a bound better."""
        raise NotImplementedError

    def used_up(self) -> str:
        """The reason when there is no work left."""
        return self.reason or f"the work of {self.asked.work:g} units was used up"

    def bounds(
        self,
        kind: str,
        delta: Mapping[str, Any],
        frequency: float,
        parts: Array,
        *,
        proved: bool,
        reason: str,
    ) -> Bounds:
        """The result with deltas of blocks and frequency of the worst case, and parts of its change."""
        system = self.asked.system
        own = [name for name in delta if name in system.parameters.names]
        values = np.array([float(delta[name]) for name in own])
        return Bounds(
            kind,
            self.lower,
            self.upper,
            physical(system, own, values) if own else {},
            delta,
            frequency,
            proved,
            shares(list(delta), parts) if delta and np.any(parts) else {},
            self.used,
            reason,
            self.proof,
            self.asked.leave_out,
        )


_MOST_COEFFICIENTS = 4e6  # of a polynomial in memory
_DEAR = 20.0  # units of work: above this a polynomial costs more than multipliers


@dataclass(slots=True)
class BoxSearch(Search):
    """A search that cuts boxes of a model with parameters only."""

    model: Realization = field(kw_only=True)

    def expanded(self, k: float, model: Realization | None = None) -> Polynomials | None:
        """The polynomials on the box of size k; None, and a reason, if the model is singular in it."""
        model = model or self.model
        self.used += cost_of(model)
        try:
            return polynomials(model, k)
        except WellPosednessError as error:
            self.reason = str(error) if k == 1.0 else f"at {k:.4g} times the box {error}"
            return None

    def cut(
        self,
        k: float,
        found: Polynomials,
        is_wrong: Check,
        gain: float = 0.0,
        *,
        model: Realization | None = None,
        share: float = SHARE,
    ) -> Outcome:
        """What comes of a box, with a share of the work that is left; arguments as of `prove`."""
        work, crew = share * self.left, self.asked.crew
        with after(self.used):
            outcome = prove(model or self.model, k, found, work, is_wrong, gain, crew)
        self.used += outcome.work
        return outcome

    def said(
        self,
        kind: str,
        worst: tuple[Array, float],
        slope: Array,
        *,
        proved: bool,
        reason: str,
    ) -> Bounds:
        """The result with deltas, frequency and slope of the worst case; nothing of what is not known."""
        names, (delta, frequency) = self.model.names, worst
        known = len(delta) == len(names) and not np.isnan(frequency)
        given = dict(zip(names, delta.tolist(), strict=True)) if known else {}
        has_slope = len(slope) == len(delta) and bool(np.all(np.isfinite(slope)))
        parts = delta * slope if has_slope else np.zeros(len(delta))
        return self.bounds(kind, given, frequency, parts, proved=proved, reason=reason)


def cost_of(model: Realization) -> float:
    """Units of work of the Bernstein coefficients of a box."""
    nodes = prod(size + 1 for size in model.sizes) * (1 + model.J.size)
    return float(nodes * (6e-5 + 4e-7 * len(model.A) ** 3))


def is_dear(model: Realization, work: float) -> bool:
    """Whether a polynomial is too large, or costs more than multipliers, or than there is."""
    return bool(too_large(model)) or cost_of(model) > min(_DEAR, work)


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
