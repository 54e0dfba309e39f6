"""The LFT: a matrix that is rational in named deltas, and its algebra.

    value(delta) = M22 + M21 Delta (I - M11 Delta)^-1 M12,   Delta = diag(delta_1 I_r1, ...)

In the literature of the archive: M11 = D_zw, M12 = D_zu, M21 = D_yw, M22 = D_yu for a static map.
Zhou, Doyle, Glover, Robust and Optimal Control (1996), chapter 10, for all rules below.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mbdlft.base.array import Array
from mbdlft.base.errors import StructureError, WellPosednessError, unknown_name
from mbdlft.number import twofold
from mbdlft.number.rounding import cleaned, solution_size
from mbdlft.number.twofold import Twofold

_WELL_CONDITIONED = 2.0**10  # double precision is enough: the square of this leaves ten digits


class Block(NamedTuple):
    """delta times the identity of a size; the name is the identity of the delta."""

    name: str
    size: int


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class LFT:
    """A frozen LFT; arrays are copied and read-only.

    Parameters
    ----------
    M11 : array (n, n)
        n is the sum of the sizes of the blocks.
    M12 : array (n, n_in)
    M21 : array (n_out, n)
    M22 : array (n_out, n_in)
    blocks : tuple of Block
        One for each delta, sorted by name; a size may be 0.

    Raises
    ------
    StructureError
        The shapes do not fit, an entry is not finite, or the blocks are not sorted and unique.
    """

    M11: Array
    M12: Array
    M21: Array
    M22: Array
    blocks: tuple[Block, ...] = ()

    def __post_init__(self) -> None:
        for name in ("M11", "M12", "M21", "M22"):
            matrix = np.array(getattr(self, name), dtype=float, ndmin=2)
            if matrix.ndim != 2:
                raise StructureError(f"LFT: {name} needs two axes, got shape {matrix.shape}.")
            matrix += 0.0  # no negative zeros
            if not np.all(np.isfinite(matrix)):
                raise StructureError(f"LFT: {name} has an entry that is not finite.")
            matrix.flags.writeable = False
            object.__setattr__(self, name, matrix)
        object.__setattr__(self, "blocks", tuple(Block(*block) for block in self.blocks))
        problem = _problem(self)
        if problem:
            raise StructureError(f"LFT: {problem}")

    def __repr__(self) -> str:
        blocks = ", ".join(f"{name} {size}" for name, size in self.blocks)
        return (
            f"<LFT {self.shape[0]} x {self.shape[1]}; order {self.order}: {blocks or 'constant'}>"
        )

    @property
    def shape(self) -> tuple[int, int]:
        """(outputs, inputs)."""
        return (self.M22.shape[0], self.M22.shape[1])

    @property
    def order(self) -> int:
        """Size of Delta."""
        return len(self.M11)

    def slices(self) -> dict[str, slice]:
        """Rows of each delta in Delta, by name."""
        ends = np.cumsum([0, *(block.size for block in self.blocks)])
        return {
            block.name: slice(int(a), int(b))
            for block, a, b in zip(self.blocks, ends[:-1], ends[1:], strict=True)
        }

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


def constant(matrix: ArrayLike) -> LFT:
    """LFT without deltas: value = matrix."""
    value = np.array(matrix, dtype=float, ndmin=2)
    return LFT(
        np.zeros((0, 0)), np.zeros((0, value.shape[1])), np.zeros((value.shape[0], 0)), value
    )


def delta(name: str, size: int = 1) -> LFT:
    """LFT of a delta: value = delta I_size."""
    eye, zero = np.eye(size), np.zeros((size, size))
    return LFT(zero, eye, eye, zero, (Block(name, size),))


def as_lft(item: LFT | ArrayLike) -> LFT:
    """An LFT unchanged, anything else as a constant."""
    return item if isinstance(item, LFT) else constant(item)


def add(a: LFT, b: LFT) -> LFT:
    """Sum: value(a + b) = value(a) + value(b)."""
    check(a.shape == b.shape, f"cannot add shapes {a.shape} and {b.shape}")
    return _merge(a, b, np.zeros((a.order, b.order)), (a.M12, b.M12), (a.M21, b.M21), a.M22 + b.M22)


def multiply(a: LFT, b: LFT) -> LFT:
    """Product: value(a @ b) = value(a) value(b)."""
    check(a.shape[1] == b.shape[0], f"cannot multiply shapes {a.shape} and {b.shape}")
    return _merge(
        a, b, a.M12 @ b.M21, (a.M12 @ b.M22, b.M12), (a.M21, a.M22 @ b.M21), a.M22 @ b.M22
    )


def inverse(a: LFT) -> LFT:
    """Inverse of a square LFT: value(inverse(a)) = value(a)^-1; no channel is added.

    Raises
    ------
    StructureError
        `a` is not square.
    WellPosednessError
        The value at delta = 0 is singular to working precision.
    """
    check(a.shape[0] == a.shape[1], f"cannot invert shape {a.shape}")
    inner = solve_nominal(a.M22, np.hstack([a.M21, np.eye(a.shape[0])]), "the inverse of an LFT")
    left, right = inner[:, : a.order], inner[:, a.order :]
    return LFT(a.M11 - a.M12 @ left, a.M12 @ right, -left, right, a.blocks)


def stack_rows(*parts: LFT | ArrayLike) -> LFT:
    """[a ; b ; ...]: the same inputs, outputs one after the other."""
    items = [as_lft(part) for part in parts]
    result = items[0]
    for b in items[1:]:
        a = result
        check(a.shape[1] == b.shape[1], f"cannot stack shapes {a.shape} and {b.shape} as rows")
        zero_a, zero_b = np.zeros((a.shape[0], b.order)), np.zeros((b.shape[0], a.order))
        outputs = (np.vstack([a.M21, zero_b]), np.vstack([zero_a, b.M21]))
        result = _merge(
            a, b, np.zeros((a.order, b.order)), (a.M12, b.M12), outputs, np.vstack([a.M22, b.M22])
        )
    return result


def stack_columns(*parts: LFT | ArrayLike) -> LFT:
    """[a , b , ...]: the same outputs, inputs one after the other."""
    return transpose(stack_rows(*(transpose(as_lft(part)) for part in parts)))


def stack_diagonal(*parts: LFT | ArrayLike) -> LFT:
    """diag(a, b, ...)."""
    items = [as_lft(part) for part in parts]
    widths = [item.shape[1] for item in items]
    rows, before = [], 0
    for item, width in zip(items, widths, strict=True):
        pick = np.zeros((width, sum(widths)))
        pick[:, before : before + width] = np.eye(width)
        rows.append(item @ pick)
        before += width
    return stack_rows(*rows)


def transpose(a: LFT) -> LFT:
    """value(transpose(a)) = value(a)'."""
    return LFT(a.M11.T, a.M21.T, a.M12.T, a.M22.T, a.blocks)


