"""Arguments and functions of Theta, each once: what is a multiple of another argument is that one."""

import operator
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, NamedTuple

import casadi as ca
import flint
import numpy as np

from mbdlft.base.errors import NotRationalError
from mbdlft.dae.mixed import ONE_KEY, Mixed, times
from mbdlft.dae.mixed import number as number_of
from mbdlft.dae.operations import column_of, free_symbols
from mbdlft.exact.numbers import Field, constant_of
from mbdlft.problem.sx.constants import constants_in, is_constant
from mbdlft.problem.sx.tapes import Rule, fold, rules, steps

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
        key = (is_rational, tuple(sorted((str(k), _key(x / lead)) for k, x in row.items())))
        for number, before in self._arguments.get(key, ()):
            ratio = lead / before if is_rational else _fraction(lead / before, self._field.prime)
            if ratio is not None:
                return self.arguments[number].symbol, ratio
        first = Fraction(1)
        if is_rational and len(row) == 1:  # a signal itself; of more, as it was written first
            first, value = lead, times(value, number_of(1 / lead))
            row, lead = {k: Fraction(1) for k in row}, Fraction(1)
        symbol = ca.SX.sym(f"psi{len(self.arguments)}")
        self._arguments.setdefault(key, []).append((len(self.arguments), lead))
        self._argument_of[symbol.element_hash()] = len(self.arguments)
        self.arguments.append(Argument(symbol, value, row if is_rational else None))
        return symbol, first

    def function(self, expression: ca.SX, hint: str) -> int:
        """The number of a function."""
        used = tuple(
            sorted(
                self._argument_of[s.element_hash()]
                for s in ca.symvar(expression)
                if s.element_hash() in self._argument_of
            )
        )
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
        fractions = all(key == ONE_KEY for key in value.linear) and constant.is_zero()
        fractions = fractions and all(is_constant(c) for c in value.terms.values())
        if fractions:
            try:
                return self._collected(value, exactly=True), True
            except NotRationalError:
                pass
        return self._collected(value, exactly=False), False

    def _collected(self, value: Mixed, *, exactly: bool) -> Row:
        row: Row = {}
        for part in value.linear.values():
            signals = free_symbols(part.form)
            slopes = ca.densify(part.coefficient * ca.jacobian(part.form, column_of(signals)))
            for s, x in zip(signals, self._values(slopes, exactly=exactly), strict=True):
                key = ("signal", s.element_hash())
                row[key] = row[key] + x if key in row else x
        for number, factor in value.terms.items():
            row["function", number] = self._values(factor, exactly=exactly)[0]
        if value.constant is not None:
            row["one", 0] = self._values(value.constant, exactly=exactly)[0]
        return {key: x for key, x in row.items() if x != 0}

    def _residue(self, value: float) -> Any:
        return self._field.residue(constant_of(value))

    def _values(self, expressions: ca.SX, *, exactly: bool) -> list[Any]:
        constants, numbers = constants_in(expressions)
        if exactly and any(number.kind != "rational" for number in numbers):
            raise NotRationalError("not rational")
        function = ca.Function("values", [self._p, constants], [ca.densify(expressions)])
        if exactly:
            make: Rule = constant_of
            given: list[Any] = [number.argument for number in numbers]
            p: Sequence[Any] = [Fraction(0)] * self._p.numel()
        else:
            make = self._residue
            given = [self._field.of(number).residue for number in numbers]
            p = self._drawn
        table = rules(make, add=operator.add, mul=operator.mul, div=operator.truediv)
        return fold(function, table, p, given)[0]


def _key(value: Any) -> Any:
    """A key of a fraction or residue."""
    return value if isinstance(value, Fraction) else int(value)


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
