"""Bounds of mu over bands of frequency: multipliers of one frequency, proved on the band around it."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from mbdlft.base.array import Array
from mbdlft.base.errors import AnalysisError
from mbdlft.base.threads import one_thread
from mbdlft.robust.coverage import first_frequencies, looks, middle
from mbdlft.robust.intervals import channels_matrix, interval_around
from mbdlft.robust.loop import loop_of
from mbdlft.robust.multipliers import upper_bound
from mbdlft.robust.realization import (
    check_constant,
    check_parameters,
    stable_states,
)
from mbdlft.robust.singular_value import channels_at
from mbdlft.robust.small_delta import small_delta
from mbdlft.system.system import System

_MOST = 600  # bands
_LEAST = 0.01  # of the largest bound: bounds below this are not told apart
_NARROW = 0.05  # of a frequency: a band below this is tried again with a larger bound
_AGAIN = 5
_WIDE = 1.0 / 8.0  # of the logarithm of high/low: no band is wider


class MuBands(NamedTuple):
    """Bands side by side, and mu in them.

    Attributes
    ----------
    edges : array (N + 1,), rad/s
    upper : array (N,)
        Proved for all frequencies of the band; inf where nothing was proved.
    at, lower : array (N,)
        A frequency in the band, and the lower bound that was found there; 0 if Delta has parameters only,
        for which `robust_stability` finds better ones.
    """

    edges: Array
    upper: Array
    at: Array
    lower: Array


def mu_bands(
    system: System, low: float, high: float, *, gap: float = 0.05, leave_out: Sequence[str] = ()
) -> MuBands:
    """Bounds of the structured singular value for all frequencies between two.

    Parameters
    ----------
    system : System or LFTModel
        Nominally stable. Delta may have blocks of all kinds.
    low, high : float, rad/s
    gap : float
        The part by which a bound may be above the best of its multipliers at one frequency.
    leave_out : sequence of str
        States on which nothing else depends.

    Returns
    -------
    MuBands

    Raises
    ------
    AnalysisError
        The ends are no range, Delta is empty, or the nominal model is not stable.
    """
    if not 0.0 < low < high < np.inf:
        raise AnalysisError(f"mu_bands: expected 0 < low < high (rad/s), got {low!r} and {high!r}.")
    check_parameters(system, "mu_bands")
    check_constant(system, "mu_bands")
    stay = stable_states(system, leave_out, "mu_bands")
    loop, blocks = loop_of(system, stay), system.lft.blocks
    channels, structure = loop.channels, loop.structure
    first = first_frequencies(channels.A)
    with one_thread():
        known = [
            upper_bound(channels_matrix(channels, w)[0], structure, tolerance=0.1 * gap).beta
            for w in looks(first)
        ]
        floor, widest = _LEAST * max(known), float(np.log(high / low)) * _WIDE
        cut = [low, *np.exp(np.arange(np.log(low) + widest, np.log(high), widest))]
        todo = list(zip(cut, [*cut[1:], high], strict=True))[::-1]
        found: list[tuple[float, float, float, float, float]] = []
        last = None
        while todo and len(found) < _MOST:
            a, b = (float(end) for end in todo.pop())
            omega = middle(a, b, first)
            M, _ = channels_matrix(channels, omega)
            last = upper_bound(M, structure, start=last, tolerance=0.1 * gap)
            beta, band = max(last.beta, floor), None
            for again in range(_AGAIN):
                beta *= 1.0 + gap * 2.0**again
                last = upper_bound(M, structure, start=last, enough=beta)._replace(beta=beta)
                band = interval_around(channels, last, omega)
                if band is not None and band.high - band.low > _NARROW * omega:
                    break
            lower = 0.0
            if not system.lft.is_plain:
                lower = small_delta(channels_at(system, omega), blocks, beta).bound
            if band is None or not band.high > band.low:
                found.append((a, b, np.inf, omega, lower))
                continue
            start, stop = max(a, band.low), min(b, band.high)
            found.append((start, stop, beta, omega, lower))
            todo += [(p, q) for p, q in ((stop, b), (a, start)) if q > p]
    found += [(float(a), float(b), np.inf, float(np.sqrt(a * b)), 0.0) for a, b in todo]
    rows = np.array(sorted(found)).T
    return MuBands(np.append(rows[0], rows[1, -1]), rows[2], rows[3], rows[4])
