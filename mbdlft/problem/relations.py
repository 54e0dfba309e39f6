"""The waist between front ends and the pipeline: what a scene, a matrix, or any other source becomes.

A front end makes one `Problem`. Everything after it (extraction, reduction, bound, search, check,
certificate) knows nothing else, and exists once. Its linear relations with parameters are SX, linear in
the perturbations, rational in the internal values:

    residual(unknown, known, p) = 0,   output(unknown, known, p)

The loads that make the equilibrium are *lifted*: the derivative of a load term with respect to one
displacement is linear in the load, so "load times displacement" is a signal, and every coefficient
then meets its signal in the order of the matrix product it comes from.
"""

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from typing import NamedTuple

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from mbdlft.base.array import Array
from mbdlft.base.parameter import BilinearMap, Parameter
from mbdlft.base.unit import Signal
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


class Lifted(NamedTuple):
    """Trim loads times displacements: load j is the output `outputs[j]` of the trim times displacement j.

    The trim loads are rational in the parameters alone, so their relations stand here once, whatever
    number of displacements they are multiplied with.
    """

    loads: ca.SX  # SX symbols (n_l,), signals in the residual and in the output
    displacements: ca.SX  # SX (n_l,), signals among the unknown and the known ones
    outputs: tuple[int, ...]  # (n_l,)
    trim: "LinearModel"  # its known signal is the constant 1

    def chosen(self, kept: Sequence[int]) -> "Lifted | None":
        """Some of the loads."""
        loads, displacements = rows_of(self.loads, kept), rows_of(self.displacements, kept)
        outputs = tuple(self.outputs[j] for j in kept)
        return Lifted(loads, displacements, outputs, self.trim) if kept else None


@dataclass(frozen=True, slots=True, eq=False)
class LinearModel:
    """0 = residual, y = output: SX expressions, linear in unknown and known, rational in p."""

    residual: ca.SX  # SX (n,)
    output: ca.SX  # SX (m,)
    unknown: ca.SX  # SX symbols (n,)
    known: ca.SX  # SX symbols (k,)
    p: ca.SX  # SX symbols, the internal values of `parameters`
    parameters: tuple[Parameter, ...]
    derivatives: int = 0  # how many of the unknowns, the first ones, are derivatives of the states
    lifted: Lifted | None = None


def linearize(equations: Equations, inputs: Sequence[int], outputs: Sequence[int]) -> LinearModel:
    """Linearized equations around the equilibrium, for every p at once.

    unknown = [xdot of the states ; what follows from them ; z], known = [x of the states ; u[inputs]],
    output = y[outputs]; and the lifted unknown loads.
    """
    e, function = equations, equation_function(equations)
    symbols, p, cosine, sine = exact_symbols(e.parameters)
    at = (p, cosine, sine)
    chosen = ca.SX(e.u.numel(), 1)
    for k in inputs:
        chosen[k] = e.u[k]
    load = ca.SX.sym("load", e.load.numel())
    none = [ca.SX(s.numel(), 1) for s in (e.xdot, e.x, e.z, e.u, e.load)]
    # xdot, z and u enter linearly, beside what the spin of the frame makes: it may cancel in each row
    moved = ca.SX(ca.vertcat(*function(e.xdot, none[1], e.z, chosen, none[4], *at)))
    signals = ca.vertcat(e.xdot, e.z, rows_of(e.u, inputs))
    moved = ca.SX(ca.jtimes(moved, signals, signals))
    # x enters through the derivative at the equilibrium: springs and dampers, and lifted loads
    displaced = ca.vertcat(*function(none[0], e.x, none[2], e.u, load, *at))
    columns = ca.jtimes(displaced, e.x, ca.DM.eye(e.x.numel()))
    slopes = ca.Function("slopes", [e.x, e.u, load, symbols], [columns], WITH_CONSTANTS)
    linear = moved + ca.mtimes(ca.sparsify(slopes(none[1], none[3], none[4], symbols)), e.x)
    lifted, value = slopes(none[1], e.u, load, symbols), load_value(e, p)
    total, known_loads = ca.vertcat(load, e.u), given_value(e, p)
    n = e.residual.numel()
    is_loaded = bool(e.unknown) and _is_loaded(e, function, at)
    pairs = list[tuple[ca.SX, ca.SX, int]]()  # signals, displacements, positions among the unknown loads
    for k in range(e.x.numel()):
        column = lifted[:, k]
        if not ca.depends_on(column, total):
            continue
        times = known_loads * e.x[k]
        if is_loaded:
            by = ca.jacobian_sparsity(column, rows_of(e.u, e.unknown)).get_col()
            for j in sorted(set(by)):
                signal = ca.SX.sym("lifted")
                times[e.unknown[j]] = signal
                pairs.append((signal, e.x[k], j))
        linear = linear + ca.jtimes(column, total, ca.vertcat(value * e.x[k], times))
    unknown, known_signals = split(e, inputs)
    return LinearModel(
        residual=linear[:n],
        output=rows_of(linear[n:], outputs),
        unknown=unknown,
        known=known_signals,
        p=symbols,
        parameters=e.parameters,
        derivatives=len(e.states),
        lifted=_lifted(e, pairs),
    )


