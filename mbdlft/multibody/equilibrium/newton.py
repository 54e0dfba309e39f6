"""The unknowns of an equilibrium at one value of the parameters, and its equations as numbers.

    0 = rows(s, w),    s: positions and chosen parameters,    w: efforts, magnitudes, multipliers

The rows are linear in w. So for each s, w is that of least squares, and the part of the rows that no w
can balance depends on s alone (variable projection: Golub, Pereyra 1973; its Jacobian: Kaufman 1975). The
roots are those of Newton's iteration on scaled unknowns, or of a trust region method where it does not
converge.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from mbdlft.base.array import Array
from mbdlft.base.errors import TrimError, check_known
from mbdlft.base.unit import Signal
from mbdlft.multibody.equilibrium.conditions import Displaced, in_physical

Bounds = Mapping[str, tuple[float, float]]

_SAMPLES = 8  # random positions at which the size of each row is measured
_SMALL = 1e-3  # least size of a row, of the largest row of the same unit
_RANK = 1e-9  # singular values below this part of the largest are zero
# rad, the largest random rotation; at pi its vector is infinite
_MOST_TURN = np.pi * (1.0 - 1.0 / 16.0)
_STEPS = 30
_LONGEST = 0.5  # longest step of an unknown over its size, so that the nearest root is found
_SHORTEST = 2.0**-8  # smallest part of a step that is tried
_SOLVED = 1e-10  # largest value of a solved equation, over its size
_TRIALS = 200  # most evaluations of the trust region method
_OUTSIDE = 1e-9  # how far rounding may leave an unknown outside its bounds, over its size


@dataclass(frozen=True, slots=True)
class Unknown:
    """One unknown, an entry of s: the displacement of a coordinate of a joint, or a parameter."""

    signal: Signal
    index: int  # of the coordinate, or of the parameter
    low: float  # range of the search
    high: float
    bounded: bool  # the user gave this range
    size: float  # a typical change
    start: float  # value at the first start
    origin: float = 0.0  # position for the value 0
    is_parameter: bool = False
    is_ball: bool = False  # a component of a rotation vector
    longest: float = 1.0  # step over its size, of the longest that all take: gears and screws turn on
    is_periodic: bool = False  # an angle of which a whole turn changes nothing


@dataclass(frozen=True, slots=True, eq=False)
class EquilibriumEquations:
    """The equations of equilibrium at one value of the parameters."""

    displaced: Displaced
    unknowns: tuple[Unknown, ...]
    parameters: Mapping[str, float]  # physical values by name
    offset: ca.Function  # s -> rows at w = 0 (m,), derivatives by w (m, n_w)
    slopes: ca.Function  # (s, w) -> rows (m,), derivatives by s (m, n_s)
    alignment: ca.Function  # s -> cosines that must be 1
    sizes: Array  # (m,) typical size of each row

    @property
    def steps(self) -> Array:
        """Typical change (n_s,) of each unknown."""
        return np.array([unknown.size for unknown in self.unknowns])

    @property
    def balls(self) -> list[list[int]]:
        """Entries of s of each rotation vector."""
        entries = [k for k, unknown in enumerate(self.unknowns) if unknown.is_ball]
        return [entries[k : k + 3] for k in range(0, len(entries), 3)]

    @property
    def ends(self) -> Array:
        """Lowest and highest values (2, n_s) that the user allows, infinite without bounds."""
        ends = [(u.low, u.high) if u.bounded else (-np.inf, np.inf) for u in self.unknowns]
        return np.array(ends).reshape(-1, 2).T


@dataclass(frozen=True, slots=True, eq=False)
class Projected:
    """The equations at some s after the elimination of w."""

    w: Array  # (n_w,) the efforts of least squares
    rows: Array  # (m,) the part of the rows that no w can balance, over their sizes
    slopes: Array  # (m, n_s) the derivatives of `rows` by s over the sizes of s


def equilibrium_equations(
    displaced: Displaced,
    values: Mapping[str, float],
    positions: Sequence[str] | None,
    bounds: Bounds,
    rng: np.random.Generator,
) -> EquilibriumEquations:
    """The equations at physical values by name; `positions` and `bounds` as of `find_equilibrium`."""
    d = displaced
    at = _parameter_values(d, values)
    w, u = ca.SX.sym("w", len(d.unknown)), ca.SX(d.given)
    if d.unknown:
        u[list(d.unknown)] = w
    rows = ca.substitute(d.rows, d.u, u)
    every = [d.declared, d.arms, d.relations, rows, d.alignment]
    symbols, (*fixed, rows, alignment) = in_physical(d, every)
    point = np.array(list(at.values()))
    declared, arms, tied = (value.full() for value in ca.Function("fixed", [symbols], fixed)(point))
    reach = float(np.max(np.linalg.norm(arms.reshape(3, -1), axis=0), initial=0.0)) or 1.0
    unknowns = _choose(d, at, positions, bounds, declared.reshape(-1), _turns(d, tied, reach), reach)

    s = ca.SX.sym("s", len(unknowns))
    q, free = ca.SX(ca.DM.zeros(d.q.numel())), ca.SX(ca.DM(point))
    for k, unknown in enumerate(unknowns):
        if unknown.is_parameter:
            free[unknown.index] = s[k]
        else:
            q[unknown.index] = s[k]
    rows, alignment = ca.substitute([rows, alignment], [d.q, symbols], [q, free])
    by_w = ca.densify(ca.jacobian(rows, w))
    none = ca.SX(ca.DM.zeros(w.numel()))
    unscaled = EquilibriumEquations(
        d,
        unknowns,
        at,
        ca.Function("offset", [s], [ca.densify(ca.substitute(rows, w, none)), by_w]),
        ca.Function("slopes", [s, w], [ca.densify(rows), ca.densify(ca.jacobian(rows, s))]),
        ca.Function("alignment", [s], [ca.densify(alignment)]),
        np.ones(rows.numel()),
    )
    return replace(unscaled, sizes=_row_sizes(unscaled, reach, rng))


def project_at(equations: EquilibriumEquations, s: Array) -> Projected:
    """The equations at s (n_s,) after the elimination of w; nan where they are not finite."""
    offset, by_w = (value.full() for value in equations.offset(s))
    offset, by_w = offset[:, 0] / equations.sizes, by_w / equations.sizes[:, None]
    if not (np.isfinite(offset).all() and np.isfinite(by_w).all()):
        return Projected(np.full(by_w.shape[1], np.nan), np.full(len(offset), np.nan), by_w[:, :0])
    column = np.max(np.abs(by_w), axis=0, initial=0.0)
    column = np.where(column > 0, column, 1.0)
    basis, values, right = np.linalg.svd(by_w / column, full_matrices=False)
    kept = values > _RANK * np.max(values, initial=0.0)
    basis, values, right = basis[:, kept], values[kept], right[kept]
    w = -(right.T @ ((basis.T @ offset) / values)) / column
    rows, by_s = (value.full() for value in equations.slopes(s, w))
    rows, by_s = rows[:, 0] / equations.sizes, by_s / equations.sizes[:, None]
    by_s = by_s * equations.steps
    return Projected(w, rows - basis @ (basis.T @ rows), by_s - basis @ (basis.T @ by_s))


def whole_slopes(equations: EquilibriumEquations, s: Array, w: Array) -> Array:
    """Derivatives (m, n_s + n_w) of the rows by s and w, with rows and columns over their sizes."""
    by_w = equations.offset(s)[1].full() / equations.sizes[:, None]
    by_s = equations.slopes(s, w)[1].full() / equations.sizes[:, None]
    column = np.max(np.abs(by_w), axis=0, initial=0.0)
    return np.hstack([by_s * equations.steps, by_w / np.where(column > 0, column, 1.0)])


def random_start(equations: EquilibriumEquations, rng: np.random.Generator) -> Array:
    """Unknowns (n_s,) drawn inside their bounds; rotation vectors have random axes."""
    s = np.array([rng.uniform(unknown.low, unknown.high) for unknown in equations.unknowns])
    for ball in equations.balls:
        axis = rng.standard_normal(3)
        angle = rng.uniform(0.0, _MOST_TURN)
        s[ball] = 2.0 * np.tan(angle / 2.0) * axis / np.linalg.norm(axis)
    return s


def _parameter_values(d: Displaced, values: Mapping[str, float]) -> dict[str, float]:
    """Physical value of every parameter by name: the given value, else the nominal one."""
    known = {parameter.name: parameter for parameter in d.parameters}
    for name, value in values.items():
        check_known("parameter", [name], known, f"scene {d.name!r}", TrimError)
        low, high, unit = known[name].low, known[name].high, known[name].unit
        if not low <= value <= high:
            raise TrimError(
                f"scene {d.name!r}: {name} = {value:g} is outside its range [{low:g}, {high:g}] {unit}."
            )
    return {name: float(values.get(name, known[name].nominal)) for name in known}


def _choose(
    d: Displaced,
    at: Mapping[str, float],
    positions: Sequence[str] | None,
    bounds: Bounds,
    declared: Array,
    turns: Array,
    reach: float,
) -> tuple[Unknown, ...]:
    """The entries of s, those of coordinates first; `reach` is the length of the longest arm (m)."""
    coordinates = d.coordinates
    sprung = {c.joint.name for c in coordinates if c.is_ball and c.is_sprung}
    chosen = [
        k
        for k, c in enumerate(coordinates)
        if c.is_passive and not (c.is_ball and c.joint.name in sprung)
    ]
    parameters: list[int] = []
    if positions is not None:
        by_name = {parameter.name: k for k, parameter in enumerate(d.parameters)}
        joints = {c.joint.name for c in coordinates}
        signals = {c.signal.name: k for k, c in enumerate(coordinates)}
        picked: set[int] = set()
        for name in positions:
            known = {*joints, *signals, *by_name}
            where = f"scene {d.name!r}, positions"
            check_known("joint, coordinate or parameter", [name], known, where, TrimError)
            if name in joints:
                picked |= {k for k, c in enumerate(coordinates) if c.joint.name == name}
            elif name in signals:
                picked.add(signals[name])
            else:
                parameters.append(by_name[name])
        chosen = sorted(picked)
    unknowns = [_coordinate(d, k, bounds, float(declared[k]), reach, turns[k]) for k in chosen]
    for k in parameters:
        parameter = d.parameters[k]
        low, high = bounds.get(parameter.name, (parameter.low, parameter.high))
        low, high = max(low, parameter.low), min(high, parameter.high)
        signal, size = Signal(parameter.name, parameter.unit), 0.5 * (parameter.high - parameter.low)
        unknowns.append(
            Unknown(signal, k, low, high, True, size, at[parameter.name], is_parameter=True)  # noqa: FBT003
        )
    known = {u.signal.name for u in unknowns}
    known |= {c.joint.name for c in coordinates if len(c.joint.freedoms) == 1}
    for name, (low, high) in bounds.items():
        check_known("unknown", [name], known, f"scene {d.name!r}, bounds", TrimError)
        if not low < high:
            raise TrimError(
                f"scene {d.name!r}, bounds of {name}: expected low < high, got {low:g}, {high:g}."
            )
    return tuple(unknowns)


def _turns(d: Displaced, relations: Array, reach: float) -> Array:
    """How far (n,) angles go where couplings tie them to others, at least 1 rad; 0: nothing does."""
    sizes = np.array([1.0 if c.freedom.turns else reach for c in d.coordinates])
    turns = np.zeros(len(sizes))
    for row in np.abs(relations) * sizes:
        own = np.flatnonzero(row)
        turns[own] = np.maximum(turns[own], np.maximum(1.0, np.max(row, initial=0.0) / row[own]))
    return turns


def _coordinate(
    d: Displaced, k: int, bounds: Bounds, declared: float, reach: float, turn: float
) -> Unknown:
    """Coordinate k as an unknown."""
    c = d.coordinates[k]
    name, where = c.signal.name, f"scene {d.name!r}, positions: joint {c.joint.name!r}"
    if c.is_imposed:
        raise TrimError(f"{where} is imposed, so its position is given. Leave it out.")
    if getattr(c.joint, "rate", None) is not None:
        raise TrimError(f"{where} turns at a steady rate, so it has no position. Leave it out.")
    if c.is_ball and c.is_sprung:
        raise TrimError(
            f"{where} has a stiffness against rotations about all axes, which is known for small ones "
            "only. Leave the joint out, or use springs or a chain of revolute joints."
        )
    ends = bounds.get(name, bounds.get(c.joint.name) if len(c.joint.freedoms) == 1 else None)
    if ends is not None and c.is_ball:
        raise TrimError(f"scene {d.name!r}, bounds: a rotation vector such as {name} has none.")
    half = 2.0 if c.is_ball else np.pi if c.freedom.turns else 2.0 * reach
    low, high = (-half, half) if ends is None else (ends[0] - declared, ends[1] - declared)
    size, start = 1.0 if c.freedom.turns else reach, min(max(0.0, low), high)
    periodic = c.freedom.turns and not c.is_ball and not c.is_sprung and not turn
    return Unknown(
        c.signal, k, low, high, ends is not None, size, start, declared,
        is_ball=c.is_ball, longest=max(1.0, turn), is_periodic=periodic,
    )  # fmt: skip


def _row_sizes(equations: EquilibriumEquations, reach: float, rng: np.random.Generator) -> Array:
    """Size (m,) of each row: the largest terms of an effort at some positions, `reach` for a gap."""
    count = len(equations.sizes)
    sizes = np.zeros(count)
    start = np.array([unknown.start for unknown in equations.unknowns])
    for k in range(_SAMPLES + 1):
        s = start if k == 0 else random_start(equations, rng)
        projected = project_at(equations, s)
        offset = equations.offset(s)[0].full()[:, 0]
        if np.isfinite(projected.rows).all() and np.isfinite(offset).all():
            slopes = np.abs(equations.slopes(s, projected.w)[1].full())
            slopes = slopes * equations.steps
            sizes = np.maximum(sizes, np.abs(offset))
            sizes = np.maximum(sizes, np.max(slopes, axis=1, initial=0.0))
    units = [signal.unit for signal in equations.displaced.row_signals]
    efforts = np.array([unit in ("N", "N m") for unit in units], dtype=bool)
    arm = np.array([reach if unit == "N m" else 1.0 for unit in units])
    least = _SMALL * np.max((sizes / arm)[efforts], initial=0.0)
    sizes = np.where(efforts, np.maximum(sizes, (least or 1.0) * arm), sizes)
    return np.where(efforts, sizes, [reach if unit == "m" else 1.0 for unit in units])


@dataclass(frozen=True, slots=True, eq=False)
class Attempt:
    """The point to which one start led."""

    s: Array  # (n_s,) the unknowns
    rows: Array  # (m,) values of the equations over their sizes; zero in equilibrium
    iterations: int  # number of evaluations of the equations
    solved: bool  # all equations are met, inside the bounds

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
    """Newton's iteration from `start` (n_s,), with steps halved until the rows get smaller.

    At a double root, such as of a flat loop, each step halves the way: what is met goes on to roundoff.
    """
    sizes, limits = equations.steps, np.array([unknown.longest for unknown in equations.unknowns])
    s, at, count = start, project_at(equations, start), 1
    while (
        count < (2 * _STEPS if _met(at) else _STEPS) and np.isfinite(at.rows).all() and equations.unknowns
    ):
        step = np.linalg.lstsq(at.slopes, -at.rows, rcond=_RANK)[0]
        longest = float(np.max(np.abs(step) / limits))
        if longest == 0.0:
            break
        fraction = min(1.0, _LONGEST / longest)
        before = np.linalg.norm(at.rows)
        while fraction >= _SHORTEST:
            trial = np.clip(s + fraction * step * sizes, *equations.ends)
            there = project_at(equations, trial)
            count += 1
            if np.isfinite(there.rows).all() and np.linalg.norm(there.rows) < before:
                break
            fraction *= 0.5
        else:
            break
        s, at = trial, there
    return Attempt(s, at.rows, count, _met(at) and _within(equations, s))


def _met(at: Projected) -> bool:
    return bool(np.all(np.abs(at.rows) <= _SOLVED))


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
