"""Repetitions of one delta exchanged for fewer of another, in exact numbers.

With all deltas but b as signals, and w = a z,

    z = A(b) w + B(b) u,    y = C(b) w + D(b) u,

is rational in b. If z stays in a space R(b) that has h dimensions less than z, the columns K(b) span it,
and rows of numbers P have P K regular, then z' = P z are enough:

    z' = P A S w' + P B u,    y = C S w' + D u,    w' = a z',    S = K (P K)^-1.

The delta a is repeated h times less. S has poles where P K is singular, at h values of b as a rule, and
each costs a repetition of b. One repetition is enough for d of them at one value beta, if P is zero on

    v, A v, ..., A^(d-1) v    at beta,    with v in R(beta) and C v = C A v = ... = C A^(d-2) v = 0.

In the words of docs/pairs.md: these v are quotients O(-d) of the bundle on the line b = beta. Chains that
exist at any beta are used; values beta are outside of the range, which is from -1 to 1.
"""

from collections.abc import Callable, Iterator, Sequence
from fractions import Fraction
from itertools import permutations
from typing import NamedTuple, TypeVar

import numpy as np
from scipy.linalg import qr

from mbdlft.base.array import Array
from mbdlft.exact import matrices
from mbdlft.exact.matrices import ExactMatrix, Residues
from mbdlft.exact.reachable import reachable_bases
from mbdlft.exact.rounding import channel_scales, equilibrate, or_one
from mbdlft.lft.lft import Block
from mbdlft.order.lower_bound import exact_degrees
from mbdlft.order.rational import image_of
from mbdlft.order.reduction import ExactLFT, eliminated, reduce_exactly, transposed
from mbdlft.order.restriction import (
    after,
    in_order,
    independent_columns,
    krylov,
    value_at,
    value_at_random,
)

Column = tuple[int, int]  # input and power, of A^power B_input
Matrix = TypeVar("Matrix", Residues, ExactMatrix)

_LINES = (100, -100, 200, -200, 300, -300, 400, -400)  # values beta, in units of the range
_TRIES = 100  # directions of chance


def with_exchanges(a: ExactLFT) -> ExactLFT:
    """An LFT of equal value, smaller where repetitions of one delta can be exchanged for fewer."""
    found: ExactLFT | None = a
    while found is not None:
        a = found
        found = next((b for plan in plans(a) if (b := _exchanged(a, plan)) is not None), None)
    return a


class Plan(NamedTuple):
    """Repetitions of the first delta that go, and the lines of the second one that they go for."""

    first: str
    second: str
    is_transposed: bool
    columns: Sequence[Column]
    lines: "Sequence[_Line]"

    @property
    def gain(self) -> int:
        """Repetitions less."""
        return sum(line.length - 1 for line in self.lines)


def plans(a: ExactLFT) -> Iterator[Plan]:
    """Exchanges that residues allow, those of the delta furthest above its degree first."""
    degrees, M = exact_degrees(a), a.M
    nothing = np.zeros(M.shape, dtype=object)  # balls are not looked at
    a = ExactLFT(ExactMatrix(M.residues, nothing, M.prime), a.blocks)
    above = {name: size - degrees[name] for name, size in a.blocks if size > degrees[name] + 1}
    pairs = [(x, y) for x, y in permutations([b.name for b in a.blocks if b.size], 2) if x in above]
    for first, second in sorted(pairs, key=lambda pair: -above[pair[0]]):
        for side in (False, True):
            opened, size = _in_one(transposed(a) if side else a, first, second), dict(a.blocks)[first]
            value = value_at_random(opened, 0)
            space = reachable_bases(value[:size, :size], value[:size, size:], [size], M.prime)[0]
            reached, lost = len(space.pivots), size - len(space.pivots)
            if lost < 2 or not reached:
                continue
            nominal = opened.M.residues[opened.order :, opened.order :]
            columns = independent_columns(opened, size, nominal)
            if len(columns) == reached:
                lines = _lines(opened, size, columns, lost)
                if len(lines) < lost == sum(line.length for line in lines):
                    yield Plan(first, second, side, columns, lines)


def _exchanged(a: ExactLFT, plan: Plan) -> ExactLFT | None:
    """The LFT after an exchange; None where that does not make it smaller."""
    first, second, is_transposed, columns, lines = plan
    opened, size = _in_one(transposed(a) if is_transposed else a, first, second), dict(a.blocks)[first]
    try:
        chains = matrices.stacked([[_chain(opened, size, columns, line) for line in lines]])
        P = _null_space(chains.T).T
        inner = _in_coordinates(opened, krylov(opened, size, columns), P)
    except (ZeroDivisionError, np.linalg.LinAlgError):  # P K is singular at nominal, or A overflows
        return None
    if inner.order - opened.order > len(lines):  # poles elsewhere may be in the range
        return None
    others = tuple(block for block in a.blocks if block.name not in (first, second))
    closed = ExactLFT(inner.M, (*inner.blocks, Block(first, len(columns)), *others))
    result = reduce_exactly(in_order(closed, [block.name for block in a.blocks]))
    return transposed(result) if is_transposed else result


