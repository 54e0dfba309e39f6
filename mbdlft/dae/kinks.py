"""Functions that switch: |x|, sign(x), min, max, floor, ceil, comparisons and the branches of `if`.

Each has an argument s that decides its branch, as x does of |x|, and a - b of max(a, b). Where s has one
sign, at an equilibrium or on the whole range of the parameters, the branch takes the place of the
function. Where s is zero at the equilibrium, both branches are compared there, of several functions in
each combination: if values and slopes are equal, any is right. If slopes of an equation differ, all may
still give one linear model, as 2 w + |w| = x |x| does at x = 0 with w = 0 x. Otherwise there is none, and
an error says which equation has which two slopes.

Where each choice determines the unknowns, with determinants of one sign, there is a solution on all sides
(a piecewise smooth map that is coherently oriented; Scholtes, Introduction to Piecewise Differentiable
Equations, 2012), and a solution has the slopes of one of the choices to first order.
"""

import itertools
import math
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from functools import partial
from typing import Any

import casadi as ca
import flint
import numpy as np

from mbdlft.base.array import Array
from mbdlft.base.errors import NotRationalError, TrimError
from mbdlft.dae.branches import (
    SWITCHES,
    Side,
    changes_its_branch,
    fraction_of,
    ranges_of,
    side_on,
    text_of_call,
)
from mbdlft.dae.newton import values_of
from mbdlft.dae.structure import Quantity, Structure, at_odd_parameters, in_symbols, parameter_points
from mbdlft.dae.text import ARITHMETIC_OF_SX, FUNCTIONS, column_of, free_symbols, unsupported
from mbdlft.exact.interval import FUNCTIONS as OF_INTERVALS
from mbdlft.exact.interval import Interval, decimal, find_zero
from mbdlft.exact.modular import multiplied, solved
from mbdlft.exact.numbers import Constant
from mbdlft.exact.numbers import decimal as decimal_of
from mbdlft.exact.ratio import NotFractionError, Ratio
from mbdlft.problem.digits import number_in_digits
from mbdlft.problem.sx.constants import (
    any_function,
    cancels,
    constant,
    in_doubles,
    is_constant,
    is_zero,
    modulo_prime,
    numbers_of,
)
from mbdlft.problem.sx.tapes import Rules, arithmetic, fold, steps

_RANGES = arithmetic(decimal, OF_INTERVALS)
_ROUNDING = 1e-12  # of the terms of a value in doubles: less is zero, as in solutions of equilibria
_SEVERAL = 3  # points at which slopes are told: they may be equal at the first, the nominal one
_MOST = 256  # combinations of branches of an expression, of some milliseconds each
_LARGEST = 4  # equations whose determinant is written out
_SEED = 20270118  # of residues
_LOGIC = ("and", "or", "not")

_Call = tuple[Any, ...]  # the name of a function and its operands
# of a call that switches, its argument, and the branches that it has at the zero, too; "at" for one that
# stays at its zero
_SideOf = Callable[[_Call, ca.SX, Sequence[Side]], Side]


def near_points(s: Structure, stacked: ca.SX, unknown: Sequence[Quantity], points: Array) -> ca.SX:
    """Expressions (n, 1) with the branch of each function that switches that they have at all points.

    `points` (N, k) are values of the unknowns at the `parameter_points`. Where an argument changes its
    sign between them, the function stays.
    """
    p = parameter_points(s.dae, len(points))
    symbols = column_of(q.symbol for q in unknown)

    def side(call: _Call, argument: ca.SX, at_zero: Sequence[Side]) -> Side:
        function = ca.Function("argument", [symbols, s.dae.p], [ca.densify(in_doubles(argument))])
        values = np.array([float(function(*at)) for at in zip(points, p, strict=True)])
        return "above" if np.all(values > 0.0) else "below" if np.all(values < 0.0) else "open"

    return _branches(stacked, side)


