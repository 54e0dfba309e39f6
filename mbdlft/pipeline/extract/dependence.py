"""Which sparse rows are combinations of the rows before them.

Entries are mostly small whole numbers, and then all of this is exact. With others, a row counts as a
combination only where all that is left is rounding and the factors are moderate: a row too many is
harmless, since `reduce_order` follows.
"""

import heapq
from typing import NamedTuple

import numpy as np

from mbdlft.base.array import Array
from mbdlft.number.rounding import is_rounding

Row = dict[int, float]  # entries by column

_NOTHING = 2.0**-44  # part of its terms below which an entry is left out while rows are subtracted
_CLEAR = 2.0**-8  # part of its terms, or of the largest, that an entry needs to be divided by
_MOST_FACTOR = 2.0**8  # of a row relative to the row that it is part of
_NO_ENTRIES = np.zeros(0)


class Dependence:
    """Rows that are independent, by number, in a form in which the next one is compared with them.

    Most rows are the first with an entry in some column: they are independent of all before, and that
    column is theirs. Subtracted from the youngest to the oldest, they leave nothing in their columns;
    what is then left of a row is compared in the others.
    """

    def __init__(self) -> None:
        self.rows: dict[int, Row] = {}
        self.seen: set[int] = set()
        self.owner: dict[int, tuple[int, int]] = {}  # of a column: place by age, and number
        self.others = _Reduced()

    def combination(self, number: int, row: Row) -> Row | None:
        """Factors of earlier rows that add up to this one; None if there are none: then it is added.

        Parameters
        ----------
        number : of this row
        row : entries that are not zero, by column
        """
        own = self._own(row)
        if own is None:
            found, rest = self._compared(row)
            if not rest.left.any():
                found = self._refined(row, found)
                if self._is_sum(row, found):
                    return found
            self.others.add(number, rest)
        else:
            self.owner[own] = (len(self.owner), number)
        self.rows[number] = row
        self.seen.update(row)
        return None

    def _compared(self, row: Row) -> tuple[Row, "_Rest"]:
        """Factors of rows, and what is left without them in columns without an owner."""
        left, sizes, factors = self._subtracted(row)
        rest = self.others.compared(left, sizes, factors)
        return self.others.together(rest), rest

    def _refined(self, row: Row, factors: Row) -> Row:
        """Factors without the rounding of the echelon."""
        left, _ = self._without(row, factors)
        if not left:
            return factors
        found, _ = self._compared(left)
        both = {k: factors.get(k, 0.0) + found.get(k, 0.0) for k in factors | found}
        return {k: factor for k, factor in both.items() if abs(factor) > _NOTHING}

    def _own(self, row: Row) -> int | None:
        """A column in which this row is the first, with an entry that can be divided by."""
        new = row.keys() - self.seen
        if not new:
            return None
        own = max(new, key=lambda column: (abs(row[column]), column))
        return own if _is_clear(row[own], max(map(abs, row.values()))) else None

    def _subtracted(self, row: Row) -> tuple[Row, Row, Row]:
        """What is left of a row without columns that have an owner, sizes of its terms, and factors."""
        owner = self.owner
        left, sizes = dict(row), {c: abs(value) for c, value in row.items()}
        factors: Row = {}
        waiting = [(-owner[c][0], c) for c in row if c in owner]
        heapq.heapify(waiting)
        while waiting:
            _, column = heapq.heappop(waiting)
            value = left.pop(column, 0.0)
            if value == 0.0:  # met twice, or cancelled
                continue
            number = owner[column][1]
            entries = self.rows[number]
            factors[number] = factor = value / entries[column]
            for c, entry in entries.items():
                if c == column:
                    continue
                term = factor * entry
                before = left.get(c, 0.0)
                size = sizes[c] = max(sizes.get(c, 0.0), abs(term))
                if abs(before - term) <= _NOTHING * size:
                    left.pop(c, None)
                    continue
                left[c] = before - term
                if before == 0.0 and c in owner:
                    heapq.heappush(waiting, (-owner[c][0], c))
        return left, sizes, factors

    def _is_sum(self, row: Row, factors: Row) -> bool:
        """Whether factors are moderate and rows times factors leave nothing but rounding of a row."""
        most = _MOST_FACTOR * max(map(abs, row.values()), default=0.0)
        if any(abs(f) * max(map(abs, self.rows[k].values())) > most for k, f in factors.items()):
            return False
        left, sizes = self._without(row, factors)
        return all(is_rounding(value, sizes[c]) for c, value in left.items())

    def _without(self, row: Row, factors: Row) -> tuple[Row, Row]:
        """What rows times factors leave of a row, and sizes of the terms."""
        left, sizes = dict(row), {c: abs(value) for c, value in row.items()}
        for k, factor in factors.items():
            for c, entry in self.rows[k].items():
                left[c] = left.get(c, 0.0) - factor * entry
                sizes[c] = sizes.get(c, 0.0) + abs(factor * entry)
        return {c: value for c, value in left.items() if value}, sizes


