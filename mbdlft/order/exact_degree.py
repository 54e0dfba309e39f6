"""Lower bounds of the repetitions of each delta: McMillan degrees, as ranks modulo a prime.

Fix all deltas but one at random residues. What is left is H(0) + z C (I - z A)^-1 B, and every exact LFT
of the same matrix repeats that delta at least as often as the McMillan degree of H, the number of states
that are reachable and observable. A rank modulo a prime, at special values of the others, is not
above the true one. So the bound is proved; a chance of about 1e-15 is that it could be larger.
"""

from functools import lru_cache

import numpy as np

from mbdlft.exact.matrices import Residues, multiplied, solved
from mbdlft.order.reduction import ExactLFT, reachable_bases


def exact_degrees(a: ExactLFT, seed: int = 0) -> dict[str, int]:
    """Proved minimum of the repetitions of each delta, in any exact LFT of the same matrix."""
    M, n = at_random(a, seed), a.order
    found = {}
    for block, part in zip(a.blocks, a.parts, strict=True):
        own = np.arange(part.start, part.stop)
        found[block.name] = sum(minimal(some(M, own, n), [block.size], a.M.prime)[1])
    return found


@lru_cache(maxsize=1)  # pairs and triples of the same LFT are asked for one after the other
def at_random(a: ExactLFT, seed: int = 0) -> Residues:
    """[M11 M12 ; M21 M22] in the distances of the deltas from random residues.

    With w' = (Delta - D) z, z = M11 (w' + D z) + M12 u. What belongs to some of the deltas is the LFT in
    these, the others at their values. That of the transposed LFT is the transpose.
    """
    random, M, n, prime = np.random.default_rng(seed), a.M.residues, a.order, a.M.prime
    at = random.integers(1, prime, len(a.blocks), dtype=np.int64)
    values = np.repeat(at, [block.size for block in a.blocks]).astype(object)
    loop = np.asarray((np.eye(n, dtype=object) - M[:n, :n] * values) % prime, dtype=np.int64)
    z = solved(loop, M[:n], prime)
    outside = np.asarray(M[n:, :n] * values % prime, dtype=np.int64)
    found = np.vstack([z, (M[n:] + multiplied(outside, z, prime)) % prime])
    found.setflags(write=False)
    return found


def some(M: Residues, own: Residues, n: int) -> Residues:
    """The rows and columns of some of n channels, and of the signals."""
    return np.asarray(M[np.ix_(np.r_[own, n : M.shape[0]], np.r_[own, n : M.shape[1]])])


def minimal(M: Residues, sizes: list[int], prime: int) -> tuple[Residues, list[int]]:
    """[A B ; C D] in the channels of each block that are reachable and observable, and their numbers."""
    for _ in range(2):
        n = sum(sizes)
        spaces = reachable_bases(M[:n, :n], M[:n, n:], sizes, prime)
        starts = np.cumsum([0, *sizes]).tolist()
        kept = [s + k for s, space in zip(starts[:-1], spaces, strict=True) for k in space.pivots]
        M = M[[*kept, *range(n, len(M))]]
        inner = [
            multiplied(M[:, s:e], space.basis.T, prime)
            for s, e, space in zip(starts[:-1], starts[1:], spaces, strict=True)
        ]
        M, sizes = np.hstack([*inner, M[:, n:]]).T, [len(space.pivots) for space in spaces]
    return M, sizes
