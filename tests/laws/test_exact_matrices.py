"""Laws of exact matrices against fractions, and of LFTs of exact numbers.

1. sums, products, solutions, ranks, echelon forms and null spaces are those of fractions
2. values are the nearest doubles, or too few bits are said to be too few
3. what is solved for in an LFT is what values say
"""

from fractions import Fraction

import flint
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mbdlft.exact import matrices
from mbdlft.exact import matrices as module
from mbdlft.exact.numbers import BITS, Constant, Field, TooFewBitsError, precision
from mbdlft.lft.lft import LFT, Block, eliminate, transpose
from mbdlft.lft.sampling import evaluate
from mbdlft.order.reduction import ExactLFT, eliminated, transposed
from tests.close import exact, roundoff
from tests.extracted import FIELD, exact_matrix, exactly
from tests.laws.lfts import lfts, points

Fractions = list[list[Fraction]]
PRIME = FIELD.prime
sides = st.integers(0, 5)


@pytest.fixture(autouse=True)
def with_bits() -> object:
    with precision(BITS):
        yield


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


@given(st.integers(0, 10**6), sides, sides, st.integers(0, 5))
def test_ranks(seed: int, n: int, m: int, most: int) -> None:
    A = fractions(seed, n, m, most)
    a, truth = from_fractions(A, m), in_flint(A, m)
    echelon, count = truth.rref()
    assert matrices.rank(a.residues, PRIME) == count
    rows, pivots = matrices.row_echelon(a.residues, PRIME)
    expected = [
        [int(FIELD.residue(Fraction(int(echelon[i, j].p), int(echelon[i, j].q)))) for j in range(m)]
        for i in range(count)
    ]
    assert rows.tolist() == expected
    assert pivots == [next(j for j in range(m) if echelon[i, j] != 0) for i in range(count)]
    assert matrices.pivot_columns(a.residues, PRIME) == pivots
    nothing = matrices.null_space(a.residues, PRIME)
    assert nothing.shape == (m, m - count)
    assert not matrices.multiplied(a.residues, nothing, PRIME).any()
    assert matrices.rank(nothing, PRIME) == m - count


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
    assert matrices.rank(a.residues, field.prime) == 1
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


@pytest.mark.parametrize("shape", [(1, 1, 1), (2, 3, 4), (30, 20, 25), (3, 5001, 2)])
def test_products_of_residues(shape: tuple[int, int, int]) -> None:
    """Against integers of any size; with the largest residues, and with limbs that are all ones."""
    n, k, m = shape
    random, prime = np.random.default_rng(k), Field(()).prime
    ones = (random.integers(0, prime >> 42, (n, k)) << 42) + 2**42 - 1
    for a, b in (
        (random.integers(0, prime, (n, k)), random.integers(0, prime, (k, m))),
        (np.full((n, k), prime - 1), np.full((k, m), prime - 1)),
        (ones, np.resize(ones, (k, m))),
    ):
        expected = (a.astype(object) @ b.astype(object)) % prime
        exact(matrices.multiplied(a, b, prime), expected.astype(np.int64))
        exact(matrices.times(a, matrices.limbs(b), prime), expected.astype(np.int64))


@pytest.mark.parametrize("most", [1, PRIME - 1])
def test_products_of_entries(most: int) -> None:
    """Against integers of any size: any residues, and the largest ones."""
    a, b = PRIME - 1 - np.random.default_rng(most).integers(0, most, (2, 200), dtype=np.int64)
    for x, y in ((a, b), (a[:, None], b[:3])):
        exact(
            matrices.entrywise(x, y, PRIME),
            (x.astype(object) * y.astype(object) % PRIME).astype(np.int64),
        )
