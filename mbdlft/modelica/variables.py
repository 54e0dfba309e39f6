"""Parameters, constants and variables of a model: values, symbols, and what stays in the linear model.

A parameter stays if the table or an annotation says so, or if its declaration has `min` and `max` and
either belongs to the model itself or has `nominal`, too: types of libraries give limits to parameters of
components. Values of others are numbers, or expressions of those that stay.
"""

import math
import re
from collections.abc import Callable, Container, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from fractions import Fraction
from graphlib import CycleError, TopologicalSorter
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
from scipy.optimize import root

from mbdlft.base.errors import SceneError, check_known, naming
from mbdlft.base.parameter import Parameter
from mbdlft.base.unit import ANGLE_UNITS
from mbdlft.dae.dae import Variable
from mbdlft.dae.text import column_of
from mbdlft.exact.numbers import decimal
from mbdlft.modelica import tree
from mbdlft.modelica import values as v
from mbdlft.modelica.evaluation import Evaluator, unit_of
from mbdlft.modelica.table import ModelicaTable
from mbdlft.modelica.tree import Expression, write
from mbdlft.modelica.values import Value, described, number_of
from mbdlft.multibody.scene.toml import read_parameters
from mbdlft.problem.sx.constants import in_doubles

_SOLVED = 1e-7  # of the last step of Newton's method, behind which there is one more
_NO_LIMIT = Fraction(10) ** 30  # libraries write 1e60 for what has no limit
_MOST_ENTRIES = 100_000  # of an array of variables
_NOT_OF_NAMES = re.compile(r"\W+")
_RANGE = frozenset(("percent", "plus", "minus", "low", "high"))


class Parameters(NamedTuple):
    """Parameters and constants by their names in the model."""

    values: dict[str, Value]
    kept: dict[str, Parameter]  # those that stay
    symbols: dict[str, ca.SX]  # of these
    notes: list[str]


def read_values(
    model: tree.FlatModel, table: ModelicaTable, place: Callable[[tree.Declaration], str]
) -> Parameters:
    """Values of all parameters and constants, in the order in which they depend on each other."""
    declared: dict[str, tree.Declaration] = {}
    for d in model.declarations:
        if d.variability in ("parameter", "constant"):
            if d.name in declared:
                raise SceneError(f"{place(d)}: it is declared twice.")
            declared[d.name] = d
    check_known("parameter", (*table.parameters, *table.values), declared, model.source)
    parameters = Parameters({}, {}, {}, [])

    def no_derivative(value: Value) -> Value:
        raise SceneError(f"der of the parameter {described(value)}.")

    sized = {d.name: d.sizes for d in model.declarations if d.name not in declared and d.sizes}
    records = {name: fields for name, fields in model.records.items() if _has_all(name, fields, declared)}
    evaluator = Evaluator(
        lambda name: (
            _unset(sized[name]) if name in sized else _value_of(name, parameters.values, records)
        ),
        no_derivative,
        model.functions,
    )
    open_, equations = _initialized(model, declared)
    starts = [d.attributes["start"] for d in open_.values() if "start" in d.attributes]
    sides = [side for e in equations for side in (e.left, e.right)]
    needed = {reference.name for x in (*starts, *sides) for reference in tree.references(x)}
    solved: dict[str, Fraction] = {}
    for name in _ordered(declared, records, place, dict.fromkeys(open_, needed - open_.keys())):
        d = declared[name]
        with naming(place(d), SceneError):
            if name in open_:
                solved = solved or _solution(open_, equations, parameters.values, evaluator)
                parameters.values[name] = solved[name]
                continue
            parameters.values[name] = value = _value(d, table, evaluator)
            if d.type == "Integer" and isinstance(value, Fraction) and value.denominator != 1:
                raise SceneError(f"expected a whole number, got {float(value):g}.")
            entry = table.parameters.get(name)
            if d.type == "Real":
                _keep(d, entry, evaluator, parameters)
            elif isinstance(entry, Mapping):
                raise SceneError(f"it is of type {d.type}; only a Real can stay. Declare it as one.")
            elif d.variability == "parameter" and d.top and _limits(d, evaluator):
                parameters.notes.append(f"{name} has min and max, and is a number: it is an {d.type}")
            elif table.parameters.get(name):
                raise SceneError(f"it is of type {d.type}; only numbers of type Real can stay.")
    return parameters


