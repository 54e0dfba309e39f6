"""Laws of exact matrices against fractions, and of LFTs of exact numbers."""

import math
from fractions import Fraction
from itertools import pairwise

import flint
import mpmath
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mbdlft.exact import matrices, modular, rounding
from mbdlft.exact import matrices as module
from mbdlft.exact.interval import Interval
from mbdlft.exact.numbers import BITS, RESIDUES_ALONE, Constant, Field, TooFewBitsError, precision
from mbdlft.exact.rounding import product
from mbdlft.lft import lft as algebra
from mbdlft.lft.box_gain import gain_bound
from mbdlft.lft.lft import LFT, Block, constant, delta, eliminate, transpose
from mbdlft.lft.sampling import agrees, evaluate, evaluate_at
from mbdlft.order.reduction import ExactLFT, _rounded, eliminated, transposed
from mbdlft.robust import sector
from mbdlft.robust.bisect import boxes, characteristic
from tests.close import EPS, ONE_ROUNDING, conditioned, exact, roundoff, target
from tests.extracted import FIELD, exact_matrix, exactly
from tests.extracted import with_bits as with_bits
from tests.laws.lfts import lfts, points

Fractions = list[list[Fraction]]
PRIME = FIELD.prime
sides = st.integers(0, 5)


def fractions(seed: int, n: int, m: int, most_rank: int = 5) -> Fractions:
    """A matrix of small fractions, many of them zero, of no more than some rank."""
    random = np.random.default_rng(seed)

    def some(rows: int, columns: int) -> np.ndarray:
        entries = random.integers(-6, 7, (rows, columns)) * (random.random((rows, columns)) < 0.7)
        below = random.integers(1, 8, (rows, columns))
        return np.array(
            [
                [Fraction(int(x), int(y)) for x, y in zip(*both, strict=True)]
                for both in zip(entries, below, strict=True)
            ],
            dtype=object,
        ).reshape(rows, columns)

    if most_rank < min(n, m):
        zero = np.full((n, m), Fraction(0), dtype=object)
        return (some(n, most_rank) @ some(most_rank, m) if most_rank else zero).tolist()
    return some(n, m).tolist()


def from_fractions(a: Fractions, m: int) -> matrices.ExactMatrix:
    return exact_matrix(a) if a else matrices.zeros(0, m, PRIME)


def in_flint(a: Fractions, m: int) -> flint.fmpq_mat:
    entries = [flint.fmpq(x.numerator, x.denominator) for row in a for x in row]
    return flint.fmpq_mat(len(a), m, entries)


def is_matrix(found: matrices.ExactMatrix, expected: flint.fmpq_mat) -> None:
    """Residues and balls are those of a matrix of fractions."""
    assert found.shape == (expected.nrows(), expected.ncols())
    for i, j in np.ndindex(*found.shape):
        value = Fraction(int(expected[i, j].p), int(expected[i, j].q))
        assert found.residues[i, j] == int(FIELD.residue(value))
        assert (found.balls[i, j] * value.denominator).contains(value.numerator)
        assert value != 0 or found.balls[i, j] == 0


@given(st.integers(0, 10**6), sides, sides, sides)
def test_arithmetic(seed: int, n: int, k: int, m: int) -> None:
    A, B, C = fractions(seed, n, k), fractions(seed + 1, k, m), fractions(seed + 2, n, m)
    a, b, c = from_fractions(A, k), from_fractions(B, m), from_fractions(C, m)
    p, q, r = in_flint(A, k), in_flint(B, m), in_flint(C, m)
    is_matrix(a @ b, p * q)
    is_matrix((a @ b) + -c, p * q - r)
    is_matrix(c + -c, r - r)
    is_matrix(a.T, p.transpose())
    both = matrices.stacked([[c, a], [a @ b, a]])
    assert both.shape == (2 * n, m + k)
    is_matrix(both[n:, :m], p * q)
    is_matrix(both[:n][:, m:], p)


@given(st.integers(0, 10**6), sides, sides)
def test_solve(seed: int, n: int, m: int) -> None:
    A, B = fractions(seed, n, n), fractions(seed + 1, n, m)
    a, b = from_fractions(A, n), from_fractions(B, m)
    if in_flint(A, n).det() == 0:
        if n and m:
            with pytest.raises(ZeroDivisionError):
                a.solve(b)
        return
    is_matrix(a.solve(b), in_flint(A, n).solve(in_flint(B, m)))
    exact((a @ a.solve(matrices.identity(n, PRIME))).residues, np.eye(n))


