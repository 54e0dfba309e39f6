"""The structure of a DAE: its index, what is a state, which equations are solved together.

`reduce_index` gives an equivalent system of index 1 at most, solved for nothing:

    0 = F(unknowns, states, inputs, p),   d/dt state = one of the unknowns, or another state
"""

import math
from collections.abc import Callable, Collection, Mapping, Sequence, Sized
from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import cache, cached_property, partial
from itertools import chain
from types import MappingProxyType
from typing import Literal, NamedTuple

import casadi as ca
import numpy as np

from mbdlft.base.arguments import arguments_checked
from mbdlft.base.array import Array
from mbdlft.base.errors import AnalysisError, SceneError, StructureError, TrimError, unknown_name
from mbdlft.base.samples import random
from mbdlft.base.unit import parse_unit
from mbdlft.dae.alias import Alias, eliminate_aliases
from mbdlft.dae.branches import with_roots_of_squares
from mbdlft.dae.dae import Dae, Variable, check_units
from mbdlft.dae.index import (
    Block,
    Differentiated,
    Entry,
    blocks_of,
    differentiated,
    dummy_derivatives,
    listed,
    name_of,
    place_of,
)
from mbdlft.dae.initial import point_by_orders
from mbdlft.dae.newton import System, solve
from mbdlft.dae.text import column_of
from mbdlft.exact.numbers import decimal
from mbdlft.problem.sx.constants import literal
from mbdlft.system.model import OUTSIDE

InputRates = Literal["refused", "inputs"]
_POINTS, _SEED = 3, 11  # at which pivots are looked at


class Quantity(NamedTuple):
    """A variable or one of its derivatives, such as ``x``, ``der(x)``, ``der(x, 2)``."""

    name: str
    symbol: ca.SX  # (1, 1), in `unit`
    unit: str
    variable: Variable  # which it is, or is a derivative of
    order: int  # of the derivative

    @property
    def start(self) -> float:
        """The value that solving begins with: that of the variable, of derivatives zero."""
        return 0.0 if self.order else self.variable.start or 0.0


@dataclass(frozen=True, eq=False)
class Structure:
    """A DAE of index 1 at most, and how it was made.

    Attributes
    ----------
    source : Dae
        As it was given.
    dae : Dae
        Without aliases.
    aliases : tuple of Alias
    index : int
        Structural index of `source`; 0 is an explicit ordinary differential equation.
    differentiations : tuple of (place of an equation, times)
        Those that were differentiated.
    states, unknowns, inputs : tuple of Quantity
        Inputs are those of the model, and derivatives of them if they are needed and were allowed.
    rates : tuple of SX
        The symbol of the derivative of each state: that of an unknown or of another state.
    equations : tuple of (place, residual SX)
        As many as unknowns.
    blocks : tuple of Block
        Positions of equations and unknowns, in the order of solving.
    near : mapping of names of variables and derivatives to float
        A consistent point at nominal parameters, where it was needed.
    """

    source: Dae
    dae: Dae
    aliases: tuple[Alias, ...]
    index: int
    differentiations: tuple[tuple[str, int], ...]
    states: tuple[Quantity, ...]
    unknowns: tuple[Quantity, ...]
    inputs: tuple[Quantity, ...]
    rates: tuple[ca.SX, ...]
    equations: tuple[tuple[str, ca.SX], ...]
    blocks: tuple[Block, ...]
    near: Mapping[str, float] = field(default_factory=dict)

    @cached_property
    def residual(self) -> ca.SX:
        return column_of(residual for _, residual in self.equations)

    @cached_property
    def x(self) -> ca.SX:
        return column_of(q.symbol for q in self.states)

    @cached_property
    def unknown(self) -> ca.SX:
        return column_of(q.symbol for q in self.unknowns)

    @cached_property
    def u(self) -> ca.SX:
        return column_of(q.symbol for q in self.inputs)

    @property
    def quantities(self) -> tuple[Quantity, ...]:
        """Unknowns, states and inputs, in the order of the columns of the derivatives."""
        return (*self.unknowns, *self.states, *self.inputs)

    @cached_property
    def symbols(self) -> ca.SX:
        return column_of(q.symbol for q in self.quantities)

    @property
    def owner(self) -> str:
        """Such as "model 'motor'"."""
        return self.dae.owner

    def near_start(
        self, unknown: Sequence[Quantity], known: Mapping[str, float] = MappingProxyType({})
    ) -> Array | None:
        """Where solving begins if start values lead nowhere: what is `known`, then `near`."""
        near = {**self.near, **known}
        return np.array([near.get(q.name, q.start) for q in unknown]) if near else None

    def __str__(self) -> str:
        return report(self)