def beside_switches(
    s: Structure, values: Mapping[str, ca.SX], stacked: ca.SX, places: Sequence[str]
) -> ca.SX:
    """Expressions (n, 1), those in which functions switch at the equilibrium with branches beside it.

    `values` are those of all quantities at the equilibrium, and `places` (n,) name the expressions. A
    TrimError or NotRationalError says which has no value or slopes that all branches share.
    """
    near = _Equilibrium(s, values)
    sides: list[Side] = []

    def side(call: _Call, argument: ca.SX, at_zero: Sequence[Side]) -> Side:
        sides.append(near.side(argument, at_zero))
        return sides[-1]

    _branches(stacked, side)
    if not {"at", "open"} & {*sides}:
        return stacked
    every = [near.beside(stacked[k], place) for k, place in enumerate(places)]
    rows, kinks = column_of(row for row, _ in every), [k for k, (_, error) in enumerate(every) if error]
    if kinks:
        alike = _one_model(near, s, rows, stacked[kinks], kinks)
        if alike is None:
            raise next(error for _, error in every if error)
        rows[kinks] = alike
    return rows


def without_switches(s: Structure, values: Mapping[str, ca.SX], stacked: ca.SX) -> ca.SX:
    """Expressions of `beside_switches` with a branch in place of each function that switches.

    Functions whose argument may change its sign in the range of the parameters stay as they are. So do
    slopes of max(a, b) that change at an end of it: of a <= b and b <= a in them one is open there.
    """
    near = _Equilibrium(s, values)
    return _branches(stacked, lambda _, *argument: near.side(*argument))


def check_modes(s: Structure, values: Mapping[str, ca.SX]) -> None:
    """Raise an error unless modes and relations of events, at the equilibrium, never change."""
    modes = [c for c in s.dae.conditions if c.kind != "assert"]
    if not modes:
        return
    near = _Equilibrium(s, values)
    for c in modes:
        sides: list[Side] = []

        def side(call: _Call, argument: ca.SX, at_zero: Sequence[Side], met: list[Side] = sides) -> Side:
            met.append(near.side(argument, at_zero))
            return met[-1]

        plain = near.there(_branches(c.expression, side))
        if "at" in sides or not is_constant(plain):
            _, kink = near.beside(c.expression, c.name)
            if kink is not None:
                raise kink
        if names := [p.name() for p in free_symbols(plain)]:
            raise changes_its_branch(f"{s.owner}, {c.name}", "it", names)
        if c.value is not None and (number := float(numbers_of(plain)[0, 0])) != c.value:
            raise TrimError(
                f"{s.owner}, {c.name}: it is {number:g} at this equilibrium, and {c.value:g} in the "
                "equations, which are those of the point of the table. Give these values there."
            )


