"""Polynomial matrices written anew in one way, so that an order does not depend on how they were written.

Polynomials are one more number system for the expressions: coefficients are fractions, a float is taken
as the decimal it prints as, so what cancels is gone. They are written by Horner's rule in one parameter
after the other: all products then have their factors in one order.
"""

from fractions import Fraction
from typing import Any, Self

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from mbdlft.base.errors import MbdlftError
from mbdlft.exact.numbers import decimal
from mbdlft.exact.operators import Operators
from mbdlft.matrix.problem import MatrixProblem
from mbdlft.matrix.resolve import MatrixForm, Resolved, matrix_values
from mbdlft.problem.sx.constants import literal

_MOST_TERMS, _MOST_DEGREE = 1000, 128


class NotPolynomialError(Exception):
    """A division by more than a number, or more terms or a higher degree than are expanded."""


class Polynomial(Operators):
    """Coefficients by the exponents of the variables; ``+ - * /`` as for numbers."""

    __slots__ = ("terms",)

    def __init__(self, terms: dict[tuple[int, ...], Fraction]) -> None:
        self.terms = {exponents: value for exponents, value in terms.items() if value}
        if len(self.terms) > _MOST_TERMS:
            raise NotPolynomialError

    def __add__(self, other: "Polynomial | float") -> Self:
        total = dict(self.terms)
        for exponents, value in self.of(other).terms.items():
            total[exponents] = total.get(exponents, Fraction(0)) + value
        return type(self)(total)

    def __neg__(self) -> Self:
        return type(self)({exponents: -value for exponents, value in self.terms.items()})

    def __mul__(self, other: "Polynomial | float") -> Self:
        total: dict[tuple[int, ...], Fraction] = {}
        factor = self.of(other)
        if self._degree() + factor._degree() > _MOST_DEGREE:
            raise NotPolynomialError
        for first, x in self.terms.items():
            for second, y in factor.terms.items():
                exponents = tuple(a + b for a, b in zip(first, second, strict=True))
                total[exponents] = total.get(exponents, Fraction(0)) + x * y
        return type(self)(total)

    def __truediv__(self, other: "Polynomial | float") -> Self:
        divisor = self.of(other).terms
        if any(any(exponents) for exponents in divisor) or not divisor:
            raise NotPolynomialError
        (value,) = divisor.values()
        return type(self)({exponents: x / value for exponents, x in self.terms.items()})

    def _degree(self) -> int:
        return max(map(sum, self.terms), default=0)

    def of(self, number: "Polynomial | float") -> Self:
        if isinstance(number, Polynomial):
            return type(self)(number.terms)
        size = len(next(iter(self.terms), ()))
        return type(self)({(0,) * size: Fraction(repr(number))})


def expanded_matrix(
    problem: MatrixProblem, resolved: Resolved, factors: NDArray[np.float64]
) -> MatrixForm | None:
    """The matrix by Horner's rule in its parameters, with entries times `factors` (rows, columns).

    None if it is not polynomial, or if its degree is too high.
    """
    if any(parameter.is_angle for parameter in problem.parameters):
        return None
    count = len(problem.parameters)
    order = sorted(range(count), key=lambda k: problem.parameters[k].name)

    def number(value: float) -> Polynomial:
        return Polynomial({(0,) * count: decimal(value)})

    values: dict[str, Any] = {
        name: number(value) for name, value in problem.constant_values().items()
    }
    for place, k in enumerate(order):
        exponents = tuple(int(place == other) for other in range(count))
        values[problem.parameters[k].name] = Polynomial({exponents: Fraction(1)})
    try:
        rows = matrix_values(problem, resolved, values, number)
    except (NotPolynomialError, MbdlftError):  # such as the sine of a constant
        return None
    q = ca.SX.sym("q", count)
    symbols = [q[k] for k in order]
    matrix = ca.vertcat(
        *(ca.horzcat(*(_horner(item.terms, symbols) for item in row)) for row in rows)
    )
    return MatrixForm(q, ca.DM(factors) * matrix)


def _horner(terms: dict[tuple[int, ...], Fraction], symbols: list[ca.SX]) -> ca.SX:
    if not terms:
        return ca.SX(0)
    if not symbols:
        return ca.SX(literal(terms[()]))
    powers: dict[int, dict[tuple[int, ...], Fraction]] = {}
    for exponents, value in terms.items():
        powers.setdefault(exponents[0], {})[exponents[1:]] = value
    total = ca.SX(0)
    for exponent in range(max(powers), -1, -1):
        total = symbols[0] * total + _horner(powers.get(exponent, {}), symbols[1:])
    return total
