"""Functions of one argument that are polynomials between breakpoints, exact: tables.

A sum of max(0, a - b_k), a chain of `if` and a saturation are polynomials of the argument on intervals,
with values at the breakpoints. So the Delta-Theta form finds tables in expressions; and
`table_expression` writes them.
"""

import operator
from collections.abc import Callable, Mapping, Sequence
from fractions import Fraction
from functools import partial
from itertools import pairwise, zip_longest
from typing import Literal, NamedTuple

import casadi as ca
import numpy as np

from mbdlft.base.array import Array
from mbdlft.base.errors import SceneError
from mbdlft.exact.numbers import constant_of, decimal
from mbdlft.problem.sx.constants import constants_in, literal
from mbdlft.problem.sx.tapes import Rules, fold
from mbdlft.system.theta import Table

Polynomial = tuple[Fraction, ...]  # coefficients from the constant on, without zeros at the end
_MOST_BREAKS, _MOST_DEGREE = 512, 3


class Piecewise(NamedTuple):
    """Polynomials (n + 1,) between breakpoints (n,), and the values at these."""

    breaks: tuple[Fraction, ...]
    pieces: tuple[Polynomial, ...]
    at: tuple[Fraction, ...]

    def table(self, least: int = 2) -> Table | None:
        """The table that this is, if it is continuous, has lines beyond its ends, and enough points."""
        f = _simple(self)
        ends = (f.pieces[0], f.pieces[-1])
        if len(f.breaks) < max(least, 2) or any(len(p) > 2 for p in ends):
            return None
        for b, value, lower_piece, right in zip(f.breaks, f.at, f.pieces, f.pieces[1:], strict=False):
            if not _value(lower_piece, b) == value == _value(right, b):
                return None
        inner = f.pieces[1:-1]
        slopes: tuple[tuple[float, float], ...] = ()
        if any(len(p) > 2 for p in inner):
            pairs = zip(inner, f.breaks, f.breaks[1:], strict=False)
            slopes = tuple((float(_slope(p, a)), float(_slope(p, b))) for p, a, b in pairs)
        below, above = (float(_slope(p, Fraction(0))) for p in ends)
        breakpoints = tuple(map(float, f.breaks))
        if len({*breakpoints}) < len(breakpoints):
            return None
        return Table(breakpoints, tuple(map(float, f.at)), below, above, slopes)


def constant(value: Fraction) -> Piecewise:
    """A number."""
    return Piecewise((), (_trimmed([value]),), ())


ARGUMENT = Piecewise((), ((Fraction(0), Fraction(1)),), ())


def applied(operation: str, *operands: Piecewise) -> Piecewise | None:
    """What an operation of CasADi makes of functions of one argument; None if it is no such function."""
    rule = _RULES.get(operation)
    polynomial = rule(*operands) if rule is not None else None
    if polynomial is None or len(polynomial.breaks) > _MOST_BREAKS:
        return None
    return None if any(len(p) > _MOST_DEGREE + 1 for p in polynomial.pieces) else polynomial


def _trimmed(coefficients: list[Fraction]) -> Polynomial:
    while coefficients and not coefficients[-1]:
        coefficients.pop()
    return tuple(coefficients)


def _value(p: Polynomial, at: Fraction) -> Fraction:
    total = Fraction(0)
    for c in reversed(p):
        total = total * at + c
    return total


def _slope(p: Polynomial, at: Fraction) -> Fraction:
    return _value(tuple(k * c for k, c in enumerate(p))[1:], at)


def _plus(a: Polynomial, b: Polynomial) -> Polynomial:
    return _trimmed([x + y for x, y in zip_longest(a, b, fillvalue=Fraction(0))])


def _product(a: Polynomial, b: Polynomial) -> Polynomial:
    coefficients = [Fraction(0)] * (len(a) + len(b))
    for j, x in enumerate(a):
        for k, y in enumerate(b):
            coefficients[j + k] += x * y
    return _trimmed(coefficients)


def _simple(f: Piecewise) -> Piecewise:
    """Without breakpoints at which nothing changes."""
    breaks, pieces, at = [], [f.pieces[0]], []
    for b, value, p in zip(f.breaks, f.at, f.pieces[1:], strict=True):
        if p == pieces[-1] and _value(p, b) == value:
            continue
        breaks.append(b)
        at.append(value)
        pieces.append(p)
    return Piecewise(tuple(breaks), tuple(pieces), tuple(at))


