"""Laws of channels with independent functions of the deltas.

1. the value stays, and the functions of the channels are independent afterwards
2. words of commuting factors that are written in different orders are one
3. what is independent comes back as it is
4. scenes that n-D reduction and the search leave larger
"""

from itertools import permutations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import mbdlft
from mbdlft.lft.lft import LFT, constant, delta, inverse, stack_columns, stack_rows, transpose
from mbdlft.lft.sampling import evaluate_at
from mbdlft.order.circles import independent
from mbdlft.order.reduction import reduce_order
from mbdlft.order.work import Work
from mbdlft.pipeline.models import build
from tests.close import SCENARIO, roundoff, target
from tests.strategies import random_scene

KAPPA = 1e3


def word(names: tuple[str, ...]) -> LFT:
    product = constant([[1.0]])
    for name in names:
        product = product @ delta(name)
    return product


def shuffled(seed: int, *, poles: bool) -> LFT:
    """Two rows of three entries; each word stands in two entries in two orders of its factors."""
    random = np.random.default_rng(seed)
    total = constant(random.standard_normal((2, 3)))
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
    return reduce_order(total)


def rank_of_functions(a: LFT) -> int:
    """Dimension of the span of 1 and Y Delta at real points, from the definition."""
    rows = []
    for point in np.random.default_rng(5).uniform(-1.0, 1.0, (a.order + 10, len(a.blocks))):
        deltas = np.diag(np.repeat(point, [block.size for block in a.blocks]))
        Y = a.M21 @ np.linalg.inv(np.eye(a.order) - deltas @ a.M11)
        rows.append(np.hstack([np.eye(a.shape[0]), Y @ deltas]))
    return int(np.linalg.matrix_rank(np.vstack(rows), tol=1e-9))


def law(a: LFT) -> LFT:
    found = independent(a, Work())
    points = np.random.default_rng(4).uniform(-0.9, 0.9, (20, len(a.blocks)))
    roundoff(evaluate_at(found, points), evaluate_at(a, points), KAPPA)
    for side in (found, transpose(found)):
        assert rank_of_functions(side) == side.order + side.shape[0]
    return found


@given(st.integers(0, 10_000), st.booleans())
def test_value_stays_and_functions_are_independent(seed: int, poles: bool) -> None:
    a = shuffled(seed, poles=poles)
    found = law(a)
    assert found.order <= a.order
    assert [name for name, _ in found.blocks] == [name for name, _ in a.blocks]


def test_orders_of_factors() -> None:
    """[a b, b a] has four channels as words, and two as functions."""
    a = reduce_order(stack_columns(word(("a", "b")), word(("b", "a"))))
    assert (a.order, law(a).order) == (4, 2)
    assert law(transpose(a)).order == 2


def test_it_is_needed() -> None:
    """The law of independence is not true of what n-D reduction leaves."""
    a = reduce_order(stack_columns(word(("a", "b")), word(("b", "a"))))
    assert rank_of_functions(a) < a.order + a.shape[0]


@pytest.mark.parametrize("a", [constant([[1.0, 2.0]]), delta("a"), word(("a", "b"))])
def test_independent_comes_back(a: LFT) -> None:
    assert independent(a, Work()) is a


def test_units_do_not_matter() -> None:
    """Outputs in micrometres beside outputs in tons."""
    a = reduce_order(stack_columns(word(("a", "b")), word(("b", "a"))))
    b = reduce_order(stack_rows(1e6 * np.eye(1) @ a, 1e-6 * np.eye(1) @ a))
    found = law(b)
    assert (b.order, found.order) == (4, 2)
    values, expected = (evaluate_at(one, np.array([[0.3, -0.7]])) for one in (found, b))
    roundoff(values[:, 1], expected[:, 1], KAPPA)


def test_scene() -> None:
    """What n-D reduction and opening the blocks with bases leave, on every CPU."""
    scene = random_scene(4)
    plain = build(scene, 0.0).model.lft
    found = same_values(plain)
    assert (plain.order, found.order) == (10, 8)
    assert sum(mbdlft.to_lft(scene, search=1.0).certificate.order) <= 8


def test_large_scene() -> None:
    """N-D reduction leaves 62 to 72, as the kernels of the CPU round; never more come back."""
    plain = build(random_scene(14), 0.0).model.lft
    assert same_values(plain).order <= plain.order


def same_values(plain: LFT) -> LFT:
    found = independent(plain, Work())
    points = np.random.default_rng(6).uniform(-1.0, 1.0, (50, len(plain.blocks)))
    target(evaluate_at(found, points), evaluate_at(plain, points), SCENARIO)
    return found
