"""Entries of a matrix as expressions that are rational in names, and the range of their denominators.

An angle stands in sin and cos only. These are written as rational in the *parts* of the angle, two
names that no text can contain, so that each number system gives its own cosine and sine. Interval
arithmetic then shows that no denominator vanishes in the range of the parameters.
"""

import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import partial
from itertools import chain
from types import MappingProxyType
from typing import Any, TypeVar

import numpy as np

from mbdlft.base.errors import (
    MbdlftError,
    NotRationalError,
    SceneError,
    WellPosednessError,
    check_known,
    naming,
)
from mbdlft.base.expression import (
    Binary,
    Call,
    Expression,
    Name,
    Negative,
    Number,
    check_degree,
    degree_of,
    denominators,
    evaluate,
    names,
    parse,
    walk,
    with_calls,
    write,
)
from mbdlft.base.parameter import Parameter, exact_cosine_sine
from mbdlft.exact.interval import FUNCTIONS, Interval, decimal, find_zero
from mbdlft.matrix.problem import MatrixProblem
from mbdlft.multibody.scene.quantities import AngleSum

T = TypeVar("T")
_MOST_TURNS = 16
_OPERATION = re.compile(r"[-+*/^]+")
_MOST_OPERATIONS, _MOST_IN_ALL = 50_000, 200_000  # of an entry and of a matrix: some 10 s and 40 s
_MOST_ENTRIES = 100_000  # numbers, too: some 15 s of zeros, a minute of others
_LEAST, _MOST = 1e-150, 1e150  # their squares are floats


@dataclass(frozen=True, slots=True)
class Resolved:
    """The expressions of a matrix problem, angles replaced by their parts."""

    shared: dict[str, Expression]  # expressions by name, each uses names before it only
    entries: tuple[tuple[Expression, ...], ...]  # rows of expressions

    def names_of(self, expression: Expression) -> frozenset[str]:
        """Names that an expression uses, itself or through shared expressions."""
        used = set(names(expression))
        for name in reversed(self.shared):
            if name in used:
                used |= names(self.shared[name])
        return frozenset(used)

    def parameters_of(self, expression: Expression) -> frozenset[str]:
        """Parameters and constants that an expression uses; the parts of an angle belong to it."""
        used = self.names_of(expression) - self.shared.keys()
        return frozenset(name.rpartition(" ")[2] for name in used)


def parts(angle: str, cosine: T, sine: T) -> dict[str, T]:
    """Cosine and sine of an angle parameter, by their names."""
    return {f"cos {angle}": cosine, f"sin {angle}": sine}


def outside(expression: Expression) -> frozenset[str]:
    """Names that stand outside of functions."""
    return names(with_calls(expression, lambda call: Number(0.0)))


def entry_place(problem: MatrixProblem, i: int, j: int) -> str:
    """How messages name an entry."""
    return f"matrix {problem.name!r}, entry ({i}, {j})"


def resolve(problem: MatrixProblem) -> Resolved:
    """Expressions of a problem."""
    return _Resolver(problem).run()


def matrix_values(
    problem: MatrixProblem,
    resolved: Resolved,
    values: Mapping[str, Any],
    number: Callable[[float], Any] = lambda value: value,
    functions: Mapping[str, Callable[..., Any]] = MappingProxyType({}),
) -> list[list[Any]]:
    """Rows of values in the number system of `values`, which has all parameters and constants."""
    known = dict(values)
    rows: list[list[Any]] = []
    place = ""
    try:
        for name, expression in resolved.shared.items():
            place = f"matrix {problem.name!r}, expression {name!r}"
            known[name] = evaluate(expression, known, number, functions)
        for i, row in enumerate(resolved.entries):
            rows.append([])
            for j, entry in enumerate(row):
                place = entry_place(problem, i, j)
                rows[i].append(evaluate(entry, known, number, functions))
    except MbdlftError as error:
        raise type(error)(f"{place}: {error}") from None
    return rows


def _operations(source: float | str) -> int:
    return len(_OPERATION.findall(source)) if isinstance(source, str) else 0


