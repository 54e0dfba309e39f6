"""Words as sparse equations of their signals, in as few channels as dense matrices of the relations have.

Words do not know that powers of one parameter commute. A rotation by an angle divides two signals by
1 + t^2, and the t y and t^2 y of two quotients y are four channels where two are enough. What follows
from other signals by one parameter alone, with its loops of quotients, is an LFT of one delta from what
it reads, e, to the equations that read it. It is closed and reduced, which is minimal for one delta, and

    w = delta (M11 w + M12 e),      M21 w + M22 e for what was read

takes its place. Ten links in space have 854 channels as words, and 628 so: as few as in dense matrices.
"""

from collections import Counter, defaultdict
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from mbdlft.base.parameter import BilinearMap
from mbdlft.exact.matrices import double_of, to_rows
from mbdlft.exact.numbers import Exact
from mbdlft.exact.reachable import reduced
from mbdlft.lft.block import Block
from mbdlft.lft.determinant import components
from mbdlft.lft.sparse import ALWAYS, SparseLFT
from mbdlft.order.sparse_bound import SparseResidues
from mbdlft.pipeline.extract.noncommuting import Item, Row, Term, Words, add, closed, with_sums_put_in


def sparse(
    words: Words, quotients: int, names: Sequence[str], maps: Sequence[BilinearMap]
) -> SparseResidues:
    """As `closed`, with signals that stay; (1 + a1 delta) w = (b0 + (b0 a1 + gain) delta) z of items."""
    words, one = with_sums_put_in(words, of_one_reader=True), words.field.one
    equations = _Equations(words, quotients, names, maps)
    signals = equations.signals
    order = sorted(range(len(names)), key=names.__getitem__)
    exact = words.field.decimals([x for k in order for x in (maps[k].b0, maps[k].gain, maps[k].a1)])
    block = {k: position for position, k in enumerate(order)}
    counts = Counter[int]()
    entries: list[tuple[int, int, Exact, int]] = []

    def put(row: int, terms: Row, factor: Exact = one, owner: int = ALWAYS) -> None:
        entries.extend((row, column, value * factor, owner) for column, value in terms.items())

    for u, row in equations.place.items():
        letter, terms = equations.letters[u], equations.read(u)
        if u < quotients:
            put(row, terms)
            continue
        put(row, {row: one})
        if letter is None:
            put(row, terms, -one)
            continue
        b0, gain, a1 = exact[3 * block[letter] : 3 * block[letter] + 3]
        put(row, {row: one}, a1, block[letter])
        put(row, terms, -b0)
        put(row, terms, -(b0 * a1 + gain), block[letter])
        counts[letter] += 1
    for letter, part in equations.parts.items():
        counts[letter] += part.order
        for row, terms in enumerate(part.rows, start=part.first):
            put(row, {row: one})
            put(row, terms, -one, block[letter])
        for row, u in enumerate(part.sources, start=part.first + part.order):
            put(row, {row: one})
            put(row, equations.read(u), -one)
    for row, u in enumerate(range(len(equations.letters), len(equations.terms)), start=signals):
        put(row, equations.read(u))
    entries = [entry for entry in entries if entry[2]]
    rows, columns, values, owners = zip(*entries, strict=True)
    doubles = np.array([double_of(value.ball) for value in values])
    blocks = tuple(Block(names[k], counts[k]) for k in order)
    shape = (len(words.outputs) - quotients, equations.inputs)
    lft = SparseLFT(np.array(rows), np.array(columns), doubles, np.array(owners), signals, shape, blocks)
    residues = np.array([int(value.residue) for value in values], dtype=np.int64)
    return SparseResidues(lft, residues, words.field.prime)


class _Part(NamedTuple):
    """What follows by one letter alone: an LFT whose channels and inputs e are signals from `first`."""

    first: int
    order: int
    rows: list[Row]  # of [M11 M12], by signals
    sources: list[int]  # the members that read other signals, e
    read: dict[int, Row]  # what other equations read of it; for members, what the sums in e do


