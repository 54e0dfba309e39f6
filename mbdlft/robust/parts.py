"""A proof for blocks of all kinds: the box of the parameters is cut where multipliers do not suffice.

No model of a part of the box has a pole on the axis, or is singular, if multipliers prove so on intervals
that cover all frequencies. A half of a part inherits its intervals: only frequencies that are open are
looked at again. Parts cover the box, which is connected, and its middle is stable: so is all of it.
(Branch and bound for mu: Newlin, Young, Int. J. Robust and Nonlinear Control 7, 1997; here parts have
intervals of frequency in place of one frequency.)

A part is cut along the parameter for which the bounds of both halves, with the multipliers of the part,
are smallest. Parts are tried in batches that do not depend on how many processes there are.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbdlft.base.array import Array
from mbdlft.base.spent import after
from mbdlft.robust.coverage import Cover, Part, covered, covers
from mbdlft.robust.crew import Crew
from mbdlft.robust.evidence import Interval, IntervalProof, Multipliers
from mbdlft.robust.intervals import holds
from mbdlft.robust.loop import (
    Complex,
    Loop,
    ends_of,
    extent_of,
    inside,
    matrix_at,
    scaled,
    unscaled,
)
from mbdlft.robust.multipliers import best_square, fits

_BATCH = 8
_SMALLEST = 2.0**-16  # of the box: a part of this size is not cut again
_FACTORS = (1.0, 2.0, 4.0)  # of D of a parameter that is cut
_TOLERANCE = 0.02  # of bounds of mu that decide whether a part is cut
_ROUGH = 3  # parts one in the other at which rounding may fail
_OFTEN = 4  # batches from one to the next that is looked at for a counterexample


class Attempt(NamedTuple):
    """What came of an attempt to prove a box.

    Attributes
    ----------
    parts : _Node or None
        The tree of parts, if all are proved; None also if a counterexample was found.
    low, high : array (number of blocks,)
        A part that resisted.
    at : float
        Where it did (rad/s); NaN if none did.
    work : float
    """

    parts: "_Node | None"
    low: Array
    high: Array
    at: float
    work: float


@dataclass(slots=True)
class _Node:
    """A part, what covers it, and its halves; `rough`: parts above it at which rounding failed."""

    part: Part
    cover: Cover | None = None
    rough: int = 0
    cut: int = -1
    halves: "tuple[_Node, _Node] | None" = None


def attempt(
    loop: Loop,
    k: float,
    work: float,
    near: Cover,
    reach: Callable[[Array, float], bool],
    crew: Crew,
) -> Attempt:
    """Try to prove the box of size k.

    Parameters
    ----------
    loop : Loop
    k : float
    work : float
        Units.
    near : Cover
        Of a smaller box: where to begin.
    reach : function of real deltas and a frequency (rad/s)
        Looks for a counterexample from there; whether one was found.
    crew : Crew
        Who covers the parts.
    """
    low, high = ends_of(loop, k)
    root = _Node(Part(low, high, ((0.0, np.inf),), near.peak, near.last, work, _TOLERANCE))
    waiting, used, batches, widths = [root], 0.0, 0, high - low
    real = np.array([block.kind == "real" for block in loop.blocks], dtype=bool)
    while waiting:
        if used > work:
            part = waiting[-1].part
            return Attempt(None, part.low, part.high, part.at, used)
        batch, waiting = waiting[-_BATCH:], waiting[:-_BATCH]
        with after(used):
            covers_of = crew.map(covered, [(loop, node.part) for node in batch])
        worst = None
        for node, cover in zip(batch, covers_of, strict=True):
            node.cover, used = cover, used + cover.work
            if cover.todo and (worst is None or worst[1].beta < cover.beta):
                worst = node.part, cover
        if worst is None:
            continue
        center = 0.5 * (worst[0].low + worst[0].high)[real]
        if batches % _OFTEN == 0 and reach(center, worst[1].at):
            return Attempt(None, worst[0].low, worst[0].high, worst[1].at, used)
        batches += 1
        for node, cover in zip(batch, covers_of, strict=True):
            if not cover.todo:
                continue
            node.cut = _cut(loop, node, cover, real, widths)
            if node.cut < 0:
                return Attempt(None, node.part.low, node.part.high, cover.at, used)
            node.halves = _halves(node, cover)
            waiting += node.halves[::-1]
    return Attempt(root, low, high, np.nan, used)


def _cut(loop: Loop, node: _Node, cover: Cover, real: NDArray[np.bool_], widths: Array) -> int:
    """The parameter along which a part is cut; -1 if there is none."""
    part, own = node.part, node.part.high - node.part.low
    fits_in = np.flatnonzero(real & (own > _SMALLEST * widths))
    is_rough = not cover.beta > 1.0 and node.rough >= _ROUGH
    if not len(fits_in) or np.isnan(cover.at) or cover.last is None or is_rough:
        return -1
    if len(fits_in) == 1 or not cover.beta > 1.0:
        return int(fits_in[np.argmax((own / widths)[fits_in])])
    M, found = matrix_at(loop, cover.at), []
    for axis in fits_in:
        both = _cut_in_two(part.low, part.high, int(axis))
        bounds = [_bound(loop, M, low, high, cover.last, int(axis)) for low, high in both]
        found.append(max(bounds) + 1e-9 * min(bounds))
    return int(fits_in[int(np.argmin(found))])


def _bound(loop: Loop, M: Complex, low: Array, high: Array, known: Multipliers, axis: int) -> float:
    """A bound of mu^2 of a part, with multipliers of the one that it is a half of."""
    scaled_M, half = inside(loop, M, low, high)
    best = np.inf
    for factor in _FACTORS:
        weight = np.where(loop.owner == axis, factor, 1.0)
        try:
            best = min(best, best_square(scaled_M, weight[:, None] * known.D, known.G * half))
        except np.linalg.LinAlgError:
            continue
    return best


def _halves(node: _Node, cover: Cover) -> tuple[_Node, _Node]:
    """Both halves of a part, the lower first, with the frequencies that are open."""
    inherited = node.part._replace(todo=cover.todo, at=cover.at, start=cover.last)
    rough = node.rough + (not cover.beta > 1.0)
    first, second = (
        _Node(inherited._replace(low=low, high=high), rough=rough)
        for low, high in _cut_in_two(node.part.low, node.part.high, node.cut)
    )
    return first, second


def _cut_in_two(low: Array, high: Array, axis: int) -> tuple[tuple[Array, Array], ...]:
    """Ends of both halves along a block, the lower first."""
    below, above = high.copy(), low.copy()
    below[axis] = above[axis] = 0.5 * (low[axis] + high[axis])
    return (low, below), (above, high)


def proof_of(
    loop: Loop, k: float, parts: _Node | Cover, signals: tuple[tuple[str, ...], tuple[str, ...]]
) -> IntervalProof:
    """The proof of a tree of parts, or of the whole box."""
    log: list[int] = []
    intervals: list[Interval] = []
    multipliers: list[Multipliers] = []

    def add(cover: Cover, cut: int) -> None:
        log.extend((len(cover.intervals), cut + 1))
        intervals.extend(cover.intervals)
        multipliers.extend(unscaled(found, loop.scale) for found in cover.multipliers)

    waiting = [parts] if isinstance(parts, _Node) else []
    if isinstance(parts, Cover):
        add(parts, -1)
    while waiting:
        node = waiting.pop()
        if node.cover is not None:
            add(node.cover, node.cut)
        waiting += node.halves[::-1] if node.halves else ()
    fixed = [b.name for b, grows in zip(loop.blocks, loop.grows, strict=True) if not grows]
    return IntervalProof(
        k, tuple(log), tuple(intervals), tuple(multipliers), tuple(fixed), *signals
    )


def wrong_in(loop: Loop, proof: IntervalProof) -> str:
    """What is wrong with a proof; empty if it is one. Nothing is searched."""
    if len(proof.log) % 2 or len(proof.intervals) != len(proof.multipliers):
        return "the list of parts is not whole"
    known: tuple[Interval, ...] = ()
    waiting, used = [(*ends_of(loop, proof.k), known)], 0
    for count, cut in zip(proof.log[::2], proof.log[1::2], strict=True):
        if not waiting or count < 0 or used + count > len(proof.intervals):
            return "the list of parts is not whole"
        low, high, known = waiting.pop()
        extent = extent_of(loop, low, high)
        own = proof.intervals[used : used + count]
        for interval, found in zip(own, proof.multipliers[used:], strict=False):
            if found.beta != 1.0 or not fits(found, loop.blocks):
                return f"the multipliers near {interval.at:.4g} rad/s are not of the structure of Delta"
            if not holds(loop.channels, scaled(found, loop.scale), interval, extent):
                return (
                    f"the multipliers near {interval.at:.4g} rad/s do not prove their bound from "
                    f"{interval.low:.4g} to {interval.high:.4g} rad/s"
                )
        used, known = used + count, (*known, *own)
        if not cut:
            if not covers(tuple(sorted(known))):
                return "the intervals of a part do not cover all frequencies"
            continue
        axis = cut - 1
        if not 0 <= axis < len(loop.blocks) or loop.blocks[axis].kind != "real":
            return "a part is cut along a block that is not real"
        waiting += [(*ends, known) for ends in _cut_in_two(low, high, axis)[::-1]]
    return "the list of parts is not whole" if waiting or used != len(proof.intervals) else ""
