"""Random vehicles that roll against their equations in maximal coordinates, in 150 digits.

`tests/cross/rolling_mechanisms.py` draws frames on wheels, balls and knife edges, with forks that steer
and a load that swings, at rest and at a speed. The truth knows where wheels touch for any pose, and takes
derivatives by differences; multipliers are those of Lagrange and d'Alembert.
"""

from pathlib import Path

from tests.attack.mechanisms import answer
from tests.cross.rolling_mechanisms import rolling


def attack(seed: int, folder: Path) -> str:
    """Build a model and compare it where the truth is known: at nominal, inside, and at a corner."""
    return answer(rolling(seed), seed)
