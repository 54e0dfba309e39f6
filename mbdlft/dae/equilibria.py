"""Equilibria of DAEs that keep parameters: numbers where they do not depend on them, rational otherwise.

All rates are zero. The equations are solved block after block: a block that is linear in its unknowns has
an exact solution, rational in the parameters; a nonlinear one has numbers if the parameters cancel.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import casadi as ca
import numpy as np

from mbdlft.base.arguments import arguments_checked
from mbdlft.base.array import Array
from mbdlft.base.errors import NotRationalError, SceneError, TrimError, check_known
from mbdlft.base.parameter import at_values
from mbdlft.base.samples import check_points
from mbdlft.dae import balance
from mbdlft.dae.index import independent
from mbdlft.dae.kinks import check_modes, near_points
from mbdlft.dae.newton import Found, System, divided, solve, values_of
from mbdlft.dae.structure import (
    Quantity,
    Structure,
    check_range,
    in_symbols,
    parameter_points,
    start_of,
    written_rates,
)
from mbdlft.dae.text import column_of
from mbdlft.exact.rounding import NOISE, equilibrate
from mbdlft.problem.equations import rows_of
from mbdlft.problem.sx.constants import constants_in, double, in_doubles, literal
from mbdlft.problem.sx.tapes import term_sizes

_SEED = 20261129  # of the points at which equilibria are in their ranges


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
    slopes : mapping of (row, column) to SX of the parameters
        Entries of the Jacobian of [residual ; outputs] that are fits.
    fit_bound : float
        Proved bound of the errors of all fits, each relative to the size of its quantity; 0 if exact.
    at_rest : bool
        False for a point of `start_point`, whose rates are not zero.
    """

    structure: Structure
    values: Mapping[str, ca.SX]
    nominal: Mapping[str, float]
    free: tuple[str, ...]
    given: Mapping[str, float | str]
    slopes: Mapping[tuple[int, int], ca.SX] = field(default_factory=dict)
    fit_bound: float = 0.0
    at_rest: bool = True


@arguments_checked
def trim(
    s: Structure,
    at: Mapping[str, float | str] | None = None,
    free: Sequence[str] = (),
    moving: Sequence[str] = (),
    fit: float | None = None,
) -> DaeTrim:
    """The equilibrium of a structure at given inputs, parameters left in.

    Parameters
    ----------
    s : Structure
        Of `reduce_index(dae)`.
    at : mapping of names of inputs, states or other variables to numbers or names of parameters
        Inputs that are not given have their start values, or 0. A state that the equilibrium does not
        determine, such as the angle of a free shaft, has its start value, or 0.
    free : names of inputs that are solved for
        As many as other variables are given.
    moving : names of variables that may grow steadily, such as the angle of a shaft that turns
        No equation may depend on them.
    fit : float, optional
        Where the equilibrium, or the linear model there, is not rational in the parameters, it is made of
        rational fits, whose errors are proved to be at most this, relative to the size of each quantity
        at nominal parameters.

    Raises
    ------
    TrimError
        There is no equilibrium, or too much is given; a fit does not meet its tolerance. A variable is
        outside its minimum and maximum, at nominal or at other values of the parameters.
    NotRationalError
        The equilibrium is not rational in the parameters; the message says what can be done.
    """
    fixed = _of_aliases(s, dict(at or {}))
    _check_names(s, fixed, free)
    point = _solved(s, _posed(s, fixed, free, moving), fixed, fit)
    if moving:
        _check_moving(s, moving, point.values)
    return replace(point, free=tuple(free))


@arguments_checked
def start_point(
    s: Structure, at: Mapping[str, float | str] | None = None, fit: float | None = None
) -> DaeTrim:
    """The initial point of a structure, which may move: rates are those that the equations give there.

    Fixed start values and initial equations hold; states that these leave open have their start values.

    Parameters
    ----------
    s : Structure
    at : mapping of names of inputs, states or other variables to numbers or names of parameters
        In the place of start values.
    fit
        As in `trim`.
    """
    fixed = _of_aliases(s, dict(at or {}))
    _check_names(s, fixed, ())
    return replace(_solved(s, _initial(s, fixed), fixed, fit), at_rest=False)


