"""Smaller LFTs by using that deltas commute.

Open the block of one delta: what is left, N, is an LFT in the other deltas, with the channels of the
opened block among its inputs and outputs,

    [z ; y] = N(others) [w ; u],    w = delta_k z,    N = [A B ; C D].

n-D reduction restricts w to a constant subspace. Deltas that commute allow a subspace that depends on
the others: over the field of rational functions in them, the reachable space of (A, B) has as its
dimension the McMillan degree in delta_k (or less often that of the observable one). With d columns
K(others) of [B, A B, A^2 B, ...] that span it and d of its rows,

    w = T w',    T = K (rows of K)^-1  or  K,    A' = S A T, B' = S B, C' = C T,

and N' is again an LFT in the others. Each such step is exact; whether the whole becomes smaller depends
on the columns and rows, so they are searched. A step is kept only if the values stay and the result is
well posed on the range, since 1/det(rows of K) may have poles there.
"""

import time
from collections.abc import Iterator, Mapping, Sequence
from itertools import combinations

import numpy as np

from mbdlft.errors import WellPosednessError
from mbdlft.lft.evaluate import evaluate_at
from mbdlft.lft.lft import (
    LFT,
    Array,
    Block,
    constant,
    inverse,
    select,
    stack_columns,
    stack_diagonal,
    transpose,
)
from mbdlft.lft.reduce import reduce_order

_BEAM, _SLACK = 6, 3  # models that are followed at once; how much larger than the best they may be
_MOST_ROWS, _COLUMN_ORDERS = 40, 4
_POINTS = 64
_SAME = 1e-11  # relative difference of values, far above rounding and far below a wrong step
_CONDITION = 1e7  # of I - M11 Delta on the range
_INDEPENDENT = 1e-7


def reduce_commuting(a: LFT, bound: Mapping[str, int], seconds: float) -> LFT:
    """The smallest LFT of equal value that is found in a time, at the latest when it meets the bound.

    Parameters
    ----------
    a : LFT
    bound : mapping of names to the lower bounds of the repetitions
    seconds : float
        Budget (s); the order in which candidates are tried does not depend on it.

    Returns
    -------
    LFT
        `a` itself if nothing smaller was found.
    """
    deadline = time.perf_counter() + seconds
    target = sum(bound.values())
    points = _check_points(len(a.blocks))
    values = evaluate_at(a, points)
    best, beam = a, [a]
    seen = {_key(a)}
    while beam and best.order > target and time.perf_counter() < deadline:
        found: dict[tuple[object, ...], LFT] = {}
        for parent in beam:
            for block in parent.blocks:
                if block.size <= bound[block.name]:
                    continue
                for candidate in _candidates(parent, block.name, deadline):
                    key = _key(candidate)
                    if candidate.order > best.order + _SLACK or key in seen or key in found:
                        continue
                    if _keeps(candidate, points, values):
                        found[key] = candidate
                        if candidate.order <= target:
                            return candidate
        seen |= found.keys()
        beam = sorted(found.values(), key=lambda candidate: candidate.order)[:_BEAM]
        if beam and beam[0].order < best.order:
            best = beam[0]
    return best


def _candidates(a: LFT, name: str, deadline: float) -> Iterator[LFT]:
    """LFTs of equal value in which the block `name` has its McMillan degree for its size."""
    yield from _reachable_candidates(a, name, deadline)
    for candidate in _reachable_candidates(transpose(a), name, deadline):
        yield transpose(candidate)


def _reachable_candidates(a: LFT, name: str, deadline: float) -> Iterator[LFT]:
    opened, r = _open(a, name)
    inputs, outputs = opened.shape[1] - r, opened.shape[0] - r
    generator = np.random.default_rng(0)
    tried: list[list[tuple[int, int]]] = []
    for trial in range(_COLUMN_ORDERS):
        order = [int(j) for j in generator.permutation(inputs)] if trial else list(range(inputs))
        columns = _independent_columns(opened, r, order, generator)
        if len(columns) == r or sorted(columns) in tried:
            continue
        tried.append(sorted(columns))
        K = _krylov(opened, r, columns)
        for rows in _row_choices(r, len(columns), generator):
            if time.perf_counter() > deadline:
                return
            try:
                normal = inverse(select(K, rows, range(len(columns))))
            except WellPosednessError:
                continue  # these rows are dependent at nominal
            pick = np.eye(r)[rows]
            for S, T in ((constant(pick), K @ normal), (normal @ pick, K)):
                T = _with_identity(T, rows) if S.order == 0 else T
                left, right = stack_diagonal(S, np.eye(outputs)), stack_diagonal(T, np.eye(inputs))
                smaller = reduce_order(left @ opened @ right)
                yield reduce_order(_close(smaller, name, len(columns)))