def depending(model: tree.FlatModel, names: Iterable[str]) -> set[str]:
    """Names of parameters, and of all whose values are made of theirs."""
    reached, before = set(names), -1
    needed = {d.name: _needed(d) for d in model.declarations} if reached else {}
    while len(reached) > before:
        before = len(reached)
        reached |= {name for name, used in needed.items() if used & reached}
    return reached


def _initialized(
    model: tree.FlatModel, declared: Mapping[str, tree.Declaration]
) -> tuple[dict[str, tree.Declaration], list[tree.Equation]]:
    """Parameters that initial equations of parameters alone give, and these, as many; or none."""
    open_ = {
        name: d
        for name, d in declared.items()
        if d.attributes.get("fixed") == tree.Truth(value=False) and d.binding is None and not d.sizes
    }
    equations = []
    for e in model.initial:
        if isinstance(e, tree.Equation):
            names = {r.name for side in (e.left, e.right) for r in tree.references(side)}
            if names <= declared.keys() and names & open_.keys():
                equations.append(e)
    return (open_, equations) if open_ and len(equations) == len(open_) else ({}, [])


def _solution(
    open_: Mapping[str, tree.Declaration],
    equations: Sequence[tree.Equation],
    values: dict[str, Value],
    evaluator: Evaluator,
) -> dict[str, Fraction]:
    """The values of unknown parameters by their equations, from their starts; in doubles."""
    starts = [evaluator.value(d.attributes.get("start", tree.Number("0"))) for d in open_.values()]
    values |= {name: ca.SX.sym(name) for name in open_}
    z = column_of(values[name] for name in open_)
    sides = [(evaluator.value(e.left), evaluator.value(e.right)) for e in equations]
    residual = in_doubles(column_of(v.to_sx(a) - v.to_sx(b) for a, b in sides))
    if len(ca.symvar(residual)) > len(open_):
        raise SceneError(
            "initial equations give its value from parameters that stay. Keep these numbers."
        )
    system = ca.Function("initial", [z], [residual, ca.jacobian(residual, z)])
    at = root(
        lambda x: system(x)[0].full()[:, 0],
        np.array(starts, dtype=float),
        jac=lambda x: system(x)[1].full(),
    ).x
    step = np.linalg.lstsq(system(at)[1].full(), system(at)[0].full()[:, 0])[0]
    if not np.all(np.abs(step) <= _SOLVED * np.abs(at)):
        raise SceneError("its initial equations have no solution near its start value. Give it a number.")
    return dict(zip(open_, map(decimal, at - step), strict=True))


def _has_all(name: str, fields: tuple[str, ...], declared: Container[str]) -> bool:
    return bool(fields) and all(f"{name}.{field}" in declared for field in fields)


def _unset(sizes: tuple[Expression, ...]) -> Value:
    """An array whose sizes alone are known; values of parameters may be made of these."""
    array: Value = "the value of a variable"
    for size in reversed(sizes):
        array = (array,) * (int(size.text) if isinstance(size, tree.Number) else 0)
    return array


def _value_of(
    name: str, values: Mapping[str, Value], records: Mapping[str, tuple[str, ...]]
) -> Value | None:
    """The value of a name: of a record, those of its fields."""
    if name in values or name not in records:
        return values.get(name)
    return {field: values[f"{name}.{field}"] for field in records[name]}


def _ordered(
    declared: Mapping[str, tree.Declaration],
    records: Mapping[str, tuple[str, ...]],
    place: Callable[[tree.Declaration], str],
    solved: Mapping[str, set[str]],
) -> list[str]:
    """Names such that each comes behind those that it depends on; `solved` says so of unknowns."""
    graph: dict[str, set[str]] = {}
    for name, d in declared.items():
        needed = solved.get(name) or _needed(d)
        fields = {f"{record}.{field}" for record in needed & records.keys() for field in records[record]}
        graph[name] = (needed | fields) & declared.keys()
    try:
        return list(TopologicalSorter(graph).static_order())
    except CycleError as error:
        names = error.args[1]
        raise SceneError(
            f"{place(declared[names[0]])}: its value depends on itself: {' -> '.join(names[::-1])}. Give "
            "one of them a number."
        ) from None


