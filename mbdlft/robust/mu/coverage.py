"""Multipliers and intervals of frequency that cover all of [0, inf], for a loop on a part of its box.

The loop is a system closed through blocks of all kinds, some of which grow:

    w = Delta z,   |delta_k| or ||Delta_k|| <= k for blocks that grow, <= 1 for those that are fixed.

The margin of robust stability is the largest k for which no Delta makes I - M(j omega) Delta singular.
With a full block that joins inputs and outputs, all blocks growing, it is that of robust performance; if
this block alone grows, 1/k is the worst-case gain (skew mu: Fan, Tits, IEEE TAC 37, 1992).

Multipliers are found for a frequency and two beside it at once, and hold on an interval around it
(`mbdlft.robust.mu.intervals`); the next frequency is one that no interval contains. Those of one
frequency alone may hold on a narrow interval. The two are nearer or farther away as the last ones
allowed; where they would be too near, a part of the box that may be cut resists.
"""

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbdlft.base.array import Array
from mbdlft.base.errors import StructureError, check_known
from mbdlft.base.running import after, tell
from mbdlft.exact.rounding import eigenvalues_of
from mbdlft.lft.block import Block, FullBlock
from mbdlft.lft.lft import check
from mbdlft.robust.ascent import by_damping
from mbdlft.robust.evidence import Interval, Multipliers
from mbdlft.robust.mu.intervals import Channels, Extent, balance, channels_matrix, interval_around
from mbdlft.robust.mu.multipliers import Structure, structure_of, upper_bound
from mbdlft.robust.realization import matrices_of
from mbdlft.system.model import System

_MOST_ENTRIES = 250  # of multipliers: more take minutes for the whole of the frequencies
GAIN = "(gain)"  # name of the block that joins inputs and outputs
Complex = NDArray[np.complex128]
_STEPS = 2000  # frequencies that are looked at, at most
_LOOKS = 12  # frequencies around those of the poles
_NARROW = 1e-10  # of a frequency: an interval below this is not cut again
# logarithm of the ratio of frequencies with the same multipliers: at first, at least, and factors of it
REACH, _LEAST_REACH, _NEARER, _FARTHER = 0.7, 0.1, 0.5, 2.0
_TOO_FAR = 1.1  # a bound of mu from which on the least ratio is next
_BEYOND = 100.0  # times the fastest pole: infinity instead, and 0 for what is as far below the slowest
_SIZES = 40  # sizes that are tried for the largest one at a frequency
_NOTHING = 1e-9  # of the largest size: less is nothing


class Loop(NamedTuple):
    """A system and its blocks, none of which is empty.

    Its channels are balanced by powers of two: z and w of each block are multiplied by the same, so
    nothing is rounded, and Delta stays what it is. Zeros make full blocks square.
    """

    channels: Channels
    scale: Array  # (m,): these powers
    structure: Structure
    blocks: tuple[Block, ...]
    grows: NDArray[np.bool_]  # (number of blocks,)

    @property
    def owner(self) -> NDArray[np.int64]:
        """The block of each channel (m,)."""
        sizes = [max(block.inputs, block.outputs) for block in self.blocks]
        return np.repeat(np.arange(len(sizes)), sizes)

    @property
    def real(self) -> NDArray[np.bool_]:
        """Which blocks are real parameters (number of blocks,)."""
        return np.array([block.kind == "real" for block in self.blocks], dtype=bool)

    @property
    def is_plain(self) -> bool:
        """Whether all blocks are real parameters."""
        return bool(np.all(self.real))


def loop_of(
    system: System,
    stay: Sequence[int],
    fixed: Iterable[str] = (),
    inputs: Sequence[int] = (),
    outputs: Sequence[int] = (),
) -> Loop:
    """The loop of a system, of the states that stay, and of a block that joins inputs and outputs."""
    check(not system.lft.is_complex, "the margin of a system needs real entries; one is complex")
    blocks = [block for block in system.lft.blocks if block.inputs and block.outputs]
    A, B, C, D, E, F, G, H, J = matrices_of(system, blocks, stay, inputs, outputs)
    if inputs and outputs:
        blocks.append(FullBlock(GAIN, len(outputs), len(inputs)))
    kept = check_fixed(system, fixed)
    grows = np.array([block.name not in kept for block in blocks], dtype=bool)
    whole = Channels(A, np.hstack([B, E]), np.vstack([C, G]), np.block([[D, F], [H, J]]))
    return _balanced(whole, tuple(blocks), grows)


