"""Matrices of exact numbers: residues decide ranks and zeros, balls carry values; FLINT computes both."""

import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from heapq import heapify, heappop, heappush
from typing import Any

import flint
import numpy as np
from numpy.typing import NDArray

from mbdlft.base.array import Array
from mbdlft.base.errors import SizeError
from mbdlft.exact.numbers import NOTHING, Exact, TooFewBitsError, carries_values, zero_of
from mbdlft.exact.rounding import equilibrate

Residues = NDArray[np.int64]
Balls = NDArray[np.object_]

_ENOUGH_BITS = 58  # of an entry, for a double that is its nearest or next to it
_LIMB, MOST_SUMMED = 21, 2047  # bits, and how many products of them have a sum that a double holds
_HALF = 31  # bits: a product of a residue with so many has a quotient by the prime that doubles know
_MOST_OF_HALVES = 500  # products, of whose sum they know it, too
_MANY = 300_000  # products, of which BLAS makes those of doubles in less time
_LARGE = 64  # rows, of which those with few entries are eliminated one by one
_FILL, _SMALL = 16, 0.125  # most entries that a pivot may add; of the largest of its row


@dataclass(frozen=True, slots=True, eq=False)
class ExactMatrix:
    """A matrix (n, m) as residues, 0 <= entry < prime, and as balls, zero where the residue is."""

    residues: Residues
    balls: Balls
    prime: int

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        n, m = self.residues.shape
        return n, m

    @property
    def T(self) -> "ExactMatrix":
        """The transpose."""
        return ExactMatrix(self.residues.T, self.balls.T, self.prime)

    def __getitem__(self, index: Any) -> "ExactMatrix":
        """Some of the rows and columns, as of an array."""
        return ExactMatrix(self.residues[index], self.balls[index], self.prime)

    def __matmul__(self, other: "ExactMatrix") -> "ExactMatrix":
        """Most matrices of models are sparse: rows and columns of zeros take no part."""
        inner = self.residues.any(axis=0) & other.residues.any(axis=1)
        left, right = self[:, inner], other[inner]
        rows, columns = left.residues.any(axis=1), right.residues.any(axis=0)
        product = zeros(self.shape[0], other.shape[1], self.prime)
        if not (rows.any() and columns.any()):
            return product
        left, right, place = left[rows], right[:, columns], np.ix_(rows, columns)
        residues = multiplied(left.residues, right.residues, self.prime)
        product.residues[place] = residues
        if not carries_values():
            return product
        balls = entries_of(ball_matrix(left.balls) * ball_matrix(right.balls))
        product.balls[place] = _cleared(residues, balls)
        return product

    def __add__(self, other: "ExactMatrix") -> "ExactMatrix":
        residues = (self.residues + other.residues) % self.prime
        if not carries_values():
            return of_residues(residues, self.prime)
        balls = np.where(self.residues != 0, self.balls, other.balls)
        both = (self.residues != 0) & (other.residues != 0)
        balls[both] = _cleared(residues[both], self.balls[both] + other.balls[both])
        return ExactMatrix(residues, balls, self.prime)

    def __neg__(self) -> "ExactMatrix":
        balls, some = self.balls.copy(), self.residues != 0
        balls[some] = -balls[some]
        return ExactMatrix(-self.residues % self.prime, balls, self.prime)

    def solve(self, right: "ExactMatrix", *, densely: bool = False) -> "ExactMatrix":
        """self^-1 right; a ZeroDivisionError if singular, a TooFewBitsError if nearly so."""
        n, m = right.shape
        if n == 0 or m == 0:
            return zeros(n, m, self.prime)
        if n > _LARGE and not densely and carries_values():
            return _solved_sparsely(self, right)
        matrix = _residue_matrix(self.residues, self.prime)
        residues = _residues(matrix.solve(_residue_matrix(right.residues, self.prime)))
        if not carries_values():
            return of_residues(residues, self.prime)
        try:
            balls = _solved(self, right)
        except ZeroDivisionError:
            raise TooFewBitsError("the balls of a matrix contain a singular one.") from None
        return ExactMatrix(residues, _cleared(residues, balls), self.prime)

    def values(self) -> Array:
        """Doubles (n, m) next to the entries, 0.0 for zeros; a TooFewBitsError if balls are wide."""
        values = np.zeros(self.shape)
        for place in zip(*np.nonzero(self.residues), strict=True):
            values[place] = double_of(self.balls[place])
        return values