def test_residues_alone_are_the_same() -> None:
    """Sums, products and solutions, also of more rows than are eliminated one by one, without balls."""
    a, b = (from_fractions(fractions(seed, 70, 70, 70), 70) for seed in (1, 2))
    wanted = [(a @ b + -a).residues, a.solve(b).residues]
    a, b = (matrices.of_residues(x.residues, PRIME) for x in (a, b))
    with precision(RESIDUES_ALONE):
        found = [a @ b + -a, a.solve(b)]
        beside = matrices.stacked([[a, matrices.identity(70, PRIME)]])
    assert all(np.array_equal(x.residues, y) for x, y in zip(found, wanted, strict=True))
    assert all(x.known_balls is None for x in (*found, beside, beside[:, 1:].T))


@given(st.integers(0, 10**6), sides, sides, st.integers(0, 5))
def test_ranks(seed: int, n: int, m: int, most: int) -> None:
    A = fractions(seed, n, m, most)
    a, truth = from_fractions(A, m), in_flint(A, m)
    echelon, count = truth.rref()
    assert modular.rank(a.residues, PRIME) == count
    rows, pivots = modular.row_echelon(a.residues, PRIME)
    expected = [
        [int(FIELD.residue(Fraction(int(echelon[i, j].p), int(echelon[i, j].q)))) for j in range(m)]
        for i in range(count)
    ]
    assert rows.tolist() == expected
    assert pivots == [next(j for j in range(m) if echelon[i, j] != 0) for i in range(count)]
    assert modular.pivot_columns(a.residues, PRIME) == pivots
    nothing = modular.null_space(a.residues, PRIME)
    assert nothing.shape == (m, m - count)
    assert not modular.multiplied(a.residues, nothing, PRIME).any()
    assert modular.rank(nothing, PRIME) == m - count


# values --------------------------------------------------------------------------------------------


