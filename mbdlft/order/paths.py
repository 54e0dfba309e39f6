"""Exchanges one after the other: residues foretell what they lead to, and what gains is made in balls."""

from collections.abc import Collection, Iterator, Sequence
from heapq import heapify, heappop, heappush
from operator import attrgetter
from typing import Any, NamedTuple

from mbdlft.exact.numbers import BITS, RESIDUES_ALONE, TooFewBitsError, ask_for_bits, precision
from mbdlft.lft.lft import Block
from mbdlft.order.exchange import Exchange, by_exchange, exchanges
from mbdlft.order.reduction import ExactLFT
from mbdlft.order.work import Work

_MORE = 4  # repetitions than there are, on the way to fewer
_IDLE, _LARGE = 9e3, 47  # channels of attempts without a gain, for each unit; so many of one, at most
_OF_LOOK = 0.6  # of the work that is left: what is not as residues foretell needs another look
OF_BALLS = 5.0  # times the work in residues: most exchanges need 1536 bits, after a try in fewer
_OF_RESULT = 20  # attempts that lead nowhere cost as much as one that leads somewhere
ENOUGH_BITS = 4 * BITS  # an exchange that needs more is not made

Path = tuple[Exchange, ...]
Impossible = tuple[tuple[Block, ...], Exchange]


class Node:
    """An LFT of residues, and what exchanges lead to from there, as far as that is known.

    That of another form is looked at however large it is. `units` of work led here.
    """

    def __init__(self, lft: ExactLFT, *, is_form: bool = False, units: float = 0.0) -> None:
        self.lft, self.is_form, self.units = lft, is_form, units
        self._known = list[tuple[Exchange, Node | None]]()
        self._others = exchanges(lft)

    def after(self, work: Work) -> Iterator[tuple[Exchange, "Node | None"]]:
        """Each exchange; what is not known yet costs work."""
        yield from tuple(self._known)
        while not work.is_over:
            before = work.spent
            with work.counting():
                attempt = next(self._others, None)
            if attempt is None:
                break
            exchange, lft = attempt
            node = Node(lft, units=self.units + work.spent - before) if lft else None
            self._known.append((exchange, node))
            yield self._known[-1]


class Found(NamedTuple):
    """Exchanges from one of some starts, their order, and others that other primes may lead below it."""

    first: int
    path: Path
    order: int
    hopeful: Sequence[tuple[int, Path]]


def path_below(
    starts: Sequence[Node],
    least: int,
    bound: int,
    work: Work,
    but_not: Collection[Impossible] = (),
    *,
    with_zeros: bool = True,
) -> Found:
    """Exchanges one after the other to the smallest order below one that residues find.

    They go on from small LFTs after few of them, the same sizes again after other deltas, and end at a
    bound, with the work, or late after a gain. In balls the path takes as much work at most.
    """
    first, path, idle, hopes = 0, Path(), 0, list[tuple[float, int, Path]]()
    smallest, most, look = least, work.most / OF_BALLS, work.part(_OF_LOOK)
    with precision(RESIDUES_ALONE):
        queue = [(node.lft.order, k, Path(), node, k) for k, node in enumerate(starts)]
        seen = set[tuple[Any, ...]]()
        heapify(queue)
        while queue:
            *_, before, start, k = heappop(queue)
            is_first = not before and (start.is_form or not k)
            if start.lft.order > smallest + _MORE and not is_first:
                continue
            for exchange, node in start.after(look):
                idle += (_OF_RESULT if node else 1) * min(start.lft.order, _LARGE)
                if smallest <= bound or idle > _IDLE * max(2.0, work.most):
                    queue.clear()
                    break
                if exchange.at_best < smallest:
                    hopes.append((exchange.at_best, k, (*before, exchange)))
                is_left_out = exchange.kind == "zeros" and not with_zeros
                if node is None or is_left_out or (start.lft.blocks, exchange) in but_not:
                    continue
                if (key := (node.lft.blocks, *exchange[:3])) in seen:
                    continue
                seen.add(key)
                after = (*before, exchange)
                heappush(queue, (node.lft.order + len(after), len(seen), after, node, k))
                if node.lft.order < smallest:
                    smallest, idle = node.lft.order, 0
                    if node.units <= most:
                        first, path, least = k, after, smallest
    hopes.sort(key=lambda hope: (hope[0], len(hope[-1])))
    return Found(first, path, least, [(k, some) for at_best, k, some in hopes if at_best < least])


def exchanged(a: ExactLFT, path: Path) -> tuple[ExactLFT, Impossible | None]:
    """The smallest LFT along exchanges, in balls, and the first one that is not as residues foretell."""
    smallest, failed = a, None
    for exchange in path:
        try:
            result, lengths = by_exchange(a, exchange)
        except TooFewBitsError:
            ask_for_bits(ENOUGH_BITS)
            result, lengths = None, ()
        if result is None or lengths != exchange.lengths:
            failed = failed or (a.blocks, exchange)
        if result is None:
            break
        a = result
        smallest = min(smallest, a, key=attrgetter("order"))
    return smallest, failed
