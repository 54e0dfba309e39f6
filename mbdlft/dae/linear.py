"""The linear model of a DAE around an equilibrium, parameters left in: its problem for the pipeline.

Functions that switch (|x|, sign(x), min, max, floor, ceil, comparisons and the branches of `if`) have an
argument s that decides the branch, as x does of |x|, and a - b of max(a, b). Where s has one sign, at an
equilibrium or on the whole range of the parameters, the branch takes the place of the function. Where s
is zero at the equilibrium, both branches are compared there: if values and slopes are equal, either is
right; otherwise there is no linear model, and an error says which equation has which two slopes.
"""

from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import replace
from functools import partial
from typing import Literal, NamedTuple

import casadi as ca
import numpy as np

from mbdlft.base.array import Array
from mbdlft.base.errors import NotRationalError, TrimError, WellPosednessError
from mbdlft.base.unit import Signal
from mbdlft.dae.equilibria import DaeTrim
from mbdlft.dae.newton import System, follow, values_of
from mbdlft.dae.structure import Structure, at_odd_parameters, in_symbols, parameter_points
from mbdlft.dae.text import ARITHMETIC_OF_SX, FUNCTIONS, column_of, unsupported
from mbdlft.dae.theta.arguments import Mixed
from mbdlft.dae.theta.separation import Separation
from mbdlft.dae.to_problem import problem_of
from mbdlft.exact.interval import FUNCTIONS as OF_INTERVALS
from mbdlft.exact.interval import Interval, decimal, find_zero
from mbdlft.problem.equations import rows_of
from mbdlft.problem.references import column_of_entries, entry_scale, reference_of_relations
from mbdlft.problem.relations import LinearModel, Problem, Reference, Stage, TrimRelations
from mbdlft.problem.sx.constants import in_doubles, is_constant, is_zero, numbers_of
from mbdlft.problem.sx.tapes import Rules, arithmetic, evaluate_many, fold

_AMPLIFIED, _ROUNDING = 1e4, 1e-9  # how much larger than fits errors of the linear model may be
_LOOKED_AT = 4  # points at which sizes of trimmed quantities are taken


def problem_of_trim(at: DaeTrim, stage: Stage = lambda name: nullcontext()) -> Problem:
    """The linearized equations of a DAE at an equilibrium, rational in the parameters."""
    s = at.structure
    with stage("linearize"):
        linear = _Linear(at)
        relations = linear.relations()
    trimmed = linear.trimmed()
    signals = [tuple(Signal(x.name, x.unit) for x in every) for every in (s.inputs, s.dae.outputs)]
    return problem_of(
        s,
        relations,
        (signals[0], signals[1]),
        partial(_reference, at, relations, trimmed),
        ("the nonlinear equations", "the linearized equations do"),
        trimmed,
        at.fit_bound,
    )


