"""Expressions of Modelica, evaluated: names are looked up, functions are applied, arrays are indexed.

Units of Modelica, such as ``N.m/(rad.s)``, become units of this package. Whether those of a model fit is
followed on the syntax tree, where every parameter still has its unit: a written number, and what has no
unit or one that is not known here, may carry any unit.
"""

import math
import operator
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from fractions import Fraction
from functools import partial, reduce
from types import MappingProxyType
from typing import Any

import casadi as ca

from mbdlft.base.errors import SceneError
from mbdlft.base.unit import parse_unit
from mbdlft.dae.dae import OPEN, SECOND, Measure, compared, measure_of, plain
from mbdlft.modelica import tree
from mbdlft.modelica import values as v
from mbdlft.modelica.functions import Run
from mbdlft.modelica.lookup import of_tables
from mbdlft.modelica.modes import RESULTS
from mbdlft.modelica.tree import Expression, shorter, write
from mbdlft.modelica.values import Value

_EVENTS = ("sample", "reinit", "delay", "spatialDistribution")  # delay: of parameters
# their value here is their first argument
_SAME = ("noEvent", "homotopy", "pure")
_NEVER = ("initial", "terminal", "edge", "change")  # in an equilibrium
_LIBRARY = "Modelica.Math."  # whose functions have the names of those of the language
_MOST_ENTRIES = 10_000
_LONG, _MOST_FACTORS = 50, 1000


class Evaluator:
    """Evaluates expressions: `lookup` is the value of a name, or None; `derivative` is der of a value."""

    def __init__(
        self,
        lookup: Callable[[str], Value | None],
        derivative: Callable[[Value], Value],
        functions: Mapping[str, tree.Function] = MappingProxyType({}),
        delay: Callable[[Value, Value], Value] | None = None,
    ) -> None:
        self.delay = delay
        self.lookup, self.derivative, self.functions = lookup, derivative, functions
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
            case tree.Entry(base, subscripts):
                return self._indexed(write(base), self.value(base), subscripts)
            case tree.Member(base, field):
                record = self.value(base)
                if not isinstance(record, dict) or field not in record:
                    raise SceneError(f"{write(base)} has no field {field!r}.")
                return record[field]

    def _chain(self, first: Expression, operations: list[tuple[str, Expression]]) -> Value:
        """first (operator) right ...; a long sum is added in pairs: CasADi does not take deep graphs."""
        total = self.value(first)
        if len(operations) <= _LONG or any(operator not in ("+", "-") for operator, _ in operations):
            if len(operations) > _MOST_FACTORS:
                raise SceneError(f"a product has at most {_MOST_FACTORS} factors.")
            for operator, right in operations:
                if total is not (operator == "or") or operator not in ("and", "or"):
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
        chosen = tuple(self._entry(name, value, k) for k in self.positions(first, len(value)))
        if others:
            chosen = tuple(self._indexed(name, entry, others) for entry in chosen)
        return chosen if isinstance(first, tree.Range) else chosen[0]

    def positions(self, subscript: Expression, count: int) -> list[int]:
        """The positions that a subscript means, counted from 1, in an array of so many entries."""
        size = tree.Number(str(count))
        (positions,) = self.with_index(
            "end", tree.Array((size,)), lambda: self._positions(subscript, size)
        )
        return list(positions)

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

    def _before(self, argument: Expression) -> Value:
        """pre of what is discrete: in an equilibrium, its value."""
        value = self.value(argument)
        if isinstance(value, ca.SX) and not v.number_of(value):
            raise SceneError(f"pre() makes or sees events; it is not supported of {write(argument)}.")
        return value

    def results(self, call: Expression) -> tuple[Value, ...]:
        """All results of a call of a function of the model."""
        if not isinstance(call, tree.Call) or call.function not in self.functions:
            raise SceneError(f"{write(call)} has one result.")
        arguments = [self.value(argument) for argument in call.arguments]
        run = Run(self.functions[call.function], partial(Evaluator, functions=self.functions))
        return run.results(arguments)

    def _call(self, name: str, arguments: tuple[Expression, ...]) -> Value:
        function = name.removeprefix(_LIBRARY)
        if function in _SAME and arguments:
            return self.value(arguments[0])
        if function == RESULTS and len(arguments) == 1:
            return self.results(arguments[0])
        if function == "pre" and len(arguments) == 1:
            return self._before(arguments[0])
        if function in _NEVER:
            return False
        looked_up = of_tables(name, self.functions[name]) if name in self.functions else None
        if looked_up is not None:
            return looked_up(*map(self.value, arguments))
        if name in self.functions and (function == name or (function, len(arguments)) not in _FUNCTIONS):
            return self.results(tree.Call(name, arguments))[0]
        values = [self.value(argument) for argument in arguments]
        if not name:
            return tuple(values)
        if function == "der" and len(values) == 1:
            return v.each(self.derivative, values[0])
        if function == "delay" and len(values) in (2, 3) and self.delay is not None:
            return self.delay(values[0], values[1])
        if function == "cat" and len(values) > 1:
            return _cat(*values)
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