def _needed(d: tree.Declaration) -> set[str]:
    """Names that the value and the limits of a parameter are made of."""
    limits = [d.attributes.get(key) for key in ("min", "max", "nominal")]
    expressions = [x for x in (_binding(d), *d.sizes, *limits) if x is not None]
    used = [reference for x in expressions for reference in tree.references(x)]
    return {name for reference in used for name in (reference.name, write(reference))}


def _binding(d: tree.Declaration) -> Expression | None:
    """What gives a parameter its value: that of its start, as the language says, if it has no other."""
    return d.attributes.get("start") if d.binding is None else d.binding


def _value(d: tree.Declaration, table: ModelicaTable, evaluator: Evaluator) -> Value:
    if d.name in table.values:
        if d.sizes or d.type != "Real":
            raise SceneError("the table gives a value to it; that is for numbers of type Real.")
        return decimal(table.values[d.name])
    if d.sizes and tree.Number("0") in d.sizes:
        return ()
    if d.attributes.get("fixed") == tree.Truth(value=False):
        raise SceneError("fixed = false: initial equations give its value. Give it a number.")
    binding = _binding(d)
    entry = table.parameters.get(d.name)
    if binding is None and isinstance(entry, Mapping) and "nominal" in entry:
        return decimal(float(entry["nominal"]))
    if binding is None:
        raise SceneError("it has no value. Give it one there, or under [values] of the table.")
    if tree.Reference("time") in tree.references(binding):
        raise SceneError("its value depends on time.")
    value = evaluator.value(binding)
    for size in reversed(d.sizes):
        if isinstance(value, tuple) or isinstance(size, tree.Range):
            break
        value = (value,) * evaluator.size(size)
    return value


def _keep(d: tree.Declaration, entry: Any, evaluator: Evaluator, parameters: Parameters) -> None:
    """Let a parameter stay if it is one of those that do; its value becomes a symbol.

    `entry` is what the table says of it, or None.
    """
    limits = _limits(d, evaluator)
    asked = isinstance(entry, Mapping) or bool(d.annotation)
    if entry is False or d.variability != "parameter" or not (asked or limits):
        if asked:
            raise SceneError("it is a constant; only a parameter can stay.")
        return
    value = parameters.values[d.name]
    if not isinstance(value, Fraction):
        if asked:
            raise SceneError(
                f"its value is {described(value)}, and only a number can stay. Let those stay that it is "
                "made of."
            )
        return
    if not asked and not (d.top or "nominal" in d.attributes):
        parameters.notes.append(
            f"{d.name} has min and max, and is the number {float(value):g}; to keep it, name it in "
            "the table"
        )
        return
    if not asked and not min(limits.values()) < value < max(limits.values()):
        raise SceneError(
            f"its value {float(value):g} is not inside of its range, above {float(limits['low']):g} and "
            f"below {float(limits['high']):g}. Move one of them, or keep it a number: {d.name} = false "
            "in the table."
        )
    annotated = {key: evaluator.value(annotation) for key, annotation in d.annotation.items()}
    fields: dict[str, Any] = {"nominal": value, **limits, **annotated}
    entries = dict(entry) if isinstance(entry, Mapping) else {}
    if entries.keys() & _RANGE:
        fields = {key: x for key, x in fields.items() if key not in _RANGE}
    fields |= entries
    label = fields.pop("name", _NOT_OF_NAMES.sub("_", d.name).strip("_"))  # load_J of load.J
    fields["unit"] = _unit(d, fields, parameters.notes)
    plain = {key: float(x) if isinstance(x, Fraction) else x for key, x in fields.items()}
    (parameter,) = read_parameters({"parameters": {label: plain}})
    if any(parameter.name == other.name for other in parameters.kept.values()):
        raise SceneError(f"two parameters would have the name {parameter.name}; give one a name.")
    parameters.kept[d.name] = parameter
    parameters.symbols[d.name] = parameters.values[d.name] = ca.SX.sym(parameter.name)


def _limits(d: tree.Declaration, evaluator: Evaluator) -> dict[str, Fraction]:
    """low and high of a declaration that has both."""
    if d.sizes or not {"min", "max"} <= d.attributes.keys():
        return {}
    low, high = (number_of(evaluator.value(d.attributes[key])) for key in ("min", "max"))
    if low is None or high is None or max(abs(low), abs(high)) >= _NO_LIMIT:
        return {}
    return {"low": low, "high": high}


