"""The waist between front ends and the pipeline: what a scene, a matrix, or any other source becomes.

A front end makes one `Problem`. Everything after it (extraction, reduction, bound, search, check,
certificate) knows nothing else, and exists once. Its linear relations with parameters are SX, linear in
the perturbations, rational in the internal values:

    residual(unknown, known, p) = 0,   output(unknown, known, p)

The loads that make the equilibrium are *lifted*: the derivative of a load term with respect to one
displacement is linear in the load, so "load times displacement" is a signal, and every coefficient
then meets its signal in the order of the matrix product it comes from.

A transfer function needs only the states that its inputs drive and its outputs see (`needed_states`).
A graph has a node for each signal of the relations. Each equation is matched with one unknown, which
depends on the other signals of that equation; a state depends on its derivative. A state that the outputs
do not depend on is *not seen*; one that does not depend on the inputs stays zero, it is *not driven*.
Without either, the transfer function is the same for every value of the parameters.

A position is *cyclic* if nothing but its own rate has it: the angle of a wheel, the place of a rover. A
graph does not see what cancels, so that is decided on A and C modulo a prime.
"""

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from typing import NamedTuple

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array, vstack
from scipy.sparse.csgraph import maximum_bipartite_matching

from mbdlft.base.array import Array
from mbdlft.base.parameter import BilinearMap, Parameter
from mbdlft.base.unit import Signal
from mbdlft.exact.matrices import multiplied, solved
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
from mbdlft.problem.sx.constants import in_doubles, modulo_prime
from mbdlft.problem.trim import trim_rows

_SEED = 20261126  # of the residues that stand for parameters


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


def at_rest(
    equations: Equations,
    function: ca.Function,
    u: ca.SX,
    load: ca.SX,
    at: tuple[ca.SX, ca.SX, ca.SX],
    alone: ca.SX,
    scale: ca.SX,
) -> ca.SX:
    """Residual at rest, times `scale` as u and load are; `alone` is that of the spin of the frame."""
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
    """
    e, function = equations, equation_function(equations)
    symbols, p, cosine, sine = exact_symbols(e.parameters)
    unknown, unit = ca.SX.sym("u", len(e.unknown)), ca.SX.sym("one")
    u = ca.SX(given_value(e, p) * unit)
    u[list(e.unknown)] = unknown
    at = (p, cosine, sine)
    none = [ca.SX(s.numel(), 1) for s in (e.xdot, e.x, e.z, e.u, e.load)]
    alone = ca.sparsify(function(*none, *at)[0])
    residual = at_rest(e, function, u, load_value(e, p) * unit, at, alone, unit)
    rows = trim_rows(rounded(e))
    return LinearModel(rows_of(residual, rows), ca.SX(0, 1), unknown, unit, symbols, e.parameters)


def constraint_relations(
    equations: Equations, rows: Sequence[int], followers: Sequence[int]
) -> tuple[LinearModel, LinearModel] | None:
    """Relations 0 = G y - s of the coordinates that follow, and 0 = G G' y - s of all; None without rows.

    `rows` are those of the residual that hold the displacements of closed loops, G q = 0.
    """
    if not rows:
        return None
    e, n = equations, equations.degrees_of_freedom
    symbols, p, cosine, sine = exact_symbols(e.parameters)
    held = ca.jacobian(rows_of(e.residual, rows), e.x[:n])
    old, new = ca.vertcat(e.p, e.cosine, e.sine), ca.densify(ca.vertcat(p, cosine, sine))
    G = ca.sparsify(ca.substitute(held, old, new))
    y, s = ca.SX.sym("y", len(rows)), ca.SX.sym("s", len(rows))
    none = ca.SX(0, 1)
    follow = ca.mtimes(G[:, list(followers)], y) - s
    whole = ca.mtimes(G, ca.mtimes(G.T, y)) - s
    square, every = (LinearModel(r, none, y, s, symbols, e.parameters) for r in (follow, whole))
    return square, every


Mask = NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class Need:
    """Relations of the states that are kept."""

    relations: LinearModel  # its first unknowns are the derivatives of the kept states
    states: tuple[int, ...]  # positions of the kept states among all of them
    # seen, driven: (n_x,), of all states; those with both are kept
    seen: Mask
    driven: Mask

    def of(self, matrices: Array) -> Array:
        """[A B ; C D] (N, ., .) of the kept states, from those of all states."""
        if self.keeps_all:
            return matrices
        rows, columns = self.kept(*matrices.shape[1:])
        kept_entries: Array = matrices[:, rows[:, None], columns]
        return kept_entries

    def omitted(self, matrices: Array, scale: Array) -> float:
        """Largest error of leaving out states, relative to `scale`; zero if they do not matter.

        `matrices` (N, ., .) are [A B ; C D] of all states: no state that is not seen may act on one that
        is, or on an output; none that is not driven may be acted on by one that is, or by an input.
        """
        count = len(self.seen)
        size = np.max(np.abs(matrices), axis=0) / scale
        rows, columns = (np.arange(n) for n in size.shape)
        seen_rows = np.r_[np.flatnonzero(self.seen), rows[count:]]
        driven_columns = np.r_[np.flatnonzero(self.driven), columns[count:]]
        unseen = size[np.ix_(seen_rows, np.flatnonzero(~self.seen))]
        undriven = size[np.ix_(np.flatnonzero(~self.driven), driven_columns)]
        return float(max(np.max(unseen, initial=0.0), np.max(undriven, initial=0.0)))

    @property
    def keeps_all(self) -> bool:
        """Whether no state is left out."""
        return len(self.states) == len(self.seen)

    def kept(self, rows: int, columns: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Rows and columns that are kept of [A B ; C D] with so many."""
        kept, count = np.array(self.states, dtype=np.intp), len(self.seen)
        return np.r_[kept, count:rows], np.r_[kept, count:columns]