def _in_one(a: ExactLFT, first: str, second: str) -> ExactLFT:
    """The LFT in the second delta, with the channels of the first one, then of others, as signals."""
    spans = {block.name: span for block, span in zip(a.blocks, a.parts, strict=True)}
    channels = [*range(a.order)[spans[second]], *range(a.order)[spans[first]]]
    others = [k for k in range(a.order) if k not in set(channels)]
    rows, columns = ([*channels, *others, *range(a.order, count)] for count in a.M.shape)
    block = next(block for block in a.blocks if block.name == second)
    return ExactLFT(a.M[rows][:, columns], (block,))


class _Line(NamedTuple):
    """A value of the second delta, and how many directions a chain there makes superfluous."""

    beta: int
    length: int


def _lines(opened: ExactLFT, size: int, columns: Sequence[Column], count: int) -> list[_Line]:
    """Lines of the longest chains that make so many directions superfluous, by residues."""
    prime, other = opened.M.prime, value_at_random(opened, 1)
    reached = np.hstack(_columns(_by(other[:size, :size], prime), other[:size, size:], columns))
    outside = matrices.null_space(reached.T, prime).T  # rows that are zero on R
    lines, before = list[_Line](), np.zeros((size, 0), dtype=np.int64)
    for beta in _LINES:
        try:
            value = value_at(opened, np.array([beta % prime]))
        except ZeroDivisionError:  # the model has no value there
            continue
        times, C = _by(value[:size, :size], prime), value[size:, :size]
        K = np.hstack(_columns(times, value[:size, size:], columns))
        before = _with_longest(times, C, K, outside, before, count, prime)
        length = before.shape[1] - sum(line.length for line in lines)
        if length == 0:
            break
        lines.append(_Line(beta, length))
        if before.shape[1] == count or lines[0].length < 2:
            break
    return lines


def _with_longest(
    times: Callable[[Residues], Residues],
    C: Residues,
    K: Residues,
    outside: Residues,
    before: Residues,
    count: int,
    prime: int,
) -> Residues:
    """Columns, at most so many, with those of the longest chain that is outside of R beside them."""
    seen, moved, bases = list[Residues](), K, [np.eye(K.shape[1], dtype=np.int64)]
    while len(bases) < count - before.shape[1]:
        seen.append(matrices.multiplied(C, moved, prime))
        moved = times(moved)
        basis = matrices.null_space(np.vstack(seen), prime)
        if not basis.shape[1]:
            break
        bases.append(basis)
    for length, basis in reversed([*enumerate(bases, 1)]):
        numbers = np.random.default_rng(0).integers(1, prime, (basis.shape[1], 1))
        v = matrices.multiplied(K, matrices.multiplied(basis, numbers, prime), prime)
        V = np.hstack([before, *_powers(times, v, length)])
        if matrices.rank(matrices.multiplied(outside, V, prime), prime) == V.shape[1]:
            return V
    return before


def _powers(times: Callable[[Matrix], Matrix], first: Matrix, count: int) -> list[Matrix]:
    """The first, and what it becomes by a product that is repeated: so many."""
    powers = [first]
    while len(powers) < count:
        powers.append(times(powers[-1]))
    return powers


def _columns(times: Callable[[Matrix], Matrix], B: Matrix, columns: Sequence[Column]) -> list[Matrix]:
    """The columns A^power B_input, by a product with A."""
    powers = _powers(times, B, 1 + max(power for _, power in columns))
    return [powers[power][:, [column]] for column, power in columns]


def _by(A: Residues, prime: int) -> Callable[[Residues], Residues]:
    """The product with A."""
    return lambda x: matrices.multiplied(A, x, prime)


def _chain(opened: ExactLFT, size: int, columns: Sequence[Column], line: _Line) -> ExactMatrix:
    """The columns v, A v, ... of a line."""
    n, M = opened.order, opened.M
    scaled = _multiple(M[:n], line.beta)
    loop = matrices.identity(n, M.prime) + -scaled[:, :n]
    value = M[n:, n:] + M[n:, :n] @ loop.solve(scaled[:, n:])
    A, B, C = value[:size, :size], value[:size, size:], value[size:, :size]
    V = K = matrices.stacked([_columns(A.__matmul__, B, columns)])
    if line.length > 1:
        seen = [[C @ x] for x in _powers(A.__matmul__, K, line.length - 1)]
        V = K @ _null_space(matrices.stacked(seen))
    nominal = M[n:, n:]
    at_nominal = _columns(nominal[:size, :size].__matmul__, nominal[:size, size:], columns)
    rough = [matrices.rough_values(x) for x in (V, A, matrices.stacked([at_nominal]), nominal)]
    numbers = _far_outside(rough[0], rough[1], rough[2], rough[3], line.length)
    v = V @ _exactly(numbers, M.prime)
    return matrices.stacked([_powers(A.__matmul__, v, line.length)])