def _branches(stacked: ca.SX, side_of: _SideOf) -> ca.SX:
    """The expressions with branches, or with the value at the zero, in place of functions that switch."""

    def switched(name: str, *operands: ca.SX) -> ca.SX:
        switch, entries = SWITCHES[name], [ca.SX(x) for x in operands]
        argument = switch.argument(*entries)
        if name == "fabs" and is_constant(argument) and not numbers_of(argument)[0, 0]:
            return ca.SX(0)  # on either side
        side = side_of((name, *entries), argument, switch.at_zero)
        if side == "open":
            return ca.SX(FUNCTIONS[name](*entries))
        if side == "at" and name == "sign":
            return ca.SX(0)
        is_above = side == "above" or (side == "below" and name in ("eq", "ne"))
        is_above |= side == "at" and "above" in switch.at_zero
        return ca.SX((switch.above if is_above else switch.below)(*entries))

    def angle(y: ca.SX, x: ca.SX) -> ca.SX:
        if side_of(call := ("atan2", y, x), x, ("at",)) == "below":  # where it jumps as y does
            side = side_of(call, y, ())
            if side in ("below", "above"):
                return ca.SX(ca.atan(y / x) + (ca.pi if side == "above" else -ca.pi))
        return ca.SX(FUNCTIONS["atan2"](y, x))

    def logical(name: str, *operands: ca.SX) -> ca.SX:
        ends = {bool(numbers_of(x)[0, 0]) for x in operands if is_constant(x)}
        if (name == "or") in ends and name != "not":
            return ca.SX(int(name == "or"))  # whatever the other is
        made = ca.SX(FUNCTIONS[name](*operands))
        return ca.SX(numbers_of(made)) if is_constant(made) else made

    def chosen_value(condition: ca.SX, value: ca.SX) -> ca.SX:
        if is_constant(condition):
            return value if numbers_of(condition)[0, 0] else ca.SX(0)
        return ca.SX(FUNCTIONS["if_else_zero"](condition, value))

    operations: dict[str, Callable[..., ca.SX]] = {
        **FUNCTIONS,
        **ARITHMETIC_OF_SX,
        "div": lambda a, b: a / _unfolded(b),
        **{name: partial(switched, name) for name in SWITCHES},
        **{name: partial(logical, name) for name in _LOGIC},
        "if_else_zero": chosen_value,
        "atan2": angle,
    }
    free = column_of(ca.symvar(stacked))
    function = ca.Function("switches", [free], [ca.densify(stacked)])
    table = Rules(ca.SX, operations, unsupported)
    (entries,) = fold(function, table, ca.vertsplit(free))
    return column_of(ca.SX(x) for x in entries)


def _switches(expression: ca.SX) -> bool:
    """Whether a function that switches is in an expression (n, 1)."""
    function = ca.Function("switches", [column_of(ca.symvar(expression))], [ca.densify(expression)])
    return any(operation in SWITCHES for operation, _, _ in steps(function))


