"""What an analysis returns: bounds, the worst case, and a proof that can be checked again."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbdlft.base.array import Array
from mbdlft.base.display import heading, table

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
    """Parts of the box, and in each intervals of frequency with multipliers (`mbdlft.robust.mu.mixed`).

    Attributes
    ----------
    k : float
        Size of the blocks that are not fixed.
    log : tuple of int
        Two numbers for each part, depth first, the lower half first: how many of the intervals are its
        own; 0, or 1 + the number of the block that is cut in the middle.
    intervals : tuple of Interval
    multipliers : tuple of Multipliers
        For beta = 1 and the size of the part.
    fixed : tuple of str
        Blocks of size 1.
    inputs, outputs : tuple of str
        Signals that a full block of performance joins; its size is one over the gain.
    """

    k: float
    log: tuple[int, ...]
    intervals: tuple[Interval, ...]
    multipliers: tuple[Multipliers, ...]
    fixed: tuple[str, ...] = ()
    inputs: tuple[str, ...] = ()
    outputs: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class BoxProof:
    """Cuts of the box |delta| <= k that prove a bound, as `mbdlft.robust.bisect.boxes` explains them.

    Attributes
    ----------
    k : float
    log : tuple of int
    gain : float
        One over the bound of the gain that is proved, too; 0 if only stability is.
    inputs, outputs : tuple of str
        Signals of the gain.
    shift, slope : float
        Poles are left of shift + (j - slope) omega (rad/s) and of its mirror image; 0 for stability.
    """

    k: float
    log: tuple[int, ...]
    gain: float = 0.0
    inputs: tuple[str, ...] = ()
    outputs: tuple[str, ...] = ()
    shift: float = 0.0
    slope: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class MotionProof:
    """A form that proves a bound for parameters that move (`mbdlft.robust.moving.variation`).

    Attributes
    ----------
    k : float
        The deltas stay in [-k, k].
    P, X, Y : arrays (n + n_s, n + n_s), (m, m), (m, m)
    states : array (n, n)
        P is for this times the states.
    channels : array (r,)
        Powers of two that z and w were divided by; X and Y are for these.
    time : float
        The power of two that time was multiplied by (rad/s).
    gain : float
        The bound of the gain that is proved, too; 0 if only stability is.
    inputs, outputs : tuple of str
        Signals of the gain.
    """

    k: float
    P: Array
    X: Array
    Y: Array
    states: Array
    channels: Array
    time: float
    gain: float = 0.0
    inputs: tuple[str, ...] = ()
    outputs: tuple[str, ...] = ()


Proof = BoxProof | IntervalProof | MotionProof


@dataclass(frozen=True, slots=True, eq=False)
class Bounds:
    """Bounds of a margin or of a gain, with the worst case that was found.

    Attributes
    ----------
    kind : str
        ``robust stability``, ``worst-case gain``, ``robust performance``, ``largest real part``,
        ``smallest damping``; ``worst-case H2 norm`` and others have no proof.
    lower, upper : float
        Of a margin, `lower` is proved and `upper` is reached at `worst`; of a gain, `upper` is proved and
        `lower` is reached at `worst`. What is reached is checked by evaluation. A margin counts multiples
        of the declared box, in which deltas are in [-1, 1].
    worst : mapping of names to physical values, in the units of the parameters
        Empty if none was found. Beyond the box they are where the map of a parameter leads.
    delta : mapping of names to deltas [1]
        Of blocks that are no parameters, too: complex numbers, and matrices of full blocks.
    frequency : float
        Of the pole on the axis, or of the peak of the gain, at `worst` (rad/s).
    proved : bool
        Whether the bound that is said to be proved is, for every frequency and every value, and is not
        trivial (0 of a margin, inf of a gain).
    sensitivity : mapping of names to numbers that add up to 1
        Shares of the ranges in how the result changes, to first order, if all grow by the same part.
    work : float
        Units of work that were used.
    reason : str
        Why the gap is larger than what was asked for; empty if it is not.
    proof : BoxProof, IntervalProof, MotionProof, or None
        What `verify` needs to prove the bound again, without a search.
    leave_out : tuple of str
        States that do not count.
    rates : mapping of names to bounds of the rates of parameters, in their units per second
        inf where a parameter may move in any way; constant parameters are not named.
    fixed : tuple of str
        Blocks of size 1 whatever the margin.
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
    proved: bool
    sensitivity: Mapping[str, float]
    work: float
    reason: str = ""
    proof: Proof | None = None
    leave_out: tuple[str, ...] = ()
    rates: Mapping[str, float] = field(default_factory=dict)
    motion: Array | None = None
    fixed: tuple[str, ...] = ()

    @property
    def gap(self) -> float:
        """(upper - lower)/upper; 1 if upper is inf."""
        return 1.0 - self.lower / self.upper if self.upper < float("inf") else 1.0

    def __repr__(self) -> str:
        said = "proved" if self.proved else f"not proved{self.reason and ': '}{self.reason}"
        return f"<{self.kind}: {self.lower:.6g} to {self.upper:.6g}, {said}>"

    def _repr_html_(self) -> str:
        said = "proved" if self.proved else "not proved"
        text = heading(f"{self.kind}: {self.lower:.6g} to {self.upper:.6g}, {said}", self.reason)
        if self.worst:
            text += heading("", f"worst case, at {self.frequency:.6g} rad/s")
        rows = ((name, float(v), self.sensitivity.get(name, 0.0)) for name, v in self.worst.items())
        return text + table(("parameter", "value", "share"), rows)
