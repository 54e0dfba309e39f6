"""Bases of the channels of one delta that depend on the other deltas.

A block is opened: [z ; y] = N(others) [w ; u], N = [A B ; C D], w = delta z. With any invertible
T(others), w = T w', z = T z',

    A' = T^-1 A T,   B' = T^-1 B,   C' = C T

has the same value. If w stays in a subspace over the field of rational functions of the others, T has
fewer columns, and T^-1 is a left inverse. Which T makes N' simple is found with values on lines; only
the T that is chosen is then made as an LFT, so each step is exact.
"""

from collections.abc import Iterator, Sequence
from math import comb
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import qr

from mbdlft.base.array import Array
from mbdlft.base.errors import WellPosednessError
from mbdlft.lft.lft import (
    LFT,
    Block,
    constant,
    fix,
    inverse,
    select,
    stack_columns,
    stack_diagonal,
    stack_rows,
    transpose,
)
from mbdlft.reduce.lines import Lines, Values, degree, equilibrate, values_on
from mbdlft.reduce.reduce import reduce_order

_INDEPENDENT = 1e-7
_SINGULAR = 1e-7  # of the median over the box: a smaller determinant at delta = 0 is not inverted
_SMALL = 1e-2  # of the median over the box: with a smaller determinant a basis is not regular
_NOISE = 1e-10  # of the largest entry of each row: a column below is rounding
_SAME = 1e-10  # relative variation of an entry that is a constant


def open_block(a: LFT, name: str) -> LFT:
    """The LFT in the other deltas, (w, u) -> (z, y)."""
    part = a.slices()[name]
    k = np.arange(part.start, part.stop)
    rest = np.setdiff1d(np.arange(a.order), k)
    return LFT(
        a.M11[np.ix_(rest, rest)],
        np.hstack([a.M11[np.ix_(rest, k)], a.M12[rest]]),
        np.vstack([a.M11[np.ix_(k, rest)], a.M21[:, rest]]),
        np.block([[a.M11[np.ix_(k, k)], a.M12[k]], [a.M21[:, k], a.M22]]),
        tuple(block for block in a.blocks if block.name != name),
    )


def close_block(opened: LFT, block: Block) -> LFT:
    """The inverse of `open_block`: the first inputs and outputs become the block."""
    before = sum(other.size for other in opened.blocks if other.name < block.name)
    n, r = opened.order, block.size
    order = np.r_[np.arange(before), n + np.arange(r), np.arange(before, n)].astype(int)
    M11 = np.block([[opened.M11, opened.M12[:, :r]], [opened.M21[:r], opened.M22[:r, :r]]])
    M12 = np.vstack([opened.M12[:, r:], opened.M22[:r, r:]])
    M21 = np.hstack([opened.M21[r:], opened.M22[r:, :r]])
    blocks = tuple(sorted((*opened.blocks, block)))
    return LFT(M11[np.ix_(order, order)], M12[order], M21[:, order], opened.M22[r:, r:], blocks)


class Choice(NamedTuple):
    """T = K or, if normalized, K (rows of K)^-1, with columns K of [B, A B, A^2 B, ...].

    Attributes
    ----------
    transposed : bool
        For the transposed LFT: then the observable space.
    columns : (input, power) of each column
    rows : as many, independent at delta = 0
    """

    transposed: bool
    columns: tuple[tuple[int, int], ...]
    rows: tuple[int, ...]
    normalized: bool

    @property
    def size(self) -> int:
        """Channels that are left."""
        return len(self.columns)


def choices(
    values: Values, r: int, most_rows: int, more_orders: int, random: np.random.Generator
) -> Iterator[Choice]:
    """Choices for an opened block of size r, from its values; simple columns first."""
    for transposed in (False, True):
        found = _transposed(values) if transposed else values
        point, nominal = _some_point(found), found.box[0]
        B = np.abs(point[:r, r:])
        lengths = np.max(B / np.max(B, axis=1, keepdims=True, initial=1e-300), axis=0, initial=0.0)
        inputs = [int(c) for c in np.flatnonzero(lengths > _NOISE)]
        simple = sorted(inputs, key=lambda c: _complexity(found, r, r + c))
        orders = [simple, inputs, inputs[::-1]]
        orders += [[int(c) for c in random.permutation(inputs)] for _ in range(more_orders)]
        tried: list[list[tuple[int, int]]] = []
        for order in orders:
            columns = _independent_columns(point, r, order)
            if not columns or sorted(columns) in tried:
                continue
            tried.append(sorted(columns))
            d = len(columns)
            pivots = qr(_krylov_values(nominal[None], r, columns)[0].T, pivoting=True)[2]
            rows = tuple(sorted(int(k) for k in pivots[:d]))
            yield Choice(transposed, tuple(columns), rows, normalized=False)
            if d < r and len(tried) == 1:
                for some in _row_choices(r, d, most_rows, random):
                    yield Choice(transposed, tuple(columns), some, normalized=True)


