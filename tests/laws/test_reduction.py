"""Laws of reduction and of the lower bound.

1. reduction does not change values, never grows, and does nothing the second time
2. a similarity transformation and padding with useless channels are taken back completely
3. lower bound <= order of every LFT of the same matrix; equal for generic minimal LFTs
4. the scale of channels, of inputs and outputs, and of parameters does not change a rank
"""

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mbdlft.lft.lft import LFT, Block, delta
from mbdlft.lft.sampling import evaluate
from mbdlft.order.reduction import reduce_order
from tests.close import exact, roundoff
from tests.extracted import lower_bound
from tests.laws.lfts import lfts, padded, points

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
