"""Functions of one argument that are polynomials between breakpoints, exact: tables.

A sum of max(0, a - b_k), a chain of `if` and a saturation are polynomials of the argument on intervals,
with values at the breakpoints. So the Delta-Theta form finds tables in expressions; and
`table_expression` writes them.
"""

import operator
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import partial, reduce
from itertools import pairwise
from typing import Any, Literal

import casadi as ca
import flint
import numpy as np

from mbdlft.base.array import Array
from mbdlft.base.errors import NotRationalError, SceneError
from mbdlft.exact.numbers import constant_of, decimal
from mbdlft.exact.operators import Operators
from mbdlft.problem.sx.constants import constants_in, literal
from mbdlft.problem.sx.tapes import Rule, Rules, fold, rules
from mbdlft.system.theta import Table

_MOST_BREAKS, _MOST_DEGREE = 512, 3
Number = flint.fmpq
Polynomial = flint.fmpq_poly


@dataclass(frozen=True, slots=True, eq=False)
class Piecewise(Operators):
    """Polynomials (n + 1,) between breakpoints (n,), and the values at these."""

    breaks: tuple[Number, ...]
    pieces: tuple[Polynomial, ...]
    at: tuple[Number, ...]

    def table(self, least: int = 2) -> Table | None:
        """The table that this is, if it is continuous, has lines beyond its ends, and enough points."""
        f = _simple(self)
        slopes = [p.derivative() for p in f.pieces]
        if len(f.breaks) < max(least, 2) or any(slopes[k].degree() > 0 for k in (0, -1)):
            return None
        for b, value, (lower, right) in zip(f.breaks, f.at, pairwise(f.pieces), strict=True):
            if not lower(b) == value == right(b):
                return None
        inside: tuple[tuple[float, float], ...] = ()
        if any(slope.degree() > 0 for slope in slopes):
            pairs = zip(slopes[1:-1], pairwise(f.breaks), strict=True)
            inside = tuple((_float(slope(a)), _float(slope(b))) for slope, (a, b) in pairs)
        breakpoints = tuple(map(_float, f.breaks))
        if len({*breakpoints}) < len(breakpoints):
            return None
        below, above = (_float(slopes[k][0]) for k in (0, -1))
        return Table(breakpoints, tuple(map(_float, f.at)), below, above, inside)

    def refined(self, breaks: Iterable[Number]) -> "Piecewise":
        """The same with more breakpoints."""
        pieces, at, k = [self.pieces[0]], [], 0
        every = tuple(sorted({*self.breaks, *breaks}))
        if every == self.breaks:
            return self
        for b in every:
            if k < len(self.breaks) and self.breaks[k] == b:
                at.append(self.at[k])
                k += 1
            else:
                at.append(self.pieces[k](b))
            pieces.append(self.pieces[k])
        return Piecewise(every, tuple(pieces), tuple(at))

    def _with(self, other: "Piecewise", operation: Callable[[Any, Any], Any]) -> "Piecewise":
        """An operation of two functions, on the breakpoints of both."""
        a, b = self.refined(other.breaks), other.refined(self.breaks)
        pieces, at = map(operation, a.pieces, b.pieces), map(operation, a.at, b.at)
        return Piecewise(a.breaks, tuple(pieces), tuple(at))

    def __add__(self, other: "Piecewise") -> "Piecewise":
        return self._with(other, operator.add)

    def __mul__(self, other: "Piecewise") -> "Piecewise":
        return self._with(other, operator.mul)

    def __neg__(self) -> "Piecewise":
        return self * constant(-1)

    def __truediv__(self, other: "Piecewise") -> "Piecewise":
        if other.breaks or other.pieces[0].degree() != 0:
            raise NotRationalError("no division by a function, or by zero")
        return self * constant(1 / other.pieces[0][0])

    def __pow__(self, other: "Piecewise") -> "Piecewise":
        exponent = other.pieces[0][0]
        is_number = not other.breaks and other.pieces[0].degree() <= 0
        if not is_number or exponent.q != 1 or not 0 <= exponent <= _MOST_DEGREE:
            raise NotRationalError("no such power")
        return reduce(operator.mul, [self] * int(exponent.p), constant(1))


def _float(value: Number) -> float:
    return int(value.p) / int(value.q)


