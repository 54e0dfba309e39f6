"""Index reduction: how often each equation is differentiated, and which derivatives become algebraic.

Signature method: the assignment of largest total order and its smallest dual give the differentiations
c_i of the equations and the orders d_j of the variables. The c_i are those of Pantelides' algorithm.

Dummy derivatives: in each block of the equations at their highest order, the differentiated equations
determine as many of the highest derivatives, chosen by pivots at several points; these become algebraic
variables. Then the same is done one order lower.

Sources: J. D. Pryce, A simple structural analysis method for DAEs, BIT 41 (2001); C. C. Pantelides, The
consistent initialization of differential-algebraic systems, SIAM J. Sci. Stat. Comput. 9 (1988);
S. E. Mattsson, G. Soderlind, Index reduction in differential-algebraic equations using dummy derivatives,
SIAM J. Sci. Comput. 14 (1993).
"""

from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from typing import NamedTuple

import casadi as ca
import numpy as np
from scipy.linalg import qr
from scipy.sparse import csr_array
from scipy.sparse.csgraph import min_weight_full_bipartite_matching

from mbdlft.base.array import Array
from mbdlft.base.errors import StructureError
from mbdlft.dae.dae import Dae, Variable
from mbdlft.dae.newton import divided, singular_part
from mbdlft.dae.text import column_of
from mbdlft.problem.sparse import LARGE
from mbdlft.problem.sx.constants import in_doubles

_LISTED = 12  # names in a message


class Row(NamedTuple):
    """An equation, differentiated `order` times."""

    equation: int
    order: int


class Entry(NamedTuple):
    """A variable, differentiated `order` times."""

    variable: int
    order: int


@dataclass(frozen=True, slots=True, eq=False)
class Differentiated:
    """All equations and their derivatives that determine a model."""

    dae: Dae
    counts: tuple[int, ...]  # differentiations of each equation, c_i
    orders: tuple[int, ...]  # of the highest derivative of each variable, d_j
    symbols: dict[Entry, ca.SX]
    residuals: dict[Row, ca.SX]
    input_rates: tuple[tuple[Variable, int, ca.SX], ...]  # derivatives of inputs: order, symbol

    @property
    def index(self) -> int:
        """The structural index: of an explicit ordinary differential equation it is 0."""
        return max(self.counts, default=0) + (0 if all(self.orders) else 1)


def name_of(name: str, order: int) -> str:
    """Such as x, der(x), der(x, 2)."""
    return (name, f"der({name})")[order] if order < 2 else f"der({name}, {order})"


def place_of(dae: Dae, row: Row) -> str:
    """An equation for messages, such as "derivative 2 of 'length' (line 4)"."""
    place = dae.equations[row.equation].place
    return f"derivative {row.order} of {place}" if row.order else place


def differentiated(dae: Dae, after: str = "") -> Differentiated:
    """The equations with those derivatives that the signature method asks for.

    Messages name what was taken out before: `after`, such as " after x = y".
    """
    sigma = _signature(dae)
    equations, variables = sigma.shape
    if equations != variables:
        raise StructureError(
            f"{dae.owner}: has {equations} equations for {variables} unknowns{after}. "
            + _named_parts(dae, sigma)
            + " Give each unknown an equation, or make it an input."
        )
    try:
        _, matched = min_weight_full_bipartite_matching(sigma, maximize=True) if equations else ((), ())
    except ValueError:
        raise StructureError(
            f"{dae.owner}: is structurally singular{after}. "
            + _named_parts(dae, sigma)
            + " Look for a missing or doubled equation, or a boundary that nothing is connected with."
        ) from None
    counts, orders = _offsets(dae, sigma, matched)
    symbols = _symbols(dae, orders)
    residuals, rates = _derivatives(dae, counts, symbols)
    return Differentiated(dae, counts, orders, symbols, residuals, rates)


def _signature(dae: Dae) -> csr_array:
    """1 + the highest order of each variable in each equation, where it occurs."""
    residuals = column_of(e.residual for e in dae.equations)
    sigma = csr_array((len(dae.equations), len(dae.variables)), dtype=int)
    for order, symbols in enumerate(zip(*((v.symbol, v.derivative) for v in dae.variables), strict=True)):
        known = [j for j, symbol in enumerate(symbols) if symbol is not None]
        if known and residuals.numel():
            pattern = ca.jacobian_sparsity(residuals, column_of(symbols[j] for j in known))
            rows, columns = (np.array(indices, dtype=int) for indices in pattern.get_triplet())
            places = rows, np.array(known)[columns]
            sigma = sigma.maximum(csr_array((np.full(len(rows), 1 + order), places), shape=sigma.shape))
    return sigma


