"""Multipliers and intervals that cover all frequencies, for one part of the box."""

from typing import NamedTuple

import numpy as np

from mbdlft.base.array import Array
from mbdlft.base.spent import after, tell
from mbdlft.robust.evidence import Interval, Multipliers
from mbdlft.robust.loop import (
    Complex,
    Loop,
    ends_of,
    extent_of,
    inside,
    matrix_at,
)
from mbdlft.robust.migration import by_damping
from mbdlft.robust.mu.intervals import interval_around
from mbdlft.robust.mu.multipliers import Structure, upper_bound

_STEPS = 2000  # frequencies that are looked at, at most
_LOOKS = 12
_NARROW = 1e-10  # of a frequency: an interval below this is not cut again
_SIZES = 40  # sizes that are tried for the largest one at a frequency
_NOTHING = 1e-9  # of the largest size: less is nothing


class Cover(NamedTuple):
    """Intervals that multipliers prove for a part of the box, and what they leave.

    Attributes
    ----------
    k : float
        The size for which they hold: that which was asked for, or less if it may shrink.
    intervals, multipliers : tuples
        The latter for balanced channels.
    todo : tuple of (low, high)
        Frequencies that are left (rad/s); none: the part is proved.
    at : float
        Where multipliers were not found (rad/s); NaN: work was used up.
    beta : float
        The bound of mu there; 0 if it was rounding that failed.
    last : Multipliers or None
        Those with which another search may start: G is over the squares of half sizes.
    peak : float
        Where the size is smallest (rad/s); NaN if nothing was looked at.
    work : float
    """

    k: float
    intervals: tuple[Interval, ...]
    multipliers: tuple[Multipliers, ...]
    todo: tuple[tuple[float, float], ...]
    at: float
    beta: float
    last: Multipliers | None
    peak: float
    work: float


class Part(NamedTuple):
    """A part of the box: ends of all blocks (number of blocks,), and the frequencies that are open.

    Attributes
    ----------
    low, high : array
    todo : tuple of (low, high), rad/s
    at : float
        Where to begin (rad/s); NaN: at the poles.
    start : Multipliers or None
        As `last` of a `Cover`.
    work : float
        Units that may be used.
    tolerance : float
        Of the bounds of mu.
    """

    low: Array
    high: Array
    todo: tuple[tuple[float, float], ...]
    at: float
    start: Multipliers | None
    work: float
    tolerance: float


def covered(loop: Loop, part: Part) -> Cover:
    """Prove a part of the box at the frequencies that are open, until one resists."""
    first, todo = first_frequencies(loop.channels.A), list(part.todo)
    extent, cost = extent_of(loop, part.low, part.high), cost_at(loop)
    kept: list[tuple[Interval, Multipliers]] = []
    last, used, at, beta = part.start, 0.0, np.nan, 0.0
    for _ in range(_STEPS):
        if not todo or used + cost > part.work:
            break
        low, high = todo.pop()
        omega = part.at if low < part.at < high else middle(low, high, first)
        used += cost
        tell(used)
        M, half = inside(loop, matrix_at(loop, omega), part.low, part.high)
        interval = None
        for start in (last, None):  # from the beginning: those of far frequencies may be extreme
            last, found = _found(M, half, loop.structure, start, part.tolerance)
            beta = last.beta
            if beta > 1.0:
                break
            interval = interval_around(loop.channels, found, omega, extent)
            if interval is not None and interval.high - interval.low > _NARROW * omega:
                break
            interval = None
        if interval is None:
            at = omega
            beta = beta if beta > 1.0 else 0.0
            todo.append((low, high))
            break
        kept.append((interval, found))
        todo += _rest(low, high, interval)
    ends = tuple(interval for interval, _ in kept), tuple(found for _, found in kept)
    return Cover(np.nan, *ends, tuple(todo), at, beta, last, np.nan, used)