def _solved(
    s: Structure, posed: balance.Balance, fixed: Mapping[str, float | str], fit: float | None
) -> DaeTrim:
    """What solves a balance, parameters left in, and what is held."""
    problem = _square(s, posed, fixed)
    points = balance.at_points(s, problem, fixed)
    problem = problem._replace(residual=near_points(s, problem.residual, problem.quantities, points))
    unsolved: list[tuple[int, int]] | None = None if fit is None else []
    values: dict[str, ca.SX] = balance.solved_exactly(s, problem, points, unsolved)
    open_ = {problem.quantities[j].name for _, j in unsolved or ()}
    for q in s.quantities:
        if q.name not in values and q.name not in open_:
            rate = posed.rates.get(q.name, ca.SX(0))
            values[q.name] = rate if q.order else _given_value(s, q, fixed)
    fits = balance.Fitted({}, {}, 0.0)
    if fit is not None:
        fits = balance.fitted(s, problem, unsolved or [], points[0], values, fit)
        values |= fits.values
    p = parameter_points(s.dae, 1)[0]
    numbers = values_of([values[q.name] for q in s.quantities], s.dae.p, p)
    missed = System(s.residual, s.symbols, s.dae.p).residual(numbers, p)
    if not np.all(np.isfinite(missed)):  # such as log(x) at zero, where any number is near a solution
        missed = np.where(np.isfinite(missed), np.abs(missed), np.inf)
        raise balance.no_solution(s, posed, Found(numbers, missed), fixed)
    _check_ranges(s, values)
    check_modes(s, values)
    nominal = {q.name: float(x) for q, x in zip(s.quantities, numbers, strict=True)}
    for alias in s.aliases:
        nominal[alias.name] = float(alias.factor) * (nominal[alias.of] if alias.of else 1.0)
    return DaeTrim(s, values, nominal, (), fixed, fits.slopes, fits.bound)


def _check_ranges(s: Structure, values: Mapping[str, ca.SX]) -> None:
    """Raise a TrimError for a variable outside its range, or an assert that does not hold."""
    ranged = {q.name: q.variable for q in s.quantities if not q.order}
    ranged = {name: v for name, v in ranged.items() if v.minimum > -math.inf or v.maximum < math.inf}
    asserts = [c for c in s.dae.conditions if c.kind == "assert"]
    if not ranged and not asserts:
        return
    points = check_points(s.dae.parameters, _SEED)
    truths = column_of(c.expression for c in asserts)
    truths = ca.substitute(truths, s.symbols, column_of(values[q.name] for q in s.quantities))
    every = ca.vertcat(column_of(values[name] for name in ranged), truths)
    function = ca.Function("values", [s.dae.p], [ca.densify(in_doubles(every))])
    for physical, p in zip(points, in_symbols(s.dae, points), strict=True):
        of, holds = np.split(np.ravel(function(p).full()), [len(ranged)])
        for v, value in zip(ranged.values(), of, strict=True):
            check_range(s, v, value, partial(at_values, s.dae.parameters, physical))
        for c, truth in zip(asserts, holds, strict=True):
            if truth != c.value:  # or has none
                where = at_values(s.dae.parameters, physical) or "the operating point"
                raise TrimError(f"{s.owner}, {c.name} At {where}: choose another one, or other ranges.")


def _of_aliases(s: Structure, fixed: Mapping[str, float | str]) -> dict[str, float | str]:
    """What is given of aliases, as values of the variables that stayed."""
    aliases = {a.name: a for a in s.aliases}
    translated: dict[str, float | str] = {}
    for name, value in fixed.items():
        alias = aliases.get(name)
        if alias is None:
            translated[name] = value
            continue
        if alias.of is None or (isinstance(value, str) and alias.factor != 1):
            raise SceneError(f"{s.owner}, trim: {alias}, which is no free variable. Give another one.")
        translated[alias.of] = value if isinstance(value, str) else value / float(alias.factor)
    return translated


