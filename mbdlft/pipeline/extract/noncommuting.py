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

Then the channels are closed. One of a parameter with p = b0 + gain delta/(1 + a1 delta) is
w = b0 z + gain w', w' = delta (z - a1 w'). Each z, and each y, follows from inputs, w' and what is
solved before it, but for the loops of quotients: one row after the other is enough, and what is zero by
structure is zero exactly.
"""

import heapq
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from mbdlft.base.errors import WellPosednessError
from mbdlft.base.parameter import BilinearMap
from mbdlft.exact.matrices import ExactMatrix, from_rows, identity, to_rows
from mbdlft.exact.numbers import Exact, Field
from mbdlft.lft.block import Block
from mbdlft.lft.determinant import components
from mbdlft.order.reduction import ExactLFT

_MANY = 5000  # items: with fewer, sums in sums take more time than longer rows
Row = dict[int, Exact]  # entries by column, none of them zero
Term = tuple[Exact, int]  # factor, and the number of a signal


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
    """The same outputs from the fewest letters, if letters did not commute; many sums stay."""
    stay = len(words.items) > _MANY
    return transposed(reached(transposed(reached(words, sums_stay=stay)), sums_stay=stay))


class _Rows:
    """Signals in inputs and items that stay, one after the other, each dropped after its last use."""

    def __init__(self, words: Words) -> None:
        self.rows: list[Row] = [{k: words.field.one} for k in range(words.inputs)]
        # how often each signal is read, by what is read itself
        self.waiting = [0] * (words.inputs + len(words.items))
        for terms in (*(item.terms for item in words.items), *words.outputs):
            self._count(terms, 1)
        for k in reversed(range(len(words.items))):
            if not self.waiting[words.inputs + k]:
                self._count(words.items[k].terms, -1)

    def _count(self, terms: Sequence[Term], step: int) -> None:
        for _, number in terms:
            self.waiting[number] += step

    def read(self, terms: Sequence[Term]) -> Row:
        """Their sum; the first row, which of a long sum has all terms so far, is copied if it is kept."""
        row: Row = {}
        for k, (factor, number) in enumerate(terms):
            self.waiting[number] -= 1
            is_kept = self.waiting[number] > 0
            if k or factor.residue != 1:
                add(row, self.rows[number], factor)
            else:
                row = dict(self.rows[number]) if is_kept else self.rows[number]
            if not is_kept:
                self.rows[number] = {}
        return row


def reached(words: Words, *, sums_stay: bool = False) -> Words:
    """The same outputs; items that are combinations of others of their letter become sums of these.

    Rows decide. They are what items read where sums do not stay.
    """
    known = _Rows(words)
    place = list(range(words.inputs))  # of each signal in what is made
    items: list[Item] = []
    letters: dict[int, Dependence] = {}
    for number, (letter, terms) in enumerate(words.items, start=words.inputs):
        new, factors = words.inputs + len(items), None
        place.append(new)
        if not known.waiting[number]:
            known.rows.append({})
            continue
        row = read = known.read(terms)
        if letter is not None:
            factors = letters.setdefault(letter, Dependence()).combination(new, row)
            row = {new: words.field.one} if factors is None else factors
        known.rows.append(row)
        if sums_stay:
            reads = _terms(factors) if factors is not None else [(x, place[k]) for x, k in terms]
            items.append(Item(letter if factors is None else None, reads))
        elif letter is not None and factors is None:
            items.append(Item(letter, _terms(read)))
    if sums_stay:
        outputs = [[(factor, place[k]) for factor, k in terms] for terms in words.outputs]
    else:
        outputs = [_terms(known.read(terms)) for terms in words.outputs]
    return Words(words.inputs, items, outputs, words.field)


def with_sums_put_in(words: Words, *, of_one_reader: bool = False) -> Words:
    """The same without sums, or without those that are read once."""
    if all(item.letter is not None for item in words.items):
        return words
    known, items = _Rows(words), list[Item]()
    readers = list(known.waiting)
    for number, (letter, terms) in enumerate(words.items, start=words.inputs):
        row = known.read(terms) if readers[number] else {}
        if readers[number] and (letter is not None or (of_one_reader and readers[number] > 1)):
            items.append(Item(letter, _terms(row)))
            row = {words.inputs + len(items) - 1: words.field.one}
        known.rows.append(row)
    outputs = [_terms(known.read(terms)) for terms in words.outputs]
    return Words(words.inputs, items, outputs, words.field)


def _terms(values: Row) -> list[Term]:
    return [(value, k) for k, value in values.items()]


def transposed(words: Words) -> Words:
    """Outputs and inputs exchanged, and the items in the opposite order."""
    inputs, count = len(words.outputs), len(words.items)
    readers: list[list[Term]] = [[] for _ in range(words.inputs + count)]
    for k, terms in enumerate(words.outputs):
        for factor, number in terms:
            readers[number].append((factor, k))
    items: list[Item] = []
    for k in reversed(range(count)):
        letter, terms = words.items[k]
        channel = inputs + len(items)
        items.append(Item(letter, readers[words.inputs + k]))
        for factor, number in terms:
            readers[number].append((factor, channel))
    return Words(inputs, items, readers[: words.inputs], words.field)


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
            factors[number], new = cleared(remainder, self.rows[number], column)
            for c in new:
                if c in owner:
                    heapq.heappush(waiting, (-owner[c][0], c))
        for pivot, number, echelon_row, made_of in self.rests:
            if pivot in remainder:
                factor, _ = cleared(remainder, echelon_row, pivot)
                subtract(factors, made_of, factor)
                factors[number] = factor
        return remainder, factors


def combined(terms: Sequence[Term], rows: Sequence[Row] | Mapping[int, Row]) -> Row:
    """The sum of some rows, each with its factor; a single one itself."""
    if len(terms) == 1 and terms[0][0].residue == 1:
        return rows[terms[0][1]]
    total: Row = {}
    for factor, number in terms:
        add(total, rows[number], factor)
    return total


def cleared(row: Row, other: Row, column: int) -> tuple[Exact, list[int]]:
    """Subtract the multiple of another row that leaves nothing in a column; its factor, new columns."""
    entry, pivot = row[column], other[column]
    factor = Exact(entry.ball / pivot.ball, entry.residue / pivot.residue)
    return factor, subtract(row, other, factor)


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
        residue_sum = before.residue + residue * entry.residue
        if residue_sum != 0:
            row[column] = Exact(before.ball + ball * entry.ball, residue_sum)
        else:
            del row[column]
    return new


def closed(words: Words, quotients: int, names: Sequence[str], maps: Sequence[BilinearMap]) -> ExactLFT:
    """Inputs to outputs in normalized deltas; the last inputs are y, the first outputs their loops."""
    closing = _Closing(words, quotients, names, maps)
    for component in closing.components():
        closing.solve(component)
    return closing.lft()


class _Closing:
    """Rows in [w', inputs] of all signals, filled in one component after the other.

    Unknowns are numbered: quotients first, as they follow from their loops, then items. Before it is
    solved, the row of an item w = b0 z + gain w' has its second term only.
    """

    def __init__(
        self, words: Words, quotients: int, names: Sequence[str], maps: Sequence[BilinearMap]
    ) -> None:
        self.words, self.quotients, self.count = words, quotients, len(words.items)
        self.inputs, one = words.inputs - quotients, words.field.one
        letters = [item.letter for item in words.items if item.letter is not None]
        self.order = sorted(range(self.count), key=lambda k: names[letters[k]])  # in the LFT
        exact = words.field.decimals([x for m in maps for x in (m.b0, m.gain, m.a1)])
        self.maps = [exact[3 * letter : 3 * letter + 3] for letter in letters]
        counts = Counter(names[letter] for letter in letters)
        self.blocks = tuple(Block(name, counts[name]) for name in sorted(names))
        # what each unknown follows from: the loop of a quotient, or z
        self.equations = [*words.outputs[:quotients], *(item.terms for item in words.items)]
        self.z: list[Row] = [{} for _ in range(self.count)]
        self.rows: list[Row] = [{self.count + k: one} for k in range(self.inputs)]
        self.rows += [{} for _ in range(words.inputs - self.inputs + self.count)]
        for k, item in enumerate(self.order):
            self.rows[words.inputs + item] = {k: self.maps[item][1]}
        self.inverses: dict[frozenset[tuple[int, int, int]], ExactMatrix] = {}  # by divisors of loops

    def components(self) -> list[list[int]]:
        """Unknowns that depend on each other, after all that they need."""
        if not self.quotients:
            return [[k] for k in range(self.count)]
        needs = [[n - self.inputs for _, n in terms if n >= self.inputs] for terms in self.equations]
        readers = np.repeat(np.arange(len(needs)), [len(need) for need in needs])
        sources = np.array([k for need in needs for k in need], dtype=int)
        return [loop.tolist() for loop in components(readers, sources, len(needs))]

    def solve(self, unknowns: list[int]) -> None:
        """Fill in the rows of unknowns that depend on each other; all others that they need are known."""
        values = [combined(self.equations[u], self.rows) for u in unknowns]
        if len(unknowns) > 1 or unknowns[0] < self.quotients:
            values = self._loop(unknowns, values)
        for u, row in zip(unknowns, values, strict=True):
            if u < self.quotients:
                self.rows[self.inputs + u] = row
                continue
            item = u - self.quotients
            self.z[item], b0 = row, self.maps[item][0]
            if b0.residue:
                add(self.rows[self.inputs + u], row, b0)

    def _loop(self, unknowns: list[int], right: list[Row]) -> list[Row]:
        """Unknowns of a loop from their rows in what is known."""
        one, prime = self.words.field.one, self.words.field.prime
        through = {
            self.inputs + u: {k: one if u < self.quotients else self.maps[u - self.quotients][0]}
            for k, u in enumerate(unknowns)
        }
        matrix: list[Row] = [{} if u < self.quotients else {k: one} for k, u in enumerate(unknowns)]
        for row, u in zip(matrix, unknowns, strict=True):
            for factor, number in self.equations[u]:
                if number in through:
                    subtract(row, through[number], factor)
        columns = sorted({column for row in right for column in row})
        place = {column: k for k, column in enumerate(columns)}
        dense = [{place[c]: value for c, value in row.items()} for row in right]
        solution = to_rows(self._inverse(matrix) @ from_rows(dense, len(columns), prime))
        return [{columns[k]: value for k, value in row.items()} for row in solution]

    def lft(self) -> ExactLFT:
        """The LFT, once all unknowns are solved for."""
        outputs = [combined(terms, self.rows) for terms in self.words.outputs[self.quotients :]]
        inner = [dict(self.z[item]) for item in self.order]
        for k, item in enumerate(self.order):
            if self.maps[item][2].residue:
                subtract(inner[k], {k: self.words.field.one}, self.maps[item][2])
        matrix = from_rows([*inner, *outputs], self.count + self.inputs, self.words.field.prime)
        return ExactLFT(matrix, self.blocks)

    def _inverse(self, rows: list[Row]) -> ExactMatrix:
        """The inverse of a matrix, or an error that says the model is not well posed at nominal."""
        entries = [(k, column, x) for k, row in enumerate(rows) for column, x in row.items()]
        key = frozenset([(k, column, int(x.residue)) for k, column, x in entries])
        if key not in self.inverses:
            matrix = from_rows(rows, len(rows), self.words.field.prime)
            try:
                self.inverses[key] = matrix.solve(identity(len(rows), matrix.prime))
            except ZeroDivisionError:
                raise WellPosednessError(
                    "a denominator vanishes at the nominal values of the parameters, so there is no "
                    "linear fractional form around them. Move the nominal values."
                ) from None
        return self.inverses[key]