def _is_loaded(e: Equations, function: ca.Function, at: tuple[ca.SX, ca.SX, ca.SX]) -> bool:
    """Whether anything acts on the equilibrium; else the unknown loads are zero for all parameters."""
    none = [ca.SX(s.numel(), 1) for s in (e.xdot, e.x, e.z)]
    offset = function(*none, given_value(e, at[0]), load_value(e, at[0]), *at)[0]
    return bool(ca.sparsify(offset).nnz())


def _lifted(e: Equations, pairs: Sequence[tuple[ca.SX, ca.SX, int]]) -> Lifted | None:
    if not pairs:
        return None
    signals, displacements, loads = zip(*pairs, strict=True)
    felt = sorted(set(loads))
    trim = trim_relations(e)
    trim = replace(trim, output=rows_of(trim.unknown, felt))
    return Lifted(ca.vertcat(*signals), ca.vertcat(*displacements), tuple(map(felt.index, loads)), trim)


def trim_relations(equations: Equations) -> LinearModel:
    """Relations of the trim, left implicit: 0 = residual at rest, linear in u and in the load.

    unknown = the unknown entries of u, known = the constant 1, output = nothing.
    """
    e, function = equations, equation_function(equations)
    symbols, p, cosine, sine = exact_symbols(e.parameters)
    unknown, unit = ca.SX.sym("u", len(e.unknown)), ca.SX.sym("one")
    u, load = ca.SX(given_value(e, p) * unit), ca.SX.sym("load", e.load.numel())
    u[list(e.unknown)] = unknown
    at, none = (p, cosine, sine), [ca.SX(s.numel(), 1) for s in (e.xdot, e.x, e.z, e.u, e.load)]
    acting, _ = function(*none[:3], e.u, load, *at)  # linear in both, beside what the spin makes
    acting = ca.jtimes(acting, ca.vertcat(e.u, load), ca.vertcat(u, load_value(e, p) * unit))
    residual = acting + ca.sparsify(function(*none, *at)[0]) * unit
    rows = trim_rows(rounded(e))
    return LinearModel(rows_of(residual, rows), ca.SX(0, 1), unknown, unit, symbols, e.parameters)


def constraint_relations(
    equations: Equations, rows: Sequence[int], followers: Sequence[int]
) -> tuple[LinearModel, LinearModel] | None:
    """Relations 0 = G y - s of the coordinates that follow, and 0 = G G' y - s of all; None without rows.

    `rows` are those of the residual that hold rates, G v = 0, `followers` positions in x of rates.
    """
    if not rows:
        return None
    e, n = equations, equations.degrees_of_freedom
    symbols, p, cosine, sine = exact_symbols(e.parameters)
    held = ca.jacobian(rows_of(e.residual, rows), e.x[n:])
    old, new = ca.vertcat(e.p, e.cosine, e.sine), ca.densify(ca.vertcat(p, cosine, sine))
    G = ca.sparsify(ca.substitute(held, old, new))
    y, s = ca.SX.sym("y", len(rows)), ca.SX.sym("s", len(rows))
    none = ca.SX(0, 1)
    follow = ca.mtimes(G[:, [k - n for k in followers]], y) - s
    whole = ca.mtimes(G, ca.mtimes(G.T, y)) - s
    square, every = (LinearModel(r, none, y, s, symbols, e.parameters) for r in (follow, whole))
    return square, every


Complex = NDArray[np.complex128]
Stage = Callable[[str], AbstractContextManager[object]]  # times what is done in it, by its name


