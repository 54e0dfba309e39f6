"""Solutions of the equations of an equilibrium, block after block: rational in the parameters, or fits.

Linear blocks are solved by elimination with numbers as pivots, then by Cramer's rule. In a nonlinear
block, numbers and monomials of parameters are recognized by values, and verified.
What blocks do not give exactly is replaced by rational fits with a proved bound relative to its size: the
unknowns z of these blocks, and those entries of the Jacobian that are not rational in z and p.
"""

from collections.abc import Mapping, Sequence
from fractions import Fraction
from functools import partial
from types import MappingProxyType
from typing import NamedTuple

import casadi as ca
import numpy as np

from mbdlft.base.arguments import arguments_checked
from mbdlft.base.array import Array
from mbdlft.base.errors import NotRationalError, SceneError, TrimError, naming
from mbdlft.base.expression import evaluate, parse
from mbdlft.base.parameter import Parameter
from mbdlft.dae.alias import rational
from mbdlft.dae.index import blocks_of, independent, listed
from mbdlft.dae.newton import Found, System, follow_all, solve, values_of
from mbdlft.dae.structure import Quantity, Structure, parameter_points, start_of
from mbdlft.dae.text import FITTED, RATIONAL, column_of, free_symbols, in_digits, operations_beyond
from mbdlft.multibody.equilibrium.fit import EquilibriumFit, fit_equilibrium
from mbdlft.problem.sx.constants import cancels, in_doubles, is_constant, literal
from mbdlft.problem.sx.tapes import term_sizes

_SMALL = Fraction(1, 8)
_MOST_CRAMER = 6  # unknowns; more are eliminated by entries with parameters, too


def solved_linear(matrix: ca.SX, right: ca.SX) -> list[ca.SX]:
    """The solution (n,) of linear equations whose entries are rational in the parameters.

    Entries that are numbers are pivots first, those of short rows before others; they vanish nowhere.
    What is left has Cramer's rule if it is small: no more is divided by than its determinant.
    """
    n = matrix.shape[0]
    rows = [{j: matrix[i, j] for j in range(n) if matrix.sparsity().has_nz(i, j)} for i in range(n)]
    sides = [ca.SX(right[i]) for i in range(n)]
    remaining, order = set(range(n)), []
    while remaining:
        pivot = _pivot(rows, remaining, any_entry=len(remaining) > _MOST_CRAMER)
        if pivot is None:
            break
        i, j = pivot
        remaining.discard(i)
        order.append((i, j))
        for k in remaining:
            if j in rows[k]:
                factor = rows[k].pop(j) / rows[i][j]
                for m, entry in rows[i].items():
                    if m != j:
                        rows[k][m] = rows[k].get(m, ca.SX(0)) - factor * entry
                rows[k] = {m: entry for m, entry in rows[k].items() if not _is_nothing(entry)}
                sides[k] = sides[k] - factor * sides[i]
    solution = _by_cramer(rows, sides, sorted(remaining), {j for _, j in order}, n)
    for i, j in reversed(order):
        side = sides[i]
        for m, entry in rows[i].items():
            if m != j:
                side = side - entry * solution[m]
        solution[j] = side / rows[i][j]
    return [ca.SX(solution[j]) for j in range(n)]


def _is_nothing(entry: ca.SX) -> bool:
    return bool(entry.is_zero()) or (is_constant(entry) and rational(entry) == 0)


def _pivot(
    rows: list[dict[int, ca.SX]], remaining: set[int], *, any_entry: bool
) -> tuple[int, int] | None:
    """Row and column of a number, of the shortest row; of another entry if none is a number.

    Numbers that are small beside others of their row come last.
    """
    candidates = []
    for i in remaining:
        numbers = {j: abs(x) for j, e in rows[i].items() if is_constant(e) and (x := rational(e))}
        largest = max(numbers.values(), default=0)
        candidates += [(_SMALL * largest > x, len(rows[i]), i, j) for j, x in numbers.items()]
    if not candidates and any_entry:
        candidates = [(False, len(rows[i]), i, j) for i in remaining for j in rows[i]]
    return min(candidates)[2:] if candidates else None


