"""Dummy derivatives: which derivatives stay derivatives of states, by pivots at several points.

In each block of the equations at their highest order, the equations that were differentiated determine
as many of the highest derivatives; these become algebraic variables. Then the same one order lower.

Source: S. E. Mattsson, G. Soderlind, Index reduction in differential-algebraic equations using dummy
derivatives, SIAM J. Sci. Comput. 14 (1993).
"""

from collections.abc import Callable, Collection, Sequence
from functools import cache
from typing import NamedTuple

import casadi as ca
import numpy as np
from scipy.linalg import qr

from mbdlft.base.array import Array
from mbdlft.base.errors import StructureError
from mbdlft.dae.exact_rank import singular_part
from mbdlft.dae.index import Differentiated, Entry, Row, listed, name_of, place_of
from mbdlft.dae.operations import column_of
from mbdlft.problem.sx.constants import in_doubles

_RANK = 1e-9  # of the largest pivot: a smaller one is no pivot
_KEPT = 3  # the class of variables that are no derivatives: none of them becomes algebraic


class Block(NamedTuple):
    """Positions of equations, and of the unknowns that they determine."""

    rows: tuple[int, ...]
    columns: tuple[int, ...]


def blocks_of(pattern: ca.Sparsity) -> tuple[Block, ...]:
    """The block-triangular order of a square pattern: later blocks need earlier ones."""
    if not pattern.size1():
        return ()
    count, rows, columns, r, c, _, _ = pattern.btf()
    found = [
        Block(tuple(rows[r[k] : r[k + 1]]), tuple(columns[c[k] : c[k + 1]])) for k in range(count)
    ]
    return tuple(found)


def dummy_derivatives(
    d: Differentiated,
    signals: Sequence[ca.SX],
    points: Callable[[], Sequence[Array]],
    wanted: Collection[str],
) -> set[Entry]:
    """The derivatives that become algebraic variables.

    Parameters
    ----------
    d : Differentiated
    signals : all symbols of the equations but parameters, then these
    points : function without arguments
        Values of these at some points.
    wanted : names of states that are kept if there is a choice

    Raises
    ------
    StructureError
        The equations at their highest order are singular: which and in which unknowns.
    """
    dae, n = d.dae, len(d.dae.equations)
    rows = [Row(i, d.counts[i]) for i in range(n)]
    entries = [Entry(j, d.orders[j]) for j in range(n)]
    residuals = column_of(d.residuals[row] for row in rows)
    unknown = column_of(d.symbols[entry] for entry in entries)
    jacobian = ca.jacobian(residuals, unknown)
    free = column_of(signals)
    own = signals[: len(signals) - len(dae.parameters)]

    @cache
    def matrices() -> list[Array]:
        function = ca.Function("jacobian", [free], [in_doubles(jacobian)])
        return [function(point).full() for point in points()]

    dummies: set[Entry] = set()
    for block in blocks_of(jacobian.sparsity()):
        part = jacobian[list(block.rows), list(block.columns)]
        alone = len(block.rows) == 1 and part.nnz() and not ca.symvar(ca.SX(part.nz[0]))
        if not alone:
            _check_regular(d, part, own, points, [rows[i] for i in block.rows], block, entries)
        if any(d.counts[i] for i in block.rows):
            at = [m[np.ix_(block.rows, block.columns)] for m in matrices()]
            chosen = [(rows[i].order) for i in block.rows]
            dummies |= _selected(d, at, chosen, [entries[j] for j in block.columns], wanted)
    return dummies


def _check_regular(
    d: Differentiated,
    part: ca.SX,
    own: Sequence[ca.SX],
    points: Callable[[], Sequence[Array]],
    rows: Sequence[Row],
    block: Block,
    entries: Sequence[Entry],
) -> None:
    signals = column_of(own)
    found = singular_part(part, signals, d.dae.p, points)
    if found is None:
        return
    dae = d.dae
    unknowns = [entries[block.columns[j]] for j in found.columns]
    names = [name_of(dae.variables[j].name, order) for j, order in unknowns]
    certain = "whatever the parameters are" if found.exact else "at all points that were tried"
    raise StructureError(
        f"{dae.owner}: is singular, {certain}: the equations "
        f"{listed(place_of(dae, rows[i]) for i in found.rows)} depend on each other, and do not "
        f"determine {listed(names)}. Remove what is said twice, and give the unknowns an equation."
    )


