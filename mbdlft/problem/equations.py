"""The waist above the extraction: implicit equations of motion in CasADi SX, nothing inverted."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import NamedTuple

import casadi as ca

from mbdlft.base.parameter import Parameter, cosine_sine_parts
from mbdlft.base.unit import Signal, parse_unit
from mbdlft.problem.sx.constants import cosine_sine, in_doubles

WITH_CONSTANTS = {"allow_free": True}  # functions of expressions with constants of `sx.constants`
CURVED = 10.0  # of the bound of a fit: what terms of second order may add to what it explains


class Moved(NamedTuple):
    """A coordinate with imposed motion, and positions in u of displacement, rate, acceleration."""

    coordinate: int
    inputs: tuple[int, int, int]


@dataclass(frozen=True, slots=True, eq=False)
class Equations:
    """0 = residual(xdot, x, z, u, p, cosine, sine, load),  y = output(...).

    x = 0, xdot = 0, z = 0 is the equilibrium for every p, once u takes its trim value. The equations
    are linear in `load`, the uniform acceleration that makes the equilibrium, whose value is
    `load_value`, and in u. In x they hold to the first order.
    """

    name: str
    # SX (2 n + 3 m,), n kinematic and n dynamic equations; those of m loop closures for
    # displacements, rates and accelerations; then two for each of `moved`
    residual: ca.SX
    output: ca.SX  # SX (n_y,)
    # xdot, x: SX symbols (2 n,), displacements, then rates, of all joints
    xdot: ca.SX
    x: ca.SX
    z: ca.SX  # SX symbols (m,), multipliers of loop closures, deviations from the trim
    # u, load: SX symbols: u: efforts, magnitudes of loads, accelerations, multipliers; total values
    u: ca.SX
    load: ca.SX
    # SX symbols (n_p,), one for each parameter, in its own unit; that of an angle is not used
    p: ca.SX
    # cosine, sine: SX symbols (n_p,), of each angle parameter; those of the others are not used
    cosine: ca.SX
    sine: ca.SX
    load_value: ca.SX  # SX, function of p
    # SX (n_u,), function of p, trim values of the entries of u that are given; zero for the others
    given: ca.SX
    unknown: tuple[int, ...]  # positions in u of those that the trim solves for
    inputs: tuple[int, ...]  # positions in u of those that can be inputs
    # positions in x of the states; the other entries follow from the loop closures
    states: tuple[int, ...]
    # x_signals, u_signals, y_signals: names and units; x_signals are those of the states
    x_signals: tuple[Signal, ...]
    u_signals: tuple[Signal, ...]
    y_signals: tuple[Signal, ...]
    # unbalanced effort of each of the n dynamic equations
    equilibrium_signals: tuple[Signal, ...]
    # default_inputs, default_outputs: positions of the signals a scene has if it names none
    default_inputs: tuple[int, ...]
    default_outputs: tuple[int, ...]
    # positions among the states of angles that a linear model leaves out: they are in no equation, as
    # what turns steadily is symmetric. An output may be one
    ignorable: tuple[int, ...]
    moved: tuple[Moved, ...]  # `Moved` coordinates, whose motion is an input
    # SX (n_c,), wrenches of the elastic bodies whose `prestress` is not said to be negligible; as
    # `output`
    carried: ca.SX
    carried_by: tuple[str, ...]  # name of the body of each entry of `carried`
    parameters: tuple[Parameter, ...]  # sorted by name
    # (n,), by how much the displacements may miss the equilibrium, where positions
    # are fits; else zero
    x_bounds: tuple[float, ...]
    u_bounds: tuple[float, ...]  # (n_u,), the same of given efforts

    @property
    def fit_error_bound(self) -> float:
        """Largest error of a position that is a fit (rad, m); 0.0 if the equilibrium is exact."""
        return max(self.x_bounds)

    @property
    def degrees_of_freedom(self) -> int:
        """n, the number of coordinates of all joints."""
        return int(self.x.numel()) // 2

    @property
    def followers(self) -> tuple[int, ...]:
        """Positions in x of the entries that follow from the loop closures."""
        return tuple(k for k in range(self.x.numel()) if k not in set(self.states))


@lru_cache(maxsize=2)
def rounded(equations: Equations) -> Equations:
    """The equations with doubles in place of their constants."""
    e = equations
    expressions = [e.residual, e.output, e.load_value, e.given, e.carried]
    ends = [0]
    for expression in expressions:
        ends.append(ends[-1] + expression.numel())
    residual, output, load, known, carried = ca.vertsplit(in_doubles(ca.vertcat(*expressions)), ends)
    return replace(e, residual=residual, output=output, load_value=load, given=known, carried=carried)


class ParameterSymbols(NamedTuple):
    """Arguments p, cosine, sine of the equations, and the symbols (n_p,) they are functions of."""

    symbols: ca.SX
    p: ca.SX
    cosine: ca.SX
    sine: ca.SX


def physical_symbols(parameters: tuple[Parameter, ...]) -> ParameterSymbols:
    """The equations as functions of physical values: cosines and sines of the angles themselves."""
    p = ca.SX.sym("p", len(parameters))
    factors = ca.DM([parse_unit(parameter.unit).factor for parameter in parameters])
    return ParameterSymbols(p, p, ca.cos(factors * p), ca.sin(factors * p))


@lru_cache(maxsize=1)  # the trim and the linearization of one scene share them
def exact_symbols(parameters: tuple[Parameter, ...]) -> ParameterSymbols:
    """Rational functions of internal values: angles by tangents of a part of them; nothing is rounded."""
    p = ca.SX.sym("internal", len(parameters))
    return ParameterSymbols(p, p, *cosines_sines(parameters, p))


def cosines_sines(parameters: Sequence[Parameter], p: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Cosines and sines (n_p,) of the angles among parameters of internal values p (n_p,), exact."""
    cosine, sine = ca.SX(len(parameters), 1), ca.SX(len(parameters), 1)
    for k, parameter in enumerate(parameters):
        if not parameter.is_angle:
            continue
        c, s, denominator = cosine_sine_parts(parameter.substitution, p[k])
        c0, s0 = cosine_sine(parameter.reference)
        cosine[k] = (c0 * c - s0 * s) / denominator
        sine[k] = (s0 * c + c0 * s) / denominator
    return cosine, sine