class _Resolver:
    """Walks the texts of one problem in order."""

    def __init__(self, problem: MatrixProblem) -> None:
        self.problem = problem
        self.constants = problem.constant_values()
        self.angles = {p.name for p in problem.parameters if p.is_angle}
        self.plain = {p.name for p in problem.parameters} - self.angles
        self.shared: dict[str, Expression] = {}
        self.depends: dict[str, frozenset[str]] = {}  # parameters of each shared expression
        self.degrees = dict.fromkeys(self.plain, 1)
        for angle in self.angles:
            self.degrees |= parts(angle, 1, 1)
        self.place = ""

    def run(self) -> Resolved:
        if (count := sum(map(len, self.problem.matrix))) > _MOST_ENTRIES:
            raise SceneError(
                f"matrix {self.problem.name!r} has {count} entries, and {_MOST_ENTRIES} is the most. "
                "Leave out rows and columns that depend on no parameter."
            )
        texts = chain(self.problem.expressions.values(), *self.problem.matrix)
        if (total := sum(map(_operations, texts))) > _MOST_IN_ALL:
            raise SceneError(
                f"matrix {self.problem.name!r} has {total} operations, and {_MOST_IN_ALL} is the most. "
                "Write a part that stands in several entries once, under expressions."
            )
        for name, source in self.problem.expressions.items():
            expression = self._read(f"matrix {self.problem.name!r}, expression {name!r}", source)
            self.shared[name] = expression
            self.depends[name] = self._parameters(expression)
            self.degrees[name] = degree_of(expression, self.degrees)
        rows = tuple(
            tuple(self._read(entry_place(self.problem, i, j), source) for j, source in enumerate(row))
            for i, row in enumerate(self.problem.matrix)
        )
        return Resolved(self.shared, rows)

    def _read(self, place: str, source: float | str) -> Expression:
        self.place = f"{place} = {source!r}"
        if (count := _operations(source)) > _MOST_OPERATIONS:
            raise SceneError(
                f"{place} has {count} operations, and {_MOST_OPERATIONS} is the most. Collect equal "
                "powers of the parameters, or declare a part as a parameter."
            )
        with naming(self.place):
            expression = parse(source)
            if any(isinstance(node, Number) and node.unit for node in walk(expression)):
                raise SceneError(
                    "a number has a unit. Names of a matrix are plain values in the units of their "
                    "parameters, and nothing is converted; leave the unit out."
                )
            known = {*self.constants, *self.angles, *self.plain, *self.problem.expressions}
            for name in sorted(names(expression)):
                check_known("name", [name], known)
                if name in self.problem.expressions and name not in self.depends:
                    raise SceneError(
                        f"the expression {name!r} is not known here; an expression uses only those "
                        "before it."
                    )
            for name in sorted(outside(expression) & self.angles):
                raise NotRationalError(
                    f"the angle {name!r} stands outside of sin and cos. A matrix is rational in the "
                    "sine and cosine of an angle, not in the angle."
                )
            rational = with_calls(expression, self._call)
            check_degree(rational, self.degrees)
            return rational

    def _parameters(self, expression: Expression) -> frozenset[str]:
        """Parameters an expression depends on."""
        used: set[str] = set()
        for name in names(expression):
            used |= self.depends.get(name, {name} - self.constants.keys())
        return frozenset(used)

    def _call(self, call: Call) -> Expression | None:
        """What takes the place of a function: of angles, cosine and sine in terms of their parts."""
        function, argument = call.function, call.argument
        used = self._parameters(argument)
        direct = {node.name for node in walk(argument) if isinstance(node, Name)}
        if not used:
            return None
        if function == "sqrt" or not used <= self.angles or not used <= direct:
            raise NotRationalError(
                f"{function}({write(argument)}) is not rational in {', '.join(sorted(used))}. "
                "Functions take constants; sin and cos also take sums of angle parameters (unit "
                "'deg' or 'rad'). Declare the whole value as a parameter instead."
            )
        values = self.constants | {name: AngleSum(0.0, {name: 1}) for name in self.angles}
        angle = evaluate(argument, values).whole()
        if sum(abs(count) for count in angle.multiples.values()) > _MOST_TURNS:
            raise NotRationalError(
                f"{write(argument)}: each angle is one more rotation, and {_MOST_TURNS} is the most. "
                "Declare the multiple as a parameter."
            )
        return self._parts(angle)[function == "sin"]

    def _parts(self, angle: AngleSum) -> tuple[Expression, Expression]:
        """Cosine and sine of a sum of angles, one rotation after the other."""
        cosine, sine = exact_cosine_sine(angle.constant)
        # labels have blanks or parentheses, so no name of a text is like them
        label = repr(angle.constant) if angle.constant else ""
        cosine_sine: tuple[Expression, Expression] = (Number(cosine), Number(sine))
        if not {cosine, sine} <= {-1.0, 0.0, 1.0}:
            constant = Number(angle.constant)
            cosine_sine = (Call("cos", constant), Call("sin", constant))
        for name, count in sorted(angle.multiples.items()):
            cosine_of, sine_of = map(Name, parts(name, 1, 1))
            turn: tuple[Expression, Expression] = (cosine_of, sine_of if count > 0 else Negative(sine_of))
            for _ in range(abs(count)):
                first, label = not label, f"{label} {'+' if count > 0 else '-'} {name}".lstrip(" +")
                if first:
                    cosine_sine = turn
                    continue
                # the new turn first: it acts on what the cosine and sine before it make of one signal
                (a, b), (c, s) = turn, cosine_sine
                rotated = (
                    Binary("-", Binary("*", a, c), Binary("*", b, s)),
                    Binary("+", Binary("*", b, c), Binary("*", a, s)),
                )
                both = (f"cos({label})", f"sin({label})")
                for name_of_part, expression in zip(both, rotated, strict=True):
                    self.shared.setdefault(name_of_part, expression)
                    self.degrees[name_of_part] = degree_of(expression, self.degrees)
                cosine_sine = (Name(both[0]), Name(both[1]))
        return cosine_sine


