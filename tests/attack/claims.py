"""Analyses of which one field is changed: refused, or what they claim is true. 100 changes for a seed."""

from pathlib import Path

import numpy as np

import mbdlft
from mbdlft import MbdlftError
from tests.claims import KINDS, analysis, changed, forged, is_true

DRAWS = 100


def attack(seed: int, folder: Path) -> str:
    """Change the analysis of one kind, a hundred times; store and load it before each tenth check."""
    kind, random = KINDS[seed % len(KINDS)], np.random.default_rng(seed)
    system, bounds = analysis(kind)
    accepted = 0
    for count in range(DRAWS):
        other, what = changed(bounds, random)
        try:
            if count % 10 == 0:
                mbdlft.save_analysis(folder / f"{count}.h5", system, other, "changed")
                system, other = mbdlft.load_analysis(folder / f"{count}.h5")
            wrong = mbdlft.verify(system, other)
        except MbdlftError:
            continue
        if not wrong:
            accepted += 1
            assert is_true(system, other, bounds), f"{what}: {other.claim}"
    for what, other in forged(bounds):
        try:
            assert mbdlft.verify(system, other), what
        except MbdlftError:
            continue
    return "some accepted, all true" if accepted else "all refused"