@arguments_checked
def reduce_index(
    dae: Dae,
    *,
    states: Sequence[str] = (),
    preferred: Sequence[str] = (),
    input_rates: InputRates = "refused",
) -> Structure:
    """The equivalent system of index 1 at most.

    Parameters
    ----------
    dae : Dae
    states : names of variables that are to be states, such as ``("phi", "w")``, where there is a choice
        The others are chosen by pivots of the differentiated constraints at several points.
    preferred : names of variables that are states if they can be
        Of consistent points, that one is taken whose values are near their starts.
    input_rates : {"refused", "inputs"}
        Whether derivatives of inputs that are needed are an error, or new inputs ``der(u)``.

    Raises
    ------
    StructureError
        Structurally or numerically singular: which equations and unknowns. A derivative of an input is
        needed. The states that are asked for cannot be states.
    SceneError
        The units of an equation do not fit.
    """
    if not dae.units_checked:
        check_units(dae)
    dae = with_roots_of_squares(dae)
    reduced, aliases = eliminate_aliases(dae)
    d = differentiated(reduced, f" after {listed(aliases)}" if aliases else "")
    if d.input_rates and input_rates == "refused":
        names = [name_of(u.name, order) for u, order, _ in d.input_rates]
        raise StructureError(
            f"{dae.owner}: derivatives of inputs are needed: {listed(names)}. A constraint imposes what "
            "has an inertia. Make them inputs with input_rates='inputs', or an input of the highest "
            "derivative and variables of the others."
        )
    inputs = tuple(
        _quantity(u, order, symbol)
        for u, order, symbol in (*((u, 0, u.symbol) for u in reduced.inputs), *d.input_rates)
    )
    free = [*d.symbols.values(), *(q.symbol for q in inputs), *ca.vertsplit(reduced.p)]
    remaining, written = {a.name: a.of for a in aliases}, written_rates(reduced)
    likely = {remaining.get(name) or name for name in preferred}
    points = cache(partial(_consistent_points, d, inputs, likely))
    known = {v.name for v in dae.variables}
    for name in states:
        variable = name.removeprefix("der(").split(",")[0].rstrip(")") if name[:4] == "der(" else name
        if variable not in known:
            raise SceneError(f"{dae.owner}, states: " + unknown_name("variable", name, known))
    # what may be the state that a name asks for: its alias, or the derivative that it is
    wanted = {name: {(kept := remaining.get(name) or name), written.get(kept, kept)} for name in states}
    rates_too = {written.get(name, name) for name in likely}
    dummies = dummy_derivatives(d, free, points, {*chain(*wanted.values()), *likely, *rates_too})
    structure = _assembled(dae, aliases, d, dummies, inputs, wanted)
    if not points.cache_info().currsize:
        return structure
    names = [name_of(reduced.variables[j].name, order) for j, order in d.symbols]
    return replace(structure, near=dict(zip(names, map(float, points()[0]), strict=False)))


def start_of(unknown: Sequence[Quantity]) -> tuple[Array, Array]:
    """Start values and sizes (n,) of unknowns."""
    start = np.array([q.start for q in unknown])
    return start, np.array([q.variable.size for q in unknown])


def check_point(s: Structure, values: Array) -> None:
    """Raise a TrimError for a variable outside its range, of values of [unknowns ; states ; inputs]."""
    for q, value in zip(s.quantities, values, strict=True):
        if not q.order:
            check_range(s, q.variable, value)