def _by_cramer(
    rows: list[dict[int, ca.SX]], sides: list[ca.SX], remaining: list[int], gone: set[int], n: int
) -> dict[int, ca.SX]:
    columns = [j for j in range(n) if j not in gone]
    if not remaining:
        return {}
    matrix = ca.SX.zeros(len(remaining), len(remaining))
    for k, i in enumerate(remaining):
        for j, entry in rows[i].items():
            matrix[k, columns.index(j)] = entry
    whole, solution = ca.det(matrix), {}
    for k, j in enumerate(columns):
        replaced = ca.SX(matrix)
        replaced[:, k] = ca.vertcat(*(sides[i] for i in remaining))
        solution[j] = ca.det(replaced) / whole
    return solution


POINTS = 8  # of the parameters at which a solution is looked at
SAME = 1e-9  # relative, of numbers that stand for the same
_ZERO = 1e-12
_MISSED = 1e-11  # of the terms of an equation
_MOST_POWER = 4
_OR_FIT = "; or take rational fits with a guaranteed bound (fit=1e-6)."
_NO_EQUILIBRIUM = (
    "no equilibrium was found{}; what misses most, over its terms with unknowns: {}. Give other inputs, "
    "leave an input free (free=...), or give start values near an equilibrium; start_point, or --at "
    "start for a Modelica model, linearizes at the start values, without an equilibrium."
)


class Balance(NamedTuple):
    """0 = residual(z, p): equations with their places for messages, and the quantities z."""

    residual: ca.SX
    places: tuple[str, ...]
    quantities: tuple[Quantity, ...]
    missing: str = _NO_EQUILIBRIUM  # what to say if there is no solution, and what to try
    rates: Mapping[str, ca.SX] = MappingProxyType({})  # those that are held; others are zero
    near: Mapping[str, float] = MappingProxyType({})  # a solution with more unknowns

    @property
    def z(self) -> ca.SX:
        return column_of(q.symbol for q in self.quantities)


def no_solution(s: Structure, problem: Balance, at: Found, fixed: Mapping[str, float | str]) -> TrimError:
    """What to say where a point misses equations."""
    given = f" with {', '.join(f'{k} = {v}' for k, v in fixed.items())}" if fixed else ""
    said = at.explained(problem.places, problem.residual, problem.z)
    return TrimError(f"{s.owner}: {problem.missing.format(given, said)}")


def solved_exactly(
    s: Structure, problem: Balance, solution: Array, unsolved: list[tuple[int, int]] | None = None
) -> dict[str, ca.SX]:
    """Each unknown as an expression of the parameters; `solution` are its values at points.

    Rows and columns of blocks that have no rational solution, and of those that depend on them, are added
    to `unsolved`; without it that is an error.
    """
    solved: dict[str, ca.SX] = {}
    if not problem.quantities:
        return solved
    of_symbol = {q.symbol.element_hash(): q.name for q in problem.quantities}
    for block in blocks_of(ca.jacobian_sparsity(problem.residual, problem.z)):
        rows = problem.residual[list(block.rows)]
        used = [(x, of_symbol.get(x.element_hash(), "")) for x in ca.symvar(rows)]
        known = [(x, solved[name]) for x, name in used if name in solved]
        part = Balance(
            ca.substitute(rows, *(column_of(x[k] for x in known) for k in (0, 1))),
            tuple(problem.places[i] for i in block.rows),
            tuple(problem.quantities[j] for j in block.columns),
        )
        pairs = list(zip(block.rows, block.columns, strict=True))
        if unsolved is not None and any(
            ca.depends_on(part.residual, problem.quantities[j].symbol) for _, j in unsolved
        ):
            unsolved += pairs
            continue
        try:
            values = _block(s, part, solution[:, list(block.columns)])
        except NotRationalError:
            if unsolved is None:
                raise
            unsolved += pairs
            continue
        solved |= {q.name: value for q, value in zip(part.quantities, values, strict=True)}
    return solved


