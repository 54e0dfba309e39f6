"""Negative controls whose last unit decides: with a bound of rounding left out, each of them fails."""

import math
from fractions import Fraction
from itertools import pairwise

import flint
import mpmath
import numpy as np
import pytest

from mbdlft.exact.interval import Interval
from mbdlft.exact.numbers import TooFewBitsError
from mbdlft.exact.rounding import product
from mbdlft.lft.box_gain import gain_bound
from mbdlft.lft.lft import LFT, Block, constant
from mbdlft.lft.sampling import agrees, evaluate_at
from mbdlft.order.reduction import _rounded
from mbdlft.robust import sector
from mbdlft.robust.bisect import boxes, characteristic
from tests.close import EPS

seeds = pytest.mark.parametrize("seed", range(5))


def halved(values: list[Fraction]) -> tuple[list[Fraction], list[Fraction]]:
    """De Casteljau's algorithm in fractions."""
    low, high, row = [values[0]], [values[-1]], values
    while len(row) > 1:
        row = [(a + b) / 2 for a, b in pairwise(row)]
        low, high = [*low, row[0]], [row[-1], *high]
    return low, high


@pytest.mark.parametrize("axis", [0, -1])
@seeds
def test_halves_of_a_polynomial_are_within_their_errors(axis: int, seed: int) -> None:
    """Real coefficients with no error of their own: each mean of two rounds."""
    rows = np.random.default_rng(seed).uniform(0.1, 1.0, (6, 6))
    whole = boxes.Piece(rows[None].astype(complex), np.zeros((1, 6)), 0.0, 1.0)
    lines = rows.T if axis == 0 else rows
    exactly = [halved([Fraction(x) for x in line]) for line in lines.tolist()]
    for side, piece in enumerate(boxes.halves(whole, axis)):
        found = piece.values[0].real.T if axis == 0 else piece.values[0].real
        for i, k in np.ndindex(6, 6):
            power = i if axis == 0 else k
            off = abs(Fraction(float(found[i, k])) - exactly[i][side][k])
            assert off <= Fraction(float(piece.error[0, power]))


@seeds
def test_no_gain_is_excluded_that_is_reached(seed: int) -> None:
    """A constant p beside a constant q with an error: |p| > g (|q| + e) in fractions if it is told."""
    random, told = np.random.default_rng(seed), 0
    for _ in range(200):
        gain, q, e = random.uniform(0.5, 2.0), random.uniform(0.5, 2.0), random.uniform(0.0, 0.1)
        p = gain * (q + e) * (1.0 + random.integers(-60, 200) * EPS)
        values = np.array([p, q], dtype=complex).reshape(2, 1)
        piece = boxes.Piece(values, np.array([[0.0], [e]]), 0.0, 1.0, outputs=1)
        if boxes.excludes(piece, gain):
            assert Fraction(float(p)) > Fraction(gain) * (Fraction(q) + Fraction(e))
            told += 1
    assert told > 50


@pytest.mark.parametrize("slope", [0.1, 0.7])
def test_products_with_powers_are_within_their_error(slope: float) -> None:
    powers, off = characteristic._powers(12, slope)
    with mpmath.workdps(60):
        for k, power in enumerate(powers):
            expected = mpmath.mpc(-slope, 1) ** k
            assert abs(mpmath.mpc(power) - expected) <= off * abs(expected)


@seeds
def test_norms_of_constants_are_not_below_them(seed: int) -> None:
    """a b' of vectors of integers: the square of its norm is an integer."""
    a, b = np.random.default_rng(seed).integers(-9, 10, (2, 4))
    assert Fraction(gain_bound(constant(np.outer(a, b).astype(float)))) ** 2 >= int(a @ a) * int(b @ b)


def test_a_function_of_the_library_may_be_wrong_in_its_last_digits() -> None:
    """An exponential that is wrong by three units in the last place."""
    for sign in (-1.0, 1.0):
        of = sector._monotone(lambda x, sign=sign: math.exp(x) * (1.0 + 3.0 * sign * EPS))
        found = of(Interval(0.7, 0.7))
        assert found.low <= math.exp(0.7) <= found.high


def test_values_that_differ_by_rounding_agree() -> None:
    """And those do not that differ by more."""
    random = np.random.default_rng(0)
    M = random.uniform(-0.3, 0.3, (5, 5))
    a = LFT(M[:3, :3], M[:3, 3:], M[3:, :3], M[3:, 3:], (Block("d", 3),))
    points = random.uniform(-1.0, 1.0, (20, 1))
    values, lost = evaluate_at(a, points), np.zeros(20, dtype=bool)
    assert agrees(a, points, values * (1.0 + 4.0 * EPS), lost, 0.0)
    assert not agrees(a, points, values * (1.0 + 1e-9), lost, 0.0)


@pytest.mark.parametrize(("apart", "stays"), [(2.0**-48, True), (2.0**-52, False)])
def test_a_sum_is_zero_where_its_terms_may_have_cancelled(apart: float, stays: bool) -> None:
    value = product(np.array([[1.0 + apart, 1.0]]), np.array([[1.0], [-1.0]]))
    assert value[0, 0] == (apart if stays else 0.0)


def test_a_number_that_is_not_known_is_not_rounded() -> None:
    a = LFT(np.zeros((1, 1)), np.ones((1, 1)), np.ones((1, 1)), np.zeros((1, 1)), (Block("a", 1),))
    known = np.array([[flint.arb(0), flint.arb(1)], [flint.arb(1, 2.0**-70), flint.arb(0)]])
    assert _rounded(known, a).M21 == 1.0
    known[1, 0] = flint.arb(1, 2.0**-50)
    with pytest.raises(TooFewBitsError):
        _rounded(known, a)