def star(upper: LFT, lower: LFT, outputs: int, inputs: int) -> LFT:
    """Redheffer star product: the last signals of `upper` are closed through the first of `lower`.

    With [a ; b] = upper [c ; d] and [d ; e] = lower [b ; f], where b has `outputs` entries and d has
    `inputs`, the result maps [c ; f] to [a ; e].

    Raises
    ------
    StructureError
        `outputs` or `inputs` is larger than a shape allows.
    WellPosednessError
        The loop is singular at delta = 0.
    """
    for size, limit in (
        (outputs, min(upper.shape[0], lower.shape[1])),
        (inputs, min(upper.shape[1], lower.shape[0])),
    ):
        check(
            0 <= size <= limit,
            f"cannot close {size} signals between {upper.shape} and {lower.shape}",
        )
    both = stack_diagonal(upper, lower)
    a, c = upper.shape[0] - outputs, upper.shape[1] - inputs
    n_out, n_in = both.shape
    # unknown = [b ; d] with 0 = [b ; d] - (what upper and lower give), then read [a ; e]
    b_rows, d_rows = np.arange(a, a + outputs), upper.shape[0] + np.arange(inputs)
    d_columns, b_columns = c + np.arange(inputs), upper.shape[1] + np.arange(outputs)
    given_rows = np.setdiff1d(np.arange(n_out), np.concatenate([b_rows, d_rows]))
    given_columns = np.setdiff1d(np.arange(n_in), np.concatenate([d_columns, b_columns]))
    order = (
        np.concatenate([b_rows, d_rows, given_rows]),
        np.concatenate([b_columns, d_columns, given_columns]),
    )
    relation = select(both, *order)
    k = outputs + inputs
    loop = np.zeros(relation.shape)
    loop[:k, :k] = -np.eye(k)
    closed = eliminate(relation + loop, k)
    return select(closed, np.arange(k, closed.shape[0]), np.arange(closed.shape[1]))


