"""A consistent point, order after order: positions, then velocities, then accelerations.

The signature method says which derivatives of which equations determine those of the variables of one
order, once those below are known. Only the first of these systems is nonlinear in mechanisms; Newton's
method begins there with what the start values make of the other variables, equation after equation.

Source: J. D. Pryce, A simple structural analysis method for DAEs, BIT 41 (2001), section 4.
"""

from collections.abc import Collection, Sequence

import casadi as ca
import numpy as np

from mbdlft.base.array import Array
from mbdlft.dae.dae import Variable
from mbdlft.dae.index import Differentiated, Entry, Row, name_of
from mbdlft.dae.newton import System, solve
from mbdlft.dae.text import column_of

_SLOPE = 1e-6  # of the largest slope of an equation: a smaller one gives no guess


def point_by_orders(
    d: Differentiated, inputs: Sequence[ca.SX], values: Array, preferred: Collection[str]
) -> dict[Entry, float] | None:
    """Values of all variables and derivatives, or None if a system has no solution near the guess.

    Parameters
    ----------
    d : Differentiated
        What is fixed has its start value.
    inputs : sequence of SX
        Symbols of the inputs; `values` are theirs, then those of the parameters.
    preferred : names of variables
        Others are guessed from the start values of these first.
    """
    variables = d.dae.variables
    known = {Entry(j, 0): v.start or 0.0 for j, v in enumerate(variables) if v.fixed}
    beside = column_of([*inputs, *ca.vertsplit(d.dae.p)])
    for below in range(max(d.orders, default=0), -1, -1):
        rows = [Row(i, c - below) for i, c in enumerate(d.counts) if c >= below]
        entries = [Entry(j, o - below) for j, o in enumerate(d.orders) if o >= below]
        entries = [entry for entry in entries if entry not in known]
        start = np.array([0.0 if order else variables[j].start or 0.0 for j, order in entries])
        sizes = np.array([variables[j].size for j, _ in entries])
        if rows and entries:
            residual = column_of(d.residuals[row] for row in rows)
            unknown = column_of(d.symbols[entry] for entry in entries)
            q = ca.vertcat(column_of(d.symbols[entry] for entry in known), beside)
            system, given = System(residual, unknown, q), np.array([*known.values(), *values])
            start = guessed(system, start, given, _seeds(variables, entries, preferred))
            at = solve(system, start, given, sizes)
            if not at.is_solution:
                return None
            start = at.values
        known |= {entry: float(x) for entry, x in zip(entries, start, strict=True)}
    return known


def _seeds(
    variables: Sequence[Variable], entries: Sequence[Entry], preferred: Collection[str]
) -> list[list[int]]:
    """Positions whose start values are taken for guesses: first those that are preferred, all at once."""
    first = [k for k, (j, order) in enumerate(entries) if name_of(variables[j].name, order) in preferred]
    others = [k for k in range(len(entries)) if k not in first]
    others.sort(key=lambda k: bool(entries[k].order) or variables[entries[k].variable].start is None)
    return [first, *([k] for k in others)]


def guessed(system: System, start: Array, given: Array, seeds: Sequence[Sequence[int]]) -> Array:
    """Values (n,) near which equations hold: each with one unknown gives it a value, by one step.

    `start` (n,) are values of those at the positions `seeds`, which count as known one after the other,
    when no equation has one unknown any more.
    """
    z, rows, columns = start.copy(), system.places.rows, system.places.columns
    is_set = np.zeros(len(z), dtype=bool)
    used = np.zeros(system.count, dtype=bool)
    for seed in seeds:
        is_set[list(seed)] = True
        while True:
            is_open = ~is_set[columns]
            ready = ~used & (np.bincount(rows[is_open], minlength=system.count) == 1)
            if not np.any(ready):
                break
            used |= ready
            alone = np.flatnonzero(ready[rows] & is_open)
            of, chosen, largest = rows[alone], columns[alone], np.zeros(system.count)
            with np.errstate(all="ignore"):
                r, J = system.residual(z, given)[of], system.slopes(z, given)
                np.maximum.at(largest, rows, np.abs(J))
                good = np.abs(J[alone]) > _SLOPE * largest[of]
                z[chosen[good]] -= (r / J[alone])[good]
            z = np.where(np.isfinite(z), z, start)
            is_set[chosen[good]] = True
    return z