def all_states(relations: LinearModel, states: int, ignorable: Sequence[int] = ()) -> Need:
    """The relations as they are, but for those states among `ignorable` that no other one and no output
    depends on."""
    m, every = relations, np.ones(states, dtype=bool)
    if not ignorable:
        return Need(m, tuple(range(states)), every, every)
    n, known = m.unknown.numel(), m.known.numel()
    seen = _seen_exactly(m, states, ignorable)
    kept, dropped = np.flatnonzero(seen).tolist(), np.flatnonzero(~seen).tolist()
    both, lifted = _stilled(m, ca.vertcat(m.residual, m.output), rows_of(m.known, dropped))
    residual, output = ca.vertsplit(both, [0, n, both.numel()])
    smaller = replace(
        m,
        residual=residual,
        output=output,
        unknown=rows_of(m.unknown, [*kept, *range(states, n), *dropped]),
        known=rows_of(m.known, [*kept, *range(states, known)]),
        derivatives=len(kept),
        lifted=lifted,
    )
    return Need(smaller, tuple(kept), seen, every)


def _seen_exactly(m: LinearModel, states: int, ignorable: Sequence[int]) -> Mask:
    """Which states (n_x,) are not ignorable, or have others or outputs that depend on them."""
    n = m.unknown.numel()
    both = _with_factors(m, ca.vertcat(m.residual, m.output))
    slopes = modulo_prime(ca.jacobian(both, ca.vertcat(m.unknown, m.known[:states])), _SEED)
    matrix, prime = slopes.residues.astype(np.int64), slopes.prime
    seen = np.ones(states, dtype=bool)
    try:
        follow = solved(matrix[:n, :n], matrix[:n, n:], prime)
    except ZeroDivisionError:
        return seen  # singular; to be reported where they are solved
    outputs = (matrix[n:, n:] - multiplied(matrix[n:, :n], follow, prime)) % prime
    seen[list(ignorable)] = outputs[:, list(ignorable)].any(axis=0)
    while np.any(more := follow[:states][seen].any(axis=0) & ~seen):
        seen |= more
    return seen