class _Linear:
    """Slopes at an equilibrium, followed so that what is not rational is named."""

    def __init__(self, at: DaeTrim) -> None:
        self.at, self.s = at, at.structure
        dae = self.s.dae
        stacked = ca.vertcat(self.s.residual, *(y.expression for y in dae.outputs))
        places = [f"equation {place}" for place, _ in self.s.equations]
        places += [f"output {y.name!r}" for y in dae.outputs]
        self.stacked = without_switches(at, stacked, places)
        every = ca.vertcat(self.stacked, *at.values.values())
        self.separation = Separation(dae, every, "fewest")
        self.internal = self.separation.internal

    def relations(self) -> LinearModel:
        """Linear relations with small changes of unknowns, states and inputs."""
        s = self.s
        small = column_of([ca.SX.sym(f"d {q.name}") for q in s.quantities])
        moved = self._moved(self.stacked, small)
        count = len(s.equations)
        equations = self.separation.equations(s, moved[:count], moved[count:], small)
        return LinearModel(
            residual=column_of(map(_linear, equations.relations)),
            output=column_of(map(_linear, equations.outputs)),
            unknown=equations.unknown,
            known=small[len(s.unknowns) :],
            p=self.internal,
            parameters=s.dae.parameters,
            derivatives=equations.derivatives,
        )

    def _moved(self, stacked: ca.SX, small: ca.SX) -> ca.SX:
        """What small changes make of expressions, at the equilibrium."""
        symbols, values = self.s.symbols, _expressions(self.at)
        if not self.at.slopes:
            return ca.SX(ca.substitute(ca.jtimes(stacked, symbols, small), symbols, values))
        J = ca.SX(ca.substitute(ca.jacobian(stacked, symbols), symbols, values))
        for (i, j), value in self.at.slopes.items():
            J[i, j] = value
        return ca.SX(ca.mtimes(J, small))

    def trimmed(self) -> TrimRelations | None:
        """What of the equilibrium depends on parameters, as relations that are solved already."""
        at, dae = self.at, self.s.dae
        named = [q for q in (*self.s.states, *self.s.unknowns, *self.s.inputs) if not q.order]
        chosen = [q for q in named if not self._is_number(at.values[q.name])]
        unknown, one = ca.SX.sym("trim", len(chosen)), ca.SX.sym("one")
        rows = []
        for k, q in enumerate(chosen):
            try:
                value = self.separation.follow(ca.SX(at.values[q.name]), f"trim of {q.name}", "trim")
            except NotRationalError:  # an angle that is a parameter
                continue
            rows.append(unknown[k] - (value.constant if value.constant is not None else 0) * one)
        if len(rows) < len(chosen) or not rows:
            return None
        relations = LinearModel(column_of(rows), ca.SX(0, 1), unknown, one, self.internal, dae.parameters)
        signals = tuple(Signal(q.name, q.unit) for q in chosen)
        return TrimRelations(relations, signals, tuple(at.nominal[q.name] for q in chosen))

    def _is_number(self, value: ca.SX) -> bool:
        """Whether a value has no parameters, or is zero whatever they are, as sums that cancel."""
        if is_constant(value):
            return True
        dae = self.s.dae
        if any(q.is_angle for q in dae.parameters):
            return False
        try:
            return is_zero(at_odd_parameters(dae, ca.SX(value)))
        except NotRationalError:  # a function of numbers
            return False


def _linear(value: Mixed) -> ca.SX:
    assert not value.terms
    return ca.SX(sum((p.coefficient * p.form for p in value.linear.values()), ca.SX(0)))


def trimmed_points(at: DaeTrim, points: Array) -> Array:
    """Numbers (N, n) of [unknowns ; states ; inputs] at physical points, each by Newton's method.

    The equations are those of the structure, the rates of the states are zero, and what was held or given
    is that.
    """
    s = at.structure
    expressions = _expressions(at)
    posed = {*at.given, *(q.name for q in s.inputs)} - {*at.free}
    moving = [bool(ca.symvar(in_doubles(expressions[k]))) for k in range(expressions.numel())]
    free = [k for k, q in enumerate(s.quantities) if q.name not in posed and moving[k]]
    values, p = _exact_values(at, points), in_symbols(s.dae, points)
    if not free:
        return values
    held = [k for k in range(expressions.numel()) if k not in free]
    held_symbols = ca.vertcat(rows_of(s.symbols, held), s.dae.p)
    sizes = np.array([q.variable.nominal for q in s.quantities])
    system = System(s.residual, s.symbols[free], held_symbols, sizes[held])
    nominal = np.array([at.nominal[q.name] for q in s.quantities])
    first = np.concatenate([nominal[held], parameter_points(s.dae, 1)[0]])
    for row, q in zip(values, p, strict=True):
        ends = first, np.concatenate([row[held], q])
        now = follow(system, nominal[free], ends, sizes[free])
        if not now.is_solution:
            raise TrimError(f"{s.owner}: no equilibrium was found at a point of the parameter range.")
        row[free] = now.values
    return values


def _expressions(at: DaeTrim) -> ca.SX:
    """Values of [unknowns ; states ; inputs] as expressions of the parameters."""
    return column_of(at.values[q.name] for q in at.structure.quantities)


