"""The front end for DAEs: from a structure to the problem that the pipeline solves."""

from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext
from functools import partial
from keyword import iskeyword
from typing import NamedTuple

import casadi as ca
import numpy as np

from mbdlft.base.array import Array
from mbdlft.base.errors import AnalysisError, StructureError
from mbdlft.base.parameter import DIVISORS, to_internal
from mbdlft.base.samples import SEED, check_points
from mbdlft.base.unit import Signal, parse_unit
from mbdlft.dae.newton import System, solve, values_of
from mbdlft.dae.structure import Structure, check_point, in_symbols, parameter_points, start_of
from mbdlft.dae.text import column_of, formula_of
from mbdlft.dae.theta.form import ThetaForm, signals_of, theta_form
from mbdlft.dae.theta.separation import Arrange
from mbdlft.problem.equations import rows_of
from mbdlft.problem.references import reference_of_relations
from mbdlft.problem.relations import Form, LinearModel, Nouns, Problem, Reference, Stage, TrimRelations
from mbdlft.problem.sx.constants import in_doubles
from mbdlft.system.theta import ThetaFunction

_SEPARATED = 1e-9  # of the terms of an equation
_LEAST = 1e-3  # size of terms that errors are relative to at least
_POINTS, _SEED = 5, 3


class Separated(NamedTuple):
    """A problem, the functions that its linear part leaves open, and a consistent point."""

    problem: Problem
    functions: tuple[ThetaFunction, ...]
    has_one: bool
    initial: tuple[float, ...]
    zeta: tuple[float, ...]
    shifted: tuple[str, ...]


def problem_of_dae(
    s: Structure, arrange: Arrange = "fewest", stage: Stage = lambda name: nullcontext()
) -> Separated:
    """The linear part of a DAE as a problem, and its nonlinear functions."""
    with stage("separate"):
        at = consistent_point(s)
        check_point(s, at[: len(s.quantities)])
        form = theta_form(s, arrange, at)
        check_separation(s, form, at)
        inputs, outputs = signals_of(s, form)
        units = {signal.name: signal.unit for signal in inputs}
        functions = theta_functions(s, form, units)
    n = s.unknown.numel()
    problem = problem_of(
        s,
        form.relations,
        (inputs, outputs),
        partial(reference_of_relations, form.relations, owner=s.owner),
        ("the equations", "the linear part does"),
    )
    states = tuple(at[n : n + len(s.states)].tolist())
    zeta = tuple(_Closed(s, form).zeta_at(at[:n], at[n:])[1].tolist())
    return Separated(problem, functions, bool(form.one.numel()), states, zeta, form.shifted)


def problem_of(
    s: Structure,
    relations: LinearModel,
    signals: tuple[tuple[Signal, ...], tuple[Signal, ...]],
    reference: Callable[[Array], Reference],
    words: tuple[str, str],
    trim: TrimRelations | None = None,
    fit_bound: float = 0.0,
) -> Problem:
    """The problem of relations; `words` say what is true, and what is singular where it is."""
    points = check_points(s.dae.parameters, SEED)
    truth, singular = words
    return Problem(
        nouns=Nouns(
            "model",
            s.dae.name,
            truth,
            "its numbers are so different in size that double precision does not carry them",
        ),
        description=s.dae.description,
        text=s.source.text or text_of(s),
        states=tuple(Signal(q.name, q.unit) for q in s.states),
        inputs=signals[0],
        outputs=signals[1],
        parameters=s.dae.parameters,
        forms=(Form(relations),),
        points=points,
        reference=partial(reference, points),
        fit_error_bound=max(s.source.fit_error_bound, fit_bound),
        singular=lambda number, names: (
            f"{singular} not determine the unknowns at nominal (condition {number:.0e})."
        ),
        trim=trim,
    )


