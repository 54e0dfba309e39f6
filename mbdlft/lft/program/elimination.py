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
from mbdlft.lft.program.tape import DIVIDE, SUBTRACT, Operand, Pivot, Program, Tape, TooLongError

Sparse = list[dict[int, Operand]]  # rows by column, without zeros

_LARGE = 0.25  # of the largest entry of its column, if rows are divided by theirs: a pivot
_CANCELLED = 2.0**-15  # of its terms, beside `run.LOST`: twenty binary digits are lost


def sparse(entries: Sequence[Sequence[Operand]]) -> Sparse:
    """Rows without their zeros."""
    return [{j: one for j, one in enumerate(row) if not is_zero(one)} for row in entries]


def is_zero(one: Operand) -> bool:
    """Whether an operand is the number zero."""
    return isinstance(one, float) and one == 0.0


def solve(
    tape: Tape, matrix: Sparse, right: Sparse, probes: Array
) -> tuple[Sparse, list[Pivot]] | None:
    """matrix^-1 right, and the pivots; None if the matrix is singular at a probe.

    Parameters
    ----------
    tape : Tape
    matrix : rows of n equations by unknown
    right : rows of n equations by right side
    probes : array (N, n, n)
        Values of the matrix at some samples.

    Returns
    -------
    rows of n unknowns by right side, and the pivots
    """
    n = len(matrix)
    rows, sides = [dict(row) for row in matrix], [dict(row) for row in right]
    terms: dict[tuple[int, int], list[Operand]] = {}
    sizes = _sizes(probes)
    values = probes / sizes[None, :, None]
    left_rows, left_columns = set(range(n)), set(range(n))
    steps: list[tuple[int, int]] = []
    pivots: list[Pivot] = []
    while left_rows:
        place = _pivot(rows, values, left_rows, left_columns)
        if place is None:
            return None
        i, j = place
        left_rows.discard(i)
        left_columns.discard(j)
        steps.append(place)
        pivot = rows[i].pop(j)
        others = [(sizes[i] / sizes[k], rows[k][j]) for k in sorted(left_rows) if j in rows[k]]
        pivots += _kept(tape, pivot, [matrix[i].get(j, 0.0), *terms.get(place, [])], others)
        inverse = tape.divide(1.0, pivot)
        rows[i] = {k: tape.multiply(one, inverse) for k, one in rows[i].items()}
        sides[i] = {k: tape.multiply(one, inverse) for k, one in sides[i].items()}
        values[:, i] /= values[:, i, j, None]
        for other in sorted(left_rows):
            if j not in rows[other]:
                continue
            factor = rows[other].pop(j)
            for k, one in rows[i].items():
                product = tape.multiply(factor, one)
                terms.setdefault((other, k), []).append(product)
                _put(rows[other], k, tape.subtract(rows[other].get(k, 0.0), product))
            for k, one in sides[i].items():
                product = tape.multiply(factor, one)
                _put(sides[other], k, tape.subtract(sides[other].get(k, 0.0), product))
            values[:, other] -= values[:, other, j, None] * values[:, i]
    return _substituted(tape, rows, sides, steps), pivots


def _sizes(probes: Array) -> Array:
    """The largest entry of each row (n,), a power of two."""
    sizes = np.exp2(np.ceil(np.log2(np.max(np.abs(probes), axis=(0, 2), initial=1e-300))))
    return np.asarray(sizes)


def _pivot(
    rows: Sparse, values: Array, left_rows: set[int], left_columns: set[int]
) -> tuple[int, int] | None:
    """The next pivot: least fill among those that are large enough at all probes."""
    counts = dict.fromkeys(left_columns, 0)
    for i in left_rows:
        for j in rows[i]:
            counts[j] += 1
    among = sorted(left_rows)
    largest = np.max(np.abs(values[:, among]), axis=1)
    best: tuple[float, float, int, int] | None = None
    for i in among:
        own = np.abs(values[:, i])
        for j in rows[i]:
            if not np.all(own[:, j] > 0.0):
                continue
            part = float(np.min(own[:, j] / largest[:, j]))
            fill = (len(rows[i]) - 1) * (counts[j] - 1)
            # none is large: the largest one
            key = (float(fill), 0.0, i, j) if part >= _LARGE else (np.inf, -part, i, j)
            if best is None or key < best:
                best = key
    return None if best is None else (best[2], best[3])


def _kept(
    tape: Tape,
    pivot: Operand,
    terms: Sequence[Operand],
    others: Sequence[tuple[float, Operand]],
) -> list[Pivot]:
    """A pivot that depends on samples, and what it has to be large beside."""
    if isinstance(pivot, float):
        return []
    size: Operand = 0.0
    if len(terms) > 1:
        for term in terms:
            size = tape.add(size, tape.size(term))
        size = tape.multiply(size, _CANCELLED)
    for factor, one in others:
        size = tape.maximum(size, tape.multiply(tape.size(one), float(factor)))
    return [Pivot(pivot, size)] if isinstance(size, int) else []


def _put(row: dict[int, Operand], k: int, one: Operand) -> None:
    if is_zero(one):
        row.pop(k, None)
    else:
        row[k] = one


def _substituted(
    tape: Tape, rows: Sparse, sides: Sparse, steps: Sequence[tuple[int, int]]
) -> Sparse:
    """The unknowns from the last one to the first."""
    found: Sparse = [{} for _ in rows]
    for i, j in reversed(steps):
        total = dict(sides[i])
        for k, factor in rows[i].items():
            for side, one in found[k].items():
                product = tape.multiply(factor, one)
                _put(total, side, tape.subtract(total.get(side, 0.0), product))
        found[j] = total
    return found


def product(tape: Tape, left: Sparse, right: Sparse) -> Sparse:
    """left right, of rows."""
    found: Sparse = []
    for row in left:
        total: dict[int, Operand] = {}
        for k, factor in row.items():
            for j, one in right[k].items():
                _put(total, j, tape.add_product(total.get(j, 0.0), factor, one))
        found.append(total)
    return found


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