def _refined(f: Piecewise, breaks: tuple[Fraction, ...]) -> Piecewise:
    """The same with more breakpoints."""
    pieces, at, k = [f.pieces[0]], [], 0
    for b in breaks:
        if k < len(f.breaks) and f.breaks[k] == b:
            at.append(f.at[k])
            k += 1
        else:
            at.append(_value(f.pieces[k], b))
        pieces.append(f.pieces[k])
    return Piecewise(breaks, tuple(pieces), tuple(at))


def _together(
    a: Piecewise,
    b: Piecewise,
    of_polynomials: Callable[[Polynomial, Polynomial], Polynomial],
    of_numbers: Callable[[Fraction, Fraction], Fraction],
) -> Piecewise:
    """An operation of two functions, on the breakpoints of both."""
    if a.breaks != b.breaks:
        breaks = tuple(sorted({*a.breaks, *b.breaks}))
        a, b = _refined(a, breaks), _refined(b, breaks)
    pieces, at = map(of_polynomials, a.pieces, b.pieces), map(of_numbers, a.at, b.at)
    return Piecewise(a.breaks, tuple(pieces), tuple(at))


def _add(a: Piecewise, b: Piecewise) -> Piecewise:
    return _together(a, b, _plus, operator.add)


def _times(a: Piecewise, b: Piecewise) -> Piecewise:
    return _together(a, b, _product, operator.mul)


def _negative(a: Piecewise) -> Piecewise:
    return _times(constant(Fraction(-1)), a)


def _minus(a: Piecewise, b: Piecewise) -> Piecewise:
    return _add(a, _negative(b))


def _over(a: Piecewise, b: Piecewise) -> Piecewise | None:
    if b.breaks or len(b.pieces[0]) != 1:
        return None
    return _times(a, constant(1 / b.pieces[0][0]))


def _power(a: Piecewise, b: Piecewise) -> Piecewise | None:
    if b.breaks or len(b.pieces[0]) > 1:
        return None
    exponent = b.pieces[0][0] if b.pieces[0] else Fraction(0)
    if exponent.denominator != 1 or not 0 <= exponent <= _MOST_DEGREE:
        return None
    power = constant(Fraction(1))
    for _ in range(int(exponent)):
        power = _times(power, a)
    return power


def _compared(holds: Callable[[Fraction], bool]) -> Callable[..., Piecewise | None]:
    """1 where a condition on a - b holds, 0 elsewhere; its polynomials are lines, so signs are known."""

    def rule(a: Piecewise, b: Piecewise) -> Piecewise | None:
        d = _minus(a, b)
        if any(len(p) > 2 for p in d.pieces):
            return None
        roots = {-p[0] / p[1] for p in d.pieces if len(p) == 2}
        d = _refined(d, tuple(sorted({*d.breaks, *roots})))
        ends = (None, *d.breaks), (*d.breaks, None)
        inside = [_inside(a, b) for a, b in zip(*ends, strict=True)]
        constant_one = (Fraction(1),)
        return Piecewise(
            d.breaks,
            tuple(
                constant_one if holds(_value(p, x)) else () for p, x in zip(d.pieces, inside, strict=True)
            ),
            tuple(Fraction(int(holds(x))) for x in d.at),
        )

    return rule


def _inside(a: Fraction | None, b: Fraction | None) -> Fraction:
    """A number between two others, or beyond one."""
    if a is None:
        return Fraction(0) if b is None else b - 1
    return a + 1 if b is None else (a + b) / 2


def _is_condition(f: Piecewise) -> bool:
    return {*f.pieces} <= {(), (Fraction(1),)} and {*f.at} <= {0, 1}


def _chosen(condition: Piecewise | None, a: Piecewise) -> Piecewise | None:
    """a where a condition holds, 0 elsewhere."""
    return _times(condition, a) if condition is not None and _is_condition(condition) else None


def _opposite(condition: Piecewise) -> Piecewise | None:
    return _minus(constant(Fraction(1)), condition) if _is_condition(condition) else None


_less, _least = _compared(lambda x: x < 0), _compared(lambda x: x <= 0)


def _smaller(a: Piecewise, b: Piecewise) -> Piecewise | None:
    """The smaller one: b + (a - b where it is negative)."""
    smaller = _chosen(_less(a, b), _minus(a, b))
    return None if smaller is None else _add(b, smaller)


