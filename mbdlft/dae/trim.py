"""Equilibria of DAEs that keep parameters: numbers where they do not depend on them, rational otherwise.

All rates are zero. The equations are solved block after block: a block that is linear in its unknowns has
an exact solution, rational in the parameters; a nonlinear one has numbers if the parameters cancel.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
from scipy.linalg import qr

from mbdlft.base.array import Array
from mbdlft.base.errors import NotRationalError, SceneError, TrimError, unknown_name
from mbdlft.dae.index import listed
from mbdlft.dae.operations import column_of
from mbdlft.dae.points import Found, System, solve
from mbdlft.dae.states import blocks_of
from mbdlft.dae.structure import Quantity, Structure, parameter_points
from mbdlft.number.exact import decimal
from mbdlft.sx.constants import in_doubles, literal

_POINTS = 8  # of the parameters at which a solution is looked at
_SAME, _RANK, _ZERO = 1e-9, 1e-9, 1e-12
_MISSED = 1e-11  # of the terms of an equation
_MOST_POWER = 4
_MOST_SOLVED = 4  # unknowns of a linear block with parameters


@dataclass(frozen=True, eq=False)
class DaeTrim:
    """An equilibrium.

    Attributes
    ----------
    structure : Structure
    values : mapping of names of unknowns, states and inputs to SX of the parameters
        Numbers where they do not depend on these.
    nominal : mapping of the same names to floats
    free : names of inputs that were solved for
    given : mapping of names to floats or names of parameters
    """

    structure: Structure
    values: Mapping[str, ca.SX]
    nominal: Mapping[str, float]
    free: tuple[str, ...]
    given: Mapping[str, float | str]


class _Problem(NamedTuple):
    """0 = residual(z, p), and what z are."""

    residual: ca.SX
    places: tuple[str, ...]
    quantities: tuple[Quantity, ...]
    z: ca.SX


def trim(
    s: Structure,
    at: Mapping[str, float | str] | None = None,
    free: Sequence[str] = (),
    moving: Sequence[str] = (),
) -> DaeTrim:
    """The equilibrium of a structure at given inputs, parameters left in.

    Parameters
    ----------
    s : Structure
    at : mapping of names of inputs, states or other variables to numbers or names of parameters
        Inputs that are not given have their start values, or 0. A state that the equilibrium does not
        determine, such as the angle of a free shaft, has its start value, or 0.
    free : names of inputs that are solved for
        As many as other variables are given.
    moving : names of variables that may grow steadily, such as the angle of a shaft that turns
        No equation may depend on them.

    Raises
    ------
    SceneError
        A name is not known.
    TrimError
        There is no equilibrium, or too much is given.
    NotRationalError
        The equilibrium is not rational in the parameters; the message says what can be done.
    """
    given = dict(at or {})
    _check_names(s, given, free)
    problem = _square(s, *_posed(s, given, free, moving), given)
    found = _solved(s, problem, _at_points(s, problem))
    values: dict[str, ca.SX] = {q.name: found[q.name] for q in problem.quantities}
    every = (*s.unknowns, *s.states, *s.inputs)
    for q in every:
        if q.name not in values:
            values[q.name] = ca.SX(0) if _rests(q) else _given_value(s, q, given)
    if moving:
        _check_moving(s, moving, values)
    p = parameter_points(s.dae, 1)[0]
    stacked = column_of([values[q.name] for q in every])
    numbers = ca.Function("trim", [s.dae.p], [ca.densify(in_doubles(stacked))])(p).full()[:, 0]
    nominal = {q.name: float(x) for q, x in zip(every, numbers, strict=True)}
    return DaeTrim(s, values, nominal, tuple(free), given)


def _check_names(s: Structure, given: Mapping[str, Any], free: Sequence[str]) -> None:
    names = [q.name for q in (*s.unknowns, *s.states, *s.inputs)]
    inputs = [q.name for q in s.inputs]
    for name in given:
        if name not in names:
            raise SceneError(f"{s.owner}, trim: " + unknown_name("variable", name, names))
        value = given[name]
        if isinstance(value, str) and value not in [p.name for p in s.dae.parameters]:
            known = [p.name for p in s.dae.parameters]
            raise SceneError(f"{s.owner}, trim, {name}: " + unknown_name("parameter", value, known))
    for name in free:
        if name not in inputs:
            raise SceneError(f"{s.owner}, trim: " + unknown_name("input", name, inputs))


def _check_moving(s: Structure, moving: Sequence[str], values: Mapping[str, ca.SX]) -> None:
    """Nothing changes while these variables move with their rates.

    Raises
    ------
    SceneError, TrimError
        A name is not known; an equation changes.
    """
    variables = {v.name: v.symbol for v in s.dae.variables}
    for name in moving:
        if name not in variables:
            raise SceneError(f"{s.owner}, moving: " + unknown_name("variable", name, variables))
    every = (*s.unknowns, *s.states, *s.inputs)
    own = column_of([variables[name] for name in moving])
    rates = column_of([values.get(f"der({name})", ca.SX(0)) for name in moving])
    changes = ca.jtimes(s.residual, own, rates)
    symbols = column_of([q.symbol for q in every if q.variable.name not in moving or q.order])
    at = [values[q.name] for q in every if q.variable.name not in moving or q.order]
    left = in_doubles(ca.substitute(changes, symbols, column_of(at)))
    sizes = np.array(
        [
            abs(float(x))
            for x in ca.DM(ca.substitute(in_doubles(rates), s.dae.p, parameter_points(s.dae, 1)[0]))
            .full()
            .ravel()
        ]
        + [1.0]
    )
    function = ca.Function("changes", [own, s.dae.p], [ca.densify(left)])
    drawn = np.random.default_rng(0)
    for p in parameter_points(s.dae, _POINTS):
        change = function(drawn.standard_normal(len(moving)), p).full()[:, 0]
        worst = int(np.argmax(np.abs(change))) if len(change) else 0
        if len(change) and abs(change[worst]) > _SAME * np.max(sizes):
            raise TrimError(
                f"{s.owner}: {', '.join(moving)} cannot move in an equilibrium: equation "
                f"{s.equations[worst][0]} changes."
            )


def _rests(q: Quantity) -> bool:
    """Whether this is a derivative that is zero at rest; those of inputs are, too."""
    return q.order > 0


def _given_value(s: Structure, q: Quantity, given: Mapping[str, float | str]) -> ca.SX:
    value = given.get(q.name, (q.variable.start or 0.0) if not q.order else 0.0)
    if isinstance(value, str):
        names = [p.name for p in s.dae.parameters]
        return ca.SX(s.dae.p[names.index(value)])
    return ca.SX(literal(float(value)))


def _posed(
    s: Structure,
    given: Mapping[str, float | str],
    free: Sequence[str],
    moving: Sequence[str],
) -> tuple[ca.SX, list[str], list[Quantity]]:
    """Equations with rates of zero and what is given, and what is unknown in them."""
    every = (*s.unknowns, *s.states, *s.inputs)
    inputs = {q.name for q in s.inputs}
    unknown, old, new = [], [], []
    for q in every:
        if _rests(q) and not (q.order == 1 and q.variable.name in moving):
            old.append(q.symbol)
            new.append(ca.SX(0))
        elif q.name in given or (q.name in inputs and q.name not in free):
            old.append(q.symbol)
            new.append(_given_value(s, q, given))
        else:
            unknown.append(q)
    residual = ca.substitute(s.residual, column_of(old), column_of(new))
    places = [place for place, _ in s.equations]
    return residual, places, unknown


def _square(
    s: Structure,
    residual: ca.SX,
    places: list[str],
    unknown: list[Quantity],
    given: Mapping[str, float | str],
) -> _Problem:
    """As many equations as unknowns: what is not determined is held, what holds anyway is left out."""
    z = column_of([q.symbol for q in unknown])
    points = parameter_points(s.dae, _POINTS)
    start, sizes = _start(s, unknown)
    system = System(residual, z, s.dae.p)
    at = solve(system, start, points[0], sizes)
    if not at.is_solution:
        raise _no_equilibrium(s, places, at, given)
    J = system.jacobian(at.values, points[0]) * sizes
    rows = np.max(np.abs(J), axis=1, keepdims=True, initial=0.0)
    J = J / np.where(rows > 0, rows, 1.0)
    columns = _independent(J, _preference(s, unknown))
    held = [q for k, q in enumerate(unknown) if k not in columns]
    kept = _independent(J[:, columns].T, np.zeros(len(J), dtype=int))
    if held:
        old = column_of([q.symbol for q in held])
        new = column_of([_given_value(s, q, given) for q in held])
        residual = ca.substitute(residual, old, new)
    chosen = [q for k, q in enumerate(unknown) if k in columns]
    problem = _Problem(
        residual[kept] if kept else ca.SX(0, 1),
        tuple(places[i] for i in kept),
        tuple(chosen),
        column_of([q.symbol for q in chosen]),
    )
    _check_others(s, problem, residual, places, points, given)
    return problem


def _preference(s: Structure, unknown: Sequence[Quantity]) -> Array:
    """States are held before other variables are."""
    states = {q.name for q in s.states}
    return np.array([1 if q.name in states else 0 for q in unknown], dtype=int)


def _independent(matrix: Array, classes: Array) -> list[int]:
    """Independent columns, of the lowest classes first."""
    rest, chosen = matrix, []
    for kind in sorted(set(classes.tolist())):
        columns = np.flatnonzero(classes == kind)
        if not len(columns) or not len(rest):
            continue
        q, triangle, order = qr(rest[:, columns], pivoting=True)
        pivots = np.abs(np.diag(triangle))
        count = int(np.sum(pivots > _RANK * max(1.0, np.max(pivots, initial=0.0))))
        chosen += [int(columns[k]) for k in order[:count]]
        rest = q[:, count:].T @ rest
    return sorted(chosen)


def _check_others(
    s: Structure,
    problem: _Problem,
    residual: ca.SX,
    places: Sequence[str],
    points: Sequence[Array],
    given: Mapping[str, float | str],
) -> None:
    """The equations that were left out hold as well, at the points.

    Raises
    ------
    TrimError
        One does not.
    """
    if problem.residual.numel() == residual.numel():
        return
    start, sizes = _start(s, problem.quantities)
    system = System(residual, problem.z, s.dae.p)
    for p in points:
        at = solve(system, start, p, sizes)
        if not at.is_solution:
            raise _no_equilibrium(s, places, at, given)


def _start(s: Structure, unknown: Sequence[Quantity]) -> tuple[Array, Array]:
    start = np.array([(q.variable.start or 0.0) if not q.order else 0.0 for q in unknown])
    return start, np.array([q.variable.nominal for q in unknown])


def _no_equilibrium(
    s: Structure, places: Sequence[str], at: Found, given: Mapping[str, float | str]
) -> TrimError:
    worst = np.argsort(-at.missing)[:3]
    missed = listed(f"{places[k]} ({at.missing[k]:.1e})" for k in worst if at.missing[k] > 0)
    return TrimError(
        f"{s.owner}: no equilibrium was found"
        + (f" with {', '.join(f'{k} = {v}' for k, v in given.items())}" if given else "")
        + f"; what misses most, relative to its terms: {missed}. Give other inputs, leave an input free "
        "(free=...), or give start values near an equilibrium."
    )


def _solved(s: Structure, problem: _Problem, solution: Array) -> dict[str, ca.SX]:
    """Each unknown as an expression of the parameters; `solution` are its values at points."""
    found: dict[str, ca.SX] = {}
    pattern = ca.jacobian_sparsity(problem.residual, problem.z) if problem.z.numel() else None
    if pattern is None:
        return found
    for block in blocks_of(pattern):
        own = [problem.quantities[j] for j in block.columns]
        known = [q for q in problem.quantities if q.name in found]
        part = ca.substitute(
            problem.residual[list(block.rows)],
            column_of([q.symbol for q in known]),
            column_of([found[q.name] for q in known]),
        )
        z = column_of([q.symbol for q in own])
        places = [problem.places[i] for i in block.rows]
        values = solution[:, list(block.columns)]
        for q, value in zip(own, _block(s, part, z, values, places, own), strict=True):
            found[q.name] = value
    return found


def _at_points(s: Structure, problem: _Problem) -> Array:
    """Numbers (points, unknowns) at nominal and at other values of the parameters."""
    start, sizes = _start(s, problem.quantities)
    system = System(problem.residual, problem.z, s.dae.p)
    rows: list[Array] = []
    for p in parameter_points(s.dae, _POINTS):
        at = solve(system, rows[0] if rows else start, p, sizes)
        if not at.is_solution:
            raise _no_equilibrium(s, problem.places, at, {})
        rows.append(at.values)
    return np.array(rows)


def _block(
    s: Structure,
    residual: ca.SX,
    z: ca.SX,
    values: Array,
    places: Sequence[str],
    own: Sequence[Quantity],
) -> list[ca.SX]:
    slopes = ca.jacobian(residual, z)
    n = z.numel()
    if not ca.depends_on(slopes, z):
        offset = ca.substitute(residual, z, ca.SX.zeros(n))
        if not ca.sparsify(offset).nnz():
            return [ca.SX(0)] * n
        if n == 1:
            return [-offset / slopes]
        if not ca.depends_on(ca.vertcat(residual), s.dae.p):
            return [_number(x, q) for x, q in zip(values[0], own, strict=True)]
        if n <= _MOST_SOLVED:
            return _by_cramer(ca.densify(slopes), -offset)
    guessed = _guessed(s, residual, z, values, own, places)
    if guessed is not None:
        return guessed
    names = listed(q.name for q in own)
    raise NotRationalError(
        f"{s.owner}, trim: {names} depend on the parameters, and the equations {listed(places)} are "
        "not linear in them, so the equilibrium is not rational. Either declare one of them as a "
        "parameter and leave an input free instead (at={'name': 'parameter'}, free=['input']), which "
        "is exact; or replace the dependence by a rational fit with a guaranteed bound."
    )


def _guessed(
    s: Structure,
    residual: ca.SX,
    z: ca.SX,
    values: Array,
    own: Sequence[Quantity],
    places: Sequence[str],
) -> list[ca.SX] | None:
    """Unknowns that are numbers or monomials of parameters by their values, and what follows from them.

    The equations have to hold with them, at many points and to rounding.
    """
    p = np.array(parameter_points(s.dae, len(values)))
    found = {q.name: _monomial(s, values[:, k], p, q) for k, q in enumerate(own)}
    known = {name: value for name, value in found.items() if value is not None}
    left = [k for k, q in enumerate(own) if q.name not in known]
    if left:
        if len(left) == len(own):
            return None
        old = column_of([q.symbol for q in own if q.name in known])
        rest = ca.substitute(residual, old, column_of(list(known.values())))
        unknown = z[left]
        J = _numbers(ca.jacobian(rest, unknown), z, s.dae.p, values[0], p[0])
        rows = _independent(J.T, np.zeros(len(J), dtype=int))
        if len(rows) < len(left):
            return None
        problem = _Problem(
            rest[rows], tuple(places[i] for i in rows), tuple(own[k] for k in left), unknown
        )
        try:
            known |= _solved(s, problem, values[:, left])
        except NotRationalError:
            return None
    chosen = [known[q.name] for q in own]
    return chosen if _holds(s, residual, z, chosen, own) else None


def _numbers(expression: ca.SX, z: ca.SX, p: ca.SX, at: Array, values: Array) -> Array:
    function = ca.Function("numbers", [z, p], [ca.densify(in_doubles(expression))])
    return np.asarray(function(at, values).full())


def _monomial(s: Structure, values: Array, points: Array, q: Quantity) -> ca.SX | None:
    """Zero, or a number times integer powers of parameters that are no angles, if the values are that."""
    size = np.max(np.abs(values))
    if size <= _SAME * q.variable.nominal:
        return ca.SX(0)
    if np.min(np.abs(values)) <= _SAME * size or len({*np.sign(values)}) > 1:
        return None
    usable = [k for k, r in enumerate(s.dae.parameters) if not r.is_angle and np.all(points[:, k])]
    logs = np.log(np.abs(points[:, usable]))
    matrix = np.hstack([np.ones((len(values), 1)), logs])
    powers = np.rint(np.linalg.lstsq(matrix, np.log(np.abs(values)), rcond=None)[0][1:])
    if np.any(np.abs(powers) > _MOST_POWER):
        return None
    factor = values / np.exp(logs @ powers) if len(usable) else values
    if np.max(np.abs(factor - factor[0])) > _SAME * abs(factor[0]):
        return None
    signs = np.prod([np.sign(points[0, k]) ** n for k, n in zip(usable, powers, strict=True)])
    expression = _number(float(factor[0] * signs), q._replace(variable=q.variable))
    for k, n in zip(usable, powers, strict=True):
        for _ in range(abs(int(n))):
            expression = expression * s.dae.p[k] if n > 0 else expression / s.dae.p[k]
    return ca.SX(expression)


def _holds(
    s: Structure, residual: ca.SX, z: ca.SX, chosen: Sequence[ca.SX], own: Sequence[Quantity]
) -> bool:
    """Whether equations hold at values of the parameters that were not looked at before."""
    expressions = column_of(list(chosen))
    left = ca.substitute(residual, z, expressions)
    slopes = ca.substitute(ca.jacobian(residual, z), z, expressions)
    parts = [ca.densify(in_doubles(part)) for part in (left, slopes, expressions)]
    function = ca.Function("left", [s.dae.p], parts)
    for p in parameter_points(s.dae, 4 * _POINTS)[1:]:
        r, J, at = (np.abs(part.full()) for part in function(p))
        sizes = np.maximum(at[:, 0], [q.variable.nominal for q in own])
        if not np.all(r[:, 0] <= _MISSED * np.max(J * sizes, axis=1)):
            return False
    return True


def _number(value: float, q: Quantity) -> ca.SX:
    """A number with the digits that doubles carry, zero if it is rounding."""
    if abs(value) <= _ZERO * q.variable.nominal:
        return ca.SX(0)
    short = decimal(float(f"{value:.14g}"))
    near = abs(float(short) - value) <= _ZERO * abs(value) and short.denominator < 10**9
    return ca.SX(literal(short if near else Fraction(repr(float(value)))))


def _by_cramer(matrix: ca.SX, right: ca.SX) -> list[ca.SX]:
    n, whole = matrix.shape[0], ca.det(matrix)
    found = []
    for j in range(n):
        replaced = ca.SX(matrix)
        replaced[:, j] = right
        found.append(ca.det(replaced) / whole)
    return found
