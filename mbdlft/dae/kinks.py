"""Functions that switch: |x|, sign(x), min, max, floor, ceil, comparisons and the branches of `if`.

Each has an argument s that decides its branch, as x does of |x|, and a - b of max(a, b). Where s has one
sign, at an equilibrium or on the whole range of the parameters, the branch takes the place of the
function. Where s is zero at the equilibrium, both branches are compared there: if values and slopes are
equal, either is right; otherwise there is no linear model, and an error says which equation has which
two slopes.
"""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import NamedTuple

import casadi as ca
import numpy as np

from mbdlft.base.array import Array
from mbdlft.base.errors import NotRationalError, TrimError
from mbdlft.dae.branches import SWITCHES, Side, ranges_of, side_on
from mbdlft.dae.newton import values_of
from mbdlft.dae.structure import Quantity, Structure, at_odd_parameters, in_symbols, parameter_points
from mbdlft.dae.text import ARITHMETIC_OF_SX, FUNCTIONS, column_of, unsupported
from mbdlft.exact.interval import FUNCTIONS as OF_INTERVALS
from mbdlft.exact.interval import Interval, decimal, find_zero
from mbdlft.problem.sx.constants import in_doubles, is_constant, is_zero, numbers_of
from mbdlft.problem.sx.tapes import Rules, arithmetic, fold

_RANGES = arithmetic(decimal, OF_INTERVALS)
_ROUNDING = 1e-12  # of the terms of a value in doubles: less is zero, as in solutions of equilibria


_LOGIC = ("and", "or", "not")


_SideOf = Callable[[ca.SX, Sequence[Side]], Side]  # of an argument, and of branches at its zero


class _Decided(NamedTuple):
    """A function that switches, in words, and on which side of its zero the equilibrium is."""

    text: str
    side: Side


def near_points(s: Structure, stacked: ca.SX, unknown: Sequence[Quantity], points: Array) -> ca.SX:
    """Expressions (n, 1) with the branch of each function that switches that they have at all points.

    `points` (N, k) are values of the unknowns at the `parameter_points`. Where an argument changes its
    sign between them, the function stays.
    """
    p = parameter_points(s.dae, len(points))
    symbols = column_of(q.symbol for q in unknown)

    def side(argument: ca.SX, at_zero: Sequence[Side]) -> Side:
        function = ca.Function("argument", [symbols, s.dae.p], [ca.densify(in_doubles(argument))])
        values = np.array([float(function(*at)) for at in zip(points, p, strict=True)])
        return "above" if np.all(values > 0.0) else "below" if np.all(values < 0.0) else "open"

    return _branches(stacked, side, [], {})


def without_switches(
    s: Structure,
    values: Mapping[str, ca.SX],
    stacked: ca.SX,
    places: Sequence[str],
    *,
    slopes: bool = False,
) -> ca.SX:
    """Expressions (n, 1) near an equilibrium, with a branch in place of each function that switches.

    `values` are those of all quantities at the equilibrium, and `places` (n,) name the expressions.
    Functions whose argument may change its sign in the range of the parameters stay as they are. In
    `slopes`, a comparison that changes at an end of the range is a kink there.
    """
    near = _Equilibrium(s, values, slopes=slopes)
    decided: list[_Decided] = []
    smooth = _branches(stacked, near.side, decided, {})
    for k, switch in enumerate(decided):
        if switch.side == "at":
            above = _branches(stacked, near.side, [], {k: "above"})
            near.compare(smooth, above, switch.text, places)
    return smooth


