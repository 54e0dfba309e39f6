"""Motions of the parameters that make a system unstable: a search over periods (Floquet).

A period is cut into even steps. The growth of a motion is that of the largest eigenvalue mu of the
product Phi of exp(A(delta_i) h), and with its vectors u and v

    d log|mu| = sum_i Re( u' Phi_after dA_i Phi_before v / (mu u' v) ) h,

to first order in h. The motion that increases this most, with |delta| <= k and rates below their bounds,
is a linear program, one for each delta; steps towards it are taken while the growth rises. What is found
is moved along its ray to where it neither grows nor falls. Floquet, Annales de l'ENS 12 (1883).
"""

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np
from scipy.linalg import expm

from mbdlft.base.array import Array
from mbdlft.base.errors import WellPosednessError
from mbdlft.exact.rounding import EPS, eigenvalues_of
from mbdlft.robust.ascent import bisected, by_damping, moving_at, state_matrices
from mbdlft.robust.bisect.characteristic import Realization

_POINTS, _FINE = 32, 8  # steps of a period; of a step, for a motion that is not in steps
_CLIMBS = 25  # steps of a climb
_SHRINKS, _SHRINK = 6, 0.25  # how often the reach of a step shrinks, by which factor
_ROUGH, _BISECTIONS = 12, 40  # halvings of a ray: in the search, and of what it ends with, to 1e-12
_LARGER = (1.0, 1.01, 1.05, 1.2)  # times what grows in coarse steps: boxes that are tried in fine ones
_MODES = 4  # the least damped, whose periods are tried
_UNIT = 1.0e-4  # units of work of a round, for each state cubed
# changes of the period of what was found; of its exact motion, with so many times as many steps
_TUNED, _TUNED_FINER, _FINER = (0.1, 0.03, 0.01), (0.001, 0.0), 2
_TURNS = (1.0, 2.0)  # of half a turn of a mode: periods that are tried
_FITS = 2  # of the middle of a motion to the end of a box
_NEAR = 2e-3  # of a size: a smaller one is not looked for by halving
_LADDER = (1.0, 0.8, 0.6, 0.4, 0.2, 0.1)  # of the largest: the first sizes


class Motion(NamedTuple):
    """A periodic motion of the deltas."""

    size: float  # largest |delta|; inf if none was found
    period: float  # in seconds
    # (points, number of deltas), in the middle of even steps: kept for a step, or joined by lines where
    # the rate is bounded
    deltas: Array


NONE = Motion(np.inf, np.nan, np.zeros((0, 0)))


def unstable_motion(
    model: Realization, rates_in: Callable[[float], Array], most: float, work: float = 10.0
) -> Motion:
    """The smallest motion found with |delta| <= most that does not fall, with so many units of work.

    `rates_in` gives rates of deltas (1/s) (number of deltas,) that are allowed everywhere in the box
    |delta| <= k; 0 for constants, inf for any motion.
    """
    is_in_steps = not np.any(np.isfinite(rates_in(most)) & (rates_in(most) > 0.0))
    fine = 1 if is_in_steps else _FINE
    rounds = iter(range(int(work / (_UNIT * (len(model.A) + 6.0) ** 3))))

    def climbed(size: float, period: float, deltas: Array, *, is_rough: bool = True) -> Motion:
        """The part that just does not fall of a motion that is near, and grows more."""
        rates = rates_in(size)
        near = _climbed(model, period, deltas, (size, rates * period / len(deltas)))
        more = partial(growth, model, rates, period, fine=1 if is_rough else fine)
        return _on_ray(more, period, near, _ROUGH if is_rough else _BISECTIONS)

    def started(place: int, size: float, *, is_rough: bool = True) -> Motion:
        for start in _starts(model, rates_in(size), size)[place : place + 1]:
            return climbed(size, *start, is_rough=is_rough)
        return NONE

    def smallest(size: float, but: int = -1) -> tuple[Motion, int]:
        """A motion in a box and the start that has it, in nearly the smallest box where it has one."""
        for place in range(len(_starts(model, rates_in(size), size))):
            if place == but or next(rounds, None) is None:
                continue
            best, low = started(place, size), 0.0
            if np.isinf(best.size):
                continue
            while low < best.size * (1.0 - _NEAR) and next(rounds, None) is not None:
                middle = 0.5 * (low + best.size)
                motion = started(place, middle)
                best, low = (motion, low) if motion.size <= middle else (best, middle)
            return best, place
        return NONE, -1

    first = (smallest(share * most) for share in _LADDER)
    best, place = next((smaller for smaller in first if smaller[1] >= 0), (NONE, -1))
    while place >= 0:
        motion, other = smallest(best.size, place)
        if not motion.size < best.size * (1.0 - _NEAR):
            break
        best, place = motion, other
    best = _tuned(climbed, rounds, best, most, _TUNED) if place >= 0 else NONE
    for factor in _LARGER if place >= 0 else ():
        size = min(most, factor * best.size)
        exact = (
            climbed(size, best.period, best.deltas, is_rough=False),
            started(place, size, is_rough=False),
        )
        for motion in exact:
            if motion.size <= most:
                near = _points(motion.deltas, rates_in(motion.size), _FINER)
                exactly = partial(climbed, is_rough=False)
                finer = _tuned(exactly, rounds, motion._replace(deltas=near), most, _TUNED_FINER)
                return finer if finer.size < motion.size else motion
    return NONE


