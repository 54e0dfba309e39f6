"""Laws of the polynomials that matrices are written in: at a point, they are fractions."""

import operator
from collections.abc import Callable
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mbdlft.matrix.symbolic import NotPolynomialError, Polynomial

seeds = st.integers(0, 1000)
ARITHMETIC = [operator.add, operator.sub, operator.mul]
by_operation = pytest.mark.parametrize("operation", ARITHMETIC, ids=lambda each: each.__name__)
Operation = Callable[[Any, Any], Any]


def polynomial(random: np.random.Generator) -> Polynomial:
    """In two variables, of degree 3 at most in each."""
    terms: dict[tuple[int, ...], Fraction] = {}
    for first, second, value in random.integers(0, 4, (5, 3)).tolist():
        terms[first, second] = Fraction(value - 1, 3)
    terms[0, 0] = Fraction(1)
    return Polynomial(terms)


def at(found: Polynomial, point: tuple[Fraction, Fraction]) -> Fraction:
    x, y = point
    return sum((value * x**i * y**j for (i, j), value in found.terms.items()), Fraction(0))


@by_operation
@given(seeds)
def test_polynomials(operation: Operation, seed: int) -> None:
    random = np.random.default_rng(seed)
    a, b, point = polynomial(random), polynomial(random), (Fraction(2, 7), Fraction(-5, 3))
    assert at(operation(a, b), point) == operation(at(a, point), at(b, point))
    assert at(operation(a, 0.3), point) == operation(at(a, point), Fraction(3, 10))
    assert at(operation(0.3, a), point) == operation(Fraction(3, 10), at(a, point))
    assert at(a / 0.3, point) == at(a, point) / Fraction(3, 10)
    assert at(-a, point) == -at(a, point)


def test_polynomials_are_not_divided_by_polynomials() -> None:
    x = Polynomial({(1, 0): Fraction(1)})
    for divisor in (x, Polynomial({})):
        with pytest.raises(NotPolynomialError):
            x / divisor