class _Equilibrium:
    """Where arguments of functions are at an equilibrium, for all values of the parameters."""

    def __init__(self, s: Structure, values: Mapping[str, ca.SX]) -> None:
        self.ranges = ranges_of(s.dae)
        self.quantities, self.dae, self.symbols = s.quantities, s.dae, s.symbols
        self.values = column_of(_unfolded(values[q.name]) for q in s.quantities)
        ends = np.array([[p.low, p.high] for p in self.dae.parameters]).reshape(-1, 2).T
        self.bounds = {
            p.name: (np.nextafter(low, -np.inf), np.nextafter(high, np.inf))  # angles are in rad
            for p, low, high in zip(self.dae.parameters, *in_symbols(self.dae, ends), strict=True)
        }
        if _switches(self.values):  # such as an input that balances max(x, 1) at x = 1
            self.values = _branches(self.values, lambda _, *argument: self.side(*argument))

    def there(self, expression: ca.SX) -> ca.SX:
        """An expression at the equilibrium, in terms of the parameters."""
        return ca.SX(ca.substitute(expression, self.symbols, self.values))

    def side(self, argument: ca.SX, at_zero: Sequence[Side]) -> Side:
        """On which side of zero an argument is: decided exactly, or by an enclosure of its range.

        One of parameters alone may be zero where the branch is one of those `at_zero`.
        """
        value = self.there(argument)
        if self.vanishes(argument):
            return "at"
        if is_constant(value):
            number = numbers_of(value)[0, 0]
            with suppress(NotRationalError):  # doubles may round it to the other side
                number = number_in_digits(value)
            return "above" if number > 0 else "below"
        if (side := side_on(argument, self.ranges)) in at_zero:
            return side
        function = ca.Function("argument", [self.dae.p], [ca.densify(in_doubles(value))])

        def enclosed(box: Mapping[str, Interval]) -> Interval:
            ((found,),) = fold(function, _RANGES, list(box.values()))
            return Interval.of(found)

        try:
            if find_zero(enclosed, self.bounds) is not None:
                return "open"
        except NotRationalError:  # a function without an enclosure
            return "open"
        return "above" if self.number(value) > 0.0 else "below"

    def vanishes(self, expression: ca.SX) -> bool:
        """Whether an expression is zero at the equilibrium for all values of the parameters."""
        value = self.there(expression)
        if cancels(value):  # doubles do not tell that of sin(0.08436/0.148 - 0.57)
            return True
        try:
            return is_zero(ca.densify(at_odd_parameters(self.dae, value)))
        except NotRationalError:
            # a function of numbers: in doubles, relative to what signals make of it
            slopes = self.there(ca.densify(ca.jacobian(expression, self.symbols)))
            sizes = [q.variable.size for q in self.quantities]
            terms = sum(abs(self.number(slopes[j])) * size for j, size in enumerate(sizes))
            return abs(self.number(value)) <= _ROUNDING * terms

    def number(self, value: ca.SX) -> float:
        """The value of an expression of the parameters at nominal."""
        return float(values_of([value], self.dae.p, parameter_points(self.dae, 1)[0])[0])

    def beside(self, expression: ca.SX, place: str) -> tuple[ca.SX, TrimError | None]:
        """An expression with branches beside the equilibrium, if functions switch there, and a kink."""
        first, *others = _Sides(self, expression, place).combinations()
        kinks = [self._kink(first[0], other, zeros, text, place) for other, zeros, text in others]
        return first[0] if others else expression, next(filter(None, kinks), None)

    def _kink(
        self, one: ca.SX, other: ca.SX, zeros: Sequence[ca.SX], text: str, place: str
    ) -> TrimError | None:
        """The error that two slopes are, if values are equal, those with arguments at zeros smooth."""
        change = other - one
        if not ca.symvar(change) and float(change) == 0.0:
            return None
        ends = [self.there(x) for x in (one, other)]
        self._check_decided(ends[1] - ends[0], text, place)
        if not self.vanishes(change):
            low, high = _told(*map(self.number, ends))
            raise self.error(place, text, f"jumps from {low:g} to {high:g}")
        along, gradient = (self._along(change, which) for which in (zeros, ()))
        j = next((j for j in range(gradient.numel()) if not self.vanishes(gradient[j])), None)
        if j is None or all(self.vanishes(along[j]) for j in range(along.numel())):
            return None
        name, (low, high) = self.quantities[j].name, _told(*self._slopes([one, other], j))
        error = self.error(place, text, f"has two slopes by {name!r}, {low:g} and {high:g}")
        if zeros:
            raise error
        return error

    def _slopes(self, expressions: Sequence[ca.SX], j: int) -> Array:
        """Slopes by the quantity j, at nominal, or at other parameters where they are equal there."""
        rows = [ca.densify(self.there(ca.jacobian(x, self.symbols[j]))) for x in expressions]
        every = [values_of(rows, self.dae.p, p) for p in parameter_points(self.dae, _SEVERAL)]
        return next((found for found in every if found[0] != found[1]), every[0])

    def _along(self, change: ca.SX, zeros: Sequence[ca.SX]) -> ca.SX:
        """The slopes of a change, without what it has across the zeros of arguments."""
        *normals, slopes = (ca.densify(ca.jacobian(x, self.symbols)) for x in (*zeros, change))
        while normals:
            normal = normals.pop()
            at = next((j for j in range(normal.numel()) if not self.vanishes(normal[j])), None)
            if at is not None:
                *normals, slopes = (x - x[at] / normal[at] * normal for x in (*normals, slopes))
        return slopes

    def _check_decided(self, change: ca.SX, text: str, place: str) -> None:
        """Raise a NotRationalError if a change has functions that switch within the range."""
        names = [p.name() for p in free_symbols(change)]
        if _switches(change):
            raise changes_its_branch(f"{self.dae.owner}, {place}", text, names)

    def error(self, place: str, text: str, what: str) -> TrimError:
        return TrimError(
            f"{self.dae.owner}, {place}: {what} at this equilibrium, where {text} switches: there is no "
            "linear model. Linearize beside it (other inputs or states in trim, at={...}), or write a "
            "smooth function, such as tanh(x/e) or sqrt(x^2 + e^2)."
        )


