"""A block restricted to what it reaches, in exact numbers.

[z ; y] = N(others) [w ; u], N = [A B ; C D], w = delta z: the columns K of [B, A B, A^2 B, ...] that are
independent at a generic point span all z. So w = K w' and K z' = z, and rows of K that are independent
at delta = 0 give z':

    K_rows z' = A_rows K w' + B_rows u,   y = C K w' + D u,   w' = delta z'.

n-D reduction restricts each delta to a constant subspace; this basis depends on the other deltas, which
may be repeated more often for it, so columns that depend on them in the simplest way come first.
Independence is decided on residues.
"""

from collections.abc import Sequence
from math import inf
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbdlft.base.reach import in_reach
from mbdlft.exact import matrices, modular
from mbdlft.exact.modular import Space
from mbdlft.exact.pencils import independent
from mbdlft.exact.reachable import over_rows
from mbdlft.lft.lft import Block, consecutive
from mbdlft.order.dependent import without_dependent
from mbdlft.order.lower_bound import exact_degrees, is_affine
from mbdlft.order.reduction import ExactLFT, eliminated, reduce_exactly, transposed


class Step(NamedTuple):
    """A block of the relations, or of the closed LFT, or of its transpose, to be restricted.

    A basis of an affine delta may leave the polynomial ones outside: then it does not depend on them.
    """

    name: str
    is_transposed: bool
    of_relations: bool
    is_inside: bool = False


def restricted_exactly(
    a: ExactLFT, name: str, *, is_transposed: bool, is_inside: bool = False, most: float = inf
) -> ExactLFT | None:
    """An LFT of equal value with one block restricted, reduced; None if that is singular at delta = 0.

    None, too, where the basis repeats other deltas more than `most` times, and of a delta that is not
    affine, or without polynomial ones, inside of these.
    """
    size = dict(a.blocks)[name]
    outside = [block for block in a.blocks if is_inside and _stays_outside(a, name, block)]
    if is_inside and not outside:
        return None
    opened = _opened(transposed(a) if is_transposed else a, name, outside)
    value = value_at_random(opened, 0, size)
    if is_inside and value[:size, :size].any():
        return None
    columns = independent_columns(opened, size, value)
    if len(columns) in (0, size):
        return None
    K = krylov(opened, size, columns, most)
    rows = independent_rows(K) if K else []
    if K is None or len(rows) < len(columns):
        return None
    if any(power for _, power in columns):
        K = _at_nominal(K, rows)
    M = _settled(_in_basis(opened, size, K, rows))
    closed = ExactLFT(M.M, (*M.blocks, Block(name, len(columns)), *outside))
    ordered = in_order(closed, [block.name for block in a.blocks])
    return reduce_exactly(transposed(ordered) if is_transposed else ordered)


# of no block: channels with dependent functions are left out of the closed LFT
INDEPENDENT = Step("", is_transposed=False, of_relations=False)


def by_step(a: ExactLFT, step: Step, most: float = inf) -> ExactLFT | None:
    """An LFT with the block of a step restricted."""
    if step == INDEPENDENT:
        return without_dependent(a)
    side, is_inside = step.is_transposed, step.is_inside
    return restricted_exactly(a, step.name, is_transposed=side, is_inside=is_inside, most=most)


def _stays_outside(a: ExactLFT, name: str, block: Block) -> bool:
    """Whether another delta is polynomial, but not affine, as no path leads from a channel back to it."""
    span = a.parts[[other.name for other in a.blocks].index(block.name)]
    paths = reach = np.sign(a.M.residues[span, span].astype(float))
    for _ in range(block.size.bit_length()):
        paths = np.sign(paths @ paths)
    return block.name != name and bool(reach.any()) and not paths.any()


def with_affine_restricted(a: ExactLFT) -> ExactLFT:
    """The LFT with parameters that it is affine in on one side of the others.

    A density multiplies masses and loads, before and after products of lengths.
    """
    degrees = exact_degrees(a)
    for name, size in a.blocks:
        if size > degrees[name] and is_affine(a, name):
            once = restricted_exactly(a, name, is_transposed=True)
            a = once if once is not None and once.order < a.order else a
    return a


def _opened(a: ExactLFT, name: str, outside: Sequence[Block]) -> ExactLFT:
    """The LFT in the other deltas, (w, u) -> (z, y); u and y begin with the channels of those outside."""
    spans = {block.name: range(a.order)[span] for block, span in zip(a.blocks, a.parts, strict=True)}
    signals = [name, *(block.name for block in outside)]
    others = [block for block in a.blocks if block.name not in signals]
    channels = [k for some in (*(block.name for block in others), *signals) for k in spans[some]]
    rows, columns = ([*channels, *range(a.order, count)] for count in a.M.shape)
    return ExactLFT(a.M[rows][:, columns], tuple(others))


