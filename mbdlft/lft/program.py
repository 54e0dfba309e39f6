"""An LFT as a straight-line program of sums, products and quotients of its deltas.

Channels are closed one by one: with s = delta_i / (1 - delta_i T_ii),

    T_kl := T_kl + T_ki s T_il    for all k, l other than i,    T = [M11 M12 ; M21 M22] at the start,

and what is left when all channels are closed is the value. Entries stay numbers until a delta reaches
them, and most stay zero: the channel that fills least is taken next (Markowitz 1957). Equal terms are
computed once. An instruction is done for many samples before the next one is.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from mbdlft.lft.lft import LFT

Operand = int | float  # a register, or a number

ADD, SUBTRACT, MULTIPLY, DIVIDE, SIZE = "add", "subtract", "multiply", "divide", "size"
ROOT, COSINE, SINE = (
    "root",
    "cosine",
    "sine",
)  # not in an LFT: of other functions that are run like one


class Instruction(NamedTuple):
    """target := left operation right; `SIZE` is |left|, and like roots and cosines has no right side."""

    operation: str
    target: int
    left: Operand
    right: Operand


class Pivot(NamedTuple):
    """1 - delta_i T_ii, and the size of the terms it was added up from: registers."""

    value: int
    size: int


@dataclass(frozen=True, slots=True)
class Program:
    """Values of an LFT from its deltas.

    Attributes
    ----------
    inputs : number of deltas; they are registers 0, 1, ...
    instructions : tuple of Instruction
    entries : tuple of ((row, column), register)
        Entries of the value that depend on a delta; the others are those of M22.
    pivots : tuple of Pivot
        Where one of them is small beside its size, digits are lost.
    """

    inputs: int
    instructions: tuple[Instruction, ...]
    entries: tuple[tuple[tuple[int, int], int], ...]
    pivots: tuple[Pivot, ...]


class _TooLongError(Exception):
    """The program has more instructions than it may have."""


class Tape:
    """Instructions that are written once each; sums and products of numbers are computed at once."""

    def __init__(self, inputs: int, most: int) -> None:
        self.inputs, self.most = inputs, most
        self.instructions: list[Instruction] = []
        self.known: dict[tuple[str, Operand, Operand], int] = {}

    def put(self, operation: str, left: Operand, right: Operand = 0.0) -> int:
        if operation in (ADD, MULTIPLY) and (type(left) is float, left) > (
            type(right) is float,
            right,
        ):
            left, right = right, left
        key = (operation, left, right)
        # 1 and 1.0 are the same key, a register and a number are not the same
        typed = (f"{operation}{type(left) is int}{type(right) is int}", left, right)
        if typed not in self.known:
            if len(self.instructions) >= self.most:
                raise _TooLongError
            target = self.inputs + len(self.instructions)
            self.instructions.append(Instruction(key[0], target, left, right))
            self.known[typed] = target
        return self.known[typed]

    def add(self, a: Operand, b: Operand) -> Operand:
        if isinstance(a, float) and isinstance(b, float):
            return a + b
        if a == 0.0 and isinstance(a, float):
            return b
        if b == 0.0 and isinstance(b, float):
            return a
        return self.put(ADD, a, b)

    def multiply(self, a: Operand, b: Operand) -> Operand:
        if isinstance(a, float) and isinstance(b, float):
            return a * b
        if isinstance(a, float):
            a, b = b, a
        if isinstance(b, float) and b in (0.0, 1.0):
            return a if b else 0.0
        return self.put(MULTIPLY, a, b)

    def add_product(self, a: Operand, b: Operand, c: Operand) -> Operand:
        """a + b c, without a product where b or c is 1 or -1."""
        for one, other in ((b, c), (c, b)):
            if isinstance(one, float) and one == -1.0 and not isinstance(other, float):
                return self.put(SUBTRACT, a, other)
        return self.add(a, self.multiply(b, c))

    def size(self, a: Operand) -> Operand:
        return abs(a) if isinstance(a, float) else self.put(SIZE, a)


def program(a: LFT, most: int) -> Program | None:
    """The program of an LFT, or nothing if it would have more than `most` instructions."""
    tape = Tape(len(a.blocks), most)
    try:
        entries, pivots = _close(a, tape)
    except _TooLongError:
        return None
    return Program(tape.inputs, tuple(tape.instructions), entries, pivots)


def _close(a: LFT, tape: Tape) -> tuple[tuple[tuple[tuple[int, int], int], ...], tuple[Pivot, ...]]:
    """Close all channels; the entries of the value that depend on deltas, and the pivots."""
    n = a.order
    delta = np.repeat(np.arange(len(a.blocks)), [block.size for block in a.blocks])
    rows, columns = _sparse(np.block([[a.M11, a.M12], [a.M21, a.M22]]))
    terms: dict[int, Operand] = {i: abs(rows[i].get(i, 0.0)) for i in range(n)}
    pivots: dict[Pivot, None] = {}
    left = set(range(n))
    while left:
        i = min(left, key=lambda k: (_fill(rows, columns, k), k))
        left.discard(i)
        row, column = rows.pop(i), columns.pop(i)
        own = row.pop(i, 0.0)
        column.discard(i)
        for k in row:
            columns[k].discard(i)
        factors = {k: rows[k].pop(i) for k in sorted(column)}
        if not row or not factors:
            continue
        s: Operand = int(delta[i])
        if not (isinstance(own, float) and own == 0.0):
            pivot = tape.put(SUBTRACT, 1.0, tape.multiply(s, own))
            size = tape.add(1.0, tape.multiply(tape.size(s), terms[i]))
            assert isinstance(size, int)
            pivots[Pivot(pivot, size)] = None
            s = tape.put(DIVIDE, s, pivot)
        # the shorter side takes the factor s
        if len(row) <= len(factors):
            row = {k: tape.multiply(s, value) for k, value in row.items()}
        else:
            factors = {k: tape.multiply(s, value) for k, value in factors.items()}
        for k, factor in factors.items():
            for column_of, value in row.items():
                if k < n and k == column_of:
                    product = tape.multiply(factor, value)
                    terms[k] = tape.add(terms[k], tape.size(product))
                rows[k][column_of] = tape.add_product(rows[k].get(column_of, 0.0), factor, value)
                columns[column_of].add(k)
    entries = tuple(
        ((k - n, j - n), value)
        for k in range(n, n + a.shape[0])
        for j, value in sorted(rows[k].items())
        if isinstance(value, int)
    )
    return entries, tuple(pivots)


def _sparse(matrix: np.ndarray) -> tuple[dict[int, dict[int, Operand]], dict[int, set[int]]]:
    """Entries of each row by column, and the rows of each column."""
    rows: dict[int, dict[int, Operand]] = {k: {} for k in range(matrix.shape[0])}
    columns: dict[int, set[int]] = {k: set() for k in range(matrix.shape[1])}
    for k, j in np.argwhere(matrix != 0.0).tolist():
        rows[k][j] = float(matrix[k, j])
        columns[j].add(k)
    return rows, columns


def _fill(rows: dict[int, dict[int, Operand]], columns: dict[int, set[int]], i: int) -> int:
    """Products that closing a channel takes; one whose own entry is zero needs no quotient."""
    own = i in rows[i]
    return (len(rows[i]) - own) * (len(columns[i]) - own) + 2 * own
