"""Functions of a model, written into the equations that call them: run on expressions.

Loops are unrolled; a choice by a signal runs all its branches, and what they set is chosen among. What a
function does that has no such form (external code, ``while``) is an error where it is called.
"""

from collections.abc import Callable
from typing import Any

from mbdlft.base.errors import SceneError
from mbdlft.modelica import tree
from mbdlft.modelica import values as v
from mbdlft.modelica.tree import write
from mbdlft.modelica.values import Value


class Run:
    """A run of a function: the values of its names, and an evaluator that looks them up."""

    def __init__(self, function: tree.Function, evaluator_of: Callable[[Any, Any], Any]) -> None:
        self.function = function
        self.names: dict[str, Value] = {}
        self.evaluator = evaluator_of(self._lookup, _no_derivative)

    def results(self, arguments: list[Value]) -> tuple[Value, ...]:
        """The values of the outputs, in their order; the record that a constructor makes."""
        f = self.function
        if len(arguments) > len(f.inputs):
            raise SceneError(f"{f.name} takes {len(f.inputs)} arguments, got {len(arguments)}.")
        for k, d in enumerate(f.inputs):
            if k >= len(arguments) and d.binding is None:
                raise SceneError(f"{f.name}: the argument {d.name!r} has no value.")
            self.names[d.name] = arguments[k] if k < len(arguments) else self.evaluator.value(d.binding)
        if f.makes_record:
            return ({d.name: self.names[d.name] for d in f.inputs},)
        in_order(list((*f.local, *f.outputs)), self._declare)
        self._run(f.body)
        for d in f.outputs:
            if not _is_set(self.names[d.name]):
                raise SceneError(f"{f.name} gives no value to {d.name!r}.")
        return tuple(self.names[d.name] for d in f.outputs)

    def _declare(self, d: tree.Declaration) -> None:
        value = None if d.binding is None else self.evaluator.value(d.binding)
        if d.binding is None and not any(isinstance(s, tree.Range) for s in d.sizes):
            for size in reversed([self.evaluator.size(size) for size in d.sizes]):
                value = (value,) * size
        self.names[d.name] = value

    def _lookup(self, name: str) -> Value | None:
        value: Any = self.names.get(name)
        if value is None and "." in name:
            whole, _, field = name.rpartition(".")
            record = self._lookup(whole)
            return record.get(field) if isinstance(record, dict) else None
        return value

    def _run(self, body: tuple[tree.Statement, ...]) -> None:
        for statement in body:
            match statement:
                case tree.Assign(targets, value, _):
                    self._assign(targets, value)
                case tree.Loop(index, values, inner, _):
                    self.evaluator.with_index(index, values, lambda inner=inner: self._run(inner))
                case tree.Choice(branches, otherwise, _):
                    self._choose(list(branches), otherwise)
                case tree.Check(condition, message, _):
                    if self.evaluator.value(condition) is False:
                        raise SceneError(f"{self.function.name}: {write(condition)} is false. {message}")
                case tree.Refused(what, _, _) | tree.Equation(what):
                    raise SceneError(f"{self.function.name} has {what}, which is not supported.")

    def _assign(self, targets: tuple[tree.Reference | None, ...], value: tree.Expression) -> None:
        results = (self.evaluator.value(value),)
        if len(targets) > 1:
            results = self.evaluator.results(value)
        for target, result in zip(targets, results, strict=False):
            if target is None:
                continue
            name, *fields = target.name.split(".")
            if name not in self.names:
                raise SceneError(f"{self.function.name}: {name!r} is not declared.")
            self.names[name] = self._with(self.names[name], fields, target.subscripts, result)

    def _with(
        self, old: Any, fields: list[str], subscripts: tuple[tree.Expression, ...], value: Value
    ) -> Value:
        """A value with another one in the place of a field or an entry."""
        if fields:
            inner = self._with((old or {}).get(fields[0]), fields[1:], subscripts, value)
            return {**(old or {}), fields[0]: inner}
        if not subscripts:
            return value
        if not isinstance(old, tuple):
            raise SceneError(f"{self.function.name}: an array has no size.")
        positions = self.evaluator.positions(subscripts[0], len(old))
        entries = list(old)
        several = isinstance(subscripts[0], tree.Range)
        if several and not (isinstance(value, tuple) and len(value) == len(positions)):
            raise SceneError(f"{v.described(value)} is no value of {len(positions)} entries.")
        for place, k in enumerate(positions):
            if not 1 <= k <= len(entries):
                raise SceneError(f"{self.function.name}: an array of {len(old)} has no entry {k}.")
            entry = value[place] if several else value
            entries[k - 1] = self._with(old[k - 1], [], subscripts[1:], entry)
        return tuple(entries)

    def _choose(self, branches: list[Any], otherwise: tuple[tree.Statement, ...]) -> None:
        """Run the branch that holds, or all, choosing among what they set."""
        if not branches:
            self._run(otherwise)
            return
        (condition, body), *others = branches
        truth = self.evaluator.value(condition)
        if truth is False:
            self._choose(others, otherwise)
            return
        before = dict(self.names)
        self._run(body)
        if truth is True:
            return
        first, self.names = self.names, before
        self._choose(others, otherwise)
        second = dict(self.names)
        for name, value in first.items():
            if value is not second[name]:
                self.names[name] = _merged(truth, value, second[name])


def in_order(declarations: list[tree.Declaration], declare: Callable[[tree.Declaration], None]) -> None:
    """Declare each one behind those that it is made of."""
    while declarations:
        later: list[tree.Declaration] = []
        error: SceneError | None = None
        for d in declarations:
            try:
                declare(d)
            except SceneError as why:
                later, error = [*later, d], error or why
        if error is not None and len(later) == len(declarations):
            raise error
        declarations = later


def _merged(truth: Value, first: Value, second: Value) -> Value:
    """What is set if a condition holds, and otherwise; entries that one branch leaves open are open."""
    if isinstance(first, tuple) and isinstance(second, tuple) and len(first) == len(second):
        return tuple(_merged(truth, a, b) for a, b in zip(first, second, strict=True))
    if first is None or second is None:
        return None
    return first if first is second else v.chosen(truth, first, second)


def _is_set(value: Any) -> bool:
    if isinstance(value, tuple):
        return all(map(_is_set, value))
    return value is not None


def _no_derivative(value: Value) -> Value:
    raise SceneError(f"der of {v.described(value)} in a function.")