def check_range(s: Structure, v: Variable, value: float, at: Callable[[], str] = str) -> None:
    """Raise a TrimError for a value of a variable outside its minimum and maximum, and say at what."""
    width, ends = v.maximum - v.minimum, (abs(v.minimum), abs(v.maximum))
    room = OUTSIDE * (width if math.isfinite(width) else max(v.nominal, min(ends)))
    if not v.minimum - room <= value <= v.maximum + room:
        where = f" at {text}" if (text := at()) else ""
        raise TrimError(
            f"{s.owner}: {v.name} = {value:g} is outside its range [{v.minimum:g}, {v.maximum:g}] "
            f"{v.unit}{where}. Give other values or start values, narrow the ranges of the parameters, "
            f"or widen that of {v.name}."
        )


def check_conditions(s: Structure, values: Array, times: Array) -> None:
    """Raise an AnalysisError if conditions (n, N) of the equations end at one of the times (N,), in s."""
    for c, of in zip(s.dae.conditions, values, strict=True):
        ended = of != (of[0] if c.value is None else c.value)
        if np.any(ended):
            raise AnalysisError(
                f"{s.owner}, simulate: {c.name}: this changes, or does not hold, at "
                f"{times[np.argmax(ended)]:g} s, where the equations end. Take earlier times, or others."
            )


def _quantity(variable: Variable, order: int, symbol: ca.SX) -> Quantity:
    name, unit = name_of(variable.name, order), rate_unit(variable.unit, order)
    return Quantity(name, symbol, unit, variable, order)


def written_rates(dae: Dae) -> dict[str, str]:
    """Variables that an equation w = der(x) gives: the names of these derivatives, ``der(x)``."""
    variables = {v.symbol.element_hash(): v.name for v in dae.variables}
    derivatives = [(v.derivative, v.name) for v in dae.variables if v.derivative is not None]
    rates = {symbol.element_hash(): name_of(name, 1) for symbol, name in derivatives}
    rate_of = {}
    for e in dae.equations:
        keys = [s.element_hash() for s in ca.symvar(e.residual)]
        names, ends = ([t[key] for key in keys if key in t] for t in (variables, rates))
        if len(keys) == 2 and len(names) == len(ends) == 1:
            slopes = ca.densify(ca.jacobian(e.residual, column_of(ca.symvar(e.residual))))
            if slopes.is_constant() and float(slopes[0]) == -float(slopes[1]):
                rate_of[names[0]] = ends[0]
    return rate_of


def rate_unit(unit: str, order: int = 1) -> str:
    """The unit of a derivative of a quantity in `unit`."""
    if not order:
        return unit
    return f"{unit}^{order + 1}" if unit.endswith("/s") else f"{unit}/s" + f"^{order}" * (order > 1)


def _consistent_points(
    d: Differentiated, inputs: Sequence[Quantity], preferred: Collection[str]
) -> list[Array]:
    """Values of all symbols, inputs and parameters, at nominal and at some other parameters."""
    dae = d.dae
    unknown = [_quantity(dae.variables[j], order, symbol) for (j, order), symbol in d.symbols.items()]
    start, sizes = start_of(unknown)
    knowns = column_of([*(q.symbol for q in inputs), *ca.vertsplit(dae.p)])
    residual = column_of(d.residuals.values())
    u = [q.start for q in inputs]
    system = System(residual, column_of(d.symbols.values()), knowns)
    points: list[Array] = []
    for p in parameter_points(dae, _POINTS):
        given = np.array([*u, *p])

        def second(given: Array = given) -> Array | None:
            if points:
                return points[0][: len(start)]
            known = point_by_orders(d, [q.symbol for q in inputs], given, preferred)
            return None if known is None else np.array([known[entry] for entry in d.symbols])

        at = solve(system, start, given, sizes, second)
        if not points and not at.is_solution:
            raise StructureError(
                f"{dae.owner}: no consistent initial point was found at the nominal parameters; what "
                "misses most, over its terms with unknowns: "
                f"{at.worst([place_of(dae, row) for row in d.residuals])}. Give start values near a "
                "solution, or, if there is none at these parameters, other nominal values."
            )
        if at.is_solution:
            points.append(np.concatenate([at.values, u, p]))
    return points


