"""A bound of mu for all frequencies: multipliers and the intervals on which they prove it."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from mbdlft.analyze.intervals import Channels, channels_matrix, interval_around
from mbdlft.analyze.multipliers import Structure, upper_bound
from mbdlft.base.array import Array
from mbdlft.bound.evidence import Interval, IntervalProof, Multipliers

_STEPS = 2000  # frequencies that are looked at, at most
_LOOKS = 12
_NARROW = 1e-10  # of a frequency: an interval below this is not cut again


class Sweep(NamedTuple):
    """What came of a sweep.

    Attributes
    ----------
    proof : IntervalProof or None
    work : float
        Newton steps and eigenvalues, as units of work.
    open_at : float
        A frequency at which nothing could be proved (rad/s); NaN if there is none.
    frequency : float
        Where the bound is largest.
    """

    proof: IntervalProof | None
    work: float
    open_at: float
    frequency: float


def swept(
    system: Channels,
    structure: Structure,
    gap: float,
    work: float,
    floor: float,
    tick: Callable[[], None] = lambda: None,
) -> Sweep:
    """Bound mu for all frequencies, within `gap` of the best of its multipliers at one of them.

    Below `floor` bounds are not told apart.
    """
    todo, first = [(0.0, np.inf)], first_frequencies(system.A)
    beta, peak, used, last = floor, np.nan, 0.0, None
    kept: list[tuple[Interval, Multipliers]] = []
    cost = _cost(len(system.A), structure)
    for omega in looks(first):
        M, _ = channels_matrix(system, omega)
        last = upper_bound(M, structure, start=last, tolerance=0.1 * gap, enough=beta)
        used += cost
        if last.beta > beta:
            beta, peak = last.beta, omega
    beta *= 1.0 + 0.5 * gap
    for _ in range(_STEPS):
        if not todo:
            return Sweep(_covered(beta, kept), used, np.nan, peak)
        tick()
        used += cost
        if used > work:
            return Sweep(None, used, todo[-1][0], peak)
        low, high = todo.pop()
        omega = middle(low, high, first)
        M, _ = channels_matrix(system, omega)
        found = upper_bound(M, structure, start=last, tolerance=0.02 * gap, enough=beta)
        last = found
        if found.beta > beta:
            found = upper_bound(M, structure, start=last, tolerance=0.02 * gap)
            beta, peak = max(found.beta * (1.0 + 0.5 * gap), beta), omega
            found = upper_bound(M, structure, start=last, tolerance=0.02 * gap, enough=beta)
        found, interval = found._replace(beta=beta), None
        for again in (False, True):
            if again:  # from the beginning: multipliers of far frequencies may be extreme
                found = upper_bound(M, structure, tolerance=0.02 * gap, enough=beta)
                found = last = found._replace(beta=beta)
            interval = interval_around(system, found, omega)
            if interval is not None and interval.high - interval.low > _NARROW * omega:
                break
        else:
            return Sweep(None, used, omega, peak)
        kept.append((interval, found))
        todo += _rest(low, high, interval)
    return Sweep(None, used, todo[-1][0] if todo else np.nan, peak)


def looks(first: Array) -> Array:
    """Frequencies at which to look before anything is proved: of the poles, and around them."""
    sizes = first[first > 0.0]
    if not len(sizes):
        return np.append(np.geomspace(1e-2, 1e2, _LOOKS), np.inf)
    around = np.geomspace(0.1 * np.min(sizes), 10.0 * np.max(sizes), _LOOKS)
    return np.concatenate([first, around, [np.inf]])


def _rest(low: float, high: float, interval: Interval) -> list[tuple[float, float]]:
    """What an interval leaves of another."""
    rest = []
    if interval.low > low:
        rest.append((low, interval.low))
    if interval.high < high:
        rest.append((interval.high, high))
    return rest


def first_frequencies(A: Array) -> Array:
    """Frequencies at which to begin: those of the poles, the least damped first."""
    poles = np.linalg.eigvals(A) if len(A) else np.zeros(0)
    poles = poles[poles.imag >= 0.0]
    order = np.argsort(-poles.real / np.maximum(np.abs(poles), 1e-300), kind="stable")
    return np.abs(poles[order])


def middle(low: float, high: float, first: Array) -> float:
    """A frequency in an interval."""
    inside = first[(first > low) & (first < high)]
    if len(inside):
        return float(inside[0])
    if low == 0.0:
        return 1.0 if np.isinf(high) else 0.5 * high
    return 2.0 * low if np.isinf(high) else float(np.sqrt(low * high))


def _covered(beta: float, kept: list[tuple[Interval, Multipliers]]) -> IntervalProof:
    order = sorted(kept, key=lambda pair: pair[0].low)
    return IntervalProof(
        beta,
        tuple(interval for interval, _ in order),
        tuple(found._replace(beta=beta) for _, found in order),
    )


def covers(intervals: tuple[Interval, ...]) -> bool:
    """Whether intervals in the order of their lower ends cover [0, inf]."""
    reached = 0.0
    for interval in intervals:
        if interval.low > reached:
            return False
        reached = max(reached, interval.high)
    return bool(reached == np.inf)


def _cost(n: int, structure: Structure) -> float:
    """Units of work of one frequency."""
    entries = 2 * len(structure.rows)
    return 1e-3 + 40.0 * (entries**2 * 3e-9 + entries**3 * 4e-11) + (2 * n) ** 3 * 5e-9
