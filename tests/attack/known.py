"""LFTs of known orders in fractions, their matrices as quotients of polynomials, and their degrees.

    Y(p) = M22 + M21 P (I - M11 P)^-1 M12,   P = diag(p_1 I_r1, ..., p_q I_rq)

is N/D with D = det(I - M11 P), and N_ij the determinant of the same matrix with row i and column j
beside it. Both have the degree r_k in p_k at most, so that their values on a grid give them.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from itertools import product
from typing import Any

import flint
import numpy as np

from tests.laws.loewner import PRIME, degree, value_modulo

Polynomial = dict[tuple[int, ...], Fraction]  # coefficients by exponents of the parameters
_MOST = 8  # channels


@dataclass(frozen=True)
class Known:
    """An LFT in fractions; |p_k| <= `reach` keeps it regular: the rows of M11 P are below 0.8.

    Attributes
    ----------
    names, sizes : of the parameters
    reach : largest size of each parameter
    M : (n + rows, n + columns), fractions
    """

    names: tuple[str, ...]
    sizes: tuple[int, ...]
    reach: tuple[Fraction, ...]
    M: list[list[Fraction]]

    @property
    def order(self) -> int:
        """Repetitions of all parameters."""
        return sum(self.sizes)

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, columns) of the matrix."""
        return len(self.M) - self.order, len(self.M[0]) - self.order

    def spread(self, values: Mapping[str, Any]) -> list[Any]:
        """The diagonal of P (n,)."""
        return [
            values[name] for name, size in zip(self.names, self.sizes, strict=True) for _ in range(size)
        ]


def known(random: np.random.Generator, *, spread: int = 0) -> Known:
    """A random LFT with 1 to 4 parameters and 1 to 8 channels, of decimals of two to six digits.

    `spread` is the largest exponent of the powers of ten in which parameters, rows and columns differ.
    """
    count = int(random.integers(1, 5))
    sizes = random.multinomial(int(random.integers(0, _MOST + 1 - count)), [1 / count] * count) + 1
    n, rows, columns = int(sizes.sum()), int(random.integers(1, 4)), int(random.integers(1, 4))
    reach = [_decimal(random, 1, 99, spread) for _ in sizes]
    dense, most = random.choice([0.3, 0.7, 1.0]), 10 ** int(random.choice([2, 2, 4, 6])) - 1

    def some(height: int, width: int) -> list[list[Fraction]]:
        drawn = random.integers(-most, most + 1, (height, width))
        drawn = drawn * (random.random((height, width)) < dense)
        return [[Fraction(int(x)) for x in row] for row in drawn]

    M = some(n + rows, n + columns)
    wide = [r for r, size in zip(reach, sizes, strict=True) for _ in range(size)]
    left = [_decimal(random, 1, 10, spread) for _ in range(rows)]
    right = [_decimal(random, 1, 10, spread) for _ in range(columns)]
    for i in range(n + rows):
        for j in range(n + columns):
            if j < n:
                M[i][j] *= _power_of_ten_below(Fraction(8, 10 * most * n) / wide[j])
            M[i][j] *= (left[i - n] if i >= n else 1) * (right[j - n] if j >= n else 1)
    names = tuple(str(name) for name in random.permutation(["a", "b", "Jg", "q_1"])[:count])
    return Known(names, tuple(map(int, sizes)), tuple(reach), M)


def _decimal(random: np.random.Generator, low: int, high: int, spread: int) -> Fraction:
    """A whole number in another unit."""
    exponent = int(random.integers(-spread, spread + 1))
    return int(random.integers(low, high + 1)) * Fraction(10) ** exponent


def _power_of_ten_below(value: Fraction) -> Fraction:
    found = Fraction(1)
    while found > value:
        found /= 10
    while 10 * found <= value:
        found *= 10
    return found


def value(a: Known, at: Mapping[str, Fraction]) -> list[list[Fraction]]:
    """The matrix at fractions."""
    n, P = a.order, a.spread(at)
    rows, columns = a.shape
    inner = _rational([[(i == j) - a.M[i][j] * P[j] for j in range(n)] for i in range(n)])
    right = _rational([row[n:] for row in a.M[:n]])
    left = _rational([[x * P[j] for j, x in enumerate(row[:n])] for row in a.M[n:]])
    found = _rational([row[n:] for row in a.M[n:]]) + left * inner.solve(right)
    return [[_fraction(found[i, j]) for j in range(columns)] for i in range(rows)]


def polynomials(a: Known) -> tuple[list[list[Polynomial]], Polynomial]:
    """Numerators, and the denominator that they have in common."""
    n, grid = a.order, list(product(*(range(size + 1) for size in a.sizes)))
    rows, columns = a.shape

    def determinants(*beside: tuple[int, int]) -> Polynomial:
        picked = [*((k, k) for k in range(n)), *beside]
        found = {}
        for point in grid:
            P = [*a.spread(dict(zip(a.names, point, strict=True))), *[1] * columns]
            matrix = [
                [(i == j < n) - a.M[i][j] * P[j] if i < n else a.M[i][j] * P[j] for _, j in picked]
                for i, _ in picked
            ]
            found[point] = _fraction(_rational(matrix).det())
        return _interpolated(found, a.sizes)

    above = [[determinants((n + i, n + j)) for j in range(columns)] for i in range(rows)]
    return above, determinants()


def _interpolated(values: dict[tuple[int, ...], Fraction], sizes: tuple[int, ...]) -> Polynomial:
    """The polynomial with values on the grid 0, 1, ..., size of each parameter."""
    found = dict(values)
    for k, size in enumerate(sizes):
        whole = flint.fmpq_mat(
            size + 1, size + 1, [x**e for x in range(size + 1) for e in range(size + 1)]
        )
        inverse = whole.inv()
        back = [[_fraction(inverse[e, x]) for x in range(size + 1)] for e in range(size + 1)]
        found = {
            point: sum(
                (back[point[k]][x] * found[(*point[:k], x, *point[k + 1 :])] for x in range(size + 1)),
                Fraction(0),
            )
            for point in found
        }
    return {exponents: x for exponents, x in found.items() if x}


def degrees(a: Known, random: np.random.Generator) -> dict[str, int]:
    """McMillan degrees, other parameters at random values."""
    found, M = {}, np.array(a.M, dtype=object)
    for name, size in zip(a.names, a.sizes, strict=True):
        at = {other: int(random.integers(1, PRIME)) for other in a.names}
        value_at = lambda z, at=at, name=name: value_modulo(M, a.spread(at | {name: z}))  # noqa: E731
        found[name] = degree(value_at, size + 1, random)
    return found


def _rational(rows: list[list[Any]]) -> Any:
    entries = [Fraction(x) for row in rows for x in row]
    return flint.fmpq_mat(
        len(rows), len(rows[0]), [flint.fmpq(x.numerator, x.denominator) for x in entries]
    )


def _fraction(x: Any) -> Fraction:
    return Fraction(int(x.p), int(x.q))
