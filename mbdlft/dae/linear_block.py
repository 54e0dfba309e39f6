"""Linear equations with parameters, solved by elimination and Cramer's rule: rational expressions."""

from fractions import Fraction

import casadi as ca

from mbdlft.dae.alias import rational
from mbdlft.problem.sx.constants import is_constant

_SMALL = Fraction(1, 8)
_MOST_CRAMER = 6  # unknowns; more are eliminated by entries with parameters, too


def solved_linear(matrix: ca.SX, right: ca.SX) -> list[ca.SX]:
    """The solution (n,) of linear equations whose entries are rational in the parameters.

    Entries that are numbers are pivots first, those of short rows before others; they vanish nowhere.
    What is left has Cramer's rule if it is small: no more is divided by than its determinant.
    """
    n = matrix.shape[0]
    rows = [{j: matrix[i, j] for j in range(n) if matrix.sparsity().has_nz(i, j)} for i in range(n)]
    sides = [ca.SX(right[i]) for i in range(n)]
    left, order = set(range(n)), []
    while left:
        pivot = _pivot(rows, left, any_entry=len(left) > _MOST_CRAMER)
        if pivot is None:
            break
        i, j = pivot
        left.discard(i)
        order.append((i, j))
        for k in left:
            if j in rows[k]:
                factor = rows[k].pop(j) / rows[i][j]
                for m, entry in rows[i].items():
                    if m != j:
                        rows[k][m] = rows[k].get(m, ca.SX(0)) - factor * entry
                rows[k] = {m: entry for m, entry in rows[k].items() if not _is_nothing(entry)}
                sides[k] = sides[k] - factor * sides[i]
    found = _by_cramer(rows, sides, sorted(left), {j for _, j in order}, n)
    for i, j in reversed(order):
        rest = sides[i]
        for m, entry in rows[i].items():
            if m != j:
                rest = rest - entry * found[m]
        found[j] = rest / rows[i][j]
    return [ca.SX(found[j]) for j in range(n)]


def _is_nothing(entry: ca.SX) -> bool:
    return bool(entry.is_zero()) or (is_constant(entry) and rational(entry) == 0)


def _pivot(
    rows: list[dict[int, ca.SX]], left: set[int], *, any_entry: bool
) -> tuple[int, int] | None:
    """Row and column of a number, of the shortest row; of another entry if none is a number.

    Numbers that are small beside others of their row come last.
    """
    found = []
    for i in left:
        numbers = {j: abs(x) for j, e in rows[i].items() if is_constant(e) and (x := rational(e))}
        largest = max(numbers.values(), default=0)
        found += [(_SMALL * largest > x, len(rows[i]), i, j) for j, x in numbers.items()]
    if not found and any_entry:
        found = [(False, len(rows[i]), i, j) for i in left for j in rows[i]]
    return min(found)[2:] if found else None


def _by_cramer(
    rows: list[dict[int, ca.SX]], sides: list[ca.SX], left: list[int], gone: set[int], n: int
) -> dict[int, ca.SX]:
    columns = [j for j in range(n) if j not in gone]
    if not left:
        return {}
    matrix = ca.SX.zeros(len(left), len(left))
    for k, i in enumerate(left):
        for j, entry in rows[i].items():
            matrix[k, columns.index(j)] = entry
    whole, found = ca.det(matrix), {}
    for k, j in enumerate(columns):
        replaced = ca.SX(matrix)
        replaced[:, k] = ca.vertcat(*(sides[i] for i in left))
        found[j] = ca.det(replaced) / whole
    return found
