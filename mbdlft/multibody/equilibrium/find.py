"""Equilibria at one value of the parameters, with positions of joints as unknowns."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, overload

import numpy as np

from mbdlft.base.array import Array
from mbdlft.base.errors import TrimError
from mbdlft.multibody.equilibrium.displaced import displace
from mbdlft.multibody.equilibrium.newton import Attempt, solve_from
from mbdlft.multibody.equilibrium.unknowns import (
    Balance,
    Bounds,
    balance,
    random_start,
    reduce_at,
    whole_slopes,
)
from mbdlft.multibody.scene.scene import Scene

_SAME = 1e-6  # of the size of an unknown: equilibria that are nearer are one
_IDLE = 0.1  # share in a combination of unknowns that changes nothing
_RANK = 1e-9
_FLAT = 1e-3  # of the rows: a smaller slope of their squares is that of a minimum
_NAMED = 4  # unbalanced rows that a message names


@dataclass(frozen=True, slots=True)
class EquilibriumPoint:
    """An equilibrium at one value of the parameters.

    Attributes
    ----------
    scene : name of the scene
    parameters : physical value by name, in its unit
        The parameters that were unknown have the value that was found.
    positions : value by coordinate (rad, m), such as ``hinge.angle``
        Of the joints whose position was unknown. The rotation of a ball, ``NAME.rotation.x`` to z, is a
        rotation vector from the declared orientation (rad).
    found : names of the parameters that were unknown
    efforts : value by name
        Efforts of joints and magnitudes of loads that were unknown.
    units : unit of each position and effort by name
    unbalanced : what is left of the equations, by effort or gap of a loop (N, N m, m, rad)
    residual : float
        The largest of these, each relative to the largest terms of its equation.
    iterations : evaluations of the equations
    undetermined : names of unknowns that can be changed, alone or together, and nothing gets unbalanced
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
    bounds: Bounds | None = ...,
    starts: int = ...,
    seed: int = ...,
    every: Literal[False] = ...,
) -> EquilibriumPoint: ...
@overload
def find_equilibrium(
    scene: Scene,
    values: Mapping[str, float] | None = ...,
    positions: Sequence[str] | None = ...,
    bounds: Bounds | None = ...,
    starts: int = ...,
    seed: int = ...,
    *,
    every: Literal[True],
) -> tuple[EquilibriumPoint, ...]: ...
def find_equilibrium(
    scene: Scene,
    values: Mapping[str, float] | None = None,
    positions: Sequence[str] | None = None,
    bounds: Bounds | None = None,
    starts: int = 30,
    seed: int = 0,
    every: bool = False,  # noqa: FBT001, FBT002
) -> EquilibriumPoint | tuple[EquilibriumPoint, ...]:
    """Positions that are in equilibrium, 0 = residual(q, u) at rest, with the unknown efforts.

    The declared positions of these joints are where their springs are relaxed (`stiffness`), springs
    have their given force density, and the search starts.

    Parameters
    ----------
    scene : Scene
    values : mapping of names to physical values, in the units of the parameters, optional
        The others are nominal.
    positions : sequence of str, optional
        Names of joints, of coordinates such as ``slide.position.x``, or of parameters that are
        unknown. By default all joints whose effort is given by a `preload`, but not the rotations of
        balls that have a stiffness, whose law is one of small rotations.
    bounds : mapping of names to (low, high), optional
        Of positions, by coordinate (rad, m; also by joint if it has one only), or of parameters, in their
        units.
    starts : int
        The first start is at the declared positions, the others are drawn inside the bounds, or half a
        turn or twice the longest arm of the scene to either side. The search ends with the first
        equilibrium, unless `every` is true.
    seed : int
        Of the random starts.
    every : bool
        Return all equilibria that any of the starts found, distinct modulo 2 pi.

    Returns
    -------
    EquilibriumPoint, or a tuple of them if `every` is true

    Raises
    ------
    TrimError
        A name is unknown, or no equilibrium was found; the message says what is unbalanced at the
        nearest position.
    SceneError, NotRationalError, WellPosednessError
        As `assemble`.
    """
    if starts < 1:
        raise TrimError(f"scene {scene.name!r}: starts: expected at least 1, got {starts}.")
    rng = np.random.default_rng(seed)
    b = balance(displace(scene), values or {}, positions, bounds or {}, rng)
    attempts: list[Attempt] = []
    solved: list[Attempt] = []
    for k in range(starts):
        start = np.array([u.start for u in b.unknowns]) if k == 0 else random_start(b, rng)
        attempts.append(found := solve_from(b, start))
        if found.solved and not any(_same(b, found.s, other.s) for other in solved):
            solved.append(found)
        if not b.unknowns or (solved and not every):
            break
    if not solved:
        raise TrimError(_no_equilibrium(b, attempts))
    total = sum(attempt.iterations for attempt in attempts)
    points = tuple(_point(b, attempt, attempt.iterations if every else total) for attempt in solved)
    return points if every else points[0]


def _same(b: Balance, s: Array, other: Array) -> bool:
    """Whether two equilibria are one, angles modulo 2 pi."""
    for unknown, difference in zip(b.unknowns, s - other, strict=True):
        apart = (
            np.remainder(difference + np.pi, 2 * np.pi) - np.pi
            if unknown.is_periodic
            else difference
        )
        if abs(apart) > _SAME * unknown.size:
            return False
    return True


