"""The LFT: a matrix that is rational in named deltas, and its algebra.

    value(delta) = M22 + M21 Delta (I - M11 Delta)^-1 M12,   Delta = diag(delta_1 I_r1, ...)

Blocks are those of `mbdlft/lft/block.py`. Entries are real (float64) unless one of a matrix is complex.
In the literature of the archive: M11 = D_zw, M12 = D_zu, M21 = D_yw, M22 = D_yu for a static map.
Zhou, Doyle, Glover, Robust and Optimal Control (1996), chapter 10, for all rules below.
Blocks can be taken out of Delta, as signals, and put back.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import accumulate, pairwise
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from mbdlft.base.array import Array, ArrayLike
from mbdlft.base.errors import SizeError, StructureError, check_known
from mbdlft.exact.rounding import condition as condition
from mbdlft.exact.rounding import solve_nominal as solve_nominal
from mbdlft.exact.rounding import through
from mbdlft.lft.block import Block as Block
from mbdlft.lft.block import FullBlock, block_value, gathered
from mbdlft.lft.block import check as check


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class LFT:
    """A frozen LFT; arrays are copied and read-only.

    Parameters
    ----------
    M11 : array (n_z, n_w)
        n_z and n_w are the sums of the inputs and of the outputs of the blocks: equal but for full blocks
        that are not square.
    M12 : array (n_z, n_in)
    M21 : array (n_out, n_w)
    M22 : array (n_out, n_in)
    blocks : tuple of Block
        One for each delta, sorted by name; a size may be 0. `ComplexBlock` and `FullBlock` are kinds.
    """

    M11: Array
    M12: Array
    M21: Array
    M22: Array
    blocks: tuple[Block, ...] = ()

    def __post_init__(self) -> None:
        for name in ("M11", "M12", "M21", "M22"):
            matrix = matrix_of(getattr(self, name))
            if matrix.ndim != 2:
                raise StructureError(f"LFT: {name} needs two axes, got shape {matrix.shape}.")
            matrix += 0.0  # no negative zeros
            if not np.all(np.isfinite(matrix)):
                raise SizeError(f"LFT: {name} has an entry that is not finite.")
            matrix.flags.writeable = False
            object.__setattr__(self, name, matrix)
        object.__setattr__(
            self, "blocks", tuple(b if isinstance(b, Block) else Block(*b) for b in self.blocks)
        )
        problem = misfit(self.M11, self.M12, self.M21, self.M22, self.blocks)
        if problem:
            raise StructureError(f"LFT: {problem}")

    def __repr__(self) -> str:
        blocks = ", ".join(f"{name} {size}" for name, size in self.blocks)
        return f"<LFT {self.shape[0]} x {self.shape[1]}; order {self.order}: {blocks or 'constant'}>"

    @property
    def shape(self) -> tuple[int, int]:
        """(outputs, inputs)."""
        return (self.M22.shape[0], self.M22.shape[1])

    @property
    def order(self) -> int:
        """Size of Delta: its number of inputs."""
        return len(self.M11)

    @property
    def is_complex(self) -> bool:
        """Whether an entry is not real."""
        return any(m.dtype.kind == "c" for m in (self.M11, self.M12, self.M21, self.M22))

    @property
    def is_plain(self) -> bool:
        """Whether all entries are real and all blocks are repeated real parameters."""
        return all(type(block) is Block for block in self.blocks) and not self.is_complex

    def slices(self) -> dict[str, slice]:
        """Inputs z of each block, rows of M11, by name; also its outputs but for full blocks."""
        return spans([block.name for block in self.blocks], [b.size for b in self.blocks])

    def columns(self) -> dict[str, slice]:
        """Outputs w of each block, columns of M11, by name."""
        if is_square(self.blocks):
            return self.slices()
        return spans([block.name for block in self.blocks], [b.outputs for b in self.blocks])

    def __add__(self, other: "LFT | ArrayLike") -> "LFT":
        return add(self, as_lft(other))

    def __radd__(self, other: ArrayLike) -> "LFT":
        return add(as_lft(other), self)

    def __sub__(self, other: "LFT | ArrayLike") -> "LFT":
        return add(self, -as_lft(other))

    def __rsub__(self, other: ArrayLike) -> "LFT":
        return add(as_lft(other), -self)

    def __neg__(self) -> Self:
        return type(self)(self.M11, self.M12, -self.M21, -self.M22, self.blocks)

    def __matmul__(self, other: "LFT | ArrayLike") -> "LFT":
        return multiply(self, as_lft(other))

    def __rmatmul__(self, other: ArrayLike) -> "LFT":
        return multiply(as_lft(other), self)

    # numpy leaves the operators of an array on the left to the reflected ones above
    __array_ufunc__ = None


def is_square(blocks: Sequence[Block]) -> bool:
    """Whether no block is full: each has as many outputs as inputs."""
    return not any([type(block) is FullBlock for block in blocks])


def consecutive(sizes: Iterable[int]) -> list[slice]:
    """Slices of these sizes, one after the other."""
    return [slice(start, stop) for start, stop in pairwise([0, *accumulate(sizes)])]


def spans(names: Sequence[str], sizes: Sequence[int]) -> dict[str, slice]:
    """Consecutive slices of these sizes by name."""
    return dict(zip(names, consecutive(sizes), strict=True))


def matrix_of(entries: ArrayLike) -> Array:
    """A copy with two axes; complex only if an entry is."""
    array: Any = np.asarray(entries)
    if array.dtype.kind == "c" and array.imag.any():
        return np.array(array, ndmin=2)
    return np.array(array.real if array.dtype.kind == "c" else array, dtype=float, ndmin=2)


def misfit(M11: Array, M12: Array, M21: Array, M22: Array, blocks: Sequence[Block]) -> str | None:
    """What does not fit among matrices and blocks, or None."""
    names = [block.name for block in blocks]
    z = w = sum([size for _, size in blocks])
    if not is_square(blocks):
        w = sum(block.outputs for block in blocks)
    square = z == w
    n, m = M11.shape
    if square:
        m = n
    n_out, n_in = M22.shape
    for name, matrix, shape in (("M11", M11, (n, m)), ("M12", M12, (n, n_in)), ("M21", M21, (n_out, m))):
        if matrix.shape != shape:
            return f"{name} needs shape {shape}, got {matrix.shape}."
    if any([block.size < 0 or block.outputs < 0 for block in blocks]):
        return f"a block has a negative size: {blocks}."
    if (z, w) != (n, m):
        sizes = f"{z}" if square else f"{z} x {w}"
        return f"the sizes of the blocks add up to {sizes}, M11 is {n} x {m}."
    if names != sorted(set(names)):
        return f"blocks must be sorted by name, each name once; got {', '.join(names)}."
    return None


def constant(matrix: ArrayLike) -> LFT:
    """LFT without deltas: value = matrix."""
    value = matrix_of(matrix)
    return LFT(np.zeros((0, 0)), np.zeros((0, value.shape[1])), np.zeros((value.shape[0], 0)), value)


def delta(name: str | Block, size: int = 1) -> LFT:
    """LFT of a delta: value = delta I_size; or that of a block of any kind."""
    block = name if isinstance(name, Block) else Block(name, size)
    z, w = block.inputs, block.outputs
    return LFT(np.zeros((z, w)), np.eye(z), np.eye(w), np.zeros((w, z)), (block,))


def as_lft(item: LFT | ArrayLike) -> LFT:
    """An LFT unchanged, anything else as a constant."""
    return item if isinstance(item, LFT) else constant(item)


def add(a: LFT, b: LFT) -> LFT:
    """Sum: value(a + b) = value(a) + value(b)."""
    check(a.shape == b.shape, f"cannot add shapes {a.shape} and {b.shape}")
    return _merge(a, b, _uncoupled(a, b), (a.M12, b.M12), (a.M21, b.M21), a.M22 + b.M22)


def multiply(a: LFT, b: LFT) -> LFT:
    """Product: value(a @ b) = value(a) value(b)."""
    check(a.shape[1] == b.shape[0], f"cannot multiply shapes {a.shape} and {b.shape}")
    return _merge(a, b, a.M12 @ b.M21, (a.M12 @ b.M22, b.M12), (a.M21, a.M22 @ b.M21), a.M22 @ b.M22)


def inverse(a: LFT) -> LFT:
    """Inverse of a square LFT that is regular at delta = 0: value(a)^-1; no channel is added."""
    check(a.shape[0] == a.shape[1], f"cannot invert shape {a.shape}")
    inner = solve_nominal(a.M22, np.hstack([a.M21, np.eye(a.shape[0])]), "the inverse of an LFT")
    n_w = a.M11.shape[1]
    left, right = inner[:, :n_w], inner[:, n_w:]
    return LFT(a.M11 - a.M12 @ left, a.M12 @ right, -left, right, a.blocks)


def stack_rows(*matrices: LFT | ArrayLike) -> LFT:
    """[a ; b ; ...]: the same inputs, outputs one after the other."""
    a, *others = map(as_lft, matrices)
    for b in others:
        check(a.shape[1] == b.shape[1], f"cannot stack shapes {a.shape} and {b.shape} as rows")
        above, below = (np.zeros((x.shape[0], y.M11.shape[1])) for x, y in ((a, b), (b, a)))
        outputs = (np.vstack([a.M21, below]), np.vstack([above, b.M21]))
        a = _merge(a, b, _uncoupled(a, b), (a.M12, b.M12), outputs, np.vstack([a.M22, b.M22]))
    return a


def stack_columns(*matrices: LFT | ArrayLike) -> LFT:
    """[a , b , ...]: the same outputs, inputs one after the other."""
    a, *others = map(as_lft, matrices)
    for b in others:
        check(a.shape[0] == b.shape[0], f"cannot stack shapes {a.shape} and {b.shape} as columns")
        beside, before = (np.zeros((x.order, y.shape[1])) for x, y in ((a, b), (b, a)))
        inputs = (np.hstack([a.M12, beside]), np.hstack([before, b.M12]))
        a = _merge(a, b, _uncoupled(a, b), inputs, (a.M21, b.M21), np.hstack([a.M22, b.M22]))
    return a


def stack_diagonal(*matrices: LFT | ArrayLike) -> LFT:
    """diag(a, b, ...)."""
    items = [as_lft(matrix) for matrix in matrices]
    widths = [item.shape[1] for item in items]
    rows, before = [], 0
    for item, width in zip(items, widths, strict=True):
        pick = np.zeros((width, sum(widths)))
        pick[:, before : before + width] = np.eye(width)
        rows.append(item @ pick)
        before += width
    return stack_rows(*rows)


def transpose(a: LFT) -> LFT:
    """value(transpose(a)) = value(a)'; blocks are repeated scalars."""
    full = [block.name for block in a.blocks if block.kind == "full"]
    check(not full, f"the transpose of a full block is another block: {', '.join(full)}")
    return LFT(a.M11.T, a.M21.T, a.M12.T, a.M22.T, a.blocks)


