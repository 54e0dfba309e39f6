"""Matrices of exact numbers: residues decide ranks and zeros, balls carry values; FLINT computes both.

In `precision(RESIDUES_ALONE)` matrices have no balls, and nothing that is made of these has any.
"""

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
from mbdlft.exact.modular import Residues, multiplied, others, rank, solved
from mbdlft.exact.numbers import NOTHING, RESIDUES_ALONE, Exact, TooFewBitsError, zero_of
from mbdlft.exact.rounding import equilibrate

Balls = NDArray[np.object_]

_ENOUGH_BITS = 58  # of an entry, for a double that is its nearest or next to it
_LARGE = 64  # rows, of which those with few entries are eliminated one by one
_FILL, _SMALL = 16, 0.125  # most entries that a pivot may add; of the largest of its row


@dataclass(slots=True, eq=False)  # a frozen one takes three times as long to make
class ExactMatrix:
    """A matrix (n, m) as residues, 0 <= entry < prime, and as balls, zero where the residue is.

    There are no balls where residues alone are known.
    """

    residues: Residues
    known_balls: Balls | None
    prime: int

    @property
    def balls(self) -> Balls:
        """The balls (n, m) of a matrix that has some."""
        assert self.known_balls is not None, "residues alone are known"
        return self.known_balls

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        n, m = self.residues.shape
        return n, m

    @property
    def T(self) -> "ExactMatrix":
        """The transpose."""
        balls = self.known_balls
        return ExactMatrix(self.residues.T, None if balls is None else balls.T, self.prime)

    def __getitem__(self, index: Any) -> "ExactMatrix":
        """Some of the rows and columns, as of an array."""
        balls = self.known_balls
        return ExactMatrix(self.residues[index], None if balls is None else balls[index], self.prime)

    def __setitem__(self, index: Any, other: "ExactMatrix") -> None:
        """Put others in their place."""
        self.residues[index] = other.residues
        if self.known_balls is not None:
            self.known_balls[index] = other.balls

    def __matmul__(self, other: "ExactMatrix") -> "ExactMatrix":
        """Most matrices of models are sparse: rows and columns of zeros take no part."""
        inner = self.residues.any(axis=0) & other.residues.any(axis=1)
        left, right = self[:, inner], other[inner]
        rows, columns = left.residues.any(axis=1), right.residues.any(axis=0)
        shape = (self.shape[0], other.shape[1])
        product = of_residues(np.zeros(shape, dtype=np.int64), self.prime)
        if has_balls := left.known_balls is not None and right.known_balls is not None:
            product.known_balls = np.full(shape, NOTHING, dtype=object)
        if not (rows.any() and columns.any()):
            return product
        left, right, place = left[rows], right[:, columns], np.ix_(rows, columns)
        product.residues[place] = residues = multiplied(left.residues, right.residues, self.prime)
        if has_balls:
            balls = entries_of(ball_matrix(left.balls) * ball_matrix(right.balls))
            product.balls[place] = _cleared(residues, balls)
        return product

    def __add__(self, other: "ExactMatrix") -> "ExactMatrix":
        residues = (self.residues + other.residues) % self.prime
        if self.known_balls is None or other.known_balls is None:
            return of_residues(residues, self.prime)
        balls = np.where(self.residues != 0, self.balls, other.balls)
        both = (self.residues != 0) & (other.residues != 0)
        balls[both] = _cleared(residues[both], self.balls[both] + other.balls[both])
        return ExactMatrix(residues, balls, self.prime)

    def __neg__(self) -> "ExactMatrix":
        residues = -self.residues % self.prime
        if self.known_balls is None:
            return of_residues(residues, self.prime)
        balls, some = self.balls.copy(), self.residues != 0
        balls[some] = -balls[some]
        return ExactMatrix(residues, balls, self.prime)

    def solve(self, right: "ExactMatrix", *, densely: bool = False) -> "ExactMatrix":
        """self^-1 right; a ZeroDivisionError if singular, a TooFewBitsError if nearly so."""
        n, m = right.shape
        if n == 0 or m == 0:
            return zeros(n, m, self.prime)
        has_balls = self.known_balls is not None and right.known_balls is not None
        if n > _LARGE and not densely and has_balls:
            return _solved_sparsely(self, right)
        residues = solved(self.residues, right.residues, self.prime)
        if not has_balls:
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
    left, columns = (others([pair[k] for pair in pivots], n) for k in (0, 1))
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
    left, columns = (others([pair[k] for pair in pivots], len(a)) for k in (0, 1))
    core = np.array([[int(rows[i].get(j, 0)) for j in columns] for i in left], dtype=np.int64)
    return rank(core.reshape(len(left), len(left)), prime) == len(left)