def _far_outside(V: Array, A: Array, K: Array, value: Array, length: int) -> Array:
    """Numbers (k, 1) of columns V for a chain that is far outside of what is reached at nominal, K.

    It is the best of some directions of chance, as doubles tell: any of them is right.
    """
    size = len(A)
    scale = channel_scales(value[:size, :size], value[:size, size:], value[size:, :size])
    V, A, K = scale[:, None] * V, scale[:, None] * A / scale, scale[:, None] * K
    lengths = or_one(np.linalg.norm(V, axis=0))
    Q, R = np.linalg.qr(V / lengths)
    outside = np.linalg.svd(K / or_one(np.linalg.norm(K, axis=0)))[0][:, K.shape[1] :]
    tries = np.random.default_rng(0).standard_normal((V.shape[1], _TRIES))
    tries[:, 0] = np.linalg.svd(outside.T @ Q)[2][0]
    chains = [Q @ tries]
    while len(chains) < length:
        chains.append(A @ (chains[-1] / or_one(np.linalg.norm(chains[-1], axis=0))))
    spans = np.linalg.qr(np.array(chains).transpose(2, 1, 0))[0]  # (tries, size, length)
    least = np.linalg.svd(outside.T @ spans, compute_uv=False)[:, -1]
    chosen = np.linalg.lstsq(R, tries[:, [np.argmax(least)]], rcond=None)[0]
    return np.asarray(chosen / lengths[:, None])


def _exactly(a: Array, prime: int) -> ExactMatrix:
    """Doubles as exact numbers."""
    fractions = np.array([Fraction(x) for x in a.ravel().tolist()], dtype=object).reshape(a.shape)
    return ExactMatrix(image_of(fractions, prime), matrices.balls_of(a), prime)


def _multiple(a: ExactMatrix, factor: int) -> ExactMatrix:
    residues = matrices.entrywise(a.residues, np.full(a.shape, factor % a.prime), a.prime)
    return ExactMatrix(residues, a.balls * factor, a.prime)


def _null_space(a: ExactMatrix) -> ExactMatrix:
    """Columns that span it."""
    pivots, free = _independent(a)
    rows, _ = _independent(a[:, pivots].T)
    basis = matrices.zeros(a.shape[1], len(free), a.prime)
    dependent = -a[rows][:, pivots].solve(a[rows][:, free])
    basis.residues[pivots], basis.balls[pivots] = dependent.residues, dependent.balls
    unit = matrices.identity(len(free), a.prime)
    basis.residues[free], basis.balls[free] = unit.residues, unit.balls
    return basis


def _independent(a: ExactMatrix) -> tuple[list[int], list[int]]:
    """Columns that are independent, as far from dependent as doubles tell, and the others."""
    rough = matrices.rough_values(a)
    rows, columns = equilibrate(rough[None])
    order = qr(rows[:, None] * rough * columns, mode="r", pivoting=True)[1]
    chosen = order[matrices.pivot_columns(a.residues[:, order], a.prime)].tolist()
    return sorted(chosen), sorted(set(order.tolist()) - set(chosen))


def _in_coordinates(opened: ExactLFT, K: ExactLFT, P: ExactMatrix) -> ExactLFT:
    """(w', u) -> (z', y), reduced: with x of w = K x as an unknown, P K x = w'."""
    (d, size), n, M, prime = P.shape, opened.order, opened.M, P.prime
    before, after_w = (matrices.zeros(d, count, prime) for count in (n, M.shape[1] - n - size))
    outputs = [[before, P, after_w], [P @ M[n : n + size]], [M[n + size :]]]  # P w, z', y
    moved = after(ExactLFT(matrices.stacked([[M[:n]], *outputs]), opened.blocks), K)
    k, others = moved.order, moved.M.shape[0] - moved.order - d
    given = [matrices.zeros(k, d, prime), -matrices.identity(d, prime), matrices.zeros(others, d, prime)]
    beside = matrices.stacked([[x] for x in given])  # w', after x
    whole = matrices.stacked([[moved.M[:, : k + d], beside, moved.M[:, k + d :]]])
    return reduce_exactly(eliminated(ExactLFT(whole, moved.blocks), d, [*range(d, d + others)]))
