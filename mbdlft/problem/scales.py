"""Relations of loads in which few powers of a parameter are left: rows and signals in units of their own.

The loads of a beam by its weight are rho A g L f(A L^2/I). Each displacement that is multiplied with
them has a copy of the powers outside of f, too, and A multiplies masses but not bending stiffnesses.
So rows, loads, multipliers and unknown signals of the trim are counted in powers of each parameter p,

    R'_ij = R_ij p^(r_i + c_j),

with the whole numbers r and c that make the sum of |powers| of all entries least: a linear program. Its
vertices are whole, as its matrix is that of a network. Of the constant 1, which drives the trim, the
highest and the lowest power count, as powers of one signal are one chain. States, rates, outputs and
displacements of loads keep their units. Rows of the structure are divided by p only where p times their
entries has at most degree 2 in p: powers of lengths are left where levers and masses share them.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from mbdlft.base.parameter import to_internal
from mbdlft.problem.equations import rows_of
from mbdlft.problem.relations import LinearModel
from mbdlft.problem.sx.constants import modulo_prime

_HIGHEST = 9  # power of one parameter that is told from a sum of powers
# of a power: of two ways, the one with powers in rows that the constant drives, where deflections are.
# Star 3046 of the attack has an order of 111 so, 137 with all rows alike
_TIE = 0.001
_SEED = 11  # of the other parameters; a wrong answer has a chance of 1e-16 for each entry


class _Entries(NamedTuple):
    """Entries of a matrix of slopes that are not zero."""

    rows: list[int]
    columns: list[int]
    values: list[ca.SX]
    powers: list[int | None]  # of the parameter; None for sums of several
    is_low: list[bool]  # whether p times the entry has degree 0 to 2


@lru_cache(maxsize=1)  # the same in more bits
def in_own_units(model: LinearModel) -> LinearModel:
    """Relations with the same unknown derivatives and outputs, whose lifted loads are scaled.

    What is scaled last multiplies signals first. Parameters of many rows are first, whatever their names
    are: ring 71 of the attack has 176 channels with its length before the area, and 239 after it.
    """
    if model.lifted is None:
        return model
    rows = ca.vertcat(model.residual, model.lifted.trim.residual)
    counts = [ca.jacobian_sparsity(rows, p).nnz() for p in ca.vertsplit(model.p)]
    for k in sorted(range(len(counts)), key=lambda k: -counts[k]):
        low, high = to_internal(model.parameters[k], [model.parameters[k].low, model.parameters[k].high])
        if low * high > 0.0:
            model = _scaled(model, model.p[k])
    return model


def _scaled(m: LinearModel, p: ca.SX) -> LinearModel:
    lifted = m.lifted
    assert lifted
    trim, both = lifted.trim, ca.vertcat(m.residual, m.output)
    signals, of_trim = ca.vertcat(m.unknown, m.known, lifted.loads), ca.vertcat(trim.unknown, trim.known)
    inside, outside = _entries(trim.residual, of_trim, p), _entries(both, signals, p)
    # columns of the trim, and then those of the model; loads are unknown signals of the trim
    n, one, held = trim.residual.numel(), trim.unknown.numel(), m.unknown.numel() + m.known.numel()
    read = ca.jacobian_sparsity(trim.output, trim.unknown).get_col()
    place = [*range(one + 1, one + 1 + held), *(read[k] for k in lifted.outputs)]
    every = _Entries(
        [*inside.rows, *(n + i for i in outside.rows)],
        [*inside.columns, *(place[j] for j in outside.columns)],
        [*inside.values, *outside.values],
        [*inside.powers, *outside.powers],
        [*inside.is_low, *outside.is_low],
    )
    free = (-_HIGHEST, _HIGHEST)
    limits = [
        *([free] * n),
        *_row_limits(m, outside),
        *([free] * one),
        (0, 0),
        *_signal_limits(m, outside),
    ]
    powers = _least_powers(every, n + both.numel(), limits, one)
    if powers is None:
        return m
    r, rows, c = np.split(powers, [n, n + both.numel()])
    scaled, count = _in_rows(both, signals, outside, p, rows, c[place]), m.residual.numel()
    trim = replace(trim, residual=_summed(inside, n, of_trim, p, r, c))
    return replace(m, residual=scaled[:count], output=scaled[count:], lifted=lifted._replace(trim=trim))


def _row_limits(m: LinearModel, entries: _Entries) -> list[tuple[int, int]]:
    high = {i for i, low in zip(entries.rows, entries.is_low, strict=True) if not low}
    rows, count = m.residual.numel(), m.residual.numel() + m.output.numel()
    return [(-1, 0) if i < rows and i not in high else (0, 0) for i in range(count)]


def _signal_limits(m: LinearModel, entries: _Entries) -> list[tuple[int, int]]:
    """Of the unknown and the known signals: multipliers may be scaled, which levers alone multiply."""
    signals = ca.vertcat(m.unknown, m.known)
    assert m.lifted
    read = {j for j, power in zip(entries.columns, entries.powers, strict=True) if power != 0}
    for by in (m.output, m.lifted.displacements):
        read |= set(ca.jacobian_sparsity(by, signals).get_col())
    free = set(range(m.derivatives, m.unknown.numel())) - read
    return [(-_HIGHEST, _HIGHEST) if j in free else (0, 0) for j in range(signals.numel())]


def _entries(rows: ca.SX, signals: ca.SX, p: ca.SX) -> _Entries:
    J = ca.sparsify(ca.jacobian(rows, signals))
    nonzero: list[Any] = J.nonzeros()
    values = [ca.SX(value) for value in nonzero]
    powers: list[int | None] = [0] * len(values)
    is_low = [True] * len(values)
    some = [k for k, value in enumerate(values) if ca.depends_on(value, p)]
    if some:
        column = ca.densify(ca.vertcat(*(values[k] for k in some)))
        at = [modulo_prime(column, _SEED, {p.element_hash(): x}) for x in (1, 2, 3, 4)]
        prime = at[0].prime
        one, two, three, four = ([int(x) for x in a.residues[:, 0]] for a in at)
        for k, f1, f2, f3, f4 in zip(some, one, two, three, four, strict=True):
            powers[k] = next(
                (
                    a
                    for a in range(-_HIGHEST, _HIGHEST + 1)
                    if (f2 - f1 * pow(2, a, prime)) % prime == 0 == (f3 - f1 * pow(3, a, prime)) % prime
                ),
                None,
            )
            is_low[k] = (4 * f4 - 9 * f3 + 6 * f2 - f1) % prime == 0
    return _Entries(J.sparsity().row(), J.sparsity().get_col(), values, powers, is_low)


def _least_powers(
    entries: _Entries, rows: int, limits: Sequence[tuple[int, int]], one: int
) -> NDArray[np.int64] | None:
    """Powers of rows and then of columns with the least sum of sizes; None if it does not fall.

    A sum of several powers counts as 1 + p, and column `one` as its highest and its lowest power.
    """
    from scipy.optimize import linprog  # here because it is slow to import
    from scipy.sparse import csr_array, hstack, vstack

    terms = [
        (i, rows + j, power)
        for i, j, own in zip(entries.rows, entries.columns, entries.powers, strict=True)
        for power in ((0, 1) if own is None else (own,))
    ]
    i, j, power = (np.array(part) for part in zip(*terms, strict=True))
    count, each, is_one = len(terms), np.arange(len(terms)), j == rows + one
    cost = np.append(1.0 - _TIE * np.isin(i, i[is_one]), [1.0, 1.0])
    by_powers = csr_array((np.ones(2 * count), (np.tile(each, 2), np.append(i, j))), (count, len(limits)))
    above, below = (
        csr_array((np.ones(count), (each, np.where(is_one, size, each))), (count, count + 2))
        for size in (count, count + 1)
    )
    found = linprog(
        np.append(np.zeros(len(limits)), cost),
        A_ub=vstack([hstack([by_powers, -above]), hstack([-by_powers, -below])]).tocsr(),
        b_ub=np.append(-power, power),
        bounds=[*limits, *[(0, None)] * (count + 2)],
        method="highs-ds",
    )
    of_one = power[is_one]
    before = cost[:count][~is_one] @ np.abs(power[~is_one])
    before += max(0, of_one.max(initial=0)) - min(0, of_one.min(initial=0))
    return np.rint(found.x[: len(limits)]).astype(np.int64) if found.fun < before - _TIE / 2 else None


def _summed(
    entries: _Entries,
    count: int,
    signals: ca.SX,
    p: ca.SX,
    rows: NDArray[np.int64],
    columns: NDArray[np.int64],
    chosen: frozenset[int] | None = None,
) -> ca.SX:
    """Rows (count,) of entries times powers of p and the signals; of some columns only, if given."""
    total = [ca.SX(0)] * count
    for i, j, value, power in zip(*entries[:4], strict=True):
        if chosen is None or j in chosen:
            more = int(rows[i] + columns[j])
            scaled = (
                value * _power(p, more)
                if power is None
                else ca.SX(ca.substitute(value, p, 1)) * _power(p, power + more)
            )
            total[i] = total[i] + scaled * signals[j]
    return ca.sparsify(ca.vertcat(*total))


def _in_rows(
    both: ca.SX,
    signals: ca.SX,
    entries: _Entries,
    p: ca.SX,
    rows: NDArray[np.int64],
    columns: NDArray[np.int64],
) -> ca.SX:
    """Rows with some columns scaled; all others stay as they are written, divided by p as a whole."""
    some = [j for j in range(signals.numel()) if columns[j]]
    scaled = _summed(entries, both.numel(), signals, p, rows, columns, frozenset(some))
    chosen = rows_of(signals, some)
    others = ca.densify(ca.SX(ca.substitute(both, chosen, ca.SX.zeros(len(some)))))
    slopes = ca.densify(ca.jacobian(others, p))
    bent = set(ca.sparsify(ca.jacobian(slopes, p)).row())
    constant = ca.densify(ca.SX(ca.substitute(others, p, 0)))
    total = []
    for i in range(both.numel()):
        if rows[i] == 0:
            total.append(others[i] + scaled[i])
        elif i in bent:
            total.append(others[i] / p + scaled[i])
        else:
            total.append(slopes[i] + constant[i] / p + scaled[i])
    return ca.sparsify(ca.vertcat(*total))


def _power(p: ca.SX, k: int) -> ca.SX:
    """p^k as products, or one divided by them."""
    product = ca.SX(1)
    for _ in range(abs(k)):
        product = product * p
    return product if k >= 0 else 1 / product
