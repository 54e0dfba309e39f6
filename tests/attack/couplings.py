"""Random mechanisms with coupled joints against their equations in maximal coordinates, in 150 digits.

`tests/cross/coupled_mechanisms.py` couples coordinates of `mixed` ones by gears, planetary gears,
differentials, belts, racks, screws, cables and mimics, rigid or not; their forces are outputs.
"""

from pathlib import Path

from tests.attack.mechanisms import answer
from tests.cross.coupled_mechanisms import coupled


def attack(seed: int, folder: Path) -> str:
    """Build a model and compare it where the truth is known: at nominal, inside, and at a corner."""
    return answer(coupled(seed), seed)