def double_of(ball: Any) -> float:
    """The double next to a ball that is not zero; a TooFewBitsError if it is wide.

    A SizeError if there is none with all digits.
    """
    if ball.rel_accuracy_bits() < _ENOUGH_BITS:
        raise TooFewBitsError(f"a ball of radius {float(ball.rad()):.1e} is too wide.")
    value = float(ball.mid())
    if not sys.float_info.min <= abs(value) <= sys.float_info.max:
        raise SizeError("LFT: an entry is too large, or too small, for doubles.")
    return value


def eliminate(
    rows: list[dict[int, Any]], count: int, size: Callable[[Any], float] = lambda x: 1.0
) -> list[tuple[int, int]]:
    """Pivots (row, column) of sparse rows, which are eliminated from the others, in place.

    Pivots are in the first `count` columns and are taken as long as they add few entries, as none does
    whose row or column has no other one; those that are small beside others of their row are not. Each
    pivot row has the columns of later pivots, and others, only.
    """
    of_column: list[set[int]] = [set() for _ in range(count)]
    for i, row in enumerate(rows):
        for j in row:
            if j < count:
                of_column[j].add(i)
    waiting = [(sum(j < count for j in row), i) for i, row in enumerate(rows)]
    heapify(waiting)
    pivots: list[tuple[int, int]] = []
    done: set[int] = set()
    while waiting:
        entries, i = heappop(waiting)
        inside = [j for j in rows[i] if j < count]
        if i in done or len(inside) != entries or not inside:
            continue
        sizes = {j: size(rows[i][j]) for j in inside}
        least = _SMALL * max(sizes.values())
        others, j = min((len(of_column[j]) - 1, j) for j, x in sizes.items() if x >= least)
        if others * (entries - 1) > _FILL:
            continue
        done.add(i)
        pivots.append((i, j))
        for m in inside:
            of_column[m].discard(i)
        pivot = rows[i][j]
        for k in sorted(of_column[j]):
            row = rows[k]
            factor = row.pop(j) / pivot
            for m, x in rows[i].items():
                if m == j:
                    continue
                value = row[m] - factor * x if m in row else -(factor * x)
                if value:
                    row[m] = value
                    if m < count:
                        of_column[m].add(k)
                elif m in row:
                    del row[m]
                    if m < count:
                        of_column[m].discard(k)
            heappush(waiting, (sum(m < count for m in row), k))
        of_column[j].clear()
    return pivots


def _solved_sparsely(a: ExactMatrix, right: ExactMatrix) -> ExactMatrix:
    """a^-1 right: rows with few entries one by one, and what is left of them densely."""
    n, m = right.shape
    rows = to_rows(stacked([[a, right]]))
    pivots = eliminate(rows, n, lambda x: abs(float(x.ball)))
    left, columns = (_others([pair[k] for pair in pivots], n) for k in (0, 1))
    place = {j: k for k, j in enumerate([*columns, *range(n, n + m)])}
    remaining = [{place[j]: x for j, x in rows[i].items()} for i in left]
    dense = from_rows(remaining, len(columns) + m, a.prime)
    solved = dense[:, : len(columns)].solve(dense[:, len(columns) :], densely=True)
    solution: dict[int, dict[int, Exact]] = dict(zip(columns, to_rows(solved), strict=True))
    for i, j in reversed(pivots):
        side = {k - n: x for k, x in rows[i].items() if k >= n}
        for k, factor in rows[i].items():
            if k < n and k != j:
                for column, x in solution[k].items():
                    known = side.get(column)
                    side[column] = -(factor * x) if known is None else known - factor * x
        pivot = rows[i][j]
        solution[j] = {column: x / pivot for column, x in side.items() if x}
    return from_rows([solution[j] for j in range(n)], m, a.prime)


