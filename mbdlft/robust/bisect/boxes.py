"""A proof on a box of deltas and all frequencies: stability, or a bound of a gain, by branch and bound.

The characteristic polynomial p in Bernstein form lies in the convex hull of its coefficients p_c, each
known up to an error e. If there is a direction a, |a| = 1, with

    Re(conj(a) p_c) > e + g |q_c|        for all coefficients,

then |p| > g |q| everywhere on the piece: with q = 0 it does not vanish, and with the products q of p and
a transfer, its norm is below 1/g. (For unit vectors v, u the polynomial p - g v'q u lies in the convex
hull of p_c - g v'q_c u, where |v'q_c u| <= |q_c|, the largest singular value.) Directions that a
coefficient allows are an arc; all arcs must meet. Angles in doubles suggest the direction; that it is one
is checked by products, with bounds of the rounding of each operation (IEEE 754).

Box and frequencies are cut until all pieces exclude zeros so. Where p vanishes for no frequency, infinity
included, all models of the box have as many unstable poles as one of them.

A box need not be cut along a delta if, at each frequency that is still open, roots on the axis can move
to one side only when this delta grows. Then no model of the box has more unstable poles than one with the
same other deltas on that face, since unstable poles stay unstable on the way there; so the face is
enough, if its own middle is stable. No open frequency may be infinite, where poles come from.

Cuts and faces are a list of integers, with which `replayed` repeats the proof without a search.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbdlft.base.array import Array
from mbdlft.base.running import after, tell
from mbdlft.exact.rounding import EPS
from mbdlft.robust.bisect.characteristic import Polynomials, Realization, is_stable_at

_WIDER = 64.0 * EPS  # rad: more than angles in doubles are off, so that edges pass their check
_TINY = 1e-300  # more than products lose that are below all normal doubles
_LOOK = 512  # coefficients that are looked at first, from twice as many on
Values = NDArray[np.complex128]
UNIT = 2.0e7  # coefficients in a unit of work, at most about a second of one core
LEAF = 0
_SMALLEST = 2.0**-16  # half of a box that is not cut again, of the whole [1]
_NARROWEST = 2.0**-44  # interval of t that is not cut again
_SLOW = 0.35  # of the change along a delta: less change along t is not a reason to cut t
_MOST_PIECES = 200  # open pieces of a box: with more, none is cut along t any more
_CALL = 4000  # coefficients that a call costs
_FIRST = 1.0  # units of work that are done before boxes are given to others
_BATCH = 8  # boxes that are given to others at a time
Check = Callable[[Array], bool]
Ends = float | Array  # of all deltas of a box, or of each
Task = tuple[Any, ...]
Crew = Callable[[Callable[..., Any], Sequence[Task]], list[Any]]  # results in the order of the tasks


class Piece(NamedTuple):
    """Polynomials on a part of the box, and low <= t <= high; an axis of a fixed delta has length 1."""

    values: Values  # (1 + n_gain, r_1 + 1, ..., n + 1)
    error: Array  # (1 + n_gain, n + 1)
    low: float
    high: float
    outputs: int = 0  # of the transfer, whose entries row by row are the last n_gain


class Cone(NamedTuple):
    """Two unit complex numbers, less than half a turn apart, with all values between their directions."""

    low: complex
    high: complex


def cone(coefficients: Values, error: Array) -> Cone | None:
    """The cone of a polynomial on a piece: coefficients (..., m + 1) with errors (m + 1,) or of each."""
    flat, radii = coefficients.ravel(), np.broadcast_to(error, coefficients.shape).ravel()
    angles = _angles(flat, radii)
    if angles is None:
        return None
    low, high = (complex(np.exp(1j * angle)) for angle in (angles[0] - _WIDER, angles[1] + _WIDER))
    inside = _is_left(flat, low, radii) and _is_left(-flat, high, radii)
    return Cone(low, high) if inside and _is_left(high, low) else None


def _is_on_one_side(coefficients: Values, error: Array) -> bool:
    """Whether a line through zero has a polynomial on a piece on one side; arguments as of `cone`."""
    flat, radii = coefficients.ravel(), np.broadcast_to(error, coefficients.shape).ravel()
    angles = _angles(flat, radii)
    return angles is not None and _is_left(flat, -1j * np.exp(0.5j * sum(angles)), radii)


def _angles(flat: Values, radii: Array) -> tuple[float, float] | None:
    """Angles (rad) of the cone of values with radii, in doubles; None if it is half a turn or more."""
    step = max(1, len(flat) // _LOOK)
    if step > 1 and _angles(flat[::step], radii[::step]) is None:
        return None
    sizes = np.abs(flat)
    if not np.all(radii < sizes):
        return None
    middle = np.sum(flat / sizes)
    if middle == 0.0:
        return None
    turned = flat * np.conj(middle / abs(middle))
    angles, widths = np.arctan2(turned.imag, turned.real), np.arcsin(radii / sizes)
    low, high = float(np.min(angles - widths)), float(np.max(angles + widths))
    base = float(np.angle(middle))
    return (base + low, base + high) if high - low < np.pi else None


def _is_left(values: Any, direction: Any, radii: Any = 0.0) -> bool:
    """Whether all numbers within radii of values are less than half a turn left of a direction.

    That is Im(conj(direction) value) > radius. Each product and the difference is off by half an EPS of
    itself, and the direction is a unit but for some EPS.
    """
    across = direction.real * np.imag(values) - direction.imag * np.real(values)
    rounding = 4.0 * EPS * (np.abs(np.real(values)) + np.abs(np.imag(values))) + _TINY
    return bool(np.all(across > radii * (1.0 + 16.0 * EPS) + rounding))


def excludes(piece: Piece, gain: float) -> bool:
    """Whether p cannot vanish on a piece, and |p| > gain |q| there; `gain` is 1 over a bound."""
    p, error = piece.values[0], piece.error[0]
    if len(piece.values) == 1:
        return _is_on_one_side(p, error)
    q = piece.values[1:]
    q = q.reshape(piece.outputs, -1, *p.shape)
    errors = np.sqrt(np.sum(piece.error[1:] ** 2, axis=0))
    size = np.sqrt(np.sum(q.real**2 + q.imag**2, axis=(0, 1)))
    if min(q.shape[:2]) > 1 and np.all(gain * size < (1.0 + q.shape[0]) * np.abs(p)):
        size = largest_singular(np.moveaxis(q.reshape(*q.shape[:2], -1), -1, 0)).reshape(p.shape)
    rounding = 8.0 * len(piece.values) * EPS  # of sums of squares, and of what is made of them
    return _is_on_one_side(p, (error + gain * (size + errors)) * (1.0 + rounding))


def largest_singular(matrices: Values) -> Array:
    """Upper bounds (N,) of the largest singular values of matrices Q (N, n_y, n_u).

    With V near to the right singular vectors, and W = Q V, it is at most the root of the largest row sum
    of |W'W|, over the least singular value of V; products of k terms are off by at most k EPS of those
    of sizes.
    """
    tall = matrices if matrices.shape[1] >= matrices.shape[2] else np.swapaxes(matrices, 1, 2)
    n = tall.shape[2]
    V = np.conj(np.swapaxes(np.linalg.svd(tall, full_matrices=False)[2], 1, 2))
    W = tall @ V
    rounding = 4.0 * (sum(tall.shape[1:]) + 4) * n * EPS
    whole = np.sqrt(np.sum(np.abs(tall) ** 2, axis=(1, 2)))
    squares, lengths = (
        _row_sums(np.conj(np.swapaxes(X, 1, 2)) @ X, diagonal) for X, diagonal in ((W, 0.0), (V, 1.0))
    )
    bound = np.sqrt(squares + rounding * whole**2) + rounding * whole
    bound = bound * (1.0 + rounding) / np.sqrt(1.0 - np.minimum(lengths + rounding, 0.5))
    return np.asarray(np.where(lengths + rounding < 0.5, bound, whole * (1.0 + rounding)))


def _row_sums(squares: Values, diagonal: float) -> Array:
    """The largest row sum of each of the matrices (N, n, n), less `one` times the identity."""
    return np.asarray(
        np.max(np.sum(np.abs(squares - diagonal * np.eye(squares.shape[1])), axis=2), axis=1)
    )


def turn_of(piece: Piece, axis: int) -> int:
    """1 or -1 if roots on this piece of the axis move to the right or left with delta; else 0.

    Where p(j omega, delta) = 0, the real part of the root changes by Im(p_delta / p_omega) d delta. It
    has one sign if it has it for all pairs of edges of both cones.
    """
    p, error = piece.values[0], piece.error[0]
    along = cone(np.diff(p, axis=axis), 2.0 * error + 2.0 * EPS * _largest(p))
    if along is None:
        return 0
    pairs = error + 2.0 * EPS * _largest(p)
    speed = cone(np.diff(p, axis=-1), pairs[1:] + pairs[:-1])
    if speed is None:
        return 0
    edges = np.array(along)
    if all(_is_left(edges, direction) for direction in speed):
        return 1
    return -1 if all(_is_left(-edges, direction) for direction in speed) else 0


def _largest(values: Values) -> Array:
    """The largest size for each power of t (m + 1,)."""
    return np.asarray(np.max(np.abs(values), axis=tuple(range(values.ndim - 1))))


def spreads(piece: Piece) -> Array:
    """How much p changes along each delta, and along t, relative to its size: (number of deltas + 1,)."""
    p = piece.values[0]
    size = float(np.mean(np.abs(p)))
    changes = [
        float(np.max(np.sum(np.abs(np.diff(p, axis=k)), axis=k), initial=0.0)) for k in range(p.ndim)
    ]
    return np.asarray(changes) / max(size, 1e-300)


def halves(piece: Piece, axis: int) -> tuple[Piece, Piece]:
    """Both halves of a piece along a delta, the lower first; -1 is the axis of t (de Casteljau)."""
    along = axis + 1 if axis >= 0 else -1
    largest = np.stack([_largest(row) for row in piece.values])
    low, high = split(piece.values, along)
    if axis >= 0:
        error = piece.error + (piece.values.shape[along] - 1) * 2.0 * EPS * largest
        return piece._replace(values=low, error=error), piece._replace(values=high, error=error)
    n, middle = piece.error.shape[-1], 0.5 * (piece.low + piece.high)
    errors = [
        (e + n * 2.0 * EPS * m) * (1.0 + 2.0 * n * EPS)
        for e, m in zip(split(piece.error, -1), split(largest, -1), strict=True)
    ]
    return (
        piece._replace(values=low, error=errors[0], high=middle),
        piece._replace(values=high, error=errors[1], low=middle),
    )


def split(values: Any, axis: int) -> tuple[Any, Any]:
    """Coefficients on both halves of an axis."""
    row = np.moveaxis(values, axis, 0)
    low, high = [row[0]], [row[-1]]
    while len(row) > 1:
        row = 0.5 * (row[1:] + row[:-1])
        low.append(row[0])
        high.append(row[-1])
    return np.stack(low, axis=axis), np.stack(high[::-1], axis=axis)


class Box(NamedTuple):
    """A part of the box: deltas c - h to c + h, [1], where h = 0 for those on a face."""

    center: Array
    half: Array
    pieces: tuple[Piece, ...]


class Outcome(NamedTuple):
    """What came of an attempt."""

    log: tuple[int, ...] | None  # the proof, or None if there is none
    counterexample: Array | None  # deltas (number of deltas,), of the unit box, where `is_wrong` holds
    open_box: Box  # the last: one that resisted, if there is neither a proof nor a counterexample
    work: float  # units that were used
    frequency: float  # where the box that took the most cuts was open (rad/s); NaN if there was none


def prove(
    model: Realization,
    k: Ends,
    polynomials: Polynomials,
    work: float,
    is_wrong: Check,
    gain: float,
    crew: Crew,
) -> Outcome:
    """Try to prove that all models of the box |delta| <= k are stable, and of a gain below 1/gain.

    `is_wrong` tells whether deltas (number of deltas,) of the unit box are a counterexample; processes
    get it, so it is a function of a module, or a part of one. The crew looks at boxes that wait when the
    first unit of work is used up.
    """
    scale, whole = polynomials.scale, _root(polynomials)
    first, unfinished = _explored(model, k, scale, whole, min(work, _FIRST), is_wrong, gain)
    if not unfinished or work <= _FIRST:
        return first
    used, frequency = first.work, first.frequency
    queue: list[Any] = [unfinished[0], *reversed(unfinished[1])]  # and what is proved
    while places := [i for i, item in enumerate(queue) if isinstance(item, Box)][:_BATCH]:
        share = (work - used) / len(places)
        if share <= 0.0:
            return first._replace(work=used, frequency=frequency)
        with after(used):
            tasks = [(model, k, scale, queue[i], share, is_wrong, gain) for i in places]
            outcomes: list[tuple[Outcome, _Rest | None]] = crew(_explored, tasks)
        used += sum(outcome.work for outcome, _ in outcomes)
        for i, (outcome, unproved) in reversed([*zip(places, outcomes, strict=True)]):
            if outcome.log is None:
                first = outcome
            if outcome.log is None and not unproved:
                return outcome._replace(work=used)
            if not np.isnan(outcome.frequency):
                frequency = outcome.frequency
            queue[i : i + 1] = [unproved[0], *reversed(unproved[1])] if unproved else [outcome.log]
    log = tuple(step for steps in queue for step in steps)
    return Outcome(log, None, first.open_box, used, frequency)


_Rest = tuple[tuple[int, ...], tuple[Box, ...]]


def _explored(
    model: Realization, k: Ends, scale: float, box: Box, work: float, is_wrong: Check, gain: float
) -> tuple[Outcome, _Rest | None]:
    """What comes of a part of the box; and where it ended for want of work: cuts, and boxes that wait."""
    coefficients_left, log, frequency = work * UNIT, list[int](), np.nan
    waiting = [box]
    while waiting:
        whole = waiting.pop()
        pieces, cost = _refined(whole.pieces, gain, patient=not np.any(whole.half))
        box, coefficients_left = whole._replace(pieces=pieces), coefficients_left - cost
        used = work - coefficients_left / UNIT
        tell(used)
        if not pieces:
            log.append(LEAF)
            if not np.all(box.half) and not is_stable_at(model, k * box.center):
                return Outcome(None, box.center, box, used, frequency), None
            continue
        t = 0.5 * (pieces[0].low + pieces[0].high)
        frequency = float(scale * t / (1.0 - t))  # (rad/s) in the middle of the first open piece
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
        if coefficients_left < 0.0:
            return Outcome(None, None, box, used, frequency), (tuple(log), (*waiting, whole))
        log.append(3 * widest + 1)
        waiting += reversed(_cut(box, widest))
    return Outcome(tuple(log), None, box, work - coefficients_left / UNIT, frequency), None


def replayed(
    model: Realization, k: Ends, polynomials: Polynomials, log: tuple[int, ...], gain: float = 0.0
) -> bool:
    """Whether a list of cuts and faces proves what `prove` says; nothing is searched."""
    waiting, steps = [_root(polynomials)], iter(log)
    for step in steps:
        if not waiting:
            return False
        box = waiting.pop()
        pieces, _ = _refined(box.pieces, gain, patient=step == LEAF)
        box = box._replace(pieces=pieces)
        axis, kind = divmod(step - 1, 3)
        if step == LEAF:
            if pieces or (not np.all(box.half) and not is_stable_at(model, k * box.center)):
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


def _root(polynomials: Polynomials) -> Box:
    q = polynomials.values.ndim - 2
    whole = Piece(polynomials.values, polynomials.error, 0.0, 1.0, polynomials.outputs)
    return Box(np.zeros(q), np.ones(q), (whole,))


def _refined(pieces: tuple[Piece, ...], gain: float, *, patient: bool) -> tuple[tuple[Piece, ...], float]:
    """The pieces on which zeros are not excluded, cut along t while that helps; and what it cost."""
    waiting, cost = list(pieces), 0.0
    still: list[Piece] = []
    while waiting:
        piece = waiting.pop()
        cost += piece.values.size + _CALL
        if excludes(piece, gain):
            continue
        cost += piece.values.size + _CALL  # of the cut, or of the look whether to cut
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


def _side(box: Box, axis: int) -> int:
    """The side to which all open pieces turn; 0 if there is none."""
    if any(piece.high == 1.0 for piece in box.pieces):
        return 0
    side = turn_of(box.pieces[0], axis)
    return side if side and all(turn_of(piece, axis) == side for piece in box.pieces[1:]) else 0


def _on_face(box: Box, axis: int, side: int) -> Box:
    """The face of a box where a delta has its lower (-1) or upper (1) end."""
    place = [-1 if side > 0 else 0]
    pieces = (p._replace(values=np.take(p.values, place, axis=axis + 1)) for p in box.pieces)
    center, half = box.center.copy(), box.half.copy()
    center[axis] += side * half[axis]
    half[axis] = 0.0
    return Box(center, half, tuple(pieces))


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