def carries_values() -> bool:
    """Whether matrices have balls: not in `precision(RESIDUES_ALONE)`, where ranks cost less."""
    return bool(flint.ctx.prec > RESIDUES_ALONE)


def rough_values(a: ExactMatrix) -> Array:
    """Doubles (n, m) of any accuracy, for the choice of scales and pivots; zeros without balls."""
    values = np.zeros(a.shape)
    if a.known_balls is not None:
        some = a.residues != 0
        values[some] = [float(ball) for ball in a.known_balls[some]]
    return values


def of_residues(residues: Residues, prime: int) -> ExactMatrix:
    """A matrix of which residues alone are known."""
    return ExactMatrix(residues, None, prime)


def zeros(n: int, m: int, prime: int) -> ExactMatrix:
    """A matrix of zeros."""
    balls = np.full((n, m), NOTHING, dtype=object) if carries_values() else None
    return ExactMatrix(np.zeros((n, m), dtype=np.int64), balls, prime)


def identity(n: int, prime: int) -> ExactMatrix:
    """The identity."""
    result, diagonal = zeros(n, n, prime), np.arange(n)
    result.residues[diagonal, diagonal] = 1
    if result.known_balls is not None:
        result.known_balls[diagonal, diagonal] = flint.arb(1)
    return result


def of_integers(a: Array, prime: int) -> ExactMatrix:
    """A matrix of whole numbers, each less than 2^53."""
    balls = balls_of(a) if carries_values() else None
    return ExactMatrix(a.astype(np.int64) % prime, balls, prime)


def from_rows(rows: Sequence[Mapping[int, Exact]], width: int, prime: int) -> ExactMatrix:
    """A matrix of sparse rows: numbers by column."""
    matrix = zeros(len(rows), width, prime)
    for k, row in enumerate(rows):
        for column, value in row.items():
            if value.residue:
                matrix.residues[k, column] = int(value.residue)
                if matrix.known_balls is not None:
                    matrix.known_balls[k, column] = value.ball
    return matrix


def to_rows(a: ExactMatrix) -> list[dict[int, Exact]]:
    """The sparse rows of a matrix: undoes `from_rows`."""
    rows: list[dict[int, Exact]] = [{} for _ in a.residues]
    for k, column in zip(*np.nonzero(a.residues), strict=True):
        residue = flint.nmod(int(a.residues[k, column]), a.prime)
        ball = NOTHING if a.known_balls is None else a.known_balls[k, column]
        rows[k][int(column)] = Exact(ball, residue)
    return rows


def stacked(blocks: Sequence[Sequence[ExactMatrix]]) -> ExactMatrix:
    """A matrix of blocks, as `numpy.block` of at least one."""
    residues = np.vstack([np.hstack([block.residues for block in row]) for row in blocks])
    balls = None
    if all(block.known_balls is not None for row in blocks for block in row):
        balls = np.vstack([np.hstack([block.balls for block in row]) for row in blocks])
    return ExactMatrix(residues, balls, blocks[0][0].prime)


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
    if a.shape == (1, 1):
        if (divisor := a.balls[0, 0]).contains(NOTHING):
            raise ZeroDivisionError
        return np.asarray(b.balls / divisor)
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
    balls[zero] = [NOTHING if ball.is_zero() else zero_of(ball) for ball in balls[zero]]
    return balls