def is_regular(a: Residues, prime: int) -> bool:
    """Whether a square matrix is regular modulo a prime."""
    rows: list[dict[int, Any]] = [{} for _ in a]
    for i, j in zip(*np.nonzero(a), strict=True):
        rows[i][int(j)] = flint.nmod(int(a[i, j]), prime)
    pivots = eliminate(rows, len(a))
    left, columns = (_others([pair[k] for pair in pivots], len(a)) for k in (0, 1))
    core = np.array([[int(rows[i].get(j, 0)) for j in columns] for i in left], dtype=np.int64)
    return rank(core.reshape(len(left), len(left)), prime) == len(left)


def rough_values(a: ExactMatrix) -> Array:
    """Doubles (n, m) of any accuracy, for the choice of scales and pivots."""
    values = np.zeros(a.shape)
    some = a.residues != 0
    values[some] = [float(ball) for ball in a.balls[some]]
    return values


def of_residues(residues: Residues, prime: int) -> ExactMatrix:
    """A matrix of which residues alone are known."""
    return ExactMatrix(residues, np.full(residues.shape, NOTHING, dtype=object), prime)


def zeros(n: int, m: int, prime: int) -> ExactMatrix:
    """A matrix of zeros."""
    return of_residues(np.zeros((n, m), dtype=np.int64), prime)


def identity(n: int, prime: int) -> ExactMatrix:
    """The identity."""
    result = zeros(n, n, prime)
    diagonal = np.arange(n)
    result.residues[diagonal, diagonal] = 1
    result.balls[diagonal, diagonal] = flint.arb(1)
    return result


def of_integers(a: Array, prime: int) -> ExactMatrix:
    """A matrix of whole numbers, each less than 2^53."""
    return ExactMatrix(a.astype(np.int64) % prime, balls_of(a), prime)


def from_rows(rows: Sequence[Mapping[int, Exact]], width: int, prime: int) -> ExactMatrix:
    """A matrix of sparse rows: numbers by column."""
    matrix = zeros(len(rows), width, prime)
    for k, row in enumerate(rows):
        for column, value in row.items():
            if value.residue:
                matrix.residues[k, column] = int(value.residue)
                matrix.balls[k, column] = value.ball
    return matrix


def to_rows(a: ExactMatrix) -> list[dict[int, Exact]]:
    """The sparse rows of a matrix: undoes `from_rows`."""
    rows: list[dict[int, Exact]] = [{} for _ in a.residues]
    for k, column in zip(*np.nonzero(a.residues), strict=True):
        residue = flint.nmod(int(a.residues[k, column]), a.prime)
        rows[k][int(column)] = Exact(a.balls[k, column], residue)
    return rows


def stacked(blocks: Sequence[Sequence[ExactMatrix]]) -> ExactMatrix:
    """A matrix of blocks, as `numpy.block` of at least one."""
    residues = np.vstack([np.hstack([block.residues for block in row]) for row in blocks])
    balls = np.vstack([np.hstack([block.balls for block in row]) for row in blocks])
    return ExactMatrix(residues, balls, blocks[0][0].prime)


def multiplied(a: Residues, b: Residues, prime: int) -> Residues:
    """a b modulo a prime below 2^61, also of stacks."""
    inner = a.shape[-1]
    if inner > MOST_SUMMED:
        half = inner // 2
        first = multiplied(a[..., :half], b[..., :half, :], prime)
        return np.asarray((first + multiplied(a[..., half:], b[..., half:, :], prime)) % prime)
    if a.size * b.shape[-1] > _MANY or inner > _MOST_OF_HALVES:
        # x y' + y x' = x x' + y y' - (x - y) (x' - y'), whose factors are no larger: 6 products for 9
        x, y, z, xy, xz, yz = np.matmul(*map(_with_differences, (a, b))).astype(np.int64)
        return _joined((x, x + y - xy, x + y + z - xz, y + z - yz, z), prime)
    # integers overflow: of x b - q p, which is small, the last 64 bits are all. BLAS has no integers
    halves = np.empty((2, *a.shape), dtype=np.int64)
    halves[0], halves[1] = a >> _HALF, a & (2**_HALF - 1)
    quotients = (halves.astype(float) @ (b * (1.0 / prime))).astype(np.int64)
    high, low = halves @ b - quotients * prime
    return np.asarray((_shifted(high, 2**_HALF, prime) + low) % prime)