def select(a: LFT, rows: ArrayLike, columns: ArrayLike) -> LFT:
    """The given outputs and inputs, in the given order."""
    i, j = np.asarray(rows, dtype=int), np.asarray(columns, dtype=int)
    return LFT(a.M11, a.M12[:, j], a.M21[i], a.M22[np.ix_(i, j)], a.blocks)


def eliminate(relation: LFT, n: int) -> LFT:
    """Solve [0 ; y] = relation [a ; s] for the first n inputs a: the LFT s -> [a ; y].

    This inverts the first n x n part without adding a channel.

    Raises
    ------
    WellPosednessError
        That part is singular at delta = 0.
    """
    w, m22 = relation.order, relation.M22
    base = np.block([[relation.M11, relation.M12[:, n:]], [relation.M21[n:], m22[n:, n:]]])
    left = np.vstack([relation.M12[:, :n], m22[n:, :n]])
    right = -np.hstack([relation.M21[:n], m22[:n, n:]])
    total, solved = _through(base, left, m22[:n, :n], right, "the relations to be solved")
    return LFT(
        total[:w, :w],
        total[:w, w:],
        np.vstack([solved[:, :w], total[w:, :w]]),
        np.vstack([solved[:, w:], total[w:, w:]]),
        relation.blocks,
    )


def fix(a: LFT, values: Mapping[str, float]) -> LFT:
    """The LFT in the remaining deltas, with the named ones fixed to values [1].

    Raises
    ------
    WellPosednessError
        I - M11 Delta is singular at these values.
    """
    for name in values:
        check_name(a, name)
    parts = a.slices()
    names = [block.name for block in a.blocks if block.name not in values]
    keep = _indices(parts, names)
    drop = _indices(parts, [block.name for block in a.blocks if block.name in values])
    scale = np.concatenate(
        [np.full(b.size, values[b.name]) for b in a.blocks if b.name in values] or [np.zeros(0)]
    )
    left = np.vstack([a.M11[np.ix_(keep, drop)], a.M21[:, drop]]) * scale
    loop = np.eye(len(drop)) - a.M11[np.ix_(drop, drop)] * scale
    right = np.hstack([a.M11[np.ix_(drop, keep)], a.M12[drop]])
    base = np.block([[a.M11[np.ix_(keep, keep)], a.M12[keep]], [a.M21[:, keep], a.M22]])
    total, _ = _through(base, left, loop, right, "an LFT with fixed deltas")
    n = len(keep)
    blocks = tuple(block for block in a.blocks if block.name not in values)
    return LFT(total[:n, :n], total[:n, n:], total[n:, :n], total[n:, n:], blocks)


def _through(
    base: Array, left: Array, matrix: Array, right: Array, what: str
) -> tuple[Array, Array]:
    """base + left matrix^-1 right, and matrix^-1 right.

    What is solved in twice the working precision stays as it is, however small beside its terms: it is
    what accelerations of the tips of beams are made of. What is solved in double precision has nothing
    below the rounding of its terms, and that is set to zero.
    """
    if not matrix.size:
        return base, np.zeros((0, base.shape[1]))
    solved, low = _solve(matrix, right, what)
    if low.any():
        return twofold.multiply_add(base, left, Twofold(solved, low)), solved
    size = solution_size(np.asarray(np.linalg.inv(matrix), dtype=float), matrix, solved, right)
    solved = cleaned(solved, 0.25 * size)
    return cleaned(base + left @ solved, np.abs(base) + np.abs(left) @ size), solved


def with_blocks(a: LFT, names: Sequence[str]) -> LFT:
    """The same LFT with a block for each of `names`, of size 0 where it has none."""
    missing = [Block(name, 0) for name in names if name not in a.slices()]
    return LFT(a.M11, a.M12, a.M21, a.M22, tuple(sorted((*a.blocks, *missing))))


def solve_nominal(matrix: Array, right: Array, what: str) -> Array:
    """matrix^-1 right, or an error if the matrix is singular to working precision."""
    return _solve(matrix, right, what).high