def _point(b: Balance, attempt: Attempt, iterations: int) -> EquilibriumPoint:
    d = b.displaced
    w = reduce_at(b, attempt.s).w
    efforts = {
        d.u_signals[k]: float(value)
        for k, value in zip(d.unknown, w, strict=True)
        if k not in d.multipliers
    }
    positions = _positions(b, attempt.s)
    changed = {
        unknown.signal.name: float(value)
        for unknown, value in zip(b.unknowns, attempt.s, strict=True)
        if unknown.is_parameter
    }
    rows = b.slopes(attempt.s, w)[0].full()[:, 0]
    units = {u.signal.name: u.signal.unit for u in b.unknowns if not u.is_parameter}
    return EquilibriumPoint(
        scene=d.name,
        parameters={**b.parameters, **changed},
        positions=positions,
        found=tuple(changed),
        efforts={signal.name: value for signal, value in efforts.items()},
        units=units | {signal.name: signal.unit for signal in efforts},
        unbalanced={
            signal.name: float(row) for signal, row in zip(d.row_signals, rows, strict=True)
        },
        residual=float(np.max(np.abs(rows) / b.sizes, initial=0.0)),
        iterations=iterations,
        undetermined=_undetermined(b, attempt.s, w),
    )


def _positions(b: Balance, s: Array) -> dict[str, float]:
    """Positions by coordinate (rad, m); an angle that has no spring within half a turn."""
    found: dict[str, float] = {}
    balls = [k for k, unknown in enumerate(b.unknowns) if unknown.is_ball]
    turned = s.astype(float).copy()
    for k in range(0, len(balls), 3):
        vector = s[balls[k : k + 3]]
        length = float(np.linalg.norm(vector))
        if length > 0.0:
            turned[balls[k : k + 3]] = vector * (2.0 * np.arctan(length / 2.0) / length)
    for unknown, value in zip(b.unknowns, turned, strict=True):
        if unknown.is_parameter:
            continue
        position = float(unknown.origin + value)
        if unknown.is_periodic and not unknown.bounded:
            position = float(np.remainder(position + np.pi, 2.0 * np.pi) - np.pi)
        found[unknown.signal.name] = position
    return found


def _undetermined(b: Balance, s: Array, w: Array) -> tuple[str, ...]:
    """Unknowns in combinations that change nothing; loads of loops may well be redundant."""
    slopes = whole_slopes(b, s, w)
    if not slopes.shape[1]:
        return ()
    _, values, right = np.linalg.svd(slopes)
    rank = int(np.sum(values > _RANK * np.max(values, initial=0.0)))
    share = np.linalg.norm(right[rank:], axis=0)
    d = b.displaced
    names = [unknown.signal.name for unknown in b.unknowns]
    names += ["" if k in d.multipliers else d.u_signals[k].name for k in d.unknown]
    return tuple(name for name, part in zip(names, share, strict=True) if name and part > _IDLE)


def _no_equilibrium(b: Balance, attempts: Sequence[Attempt]) -> str:
    """The nearest that any start came to an equilibrium: where, what is unbalanced, and why."""
    d = b.displaced
    sound = [attempt for attempt in attempts if np.isfinite(attempt.rows).all()]
    where = ", ".join(f"{name} = {value:g}" for name, value in b.parameters.items())
    what = f"scene {d.name!r}: no equilibrium found{' at ' + where if where else ''}"
    tries = f"{len(attempts)} start{'s' if len(attempts) > 1 else ''}"
    if not sound:
        return (
            f"{what}: the equations are not finite at any of {tries}. A spring whose ports are at one "
            "point has no direction; move the declared positions."
        )
    names = ", ".join(unknown.signal.name for unknown in b.unknowns) or "nothing"
    best = min(sound, key=lambda attempt: float(np.linalg.norm(attempt.rows)))
    if best.residual <= _SAME:
        return (
            f"{what} from {tries}: the equations are met at {_where(b, best)}, but that is outside the "
            "bounds, or a loop is closed the wrong way round there. Widen the bounds or use more "
            "starts."
        )
    order = np.argsort(-np.abs(best.rows))
    largest = [int(k) for k in order[:_NAMED] if abs(best.rows[k]) > 1e-3 * best.residual]
    misses = ", ".join(
        f"{d.row_signals[k].name} misses {best.rows[k] * b.sizes[k]:.4g} {d.row_signals[k].unit}"
        for k in largest
    )
    return (
        f"{what} from {tries} with the unknown positions {names}. Nearest, {_where(b, best)}: {misses}; "
        f"{_why(b, best)} Use more starts, other bounds, more unknown positions, or leave out a preload "
        "or a load's magnitude that can balance it."
    )


def _where(b: Balance, attempt: Attempt) -> str:
    positions = {**_positions(b, attempt.s)}
    positions |= {
        u.signal.name: float(value)
        for u, value in zip(b.unknowns, attempt.s, strict=True)
        if u.is_parameter
    }
    units = {unknown.signal.name: unknown.signal.unit for unknown in b.unknowns}
    listed = ", ".join(f"{name} = {value:.6g} {units[name]}" for name, value in positions.items())
    return f"at {listed}" if listed else "at the declared positions"


def _why(b: Balance, attempt: Attempt) -> str:
    """Why no step makes the rows smaller."""
    at = reduce_at(b, attempt.s)
    held = [
        unknown.signal.name
        for unknown, value in zip(b.unknowns, attempt.s, strict=True)
        if unknown.bounded
        and min(value - unknown.low, unknown.high - value) <= _SAME * unknown.size
    ]
    if held:
        return f"{', '.join(held)} at the end of the bounds."
    towards = np.abs(at.slopes.T @ at.rows)
    if float(np.max(towards, initial=0.0)) <= _FLAT * float(np.linalg.norm(at.rows)):
        return "there no small change of the unknowns makes that smaller."
    return "the iteration did not converge."
