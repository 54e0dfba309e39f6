"""A matrix as one fraction N(p) / d(p) of polynomials in its parameters, and ways to write it from that.

Fractions of polynomials are one more number system for the expressions. A float is taken as the decimal
it prints as, so terms that cancel are gone, and numerators and denominators are in lowest terms. What is
made from N and d does not depend on how the entries were written:

- entries by Horner's rule, where they are polynomial: all products have their factors in one order;
- the LFT that the values alone lead to (`mbdlft.order.recovery`);
- relations D(p) y = N(p) u of low degrees, for rows and for columns (`mbdlft.order.rational`).
"""

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from fractions import Fraction
from functools import reduce
from typing import Any

import casadi as ca
import flint
import numpy as np

from mbdlft.base.array import Array
from mbdlft.base.errors import MbdlftError
from mbdlft.base.parameter import cosine_sine_parts, exact_cosine_sine
from mbdlft.exact.numbers import decimal
from mbdlft.exact.ratio import NotFractionError, Polynomial, Ratio, flint_rational
from mbdlft.matrix.expressions import Resolved, matrix_values, parts
from mbdlft.matrix.problem import MatrixProblem
from mbdlft.order.rational import Fractions, RationalMatrix, Terms, low_relations
from mbdlft.order.recovery import Recovered, recovered
from mbdlft.order.work import Work
from mbdlft.problem.relations import Form, LinearModel
from mbdlft.problem.sx.constants import literal

_MOST_ENTRIES = 300_000  # coefficients over one denominator, zeros too: 3 s from the values of more
_SWEEPS = 10  # of balancing
_WORK = 6.0  # units, for the recovery, for relations of rows, and for those of columns


def fractions(
    problem: MatrixProblem, resolved: Resolved, kind: type[Ratio] = Ratio
) -> list[list[Ratio]] | None:
    """The entries in the internal values of the parameters; None where one is no such fraction."""
    context = flint.fmpq_mpoly_ctx.get([f"p{k}" for k in range(len(problem.parameters))])
    unit = kind(context.constant(1), context.constant(1))
    values: dict[str, Any] = {name: unit.of(x) for name, x in problem.constant_values().items()}
    try:
        for parameter, symbol in zip(problem.parameters, context.gens(), strict=True):
            t = kind(symbol, context.constant(1))
            values[parameter.name] = t
            if parameter.is_angle:
                c0, s0 = exact_cosine_sine(parameter.reference)
                if c0 * s0:
                    return None
                cosine, sine, denominator = cosine_sine_parts(parameter.substitution, t)
                cosine, sine = cosine / denominator, sine / denominator
                values |= parts(parameter.name, c0 * cosine - s0 * sine, s0 * cosine + c0 * sine)
        return matrix_values(problem, resolved, values, unit.of)
    except (NotFractionError, MbdlftError):  # such as the sine of a constant
        return None


def expanded_matrix(problem: MatrixProblem, resolved: Resolved, q: ca.SX) -> ca.SX | None:
    """The matrix by Horner's rule in the internal values q; None if it is not polynomial."""
    entries = fractions(problem, resolved, Polynomial)
    if entries is None:
        return None
    by_name = sorted(range(q.numel()), key=lambda k: problem.parameters[k].name)
    return ca.vertcat(
        *(ca.horzcat(*(_horner(_terms(x.n / x.d), q, by_name) for x in row)) for row in entries)
    )


def least_forms(
    problem: MatrixProblem, resolved: Resolved, rows: Array, columns: Array
) -> Iterator[Form]:
    """The matrix with rows and columns divided by powers of two, from its values."""
    entries = fractions(problem, resolved)
    if entries is None:
        return
    divided = [
        [x * Fraction(1.0 / (r * c)) for x, c in zip(row, columns.tolist(), strict=True)]
        for row, r in zip(entries, rows.tolist(), strict=True)
    ]
    q = ca.SX.sym("q", len(problem.parameters))
    fraction = _over_one_denominator(divided)
    if fraction is None:
        return
    N, d = fraction
    shifts = _simple_point(d, problem)
    lft = recovered(_about(N, d, shifts), Work(_WORK))
    if lft is not None:
        yield Form(_recovered(lft, q, shifts, problem), is_from_values=True)
        if lft.is_minimal:
            return
    F = _about(N, d, [Fraction(0)] * len(shifts))
    if math.prod(F.box) * len(N) * len(N[0]) > _MOST_ENTRIES:
        return
    for is_transposed in (False, True):
        turned = replace(F, N=[*zip(*F.N, strict=True)]) if is_transposed else F
        form = low_relations(turned, Work(_WORK))
        if form is not None:
            yield Form(_implicit(form, q, problem), None, is_transposed, is_from_values=True)


