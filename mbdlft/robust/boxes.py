"""A proof for all deltas of a box: stability, or a bound of a gain, by pieces that exclude zeros.

A box of deltas and all frequencies is cut into pieces on which the characteristic polynomial cannot
vanish (`mbdlft.robust.exclusion`). Where it cannot vanish for any frequency, infinity included, all
models of the box have as many unstable poles as one of them.

A box need not be cut along a delta if, at each frequency that is still open, roots on the axis can move
to one side only when this delta grows. Then no model of the box has more unstable poles than one with the
same other deltas on that face, since unstable poles stay unstable on the way there; so the face is
enough, if its own middle is stable. No open frequency may be infinite, where poles come from.

What was cut and fixed is a list of integers, with which `replayed` repeats the proof without a search.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from mbdlft.base.array import Array
from mbdlft.base.spent import after, tell
from mbdlft.robust.characteristic import Polynomials, Realization, is_stable_at
from mbdlft.robust.crew import ALONE, Crew
from mbdlft.robust.exclusion import Piece, excludes, fixed, halves, spreads, turn_of

UNIT = 2.0e7  # coefficients in a unit of work, at most about a second of one core
LEAF = 0
_SMALLEST = 2.0**-16  # half of a box that is not cut again, of the whole [1]
_NARROWEST = 2.0**-44  # interval of t that is not cut again
_SLOW = 0.35  # of the change along a delta: less change along t is not a reason to cut t
_MOST_PIECES = 200  # open pieces of a box: with more, none is cut along t any more
_CALL = 2000  # coefficients that a call costs
_FIRST = 1.0  # units of work that are done before boxes are given to others
_BATCH = 8  # boxes that are given to others at a time
_SHARE = 0.5  # of the work that is left, for one of them


class Box(NamedTuple):
    """A part of the box: deltas c - h to c + h, [1], where h = 0 for those on a face."""

    center: Array
    half: Array
    pieces: tuple[Piece, ...]


class Outcome(NamedTuple):
    """What came of an attempt.

    Attributes
    ----------
    log : tuple of int, or None
        The proof, or None if there is none.
    counterexample : array (number of deltas,), or None
        Deltas, of the unit box, at which `is_wrong` holds.
    open_box : Box
        The last box: one that resisted, if there is neither a proof nor a counterexample.
    work : float
        Units that were used.
    frequency : float
        Where the box that took the most cuts was open (rad/s); NaN if there was none.
    """

    log: tuple[int, ...] | None
    counterexample: Array | None
    open_box: Box
    work: float
    frequency: float


Check = Callable[[Array], bool]


def prove(
    model: Realization,
    k: float,
    found: Polynomials,
    work: float,
    is_wrong: Check,
    gain: float = 0.0,
    crew: Crew = ALONE,
) -> Outcome:
    """Try to prove that all models of the box |delta| <= k are stable, and of a gain below 1/gain.

    Parameters
    ----------
    model : Realization
    k : float
    found : Polynomials of this box
    work : float
        Units of work.
    is_wrong : function of deltas (number of deltas,), of the unit box
        Whether they are a counterexample. Processes get it: a function of a module, or a part of one.
    gain : float
        One over the bound; 0 for stability only.
    crew : Crew
        Who looks at boxes that wait when the first unit of work is used up.
    """
    first, rest = _explored(model, k, found.scale, _root(found), min(work, _FIRST), is_wrong, gain)
    if not rest or work <= _FIRST:
        return first
    log, used, frequency = list(rest[0]), first.work, first.frequency
    waiting = list(rest[1])
    while waiting:
        batch, waiting = waiting[: -_BATCH - 1 : -1], waiting[:-_BATCH]
        share = _SHARE * max(work - used, 0.0)
        tasks = [(model, k, found.scale, box, share, is_wrong, gain) for box in batch]
        with after(used):
            outcomes = [outcome for outcome, _ in crew.map(_explored, tasks)]
        used += sum(outcome.work for outcome in outcomes)
        for outcome in outcomes:
            if outcome.log is None:
                failed: Outcome = outcome._replace(work=used)
                return failed
            log += outcome.log
            if not np.isnan(outcome.frequency):
                frequency = outcome.frequency
    return Outcome(tuple(log), None, first.open_box, used, frequency)


_Rest = tuple[tuple[int, ...], tuple[Box, ...]]


def _explored(
    model: Realization, k: float, scale: float, box: Box, work: float, is_wrong: Check, gain: float
) -> tuple[Outcome, _Rest | None]:
    """What comes of a part of the box; and where it ended for want of work: cuts, and boxes that wait."""
    left, log, frequency = work * UNIT, list[int](), np.nan
    waiting = [box]
    while waiting:
        whole = waiting.pop()
        pieces, cost = _refined(whole.pieces, gain, patient=not np.any(whole.half))
        box, left = whole._replace(pieces=pieces), left - cost
        used = work - left / UNIT
        tell(used)
        if not pieces:
            log.append(LEAF)
            if _is_face(box) and not is_stable_at(model, k * box.center):
                return Outcome(None, box.center, box, used, frequency), None
            continue
        frequency = _frequency(pieces, scale)
        if is_wrong(box.center):
            return Outcome(None, box.center, box, used, frequency), None
        sides = [] if gain else [(int(k), _side(box, int(k))) for k in np.flatnonzero(box.half)]
        faces = [(axis, side) for axis, side in sides if side]
        for axis, side in faces:
            log.append(3 * axis + (2 if side < 0 else 3))
            box = _on_face(box, axis, side)
        if faces:
            waiting.append(box)
            continue
        widest = _widest(box)
        if widest is None:
            return Outcome(None, None, box, used, frequency), None
        if left < 0.0:
            return Outcome(None, None, box, used, frequency), (tuple(log), (*waiting, whole))
        log.append(3 * widest + 1)
        waiting += reversed(_cut(box, widest))
    return Outcome(tuple(log), None, box, work - left / UNIT, frequency), None


def replayed(
    model: Realization, k: float, found: Polynomials, log: tuple[int, ...], gain: float = 0.0
) -> bool:
    """Whether a list of cuts and faces proves what `prove` says; nothing is searched."""
    waiting, steps = [_root(found)], iter(log)
    for step in steps:
        if not waiting:
            return False
        box = waiting.pop()
        pieces, _ = _refined(box.pieces, gain, patient=step == LEAF)
        box = box._replace(pieces=pieces)
        axis, kind = divmod(step - 1, 3)
        if step == LEAF:
            if pieces or (_is_face(box) and not is_stable_at(model, k * box.center)):
                return False
        elif not 0 <= axis < len(box.center) or box.half[axis] == 0.0:
            return False
        elif kind == 0:
            waiting += reversed(_cut(box, axis))
        else:
            # faces of one box are found together: behind the first, the others may have no zeros left,
            # and then the middle of any face speaks for all
            side = -1 if kind == 1 else 1
            if gain or (pieces and _side(box, axis) != side):
                return False
            waiting.append(_on_face(box, axis, side))
    return not waiting


def _root(found: Polynomials) -> Box:
    q = found.values.ndim - 2
    whole = Piece(found.values, found.error, 0.0, 1.0, found.outputs)
    return Box(np.zeros(q), np.ones(q), (whole,))


def _refined(
    pieces: tuple[Piece, ...], gain: float, *, patient: bool
) -> tuple[tuple[Piece, ...], float]:
    """The pieces on which zeros are not excluded, cut along t while that helps; and what it cost."""
    waiting, cost = list(pieces), 0.0
    still: list[Piece] = []
    while waiting:
        piece = waiting.pop()
        cost += piece.values.size + _CALL
        if excludes(piece, gain):
            continue
        if len(still) < _MOST_PIECES and _is_worth_cutting(piece, patient=patient):
            waiting += halves(piece, -1)
        else:
            still.append(piece)
    return tuple(still), cost


def _is_worth_cutting(piece: Piece, *, patient: bool) -> bool:
    if piece.high - piece.low < _NARROWEST:
        return False
    if patient:
        return piece.high - piece.low > 2.0**-20 or float(spreads(piece)[-1]) > 2.0**-30
    *deltas, along_t = spreads(piece)
    return float(along_t) > _SLOW * max(map(float, deltas), default=0.0)


def _is_face(box: Box) -> bool:
    """Whether a box without zeros says nothing before its middle is looked at."""
    return not np.all(box.half)


def _side(box: Box, axis: int) -> int:
    """The side to which all open pieces turn; 0 if there is none."""
    side = 0
    if any(piece.high == 1.0 for piece in box.pieces):
        return 0
    for piece in box.pieces:
        turn = turn_of(piece, axis)
        if turn == 0 or turn == -side:
            return 0
        side = turn
    return side


def _on_face(box: Box, axis: int, side: int) -> Box:
    center, half = box.center.copy(), box.half.copy()
    center[axis] += side * half[axis]
    half[axis] = 0.0
    return Box(center, half, tuple(fixed(piece, axis, side) for piece in box.pieces))


def _widest(box: Box) -> int | None:
    """The delta along which the open pieces change most, or None if all are narrow."""
    change = np.max([spreads(piece)[:-1] for piece in box.pieces], axis=0)
    change = np.where(box.half > _SMALLEST, change, -1.0)
    if not len(change) or np.max(change) <= 0.0:
        return None
    return int(np.argmax(change))


def _cut(box: Box, axis: int) -> list[Box]:
    """Both halves of a box along a delta."""
    both = [halves(piece, axis) for piece in box.pieces]
    half = box.half.copy()
    half[axis] *= 0.5
    cut = []
    for side in (0, 1):
        center = box.center.copy()
        center[axis] += (2 * side - 1) * half[axis]
        cut.append(Box(center, half, tuple(pair[side] for pair in both)))
    return cut


def _frequency(pieces: tuple[Piece, ...], scale: float) -> float:
    """The middle frequency of the first open piece (rad/s)."""
    t = 0.5 * (pieces[0].low + pieces[0].high)
    return float(scale * t / (1.0 - t))
