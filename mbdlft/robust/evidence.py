"""What an analysis returns: bounds, the worst case, a claim, and a proof that can be checked again."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbdlft.base.array import Array
from mbdlft.base.display import heading, table
from mbdlft.exact.rounding import EPS

Complex = NDArray[np.complex128]


class Multipliers(NamedTuple):
    """D (n, n) and G (n, n) of a matrix that was made square, and the beta that they prove."""

    beta: float
    D: Complex
    G: Complex


class Interval(NamedTuple):
    """Frequencies (rad/s) from low to high, which may be inf and is included, with one inside."""

    low: float
    at: float
    high: float


@dataclass(frozen=True, slots=True, eq=False)
class IntervalProof:
    """Parts of the box, and in each intervals with multipliers (`mbdlft.robust.mu.mixed`)."""

    # two numbers for each part, depth first, the lower half first: how many of the intervals are its own;
    # 0, or 1 + the number of the block that is cut in the middle
    log: tuple[int, ...]
    intervals: tuple[Interval, ...]
    multipliers: tuple[Multipliers, ...]  # for beta = 1 and the size of the part


@dataclass(frozen=True, slots=True, eq=False)
class BoxProof:
    """Cuts of the box that prove a claim, as `mbdlft.robust.bisect.boxes` explains them."""

    log: tuple[int, ...]


@dataclass(frozen=True, slots=True, eq=False)
class MotionProof:
    """A form that proves a claim for parameters that move (`mbdlft.robust.moving.variation`)."""

    P: Array  # (n + n_s, n + n_s)
    X: Array  # (m, m)
    Y: Array  # (m, m)
    states: Array  # (n, n), P is for this times the states
    channels: Array  # (r,), powers of two that z and w were divided by; X and Y are for these
    time: float  # the power of two that time was multiplied by (rad/s)


@dataclass(frozen=True, slots=True, eq=False)
class PolynomialProof:
    """A function that falls along all motions (`mbdlft.robust.moving.polynomial`)."""

    V: Array  # (coefficients in the deltas, products of 2 degree states)
    G: Array  # (ends of rates times coefficients, p, p), p the products of degree states
    states: Array  # (n, n), V is of this times the states
    degree: int
    orders: NDArray[np.int64]  # (number of deltas,), degrees of V in them


@dataclass(frozen=True, slots=True, eq=False)
class LyapunovProof:
    """Lyapunov functions on parts of the box (`mbdlft.robust.bisect.lyapunov`)."""

    # parts depth first, the lower half first: 0 for a proved one, 1 + the delta that is cut
    log: tuple[int, ...]
    # (proved parts, number of deltas), of the function of each part in each delta
    degrees: NDArray[np.int64]
    states: Array  # (proved parts, n, n), modes of each part as columns, of which its function follows


ProofOfMotions = MotionProof | PolynomialProof  # for parameters that move
Proof = BoxProof | IntervalProof | ProofOfMotions | LyapunovProof
STABILITY, PERFORMANCE, GAIN = "robust stability", "robust performance", "worst-case gain"
REAL_PART, DAMPING, DISK = "largest real part", "smallest damping", "smallest disk margin"
SENTENCES = {
    STABILITY: "stable for all values in {bound} times the ranges{fixed}",
    PERFORMANCE: "the gain {signals} is at most 1/{bound} for all values in {bound} times the ranges",
    GAIN: "the gain {signals} is at most {bound} for all values in the ranges",
    REAL_PART: "no pole has a real part above {bound} rad/s for all values in the ranges",
    DAMPING: "no pole is damped less than {bound} for all values in the ranges",
    DISK: "the disk margin {signals} is at least {bound} for all values in the ranges",
}


@dataclass(frozen=True, slots=True)
class Claim:
    """What is said of a system, at all frequencies and for all values in a box: a proof is of a claim."""

    kind: str  # one of `SENTENCES`
    bound: float  # of a margin, how many times the declared ranges; else the number that is not passed
    inputs: tuple[str, ...] = ()  # signals of a gain, a performance, or a disk margin
    outputs: tuple[str, ...] = ()
    # bounds of rates in units of the parameters per second, inf for any motion; others are constant
    rates: Mapping[str, float] = field(default_factory=dict)
    fixed: tuple[str, ...] = ()  # blocks that stay in their ranges whatever the margin
    leave_out: tuple[str, ...] = ()  # states that do not count

    @property
    def size(self) -> float:
        """How many times the declared ranges the box is."""
        return self.bound if self.kind in (STABILITY, PERFORMANCE) else 1.0

    @property
    def gain(self) -> float:
        """One over the largest gain that is allowed; 0 if there is none."""
        if self.kind == GAIN:
            return one_over(self.bound)
        return self.bound if self.kind in (PERFORMANCE, DISK) else 0.0

    @property
    def edge(self) -> tuple[float, float]:
        """Poles are left of shift + (j - slope) omega (rad/s), and its mirror image: shift and slope."""
        if self.kind == REAL_PART:
            return self.bound, 0.0
        return 0.0, slope_of(self.bound) if self.kind == DAMPING else 0.0

    def __str__(self) -> str:
        signals = f"from {', '.join(self.inputs)} to {', '.join(self.outputs)}"
        fixed = f", {', '.join(self.fixed)} in theirs" if self.fixed else ""
        bound = f"{self.bound:.6g}"
        text = SENTENCES.get(self.kind, self.kind).format(bound=bound, signals=signals, fixed=fixed)
        if self.rates:
            moving = ", ".join(f"{name} {rate:g}" for name, rate in self.rates.items())
            text += f", also while they move at rates up to {moving} per second"
        return text + (f"; {', '.join(self.leave_out)} left out" if self.leave_out else "")


def one_over(bound: float) -> float:
    """A number whose product with a positive bound is 1 or more."""
    return float(np.nextafter(1.0 / bound, np.inf)) if bound else np.inf


def slope_of(damping: float) -> float:
    """A slope of edges left of which poles are damped by at least so much, which is inside (-1, 1)."""
    slope = damping / math.sqrt((1.0 - damping) * (1.0 + damping))
    return slope + 8.0 * EPS * abs(slope)


@dataclass(frozen=True, slots=True, eq=False)
class Bounds:
    """Bounds of a margin or of a gain, with the worst case that was found.

    Attributes
    ----------
    kind : str
        ``robust stability``, ``worst-case gain``, ``robust performance``, ``largest real part``,
        ``smallest damping``, ``smallest disk margin``; ``worst-case H2 norm`` and others have no proof.
    lower, upper : float
        Of a margin and a damping, `lower` is claimed and `upper` is reached at `worst`; of a gain and a
        real part, `upper` is claimed and `lower` is reached at `worst`. A margin counts multiples of the
        declared box, in which deltas are in [-1, 1].
    worst : mapping of names to physical values, in the units of the parameters
        Empty if none was found. Beyond the box they are where the map of a parameter leads.
    delta : mapping of names to deltas [1]
        Of blocks that are no parameters, too: complex numbers, and matrices of full blocks.
    frequency : float
        Of the pole on the axis, or of the peak of the gain, at `worst` (rad/s).
    sensitivity : mapping of names to numbers that add up to 1
        Shares of the ranges in how the result changes, to first order, if all grow by the same part.
    work : float
        Units of work that were used.
    reason : str
        Why the gap is larger than what was asked for; empty if it is not.
    proof : BoxProof, IntervalProof, MotionProof, PolynomialProof, LyapunovProof, or None
        Evidence for `claim`: what `verify` needs to prove it again, without a search.
    inputs, outputs, rates, fixed, leave_out
        As those of the claim.
    motion : array (N, 1 + number of deltas), or None
        A periodic motion that is `upper` large and does not come to rest, if no constant values are as
        near: times (s) in the middle of even steps, and the deltas there, in the order of `delta`. Those
        of bounded rates are joined by lines, others are kept for their step.
    """

    kind: str
    lower: float
    upper: float
    worst: Mapping[str, float]
    delta: Mapping[str, Any]
    frequency: float
    sensitivity: Mapping[str, float]
    work: float
    reason: str = ""
    proof: Proof | None = None
    leave_out: tuple[str, ...] = ()
    rates: Mapping[str, float] = field(default_factory=dict)
    motion: Array | None = None
    fixed: tuple[str, ...] = ()
    inputs: tuple[str, ...] = ()
    outputs: tuple[str, ...] = ()

    @property
    def is_from_above(self) -> bool:
        """Whether what is large is bad: `upper` is claimed, and `lower` reached."""
        return not self.kind.startswith(("robust", "smallest"))

    @property
    def is_bare(self) -> bool:
        """Whether nothing is proved, and the worst case does not say that nothing can be."""
        return self.proof is None and (
            math.isfinite(self.lower) if self.is_from_above else self.upper > 0.0
        )

    @property
    def reached(self) -> float:
        """The bound that `worst` reaches."""
        return self.lower if self.is_from_above else self.upper

    @property
    def claim(self) -> Claim:
        """What `proof` is evidence for."""
        bound = self.upper if self.is_from_above else self.lower
        named = self.inputs, self.outputs, self.rates, self.fixed, self.leave_out
        return Claim(self.kind, bound, *named)

    @property
    def proved(self) -> bool:
        """Whether there is a proof of the claim; `verify` says whether it is one."""
        return self.proof is not None

    @property
    def gap(self) -> float:
        """(upper - lower)/|upper|; 1 if upper is inf, and inf if it is 0."""
        if math.isinf(self.upper):
            return 1.0
        return (self.upper - self.lower) / abs(self.upper) if self.upper else math.inf

    def __repr__(self) -> str:
        return f"<{self._head()}>"

    def _head(self) -> str:
        why = f"{self.reason and ': '}{self.reason}"
        text = "with a proof" if self.proof else f"no proof{why}"
        return f"{self.kind}: {self.lower:.6g} to {self.upper:.6g}, {text}"

    def _repr_html_(self) -> str:
        text = heading(self._head(), "")
        if self.worst:
            text += heading("", f"worst case, at {self.frequency:.6g} rad/s")
        rows = ((name, float(v), self.sensitivity.get(name, 0.0)) for name, v in self.worst.items())
        return text + table(("parameter", "value", "share"), rows)
