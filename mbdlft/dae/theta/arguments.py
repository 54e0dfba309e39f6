"""Values in separated equations: a part linear in signals, a number, nonlinear functions with factors.

value = sum c_k(p) l_k + c_0(p) + sum c_j(p) f_j,      l_k, f_j without parameters

Arguments and functions of Theta are registered once: a multiple of another argument is that argument.
Functions of one argument whose sum is a table become one function.
"""

import operator
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, NamedTuple

import casadi as ca
import flint
import numpy as np

from mbdlft.base.errors import NotRationalError
from mbdlft.dae.alias import rational
from mbdlft.dae.text import column_of, free_symbols
from mbdlft.dae.theta.piecewise import piecewise_of
from mbdlft.exact.numbers import Field, constant_of
from mbdlft.problem.sx.constants import constants_in, is_constant, literal
from mbdlft.problem.sx.tapes import fold, rules, steps

ONE_KEY = "1"


class Part(NamedTuple):
    """A coefficient of parameters and numbers, times an expression linear in signals."""

    coefficient: ca.SX
    form: ca.SX


@dataclass(frozen=True, slots=True, eq=False)
class Mixed:
    """A value in an equation."""

    linear: Mapping[str, Part]  # by the text of the coefficient; the forms have numbers only
    constant: ca.SX | None  # of parameters and numbers; None for zero
    terms: Mapping[int, ca.SX]  # factors by the numbers of functions

    @property
    def is_coefficient(self) -> bool:
        """Whether there are no signals in it."""
        return not self.linear and not self.terms

    @property
    def is_plain(self) -> bool:
        """Whether there are no parameters in it."""
        return (
            set(self.linear) <= {ONE_KEY}
            and (self.constant is None or is_constant(self.constant))
            and all(is_constant(c) for c in self.terms.values())
        )


NOTHING = Mixed({}, None, {})


def coefficient(value: ca.SX) -> Mixed:
    """A value of parameters and numbers."""
    return NOTHING if rational(value) == 0 else Mixed({}, value, {})


def signal(symbol: ca.SX) -> Mixed:
    """A signal."""
    return Mixed({ONE_KEY: Part(ca.SX(1), symbol)}, None, {})


def term(number: int, factor: ca.SX) -> Mixed:
    """A function with a factor."""
    return Mixed({}, None, {number: factor})


def plus(a: Mixed, b: Mixed) -> Mixed:
    """Sum."""
    linear = dict(a.linear)
    for key, term in b.linear.items():
        known = linear.get(key)
        linear[key] = term if known is None else Part(known.coefficient, known.form + term.form)
    linear = {key: term for key, term in linear.items() if not _is_zero(term.form)}
    terms = dict(a.terms)
    for number, factor in b.terms.items():
        terms[number] = terms[number] + factor if number in terms else factor
    terms = {number: factor for number, factor in terms.items() if not _is_zero(factor)}
    constants = [value.constant for value in (a, b) if value.constant is not None]
    constant = constants[0] + constants[1] if len(constants) == 2 else (*constants, None)[0]
    return Mixed(linear, None if constant is None or _is_zero(constant) else constant, terms)


def times(a: Mixed, factor: ca.SX) -> Mixed:
    """Times a coefficient."""
    if rational(factor) in (0, 1):
        return a if rational(factor) else NOTHING
    linear: dict[str, Part] = {}
    for key, term in a.linear.items():
        if is_constant(factor):
            linear[key] = Part(term.coefficient, factor * term.form)
            continue
        new = factor if key == ONE_KEY else term.coefficient * factor
        known = linear.get(str(new))
        linear[str(new)] = Part(new, term.form if known is None else known.form + term.form)
    return Mixed(
        linear,
        None if a.constant is None else factor * a.constant,
        {number: c * factor for number, c in a.terms.items()},
    )


def _is_zero(expression: ca.SX) -> bool:
    return expression.nnz() == 0 or bool(expression.is_zero())


def number(value: Fraction) -> ca.SX:
    """A number as SX that is not rounded."""
    return ca.SX(literal(value))


_SEED = 20090211  # of the residues that stand for parameters
_SMALL = 2**15  # of numerators and denominators of ratios that are recognized
Row = dict[Any, Any]  # coefficients by signal; fractions, or residues where one is not rational


class Argument(NamedTuple):
    """An argument: its symbol in functions, what it is, and its row of fractions if it has one."""

    symbol: ca.SX
    value: Mixed
    row: Row | None


