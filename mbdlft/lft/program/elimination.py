"""Elimination on a tape: linear equations, and LFTs, as straight-line programs.

Linear equations are eliminated in an order that is chosen once for all samples: that of least fill
(Markowitz 1957) among pivots that are large enough, beside the other entries of their column, at all of
some probes (threshold pivoting, Duff, Erisman, Reid 1986). Each pivot is kept with the size of these
entries, and with a small part of the terms it was added up from: a sample is seen at which another order
is better, or at which nearly all digits of a pivot have cancelled.

The channels of an LFT are closed one by one: with s = delta_i / (1 - delta_i T_ii),

    T_kl := T_kl + T_ki s T_il    for all k, l other than i,    T = [M11 M12 ; M21 M22] at the start,

and what is left when all channels are closed is the value. Entries stay numbers until a delta reaches
them, and most stay zero: the channel that fills least is taken next. Equal terms are computed once.
"""

from collections.abc import Sequence

import numpy as np

from mbdlft.base.array import Array
from mbdlft.lft.lft import LFT
from mbdlft.lft.program.tape import (
    DIVIDE,
    SUBTRACT,
    Operand,
    Pivot,
    Program,
    Tape,
    TooLongError,
    is_number,
)

Sparse = list[dict[int, Operand]]  # rows by column, without zeros

_LARGE = 0.25  # of the largest entry of its column, if rows are divided by theirs: a pivot
_CANCELLED = 2.0**-15  # of its terms, beside `run.LOST`: twenty binary digits are lost


def sparse(entries: Sequence[Sequence[Operand]]) -> Sparse:
    """Rows without their zeros."""
    return [{j: x for j, x in enumerate(row) if not is_number(x, 0.0)} for row in entries]


def solve(tape: Tape, matrix: Sparse, right: Sparse, probes: Array) -> tuple[Sparse, list[Pivot]] | None:
    """matrix^-1 right, as rows, and pivots; None if singular at a probe, one of the values (N, n, n)."""
    n = len(matrix)
    rows, sides = [dict(row) for row in matrix], [dict(row) for row in right]
    terms: dict[tuple[int, int], list[Operand]] = {}
    # the largest entry of each row (n,), as a power of two
    sizes = np.exp2(np.ceil(np.log2(np.max(np.abs(probes), axis=(0, 2), initial=1e-300))))
    values = probes / sizes[None, :, None]
    open_rows, open_columns = set(range(n)), set(range(n))
    steps: list[tuple[int, int]] = []
    pivots: list[Pivot] = []
    while open_rows:
        place = _pivot(rows, values, open_rows, open_columns)
        if place is None:
            return None
        i, j = place
        open_rows.discard(i)
        open_columns.discard(j)
        steps.append(place)
        pivot = rows[i].pop(j)
        below = [k for k in sorted(open_rows) if j in rows[k]]
        others = [(sizes[i] / sizes[k], rows[k][j]) for k in below]
        pivots += _kept(tape, pivot, [matrix[i].get(j, 0.0), *terms.get(place, [])], others)
        inverse = tape.divide(1.0, pivot)
        for row in (rows[i], sides[i]):
            row.update({k: tape.multiply(entry, inverse) for k, entry in row.items()})
        values[:, i] /= values[:, i, j, None]
        for other in below:
            factor = rows[other].pop(j)
            for k in rows[i]:
                terms.setdefault((other, k), []).append(tape.multiply(factor, rows[i][k]))
            _subtract(tape, rows[other], factor, rows[i])
            _subtract(tape, sides[other], factor, sides[i])
            values[:, other] -= values[:, other, j, None] * values[:, i]
    return _substituted(tape, rows, sides, steps), pivots


def _subtract(tape: Tape, row: dict[int, Operand], factor: Operand, other: dict[int, Operand]) -> None:
    """row - factor other, in place."""
    for k, entry in other.items():
        _put(row, k, tape.subtract(row.get(k, 0.0), tape.multiply(factor, entry)))