def parameter_points(dae: Dae, count: int) -> list[Array]:
    """Values of the parameters as the symbols have them: nominal, then random ones."""
    if not dae.parameters:
        return [np.zeros(0)]
    drawn = random(dae.parameters, count - 1, _SEED) if count > 1 else {}
    physical = [np.concatenate([[p.nominal], drawn.get(p.name, [])]) for p in dae.parameters]
    return list(in_symbols(dae, np.stack(physical, axis=1)))


def at_odd_parameters(dae: Dae, value: ca.SX) -> ca.SX:
    """An expression at exact values of the parameters, at which none is zero that is not always."""
    odd = [decimal(p.nominal) + Fraction(k + 1, 9973) for k, p in enumerate(dae.parameters)]
    numbers = column_of(ca.SX(literal(x)) for x in odd)
    return ca.SX(ca.substitute(value, dae.p, numbers)) if odd else value


def in_symbols(dae: Dae, points: Array) -> Array:
    """Physical values (N, n_p) as the symbols have them: angles in rad."""
    factors = [parse_unit(p.unit).factor if p.is_angle else 1.0 for p in dae.parameters]
    return np.asarray(points * np.array(factors))


def _assembled(
    source: Dae,
    aliases: tuple[Alias, ...],
    d: Differentiated,
    dummies: Collection[Entry],
    inputs: tuple[Quantity, ...],
    wanted: Mapping[str, set[str]],
) -> Structure:
    dae = d.dae
    quantity = {e: _quantity(dae.variables[e.variable], e.order, s) for e, s in d.symbols.items()}
    states = [
        Entry(j, order)
        for j, order in d.symbols
        if order < d.orders[j] and Entry(j, order + 1) not in dummies
    ]
    unknowns = [entry for entry in d.symbols if entry not in set(states)]
    names = {quantity[entry].name for entry in states}
    for name, candidates in wanted.items():
        if not candidates & names:
            raise StructureError(
                f"{source.owner}: {name!r} cannot be a state together with the other states that are "
                f"asked for. The states are {listed(sorted(names))}."
            )
    residual, unknown = column_of(d.residuals.values()), column_of(d.symbols[e] for e in unknowns)
    return Structure(
        source=source,
        dae=dae,
        aliases=aliases,
        index=d.index,
        differentiations=tuple(
            (dae.equations[i].place, count) for i, count in enumerate(d.counts) if count
        ),
        states=tuple(quantity[entry] for entry in states),
        unknowns=tuple(quantity[entry] for entry in unknowns),
        inputs=inputs,
        rates=tuple(d.symbols[Entry(j, order + 1)] for j, order in states),
        equations=tuple((place_of(dae, row), r) for row, r in d.residuals.items()),
        blocks=blocks_of(ca.jacobian_sparsity(residual, unknown)),
    )


def report(s: Structure) -> str:
    """What the structure is, in words: index, states, blocks that are solved together."""
    dae = s.source
    lines = [
        f"{dae.name}: {_counted(dae.equations, 'equation')}, {_counted(dae.inputs, 'input')}, "
        f"{_counted(dae.parameters, 'parameter')} left in",
        f"  aliases: {_counted(s.aliases, 'variable')} taken out as others or numbers, "
        f"{len(s.dae.variables)} left",
        f"  index {s.index}"
        + ": differentiated " * bool(s.differentiations)
        + listed(f"{place} {n} x" for place, n in s.differentiations),
        f"  {_counted(s.states, 'state')}: {listed(q.name for q in s.states) or 'none'}",
    ]
    large = [b for b in s.blocks if len(b.rows) > 1]
    lines.append(
        f"  {_counted(s.blocks, 'block')}, {len(large)} of them of more than one equation"
        + (f", the largest of {max(len(b.rows) for b in large)}" if large else "")
    )
    for block in large[:5]:
        unknown = s.unknown[list(block.columns)]
        slopes = ca.jacobian(s.residual[list(block.rows)], unknown)
        kind = "nonlinear" if ca.depends_on(slopes, unknown) else "linear"
        unknowns = listed(s.unknowns[j].name for j in block.columns)
        lines.append(f"    {len(block.rows)} equations, {kind}: {unknowns}")
    return "\n".join(lines)


def _counted(items: Sized, noun: str) -> str:
    """Such as "1 input" and "2 inputs"."""
    return f"{len(items)} {noun}{'' if len(items) == 1 else 's'}"