def _branches(
    stacked: ca.SX, side_of: _SideOf, decided: list[_Decided], chosen: Mapping[int, Side]
) -> ca.SX:
    """The expressions with branches; those at a zero are below it, unless `chosen` says otherwise."""

    def switched(name: str, *operands: ca.SX) -> ca.SX:
        switch, entries = SWITCHES[name], [ca.SX(x) for x in operands]
        argument = switch.argument(*entries)
        if name == "fabs" and is_constant(argument) and not numbers_of(argument)[0, 0]:
            return ca.SX(0)  # on either side
        side = side_of(argument, switch.at_zero)
        side = "above" if side == "below" and name in ("eq", "ne") else side
        decided.append(_Decided(f"{name}({', '.join(map(str, entries))})", side))
        side = chosen.get(len(decided) - 1, decided[-1].side)
        if side == "open":
            return ca.SX(FUNCTIONS[name](*entries))
        return ca.SX((switch.above if side == "above" else switch.below)(*entries))

    def logical(name: str, *operands: ca.SX) -> ca.SX:
        made = ca.SX(FUNCTIONS[name](*operands))
        return ca.SX(numbers_of(made)) if is_constant(made) else made

    def chosen_value(condition: ca.SX, value: ca.SX) -> ca.SX:
        if is_constant(condition):
            return value if numbers_of(condition)[0, 0] else ca.SX(0)
        return ca.SX(FUNCTIONS["if_else_zero"](condition, value))

    operations: dict[str, Callable[..., ca.SX]] = {
        **FUNCTIONS,
        **ARITHMETIC_OF_SX,
        **{name: partial(switched, name) for name in SWITCHES},
        **{name: partial(logical, name) for name in _LOGIC},
        "if_else_zero": chosen_value,
    }
    free = column_of(ca.symvar(stacked))
    function = ca.Function("switches", [free], [ca.densify(stacked)])
    table = Rules(ca.SX, operations, unsupported)
    (entries,) = fold(function, table, ca.vertsplit(free))
    return column_of(ca.SX(x) for x in entries)


class _Equilibrium:
    """Where arguments of functions are at an equilibrium, for all values of the parameters."""

    def __init__(self, s: Structure, values: Mapping[str, ca.SX], *, slopes: bool) -> None:
        self.ranges = {} if slopes else ranges_of(s.dae)
        self.quantities, self.dae, self.symbols = s.quantities, s.dae, s.symbols
        self.values = column_of(values[q.name] for q in s.quantities)
        ends = np.array([[p.low, p.high] for p in self.dae.parameters]).reshape(-1, 2).T
        self.bounds = {
            p.name: (np.nextafter(low, -np.inf), np.nextafter(high, np.inf))  # angles are in rad
            for p, low, high in zip(self.dae.parameters, *in_symbols(self.dae, ends), strict=True)
        }

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
            return "above" if numbers_of(value)[0, 0] > 0.0 else "below"
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
        try:
            return is_zero(ca.densify(at_odd_parameters(self.dae, value)))
        except NotRationalError:
            # a function of numbers: in doubles, relative to what signals make of it
            slopes = self.there(ca.densify(ca.jacobian(expression, self.symbols)))
            sizes = [q.variable.nominal for q in self.quantities]
            terms = sum(abs(self.number(slopes[j])) * size for j, size in enumerate(sizes))
            return abs(self.number(value)) <= _ROUNDING * terms

    def number(self, value: ca.SX) -> float:
        """The value of an expression of the parameters at nominal."""
        return float(values_of([value], self.dae.p, parameter_points(self.dae, 1)[0])[0])

    def compare(self, below: ca.SX, above: ca.SX, text: str, places: Sequence[str]) -> None:
        """Raise a TrimError if two branches differ in their values or slopes at the equilibrium."""
        for k, place in enumerate(places):
            change = above[k] - below[k]
            if not ca.symvar(change) and float(change) == 0.0:
                continue
            if not self.vanishes(change):
                ends = [self.number(self.there(x[k])) for x in (below, above)]
                raise self._error(place, text, f"jumps from {ends[0]:g} to {ends[1]:g}")
            slopes = ca.densify(ca.jacobian(change, self.symbols))
            for j, q in enumerate(self.quantities):
                if not self.vanishes(slopes[j]):
                    rows = (self.there(ca.jacobian(x[k], self.symbols[j])) for x in (below, above))
                    ends = [self.number(ca.densify(row)) for row in rows]
                    what = f"has two slopes by {q.name!r}, {ends[0] + 0.0:g} and {ends[1] + 0.0:g}"
                    raise self._error(place, text, what)

    def _error(self, place: str, text: str, what: str) -> TrimError:
        return TrimError(
            f"{self.dae.owner}, {place}: {what} at this equilibrium, where {text} switches: there is no "
            "linear model. Linearize beside it (other inputs or states in trim, at={...}), or write a "
            "smooth function, such as tanh(x/e) or sqrt(x^2 + e^2)."
        )