class _Equations:
    """Loops of quotients, items and outputs in signals: inputs, and one for each loop and each item."""

    def __init__(
        self, words: Words, quotients: int, names: Sequence[str], maps: Sequence[BilinearMap]
    ) -> None:
        self.field, self.quotients, self.inputs = words.field, quotients, words.inputs - quotients
        self.letters = [*[None] * quotients, *(item.letter for item in words.items)]  # of the unknowns
        self.terms = [*words.outputs[:quotients], *(item.terms for item in words.items)]
        self.terms += words.outputs[quotients:]
        self.readers: list[list[int]] = [[] for _ in self.letters]
        for u, terms in enumerate(self.terms):
            for _, number in terms:
                if number >= self.inputs:
                    self.readers[number - self.inputs].append(u)
        self.owners = self._owners()
        kept = [u for u in range(len(self.letters)) if u not in self.owners]
        self.place = {u: position for position, u in enumerate(kept)}
        self.signals, self.parts = len(kept), dict[int, _Part]()
        for letter, members in sorted(self._members().items()):
            self.parts[letter] = part = self._part(members, names[letter], maps[letter])
            self.signals += part.order + len(part.sources)

    def _is_sum(self, u: int) -> bool:
        return self.quotients <= u < len(self.letters) and self.letters[u] is None

    def _owners(self) -> dict[int, int]:
        """The letters that unknowns follow by alone, if these have loops."""
        count = len(self.letters)
        pairs = [(u, k) for k, some in enumerate(self.readers) for u in some if u < count]
        readers, sources = np.array(pairs, dtype=np.int64).reshape(-1, 2).T
        owners, looped = dict[int, int](), set[int]()
        for loop in components(readers, sources, count):
            letters = {self.letters[u] for u in loop.tolist()} - {None}
            if len(letters) == 1 and (letter := letters.pop()) is not None:
                owners |= {u: letter for u in loop.tolist() if not self._is_sum(u)}
                looped |= {letter} if len(loop) > 1 else set()
        return {u: owners[u] for u in sorted(owners) if owners[u] in looped}

    def _members(self) -> dict[int, list[int]]:
        """Unknowns by the letter that they follow by alone, in order."""
        members = defaultdict[int, list[int]](list)
        for u, letter in self.owners.items():
            members[letter].append(u)
        return members

    def _part(self, members: Sequence[int], name: str, values: BilinearMap) -> _Part:
        """The smallest LFT for the equations that read it, by sums too; sums are what these need."""
        own = {self.inputs + u for u in members}
        direct, by_sums = self._read(members)
        sources = [u for u in members if any(number not in own for _, number in self.terms[u])]
        loops = [u for u in members if u < self.quotients]
        place = {u: len(sources) + k for k, u in enumerate(members)}

        def terms(*rows: Row) -> list[Term]:
            return [(factor, place[u]) for row in rows for u, factor in row.items()]

        inner = {u: terms(direct.get(u, {}), by_sums.get(u, {})) for u in members}
        for k, u in enumerate(sources):
            inner[u].append((self.field.one, k))
        items = [Item(0, inner[u]) for u in members[len(loops) :]]
        others = [u for u in direct if u not in place]
        seen = [terms(direct[u], by_sums[u]) for u in others if not self._is_sum(u)]
        read = {u: terms(direct[u]) for u in others} | {
            u: terms(by_sums[u]) for u in members if u in by_sums
        }
        read = {u: row for u, row in read.items() if row}
        outputs = [*(inner[u] for u in loops), *seen, *read.values()]
        words = Words(len(sources) + len(loops), items, outputs, self.field)
        lft = closed(words, len(loops), [name], [values])
        M, (order,) = reduced(lft.M, [lft.order], len(seen))
        first = self.signals
        rows = [{first + k: value for k, value in row.items()} for row in to_rows(M)]
        found = dict(zip(read, rows[order + len(seen) :], strict=True))
        return _Part(first, order, rows[:order], sources, found)

    def _read(self, members: Sequence[int]) -> tuple[dict[int, Row], dict[int, Row]]:
        """What equations read of some unknowns, directly and by sums, for those that do."""
        some, waiting = set[int](), list(members)
        while waiting:
            for u in self.readers[waiting.pop()]:
                if u not in some:
                    some.add(u)
                    waiting += [u] if self._is_sum(u) else []
        direct, by_sums, own = dict[int, Row](), dict[int, Row](), set(members)
        for u in sorted(some, key=lambda u: (not self._is_sum(u), u)):
            direct[u], by_sums[u] = {}, {}
            for factor, number in self.terms[u]:
                source = number - self.inputs
                if source in own:
                    add(direct[u], {source: self.field.one}, factor)
                elif source in some and self._is_sum(source):
                    add(by_sums[u], direct[source], factor)
                    add(by_sums[u], by_sums[source], factor)
        return direct, by_sums

    def read(self, u: int) -> Row:
        """The terms of an equation by signals, but for those of its own part; inputs come last."""
        row, own = Row(), self.owners.get(u)
        letters = set[int]()
        for factor, number in self.terms[u]:
            source = number - self.inputs
            if source in self.owners:
                letters.add(self.owners[source])
            else:
                add(
                    row,
                    {self.signals + number if source < 0 else self.place[source]: self.field.one},
                    factor,
                )
        for letter in letters - {own}:
            add(row, self.parts[letter].read[u], self.field.one)
        if own is not None:
            add(row, self.parts[own].read.get(u, {}), -self.field.one)
        return row