def consistent_point(s: Structure, p: Array | None = None) -> Array:
    """Values of [unknowns ; states ; inputs ; p] where the equations hold, nominal parameters by default.

    Variables that are fixed have their start values, and the initial equations hold; the others are near
    their start values.
    """
    quantities = [*s.unknowns, *s.states]
    _, sizes = start_of(quantities)
    p = parameter_points(s.dae, 1)[0] if p is None else p
    starts = [
        q.start if q.order or q.variable.start_of is None else q.variable.start_of
        for q in (*quantities, *s.inputs)
    ]
    start, u = np.split(values_of([ca.SX(x) for x in starts], s.dae.p, p), [len(quantities)])
    symbols = ca.vertcat(s.unknown, s.x)
    fixed = [k for k, q in enumerate(quantities) if q.variable.fixed and not q.order]
    free = [k for k in range(len(quantities)) if k not in {*fixed}]
    places = [*(place for place, _ in s.equations), *(e.place for e in s.dae.initial)]
    residual = ca.vertcat(s.residual, *(e.residual for e in s.dae.initial))
    knowns = ca.vertcat(s.u, s.dae.p, *(symbols[k] for k in fixed))
    system = System(residual, rows_of(symbols, free), knowns)
    point = solve(system, start[free], np.concatenate([u, p, start[fixed]]), sizes[free])
    if not point.is_solution:
        worst = int(np.argmax(point.missing))
        raise StructureError(
            f"{s.owner}: no consistent initial point was found; equation {places[worst]} is "
            f"missed by {point.missing[worst]:.1e} of its terms. Give start values near a solution, or "
            "fix fewer of them."
        )
    start[free] = point.values
    return np.concatenate([start, u, p])


def check_separation(s: Structure, form: ThetaForm, at: Array) -> float:
    """Largest difference of the relations, closed with the functions, from the equations at points.

    The points are around a consistent one, with random parameters. At each the unknowns of the DAE are
    taken from a solution of its equations; the relations have to hold there, too.
    """
    drawn = np.random.default_rng(_SEED)
    n, nx = s.unknown.numel(), len(s.states)
    system = System(s.residual, s.unknown, ca.vertcat(s.x, s.u, s.dae.p))
    sizes = np.array([q.variable.size for q in s.unknowns])
    relations = _Closed(s, form)
    worst = 0.0
    for k in range(_POINTS):
        knowns = at[n:].copy()
        if k:
            spread = np.array([q.variable.size for q in (*s.states, *s.inputs)])
            knowns[: len(spread)] += 0.1 * k * spread * drawn.uniform(-1, 1, len(spread))
            physical = np.array([[drawn.uniform(p.low, p.high) for p in s.dae.parameters]])
            knowns[nx + len(s.inputs) :] = in_symbols(s.dae, physical)[0] if physical.size else []
        point = solve(system, at[:n], knowns, sizes)
        if point.is_solution:
            worst = max(worst, relations.error(point.values, knowns))
    if not worst <= _SEPARATED:
        raise AnalysisError(
            f"{s.owner}: the Delta-Theta form differs from the equations by {worst:.1e}. This is a bug: "
            "please report the model."
        )
    return worst


