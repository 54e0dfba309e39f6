"""What leads where in a graph."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


def in_reach(leads: "NDArray[np.bool_]", start: "NDArray[np.bool_]") -> "NDArray[np.bool_]":
    """Those (n,) at the start, and all to which they lead: i from j where leads[i, j]."""
    fresh = reached = start
    while fresh.any():
        fresh = leads[:, fresh].any(axis=1) & ~reached
        reached = reached | fresh
    return reached