def _unit(d: tree.Declaration, fields: Mapping[str, Any], notes: list[str]) -> str:
    """The unit of a parameter that stays; an angle is one only if a substitution is asked for."""
    if "unit" in fields:
        return str(fields["unit"])
    unit = _declared_unit(d, notes)
    if unit not in ANGLE_UNITS:
        return unit
    if "substitution" not in fields:
        return "1"
    if unit != "rad":
        raise SceneError("a substitution is for an angle in rad.")
    return unit


def _declared_unit(d: tree.Declaration, notes: list[str]) -> str:
    """The unit of a declaration; "1" and a note if it is not known here."""
    attribute = d.attributes.get("unit")
    if not isinstance(attribute, tree.Text) or not attribute.text.strip():
        return "1"
    unit = unit_of(attribute.text)
    if unit is None:
        notes.append(f"the unit {attribute.text!r} of {d.name} is not known here; it is not checked")
        return "1"
    return unit


class Variables:
    """Variables by name, and the values of all names of a model; `place` says where one is declared."""

    def __init__(
        self,
        parameters: Parameters,
        place: Callable[[tree.Declaration], str],
        functions: Mapping[str, tree.Function],
        delay: int | None = None,
    ) -> None:
        self.parameters, self.place = parameters, place
        self.time = ca.SX.sym("time")
        self.values: dict[str, Value] = {**parameters.values, "time": self.time}
        self.by_name: dict[str, Variable] = {}  # one for each entry of an array
        self.rates: dict[str, ca.SX] = {}  # symbols of derivatives that occur
        self.order = delay
        self.delayed: list[tuple[str, ca.SX]] = []  # equations of delays, and what they are called
        self.evaluator = Evaluator(self.values.get, self.derivative, functions, self.delay)

    def declare(self, d: tree.Declaration) -> None:
        """Symbols and variables of a declaration, of each entry of an array."""
        if d.name in self.values:
            raise SceneError(f"{self.place(d)}: it is declared twice.")
        with naming(self.place(d), SceneError):
            sizes = [self.evaluator.size(size) for size in d.sizes]
            if math.prod(sizes) > _MOST_ENTRIES:
                raise SceneError(f"an array has at most {_MOST_ENTRIES} entries, got {math.prod(sizes)}.")
            unit = _declared_unit(d, self.parameters.notes)
            self.values[d.name] = self._symbols(d, unit, sizes, ())

    def declare_records(self, records: Mapping[str, tuple[str, ...]]) -> None:
        """The values of records whose fields are declared."""
        for name, fields in records.items():
            if name not in self.values and _has_all(name, fields, self.values):
                self.values[name] = {field: self.values[f"{name}.{field}"] for field in fields}

    def all(self) -> tuple[Variable, ...]:
        """All variables, with the derivatives that occur."""
        return tuple(replace(x, derivative=self.rates.get(x.name)) for x in self.by_name.values())

    def of(self, expression: ca.SX) -> list[Variable]:
        pairs = [(s, self.by_name.get(s.name())) for s in ca.symvar(expression)]
        return [x for symbol, x in pairs if x is not None and ca.is_equal(x.symbol, symbol)]

    def derivative(self, value: Value) -> Value:
        """der of an expression: the sum over its variables of its slopes times their derivatives."""
        if isinstance(value, Fraction):
            return value * 0
        expression = v.to_sx(value)
        if ca.depends_on(expression, self.time):
            raise SceneError("der of a function of time is not supported.")
        if ca.depends_on(expression, column_of(self.rates.values())):
            raise SceneError("der of a derivative: write v = der(x), and der(v).")
        derivative: Value = Fraction(0)
        for x in self.of(expression):
            rate = self.rates.setdefault(x.name, ca.SX.sym(f"der({x.name})"))
            slope = ca.jacobian(expression, x.symbol)
            derivative = v.binary("+", derivative, rate if slope.is_one() else slope * rate)
        return derivative

    def delay(self, value: Value, time: Value) -> Value:
        """A value a time ago: its Pade approximation, whose states are new variables.

        T^k x^(k) are its states x[k]; sum of c[k] T^k x^(k) = value, sum of c[k] (-T)^k x^(k) the result.
        """
        n = self.order
        if n is None:
            raise SceneError(
                "delay() has no linear model of finite order; delay = 3 under [linearize] of the table "
                "puts a Pade approximation in its place."
            )
        count = len(self.delayed) // n + 1
        states = []
        for k in range(n):
            name = f"delay{count}.x[{k + 1}]"
            states.append(ca.SX.sym(name))
            self.by_name[name] = Variable(name, states[-1], "1")
        c = [Fraction(math.comb(n, k), math.perm(2 * n, k)) for k in range(n + 1)]
        known: Value = v.total(tuple(v.binary("*", c[k], x) for k, x in enumerate(states)))
        highest = v.binary("/", v.binary("-", value, known), c[n])
        for k, following in enumerate((*states[1:], v.to_sx(highest))):
            rate = v.binary("*", time, self.derivative(states[k]))
            self.delayed.append((f"delay {count} [{k + 1}]", v.to_sx(rate) - following))
        signs = [(-1) ** k * c[k] for k in range(n + 1)]
        terms = zip(signs, (*states, highest), strict=True)
        return v.total(tuple(v.binary("*", sign, x) for sign, x in terms))

    def at_time_zero(self, expression: ca.SX) -> ca.SX:
        """An expression at time zero, if it depends on time and parameters alone."""
        if self.of(expression) or not ca.depends_on(expression, self.time):
            return expression
        at_zero = ca.substitute(expression, self.time, 0)
        return ca.SX(at_zero if ca.symvar(at_zero) else ca.DM(ca.evalf(at_zero)))

    def at_nominal(self, value: Value) -> float:
        """The number that a value has at nominal values of the parameters, and at time 0."""
        number = v.number_of(value)
        if number is not None:
            return float(v.in_range(number))
        expression = in_doubles(v.to_sx(value))
        for x in self.of(expression):
            raise SceneError(f"it depends on the variable {x.name}.")
        nominal = {p.name: p.nominal for p in self.parameters.kept.values()} | {"time": 0.0}
        symbols = ca.symvar(expression)
        function = ca.Function("nominal", [column_of(symbols)], [expression])
        return float(function([nominal[symbol.name()] for symbol in symbols]))

    def _symbols(
        self, d: tree.Declaration, unit: str, sizes: Sequence[int], entry: tuple[int, ...]
    ) -> Value:
        if sizes:
            entries = range(1, sizes[0] + 1)
            return tuple(self._symbols(d, unit, sizes[1:], (*entry, k)) for k in entries)
        name = d.name + (f"[{','.join(map(str, entry))}]" if entry else "")
        if name in self.by_name:
            raise SceneError(f"{name!r} is declared twice.")
        low, high = self._number(d, "min", entry), self._number(d, "max", entry)
        self.by_name[name] = Variable(
            name,
            ca.SX.sym(name),
            unit,
            start=self._number(d, "start", entry),
            start_of=self.start_of(self._entry(d, "start", entry)),
            fixed=d.attributes.get("fixed") == tree.Truth(value=True),
            nominal=abs(self._number(d, "nominal", entry) or 1.0),
            minimum=-math.inf if low is None else low,
            maximum=math.inf if high is None else high,
            comment=d.comment,
        )
        return self.by_name[name].symbol

    def _number(self, d: tree.Declaration, key: str, entry: tuple[int, ...]) -> float | None:
        """The number that an attribute has, of one entry of an array."""
        value = self._entry(d, key, entry)
        with naming(key, SceneError):
            return None if value is None else self.at_nominal(value)

    def _entry(self, d: tree.Declaration, key: str, entry: tuple[int, ...]) -> Value | None:
        """The value that an attribute has, of one entry of an array."""
        if key not in d.attributes:
            return None
        value = self.evaluator.value(d.attributes[key])
        for k in entry:
            value = value[k - 1] if isinstance(value, tuple) and k <= len(value) else value
        return value

    def start_of(self, value: Value | None) -> ca.SX | None:
        """A start value in terms of parameters that stay, at time zero; None if it depends on none."""
        if value is None or v.number_of(value) is not None:
            return None
        expression = v.to_sx(value)
        time = [s for s in ca.symvar(expression) if s.name() == "time"]
        expression = ca.substitute(expression, column_of(time), ca.SX.zeros(len(time)))
        kept = {*self.parameters.kept}
        return expression if any(s.name() in kept for s in ca.symvar(expression)) else None


def names_in(value: Value) -> Iterator[str]:
    """Names of the symbols of a variable or an array of variables."""
    if isinstance(value, tuple):
        for entry in value:
            yield from names_in(entry)
    else:
        yield str(value.name())