def select(a: LFT, rows: ArrayLike, columns: ArrayLike) -> LFT:
    """The given outputs and inputs, in the given order."""
    i, j = np.asarray(rows, dtype=int), np.asarray(columns, dtype=int)
    return LFT(a.M11, a.M12[:, j], a.M21[i], a.M22[np.ix_(i, j)], a.blocks)


def eliminate(relation: LFT, n: int) -> LFT:
    """Solve [0 ; y] = relation [a ; s] for the first n inputs a: the LFT s -> [a ; y].

    This inverts the first n x n part, which must not be singular at delta = 0, without adding a channel.
    """
    (z, w), m22 = relation.M11.shape, relation.M22
    base = np.block([[relation.M11, relation.M12[:, n:]], [relation.M21[n:], m22[n:, n:]]])
    left = np.vstack([relation.M12[:, :n], m22[n:, :n]])
    right = -np.hstack([relation.M21[:n], m22[:n, n:]])
    total, solved = through(base, left, m22[:n, :n], right, "the relations to be solved")
    return LFT(
        total[:z, :w],
        total[:z, w:],
        np.vstack([solved[:, :w], total[z:, :w]]),
        np.vstack([solved[:, w:], total[z:, w:]]),
        relation.blocks,
    )


def fix(a: LFT, values: Mapping[str, ArrayLike]) -> LFT:
    """The LFT with deltas fixed to values [1] or matrices; a WellPosednessError if singular."""
    for name in values:
        check_name(a, name)
    rows, columns = a.slices(), a.columns()
    stay = tuple(block for block in a.blocks if block.name not in values)
    gone = [block for block in a.blocks if block.name in values]
    kept_z, kept_w = (_indices(ranges, [b.name for b in stay]) for ranges in (rows, columns))
    z, w = (_indices(ranges, [b.name for b in gone]) for ranges in (rows, columns))
    scale = [block_value(block, values[block.name]) for block in gone]

    def closed(left: Array) -> Array:
        """left (., w) times Delta."""
        blocks = spans([b.name for b in gone], [b.outputs for b in gone]).values()
        pairs = [(left[:, block], s) for block, s in zip(blocks, scale, strict=True)]
        products = [matrix @ s if s.ndim else matrix * s for matrix, s in pairs]
        return np.hstack([np.zeros((len(left), 0)), *products])

    left = closed(np.vstack([a.M11[np.ix_(kept_z, w)], a.M21[:, w]]))
    loop = np.eye(len(z)) - closed(a.M11[np.ix_(z, w)])
    right = np.hstack([a.M11[np.ix_(z, kept_w)], a.M12[z]])
    base = np.block([[a.M11[np.ix_(kept_z, kept_w)], a.M12[kept_z]], [a.M21[:, kept_w], a.M22]])
    total, _ = through(base, left, loop, right, "an LFT with fixed deltas")
    n, m = len(kept_z), len(kept_w)
    return LFT(total[:n, :m], total[:n, m:], total[n:, :m], total[n:, m:], stay)


