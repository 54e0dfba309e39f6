"""Linear relations with parameters: SX, linear in the perturbations, rational in the internal values.

    residual(unknown, known, p) = 0,   output(unknown, known, p)

The loads that make the equilibrium are *lifted*: the derivative of a load term with respect to one
displacement is linear in the load, so "load times displacement" is a signal, and every coefficient
then meets its signal in the order of the matrix product it comes from.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca

from mbdlft.base.parameter import Parameter
from mbdlft.problem.equations import (
    WITH_CONSTANTS,
    Equations,
    equation_function,
    exact_symbols,
    given_value,
    load_value,
    rounded,
    rows_of,
    split,
)
from mbdlft.problem.trim import trim_rows


@dataclass(frozen=True, slots=True, eq=False)
class LinearModel:
    """0 = residual, y = output: SX expressions, linear in unknown and known, rational in p.

    Attributes
    ----------
    residual : SX (n,)
    output : SX (m,)
    unknown : SX symbols (n,)
    known : SX symbols (k,)
    p : SX symbols, the internal values of `parameters`
    derivatives : int
        How many of the unknowns, the first ones, are derivatives of the states.
    """

    residual: ca.SX
    output: ca.SX
    unknown: ca.SX
    known: ca.SX
    p: ca.SX
    parameters: tuple[Parameter, ...]
    derivatives: int = 0


def linearize(equations: Equations, inputs: Sequence[int], outputs: Sequence[int]) -> LinearModel:
    """Linearized equations around the equilibrium, for every p at once.

    unknown = [xdot of the states ; what follows from them ; z ; lifted trim loads],
    known = [x of the states ; u[inputs]], output = y[outputs].
    """
    e, function = equations, equation_function(equations)
    symbols, p, cosine, sine = exact_symbols(e.parameters)
    at = (p, cosine, sine)
    chosen = ca.SX(e.u.numel(), 1)
    for k in inputs:
        chosen[k] = e.u[k]
    load = ca.SX.sym("load", e.load.numel())
    none = [ca.SX(s.numel(), 1) for s in (e.xdot, e.x, e.z, e.u, e.load)]
    # xdot, z and u enter linearly as they are, beside what the spin of the frame makes
    alone = ca.SX(ca.sparsify(ca.vertcat(*function(*none, *at))))
    moved = ca.SX(ca.vertcat(*function(e.xdot, none[1], e.z, chosen, none[4], *at)))
    if alone.nnz():
        signals = ca.vertcat(e.xdot, e.z, rows_of(e.u, inputs))
        moved = ca.SX(ca.jtimes(moved, signals, signals))
    # x enters through the derivative at the equilibrium: springs and dampers, and lifted loads
    displaced = ca.vertcat(*function(none[0], e.x, none[2], e.u, load, *at))
    columns = ca.jtimes(displaced, e.x, ca.DM.eye(e.x.numel()))
    slopes = ca.Function("slopes", [e.x, e.u, load, symbols], [columns], WITH_CONSTANTS)
    linear = moved + ca.mtimes(ca.sparsify(slopes(none[1], none[3], none[4], symbols)), e.x)
    lifted, value = slopes(none[1], e.u, load, symbols), load_value(e, p)
    total, given = ca.vertcat(load, e.u), given_value(e, p)
    n = e.residual.numel()
    implicit = _Implicit(e, function, at, alone[:n])
    for k in range(e.x.numel()):
        column = lifted[:, k]
        if not ca.depends_on(column, total):
            continue
        times = given * e.x[k]
        if e.unknown and ca.depends_on(column, e.u[list(e.unknown)]):
            times = implicit.times(value * e.x[k], times, e.x[k])
        linear = linear + ca.jtimes(column, total, ca.vertcat(value * e.x[k], times))
    unknown, known = split(e, inputs)
    return LinearModel(
        residual=ca.vertcat(linear[:n], *implicit.relations),
        output=rows_of(linear[n:], outputs),
        unknown=ca.vertcat(unknown, *implicit.unknown),
        known=known,
        p=symbols,
        parameters=e.parameters,
        derivatives=len(e.states),
    )


class _Implicit:
    """Unknown trim loads times displacements: signals l with A(p) l = b(p) dx, never solved for here."""

    def __init__(
        self,
        equations: Equations,
        function: ca.Function,
        at: tuple[ca.SX, ca.SX, ca.SX],
        alone: ca.SX,
    ) -> None:
        self.equations, self.function, self.at, self.alone = equations, function, at, alone
        self.loaded = is_loaded(equations)
        self.unknown: list[ca.SX] = []
        self.relations: list[ca.SX] = []

    def times(self, load: ca.SX, given: ca.SX, displacement: ca.SX) -> ca.SX:
        """u (n_u,) times a displacement; `load` and `given` are what they stand for times it."""
        e = self.equations
        if not self.loaded:
            return given
        signals = ca.SX.sym("lifted", len(e.unknown))
        u = ca.SX(given)
        u[list(e.unknown)] = signals
        self.unknown.append(signals)
        relations = at_rest(e, self.function, u, load, self.at, self.alone, displacement)
        self.relations.append(rows_of(relations, trim_rows(rounded(e))))
        return u


def is_loaded(equations: Equations) -> bool:
    """Whether anything acts on the equilibrium: else the unknown efforts are zero for all parameters."""
    e, function = equations, equation_function(equations)
    _, p, cosine, sine = exact_symbols(e.parameters)
    none = [ca.SX(s.numel(), 1) for s in (e.xdot, e.x, e.z)]
    offset = function(*none, given_value(e, p), load_value(e, p), p, cosine, sine)[0]
    return bool(ca.sparsify(offset).nnz())


def at_rest(
    equations: Equations,
    function: ca.Function,
    u: ca.SX,
    load: ca.SX,
    at: tuple[ca.SX, ca.SX, ca.SX],
    alone: ca.SX,
    scale: ca.SX,
) -> ca.SX:
    """Residual at rest, times `scale`: u and load are already multiplied by it.

    `alone` is the residual without either, what the spin of the frame needs.
    """
    e = equations
    none = [ca.SX(s.numel(), 1) for s in (e.xdot, e.x, e.z, e.u, e.load)]
    if not alone.nnz():
        return ca.SX(function(*none[:3], u, load, *at)[0])
    symbol = ca.SX.sym("load", e.load.numel())
    residual, _ = function(*none[:3], e.u, symbol, *at)
    acting = ca.jtimes(residual, ca.vertcat(e.u, symbol), ca.vertcat(u, load))
    return ca.SX(acting + alone * scale)


def trim_relations(equations: Equations) -> LinearModel:
    """Relations of the trim, left implicit: 0 = residual at rest, linear in u and in the load.

    unknown = the unknown entries of u, known = the constant 1, output = nothing.

    Raises
    ------
    TrimError
        The unknown efforts are redundant.
    """
    e, function = equations, equation_function(equations)
    symbols, p, cosine, sine = exact_symbols(e.parameters)
    unknown, one = ca.SX.sym("u", len(e.unknown)), ca.SX.sym("one")
    u = ca.SX(given_value(e, p) * one)
    u[list(e.unknown)] = unknown
    at = (p, cosine, sine)
    none = [ca.SX(s.numel(), 1) for s in (e.xdot, e.x, e.z, e.u, e.load)]
    alone = ca.sparsify(function(*none, *at)[0])
    residual = at_rest(e, function, u, load_value(e, p) * one, at, alone, one)
    rows = trim_rows(rounded(e))
    return LinearModel(rows_of(residual, rows), ca.SX(0, 1), unknown, one, symbols, e.parameters)
