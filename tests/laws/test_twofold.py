"""Products and solutions in twice the working precision against rational arithmetic, entry by entry.

1. base + left right has the error of one rounding, although almost all of it cancels, and of as many
   roundings of its low part as there are levels of slices: eps/2 |value| + 5 (eps/2)^2 of its terms
2. matrix^-1 right has the error of one rounding in each entry, with condition numbers up to 1e13
3. an elimination with such a matrix costs the digits of its condition once, not twice
4. the low parts are what rounding took from the high ones
"""

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mbdlft.exact import rounding
from mbdlft.lft import lft as algebra
from mbdlft.lft.lft import constant, delta
from mbdlft.lft.sampling import evaluate
from tests.close import EPS, ONE_ROUNDING, conditioned, target

seeds = st.integers(0, 1000)
Exact = np.ndarray  # of Fraction


def fractions(matrix: np.ndarray) -> Exact:
    """The numbers themselves."""
    exact = [Fraction(float(value)) for value in matrix.ravel()]
    return np.array(exact, dtype=object).reshape(matrix.shape)


def solved(matrix: Exact, right: Exact) -> Exact:
    """matrix^-1 right by Gauss and Jordan, exactly."""
    a, n = np.hstack([matrix, right]), len(matrix)
    for k in range(n):
        pivot = next(row for row in range(k, n) if a[row, k])
        a[[k, pivot]] = a[[pivot, k]]
        a[k] = a[k] / a[k, k]
        for row in range(n):
            if row != k:
                a[row] = a[row] - a[row, k] * a[k]
    return a[:, n:]


def entries(found: np.ndarray, expected: Exact, terms: float | np.ndarray = 0.0) -> None:
    """Each entry relative to itself; `terms` are the sizes of what was added up."""
    away = ((fractions(found) - expected) / expected).astype(float)
    roundings = 0.5 + 1.25 * EPS * terms / np.abs(expected.astype(float))
    target(away / roundings, np.zeros(found.shape), ONE_ROUNDING, 1.0)


def hilbert(n: int) -> np.ndarray:
    """Condition 1e13 at n = 10; units of rows and columns differ by 1e12."""
    i = np.arange(n)
    units = np.logspace(-6, 6, n)
    return units[:, None] / (i[:, None] + i + 1.0) * units[::-1]


@given(seeds)
def test_the_error_of_a_sum_is_exact(seed: int) -> None:
    random = np.random.default_rng(seed)
    a, b = random.standard_normal((2, 50)) * np.exp2(random.integers(-60, 60, (2, 50)))
    total, rest = (fractions(part) for part in rounding.exact_sum(a, b))
    assert np.all(total + rest == fractions(a) + fractions(b))


@given(seeds)
def test_products_with_what_is_below_the_rounding(seed: int) -> None:
    random = np.random.default_rng(seed)
    left, right = random.uniform(1.0, 2.0, (3, 7)), random.uniform(1.0, 2.0, (7, 4))
    low = random.uniform(-EPS, EPS, right.shape) / 4.0
    found = rounding.multiply_add(-left @ right, left, rounding.Twofold(right, low))
    expected = fractions(-left @ right) + fractions(left) @ (fractions(right) + fractions(low))
    ratio = np.array([float(a / b) for a, b in zip(fractions(found).flat, expected.flat)])  # noqa: B905
    # of 95 binary digits 53 cancel
    conditioned(ratio, np.ones(expected.size), 2.0 ** (2 * 53 - 95))


@given(seeds)
def test_products(seed: int) -> None:
    random = np.random.default_rng(seed)
    left = random.standard_normal((3, 7)) * np.exp2(random.integers(-30, 30, 7))
    right = random.standard_normal((7, 4)) * np.exp2(random.integers(-30, 30, 4))
    base = -left @ right  # what is left is rounding
    entries(
        rounding.multiply_add(base, left, rounding.Twofold(right, 0.0 * right)),
        fractions(base) + fractions(left) @ fractions(right),
        np.abs(base) + np.abs(left) @ np.abs(right),
    )


@pytest.mark.parametrize("n", [1, 2, 5, 8, 10])
def test_solutions(n: int) -> None:
    matrix, right = hilbert(n), np.random.default_rng(n).standard_normal((n, 3))
    found, expected = (rounding.solve_twofold(matrix, right), solved(fractions(matrix), fractions(right)))
    entries(found.high, expected)
    rest = (expected - fractions(found.high)).astype(float)
    conditioned(found.low, rest, algebra.condition(matrix))


@pytest.mark.parametrize("n", [5, 8])
def test_eliminations(n: int) -> None:
    """[0 ; y] = [H + d E, B ; C, D] [a ; s] at d = 1 is a solution with H + E; E is as H."""
    random = np.random.default_rng(n)
    B, C, D = (random.standard_normal(shape) for shape in ((n, 2), (2, n), (2, 2)))
    H, some = hilbert(n), random.uniform(0.5, 2.0, n)
    change = some[:, None] * H * some
    upper = constant(H) + constant(change) @ delta("d", n)
    relation = algebra.stack_rows(algebra.stack_columns(upper, B), algebra.stack_columns(constant(C), D))
    found = evaluate(algebra.eliminate(relation, n), {"d": 1.0})
    G, forced = solved(fractions(H), fractions(change)), solved(fractions(H), fractions(B))
    loop = G + fractions(np.eye(n))
    x = -solved(loop, forced)
    # entries of G and of H^-1 B are rounded, and (I + G) x = -H^-1 B is solved for
    error = abs(solved(loop, fractions(np.eye(n)))) @ (abs(G) @ abs(x) + abs(x) + abs(forced))
    y, size = fractions(C) @ x + fractions(D), abs(fractions(C))
    errors = np.vstack([error, size @ (error + abs(x)) + abs(fractions(D))]).astype(float)
    away = (fractions(found) - np.vstack([x, y])).astype(float) / errors
    target(away, np.zeros(found.shape), ONE_ROUNDING, 1.0)