def _open(a: LFT, name: str) -> tuple[LFT, int]:
    """The LFT in the other deltas, (w, u) -> (z, y), and the size of the block."""
    part = a.slices()[name]
    k = np.arange(part.start, part.stop)
    rest = np.setdiff1d(np.arange(a.order), k)
    opened = LFT(
        a.M11[np.ix_(rest, rest)],
        np.hstack([a.M11[np.ix_(rest, k)], a.M12[rest]]),
        np.vstack([a.M11[np.ix_(k, rest)], a.M21[:, rest]]),
        np.block([[a.M11[np.ix_(k, k)], a.M12[k]], [a.M21[:, k], a.M22]]),
        tuple(block for block in a.blocks if block.name != name),
    )
    return opened, len(k)


def _close(opened: LFT, name: str, r: int) -> LFT:
    """The inverse of `_open`: the first r inputs and outputs become the block `name`."""
    before = sum(block.size for block in opened.blocks if block.name < name)
    n = opened.order
    order = np.r_[np.arange(before), n + np.arange(r), np.arange(before, n)].astype(int)
    M11 = np.block([[opened.M11, opened.M12[:, :r]], [opened.M21[:r], opened.M22[:r, :r]]])
    M12 = np.vstack([opened.M12[:, r:], opened.M22[:r, r:]])
    M21 = np.hstack([opened.M21[r:], opened.M22[r:, :r]])
    blocks = tuple(sorted((*opened.blocks, Block(name, r))))
    return LFT(M11[np.ix_(order, order)], M12[order], M21[:, order], opened.M22[r:, r:], blocks)


def _independent_columns(
    opened: LFT, r: int, order: Sequence[int], generator: np.random.Generator
) -> list[tuple[int, int]]:
    """(input j, power e) of columns A^e B_j that span the reachable space at a generic point."""
    point = generator.uniform(-0.7, 0.7, (1, len(opened.blocks)))
    value = evaluate_at(opened, point)[0]
    A, B = value[:r, :r], value[:r, r:]
    chosen: list[tuple[int, int]] = []
    basis = np.zeros((r, 0))
    current = [(int(j), 0, B[:, j]) for j in order]
    while current and len(chosen) < r:
        following = []
        for j, e, column in current:
            length = np.linalg.norm(column)
            if length == 0.0:
                continue
            rest = column / length
            for _ in range(2):
                rest = rest - basis @ (basis.T @ rest)
            if np.linalg.norm(rest) > _INDEPENDENT:
                basis = np.column_stack([basis, rest / np.linalg.norm(rest)])
                chosen.append((j, e))
                following.append((j, e + 1, A @ column))
        current = following
    return chosen


def _krylov(opened: LFT, r: int, columns: Sequence[tuple[int, int]]) -> LFT:
    """The chosen columns A^e B_j as an LFT (r, number of columns)."""
    A = select(opened, range(r), range(r))
    parts: dict[tuple[int, int], LFT] = {}
    for j, e in columns:
        source = select(opened, range(r), [r + j]) if e == 0 else A @ parts[j, e - 1]
        parts[j, e] = reduce_order(source)
    return reduce_order(stack_columns(*(parts[column] for column in columns)))


def _row_choices(r: int, d: int, generator: np.random.Generator) -> list[list[int]]:
    choices = [list(rows) for rows in combinations(range(r), d)]
    if len(choices) <= _MOST_ROWS:
        return choices
    picked = sorted(generator.choice(len(choices), _MOST_ROWS, replace=False))
    return [choices[k] for k in picked]


def _with_identity(T: LFT, rows: Sequence[int]) -> LFT:
    """T with its chosen rows, the identity up to rounding, made exactly so."""
    r, d = T.shape
    others = np.setdiff1d(np.arange(r), rows)
    rest = reduce_order(select(T, others, range(d)))
    eye, spread = np.eye(r)[:, rows], np.eye(r)[:, others]
    return constant(spread) @ rest + eye


def _check_points(count: int) -> Array:
    """Random points and corners of the unit box (N, count)."""
    points = np.random.default_rng(1).uniform(-1.0, 1.0, (2 * _POINTS, count))
    points[_POINTS:] = np.sign(points[_POINTS:])
    return points


def _keeps(candidate: LFT, points: Array, values: Array) -> bool:
    """Whether the values are the same, and the loop is far from singular, at all points."""
    spread = np.repeat(points, [block.size for block in candidate.blocks], axis=1)
    loop = np.eye(candidate.order) - candidate.M11[None] * spread[:, None, :]
    signs, _ = np.linalg.slogdet(loop)
    if np.any(signs <= 0) or (loop.size and np.max(np.linalg.cond(loop)) > _CONDITION):
        return False
    found = evaluate_at(candidate, points)
    size = np.max(np.abs(values), axis=0)
    size = np.maximum(size, 1e-6 * np.max(size, initial=0.0))
    return bool(
        np.max(np.abs(found - values) / np.where(size > 0, size, 1.0), initial=0.0) <= _SAME
    )


def _key(a: LFT) -> tuple[object, ...]:
    """What tells two candidates apart: sizes, and a number that depends on all entries."""
    return (*(block.size for block in a.blocks), f"{np.sum(np.abs(a.M11)):.6e}")
