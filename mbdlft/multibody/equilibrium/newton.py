"""Newton's iteration on scaled unknowns, and a trust region where it stalls."""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from mbdlft.base.array import Array
from mbdlft.multibody.equilibrium.unknowns import Balance, reduce_at

_STEPS = 30
_LONGEST = 0.5  # step of an unknown over its size, so that the nearest root is found
_SHORTEST = 2.0**-8  # part of a step that is not halved again
_RANK = 1e-9
_SOLVED = 1e-10  # of the size of each row
_TRIALS = 200  # evaluations of the trust region
_OUTSIDE = 1e-9  # of the size of an unknown: what rounding may leave it outside its bounds


@dataclass(frozen=True, slots=True, eq=False)
class Attempt:
    """Where one start led.

    Attributes
    ----------
    s : Array (n_s,)
    rows : Array (m,)
        What is left of the rows, over their sizes.
    iterations : evaluations of the equations
    solved : whether the rows vanish, inside the bounds
    """

    s: Array
    rows: Array
    iterations: int
    solved: bool

    @property
    def residual(self) -> float:
        """Largest row over its size."""
        return float(np.max(np.abs(self.rows), initial=0.0))


def solve_from(b: Balance, start: Array) -> Attempt:
    """Newton's iteration, the trust region if it does not converge, and Newton's to roundoff."""
    found = _newton(b, start)
    if found.solved or not b.unknowns or not np.isfinite(reduce_at(b, start).rows).all():
        return found
    robust = _newton(b, _trust_region(b, start))
    iterations = found.iterations + robust.iterations
    return Attempt(robust.s, robust.rows, iterations, robust.solved)


def _newton(b: Balance, start: Array) -> Attempt:
    """Steps of least length, halved until the rows get smaller."""
    sizes = np.array([unknown.size for unknown in b.unknowns])
    s, at, count = start, reduce_at(b, start), 1
    while count < _STEPS and np.isfinite(at.rows).all() and b.unknowns:
        step = np.linalg.lstsq(at.slopes, -at.rows, rcond=_RANK)[0]
        longest = float(np.max(np.abs(step)))
        if longest == 0.0:
            break
        part = min(1.0, _LONGEST / longest)
        before = np.linalg.norm(at.rows)
        while part >= _SHORTEST:
            trial = _inside(b, s + part * step * sizes)
            there = reduce_at(b, trial)
            count += 1
            if np.isfinite(there.rows).all() and np.linalg.norm(there.rows) < before:
                break
            part *= 0.5
        else:
            break
        s, at = trial, there
    solved = (
        bool(np.isfinite(at.rows).all()) and float(np.max(np.abs(at.rows), initial=0.0)) <= _SOLVED
    )
    return Attempt(s, at.rows, count, solved and _within(b, s))


def _trust_region(b: Balance, start: Array) -> Array:
    """The least squares of the rows by scipy's trust region reflective method."""
    sizes = np.array([unknown.size for unknown in b.unknowns])
    low = np.array([u.low if u.bounded else -np.inf for u in b.unknowns]) / sizes
    high = np.array([u.high if u.bounded else np.inf for u in b.unknowns]) / sizes
    margin = np.where(np.isfinite(high - low), 1e-6 * (high - low), 0.0)
    begin = np.clip(start / sizes, low + margin, high - margin)
    far = np.full(len(b.sizes), 1e6)  # where the equations are not finite: never a step

    def rows(scaled: Array) -> Array:
        found = reduce_at(b, scaled * sizes).rows
        return found if np.isfinite(found).all() else far

    def slopes(scaled: Array) -> Array:
        return reduce_at(b, scaled * sizes).slopes

    found = least_squares(rows, begin, slopes, bounds=(low, high), max_nfev=_TRIALS, xtol=1e-12)
    return np.asarray(found.x * sizes)


def _inside(b: Balance, s: Array) -> Array:
    """The nearest point within the bounds that were given."""
    low = np.array([u.low if u.bounded else -np.inf for u in b.unknowns])
    high = np.array([u.high if u.bounded else np.inf for u in b.unknowns])
    return np.clip(s, low, high)


def _within(b: Balance, s: Array) -> bool:
    """Within the bounds, and with loops closed the right way round."""
    for unknown, value in zip(b.unknowns, s, strict=True):
        slack = _OUTSIDE * unknown.size
        if unknown.bounded and not unknown.low - slack <= value <= unknown.high + slack:
            return False
    return bool(np.all(b.alignment(s).full() > 0.0))