def _tuned(
    climbed: Callable[[float, float, Array], Motion],
    rounds: Iterator[int],
    best: Motion,
    most: float,
    steps: Sequence[float],
) -> Motion:
    """A motion with another period, as long as a smaller one grows."""
    for step in steps:
        for share in (1.0 + step, 1.0 / (1.0 + step)):
            while next(rounds, None) is not None:
                motion = climbed(min(most, best.size * (1.0 + step)), best.period * share, best.deltas)
                if not motion.size < best.size * (1.0 - 1e-4):
                    break
                best = motion
    return best


def growth(model: Realization, rates: Array, period: float, deltas: Array, fine: int) -> float:
    """log |mu| of a period; inf where the model is singular, -inf where a step is beyond all numbers.

    Also where only rounding is left of it: a period may be too short for anything to fall or grow.
    """
    A = state_matrices(model, _points(deltas, rates, fine))
    if A is None:
        return np.inf
    with np.errstate(all="ignore"):
        steps, total = expm(A * (period / len(A))), 0.0
        while True:
            sizes = np.max(np.abs(steps), axis=(1, 2))
            if not np.all((sizes > 0.0) & (sizes < np.inf)):
                return -np.inf
            steps, total = steps / sizes[:, None, None], total + float(np.sum(np.log(sizes)))
            if len(steps) == 1:
                total += float(np.log(np.max(np.abs(eigenvalues_of(steps[0])))))
                return total if abs(total) > EPS * A[..., 0].size else -np.inf
            pairs = steps[1::2] @ steps[: len(steps) // 2 * 2 : 2]
            steps = np.concatenate([pairs, steps[len(steps) // 2 * 2 :]])


def growth_of(model: Realization, rates: Array, period: float, deltas: Array) -> float:
    """As `growth`, with finer steps if a rate is bounded."""
    fine = 1 if np.all(np.isinf(rates) | (rates == 0.0)) else _FINE
    return growth(model, rates, period, deltas, fine)


def _points(deltas: Array, rates: Array, fine: int) -> Array:
    """Deltas at the middles of finer steps."""
    if fine == 1:
        return deltas
    count = len(deltas)
    at = (np.arange(count * fine) + 0.5) / fine - 0.5
    low = np.floor(at).astype(int)
    fraction = (at - low)[:, None]
    lines = (1.0 - fraction) * deltas[low % count] + fraction * deltas[(low + 1) % count]
    return np.where(np.isinf(rates), np.repeat(deltas, fine, axis=0), lines)


def _starts(model: Realization, rates: Array, size: float) -> list[tuple[float, Array]]:
    """Periods and motions that push at half the turn of a mode: around 0, and at the ends of a box."""
    wave = np.sin(2.0 * np.pi * (np.arange(_POINTS) + 0.5) / _POINTS)[:, None]
    here = _modes(model, np.zeros(len(rates)))
    around = [(np.zeros(len(rates)), here)]
    for turn, side in here[:1] if np.any(np.isfinite(rates) & (rates > 0.0)) else []:
        for end in (side, -side):
            center, modes = np.zeros(len(rates)), [(turn, side)]
            for _ in range(_FITS):  # a mode has another turn there, so it needs another room
                center = np.maximum(size - 0.25 * (modes[0][0] if modes else turn) * rates, 0.0) * end
                modes = _modes(model, center)
            around.append((center, modes))
    return [
        (share * turn, center + 0.3 * size * wave * side)
        for share in _TURNS
        for place in range(_MODES)
        for center, modes in around
        for turn, side in modes[place : place + 1]
    ]


def _modes(model: Realization, center: Array) -> list[tuple[float, Array]]:
    """Half the turn (s) of each of the least damped modes, and the signs of its slopes by the deltas."""
    try:
        here, _, _ = moving_at(model, center)
    except WellPosednessError:
        return []
    kept = np.flatnonzero((here.poles.imag >= 0.0) & (here.poles != 0.0))  # an integrator has no turn
    modes = []
    for k in kept[by_damping(here.poles[kept])][:_MODES]:
        pole, slope = here.poles[k], here.gradients[k]
        side = np.sign(slope.imag if pole.imag else slope.real)
        modes.append((np.pi / float(pole.imag or abs(pole)), side))
    return modes


def _climbed(model: Realization, period: float, deltas: Array, limits: tuple[float, Array]) -> Array:
    """A motion within the limits of size and change per step that grows more."""
    size, steps = limits
    any_rate = np.full(len(steps), np.inf)
    deltas = np.stack([_fitted(row, size, step) for row, step in zip(deltas.T, steps, strict=True)], 1)
    value = growth(model, any_rate, period, deltas, 1)
    reach = size
    for _ in range(_CLIMBS):
        slope = _slope(model, period, deltas) if np.isfinite(value) else None
        if slope is None:
            return deltas
        for _ in range(_SHRINKS):
            triples = zip(slope.T, deltas.T, steps, strict=True)
            rows = [_best(row, near, min(size, reach), size, step) for row, near, step in triples]
            new = np.stack(rows, axis=1)
            there = growth(model, any_rate, period, new, 1)
            if there > value * (1.0 + np.sign(value) * 1e-6):
                break
            reach *= _SHRINK
        else:
            return deltas
        deltas, value = new, there
    return deltas


def _slope(model: Realization, period: float, deltas: Array) -> Array | None:
    """Derivatives of the growth (points, number of deltas); None where they are beyond all numbers."""
    A = state_matrices(model, deltas)
    if A is None:
        return None
    steps = expm(A * (period / len(A)))
    before = [np.eye(len(model.A))]
    with np.errstate(all="ignore"):
        for step in steps:
            before.append(step @ before[-1])
    try:
        values, V = np.linalg.eig(before[-1])
        U = np.linalg.inv(V)
    except np.linalg.LinAlgError:
        return None
    k = int(np.argmax(np.abs(values)))
    if not values[k]:
        return None
    row, lefts = U[k], []
    for step in steps[::-1]:
        lefts.append(row)
        row = row @ step
    rights = [(middle @ V[:, k])[None] for middle in before[1:]]
    terms = model.slopes(deltas, np.array(lefts[::-1])[:, None], np.array(rights))[:, 0] / values[k]
    return np.asarray(terms.real * (period / len(A)))


def _fitted(row: Array, size: float, step: float) -> Array:
    """A motion in proportion to a row, around the same mean, within the limits."""
    mean = float(np.clip(np.mean(row), -size, size))
    if step == 0.0:
        return np.full_like(row, mean)
    change = float(np.max(np.abs(np.diff(np.append(row, row[0])))))
    share = min(1.0, step / change if change > 0.0 else 1.0)
    return np.clip(mean + share * (row - mean), -size, size)


def _best(slope: Array, near: Array, reach: float, size: float, step: float) -> Array:
    """The periodic row within the limits, near another one, that increases a linear function most."""
    from scipy.optimize import linprog  # here because it is slow to import

    n = len(slope)
    low, high = np.maximum(near - reach, -size), np.minimum(near + reach, size)
    if np.isinf(step) or step >= 2.0 * size:
        return np.where(slope > 0.0, high, low)
    if step == 0.0:
        return high if np.sum(slope) > 0.0 else low
    change = np.roll(np.eye(n), 1, axis=1) - np.eye(n)
    solution = linprog(
        -slope / max(float(np.max(np.abs(slope))), 1e-300),
        A_ub=np.vstack([change, -change]),
        b_ub=np.full(2 * n, step),
        bounds=np.stack([low, high], axis=1),
        method="highs",
    )
    return np.asarray(solution.x, dtype=float) if solution.status == 0 else near


def _on_ray(more: Callable[[Array], float], period: float, deltas: Array, count: int) -> Motion:
    """The part of a motion that just does not fall, after so many halvings; `NONE` if the whole falls."""
    if not more(deltas) >= 0.0:
        return NONE
    high = bisected(lambda t: more(t * deltas) >= 0.0, 0.0, 1.0, count)
    return Motion(high * float(np.max(np.abs(deltas))), period, high * deltas)
