"""Trim relations in which a parameter multiplies fewer signals: deflections times their stiffness.

A second moment I multiplies the bending deflections q in E I / L^3 q, and the compatibility of a frame
adds them to axial ones: I has as many channels as there are bending deflections. With I q as unknown
signals and the rows of compatibility times I, it multiplies axial deflections alone. That is the force
method, whose flexibilities have the redundant loads as unknowns. So relations R become

    R'_ij = R_ij p^(i in Q) / p^(j in S),

Q the rows and S the columns of as few entries as keep all powers of p at 0 and 1, with those of entries
a p in S. Other parameters may get more channels by that, so both relations are tried.

Loads of weight and thrust have an area and a density as factors, which leave the relations: what they
multiply outside, such as masses, has them too, and there they may be restricted to few channels.
"""

from dataclasses import replace
from typing import Any

import casadi as ca

from mbdlft.problem.equations import rows_of
from mbdlft.problem.relations import LinearModel

_MIXED = 2  # an entry a + b p, or of another degree; a p^0 and a p^1 have the powers 0 and 1


def with_scaled_deflections(trim: LinearModel) -> tuple[LinearModel, ...]:
    """Relations with scaled deflections and the same outputs; none if no parameter has fewer channels."""
    scaled = trim
    for k, parameter in enumerate(trim.parameters):
        if parameter.low * parameter.high > 0.0:
            scaled = _scaled(scaled, trim.p[k])
    return (scaled,) if scaled is not trim else ()


def without_factor(trim: LinearModel) -> tuple[LinearModel, ca.SX]:
    """Relations whose solution times a product of parameters is that of `trim`, and this product."""
    by_known, factor = ca.sparsify(ca.jacobian(trim.residual, trim.known)), ca.SX(1)
    for p in ca.vertsplit(trim.p):
        if set(_powers(by_known, p)) == {1}:
            by_known, factor = ca.substitute(by_known, p, 1), factor * p
    others = _without(trim.residual, trim.known)
    return replace(trim, residual=others + ca.mtimes(by_known, trim.known)), factor


def _scaled(m: LinearModel, p: ca.SX) -> LinearModel:
    """Relations scaled by one parameter, if it multiplies fewer signals then."""
    signals = ca.vertcat(m.unknown, m.known)
    J = ca.sparsify(ca.jacobian(m.residual, signals))
    entries = [*zip(*J.sparsity().get_triplet(), _powers(J, p), strict=True)]
    rows, columns = set[int](), {j for _, j, power in entries if power == 1}
    while True:
        more = rows | {i for i, j, power in entries if j in columns and power != 1}
        wider = columns | {j for i, j, power in entries if i in more and power}
        if (more, wider) == (rows, columns):
            break
        rows, columns = more, wider
    read = ca.jacobian_sparsity(m.output, signals).get_col()
    if columns & {*read, *range(m.unknown.numel(), signals.numel())}:
        return m
    scaled = [(i, j, power + (i in rows) - (j in columns)) for i, j, power in entries]
    if _channels(J, scaled) >= _channels(J, entries):
        return m
    kept = [j for j in range(signals.numel()) if j not in columns]
    by_scaled = _without(m.residual, rows_of(signals, kept))
    by_others = _without(m.residual, rows_of(signals, sorted(columns)))
    at_one = ca.substitute(by_scaled, p, 1)
    residual = (
        by_scaled[i] + p * by_others[i] if i in rows else at_one[i] + by_others[i]
        for i in range(m.residual.numel())
    )
    return replace(m, residual=ca.vertcat(*residual))


def _powers(J: ca.SX, p: ca.SX) -> list[int]:
    """Of the entries of a matrix that are not zero."""
    nonzero: list[Any] = J.nonzeros()
    entries = ca.vertcat(*nonzero)
    slopes = ca.densify(ca.jacobian(entries, p))
    bends, at_zero = ca.densify(ca.jacobian(slopes, p)), ca.substitute(entries, p, 0)
    return [
        0 if slopes[k].is_zero() else 1 if bends[k].is_zero() and at_zero[k].is_zero() else _MIXED
        for k in range(entries.numel())
    ]


def _channels(J: ca.SX, entries: list[tuple[int, int, int]]) -> int:
    """The largest rank of a matrix with the entries that a parameter is in."""
    rows, columns = [i for i, _, power in entries if power], [j for _, j, power in entries if power]
    return int(ca.sprank(ca.Sparsity.triplet(*J.shape, rows, columns)))


def _without(residual: ca.SX, signals: ca.SX) -> ca.SX:
    return ca.SX(ca.substitute(residual, signals, ca.SX.zeros(signals.numel())))
