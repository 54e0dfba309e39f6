"""What a transfer needs: the states that its inputs drive and its outputs see, by structure.

A graph has a node for each signal of the linear relations. Each equation is matched with one unknown,
which depends on the other signals of that equation; a state depends on its derivative. What the
outputs do not depend on is *not seen*; what does not depend on the inputs stays zero, it is *not driven*.
Without either, the transfer is the same for every value of the parameters.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array, vstack
from scipy.sparse.csgraph import maximum_bipartite_matching

from mbdlft.base.array import Array
from mbdlft.problem.equations import rows_of
from mbdlft.problem.linearize import LinearModel
from mbdlft.problem.sx.constants import in_doubles

Mask = NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class Need:
    """Relations of the states that are kept.

    Attributes
    ----------
    relations : LinearModel
        Its first unknowns are the derivatives of the kept states.
    states : positions of the kept states among all of them
    seen, driven : bool array (n_x,)
        Of all states; those with both are kept.
    """

    relations: LinearModel
    states: tuple[int, ...]
    seen: Mask
    driven: Mask

    def of(self, matrices: Array) -> Array:
        """[A B ; C D] (N, ., .) of the kept states, from those of all states."""
        if self._keeps_all:
            return matrices
        rows, columns = self.kept(*matrices.shape[1:])
        found: Array = matrices[:, rows[:, None], columns]
        return found

    def omitted(self, matrices: Array, scale: Array) -> float:
        """Largest relative error of leaving out states; zero if they do not matter.

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
    def _keeps_all(self) -> bool:
        return len(self.states) == len(self.seen)

    def kept(self, rows: int, columns: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Rows and columns that are kept of [A B ; C D] with so many."""
        kept, count = np.array(self.states, dtype=np.intp), len(self.seen)
        return np.r_[kept, count:rows], np.r_[kept, count:columns]


def all_states(relations: LinearModel, states: int, ignorable: Sequence[int] = ()) -> Need:
    """The relations as they are, but for those states among `ignorable` that are in none of them."""
    m, every = relations, np.ones(states, dtype=bool)
    if not ignorable:
        return Need(m, tuple(range(states)), every, every)
    n, known = m.unknown.numel(), m.known.numel()
    used = np.asarray(_pattern(m).sum(axis=0)).ravel()[n : n + states] > 0
    seen = np.array([k not in ignorable or bool(used[k]) for k in range(states)])
    kept, left = np.flatnonzero(seen).tolist(), np.flatnonzero(~seen).tolist()
    smaller = replace(
        m,
        unknown=rows_of(m.unknown, [*kept, *range(states, n), *left]),
        known=rows_of(m.known, [*kept, *range(states, known)]),
        derivatives=len(kept),
    )
    return Need(smaller, tuple(kept), seen, every)


def needed_states(relations: LinearModel, states: int) -> Need:
    """The relations without states and signals that are not driven or not seen.

    Parameters
    ----------
    relations : LinearModel
    states : int
        n_x: the first unknowns are the derivatives of the states, the first known signals the states.
    """
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
    both = ca.substitute(both, still, ca.SX.zeros(still.numel()))
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
        ),
        tuple(first),
        seen[of_states],
        driven[of_states],
    )


def _pattern(m: LinearModel) -> csr_array:
    """Which of the rows [residual ; output] have which of the signals [unknown ; known]."""
    both = in_doubles(ca.vertcat(m.residual, m.output))
    found = ca.jacobian_sparsity(both, ca.vertcat(m.unknown, m.known))
    rows, columns = found.get_triplet()
    return csr_array((np.ones(len(rows)), (rows, columns)), shape=found.shape)


def _reached(graph: csr_array, start: Mask) -> Mask:
    """Nodes from which, or at which, a way along the edges row -> column ends in `start`."""
    found, front = start, start
    while np.any(front):
        front = (graph @ front.astype(float) > 0.0) & ~found
        found = found | front
    return found