def constant(value: Fraction | Number | int) -> Piecewise:
    """A number."""
    exact = Number(value.numerator, value.denominator) if isinstance(value, Fraction) else value
    return Piecewise((), (Polynomial([exact]),), ())


ARGUMENT = Piecewise((), (Polynomial([0, 1]),), ())


def applied(operation: str, *operands: Piecewise) -> Piecewise:
    """What an operation of CasADi makes of functions of one argument; an error if it is none."""
    f: Piecewise = _RULES.operations.get(operation, partial(_RULES.missing, operation, ""))(*operands)
    if len(f.breaks) > _MOST_BREAKS or any(p.degree() > _MOST_DEGREE for p in f.pieces):
        raise NotRationalError("too many breakpoints, or too high a degree")
    return f


def _simple(f: Piecewise) -> Piecewise:
    """Without breakpoints at which nothing changes."""
    breaks, pieces, at = [], [f.pieces[0]], []
    for b, value, p in zip(f.breaks, f.at, f.pieces[1:], strict=True):
        if p == pieces[-1] and p(b) == value:
            continue
        breaks.append(b)
        at.append(value)
        pieces.append(p)
    return Piecewise(tuple(breaks), tuple(pieces), tuple(at))


def _compared(holds: Callable[[Number], bool]) -> Callable[..., Piecewise]:
    """1 where a condition on a - b holds, 0 elsewhere; its polynomials are lines, so signs are known."""

    def rule(a: Piecewise, b: Piecewise) -> Piecewise:
        d: Piecewise = a - b
        if any(p.degree() > 1 for p in d.pieces):
            raise NotRationalError("a comparison of curves")
        d = d.refined(-p[0] / p[1] for p in d.pieces if p.degree() == 1)
        ends = [d.breaks[0] - 1, *d.breaks, d.breaks[-1] + 1] if d.breaks else [Number(0), Number(0)]
        inside = [
            p((left + right) / 2) for p, (left, right) in zip(d.pieces, pairwise(ends), strict=True)
        ]
        pieces = tuple(Polynomial([int(holds(x))]) for x in inside)
        return Piecewise(d.breaks, pieces, tuple(Number(int(holds(x))) for x in d.at))

    return rule


def _chosen(condition: Piecewise, a: Piecewise) -> Piecewise:
    """a where a condition holds, 0 elsewhere."""
    values: list[Any] = [*condition.pieces, *condition.at]
    if any(value not in (0, 1) for value in values):
        raise NotRationalError("no condition")
    return condition * a


_less, _least = _compared(lambda x: x < 0), _compared(lambda x: x <= 0)


def _smaller(a: Piecewise, b: Piecewise) -> Piecewise:
    """The smaller one: b + (a - b where it is negative)."""
    return b + _chosen(_less(a, b), a - b)


def _larger(a: Piecewise, b: Piecewise) -> Piecewise:
    return -_smaller(-a, -b)


_OTHERS: dict[str, Rule] = {
    **dict.fromkeys(("pow", "constpow"), operator.pow),
    **{"lt": _less, "le": _least, "if_else_zero": _chosen},
    "and": lambda a, b: _chosen(a, _chosen(b, constant(1))),
    "not": lambda a: constant(1) - _chosen(a, constant(1)),
    **{"fmin": _smaller, "fmax": _larger, "fabs": lambda a: _larger(a, -a)},
}
_RULES: Rules = rules(
    lambda value: constant(constant_of(value)),
    add=operator.add,
    mul=operator.mul,
    div=operator.truediv,
    **_OTHERS,
)


def piecewise_of(expression: ca.SX, argument: ca.SX) -> Piecewise | None:
    """An expression as polynomials of a symbol; None if it is none, or has another symbol."""
    constants, numbers = constants_in(expression)
    known = {s.element_hash() for s in ca.vertsplit(ca.vertcat(argument, constants))}
    if any(number.kind != "rational" for number in numbers):
        return None
    if any(s.element_hash() not in known for s in ca.symvar(expression)):
        return None
    function = ca.Function("piecewise", [argument, constants], [ca.densify(expression)])
    table = _RULES._replace(operations={name: partial(applied, name) for name in _RULES.operations})
    try:
        ((f,),) = fold(function, table, [ARGUMENT], [constant(number.argument) for number in numbers])
    except NotRationalError:
        return None
    return f if isinstance(f, Piecewise) else None