def _exact_values(at: DaeTrim, points: Array) -> Array:
    """Numbers (N, n) of these expressions at physical points."""
    dae = at.structure.dae
    function = ca.Function("trim", [dae.p], [ca.densify(in_doubles(_expressions(at)))])
    return np.array([function(row).full()[:, 0] for row in in_symbols(dae, points)])


def trim_sizes(at: DaeTrim, points: Array, z: Array) -> Array:
    """Sizes (n,) of [unknowns ; states ; inputs] at equilibria z (N, n), with terms that cancel.

    A quantity is as large as what the terms of the equations, alone, make of it: rounding of the terms
    changes it by so much times the precision. It is not smaller than its largest value.
    """
    s = at.structure
    size = np.max(np.abs(z), axis=0, initial=0.0)
    inputs = {q.name for q in s.inputs} - {*at.free}
    free = [k for k, q in enumerate(s.quantities) if not q.order and q.name not in inputs]
    both = ca.vertcat(s.symbols, s.dae.p)
    slopes = ca.Function("slopes", [both], [ca.jacobian(in_doubles(s.residual), both)])
    nominal = np.array([s.quantities[k].variable.nominal for k in free])
    for row in np.hstack([z, in_symbols(s.dae, points)])[:_LOOKED_AT]:
        J = slopes(row).full()
        terms = np.abs(J) @ np.abs(row)  # none where all is zero: nothing is rounded
        columns = np.maximum(np.abs(row[free]), nominal)
        scaled = J[:, free] * columns
        norm = np.linalg.norm(scaled, axis=1)
        norm[norm == 0.0] = 1.0
        made = columns * (np.abs(np.linalg.pinv(scaled / norm[:, None])) @ (terms / norm))
        size[free] = np.maximum(size[free], made)
    return np.asarray(size)


def _reference(
    at: DaeTrim, relations: LinearModel, trimmed: TrimRelations | None, points: Array
) -> Reference:
    """The nonlinear equations, trimmed and linearized again with numbers at every point.

    Where the equilibrium is a fit, the relations at the fits; that they are near is looked at, too.
    """
    s = at.structure
    reference = reference_of_relations(relations, points, s.owner)
    z = trimmed_points(at, points)
    values = linearized(s, z, points)
    scale = entry_scale(values, len(s.states))
    if at.fit_bound:
        error = float(np.max(np.abs(reference.values - values) / scale, initial=0.0))
        if not error <= max(_AMPLIFIED * at.fit_bound, _ROUNDING):
            raise TrimError(
                f"{s.owner}: with fits within {at.fit_bound:.1e} the linear model is {error:.1e} from "
                "that of the equations: it is nearly singular at this equilibrium. Take a smaller "
                "tolerance (fit=...)."
            )
        numbers, sizes = _exact_values(at, points), np.max(np.abs(z), axis=0, initial=0.0)
    else:
        reference = replace(reference, values=values, scale=scale)
        numbers, sizes = z, trim_sizes(at, points, z)
    names = [q.name for q in s.quantities]
    chosen = [names.index(signal.name) for signal in trimmed.signals] if trimmed else []
    sizes = sizes[chosen]
    return replace(reference, trimmed=numbers[:, chosen], trim_scale=np.where(sizes > 0, sizes, 1.0))


def linearized(s: Structure, z: Array, points: Array) -> Array:
    """[A B ; C D] (N, ., .) of the nonlinear equations at z (N, n) = [unknowns ; states ; inputs]."""
    outputs = column_of([y.expression for y in s.dae.outputs])
    stacked = ca.vertcat(s.residual, outputs, column_of(s.rates))
    slopes = ca.sparsify(in_doubles(ca.jacobian(stacked, s.symbols)))
    where = slopes.sparsity().get_triplet()
    entries = ca.densify(column_of_entries(slopes))
    function = ca.Function("slopes", [s.symbols, s.dae.p], [entries])
    n = s.unknown.numel()
    matrices = []
    (every,) = evaluate_many(function, z, in_symbols(s.dae, points))
    for values in every:
        J = np.zeros(slopes.shape)
        J[where] = values[:, 0]
        try:
            solved = -np.linalg.solve(J[:n, :n], J[:n, n:])
        except np.linalg.LinAlgError:
            raise WellPosednessError(
                f"{s.owner}: the equations do not determine the unknowns at a point of the range."
            ) from None
        read = J[n:, n:] + J[n:, :n] @ solved
        count = len(s.dae.outputs)
        matrices.append(np.concatenate([read[count:], read[:count]]))
    return np.array(matrices)


