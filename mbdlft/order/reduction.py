"""LFTs of exact numbers, and their n-D reduction, whose ranks `exact/matrices.py` decides."""

from dataclasses import dataclass

import numpy as np

from mbdlft.exact.matrices import ExactMatrix, reduced, stacked
from mbdlft.lft.block import Block, consecutive
from mbdlft.lft.lft import LFT


@dataclass(frozen=True, slots=True, eq=False)
class ExactLFT:
    """M22 + M21 Delta (I - M11 Delta)^-1 M12 in exact numbers, M = [M11 M12 ; M21 M22]."""

    M: ExactMatrix
    blocks: tuple[Block, ...]

    @property
    def order(self) -> int:
        """n, the sum of all repetitions."""
        return sum(block.size for block in self.blocks)

    @property
    def parts(self) -> list[slice]:
        """Rows of each block."""
        return consecutive(block.size for block in self.blocks)

    def rounded(self) -> LFT:
        """The LFT in doubles; see `ExactMatrix.values`."""
        values, n = self.M.values(), self.order
        return LFT(values[:n, :n], values[:n, n:], values[n:, :n], values[n:, n:], self.blocks)


def transposed(a: ExactLFT) -> ExactLFT:
    """The LFT of the transposed value."""
    return ExactLFT(a.M.T, a.blocks)


def eliminated(a: ExactLFT, count: int, rows: list[int]) -> ExactLFT:
    """The LFT with the first `count` inputs u solved for such that the first outputs vanish.

    With 0 = a u + b v, y = c u + d v the result has those of [u ; y] in `rows` as outputs. A
    ZeroDivisionError if a is singular at nominal.
    """
    n, M = a.order, a.M
    inner, others = slice(n, n + count), [*range(n), *range(n + count, M.shape[1])]
    solution = -M[inner, inner].solve(M[inner, others])  # of u, in w and v
    outside = [*range(n), *range(n + count, M.shape[0])]
    reduced = M[outside][:, others] + M[outside][:, inner] @ solution
    both = stacked([[reduced[:n]], [solution], [reduced[n:]]])
    return ExactLFT(both[[*range(n), *(n + k for k in rows)]], a.blocks)


def residues_alone(a: ExactLFT) -> ExactLFT:
    """What decides ranks and zeros, without the balls that carry values: it can go to another process."""
    M = a.M
    return ExactLFT(ExactMatrix(M.residues, np.empty((0, 0), object), M.prime), a.blocks)


def reduce_exactly(a: ExactLFT) -> ExactLFT:
    """The LFT of equal value whose order is minimal for deltas that do not commute."""
    M, sizes = reduced(a.M, [block.size for block in a.blocks])
    return ExactLFT(
        M, tuple(Block(block.name, size) for block, size in zip(a.blocks, sizes, strict=True))
    )
