"""Channels whose functions of the deltas depend on those of others, in exact numbers.

With Y = C (I - Delta A)^-1, whose columns are functions of the deltas,

    Y = C + Y Delta A,    value = D + Y Delta B.

If Y Delta n = 0 for a constant vector n, then [A B] + n m has the same Y and the same value for every row
m: both equations hold again. With m = -(row k of [A B]) / n_k, row k becomes zero, and channel k is left
out. So in a smallest LFT the functions Y Delta are independent, and those of its transpose too. n-D
reduction does not see this: delta_1 (delta_2 f) and delta_2 (delta_1 f) are one function but two
noncommutative monomials. Values at random points decide.

The value has no new pole, but det(I - A Delta) is another one, ((I - A Delta)^-1 n)_k / n_k times what it
was: where that vanishes on the ranges, the LFT is singular there, and of no use.
"""

import numpy as np

from mbdlft.exact import matrices
from mbdlft.exact.matrices import ExactMatrix
from mbdlft.exact.pencils import null_space
from mbdlft.order.lower_bound import exact_degrees
from mbdlft.order.reduction import ExactLFT, reduce_exactly, transposed

_LARGEST = 100  # whole numbers of the points: outside of the range, where few poles are
_MORE = 2  # points than there are functions


def without_dependent(a: ExactLFT) -> ExactLFT:
    """The same value in channels with independent functions, reduced; the LFT if they are.

    They are in an LFT that meets its degrees.
    """
    while sum(exact_degrees(a).values()) < a.order:
        smaller = _of_one_side(transposed(_of_one_side(transposed(a))))
        if smaller.order == a.order:
            break
        a = smaller
    return a


def _of_one_side(a: ExactLFT) -> ExactLFT:
    """The same for the functions Y Delta alone."""
    n, rank = a.order, _rank(a)
    if rank == n:
        return a
    change = _dependences(a, rank)
    pivots = matrices.pivot_columns(change.residues.T, a.M.prime)
    change = change @ change[pivots].solve(a.M[pivots])
    # the rows of the pivots become zero: the reduction leaves their channels out
    return reduce_exactly(ExactLFT(matrices.stacked([[a.M[:n] + -change], [a.M[n:]]]), a.blocks))


def _rank(a: ExactLFT) -> int:
    """How many of the functions Y Delta are independent, by residues."""
    M, prime, n = a.M.residues, a.M.prime, a.order
    count, random = n + _MORE, np.random.default_rng(0)
    inverses = random.integers(1, prime, (count, len(a.blocks)))
    inverses = np.repeat(inverses, [block.size for block in a.blocks], axis=1)
    left = matrices.multiplied(random.integers(1, prime, (count, len(M) - n)), M[n:, :n], prime)
    # left Y Delta is left C (1/Delta - A)^-1
    return matrices.rank(matrices.resolvents(M[:n, :n].T, inverses, left, prime), prime)


def _dependences(a: ExactLFT, rank: int) -> ExactMatrix:
    """Columns (channels, count) that vanish together with so many functions Y Delta."""
    n, M, prime = a.order, a.M, a.M.prime
    random, one = np.random.default_rng(0), matrices.identity(n, prime)
    values = matrices.zeros(0, n, prime)
    while matrices.rank(values.residues, prime) < rank:
        at = random.integers(2, _LARGEST, len(a.blocks)) * random.choice([-1, 1], len(a.blocks))
        delta = matrices.of_integers(np.diag(np.repeat(at, [b.size for b in a.blocks])), prime)
        try:
            Y = (one + -(delta @ M[:n, :n])).T.solve(M[n:, :n].T).T
        except ZeroDivisionError:  # a pole
            continue
        values = matrices.stacked([[values], [Y @ delta]])
    return null_space(values)[0]