Side = Literal["below", "above", "at", "open"]
_RANGES = arithmetic(decimal, OF_INTERVALS)
_NOTHING = 1e-12  # of the terms of a value in doubles: less is zero, as in solutions of equilibria


class _Switch(NamedTuple):
    """What decides, as a function of the operands, and the values below and above its zero."""

    argument: Callable[..., ca.SX]
    below: Callable[..., ca.SX]
    above: Callable[..., ca.SX]


def _difference(a: ca.SX, b: ca.SX) -> ca.SX:
    return a - b


_SWITCHES: Mapping[str, _Switch] = {
    "fabs": _Switch(lambda a: a, lambda a: -a, lambda a: a),
    "sign": _Switch(lambda a: a, lambda a: ca.SX(-1), lambda a: ca.SX(1)),
    "fmin": _Switch(_difference, lambda a, b: a, lambda a, b: b),
    "fmax": _Switch(_difference, lambda a, b: b, lambda a, b: a),
    "lt": _Switch(_difference, lambda a, b: ca.SX(1), lambda a, b: ca.SX(0)),
    "le": _Switch(_difference, lambda a, b: ca.SX(1), lambda a, b: ca.SX(0)),
}
_LOGIC = ("and", "or", "not")


class _Decided(NamedTuple):
    """A function that switches, in words, and on which side of its zero the equilibrium is."""

    text: str
    side: Side


def without_switches(at: DaeTrim, stacked: ca.SX, places: Sequence[str]) -> ca.SX:
    """Expressions (n, 1) near an equilibrium, with a branch in place of each function that switches.

    `places` (n,) name the expressions. Functions whose argument may change its sign in the range of the
    parameters stay as they are.
    """
    near = _Equilibrium(at)
    decided: list[_Decided] = []
    smooth = _branches(stacked, near.side, decided, {})
    for k, switch in enumerate(decided):
        if switch.side == "at":
            above = _branches(stacked, near.side, [], {k: "above"})
            near.compare(smooth, above, switch.text, places)
    return smooth


def _branches(
    stacked: ca.SX, side_of: Callable[[ca.SX], Side], decided: list[_Decided], chosen: Mapping[int, Side]
) -> ca.SX:
    """The expressions with branches; those at a zero are below it, unless `chosen` says otherwise."""

    def switched(name: str, *operands: ca.SX) -> ca.SX:
        switch, entries = _SWITCHES[name], [ca.SX(x) for x in operands]
        argument = switch.argument(*entries)
        decided.append(_Decided(f"{name}({', '.join(map(str, entries))})", side_of(argument)))
        side = chosen.get(len(decided) - 1, decided[-1].side)
        if side == "open":
            return ca.SX(FUNCTIONS[name](*entries))
        return ca.SX((switch.above if side == "above" else switch.below)(*entries))

    def logical(name: str, *operands: ca.SX) -> ca.SX:
        made = ca.SX(FUNCTIONS[name](*operands))
        return ca.SX(numbers_of(made)) if is_constant(made) else made

    def chosen_value(condition: ca.SX, value: ca.SX) -> ca.SX:
        if is_constant(condition):
            return value if numbers_of(condition)[0, 0] else ca.SX(0)
        return ca.SX(FUNCTIONS["if_else_zero"](condition, value))

    operations: dict[str, Callable[..., ca.SX]] = {
        **FUNCTIONS,
        **ARITHMETIC_OF_SX,
        **{name: partial(switched, name) for name in _SWITCHES},
        **{name: partial(logical, name) for name in _LOGIC},
        "if_else_zero": chosen_value,
    }
    free = column_of(ca.symvar(stacked))
    function = ca.Function("switches", [free], [ca.densify(stacked)])
    table = Rules(ca.SX, operations, unsupported)
    (entries,) = fold(function, table, ca.vertsplit(free))
    return column_of(ca.SX(x) for x in entries)


