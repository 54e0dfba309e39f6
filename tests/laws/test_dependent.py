"""Laws of channels with independent functions of the deltas, in exact numbers."""

from collections.abc import Iterator
from itertools import permutations
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from benchmarks.cases.chains import chain
from mbdlft import load_scene, to_lft
from mbdlft.exact.numbers import BITS, precision
from mbdlft.lft.lft import LFT, constant, delta, inverse, stack_columns, stack_rows
from mbdlft.lft.sampling import evaluate_at
from mbdlft.multibody.to_problem import problem_of_scene
from mbdlft.order.dependent import without_dependent
from mbdlft.order.lower_bound import at_random
from mbdlft.order.reduction import ExactLFT, in_scales, reduce_exactly, transposed
from mbdlft.pipeline.forms import candidates
from mbdlft.pipeline.smaller import without_dependent_channels
from tests.close import roundoff
from tests.extracted import exactly
from tests.laws.test_weights import forces_turned_on_the_way

SCENARIOS = Path(__file__).parents[2] / "scenarios"


@pytest.fixture(autouse=True)
def in_balls() -> Iterator[None]:
    with precision(BITS):
        yield


def word(names: tuple[str, ...]) -> LFT:
    product = constant([[1.0]])
    for name in names:
        product = product @ delta(name)
    return product


def shuffled(seed: int, *, poles: bool) -> LFT:
    """Two rows of three entries; each word stands in two entries in two orders of its factors."""
    random = np.random.default_rng(seed)
    total = constant(random.integers(-3, 4, (2, 3)))
    for _ in range(4):
        names = tuple(random.choice(["a", "b", "c"], size=int(random.integers(2, 4))))
        orders = list(permutations(names))
        for _ in range(2):
            left, right = random.integers(-2, 3, (2, 1)), random.integers(-2, 3, (1, 3))
            total = total + left @ word(orders[random.integers(len(orders))]) @ right
    if poles:
        total = stack_rows(total, total) @ stack_rows(
            inverse(constant([[2.0]]) + word(("a", "b"))), [[1.0]], word(("b", "a"))
        )
    return total


def rank_of_functions(a: LFT) -> int:
    """Dimension of the span of Y Delta at real points, from the definition."""
    rows = []
    for point in np.random.default_rng(5).uniform(-1.0, 1.0, (a.order + 9, len(a.blocks))):
        deltas = np.diag(np.repeat(point, [block.size for block in a.blocks]))
        Y = a.M21 @ np.linalg.inv(np.eye(a.order) - deltas @ a.M11)
        rows.append(Y @ deltas)
    return int(np.linalg.matrix_rank(np.vstack(rows), tol=1e-9))


def law(a: LFT) -> ExactLFT:
    whole = reduce_exactly(exactly(a))
    small = without_dependent(whole)
    assert [name for name, _ in small.blocks] == [name for name, _ in whole.blocks]
    assert np.array_equal(
        at_random(small)[small.order :, small.order :], at_random(whole)[whole.order :, whole.order :]
    )
    points = np.random.default_rng(4).uniform(-0.9, 0.9, (20, len(whole.blocks)))
    roundoff(evaluate_at(small.rounded(), points), evaluate_at(whole.rounded(), points), 1e4)
    for side in (small, transposed(small)):
        rounded = in_scales(side.rounded())
        assert rank_of_functions(rounded) == rounded.order
    return small


@given(st.integers(0, 10_000), st.booleans())
def test_value_stays_and_functions_are_independent(seed: int, poles: bool) -> None:
    a = shuffled(seed, poles=poles)
    assert law(a).order <= a.order


@pytest.mark.parametrize("seed", [1, 5, 9, 10])
@pytest.mark.parametrize("poles", [False, True])
def test_blocks_take_those_before_them(seed: int, poles: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """As those of many channels do."""
    monkeypatch.setattr("mbdlft.lft.determinant._MERGED", 1)
    a = shuffled(seed, poles=poles)
    assert law(a).order < reduce_exactly(exactly(a)).order


def test_orders_of_factors() -> None:
    """[a b, b a] has four channels as words, and two as functions, also of its transpose."""
    for stack in (stack_columns, stack_rows):
        a = stack(word(("a", "b")), word(("b", "a")))
        assert (reduce_exactly(exactly(a)).order, law(a).order) == (4, 2)


def test_small_numbers_divide_nothing() -> None:
    """Of [a b, b a], channels of a with the functions a and a + 2^30 b a: a would lose 30 bits."""
    words = stack_columns(word(("a", "b")), word(("b", "a")))
    T = np.eye(4)
    T[:2, :2] = [[1.0, 1.0], [0.0, 2.0**30]]
    inverse_of_T = np.linalg.inv(T)
    a = LFT(
        inverse_of_T @ words.M11 @ T, inverse_of_T @ words.M12, words.M21 @ T, words.M22, words.blocks
    )
    small = without_dependent(ExactLFT(exactly(a).M, a.blocks))
    assert small.order == 2
    points = np.random.default_rng(4).uniform(-0.9, 0.9, (20, 2))
    roundoff(evaluate_at(small.rounded(), points), evaluate_at(words, points), 1e3)


@pytest.mark.parametrize("a", [constant([[1.0, 2.0]]), delta("a"), word(("a", "b"))])
def test_what_is_independent_comes_back(a: LFT) -> None:
    whole = reduce_exactly(exactly(a))
    assert without_dependent(whole) is whole


def test_a_row_that_never_varies_is_no_reason_for_more() -> None:
    """Outputs that are constant show nothing at any number of points."""
    varies = stack_columns(word(("a", "b")) + word(("a",)), word(("b", "a", "a")))
    a = stack_rows(*(constant([[1.0, 2.0]]) for _ in range(6)), varies)
    assert law(a).order == law(varies).order


@pytest.mark.parametrize(("name", "order"), [("double_pendulum_hanging", 9), ("spinning_satellite", 28)])
def test_scenes_without_a_search(name: str, order: int) -> None:
    """N-D reduction alone leaves 13 and 41 repetitions."""
    assert to_lft(load_scene(SCENARIOS / f"{name}.toml"), search=0.0).order == order


def test_searches_of_many_channels_begin_without_dependent_ones(monkeypatch: pytest.MonkeyPatch) -> None:
    """They had more repetitions than without a search."""
    monkeypatch.setattr("mbdlft.pipeline.stages._MOST_RESTRICTED", 0)
    assert to_lft(load_scene(SCENARIOS / "double_pendulum_hanging.toml"), search=1e-6).order == 9


def test_more_work_proves_more_of_many_channels(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pairs that need two more repetitions together; 62 by default."""
    monkeypatch.setattr("mbdlft.pipeline.stages._MOST_RESTRICTED", 0)
    bicycle = load_scene(SCENARIOS / "whipple_bicycle.toml")
    assert to_lft(bicycle, search=4.0).certificate.order_bound == 63


def test_what_becomes_singular_is_not_used() -> None:
    """Of a chain of links, repetitions could be left out but for a determinant that vanishes."""
    scene = chain(3, spatial=False)
    with forces_turned_on_the_way():
        problem = problem_of_scene(scene)
        (candidate,) = candidates(problem, problem.forms[:1])
        assert isinstance(candidate.exact, ExactLFT)
        assert without_dependent(candidate.exact).order < candidate.lft.order
        assert without_dependent_channels(problem, candidate, 0) is None
        assert to_lft(scene, search=0.0).order == candidate.lft.order