def at_points(s: Structure, problem: Balance, fixed: Mapping[str, float | str]) -> Array:
    """Numbers (points, unknowns) at nominal and at other values of the parameters."""
    start, sizes = start_of(problem.quantities)
    system = System(problem.residual, problem.z, s.dae.p)
    points = np.array(parameter_points(s.dae, POINTS))
    second = partial(s.near_start, problem.quantities, problem.near)
    found = [solve(system, start, points[0], sizes, second)]
    if found[0].is_solution:
        found += follow_all(system, found[0].values, points[0], points[1:], sizes)
    if not found[-1].is_solution:
        raise no_solution(s, problem, found[-1], fixed)
    return np.array([at.values for at in found])


def _block(s: Structure, block: Balance, values: Array) -> list[ca.SX]:
    """The unknowns of one block as expressions of the parameters; `values` (points, n) are theirs."""
    residual, places, quantities, *_ = block
    slopes, n = ca.jacobian(residual, block.z), len(quantities)
    if not ca.depends_on(slopes, block.z):
        offset = ca.substitute(residual, block.z, ca.SX.zeros(n))
        if not ca.sparsify(offset).nnz():
            return [ca.SX(0)] * n
        if n == 1:
            return [-offset / slopes]
        if not ca.depends_on(ca.vertcat(residual), s.dae.p):
            numbers = [in_digits(x) for x in values[0]]
            sizes = zip(values[0], quantities, strict=True)
            zeros = [abs(x) <= _ZERO * q.variable.size for x, q in sizes]
            cleaned = [ca.SX(0) if zero else x for x, zero in zip(numbers, zeros, strict=True)]
            return cleaned if _holds(s, block, cleaned) else numbers
        return solved_linear(slopes, -offset)
    for least in (SAME, 0.0):  # what is small may be a number in other units
        guessed = _guessed(s, block, values, least)
        if guessed is not None:
            return guessed
    names, others = listed(q.name for q in quantities), operations_beyond(residual, FITTED)
    source = "leave an input free instead" if s.inputs else "make an input of a term, which is left free"
    raise NotRationalError(
        f"{s.owner}, trim: {names} depend on the parameters, and the equations {listed(places)} "
        "are not linear in them, so no rational solution was found. Declare one of them as a parameter "
        f"and {source} (at={{'name': 'parameter'}}, free=['input']), which is exact"
        + (f"; rational fits have no rule for {listed(others)}." if others else _OR_FIT)
    )


def _guessed(s: Structure, block: Balance, values: Array, least: float) -> list[ca.SX] | None:
    """Unknowns that are numbers or monomials of parameters by their values, and what follows from them.

    Values up to `least` of their nominal size are zero. The equations have to hold with them, at many
    points and to rounding.
    """
    residual, places, quantities, *_ = block
    p = np.array(parameter_points(s.dae, len(values)))
    guesses = {
        q.name: _monomial(s, values[:, k], p, least * q.variable.size) for k, q in enumerate(quantities)
    }
    known = {name: value for name, value in guesses.items() if value is not None}
    missing = [k for k, q in enumerate(quantities) if q.name not in known]
    if missing:
        if len(missing) == len(quantities):
            return None
        old = column_of([q.symbol for q in quantities if q.name in known])
        reduced = ca.substitute(residual, old, column_of(known.values()))
        slopes = in_doubles(ca.jacobian(reduced, block.z[missing]))
        function = ca.Function("slopes", [block.z, s.dae.p], [ca.densify(slopes)])
        J = function(values[0], p[0]).full()
        rows = independent(J.T, np.zeros(len(J), dtype=int))
        if len(rows) < len(missing):
            return None
        chosen = tuple(quantities[k] for k in missing)
        problem = Balance(reduced[rows], tuple(places[i] for i in rows), chosen)
        try:
            known |= solved_exactly(s, problem, values[:, missing])
        except NotRationalError:
            return None
    solution = [known[q.name] for q in quantities]
    return solution if _holds(s, block, solution) else None