@lru_cache(maxsize=2)  # the stages of one scene share it, and there are two of each scene
def equation_function(equations: Equations) -> ca.Function:
    """(xdot, x, z, u, load, p, cosine, sine) -> (residual, output)."""
    e = equations
    arguments = [e.xdot, e.x, e.z, e.u, e.load, e.p, e.cosine, e.sine]
    return ca.Function("equations", arguments, [e.residual, e.output], WITH_CONSTANTS)


def load_value(equations: Equations, p: ca.SX) -> ca.SX:
    """The load (n_l,) at the parameter symbols p."""
    e = equations
    return ca.Function("load", [e.p], [e.load_value], WITH_CONSTANTS)(p)


def given_value(equations: Equations, p: ca.SX) -> ca.SX:
    """Trim values (n_u,) of the given efforts at the parameter symbols p; zero for the others."""
    e = equations
    return ca.Function("given", [e.p], [e.given], WITH_CONSTANTS)(p)


def rows_of(column: ca.SX, rows: Sequence[int]) -> ca.SX:
    """Some rows of a column (n, 1); CasADi makes a row of 1 x 0 of none of a single one."""
    return column[list(rows)] if rows else ca.SX(0, 1)


def split(equations: Equations, inputs: Sequence[int]) -> tuple[ca.SX, ca.SX]:
    """Unknown and known signals of the linear model.

    unknown = [xdot of the states ; xdot and x of the followers ; z], known = [x of the states ; u].
    """
    e = equations
    states, followers = list(e.states), list(e.followers)
    unknown = ca.vertcat(
        rows_of(e.xdot, states), rows_of(e.xdot, followers), rows_of(e.x, followers), e.z
    )
    return unknown, ca.vertcat(rows_of(e.x, states), rows_of(e.u, inputs))
