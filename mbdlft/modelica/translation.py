"""From a Modelica file, by the syntax tree of its flat model, to its DAE and its operating point."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, replace
from fractions import Fraction
from typing import TypeVar

import casadi as ca

from mbdlft.base.arguments import arguments_checked
from mbdlft.base.errors import SceneError, check_known
from mbdlft.dae.dae import Condition, Dae, Equation, Output
from mbdlft.dae.equilibria import DaeTrim, start_point, trim
from mbdlft.dae.index import name_of
from mbdlft.dae.structure import Structure, reduce_index
from mbdlft.dae.text import column_of
from mbdlft.modelica import tree
from mbdlft.modelica import values as v
from mbdlft.modelica.evaluation import check_units
from mbdlft.modelica.lookup import OF_TIME
from mbdlft.modelica.modes import (
    Discrete,
    Point,
    conditions_of,
    found_at,
    initialized,
    propagated,
    start_all,
    without_discrete,
)
from mbdlft.modelica.table import ModelicaTable
from mbdlft.modelica.tree import Expression, flat_text, shorter, write
from mbdlft.modelica.values import Value
from mbdlft.modelica.variables import Variables, depending, names_in, read_values

T = TypeVar("T")

_PREFERRED = (tree.Reference("StateSelect.prefer"), tree.Reference("StateSelect.always"))
_MOST_MODES = 50  # that are tried
_LISTED = 12  # of what is refused
_DIGITS = 6  # of the size of a variable, to which its start is compared
_TIME = (
    "A variable that a formula of time and parameters alone gives, u = f(time), becomes an input; time "
    "anywhere else is not supported. Make an input of what it stands for."
)


@dataclass(frozen=True, slots=True)
class ModelicaReport:
    """The differences between a Modelica model and the DAE that was made of it.

    Attributes
    ----------
    sources : tuple of str
        Variables that a formula of time gave, and that are inputs now.
    states : tuple of str
        Variables that the model prefers as states.
    notes : tuple of str
        Sentences: parameters that are numbers though they have limits, units that are not known, asserts
        that are not checked.
    table : ModelicaTable
        What was said beside the model.
    """

    sources: tuple[str, ...]
    states: tuple[str, ...]
    notes: tuple[str, ...]
    table: ModelicaTable = field(default_factory=ModelicaTable)

    def __str__(self) -> str:
        sources = (
            f"{name} is a function of time: it is an input, with its value of time 0"
            for name in self.sources
        )
        return "\n".join(f"note: {line}." for line in (*sources, *self.notes))


@arguments_checked
def translate(model: tree.FlatModel, table: ModelicaTable | None = None) -> tuple[Dae, ModelicaReport]:
    """The description of a flat model.

    Parameters
    ----------
    model : FlatModel
    table : ModelicaTable, optional
        Which parameters stay, and what else is said beside the model.

    Raises
    ------
    SceneError
        Something in the model has no place in a linear model (the message lists all of it, with lines), a
        name is unknown, a value is missing, a time is not that of a source.
    """
    table = table or ModelicaTable()
    continuous, discrete = without_discrete(initialized(model))
    _refuse(model, discrete)
    modes: dict[str, Value] = {}
    for _ in range(_MOST_MODES):
        translation = _Translation(continuous, table, discrete, modes)
        dae, report = translation.result()
        if not translation.open and not any(event.conditions for event in model.held):
            return dae, report
        at = operating_point(dae, report, table)
        point = Point(at, {p.name: p.nominal for p in dae.parameters})
        new = found_at(discrete, translation.open, point)
        if all(new[name] == translation.variables.values[name] for name in new):
            given = translation.open, new, translation.variables, translation.place
            noted = (
                f"{name} is {v.described(value)} at the operating point" for name, value in new.items()
            )
            dae = replace(dae, conditions=(*dae.conditions, *conditions_of(discrete, *given)))
            return dae, replace(report, notes=(*report.notes, *noted))
        modes = {**modes, **new}
    raise SceneError(
        f"{model.source}: model {model.name!r}: the modes {', '.join(sorted(modes))} have no values that "
        "the equilibrium confirms."
    )


def _refuse(model: tree.FlatModel, discrete: Discrete) -> None:
    """Raise a SceneError if something has no place in a linear model."""
    loose = (
        tree.Refused(f"the {f'{d.variability} {d.type}'.strip()} variable", (d.name,), d.line)
        for d in discrete.undefined
    )
    refused = sorted((*model.refused, *loose), key=lambda item: item.line)
    if not refused:
        return
    lines = [
        item.what
        + (f" in line {item.line}" if item.line else "")
        + (f" ({', '.join(item.names)})" if item.names else "")
        for item in refused[:_LISTED]
    ]
    more = f"; and {len(refused) - _LISTED} more" if len(refused) > _LISTED else ""
    raise SceneError(
        f"{model.source}: model {model.name!r} has what no continuous model has: {'; '.join(lines)}"
        f"{more}. Take it out, or write equations of Real variables in its place."
    )


class _Translation:
    """One model on its way."""

    def __init__(
        self, model: tree.FlatModel, table: ModelicaTable, discrete: Discrete, modes: dict[str, Value]
    ) -> None:
        self.model, self.table, self.discrete, self.modes = model, table, discrete, modes
        self.open: dict[str, Value] = {}  # modes that the equilibrium decides, as expressions
        self.asserts: list[Condition] = []
        self.looked_up: set[int] = set()  # ids of equations that look a time up in a table
        self.parameters = read_values(model, table, self._of_declaration)
        symbols = column_of(self.parameters.symbols.values())
        changed = depending(model, table.values)
        for item in model.fixed:
            value = self.parameters.values.get(item.name)
            if item.name in changed or (isinstance(value, ca.SX) and ca.depends_on(value, symbols)):
                remedy = (
                    f"keep the number of the model ({item.name} = false in the table), or {item.remedy}"
                )
                what = f"{item.why}, which cannot stay or change then: {remedy}."
                raise SceneError(self.place(item.line, what))
        self.variables = Variables(self.parameters, self._of_declaration, model.functions, table.delay)
        self.declared = [d for d in model.declarations if d.variability not in ("parameter", "constant")]

    def result(self) -> tuple[Dae, ModelicaReport]:
        if self.table.check_units:
            check_units(self.model, self.place)
        for d in self.declared:
            self.variables.declare(d)
        self.variables.declare_records(self.model.records)
        self._hold()
        bound = [
            tree.Equation(tree.Reference(d.name), d.binding, d.line)
            for d in self.declared
            if d.binding is not None
        ]
        equations = self._equations([*bound, *self.model.equations])
        equations += [Equation(name, residual, None) for name, residual in self.variables.delayed]
        if self.variables.delayed:
            self.parameters.notes.append(f"delays are Pade approximations of order {self.table.delay}")
        initial = self._equations(self.model.initial)
        equations, sources = self._sources(equations)
        inputs = self._inputs(sources)
        kept = sorted(self.parameters.kept.items(), key=lambda pair: pair[1].name)
        by_name = self.variables.by_name
        dae = Dae(
            name=self.model.name,
            variables=tuple(x for x in self.variables.all() if x.name not in inputs),
            inputs=tuple(by_name[name] for name in inputs),
            parameters=tuple(parameter for _, parameter in kept),
            p=column_of(self.parameters.symbols[name] for name, _ in kept),
            outputs=tuple(self._outputs()),
            equations=tuple(equations),
            initial=tuple(initial),
            conditions=tuple(self.asserts),
            description=self.model.comment,
            text=flat_text(self.model),
            units_checked=True,
        )
        preferred = self._names(lambda d: d.attributes.get("stateSelect") in _PREFERRED)
        notes = tuple(self.parameters.notes)
        return dae, ModelicaReport(tuple(sources), tuple(preferred), notes, self.table)

    def _hold(self) -> None:
        """Give values to what is discrete."""
        names, evaluator = self.variables.values, self.variables.evaluator
        if not self.discrete.declared:
            return
        start_all(self.discrete, names, evaluator)
        names |= self.modes
        self.open = propagated(self.discrete, names, evaluator, self.variables.at_time_zero)
        for event in self.model.held:
            self.parameters.notes.append(
                f"the event 'when' in line {event.line} does not happen in an equilibrium: "
                f"{', '.join(event.names)} keeps its value"
            )

    def _names(self, chosen: Callable[[tree.Declaration], bool]) -> list[str]:
        """Names of the variables, and of entries of arrays, whose declarations are chosen."""
        values = [self.variables.values[d.name] for d in self.declared if chosen(d)]
        return [name for value in values for name in names_in(value)]

    def _of_declaration(self, d: tree.Declaration) -> str:
        return self.place(d.line, f"{d.variability or 'variable'} {d.name!r}")

    def place(self, line: int | None, what: str) -> str:
        """Where something is, and what it is, for messages."""
        return f"{self.model.source}{f', line {line}' if line else ''}: {what}"

    # equations -------------------------------------------------------------------------------

    def _equations(self, statements: Iterable[tree.Statement]) -> list[Equation]:
        return [e for statement in statements for e in self._statement(statement)]

    def _statement(self, statement: tree.Statement) -> list[Equation]:
        match statement:
            case tree.Equation():
                return self._equate(statement)
            case tree.Loop(index, values, body, line):
                loop = self.variables.evaluator.with_index
                runs = self._at(
                    line, f"for {index}", lambda: loop(index, values, lambda: self._equations(body))
                )
                return [e for run in runs for e in run]
            case tree.Choice():
                return self._choose(statement)
            case tree.Check():
                self._check(statement)
        return []

    def _at(self, line: int, what: str, do: Callable[[], T]) -> T:
        """What `do` gives; errors name the line and the text."""
        try:
            return do()
        except SceneError as error:
            if str(error).startswith(self.model.source):
                raise
            raise SceneError(self.place(line, f"{what}: {error}")) from None
        except RecursionError:
            raise SceneError(self.place(line, f"{what[:60]}: is nested too deep.")) from None

    def _value(self, line: int, what: str, expression: Expression) -> Value:
        return self._at(line, what, lambda: self.variables.evaluator.value(expression))

    def _equate(self, written: tree.Equation) -> list[Equation]:
        """The equations of one that is written: one for each entry of arrays."""
        name = shorter(f"{write(written.left)} = {write(written.right)}")
        left, right = (
            self._value(written.line, repr(name), side) for side in (written.left, written.right)
        )
        match written.left, written.right:  # (a, b) = f(...)
            case tree.Call("", targets), tree.Call() as call:
                results = self.variables.evaluator.results
                right = self._at(written.line, repr(name), lambda: results(call)[: len(targets)])
        pairs = self._at(written.line, repr(name), lambda: list(_pairs(left, right)))
        equations = [
            Equation(name if len(pairs) == 1 else f"{name} [{k + 1}]", residual, written.line or None)
            for k, residual in enumerate(pairs)
        ]
        calls = (x for side in (written.left, written.right) for x in tree.walk(side))
        if any(isinstance(x, tree.Call) and x.function.startswith(OF_TIME) for x in calls):
            self.looked_up |= {id(e) for e in equations}
        return equations

    def _check(self, check: tree.Check) -> None:
        """A claim: it is evaluated where it is one on numbers, and at the operating point otherwise."""
        text = f"assert({shorter(write(check.condition))})"
        value = self._value(check.line, text, check.condition)
        if check.warning:
            if value is not True:
                self.parameters.notes.append(f"{text} in line {check.line} is a warning: not checked")
        elif value is not True:
            claim = self.place(check.line, f"{text} does not hold. {check.message}".strip())
            if not isinstance(value, ca.SX):
                raise SceneError(claim)
            self.asserts.append(Condition(claim, self.variables.at_time_zero(value), "assert", 1.0))

    def _choose(self, choice: tree.Choice) -> list[Equation]:
        """Equations of the branch whose condition holds, or choices between those of all branches."""
        made: list[tuple[Value, list[Equation]]] = []
        body = choice.otherwise
        for condition, branch in choice.branches:
            value = self._value(choice.line, f"if {write(condition)}", condition)
            if value is True:
                body = branch
                break
            if value is not False:
                made.append((value, self._equations(branch)))
        chosen = self._equations(body)
        for value, equations in reversed(made):
            if len(equations) != len(chosen):
                counts = f"{len(equations)} and {len(chosen)} equations, expected equally many."
                raise SceneError(self.place(choice.line, f"the branches of 'if' have {counts}"))
            for k, (a, b) in enumerate(zip(equations, chosen, strict=True)):
                residual = v.chosen(value, a.residual, b.residual)
                chosen[k] = replace(a, name=f"{a.name}, or {b.name}", residual=residual)
        return chosen

    # inputs and outputs ----------------------------------------------------------------------

    def _sources(self, equations: list[Equation]) -> tuple[list[Equation], list[str]]:
        """Equations without those of sources, and the variables that they gave.

        A source is a variable that a formula of time and parameters gives; it becomes an input, with its
        value at time 0. Any other use of time is an error.
        """
        others: list[Equation] = []
        sources: dict[str, Equation] = {}
        known = self._of_time(equations)
        for name, value in self.of_time.items():  # guesses for what they are made of
            x = self.variables.by_name[name]
            if not x.fixed and x.start is None:
                self.variables.by_name[name] = replace(x, start=self.variables.at_nominal(value))
        for e in equations:
            source = known.get(id(e))
            of_table = source is not None and id(e) in self.looked_up
            if not of_table and not ca.depends_on(e.residual, self.variables.time):
                others.append(e)
                continue
            if source is None:
                raise SceneError(self.place(e.line, f"{e.name!r} depends on time. {_TIME}"))
            x = self.variables.by_name[source]
            at_zero = self.of_time[source]
            start = self.variables.at_nominal(at_zero)
            of = self.variables.start_of(at_zero)
            self.variables.by_name[x.name] = replace(x, start=start, start_of=of)
            sources[x.name] = e
        used = {x.name for e in others for x in self.variables.of(e.residual)}
        of_tables = [e for e in sources.values() if id(e) in self.looked_up]
        for name in {x.name for e in of_tables for x in self.variables.of(e.residual)} - used:
            e = sources[name]  # the time in a table, and no input
            if id(e) not in self.looked_up:
                x = self.variables.by_name[name]
                others.append(
                    replace(e, residual=x.symbol - self.variables.at_time_zero(self.of_time[name]))
                )
                del sources[name]
        return others, list(sources)

    def _of_time(self, equations: list[Equation]) -> dict[int, str]:
        """Equations that give a variable as a formula of time and parameters, and its name.

        The formula may use variables that such formulas give; `of_time` has their values.
        """
        self.of_time: dict[str, ca.SX] = {}
        known: dict[int, str] = {}
        if not ca.depends_on(column_of(e.residual for e in equations), self.variables.time):
            return known
        rates = column_of(self.variables.rates.values())
        used = [(e, {x.name for x in self.variables.of(e.residual)}) for e in equations]
        used = [(e, names) for e, names in used if not ca.depends_on(e.residual, rates)]
        more = True
        while more:
            more = False
            for e, names in used:
                unknown = names - self.of_time.keys()
                if id(e) in known or len(unknown) != 1:
                    continue
                x = self.variables.by_name[unknown.pop()]
                slope = ca.jacobian(e.residual, x.symbol)
                if slope.is_constant() and abs(float(slope)) == 1.0:
                    others = [self.variables.by_name[name] for name in names - {x.name}]
                    symbols = column_of([x.symbol, *(other.symbol for other in others)])
                    values = column_of([ca.SX(0), *(self.of_time[other.name] for other in others)])
                    formula = ca.substitute(e.residual, symbols, values) / -slope
                    self.of_time[x.name], known[id(e)], more = ca.SX(formula), x.name, True
        return known

    def _inputs(self, sources: list[str]) -> list[str]:
        """Names of inputs: what the model itself declares as one, and sources of time."""
        declared = self._names(lambda d: d.causality == "input" and d.top and d.binding is None)
        names = [*declared, *(name for name in sources if name not in declared)]
        for name in names:
            if name in self.variables.rates:
                raise SceneError(
                    f"{self.model.source}: der({name}) is that of an input. Take the derivative as the "
                    "input, and make a state of what it is the derivative of."
                )
        return names

    def _outputs(self) -> Iterator[Output]:
        """What the table or the declarations say to be outputs."""
        by_name, names = self.variables.by_name, self.table.outputs
        if names is None:
            names = tuple(self._names(lambda d: d.causality == "output" and d.top))
        check_known("variable", names, by_name, f"{self.model.source}: outputs")
        for name in names:
            yield Output(name, by_name[name].symbol, by_name[name].unit)


def _pairs(left: Value, right: Value) -> Iterator[ca.SX]:
    """The residuals of left = right, of each entry of arrays; sums of flows of arrays are equal to 0."""
    if isinstance(left, tuple) and isinstance(right, Fraction) and right == 0:
        right = (right,) * len(left)
    if isinstance(left, tuple) and isinstance(right, tuple) and len(left) == len(right):
        for a, b in zip(left, right, strict=True):
            yield from _pairs(a, b)
        return
    if isinstance(left, dict) and isinstance(right, dict) and left.keys() == right.keys():
        for field, value in left.items():
            yield from _pairs(value, right[field])
        return
    if isinstance(left, tuple | dict) or isinstance(right, tuple | dict):
        raise SceneError(f"{v.described(left)} is to be equal to {v.described(right)}.")
    yield v.to_sx(left) - v.to_sx(right)


@arguments_checked
def operating_point(
    dae: Dae, report: ModelicaReport | None = None, table: ModelicaTable | None = None
) -> DaeTrim:
    """The operating point of a model, with the states and the values that its table asks for.

    Parameters
    ----------
    dae, report
        As `load_modelica` gives them.
    table : ModelicaTable, optional
        By default that of the report.

    Raises
    ------
    StructureError, TrimError, NotRationalError
        As `mbdlft.dae.reduce_index` and `mbdlft.dae.equilibria`.
    SceneError
        The table asks for the start, and for what an equilibrium gives.
    """
    table = table or (report.table if report else ModelicaTable())
    structure = structure_of(dae, report, table)
    if table.point == "start":
        if table.free or table.moving:
            raise SceneError(
                f"{dae.owner}: free and moving are for an equilibrium; the point is the start."
            )
        return start_point(structure, table.at, table.fit)
    return trim(structure, table.at, table.free, table.moving, table.fit)


def notes_of_point(at: DaeTrim) -> list[str]:
    """What a user should know of an operating point that is no equilibrium."""
    if at.at_rest:
        return []
    names = [name_of(q.variable.name, q.order + 1) for q in at.structure.states]
    moving = [f"{name} = {at.nominal[name]:.6g}" for name in names if at.nominal[name]]
    notes = [
        f"note: the operating point is the start, and no equilibrium: {shorter(', '.join(moving))}. The "
        "linear model is that of small deviations from the motion that begins there, at its beginning."
    ] * bool(moving)
    for x in at.structure.dae.variables:
        if x.derivative is not None and x.start is not None and x.name not in at.given:
            value = at.nominal[x.name]
            if round((value - x.start) / x.nominal, _DIGITS):
                notes.append(
                    f"note: {x.name} is {value:.6g} and not its start {x.start:.6g}, by starts of "
                    "states or initial equations. Give it in at of the table, or starts that fit."
                )
    return notes


@arguments_checked
def structure_of(
    dae: Dae, report: ModelicaReport | None = None, table: ModelicaTable | None = None
) -> Structure:
    """The structure of a model, with the states that its table asks for or that it prefers itself.

    Parameters
    ----------
    dae, report, table
        As in `operating_point`.
    """
    table = table or (report.table if report else ModelicaTable())
    if table.states:
        return reduce_index(dae, states=table.states)
    return reduce_index(dae, preferred=() if report is None else report.states)