def shrunk(loop: Loop, largest: float, gap: float, work: float) -> Cover:
    """The whole box, as large as its multipliers prove within a part `gap` at one of the frequencies."""
    first, cost = first_frequencies(loop.channels.A), cost_at(loop)
    used, last, peak, k = 0.0, None, np.nan, largest
    for omega in looks(first):
        if used + cost > work:
            return Cover(0.0, (), (), ((0.0, np.inf),), np.nan, 0.0, last, peak, used)
        size, last = largest_size(loop, matrix_at(loop, omega), k, last, 0.1 * gap)
        used += cost
        tell(used)
        k, peak = (size, omega) if size < k else (k, peak)
        if k == 0.0:
            return Cover(k, (), (), ((0.0, np.inf),), omega, np.inf, last, peak, used)
    k *= 1.0 - 0.5 * gap if k < largest else 1.0
    todo: tuple[tuple[float, float], ...] = ((0.0, np.inf),)
    intervals: tuple[Interval, ...] = ()
    multipliers: tuple[Multipliers, ...] = ()
    while True:
        part = Part(*ends_of(loop, k), todo, np.nan, last, work - used, 0.02 * gap)
        with after(used):
            found = covered(loop, part)
        used += found.work
        intervals, multipliers = intervals + found.intervals, multipliers + found.multipliers
        found = found._replace(
            k=k, intervals=intervals, multipliers=multipliers, work=used, peak=peak
        )
        if not found.todo or not found.beta > 1.0 or used + cost > work:
            return found
        size, last = largest_size(loop, matrix_at(loop, found.at), k, found.last, 0.02 * gap)
        used += cost
        if size == 0.0:
            return found._replace(k=0.0)
        size = min(size, k * (1.0 - 0.1 * gap))
        k, peak, todo = size * (1.0 - 0.5 * gap), found.at, found.todo


def largest_size(
    loop: Loop, M: Complex, most: float, start: Multipliers | None, tolerance: float
) -> tuple[float, Multipliers]:
    """Nearly the largest size up to `most` for which mu <= 1 is proved, and multipliers there; 0: none.

    mu of the whole box rises with its size; where all blocks grow, it is proportional to it.
    """

    def bound(k: float, near: Multipliers | None) -> tuple[Multipliers, Multipliers]:
        scaled, half = inside(loop, M, *ends_of(loop, k))
        return _found(scaled, half, loop.structure, near, tolerance, enough=0.0)

    if np.all(loop.grows):
        found, _ = bound(1.0, start)
        return min(1.0 / max(found.beta, 1e-300), most), found._replace(beta=1.0)
    found, _ = bound(most, start)
    if found.beta <= 1.0:
        return most, found
    low, low_log, high, high_log = 0.0, 0.0, most, float(np.log(found.beta))
    best = found
    for count in range(_SIZES):
        if low == 0.0:
            k = high * float(np.exp(-max(high_log, tolerance) * 1.05 * 2.0 ** (count // 2)))
        elif count % 3 == 2:
            k = float(np.sqrt(low * high))
        else:
            share = low_log / (low_log - high_log)
            k = low * (high / low) ** float(np.clip(share, 0.02, 0.98))
        if k < _NOTHING * most:
            break
        found, _ = bound(k, found)
        if found.beta <= 1.0:
            best = found
            low, low_log = k, float(np.log(max(found.beta, 1e-300)))
        else:
            high, high_log = k, float(np.log(found.beta))
        if low > 0.0 and high / low - 1.0 <= tolerance:
            break
    return low, best


def _found(
    M: Complex,
    half: Array,
    structure: Structure,
    start: Multipliers | None,
    tolerance: float,
    enough: float = 1.0,
) -> tuple[Multipliers, Multipliers]:
    """Multipliers of a matrix whose rows were multiplied by half sizes: for size 1, and as they are."""
    if start is not None:
        start = start._replace(G=start.G * half[:, None])
    found = upper_bound(M, structure, start=start, tolerance=tolerance, enough=enough)
    positive = np.where(half > 0.0, half, 1.0)
    unit = found._replace(G=found.G / positive[:, None])
    return unit, found._replace(beta=1.0, G=found.G * half[:, None])


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
    return np.abs(poles[by_damping(poles)])


def middle(low: float, high: float, first: Array) -> float:
    """A frequency in an interval."""
    inside = first[(first > low) & (first < high)]
    if len(inside):
        return float(inside[0])
    if low == 0.0:
        return 1.0 if np.isinf(high) else 0.5 * high
    return 2.0 * low if np.isinf(high) else float(np.sqrt(low * high))


def covers(intervals: tuple[Interval, ...]) -> bool:
    """Whether intervals in the order of their lower ends cover [0, inf]."""
    reached = 0.0
    for interval in intervals:
        if interval.low > reached:
            return False
        reached = max(reached, interval.high)
    return bool(reached == np.inf)


def cost_at(loop: Loop) -> float:
    """Units of work of one frequency."""
    n, entries = len(loop.channels.A), 2 * len(loop.structure.rows)
    return 4e-3 + entries**2 * 1e-7 + entries**3 * 4e-9 + (2 * n) ** 3 * 3e-8
