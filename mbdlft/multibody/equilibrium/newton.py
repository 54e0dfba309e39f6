"""Newton's iteration on scaled unknowns, and a trust region method where it does not converge."""

from dataclasses import dataclass

import numpy as np

from mbdlft.base.array import Array
from mbdlft.multibody.equilibrium.unknowns import EquilibriumEquations, project_at

_STEPS = 30
_LONGEST = 0.5  # longest step of an unknown over its size, so that the nearest root is found
_SHORTEST = 2.0**-8  # smallest part of a step that is tried
_RANK = 1e-9  # a singular value below this part of the largest is zero
_SOLVED = 1e-10  # largest value of a solved equation, over its size
_TRIALS = 200  # most evaluations of the trust region method
_OUTSIDE = 1e-9  # how far rounding may leave an unknown outside its bounds, over its size


@dataclass(frozen=True, slots=True, eq=False)
class Attempt:
    """The point to which one start led.

    Attributes
    ----------
    s : Array (n_s,)
        The unknowns.
    rows : Array (m,)
        Values of the equations over their sizes; zero in equilibrium.
    iterations : number of evaluations of the equations
    solved : whether all equations are met, inside the bounds
    """

    s: Array
    rows: Array
    iterations: int
    solved: bool

    @property
    def residual(self) -> float:
        """Largest value of an equation over its size."""
        return float(np.max(np.abs(self.rows), initial=0.0))


def solve_from(equations: EquilibriumEquations, start: Array) -> Attempt:
    """Solve the equations by Newton's iteration from `start` (n_s,).

    If the iteration does not converge, a trust region method finds the least squares of the equations,
    and a second iteration continues from there down to roundoff.
    """
    attempt = _newton(equations, start)
    if attempt.solved or not equations.unknowns:
        return attempt
    if not np.isfinite(project_at(equations, start).rows).all():
        return attempt
    robust = _newton(equations, _trust_region(equations, start))
    iterations = attempt.iterations + robust.iterations
    return Attempt(robust.s, robust.rows, iterations, robust.solved)


def _newton(equations: EquilibriumEquations, start: Array) -> Attempt:
    """Newton's iteration from `start` (n_s,), with steps halved until the rows get smaller."""
    sizes = equations.steps
    s, at, count = start, project_at(equations, start), 1
    while count < _STEPS and np.isfinite(at.rows).all() and equations.unknowns:
        step = np.linalg.lstsq(at.slopes, -at.rows, rcond=_RANK)[0]
        longest = float(np.max(np.abs(step)))
        if longest == 0.0:
            break
        part = min(1.0, _LONGEST / longest)
        before = np.linalg.norm(at.rows)
        while part >= _SHORTEST:
            trial = np.clip(s + part * step * sizes, *equations.ends)
            there = project_at(equations, trial)
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
    return Attempt(s, at.rows, count, solved and _within(equations, s))


def _trust_region(equations: EquilibriumEquations, start: Array) -> Array:
    """The unknowns (n_s,) of least squares of the rows, by scipy's trust region reflective method."""
    from scipy.optimize import least_squares  # here because it is slow to import

    sizes = equations.steps
    low, high = equations.ends / sizes
    margin = np.where(np.isfinite(high - low), 1e-6 * (high - low), 0.0)
    begin = np.clip(start / sizes, low + margin, high - margin)
    far = np.full(len(equations.sizes), 1e6)  # where the equations are not finite: never a step

    def rows(scaled: Array) -> Array:
        values = project_at(equations, scaled * sizes).rows
        return values if np.isfinite(values).all() else far

    def slopes(scaled: Array) -> Array:
        return project_at(equations, scaled * sizes).slopes

    minimum = least_squares(rows, begin, slopes, bounds=(low, high), max_nfev=_TRIALS, xtol=1e-12)
    return np.asarray(minimum.x * sizes)


def _within(equations: EquilibriumEquations, s: Array) -> bool:
    """Whether s (n_s,) is within the bounds, with loops closed the right way round."""
    for unknown, value in zip(equations.unknowns, s, strict=True):
        slack = _OUTSIDE * unknown.size
        if unknown.bounded and not unknown.low - slack <= value <= unknown.high + slack:
            return False
    return bool(np.all(equations.alignment(s).full() > 0.0))
