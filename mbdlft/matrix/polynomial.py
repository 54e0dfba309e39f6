"""Polynomial matrices written anew in one way, so that an order does not depend on how they were written.

Polynomials are one more number system for the expressions: coefficients are fractions, a float is taken
as the decimal it prints as, so what cancels is gone. They are written by Horner's rule in one parameter
after the other: all products then have their factors in one order.
"""

from fractions import Fraction
from typing import Any, Self

import casadi as ca

from mbdlft.errors import MbdlftError
from mbdlft.matrix.problem import MatrixProblem
from mbdlft.matrix.resolve import Resolved, matrix_values

_MOST_TERMS, _MOST_DEGREE = 1000, 128


class NotPolynomialError(Exception):
    """A division by more than a number, or more terms or a higher degree than are expanded."""


class Polynomial:
    """Coefficients by the exponents of the variables; ``+ - * /`` as for numbers."""

    __slots__ = ("terms",)

    def __init__(self, terms: dict[tuple[int, ...], Fraction]) -> None:
        self.terms = {exponents: value for exponents, value in terms.items() if value}
        if len(self.terms) > _MOST_TERMS:
            raise NotPolynomialError

    def __add__(self, other: "Polynomial | float") -> Self:
        total = dict(self.terms)
        for exponents, value in self._like(other).terms.items():
            total[exponents] = total.get(exponents, Fraction(0)) + value
        return type(self)(total)

    __radd__ = __add__

    def __neg__(self) -> Self:
        return type(self)({exponents: -value for exponents, value in self.terms.items()})

    def __sub__(self, other: "Polynomial | float") -> Self:
        return self + -self._like(other)

    def __rsub__(self, other: float) -> Self:
        return -self + other

    def __mul__(self, other: "Polynomial | float") -> Self:
        total: dict[tuple[int, ...], Fraction] = {}
        factor = self._like(other)
        if self._degree() + factor._degree() > _MOST_DEGREE:
            raise NotPolynomialError
        for first, x in self.terms.items():
            for second, y in factor.terms.items():
                exponents = tuple(a + b for a, b in zip(first, second, strict=True))
                total[exponents] = total.get(exponents, Fraction(0)) + x * y
        return type(self)(total)

    __rmul__ = __mul__

    def __truediv__(self, other: "Polynomial | float") -> Self:
        divisor = self._like(other).terms
        if any(any(exponents) for exponents in divisor) or not divisor:
            raise NotPolynomialError
        (value,) = divisor.values()
        return type(self)({exponents: x / value for exponents, x in self.terms.items()})

    def __rtruediv__(self, other: float) -> Self:
        return self._like(other) / self

    def _degree(self) -> int:
        return max(map(sum, self.terms), default=0)

    def _like(self, number: "Polynomial | float") -> Self:
        if isinstance(number, Polynomial):
            return type(self)(number.terms)
        size = len(next(iter(self.terms), ()))
        return type(self)({(0,) * size: Fraction(repr(number))})


def expanded_matrix(problem: MatrixProblem, resolved: Resolved, p: ca.SX) -> ca.SX | None:
    """The matrix by Horner's rule in the symbols p (n_p,); None if it is not polynomial in them.

    Nor is it if the degree is too high, or a coefficient is beyond the largest float.
    """
    count = len(problem.parameters)
    if any(parameter.is_angle for parameter in problem.parameters):
        return None

    def number(value: float) -> Polynomial:
        return Polynomial({(0,) * count: Fraction(repr(value))})

    values: dict[str, Any] = {
        name: number(float(value)) for name, value in problem.constant_values().items()
    }
    order = sorted(range(count), key=lambda k: problem.parameters[k].name)
    for place, k in enumerate(order):
        exponents = tuple(int(place == other) for other in range(count))
        values[problem.parameters[k].name] = Polynomial({exponents: Fraction(1)})
    try:
        rows = matrix_values(problem, resolved, values, number)
    except (NotPolynomialError, MbdlftError):  # such as the sine of a constant
        return None
    symbols = [p[k] for k in order]
    try:
        entries = [
            [
                _horner((number(item) if isinstance(item, float) else item).terms, symbols)
                for item in row
            ]
            for row in rows
        ]
    except OverflowError:
        return None
    return ca.vertcat(*(ca.horzcat(*row) for row in entries))


def _horner(terms: dict[tuple[int, ...], Fraction], symbols: list[ca.SX]) -> ca.SX:
    if not terms:
        return ca.SX(0)
    if not symbols:
        return ca.SX(float(terms[()]))
    powers: dict[int, dict[tuple[int, ...], Fraction]] = {}
    for exponents, value in terms.items():
        powers.setdefault(exponents[0], {})[exponents[1:]] = value
    total = ca.SX(0)
    for exponent in range(max(powers), -1, -1):
        total = symbols[0] * total + _horner(powers.get(exponent, {}), symbols[1:])
    return total