def _shifted(x: Residues, y: Residues | int, prime: int) -> Residues:
    """x y less a multiple of a prime, below it in size, for y up to 2^31."""
    return np.asarray(x * y - (x * (1.0 / prime) * y).astype(np.int64) * prime)


def limbs(a: Residues) -> Array:
    """Residues as three doubles each, 2^42 x + 2^21 y + z: (3, ...)."""
    mask = 2**_LIMB - 1
    return np.array([a & mask, (a >> _LIMB) & mask, a >> 2 * _LIMB], dtype=float)


def _with_differences(a: Residues) -> Array:
    x, y, z = limbs(a)
    return np.array([x, y, z, x - y, x - z, y - z])


def joined(C: Residues, prime: int) -> Residues:
    """The residue of products C (3, 3, ...) of limbs with limbs."""
    middle = C[0, 2] + C[1, 1] + C[2, 0]
    return _joined((C[0, 0], C[0, 1] + C[1, 0], middle, C[1, 2] + C[2, 1], C[2, 2]), prime)


def _joined(totals: Sequence[Residues], prime: int) -> Residues:
    """The residue of a sum of totals times 1, 2^21, 2^42, ..., each below 2^55 in size.

    Sums stay below 2^62 in size, as 2^21 times one of them is reduced by its quotient.
    """
    *lower, sums = totals
    for total in reversed(lower):
        quotient = (sums * (2.0**_LIMB / prime)).astype(np.int64)
        sums = (sums << _LIMB) - quotient * prime + total
    return np.asarray(sums % prime)


def entrywise(a: Residues, b: Residues, prime: int) -> Residues:
    """Products of entries modulo a prime below 2^61, with the rules of numpy for shapes."""
    high = _shifted(_shifted(a, b >> _HALF, prime), 2**_HALF, prime)
    return np.asarray((high + _shifted(a, b & (2**_HALF - 1), prime)) % prime)


def inverses(a: Residues, prime: int) -> Residues:
    """Of entries (n,), none of them zero, modulo a prime."""
    return np.array([int(1 / flint.nmod(x, prime)) for x in a.tolist()], dtype=np.int64)


def powers_of(points: Residues, count: int, prime: int) -> Residues:
    """(points, count)."""
    powers = np.ones((len(points), count), dtype=np.int64)
    for e in range(1, count):
        powers[:, e] = entrywise(powers[:, e - 1], points, prime)
    return powers


def solved(a: Residues, b: Residues, prime: int) -> Residues:
    """a^-1 b modulo a prime; a ZeroDivisionError if a is singular."""
    if 0 in b.shape:
        return np.zeros(b.shape, dtype=np.int64)
    return _residues(_residue_matrix(a, prime).solve(_residue_matrix(b, prime)))


def resolvents(a: Residues, diagonals: Residues, right: Residues, prime: int) -> Residues:
    """(diagonal - a)^-1 right modulo a prime, for diagonals (N, n); a ZeroDivisionError if singular.

    Right sides are (N, n) or (N, n, columns). One matrix is converted for all, as an entry of FLINT takes
    longer than its elimination.
    """
    n = len(a)
    if not n:
        return np.zeros(right.shape, dtype=np.int64)
    minus, solutions = _residue_matrix(-a % prime, prime), []
    for diagonal, side in zip((diagonals - np.diag(a)) % prime, right, strict=True):
        matrix = flint.nmod_mat(minus)
        for k, x in enumerate(diagonal.tolist()):
            matrix[k, k] = x
        solutions.append(_residues(matrix.solve(_residue_matrix(side.reshape(n, -1), prime))))
    return np.array(solutions).reshape(right.shape)


def rank(a: Residues, prime: int) -> int:
    """The rank modulo a prime."""
    return int(_residue_matrix(a, prime).rank()) if a.size else 0


def null_space(a: Residues, prime: int) -> Residues:
    """Independent columns (columns of a, nullity) that span the null space modulo a prime."""
    rows, pivots = row_echelon(a, prime)
    free = _others(pivots, a.shape[1])
    basis = np.zeros((a.shape[1], len(free)), dtype=np.int64)
    basis[free, np.arange(len(free))] = 1
    basis[pivots] = -rows[:, free] % prime
    return basis


