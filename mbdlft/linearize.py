"""Linear relations with parameters: SX, linear in the perturbations, rational in the internal values.

    residual(unknown, known, p) = 0,   output(unknown, known, p)

The loads that make the equilibrium are *lifted*: the derivative of a load term with respect to one
displacement is linear in the load, so "load times displacement" is a signal, and every coefficient
then meets its signal in the order of the matrix product it comes from.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca

from mbdlft.equations import Equations, equation_function, internal_symbols, load_value
from mbdlft.errors import TrimError
from mbdlft.parameter import Parameter


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
    """

    residual: ca.SX
    output: ca.SX
    unknown: ca.SX
    known: ca.SX
    p: ca.SX
    parameters: tuple[Parameter, ...]


def linearize(equations: Equations, inputs: Sequence[int], outputs: Sequence[int]) -> LinearModel:
    """Linearized equations around the equilibrium, for every p at once.

    unknown = [xdot ; z], known = [x ; u[inputs]], output = y[outputs].
    """
    e, function = equations, equation_function(equations)
    symbols, p, cosine, sine = internal_symbols(e.parameters)
    xdot, x, z = (
        ca.SX.sym(name, s.numel()) for name, s in (("xdot", e.xdot), ("x", e.x), ("z", e.z))
    )
    selected = ca.SX.sym("u", len(inputs))
    u = ca.SX(e.u.numel(), 1)
    for k, column in enumerate(inputs):
        u[column] = selected[k]
    load = ca.SX.sym("load", e.load.numel())
    none = [ca.SX(s.numel(), 1) for s in (e.xdot, e.x, e.z, e.u, e.load)]
    # xdot, z and u enter linearly as they are
    moved = ca.vertcat(*function(xdot, none[1], z, u, none[4], p, cosine, sine))
    # x enters through the derivative at the equilibrium: springs and dampers, and lifted loads
    displaced = ca.vertcat(*function(none[0], x, none[2], none[3], load, p, cosine, sine))
    columns = ca.jtimes(displaced, x, ca.DM.eye(x.numel()))
    slopes = ca.Function("slopes", [x, load, symbols], [columns])
    linear = moved + ca.mtimes(ca.sparsify(slopes(none[1], none[4], symbols)), x)
    lifted, value = slopes(none[1], load, symbols), load_value(e, p)
    for k in range(x.numel()):
        linear = linear + ca.jtimes(lifted[:, k], load, value * x[k])
    n = e.residual.numel()
    return LinearModel(
        residual=linear[:n],
        output=linear[n:][list(outputs)],
        unknown=ca.vertcat(xdot, z),
        known=ca.vertcat(x, selected),
        p=symbols,
        parameters=e.parameters,
    )


def trim_relations(equations: Equations) -> LinearModel:
    """Relations of the trim, left implicit: 0 = residual at rest, linear in u and in the load.

    unknown = u, known = the constant 1, output = nothing.

    Raises
    ------
    TrimError
        There are not as many relations as efforts.
    """
    e, function = equations, equation_function(equations)
    symbols, p, cosine, sine = internal_symbols(e.parameters)
    u, one = ca.SX.sym("u", e.u.numel()), ca.SX.sym("one")
    none = [ca.SX(s.numel(), 1) for s in (e.xdot, e.x, e.z)]
    residual, _ = function(*none, u, load_value(e, p) * one, p, cosine, sine)
    rows = sorted(set(ca.jacobian_sparsity(residual, u).row()))
    if len(rows) != u.numel():
        raise TrimError(
            f"scene {e.name!r}: {u.numel()} unknown efforts and {len(rows)} equations of equilibrium."
        )
    return LinearModel(residual[rows], ca.SX(0, 1), u, one, symbols, e.parameters)