def _monomial(s: Structure, values: Array, points: Array, least: float) -> ca.SX | None:
    """Zero up to a size, or a number times integer powers of parameters that are no angles; else None."""
    size = np.max(np.abs(values))
    if size <= least:
        return ca.SX(0)
    if np.min(np.abs(values)) <= SAME * size or len({*np.sign(values)}) > 1:
        return None
    usable = [k for k, r in enumerate(s.dae.parameters) if not r.is_angle and np.all(points[:, k])]
    logs = np.log(np.abs(points[:, usable]))
    matrix = np.hstack([np.ones((len(values), 1)), logs])
    powers = np.rint(np.linalg.lstsq(matrix, np.log(np.abs(values)), rcond=None)[0][1:])
    if np.any(np.abs(powers) > _MOST_POWER):
        return None
    factor = values / np.exp(logs @ powers) if len(usable) else values
    if np.max(np.abs(factor - factor[0])) > SAME * abs(factor[0]):
        return None
    signs = np.prod([np.sign(points[0, k]) ** n for k, n in zip(usable, powers, strict=True)])
    expression = in_digits(float(factor[0] * signs))
    for k, n in zip(usable, powers, strict=True):
        for _ in range(abs(int(n))):
            expression = expression * s.dae.p[k] if n > 0 else expression / s.dae.p[k]
    return ca.SX(expression)


def _holds(s: Structure, block: Balance, solution: Sequence[ca.SX]) -> bool:
    """Whether equations hold exactly, or at values of the parameters that were not looked at before."""
    expressions, z = column_of(solution), block.z
    missed = ca.substitute(block.residual, z, expressions)
    if cancels(missed):
        return True
    slopes = ca.substitute(ca.jacobian(block.residual, z), z, expressions)
    slopes, expressions = (ca.densify(in_doubles(x)) for x in (slopes, expressions))
    function = ca.Function("slopes", [s.dae.p], [slopes, expressions])
    of_terms = ca.Function("missed", [s.dae.p], [ca.densify(in_doubles(missed))])
    points = np.array(parameter_points(s.dae, 4 * POINTS)[1:])
    for p, terms in zip(points, term_sizes(of_terms, points), strict=True):
        r, (J, at) = np.abs(of_terms(p).full()[:, 0]), (np.abs(x.full()) for x in function(p))
        with np.errstate(invalid="ignore"):  # an infinite slope at zero has no size
            sizes = np.fmax(terms, np.max(J * at[:, 0], axis=1))
        if not np.all(r <= _MISSED * sizes):
            return False
    return True


_SMALLEST = 1e-9  # of the nominal size of a variable: a value below this has that size


class CoefficientFit(NamedTuple):
    """A rational fit of a coefficient.

    Attributes
    ----------
    expression : SX
        Rational in the parameters, to be written in place of the coefficient.
    text : str
        The same.
    bound : float
        Proved bound of the error for all values of the parameters, in the unit of the coefficient.
    """

    expression: ca.SX
    text: str
    bound: float