def row_echelon(a: Residues, prime: int) -> tuple[Residues, list[int]]:
    """The reduced echelon form of the rows, without rows of zeros, and the columns of its pivots."""
    matrix, pivots = _eliminated(a, prime)
    rows, all_rows = np.zeros((len(pivots), a.shape[1]), dtype=np.int64), range(len(pivots))
    rows[all_rows, pivots] = 1
    # an entry of FLINT takes longer than its elimination: only those are read that may be anything
    free = _others(pivots, a.shape[1])
    entries = [[int(matrix[i, j]) if j > pivots[i] else 0 for j in free] for i in all_rows]
    rows[:, free] = np.array(entries, dtype=np.int64).reshape(len(pivots), len(free))
    return rows, pivots


def _others(some: Sequence[int], count: int) -> list[int]:
    """Those of so many numbers that are not among some."""
    return [k for k, is_other in enumerate(np.bincount(some, minlength=count) == 0) if is_other]


def pivot_columns(a: Residues, prime: int) -> list[int]:
    """The columns that do not depend on those before them."""
    return _eliminated(a, prime)[1]


def _eliminated(a: Residues, prime: int) -> tuple[Any, list[int]]:
    """The reduced echelon form of FLINT, and the columns of its pivots."""
    if not a.size:
        return None, []
    matrix, count = _residue_matrix(a, prime).rref()
    pivots, column = [], 0
    for row in range(count):
        while not matrix[row, column]:
            column += 1
        pivots.append(column)
        column += 1
    return matrix, pivots


def _residue_matrix(a: Residues, prime: int) -> Any:
    n, m = a.shape
    # through a matrix of integers: FLINT converts these half as slowly
    return flint.nmod_mat(flint.fmpz_mat(n, m, a.ravel().tolist()), prime)


def _residues(matrix: Any) -> Residues:
    entries = np.array(list(map(int, matrix.entries())), dtype=np.int64)
    return entries.reshape(matrix.nrows(), matrix.ncols())


def balls_of(a: Array) -> Balls:
    """Doubles (n, m) as balls."""
    balls = np.empty(a.size, dtype=object)
    balls[:] = [flint.arb(x) for x in a.ravel().tolist()]
    return balls.reshape(a.shape)


def entries_of(matrix: Any) -> Balls:
    """The entries of a matrix of FLINT, as they are, in an array."""
    balls = np.empty(matrix.nrows() * matrix.ncols(), dtype=object)
    balls[:] = matrix.entries()
    return balls.reshape(matrix.nrows(), matrix.ncols())


def middles_of(matrix: Any) -> NDArray[Any]:
    """The midpoints (n, m) of a matrix of FLINT in doubles, complex ones of complex balls."""
    kind: type = complex if isinstance(matrix, flint.acb_mat) else float
    entries = [kind(entry.mid()) for entry in matrix.entries()]
    return np.array(entries, dtype=kind).reshape(matrix.nrows(), matrix.ncols())


def ball_matrix(a: Balls) -> Any:
    """The matrix of FLINT."""
    n, m = a.shape
    return flint.arb_mat(n, m, a.ravel().tolist())


def _solved(a: ExactMatrix, b: ExactMatrix) -> Balls:
    """a^-1 b, with rows and columns of one size: errors of large unknowns would be those of all."""
    rows, columns = map(_powers, equilibrate(rough_values(a)[None]))
    scaled = ball_matrix(rows[:, None] * a.balls * columns)
    # FLINT eliminates fewer than 40 rows in balls by default, which lose a bit or two with each
    solved = scaled.solve(ball_matrix(rows[:, None] * b.balls), algorithm="precond")
    return np.asarray(columns[:, None] * entries_of(solved))


def _powers(sizes: Array) -> Balls:
    """Powers of two near to sizes (n,)."""
    powers = 2.0 ** np.round(np.log2(np.clip(sizes, 1e-300, 1e300)))
    return balls_of(np.array([powers], dtype=float)).ravel()


def _cleared(residues: Residues, balls: Balls) -> Balls:
    zero = residues == 0
    balls[zero] = [zero_of(ball) for ball in balls[zero]]
    return balls