def _pivot(
    rows: Sparse, values: Array, open_rows: set[int], open_columns: set[int]
) -> tuple[int, int] | None:
    """The next pivot: least fill among those that are large enough at all probes."""
    counts = dict.fromkeys(open_columns, 0)
    for i in open_rows:
        for j in rows[i]:
            counts[j] += 1
    among = sorted(open_rows)
    largest = np.max(np.abs(values[:, among]), axis=1)
    best: tuple[float, float, int, int] | None = None
    for i in among:
        sizes = np.abs(values[:, i])
        for j in rows[i]:
            if not np.all(sizes[:, j] > 0.0):
                continue
            share = float(np.min(sizes[:, j] / largest[:, j]))
            fill = (len(rows[i]) - 1) * (counts[j] - 1)
            # none is large: the largest one
            key = (float(fill), 0.0, i, j) if share >= _LARGE else (np.inf, -share, i, j)
            if best is None or key < best:
                best = key
    return None if best is None else (best[2], best[3])


def _kept(
    tape: Tape, pivot: Operand, terms: Sequence[Operand], others: Sequence[tuple[float, Operand]]
) -> list[Pivot]:
    """A pivot that depends on samples, and what it has to be large beside."""
    if isinstance(pivot, float):
        return []
    size: Operand = 0.0
    if len(terms) > 1:
        for term in terms:
            size = tape.add(size, tape.size(term))
        size = tape.multiply(size, _CANCELLED)
    for factor, entry in others:
        size = tape.maximum(size, tape.multiply(tape.size(entry), float(factor)))
    return [Pivot(pivot, size)] if isinstance(size, int) else []


def _put(row: dict[int, Operand], k: int, entry: Operand) -> None:
    if is_number(entry, 0.0):
        row.pop(k, None)
    else:
        row[k] = entry


def _substituted(tape: Tape, rows: Sparse, sides: Sparse, steps: Sequence[tuple[int, int]]) -> Sparse:
    """The unknowns from the last one to the first."""
    unknowns: Sparse = [{} for _ in rows]
    for i, j in reversed(steps):
        unknowns[j] = dict(sides[i])
        for k, factor in rows[i].items():
            _subtract(tape, unknowns[j], factor, unknowns[k])
    return unknowns


def product(tape: Tape, left: Sparse, right: Sparse) -> Sparse:
    """left right, of rows."""
    rows: Sparse = [{} for _ in left]
    for total, row in zip(rows, left, strict=True):
        for k, factor in row.items():
            for j, entry in right[k].items():
                _put(total, j, tape.add_product(total.get(j, 0.0), factor, entry))
    return rows


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
    """Close all channels, with the registers `deltas` of the blocks: entries of the value, and pivots."""
    n = a.order
    delta = np.repeat(np.asarray(deltas, dtype=int), [block.size for block in a.blocks])
    rows, columns = _sparse(np.block([[a.M11, a.M12], [a.M21, a.M22]]))
    terms: dict[int, Operand] = {i: abs(rows[i].get(i, 0.0)) for i in range(n)}
    pivots: dict[Pivot, None] = {}
    open_ = set(range(n))
    while open_:
        i = min(open_, key=lambda k: (_fill(rows, columns, k), k))
        open_.discard(i)
        row, column = rows.pop(i), columns.pop(i)
        diagonal = row.pop(i, 0.0)
        column.discard(i)
        for k in row:
            columns[k].discard(i)
        factors = {k: rows[k].pop(i) for k in sorted(column)}
        if not row or not factors:
            continue
        s: Operand = int(delta[i])
        if not is_number(diagonal, 0.0):
            pivot = tape.put(SUBTRACT, 1.0, tape.multiply(s, diagonal))
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
    on_diagonal = i in rows[i]
    return (len(rows[i]) - on_diagonal) * (len(columns[i]) - on_diagonal) + 2 * on_diagonal
