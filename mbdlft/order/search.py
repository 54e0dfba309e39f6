"""What the search for a smaller LFT of the same value may cost, and what it leads to.

n-D reduction takes a product of deltas as a noncommutative monomial. Deltas commute, and steps in exact
numbers use it (`mbdlft.pipeline.smaller`). Pairs and triples of deltas (`mbdlft.order.joint_bound`) show
how small the order can be: then the search is over.
"""

from collections.abc import Iterable
from typing import NamedTuple

from mbdlft.base.errors import SceneError
from mbdlft.lft.lft import LFT

SEARCH = 2.0  # units of work; a small part of it is enough where the order meets the bound at once
CUT_OFF = "search was cut off"  # a stage that tells so
DROPPED = "search: a result was dropped"  # one, too: what is there before it stands


class Budget(NamedTuple):
    """What a search may cost: units of work, which decide its result, and at most so many seconds."""

    work: float
    seconds: float | None = None


class Smallest(NamedTuple):
    """The smallest LFTs of a value that are found, the smallest first, the least order of any, and
    whether seconds ended the search early."""

    lfts: Iterable[LFT]
    order_bound: int
    is_cut_off: bool = False


def budget_of(search: float, seconds: float | None = None) -> Budget:
    """The budget of a search; a SceneError if one of the two is not a size."""
    if not isinstance(search, int | float) or not search >= 0.0:
        raise SceneError(f"search: expected units of work, 0 for no search, got {search!r}.")
    if seconds is not None and (not isinstance(seconds, int | float) or not seconds >= 0.0):
        raise SceneError(f"seconds: expected a time (s), or None for no limit, got {seconds!r}.")
    return Budget(search, seconds)
