"""Motions of the parameters that make a system unstable: a search over periods (Floquet).

A period is cut into even steps. The growth of a motion is that of the largest eigenvalue mu of the
product Phi of exp(A(delta_i) h), and with its vectors u and v

    d log|mu| = sum_i Re( u' Phi_after dA_i Phi_before v / (mu u' v) ) h,

to first order in h. The motion that increases this most, with |delta| <= k and rates below their bounds,
is a linear program, one for each delta; steps towards it are taken while the growth rises. What is found
is moved along its ray to where it neither grows nor falls. Floquet, Annales de l'ENS 12 (1883).
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.linalg import expm

from mbdlft.base.array import Array
from mbdlft.exact.rounding import eigenvalues_of
from mbdlft.robust.ascent import bisected, by_damping, moving_at, state_matrices
from mbdlft.robust.bisect.characteristic import Realization

_POINTS, _FINE = 32, 8  # steps of a period; of a step, for a motion that is not in steps
_CLIMBS, _HALVES = 25, 4  # steps of a climb, and how often one is halved
_ROUNDS, _BISECTIONS = 3, 40  # climbs from a start; halvings of a ray, to 1e-12 of it
_MODES = 4  # the least damped, whose periods are tried
_UNIT = 3.0e-5  # units of work of a round, for each state cubed
_TUNED = (0.1, 0.03, 0.01)  # changes of the period of what was found
_TURNS = (1.0, 0.93, 1.07, 2.0)  # of half a turn of a mode: periods that are tried


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
    best, rounds = NONE, iter(range(int(work / (_UNIT * (len(model.A) + 6.0) ** 3))))

    def climbed(size: float, period: float, deltas: Array) -> Motion:
        """The part that just does not fall of a motion that is near, and grows more."""
        rates = rates_in(size)
        return _on_ray(
            model, rates, period, _climbed(model, period, deltas, (size, rates * period / _POINTS))
        )

    for period, deltas in _starts(model, most):
        size = most
        for _ in range(_ROUNDS):
            if next(rounds, None) is None:
                return best
            motion = climbed(size, period, deltas)
            if not motion.size < size * (1.0 - 1e-3):
                break
            best = motion if motion.size < best.size else best
            size, deltas = motion.size, motion.deltas
    for step in _TUNED:  # another period, as long as a smaller motion grows
        for share in (1.0 + step, 1.0 / (1.0 + step)):
            while np.isfinite(best.size) and next(rounds, None) is not None:
                more = 1.0 + step
                motion = climbed(best.size * more, best.period * share, best.deltas * more)
                if not motion.size < best.size * (1.0 - 1e-4):
                    break
                best = motion
    return best


def growth(model: Realization, rates: Array, period: float, deltas: Array, fine: int) -> float:
    """log |mu| of a period; inf where the model is singular, -inf where a step is beyond all numbers."""
    A = state_matrices(model, _points(deltas, rates, fine))
    if A is None:
        return np.inf
    Phi, total = np.eye(len(model.A)), 0.0
    with np.errstate(all="ignore"):
        for step in expm(A * (period / len(A))):
            Phi = step @ Phi
            size = float(np.max(np.abs(Phi)))
            if not 0.0 < size < np.inf:
                return -np.inf
            Phi, total = Phi / size, total + float(np.log(size))
        return total + float(np.log(np.max(np.abs(eigenvalues_of(Phi)))))


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


def _starts(model: Realization, most: float) -> list[tuple[float, Array]]:
    """Periods and motions that push at half the turn of a mode."""
    here, _, _ = moving_at(model, np.zeros(len(model.sizes)))
    kept = np.flatnonzero(here.poles.imag >= 0.0)
    turn = 2.0 * np.pi * (np.arange(_POINTS) + 0.5) / _POINTS
    starts = []
    for k in kept[by_damping(here.poles[kept])][:_MODES]:
        pole, slope = here.poles[k], here.gradients[k]
        side = np.sign(slope.imag if pole.imag else slope.real)
        for share in _TURNS:
            for wave in (np.sin(turn), np.cos(turn)):
                start = 0.3 * most * wave[:, None] * side
                starts.append((share * np.pi / float(pole.imag or abs(pole)), start))
    return starts


def _climbed(model: Realization, period: float, deltas: Array, limits: tuple[float, Array]) -> Array:
    """A motion within the limits of size and change per step that grows more."""
    size, steps = limits
    any_rate = np.full(len(steps), np.inf)
    deltas = np.stack([_fitted(row, size, step) for row, step in zip(deltas.T, steps, strict=True)], 1)
    value = growth(model, any_rate, period, deltas, 1)
    for _ in range(_CLIMBS):
        slope = _slope(model, period, deltas) if np.isfinite(value) else None
        if slope is None:
            return deltas
        pairs = zip(slope.T, steps, strict=True)
        target = np.stack([_best(row, size, step) for row, step in pairs], axis=1)
        for half in range(_HALVES):
            new = deltas + 0.5**half * (target - deltas)
            there = growth(model, any_rate, period, new, 1)
            if there > value * (1.0 + np.sign(value) * 1e-6):
                break
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
    """A motion in proportion to a row, within the limits."""
    if step == 0.0:
        return np.full_like(row, np.clip(np.mean(row), -size, size))
    change = float(np.max(np.abs(np.diff(np.append(row, row[0])))))
    share = min(1.0, step / change if change > 0.0 else 1.0)
    return np.clip(share * row, -size, size)


def _best(slope: Array, size: float, step: float) -> Array:
    """The periodic row within the limits that increases a linear function most."""
    from scipy.optimize import linprog  # here because it is slow to import

    n = len(slope)
    if np.isinf(step) or step >= 2.0 * size:
        return np.asarray(size * np.sign(slope))
    if step == 0.0:
        return np.full(n, size * np.sign(np.sum(slope)))
    change = np.roll(np.eye(n), 1, axis=1) - np.eye(n)
    solution = linprog(
        -slope / max(float(np.max(np.abs(slope))), 1e-300),
        A_ub=np.vstack([change, -change]),
        b_ub=np.full(2 * n, step),
        bounds=[(-size, size)] * n,
        method="highs",
    )
    return np.asarray(solution.x, dtype=float) if solution.status == 0 else np.zeros(n)


def _on_ray(model: Realization, rates: Array, period: float, deltas: Array) -> Motion:
    """The part of a motion that just does not fall; `NONE` if the whole falls."""
    if not growth_of(model, rates, period, deltas) >= 0.0:
        return NONE
    high = bisected(lambda t: growth_of(model, rates, period, t * deltas) >= 0.0, 0.0, 1.0, _BISECTIONS)
    return Motion(high * float(np.max(np.abs(deltas))), period, high * deltas)
