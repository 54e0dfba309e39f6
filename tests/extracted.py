"""LFTs in exact numbers and in doubles, for laws of either."""

from collections.abc import Iterator, Sequence
from fractions import Fraction

import numpy as np
import pytest

from mbdlft.base.parameter import BilinearMap
from mbdlft.exact.matrices import ExactMatrix, from_rows
from mbdlft.exact.numbers import BITS, Field, precision
from mbdlft.lft.lft import LFT
from mbdlft.order.degree import degree_bounds
from mbdlft.order.reduction import ExactLFT, in_scales, reduce_exactly
from mbdlft.pipeline.extract import extract
from mbdlft.problem.relations import LinearModel

FIELD = Field()


@pytest.fixture(autouse=True)
def with_bits() -> Iterator[None]:
    """Tests of a file that imports this have exact numbers of as many bits as models begin with."""
    with precision(BITS):
        yield


def extracted(relations: LinearModel, maps: Sequence[BilinearMap] | None = None) -> LFT:
    """Relations as an LFT in doubles, not reduced."""
    with precision(BITS):
        return extract(relations, maps).lft.rounded()


def reduced(relations: LinearModel) -> LFT:
    """Relations as an LFT in doubles, reduced in exact numbers, in the scales of a model."""
    with precision(BITS):
        return in_scales(reduce_exactly(extract(relations).lft).rounded())


def exact_matrix(values: Sequence[Sequence[float | Fraction]] | np.ndarray) -> ExactMatrix:
    """A matrix (n, m) of fractions, or of doubles as the binary fractions that they are."""
    array = np.asarray(values, dtype=object)
    with precision(BITS):
        rows = [{k: FIELD.rational(Fraction(x)) for k, x in enumerate(row)} for row in array]
        return from_rows(rows, array.shape[1], FIELD.prime)


def eliminated_in_doubles(a: ExactLFT, count: int, rows: list[int]) -> ExactLFT:
    """As `lft.exact.eliminated`, with the rounding of doubles: a bug that tests plant."""
    b, n = a.rounded(), a.order
    M = np.block([[b.M11, b.M12], [b.M21, b.M22]])
    inner, others = slice(n, n + count), [*range(n), *range(n + count, M.shape[1])]
    outside = [*range(n), *range(n + count, M.shape[0])]
    solution = -np.linalg.solve(M[inner, inner], M[inner, others])
    rest = M[outside][:, others] + M[outside][:, inner] @ solution
    both = np.vstack([rest[:n], solution, rest[n:]])
    return ExactLFT(exact_matrix(both[[*range(n), *(n + k for k in rows)]]), a.blocks)


def lower_bound(a: LFT, seed: int = 0) -> dict[str, int]:
    """Degrees of all deltas that doubles show."""
    return {name: bound.degree for name, bound in degree_bounds(a, seed=seed).items()}


def exactly(a: LFT) -> ExactLFT:
    """An LFT of doubles in exact numbers."""
    return ExactLFT(exact_matrix(np.block([[a.M11, a.M12], [a.M21, a.M22]])), a.blocks)