@arguments_checked
def fit_coefficient(
    coefficient: ca.SX, parameters: Sequence[Parameter], symbols: Sequence[ca.SX], tolerance: float
) -> CoefficientFit:
    """A rational function near a coefficient such as sqrt(p), with a proved bound over the whole range.

    Parameters
    ----------
    coefficient : SX
        + - * /, integer powers, sqrt, sin, cos and tan of symbols of parameters that are no angles.
    parameters, symbols : sequences of Parameter and SX
    tolerance : float
        Largest bound, in the unit of the coefficient.

    Raises
    ------
    SceneError
        The coefficient has another symbol, or is a number.
    NotRationalError
        It depends on an angle, or has an operation that cannot be bounded, such as exp.
    TrimError
        The tolerance is not met.
    """
    expression = ca.SX(coefficient)
    known = {s.element_hash(): p for s, p in zip(symbols, parameters, strict=True)}
    free = free_symbols(expression)
    for s in free:
        if s.element_hash() not in known:
            raise SceneError(f"fit of {expression}: {s.name()!r} is no parameter.")
        if known[s.element_hash()].is_angle:
            raise NotRationalError(f"fit of {expression}: {s.name()!r} is an angle, in sin and cos only.")
    if not free:
        raise SceneError(f"fit of {expression}: it has no parameters, and is a number.")
    used = [known[s.element_hash()] for s in free]
    p, t, value = column_of(free), ca.SX.sym("t"), in_doubles(expression)
    start = values_of([value], p, _nominal(used))
    residual = ca.Function("coefficient", [t, p], [t - value])
    with naming(f"fit of {expression}", TrimError):
        fits, (made,) = _fits(residual, used, free, start, tolerance)
    return CoefficientFit(made, fits.expressions[0], float(fits.bound[0]))


def _nominal(parameters: Sequence[Parameter]) -> Array:
    return np.array([p.nominal for p in parameters])


def _fits(
    residual: ca.Function,
    parameters: Sequence[Parameter],
    symbols: Sequence[ca.SX],
    start: Array,
    tolerance: float,
) -> tuple[EquilibriumFit, list[ca.SX]]:
    """Fits of what solves 0 = residual(t, p) near a start at nominal p, and their expressions."""
    fits = fit_equilibrium(
        residual,
        _nominal(parameters),
        np.array([p.low for p in parameters]),
        np.array([p.high for p in parameters]),
        start,
        tolerance,
        names=[p.name for p in parameters],
    )
    values = {p.name: symbol for p, symbol in zip(parameters, symbols, strict=True)}
    texts = fits.expressions
    return fits, [ca.SX(evaluate(parse(text), values, lambda x: ca.SX(literal(x)))) for text in texts]


class Fitted(NamedTuple):
    """What was fitted: expressions of the parameters."""

    values: Mapping[str, ca.SX]  # by names of unknowns
    slopes: Mapping[tuple[int, int], ca.SX]  # of [residual ; outputs] by [unknowns ; states ; inputs]
    bound: float  # proved, of all errors, each relative to the size of its quantity


