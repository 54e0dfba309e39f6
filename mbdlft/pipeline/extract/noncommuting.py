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

import heapq
from collections.abc import Sequence
from typing import Any, NamedTuple

from mbdlft.exact.numbers import Exact, Field
from mbdlft.pipeline.extract.graph import Scaled, SignalGraph

Row = dict[int, Exact]  # entries by column, none of them zero
# factor, and the number of a signal
Term = tuple[Exact, int]


class Item(NamedTuple):
    """A signal that follows from earlier ones: a letter times a sum, or the sum itself (letter None)."""

    letter: int | None
    terms: Sequence[Term]


class Words(NamedTuple):
    """Sums of words: signals 0 ... inputs - 1 are the inputs, then come the items, in order."""

    inputs: int
    items: Sequence[Item]
    outputs: Sequence[Sequence[Term]]
    field: Field


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
        for _, number in terms:
            used[number] += 1
    # each signal in inputs and kept items
    one = words.field.one
    held: list[Row | None] = [{k: one} for k in range(words.inputs)]
    kept: list[Item] = []
    letters: dict[int, Dependence] = {}

    def added(terms: Sequence[Term]) -> Row:
        values: Row = {}
        for factor, number in terms:
            row = held[number]
            assert row is not None
            used[number] -= 1
            if not used[number]:
                held[number] = None
            if len(terms) == 1 and factor is one:
                return row
            add(values, row, factor)
        return values

    for number, (letter, terms) in enumerate(words.items, start=words.inputs):
        if not used[number]:
            for _, unused in terms:
                used[unused] -= 1
            held.append(None)
            continue
        values = added(terms)
        if letter is None:
            held.append(values)
            continue
        own = words.inputs + len(kept)
        found = None
        if not all_kept:
            found = letters.setdefault(letter, Dependence()).combination(own, values)
        if found is None:
            kept.append(Item(letter, _terms(values)))
            found = {own: one}
        held.append(found)
    outputs = [_terms(added(terms)) for terms in words.outputs]
    return Words(words.inputs, kept, outputs, words.field)


def _terms(values: Row) -> list[Term]:
    return [(value, k) for k, value in values.items()]


def transposed(words: Words) -> Words:
    """Outputs and inputs exchanged, and the items in the opposite order; there are no sums."""
    inputs, count = len(words.outputs), len(words.items)
    readers: list[list[Term]] = [[] for _ in range(words.inputs + count)]
    for k, terms in enumerate(words.outputs):
        for factor, number in terms:
            readers[number].append((factor, k))
    items: list[Item] = []
    for k in reversed(range(count)):
        letter, terms = words.items[k]
        own = inputs + len(items)
        items.append(Item(letter, readers[words.inputs + k]))
        for factor, number in terms:
            readers[number].append((factor, own))
    return Words(inputs, items, readers[: words.inputs], words.field)


def condensed(graph: SignalGraph) -> SignalGraph:
    """The same outputs from the fewest channels and quotients, if the divisors were letters, too.

    A graph that would not be smaller is returned as it is.
    """
    if not graph.quotients:
        return graph
    items: list[Item] = [Item(None, ())] * (graph.size - graph.inputs)
    for signal, terms in graph.equations:
        items[signal - graph.inputs] = Item(None, _given(*terms))
    letters = {k: graph.node("parameter", float(k)) for k in {k for _, k, _ in graph.channels}}
    for signal, parameter, z in graph.channels:
        items[signal - graph.inputs] = Item(letters[parameter], _given(z))
    for signal, divisor, z in graph.quotients:
        items[signal - graph.inputs] = Item(-1 - divisor, _given(z))
    outputs = [_given(output) for output in graph.outputs]
    words = smallest(Words(graph.inputs, items, outputs, graph.field))
    small = graph.without_signals()
    signals = [Scaled(graph.field.one, k) for k in range(words.inputs)]
    for item in words.items:
        assert item.letter is not None
        z, number = _combined(small, signals, item.terms), item.letter
        signals.append(small.divide(-1 - number, z) if number < 0 else small.apply(number, z))
    small.outputs = [_combined(small, signals, output) for output in words.outputs]
    return small if len(small.channels) < len(graph.channels) else graph


def _given(*terms: Scaled) -> list[Term]:
    return [(factor, number) for factor, number in terms if number >= 0]