def with_blocks(a: LFT, names: Sequence[str]) -> LFT:
    """The same LFT with a block for each of `names`, of size 0 where it has none."""
    own = {block.name for block in a.blocks}
    missing = [Block(name, 0) for name in names if name not in own]
    return LFT(a.M11, a.M12, a.M21, a.M22, tuple(sorted((*a.blocks, *missing))))


def _merge(
    a: LFT,
    b: LFT,
    coupling: Array,
    inputs: tuple[Array, Array],
    outputs: tuple[Array, Array],
    direct: Array,
) -> LFT:
    """[a, coupling; 0, b] with the blocks of equal names gathered."""
    M11 = np.block([[a.M11, coupling], [_uncoupled(b, a), b.M11]])
    known: dict[str, Block] = {block.name: block for block in a.blocks}
    for block in b.blocks:
        known[block.name] = gathered(known[block.name], block) if block.name in known else block
    names = sorted(known)
    blocks = tuple(known[name] for name in names)
    i = j = _side_by_side(names, a.slices(), a.order, b.slices())
    if not is_square(blocks):
        j = _side_by_side(names, a.columns(), a.M11.shape[1], b.columns())
    return LFT(M11[np.ix_(i, j)], np.vstack(inputs)[i], np.hstack(outputs)[:, j], direct, blocks)


