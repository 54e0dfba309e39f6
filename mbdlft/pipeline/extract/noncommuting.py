"""Exact n-D reduction of a signal graph, before any parameter has a value.

A channel is w = p z, with z a linear combination of inputs and of earlier channels. Written out, z is a
sum of words: products of parameters, in the order in which they act on an input. A combination of inputs
and channels is zero as such a sum if and only if it is zero in each part that begins with one letter, so
when the channels that are kept for each letter have independent z,

    z = 0    if and only if    its row of constants is zero,

and z depends on the z that are kept for the same letter exactly where its row is a combination of
theirs. Then w is the same combination, and the channel is not needed. One pass in the order of the
channels keeps those that can be told apart by what reaches them. The same pass on the transposed system
keeps those that can be told apart by what they do. What is left is minimal for letters that do not
commute (Beck, Doyle 1999), in channels that were there before.

A quotient y, b y = s, is a letter of its own in the first round, y = (1/b) s: equal sums of quotients
by one divisor are found. In the second round, y is an input and b y - s an output.
"""

from collections.abc import Sequence
from typing import NamedTuple

from mbdlft.number.rounding import is_rounding
from mbdlft.pipeline.extract.dependence import Dependence, Row
from mbdlft.pipeline.extract.graph import ZERO, Scaled, SignalGraph

# factor, its size if nothing had cancelled in it, and the number of a signal
Term = tuple[float, float, int]


class Item(NamedTuple):
    """A signal that follows from earlier ones: a letter times a sum, or the sum itself (letter None)."""

    letter: int | None
    terms: Sequence[Term]


class Words(NamedTuple):
    """Sums of words: signals 0 ... inputs - 1 are the inputs, then come the items, in order."""

    inputs: int
    items: Sequence[Item]
    outputs: Sequence[Sequence[Term]]


def smallest(words: Words) -> Words:
    """The same outputs from the fewest items, if letters did not commute; sums are put in."""
    return transposed(reached(transposed(reached(words))))


def reached(words: Words, *, all_kept: bool = False) -> Words:
    """The same outputs from items with a letter, no combination of others of the same letter.

    With `all_kept`, sums are put in, and nothing else is done. A row is dropped after its last use:
    there are many more sums than items that stay.
    """
    used = [0] * (words.inputs + len(words.items))
    for terms in (*(item.terms for item in words.items), *words.outputs):
        for _, _, number in terms:
            used[number] += 1
    # each signal in inputs and kept items, and sizes if nothing had cancelled
    held: list[tuple[Row, Row] | None] = [({k: 1.0}, {k: 1.0}) for k in range(words.inputs)]
    kept: list[Item] = []
    letters: dict[int, Dependence] = {}

    def added(terms: Sequence[Term]) -> tuple[Row, Row]:
        values: Row = {}
        sizes: Row = {}
        for factor, size, number in terms:
            found = held[number]
            assert found is not None
            used[number] -= 1
            if not used[number]:
                held[number] = None
            if not values and not sizes:
                if factor == size == 1.0 and len(terms) == 1:
                    return found
                values = {k: factor * value for k, value in found[0].items()}
                sizes = {k: size * found[1][k] for k in values}
                continue
            for k, value in found[0].items():
                before = sizes.get(k)
                if before is None:
                    values[k], sizes[k] = factor * value, size * found[1][k]
                    continue
                total = values.get(k, 0.0) + factor * value
                sizes[k] = before + size * found[1][k]
                if is_rounding(total, sizes[k]):
                    values.pop(k, None)
                else:
                    values[k] = total
        return values, sizes

    for number, (letter, terms) in enumerate(words.items, start=words.inputs):
        if not used[number]:
            for _, _, unused in terms:
                used[unused] -= 1
            held.append(None)
            continue
        values, sizes = added(terms)
        if letter is None:
            held.append((values, sizes))
            continue
        own = words.inputs + len(kept)
        found = None
        if not all_kept:
            found = letters.setdefault(letter, Dependence()).combination(own, values)
        if found is None:
            kept.append(Item(letter, _terms(values, sizes)))
            found = {own: 1.0}
        held.append((found, {k: abs(factor) for k, factor in found.items()}))
    return Words(words.inputs, kept, [_terms(*added(terms)) for terms in words.outputs])