class Nouns(NamedTuple):
    """How messages name a problem."""

    # kind, name: such as "scene" and "arm"
    kind: str
    name: str
    truth: str  # what the model is checked against, such as "the nonlinear equations"
    badly_scaled: str  # why rounding may be large, a clause
    # what helps beside narrower ranges where the model is singular; begins with a comma
    narrow: str = ""

    @property
    def owner(self) -> str:
        """Such as "scene 'arm'"."""
        return f"{self.kind} {self.name!r}"


@dataclass(frozen=True, slots=True, eq=False)
class Form:
    """One way to write the linear relations of a problem; all forms have the same solution."""

    relations: LinearModel  # solved for their unknown signals they give [A B ; C D]
    # for each parameter: from deltas to the symbols of the relations, if these are not the
    # internal values
    maps: tuple[BilinearMap, ...] | None = None
    # the relations are those of the transpose; they have no derivatives then
    is_transposed: bool = False
    # made from the values of the matrix: numbers are not those of the problem, and unknown signals may be
    # undetermined where the matrix is finite
    is_from_values: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class Reference:
    """Values of [A B ; C D] at points, by another computation: what a model is checked against."""

    values: Array  # (N, rows, columns)
    scale: Array  # (rows, columns), what the error of an entry is relative to
    # `scale` for entries that are nothing but rounding of terms that cancelled
    if_cancelled: Callable[[], Array]
    # sizes (N, rows, columns) if nothing cancelled, which rounding of the data is relative to
    sizes: Callable[[], Array]
    least: Array  # (rows, columns), of a value: a smaller one is negligible at a point
    trimmed: Array  # (N, n_t), trimmed quantities
    trim_scale: Array  # (n_t,)
    # function of positions among the points and of frequencies (F,) in rad/s: transfer functions
    # (N, F, n_y, n_u)
    transfers: Callable[[Sequence[int], Array], Complex]
    # the same in 50 digits, rounded at the end
    transfers_in_digits: Callable[[Sequence[int], Array], Complex]
    # function of some of the points (N, n_p), or None: values there in 50 digits, rounded at the
    # end; None where `values` are that already
    in_digits: Callable[[Array], Array] | None = None
    # `trimmed` in 50 digits, rounded at the end, and `trim_scale` for quantities whose terms cancelled
    # already in the numbers of the problem: at least a part of what a displacement of 1 rad or 1 m
    # makes of them
    trim_in_digits: Callable[[], tuple[Array, Array]] | None = None
    # largest error that leaving out states has made, in roundings of the terms of an entry
    omitted: Callable[[], float] = float


class TrimRelations(NamedTuple):
    """What the equilibrium is held by: relations linear in it, names, numbers at nominal."""

    relations: LinearModel
    signals: tuple[Signal, ...]
    nominal: tuple[float, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Problem:
    """Linear relations with parameters, and what is needed to make a certified model of them."""

    nouns: Nouns
    description: str
    text: str  # TOML text that the problem can be made from again, for the provenance
    states: tuple[Signal, ...]
    inputs: tuple[Signal, ...]
    outputs: tuple[Signal, ...]
    parameters: tuple[Parameter, ...]  # sorted by name
    forms: tuple[Form, ...]  # ways to write the relations, all of which are looked at
    points: Array  # (N, n_p), physical values at which models are checked; the first is nominal
    reference: Callable[[], Reference]  # values at the points
    # ways that are looked at only while the order is above its bound
    more_forms: Callable[[], Sequence[Form]] = tuple
    # function of a condition number and of names of states: what to say where the relations cannot
    # be solved at nominal
    singular: Callable[[float, Sequence[str]], str] = lambda number, names: "singular"
    trim: TrimRelations | None = None
    # row_units, column_units: arrays (rows,) and (columns,) of powers of two, or None: the
    # relations are those of the matrix with rows and columns divided by these
    row_units: Array | None = None
    column_units: Array | None = None
    # whether the relations are proved to determine the unknown signals
    # at every value of the parameters; False says that it was not proved
    is_regular: Callable[[], bool] = lambda: False
    # of closed loops with constraints G: relations 0 = G y - s of the coordinates that follow, which are
    # regular only where 0 = G G' y - s of all are, and these where the constraints are independent
    constraints: Callable[[], tuple[LinearModel, LinearModel] | None] = lambda: None
    # guaranteed bound of the error of equilibrium positions that are fits; 0.0 if there are none
    fit_error_bound: float = 0.0