def choose_values(values: Values, r: int, choice: Choice) -> Values | None:
    """Values after a choice; None if it is not invertible at delta = 0."""
    found = _transposed(values) if choice.transposed else values
    basis = _krylov_values(found.box, r, choice.columns)[:, choice.rows, :]
    sizes = np.abs(np.linalg.det(basis))
    if not sizes[0] > _SINGULAR * np.median(sizes):
        return None
    try:
        changed = Values(
            {name: _changed(item, r, choice) for name, item in found.circles.items()},
            found.diagonal[:0],
            _changed(found.box, r, choice),
        )
    except np.linalg.LinAlgError:
        return None
    return _transposed(changed) if choice.transposed else changed


def is_regular(values: Values, r: int, choice: Choice) -> bool:
    """Whether the basis is invertible on the whole range, as far as the points of the box tell."""
    found = _transposed(values) if choice.transposed else values
    sizes = np.linalg.det(_krylov_values(found.box, r, choice.columns)[:, choice.rows, :])
    sizes = sizes * np.sign(sizes[0])  # where it changes its sign it is not invertible between
    return bool(np.min(sizes) > _SMALL * np.median(sizes))


def choose(opened: LFT, r: int, choice: Choice, largest: int) -> LFT:
    """The opened LFT after a choice.

    Raises
    ------
    WellPosednessError
        The rows are dependent at delta = 0, or an LFT on the way has more than `largest` channels.
    """
    a = transpose(opened) if choice.transposed else opened
    d, rows = choice.size, list(choice.rows)
    K = _krylov(a, r, choice.columns, largest)
    normal = inverse(select(K, rows, range(d)))
    pick = np.eye(r)[rows]
    if choice.normalized:
        others = np.setdiff1d(np.arange(r), rows)
        rest = reduce_order(select(K, others, range(d)) @ normal)
        S, T = constant(pick), constant(np.eye(r)[:, others]) @ rest + pick.T
    else:
        S, T = reduce_order(normal @ pick), K
    changed = _change(a, S, T, largest)
    return transpose(changed) if choice.transposed else changed


class Exchange(NamedTuple):
    """A new basis in which one column of [A B], or if transposed one row of [A ; C], is a unit vector."""

    position: int
    signal: int
    transposed: bool


def exchange(opened: LFT, d: int, move: Exchange, largest: int) -> LFT:
    """The opened LFT after an exchange; errors as for `choose`."""
    a = transpose(opened) if move.transposed else opened
    column = reduce_order(select(a, range(d), [move.signal]))
    unit = np.eye(d)[:, [move.position]]
    T = reduce_order(column @ unit.T + (np.eye(d) - unit @ unit.T))
    changed = _change(a, reduce_order(inverse(T)), T, largest)
    return transpose(changed) if move.transposed else changed


def settle(a: LFT, lines: Lines) -> LFT:
    """The same with rows and columns that do not vary as constants, for which nothing is repeated."""
    values = values_on(a, lines)
    every = np.concatenate([values.box, *values.circles.values()])
    first, size = values.box[0], np.max(np.abs(every), axis=0)
    fixed = np.max(np.abs(every - first), axis=0) <= _SAME * size
    rows, columns = (np.flatnonzero(~np.all(fixed, axis=axis)) for axis in (1, 0))
    if len(rows) == a.shape[0] and len(columns) == a.shape[1]:
        return a
    core = reduce_order(select(a, rows, columns))
    outer = np.where(fixed, first, 0.0)
    outer[np.ix_(rows, columns)] = 0.0
    left, right = np.eye(a.shape[0])[:, rows], np.eye(a.shape[1])[columns]
    return left @ core @ right + outer


def affine_form(opened: LFT, chosen: LFT, r: int, d: int, lines: Lines) -> LFT:
    """The same as `chosen`, made from values of `opened`, if the delta enters affinely.

    With A' = 0 and C' constant the value is N0 + delta C' B', and B' is the difference of the values at
    delta = 1 and 0 in some rows: products keep the order of their factors, which n-D reduction needs.
    The same for B' constant. In other cases `chosen` itself.
    """
    values = values_on(chosen, lines)
    every = np.concatenate([values.box, *values.circles.values()])
    if np.any(np.abs(every[:, :d, :d]) > _NOISE * np.max(np.abs(every))):
        return chosen
    for transposed in (False, True):
        outer = every.transpose(0, 2, 1)[:, d:, :d] if transposed else every[:, d:, :d]
        K = outer[0].real
        if d and np.max(np.abs(outer - K)) <= _SAME * np.max(np.abs(K)):
            found = _affine_form(transpose(opened) if transposed else opened, K, r)
            return transpose(found) if transposed else found
    return chosen


def _affine_form(opened: LFT, K: Array, r: int) -> LFT:
    d = K.shape[1]
    rows = np.sort(qr(K.T, pivoting=True)[2][:d])
    name = "".join(block.name for block in opened.blocks) + "_"  # not one of them
    there = fix(close_block(opened, Block(name, r)), {name: 1.0})
    here = select(opened, range(r, opened.shape[0]), range(r, opened.shape[1]))
    columns = range(here.shape[1])
    B = np.linalg.inv(K[rows]) @ (select(there, rows, columns) - select(here, rows, columns))
    return reduce_order(
        stack_rows(stack_columns(np.zeros((d, d)), B), stack_columns(constant(K), here))
    )


