"""Closed loops that pass a position where branches of their motion meet are never called proved."""

import pytest

from tests.attack.loops import FAMILIES, attack
from tests.seeds import some

# families go round: even seeds have a flat position in the range, odd ones do not
SOME, MANY = (1, 3, 4, 9, 11, 60), range(4 * len(FAMILIES))


@pytest.mark.parametrize("seed", some(SOME, MANY))
def test_flat_positions_in_the_range(seed: int) -> None:
    word = attack(seed)
    assert word.startswith("flat") if seed % 2 == 0 else word == "regular, proved"
