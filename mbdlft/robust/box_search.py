"""What searches share that prove by cuts of boxes (`mbdlft.robust.boxes`): margins, gains and poles."""

from dataclasses import dataclass, field
from math import prod

import numpy as np

from mbdlft.base.array import Array
from mbdlft.base.errors import WellPosednessError
from mbdlft.base.spent import after
from mbdlft.robust.anytime import SHARE, Search
from mbdlft.robust.boxes import Check, Outcome, prove
from mbdlft.robust.characteristic import Polynomials, Realization, polynomials
from mbdlft.robust.evidence import Bounds

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
