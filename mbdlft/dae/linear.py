"""The linear model of a DAE around an equilibrium, parameters left in: its problem for the pipeline."""

from contextlib import nullcontext
from dataclasses import replace
from functools import partial
from typing import Any

import casadi as ca
import numpy as np

from mbdlft.base.array import Array
from mbdlft.base.errors import NotRationalError, TrimError, WellPosednessError
from mbdlft.base.unit import Signal
from mbdlft.dae.equilibria import DaeTrim
from mbdlft.dae.kinks import beside_switches, without_switches
from mbdlft.dae.newton import System, follow_all
from mbdlft.dae.structure import Quantity, Structure, at_odd_parameters, in_symbols, parameter_points
from mbdlft.dae.text import column_of
from mbdlft.dae.theta.arguments import Mixed
from mbdlft.dae.theta.separation import Separation
from mbdlft.dae.to_problem import problem_of
from mbdlft.problem.digits import nonlinear_in_digits
from mbdlft.problem.equations import rows_of
from mbdlft.problem.references import column_of_entries, entry_scale, reference_of_relations
from mbdlft.problem.relations import LinearModel, Problem, Reference, Stage, TrimRelations
from mbdlft.problem.sparse import Entries, pseudo_inverse, solve
from mbdlft.problem.sx.constants import in_doubles, is_constant, is_zero
from mbdlft.problem.sx.tapes import evaluate_many, felt_terms

_AMPLIFIED, _ROUNDING = 1e4, 1e-9  # how much larger than fits errors of the linear model may be
_LOOKED_AT = 4  # points at which sizes of trimmed quantities are taken
_SHAKES, _SHAKE = 4, 2.0**-30  # how often slopes are changed, and by which part of what they feel
Slopes = tuple[ca.Function, Entries]


def problem_of_trim(at: DaeTrim, stage: Stage = lambda name: nullcontext()) -> Problem:
    """The linearized equations of a DAE at an equilibrium, rational in the parameters."""
    with stage("linearize"):
        at = _beside_switches(at)
        linear = _Linear(at)
        smooth = _replaced(at, linear.stacked).structure
        relations = linear.relations()
    trimmed, s = linear.trimmed(), at.structure
    signals = [tuple(Signal(x.name, x.unit) for x in every) for every in (s.inputs, s.dae.outputs)]
    return problem_of(
        s,
        relations,
        (signals[0], signals[1]),
        partial(_reference, at, smooth, relations, trimmed),
        ("the nonlinear equations", "the linearized equations do"),
        trimmed,
        at.fit_bound,
    )


def _beside_switches(at: DaeTrim) -> DaeTrim:
    """The equilibrium of equations with branches where functions switch there."""
    s, outputs = at.structure, at.structure.dae.outputs
    places = [f"equation {place}" for place, _ in s.equations]
    stacked = ca.vertcat(s.residual, *(y.expression for y in outputs))
    every = [*places, *(f"output {y.name!r}" for y in outputs)]
    return _replaced(at, beside_switches(s, at.values, stacked, every))


def _replaced(at: DaeTrim, stacked: ca.SX) -> DaeTrim:
    """The equilibrium of other expressions of [residual ; outputs]."""
    s, outputs = at.structure, at.structure.dae.outputs
    equations = tuple((place, stacked[k]) for k, (place, _) in enumerate(s.equations))
    read = tuple(replace(y, expression=stacked[len(equations) + k]) for k, y in enumerate(outputs))
    return replace(at, structure=replace(s, equations=equations, dae=replace(s.dae, outputs=read)))


class _Linear:
    """Slopes at an equilibrium, followed so that what is not rational is named."""

    def __init__(self, at: DaeTrim) -> None:
        self.at, self.s = at, at.structure
        dae = self.s.dae
        stacked = ca.vertcat(self.s.residual, *(y.expression for y in dae.outputs))
        self.stacked = without_switches(self.s, at.values, stacked)
        every = ca.vertcat(self.stacked, *at.values.values())
        self.separation = Separation(dae, every, "fewest")
        self.internal = self.separation.internal

    def relations(self) -> LinearModel:
        """Linear relations with small changes of unknowns, states and inputs."""
        s = self.s
        small = column_of([ca.SX.sym(f"d {q.name}") for q in s.quantities])
        moved = self._moved(self.stacked, small)
        moved = without_switches(self.s, self.at.values, moved)
        count = len(s.equations)
        equations = self.separation.equations(s, moved[:count], moved[count:], small)
        return LinearModel(
            residual=column_of(map(_linear, equations.relations)),
            output=column_of(map(_linear, equations.outputs)),
            unknown=equations.unknown,
            known=small[len(s.unknowns) :, :],  # of a single entry there is a row otherwise
            p=self.internal,
            parameters=s.dae.parameters,
            derivatives=equations.derivatives,
        )

    def _moved(self, stacked: ca.SX, small: ca.SX) -> ca.SX:
        """What small changes make of expressions, at the equilibrium."""
        symbols, values = self.s.symbols, _expressions(self.at)
        if not self.at.slopes:
            return ca.SX(ca.substitute(ca.jtimes(stacked, symbols, small), symbols, values))
        J = ca.substitute(_slopes(self.at, stacked), symbols, values)
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


