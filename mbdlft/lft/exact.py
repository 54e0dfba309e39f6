"""LFTs of exact numbers: [M11 M12 ; M21 M22] as one matrix, with real repeated blocks."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from mbdlft.exact.matrices import ExactMatrix, stacked
from mbdlft.lft.block import Block
from mbdlft.lft.lft import LFT


@dataclass(frozen=True, slots=True, eq=False)
class ExactLFT:
    """value = M22 + M21 Delta (I - M11 Delta)^-1 M12, in exact numbers.

    Attributes
    ----------
    M : ExactMatrix (n + n_out, n + n_in)
        [M11 M12 ; M21 M22].
    blocks : tuple of Block, sorted by name
    """

    M: ExactMatrix
    blocks: tuple[Block, ...]

    @property
    def order(self) -> int:
        """n, the sum of all repetitions."""
        return sum(block.size for block in self.blocks)

    @property
    def parts(self) -> list[slice]:
        """Rows of each block."""
        ends = np.cumsum([0, *(block.size for block in self.blocks)]).tolist()
        return [slice(a, b) for a, b in pairwise(ends)]

    def rounded(self) -> LFT:
        """The LFT in doubles; see `ExactMatrix.values`."""
        values, n = self.M.values(), self.order
        return LFT(values[:n, :n], values[:n, n:], values[n:, :n], values[n:, n:], self.blocks)


def transposed(a: ExactLFT) -> ExactLFT:
    """The LFT of the transposed value."""
    return ExactLFT(a.M.T, a.blocks)


def eliminated(a: ExactLFT, count: int, rows: list[int]) -> ExactLFT:
    """The LFT with the first `count` inputs solved for such that the first `count` outputs vanish.

    Parameters
    ----------
    a : ExactLFT
        0 = a u + b v, y = c u + d v for u the first inputs.
    rows
        Of [u ; y], those that the result has as outputs.

    Raises
    ------
    ZeroDivisionError
        The inner matrix is singular at nominal.
    """
    n, M = a.order, a.M
    inner, others = slice(n, n + count), [*range(n), *range(n + count, M.shape[1])]
    solution = -M[inner, inner].solve(M[inner, others])  # of u, in w and v
    outside = [*range(n), *range(n + count, M.shape[0])]
    rest = M[outside][:, others] + M[outside][:, inner] @ solution
    both = stacked([[rest[:n]], [solution], [rest[n:]]])
    return ExactLFT(both[[*range(n), *(n + k for k in rows)]], a.blocks)


def residues_alone(a: ExactLFT) -> ExactLFT:
    """What decides ranks and zeros, without the balls that carry values: it can go to another process."""
    M = a.M
    return ExactLFT(ExactMatrix(M.residues, np.empty((0, 0), object), M.prime), a.blocks)
