"""How often each equation has to be differentiated: the signature method, and the derivatives.

The assignment of largest total order and its smallest dual give the counts c_i of differentiations of
the equations and the orders d_j of the variables; the counts are those of Pantelides' algorithm.

Source: J. D. Pryce, A simple structural analysis method for DAEs, BIT 41 (2001); C. C. Pantelides, The
consistent initialization of differential-algebraic systems, SIAM J. Sci. Stat. Comput. 9 (1988).
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from mbdlft.base.errors import StructureError
from mbdlft.dae.description import Dae, Variable
from mbdlft.dae.operations import column_of

Pattern = NDArray[np.int64]
_ABSENT = -1  # in a signature: the variable does not occur
_FORBIDDEN = 10**6  # what an assignment to an absent variable costs
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
    """All equations and their derivatives that determine a model.

    Attributes
    ----------
    dae : Dae
    counts : tuple of int
        Differentiations of each equation, c_i.
    orders : tuple of int
        Of the highest derivative of each variable, d_j.
    symbols : mapping of `Entry` to SX
    residuals : mapping of `Row` to SX
    input_rates : tuple of (input, order, SX)
        Derivatives of inputs that occur.
    """

    dae: Dae
    counts: tuple[int, ...]
    orders: tuple[int, ...]
    symbols: dict[Entry, ca.SX]
    residuals: dict[Row, ca.SX]
    input_rates: tuple[tuple[Variable, int, ca.SX], ...]

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


def differentiated(dae: Dae) -> Differentiated:
    """The equations with those derivatives that the signature method asks for.

    Raises
    ------
    StructureError
        The numbers of equations and variables differ, or the model is structurally singular.
    """
    sigma = _signature(dae)
    _check_square(dae, sigma)
    rows, columns = linear_sum_assignment(np.where(sigma == _ABSENT, _FORBIDDEN, -sigma))
    if np.any(sigma[rows, columns] == _ABSENT):
        raise _structurally_singular(dae, sigma)
    counts, orders = _offsets(dae, sigma, columns)
    symbols = _symbols(dae, orders)
    residuals, rates = _derivatives(dae, counts, orders, symbols)
    return Differentiated(dae, counts, orders, symbols, residuals, rates)


def _signature(dae: Dae) -> Pattern:
    """Highest order of each variable in each equation; -1 where it does not occur."""
    residuals = column_of(e.residual for e in dae.equations)
    found = np.full((len(dae.equations), len(dae.variables)), _ABSENT)
    for order in (0, 1):
        chosen = [
            (j, symbol)
            for j, v in enumerate(dae.variables)
            if (symbol := v.derivative if order else v.symbol) is not None
        ]
        if not chosen or not residuals.numel():
            continue
        pattern = ca.jacobian_sparsity(residuals, column_of(s for _, s in chosen))
        rows, columns = (np.array(part, dtype=int) for part in pattern.get_triplet())
        found[rows, np.array([j for j, _ in chosen])[columns]] = order
    return found


def _check_square(dae: Dae, sigma: Pattern) -> None:
    equations, variables = sigma.shape
    if equations == variables:
        return
    raise StructureError(
        f"{dae.owner}: has {equations} equations for {variables} unknowns. "
        + _named_parts(dae, sigma)
        + " Give each unknown an equation, or make it an input."
    )


def _structurally_singular(dae: Dae, sigma: Pattern) -> StructureError:
    return StructureError(
        f"{dae.owner}: is structurally singular. "
        + _named_parts(dae, sigma)
        + " Look for a missing or "
        "doubled equation, or a boundary that nothing is connected with."
    )


def _named_parts(dae: Dae, sigma: Pattern) -> str:
    """What is over- and underdetermined, by Dulmage and Mendelsohn."""
    places = (found.tolist() for found in np.nonzero(sigma != _ABSENT))
    _, rows, columns, _, _, *coarse = ca.Sparsity.triplet(*sigma.shape, *places).btf()
    over, few = sorted(rows[: coarse[0][2]]), sorted(columns[coarse[1][2] :])
    parts = []
    if few:
        own = {i for j in few for i in np.flatnonzero(sigma[:, j] != _ABSENT)}
        parts.append(
            f"The unknowns {listed(dae.variables[j].name for j in few)} are in too few equations: "
            f"{listed(dae.equations[i].place for i in sorted(own)) or 'none'}."
        )
    if over:
        many = {j for i in over for j in np.flatnonzero(sigma[i] != _ABSENT)}
        parts.append(
            f"The equations {listed(dae.equations[i].place for i in over)} are too many for "
            f"{listed(dae.variables[j].name for j in sorted(many)) or 'no unknown'}."
        )
    return " ".join(parts)


def listed(names: Iterable[object]) -> str:
    """Names with commas; of many, the first ones."""
    every = list(names)
    more = f" and {len(every) - _LISTED} more" if len(every) > _LISTED else ""
    return ", ".join(map(str, every[:_LISTED])) + more


def _offsets(
    dae: Dae, sigma: Pattern, matched: Sequence[int]
) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """The smallest c and d with d_j - c_i >= sigma_ij, and = on the assignment."""
    n = len(sigma)
    counts = np.zeros(n, dtype=int)
    rows = np.arange(n)
    for _ in range(2 * n + 2):
        shifted = np.where(sigma == _ABSENT, _ABSENT, sigma + counts[:, None])
        orders = np.max(shifted, axis=0, initial=0)
        found = orders[matched] - sigma[rows, matched]
        if np.array_equal(found, counts):
            return tuple(map(int, counts)), tuple(map(int, orders))
        counts = found
    raise StructureError(
        f"{dae.owner}: the equations would have to be differentiated without end. Please report it."
    )


def _symbols(dae: Dae, orders: Sequence[int]) -> dict[Entry, ca.SX]:
    found = {}
    for j, v in enumerate(dae.variables):
        for order in range(orders[j] + 1):
            known = (v.symbol, v.derivative)[order] if order < 2 else None
            found[Entry(j, order)] = ca.SX.sym(name_of(v.name, order)) if known is None else known
    return found


def _derivatives(
    dae: Dae, counts: Sequence[int], orders: Sequence[int], symbols: dict[Entry, ca.SX]
) -> tuple[dict[Row, ca.SX], tuple[tuple[Variable, int, ca.SX], ...]]:
    found = {Row(i, 0): e.residual for i, e in enumerate(dae.equations)}
    rates = {
        (k, order): ca.SX.sym(name_of(u.name, order))
        for k, u in enumerate(dae.inputs)
        for order in range(1, max(counts, default=0) + 1)
    }
    rates |= {(k, 0): u.symbol for k, u in enumerate(dae.inputs)}
    moving = [
        (symbols[e], symbols[Entry(e.variable, e.order + 1)])
        for e in symbols
        if e.order < orders[e.variable]
    ]
    moving += [
        (s, rates[k, order + 1]) for (k, order), s in rates.items() if (k, order + 1) in rates
    ]
    symbols_now, rates_now = column_of([s for s, _ in moving]), column_of([r for _, r in moving])
    for order in range(1, max(counts, default=0) + 1):
        rows = [i for i, count in enumerate(counts) if count >= order]
        before = column_of(found[Row(i, order - 1)] for i in rows)
        after = ca.jtimes(before, symbols_now, rates_now)
        found |= {Row(i, order): after[k] for k, i in enumerate(rows)}
    every = column_of(found.values())
    used = [
        (dae.inputs[k], order, s)
        for (k, order), s in rates.items()
        if order and ca.depends_on(every, s)
    ]
    return found, tuple(used)
