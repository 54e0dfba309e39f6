"""Which sparse rows are combinations of the rows before them, decided exactly."""

import heapq

from mbdlft.number.exact import Exact

Row = dict[int, Exact]  # entries by column, none of them zero


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
        """Factors of earlier rows that add up to this one; None if there are none: then it is added.

        Parameters
        ----------
        number : of this row
        row : entries by column
        """
        new = row.keys() - self.seen
        if new:
            own = max(new)
            self.owner[own] = (len(self.owner), number)
        else:
            left, factors = self._subtracted(row)
            if not left:
                return factors
            self.rests.append((max(left), number, left, factors))
        self.rows[number] = row
        self.seen.update(row)
        return None

    def _subtracted(self, row: Row) -> tuple[Row, Row]:
        """What is left of a row, and factors of the rows that were subtracted."""
        owner, left = self.owner, dict(row)
        factors: Row = {}
        waiting = [(-owner[c][0], c) for c in row if c in owner]
        heapq.heapify(waiting)
        while waiting:
            _, column = heapq.heappop(waiting)
            if column not in left:  # met twice, or cancelled
                continue
            number = owner[column][1]
            entries = self.rows[number]
            factors[number] = factor = left[column] / entries[column]
            for c in subtract(left, entries, factor):
                if c in owner:
                    heapq.heappush(waiting, (-owner[c][0], c))
        for pivot, number, rest, made_of in self.rests:
            if pivot in left:
                factor = left[pivot] / rest[pivot]
                subtract(left, rest, factor)
                subtract(factors, made_of, factor)
                factors[number] = factor
        return left, factors


def subtract(row: Row, other: Row, factor: Exact) -> list[int]:
    """Subtract a multiple of another row in place; columns that are new."""
    # the two parts of the numbers are written out: this is where most of the time goes
    new, ball, residue = [], -factor.ball, -factor.residue
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