def needed_states(relations: LinearModel, states: int) -> Need:
    """The relations without states and signals that are not driven or not seen; states come first."""
    m = relations
    n, known, outputs = m.unknown.numel(), m.known.numel(), m.output.numel()
    rows = _pattern(m)
    matched = maximum_bipartite_matching(csr_array(rows[:n, :n]), perm_type="row")
    if np.any(matched < 0):
        return all_states(m, states)  # singular; to be reported where they are solved
    derivative = csr_array(
        (np.ones(states), (np.arange(states), np.arange(states))), shape=(known, n + known)
    )
    on = csr_array(vstack([rows[matched], derivative, rows[n:]]))
    every = np.arange(n + known + outputs)
    on.resize((len(every), len(every)))
    seen = _reached(csr_array(on.T), every >= n + known)
    driven = _reached(on, (every >= n + states) & (every < n + known))
    of_states = slice(n, n + states)
    kept = seen & driven
    first = [k for k in range(states) if kept[n + k]]
    others = [k for k in range(n) if kept[k] and not (k < states and kept[n + k])]
    unknown = first + others
    still = ca.vertcat(
        rows_of(m.unknown, np.flatnonzero(~driven[:n]).tolist()),
        rows_of(m.known, np.flatnonzero(~driven[of_states]).tolist()),
    )
    both = ca.vertcat(rows_of(m.residual, [int(matched[k]) for k in unknown]), m.output)
    both, lifted = _stilled(m, both, still)
    residual, output = ca.vertsplit(both, [0, len(unknown), both.numel()])
    inputs = list(range(states, known))
    return Need(
        LinearModel(
            residual=residual,
            output=output,
            unknown=rows_of(m.unknown, unknown),
            known=rows_of(m.known, first + inputs),
            p=m.p,
            parameters=m.parameters,
            derivatives=len(first),
            lifted=lifted,
        ),
        tuple(first),
        seen[of_states],
        driven[of_states],
    )


def _stilled(m: LinearModel, both: ca.SX, still: ca.SX) -> tuple[ca.SX, Lifted | None]:
    """Rows of the relations without signals that stay zero, and the loads that are left in them."""
    lifted = m.lifted
    if lifted:
        displacements = enumerate(ca.vertsplit(lifted.displacements))
        unmoved = [j for j, displacement in displacements if ca.depends_on(displacement, still)]
        still = ca.vertcat(still, rows_of(lifted.loads, unmoved))
    both = ca.substitute(both, still, ca.SX.zeros(still.numel()))
    if lifted:
        lifted = lifted.chosen(
            [j for j in range(len(lifted.outputs)) if ca.depends_on(both, lifted.loads[j])]
        )
    return both, lifted


def _with_factors(m: LinearModel, both: ca.SX) -> ca.SX:
    """Rows with symbols times displacements in place of lifted loads, so that nothing cancels."""
    if not m.lifted:
        return both
    factors = ca.SX.sym("load", m.lifted.loads.numel())
    return ca.SX(ca.substitute(both, m.lifted.loads, factors * m.lifted.displacements))


def _pattern(m: LinearModel) -> csr_array:
    """Which of the rows [residual ; output] have which of the signals [unknown ; known]."""
    both = _with_factors(m, in_doubles(ca.vertcat(m.residual, m.output)))
    sparsity = ca.jacobian_sparsity(both, ca.vertcat(m.unknown, m.known))
    rows, columns = sparsity.get_triplet()
    return csr_array((np.ones(len(rows)), (rows, columns)), shape=sparsity.shape)


def _reached(graph: csr_array, start: Mask) -> Mask:
    """Nodes from which, or at which, a way along the edges row -> column ends in `start`."""
    reached, front = start, start
    while np.any(front):
        front = (graph @ front.astype(float) > 0.0) & ~reached
        reached = reached | front
    return reached


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