def in_order(a: ExactLFT, names: Sequence[str]) -> ExactLFT:
    """The same with its blocks in an order."""
    spans = {block.name: (block, span) for block, span in zip(a.blocks, a.parts, strict=True)}
    channels = [k for name in names for k in range(a.order)[spans[name][1]]]
    rows, columns = ([*channels, *range(a.order, count)] for count in a.M.shape)
    return ExactLFT(a.M[rows][:, columns], tuple(spans[name][0] for name in names))


def selected(a: ExactLFT, outputs: Sequence[int], inputs: Sequence[int]) -> ExactLFT:
    """An LFT with some of its outputs and of its inputs."""
    n = a.order
    rows, columns = [*range(n), *(n + k for k in outputs)], [*range(n), *(n + k for k in inputs)]
    return ExactLFT(a.M[rows][:, columns], a.blocks)


def merged(M: matrices.ExactMatrix, blocks: Sequence[Block], others: Sequence[Block]) -> ExactLFT:
    """An LFT whose channels are those of `blocks` and then of `others`, with the same deltas."""
    first, n = consecutive(b.size for b in blocks), sum(b.size for b in blocks)
    second = [slice(n + p.start, n + p.stop) for p in consecutive(b.size for b in others)]
    count = n + sum(b.size for b in others)
    order = [k for pair in zip(first, second, strict=True) for span in pair for k in range(count)[span]]
    rows, columns = ([*order, *range(count, size)] for size in M.shape)
    sizes = [b.size + c.size for b, c in zip(blocks, others, strict=True)]
    named = tuple(Block(b.name, size) for b, size in zip(blocks, sizes, strict=True))
    return ExactLFT(M[rows][:, columns], named)


def after(F: ExactLFT, G: ExactLFT) -> ExactLFT:
    """F [G v ; v'] with the inputs (v, v'), not reduced."""
    f, g, prime = F.order, G.order, F.M.prime
    taken = slice(f, f + G.M.shape[0] - g)
    others = slice(taken.stop, F.M.shape[1])
    through = F.M[:, taken] @ G.M[g:]
    rows = matrices.stacked([[F.M[:, :f], through, F.M[:, others]]])
    inner = matrices.stacked(
        [[matrices.zeros(g, f, prime), G.M[:g], matrices.zeros(g, others.stop - others.start, prime)]]
    )
    return merged(matrices.stacked([[rows[:f]], [inner], [rows[f:]]]), F.blocks, G.blocks)


def independent_columns(opened: ExactLFT, size: int, value: modular.Residues) -> list[tuple[int, int]]:
    """(input, power) of columns A^power B_input that span what the block reaches, the simplest first.

    They are independent in a `value` of the LFT.
    """
    prime = opened.M.prime
    A, space, chosen = value[:size, :size], Space(size, prime), list[tuple[int, int]]()
    n = opened.order
    residues = opened.M.residues
    inputs = simplest_first(
        residues[:n, :n] != 0, residues[:n, n + size :] != 0, residues[n : n + size, :n] != 0
    )
    power, columns = 0, value[:size, size + inputs]
    while len(inputs) and len(space.pivots) < size:
        columns = space.take(columns.T).T
        inputs = inputs[space.taken[-1]]
        chosen += [(c, power) for c in inputs.tolist()]
        power, columns = power + 1, modular.multiplied(A, columns, prime)
    return chosen


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


def in_rows(K: ExactLFT, rows: Sequence[int]) -> ExactLFT:
    """K (K_rows)^-1, which has the fewest poles."""
    k, count, prime = K.order, len(rows), K.M.prime
    size = K.M.shape[0] - k
    given = [matrices.zeros(k, count, prime), -matrices.identity(count, prime)]
    given.append(matrices.zeros(size, count, prime))
    whole = [[K.M[:k], given[0]], [K.M[[k + i for i in rows]], given[1]], [K.M[k:], given[2]]]
    in_x = eliminated(ExactLFT(matrices.stacked(whole), K.blocks), count, [*range(count, count + size)])
    return reduce_exactly(in_x)


def independent_rows(K: ExactLFT) -> list[int]:
    """Rows that are independent at nominal, as far from dependent as doubles tell."""
    return independent(K.M[K.order :, K.order :].T)[0]


def value_at_random(a: ExactLFT, seed: int, count: int | None = None) -> modular.Residues:
    """The value at a random point, in residues; of the first outputs, so many or all."""
    M = a.M.residues if count is None else a.M.residues[: a.order + count]
    return _at_random(M, a.blocks, a.M.prime, seed)


