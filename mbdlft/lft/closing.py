"""An LFT as a straight-line program of sums, products and quotients of its deltas.

Channels are closed one by one: with s = delta_i / (1 - delta_i T_ii),

    T_kl := T_kl + T_ki s T_il    for all k, l other than i,    T = [M11 M12 ; M21 M22] at the start,

and what is left when all channels are closed is the value. Entries stay numbers until a delta reaches
them, and most stay zero: the channel that fills least is taken next (Markowitz 1957). Equal terms are
computed once. An instruction is done for many samples before the next one is.
"""

from collections.abc import Sequence

import numpy as np

from mbdlft.lft.lft import LFT
from mbdlft.lft.program.tape import DIVIDE, SUBTRACT, Operand, Pivot, Program, Tape, TooLongError


def program(a: LFT, most: int) -> Program | None:
    """The program of an LFT, or nothing if it would have more than `most` instructions."""
    tape = Tape(len(a.blocks), most)
    try:
        entries, pivots = closed(a, tape, range(len(a.blocks)))
    except TooLongError:
        return None
    return Program(tape.inputs, tuple(tape.instructions), entries, pivots)


def closed(
    a: LFT, tape: Tape, deltas: Sequence[int]
) -> tuple[tuple[tuple[tuple[int, int], int], ...], tuple[Pivot, ...]]:
    """Close all channels; the entries of the value that depend on deltas, and the pivots.

    `deltas` are the registers of the blocks.
    """
    n = a.order
    delta = np.repeat(np.asarray(deltas, dtype=int), [block.size for block in a.blocks])
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