def fitted(
    s: Structure,
    problem: Balance,
    unsolved: Sequence[tuple[int, int]],
    at_nominal: Array,
    values: Mapping[str, ca.SX],
    tolerance: float,
) -> Fitted:
    """Fits of the unknowns at `unsolved` (row, column) of a problem, and of slopes that are not rational.

    `at_nominal` (n,) are all unknowns of the problem at nominal parameters; `values` are all others.
    """
    z = [problem.quantities[j] for _, j in unsolved]
    known = [q for q in s.quantities if q.name in values]
    old = column_of([q.symbol for q in known])
    new = column_of([values[q.name] for q in known])
    rows = column_of(problem.residual[i] for i, _ in unsolved)
    rows = ca.SX(ca.substitute(rows, old, new))
    places, entries = _slopes(s, old, new)
    if others := operations_beyond(ca.vertcat(rows, *entries), FITTED):
        raise NotRationalError(
            f"{s.owner}, fit of the equilibrium: {listed(others)} has no rule in rational fits, which "
            "take + - * /, whole powers, sqrt, sin, cos and tan."
        )
    if not z and not entries:
        return Fitted({}, {}, 0.0)
    symbols = [q.symbol for q in z]
    start = at_nominal[[j for _, j in unsolved]]
    sizes = [
        abs(x) if abs(x) > _SMALLEST * q.variable.size else q.variable.size
        for x, q in zip(start, z, strict=True)
    ]
    used, p = _parameters(s, [rows, *entries])
    slopes = values_of(entries, column_of([*symbols, *p]), np.concatenate([start, _nominal(used)]))
    sizes += [abs(x) if x else 1.0 for x in slopes]
    t = ca.SX.sym("t", len(sizes))
    scaled = [t[k] * size for k, size in enumerate(sizes[: len(z)])]
    both = ca.vertcat(
        _of_one_size(rows, column_of(symbols), p, start, sizes, used),
        *(t[len(z) + k] - e / sizes[len(z) + k] for k, e in enumerate(entries)),
    )
    residual = ca.substitute(in_doubles(both), column_of(symbols), column_of(scaled))
    name = s.dae.name.replace(".", "_") or "model"
    function = ca.Function(name, [t, column_of(p)], [residual])
    small = listed(
        q.name for x, q in zip(start, z, strict=True) if 0 < abs(x) <= _SMALLEST * q.variable.size
    )
    with naming(f"{s.owner}{small and f', {small} without a `nominal` of its size'}", TrimError):
        fits, made = _fits(function, used, p, np.concatenate([start, slopes]) / sizes, tolerance)
    made = [value * literal(float(size)) for value, size in zip(made, sizes, strict=True)]
    return Fitted(
        {q.name: value for q, value in zip(z, made, strict=False)},
        dict(zip(places, made[len(z) :], strict=True)),
        float(np.max(fits.bound)),
    )


def _of_one_size(
    rows: ca.SX,
    unknown: ca.SX,
    p: Sequence[ca.SX],
    start: Array,
    sizes: Sequence[float],
    used: Sequence[Parameter],
) -> ca.SX:
    """Rows over powers of two, with which their slopes by the scaled unknowns are of size 1."""
    arguments, at = column_of([unknown, *p]), np.concatenate([start, _nominal(used)])
    slopes = ca.Function("slopes", [arguments], [ca.jacobian(in_doubles(rows), unknown)])(at).full()
    largest = np.max(np.abs(slopes) * np.array(sizes[: len(start)]), axis=1, initial=0.0)
    powers = np.exp2(-np.floor(np.log2(np.where(largest > 0.0, largest, 1.0))))
    return column_of(rows[k] * float(power) for k, power in enumerate(powers))


def _slopes(s: Structure, old: ca.SX, new: ca.SX) -> tuple[list[tuple[int, int]], list[ca.SX]]:
    """Places and values of entries of the Jacobian that are not rational in what is left and p."""
    stacked = ca.vertcat(s.residual, *(y.expression for y in s.dae.outputs))
    J = ca.SX(ca.sparsify(ca.substitute(ca.jacobian(stacked, s.symbols), old, new)))
    every = zip(*J.sparsity().get_triplet(), strict=True)
    places = [(i, j) for i, j in every if operations_beyond(J[i, j], RATIONAL)]
    return places, [J[i, j] for i, j in places]


def _parameters(s: Structure, expressions: Sequence[ca.SX]) -> tuple[list[Parameter], list[ca.SX]]:
    """The parameters that expressions depend on, and their symbols."""
    stacked = ca.vertcat(*expressions)
    every = zip(s.dae.parameters, ca.vertsplit(s.dae.p), strict=True)
    pairs = [(p, symbol) for p, symbol in every if ca.depends_on(stacked, symbol)]
    angles = [p.name for p, _ in pairs if p.is_angle]
    if angles:
        raise NotRationalError(
            f"{s.owner}, fit of the equilibrium: it depends on the angle {angles[0]}; fits are of "
            "parameters that are no angles."
        )
    if not pairs:
        raise TrimError(f"{s.owner}, fit of the equilibrium: it depends on no parameter.")
    return [p for p, _ in pairs], [symbol for _, symbol in pairs]