def _divided(a: Value, b: Value, *, function: str) -> Value:
    """div, mod or rem of two numbers."""
    x, y = (v.number_of(value) for value in (a, b))
    if x is None or not y:
        raise SceneError(f"{function} of what is no number makes events; they are not supported.")
    if function == "div":
        return Fraction(int(x / y))
    return x - y * (math.floor(x / y) if function == "mod" else int(x / y))


def _filled(function: str, values: list[Value]) -> Value:
    filled, *sizes = values if function == "fill" else (Fraction(function == "ones"), *values)
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


def _matrix(a: Value) -> Value:
    rows = a if isinstance(a, tuple) else (a,)
    return tuple(row if isinstance(row, tuple) else (row,) for row in rows)


def _cat(dimension: Value, *arrays: Value) -> Value:
    """Arrays one behind the other in a dimension."""
    if dimension == 1:
        return tuple(entry for array in arrays for entry in array)
    if len({len(array) for array in arrays}) > 1:
        raise SceneError(f"blocks of {', '.join(str(len(a)) for a in arrays)} rows in one row.")
    return tuple(_cat(dimension - 1, *rows) for rows in zip(*arrays, strict=True))


def _flat(values: Value) -> Iterator[Value]:
    for entry in values:
        yield from _flat(entry) if isinstance(entry, tuple) else (entry,)


def _sizes(array: Value) -> Iterator[Fraction]:
    while isinstance(array, tuple):
        yield Fraction(len(array))
        array = array[0] if array else None


_larger, _smaller = (partial(v.extreme, largest=largest) for largest in (True, False))
_FUNCTIONS: Mapping[tuple[str, int], Callable[..., Value]] = {  # by name and number of arguments
    **{(name, 1): partial(v.each, partial(v.applied, name)) for name in v.UNARY},
    **{(name, 1): partial(v.rounded, name) for name in ("floor", "ceil", "integer")},
    ("smooth", 2): lambda order, value: value,
    ("max", 2): _larger,
    ("min", 2): _smaller,
    ("max", 1): lambda values: reduce(_larger, _flat(values)),
    ("min", 1): lambda values: reduce(_smaller, _flat(values)),
    ("outerProduct", 2): lambda a, b: tuple(tuple(v.binary("*", x, y) for y in b) for x in a),
    ("atan2", 2): v.arctangent,
    ("sum", 1): v.total,
    ("product", 1): lambda a: reduce(partial(v.binary, "*"), _flat(a), Fraction(1)),
    ("linspace", 3): v.spaced,
    ("semiLinear", 3): _semi_linear,
    ("transpose", 1): lambda a: tuple(zip(*a, strict=True)),
    ("cross", 2): lambda a, b: v.binary("*", _skew(a), b),
    ("skew", 1): _skew,
    ("identity", 1): lambda size: _diagonal((Fraction(1),) * int(size)),
    ("diagonal", 1): _diagonal,
    ("size", 2): _size,
    ("size", 1): lambda a: tuple(_sizes(a)),
    **{(name, 2): partial(_divided, function=name) for name in ("div", "mod", "rem")},
    ("matrix", 1): _matrix,
    ("vector", 1): lambda a: tuple(_flat(a if isinstance(a, tuple) else (a,))),
    ("scalar", 1): lambda a: next(_flat(a if isinstance(a, tuple) else (a,))),
    ("String", 0): lambda: "",
}


_FACTOR = re.compile(r"([^\W\d_]+|%|1)([+-]?\d+)?")


def unit_of(text: str) -> str | None:
    """The unit of this package, such as ``N m/rad/s``; None if it is not known here.

    Modelica Specification 3.6, section 19.1: one slash at most, products by dots, exponents without sign
    or caret, parentheses around the denominator.
    """
    above, slash, below = text.replace(" ", "").partition("/")
    factors = [*_factors(above, 1), *(_factors(below, -1) if slash else [])]
    if None in factors:
        return None
    known = [factor for factor in factors if factor is not None and factor[0] != "1"]
    upper = " ".join(_factor(symbol, exponent) for symbol, exponent in known if exponent > 0)
    lower = "".join(f"/{_factor(symbol, -exponent)}" for symbol, exponent in known if exponent < 0)
    written = (upper or "1") + lower
    try:
        parse_unit(written)
    except SceneError:
        return None
    return written


