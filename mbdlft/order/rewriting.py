"""Other LFTs of one value: affine deltas moved, and blocks opened in bases that depend on other deltas.

n-D reduction leaves the factors of a product in the order in which they came. A delta that enters
affinely, H = N + delta N', can stand on either side of N': the constants K with N' = K B are as many
columns as the values of N' span at all points, and B are rows of N', so

    [z ; y] = [0 B ; K N] [w ; u],   w = delta z.

Which other deltas are opened before, and so stay outside of B, decides about the order: a mass that
stands inside of the lengths needs no copy of them.

n-D reduction also restricts each delta to a constant subspace. A block is opened:
[z ; y] = N(others) [w ; u], N = [A B ; C D], w = delta z. The columns K of [B, A B, A^2 B, ...] that are
independent at a generic point span all w, and with rows of K that are independent at delta = 0,

    w = K w',   z' = (rows of K)^-1 (rows of z)

has the same value with as many channels as there are columns. The other deltas may be repeated more
often for it, so columns that depend on them in the simplest way come first.
"""

from collections.abc import Iterable, Iterator, Sequence
from functools import reduce
from itertools import product as each_pair
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import qr

from mbdlft.base.array import Array
from mbdlft.base.errors import WellPosednessError
from mbdlft.exact.rounding import equilibrate
from mbdlft.lft.lft import (
    LFT,
    Block,
    close_blocks,
    constant,
    fix,
    inverse,
    open_blocks,
    select,
    stack_columns,
    stack_diagonal,
    stack_rows,
    transpose,
)
from mbdlft.lft.sampling import evaluate, evaluate_at
from mbdlft.order.circles import independent
from mbdlft.order.reduction import reduce_order
from mbdlft.order.work import Work, product, reduction, solutions

_SLOPE_POINTS, _FEW_POINTS = 24, 4  # of a slope, whose span is looked at; of whether there is one
_NO_CHANGE = 1e-10  # of the size of a row: a change below is rounding
_RANK = 1e-8  # of the largest pivot: a direction below is rounding


def move_affine(
    a: LFT, outside: Iterable[str], moved: Iterable[str], work: Work, most: int | None = None
) -> LFT | None:
    """The same value, with affine deltas on one side of all but the deltas outside.

    Deltas that do not enter affinely stay where they are. None is returned if the work is over before all
    are moved, or if an LFT on the way has more than `most` channels.
    """
    opened: list[Block] = []
    for name in outside:
        opened.append(Block(name, dict(a.blocks)[name]))
        a = open_block(a, name)
    for name in moved:
        if work.is_over:
            return None
        taken = at_one_side(a, name, work)
        if taken is not None:
            size, a = taken
            opened.append(Block(name, size))
            if most is not None and a.order > most:
                return None
    for block in reversed(opened):
        a = close_block(a, block)
    work.add(reduction(a.order))
    return reduce_order(a)


def affine_moved(a: LFT, work: Work) -> Iterator[LFT]:
    """Forms of the same value with the affine deltas moved: inside of other polynomial ones, or not."""
    names = [block.name for block in a.blocks]
    affine = [name for name in names if not work.is_over and is_affine(a, name, work)]
    if not affine:
        return
    others = [name for name in names if name not in affine and is_polynomial(a, name)]
    for outside in (others, ()):
        try:
            moved = move_affine(a, outside, affine, work, _GROWTH * a.order + _MORE)
        except WellPosednessError:
            continue
        if moved is not None:
            yield moved


def open_block(a: LFT, name: str) -> LFT:
    """The LFT in the other deltas, (w, u) -> (z, y)."""
    opened, (n_out, n_in) = open_blocks(a, [name]), a.shape
    rows, columns = np.arange(opened.shape[0]), np.arange(opened.shape[1])
    return select(opened, np.roll(rows, -n_out), np.roll(columns, -n_in))


def close_block(opened: LFT, block: Block) -> LFT:
    """The inverse of `open_block`: the first inputs and outputs become the block."""
    rows, columns = (np.roll(np.arange(n), -block.size) for n in opened.shape)
    return close_blocks(select(opened, rows, columns), [block])


def is_polynomial(a: LFT, name: str) -> bool:
    """Whether a delta alone has no poles, as its channels do not feed themselves back."""
    block = a.slices()[name]
    paths = reach = (a.M11[block, block] != 0.0).astype(int)
    for _ in range(len(reach)):
        paths = np.minimum(paths @ reach, 1)
    return not paths.any()


def is_affine(a: LFT, name: str, work: Work) -> bool:
    """Whether the value is affine in a delta, at generic values of the others."""
    return bool(_slope(a, name, work, _FEW_POINTS) is not None)


