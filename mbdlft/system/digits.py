"""Values of an LFT in twice the working precision, where solving in doubles loses digits.

Channels of elastic bodies with their lengths as parameters have entries of many sizes. In doubles, values
of such an LFT have errors that are far above what rounding of M11, M12, M21 and M22 makes: accelerations
at low frequencies, which are differences of D and C (s I - A)^-1 B, then lose their digits. One step of
refinement in doubles tells how large these errors are, as its own errors are of their size; where they
matter, (I - M11 Delta)^-1 M12 is solved for again with residuals of twice the precision.
"""

import numpy as np

from mbdlft.base.array import Array
from mbdlft.exact import rounding
from mbdlft.exact.rounding import equilibrate
from mbdlft.lft.lft import LFT

LOST = 2.0**-40  # of the size of an entry: an error that is worth the work
_NEGLIGIBLE = (
    1e-6  # of what its row and column give an entry: the least that its error is relative to
)
_MOST = (
    5e8  # operations of the solutions of all points, about a second: more points stay in doubles
)


def with_digits(a: LFT, points: Array, values: Array) -> Array:
    """Values (N, n_out, n_in) at points (N, number of blocks), better ones where digits are lost.

    `values` are those in doubles. What is lost is seen at the points that are farthest from zero.
    """
    if not needs_digits(a, points, values):
        return values
    spread = np.repeat(points, [block.size for block in a.blocks], axis=1)
    return np.array([_in_twice(a, deltas) for deltas in spread])


def needs_digits(a: LFT, points: Array, values: Array) -> bool:
    """Whether values in doubles lose digits that are worth their work."""
    if not a.order or a.is_complex or not len(points) or len(points) * a.order**3 > _MOST:
        return False
    far = {int(np.argmax(size)) for size in (np.max(np.abs(points), 1), np.sum(np.abs(points), 1))}
    spread = np.repeat(points, [block.size for block in a.blocks], axis=1)
    return any(lost(a, spread[k], values[k]) > LOST for k in far)


def lost(a: LFT, deltas: Array, value: Array) -> float:
    """About the largest error of a value (n_out, n_in) at deltas (order,), relative to its entries."""
    loop = np.eye(a.order) - a.M11 * deltas
    solved = np.linalg.solve(loop, a.M12)
    rest = a.M12 - (solved - a.M11 @ (deltas[:, None] * solved))
    change = np.abs((a.M21 * deltas) @ np.linalg.solve(loop, rest))
    rows, columns = equilibrate(value[None])
    size = np.maximum(np.abs(value), _NEGLIGIBLE / np.outer(rows, columns))
    return float(np.max(change / size, initial=0.0))


def _in_twice(a: LFT, deltas: Array) -> Array:
    """The value at deltas (order,), rounded once."""
    solved = rounding.solve_twofold(np.eye(a.order) - a.M11 * deltas, a.M12)
    return rounding.multiply_add(a.M22, a.M21 * deltas, solved)
