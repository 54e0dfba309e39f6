"""What is not rational in the parameters, replaced by fits with a proved bound: coefficients, equilibria.

What blocks of equations do not give of an equilibrium exactly is fitted together: the unknowns z of these
blocks, and those entries of the Jacobian that are not rational in z and p, as unknowns of their own. So
the bound counts everything that the linear model is made of, each relative to its size.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import casadi as ca
import numpy as np

from mbdlft.base.array import Array
from mbdlft.base.errors import NotRationalError, SceneError, TrimError
from mbdlft.base.expression import evaluate, parse
from mbdlft.base.parameter import Parameter
from mbdlft.dae.balance import Balance
from mbdlft.dae.newton import values_of
from mbdlft.dae.structure import Structure
from mbdlft.dae.text import column_of, free_symbols
from mbdlft.multibody.equilibrium.fit import EquilibriumFit, fit_equilibrium
from mbdlft.problem.sx.constants import in_doubles, is_constant, literal
from mbdlft.problem.sx.tapes import steps

_RATIONAL = {"input", "output", "const", "assign", "add", "sub", "mul", "div", "neg", "sq", "twice"}
_RATIONAL |= {"inv", "constpow", "pow"}
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
    made = [evaluate(parse(text), values, lambda x: ca.SX(literal(x))) for text in fits.expressions]
    return fits, [ca.SX(expression) for expression in made]


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
    if not z and not entries:
        return Fitted({}, {}, 0.0)
    symbols = [q.symbol for q in z]
    start = at_nominal[[j for _, j in unsolved]]
    sizes = [
        abs(x) if abs(x) > _SMALLEST * q.variable.nominal else q.variable.nominal
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
    places = [(i, j) for i, j in every if not is_rational(J[i, j])]
    return places, [J[i, j] for i, j in places]


def is_rational(expression: ca.SX) -> bool:
    """Whether an expression has + - * / and powers of its symbols only; functions of numbers pass."""
    if is_constant(expression):
        return True
    function = ca.Function("f", [column_of(ca.symvar(expression))], [ca.densify(expression)])
    return all(name in _RATIONAL for name, _, _ in steps(function))


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