def check_fixed(system: System, fixed: Iterable[str]) -> tuple[str, ...]:
    """Names of fixed blocks, all of which exist."""
    names = [block.name for block in system.lft.blocks]
    chosen = (fixed,) if isinstance(fixed, str) else tuple(fixed)
    check_known("block", chosen, names, f"fixed blocks of {system.name!r}", StructureError)
    return chosen


def _balanced(whole: Channels, blocks: tuple[Block, ...], grows: NDArray[np.bool_]) -> Loop:
    structure = structure_of(_pieces(blocks))
    inputs, outputs, size = structure.inputs, structure.outputs, structure.size
    n = len(whole.A)
    B, C, D = np.zeros((n, size)), np.zeros((size, n)), np.zeros((size, size))
    B[:, outputs], C[inputs] = whole.B, whole.C
    D[np.ix_(inputs, outputs)] = whole.D
    of_states = balance(whole.A)
    plain = Channels(whole.A * of_states / of_states[:, None], B / of_states[:, None], C * of_states, D)
    loop = Loop(plain, np.ones(size), structure, blocks, grows)
    pick = (loop.owner == np.arange(len(blocks))[:, None]).astype(float)
    sizes = [np.abs(channels_matrix(plain, w)) for w in (0.0, *np.abs(eigenvalues_of(whole.A)).tolist())]
    scale = balance(pick @ np.max(sizes, axis=0) @ pick.T)[loop.owner]
    B, C = plain.B * scale, plain.C / scale[:, None]
    return loop._replace(
        channels=Channels(plain.A, B, C, D * scale / scale[:, None]), scale=np.asarray(scale)
    )


