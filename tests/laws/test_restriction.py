"""Laws of blocks restricted in exact numbers.

1. residues of the value stay, at random residues of the deltas, for each block and on both sides
2. the orders are those of the same step in doubles, where these keep their digits
3. a result of a search that has lost digits is made again in exact numbers
"""

from pathlib import Path

import numpy as np
import pytest

from mbdlft import load_scene, to_lft
from mbdlft.exact.numbers import BITS, precision
from mbdlft.lft.lft import LFT
from mbdlft.lft.sampling import evaluate
from mbdlft.order.lower_bound import at_random
from mbdlft.order.reduction import ExactLFT, reduce_exactly, reduce_order
from mbdlft.order.restriction import restricted_exactly
from mbdlft.order.rewriting import restrictions
from mbdlft.order.work import Work
from tests.close import SCENARIO, roundoff
from tests.extracted import exactly
from tests.laws.test_search import case

ROOT = Path(__file__).parents[2]


@pytest.fixture(autouse=True)
def with_bits() -> object:
    with precision(BITS):
        yield


def residues_of(a: ExactLFT) -> np.ndarray:
    """The value at random residues, which follow the order of the blocks."""
    n = a.order
    return at_random(a)[n:, n:]


def law_restricted(a: LFT) -> None:
    whole, restricted = reduce_exactly(exactly(a)), 0
    points = {name: np.linspace(-0.3, 0.4, 7) for name, _ in a.blocks}
    expected = evaluate(a, points)
    of_doubles = {
        made[1:]: dict(made.lft.blocks) for made in restrictions(a, [b.name for b in a.blocks], Work())
    }
    for name, size in whole.blocks:
        for side in (False, True):
            small = restricted_exactly(whole, name, is_transposed=side)
            if small is None:
                continue
            restricted += 1
            assert [b.name for b in small.blocks] == [b.name for b in whole.blocks]
            assert np.array_equal(residues_of(small), residues_of(whole))
            assert dict(small.blocks)[name] <= size
            roundoff(evaluate(small.rounded(), points), expected, 1e6, float(np.max(np.abs(expected))))
            if (name, side) in of_doubles:
                assert small.order >= sum(of_doubles[name, side].values())
    assert restricted


@pytest.mark.parametrize("name", ["O1", "O3", "O13"])
def test_blocks_of_matrices(name: str) -> None:
    law_restricted(reduce_order(case(name)))


def test_a_result_that_has_lost_digits_is_made_again() -> None:
    """Voltages of patches stand in bending and in tension: 53 repetitions, 47 with a block restricted.

    In doubles an entry of these 47 differs by hundreds of roundings.
    """
    model = to_lft(load_scene(ROOT / "scenarios" / "piezo_beam.toml"))
    assert model.order == 47
    assert model.certificate.max_relative_error < SCENARIO