def _slopes(at: DaeTrim, stacked: ca.SX) -> ca.SX:
    """Slopes of expressions, those that are known at the equilibrium as functions of the parameters."""
    J = ca.SX(ca.jacobian(stacked, at.structure.symbols))
    for (i, j), value in at.slopes.items():
        J[i, j] = value
    return J


def _linear(value: Mixed) -> ca.SX:
    assert not value.terms
    return ca.SX(sum((p.coefficient * p.form for p in value.linear.values()), ca.SX(0)))


def trimmed_points(at: DaeTrim, points: Array) -> Array:
    """Numbers (N, n) of [unknowns ; states ; inputs] at physical points, each by Newton's method.

    The equations are those of the structure, the rates of the states are zero or, at an initial point,
    what these give, and what was held or given is that.
    """
    s = at.structure
    expressions = _expressions(at)
    posed = {*at.given, *(q.name for q in s.inputs)} - {*at.free}
    posed |= {q.name for q in s.quantities if _is_start(q, at.values[q.name])}
    moving = [bool(ca.symvar(in_doubles(expressions[k]))) for k in range(expressions.numel())]
    free = [k for k, q in enumerate(s.quantities) if q.name not in posed and moving[k]]
    values, p = _exact_values(at, points), in_symbols(s.dae, points)
    if not free:
        return values
    held = [k for k in range(expressions.numel()) if k not in free]
    held_symbols = ca.vertcat(rows_of(s.symbols, held), s.dae.p)
    sizes = np.array([q.variable.size for q in s.quantities])
    initial = () if at.at_rest else (e.residual for e in s.dae.initial)
    system = System(ca.vertcat(s.residual, *initial), s.symbols[free], held_symbols, sizes[held])
    nominal = np.array([at.nominal[q.name] for q in s.quantities])
    first = np.concatenate([nominal[held], parameter_points(s.dae, 1)[0]])
    followed = follow_all(system, nominal[free], first, np.hstack([values[:, held], p]), sizes[free])
    if not all(now.is_solution for now in followed):
        raise TrimError(f"{s.owner}: no equilibrium was found at a point of the parameter range.")
    values[:, free] = [now.values for now in followed]
    return values


def _is_start(q: Quantity, value: ca.SX) -> bool:
    """Whether a quantity has its start value, in terms of parameters, as nothing determines it."""
    start = q.variable.start_of
    return not q.order and start is not None and bool(ca.is_equal(value, start))


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
    known = {q.name for q in s.inputs} - {*at.free}
    unknown = [q.name not in known and not q.order for q in s.quantities]
    if not at.at_rest:  # derivatives are unknown, and states that are fixed are not
        known |= {*at.given, *(v.name for v in s.dae.variables if v.fixed)}
        unknown = [q.name not in known for q in s.quantities]
    free = [k for k, u in enumerate(unknown) if u]
    both = ca.vertcat(s.symbols, s.dae.p)
    slopes = ca.Function("slopes", [both], [ca.jacobian(in_doubles(s.residual), both)])
    nominal = np.array([s.quantities[k].variable.size for k in free])
    places = Entries(slopes.sparsity_out(0))
    for row in np.hstack([z, in_symbols(s.dae, points)])[:_LOOKED_AT]:
        J = places.matrix(np.array(slopes(row).nonzeros()))
        terms = abs(J) @ np.abs(row)  # none where all is zero: nothing is rounded
        columns = np.maximum(np.abs(row[free]), nominal)
        inverse, norm = pseudo_inverse(J[:, free], columns)
        made = columns * (np.abs(inverse) @ (terms / norm))
        size[free] = np.maximum(size[free], made)
    return np.asarray(size)


def _reference(
    at: DaeTrim, smooth: Structure, relations: LinearModel, trimmed: TrimRelations | None, points: Array
) -> Reference:
    """The nonlinear equations, trimmed and linearized again with numbers at every point.

    `smooth` has branches in place of functions that switch: what rounding does has no conditions.
    Where the equilibrium is a fit, they are linearized at it; that it is near is looked at, too.
    """
    s = at.structure
    z = trimmed_points(at, points)
    slopes, numbers, sizes = slopes_of(s), z, np.max(np.abs(z), axis=0, initial=0.0)
    values = linearized(s, slopes, z, points)
    scale = entry_scale(values, len(s.states))
    if at.fit_bound:
        numbers, exact = _exact_values(at, points), values
        values = linearized(s, slopes, numbers, points)
        error = float(np.max(np.abs(values - exact) / scale, initial=0.0))
        if not error <= max(_AMPLIFIED * at.fit_bound, _ROUNDING):
            raise TrimError(
                f"{s.owner}: with fits within {at.fit_bound:.1e} the linear model is {error:.1e} from "
                "that of the equations: it is nearly singular at this equilibrium. Take a smaller "
                "tolerance (fit=...)."
            )
    else:
        sizes = trim_sizes(at, points, z)
    names = [q.name for q in s.quantities]
    chosen = [names.index(signal.name) for signal in trimmed.signals] if trimmed else []
    sizes = sizes[chosen]
    of_relations = reference_of_relations(relations, points, s.owner)
    # a coefficient such as 1 - p is zero at nominal, and not at the last point, a corner
    ends = ((z[k : k + 1], points[k : k + 1]) for k in (0, len(points) - 1))
    felt = np.max([felt_sizes(smooth, slopes_of(smooth), *end) for end in ends], axis=0)
    return replace(
        of_relations,
        sizes=lambda: np.maximum(of_relations.sizes(), felt),
        values=values,
        scale=entry_scale(values, len(s.states), terms=felt),
        trimmed=numbers[:, chosen],
        trim_scale=np.where(sizes > 0, sizes, 1.0),
        **_in_digits(at, points),
    )