def _told(low: float, high: float) -> tuple[float, float]:
    """Numbers of a message: one that is rounding beside the other is zero, which has no sign."""
    least = _ROUNDING * max(abs(low), abs(high))
    return low if abs(low) > least else 0.0, high if abs(high) > least else 0.0


def _one_model(
    near: _Equilibrium, s: Structure, rows: ca.SX, kinked: ca.SX, places: list[int]
) -> ca.SX | None:
    """Branches of the expressions at `places` of the rows [residual ; outputs], if all give one model.

    The slopes of states and outputs are compared modulo a prime, parameters and values of functions being
    any numbers.
    """
    made, models = _Sides(near, kinked, "equations with kinks").combinations(), set[bytes]()
    try:
        choices = [branch for branch, zeros, _ in made if not zeros]
        plain = _branches(rows, lambda _, *argument: near.side(*argument))
        whole = ca.SX(ca.jacobian(ca.vertcat(plain, *s.rates), s.symbols))
        slopes = [ca.SX(ca.jacobian(branch, s.symbols)) for branch in choices]
        every, prime = modulo_prime(near.there(ca.vertcat(*slopes, whole)), _SEED, missing=any_function)
        ends = len(places) * np.arange(1, len(choices) + 1)
        *others, J = np.split(every.astype(np.int64), ends)
        n = len(s.equations)
        for branch in others:
            J[places] = branch
            solution = solved(J[:n, :n], J[:n, n:], prime)
            models.add(((J[n:, n:] - multiplied(J[n:, :n], solution, prime)) % prime).tobytes())
    except (TrimError, ArithmeticError, ValueError):  # a slope that is infinite, or no number
        return None
    are_alike = len(models) == 1 and _have_one_sign(near, s, whole, slopes, places)
    return choices[0] if are_alike else None


def _have_one_sign(
    near: _Equilibrium, s: Structure, J: ca.SX, slopes: Sequence[ca.SX], places: list[int]
) -> bool:
    """Whether determinants have one sign on the whole range with any of the slopes at places of J."""
    for block in s.blocks:
        if {*block.rows}.isdisjoint(places):
            continue
        signs = set[Side]()
        for branch in slopes if len(block.rows) <= _LARGEST else ():
            J[places, :] = branch
            signs.add(near.side(ca.SX(ca.det(J[list(block.rows), list(block.columns)])), ()))
        if signs not in ({"above"}, {"below"}):
            return False
    return True


def _unfolded(value: ca.SX) -> ca.SX:
    """A number as a symbol: quotients of whole numbers are folded in doubles otherwise, as 57/100."""
    plain = value.is_constant() and math.isfinite(float(value)) and not value.is_zero()
    return constant(Constant("rational", decimal_of(float(value)))) if plain else value