def _check_names(s: Structure, fixed: Mapping[str, Any], free: Sequence[str]) -> None:
    where, names = f"{s.owner}, trim", [q.name for q in s.quantities]
    for name, value in fixed.items():
        check_known("variable", [name], names, where)
        if not isinstance(value, (str, int, float, np.number)) or value != value:
            raise SceneError(f"{where}, {name}: expected a number or a parameter's name, got {value!r}.")
        if isinstance(value, str):
            check_known("parameter", [value], [p.name for p in s.dae.parameters], f"{where}, {name}")
    check_known("input", free, [q.name for q in s.inputs], where)


def _check_moving(s: Structure, moving: Sequence[str], values: Mapping[str, ca.SX]) -> None:
    """Nothing changes while these variables move with their rates."""
    variables = {v.name: v.symbol for v in s.dae.variables}
    check_known("variable", moving, variables, f"{s.owner}, moving")
    moving_symbols = column_of([variables[name] for name in moving])
    rates = [values.get(f"der({name})", ca.SX(0)) for name in moving]
    changes = ca.jtimes(s.residual, moving_symbols, column_of(rates))
    held = [q for q in s.quantities if q.variable.name not in moving or q.order]
    symbols, at = column_of(q.symbol for q in held), column_of(values[q.name] for q in held)
    remaining = in_doubles(ca.substitute(changes, symbols, at))
    size = np.max(np.abs(values_of(rates, s.dae.p, parameter_points(s.dae, 1)[0])), initial=1.0)
    function = ca.Function("changes", [moving_symbols, s.dae.p], [ca.densify(remaining)])
    drawn = np.random.default_rng(0)
    for p in parameter_points(s.dae, balance.POINTS):
        change = function(drawn.standard_normal(len(moving)), p).full()[:, 0]
        worst = int(np.argmax(np.abs(change))) if len(change) else 0
        if len(change) and abs(change[worst]) > balance.SAME * size:
            raise TrimError(
                f"{s.owner}: {', '.join(moving)} cannot move in an equilibrium: equation "
                f"{s.equations[worst][0]} changes."
            )


def _given_value(s: Structure, q: Quantity, fixed: Mapping[str, float | str]) -> ca.SX:
    if q.name not in fixed and not q.order and q.variable.start_of is not None:
        return ca.SX(q.variable.start_of)
    value = fixed.get(q.name, q.start)
    if isinstance(value, str):
        names = [p.name for p in s.dae.parameters]
        return ca.SX(s.dae.p[names.index(value)])
    return ca.SX(literal(float(value)))


def _posed(
    s: Structure, fixed: Mapping[str, float | str], free: Sequence[str], moving: Sequence[str]
) -> balance.Balance:
    """Equations with rates of zero and what is given, and what is unknown in them."""
    posed = {*fixed, *(q.name for q in s.inputs if q.name not in free)}
    unknown, old, new = [], [], []
    for q in s.quantities:
        at_rest = q.order > 1 or (q.order == 1 and q.variable.name not in moving)
        if not at_rest and q.name not in posed:
            unknown.append(q)
            continue
        old.append(q.symbol)
        new.append(ca.SX(0) if at_rest else _given_value(s, q, fixed))
    residual = ca.substitute(s.residual, column_of(old), column_of(new))
    return balance.Balance(residual, tuple(place for place, _ in s.equations), tuple(unknown))


_NO_START = (
    "no consistent initial point was found{}; what misses most, over its terms with unknowns: {}. Give "
    "start values near a solution, or fix fewer of them."
)


