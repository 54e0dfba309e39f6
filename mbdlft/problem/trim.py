"""Trim: the efforts and loads that hold the equilibrium, 0 = residual(0, 0, 0, u, p), linear in u.

A load at equilibrium that goes through an elastic body changes its stiffness, which the model does not
have: it is refused unless the scene says that it is known.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from scipy.linalg import qr

from mbdlft.base.arguments import arguments_checked
from mbdlft.base.array import Array
from mbdlft.base.errors import TrimError
from mbdlft.base.parameter import at_values
from mbdlft.base.samples import physical_points
from mbdlft.base.unit import Signal
from mbdlft.exact.rounding import cleaned
from mbdlft.problem.equations import (
    CURVED,
    Equations,
    ParameterSymbols,
    equation_function,
    given_value,
    load_value,
    physical_symbols,
)
from mbdlft.problem.sx.tapes import evaluate_many, term_sizes

RESIDUAL = 1e-9
_GIVEN = "(a joint's preload, a load's magnitude, a spring's force_density, a strut's force)"
_RANK = 1e-13  # an unknown whose effect is that of others up to this part is redundant
_ROUNDS = 20  # each takes the square root of what sizes differ by
PART = 1e-2  # of the inertia and stiffness that unbalanced efforts are compared with
_IDLE = 0.1  # share in a combination of unknowns that does nothing


@dataclass(frozen=True, slots=True)
class TrimPoint:
    """Efforts that hold the equilibrium at one value of the parameters."""

    parameters: Mapping[str, float]  # physical value by name, in its unit
    signals: tuple[Signal, ...]  # names and units of the efforts and loads that were unknown
    values: tuple[float, ...]  # one number for each of them
    residual: float  # largest residual of the equations relative to the largest effort


@arguments_checked
def solve_trim(equations: Equations, values: Mapping[str, float] | None = None) -> TrimPoint:
    """Trim at physical values by name, in their units; the others are nominal."""
    point = physical_points(equations.parameters, values or {}, "trim", TrimError)
    efforts, residual = trim_efforts(equations, point)
    names = [parameter.name for parameter in equations.parameters]
    return TrimPoint(
        dict(zip(names, point[0].tolist(), strict=True)),
        tuple(equations.u_signals[k] for k in equations.unknown),
        tuple(float(efforts[0, k]) for k in equations.unknown),
        float(residual[0]),
    )


class Balance(NamedTuple):
    """Efforts at N points, and how well they hold the equilibrium."""

    efforts: Array  # (N, n_u)
    relative: Array  # (N,), largest residual relative to the largest effort
    unbalanced: NDArray[np.bool_]  # (N,), no efforts hold the equilibrium there
    residual: Array  # (N, rows)
    # (N,), by how much the worst row misses the equilibrium, beyond what fits explain
    excess: Array


def trim_efforts(equations: Equations, points: Array) -> tuple[Array, Array]:
    """Efforts (N, n_u) and relative residuals (N,) at physical points (N, n_p)."""
    try:
        balanced = balance(equations, points)
    except np.linalg.LinAlgError:
        raise TrimError(
            f"scene {equations.name!r}: the equilibrium does not determine the trim unknowns "
            f"{_names(equations)} at a point of the parameter range: they are redundant there. Narrow "
            "the ranges."
        ) from None
    if np.any(balanced.unbalanced):
        raise TrimError(
            _unbalanced(equations, points, balanced.residual, int(np.argmax(balanced.excess)))
        )
    check_prestress(equations, points, balanced.efforts)
    return balanced.efforts, balanced.relative


def balance(equations: Equations, points: Array) -> Balance:
    """Efforts at physical points (N, n_p), and where they do not hold the equilibrium.

    A TrimError says that unknown efforts are redundant at nominal, a LinAlgError that they are at one of
    the points.
    """
    e = equations
    rows, unknown = list(trim_rows(e)), list(e.unknown)
    offset, matrix, known_efforts = _relations_at(e, points)
    efforts = known_efforts.copy()
    if unknown:
        efforts[:, unknown] = -np.linalg.solve(matrix[:, rows], offset[:, rows, None])[:, :, 0]
    residual = offset + (matrix @ efforts[:, unknown, None])[:, :, 0]
    scale = np.max(np.abs(offset), axis=1, initial=0.0)
    relative = excess = _relative(residual, scale)
    unbalanced = ~(relative <= RESIDUAL)
    if np.any(unbalanced):
        # where nothing is unknown the terms have cancelled already, and what is left is no scale
        some = np.flatnonzero(unbalanced)
        scale = _uncancelled(e, points[some], efforts[some])
        relative[some] = _relative(residual[some], scale)
        unbalanced = ~(relative <= RESIDUAL)
        excess = relative.copy()
        if np.any(unbalanced) and e.fit_error_bound > 0.0:
            explained = _explained(e, points[some], efforts[some], matrix[some])
            beyond = np.maximum(np.abs(residual[some]) - explained, 0.0)
            excess = np.zeros(len(points))
            excess[some] = np.max(beyond, axis=1, initial=0.0)
            unbalanced[some] &= ~(_relative(beyond, scale) <= RESIDUAL)
    return Balance(efforts, relative, unbalanced, residual, excess)


@lru_cache(maxsize=1)  # the stages of one scene ask for the same
def trim_rows(equations: Equations) -> tuple[int, ...]:
    """Positions of the equations of equilibrium that determine the unknown efforts, one for each."""
    e = equations
    nominal = np.array([[parameter.nominal for parameter in e.parameters]])
    _, matrix, _ = _relations_at(e, nominal)
    matrix, count = _without_rounding(e, nominal, matrix)[0], len(e.unknown)
    rows = [int(row) for row in np.flatnonzero(matrix.any(axis=1))]
    if len(rows) == count and np.linalg.matrix_rank(matrix) == count:
        return tuple(rows)
    if not count:
        return ()
    vain = [
        e.u_signals[k].name for k, acts in zip(e.unknown, matrix.any(axis=0), strict=True) if not acts
    ]
    if vain:
        raise TrimError(
            f"scene {e.name!r}: the equilibrium does not determine {', '.join(vain)}, which moves "
            "nothing at nominal, as a spring or a force whose line meets the axis of a hinge or is "
            "parallel to it, or is at right angles to a slide. Give it a value "
            f"{_GIVEN}, such as 0, or change its ports or direction."
        )
    scaled = _equilibrated(matrix)
    _, triangle, order = qr(scaled.T, mode="economic", pivoting=True)
    steps = np.abs(np.diag(triangle))
    rank = int(np.sum(steps > _RANK * np.max(steps, initial=0.0)))
    if rank < count:
        idle = np.abs(np.linalg.svd(scaled)[2][rank:])
        doubtful = [k for k, size in zip(e.unknown, np.max(idle, axis=0), strict=True) if size > _IDLE]
        raise TrimError(
            f"scene {e.name!r}: the equilibrium does not determine the trim unknowns "
            f"{', '.join(e.u_signals[k].name for k in doubtful)}: they are redundant, {count - rank} too "
            f"many. Give a value to that many of them {_GIVEN}: a number or an expression, such as "
            'magnitude = "m*9.81 [m/s^2]/4".'
        )
    return tuple(sorted(int(row) for row in order[:count]))


def _without_rounding(e: Equations, points: Array, matrix: Array) -> Array:
    """Slopes (N, rows, unknowns) in which what is left of terms that cancelled is zero.

    Terms that are numbers have cancelled before: of these nothing is left but an entry that is rounding
    beside the largest one of its unknown (N beside N m: lengths below 1e-15 m are none).
    """
    if not matrix.size:
        return matrix
    symbols = physical_symbols(e.parameters)
    # most entries are zero: of rows, a few are not
    slopes = ca.sparsify(relations_at_rest(e, symbols)[1])
    tape, sizes = ca.Function("slopes", [symbols.symbols], [slopes]), np.zeros(matrix.shape)
    sizes[:, *slopes.sparsity().get_triplet()] = term_sizes(tape, points)
    return cleaned(matrix, np.maximum(sizes, np.max(np.abs(matrix), axis=1, keepdims=True)))


def _equilibrated(matrix: Array) -> Array:
    """A matrix with rows and columns of one size, as units differ (Ruiz 2001)."""
    scaled = matrix
    for _ in range(_ROUNDS):
        for axis in (1, 0):
            size = np.sqrt(np.max(np.abs(scaled), axis=axis, initial=0.0, keepdims=True))
            scaled = scaled / np.where(size > 0, size, 1.0)
    return scaled


def _relative(residual: Array, scale: Array) -> Array:
    return np.asarray(np.max(np.abs(residual), axis=1, initial=0.0) / np.where(scale > 0, scale, 1.0))


def _explained(e: Equations, points: Array, efforts: Array, matrix: Array) -> Array:
    """Unbalanced efforts (N, rows) that the bounds of fitted positions and efforts allow.

    To first order, once the unknown efforts have followed; `matrix` are the slopes by these. Errors
    of positions and of efforts are added as if each had its largest value and the worse sign.
    """
    slopes = _slopes(e, points, efforts, ca.vertcat(e.x[: e.degrees_of_freedom], e.u))
    rows = list(trim_rows(e))
    if rows:
        slopes = slopes - matrix @ np.linalg.solve(matrix[:, rows], slopes[:, rows])
    bounds = np.array([*e.x_bounds, *e.u_bounds])
    return np.asarray((1.0 + CURVED * e.fit_error_bound) * (np.abs(slopes) @ bounds))


def _slopes(e: Equations, points: Array, efforts: Array, around: ca.SX) -> Array:
    """Derivatives (N, rows, entries) of the equations at rest by entries of xdot, x and u."""
    symbols = physical_symbols(e.parameters)
    moved = _residual(e, e.xdot, e.x, e.u, symbols)
    effort, moving = ca.SX.sym("u", e.u.numel()), ca.vertcat(e.xdot, e.x)
    by_around = ca.substitute(
        ca.jacobian(moved, around),
        ca.vertcat(moving, e.u),
        ca.vertcat(ca.SX.zeros(moving.numel()), effort),
    )
    (slopes,) = evaluate_many(
        ca.Function("slopes", [symbols.symbols, effort], [ca.densify(by_around)]), points, efforts
    )
    return slopes


def _uncancelled(e: Equations, points: Array, efforts: Array) -> Array:
    """Sizes (N,) of the equations of equilibrium if nothing cancelled in them.

    Terms of the residual; what efforts do; parts of what the load does to the inertia, and of what
    displacements of 1 rad or 1 m do. In a scene of numbers only the last ones are left.
    """
    n = e.degrees_of_freedom
    at = physical_symbols(e.parameters)
    symbols, (offset, _, _) = at.symbols, relations_at_rest(e, at)
    terms = term_sizes(ca.Function("offset", [symbols], [offset]), points)
    by_motion = _slopes(e, points, efforts, ca.vertcat(e.xdot[n:], e.x[:n]))
    by_motion = np.max(np.abs(by_motion), axis=1)
    inertia = np.max(by_motion[:, :n], axis=1, initial=0.0)
    stiffness = np.max(by_motion[:, n:], axis=1, initial=0.0)
    value = ca.Function("load", [symbols], [ca.densify(load_value(e, symbols))])
    (load,) = evaluate_many(value, points)
    pull = np.max(np.abs(load), axis=(1, 2), initial=0.0)
    largest = np.maximum(np.max(terms, axis=1), np.max(np.abs(efforts), axis=1, initial=0.0))
    return np.asarray(np.maximum(largest, PART * np.maximum(pull * inertia, stiffness)))


def _residual(e: Equations, xdot: ca.SX, x: ca.SX, u: ca.SX, symbols: ParameterSymbols) -> ca.SX:
    """The residual, with multipliers of the trim."""
    _, p, cosine, sine = symbols
    none = ca.SX(e.z.numel(), 1)
    return equation_function(e)(xdot, x, none, u, load_value(e, p), p, cosine, sine)[0]


def _relations_at(e: Equations, points: Array) -> tuple[Array, Array, Array]:
    """Unbalanced efforts (N, rows) without the unknowns, their slopes (N, rows, unknowns), given u."""
    offset, matrix, values = evaluate_many(relation_function(e), points)
    return offset[:, :, 0], matrix, values[:, :, 0]


@lru_cache(maxsize=1)  # the stages of one scene ask for the same
def relation_function(e: Equations) -> ca.Function:
    """Physical values -> residual at rest with the given entries of u, its slopes, given entries."""
    symbols = physical_symbols(e.parameters)
    return ca.Function("trim", [symbols.symbols], list(relations_at_rest(e, symbols)))


def relations_at_rest(e: Equations, symbols: ParameterSymbols) -> tuple[ca.SX, ca.SX, ca.SX]:
    """Residual at rest with the given entries of u, its slopes by the unknown ones, given entries."""
    u, still = ca.SX.sym("u", e.u.numel()), ca.SX(e.x.numel(), 1)
    residual, known_efforts = (_residual(e, still, still, u, symbols), given_value(e, symbols.symbols))
    slopes = ca.jacobian(residual, u[list(e.unknown)]) if e.unknown else ca.SX(residual.numel(), 0)
    offset = ca.substitute(residual, u, known_efforts)
    return ca.densify(offset), ca.densify(slopes), ca.densify(known_efforts)


def _names(e: Equations) -> str:
    return ", ".join(e.u_signals[k].name for k in e.unknown)


def _unbalanced(e: Equations, points: Array, residual: Array, worst: int) -> str:
    """Which coordinate is not in equilibrium, by how much, and where."""
    n = e.degrees_of_freedom
    row = int(np.argmax(np.abs(residual[worst, n : 2 * n])))
    signal, size = e.equilibrium_signals[row], residual[worst, n + row]
    where = at_values(e.parameters, points[worst])
    return (
        f"scene {e.name!r}: no equilibrium{' at ' + where if where else ''}: {signal.name} misses "
        f"{size:.4g} {signal.unit}"
        f"{' with the trim unknowns ' + _names(e) if e.unknown else ', and nothing is unknown'}. "
        "Leave out a preload or a load's magnitude that can balance it, change the position "
        "(find_equilibrium gives one), or, where the whole accelerates as a rocket does, make a "
        "component of the scene's acceleration 'unknown'. Where the position itself depends on "
        "parameters: (a) declare the angle as a parameter and let the trim solve for a load or preload, "
        "which is exact, or (b) fit the position by a rational function with a guaranteed bound "
        "(fit_positions)."
    )


CARRIED = 1e-9  # of the loads of the scene: a smaller wrench through a body is rounding


def check_prestress(equations: Equations, points: Array, efforts: Array) -> None:
    """No load at equilibrium goes through an elastic body, unless its scene says that this is known."""
    e = equations
    if e.carried_by:
        carried, loads = evaluate_many(carried_function(e), points, efforts)
        largest = np.max(np.abs(loads), initial=0.0), np.max(np.abs(efforts), initial=0.0)
        check_carried(e, np.max(np.abs(carried[:, :, 0]), axis=0), max(map(float, largest)))


def check_carried(equations: Equations, largest: Array, load: float) -> None:
    """The same, from the largest wrenches (n_c,) and the largest load or effort."""
    e = equations
    loaded = np.flatnonzero(largest > CARRIED * load)
    if len(loaded):
        body = e.carried_by[int(loaded[0])]
        raise TrimError(
            f"scene {e.name!r}: body {body!r} is elastic and carries a load at equilibrium (up to "
            f"{np.max(largest[loaded]):.3g} N or N m). The model takes the given shape for that under "
            "this load, and has the effects of the load through the displaced ports and of the weight of "
            "the displaced mass; it does not have the change of the body's own stiffness by the load "
            "(buckling, tension), which is known for axial forces in beams only. Where the change may "
            "be left out, write prestress = 'neglected' in the body; where only that of the other "
            "loads of a beam may be, prestress = 'axial'."
        )


@lru_cache(maxsize=1)  # a sweep asks for it again and again
def carried_function(e: Equations) -> ca.Function:
    """(physical values, efforts) -> wrenches through elastic bodies, loads of the scene."""
    symbols, p, cosine, sine = physical_symbols(e.parameters)
    still = [e.xdot, e.x, e.z]
    at_rest = ca.substitute([e.carried], still, [ca.SX.zeros(s.numel()) for s in still])
    function = ca.Function("carried", [e.u, e.load, e.p, e.cosine, e.sine], at_rest)
    u, load = ca.SX.sym("u", e.u.numel()), load_value(e, p)
    values = function(u, load, p, cosine, sine)
    return ca.Function("carried", [symbols, u], [ca.densify(values), ca.densify(load)])