def check_denominators(problem: MatrixProblem, resolved: Resolved) -> None:
    """Show by interval arithmetic that no denominator vanishes in the range.

    What intervals cannot decide is left to the check of the model at points of the range.
    """
    parameters = {p.name: p for p in problem.parameters}
    numbers = problem.constant_values()
    constants = {name: decimal(value) for name, value in numbers.items()}
    corners = [
        {name: Interval(at, at) for name, at in zip(parameters, point, strict=True)}
        for point in zip(*((p.nominal, p.low, p.high) for p in problem.parameters), strict=True)
    ]
    for p in problem.parameters:
        _check_size(f"matrix {problem.name!r}: parameter {p.name!r}", (p.low, p.high), _LEAST)
    every = {f"expression {name!r}": expression for name, expression in resolved.shared.items()}
    every |= {f"entry ({i}, {j})": e for i, row in enumerate(resolved.entries) for j, e in enumerate(row)}
    places: dict[Expression, str] = {}  # of each denominator, the first
    for where, expression in every.items():
        for divisor in denominators(expression):
            places.setdefault(divisor, f"matrix {problem.name!r}, {where}")
    for divisor, place in places.items():
        used = sorted(resolved.parameters_of(divisor) & parameters.keys())
        value = partial(_enclosure, divisor, resolved, constants, parameters)
        _check_size(f"{place}: the denominator {write(divisor)}", map(value, corners), _LEAST)
        zero = find_zero(value, {name: (parameters[name].low, parameters[name].high) for name in used})
        if zero is not None and zero[1]:
            near = ", ".join(
                f"{name} = {at:g} {parameters[name].unit}".removesuffix(" 1")
                for name, at in zero[0].items()
            )
            raise WellPosednessError(
                f"{place}: the denominator {write(divisor)} vanishes in the range"
                f"{f', near {near}' if near else ''}. Narrow the range, or write the entry without "
                "the division."
            )
    rows = [
        matrix_values(problem, resolved, {**numbers, **_intervals(parameters, box)})
        for box in corners or [{}]
    ]
    for i, j in np.ndindex(problem.shape):
        _check_size(entry_place(problem, i, j), (row[i][j] for row in rows))


def _check_size(what: str, values: Iterable[Interval | float], least: float = 0.0) -> None:
    """Raise a SceneError if the largest of some values is not zero, and below the least or too large.

    What may be zero at a point, or has a pole there, is left to the other checks.
    """
    intervals = [Interval.of(value) for value in values]
    size = max((value.largest for value in intervals if value.smallest), default=0.0)
    if size and not least <= size <= _MOST:
        expected = f"least {least:g}" if size < least else f"most {_MOST:g}"
        raise SceneError(
            f"{what} has the size {size:.3g}. Expected at {expected}: the square of a number has to be "
            "one in double precision, too. Choose other units."
        )


def _enclosure(
    divisor: Expression,
    resolved: Resolved,
    constants: Mapping[str, Interval],
    parameters: Mapping[str, Parameter],
    box: Mapping[str, Interval],
) -> Interval:
    """A denominator over a box of parameters."""
    known, names_used = {**constants, **_intervals(parameters, box)}, resolved.names_of(divisor)
    for name, expression in resolved.shared.items():
        if name in names_used:
            known[name] = evaluate(expression, known, decimal, FUNCTIONS)
    interval: Interval = evaluate(divisor, known, decimal, FUNCTIONS)
    return interval


def _intervals(parameters: Mapping[str, Parameter], box: Mapping[str, Interval]) -> dict[str, Interval]:
    """Parameters over intervals; an angle by its cosine and sine."""
    values: dict[str, Interval] = {}
    for name, item in box.items():
        if parameters[name].is_angle:
            angle = item * parameters[name].factor
            values |= parts(name, FUNCTIONS["cos"](angle), FUNCTIONS["sin"](angle))
        else:
            values[name] = item
    return values
