"""From which states signals stay in their ranges: a level set of what proves robust stability.

With V = x'P x, which falls along all motions, V <= c is never left. There |y| <= r for an output
y = C x + D w, w = Delta z, if

    r^2 V/c - y'y - (z'X z - w'X w + z'Y w - w'Y z) >= 0

for some X = X' > 0, Y = -Y' of the structure of Delta, where the last part is not negative for
|delta| <= 1. So a motion that begins in it keeps its signals in their ranges, and what is proved with
bounds over these ranges is true of it.

Source: H. K. Khalil, Nonlinear Systems, 3rd ed., section 8.2; S-procedure: Boyd et al., Linear Matrix
Inequalities in System and Control Theory (1994), section 2.6.3.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from mbdlft.base.array import Array, ArrayLike
from mbdlft.base.errors import AnalysisError
from mbdlft.base.threads import one_thread
from mbdlft.robust.bisect.characteristic import Realization
from mbdlft.robust.evidence import Bounds, MotionProof
from mbdlft.robust.moving.variation import form_of, is_negative, least_level, scaled, sizes_of
from mbdlft.robust.realization import realization, turned
from mbdlft.system.conversion import positions_of
from mbdlft.system.model import System

_OUTSIDE = 1e-6  # of a level: the first part by which it is taken larger than what the solver found
_TRIES = 5


@dataclass(frozen=True, slots=True, eq=False)
class SafeRegion:
    """States x with x'P x <= 1, which no motion without inputs leaves.

    Attributes
    ----------
    states : tuple of str
    P : array (n, n)
    """

    states: tuple[str, ...]
    P: Array

    def value(self, states: Mapping[str, float] | ArrayLike) -> float:
        """x'P x of states by name, the others zero, or of an array (n,): at most 1 in the region."""
        if isinstance(states, Mapping):
            where = positions_of(list(states), list(self.states), "safe region: states")
            x = np.zeros(len(self.states))
            x[where] = list(states.values())
        else:
            x = np.asarray(states, dtype=float)
        return float(x @ self.P @ x)

    @property
    def extents(self) -> dict[str, float]:
        """The largest size of each state in the region."""
        largest = np.sqrt(np.diag(np.linalg.inv(self.P)))
        return dict(zip(self.states, largest.tolist(), strict=True))


class _Signal(NamedTuple):
    """An output with the size that it may have."""

    name: str
    size: float


def safe_region(
    system: System, bounds: Bounds, ranges: Mapping[str, tuple[float, float]]
) -> SafeRegion:
    """States from which outputs stay in their ranges, for all motions of the parameters in the box.

    Parameters
    ----------
    system : System
        Such as that of `with_sectors`, whose outputs omega are the arguments of the functions.
    bounds : Bounds
        Of its `robust_stability`, of 1 or more, with ``rates=inf``: then V does not depend on parameters.
    ranges : mapping of names of outputs to (low, high)
        Zero is inside; of slopes, these are distances from the equilibrium.

    Returns
    -------
    SafeRegion
        For inputs that are zero. It is proved in balls that V <= 1 keeps the outputs in their ranges.

    Raises
    ------
    AnalysisError
        `bounds` are not such; a range does not contain zero; nothing was proved.
    StructureError
        A name is unknown.
    """
    proof = bounds.proof
    if not isinstance(proof, MotionProof) or bounds.kind != "robust stability":
        raise AnalysisError("safe_region: expected the bounds of robust_stability(..., rates=inf).")
    if proof.k < 1.0 or proof.P.shape != proof.states.shape:
        raise AnalysisError(
            f"safe_region: the proof is for {proof.k:.4g} times the box"
            + ("." if proof.k < 1.0 else ", with parameters in V.")
            + " Expected bounds.lower >= 1, with rates=inf for all parameters."
        )
    names = [s.name for s in system.outputs]
    rows = positions_of(list(ranges), names, "safe_region: ranges")
    signals = []
    for name, (low, high) in ranges.items():
        if not low < 0.0 < high:
            raise AnalysisError(
                f"safe_region: the range [{low:g}, {high:g}] of {name} has no zero inside."
            )
        signals.append(_Signal(name, min(-low, high)))
    with one_thread():
        model = scaled(realization(system, (), rows, bounds.leave_out), proof.channels, proof.time)
        found = [_level(model, proof, k, signal) for k, signal in enumerate(signals)]
    L = proof.states
    states = tuple(s.name for s in system.states if s.name not in bounds.leave_out)
    return SafeRegion(states, max(found) * (L.T @ proof.P @ L))


def _level(model: Realization, proof: MotionProof, row: int, signal: _Signal) -> float:
    """A number with |y| <= r where this times x'P x is at most 1.

    Raises
    ------
    AnalysisError
        None was proved.
    """
    y = model._replace(
        G=model.G[row : row + 1] / signal.size,
        H=model.H[row : row + 1] / signal.size,
        E=model.E[:, :0],
        F=model.F[:, :0],
        J=model.J[row : row + 1, :0],
    )
    rates = np.full(len(model.sizes), np.inf)
    back = np.asarray(np.linalg.inv(proof.states))
    near = form_of(turned(y, proof.states, back), rates)
    form = form_of(y, rates)
    sizes = sizes_of(form, 1.0, rates)
    found = least_level(near, sizes, proof.P)
    least, X, Y = found or (np.inf, proof.X, proof.Y)
    size = max(1.0, float(np.linalg.norm(sizes[:, None] * near.R)) ** 2)
    definite = float(np.min(np.linalg.eigvalsh(proof.P))) / size
    for attempt in range(_TRIES if np.isfinite(least) else 0):
        slack = _OUTSIDE * 10.0**attempt
        level = least * (1.0 + slack)
        falling = form._replace(W=-0.5 * level * form.V)
        wider = X + 0.1 * slack * least * definite * np.eye(len(X))
        if is_negative(falling, sizes, 1.0, proof.states, proof.P, wider, Y):
            return float(level)
    raise AnalysisError(
        f"safe_region: no level of V was proved to keep {signal.name} in its range. Take functions of "
        "signals that depend less on parameters."
    )
