"""Laws of reduction and of the lower bound."""

from collections.abc import Callable
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mbdlft.exact import reachable as module
from mbdlft.exact.matrices import ExactMatrix, rough_values
from mbdlft.exact.modular import Space, parts_of, rank, reachable_bases
from mbdlft.exact.numbers import BITS, precision
from mbdlft.lft.lft import LFT, Block, consecutive, delta
from mbdlft.lft.sampling import evaluate, evaluate_at
from mbdlft.order.reduction import _SHOWN, ExactLFT, in_good_coordinates, reduce_exactly, reduce_order
from tests.close import ONE_ROUNDING, exact, roundoff
from tests.extracted import FIELD, exact_matrix, exactly, lower_bound
from tests.extracted import with_bits as with_bits
from tests.laws.lfts import lfts, padded, points, sparse_lfts

KAPPA = 1e5
seeds = st.integers(0, 1000)


def values(a: LFT, seed: int) -> np.ndarray:
    at = points(seed)
    return evaluate(a, {name: at[name] for name, _ in a.blocks}) if a.blocks else a.M22[None]


def law_values(reduction: Callable[[LFT], LFT], a: LFT, seed: int) -> None:
    roundoff(values(reduction(a), seed), values(a, seed), KAPPA)


@given(lfts(), seeds)
def test_values_stay_order_does_not_grow_second_time_nothing(a: LFT, seed: int) -> None:
    law_values(reduce_order, a, seed)
    once = reduce_order(a)
    twice = reduce_order(once)
    assert all(new.size <= old.size for new, old in zip(once.blocks, a.blocks, strict=True))
    assert twice.blocks == once.blocks
    exact(twice.M11, once.M11)


@given(lfts(2, 2, scales=(1.0,)), seeds)
def test_padding_is_taken_back(a: LFT, seed: int) -> None:
    wide = padded(a, np.random.default_rng(seed))
    roundoff(values(wide, seed), values(a, seed), KAPPA)
    assert reduce_order(wide).blocks == reduce_order(a).blocks
    law_values(reduce_order, wide, seed)


@given(lfts(scales=(1.0,)), seeds)
def test_bound_is_not_above_any_order(a: LFT, seed: int) -> None:
    bound = lower_bound(a)
    small = reduce_order(a)
    assert all(bound[block.name] <= block.size for block in small.blocks)
    assert lower_bound(padded(a, np.random.default_rng(seed))) == bound


def test_bound_of_words_that_commute() -> None:
    """[d1 d2 ; d2 d1]: n-D reduction keeps 4, the bound is 1 each."""
    from mbdlft.lft.lft import stack_rows

    d1, d2 = delta("d1"), delta("d2")
    a = stack_rows(d1 @ d2, d2 @ d1)
    assert dict(reduce_order(a).blocks) == {"d1": 2, "d2": 2}
    assert lower_bound(a) == {"d1": 1, "d2": 1}


def test_merging_cases_of_the_literature() -> None:
    """Shared factors are merged: [d1 d2 ; d1 d2] is 2; two equal inverses 1/(1+d1+d2) are 2."""
    from mbdlft.lft.lft import constant, inverse, stack_rows

    d1, d2 = delta("d1"), delta("d2")
    assert reduce_order(stack_rows(d1 @ d2, d1 @ d2)).order == 2
    quotient = inverse(constant([[1.0]]) + d1 @ constant([[0.3]]) + d2 @ constant([[0.3]]))
    both = reduce_order(stack_rows(quotient, quotient))
    assert both.order == 2 == sum(lower_bound(both).values())


@pytest.mark.parametrize("power", [-12, -6, 6, 12])
def test_scales_do_not_change_ranks(power: int) -> None:
    random = np.random.default_rng(4)
    blocks = (Block("a", 3), Block("b", 2))
    minimal = LFT(
        0.3 * random.standard_normal((5, 5)),
        random.standard_normal((5, 2)),
        random.standard_normal((2, 5)),
        random.standard_normal((2, 2)),
        blocks,
    )
    wide = padded(minimal, random)
    scale = 10.0 ** (power * random.random(wide.order))
    inputs, outputs = 10.0 ** (power * random.random(2)), 10.0 ** (power * random.random(2))
    scaled = LFT(
        scale[:, None] * wide.M11 / scale,
        scale[:, None] * wide.M12 * inputs,
        outputs[:, None] * wide.M21 / scale,
        outputs[:, None] * wide.M22 * inputs,
        wide.blocks,
    )
    assert reduce_order(scaled).blocks == blocks
    assert lower_bound(scaled) == dict(blocks)