def _factor(symbol: str, exponent: int) -> str:
    return symbol if exponent == 1 else f"{symbol}^{exponent}"


def _factors(text: str, sign: int) -> list[tuple[str, int] | None]:
    """The factors of a product and their exponents; None for one that cannot be read."""
    if text.startswith("(") and text.endswith(")"):
        text = text[1:-1]
    matches = [_FACTOR.fullmatch(factor) for factor in text.split(".")]
    return [match and (match[1], sign * int(match[2] or 1)) for match in matches]


def check_units(model: tree.FlatModel, place: Callable[[int, str], str]) -> None:
    """What is added, compared or made equal has the same unit; arguments of functions have none."""
    known = {}
    for d in model.declarations:
        unit = d.attributes.get("unit")
        text = unit_of(unit.text) if isinstance(unit, tree.Text) and unit.text.strip() else None
        known[d.name] = OPEN if text is None else measure_of(text)
    bound = [
        tree.Equation(tree.Reference(d.name), d.binding, d.line)
        for d in model.declarations
        if d.binding is not None
    ]
    for e in (*bound, *_equations((*model.equations, *model.initial))):
        try:
            left, right = (_measure(side, known) for side in (e.left, e.right))
            if not left.fits(right):
                raise SceneError(
                    f"the left side is in {left}, the right side in {right}; units do not fit."
                )
        except SceneError as error:
            text = shorter(f"{write(e.left)} = {write(e.right)}")
            raise SceneError(place(e.line, f"{text!r}: {error}")) from None


def _equations(statements: Iterable[tree.Statement]) -> Iterator[tree.Equation]:
    """All equations, those of choices and loops, too."""
    for statement in statements:
        match statement:
            case tree.Equation():
                yield statement
            case tree.Loop(_, _, body, _):
                yield from _equations(body)
            case tree.Choice(branches, otherwise, _):
                for body in (*(body for _, body in branches), otherwise):
                    yield from _equations(body)


def _measure(expression: Expression, known: Mapping[str, Measure]) -> Measure:
    """The unit of an expression; `OPEN` where any unit fits."""

    def of(part: Expression) -> Measure:
        return _measure(part, known)

    match expression:
        case tree.Reference(name, _):
            return known.get(name) or known.get(write(expression), OPEN)
        case tree.Binary():
            first, operations = tree.spine(expression)
            measure = of(first)
            for sign, right in ((symbol.lstrip("."), right) for symbol, right in operations):
                measure = _power(measure, right) if sign == "^" else _BINARY[sign](measure, of(right))
            return measure
        case tree.Unary(_, operand):
            return of(operand)
        case tree.Call(function, arguments) if arguments:
            rule = _MEASURES.get(function.rpartition(".")[2])
            measures = [of(argument) for argument in arguments]
            return rule(*measures) if rule is not None else OPEN
        case tree.If(branches, otherwise):
            for condition, _ in branches:
                of(condition)
            return _common(*(of(value) for _, value in branches), of(otherwise))
        case tree.Array(entries):
            of_entries = {of(entry) for entry in entries}
            return of_entries.pop() if len(of_entries) == 1 else OPEN
        case tree.Comprehension(value, _, _):
            return of(value)
        case _:
            return OPEN


def _common(*measures: Measure) -> Measure:
    """The unit of values that have to have the same."""
    return reduce(operator.add, measures, OPEN)


def _power(base: Measure, exponent: Expression) -> Measure:
    sign = 1
    if isinstance(exponent, tree.Unary):
        sign, exponent = -1, exponent.operand
    return base.power(sign * Fraction(exponent.text)) if isinstance(exponent, tree.Number) else OPEN


_BINARY: Mapping[str, Callable[[Measure, Measure], Measure]] = {
    **{"+": operator.add, "-": operator.add, "*": operator.mul, "/": operator.truediv},
    **dict.fromkeys(tree.RELATIONS, compared),
    **dict.fromkeys(("and", "or"), lambda a, b: OPEN),
}
_PLAIN = ("sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh", "exp", "log", "log10")
_OF_SAME = ("noEvent", "abs", "max", "min", "sum", "transpose", "homotopy", "scalar", "vector")
_MEASURES: dict[str, Callable[..., Measure]] = {
    **dict.fromkeys(_OF_SAME, _common),
    **{name: partial(plain, function=name) for name in _PLAIN},
    "smooth": lambda order, value: value,
    "delay": lambda value, *times: value,
    "atan2": lambda y, x: plain(y / (y + x), "atan2"),
    "der": lambda a: a / SECOND,
    "sqrt": Measure.root,
    "cross": operator.mul,
}