def _transposed(values: Values) -> Values:
    return Values(
        {name: item.transpose(0, 2, 1) for name, item in values.circles.items()},
        values.diagonal.transpose(0, 2, 1),
        values.box.transpose(0, 2, 1),
    )


def _some_point(values: Values) -> NDArray[Any]:
    """Values at a generic point."""
    return next((item[0] for item in values.circles.values()), values.box[1])


def _complexity(values: Values, r: int, column: int) -> int:
    """Degree of the direction of a column on the diagonal: how much it costs as a basis vector."""
    if not len(values.diagonal):
        return 0
    vectors = values.diagonal[:, :r, [column]]
    weights = 1.0 + 0.1 * np.cos(np.arange(r))
    with np.errstate(all="ignore"):  # a length that vanishes somewhere counts as complex
        vectors = vectors / (weights @ vectors)[:, None]
    return degree(vectors, _circle(len(vectors)))


def _circle(count: int) -> NDArray[Any]:
    """Any circle with this many points: ranks of ratios do not depend on its phase."""
    return np.asarray(np.exp(2j * np.pi * np.arange(count) / count))


def _independent_columns(
    point: NDArray[Any], r: int, order: Sequence[int]
) -> list[tuple[int, int]]:
    """(input, power) of columns A^power B_input that span the reachable space at a generic point."""
    A, B = point[:r, :r], point[:r, r:]
    rows, _ = equilibrate(B[None])
    A = np.where(np.abs(A) * rows[:, None] / rows <= _NOISE, 0.0, A)
    chosen: list[tuple[int, int]] = []
    basis = np.zeros((r, 0), dtype=complex)
    current = [(c, 0, B[:, c]) for c in order]
    while current and len(chosen) < r:
        following = []
        for c, power, column in current:
            length = np.linalg.norm(column)
            if length == 0.0:
                continue
            rest = column / length
            for _ in range(2):
                rest = rest - basis @ (basis.conj().T @ rest)
            if np.linalg.norm(rest) > _INDEPENDENT:
                basis = np.column_stack([basis, rest / np.linalg.norm(rest)])
                chosen.append((c, power))
                following.append((c, power + 1, A @ column))
        current = following
    return chosen


def _row_choices(
    r: int, d: int, most: int, random: np.random.Generator
) -> Iterator[tuple[int, ...]]:
    """Different sets of d of r rows, all of them or `most` random ones."""
    seen: set[tuple[int, ...]] = set()
    for _ in range(most):
        if len(seen) == comb(r, d):
            return
        rows = tuple(sorted(int(k) for k in random.choice(r, d, replace=False)))
        if rows not in seen:
            seen.add(rows)
            yield rows


def _krylov_values(
    values: NDArray[Any], r: int, columns: Sequence[tuple[int, int]]
) -> NDArray[Any]:
    """The columns A^power B_input at each point (points, r, number of columns)."""
    A = values[:, :r, :r]
    parts: dict[tuple[int, int], NDArray[Any]] = {}
    for c, power in sorted(columns, key=lambda column: column[1]):
        parts[c, power] = A @ parts[c, power - 1] if power else values[:, :r, [r + c]]
    return np.concatenate([parts[column] for column in columns], axis=2)


def _changed(values: NDArray[Any], r: int, choice: Choice) -> NDArray[Any]:
    K = _krylov_values(values, r, choice.columns)
    rows = list(choice.rows)
    normal = np.linalg.inv(K[:, rows, :])
    T = K @ normal if choice.normalized else K
    inner = values[:, rows, :] if choice.normalized else normal @ values[:, rows, :]
    left = np.concatenate([inner, values[:, r:, :]], axis=1)
    return np.concatenate([left[:, :, :r] @ T, left[:, :, r:]], axis=2)


def _krylov(a: LFT, r: int, columns: Sequence[tuple[int, int]], largest: int) -> LFT:
    A = reduce_order(select(a, range(r), range(r)))
    parts: dict[tuple[int, int], LFT] = {}
    for c, power in sorted(columns, key=lambda column: column[1]):
        source = A @ parts[c, power - 1] if power else select(a, range(r), [r + c])
        parts[c, power] = reduce_order(_limited(source, largest))
    return reduce_order(_limited(stack_columns(*(parts[column] for column in columns)), largest))


def _change(a: LFT, S: LFT, T: LFT, largest: int) -> LFT:
    """[S 0 ; 0 I] a [T 0 ; 0 I]."""
    outputs, inputs = a.shape[0] - S.shape[1], a.shape[1] - T.shape[0]
    half = _limited(stack_diagonal(S, np.eye(outputs)) @ a, 3 * largest)
    return reduce_order(
        _limited(reduce_order(half) @ stack_diagonal(T, np.eye(inputs)), 3 * largest)
    )


def _limited(a: LFT, largest: int) -> LFT:
    if a.order > largest:
        raise WellPosednessError(f"an LFT of order {a.order} on the way to a smaller one.")
    return a
