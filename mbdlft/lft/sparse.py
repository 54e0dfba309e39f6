"""An LFT of very many channels, as sparse equations of its signals.

    [0 ; y] = (E + sum_k delta_k E_k) [s ; u],      value(delta) = Y_u - Y_s K^-1 B

with [K, B ; Y_s, Y_u] the matrix in brackets, n signals s and n equations. A channel w = delta_k z is one
of the signals, and its equation is the only one of its own with delta_k, so E_k has as many rows that are
not zero as delta_k has repetitions. This is a descriptor LFT: with the other signals put in it is that of
M11, M12, M21, M22. These matrices are full where few signals, such as the accelerations of all bodies,
follow from all channels. A chain of 50 links in space has 11,469 channels among 25,300 signals, with five
entries each: one value takes half a second, and M11 would have 1.1 GB.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mbdlft.base.array import Array
from mbdlft.base.errors import StructureError, WellPosednessError
from mbdlft.lft.block import Block
from mbdlft.lft.lft import LFT

Places = NDArray[np.int64]
ALWAYS = -1  # the block of an entry of E
_BYTES = 8


class NoMatrixError(StructureError, AttributeError):
    """A matrix of an LFT that is asked of a sparse one."""


class SparseLFT(LFT):
    """A frozen LFT in the form above; it has values, and none of the matrices of an `LFT`.

    Parameters
    ----------
    row, column : int arrays (entries,)
        Places of entries: rows are the equations and then the outputs, columns the signals and then the
        inputs. Entries of one place are added.
    entry : array (entries,)
    block : int array (entries,)
        Position of the block whose delta an entry is multiplied with; -1: none.
    signals : int
        n, the number of signals and of equations.
    shape : (outputs, inputs)
    blocks : tuple of Block
        As of an `LFT`; real ones only.
    nonzero : bool array (outputs, inputs), optional
        Which entries of the value are zero, whatever the deltas are, says False: rounding does not.
    """

    __slots__ = ("_shape", "block", "column", "entry", "nonzero", "row", "signals")
    row: Places
    column: Places
    entry: Array
    block: Places
    signals: int
    nonzero: NDArray[np.bool_]
    _shape: tuple[int, int]

    def __init__(
        self,
        row: Places,
        column: Places,
        entry: Array,
        block: Places,
        signals: int,
        shape: tuple[int, int],
        blocks: tuple[Block, ...],
        nonzero: NDArray[np.bool_] | None = None,
    ) -> None:
        arrays: dict[str, NDArray[Any]] = {"row": row, "column": column, "block": block}
        arrays = {name: np.array(places, dtype=np.int64) for name, places in arrays.items()}
        arrays["entry"] = np.array(entry, dtype=float)
        arrays["nonzero"] = (
            np.ones(shape, dtype=bool) if nonzero is None else np.array(nonzero, dtype=bool)
        )
        for name, array in arrays.items():
            array.flags.writeable = False
            object.__setattr__(self, name, array)
        blocks = tuple(b if isinstance(b, Block) else Block(*b) for b in blocks)
        values = {"signals": int(signals), "_shape": (int(shape[0]), int(shape[1])), "blocks": blocks}
        for name, value in values.items():
            object.__setattr__(self, name, value)
        if problem := _misfit(self):
            raise StructureError(f"sparse LFT: {problem}")

    def __reduce__(self) -> Any:
        arrays = (self.row, self.column, self.entry, self.block)
        return SparseLFT, (*arrays, self.signals, self._shape, self.blocks, self.nonzero)

    def __getattr__(self, name: str) -> Array:
        if name == "M22":
            return value_and_sign(self, np.zeros(len(self.blocks)))[0]
        if name not in ("M11", "M12", "M21"):
            raise AttributeError(name)
        raise NoMatrixError(
            f"an LFT of order {self.order} is stored as sparse equations, as {name} and the others would "
            f"have {_BYTES * self.order**2 / 1e9:.2g} GB. It has values, responses and archives; for all "
            "else give numbers to some of the parameters, so that the order is below 4000."
        )

    @property
    def shape(self) -> tuple[int, int]:
        return self._shape

    @property
    def order(self) -> int:
        return sum(block.size for block in self.blocks)

    @property
    def is_complex(self) -> bool:
        return False

    @property
    def is_plain(self) -> bool:
        return all(type(block) is Block for block in self.blocks)


def _misfit(a: SparseLFT) -> str | None:
    """What does not fit among entries and blocks, or None."""
    names, count = [block.name for block in a.blocks], len(a.entry)
    if names != sorted(set(names)) or not a.is_plain:
        return f"blocks must be real and sorted by name, each name once; got {', '.join(names)}."
    if any(places.shape != (count,) for places in (a.row, a.column, a.block)):
        return "row, column, entry and block need one length."
    if a.nonzero.shape != a.shape:
        return f"nonzero needs shape {a.shape}, got {a.nonzero.shape}."
    limits = [(a.row, 0, a.signals + a.shape[0]), (a.column, 0, a.signals + a.shape[1])]
    for places, low, high in (*limits, (a.block, ALWAYS, len(names))):
        if count and not (low <= places.min() and places.max() < high):
            return f"a place is outside of {low} to {high - 1}."
    if not np.all(np.isfinite(a.entry)):
        return "an entry is not finite."
    own = a.block != ALWAYS
    pairs = np.unique(np.stack([a.block[own], a.row[own]]), axis=1)
    if pairs.shape[1] != len(np.unique(pairs[1])) or np.any(pairs[1] >= a.signals):
        return "an equation has two deltas, or an output has one."
    sizes = np.bincount(pairs[0], minlength=len(names)).tolist()
    if any(size > block.size for size, block in zip(sizes, a.blocks, strict=True)):
        return f"the blocks {a.blocks} have {sizes} equations."
    return None


def solved_for(a: SparseLFT, count: int, first: int) -> SparseLFT:
    """The LFT with its first `count` inputs as signals, such that as many first outputs vanish.

    The `first` of these signals are its first outputs, before those that are left.
    """
    n = a.signals + count
    row = np.where(a.row >= n, a.row + first, a.row)
    seen = np.arange(first)
    return SparseLFT(
        np.concatenate([row, n + seen]),
        np.concatenate([a.column, a.signals + seen]),
        np.concatenate([a.entry, np.ones(first)]),
        np.concatenate([a.block, np.full(first, ALWAYS)]),
        n,
        (a.shape[0] - count + first, a.shape[1] - count),
        a.blocks,
    )


def with_zeros(a: SparseLFT, nonzero: NDArray[np.bool_]) -> SparseLFT:
    """The LFT with the entries of its value that are zero, whatever the deltas are."""
    return SparseLFT(a.row, a.column, a.entry, a.block, a.signals, a.shape, a.blocks, nonzero)


def in_units(a: SparseLFT, names: Sequence[str], rows: Array, columns: Array) -> SparseLFT:
    """The LFT with outputs and inputs times numbers (outputs,), (inputs,), and a block for each name."""
    by_row, by_column = (np.concatenate([np.ones(a.signals), x]) for x in (rows, columns))
    sizes = dict.fromkeys(names, 0) | dict(a.blocks)
    place = {name: k for k, name in enumerate(sorted(sizes))}
    block = np.array([*(place[name] for name, _ in a.blocks), ALWAYS])[a.block]
    blocks = tuple(Block(name, sizes[name]) for name in place)
    entry = a.entry * by_row[a.row] * by_column[a.column]
    return SparseLFT(a.row, a.column, entry, block, a.signals, a.shape, blocks, a.nonzero)


def matrix_at(a: SparseLFT, deltas: Array, *, in_sizes: bool = False) -> Any:
    """[K, B ; Y_s, Y_u], a csc_array, at deltas (blocks,); or sums of the sizes of its terms."""
    # imported here: archives are read without scipy, too
    from scipy.sparse import csc_array

    n, (outputs, inputs) = a.signals, a.shape
    terms = a.entry * np.append(deltas, 1.0)[a.block]  # the last is that of -1
    terms = np.abs(terms) if in_sizes else terms
    return csc_array((terms, (a.row, a.column)), shape=(n + outputs, n + inputs))


def value_and_sign(a: SparseLFT, deltas: Array) -> tuple[Array, float]:
    """The value (outputs, inputs) at deltas (blocks,), and the sign of det K: at 0.0 it means nothing."""
    n, E = a.signals, matrix_at(a, deltas)
    K, B, Y = E[:n, :n], E[:n, n:].toarray(), E[n:]
    factors = factors_of(K)
    if factors is None:
        return np.zeros(a.shape), 0.0
    solved = factors.solve(B)
    solved += factors.solve(B - K @ solved)  # rounding is then that of single entries (Skeel)
    value = Y[:, n:].toarray() - Y[:, :n] @ solved
    signs = np.sign(factors.U.diagonal())
    sign = float(np.prod(signs)) * _parity(factors.perm_r) * _parity(factors.perm_c)
    return np.where(a.nonzero, value, 0.0), sign


def values(a: SparseLFT, points: Array) -> tuple[Array, Array]:
    """Values (N, outputs, inputs) at points (N, blocks), and signs (N,) of det K over that at zero."""
    _, nominal = value_and_sign(a, np.zeros(len(a.blocks)))
    made, signs = _each(a, points)
    return made, nominal * signs


def _each(a: SparseLFT, points: Array) -> tuple[Array, Array]:
    """Values (N, outputs, inputs) at points (N, blocks), and signs (N,) of det K."""
    pairs = [value_and_sign(a, point) for point in points]
    made = np.array([value for value, _ in pairs]).reshape(len(points), *a.shape)
    return made, np.array([sign for _, sign in pairs])


def regular_values(a: SparseLFT, points: Array) -> Array:
    """Values (N, outputs, inputs) at points (N, blocks); a WellPosednessError where K is singular."""
    made, signs = _each(a, points)
    if np.any(signs == 0.0):
        raise WellPosednessError("the equations of a sparse LFT are singular at one of the points.")
    return made


def sizes(a: SparseLFT, points: Array) -> Array:
    """Sizes (N, outputs, inputs) that rounding of all entries is relative to, at points (N, blocks).

    With S = [-K^-1 B ; I] and R = [-Y_s K^-1, I], a change dE of the matrix changes the value by R dE S.
    """
    made, n = [], a.signals
    for point in points:
        E = matrix_at(a, point)
        factors = factors_of(E[:n, :n])
        assert factors is not None  # values were computed there
        S = np.vstack([np.abs(factors.solve(E[:n, n:].toarray())), np.eye(a.shape[1])])
        R = np.vstack([np.abs(factors.solve(E[n:, :n].toarray().T, "T")), np.eye(a.shape[0])])
        made.append(R.T @ (matrix_at(a, point, in_sizes=True) @ S))
    return np.array(made).reshape(len(points), *a.shape)


def factors_of(K: Any) -> Any:
    """Sparse triangular factors; None of a singular matrix."""
    from scipy.sparse.linalg import splu

    try:
        return splu(K)
    except RuntimeError:  # the factor is singular
        return None


def _parity(permutation: NDArray[Any]) -> float:
    """The sign of a permutation: -1 to the number of its places less that of its cycles."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    n = len(permutation)
    graph = coo_array((np.ones(n), (np.arange(n), permutation)), shape=(n, n))
    return float((-1.0) ** (n - connected_components(graph)[0]))
