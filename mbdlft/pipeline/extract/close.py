"""From a signal graph to an LFT: words are reduced exactly, then nominal values are put in.

A channel w = p z of a parameter with p = b0 + gain delta/(1 + a1 delta) is w = b0 z + gain w',
w' = delta (z - a1 w'). Each z, and each quotient, is solved for in inputs and w'. They follow from
each other but for the loops of the quotients, so one row after the other is enough, and what is zero by
structure is zero exactly.
"""

from collections.abc import Container, Iterator, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from mbdlft.base.array import Array
from mbdlft.base.errors import WellPosednessError
from mbdlft.base.parameter import BilinearMap
from mbdlft.lft.lft import LFT, Block
from mbdlft.number.rounding import ROUNDING, cleaned, solution_size
from mbdlft.pipeline.extract.graph import SignalGraph
from mbdlft.pipeline.extract.noncommuting import (
    Item,
    Term,
    Words,
    condensed,
    opened,
    reached,
    smallest,
)


def close(
    graph: SignalGraph,
    names: Sequence[str],
    maps: Sequence[BilinearMap],
    *,
    all_kept: bool = False,
) -> LFT:
    """Inputs to outputs as an LFT in the normalized deltas of the parameters `names`.

    With `all_kept`, every channel of the graph that something depends on is one of the LFT.

    Raises
    ------
    WellPosednessError
        A denominator vanishes at the nominal values.
    """
    small = graph if all_kept else condensed(graph)
    words, quotients = opened(small), len(small.quotients)
    words = reached(words, all_kept=True) if all_kept else smallest(words)
    channels = _Channels(words, quotients, names, maps)
    for component in _components(words, quotients):
        channels.solve(component)
    return channels.lft()


class _Channels:
    """Rows [M11 M12] and those of the quotients, filled in one component after the other.

    Unknowns are numbered: quotients first, as they follow from their loops, then items.
    """

    def __init__(
        self,
        words: Words,
        quotients: int,
        names: Sequence[str],
        maps: Sequence[BilinearMap],
    ) -> None:
        self.words, self.quotients = words, quotients
        self.inputs = words.inputs - quotients
        letters = [_letter(item) for item in words.items]
        order = sorted(range(len(letters)), key=lambda k: names[letters[k]])
        place = [0] * len(order)
        for k, item in enumerate(order):
            place[item] = k
        owners = [maps[letter] for letter in letters]
        self.b0, self.gain = [owner.b0 for owner in owners], [owner.gain for owner in owners]
        self.a1 = [owner.a1 for owner in owners]
        counts = {name: 0 for name in names}
        for letter in letters:
            counts[names[letter]] += 1
        self.blocks = tuple(sorted(Block(name, count) for name, count in counts.items()))
        self.count = len(order)
        # rows of quotients, then of z of the channels by name; columns are those of w', then inputs
        self.row = [*range(quotients), *(quotients + k for k in place)]
        self.values = np.zeros((quotients + self.count, self.count + self.inputs))
        self.inverses: dict[bytes, Array] = {}  # many loops are those of one divisor

    def solve(self, unknowns: list[int]) -> None:
        """Fill in the rows of unknowns that depend on each other; all others that they need are known."""
        if len(unknowns) == 1 and unknowns[0] >= self.quotients:
            self.values[self.row[unknowns[0]]] = self._added(self._given(unknowns[0]))[0]
            return
        position = {u: k for k, u in enumerate(unknowns)}
        matrix = np.zeros((len(unknowns), len(unknowns)))
        right, size = np.zeros((2, len(unknowns), self.values.shape[1]))
        for k, u in enumerate(unknowns):
            if u >= self.quotients:
                matrix[k, k] += 1.0
            for factor, _, number in self._given(u):
                at = number - self.inputs
                if at in position:
                    through = 1.0 if at < self.quotients else self.b0[at - self.quotients]
                    matrix[k, position[at]] -= factor * through
            right[k], size[k] = self._added(self._given(u), position)
        key = matrix.tobytes()
        if key not in self.inverses:
            self.inverses[key] = _inverse(matrix)
        inverse = self.inverses[key]
        solution = inverse @ right
        size = solution_size(inverse, matrix, solution, size)
        self.values[[self.row[u] for u in unknowns]] = cleaned(solution, 0.25 * size)

    def lft(self) -> LFT:
        """The LFT, once all unknowns are solved for."""
        outputs = [self._added(terms)[0] for terms in self.words.outputs[self.quotients :]]
        read = np.array(outputs).reshape(len(outputs), self.values.shape[1])
        n = self.count
        inner = self.values[self.quotients :]
        at = [row - self.quotients for row in self.row[self.quotients :]]
        inner[at, at] -= self.a1
        return LFT(inner[:, :n], inner[:, n:], read[:, :n], read[:, n:], self.blocks)

    def _given(self, unknown: int) -> Sequence[Term]:
        """The row that an unknown follows from: the loop of a quotient, or z."""
        if unknown < self.quotients:
            return self.words.outputs[unknown]
        return self.words.items[unknown - self.quotients].terms

    def _added(self, terms: Sequence[Term], unknowns: Container[int] = ()) -> tuple[Array, Array]:
        """A sum without its terms in b0 z and y of unknowns, and its size if nothing cancelled."""
        total, size = np.zeros((2, self.values.shape[1]))
        for factor, _, number in terms:
            at, through = number - self.inputs, factor
            if at < 0:
                total[self.count + number] += factor
                size[self.count + number] += abs(factor)
                continue
            if at >= self.quotients:
                item = at - self.quotients
                direct, column = factor * self.gain[item], self.row[at] - self.quotients
                total[column] += direct
                size[column] += abs(direct)
                through = factor * self.b0[item]
            if at not in unknowns and through:
                term = through * self.values[self.row[at]]
                total += term
                size += np.abs(term, out=term)
        if len(terms) > 1:  # what is left of terms that cancel
            total[np.abs(total) <= ROUNDING * size] = 0.0
        return total, size