def _in_digits(at: DaeTrim, points: Array) -> dict[str, Any]:
    """Values and transfer functions of the nonlinear equations in 50 digits, for a reference.

    No values where functions have no digits, and no kinks: doubles are compared with then.
    """
    s = at.structure
    outputs = column_of([y.expression for y in s.dae.outputs])
    J = _slopes(at, ca.vertcat(s.residual, outputs))
    n, k = s.residual.numel(), len(s.states)
    of_rates = ca.horzcat(ca.DM.eye(k), -ca.jacobian(column_of(s.rates), s.symbols))
    slopes = ca.vertcat(of_rates, ca.horzcat(ca.SX(J.size1(), k), J))
    counts = (n + k, s.symbols.numel() - n, k)
    where = s.symbols, _expressions(at)
    digits = nonlinear_in_digits(slopes, where, s.dae.p, s.dae.parameters, counts)
    try:
        digits.matrices(points[:1])
    except (NotRationalError, WellPosednessError):
        return {"in_digits": None}
    return {
        "in_digits": digits.matrices,
        "transfers_in_digits": lambda some, w: digits.transfers(points[list(some)], w),
    }


def linearized(s: Structure, slopes: Slopes, z: Array, points: Array) -> Array:
    """[A B ; C D] (N, ., .) of the nonlinear equations at z (N, n) = [unknowns ; states ; inputs]."""
    function, places = slopes
    (every,) = evaluate_many(function, z, in_symbols(s.dae, points))
    _check_finite(s, every)
    return np.array([_solved(s, places.matrix(values[:, 0])) for values in every])


def _check_finite(s: Structure, slopes: Array) -> None:
    if not np.all(np.isfinite(slopes)):
        raise TrimError(
            f"{s.owner}: a slope of the equations, or what rounding makes of it, is not finite at the "
            "equilibrium, as that of a root at zero is: there is no linear model. Linearize beside it."
        )


def felt_sizes(s: Structure, slopes: Slopes, z: Array, point: Array) -> Array:
    """Sizes (., .) of entries of [A B ; C D] at one point to which rounding that is felt is relative.

    Numbers, those of the equilibrium too, are doubles: cos(1.5707963267948966) is 0 or 6e-17, as it is
    read. So the slopes are moved by as much as rounding of each step and number moves them; none are
    where equations have conditions.
    """
    function, places = slopes
    p, random = in_symbols(s.dae, point), np.random.default_rng(0)
    values = evaluate_many(function, z, p)[0][0, :, 0]
    exact = _solved(s, places.matrix(values))
    try:
        felt = felt_terms(function, z, p)[:, 0]
    except NotRationalError:
        return np.zeros_like(exact)
    _check_finite(s, felt)
    changes = _SHAKE * felt * random.uniform(-1.0, 1.0, (_SHAKES, len(values)))
    moved = np.array([_solved(s, places.matrix(values + change)) for change in changes])
    return np.asarray(np.max(np.abs(moved - exact), axis=0) / _SHAKE)


def slopes_of(s: Structure) -> Slopes:
    """Slopes of [residual ; outputs ; rates] that are not structural zeros, as a function of z and p."""
    outputs = column_of([y.expression for y in s.dae.outputs])
    stacked = ca.vertcat(s.residual, outputs, column_of(s.rates))
    slopes = ca.sparsify(in_doubles(ca.jacobian(stacked, s.symbols)))
    entries = ca.densify(column_of_entries(slopes))
    return ca.Function("slopes", [s.symbols, s.dae.p], [entries]), Entries(slopes.sparsity())


def _solved(s: Structure, J: Any) -> Array:
    """[A B ; C D] of the slopes at a point."""
    n, count = s.unknown.numel(), len(s.dae.outputs)
    try:
        solved = -solve(J[:n, :n], J[:n, n:])
    except np.linalg.LinAlgError:
        raise WellPosednessError(
            f"{s.owner}: the equations do not determine the unknowns at a point of the range."
        ) from None
    read = J[n:, n:] + J[n:, :n] @ solved
    return np.concatenate([read[count:], read[:count]])
