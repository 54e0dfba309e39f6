"""Ascent of a function of the deltas in a box: corners to which its slope points, then within the box."""

from collections.abc import Callable

import numpy as np

from mbdlft.base.array import Array

_STEPS = 40
Look = Callable[[Array], tuple[float, Callable[[], Array]]]


def climb(look: Look, k: float, start: Array) -> None:
    """Look at points of the box |delta| <= k where a function is larger and larger.

    Parameters
    ----------
    look : function of deltas (number of deltas,)
        Its value, of the size of 1, and a function without arguments for its slope there. It keeps what
        is the best; an infinite value ends the ascent.
    k : float
    start : array (number of deltas,)
    """
    from scipy.optimize import minimize  # here because it is slow to import

    here, (value, slope) = start, look(start)
    for _ in range(_STEPS):  # corners to which the slope points
        if not np.isfinite(value):
            return
        corner = k * np.sign(slope())
        if np.array_equal(corner, here):
            return
        there, its_slope = look(corner)
        if there <= value:
            break
        here, value, slope = corner, there, its_slope
    if not np.isfinite(value):
        return

    def objective(delta: Array) -> tuple[float, Array]:
        found, its_slope = look(delta)
        if not np.isfinite(found):
            return -1e30, np.zeros(len(delta))
        return -found, -its_slope()

    box, options = [(-k, k)] * len(start), {"maxiter": _STEPS}
    minimize(objective, here, jac=True, bounds=box, method="L-BFGS-B", options=options)