def at_one_side(a: LFT, name: str, work: Work) -> tuple[int, LFT] | None:
    """The size of a block, the LFT opened in it on the smaller side; None if it is not affine."""
    change = _slope(a, name, work)
    if change is None:
        return None
    slope, rows, columns = change
    points, high, wide = slope.shape
    work.add(product(points * wide, high, high) + product(points * high, wide, wide))
    work.add(2.0 * reduction(a.order))
    outer, inner = _span(slope, rows), _span(slope.swapaxes(1, 2), columns)
    if inner.shape[1] < outer.shape[1]:
        return inner.shape[1], transpose(_at_outputs(transpose(a), name, inner))
    return outer.shape[1], _at_outputs(a, name, outer)


def _slope(
    a: LFT, name: str, work: Work, count: int = _SLOPE_POINTS
) -> tuple[Array, Array, Array] | None:
    """Changes of the values (points, rows, columns) with a delta, scaled; None if they are not affine."""
    random = np.random.default_rng(0)
    points = {b.name: random.uniform(-0.9, 0.9, count) for b in a.blocks if b.name != name}
    work.add(solutions(3 * count, a.order, a.shape[1], is_complex=False))
    try:
        low, middle, high = (
            evaluate(a, {**points, name: np.full(count, value)}) for value in (-1.0, 0.0, 1.0)
        )
    except WellPosednessError:  # a pole at one of the points
        return None
    size = np.max(np.abs(low) + np.abs(middle) + np.abs(high), axis=0)
    rows, columns = (1.0 / factor for factor in equilibrate(size[None]))
    scale = rows[:, None] * columns
    if np.max(np.abs(high + low - 2.0 * middle) / scale, initial=0.0) > _NO_CHANGE:
        return None
    slope = (high - low) / scale
    slope[np.abs(slope) <= _NO_CHANGE] = 0.0
    return slope, rows, columns


def _span(values: Array, scale: Array) -> Array:
    """K (rows, d), the identity in d rows, with values (points, rows, columns) = K values[d rows]."""
    all_columns = np.hstack(list(values))
    _, factor, pivots = qr(all_columns.T, mode="economic", pivoting=True)
    sizes = np.abs(np.diagonal(factor))
    d = int(np.sum(sizes > _RANK * np.max(sizes, initial=0.0)))
    rows = np.sort(pivots[:d])
    K = np.linalg.lstsq(all_columns[rows].T, all_columns.T)[0].T
    K[np.abs(K) <= _NO_CHANGE] = 0.0
    K[rows] = np.eye(d)
    return np.asarray(scale[:, None] * K / scale[rows])


def _at_outputs(a: LFT, name: str, K: Array) -> LFT:
    d = K.shape[1]
    rows = [int(np.flatnonzero(np.all(unit == K, axis=1))[0]) for unit in np.eye(d)]
    columns = range(a.shape[1])
    here, there = fix(a, {name: 0.0}), fix(a, {name: 1.0})
    slope = reduce_order(select(there, rows, columns) - select(here, rows, columns))
    opened = stack_rows(stack_columns(np.zeros((d, d)), slope), stack_columns(constant(K), here))
    return reduce_order(opened)


_INDEPENDENT = 1e-7  # of the length of a column: what is left of it beside those before
_NOISE = 1e-10  # of the largest entry beside it: rounding
_SAME = 1e-10  # relative variation of an entry that is a constant
_POINTS = 12
_CENTER = 0.7  # of the range, where generic points are
_NEAR = 8  # so many channels more than the smallest LFT may turn out to be dependent
_GROWTH, _MORE = 2, 30  # channels of LFTs on the way: so many times those at the start, and more


class Restricted(NamedTuple):
    """An LFT with a block restricted, itself or its transpose."""

    lft: LFT
    name: str = ""  # of the block; of none
    is_transposed: bool = False


def restrictions(
    a: LFT, names: Sequence[str], work: Work, *, is_transposed: bool | None = None
) -> Iterator[Restricted]:
    """LFTs of equal value, each with one block restricted on one side, or that side, until work is over.

    The basis has the columns that depend on the other deltas in the simplest way. Each of these may then
    be repeated less often, so the block that is restricted may be one at its bound. Ranks are numerical:
    the LFTs are to be compared with `a`.
    """
    most, sizes = a.order + _MORE, dict(a.blocks)
    sides = [side for side in (_as_it_is, transpose) if is_transposed in (None, side is transpose)]
    for name, side in each_pair(names, sides):
        if work.is_over:
            return
        try:
            opened = side(open_block(a, name))
            into, out = opened.M12[:, sizes[name] :], opened.M21[: sizes[name]]
            columns = simplest_first(opened.M11 != 0.0, into != 0.0, out != 0.0)
            opened, size = restricted(opened, sizes[name], columns, most, work)
            closed = reduce_order(close_block(reduce_order(side(opened)), Block(name, size)))
        except (WellPosednessError, np.linalg.LinAlgError):
            continue
        work.add(3.0 * reduction(closed.order))
        closed = independent(closed, work) if closed.order < a.order + _NEAR else closed
        yield Restricted(closed, name, side is transpose)