def _named_parts(dae: Dae, sigma: csr_array) -> str:
    """What is over- and underdetermined, by Dulmage and Mendelsohn."""
    places = [indices.tolist() for indices in sigma.nonzero()]
    _, rows, columns, _, _, *coarse = ca.Sparsity.triplet(*sigma.shape, *places).btf()
    over, few = sorted(rows[: coarse[0][2]]), sorted(columns[coarse[1][2] :])
    sentences = []
    if few:
        equations = {i for i, j in zip(*places, strict=True) if j in {*few}}
        sentences.append(
            f"The unknowns {listed(dae.variables[j].name for j in few)} are in too few equations: "
            f"{listed(dae.equations[i].place for i in sorted(equations)) or 'none'}."
        )
    if over:
        many = {j for i, j in zip(*places, strict=True) if i in {*over}}
        sentences.append(
            f"The equations {listed(dae.equations[i].place for i in over)} are too many for "
            f"{listed(dae.variables[j].name for j in sorted(many)) or 'no unknown'}."
        )
    return " ".join(sentences)


def listed(names: Iterable[object]) -> str:
    """Names with commas; of many, the first ones."""
    every = list(names)
    more = f" and {len(every) - _LISTED} more" if len(every) > _LISTED else ""
    return ", ".join(map(str, every[:_LISTED])) + more


def _offsets(
    dae: Dae, sigma: csr_array, matched: Sequence[int]
) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """The smallest c and d with d_j - c_i >= sigma_ij, and = on the assignment."""
    n = sigma.shape[0]
    counts = np.zeros(n, dtype=int)
    entries = sigma.tocoo()
    rows, columns, of = entries.row, entries.col, entries.data - 1
    on_assignment = np.array(matched, dtype=int)[rows] == columns
    for _ in range(2 * n + 2):
        orders, differentiations = np.zeros((2, n), dtype=int)
        np.maximum.at(orders, columns, of + counts[rows])
        differentiations[rows[on_assignment]] = (orders[columns] - of)[on_assignment]
        if np.array_equal(differentiations, counts):
            return tuple(map(int, counts)), tuple(map(int, orders))
        counts = differentiations
    raise StructureError(
        f"{dae.owner}: the equations would have to be differentiated without end. Please report it."
    )


def _symbols(dae: Dae, orders: Sequence[int]) -> dict[Entry, ca.SX]:
    symbols = {}
    for j, v in enumerate(dae.variables):
        for order in range(orders[j] + 1):
            known = (v.symbol, v.derivative)[order] if order < 2 else None
            symbols[Entry(j, order)] = ca.SX.sym(name_of(v.name, order)) if known is None else known
    return symbols


def _derivatives(
    dae: Dae, counts: Sequence[int], symbols: dict[Entry, ca.SX]
) -> tuple[dict[Row, ca.SX], tuple[tuple[Variable, int, ca.SX], ...]]:
    residuals = {Row(i, 0): e.residual for i, e in enumerate(dae.equations)}
    n = len(dae.variables)
    most = max(counts, default=0)
    rates = {
        Entry(n + k, order): ca.SX.sym(name_of(u.name, order)) if order else u.symbol
        for k, u in enumerate(dae.inputs)
        for order in range(most + 1)
    }
    signals = symbols | rates
    moving = [entry for entry in signals if Entry(entry.variable, entry.order + 1) in signals]
    symbols_now = column_of(signals[entry] for entry in moving)
    rates_now = column_of(signals[Entry(j, order + 1)] for j, order in moving)
    for order in range(1, most + 1):
        rows = [i for i, count in enumerate(counts) if count >= order]
        before = column_of(residuals[Row(i, order - 1)] for i in rows)
        after = ca.jtimes(before, symbols_now, rates_now)
        residuals |= {Row(i, order): after[k] for k, i in enumerate(rows)}
    every = {s.element_hash() for s in ca.symvar(column_of(residuals.values()))}
    used = [
        (dae.inputs[j - n], order, s)
        for (j, order), s in rates.items()
        if order and s.element_hash() in every
    ]
    return residuals, tuple(used)


_RANK = 1e-9  # of the largest pivot: a smaller one is no pivot
_CLEAR = 1e-3  # of the largest entry of a row: what is left of it may be rounding if it is smaller
_KEPT = 3  # the class of variables that are no derivatives: none of them becomes algebraic


