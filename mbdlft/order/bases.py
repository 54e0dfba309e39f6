"""Other ways to write a value: blocks opened one by one, in bases that depend on the other deltas.

n-D reduction restricts each delta to a constant subspace. A block is opened: [z ; y] = N(others) [w ; u],
N = [A B ; C D], w = delta z. The columns K of [B, A B, A^2 B, ...] that are independent at a generic
point span all w, and with rows of K that are independent at delta = 0,

    w = K w',   z' = (rows of K)^-1 (rows of z)

has the same value with as many channels as there are columns. The other deltas may be repeated more
often for it. Which columns, which side and which order of the blocks are good is found by trying; at
every step the opened blocks can be closed again.
"""

from collections.abc import Iterator, Sequence

import numpy as np
from scipy.linalg import qr

from mbdlft.base.array import Array
from mbdlft.base.errors import WellPosednessError
from mbdlft.exact.scale import equilibrate
from mbdlft.lft.evaluate import evaluate_at
from mbdlft.lft.lft import (
    LFT,
    Block,
    inverse,
    select,
    stack_columns,
    stack_diagonal,
    transpose,
)
from mbdlft.order.affine import at_one_side, close_block, open_block
from mbdlft.order.independent import independent
from mbdlft.order.reduction_in_doubles import reduce_order
from mbdlft.order.work import Work, reduction, solutions

_INDEPENDENT = 1e-7  # of the length of a column: what is left of it beside those before
_NOISE = 1e-10  # of the largest entry beside it: rounding
_SAME = 1e-10  # relative variation of an entry that is a constant
_POINTS = 12
_CENTER = 0.7  # of the range, where generic points are
_SHIFT = (
    0.1,
    0.3,
)  # of the range: blocks are opened around a point where nothing vanishes by chance
_WAYS = (0.1, 0.1, 0.8)  # how often a delta is moved to one side, left as it is, restricted
_NEAR = 8  # so many channels more than the smallest LFT may turn out to be dependent
_GROWTH, _MORE = 2, 30  # channels of LFTs on the way: so many times those at the start, and more


def rewritten(a: LFT, smallest: int, random: np.random.Generator, work: Work) -> Iterator[LFT]:
    """LFTs of equal value, one for each block that is opened, in an order of chance.

    Parameters
    ----------
    a : LFT
    smallest : int
        Order from which on an LFT is looked at for dependent channels.
    random : Generator
    work : Work

    Yields
    ------
    LFT
        Most of them are larger than `a`. Ranks are numerical: to be compared with `a`.
    """
    shift = random.uniform(*_SHIFT, len(a.blocks)) * random.choice([-1.0, 1.0], len(a.blocks))
    names = [a.blocks[k].name for k in random.permutation(len(a.blocks))]
    if random.random() < 0.5:
        names.sort(key=lambda name: dict(a.blocks)[name])
    left, opened = _around(a, shift), list[Block]()
    most = _GROWTH * a.order + _MORE
    for name in names:
        if work.is_over or left.order + sum(block.size for block in opened) > 2 * most:
            return
        left, size = _opened(left, name, random, most, work)
        opened.append(Block(name, size))
        closed = left
        for block in reversed(opened):
            closed = close_block(closed, block)
        work.add(3.0 * reduction(closed.order))
        try:
            closed = reduce_order(_around(closed, -shift))
        except WellPosednessError:
            continue
        yield independent(closed, work) if closed.order < smallest + _NEAR else closed


def _opened(
    a: LFT, name: str, random: np.random.Generator, most: int, work: Work
) -> tuple[LFT, int]:
    """An LFT opened in a block, and the size of the block: at one side, restricted, or as it is."""
    way = random.choice(3, p=_WAYS)
    moved = at_one_side(a, name, work) if way == 0 else None
    if moved is not None:
        size, left = moved
        return left, size
    plain, size = open_block(a, name), dict(a.blocks)[name]
    if way == 1:
        return reduce_order(plain), size
    is_transposed = random.random() < 0.5
    try:
        side = transpose(plain) if is_transposed else plain
        left, fewer = restricted(side, size, random, most, work)
    except (WellPosednessError, np.linalg.LinAlgError):  # not invertible, or too large on the way
        return reduce_order(plain), size
    return reduce_order(transpose(left) if is_transposed else left), fewer


def _around(a: LFT, shift: Array) -> LFT:
    """The same value in the distances of the deltas from a point (number of blocks)."""
    center: Array = np.repeat(shift, [block.size for block in a.blocks]).astype(float)
    loop = np.eye(a.order) - a.M11 * center
    try:
        solved: Array = np.linalg.solve(loop, np.hstack([a.M11, a.M12])).astype(float)
    except np.linalg.LinAlgError:
        raise WellPosednessError("the LFT is singular at the point.") from None
    M11, M12 = solved[:, : a.order], solved[:, a.order :]
    outer = a.M21 * center
    return LFT(M11, M12, a.M21 + outer @ M11, a.M22 + outer @ M12, a.blocks)


