"""The search for a smaller LFT of the same value, and for a better lower bound on its order."""

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

from mbdlft.base.errors import SceneError
from mbdlft.bound.pairs import joint_bound
from mbdlft.lft.lft import LFT
from mbdlft.reduce.commuting import LARGE, reduce_commuting
from mbdlft.reduce.independent import independent
from mbdlft.reduce.same_value import Truth, is_same, part_of_either

SEARCH = 4.0  # units of work; a small part of it is enough where the order meets the bound at once
_HALF, _MOST = 0.5, 0.8  # of the budget for the relations; the rest is for the closed LFT


class Budget(NamedTuple):
    """What a search may cost.

    Attributes
    ----------
    work : float
        Units of work; one is about what one core does in a second. The result of a search depends on
        this number alone, not on the machine and its load.
    seconds : float, optional
        Upper limit of the time (s); a search that it cuts off says so.
    """

    work: float
    seconds: float | None = None


class Smallest(NamedTuple):
    """The smallest LFT that was found, and the least order that any LFT of the same value can have.

    `is_cut_off` says whether the limit in seconds ended the search before its work was done.
    """

    lft: LFT
    order_bound: int
    is_cut_off: bool = False


def budget_of(search: float, seconds: float | None = None) -> Budget:
    """The budget of a search.

    Raises
    ------
    SceneError
        One of the two is not a size.
    """
    if not isinstance(search, int | float) or not search >= 0.0:
        raise SceneError(f"search: expected units of work, 0 for no search, got {search!r}.")
    if seconds is not None and (not isinstance(seconds, int | float) or not seconds >= 0.0):
        raise SceneError(f"seconds: expected a time (s), or None for no limit, got {seconds!r}.")
    return Budget(search, seconds)


def find_smallest(
    closed: Sequence[LFT],
    bound: Mapping[str, int],
    budget: Budget,
    relations: Sequence[LFT] = (),
    close: Callable[[LFT], LFT] | None = None,
    truth: LFT | None = None,
) -> Smallest:
    """The smallest LFT of equal value that is found within a budget, and the best bound on its order.

    Parameters
    ----------
    closed : LFTs of one value, with the same blocks but for their sizes
        Ways to write the model. Different ones lead to different results; with work 0 the smallest of
        them is the result.
    bound : mapping of names to the lower bounds of the repetitions
    budget : Budget
    relations : LFTs of one value, with the same blocks but for their sizes
        What the model was closed from, if it was: there masses and lengths are polynomial, and closing
        them can hide that parameters cancel.
    close : function of an LFT
        The model, reduced, from LFTs like `relations`; required with them.
    truth : LFT
        The closed model before it was reduced; it shows which entries are only what is left of terms
        that cancel. By default the smallest of `closed`.

    Returns
    -------
    Smallest
        `lft` has the names of the blocks of `closed`, in their order.
    """
    lft, order_bound = min(closed, key=lambda one: one.order), sum(bound.values())
    if lft.order <= order_bound or budget.work <= 0.0:
        return Smallest(lft, order_bound)
    source, left = lft, budget.work
    apart = independent(lft)
    if apart.order < lft.order and is_same(
        apart, Truth(lambda: lft if truth is None else truth, part_of_either)
    ):
        lft = apart
    if is_large := lft.order > LARGE:
        order_bound = joint_bound(lft, bound, source=source)

    def joint(one: LFT, stop: Callable[[], bool]) -> int:
        return order_bound if is_large else max(order_bound, joint_bound(one, bound, stop, source))

    if relations and lft.order > order_bound:
        share = _HALF if lft.order < min(form.order for form in relations) else _MOST
        found = reduce_commuting(relations, bound, share * left, joint, close, truth)
        order_bound, left = max(order_bound, found.order_bound), (1.0 - share) * left
        assert close is not None
        closed = [lft, min(lft, close(found.lft), key=lambda one: one.order)]
        lft = closed[-1]
    if lft.order > order_bound:
        again = reduce_commuting([lft, *closed], bound, left, joint, truth=truth)
        order_bound = max(order_bound, again.order_bound)
        lft = min(lft, again.lft, key=lambda one: one.order)
    return Smallest(lft, order_bound)