class Block(NamedTuple):
    """Positions of equations, and of the unknowns that they determine."""

    rows: tuple[int, ...]
    columns: tuple[int, ...]


def blocks_of(pattern: ca.Sparsity) -> tuple[Block, ...]:
    """The block-triangular order of a square pattern: later blocks need earlier ones."""
    if not pattern.size1():
        return ()
    _, rows, columns, r, c, _, _ = pattern.btf()
    pairs = zip(pairwise(r), pairwise(c), strict=True)
    return tuple(Block(tuple(rows[a:b]), tuple(columns[i:j])) for (a, b), (i, j) in pairs)


def dummy_derivatives(
    d: Differentiated,
    signals: Sequence[ca.SX],
    points: Callable[[], Sequence[Array]],
    wanted: Collection[str],
) -> set[Entry]:
    """The derivatives that become algebraic variables; states that are `wanted` are kept if possible.

    `signals` are all symbols of the equations but parameters, then these; `points()` are values of them.
    """
    dae, n = d.dae, len(d.dae.equations)
    rows = [Row(i, d.counts[i]) for i in range(n)]
    entries = [Entry(j, d.orders[j]) for j in range(n)]
    residuals = column_of(d.residuals[row] for row in rows)
    unknown = column_of(d.symbols[entry] for entry in entries)
    jacobian = ca.jacobian(residuals, unknown)
    free = column_of(signals)
    highest = column_of(signals[: len(signals) - len(dae.parameters)])

    @cache
    def matrices() -> list[Array]:
        function = ca.Function("jacobian", [free], [in_doubles(jacobian)])
        return [function(point).full() for point in points()]

    dummies: set[Entry] = set()
    for block in blocks_of(jacobian.sparsity()):
        matrix = jacobian[list(block.rows), list(block.columns)]
        alone = len(block.rows) == 1 and matrix.nnz() and not ca.symvar(ca.SX(matrix.nz[0]))
        if not alone:
            of_block = [rows[i] for i in block.rows], [entries[j] for j in block.columns]
            _check_regular(d, matrix, highest, points, *of_block)
        if any(d.counts[i] for i in block.rows):
            at = [m[np.ix_(block.rows, block.columns)] for m in matrices()]
            orders = [rows[i].order for i in block.rows]
            dummies |= _selected(d, at, orders, [entries[j] for j in block.columns], wanted)
    return dummies


def _check_regular(
    d: Differentiated,
    matrix: ca.SX,
    highest: ca.SX,
    points: Callable[[], Sequence[Array]],
    rows: Sequence[Row],
    entries: Sequence[Entry],
) -> None:
    dae, singular = d.dae, singular_part(matrix, highest, d.dae.p, points)
    if singular is None:
        return
    unknowns = [entries[j] for j in singular.columns]
    names = [name_of(dae.variables[j].name, order) for j, order in unknowns]
    places = listed(place_of(dae, rows[i]) for i in singular.rows)
    if singular.exact:
        said, advice = _dependence(d, [rows[i] for i in singular.rows])
        raise StructureError(
            f"{dae.owner}: is singular, whatever the parameters are: the equations {places} {said}, and "
            f"do not determine {listed(names)}. {advice}"
        )
    used = {s.element_hash() for s in ca.symvar(ca.densify(matrix))}
    moving = [v for v in dae.variables if v.symbol.element_hash() in used]
    starts = [v.name for v in moving if v.start is None] or [v.name for v in moving]
    raise StructureError(
        f"{dae.owner}: is singular at the points that were tried, near the start values: the equations "
        f"{places} do not determine {listed(names)} there. Give other start values"
        + (f" of {listed(starts)}" if starts else "")
        + ", or equations that determine the unknowns."
    )


def _dependence(d: Differentiated, rows: Sequence[Row]) -> tuple[str, str]:
    """How equations depend on each other, looked at in doubles at one odd point, and what to do."""
    residual = ca.densify(in_doubles(column_of(d.residuals[row] for row in rows)))
    parameters = {p.element_hash() for p in ca.vertsplit(d.dae.p)}
    symbols = ca.symvar(residual)
    signals = column_of(s for s in symbols if s.element_hash() not in parameters)
    slopes = ca.densify(ca.jacobian(residual, signals))
    function = ca.Function("rows", [column_of(symbols)], [residual, slopes])
    value, J = (x.full() for x in function(np.linspace(0.6, 1.4, len(symbols))))
    if not np.all(np.isfinite(J)) or np.linalg.matrix_rank(J) == len(J):
        return (
            "have a combination without the highest derivatives",
            "Write this combination, a constraint, in the place of one of them, or remove what is said "
            "twice and give the unknowns an equation.",
        )
    if np.linalg.matrix_rank(np.hstack([J, value])) > np.linalg.matrix_rank(J):
        return "contradict each other", "Change one of them."
    return "depend on each other", "Remove what is said twice, and give the unknowns an equation."


