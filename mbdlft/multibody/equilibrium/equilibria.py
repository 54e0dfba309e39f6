"""Equilibria at one value of the parameters, with positions of joints as unknowns."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, overload

import numpy as np

from mbdlft.base.arguments import arguments_checked
from mbdlft.base.array import Array
from mbdlft.base.errors import TrimError
from mbdlft.multibody.equilibrium import newton
from mbdlft.multibody.equilibrium.conditions import displace
from mbdlft.multibody.scene.scene import Scene

# two equilibria that are nearer, relative to the size of each unknown, are one: a triple root, as at a
# flat loop, is known to the cube root of rounding, 6e-6
_SAME = 1e-5
_IDLE = 0.1  # an unknown with a larger part in a motion that unbalances nothing is not determined
_RANK = 1e-9  # a singular value below this part of the largest is zero
# a smaller slope of the sum of squares, relative to the equations, is that of a minimum
_FLAT = 1e-3
_NAMED = 4  # unbalanced equations that a message names


@dataclass(frozen=True, slots=True)
class EquilibriumPoint:
    """An equilibrium at one value of the parameters.

    Attributes
    ----------
    scene : name of the scene
    parameters : physical value by name, in its unit
        A parameter that was unknown has the value that the search found.
    positions : value by coordinate (rad, m), such as ``hinge.angle``
        The positions that were unknown. The rotation of a spherical or free joint, ``NAME.rotation.x`` to
        z, is a rotation vector from the declared orientation (rad).
    found : names of the parameters that were unknown
    efforts : value by name
        The efforts of joints and magnitudes of loads that were unknown.
    units : unit of each position and effort by name
    unbalanced : value of each equation, by effort or gap of a loop (N, N m, m, rad); 0 in equilibrium
    residual : float
        The largest value of an equation, relative to the largest terms of this equation.
    iterations : number of evaluations of the equations
    undetermined : names of unknowns that can change, alone or together, without unbalancing anything
    """

    scene: str
    parameters: Mapping[str, float]
    positions: Mapping[str, float]
    found: tuple[str, ...]
    efforts: Mapping[str, float]
    units: Mapping[str, str]
    unbalanced: Mapping[str, float]
    residual: float
    iterations: int
    undetermined: tuple[str, ...]


@overload
def find_equilibrium(
    scene: Scene,
    values: Mapping[str, float] | None = ...,
    positions: Sequence[str] | None = ...,
    bounds: newton.Bounds | None = ...,
    starts: int = ...,
    seed: int = ...,
    every: Literal[False] = ...,
) -> EquilibriumPoint: ...
@overload
def find_equilibrium(
    scene: Scene,
    values: Mapping[str, float] | None = ...,
    positions: Sequence[str] | None = ...,
    bounds: newton.Bounds | None = ...,
    starts: int = ...,
    seed: int = ...,
    *,
    every: Literal[True],
) -> tuple[EquilibriumPoint, ...]: ...
@arguments_checked
def find_equilibrium(
    scene: Scene,
    values: Mapping[str, float] | None = None,
    positions: Sequence[str] | None = None,
    bounds: newton.Bounds | None = None,
    starts: int = 30,
    seed: int = 0,
    every: bool = False,  # noqa: FBT001, FBT002
) -> EquilibriumPoint | tuple[EquilibriumPoint, ...]:
    """Find positions of joints that are in equilibrium, 0 = residual(q, u) at rest, with their efforts.

    The search starts at the declared positions. There the `stiffness` of a joint is relaxed, and a spring
    has its given force density.

    Parameters
    ----------
    scene : Scene
    values : mapping of names to physical values, in the units of the parameters, optional
        Parameters that are not in it are nominal.
    positions : sequence of str, optional
        Names of the unknowns: joints, coordinates such as ``slide.position.x``, or parameters. By default
        the unknowns are the positions of all joints whose effort is given by a `preload`. The rotation
        of a spherical or free joint with a stiffness cannot be unknown: its law holds for small rotations
        only.
    bounds : mapping of names to (low, high), optional
        Bounds of positions, by coordinate (rad, m; also by joint if it has one coordinate), or of
        parameters, in their units.
    starts : int
        Number of starts. The first start is at the declared positions. The others are drawn inside the
        bounds; without bounds, up to half a turn, or twice the longest arm of the scene, to either side.
        The search ends with the first equilibrium, unless `every` is true.
    seed : int
        Seed of the random starts.
    every : bool
        Return all equilibria to which any of the starts led, distinct modulo 2 pi.

    Raises
    ------
    TrimError
        A name is unknown, or no equilibrium was found; the message says which equations are not met at
        the nearest position.
    SceneError, NotRationalError, WellPosednessError
        As `assemble` raises them.
    """
    if starts < 1:
        raise TrimError(f"scene {scene.name!r}: starts: expected at least 1, got {starts}.")
    rng = np.random.default_rng(seed)
    equations = newton.equilibrium_equations(displace(scene), values or {}, positions, bounds or {}, rng)
    attempts: list[newton.Attempt] = []
    solved: list[newton.Attempt] = []
    for k in range(starts):
        first = np.array([u.start for u in equations.unknowns])
        attempt = newton.solve_from(equations, newton.random_start(equations, rng) if k else first)
        attempts.append(attempt)
        if attempt.solved and not any(_same(equations, attempt.s, other.s) for other in solved):
            solved.append(attempt)
        if not equations.unknowns or (solved and not every):
            break
    if not solved:
        raise TrimError(_no_equilibrium(equations, attempts))
    total = sum(attempt.iterations for attempt in attempts)
    points = tuple(
        _point(equations, attempt, attempt.iterations if every else total) for attempt in solved
    )
    return points if every else points[0]


def _same(equations: newton.EquilibriumEquations, s: Array, other: Array) -> bool:
    """Whether two equilibria s, other (n_s,) are one, with angles modulo 2 pi."""
    for unknown, difference in zip(equations.unknowns, s - other, strict=True):
        apart = np.remainder(difference + np.pi, 2 * np.pi) - np.pi if unknown.is_periodic else difference
        if abs(apart) > _SAME * unknown.size:
            return False
    return True


def _point(
    equations: newton.EquilibriumEquations, attempt: newton.Attempt, iterations: int
) -> EquilibriumPoint:
    d = equations.displaced
    w = newton.project_at(equations, attempt.s).w
    efforts = {
        d.u_signals[k]: float(value)
        for k, value in zip(d.unknown, w, strict=True)
        if k not in d.multipliers
    }
    changed = _parameters(equations, attempt.s)
    rows = equations.slopes(attempt.s, w)[0].full()[:, 0]
    units = {u.signal.name: u.signal.unit for u in equations.unknowns if not u.is_parameter}
    return EquilibriumPoint(
        scene=d.name,
        parameters={**equations.parameters, **changed},
        positions=_positions(equations, attempt.s),
        found=tuple(changed),
        efforts={signal.name: value for signal, value in efforts.items()},
        units=units | {signal.name: signal.unit for signal in efforts},
        unbalanced={signal.name: float(row) for signal, row in zip(d.row_signals, rows, strict=True)},
        residual=float(np.max(np.abs(rows) / equations.sizes, initial=0.0)),
        iterations=iterations,
        undetermined=_undetermined(equations, attempt.s, w),
    )


def _parameters(equations: newton.EquilibriumEquations, s: Array) -> dict[str, float]:
    """Values by name of the parameters among the unknowns s (n_s,)."""
    both = zip(equations.unknowns, s, strict=True)
    return {unknown.signal.name: float(value) for unknown, value in both if unknown.is_parameter}


def _positions(equations: newton.EquilibriumEquations, s: Array) -> dict[str, float]:
    """Positions by coordinate (rad, m) for the unknowns s (n_s,).

    An angle without spring and bounds is given between minus and plus half a turn.
    """
    values: dict[str, float] = {}
    turned = s.astype(float).copy()
    for ball in equations.balls:
        length = float(np.linalg.norm(s[ball]))
        if length > 0.0:
            turned[ball] = s[ball] * (2.0 * np.arctan(length / 2.0) / length)
    for unknown, value in zip(equations.unknowns, turned, strict=True):
        if unknown.is_parameter:
            continue
        position = float(unknown.origin + value)
        if unknown.is_periodic and not unknown.bounded:
            position = float(np.remainder(position + np.pi, 2.0 * np.pi) - np.pi)
        values[unknown.signal.name] = position
    return values


def _undetermined(equations: newton.EquilibriumEquations, s: Array, w: Array) -> tuple[str, ...]:
    """Names of unknowns that change in some direction in which no equation changes, to first order.

    Multipliers of loops are left out: those of redundant closures never are determined.
    """
    slopes = newton.whole_slopes(equations, s, w)
    if not slopes.shape[1]:
        return ()
    _, values, right = np.linalg.svd(slopes)
    rank = int(np.sum(values > _RANK * np.max(values, initial=0.0)))
    share = np.linalg.norm(right[rank:], axis=0)
    d = equations.displaced
    names = [unknown.signal.name for unknown in equations.unknowns]
    names += ["" if k in d.multipliers else d.u_signals[k].name for k in d.unknown]
    return tuple(name for name, size in zip(names, share, strict=True) if name and size > _IDLE)


def _no_equilibrium(equations: newton.EquilibriumEquations, attempts: Sequence[newton.Attempt]) -> str:
    """The message for a search without success: the nearest point, what is unbalanced there, and why."""
    d = equations.displaced
    sound = [attempt for attempt in attempts if np.isfinite(attempt.rows).all()]
    where = ", ".join(f"{name} = {value:g}" for name, value in equations.parameters.items())
    what = f"scene {d.name!r}: no equilibrium found{' at ' + where if where else ''}"
    tries = f"{len(attempts)} start{'s' if len(attempts) > 1 else ''}"
    if not sound:
        return (
            f"{what}: the equations are not finite at any of {tries}. A spring whose ports are at one "
            "point has no direction; move the declared positions."
        )
    names = ", ".join(unknown.signal.name for unknown in equations.unknowns) or "nothing"
    best = min(sound, key=lambda attempt: float(np.linalg.norm(attempt.rows)))
    if best.residual <= _SAME:
        return (
            f"{what} from {tries}: the equations are met at {_where(equations, best)}, but that is "
            "outside the bounds, or a loop is closed the wrong way round there. Widen the bounds or "
            "use more starts."
        )
    order = np.argsort(-np.abs(best.rows))
    largest = [int(k) for k in order[:_NAMED] if abs(best.rows[k]) > 1e-3 * best.residual]
    misses = ", ".join(
        f"{d.row_signals[k].name} misses {best.rows[k] * equations.sizes[k]:.4g} {d.row_signals[k].unit}"
        for k in largest
    )
    return (
        f"{what} from {tries} with the unknown positions {names}. Nearest, "
        f"{_where(equations, best)}: {misses}; {_why(equations, best)} Use more starts, other bounds, "
        "more unknown positions, or leave out a preload or a load's magnitude that can balance it."
    )


def _where(equations: newton.EquilibriumEquations, attempt: newton.Attempt) -> str:
    """The positions of an attempt, in words."""
    positions = _positions(equations, attempt.s) | _parameters(equations, attempt.s)
    units = {unknown.signal.name: unknown.signal.unit for unknown in equations.unknowns}
    listed = ", ".join(f"{name} = {value:.6g} {units[name]}" for name, value in positions.items())
    return f"at {listed}" if listed else "at the declared positions"


def _why(equations: newton.EquilibriumEquations, attempt: newton.Attempt) -> str:
    """A sentence that says why no step brings the attempt nearer to an equilibrium."""
    at = newton.project_at(equations, attempt.s)
    held = [
        unknown.signal.name
        for unknown, value in zip(equations.unknowns, attempt.s, strict=True)
        if unknown.bounded and min(value - unknown.low, unknown.high - value) <= _SAME * unknown.size
    ]
    if held:
        return f"{', '.join(held)} at the end of the bounds."
    towards = np.abs(at.slopes.T @ at.rows)
    if float(np.max(towards, initial=0.0)) <= _FLAT * float(np.linalg.norm(at.rows)):
        return "there no small change of the unknowns makes that smaller."
    return "the iteration did not converge."