def _selected(
    d: Differentiated,
    matrices: Sequence[Array],
    orders: Sequence[int],
    entries: Sequence[Entry],
    wanted: Collection[str],
) -> set[Entry]:
    """The dummy derivatives of one block, level by level."""
    found: set[Entry] = set()
    now, left, columns = list(matrices), list(orders), list(entries)
    while any(left):
        rows = [i for i, order in enumerate(left) if order]
        parts = [m[rows] for m in now]
        chosen = _columns(d, parts, columns, wanted)
        found |= {columns[j] for j in chosen}
        now = [part[:, chosen] for part in parts]
        left = [left[i] - 1 for i in rows]
        columns = [Entry(columns[j].variable, columns[j].order - 1) for j in chosen]
    return found


def _columns(
    d: Differentiated, parts: Sequence[Array], entries: Sequence[Entry], wanted: Collection[str]
) -> list[int]:
    """Columns, as many as rows, with which all matrices (m, k) are regular."""
    sizes = np.array([d.dae.variables[j].nominal for j, _ in entries])
    classes = np.array([_class(d, entry, wanted) for entry in entries])
    count = len(parts[0])
    best, least = None, 0.0
    for part in parts:
        chosen = _by_pivots(part * sizes, classes, count)
        if chosen is None:
            continue
        worst = min(_smallest(other[:, chosen] * sizes[chosen]) for other in parts)
        if best is None or worst > 2.0 * least:
            best, least = chosen, worst
    if best is None:
        names = [name_of(d.dae.variables[j].name, order) for j, order in entries]
        raise StructureError(
            f"{d.dae.owner}: differentiated constraints depend on each other, in {listed(names)}: there "
            "are more constraints than degrees of freedom. Remove one."
        )
    return best


def _class(d: Differentiated, entry: Entry, wanted: Collection[str]) -> int:
    """Lower classes become algebraic first: what is asked for stays, then what has a name of its own."""
    if entry.order == 0:
        return _KEPT
    if name_of(d.dae.variables[entry.variable].name, entry.order - 1) in wanted:
        return 2
    return 0 if entry.order > 1 else 1


def _by_pivots(matrix: Array, classes: Array, count: int) -> list[int] | None:
    """Pivot columns of the lowest classes, but the last, that give the full rank."""
    rows = np.max(np.abs(matrix), axis=1, keepdims=True)
    columns = np.flatnonzero(classes < _KEPT)
    scaled = matrix[:, columns] / np.where(rows > 0, rows, 1.0)
    chosen = [int(columns[k]) for k in independent(scaled, classes[columns])]
    return chosen if len(chosen) == count else None


def independent(matrix: Array, classes: Array) -> list[int]:
    """Independent columns, of the lowest classes first."""
    rest, chosen = matrix, []
    for kind in sorted(set(classes.tolist())):
        columns = np.flatnonzero(classes == kind)
        if not len(rest):
            break
        q, triangle, order = qr(rest[:, columns], pivoting=True)
        pivots = np.abs(np.diag(triangle))
        count = int(np.sum(pivots > _RANK * max(1.0, np.max(pivots, initial=0.0))))
        chosen += [int(columns[k]) for k in order[:count]]
        rest = q[:, count:].T @ rest
    return sorted(chosen)


def _smallest(matrix: Array) -> float:
    """The least singular value of a matrix with rows and columns of one size."""
    rows = np.linalg.norm(matrix, axis=1, keepdims=True)
    scaled = matrix / np.where(rows > 0, rows, 1.0)
    columns = np.linalg.norm(scaled, axis=0)
    values = np.linalg.svd(scaled / np.where(columns > 0, columns, 1.0), compute_uv=False)
    return float(values[-1])
