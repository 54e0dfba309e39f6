"""Channels whose functions of the deltas depend on those of others, in exact numbers.

With Y = C (I - Delta A)^-1, whose columns are functions of the deltas,

    Y = C + Y Delta A,    value = D + Y Delta B.

If Y Delta n = 0 for a constant vector n, then [A B] + n m has the same Y and the same value for every row
m: both equations hold again. With m = -(row k of [A B]) / n_k, row k becomes zero, and channel k is left
out. So in a smallest LFT the functions Y Delta are independent, and those of its transpose too. n-D
reduction does not see this: delta_1 (delta_2 f) and delta_2 (delta_1 f) are one function but two
noncommutative monomials. Values at random points decide, as residues; few channels take part in each n,
and balls are computed for these and for those that lead to them alone. Of a block, channels with small
n_k are not left out, as the other numbers are divided by n_k.

The value has no new pole, but det(I - A Delta) is another one, ((I - A Delta)^-1 n)_k / n_k times what it
was: where that vanishes on the ranges, the LFT is singular there, and of no use.
"""

from collections.abc import Sequence
from contextlib import suppress

import numpy as np

from mbdlft.base.reach import in_reach
from mbdlft.exact import matrices, modular
from mbdlft.exact.matrices import ExactMatrix
from mbdlft.exact.modular import Residues, Space
from mbdlft.exact.pencils import null_space
from mbdlft.exact.rounding import channel_scales
from mbdlft.lft.determinant import Channels, diagonal_blocks
from mbdlft.order.reduction import ExactLFT, reduce_exactly, transposed

_ONE = 1000  # in the whole numbers of points, whose deltas are inside of the ranges, where no poles are
_SMALL = 1e-5  # of a vector, and no number to divide the others by if there are larger ones


def without_dependent(a: ExactLFT, least: int = 0) -> ExactLFT:
    """The same value in channels with independent functions, reduced; the LFT if they are.

    They are in an LFT that meets the `least` order, a bound.
    """
    while least < a.order:
        smaller = _of_one_side(transposed(_of_one_side(transposed(a))))
        if smaller.order == a.order:
            break
        a = smaller
    return a


def _of_one_side(a: ExactLFT) -> ExactLFT:
    """The same for the functions Y Delta alone."""
    n, M, change = a.order, a.M, _dependences(a)
    if not change.shape[1]:
        return a
    order = np.arange(n)
    if matrices.carries_values():
        change, rough = _in_balls(a, change), matrices.rough_values(M)
        scale = channel_scales(rough[:n, :n], rough[:n, n:], rough[n:, :n])
        sizes = np.abs(scale[:, None] * matrices.rough_values(change))
        is_small = np.all(sizes < _SMALL * sizes.max(axis=0), axis=1)
        order = np.concatenate([np.arange(n)[k][np.argsort(is_small[k], kind="stable")] for k in a.parts])
    pivots = order[modular.pivot_columns(change.residues[order].T, M.prime)]
    change = change @ change[pivots].solve(M[pivots])
    # the rows of the pivots become zero: the reduction leaves their channels out
    return reduce_exactly(ExactLFT(matrices.stacked([[M[:n] + -change], [M[n:]]]), a.blocks))


def _dependences(a: ExactLFT) -> ExactMatrix:
    """Columns (channels, count) n with Y Delta n = 0, few channels in each, in residues.

    Functions that depend at points and at one more, all random, do at any.
    """
    n, M, prime = a.order, a.M.residues, a.M.prime
    space, random = Space(n, prime), np.random.default_rng(0)
    A, C = M[:n, :n], M[n:, :n][M[n:, :n].any(axis=1)]
    blocks = diagonal_blocks(A.T)
    while missing := n - len(space.pivots):
        inverses = random.integers(1, prime, (1 + missing // len(C), len(a.blocks)))
        inverses = np.repeat(inverses, [block.size for block in a.blocks], axis=1)
        if not len(space.extend(_values(A, C, inverses, blocks, prime))):
            break
    others = sorted(set(range(n)) - set(space.pivots))
    null = matrices.identity(n, prime)[:, others]
    null.residues[space.pivots] = -space.basis[:, others] % prime
    return null


def _values(
    A: Residues, C: Residues, inverses: Residues, blocks: Sequence[Channels], prime: int
) -> Residues:
    """Rows of Y Delta = C (1/Delta - A)^-1 at points (N, channels); a block takes those before it."""
    values = np.zeros((len(inverses), *C.shape), dtype=np.int64)
    for block in blocks:
        needed = modular.multiplied(values.reshape(-1, len(A)), A[:, block], prime)
        right = np.swapaxes((C[:, block] + needed.reshape(*values.shape[:2], -1)) % prime, 1, 2)
        solved = modular.resolvents(A[block][:, block].T, inverses[:, block], right, prime)
        values[:, :, block] = np.swapaxes(solved, 1, 2)
    return values.reshape(-1, len(A))


def _in_balls(a: ExactLFT, null: ExactMatrix) -> ExactMatrix:
    """The same columns in balls, each from values of the functions that take part in it."""
    n, prime, random, sizes = a.order, a.M.prime, np.random.default_rng(0), [b.size for b in a.blocks]
    kept = np.flatnonzero(in_reach(a.M.residues[:n, :n] != 0, np.asarray(null.residues.any(axis=1))))
    A, C = a.M[kept][:, kept], a.M[n:][:, kept]
    A, C = matrices.of_integers(_ONE * np.eye(len(kept)), prime) @ A, C[C.residues.any(axis=1)]
    blocks = diagonal_blocks(A.residues.T)
    values, result = matrices.zeros(0, len(kept), prime), matrices.zeros(*null.shape, prime)
    for k, column in enumerate(null.residues[kept].T):
        some = np.flatnonzero(column)
        for _ in some:  # each point adds a row that is independent, at least
            if modular.rank(values.residues[:, some], prime) == len(some) - 1:
                break
            at = random.integers(_ONE, 2 * _ONE, len(sizes)) * random.choice([-1, 1], len(sizes))
            with suppress(ZeroDivisionError):  # a pole
                more = _values_in_balls(A, C, np.repeat(at, sizes)[kept], blocks)
                values = matrices.stacked([[values], [more]])
        basis, _ = null_space(values[:, some])
        result[kept[some], k] = basis[:, 0]
    return result


def _values_in_balls(
    A: ExactMatrix, C: ExactMatrix, inverses: Residues, blocks: Sequence[Channels]
) -> ExactMatrix:
    """`_values` at one point."""
    values = matrices.zeros(*C.shape, C.prime)
    for block in blocks:
        loop = matrices.of_integers(np.diag(inverses[block]), C.prime) + -A[block][:, block]
        values[:, block] = loop.T.solve((C[:, block] + values @ A[:, block]).T).T
    return values
