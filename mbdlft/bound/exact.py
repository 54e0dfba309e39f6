"""Lower bounds of the repetitions of each delta: McMillan degrees, as ranks modulo a prime.

Fix all deltas but one at random residues. What is left is H(0) + z C (I - z A)^-1 B, and every exact LFT
of the same matrix repeats that delta at least as often as the McMillan degree of H, the number of states
that are reachable and observable. A rank modulo a prime, at special values of the others, is not
above the true one. So the bound is proved; a chance of about 1e-15 is that it could be larger.
"""

import numpy as np

from mbdlft.lft.exact import ExactLFT
from mbdlft.number.exact_matrix import Residues, multiplied, solved
from mbdlft.reduce.exact import reachable_bases


def exact_degrees(a: ExactLFT, seed: int = 0) -> dict[str, int]:
    """Proved minimum of the repetitions of each delta, in any exact LFT of the same matrix."""
    random = np.random.default_rng(seed)
    prime = a.M.prime
    at = random.integers(1, prime, len(a.blocks), dtype=np.int64)
    values = np.repeat(at, [block.size for block in a.blocks])
    found = {}
    for block, part in zip(a.blocks, a.parts, strict=True):
        M = fixed(a, np.arange(part.start, part.stop), values)
        found[block.name] = sum(minimal(M, [block.size], prime)[1])
    return found


def fixed(a: ExactLFT, own: Residues, values: Residues) -> Residues:
    """[A B ; C D] in the channels `own`, with the deltas of all others at their values (n,)."""
    M, n, prime = a.M.residues, a.order, a.M.prime
    others = np.setdiff1d(np.arange(n), own)
    rows, columns = np.r_[own, n : M.shape[0]], np.r_[own, n : M.shape[1]]
    if not len(others):
        return np.asarray(M[np.ix_(rows, columns)])
    diagonal = np.diag(values[others])
    inner = multiplied(M[np.ix_(others, others)], diagonal, prime)
    loop = (np.eye(len(others), dtype=np.int64) - inner) % prime
    solution = solved(loop, M[np.ix_(others, columns)], prime)
    through = multiplied(multiplied(M[np.ix_(rows, others)], diagonal, prime), solution, prime)
    return np.asarray((M[np.ix_(rows, columns)] + through) % prime)


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