def _solve(matrix: Array, right: Array, what: str) -> Twofold:
    """As `solve_nominal`, with the rounding of the solution where the condition makes it matter.

    One step of refinement makes the error small relative to the terms of each entry (Skeel 1980): the
    entries of M^-1 K of a finite-element model fall by many orders from the diagonal. On the way to a
    value the LFT undoes the nominal solution and takes another one, so errors of the size of the
    condition are multiplied by it once more: then twice the working precision is used.
    """
    if not matrix.size:
        return Twofold(*np.zeros((2, matrix.shape[0], right.shape[1])))
    scale = np.max(np.abs(matrix), axis=1, keepdims=True)
    scale[scale == 0.0] = 1.0
    try:
        number = condition(matrix / scale)
        singular = number > 1.0 / float(np.finfo(float).eps)
        if not singular and number > _WELL_CONDITIONED:
            return twofold.solve(matrix, right)
        matrix, right = matrix / scale, right / scale
        first = np.linalg.solve(matrix, right)
        solution = np.asarray(first + np.linalg.solve(matrix, right - matrix @ first), dtype=float)
    except np.linalg.LinAlgError:
        singular = True
    if singular:
        raise WellPosednessError(f"{what}: the matrix is singular to working precision.")
    return Twofold(solution, np.zeros_like(solution))


def condition(matrix: Array) -> float:
    """Condition number in the 1-norm, with rows and columns of one size: units do not count."""
    scaled = matrix
    for axis in (1, 0):
        size = np.max(np.abs(scaled), axis=axis, keepdims=True, initial=0.0)
        scaled = scaled / np.where(size > 0.0, size, 1.0)
    return float(np.linalg.cond(scaled, 1))


def _merge(
    a: LFT,
    b: LFT,
    coupling: Array,
    inputs: tuple[Array, Array],
    outputs: tuple[Array, Array],
    direct: Array,
) -> LFT:
    """[a, coupling; 0, b] with the blocks of equal names gathered."""
    M11 = np.block([[a.M11, coupling], [np.zeros((b.order, a.order)), b.M11]])
    parts_a, parts_b = a.slices(), b.slices()
    names = sorted(parts_a.keys() | parts_b.keys())
    blocks, order = [], []
    for name in names:
        rows = [*np.arange(a.order)[parts_a.get(name, slice(0))]]
        rows += [*(a.order + np.arange(b.order)[parts_b.get(name, slice(0))])]
        blocks.append(Block(name, len(rows)))
        order += rows
    i = np.array(order, dtype=int)
    return LFT(
        M11[np.ix_(i, i)], np.vstack(inputs)[i], np.hstack(outputs)[:, i], direct, tuple(blocks)
    )


def _indices(parts: Mapping[str, slice], names: Sequence[str]) -> NDArray[np.int64]:
    ranges = [np.arange(parts[name].start, parts[name].stop) for name in names]
    return np.concatenate([*ranges, np.zeros(0, dtype=int)]).astype(int)


def check(condition: bool, message: str) -> None:  # noqa: FBT001
    """Raise a StructureError with the message unless the condition holds."""
    if not condition:
        raise StructureError(f"LFT: {message}.")


def check_name(a: LFT, name: str) -> None:
    """Raise a StructureError if the LFT has no delta of this name."""
    names = [block.name for block in a.blocks]
    if name not in names:
        raise StructureError("LFT: " + unknown_name("delta", name, names))


def _problem(a: LFT) -> str | None:
    """What does not fit, or None."""
    n, names = a.M11.shape[0], [block.name for block in a.blocks]
    n_out, n_in = a.M22.shape
    for name, matrix, shape in (
        ("M11", a.M11, (n, n)),
        ("M12", a.M12, (n, n_in)),
        ("M21", a.M21, (n_out, n)),
    ):
        if matrix.shape != shape:
            return f"{name} needs shape {shape}, got {matrix.shape}."
    if any(block.size < 0 for block in a.blocks):
        return f"a block has a negative size: {a.blocks}."
    if sum(block.size for block in a.blocks) != n:
        return (
            f"the sizes of the blocks add up to {sum(b.size for b in a.blocks)}, M11 is {n} x {n}."
        )
    if names != sorted(set(names)):
        return f"blocks must be sorted by name, each name once; got {', '.join(names)}."
    return None