def simplest_first(
    M11: NDArray[np.bool_], inputs: NDArray[np.bool_], outputs: NDArray[np.bool_]
) -> NDArray[np.intp]:
    """The inputs (n, .) that feed outputs (., n), by the channels through which they do."""
    # products of booleans are those of loops; of doubles, whose sums are exact, those of BLAS
    near = np.where(M11, 1.0, np.eye(len(M11)))
    for _ in range(len(M11).bit_length()):
        near = np.sign(near @ near)
    after = near @ inputs > 0.0
    before = outputs.any(axis=0) @ near > 0.0
    return np.argsort(np.sum(after & before[:, None], axis=0), kind="stable")


def _as_it_is(a: LFT) -> LFT:
    return a


def restricted(opened: LFT, size: int, inputs: Iterable[int], most: int, work: Work) -> tuple[LFT, int]:
    """An LFT in a basis of what its block reaches, and the size of the block then.

    It is opened, (w, u) to (z, y), and the first `size` of each are the block; of its `inputs` u, those
    that come first are in the basis. A WellPosednessError if
    the rows are dependent at delta = 0, or an LFT on the way has more than `most` channels.
    """
    random = np.random.default_rng(0)
    points = random.uniform(-_CENTER, _CENTER, (_POINTS, len(opened.blocks)))
    columns = _independent_columns(evaluate_at(opened, points)[0], size, inputs)
    if not columns:
        return opened, size
    K = _krylov(opened, size, columns, most, work)
    nominal = K.M22
    rows = np.sort(qr(nominal.T, mode="r", pivoting=True)[1][: len(columns)])
    S = reduce_order(inverse(select(K, rows, range(len(columns)))) @ np.eye(size)[rows])
    changed = _changed(opened, S, K, most)
    work.add(5.0 * reduction(max(opened.order, changed.order)) + solutions(_POINTS, changed.order, 1))
    return _settled(changed, random), len(columns)


def _independent_columns(point: Array, size: int, inputs: Iterable[int]) -> list[tuple[int, int]]:
    """(input, power) of columns A^power B_input that span the reachable space at a generic point."""
    A, B = point[:size, :size], point[:size, size:]
    rows, _ = equilibrate(B[None])
    A = np.where(np.abs(A) * rows[:, None] / rows <= _NOISE, 0.0, A)
    lengths = np.max(np.abs(B) * rows[:, None], axis=0, initial=0.0)
    current = [(int(c), 0, B[:, c]) for c in inputs if lengths[c] > _NOISE]
    chosen: list[tuple[int, int]] = []
    basis = np.zeros((size, 0))
    while current and len(chosen) < size:
        following = []
        for c, power, column in current:
            length = np.linalg.norm(column)
            if length == 0.0:
                continue
            direction = column / length
            for _ in range(2):
                direction = direction - basis @ (basis.T @ direction)
            if np.linalg.norm(direction) > _INDEPENDENT:
                basis = np.column_stack([basis, direction / np.linalg.norm(direction)])
                chosen.append((c, power))
                following.append((c, power + 1, A @ column))
        current = following
    return chosen


def _krylov(a: LFT, size: int, columns: Sequence[tuple[int, int]], most: int, work: Work) -> LFT:
    """The columns A^power B_input, those of low powers first, as an LFT: [B, A [B, A [B, ...]]]."""
    inside = range(size)

    def step(K: LFT | None, power: int) -> LFT:
        inputs = [size + c for c, other in columns if other == power]
        source = select(a, inside, inputs if K is None else [*inputs, *inside])
        if K is not None:
            source = source @ stack_diagonal(np.eye(len(inputs)), K)
        work.add(reduction(source.order))
        return reduce_order(_limited(source, most))

    highest = max(power for _, power in columns)
    return reduce(step, range(highest - 1, -1, -1), step(None, highest))


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
    outer = np.where(fixed, a.M22, 0.0)
    outer[np.ix_(rows, columns)] = 0.0
    core = reduce_order(select(a, rows, columns))
    return np.eye(a.shape[0])[:, rows] @ core @ np.eye(a.shape[1])[columns] + outer


def _limited(a: LFT, most: int) -> LFT:
    if a.order > most:
        raise WellPosednessError(f"an LFT of order {a.order} on the way to a smaller one.")
    return a
