"""Random mechanisms as sparse models: right where the truth is known, with the bounds of dense ones."""

from pathlib import Path
from unittest.mock import patch

from mbdlft import to_lft
from tests.attack.mechanisms import answer
from tests.cross.mixed_mechanisms import mixed


def attack(seed: int, folder: Path) -> str:
    """As of the class of mechanisms, for LFTs of any order."""
    scene, most = mixed(seed), 5000 * (seed % 2)  # items: with more, sums of words stay
    in_sums = patch("mbdlft.pipeline.extract.noncommuting._MANY", most)
    with in_sums, patch("mbdlft.pipeline.forms._MOST_EXACT", 0):
        word = answer(scene, seed)
        if word == "refused":
            return word
        sparse = to_lft(scene, search=0.0, prove=0.0).certificate
    dense = to_lft(scene, search=0.0, prove=0.0).certificate
    assert sparse.lower_bound == dense.lower_bound
    assert sparse.accelerations == dense.accelerations
    assert sparse.momenta == dense.momenta
    assert sparse.rigid_motions == dense.rigid_motions
    return word
