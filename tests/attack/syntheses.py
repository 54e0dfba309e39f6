"""Random plants with a controller of full order: at constant values no loop is above its gamma.

With none of the parameters, one or two of them measured; a proof for any motion of them is asked for.
Without a measured one, each plant has a controller.
"""

from pathlib import Path

import numpy as np

import mbdlft
from mbdlft import synthesis
from mbdlft.base.errors import AnalysisError
from tests.attack.tunings import ROUNDED, task
from tests.tuned import loop

POINTS = 12


def attack(seed: int, folder: Path) -> str:
    """One plant."""
    (system, old), goals, wired, _, plant, _, random = task(seed)
    names = [p.name for p in system.parameters]
    count = min(seed % 3, len(names))
    law = synthesis.tunable_gain("K", *old.channels)
    try:
        made = synthesis.lpv_synthesis([system, law], goals, wired, measured=names[:count], prove=False)
    except AnalysisError:
        assert count, "no controller at nominal"
        return "refused"
    values = plant.points(random, POINTS)
    values[:, count:] = 1.0
    K = made.tuning.controllers[0]
    at = mbdlft.matrices_at(K, dict(zip(names[:count], values.T[:count], strict=True)))
    gains = np.block([[at.A, at.B], [at.C, at.D]])
    found = loop(plant, len(K.states), values).largest_gain(gains)
    assert found <= ROUNDED * made.gamma, (found, made.gamma)
    return "proved" if np.isfinite(made.motion.upper) else "open"