def _letter(item: Item) -> int:
    assert item.letter is not None
    return item.letter


def _components(words: Words, quotients: int) -> Iterator[list[int]]:
    """Unknowns that depend on each other, after all that they need; numbered as in `_Channels`."""
    inputs = words.inputs - quotients
    needs = [
        [number - inputs for _, _, number in terms if number >= inputs]
        for terms in (*words.outputs[:quotients], *(item.terms for item in words.items))
    ]
    if not quotients:
        yield from ([k] for k in range(len(needs)))
        return
    ends = np.cumsum([0, *(len(need) for need in needs)])
    columns: NDArray[np.int64] = np.array([k for need in needs for k in need], dtype=int)
    graph = csr_array((np.ones(len(columns)), columns, ends), shape=(len(needs), len(needs)))
    count, label = connected_components(graph, connection="strong")
    members: list[list[int]] = [[] for _ in range(count)]
    for k, owner in enumerate(label.tolist()):
        members[owner].append(k)
    # depth first: a component comes after all that it reads from
    done = [False] * count
    for start in range(count):
        waiting = [start]
        while waiting:
            current = waiting[-1]
            before = {int(label[k]) for u in members[current] for k in needs[u]} - {current}
            open_ = [component for component in before if not done[component]]
            if open_:
                waiting += open_
                continue
            waiting.pop()
            if not done[current]:
                done[current] = True
                yield members[current]


def _inverse(matrix: Array) -> Array:
    """matrix^-1, or an error that says the model is not well posed at nominal."""
    try:
        inverse = np.asarray(np.linalg.inv(matrix), dtype=float)
    except np.linalg.LinAlgError:
        inverse = np.full_like(matrix, np.nan)
    if not np.all(np.isfinite(inverse)):
        raise WellPosednessError(
            "a denominator vanishes at the nominal values of the parameters, so there is no linear "
            "fractional form around them. Move the nominal values."
        )
    return inverse
