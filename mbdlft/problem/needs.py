"""Which states a model keeps: those that are needed, or all but cyclic ones.

A transfer function needs only the states that its inputs drive and its outputs see (`needed_states`).
A graph has a node for each signal of the relations. Each equation is matched with one unknown, which
depends on the other signals of that equation; a state depends on its derivative. A state that the outputs
do not depend on is *not seen*; one that does not depend on the inputs stays zero, it is *not driven*.
Without either, the transfer function is the same for every value of the parameters. What a graph does
not see are states that outputs do not see together: `free_modes`.

A position is *cyclic* if nothing but its own rate has it: the angle of a wheel, the place of a rover. A
graph does not see what cancels, so that is decided on A and C modulo a prime.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array, vstack
from scipy.sparse.csgraph import maximum_bipartite_matching

from mbdlft.base.array import Array
from mbdlft.base.unit import Signal
from mbdlft.exact.modular import Residues, entrywise, multiplied, solved
from mbdlft.problem.equations import rows_of
from mbdlft.problem.free_modes import FreeModes, free_modes
from mbdlft.problem.relations import Lifted, LinearModel
from mbdlft.problem.sx.constants import in_doubles, modulo_prime

_SEED = 20261126  # of the residues that stand for parameters

Mask = NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class Need:
    """Relations of the states that are kept."""

    relations: LinearModel  # its first unknowns are the derivatives of the kept states
    states: tuple[int, ...]  # positions of the kept states among all of them
    # seen, driven: (n_x,), of all states; those with both are kept
    seen: Mask
    driven: Mask
    free: FreeModes | None = None  # what others are measured from, and is not seen then

    def signals(self, every: Sequence[Signal]) -> tuple[Signal, ...]:
        """The kept states, of all of them."""
        if not self.free:
            return tuple(every[k] for k in self.states)
        names = [signal.name for signal in every]
        return tuple(Signal(self.free.name(k, names), every[k].unit) for k in self.states)

    def of(self, matrices: Array, points: Array, *, sizes: bool = False) -> Array:
        """[A B ; C D] (N, ., .) of the kept states, from those of all states at points (N, n_p).

        Or sizes of the entries, from sizes.
        """
        if self.keeps_all:
            return matrices
        rows, columns = self.kept(*matrices.shape[1:])
        turned = self.free.turned(matrices, points, sizes=sizes) if self.free else matrices
        kept_entries: Array = turned[:, rows[:, None], columns]
        return kept_entries

    def omitted(self, matrices: Array, scale: Array, points: Array) -> float:
        """Largest error of leaving out states, relative to `scale`; zero if they do not matter.

        `matrices` (N, ., .) are [A B ; C D] of all states at points (N, n_p): no state that is not seen
        may act on one that is, or on an output; none that is not driven may be acted on by one that is,
        or by an input.
        """
        count = len(self.seen)
        if self.free:
            matrices = self.free.turned(matrices, points)
            scale = self.free.turned(scale[None], points, sizes=True)[0]
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
    seen = _seen_exactly(m, states, ignorable)
    kept, dropped = np.flatnonzero(seen).tolist(), np.flatnonzero(~seen).tolist()
    smaller = _without(m, ca.vertcat(m.residual, m.output), kept, dropped)
    return Need(smaller, tuple(kept), seen, every)


def _without(m: LinearModel, both: ca.SX, kept: Sequence[int], dropped: Sequence[int]) -> LinearModel:
    """Relations of kept states, of rows [residual ; output] that do not depend on the dropped ones."""
    n, known, states = m.unknown.numel(), m.known.numel(), len(kept) + len(dropped)
    both, lifted = _stilled(m, both, rows_of(m.known, dropped))
    residual, output = ca.vertsplit(both, [0, n, both.numel()])
    return replace(
        m,
        residual=residual,
        output=output,
        unknown=rows_of(m.unknown, [*kept, *range(states, n), *dropped]),
        known=rows_of(m.known, [*kept, *range(states, known)]),
        derivatives=len(kept),
        lifted=lifted,
    )


def without_free_modes(need: Need) -> Need:
    """The relations with states measured from those of a free mode, which are gone."""
    m, count = need.relations, len(need.states)
    if not count:
        return need

    def at(values: Sequence[int], seed: int) -> tuple[Residues, Residues, int]:
        values_of = dict(zip((s.element_hash() for s in ca.vertsplit(m.p)), values, strict=True))
        return _dynamics(m, count, _SEED + seed, values_of)

    try:
        free = free_modes(at, m.parameters)
    except ZeroDivisionError:
        return need  # singular; to be reported where they are solved
    if free is None:  # other functions of parameters are in them
        alone = np.flatnonzero(~_seen_exactly(m, count, range(count)))
        free = FreeModes(tuple(alone.tolist()), {}, m.parameters)
    if not free.dropped:
        return need
    stay = [k for k in range(count) if k not in free.dropped]
    V = ca.SX(count, count)
    for (s, j), entry in free.entries.items():
        V[s, j] = entry.symbol(m.p)
    rates = m.unknown[:count]
    both = ca.substitute(ca.vertcat(m.residual, m.output), rates, rates + V @ rates)
    place = need.states
    entries = {(place[s], place[j]): entry for (s, j), entry in free.entries.items()}
    dropped = tuple(place[j] for j in free.dropped)
    return replace(
        need,
        relations=_without(m, both, stay, free.dropped),
        states=tuple(place[k] for k in stay),
        seen=need.seen & ~np.isin(np.arange(len(need.seen)), dropped),
        free=replace(free, dropped=dropped, entries=entries),
    )


def _seen_exactly(m: LinearModel, states: int, ignorable: Sequence[int]) -> Mask:
    """Which states (n_x,) are not ignorable, or have others or outputs that depend on them."""
    places, seen = list(ignorable), np.ones(states, dtype=bool)
    try:
        A, C, _ = _dynamics(m, states)
    except ZeroDivisionError:
        return seen  # singular; to be reported where they are solved
    seen[places] = C[:, places].any(axis=0)
    while np.any(more := A[seen].any(axis=0) & ~seen):
        seen |= more
    return seen


def felt_inputs(m: LinearModel) -> Mask:
    """Whether the column of [B ; D] of each input is not exactly zero; none if undetermined."""
    states = m.derivatives
    try:
        rates, outputs, _ = _dynamics(m, states, signals=m.known.numel())
    except ZeroDivisionError:  # to be reported where they are solved
        return np.zeros(m.known.numel() - states, dtype=bool)
    return np.asarray(np.vstack([rates, outputs])[:, states:].any(axis=0))


def _dynamics(
    m: LinearModel,
    states: int,
    seed: int = _SEED,
    values_of: Mapping[int, int] = MappingProxyType({}),
    signals: int | None = None,
) -> tuple[Residues, Residues, int]:
    """Residues of A and C, and the prime; a ZeroDivisionError if unknowns are not determined.

    Of [A B] and [C D] with as many known signals, if not the states only.
    """
    columns = states if signals is None else signals
    n, (matrix, prime) = m.unknown.numel(), _slopes(m, columns, seed, values_of)
    follow = solved(matrix[:n, :n], -matrix[:n, n:] % prime, prime)
    return follow[:states], (matrix[n:, n:] + multiplied(matrix[n:, :n], follow, prime)) % prime, prime


def _slopes(m: LinearModel, known: int, seed: int, values_of: Mapping[int, int]) -> tuple[Residues, int]:
    """Residues of the slopes of [residual ; output] by [unknown ; known], and the prime.

    Parameters are given by the hashes of their symbols, or random.

    Loads of the trim have their own residues: what they do cancels where the equilibrium says so.
    """
    signals = ca.vertcat(m.unknown, rows_of(m.known, range(known)))
    both = ca.vertcat(m.residual, m.output)
    slopes = [ca.jacobian(both, signals)]
    if m.lifted:
        trim = m.lifted.trim
        slopes += [ca.jacobian(both, m.lifted.loads), ca.jacobian(m.lifted.displacements, signals)]
        for rows in (trim.residual, trim.output):
            slopes += [ca.jacobian(rows, trim.unknown), ca.jacobian(rows, trim.known)]
    modulo = modulo_prime(ca.vertcat(*(ca.vec(slope) for slope in slopes)), seed, values_of)
    ends = np.cumsum([slope.numel() for slope in slopes])[:-1]
    columns = np.split(modulo.residues.astype(np.int64)[:, 0], ends)
    matrix, *others = (
        entries.reshape(slope.shape, order="F") for entries, slope in zip(columns, slopes, strict=True)
    )
    if m.lifted:
        by_loads, displaced, left, right, of_output, direct = others
        solution = solved(left, -right % modulo.prime, modulo.prime)
        values = (direct + multiplied(of_output, solution, modulo.prime)) % modulo.prime
        loads = np.array(values[list(m.lifted.outputs)], dtype=np.int64)
        acting = entrywise(loads, displaced, modulo.prime)
        matrix = (matrix + multiplied(by_loads, acting, modulo.prime)) % modulo.prime
    return matrix, modulo.prime


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
