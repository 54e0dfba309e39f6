"""Expressions of Modelica, evaluated: names are looked up, functions are applied, arrays are indexed."""

from collections.abc import Callable, Mapping
from fractions import Fraction
from functools import partial, reduce
from typing import Any

from mbdlft.base.errors import SceneError
from mbdlft.modelica import tree
from mbdlft.modelica import values as v
from mbdlft.modelica.tree import Expression
from mbdlft.modelica.values import Value

_EVENTS = (
    *("pre", "edge", "change", "sample", "reinit", "initial", "terminal", "delay"),
    *("spatialDistribution", "div", "mod", "rem"),
)
# their value here is their first argument
_SAME = ("noEvent", "homotopy", "scalar", "vector", "pure")
_LIBRARY = "Modelica.Math."  # whose functions have the names of those of the language
_MOST_ENTRIES = 10_000
_LONG, _MOST_FACTORS = 50, 1000


class Evaluator:
    """Evaluates expressions: `lookup` is the value of a name, or None; `derivative` is der of a value."""

    def __init__(
        self, lookup: Callable[[str], Value | None], derivative: Callable[[Value], Value]
    ) -> None:
        self.lookup, self.derivative = lookup, derivative
        self.indices: dict[str, Value] = {}

    def value(self, expression: Expression) -> Value:
        """The value of an expression."""
        match expression:
            case tree.Number(text):
                return Fraction(text)
            case tree.Text(value) | tree.Truth(value):
                return value
            case tree.Reference():
                return self._reference(expression)
            case tree.Binary():
                return self._chain(*tree.spine(expression))
            case tree.Unary(operator, operand):
                operand_value = self.value(operand)
                return v.opposite(operand_value) if operator == "not" else v.negative(operand_value)
            case tree.Call(function, arguments):
                return self._call(function, arguments)
            case tree.If(branches, otherwise):
                return self._if(branches, otherwise)
            case tree.Array(entries):
                return tuple(self.value(entry) for entry in entries)
            case tree.Range():
                return self.range_of(expression)
            case tree.Comprehension(entry, index, values):
                return tuple(self.with_index(index, values, lambda: self.value(entry)))

    def _chain(self, first: Expression, operations: list[tuple[str, Expression]]) -> Value:
        """first (operator) right ...; a long sum is added in pairs: CasADi does not take deep graphs."""
        total = self.value(first)
        if len(operations) <= _LONG or any(operator not in ("+", "-") for operator, _ in operations):
            if len(operations) > _MOST_FACTORS:
                raise SceneError(f"a product has at most {_MOST_FACTORS} factors.")
            for operator, right in operations:
                total = v.binary(operator, total, self.value(right))
            return total
        terms = [total]
        for operator, right in operations:
            term = self.value(right)
            terms.append(v.negative(term) if operator == "-" else term)
        while len(terms) > 1:
            pairs = [v.binary("+", a, b) for a, b in zip(terms[::2], terms[1::2], strict=False)]
            terms = pairs + terms[2 * len(pairs) :]
        return terms[0]

    def number(self, expression: Expression) -> Fraction:
        """The value of an expression that is a number."""
        value = self.value(expression)
        number = v.number_of(value)
        if number is None:
            raise SceneError(f"expected a number, got {v.described(value)}.")
        return number

    def whole(self, expression: Expression) -> int:
        """The value of an expression that is a whole number."""
        number = self.number(expression)
        if number.denominator != 1:
            raise SceneError(f"expected a whole number, got {float(number):g}.")
        return int(number)

    def size(self, expression: Expression) -> int:
        """The value of an expression that is the size of an array."""
        size = self.whole(expression)
        if not 0 <= size <= _MOST_ENTRIES:
            raise SceneError(f"expected a size from 0 to {_MOST_ENTRIES}, got {size}.")
        return size

    def with_index(self, index: str, values: Expression, of: Callable[[], Any]) -> list[Any]:
        """What `of` gives while an index has each value of a range."""
        before = dict(self.indices)
        items = []
        chosen = self.value(values)
        if not isinstance(chosen, tuple):
            raise SceneError(f"expected a range such as 1:3, got {v.described(chosen)}.")
        for value in chosen:
            self.indices[index] = value
            items.append(of())
        self.indices = before
        return items

    def range_of(self, expression: tree.Range) -> tuple[Value, ...]:
        """The numbers of a range."""
        if expression.first is None or expression.last is None:
            raise SceneError("':' stands in subscripts only.")
        step = Fraction(1) if expression.step is None else self.number(expression.step)
        first, last = self.number(expression.first), self.number(expression.last)
        if step == 0 or (last - first) / step > _MOST_ENTRIES:
            raise SceneError(f"a range has at most {_MOST_ENTRIES} entries.")
        return tuple(first + k * step for k in range(int((last - first) // step) + 1))

    def _reference(self, reference: tree.Reference) -> Value:
        name, subscripts = reference.name, reference.subscripts
        if name in self.indices and not subscripts:
            return self.indices[name]
        needs_size = (  # of the array, or is several
            isinstance(s, tree.Range) or tree.Reference("end") in tree.references(s) for s in subscripts
        )
        if subscripts and not any(needs_size):
            whole = ",".join(str(self.whole(s)) for s in subscripts)
            variable = self.lookup(f"{name}[{whole}]")
            if variable is not None:
                return variable
        variable = self.lookup(name)
        if variable is None:
            raise SceneError(f"{name!r} is not declared.")
        return self._indexed(name, variable, subscripts) if subscripts else variable

    def _indexed(self, name: str, value: Value, subscripts: tuple[Expression, ...]) -> Value:
        first, others = subscripts[0], subscripts[1:]
        if not isinstance(value, tuple):
            raise SceneError(f"{name!r} has more subscripts than dimensions.")
        size = tree.Number(str(len(value)))
        (positions,) = self.with_index("end", tree.Array((size,)), lambda: self._positions(first, size))
        chosen = tuple(self._entry(name, value, k) for k in positions)
        if others:
            chosen = tuple(self._indexed(name, entry, others) for entry in chosen)
        return chosen if isinstance(first, tree.Range) else chosen[0]

    def _positions(self, subscript: Expression, size: tree.Number) -> list[int]:
        if not isinstance(subscript, tree.Range):
            return [self.whole(subscript)]
        bounds = subscript if subscript.last is not None else tree.Range(tree.Number("1"), None, size)
        return [int(k) for k in self.range_of(bounds)]

    def _entry(self, name: str, value: tuple[Value, ...], position: int) -> Value:
        if not 1 <= position <= len(value):
            raise SceneError(f"{name!r} has {len(value)} entries, and no entry {position}.")
        return value[position - 1]

    def _if(self, branches: tuple[tuple[Expression, Expression], ...], otherwise: Expression) -> Value:
        made: list[tuple[Value, Expression]] = []
        for condition, then in branches:
            truth = self.value(condition)
            if truth is True:
                otherwise = then
                break
            if truth is not False:
                made.append((truth, then))
        value = self.value(otherwise)
        for condition_value, then in reversed(made):
            value = v.chosen(condition_value, self.value(then), value)
        return value

    def _call(self, name: str, arguments: tuple[Expression, ...]) -> Value:
        function = name.removeprefix(_LIBRARY)
        if function in _SAME and arguments:
            return self.value(arguments[0])
        values = [self.value(argument) for argument in arguments]
        if function == "der" and len(values) == 1:
            return v.each(self.derivative, values[0])
        if (function, len(values)) in _FUNCTIONS:
            try:
                return _FUNCTIONS[function, len(values)](*values)
            except SceneError:
                raise
            except (TypeError, IndexError, ValueError, RuntimeError):
                listed = ", ".join(v.described(value) for value in values)
                raise SceneError(f"{function} does not take {listed}.") from None
        if function in ("zeros", "ones", "fill") and values:
            return _filled(function, values)
        if function in _EVENTS:
            raise SceneError(f"{function}() makes or sees events; they are not supported.")
        raise SceneError(
            f"the function {name} of {len(values)} arguments is not supported. Supported are the "
            "functions of the language itself; write its formula into the equation."
        )


def _filled(function: str, values: list[Value]) -> Value:
    filled: Value = Fraction(function == "ones")
    sizes = values
    if function == "fill":
        filled, sizes = values[0], values[1:]
    for size in reversed(sizes):
        number = v.number_of(size)
        if number is None or not 0 <= number <= _MOST_ENTRIES:
            raise SceneError(f"{function} of {v.described(size)} entries.")
        filled = (filled,) * int(number)
    return filled


def _semi_linear(x: Value, above: Value, below: Value) -> Value:
    at = v.binary(">=", x, Fraction(0))
    if isinstance(at, bool):
        return v.binary("*", above if at else below, x)
    return v.chosen(at, v.binary("*", above, x), v.binary("*", below, x))


def _skew(a: Value) -> Value:
    zero = Fraction(0)
    x, y, z = a
    return ((zero, v.negative(z), y), (z, zero, v.negative(x)), (v.negative(y), x, zero))


def _diagonal(entries: Value) -> Value:
    n = len(entries)
    return tuple(tuple(entries[i] if i == j else Fraction(0) for j in range(n)) for i in range(n))


def _size(array: Value, dimension: Value = Fraction(1)) -> Value:
    for _ in range(int(dimension) - 1):
        array = array[0]
    return Fraction(len(array))


_larger, _smaller = (partial(v.extreme, largest=largest) for largest in (True, False))
_FUNCTIONS: Mapping[tuple[str, int], Callable[..., Value]] = {  # by name and number of arguments
    **{(name, 1): partial(v.each, partial(v.applied, name)) for name in v.UNARY},
    **{(name, 1): partial(v.rounded, name) for name in ("floor", "ceil", "integer")},
    ("smooth", 2): lambda order, value: value,
    ("max", 2): _larger,
    ("min", 2): _smaller,
    ("max", 1): lambda values: reduce(_larger, values),
    ("min", 1): lambda values: reduce(_smaller, values),
    ("atan2", 2): v.arctangent,
    ("sum", 1): v.total,
    ("semiLinear", 3): _semi_linear,
    ("transpose", 1): lambda a: tuple(zip(*a, strict=True)),
    ("cross", 2): lambda a, b: v.binary("*", _skew(a), b),
    ("skew", 1): _skew,
    ("identity", 1): lambda size: _diagonal((Fraction(1),) * int(size)),
    ("diagonal", 1): _diagonal,
    ("size", 2): _size,
}