def _side_by_side(
    names: Sequence[str], first: Mapping[str, slice], size: int, second: Mapping[str, slice]
) -> NDArray[np.int64]:
    """Positions of the channels of each name: those of an LFT of a size, then those of one behind it."""
    channels: list[int] = []
    for name in names:
        for start, ranges in ((0, first), (size, second)):
            if name in ranges:
                channels += range(start + ranges[name].start, start + ranges[name].stop)
    return np.array(channels, dtype=int)


def _uncoupled(a: LFT, b: LFT) -> Array:
    """Zeros for what the outputs of the blocks of b do to the inputs of those of a."""
    return np.zeros((a.M11.shape[0], b.M11.shape[1]))


def _indices(slices_of: Mapping[str, slice], names: Sequence[str]) -> NDArray[np.int64]:
    ranges = [np.arange(slices_of[name].start, slices_of[name].stop) for name in names]
    return np.concatenate([*ranges, np.zeros(0, dtype=int)]).astype(int)


def check_plain(a: LFT, what: str) -> None:
    """Raise a StructureError unless all entries are real and all blocks repeated real parameters."""
    others = ", ".join(f"{b.name} is a {b.kind} block" for b in a.blocks if b.kind != "real")
    check(
        a.is_plain,
        f"{what} holds for real entries and repeated real parameters only; "
        + (others or "an entry is complex"),
    )