class _Closed:
    """Relations with the functions put in, at values of the signals of the DAE."""

    def __init__(self, s: Structure, form: ThetaForm) -> None:
        self.s = s
        self.p = form.relations.p
        m, unknowns = form.relations, {q.element_hash() for q in ca.vertsplit(s.unknown)}
        fresh = [q for q in ca.vertsplit(m.unknown) if q.element_hash() not in unknowns]
        psi = [expression for _, _, expression in form.arguments]
        symbols = [symbol for _, symbol, _ in form.arguments]
        zeta = [expression for _, expression, _ in form.functions]
        self.free = ca.vertcat(s.unknown, s.x, s.u, m.p)
        self.zeta, self.symbols = column_of(form.zeta), column_of(symbols)
        knowns = ca.vertcat(self.free, form.one)
        self.psi = ca.Function("psi", [knowns, self.zeta], [ca.densify(in_doubles(column_of(psi)))])
        self.theta = ca.Function("theta", [self.symbols], [ca.densify(in_doubles(column_of(zeta)))])
        residual = in_doubles(m.residual)
        output = in_doubles(column_of(ca.vertsplit(m.output)[: len(s.dae.outputs)]))
        true = in_doubles(column_of(y.expression for y in s.dae.outputs))
        # rates that have a symbol of their own
        values = [
            s.rates[k]
            for k, q in enumerate(ca.vertsplit(m.unknown)[: m.derivatives])
            if q.element_hash() not in unknowns
        ]
        stacked = ca.vertcat(residual, output - self._of_internal(true))
        stacked = ca.substitute(stacked, column_of(fresh), column_of(values))
        arguments = [knowns, self.zeta]
        self.residual = ca.Function("relations", arguments, [ca.densify(stacked)])
        self.slopes = ca.Function(
            "slopes", arguments, [ca.jacobian(stacked, ca.vertcat(knowns, self.zeta))]
        )
        self.ones = np.ones(form.one.numel())

    def _of_internal(self, expression: ca.SX) -> ca.SX:
        """An expression with angles in terms of their internal values."""
        dae, p = self.s.dae, self.p
        for k, q in enumerate(dae.parameters):
            if q.is_angle:
                angle = q.reference + DIVISORS[q.substitution] * ca.atan(p[k])
                expression = ca.substitute(expression, dae.p[k], angle)
        return expression

    def zeta_at(self, unknown: Array, knowns: Array) -> tuple[Array, Array]:
        """All values that the functions need, and those of the functions."""
        dae = self.s.dae
        count = len(knowns) - len(dae.parameters)
        internal = []
        for parameter, value in zip(dae.parameters, knowns[count:], strict=True):
            factor = parse_unit(parameter.unit).factor if parameter.is_angle else 1.0
            internal.append(float(to_internal(parameter, value / factor)))
        at = np.concatenate([unknown, knowns[:count], internal, self.ones])
        zeta = np.zeros(self.zeta.numel())
        for _ in range(len(zeta) + 1):  # functions of functions
            after = self.theta(self.psi(at, zeta)).full()[:, 0]
            if np.array_equal(after, zeta):
                break
            zeta = after
        return at, zeta

    def error(self, unknown: Array, knowns: Array) -> float:
        """Largest residual relative to its terms."""
        at, zeta = self.zeta_at(unknown, knowns)
        residual = self.residual(at, zeta).full()[:, 0]
        J = np.abs(self.slopes(at, zeta).full())
        scale = np.max(J * np.abs(np.concatenate([at, zeta])), axis=1, initial=0.0)
        return float(np.max(np.abs(residual) / np.maximum(scale, _LEAST), initial=0.0))


def theta_functions(s: Structure, form: ThetaForm, units: Mapping[str, str]) -> tuple[ThetaFunction, ...]:
    """The functions as texts, with ranges of arguments that are variables."""
    variables = {q.name: q.variable for q in s.quantities if not q.order}
    functions = []
    for name, expression, used in form.functions:
        signals = tuple(form.arguments[a][0] for a in used)
        names = _identifiers(signals)
        text, tables = formula_of(expression, [form.arguments[a][1] for a in used], names)
        limits = [variables.get(omega.removeprefix("omega.")) for omega in signals]
        ranges = [(-np.inf, np.inf) if v is None else (v.minimum, v.maximum) for v in limits]
        floats = tuple((float(a), float(b)) for a, b in ranges)
        functions.append(ThetaFunction(name, signals, names, text, floats, units[name], tables))
    return tuple(functions)


def _identifiers(names: Sequence[str]) -> tuple[str, ...]:
    names_made: list[str] = []
    for name in names:
        plain = "".join(c if c.isalnum() else "_" for c in name.removeprefix("omega.")).strip("_")
        plain = plain if plain and not plain[0].isdigit() else f"a_{plain}"
        if name.startswith("omega") and not name.startswith("omega."):
            plain = f"a{name.removeprefix('omega')}"
        while plain in names_made or iskeyword(plain):  # formulas are read as Python's own
            plain += "_"
        names_made.append(plain)
    return tuple(names_made)


def text_of(s: Structure) -> str:
    """The equations as they are, one a line."""
    lines = [f"{place}: 0 = {in_doubles(residual)}" for place, residual in s.equations]
    return "\n".join([f"model {s.dae.name}", *lines])