def _selected(
    d: Differentiated,
    matrices: Sequence[Array],
    orders: Sequence[int],
    entries: Sequence[Entry],
    wanted: Collection[str],
) -> set[Entry]:
    """The dummy derivatives of one block, level by level."""
    dummies: set[Entry] = set()
    now, remaining, columns = list(matrices), list(orders), list(entries)
    while any(remaining):
        rows = [i for i, order in enumerate(remaining) if order]
        constrained = [m[rows] for m in now]
        chosen = _columns(d, constrained, columns, wanted)
        dummies |= {columns[j] for j in chosen}
        now = [block[:, chosen] for block in constrained]
        remaining = [remaining[i] - 1 for i in rows]
        columns = [Entry(columns[j].variable, columns[j].order - 1) for j in chosen]
    return dummies


def _columns(
    d: Differentiated, matrices: Sequence[Array], entries: Sequence[Entry], wanted: Collection[str]
) -> list[int]:
    """Columns, as many as rows, with which all matrices (m, k) are regular."""
    sizes = np.array([d.dae.variables[j].size for j, _ in entries])
    classes = np.array([_class(d, entry, wanted) for entry in entries])
    count, free = len(matrices[0]), np.flatnonzero(classes < _KEPT)
    best, least = None, 0.0
    for matrix in matrices:
        scaled = divided(matrix * sizes, np.max(np.abs(matrix * sizes), axis=1, keepdims=True))[:, free]
        chosen = [int(free[k]) for k in independent(scaled, classes[free])]
        if len(chosen) < count:
            continue
        worst = np.inf
        for other in matrices:  # the least singular value of all, with rows and columns of one size
            whole = other[:, chosen] * sizes[chosen]
            whole = divided(whole, np.linalg.norm(whole, axis=1, keepdims=True))
            whole = divided(whole, np.linalg.norm(whole, axis=0))
            worst = min(worst, float(np.linalg.svd(whole, compute_uv=False)[-1]))
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


def independent(matrix: Array, classes: Array) -> list[int]:
    """Independent columns, of the lowest classes first.

    A column that alone has an entry in a row is in every such choice; of large matrices these are
    taken first, one after the other, and what is left of the matrix is small.
    """
    alone = _alone(csr_array(matrix)) if min(matrix.shape) > LARGE else []
    rows = np.delete(np.arange(len(matrix)), [i for i, _ in alone])
    others = np.delete(np.arange(len(classes)), [j for _, j in alone])
    projected, chosen = matrix[np.ix_(rows, others)], [j for _, j in alone]
    for kind in sorted(set(classes[others].tolist())):
        columns = np.flatnonzero(classes[others] == kind)
        if not len(projected):
            break
        q, triangle, order = qr(projected[:, columns], pivoting=True)
        pivots = np.abs(np.diag(triangle))
        count = int(np.sum(pivots > _RANK * max(1.0, np.max(pivots, initial=0.0))))
        chosen += [int(others[columns[k]]) for k in order[:count]]
        projected = q[:, count:].T @ projected
    return sorted(chosen)


def _alone(matrix: csr_array) -> list[tuple[int, int]]:
    """Rows and columns of entries that are alone in their rows, but for columns found before."""
    of_column, sizes = matrix.tocsc(), abs(matrix).max(axis=1).toarray()
    count, is_open = np.diff(matrix.indptr), np.ones(matrix.shape[1], dtype=bool)
    pairs: list[tuple[int, int]] = []
    waiting = np.flatnonzero(count == 1).tolist()
    while waiting:
        i = waiting.pop()
        places = range(matrix.indptr[i], matrix.indptr[i + 1])
        free = [k for k in places if is_open[matrix.indices[k]]]
        if len(free) != 1 or abs(matrix.data[free[0]]) < _CLEAR * sizes[i]:
            continue
        j = int(matrix.indices[free[0]])
        pairs.append((i, j))
        is_open[j] = False
        below = of_column.indices[of_column.indptr[j] : of_column.indptr[j + 1]]
        count[below] -= 1
        waiting += below[count[below] == 1].tolist()
    return pairs
