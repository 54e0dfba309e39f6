"""Modes: the values of Boolean, Integer and discrete variables at an equilibrium.

Each has a definition, or an event sets it, and then its start holds. They are constants in the
equations; at the equilibrium their definitions have to give them again, for all parameters, and no
relation that decides one of them may be on its switching surface. These are conditions of the DAE.

Initialization gives parameters with `fixed = false`, and values that events hold: their equations and
assignments become their values; those of a tuple, one for each result.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from fractions import Fraction
from typing import Any, NamedTuple

import casadi as ca

from mbdlft.base.errors import SceneError
from mbdlft.dae.dae import Condition
from mbdlft.dae.equilibria import DaeTrim
from mbdlft.dae.text import column_of
from mbdlft.modelica import tree
from mbdlft.modelica import values as v
from mbdlft.modelica.functions import in_order
from mbdlft.modelica.tree import Expression, shorter, write
from mbdlft.modelica.values import Value
from mbdlft.problem.sx.constants import in_doubles

RESULTS = "results"  # the tuple of all results of a call


def initialized(model: tree.FlatModel) -> tree.FlatModel:
    """A model whose parameters with `fixed = false`, and what is discrete, have values of their own.

    Initial equations that give none of these stay as they are; so does a parameter that none gives.
    """
    model = replace(model, declarations=tuple(_set_by_events(model)))
    declared = {d.name: d for d in model.declarations}
    given: dict[str, Expression] = {}
    others: list[tree.Statement] = []
    pairs = [(statement, dict(_given(statement, declared))) for statement in model.initial]
    while True:
        implicit = {
            name
            for name, d in declared.items()
            if d.variability == "parameter" and not d.sizes and d.binding is None
            if d.attributes.get("fixed") == tree.Truth(value=False)
        } - {name.partition("[")[0] for _, values in pairs for name in values}
        later = [
            (statement, values)
            for statement, values in pairs
            if not any(r.name in implicit for x in values.values() for r in tree.references(x))
        ]
        if len(later) == len(pairs):
            break
        others += [statement for statement, values in pairs if (statement, values) not in later]
        pairs = later
    for statement, values in pairs:
        if values and not values.keys() & given.keys():
            given |= values
        else:
            others.append(statement)
    given = _whole(given)
    starts = {
        name: d.attributes["start"]
        for name, d in declared.items()
        if d.attributes.get("fixed") == tree.Truth(value=True) and "start" in d.attributes
        if d.variability not in ("parameter", "constant")
    }

    def start(node: Expression) -> Expression | None:
        if node == tree.Reference("time"):
            return tree.Number("0")
        return starts.get(node.name) if isinstance(node, tree.Reference) else None

    def with_value(d: tree.Declaration) -> tree.Declaration:
        if d.name not in given:
            return d
        value = tree.replaced(given[d.name], start)
        attributes = {key: x for key, x in d.attributes.items() if key not in ("fixed", "start")}
        if d.variability == "parameter":
            return replace(d, binding=value, attributes=attributes)
        return replace(d, attributes={**attributes, "start": value})

    return replace(model, declarations=tuple(map(with_value, model.declarations)), initial=tuple(others))


def _set_by_events(model: tree.FlatModel) -> Iterator[tree.Declaration]:
    """Declarations; what an event sets is discrete."""
    names = {name for event in model.held for name in event.names}
    for d in model.declarations:
        yield replace(d, variability="discrete") if d.name in names and not d.variability else d


def is_discrete(d: tree.Declaration) -> bool:
    """Whether events alone change a variable."""
    constant = d.variability in ("parameter", "constant")
    return not constant and (d.variability == "discrete" or d.type != "Real")


def _given(
    statement: tree.Statement, declared: Mapping[str, tree.Declaration]
) -> Iterator[tuple[str, Expression]]:
    """Names, and the values that a statement gives to them, if it gives values to nothing else."""

    def is_open(target: Expression | None) -> bool:
        if not isinstance(target, tree.Reference) or target.name not in declared:
            return False
        if not all(isinstance(subscript, tree.Number) for subscript in target.subscripts):
            return False
        d = declared[target.name]
        loose = d.attributes.get("fixed") == tree.Truth(value=False)
        return is_discrete(d) or (d.variability == "parameter" and loose and d.binding is None)

    match statement:
        case tree.Equation(tree.Call("", targets), value) | tree.Assign(targets, value):
            if all(map(is_open, targets)):
                whole = tree.Call(RESULTS, (value,)) if len(targets) > 1 else None
                for k, target in enumerate(targets):
                    entry = whole and tree.Entry(whole, (tree.Number(str(k + 1)),))
                    yield write(target), entry or value  # type: ignore[arg-type]
        case tree.Equation(tree.Call("pre", (target,)), value) if is_open(target):
            yield write(target), value
        case tree.Equation(left, right) if is_open(left):
            yield write(left), right
        case tree.Equation(left, right) if is_open(right):
            yield write(right), left
        case tree.Loop(index, tree.Range(tree.Number(first), tree.Number("1"), tree.Number(last)), body):
            for k in range(int(first), int(last) + 1):
                at = tree.Number(str(k))
                for inner in body:
                    if isinstance(inner, tree.Equation):
                        put = _put(index, at)
                        left, right = (tree.replaced(side, put) for side in (inner.left, inner.right))
                        yield from _given(tree.Equation(left, right, inner.line), declared)
        case tree.Choice(branches, otherwise):
            made = [dict(_of_block(body, declared)) for body in (*(b for _, b in branches), otherwise)]
            if all(block.keys() == made[0].keys() for block in made):
                for name in made[0]:
                    chosen = tuple(
                        (when, block[name]) for (when, _), block in zip(branches, made, strict=False)
                    )
                    yield name, tree.If(chosen, made[-1][name])


def _put(index: str, value: Expression) -> Callable[[Expression], Expression | None]:
    return lambda node: value if node == tree.Reference(index) else None


def _whole(given: Mapping[str, Expression]) -> dict[str, Expression]:
    """Values by name; those of the entries of a vector become one array."""
    values = {name: value for name, value in given.items() if not name.endswith("]")}
    entries = [name for name in given if name.endswith("]")]
    for whole in dict.fromkeys(name.rpartition("[")[0] for name in entries):
        count = sum(name.rpartition("[")[0] == whole for name in entries)
        names = [f"{whole}[{k + 1}]" for k in range(count)]
        if all(name in given for name in names):
            values[whole] = tree.Array(tuple(given[name] for name in names))
    return values


def _of_block(
    body: tuple[tree.Statement, ...], declared: Mapping[str, tree.Declaration]
) -> Iterator[tuple[str, Expression]]:
    for statement in body:
        yield from _given(statement, declared)


_STARTS: Mapping[str, Value] = {
    "Boolean": False,
    "Integer": Fraction(0),
    "Real": Fraction(0),
    "String": "",
}


class Discrete(NamedTuple):
    """What is discrete in a model: declarations, definitions by name with lines, events."""

    declared: Mapping[str, tree.Declaration]
    definitions: Mapping[str, tuple[Expression, int]]
    events: tuple[tree.Event, ...]

    @property
    def undefined(self) -> tuple[tree.Declaration, ...]:
        """Those that no equation and no event gives."""
        held = {name for event in self.events for name in event.names}
        return tuple(
            d for name, d in self.declared.items() if name not in held and not self._is_defined(name)
        )

    def _is_defined(self, name: str) -> bool:
        return any(key == name or key.startswith(f"{name}[") for key in self.definitions)


def without_discrete(model: tree.FlatModel) -> tuple[tree.FlatModel, Discrete]:
    """A model without its discrete variables and their equations, and these."""
    declared = {d.name: d for d in model.declarations if is_discrete(d)}
    definitions = {name: (d.binding, d.line) for name, d in declared.items() if d.binding is not None}
    held = {name for event in model.held for name in event.names}
    others: list[tree.Statement] = []
    pending: list[tree.Equation] = []
    for e in model.equations:
        is_of = isinstance(e, tree.Equation) and any(_of(side, declared) for side in (e.left, e.right))
        (pending if is_of else others).append(e)  # type: ignore[arg-type]
    pending.sort(key=lambda e: all(_of(side, declared) for side in (e.left, e.right)))
    while pending:
        later = []
        for e in pending:
            known = [_of(side, declared) for side in (e.left, e.right)]
            free = [k for k, name in enumerate(known) if name and name not in {*definitions, *held}]
            if not free and not all(known):  # it gives a value to what is not discrete
                others.append(e)
            elif len(free) == 1:
                side = (e.right, e.left)[free[0]]
                definitions[str(known[free[0]])] = (side, e.line)
            else:
                later.append(e)
        if len(later) == len(pending):
            e = later[0]
            text = f"{write(e.left)} = {write(e.right)}"
            raise SceneError(
                f"{model.source}, line {e.line}: {text!r} defines no discrete variable of its own."
            )
        pending = later
    kept = tuple(d for d in model.declarations if d.name not in declared)
    return replace(model, declarations=kept, equations=tuple(others)), Discrete(
        declared, definitions, model.held
    )


def _of(side: Expression, declared: Mapping[str, Any]) -> str:
    """The discrete variable, or its entry, that a side of an equation is."""
    return write(side) if isinstance(side, tree.Reference) and side.name in declared else ""


def start_all(discrete: Discrete, names: dict[str, Value], evaluator: Any) -> None:
    """Give each one its value at the start, among all values of the model."""

    def start(d: tree.Declaration) -> None:
        given = d.attributes.get("start")
        value: Value = _STARTS.get(d.type, "") if given is None else evaluator.value(given)
        for size in reversed(d.sizes):
            value = value if isinstance(value, tuple) else (value,) * evaluator.size(size)
        names[d.name] = value

    in_order(list(discrete.declared.values()), start)


def propagated(
    discrete: Discrete, names: dict[str, Value], evaluator: Any, at_start: Callable[[ca.SX], ca.SX]
) -> dict[str, Value]:
    """Give each mode the value of its definition where that is a constant; the other ones remain.

    `names` are all values of the model, and `at_start` takes an expression at time zero.
    """
    open_: dict[str, Value] = {}
    for _ in range(len(discrete.definitions) + 1):
        changed = False
        for name, (definition, _) in discrete.definitions.items():
            value = v.each(
                lambda x: at_start(x) if isinstance(x, ca.SX) else x, evaluator.value(definition)
            )
            value = _plain(value, discrete, name)
            if _is_open(value):
                open_[name] = value
                continue
            open_.pop(name, None)
            changed |= _set(names, name, value)
        if not changed:
            return open_
    raise SceneError(f"the modes {', '.join(discrete.definitions)} have no values that stay.")


def _plain(value: Value, discrete: Discrete, name: str) -> Value:
    """A truth or a number where an expression is one."""
    kind = discrete.declared[name.partition("[")[0]].type

    def of(x: Value) -> Value:
        number = v.number_of(x) if isinstance(x, ca.SX) else None
        x = x if number is None else bool(number) if kind == "Boolean" else number
        return _of_type(x, kind, name)

    return v.each(of, value)


def _of_type(value: Value, kind: str, name: str) -> Value:
    """A value, which is no truth for a number, no number for a truth, and whole for an Integer."""
    is_wrong = {
        "Boolean": isinstance(value, Fraction),
        "Integer": isinstance(value, bool) or (isinstance(value, Fraction) and value.denominator > 1),
    }
    if is_wrong.get(kind, False):
        raise SceneError(f"{name} is of type {kind}, and its equation gives {v.described(value)}.")
    return value


def _is_open(value: Value) -> bool:
    if isinstance(value, tuple):
        return any(map(_is_open, value))
    return isinstance(value, ca.SX)


def _set(names: dict[str, Value], name: str, value: Value) -> bool:
    """Give a mode its value; whether that is another one."""
    before = names.get(name)
    names[name] = value
    whole, bracket, inside = name.partition("[")
    if bracket:
        names[whole] = _with(names[whole], [int(k) for k in inside[:-1].split(",")], value)
    return bool(before != value)


def _with(old: tuple[Value, ...], entry: list[int], value: Value) -> Value:
    first, *others = entry
    inner = _with(old[first - 1], others, value) if others else value
    return (*old[: first - 1], inner, *old[first:])


class Point:
    """Numbers of expressions at an equilibrium."""

    def __init__(self, at: DaeTrim, nominal: Mapping[str, float]) -> None:
        rates = {
            f"der({a.name})": float(a.factor) * at.nominal.get(f"der({a.of})", 0.0)
            for a in at.structure.aliases
        }
        self.numbers = {**rates, **at.nominal, **nominal, "time": 0.0}

    def number(self, expression: ca.SX) -> float:
        """The number of an expression."""
        symbols = ca.symvar(expression)
        function = ca.Function("point", [column_of(symbols)], [in_doubles(expression)])
        return float(function([self.numbers.get(s.name(), 0.0) for s in symbols]))


def conditions_of(
    discrete: Discrete,
    open_: Mapping[str, Value],
    found: Mapping[str, Value],
    variables: Any,
    place: Callable[[int | None, str], str],
) -> Iterator[Condition]:
    """That modes are what is found of their definitions, and that no event happens."""
    at_start = variables.at_time_zero
    for name, value in found.items():
        definition, line = discrete.definitions[name]
        text = place(line, f"{name} = {shorter(write(definition))}")
        for expression, number in zip(_scalars(open_[name]), _scalars(value), strict=True):
            if isinstance(expression, ca.SX):
                yield Condition(text, expression, "mode", float(number))
    for event in discrete.events:
        for condition in event.conditions:
            for node in tree.walk(condition):
                if isinstance(node, tree.Binary) and node.operator in tree.RELATIONS:
                    relation = variables.evaluator.value(node)
                    if isinstance(relation, ca.SX) and ca.symvar(at_start(relation)):
                        text = place(event.line, f"the event at {write(node)}")
                        yield Condition(text, at_start(relation), "event")


def _scalars(value: Value) -> Iterator[Value]:
    if isinstance(value, tuple):
        for entry in value:
            yield from _scalars(entry)
    else:
        yield value


def found_at(discrete: Discrete, open_: Mapping[str, Value], point: Point) -> dict[str, Value]:
    """What the definitions give at an equilibrium."""
    made = {}
    for name, value in open_.items():
        whole = discrete.declared[name.partition("[")[0]]

        def of(x: Value, kind: str = whole.type, name: str = name) -> Value:
            if not isinstance(x, ca.SX):
                return x
            number = point.number(x)
            return bool(number) if kind == "Boolean" else _of_type(Fraction(number), kind, name)

        made[name] = v.each(of, value)
    return made