# Laws of the reduction in exact numbers.

PRIME = FIELD.prime


def at_points(a: LFT) -> np.ndarray:
    return evaluate(a, {k: 0.3 * v for k, v in points(0).items() if k in dict(a.blocks)})


def law_reduced(a: LFT) -> ExactLFT:
    whole = exactly(a)
    small = reduce_exactly(whole)
    expected = at_points(a)
    size = max(1.0, float(np.max(np.abs(expected))))
    roundoff(at_points(small.rounded()), expected, 1e4, size)
    assert reduce_exactly(small).blocks == small.blocks
    assert [b.name for b in small.blocks] == [b.name for b in a.blocks]
    assert all(x.size <= y.size for x, y in zip(small.blocks, a.blocks, strict=True))
    return small


@given(lfts(most=3, scales=(1.0,)))
def test_values_stay(a: LFT) -> None:
    assert law_reduced(a).blocks == reduce_order(a).blocks


@given(sparse_lfts())
def test_orders_of_sparse_lfts(a: LFT) -> None:
    """Entries are small fractions, so the reduction in doubles sees the same."""
    assert reduce_exactly(exactly(a)).blocks == reduce_order(a).blocks


def nearly_equal(size: int) -> ExactLFT:
    """A chain of so many channels w, and before these as many sums of all w, equal but for 1e-9."""
    far = np.random.default_rng(size).integers(-4, 5, (size, size)).tolist()
    sums = np.array([[1 + Fraction(x, 10**9) for x in row] for row in far])
    one = np.array([[Fraction(j == k) for j in range(size)] for k in range(size)])
    w = np.vstack([sums, one])
    of_w = np.hstack([one / 4, one - sums / 4])  # w from the channels, in one of many ways
    A = np.vstack([np.roll(one, 1, axis=1), one[:1]])  # what the chain does, and the output
    top = np.hstack([w @ A[:-1] @ of_w, w[:, :1] + w[:, size // 2, None]])
    M = np.vstack([top, np.append(A[-1:] @ of_w, [[Fraction(0)]], axis=1)])
    return ExactLFT(exact_matrix(M.tolist()), (Block("a", 2 * size),))


def coarse(seed: int) -> LFT:
    """A minimal LFT of quarters."""
    random = np.random.default_rng(seed)
    blocks = (Block("a", 2), Block("b", 3))
    M = random.integers(-3, 4, (7, 7)) / 4.0
    return LFT(M[:5, :5], M[:5, 5:], M[5:, :5], M[5:, 5:], blocks)


@pytest.mark.parametrize("seed", range(8))
def test_channels_that_do_not_matter_go(seed: int) -> None:
    a = coarse(seed)
    minimal = reduce_exactly(exactly(a))
    large = exactly(padded(a, np.random.default_rng(seed), exact=True))
    found = reduce_exactly(large)
    assert found.blocks == minimal.blocks
    roundoff(at_points(found.rounded()), at_points(a), 1e4, 10.0)


# what doubles cannot decide ------------------------------------------------------------------------


def nearly(distance: Fraction) -> ExactLFT:
    """delta [1 1 ; 1 1 + e] in fractions: of rank two, but for e = 0."""
    one, zero = Fraction(1), Fraction(0)
    M = [
        [zero, zero, one, one],
        [zero, zero, one, one + distance],
        [one, zero, zero, zero],
        [zero, one, zero, zero],
    ]
    return ExactLFT(exact_matrix(M), (Block("d", 2),))


@pytest.mark.parametrize("power", [3, 17, 40, 80])
def test_nearly_dependent_channels_stay(power: int) -> None:
    distance = Fraction(1, 10**power)
    assert reduce_exactly(nearly(distance)).order == 2
    assert reduce_exactly(nearly(Fraction(0))).order == 1
    assert reduce_exactly(nearly(distance)).rounded().M11.shape == (2, 2)


def falling(count: int) -> ExactLFT:
    """A chain in which each channel is reached with a thousandth of the one before."""
    M = np.full((count + 1, count + 1), Fraction(0), dtype=object)
    M[0, count] = M[count, count - 1] = Fraction(1)
    for k in range(1, count):
        M[k, k - 1] = Fraction(1, 1000)
    return ExactLFT(exact_matrix(M), (Block("d", count),))


def test_a_chain_of_small_directions_keeps_its_length() -> None:
    """(d/1000)^11 d has degree 12; the last direction is 1e-33 of the first."""
    assert reduce_exactly(falling(12)).order == 12


# coordinates ---------------------------------------------------------------------------------------


def sheared(matrix: np.ndarray, rows: slice, random: np.random.Generator) -> np.ndarray:
    """[M11 M12 ; M21 M22] in coordinates by shears up to 1e4 of some rows, which have exact inverses."""
    size, M = rows.stop - rows.start, matrix.copy()
    for upper in (True, False, True):
        for i, j in np.ndindex(size, size):
            if i != j and (i < j) == upper:
                factor = Fraction(int(random.integers(-(10**4), 10**4)))
                M[rows.start + i] -= factor * M[rows.start + j]
                M[:, rows.start + j] += factor * M[:, rows.start + i]
    return M


@pytest.mark.parametrize("seed", range(3))
def test_far_coordinates_keep_digits(seed: int) -> None:
    """In those that are given, doubles have no digit left; signals are asked up to `_SHOWN`."""
    random, sizes = np.random.default_rng(seed), (6, 7, 5)
    M = np.vectorize(lambda x: Fraction(int(x), 16), otypes=[object])(random.integers(-9, 10, (22, 22)))
    blocks = tuple(Block(name, size) for name, size in zip("abc", sizes, strict=True))
    deltas = random.uniform(-0.3, 0.3, (3, 3))
    true = ExactLFT(exact_matrix(M.tolist()), blocks).rounded()
    for rows in consecutive(sizes):
        M = sheared(M, rows, random)
    with precision(4 * BITS):
        far = ExactLFT(exact_matrix(M.tolist()), blocks)
        near = in_good_coordinates(far, deltas, 100.0)
    expected = evaluate_at(true, deltas)
    size = np.max(np.abs(expected))
    assert np.max(np.abs(evaluate_at(near, deltas) - expected)) <= _SHOWN * ONE_ROUNDING * size


# rows that are kept --------------------------------------------------------------------------------


def spread(seed: int) -> np.ndarray:
    """A basis (12, 4) with the identity in four rows, and rows of very different sizes."""
    random = np.random.default_rng(seed)
    basis = random.standard_normal((12, 4)) * 10.0 ** random.uniform(-3, 3, (12, 1))
    rows = np.sort(random.choice(12, 4, replace=False))
    basis[rows] = np.eye(4)
    return basis


@pytest.mark.parametrize("seed", range(10))
def test_rows_that_are_kept_are_independent(seed: int) -> None:
    basis = spread(seed)
    first = np.array([int(np.flatnonzero((basis == row).all(axis=1))[0]) for row in np.eye(4)])
    rows = module._best_rows(basis, first)
    assert len(set(rows.tolist())) == 4
    factors = np.abs(basis @ np.linalg.inv(basis[rows]))
    assert np.max(factors) <= 1.01 * module._MOST_FACTOR


@pytest.mark.parametrize("seed", range(6))
def test_a_basis_over_other_rows_spans_the_same(seed: int) -> None:
    """Rows with a single one, in any order, are not solved for; one that comes twice is refused."""
    random = np.random.default_rng(seed)
    entries = random.integers(-6, 7, (11, 5))
    ones = random.permutation(5)[:seed]
    entries[:seed] = np.eye(5, dtype=int)[ones]
    basis = exact_matrix(entries.tolist())
    rows = random.permutation(5)
    made = module.over_rows(basis, rows)
    again = made @ basis[rows]
    assert np.array_equal(made.residues[rows], np.eye(5, dtype=np.int64))
    assert np.array_equal(again.residues, basis.residues)
    roundoff(rough_values(again), entries.astype(float), 1e3)
    if seed:
        with pytest.raises(ZeroDivisionError):
            module.over_rows(basis, np.array([0, 0, 5, 6, 7]))


@pytest.mark.parametrize("seed", range(4))
def test_bases_are_found_row_by_row(seed: int) -> None:
    """Their balls are those of all Krylov vectors over the pivots; some rows need each other."""
    large = exactly(padded(coarse(seed), np.random.default_rng(seed), exact=True))
    M, sizes = large.M, [block.size for block in large.blocks]
    n, blocks = sum(sizes), parts_of(sizes)
    spaces = reachable_bases(M.residues[:n, :n], M.residues[:n, n:], sizes, PRIME, is_traced=True)
    found, krylov = module._bases(M, blocks, spaces), module._krylov(M, blocks, spaces)
    for space, basis, vectors in zip(spaces, found, krylov, strict=True):
        expected = module.over_rows(vectors, np.array(space.pivots))
        assert 0 < basis.shape[1] < basis.shape[0]
        assert np.array_equal(basis.residues, expected.residues)
        roundoff(rough_values(basis), rough_values(expected), 1e3)


@pytest.mark.parametrize("seed", range(4))
def test_a_basis_in_doubles_spans_the_same(seed: int) -> None:
    """Its vectors are orthonormal, and rows that are chosen by it carry the others with small factors."""
    large = exactly(padded(coarse(seed), np.random.default_rng(seed), exact=True))
    M, sizes = large.M, [block.size for block in large.blocks]
    n, blocks = sum(sizes), parts_of(sizes)
    spaces = reachable_bases(M.residues[:n, :n], M.residues[:n, n:], sizes, PRIME, is_traced=True)
    for space, Q, basis in zip(
        spaces,
        module._orthonormal(rough_values(M)[:n], blocks, spaces),
        module._bases(M, blocks, spaces),
        strict=True,
    ):
        exact = rough_values(basis)
        roundoff(Q.T @ Q, np.eye(len(space.pivots)), 1e2)
        roundoff(Q @ (Q.T @ exact), exact, 1e4, float(np.max(np.abs(exact))))
        rows = module._pivot_rows(Q)
        assert np.max(np.abs(Q @ np.linalg.inv(Q[rows]))) <= 10.0
        there = module._in_rows(space, rows)
        assert there.pivots == rows.tolist()
        assert np.array_equal(there.basis[:, rows], np.eye(len(rows), dtype=np.int64))
        assert rank(np.vstack([there.basis, space.basis]), PRIME) == len(rows)


def test_rows_that_depend_on_others_are_passed_over() -> None:
    space = Space(4, PRIME)
    space.extend(np.array([[1, 0, 2, 0], [0, 1, 0, 3]], dtype=np.int64))
    assert sorted(module._in_rows(space, np.array([0, 2])).pivots) == [0, 1]
    assert module._in_rows(space, np.array([3, 2])).pivots == [3, 2]
    twice = module._in_rows(space, np.array([3, 3]))
    assert (twice.pivots, twice.basis.shape) == ([3, 0], (2, 4))


@pytest.mark.parametrize("seed", range(4))
def test_large_bases_are_found_over_rows_that_doubles_choose(
    seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "_MOST_BY_BALLS", 0)
    test_channels_that_do_not_matter_go(seed)


def bits_left(M: ExactMatrix) -> int:
    return min(ball.rel_accuracy_bits() for ball in M.balls[M.residues != 0])


def test_channels_that_are_chosen_first_keep_bits(monkeypatch: pytest.MonkeyPatch) -> None:
    """Channels that are nearly those before them say little: a basis over the first loses bits twice."""
    kept = []
    for most in (0, 10**6):
        monkeypatch.setattr(module, "_MOST_BY_BALLS", most)
        kept.append(bits_left(reduce_exactly(nearly_equal(12)).M))
    assert kept[0] > kept[1] + 20


def test_rows_are_solved_for_together_where_that_is_less() -> None:
    """Two rows of the same two columns and one of three are one group, a row of one column another."""
    space = Space(8, PRIME)
    space.extend(np.array([[1, 0, 0, 0, 2, 3, 4, 0], [0, 1, 0, 0, 1, 1, 0, 0], [0, 0, 1, 0, 0, 1, 0, 0],
                           [0, 0, 0, 1, 0, 0, 0, 5]], dtype=np.int64))  # fmt: skip
    basis = module._Basis(space, exact_matrix(space.basis.T.tolist()))
    assert sorted(map(len, basis.waiting)) == [1, 1, 1, 1]
    basis.merge()
    assert sorted(map(sorted, basis.waiting)) == [[4, 5, 6], [7]]
    assert basis.is_solved()
    assert np.array_equal(rough_values(basis.matrix), space.basis.T.astype(float))


def test_a_row_that_needs_a_power_of_the_matrix() -> None:
    """(1, 0, 1) and (0, 1, 2) are reached, and no column of the basis has a one only."""
    M = exact_matrix([[-1, -1, 1, 1], [0, -1, 1, 0], [1, 1, 1, 1]])
    spaces = reachable_bases(M.residues[:, :3], M.residues[:, 3:], [3], PRIME, is_traced=True)
    (found,) = module._bases(M, [slice(0, 3)], spaces)
    assert np.array_equal(rough_values(found), [[1.0, 0.0], [0.0, 1.0], [1.0, 2.0]])


def test_a_space_that_only_a_whole_one_leads_to() -> None:
    """The input moves the one channel of the first delta, and that (1, 2) of the second."""
    M = exact_matrix([[0, 1, 0, 1], [1, 0, 0, 0], [2, 0, 0, 0]])
    spaces = reachable_bases(M.residues[:, :3], M.residues[:, 3:], [1, 2], PRIME)
    (found,) = module._bases(M, [slice(0, 1), slice(1, 3)], spaces)
    assert np.array_equal(rough_values(found), [[1.0], [2.0]])


def test_rows_that_doubles_take_for_independent() -> None:
    """Row 4 is 7/10 of row 3, of size 1e25: doubles choose both, by what rounding leaves of row 4."""
    far = [Fraction(10**25), Fraction(10**25, 3)]
    krylov = exact_matrix([[1, 0], [0, 1], far, [Fraction(7, 10) * x for x in far]])
    space, scale = Space(4, PRIME), np.ones(4)
    space.extend(np.ascontiguousarray(krylov.residues.T))
    first = np.array(space.pivots)
    chosen = module._best_rows(rough_values(module.over_rows(krylov, first)), first)
    with pytest.raises(ZeroDivisionError):  # the negative control: these rows depend on each other
        module.over_rows(krylov, chosen)
    graph = module._graph(krylov, space.pivots, scale)
    assert np.array_equal(graph.basis.residues[graph.chosen], np.eye(2, dtype=np.int64))
    again = graph.basis @ krylov[graph.chosen]
    assert np.array_equal(again.residues, krylov.residues)


@given(st.integers(0, 10**6), st.integers(1, 6))
def test_spaces_grow_as_ranks_do(seed: int, size: int) -> None:
    """A basis in echelon form, and the candidates that were independent of all before."""
    random = np.random.default_rng(seed)
    space, same, rows = Space(size, PRIME), Space(size, PRIME), np.zeros((0, size), dtype=np.int64)
    for _ in range(3):
        fresh = np.asarray(random.integers(-1, 2, (3, size)) % PRIME, dtype=np.int64)
        before = rank(rows, PRIME)
        taken, new = space.take(fresh), same.extend(fresh)
        rows = np.vstack([rows, fresh])
        assert np.array_equal(same.basis, space.basis)
        assert same.pivots == space.pivots
        assert np.array_equal(fresh[space.taken[-1]], taken)
        assert len(new) == len(taken)
        assert rank(np.vstack([rows[:-3], new]), PRIME) == rank(rows, PRIME)
        assert len(space.pivots) == rank(rows, PRIME)
        assert len(taken) == rank(rows, PRIME) - before
        assert np.array_equal(space.basis[:, space.pivots], np.eye(len(space.pivots)))
        assert rank(np.vstack([space.basis, rows]), PRIME) == len(space.pivots)
