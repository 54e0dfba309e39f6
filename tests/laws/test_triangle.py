"""Values, signs and vanishing determinants by the loops of an LFT are those of the whole matrix.

1. diagonal blocks: each channel once, and nothing is read from a block that comes later
2. values are those of the dense definition, and signs those of det(I - M11 Delta)
3. the determinant vanishes on a line exactly if an eigenvalue of M11 Delta is real and at least 1
"""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mbdlft.lft import sampling
from mbdlft.lft.lft import LFT, Block
from mbdlft.lft.sampling import evaluate_at
from mbdlft.order.circles import pole_distance
from tests.close import exact, roundoff
from tests.laws.lfts import lfts

seeds = st.integers(0, 1000)
KAPPA = 1e6  # condition of the loops below at the points that are compared


def deltas(a: LFT, count: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-1.0, 1.0, (count, len(a.blocks)))


def chained(loops: tuple[int, ...], seed: int, shape: tuple[int, int] = (3, 2)) -> LFT:
    """Loops of such sizes that read from one or two earlier ones, with their channels shuffled."""
    random = np.random.default_rng(seed)
    n = sum(loops)
    M11, end = np.zeros((n, n)), 0
    for size in loops:
        part = slice(end, end + size)
        M11[part, part] = random.standard_normal((size, size)) / (size + 1.0)
        for source in random.integers(0, end, min(end, 2)):
            M11[end + random.integers(size), source] = random.standard_normal()
        end += size
    order = random.permutation(n)
    cut = n // 3
    return LFT(
        M11[np.ix_(order, order)],
        random.standard_normal((n, shape[1])),
        random.standard_normal((shape[0], n)),
        random.standard_normal(shape),
        (Block("a", cut), Block("b", n - cut)),
    )


# small ones are one block; those of the last two have blocks that are factored point by point
LOOPS = [(1,), (3, 1, 2), (1,) * 100, (2, 3) * 30, (70, 1, 1, 20, 5, 90), (1, 1, 120) + (2,) * 40]


def law_blocks(matrix: np.ndarray) -> int:
    """The number of blocks."""
    blocks = sampling.diagonal_blocks(matrix)
    exact(np.sort(np.concatenate(blocks)), np.arange(len(matrix)))
    for k, block in enumerate(blocks):
        for later in blocks[k + 1 :]:
            assert not matrix[np.ix_(block, later)].any()
    return len(blocks)


def law_values(a: LFT, at: np.ndarray) -> None:
    values, signs = sampling.values_at(a, at)
    spread = np.repeat(at, [block.size for block in a.blocks], axis=1)
    exact(signs, [np.linalg.slogdet(np.eye(a.order) - a.M11 * row)[0] for row in spread])
    roundoff(values, evaluate_at(a, at), KAPPA)


def law_vanishing(a: LFT, at: np.ndarray) -> np.ndarray:
    """Every line is searched: at most 32 points, small blocks."""
    found = sampling.vanishes(a, at)
    spread = np.repeat(at, [block.size for block in a.blocks], axis=1)
    poles = [np.linalg.eigvals(a.M11 * row) for row in spread]
    exact(found, [bool(np.any((s.imag == 0.0) & (s.real >= 1.0))) for s in poles])
    return found


@pytest.mark.parametrize("loops", LOOPS)
@pytest.mark.parametrize("shape", [(3, 2), (2, 3)])
def test_chained_loops(loops: tuple[int, ...], shape: tuple[int, int]) -> None:
    a = chained(loops, 1, shape)
    assert (law_blocks(a.M11) > 1) == (a.order > 48)
    law_values(a, deltas(a, 7))
    law_vanishing(a, 3.0 * deltas(a, 7))


def test_signs_far_from_nominal() -> None:
    """Where rows are exchanged in the factorization, and each exchange changes the sign."""
    a = chained((70,), 2)
    at = 20.0 * deltas(a, 12)
    spread = np.repeat(at, [block.size for block in a.blocks], axis=1)
    expected = [np.linalg.slogdet(np.eye(a.order) - a.M11 * row)[0] for row in spread]
    assert set(expected) == {-1.0, 1.0}
    exact(sampling.values_at(a, at)[1], expected)


@given(lfts(2, 3), seeds)
def test_small_lfts(a: LFT, seed: int) -> None:
    law_values(a, deltas(a, 3, seed))


def test_an_lft_without_channels() -> None:
    a = LFT(np.zeros((0, 0)), np.zeros((0, 2)), np.zeros((1, 0)), np.ones((1, 2)))
    values, signs = sampling.values_at(a, np.zeros((3, 0)))
    exact(values, np.ones((3, 1, 2)))
    exact(signs, np.ones(3))
    assert not sampling.vanishes(a, np.zeros((3, 0))).any()


@pytest.mark.parametrize("size", [1, 70])
def test_a_singular_point_has_the_sign_zero(size: int) -> None:
    a = LFT(np.eye(size), np.ones((size, 1)), np.ones((1, size)), np.zeros((1, 1)), (Block("a", size),))
    _, signs = sampling.values_at(a, np.array([[0.5], [1.0], [2.0]]))
    exact(signs, [1.0, 0.0, (-1.0) ** size])
    exact(sampling.vanishes(a, np.array([[0.5], [1.0], [2.0], [-2.0]])), [False, True, True, False])


def test_a_double_root_does_not_change_the_sign() -> None:
    """det = (1 - d/2)^2 + e^2: touches zero at d = 2 for e = 0 only."""
    for gap, expected in ((0.0, True), (0.1, False)):
        M11 = np.array([[0.5, gap], [-gap, 0.5]])
        a = LFT(M11, np.ones((2, 1)), np.ones((1, 2)), np.zeros((1, 1)), (Block("a", 2),))
        exact(sampling.values_at(a, np.array([[3.0]]))[1], [1.0])
        exact(sampling.vanishes(a, np.array([[3.0]])), [expected])


def test_eigenvalues_that_are_not_found_show_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """No line is seen to vanish, and a pole is not nearer than the norm allows."""

    def failing(matrix: np.ndarray) -> np.ndarray:
        raise np.linalg.LinAlgError

    monkeypatch.setattr(np.linalg, "eigvals", failing)
    a = LFT(np.eye(1), np.ones((1, 1)), np.ones((1, 1)), np.zeros((1, 1)), (Block("a", 1),))
    assert not sampling.vanishes(a, np.array([[2.0]])).any()
    exact(pole_distance(np.array([[0.0, 4.0], [0.0, 0.0]]), 10.0), 0.25)