def _combined(graph: SignalGraph, signals: Sequence[Scaled], terms: Sequence[Term]) -> Scaled:
    return graph.combine([graph.scaled(factor, signals[number]) for factor, number in terms])


def opened(graph: SignalGraph) -> Words:
    """Channels by parameter; quotients are inputs, and b y - s of each is one of the first outputs."""
    quotients = [signal for signal, _, _ in graph.quotients]
    is_quotient = set(quotients)
    others = [k for k in range(graph.inputs, graph.size) if k not in is_quotient]
    order = [*range(graph.inputs), *quotients, *others]
    renumbered = {signal: k for k, signal in enumerate(order)}
    first = graph.inputs + len(quotients)

    def terms(*scaled: Scaled) -> list[Term]:
        return [(factor, renumbered[number]) for factor, number in _given(*scaled)]

    items: list[Item] = [Item(None, ())] * len(others)
    for signal, summed in graph.equations:
        items[renumbered[signal] - first] = Item(None, terms(*summed))
    for signal, parameter, z in graph.channels:
        items[renumbered[signal] - first] = Item(parameter, terms(z))
    loops = [
        terms(left, Scaled(-right.factor, right.number))
        for left, (_, _, right) in zip(graph.products, graph.quotients, strict=True)
    ]
    outputs = [*loops, *(terms(output) for output in graph.outputs)]
    return Words(first, items, outputs, graph.field)


class Dependence:
    """Rows that are independent, by number, in a form in which the next one is compared with them.

    Most rows are the first with an entry in some column: they are independent of all before, and that
    column is theirs. Subtracted from the youngest to the oldest, they leave nothing in their columns.
    What is then left of the other rows, `rests`, is in echelon form.
    """

    def __init__(self) -> None:
        self.rows: dict[int, Row] = {}
        self.seen: set[int] = set()
        self.owner: dict[int, tuple[int, int]] = {}  # of a column: place by age, and number
        self.rests: list[tuple[int, int, Row, Row]] = []  # pivot, number, what is left, factors

    def combination(self, number: int, row: Row) -> Row | None:
        """Factors of earlier rows that add up to this one; None if there are none: then it is added."""
        new = row.keys() - self.seen
        if new:
            pivot = max(new)
            self.owner[pivot] = (len(self.owner), number)
        else:
            remainder, factors = self._subtracted(row)
            if not remainder:
                return factors
            self.rests.append((max(remainder), number, remainder, factors))
        self.rows[number] = row
        self.seen.update(row)
        return None

    def _subtracted(self, row: Row) -> tuple[Row, Row]:
        """What is left of a row, and factors of the rows that were subtracted."""
        owner, remainder = self.owner, dict(row)
        factors: Row = {}
        waiting = [(-owner[c][0], c) for c in row if c in owner]
        heapq.heapify(waiting)
        while waiting:
            _, column = heapq.heappop(waiting)
            if column not in remainder:  # met twice, or cancelled
                continue
            number = owner[column][1]
            entries = self.rows[number]
            factors[number] = factor = remainder[column] / entries[column]
            for c in subtract(remainder, entries, factor):
                if c in owner:
                    heapq.heappush(waiting, (-owner[c][0], c))
        for pivot, number, echelon_row, made_of in self.rests:
            if pivot in remainder:
                factor = remainder[pivot] / echelon_row[pivot]
                subtract(remainder, echelon_row, factor)
                subtract(factors, made_of, factor)
                factors[number] = factor
        return remainder, factors


def subtract(row: Row, other: Row, factor: Exact) -> list[int]:
    """Subtract a multiple of another row in place; columns that are new."""
    return _add(row, other, -factor.ball, -factor.residue)


def add(row: Row, other: Row, factor: Exact) -> list[int]:
    """Add a multiple of another row in place; columns that are new."""
    return _add(row, other, factor.ball, factor.residue)


def _add(row: Row, other: Row, ball: Any, residue: Any) -> list[int]:
    # the two parts of the numbers are written out: this is where most of the time goes
    new = []
    for column, entry in other.items():
        before = row.get(column)
        if before is None:
            row[column] = Exact(ball * entry.ball, residue * entry.residue)
            new.append(column)
            continue
        left = before.residue + residue * entry.residue
        if left != 0:
            row[column] = Exact(before.ball + ball * entry.ball, left)
        else:
            del row[column]
    return new