class _Equilibrium:
    """Where arguments of functions are at an equilibrium, for all values of the parameters."""

    def __init__(self, at: DaeTrim) -> None:
        self.at, self.dae, self.symbols = at, at.structure.dae, at.structure.symbols
        self.values = column_of(at.values[q.name] for q in at.structure.quantities)
        ends = np.array([[p.low, p.high] for p in self.dae.parameters]).reshape(-1, 2).T
        self.bounds = {
            p.name: (np.nextafter(low, -np.inf), np.nextafter(high, np.inf))  # angles are in rad
            for p, low, high in zip(self.dae.parameters, *in_symbols(self.dae, ends), strict=True)
        }

    def there(self, expression: ca.SX) -> ca.SX:
        """An expression at the equilibrium, in terms of the parameters."""
        return ca.SX(ca.substitute(expression, self.symbols, self.values))

    def side(self, argument: ca.SX) -> Side:
        """On which side of zero an argument is: decided exactly, or by an enclosure of its range."""
        value = self.there(argument)
        if self.vanishes(argument):
            return "at"
        if is_constant(value):
            return "above" if numbers_of(value)[0, 0] > 0.0 else "below"
        function = ca.Function("argument", [self.dae.p], [ca.densify(in_doubles(value))])

        def enclosed(box: Mapping[str, Interval]) -> Interval:
            ((found,),) = fold(function, _RANGES, list(box.values()))
            return Interval.of(found)

        try:
            if find_zero(enclosed, self.bounds) is not None:
                return "open"
        except NotRationalError:  # a function without an enclosure
            return "open"
        return "above" if self.number(value) > 0.0 else "below"

    def vanishes(self, expression: ca.SX) -> bool:
        """Whether an expression is zero at the equilibrium for all values of the parameters."""
        value = self.there(expression)
        try:
            return is_zero(ca.densify(at_odd_parameters(self.dae, value)))
        except NotRationalError:
            # a function of numbers: in doubles, relative to what signals make of it
            slopes = self.there(ca.densify(ca.jacobian(expression, self.symbols)))
            sizes = [q.variable.nominal for q in self.at.structure.quantities]
            terms = sum(abs(self.number(slopes[j])) * size for j, size in enumerate(sizes))
            return abs(self.number(value)) <= _NOTHING * terms

    def number(self, value: ca.SX) -> float:
        """The value of an expression of the parameters at nominal."""
        return float(values_of([value], self.dae.p, parameter_points(self.dae, 1)[0])[0])

    def compare(self, below: ca.SX, above: ca.SX, text: str, places: Sequence[str]) -> None:
        """Raise a TrimError if two branches differ in their values or slopes at the equilibrium."""
        for k, place in enumerate(places):
            change = above[k] - below[k]
            if not ca.symvar(change) and float(change) == 0.0:
                continue
            if not self.vanishes(change):
                ends = [self.number(self.there(x[k])) for x in (below, above)]
                raise self._error(place, text, f"jumps from {ends[0]:g} to {ends[1]:g}")
            slopes = ca.densify(ca.jacobian(change, self.symbols))
            for j, q in enumerate(self.at.structure.quantities):
                if not self.vanishes(slopes[j]):
                    rows = (self.there(ca.jacobian(x[k], self.symbols[j])) for x in (below, above))
                    ends = [self.number(ca.densify(row)) for row in rows]
                    what = f"has two slopes by {q.name!r}, {ends[0] + 0.0:g} and {ends[1] + 0.0:g}"
                    raise self._error(place, text, what)

    def _error(self, place: str, text: str, what: str) -> TrimError:
        return TrimError(
            f"{self.dae.owner}, {place}: {what} at this equilibrium, where {text} switches: there is no "
            "linear model. Linearize beside it (other inputs or states in trim, at={...}), or write a "
            "smooth function, such as tanh(x/e) or sqrt(x^2 + e^2)."
        )