Interpolation = Literal["linear", "cubic"]
Beyond = Literal["lines", "constant"]


def table_expression(
    argument: ca.SX,
    breakpoints: Sequence[float],
    values: Sequence[float],
    interpolation: Interpolation = "linear",
    beyond: Beyond = "lines",
) -> ca.SX:
    """A function that has values at breakpoints.

    Parameters
    ----------
    argument : SX
        A symbol.
    breakpoints, values : sequences of float (n,)
        Decimals, which are exact.
    interpolation : {"linear", "cubic"}
        Lines; or cubic polynomials whose slopes at the breakpoints keep the function monotone where the
        values are (Fritsch, Butland, SIAM J. Sci. Stat. Comput. 5, 1984).
    beyond : {"lines", "constant"}
        What stands before the first and behind the last breakpoint: lines with the slopes there, or the
        last values.
    """
    b, v = np.asarray(breakpoints, dtype=float), np.asarray(values, dtype=float)
    if b.ndim != 1 or b.shape != v.shape or len(b) < 2 or not np.all(np.isfinite([b, v])):
        raise SceneError(
            f"table of {argument}: expected as many finite values as breakpoints, two or more; got "
            f"{b.shape} and {v.shape}."
        )
    if not np.all(np.diff(b) > 0):
        where = int(np.argmin(np.diff(b) > 0))
        raise SceneError(
            f"table of {argument}: breakpoints do not increase: {b[where]:g}, {b[where + 1]:g}."
        )
    if interpolation not in ("linear", "cubic") or beyond not in ("lines", "constant"):
        raise SceneError(
            f"table of {argument}: interpolation is 'linear' or 'cubic', and beyond is 'lines' or "
            f"'constant'; got {interpolation!r}, {beyond!r}."
        )
    exact = [(decimal(float(x)), decimal(float(y))) for x, y in zip(b, v, strict=True)]
    slopes = list(pairwise(_monotone(b, v))) if interpolation == "cubic" else []
    ends = (Fraction(0), Fraction(0))
    if beyond == "lines":
        chords = [(y - x) / (q - p) for (p, x), (q, y) in (exact[:2], exact[-2:])]
        ends = (slopes[0][0], slopes[-1][1]) if slopes else (chords[0], chords[1])
    return between(argument, exact, slopes, ends)


Pair = tuple[Fraction, Fraction]


def between(argument: ca.SX, points: Sequence[Pair], slopes: Sequence[Pair], ends: Pair) -> ca.SX:
    """The function with values at points (b, value): lines, or cubics with `slopes` at both ends of each
    piece, and lines with the slopes `ends` before the first point and behind the last."""
    pieces: list[tuple[Fraction, ...]] = [(points[0][1], ends[0])]
    for k, ((a, low), (b, high)) in enumerate(pairwise(points)):
        h = b - a
        chord = (high - low) / h
        pieces.append((low, chord))
        if slopes:
            s, e = slopes[k]
            pieces[-1] = (low, s, (3 * chord - 2 * s - e) / h, (s + e - 2 * chord) / h**2)
    pieces.append((points[-1][1], ends[1]))
    origins, parts = [points[0][0], *(b for b, _ in points)], []
    for origin, coefficients in zip(origins, pieces, strict=True):
        distance, value = argument - literal(origin), ca.SX(0)
        for c in reversed(coefficients):
            value = value * distance + literal(c)
        parts.append(ca.SX(value))
    return joined(argument, [literal(b) for b, _ in points], parts)


def _monotone(b: Array, v: Array) -> list[Fraction]:
    from scipy.interpolate import PchipInterpolator

    return [decimal(float(x)) for x in PchipInterpolator(b, v).derivative()(b)]


def joined(argument: ca.SX, cuts: Sequence[float | ca.SX], pieces: Sequence[ca.SX]) -> ca.SX:
    """The part between each two cuts, found by halves."""
    if not cuts:
        return pieces[0]
    k = len(cuts) // 2
    lower = joined(argument, cuts[:k], pieces[: k + 1])
    right = joined(argument, cuts[k + 1 :], pieces[k + 1 :])
    return ca.SX(ca.if_else(argument < cuts[k], lower, right))