def _initial(s: Structure, fixed: Mapping[str, float | str]) -> balance.Balance:
    """Equations with what is fixed and given, initial equations, and what is unknown in them."""
    known = {*fixed, *(q.name for q in s.inputs)}
    known |= {q.name for q in s.quantities if q.variable.fixed and not q.order}
    chosen = [q for q in s.quantities if q.name in known]
    values = column_of(_given_value(s, q, fixed) for q in chosen)
    every = ca.vertcat(s.residual, *(e.residual for e in s.dae.initial))
    residual = ca.substitute(every, column_of(q.symbol for q in chosen), values)
    places = (*(place for place, _ in s.equations), *(e.place for e in s.dae.initial))
    unknown = tuple(q for q in s.quantities if q.name not in known)
    of_name = {v.name: v for v in s.dae.variables}
    rates = {}
    for name, rate in written_rates(s.dae).items():
        v = of_name[name]
        rates[rate] = ca.SX(literal(v.start or 0.0)) if v.start_of is None else v.start_of
    return balance.Balance(residual, places, unknown, _NO_START, rates)


def _square(s: Structure, posed: balance.Balance, fixed: Mapping[str, float | str]) -> balance.Balance:
    """As many equations as unknowns: what is not determined is held, what holds anyway is left out."""
    residual, places, unknown, *_ = posed
    point = parameter_points(s.dae, 1)[0]
    start, sizes = start_of(unknown)
    system = System(residual, posed.z, s.dae.p)
    at = solve(system, start, point, sizes, partial(s.near_start, unknown))
    if not at.is_solution:
        raise balance.no_solution(s, posed, at, fixed)
    J = system.jacobian(at.values, point) * np.maximum(sizes, np.abs(at.values))
    J = divided(J, np.max(np.abs(J), axis=1, keepdims=True, initial=0.0))
    # states are held before other variables are
    states = {q.name for q in s.states}
    classes = np.array([int(q.name in states) for q in unknown], dtype=int)
    columns = independent(J, classes)
    if len(columns) < min(J.shape):  # or sizes are not known: 1e-12 beside others, and no nominal
        of_one_size = _equilibrated(s, posed, at.values, J, point)
        of_any_size = independent(of_one_size, classes)
        if len(of_any_size) > len(columns):
            J, columns = of_one_size, of_any_size
    kept = independent(J[:, columns].T, np.zeros(len(J), dtype=int))
    if len(kept) < len(columns):  # two ranks, where errors of the solution are as large as a pivot
        columns = independent(J[kept], classes)
    held = [q for k, q in enumerate(unknown) if k not in columns]
    new = column_of(posed.rates.get(q.name, _given_value(s, q, fixed)) for q in held)
    residual = ca.substitute(residual, column_of(q.symbol for q in held), new)
    chosen = tuple(q for k, q in enumerate(unknown) if k in columns)
    near = dict(zip((q.name for q in unknown), map(float, at.values), strict=True))
    posed = posed._replace(near=near)
    if len(kept) < len(places):  # the equations that are left out have to hold as well
        balance.at_points(s, posed._replace(residual=residual, quantities=chosen), fixed)
    left = tuple(places[i] for i in kept)
    return posed._replace(residual=rows_of(residual, kept), places=left, quantities=chosen)


def _equilibrated(s: Structure, posed: balance.Balance, z: Array, J: Array, p: Array) -> Array:
    """Slopes J (m, n) at z without those that are rounding of their terms; columns of one size, too."""
    smooth = near_points(s, posed.residual, posed.quantities, z[None])
    slopes = ca.densify(ca.jacobian(smooth, posed.z))
    constants, numbers = constants_in(slopes)  # as doubles their sums would be without terms
    function = ca.Function("slopes", [ca.vertcat(posed.z, s.dae.p, constants)], [slopes])
    at = np.array([[*z, *p, *map(double, numbers)]])
    try:
        terms = term_sizes(function, at)
    except NotRationalError:  # a function switches there: what is rounding is not known
        return J
    clear = np.abs(function(at[0]).full()) > NOISE * terms.reshape(slopes.shape, order="F")
    rows, columns = equilibrate(np.where(clear, J, 0.0)[None])
    return np.asarray(np.where(clear, J, 0.0) * rows[:, None] * columns)