def check_name(a: LFT, name: str) -> None:
    """Raise a StructureError if the LFT has no delta of this name."""
    check_known("delta", [name], [block.name for block in a.blocks], "LFT", StructureError)


def open_blocks(a: LFT, names: Sequence[str]) -> LFT:
    """The LFT whose last inputs and outputs are w and z of the named blocks, in that order."""
    z, w = (_indices(slices_of, names) for slices_of in (a.slices(), a.columns()))
    kept_z, kept_w = (np.setdiff1d(np.arange(n), k) for n, k in zip(a.M11.shape, (z, w), strict=True))
    return LFT(
        a.M11[np.ix_(kept_z, kept_w)],
        np.hstack([a.M12[kept_z], a.M11[np.ix_(kept_z, w)]]),
        np.vstack([a.M21[:, kept_w], a.M11[np.ix_(z, kept_w)]]),
        np.block([[a.M22, a.M21[:, w]], [a.M12[z], a.M11[np.ix_(z, w)]]]),
        tuple(block for block in a.blocks if block.name not in names),
    )


def close_blocks(a: LFT, blocks: Sequence[Block]) -> LFT:
    """The LFT whose last inputs and outputs are closed through blocks: undoes `open_blocks`."""
    n_out = a.shape[0] - sum(block.inputs for block in blocks)
    n_in = a.shape[1] - sum(block.outputs for block in blocks)
    every = [*a.blocks, *blocks]
    order = sorted(range(len(every)), key=lambda k: every[k].name)
    z, w = (
        [j for k in order for j in range(ends[k], ends[k + 1])]
        for ends in (
            np.cumsum([0, *(block.inputs for block in every)]).tolist(),
            np.cumsum([0, *(block.outputs for block in every)]).tolist(),
        )
    )
    M11 = np.block([[a.M11, a.M12[:, n_in:]], [a.M21[n_out:], a.M22[n_out:, n_in:]]])
    M12 = np.vstack([a.M12[:, :n_in], a.M22[n_out:, :n_in]])
    M21 = np.hstack([a.M21[:n_out], a.M22[:n_out, n_in:]])
    blocks = tuple(every[k] for k in order)
    return LFT(M11[np.ix_(z, w)], M12[z], M21[:, w], a.M22[:n_out, :n_in], blocks)


def as_plain(a: LFT) -> tuple[LFT, list[Block]]:
    """The same matrices with full blocks opened and complex deltas taken for real ones; the full blocks.

    What never uses that a delta is real, such as the reduction, holds for it.
    """
    full = [block for block in a.blocks if block.kind == "full"]
    inner = open_blocks(a, [block.name for block in full])
    return replace(inner, blocks=tuple(Block(*block) for block in inner.blocks)), full


def of_kinds(plain: LFT, full: Sequence[Block], a: LFT) -> LFT:
    """Undoes `as_plain` for an LFT with other repetitions."""
    known = {block.name: block for block in a.blocks}
    blocks = tuple(known[name].of_size(size) for name, size in plain.blocks)
    return close_blocks(replace(plain, blocks=blocks), full)
