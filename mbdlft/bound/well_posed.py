"""Proof that I - M11 Delta is invertible on the whole box |delta_k| <= 1, deltas real and constant.

Where no channel acts on itself in the end, the determinant is one. Otherwise multipliers X, one matrix
for each block, prove it as in `gain.py`: the symmetric part of (z - w)'X (z + w) is not negative for
w = Delta z, so z = M11 w with w not zero is impossible where it is negative. X is found by a barrier
method, and checked with a margin for rounding. A box that resists is cut.
"""

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from mbdlft.base.errors import WellPosednessError
from mbdlft.bound.gain import multipliers, restrict
from mbdlft.lft.lft import LFT

_MOST_ENTRIES = 400  # of X: their number to the third power is what a step costs
_BOXES = 16


def is_well_posed(a: LFT, boxes: int = _BOXES) -> bool:
    """Whether it is proved; False says that it was not, by at most so many boxes."""
    if not a.is_plain or a.is_complex:
        return False
    if _acts_on_nothing_twice(a):
        return True
    if sum(block.size**2 for block in a.blocks) > _MOST_ENTRIES:
        return False
    waiting = [_inner(a)]
    for _ in range(boxes):
        if not waiting:
            return True
        box = waiting.pop()
        found = multipliers(box)
        if found.is_proved:
            continue
        worst = int(np.argmax(found.slope))
        if found.slope[worst] <= 0.0:
            return False
        for side in (-0.5, 0.5):
            center, half = np.zeros(len(a.blocks)), np.ones(len(a.blocks))
            center[worst], half[worst] = side, 0.5
            try:
                waiting.append(restrict(box, center, half))
            except WellPosednessError:
                return False
    return not waiting


def _acts_on_nothing_twice(a: LFT) -> bool:
    """Whether no channel reaches itself: each strong component of M11 is one channel without a loop."""
    if np.any(np.diagonal(a.M11)):
        return False
    count, _ = connected_components(csr_array(a.M11 != 0.0), connection="strong")
    return bool(count == a.order)


def _inner(a: LFT) -> LFT:
    n = a.order
    return LFT(a.M11, np.zeros((n, 0)), np.zeros((0, n)), np.zeros((0, 0)), a.blocks)