class _Sides:
    """Sides of arguments that are zero at an equilibrium, where multiples of one change together."""

    def __init__(self, near: _Equilibrium, expression: ca.SX, place: str) -> None:
        self.near, self.expression, self.place = near, expression, place
        self.free = free_symbols(expression)
        self.arguments: list[Ratio | str] = []
        self.zeros: list[ca.SX] = []  # the same, as expressions
        self.texts: list[str] = []  # of the functions that had them first
        self.at_zero: list[set[Side]] = []  # what functions that jump do at the zero, as on which side

    def combinations(self) -> Iterator[tuple[ca.SX, Sequence[ca.SX], str]]:
        """The expression for all choices of sides, the arguments at their zeros, what switched last.

        Choices that contradict each other, such as x < 0, z < 0, x + z > 0, are left out. An argument is
        at its zero where a function has another value than on either side.
        """
        waiting: deque[dict[int, Side]] = deque([{}])
        met, made = set[frozenset[tuple[int, Side]]](), set[frozenset[tuple[int, Side]]]()
        for _ in range(_MOST):
            sides = waiting.popleft()
            text = self.texts[[*sides][-1]] if sides else ""
            branch = _branches(self.expression, partial(self._side, sides))
            every = [*sides.items()]
            if self._is_possible(sides) and frozenset(every) not in made:
                yield branch, [self.zeros[k] for k, side in every if side == "at"], text
            made.add(frozenset(every))
            for n, (k, _) in enumerate(every):
                for side in _SIDES[: 2 + (self.at_zero[k] not in _ONE_SIDED)]:
                    other = {**dict(every[:n]), k: side}
                    if frozenset(other.items()) not in met | made:
                        met.add(frozenset(other.items()))
                        waiting.append(other)
            if not waiting:
                return
        raise self.near.error(self.place, text, f"has more than {_MOST} branches that meet")

    def _side(
        self, sides: dict[int, Side], call: _Call, argument: ca.SX, at_zero: Sequence[Side]
    ) -> Side:
        side, jumps = self.near.side(argument, at_zero), len(at_zero) < 2 and "at" not in at_zero
        if side == "open" and jumps:
            names = [p.name() for p in free_symbols(self.near.there(argument))]
            raise changes_its_branch(
                f"{self.near.dae.owner}, {self.place}", text_of_call(call[0], call[1:]), names
            )
        if side != "at" or "at" in at_zero:
            return side
        own: Ratio | str = str(argument)
        with suppress(NotFractionError):
            own = fraction_of(argument, self.free)
        if isinstance(own, Ratio) and not own.n:
            return "at"
        signs = [_sign_of_multiple(own, other) for other in self.arguments]
        if not any(signs):
            self.arguments.append(own)
            self.zeros.append(argument)
            self.texts.append(text_of_call(call[0], call[1:]))
            self.at_zero.append(set())
            signs.append(1)
        k = next(k for k, sign in enumerate(signs) if sign)
        if jumps:
            self.at_zero[k] |= {_turned(x, signs[k]) for x in at_zero or ("at",)}
        side = sides.setdefault(k, "below")
        return side if side == "at" and jumps else _turned(side, signs[k])

    def _is_possible(self, sides: Mapping[int, Side]) -> bool:
        """Whether no three arguments, of which one is a sum of multiples of the others, contradict it."""
        for three in itertools.combinations(sides, 3):
            factors = _sum_of_two([self.arguments[k] for k in three])
            terms = [f * _SIGNS[sides[k]] for f, k in zip(factors, three, strict=True)]
            if len({term > 0 for term in terms if term}) == 1:
                return False
        return True


_SIDES: tuple[Side, ...] = ("below", "above", "at")
_SIGNS: Mapping[Side, int] = {"below": -1, "above": 1, "at": 0}
_ONE_SIDED: tuple[set[Side], ...] = (set(), {"below"}, {"above"})


def _turned(side: Side, sign: int) -> Side:
    """A side of an argument for one that is a multiple of it."""
    if sign > 0 or side == "at":
        return side
    return "below" if side == "above" else "above"


def _sum_of_two(arguments: Sequence[Ratio | str]) -> Sequence[Any]:
    """Numbers with which three polynomials, none a multiple of another, sum up to zero, if there are."""
    polynomials = [a.n.to_dict() for a in arguments if isinstance(a, Ratio) and a.d.is_constant()]
    if len(polynomials) < 3:
        return 0, 0, 0
    monomials = {exponents for p in polynomials for exponents in p}
    rows, rank = flint.fmpq_mat([[p.get(e, 0) for p in polynomials] for e in monomials]).rref()
    return (rows[0, 2], rows[1, 2], -1) if rank == 2 else (0, 0, 0)


def _sign_of_multiple(a: Ratio | str, b: Ratio | str) -> int:
    """The sign of the number that one argument is of another, 0 if it is not known to be one."""
    if isinstance(a, str) or isinstance(b, str):
        return int(a == b)
    ratio = a / b
    if not (ratio.n.is_constant() and ratio.d.is_constant()):
        return 0
    return 1 if ratio.n.leading_coefficient() > 0 else -1
