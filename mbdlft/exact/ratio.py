"""Fractions of polynomials in lowest terms: their arithmetic, their roots, and their signs on a box.

A float is taken as the decimal it prints as. A polynomial has the sign of its factors of odd powers. That
of a factor is decided by its control points, the coefficients of its Bernstein form, between which its
values are, on the whole box or on parts of it. All numbers are fractions, so that a zero at the end of a
range is one.
"""

import itertools
import math
from collections.abc import Sequence
from fractions import Fraction
from typing import Any, Self

import flint
import numpy as np
from numpy.typing import NDArray

from mbdlft.exact.numbers import decimal
from mbdlft.exact.operators import Operators

_MOST_TERMS, _MOST_DEGREE = 1000, 128  # of a polynomial that is made from a text
_MOST_POINTS = 20_000  # control points of all parts of a box together: some tenths of a second

Box = Sequence[tuple[Fraction, Fraction]]  # (low, high) of each variable


class NotFractionError(Exception):
    """A number that is no fraction, a division by zero, or a polynomial that is too large."""


class Ratio(Operators):
    """n / d in lowest terms, polynomials of FLINT; ``+ - * /`` as for numbers."""

    __slots__ = ("d", "n")

    def __init__(self, n: Any, d: Any) -> None:
        shared = n.gcd(d) * d.leading_coefficient()  # so the one of the denominator is 1
        self.n, self.d = divmod(n, shared)[0], divmod(d, shared)[0]
        for polynomial in (self.n, self.d):
            if len(polynomial) > _MOST_TERMS or polynomial.total_degree() > _MOST_DEGREE:
                raise NotFractionError

    def __add__(self, other: "Ratio | Fraction | float") -> Self:
        b = self.of(other)
        return type(self)(self.n * b.d + b.n * self.d, self.d * b.d)

    def __neg__(self) -> Self:
        return type(self)(-self.n, self.d)

    def __mul__(self, other: "Ratio | Fraction | float") -> Self:
        b = self.of(other)
        return type(self)(self.n * b.n, self.d * b.d)

    def __truediv__(self, other: "Ratio | Fraction | float") -> Self:
        b = self.of(other)
        if b.n == 0:
            raise NotFractionError
        return type(self)(self.n * b.d, self.d * b.n)

    def of(self, number: "Ratio | Fraction | float") -> Self:
        if isinstance(number, Ratio):
            return type(self)(number.n, number.d)
        context, exact = self.n.context(), number if isinstance(number, Fraction) else decimal(number)
        return type(self)(context.constant(flint_rational(exact)), context.constant(1))


class Polynomial(Ratio):
    """A `Ratio` that is divided by numbers only."""

    __slots__ = ()

    def __init__(self, n: Any, d: Any) -> None:
        if not d.is_constant():
            raise NotFractionError
        super().__init__(n, d)


def square_root(x: Ratio) -> tuple[Fraction, Ratio] | None:
    """A positive number c and r with x = c r^2, or None where there are none."""
    if not x.n:
        return Fraction(1), x
    roots, number = [], Fraction(1)
    for polynomial, power in ((x.n, 1), (x.d, -1)):
        content, factors = polynomial.factor()
        number *= Fraction(int(content.p), int(content.q)) ** power
        if any(exponent % 2 for _, exponent in factors):
            return None
        one = polynomial.context().constant(1)
        roots.append(math.prod((f ** (e // 2) for f, e in factors), start=one))
    return (number, Ratio(*roots)) if number > 0 else None


def sign_on(x: Ratio, box: Box) -> int:
    """1 or -1 where x is shown to be nowhere negative or nowhere positive on a box, else 0."""
    if not x.n:
        return 1
    sign = 1
    for polynomial in (x.n, x.d):
        content, factors = polynomial.factor()
        sign *= 1 if content > 0 else -1
        for factor, exponent in factors:
            sign *= _sign(factor, box) if exponent % 2 else 1
    return sign


def _sign(polynomial: Any, box: Box) -> int:
    """As `sign_on`, of a polynomial."""
    degrees = [int(d) for d in polynomial.degrees()]
    used = [k for k, d in enumerate(degrees) if d]
    count = math.prod(degrees[k] + 1 for k in used)
    coefficients = np.full([degrees[k] + 1 for k in used], Fraction(0), dtype=object)
    if count > _MOST_POINTS:
        return 0
    for exponents, x in polynomial.to_dict().items():
        coefficients[tuple(int(exponents[k]) for k in used)] = Fraction(int(x.p), int(x.q))
    parts, signs, left = [[box[k] for k in used]], set[int](), _MOST_POINTS
    while parts and len(signs) < 2:
        part, left = parts.pop(), left - count
        if left < 0:
            return 0
        points = _control_points(coefficients, part)
        ends = points[np.ix_(*([0, -1] for _ in used))].ravel().tolist()  # values at the corners
        every = points.ravel().tolist()
        signs |= {1 if x > 0 else -1 for x in ends if x}
        if all(x >= 0 for x in every) or all(x <= 0 for x in every):
            signs |= {1 if x > 0 else -1 for x in every if x}
            continue
        if all(degrees[k] == 1 for k in used):
            return 0
        widths = [
            (high - low) / (box[k][1] - box[k][0]) for k, (low, high) in zip(used, part, strict=True)
        ]
        along = max(range(len(used)), key=widths.__getitem__)
        low, high = part[along]
        middle = (low + high) / 2
        parts += [[*part[:along], half, *part[along + 1 :]] for half in ((low, middle), (middle, high))]
    return signs.pop() if len(signs) == 1 else 0


def _control_points(coefficients: NDArray[np.object_], box: Box) -> NDArray[np.object_]:
    """Coefficients of the Bernstein form on a box of those of powers."""
    for axis, (low, high) in enumerate(box):
        d = coefficients.shape[axis] - 1
        turn = np.full((d + 1, d + 1), Fraction(0), dtype=object)
        for k, i, j in itertools.product(range(d + 1), repeat=3):
            if i <= min(j, k):
                power = math.comb(j, i) * low ** (j - i) * (high - low) ** i
                turn[k, j] += power * Fraction(math.comb(k, i), math.comb(d, i))
        coefficients = np.moveaxis(np.tensordot(turn, coefficients, (1, axis)), 0, axis)
    return coefficients


def flint_rational(x: Fraction) -> Any:
    """The number of FLINT."""
    return flint.fmpq(x.numerator, x.denominator)
