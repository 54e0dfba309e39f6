"""Motions of any size of random scenes, which for small ones are those of their linear models.

Vehicles that roll, spinning wheels, mechanisms with loops and couplings, trees: those of other attacks.
"""

from collections.abc import Callable
from pathlib import Path

import mbdlft
from mbdlft import MbdlftError, Scene
from tests.cross.coupled_mechanisms import coupled
from tests.cross.mechanisms import closed_loop, open_tree
from tests.cross.mixed_mechanisms import mixed
from tests.cross.rolling_mechanisms import rolling
from tests.cross.steady_mechanisms import spinning
from tests.motions import check_second_order

_KINDS: tuple[Callable[[int], Scene], ...] = (rolling, spinning, coupled, mixed, closed_loop, open_tree)


def attack(seed: int, folder: Path) -> str:
    """Build a model and compare its rates with those of the nonlinear equations."""
    scene = _KINDS[seed % len(_KINDS)](seed)
    try:
        model = mbdlft.to_lft(scene, search=0.0, prove=0.0)
    except MbdlftError as error:  # other attacks ask why
        return f"refused: {error}"
    check_second_order(scene, model, seed)
    return "right"