@dataclass(frozen=True, slots=True, eq=False)
class Function:
    """A nonlinear function: an expression of symbols of arguments, and the numbers of these."""

    expression: ca.SX
    arguments: tuple[int, ...]
    hint: str


class Registry:
    """Arguments and functions, by what they are."""

    def __init__(self, expressions: ca.SX, parameters: ca.SX) -> None:
        self.arguments: list[Argument] = []
        self.functions: list[Function] = []
        self._arguments: dict[Any, list[tuple[int, Any]]] = {}
        self._functions: dict[Any, int] = {}
        self._argument_of: dict[int, int] = {}  # by the hash of its symbol
        self._field = Field(constants_in(expressions)[1])
        drawn = np.random.default_rng(_SEED).integers(1, 2**59, parameters.numel())
        self._p = parameters
        self._drawn = [self._field.residue(int(x)) for x in drawn]

    def argument(self, value: Mixed) -> tuple[ca.SX, Fraction]:
        """The symbol of an argument, and the number that it has to be multiplied with."""
        row, is_rational = self._row(value)
        lead = row[min(row, key=str)]
        ratios = sorted((str(k), x / lead if is_rational else int(x / lead)) for k, x in row.items())
        key = (is_rational, tuple(ratios))
        for index, before in self._arguments.get(key, ()):
            ratio = lead / before if is_rational else _fraction(lead / before, self._field.prime)
            if ratio is not None:
                return self.arguments[index].symbol, ratio
        first = Fraction(1)
        if is_rational and len(row) == 1:  # a signal itself; of more, as it was written first
            first, value = lead, times(value, number(1 / lead))
            row, lead = {k: Fraction(1) for k in row}, Fraction(1)
        symbol = ca.SX.sym(f"psi{len(self.arguments)}")
        self._arguments.setdefault(key, []).append((len(self.arguments), lead))
        self._argument_of[symbol.element_hash()] = len(self.arguments)
        self.arguments.append(Argument(symbol, value, row if is_rational else None))
        return symbol, first

    def function(self, expression: ca.SX, hint: str) -> int:
        numbered = (self._argument_of.get(s.element_hash()) for s in ca.symvar(expression))
        used = tuple(sorted(k for k in numbered if k is not None))
        symbols = [self.arguments[k].symbol for k in used]
        constants, numbers = constants_in(expression)
        function = ca.Function("f", [column_of(symbols), constants], [ca.densify(expression)])
        written = tuple((name, str(to), tuple(map(str, of))) for name, to, of in steps(function))
        key = (used, written, numbers)
        if key not in self._functions:
            self._functions[key] = len(self.functions)
            self.functions.append(Function(expression, used, hint))
        return self._functions[key]

    def _row(self, value: Mixed) -> tuple[Row, bool]:
        """Coefficients by signal, and whether all of them are rational numbers."""
        constant = ca.SX(0) if value.constant is None else ca.SX(value.constant)
        if value.is_plain and constant.is_zero():
            with suppress(NotRationalError):
                return self._collected(value, exactly=True), True
        return self._collected(value, exactly=False), False

    def _collected(self, value: Mixed, *, exactly: bool) -> Row:
        row: Row = {}
        for term in value.linear.values():
            signals = free_symbols(term.form)
            slopes = ca.densify(term.coefficient * ca.jacobian(term.form, column_of(signals)))
            for s, x in zip(signals, self._values(slopes, exactly=exactly), strict=True):
                key = ("signal", s.element_hash())
                row[key] = row[key] + x if key in row else x
        for number, factor in value.terms.items():
            row["function", number] = self._values(factor, exactly=exactly)[0]
        if value.constant is not None:
            row["one", 0] = self._values(value.constant, exactly=exactly)[0]
        return {key: x for key, x in row.items() if x != 0}

    def _values(self, expressions: ca.SX, *, exactly: bool) -> list[Any]:
        constants, numbers = constants_in(expressions)
        if exactly and any(number.kind != "rational" for number in numbers):
            raise NotRationalError("not rational")
        function = ca.Function("values", [self._p, constants], [ca.densify(expressions)])
        field = self._field
        of_numbers = [n.argument if exactly else field.of(n).residue for n in numbers]

        def make(value: float) -> Any:
            return constant_of(value) if exactly else field.residue(constant_of(value))

        table = rules(make, add=operator.add, mul=operator.mul, div=operator.truediv)
        return fold(function, table, self._drawn, of_numbers)[0]


