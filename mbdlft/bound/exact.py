"""Lower bounds of the repetitions of each delta: McMillan degrees, as ranks modulo a prime.

Fix all deltas but one at random residues. What is left is H(0) + z C (I - z A)^-1 B, and every exact LFT
of the same matrix repeats that delta at least as often as the McMillan degree of H, which is the number
of states that are reachable and observable. A rank modulo a prime, at special values of the others, is not
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
        own = np.arange(part.start, part.stop)
        others = np.setdiff1d(np.arange(a.order), own)
        found[block.name] = _degree(_fixed(a.M.residues, own, others, values, a.order, prime), block.size, prime)
    return found


def _fixed(
    M: Residues, own: Residues, others: Residues, values: Residues, order: int, prime: int
) -> Residues:
    """[A B ; C D] in the channels `own`, with the deltas of the others at their values."""
    rows = np.r_[own, order : M.shape[0]]
    columns = np.r_[own, order : M.shape[1]]
    if not len(others):
        return M[np.ix_(rows, columns)]
    diagonal = np.diag(values[others])
    inner = multiplied(M[np.ix_(others, others)], diagonal, prime)
    loop = (np.eye(len(others), dtype=np.int64) - inner) % prime
    solution = solved(loop, M[np.ix_(others, columns)], prime)
    through = multiplied(multiplied(M[np.ix_(rows, others)], diagonal, prime), solution, prime)
    return np.asarray((M[np.ix_(rows, columns)] + through) % prime)


def _degree(M: Residues, n: int, prime: int) -> int:
    """Number of states that are reachable and observable, of [A B ; C D] with n states."""
    for _ in range(2):
        (space,) = reachable_bases(M[:n, :n], M[:n, n:], [n], prime)
        kept = np.r_[np.array(space.pivots, dtype=np.int64), n : M.shape[0]]
        inner = multiplied(M[kept, :n], space.basis.T, prime)
        M, n = np.hstack([inner, M[kept, n:]]).T, len(space.pivots)
    return n