class _Rest(NamedTuple):
    """What is left of a row, sizes of its terms, factors of the echelon, and of owners of columns."""

    left: Array
    size: Array
    used: Array
    factors: Row


class _Reduced:
    """Independent rows without a column of their own at first, in reduced echelon form.

    Attributes
    ----------
    entries : array (rows, columns)
        One in the pivot of each row, and zero in the pivots of all others.
    made : array (rows, rows)
        Rows of the form = made times the rows as they came.
    """

    def __init__(self) -> None:
        self.columns: dict[int, int] = {}
        self.pivots: list[int] = []
        self.numbers: list[int] = []
        self.subtracted: list[Row] = []  # of owners of columns, from each row as it came
        self.entries, self.made = np.zeros((0, 0)), np.zeros((0, 0))

    def compared(self, row: Row, sizes: Row, factors: Row) -> _Rest:
        """What is left of a row in which `factors` of owners of columns are already subtracted."""
        if not row:
            return _Rest(_NO_ENTRIES, _NO_ENTRIES, _NO_ENTRIES, factors)
        value, size = self._spread(row, row), self._spread(row, sizes)
        by_row = value[self.pivots]
        rest = value - by_row @ self.entries
        size = np.maximum(size, np.abs(by_row) @ np.abs(self.entries))
        rest[np.abs(rest) <= _NOTHING * size] = 0.0
        rest[self.pivots] = 0.0
        return _Rest(rest, size, by_row @ self.made, factors)

    def together(self, rest: _Rest) -> Row:
        """Factors of all rows that were subtracted."""
        found = dict(rest.factors)
        for k in np.flatnonzero(rest.used).tolist():
            factor = float(rest.used[k])
            found[self.numbers[k]] = factor
            for number, part in self.subtracted[k].items():
                found[number] = found.get(number, 0.0) - factor * part
        return found

    def add(self, number: int, rest: _Rest) -> None:
        """One more row, unless what is left of it nearly cancels: no later row is compared with that."""
        clear = np.abs(rest.left) > _CLEAR * rest.size
        if not clear.any():
            return
        pivot = int(np.argmax(np.where(clear, np.abs(rest.left), 0.0)))
        row = rest.left / rest.left[pivot]
        made = np.append(-rest.used, 1.0) / rest.left[pivot]
        column = self.entries[:, pivot]
        change = np.flatnonzero(column)
        before, terms = self.entries[change], column[change, None] * row
        after = before - terms
        after[np.abs(after) <= _NOTHING * np.maximum(np.abs(before), np.abs(terms))] = 0.0
        after[:, pivot] = 0.0
        self.made = np.hstack([self.made, np.zeros((len(self.made), 1))])
        self.made[change] -= column[change, None] * made
        self.entries[change] = after
        self.entries, self.made = np.vstack([self.entries, row]), np.vstack([self.made, made])
        self.pivots.append(pivot)
        self.numbers.append(number)
        self.subtracted.append(rest.factors)

    def _spread(self, row: Row, values: Row) -> Array:
        """Values of a row in the columns that were met so far, and its own."""
        for column in row:
            self.columns.setdefault(column, len(self.columns))
        width = len(self.columns)
        if self.entries.shape[1] < width:
            more = np.zeros((len(self.entries), width - self.entries.shape[1]))
            self.entries = np.hstack([self.entries, more])
        spread = np.zeros(width)
        spread[[self.columns[column] for column in row]] = [values[column] for column in row]
        return spread


def _is_clear(value: float, size: float) -> bool:
    return abs(value) >= _CLEAR * size