def _fraction(residue: Any, prime: int) -> Fraction | None:
    """The fraction of small numbers that a residue is, if it is one (by Euclid's algorithm)."""
    before, now = (prime, 0), (int(residue), 1)
    while now[0] > _SMALL:
        quotient = before[0] // now[0]
        before, now = now, (before[0] - quotient * now[0], before[1] - quotient * now[1])
    return Fraction(now[0], now[1]) if now[0] and 0 < abs(now[1]) <= _SMALL else None


def independent(arguments: Sequence[Argument]) -> list[tuple[Fraction, ...]] | None:
    """Rows that write arguments by the first independent ones, or None if all are independent.

    Each row has a factor for each argument; those of dependent arguments are zero.
    """
    rows = [argument.row for argument in arguments if argument.row is not None]
    if len(arguments) < 2 or len(rows) < len(arguments):
        return None
    signals = sorted({key for row in rows for key in row}, key=str)
    entries = [row.get(key, Fraction(0)) for key in signals for row in rows]
    exact = [flint.fmpq(x.numerator, x.denominator) for x in entries]
    reduced, rank = flint.fmpq_mat(len(signals), len(rows), exact).rref()
    if rank == len(rows):
        return None
    factors = [[Fraction(int(x.p), int(x.q)) for x in row] for row in reduced.tolist()[:rank]]
    pivots = {next(k for k, x in enumerate(row) if x): row for row in factors}
    nothing = [Fraction(0)] * len(rows)
    return list(zip(*(pivots.get(k, nothing) for k in range(len(rows))), strict=True))


def with_tables(registry: Registry, value: Mixed, hint: str, sign: int) -> Mixed:
    """A value with sums of functions of one argument that are a table together as one function.

    What is linear in the argument is in the table, too. The function is `sign` times these terms.
    """
    groups: dict[tuple[int, str], list[int]] = {}
    for k, factor in value.terms.items():
        used = registry.functions[k].arguments
        if len(used) == 1:
            common = "" if is_constant(factor) else str(factor)
            groups.setdefault((used[0], common), []).append(k)
    for (a, common), terms in groups.items():
        if len(terms) > 1 and common:
            value = _with_factor(registry, value, a, terms, hint)
        elif len(terms) > 1:
            value = _with_numbers(registry, value, a, terms, hint, ca.SX(sign))
    return value


def _with_factor(registry: Registry, value: Mixed, a: int, terms: list[int], hint: str) -> Mixed:
    """Functions with one factor of parameters."""
    total = sum((registry.functions[k].expression for k in terms), ca.SX(0))
    if not _is_table(total, registry.arguments[a].symbol):
        return value
    made = term(registry.function(total, hint), value.terms[terms[0]])
    return plus(_without(value, terms), made)


def _with_numbers(
    registry: Registry, value: Mixed, a: int, terms: list[int], hint: str, sign: ca.SX
) -> Mixed:
    """Functions with numbers for factors, what is linear in their argument, and a constant."""
    argument = registry.arguments[a]
    total = sum((value.terms[k] * registry.functions[k].expression for k in terms), ca.SX(0))
    others = _without(value, terms)
    slope = _slope_by(value, argument.value)
    if slope is not None:
        total = total + slope * argument.symbol
        others = plus(others, times(argument.value, -slope))
    if others.constant is not None and is_constant(others.constant):
        total = total + others.constant
        others = Mixed(others.linear, None, others.terms)
    if not _is_table(total, argument.symbol):
        return value
    return plus(others, term(registry.function(sign * total, hint), sign))


def _without(value: Mixed, removed: list[int]) -> Mixed:
    terms = {k: factor for k, factor in value.terms.items() if k not in removed}
    return Mixed(value.linear, value.constant, terms)


def _is_table(expression: ca.SX, argument: ca.SX) -> bool:
    table = piecewise_of(expression, argument)
    return table is not None and table.table() is not None


def _slope_by(value: Mixed, argument: Mixed) -> ca.SX | None:
    """How often an argument that is a signal is in the part of a value that is linear with numbers."""
    term, direct = value.linear.get(ONE_KEY), argument.linear.get(ONE_KEY)
    is_signal = direct is not None and len(argument.linear) == 1 and argument.constant is None
    if term is None or direct is None or not is_signal or argument.terms or not direct.form.is_symbolic():
        return None
    slope = ca.SX(ca.jacobian(term.form, direct.form))
    return ca.densify(slope) if slope.nnz() else None
