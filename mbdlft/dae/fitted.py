"""Equilibria that are not rational in the parameters, and slopes at them: fits with a proved bound.

What blocks of equations do not give exactly is fitted together: the unknowns z of these blocks, and those
entries of the Jacobian that are not rational in z and p, as unknowns of their own. So the bound counts
everything that the linear model is made of, each relative to its size.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import casadi as ca
import numpy as np

from mbdlft.base.array import Array
from mbdlft.base.errors import NotRationalError, TrimError
from mbdlft.base.expression import evaluate
from mbdlft.base.grammar import parse
from mbdlft.base.parameter import Parameter
from mbdlft.dae.balance import Balance
from mbdlft.dae.operations import column_of
from mbdlft.dae.structure import Structure
from mbdlft.multibody.equilibrium.fit import fit_equilibrium
from mbdlft.sx.constants import in_doubles, is_constant, literal
from mbdlft.sx.fold import steps

_RATIONAL = {"input", "output", "const", "assign", "add", "sub", "mul", "div", "neg", "sq", "twice"}
_RATIONAL |= {"inv", "constpow", "pow"}
_SMALLEST = 1e-9  # of the nominal size of a variable: a value below this has that size


class Fitted(NamedTuple):
    """What was fitted.

    Attributes
    ----------
    values : mapping of names of unknowns to SX of the parameters
    slopes : mapping of (row, column) to SX of the parameters
        Entries of the Jacobian of [residual ; outputs] by [unknowns ; states ; inputs].
    bound : float
        Proved bound of all errors, each relative to the size of its quantity.
    """

    values: Mapping[str, ca.SX]
    slopes: Mapping[tuple[int, int], ca.SX]
    bound: float


def fitted(
    s: Structure,
    problem: Balance,
    left: Sequence[tuple[int, int]],
    at_nominal: Array,
    values: Mapping[str, ca.SX],
    tolerance: float,
) -> Fitted:
    """Fits of the unknowns that are left, and of slopes that are not rational.

    Parameters
    ----------
    s : Structure
    problem : Balance
    left : sequence of (row, column) of `problem`
    at_nominal : array (n,)
        All unknowns of `problem` at nominal parameters.
    values : mapping of names to SX
        All others, exact; numbers or rational in the parameters.
    tolerance : float

    Raises
    ------
    TrimError
        The tolerance is not met, or there is a fold.
    NotRationalError
        An angle is among the parameters, or an operation cannot be bounded.
    """
    z = [problem.quantities[j] for _, j in left]
    known = [q for q in s.quantities if q.name in values]
    old = column_of([q.symbol for q in known])
    new = column_of([values[q.name] for q in known])
    own = [problem.residual[i] for i, _ in left]
    rows = ca.SX(ca.substitute(column_of(own), old, new))
    places, entries = _slopes(s, old, new)
    if not z and not entries:
        return Fitted({}, {}, 0.0)
    symbols = [q.symbol for q in z]
    start = at_nominal[[j for _, j in left]]
    sizes = [
        abs(x) if abs(x) > _SMALLEST * q.variable.nominal else q.variable.nominal
        for x, q in zip(start, z, strict=True)
    ]
    used, p = _parameters(s, [rows, *entries])
    at = ca.Function(
        "slopes", [column_of(symbols), p], [column_of([in_doubles(e) for e in entries])]
    )
    nominal, low, high = (
        np.array([getattr(q, end) for q in used]) for end in ("nominal", "low", "high")
    )
    slopes = np.ravel(at(start, nominal).full())
    sizes += [abs(x) if x else 1.0 for x in slopes]
    t = ca.SX.sym("t", len(sizes))
    scaled = [t[k] * size for k, size in enumerate(sizes)]
    both = ca.vertcat(rows, *(scaled[len(z) + k] - e for k, e in enumerate(entries)))
    residual = ca.substitute(in_doubles(both), column_of(symbols), column_of(scaled[: len(z)]))
    found = fit_equilibrium(
        ca.Function(s.dae.name.replace(".", "_") or "model", [t, p], [residual]),
        nominal,
        low,
        high,
        np.concatenate([start, slopes]) / sizes,
        tolerance,
        names=[q.name for q in used],
    )
    by_name = {q.name: symbol for q, symbol in zip(used, ca.vertsplit(p), strict=True)}
    made = [
        ca.SX(evaluate(parse(text), by_name, lambda x: ca.SX(literal(x)))) * literal(float(size))
        for text, size in zip(found.expressions, sizes, strict=True)
    ]
    return Fitted(
        {q.name: value for q, value in zip(z, made, strict=False)},
        dict(zip(places, made[len(z) :], strict=True)),
        float(np.max(found.bound)),
    )


def _slopes(s: Structure, old: ca.SX, new: ca.SX) -> tuple[list[tuple[int, int]], list[ca.SX]]:
    """Places and values of entries of the Jacobian that are not rational in what is left and p."""
    stacked = ca.vertcat(s.residual, *(y.expression for y in s.dae.outputs))
    J = ca.SX(ca.sparsify(ca.substitute(ca.jacobian(stacked, s.symbols), old, new)))
    places, entries = [], []
    for i, j in zip(*J.sparsity().get_triplet(), strict=True):
        if not is_rational(J[i, j]):
            places.append((i, j))
            entries.append(J[i, j])
    return places, entries


def is_rational(expression: ca.SX) -> bool:
    """Whether an expression has + - * / and powers of its symbols only; functions of numbers pass."""
    if is_constant(expression):
        return True
    function = ca.Function("f", [column_of(ca.symvar(expression))], [ca.densify(expression)])
    return all(name in _RATIONAL for name, _, _ in steps(function))


def _parameters(s: Structure, expressions: Sequence[ca.SX]) -> tuple[list[Parameter], ca.SX]:
    """The parameters that expressions depend on, and their symbols.

    Raises
    ------
    NotRationalError, TrimError
        An angle is among them; there is none.
    """
    stacked = ca.vertcat(*expressions)
    symbols = ca.vertsplit(s.dae.p)
    pairs = [
        (p, symbol)
        for p, symbol in zip(s.dae.parameters, symbols, strict=True)
        if ca.depends_on(stacked, symbol)
    ]
    angles = [p.name for p, _ in pairs if p.is_angle]
    if angles:
        raise NotRationalError(
            f"{s.owner}, fit of the equilibrium: it depends on the angle {angles[0]}; fits are of "
            "parameters that are no angles."
        )
    if not pairs:
        raise TrimError(f"{s.owner}, fit of the equilibrium: it depends on no parameter.")
    return [p for p, _ in pairs], column_of([symbol for _, symbol in pairs])