def _at_random(M: modular.Residues, blocks: Sequence[Block], prime: int, seed: int) -> modular.Residues:
    n, at = sum(b.size for b in blocks), np.random.default_rng(seed).integers(1, prime, len(blocks))
    is_read = np.asarray(M[n:, :n].any(axis=0))
    seen = np.flatnonzero(in_reach((M[:n, :n] != 0).T, is_read))
    deltas = np.repeat(at, [block.size for block in blocks])[seen]
    inner = modular.entrywise(M[np.ix_(seen, seen)], deltas, prime)
    loop = (np.eye(len(seen), dtype=np.int64) - inner) % prime
    left, right = modular.entrywise(M[n:, seen], deltas, prime), M[seen, n:]
    if len(left) < right.shape[1]:  # the fewer equations
        left = modular.solved(loop.T, left.T, prime).T
    else:
        right = modular.solved(loop, right, prime)
    return np.asarray((M[n:, n:] + modular.multiplied(left, right, prime)) % prime)


def krylov(
    a: ExactLFT, size: int, columns: Sequence[tuple[int, int]], most: float = inf
) -> ExactLFT | None:
    """The columns A^power B_input in some order, as an LFT (size, number of columns).

    None if it has more than `most` channels.
    """
    K, inside = None, range(size)
    for power in range(max(power for _, power in columns), -1, -1):
        inputs = [size + c for c, other in columns if other == power]
        if K is None:
            K = reduce_exactly(selected(a, inside, inputs))
        else:
            K = reduce_exactly(after(selected(a, inside, [*inside, *inputs]), K))
        if K.order > most:
            return None
    return K


def _at_nominal(K: ExactLFT, rows: Sequence[int]) -> ExactLFT:
    """The basis of the same space that is the identity in some rows at nominal.

    Channels stay channels so, and zeros zeros; in columns of powers a reduction loses hundreds of bits.
    """
    k, M = K.order, K.M
    columns = over_rows(M[:, k:], np.array(rows) + k)
    return ExactLFT(matrices.stacked([[M[:, :k], columns]]), K.blocks)


def _in_basis(a: ExactLFT, size: int, K: ExactLFT, rows: Sequence[int]) -> ExactLFT:
    """(w', u) -> (z', y) of an opened LFT in a basis K."""
    d, prime = len(rows), a.M.prime
    outputs = a.M.shape[0] - a.order - size
    wanted = selected(a, [*rows, *range(size, size + outputs)], range(a.M.shape[1] - a.order))
    moved = after(wanted, K)
    chosen = selected(K, rows, range(d))
    n, k = moved.order, chosen.order
    others = moved.M.shape[1] - n
    M = matrices.stacked(
        [
            [moved.M[:n, :n], matrices.zeros(n, k + d, prime), moved.M[:n, n:]],
            [matrices.zeros(k, n, prime), chosen.M[:k], matrices.zeros(k, others, prime)],
            [moved.M[n : n + d, :n], -chosen.M[k:], moved.M[n : n + d, n:]],
            [moved.M[n + d :, :n], matrices.zeros(outputs, k + d, prime), moved.M[n + d :, n:]],
        ]
    )
    whole = merged(M, moved.blocks, chosen.blocks)
    return reduce_exactly(eliminated(whole, d, [*range(d + outputs)]))


def _settled(a: ExactLFT) -> ExactLFT:
    """The same with rows and columns that do not vary as constants, for which nothing is repeated."""
    n, prime = a.order, a.M.prime
    D = a.M[n:, n:]
    rows, columns = (_varying(M, a.blocks, prime) for M in (a.M.residues, a.M.residues.T))
    core = selected(a, rows.tolist(), columns.tolist())
    m, (high, wide) = core.order, D.shape
    left, right = matrices.identity(high, prime)[:, rows], matrices.identity(wide, prime)[columns]
    return ExactLFT(
        matrices.stacked([[core.M[:m, :m], core.M[:m, m:] @ right], [left @ core.M[m:, :m], D]]),
        core.blocks,
    )


def _varying(M: modular.Residues, blocks: Sequence[Block], prime: int) -> NDArray[np.intp]:
    """The outputs that vary with the deltas: with random inputs their terms of first order are not zero.

    Where these are zero, values at a random point tell.
    """
    n, random = sum(block.size for block in blocks), np.random.default_rng(0)
    column, slopes = np.zeros((len(M), 1), dtype=np.int64), random.integers(1, prime, len(blocks))
    inputs = random.integers(1, prime, (M.shape[1] - n, 1))
    column[:n] = modular.multiplied(M[:n, n:], inputs, prime)
    moved = np.repeat(slopes, [block.size for block in blocks])[:, None]
    moved = modular.multiplied(M[n:, :n], modular.entrywise(moved, column[:n], prime), prime)
    if np.any(M[n:, :n].any(axis=1) & ~moved.any(axis=1)):
        moved = _at_random(np.hstack([M[:, :n], column]), blocks, prime, 1)
    return np.flatnonzero(moved.any(axis=1))