def test_values_are_the_nearest_doubles() -> None:
    numbers = [Fraction(1, 3), Fraction(10) ** 300, Fraction(1, 10**300), Fraction(0)]
    exact(exact_matrix([numbers]).values(), [[float(x) for x in numbers]])
    third = FIELD.rational(Fraction(1, 3))
    left = third - FIELD.rational(Fraction(10**40 // 3, 10**40))
    found = module.from_rows([{1: left}], 2, PRIME)
    roundoff(found.values()[0, 1] * 1e40, 1.0 / 3.0)
    assert found.values()[0, 0] == 0.0
    with pytest.raises(TooFewBitsError, match=r"a ball of radius .* is too wide\."):
        module.from_rows([{0: left * left * left + left * third - left * third}], 1, PRIME).values()


@pytest.mark.parametrize("bits", [52, 57, 59, 70])
def test_values_are_told_up_to_their_last_unit_only(bits: int) -> None:
    """An entry known to so many bits: its nearest double, or an error, and not one of another end."""
    third = FIELD.rational(Fraction(1, 3))
    value = type(third)(third.ball + flint.arb(0, 2.0 ** -(bits + 2)), third.residue)
    a = module.from_rows([{0: value}], 1, PRIME)
    if bits > 58:
        exact(a.values(), [[1.0 / 3.0]])
    else:
        with pytest.raises(TooFewBitsError, match="is too wide"):
            a.values()


def test_rough_values_never_fail() -> None:
    third = FIELD.rational(Fraction(1, 3))
    left = third - FIELD.rational(Fraction(10**120 // 3, 10**120))
    a = module.from_rows([{0: left, 2: third}], 3, PRIME)
    assert matrices.rough_values(a).tolist()[0][1] == 0.0
    roundoff(matrices.rough_values(a)[0, 2], 1.0 / 3.0)


def test_balls_that_are_too_wide_to_solve_with() -> None:
    tiny = FIELD.rational(Fraction(1, 2**400))
    rows = [{0: FIELD.one, 1: FIELD.one}, {0: FIELD.one, 1: FIELD.one + tiny}]
    a = module.from_rows(rows, 2, PRIME)
    with pytest.raises(TooFewBitsError, match="contain a singular one"):
        a.solve(matrices.identity(2, PRIME))
    difference = FIELD.rational(Fraction(1, 3)) - FIELD.rational(Fraction(10**120 // 3, 10**120))
    of_one = module.from_rows([{0: difference}], 1, PRIME)
    with pytest.raises(TooFewBitsError, match="contain a singular one"):
        of_one.solve(matrices.identity(1, PRIME))
    with precision(4 * BITS):
        rows[1][1] = FIELD.one + tiny
        found = module.from_rows(rows, 2, PRIME).solve(matrices.identity(2, PRIME)).values()
    exact(found, np.array([[1.0, -1.0], [-1.0, 1.0]]) * 2.0**400 + [[1.0, 0.0], [0.0, 0.0]])


def test_equations_of_many_sizes_keep_bits() -> None:
    """Powers of 1 to 45, as those of a matrix times a vector: up to 1e72 beside 1."""
    n = 45
    rows = [{j: FIELD.rational(Fraction(j + 1) ** i) for j in range(n)} for i in range(n)]
    found = module.from_rows(rows, n, PRIME).solve(matrices.identity(n, PRIME))
    assert min(ball.rel_accuracy_bits() for ball in found.balls.ravel()) > BITS // 3


def test_zeros_of_irrational_numbers() -> None:
    """[2 sqrt 2 ; sqrt 2 1] is singular."""
    field = Field([Constant("root", Fraction(2))])
    root = field.of(Constant("root", Fraction(2)))
    a = module.from_rows([{0: field.rational(2), 1: root}, {0: root, 1: field.one}], 2, field.prime)
    assert modular.rank(a.residues, field.prime) == 1
    with pytest.raises(ZeroDivisionError):
        a.solve(matrices.identity(2, field.prime))


# LFTs ----------------------------------------------------------------------------------------------


@given(lfts(3, 3, scales=(1.0,)), st.integers(1, 2))
def test_elimination(a: LFT, count: int) -> None:
    """Values of what is eliminated in doubles, and in exact numbers."""
    rows = [2, 0]
    found = eliminated(exactly(a), count, rows)
    plain = eliminate(a, count)
    at = {name: column for name, column in points(0).items() if name in dict(a.blocks)}
    roundoff(evaluate(found.rounded(), at), evaluate(plain, at)[..., rows, :], 1e4)
    same = evaluate(transposed(transposed(found)).rounded(), at)
    roundoff(same, evaluate(found.rounded(), at))
    flipped = evaluate(transposed(exactly(a)).rounded(), at)
    roundoff(flipped, evaluate(transpose(a), at))


def test_parts_of_an_lft() -> None:
    a = ExactLFT(matrices.zeros(7, 6, PRIME), (Block("a", 2), Block("b", 0), Block("c", 3)))
    assert a.order == 5
    assert a.parts == [slice(0, 2), slice(2, 2), slice(2, 5)]
    assert a.rounded().shape == (2, 1)


def test_balls_of_zeros_are_zero() -> None:
    third = exact_matrix([[Fraction(1, 3)]])
    assert (third + third + -third + -third).balls[0, 0] == 0


@pytest.mark.parametrize(
    "shape",
    [(1, 1, 1), (2, 0, 3), (2, 3, 4), (30, 20, 25), (3, 500, 4), (3, 501, 4), (90, 60, 70), (3, 5001, 2)],
)
def test_products_of_residues(shape: tuple[int, int, int]) -> None:
    """Against integers of any size; the largest residues, parts that are all ones, stacks."""
    n, k, m = shape
    random, prime = np.random.default_rng(k), Field(()).prime
    ones = (random.integers(0, prime >> 42, (n, k)) << 42) + 2**42 - 1
    middle = np.full((n, k), 2**31 - 1)
    for a, b in (
        (random.integers(0, prime, (n, k)), random.integers(0, prime, (k, m))),
        (np.full((n, k), prime - 1), np.full((k, m), prime - 1)),
        (ones, np.resize(ones, (k, m))),
        (middle, np.full((k, m), prime - 1)),
    ):
        expected = (a.astype(object) @ b.astype(object)) % prime
        exact(modular.multiplied(a, b, prime), expected.astype(np.int64))
        twice = modular.multiplied(np.array([a, 0 * a]), np.array([b, b]), prime)
        exact(twice, np.array([expected, 0 * expected]).astype(np.int64))


def test_inverses_of_residues() -> None:
    a = np.random.default_rng(0).integers(1, PRIME, 50)
    exact(modular.entrywise(modular.inverses(a, PRIME), a, PRIME), np.ones(50, dtype=np.int64))


@pytest.mark.parametrize("most", [1, PRIME - 1])
def test_products_of_entries(most: int) -> None:
    """Against integers of any size: any residues, and the largest ones."""
    a, b = PRIME - 1 - np.random.default_rng(most).integers(0, most, (2, 200), dtype=np.int64)
    for x, y in ((a, b), (a[:, None], b[:3])):
        exact(
            modular.entrywise(x, y, PRIME), (x.astype(object) * y.astype(object) % PRIME).astype(np.int64)
        )


# Products and solutions in twice the working precision against rational arithmetic, entry by entry.

seeds = st.integers(0, 1000)
Exact = np.ndarray  # of Fraction


def as_fractions(matrix: np.ndarray) -> Exact:
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
    away = ((as_fractions(found) - expected) / expected).astype(float)
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
    total, rest = (as_fractions(part) for part in rounding.exact_sum(a, b))
    assert np.all(total + rest == as_fractions(a) + as_fractions(b))


@given(seeds)
def test_products_with_what_is_below_the_rounding(seed: int) -> None:
    random = np.random.default_rng(seed)
    left, right = random.uniform(1.0, 2.0, (3, 7)), random.uniform(1.0, 2.0, (7, 4))
    low = random.uniform(-EPS, EPS, right.shape) / 4.0
    found = rounding.multiply_add(-left @ right, left, rounding.Twofold(right, low))
    expected = as_fractions(-left @ right) + as_fractions(left) @ (
        as_fractions(right) + as_fractions(low)
    )
    errors = (as_fractions(found) - expected) / as_fractions(EPS * left @ right)
    # of 95 binary digits 53 cancel
    conditioned(1.0 + errors.astype(float), np.ones(expected.shape), 2.0 ** (2 * 53 - 95))


@given(seeds)
def test_products(seed: int) -> None:
    random = np.random.default_rng(seed)
    left = random.standard_normal((3, 7)) * np.exp2(random.integers(-30, 30, 7))
    right = random.standard_normal((7, 4)) * np.exp2(random.integers(-30, 30, 4))
    base = -left @ right  # what is left is rounding
    entries(
        rounding.multiply_add(base, left, rounding.Twofold(right, 0.0 * right)),
        as_fractions(base) + as_fractions(left) @ as_fractions(right),
        np.abs(base) + np.abs(left) @ np.abs(right),
    )


@pytest.mark.parametrize("n", [1, 3, 8])
def test_exponentials(n: int) -> None:
    """To twice the digits, also of many revolutions, and of what has decayed to nothing."""
    random = np.random.default_rng(n)
    A = random.standard_normal((2, n, n)) * [[[1.0]], [[1e4]]]
    A = A - np.swapaxes(A, 1, 2) - 0.1 * np.eye(n)
    high, low = rounding.exponential(A)
    for k in range(2):
        with flint.ctx.workprec(400):
            parts = [flint.arb_mat(part[k].tolist()) for part in (high, low)]
            left = flint.arb_mat(A[k].tolist()).exp() - parts[0] - parts[1]
        assert max(abs(float(x.mid())) for x in left.entries()) < 1e-22
    exact(rounding.exponential(np.array([[-1380.0]])).high, [[0.0]])  # of a square of 1e-300
    assert rounding.exponential(np.zeros((2, 0, 0))).high.shape == (2, 0, 0)


@pytest.mark.parametrize("n", [1, 2, 5, 8, 10])
def test_solutions(n: int) -> None:
    matrix, right = hilbert(n), np.random.default_rng(n).standard_normal((n, 3))
    found, expected = (
        rounding.solve_twofold(matrix, right),
        solved(as_fractions(matrix), as_fractions(right)),
    )
    entries(found.high, expected)
    rest = (expected - as_fractions(found.high)).astype(float)
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
    G, forced = (solved(as_fractions(H), as_fractions(change)), solved(as_fractions(H), as_fractions(B)))
    loop = G + as_fractions(np.eye(n))
    x = -solved(loop, forced)
    # entries of G and of H^-1 B are rounded, and (I + G) x = -H^-1 B is solved for
    error = abs(solved(loop, as_fractions(np.eye(n)))) @ (abs(G) @ abs(x) + abs(x) + abs(forced))
    y, size = as_fractions(C) @ x + as_fractions(D), abs(as_fractions(C))
    errors = np.vstack([error, size @ (error + abs(x)) + abs(as_fractions(D))]).astype(float)
    away = (as_fractions(found) - np.vstack([x, y])).astype(float) / errors
    target(away, np.zeros(found.shape), ONE_ROUNDING, 1.0)


# Negative controls whose last unit decides: with a bound of rounding left out, each of them fails.

many_seeds = pytest.mark.parametrize("seed", range(5))


def halved(values: list[Fraction]) -> tuple[list[Fraction], list[Fraction]]:
    """De Casteljau's algorithm in fractions."""
    low, high, row = [values[0]], [values[-1]], values
    while len(row) > 1:
        row = [(a + b) / 2 for a, b in pairwise(row)]
        low, high = [*low, row[0]], [row[-1], *high]
    return low, high


@pytest.mark.parametrize("axis", [0, -1])
@many_seeds
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


@many_seeds
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


@many_seeds
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