def _terms(values: Row, sizes: Row) -> list[Term]:
    return [(value, sizes[k], k) for k, value in values.items()]


def transposed(words: Words) -> Words:
    """Outputs and inputs exchanged, and the items in the opposite order; there are no sums."""
    inputs, count = len(words.outputs), len(words.items)
    readers: list[list[Term]] = [[] for _ in range(words.inputs + count)]
    for k, terms in enumerate(words.outputs):
        for factor, size, number in terms:
            readers[number].append((factor, size, k))
    items: list[Item] = []
    for k in reversed(range(count)):
        letter, terms = words.items[k]
        own = inputs + len(items)
        items.append(Item(letter, readers[words.inputs + k]))
        for factor, size, number in terms:
            readers[number].append((factor, size, own))
    return Words(inputs, items, readers[: words.inputs])


def condensed(graph: SignalGraph) -> SignalGraph:
    """The same outputs from the fewest channels and quotients, if the divisors were letters, too.

    A graph that would not be smaller is returned as it is.
    """
    if not graph.quotients:
        return graph
    items: list[Item] = [Item(None, ())] * (graph.size - graph.inputs)
    for signal, terms in graph.equations:
        items[signal - graph.inputs] = Item(None, _given(*terms))
    for signal, parameter, z in graph.channels:
        letter = graph.node("parameter", float(parameter))
        items[signal - graph.inputs] = Item(letter, _given(z))
    for signal, divisor, z in graph.quotients:
        items[signal - graph.inputs] = Item(-1 - divisor, _given(z))
    words = smallest(Words(graph.inputs, items, [_given(output) for output in graph.outputs]))
    found = graph.without_signals()
    signals = [Scaled(1.0, k) for k in range(words.inputs)]
    for item in words.items:
        assert item.letter is not None
        z, number = _combined(found, signals, item.terms), item.letter
        signals.append(found.divide(-1 - number, z) if number < 0 else found.apply(number, z))
    found.outputs = [_combined(found, signals, output) for output in words.outputs]
    return found if len(found.channels) < len(graph.channels) else graph


def _given(*terms: Scaled) -> list[Term]:
    return [(factor, abs(factor), number) for factor, number in terms if number >= 0]


def _combined(graph: SignalGraph, signals: Sequence[Scaled], terms: Sequence[Term]) -> Scaled:
    parts = (
        Scaled(factor * signals[number].factor, signals[number].number)
        for factor, _, number in terms
    )
    return graph.combine([part for part in parts if part != ZERO])


def opened(graph: SignalGraph) -> Words:
    """Channels by parameter; quotients are inputs, and b y - s of each is one of the first outputs."""
    quotients = [signal for signal, _, _ in graph.quotients]
    is_quotient = set(quotients)
    others = [k for k in range(graph.inputs, graph.size) if k not in is_quotient]
    order = [*range(graph.inputs), *quotients, *others]
    renumbered = {signal: k for k, signal in enumerate(order)}
    first = graph.inputs + len(quotients)

    def terms(*given: Scaled) -> list[Term]:
        return [(f, s, renumbered[number]) for f, s, number in _given(*given)]

    items: list[Item] = [Item(None, ())] * len(others)
    for signal, summed in graph.equations:
        items[renumbered[signal] - first] = Item(None, terms(*summed))
    for signal, parameter, z in graph.channels:
        items[renumbered[signal] - first] = Item(parameter, terms(z))
    loops = [
        terms(left, Scaled(-right.factor, right.number))
        for left, (_, _, right) in zip(graph.products, graph.quotients, strict=True)
    ]
    return Words(first, items, [*loops, *(terms(output) for output in graph.outputs)])