def _over_one_denominator(entries: Sequence[Sequence[Ratio]]) -> tuple[list[list[Any]], Any] | None:
    """N and d, polynomials of FLINT; None if they are too large."""
    d, count = entries[0][0].d, len(entries) * len(entries[0])
    for x in itertools.chain(*entries):
        d = divmod(d * x.d, d.gcd(x.d))[0]
        if count * math.prod(1 + degree for degree in d.degrees()) > _MOST_ENTRIES:
            return None
    return [[x.n * divmod(d, x.d)[0] for x in row] for row in entries], d


def _simple_point(d: Any, problem: MatrixProblem) -> list[Fraction]:
    """Where d is not zero: the origin, or near nominal values; the LFT has few digits if it has few."""
    nominal = [parameter.map.b0 for parameter in problem.parameters]
    for digits in range(18):
        point = [decimal(f"{x:.{digits - 1}e}") if digits else Fraction(0) for x in nominal]
        if d(*map(flint_rational, point)) != 0:
            break
    return point


def _about(N: Sequence[Sequence[Any]], d: Any, point: Sequence[Fraction]) -> RationalMatrix:
    """N / d in the distances of the parameters from a point."""
    moved = [symbol + flint_rational(x) for symbol, x in zip(d.context().gens(), point, strict=True)]
    terms = [[_terms(x.compose(*moved)) for x in row] for row in N]
    return RationalMatrix(terms, _terms(d.compose(*moved)), len(point))


def _recovered(
    lft: Recovered, q: ca.SX, shifts: Sequence[Fraction], problem: MatrixProblem
) -> LinearModel:
    """0 = z - M11 w - M12 u, y = M21 w + M22 u with w_i = (q_k - shift_k) z_i."""
    channels = [k for k, size in lft.blocks for _ in range(size)]
    n, M = len(channels), _balanced(lft.M, len(channels))
    z, u = ca.SX.sym("z", n), ca.SX.sym("input", M.shape[1] - n)
    w = [(q[k] - literal(shifts[k])) * z[i] for i, k in enumerate(channels)]
    signals = [*w, *ca.vertsplit(u)]
    rows = (zip(row, signals, strict=True) for row in M.tolist())
    values = [sum((literal(x) * signal for x, signal in row if x), ca.SX(0)) for row in rows]
    residual = z - ca.vertcat(ca.SX(0, 1), *values[:n])
    return LinearModel(residual, ca.vertcat(*values[n:]), z, u, q, tuple(problem.parameters))


def _balanced(M: Fractions, n: int) -> Fractions:
    """Channels times powers of two, so that no row or column of one is far larger than the other."""
    sizes = np.array([[_log2(x) for x in row] for row in M.tolist()]).reshape(M.shape)
    sizes[range(n), range(n)] = -np.inf
    total = np.zeros(n)
    for _ in range(_SWEEPS):
        for i in range(n):
            row, column = np.max(sizes[i], initial=-np.inf), np.max(sizes[:, i], initial=-np.inf)
            if np.isfinite(row + column):
                step = np.rint((column - row) / 2.0)
                total[i] += step
                sizes[i] += step
                sizes[:, i] -= step
    scale = [Fraction(2) ** int(x) for x in total]
    balanced = M.copy()
    for i, x in enumerate(scale):
        balanced[i] = balanced[i] * x
        balanced[:, i] = balanced[:, i] / x
    return balanced


def _log2(x: Fraction) -> float:
    return math.log2(abs(x.numerator)) - math.log2(x.denominator) if x else -math.inf


def _implicit(rows: list[list[Terms]], q: ca.SX, problem: MatrixProblem) -> LinearModel:
    """0 = D y - N u."""
    by_name = sorted(range(q.numel()), key=lambda k: problem.parameters[k].name)
    y, u = ca.SX.sym("y", len(rows)), ca.SX.sym("input", len(rows[0]) - len(rows))
    signals = [*ca.vertsplit(y), *ca.vertsplit(-u)]
    residual = [
        sum((_horner(x, q, by_name) * s for x, s in zip(row, signals, strict=True) if x), ca.SX(0))
        for row in rows
    ]
    return LinearModel(ca.vertcat(*residual), y, y, u, q, tuple(problem.parameters))


def _horner(terms: Terms, q: ca.SX, order: Sequence[int]) -> ca.SX:
    """A polynomial, by Horner's rule in one parameter after the other."""
    products, last = [], ca.SX(0)  # with each parameter, of what those before it are not in
    for place, k in enumerate(order):
        total = ca.SX(0)
        for exponent in range(max((e[k] for e in terms), default=0), 0, -1):
            lower_terms = {e: x for e, x in terms.items() if e[k] == exponent}
            total = q[k] * (total + _horner(lower_terms, q, order[place + 1 :]))
        products.append(total)
        terms = {e: x for e, x in terms.items() if not e[k]}
    if terms:
        last = ca.SX(literal(next(iter(terms.values()))))
    return reduce(lambda rest, product: product + rest, reversed(products), last)


def _terms(polynomial: Any) -> Terms:
    return {tuple(map(int, e)): Fraction(int(x.p), int(x.q)) for e, x in polynomial.to_dict().items()}
