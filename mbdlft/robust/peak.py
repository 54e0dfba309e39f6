"""The peak of a gain over frequency, and deltas at which it is large: lower bounds of the worst case.

An ascent goes to corners of the box to which the slope points, then within the box. With

    G(j omega, delta) = M22 + M21 Delta (I - M11 Delta)^-1 M12,   M = M(j omega) of all channels,
    d sigma / d delta_k = Re( u' M21 (I - Delta M11)^-1 P_k (I - M11 Delta)^-1 M12 v )

at the frequency of the peak, where u and v are the singular vectors of G.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbdlft.base.array import Array
from mbdlft.response.norms import peak_of
from mbdlft.response.staircase import Plant
from mbdlft.robust.bisect.characteristic import Realization

_STEPS = 40
Look = Callable[[Array], tuple[float, Callable[[], Array]]]


def climb(look: Look, k: float, start: Array) -> None:
    """Look at points of the box |delta| <= k where a function is larger and larger, from a start.

    `look` gives its value at deltas (number of deltas,), of the size of 1, and a function for its slope
    there. It keeps what is the best; an infinite value ends the ascent.
    """
    from scipy.optimize import minimize  # here because it is slow to import

    here, (value, slope) = start, look(start)
    for _ in range(_STEPS):  # corners to which the slope points
        if not np.isfinite(value):
            return
        corner = k * np.sign(slope())
        if np.array_equal(corner, here):
            return
        there, its_slope = look(corner)
        if there <= value:
            break
        here, value, slope = corner, there, its_slope
    if not np.isfinite(value):
        return

    def objective(delta: Array) -> tuple[float, Array]:
        value, its_slope = look(delta)
        if not np.isfinite(value):
            return -1e30, np.zeros(len(delta))
        return -value, -its_slope()

    box, options = [(-k, k)] * len(start), {"maxiter": _STEPS}
    minimize(objective, here, jac=True, bounds=box, method="L-BFGS-B", options=options)


_GROWTH = 1e-9  # of the level at which the search for a peak ends
_STARTS = 6
Complex = NDArray[np.complex128]


class Peak(NamedTuple):
    """A largest gain over frequency; infinite where a pole is not stable."""

    gain: float
    frequency: float  # rad/s
    delta: Array  # (number of deltas,)


NOTHING = Peak(0.0, np.nan, np.zeros(0))


def at_delta(model: Realization, delta: Array) -> Plant | None:
    """A, B, C, D from u to y at some deltas; None where the model is singular."""
    n = len(model.A)
    try:
        right = model.into(delta)
    except np.linalg.LinAlgError:
        return None
    whole = np.block([[model.A, model.E], [model.G, model.J]])
    whole = whole + (np.vstack([model.B, model.H]) * model.spread(delta)) @ right
    return Plant(whole[:n, :n], whole[:n, n:], whole[n:, :n], whole[n:, n:])


def peak_at(model: Realization, delta: Array) -> Peak:
    """The peak over all frequencies at some deltas."""
    matrices = at_delta(model, delta)
    if matrices is None:
        return Peak(np.inf, np.nan, delta)
    poles = np.linalg.eigvals(matrices.A)
    if np.max(poles.real, initial=-1.0) >= 0.0:
        return Peak(np.inf, float(abs(poles[np.argmax(poles.real)].imag)), delta)
    gain, _, frequency, _ = peak_of(matrices, _GROWTH)
    return Peak(gain, frequency, delta)


def slope_at(model: Realization, peak: Peak) -> Array:
    """Derivatives of the gain at the frequency of a peak by the deltas."""
    n, N = len(model.A), len(model.D)
    w = model.spread(peak.delta)
    B, C = np.hstack([model.B, model.E]), np.vstack([model.C, model.G])
    D = np.block([[model.D, model.F], [model.H, model.J]])
    M: Complex = D.astype(complex)
    if np.isfinite(peak.frequency):
        M = M + C @ np.linalg.solve(1j * peak.frequency * np.eye(n) - model.A, B)
    inner = np.linalg.inv(np.eye(N) - M[:N, :N] * w)
    column = inner @ M[:N, N:]
    row = M[N:, :N] @ (np.eye(N) + w[:, None] * inner @ M[:N, :N])
    G = M[N:, N:] + (M[N:, :N] * w) @ column
    u, _, v = np.linalg.svd(G)
    by_channel = ((u[:, 0].conj() @ row) * (column @ v[0].conj())).real
    return model.by_parameter(by_channel)


def largest_peak(model: Realization, k: float, more: tuple[Array, ...] = ()) -> Peak:
    """The largest peak found on the box |delta| <= k: from its middle, corners, and other starts."""
    q = len(model.sizes)
    random = np.random.default_rng(0)
    best = peak_at(model, np.zeros(q))
    if not q:
        return best
    starts = [np.zeros(q), *more]
    starts += [k * np.sign(random.uniform(-1.0, 1.0, q)) for _ in range(_STARTS)]
    for start in starts:
        best = _climbed(model, k, start, best)
        if not np.isfinite(best.gain):
            break
    return best


def _climbed(model: Realization, k: float, start: Array, best: Peak) -> Peak:
    """The best of what was known and of what an ascent leads to."""
    reached = [best]

    def look(delta: Array) -> tuple[float, Callable[[], Array]]:
        peak = peak_at(model, delta)
        if peak.gain > reached[0].gain:
            reached[0] = peak
        gain = float(np.log(peak.gain)) if peak.gain > 0.0 else -1e30
        return gain, lambda: slope_at(model, peak) / max(peak.gain, 1e-30)

    climb(look, k, start)
    return reached[0]