def _larger(a: Piecewise, b: Piecewise) -> Piecewise | None:
    larger = _smaller(_negative(a), _negative(b))
    return None if larger is None else _negative(larger)


_RULES: Mapping[str, Callable[..., Piecewise | None]] = {
    "assign": lambda a: a,
    "add": _add,
    "sub": _minus,
    "mul": _times,
    "div": _over,
    "neg": _negative,
    "twice": lambda a: _add(a, a),
    "sq": lambda a: _times(a, a),
    "constpow": _power,
    "pow": _power,
    "lt": _less,
    "le": _least,
    "not": _opposite,
    "and": lambda a, b: _chosen(a, b) if _is_condition(b) else None,
    "if_else_zero": _chosen,
    "fmin": _smaller,
    "fmax": _larger,
    "fabs": lambda a: _larger(a, _negative(a)),
}


def piecewise_of(expression: ca.SX, argument: ca.SX) -> Piecewise | None:
    """An expression as polynomials of a symbol; None if it is none, or has another symbol."""
    constants, numbers = constants_in(expression)
    if any(number.kind != "rational" for number in numbers):
        return None
    known = {s.element_hash() for s in ca.vertsplit(ca.vertcat(argument, constants))}
    if any(s.element_hash() not in known for s in ca.symvar(expression)):
        return None
    function = ca.Function("piecewise", [argument, constants], [ca.densify(expression)])

    def follow(name: str, *operands: Piecewise | None) -> Piecewise | None:
        dependent = [operand for operand in operands if operand is not None]
        return applied(name, *dependent) if len(dependent) == len(operands) else None

    table = Rules(
        lambda value: constant(constant_of(value)),
        {name: partial(follow, name) for name in _RULES},
        lambda operation, where, *operands: None,
    )
    values = [constant(number.argument) for number in numbers]
    ((polynomial,),) = fold(function, table, [ARGUMENT], values)
    return polynomial if isinstance(polynomial, Piecewise) else None


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
    slopes = _monotone(b, v) if interpolation == "cubic" else None
    pieces = _pieces(exact, slopes)
    chord = pieces[-1][1] if slopes is None else slopes[-1]
    ends = (Fraction(0), Fraction(0)) if beyond == "constant" else (pieces[0][1], chord)
    every = [(exact[0][1], ends[0]), *pieces, (exact[-1][1], ends[1])]
    origins = [exact[0][0], *(x for x, _ in exact)]
    cuts = [literal(x) for x, _ in exact]
    return joined(argument, cuts, [_local(argument, o, p) for o, p in zip(origins, every, strict=True)])


def _monotone(b: Array, v: Array) -> list[Fraction]:
    from scipy.interpolate import PchipInterpolator

    return [decimal(float(x)) for x in PchipInterpolator(b, v).derivative()(b)]


def _pieces(
    points: Sequence[tuple[Fraction, Fraction]], slopes: Sequence[Fraction] | None
) -> list[tuple[Fraction, ...]]:
    """Coefficients of each piece, in powers of the distance from its left end."""
    pieces: list[tuple[Fraction, ...]] = []
    for k, ((a, low), (b, high)) in enumerate(pairwise(points)):
        h = b - a
        chord = (high - low) / h
        if slopes is None:
            pieces.append((low, chord))
        else:
            below, right = slopes[k], slopes[k + 1]
            pieces.append(
                (low, below, (3 * chord - 2 * below - right) / h, (below + right - 2 * chord) / h**2)
            )
    return pieces


def _local(argument: ca.SX, origin: Fraction, coefficients: Sequence[Fraction]) -> ca.SX:
    distance, value = argument - literal(origin), ca.SX(0)
    for c in reversed(coefficients):
        value = value * distance + literal(c)
    return ca.SX(value)


def joined(argument: ca.SX, cuts: Sequence[float | ca.SX], pieces: Sequence[ca.SX]) -> ca.SX:
    """The part between each two cuts, found by halves."""
    if not cuts:
        return pieces[0]
    k = len(cuts) // 2
    lower = joined(argument, cuts[:k], pieces[: k + 1])
    right = joined(argument, cuts[k + 1 :], pieces[k + 1 :])
    return ca.SX(ca.if_else(argument < cuts[k], lower, right))