def restricted(
    opened: LFT, size: int, random: np.random.Generator, most: int, work: Work
) -> tuple[LFT, int]:
    """An opened LFT in a basis of what its block reaches, and the size of the block then.

    Parameters
    ----------
    opened : LFT
        Of (w, u) to (z, y), the first `size` of each are the block.
    size : int
    random : Generator
        Says in which order columns are taken.
    most : int
        Channels of the LFTs on the way.
    work : Work

    Raises
    ------
    WellPosednessError
        The rows are dependent at delta = 0, or an LFT on the way has too many channels.
    """
    points = random.uniform(-_CENTER, _CENTER, (_POINTS, len(opened.blocks)))
    columns = _independent_columns(evaluate_at(opened, points)[0], size, random)
    if not columns:
        return opened, size
    K = _krylov(opened, size, columns, most, work)
    nominal = K.M22
    rows = np.sort(qr(nominal.T, mode="r", pivoting=True)[1][: len(columns)])
    S = reduce_order(inverse(select(K, rows, range(len(columns)))) @ np.eye(size)[rows])
    changed = _changed(opened, S, K, most)
    work.add(
        5.0 * reduction(max(opened.order, changed.order)) + solutions(_POINTS, changed.order, 1)
    )
    return _settled(changed, random), len(columns)


def _independent_columns(
    point: Array, size: int, random: np.random.Generator
) -> list[tuple[int, int]]:
    """(input, power) of columns A^power B_input that span the reachable space at a generic point."""
    A, B = point[:size, :size], point[:size, size:]
    rows, _ = equilibrate(B[None])
    A = np.where(np.abs(A) * rows[:, None] / rows <= _NOISE, 0.0, A)
    lengths = np.max(np.abs(B) * rows[:, None], axis=0, initial=0.0)
    current = [(int(c), 0, B[:, c]) for c in random.permutation(np.flatnonzero(lengths > _NOISE))]
    chosen: list[tuple[int, int]] = []
    basis = np.zeros((size, 0))
    while current and len(chosen) < size:
        following = []
        for c, power, column in current:
            length = np.linalg.norm(column)
            if length == 0.0:
                continue
            rest = column / length
            for _ in range(2):
                rest = rest - basis @ (basis.T @ rest)
            if np.linalg.norm(rest) > _INDEPENDENT:
                basis = np.column_stack([basis, rest / np.linalg.norm(rest)])
                chosen.append((c, power))
                following.append((c, power + 1, A @ column))
        current = following
    return chosen


def _krylov(a: LFT, size: int, columns: Sequence[tuple[int, int]], most: int, work: Work) -> LFT:
    """The columns A^power B_input, as an LFT (size, number of columns)."""
    A = reduce_order(select(a, range(size), range(size)))
    parts: dict[tuple[int, int], LFT] = {}
    for c, power in sorted(columns, key=lambda column: column[1]):
        source = A @ parts[c, power - 1] if power else select(a, range(size), [size + c])
        parts[c, power] = reduce_order(_limited(source, most))
        work.add(reduction(source.order))
    return reduce_order(_limited(stack_columns(*(parts[column] for column in columns)), most))


def _changed(a: LFT, S: LFT, T: LFT, most: int) -> LFT:
    """[S 0 ; 0 I] a [T 0 ; 0 I]."""
    outputs, inputs = a.shape[0] - S.shape[1], a.shape[1] - T.shape[0]
    half = reduce_order(_limited(stack_diagonal(S, np.eye(outputs)) @ a, 3 * most))
    return reduce_order(_limited(half @ stack_diagonal(T, np.eye(inputs)), 3 * most))


def _settled(a: LFT, random: np.random.Generator) -> LFT:
    """The same with rows and columns that do not vary as constants, for which nothing is repeated."""
    points = random.uniform(-_CENTER, _CENTER, (_POINTS, len(a.blocks)))
    values = evaluate_at(a, points)
    first, size = values[0], np.max(np.abs(values), axis=0)
    fixed = np.max(np.abs(values - first), axis=0) <= _SAME * size
    rows, columns = (np.flatnonzero(~np.all(fixed, axis=axis)) for axis in (1, 0))
    outer = np.where(fixed, first, 0.0)
    outer[np.ix_(rows, columns)] = 0.0
    core = reduce_order(select(a, rows, columns))
    return np.eye(a.shape[0])[:, rows] @ core @ np.eye(a.shape[1])[columns] + outer


def _limited(a: LFT, most: int) -> LFT:
    if a.order > most:
        raise WellPosednessError(f"an LFT of order {a.order} on the way to a smaller one.")
    return a