def _pieces(blocks: Sequence[Block]) -> list[Block]:
    """Blocks for multipliers: where full ones are too many, repeated blocks are cut into pieces.

    Multipliers that are zero between the pieces are multipliers of the block, too, and prove less.
    """
    most = max((block.size for block in blocks), default=1)
    while True:
        pieces: list[Block] = []
        for block in blocks:
            whole, remainder = divmod(block.size, most) if block.kind != "full" else (0, 0)
            count = whole + (remainder > 0)
            sizes = [block.size // count + (k < block.size % count) for k in range(count)]
            pieces += [block] if block.kind == "full" else [block.of_size(size) for size in sizes]
        if len(structure_of(pieces).rows) <= _MOST_ENTRIES or most == 1:
            return pieces
        most -= 1


def scaled(multipliers: Multipliers, scale: Array) -> Multipliers:
    """Multipliers of balanced channels, of those of the channels as they are; 1/scale: the way back."""
    both = np.outer(scale, scale)
    return multipliers._replace(D=multipliers.D * both, G=multipliers.G * both)


def ends_of(loop: Loop, k: float) -> tuple[Array, Array]:
    """Ends (number of blocks,) of the whole box of size k; those of blocks that are not real: norms."""
    size = np.where(loop.grows, k, 1.0)
    return -size, size


def extent_of(loop: Loop, low: Array, high: Array) -> Extent:
    """What multipliers of deltas between these ends have in the place of the box."""
    return Extent(low[loop.owner], high[loop.owner])


def matrix_at(loop: Loop, omega: float) -> Complex:
    """M(j omega) (m, m)."""
    return channels_matrix(loop.channels, omega)


def inside(loop: Loop, M: Complex, low: Array, high: Array) -> tuple[Complex, Array]:
    """The matrix (..., m, m) whose deltas of size 1 are those between the ends, and half sizes (m,).

    With w = c z + v, z = (I - M c)^-1 M v.
    """
    center, half = (0.5 * (low + high))[loop.owner], (0.5 * (high - low))[loop.owner]
    if np.any(center):
        M = np.asarray(np.linalg.solve(np.eye(len(center)) - M * center, M), dtype=complex)
    return half[:, None] * M, half


def loop_of_matrix(M: Complex, blocks: Sequence[Block], grows: NDArray[np.bool_]) -> Loop:
    """A loop without states: its structure, as M (n_z, n_w) is given."""
    structure = structure_of(blocks)
    none = np.zeros((structure.size, structure.size))
    channels = Channels(none[:0, :0], none[:0], none[:, :0], none)
    check(M.shape == (len(structure.inputs), len(structure.outputs)), "M does not fit its blocks")
    return Loop(channels, np.ones(structure.size), structure, tuple(blocks), grows)


class Cover(NamedTuple):
    """Intervals that multipliers of balanced channels prove for a part of the box, and the rest."""

    k: float  # the size for which they hold: what was asked for, or less if it may shrink
    intervals: tuple[Interval, ...]
    multipliers: tuple[Multipliers, ...]
    todo: tuple[tuple[float, float], ...]  # frequencies that are left (rad/s); none: it is proved
    at: float  # where multipliers were not found (rad/s); NaN: work was used up
    beta: float  # the bound of mu there; 0 if it was rounding that failed
    last: Multipliers | None  # where another search may start: G is over the squares of half sizes
    peak: float  # where the size is smallest (rad/s); NaN if nothing was looked at
    work: float
    reach: float = REACH  # logarithm of the ratio of frequencies for which multipliers were looked for


class Part(NamedTuple):
    """A part of the box, and the frequencies that are open."""

    low: Array  # ends of all blocks (number of blocks,)
    high: Array
    todo: tuple[tuple[float, float], ...]  # rad/s
    at: float  # where to begin (rad/s); NaN: at the poles
    start: Multipliers | None  # as `last` of a `Cover`
    work: float  # units that may be used
    tolerance: float  # of the bounds of mu
    may_be_cut: bool = False  # rather than to have multipliers of one frequency alone
    reach: float = REACH  # as that of a `Cover`
    resists: bool = False  # `start` is all that multipliers prove at `at`, which is not enough


class _Proved(NamedTuple):
    """An interval, its multipliers as they are, and those for size 1."""

    interval: Interval
    multipliers: Multipliers
    unit: Multipliers


def covered(loop: Loop, box: Part) -> Cover:
    """Prove a part of the box at the frequencies that are open, until one resists."""
    if box.resists and box.start is not None:
        beta = box.start.beta
        return Cover(np.nan, (), (), box.todo, box.at, beta, box.start, np.nan, 0.0, box.reach)
    poles, todo = eigenvalues_of(loop.channels.A), list(box.todo)
    first = _sizes_in_order(poles)
    extent, cost = extent_of(loop, box.low, box.high), cost_at(loop)
    kept: list[_Proved] = []
    last, reach, used, at, beta = box.start, box.reach, 0.0, np.nan, 0.0
    for _ in range(_STEPS):
        if not todo or used + cost > box.work:
            break
        low, high = todo.pop()
        omega = box.at if low < box.at < high else middle(low, high, first)
        beside, far = _beside(omega, low, high, poles, reach)
        used += cost * (2 + len(beside)) / 3.0
        tell(used)
        M = np.array([matrix_at(loop, w) for w in beside])
        M, half = inside(loop, M, box.low, box.high)
        interval = None
        beside_omega = [unit for unit in (last, *_neighbors(kept, omega)) if unit is not None]
        for starts in (beside_omega, ()):  # from the beginning: those of far frequencies may be extreme
            near, multipliers = _found(M, half, loop.structure, starts, box.tolerance)
            beta = near.beta
            if beta > 1.0:
                break
            interval = interval_around(loop.channels, multipliers, omega, extent)
            if interval is not None and interval.high - interval.low > _NARROW * omega:
                break
            interval = None
        if interval is None:
            todo.append((low, high))
            tried = min(reach, far)
            if tried > _LEAST_REACH:
                reach = max(_LEAST_REACH, _NEARER * tried if beta < _TOO_FAR else 0.0)
                continue
            if reach and not box.may_be_cut:
                reach = 0.0
                continue
            last, at, beta = near, omega, beta if beta > 1.0 else 0.0
            break
        last, reach = near, reach if far < reach else max(reach, _LEAST_REACH) * _FARTHER
        kept.append(_Proved(interval, multipliers, near))
        todo += [(a, b) for a, b in ((low, interval.low), (interval.high, high)) if b > a]
    ends = tuple(each.interval for each in kept), tuple(each.multipliers for each in kept)
    return Cover(np.nan, *ends, tuple(todo), at, beta, last, np.nan, used, reach)


def _neighbors(kept: Sequence[_Proved], omega: float) -> list[Multipliers]:
    """Multipliers of the next intervals below and above a frequency."""
    below = [each for each in kept if each.interval.at < omega]
    above = [each for each in kept if each.interval.at > omega]
    next_below = max(below, key=lambda each: each.interval.high, default=None)
    next_above = min(above, key=lambda each: each.interval.low, default=None)
    return [each.unit for each in (next_below, next_above) if each is not None]


def _beside(omega: float, low: float, high: float, poles: Complex, reach: float) -> tuple[Array, float]:
    """A frequency between two ends with those beside it, and how far away the farther one is.

    Ratios are measured by how near the next pole is: beside it, a loop changes within its distance.
    """
    if not reach:
        return np.array([omega]), 0.0
    near = min(1.0, float(np.min(np.abs(1j * omega - poles), initial=omega)) / omega)
    a, b = omega * np.exp(-reach * near), omega * np.exp(reach * near)
    sizes = np.abs(poles[poles != 0.0])
    if len(sizes):
        a, b = (0.0 if a * _BEYOND < np.min(sizes) else a), (np.inf if b > _BEYOND * np.max(sizes) else b)
    ends = max(a, low), min(b, high)
    ratios = [omega / end if end < omega else end / omega for end in ends if 0.0 < end < np.inf]
    far = max((float(np.log(ratio)) / near for ratio in ratios), default=reach)
    return np.unique([ends[0], omega, ends[1]]), min(far, reach)


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
        box = Part(*ends_of(loop, k), todo, np.nan, last, work - used, 0.02 * gap)
        with after(used):
            cover = covered(loop, box)
        used += cover.work
        intervals, multipliers = intervals + cover.intervals, multipliers + cover.multipliers
        cover = cover._replace(k=k, intervals=intervals, multipliers=multipliers, work=used, peak=peak)
        if not cover.todo or not cover.beta > 1.0 or used + cost > work:
            return cover
        size, last = largest_size(loop, matrix_at(loop, cover.at), k, cover.last, 0.02 * gap)
        used += cost
        if size == 0.0:
            return cover._replace(k=0.0)
        size = min(size, k * (1.0 - 0.1 * gap))
        k, peak, todo = size * (1.0 - 0.5 * gap), cover.at, cover.todo


def largest_size(
    loop: Loop, M: Complex, most: float, start: Multipliers | None, tolerance: float
) -> tuple[float, Multipliers]:
    """Nearly the largest size up to `most` for which mu <= 1 is proved, and multipliers there; 0: none.

    mu of the whole box rises with its size; where all blocks grow, it is proportional to it.
    """

    def bound(k: float, near: Multipliers | None) -> tuple[Multipliers, Multipliers]:
        scaled, half = inside(loop, M, *ends_of(loop, k))
        starts = () if near is None else (near,)
        return _found(scaled, half, loop.structure, starts, tolerance, enough=0.0)

    if np.all(loop.grows):
        unit, _ = bound(1.0, start)
        return min(1.0 / max(unit.beta, 1e-300), most), unit._replace(beta=1.0)
    unit, _ = bound(most, start)
    if unit.beta <= 1.0:
        return most, unit
    nothing, _ = bound(_NOTHING * most, unit)
    if nothing.beta > 1.0:
        return 0.0, unit
    low, low_log, high, high_log = 0.0, 0.0, most, float(np.log(unit.beta))
    best = unit
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
        unit, _ = bound(k, unit)
        if unit.beta <= 1.0:
            best = unit
            low, low_log = k, float(np.log(max(unit.beta, 1e-300)))
        else:
            high, high_log = k, float(np.log(unit.beta))
        if low > 0.0 and high / low - 1.0 <= tolerance:
            break
    return low, best


def multipliers_of(
    loop: Loop, M: Complex, ends: tuple[Array, Array], start: Multipliers, tolerance: float
) -> Multipliers:
    """Those of nearly the least bound of mu of a part of the box, from those of one around it."""
    inner, half = inside(loop, M, *ends)
    return _found(inner, half, loop.structure, (start,), tolerance, enough=0.0)[0]


def _found(
    M: Complex,
    half: Array,
    structure: Structure,
    starts: Sequence[Multipliers],
    tolerance: float,
    enough: float = 1.0,
) -> tuple[Multipliers, Multipliers]:
    """Multipliers of a matrix whose rows were multiplied by half sizes: for size 1, and as they are."""
    starts = [start._replace(G=start.G * half[:, None]) for start in starts]
    multipliers = upper_bound(M, structure, starts=starts, tolerance=tolerance, enough=enough)
    positive = np.where(half > 0.0, half, 1.0)
    unit = multipliers._replace(G=multipliers.G / positive[:, None])
    return unit, multipliers._replace(beta=1.0, G=multipliers.G * half[:, None])


def looks(first: Array) -> Array:
    """Frequencies at which to look before anything is proved: of the poles, and around them."""
    sizes = first[first > 0.0]
    if not len(sizes):
        return np.append(np.geomspace(1e-2, 1e2, _LOOKS), np.inf)
    around = np.geomspace(0.1 * np.min(sizes), 10.0 * np.max(sizes), _LOOKS)
    return np.concatenate([first, around, [np.inf]])


def first_frequencies(A: Array) -> Array:
    """Frequencies at which to begin: those of the poles, the least damped first."""
    return _sizes_in_order(eigenvalues_of(A))


def _sizes_in_order(poles: Complex) -> Array:
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
