"""Repetitions of one delta exchanged for fewer of another, in exact numbers.

With all deltas but b as signals, and w = a z,

    z = A(b) w + B(b) u,    y = C(b) w + D(b) u,

is rational in b. If z stays in a space R(b) that has fewer dimensions than z, the columns K(b) span it,
and rows of numbers P have P K regular, then z' = P z are enough:

    z' = P A S w' + P B u,    y = C S w' + D u,    w' = a z',    S = K (P K)^-1.

S has poles where P K is singular, and each costs a repetition of b. They are at least as many, d, as
those of K (K_rows)^-1 for independent rows x = K_rows of z. The channels of this one join x: in such a z
R leaves d dimensions out, and whichever rows P are there, S has d poles. One repetition is enough for k
of them at one value beta, if P is zero on

    v, A v, ..., A^(k-1) v    at beta,    with v in R(beta) and C v = C A v = ... = C A^(k-2) v = 0.

In the words of docs/pairs.md: these v are quotients O(-k) of the bundle on the line b = beta. Chains that
exist at any beta are used, and those that are longer at single values of beta, which are zeros of what
leads to C v, ... All beta are outside of the range, which is from -1 to 1, or infinite.

Directions that no output sees at a value of b cost nothing (`mbdlft.order.unobservable`). Where b is
repeated too often, an exchange the other way round comes first: it costs more, and the one back gains
more (`mbdlft.order.paths`).
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import lru_cache
from itertools import islice, product
from math import inf
from typing import Any, Literal, NamedTuple

import flint
import numpy as np

from mbdlft.base.array import Array
from mbdlft.exact import matrices, modular
from mbdlft.exact.matrices import ExactMatrix
from mbdlft.exact.modular import Residues, reachable_bases
from mbdlft.exact.numbers import NOTHING, TooFewBitsError
from mbdlft.exact.pencils import eigenvalues, invariant_zeros, null_space, pencil, residues_of_pencil
from mbdlft.exact.rounding import channel_scales, or_one
from mbdlft.lft.lft import Block
from mbdlft.order.lower_bound import exact_degrees
from mbdlft.order.reduction import ExactLFT, eliminated, reduce_exactly, transposed
from mbdlft.order.restriction import (
    after,
    in_order,
    in_rows,
    independent_columns,
    independent_rows,
    krylov,
    selected,
    value_at_random,
)
from mbdlft.order.unobservable import (
    MOST_VALUES,
    Unobservable,
    motions_anywhere,
    motions_at_infinity,
    unobservable,
)

_LINES = (10, -10, 20, -20, 30, -30, 40, -40)  # values beta, in units of the range
_SHIFT, _PARTS = 3, 7  # of the range: a place without special values
_TRIES = 100  # directions of chance

# chains at any beta, those that are longer at infinity, and those at zeros, which may not be real
Kind = Literal["any", "infinite", "zeros"]
_KINDS: tuple[Kind, ...] = ("infinite", "any", "zeros")


class Exchange(NamedTuple):
    """Repetitions of the first delta for fewer of the second, one for each chain of some lengths.

    Modulo other primes there may be more that cost nothing, for an order of `at_best`.
    """

    first: str
    second: str
    is_transposed: bool
    kind: Kind
    lengths: tuple[int, ...]
    at_best: float = inf


def by_exchange(a: ExactLFT, wanted: Exchange) -> tuple[ExactLFT | None, tuple[int, ...]]:
    """An LFT after an exchange, in balls, if there is one, and the lengths of its chains.

    The value of a zero may not be real, or in the range: then they are others.
    """
    opened = _opened(a, wanted.first, wanted.second, is_transposed=wanted.is_transposed)
    if opened is None:
        return None, ()
    longest = max(wanted.lengths, default=opened.K.order) + (wanted.kind != "any")
    left_out = _left_out(opened, min(longest, opened.K.order), wanted.kind)
    return _along(a, opened, left_out), left_out.lengths


def exchanges(a: ExactLFT) -> Iterator[tuple[Exchange, ExactLFT | None]]:
    """Exchanges of two deltas, and what they lead to; None where there are none."""
    degrees, sizes = exact_degrees(a), {block.name: block.size for block in a.blocks if block.size}
    above = [name for name, size in sizes.items() if size > degrees[name]]
    for first, second, side in product(above, sizes, (False, True)):
        opened = _opened(a, first, second, is_transposed=side) if first != second else None
        for kind in _KINDS:
            left_out = _left_out(opened, opened.K.order, kind) if opened else _NOTHING
            result = _along(a, opened, left_out) if opened else None
            at_best = inf
            if opened and left_out.by_prime:
                at_best = a.order - sizes[first] + opened.dimensions
            yield Exchange(first, second, side, kind, left_out.lengths, at_best), result


class _Opened(NamedTuple):
    """An LFT in the second delta, transposed or not, (w, u) -> (z, y) with the channels of the first one.

    z has as many channels beside R, which is K(b) x, as K has poles. Where R has fewer dimensions at
    nominal than elsewhere, the second delta is counted from another place.
    """

    first: str
    second: str
    is_transposed: bool
    lft: ExactLFT
    K: ExactLFT
    is_shifted: bool

    @property
    def size(self) -> int:
        return self.K.M.shape[0] - self.K.order

    @property
    def dimensions(self) -> int:
        """Those of R."""
        return self.K.M.shape[1] - self.K.order


def _opened(a: ExactLFT, first: str, second: str, *, is_transposed: bool) -> _Opened | None:
    """None if R is all of z."""
    size, prime = dict(a.blocks)[first], a.M.prime
    lft = _in_one(transposed(a) if is_transposed else a, first, second)
    value = value_at_random(lft, 0, size)
    space = reachable_bases(value[:size, :size], value[:size, size:], [size], prime)[0]
    count = len(space.pivots)
    if count in (0, size):
        return None
    columns = independent_columns(lft, size, lft.M.residues[lft.order :, lft.order :])
    if is_shifted := len(columns) < count:
        try:
            lft = _shifted(lft, _SHIFT)
        except ZeroDivisionError:
            return None
        columns = independent_columns(lft, size, lft.M.residues[lft.order :, lft.order :])
        if len(columns) < count:
            return None
    K = krylov(lft, size, columns)
    assert K is not None
    rows, outputs = independent_rows(K), [*range(size, lft.M.shape[0] - lft.order)]
    K = in_rows(K, rows)
    n, y = K.order, len(outputs)
    inner = after(selected(lft, [*rows, *outputs], range(lft.M.shape[1] - lft.order)), K)
    ahead = [[K.M[:n], matrices.zeros(n, y, prime)], [matrices.identity(n + count + y, prime)]]
    moved = after(ExactLFT(matrices.stacked(ahead), K.blocks), reduce_exactly(inner))
    k, M = moved.order, moved.M
    M = matrices.stacked([[M[:, :k], matrices.zeros(M.shape[0], n, prime), M[:, k:]]])
    K = ExactLFT(matrices.stacked([[K.M[:n]], [matrices.identity(n + count, prime)]]), K.blocks)
    opened = reduce_exactly(ExactLFT(M, moved.blocks))
    return _Opened(first, second, is_transposed, opened, K, is_shifted)


def _shifted(a: ExactLFT, by: int) -> ExactLFT:
    """The LFT in one delta counted from by/_PARTS; a ZeroDivisionError if it is singular there."""
    n, M, prime = a.order, a.M, a.M.prime
    parts, times = (matrices.of_integers(k * np.eye(n), prime) for k in (_PARTS, by))
    z = (parts + -(times @ M[:n, :n])).solve(M[:n])
    more = M[n:, :n] @ (times @ z)
    return ExactLFT(matrices.stacked([[parts @ z], [M[n:] + more]]), a.blocks)


def _in_one(a: ExactLFT, first: str, second: str) -> ExactLFT:
    """The LFT in the second delta, with the channels of the first one, then of others, as signals."""
    spans = {block.name: span for block, span in zip(a.blocks, a.parts, strict=True)}
    channels = [*range(a.order)[spans[second]], *range(a.order)[spans[first]]]
    others = [k for k in range(a.order) if k not in set(channels)]
    rows, columns = ([*channels, *others, *range(a.order, count)] for count in a.M.shape)
    block = next(block for block in a.blocks if block.name == second)
    return ExactLFT(a.M[rows][:, columns], (block,))


def _along(a: ExactLFT, opened: _Opened, left_out: "_LeftOut") -> ExactLFT | None:
    """The LFT after an exchange; None if poles are left, or none of the values of zeros is right."""
    if left_out.size < opened.K.order:
        return None
    free, lines = left_out.free, left_out.lines
    others = [block for block in a.blocks if block.name not in (opened.first, opened.second)]
    block = Block(opened.first, opened.dimensions)
    places = {line.residue: line.values for line in lines}
    of_free = free.values() if free else [()]
    pairs = ((values, some) for values in of_free for some in product(*places.values()))
    error: TooFewBitsError | None = None
    for values, some in islice(pairs, MOST_VALUES):
        try:
            first = [free.columns(values, _outside(opened))] if free else []
            inner = _along_values(opened, first, lines, dict(zip(places, some, strict=True)))
        except TooFewBitsError as too_few:  # or a zero is not the one of the residue
            error = too_few
            continue
        if inner is not None:
            closed = ExactLFT(inner.M, (*inner.blocks, block, *others))
            result = reduce_exactly(in_order(closed, [block.name for block in a.blocks]))
            return transposed(result) if opened.is_transposed else result
    if error:
        raise error
    return None


def _along_values(
    opened: _Opened, chains: list[ExactMatrix], lines: Sequence["_Line"], values: Mapping[int, Any]
) -> ExactLFT | None:
    """(w', u) -> (z', y) with P that is zero on chains at 1/beta; None if that has no value."""
    nominal, V = (matrices.rough_values(x.M[x.order :, x.order :]) for x in (opened.lft, opened.K))
    V = np.hstack([V, *map(matrices.rough_values, chains)])
    try:
        for line in lines:
            chains.append(_chain(line, values[line.residue], V, nominal))
            V = np.hstack([V, matrices.rough_values(chains[-1])])
        inner = _in_coordinates(opened.lft, opened.K, null_space(matrices.stacked([chains]).T)[0].T)
        return _shifted(inner, -_SHIFT) if opened.is_shifted else inner
    except (ZeroDivisionError, np.linalg.LinAlgError):  # P K is singular at nominal, or A overflows
        return None


class _Line(NamedTuple):
    """A chain of so many columns at 1/beta, a residue that is one of some values.

    `chains` is an LFT (v, ...) -> (..., A v, v; C v, ...) with v in R.
    """

    chains: ExactLFT
    length: int
    residue: int
    values: Sequence[Any]


class _LeftOut(NamedTuple):
    """What P is zero on, if anything; modulo another prime there may be more."""

    free: Unobservable | None
    lines: Sequence[_Line]
    by_prime: bool = False

    @property
    def lengths(self) -> tuple[int, ...]:
        """How many columns cost nothing, as a number below zero, if any, and those of the lines."""
        return (*([-self.free.size] if self.free else []), *(line.length for line in self.lines))

    @property
    def size(self) -> int:
        return sum(map(abs, self.lengths))


_NOTHING = _LeftOut(None, ())
_Place = tuple[int, Sequence[Any]]  # a residue of 1/beta, and values that may be its own


def _free(opened: _Opened, kind: Kind) -> Unobservable | None:
    """Directions that cost nothing, at infinity or anywhere."""
    if kind == "any":
        return None
    of_kind = motions_anywhere if kind == "zeros" else motions_at_infinity
    first = _longest_anywhere(opened, opened.K.order) + 1
    chains = ((_chains(opened, length), length) for length in range(first, opened.size + 3))
    return unobservable(of_kind(chains, opened.size), _outside(opened), opened.K.order)


def _left_out(opened: _Opened, longest: int, kind: Kind) -> _LeftOut:
    """Directions that cost nothing, then lines of long chains; nothing if there are none of the kind."""
    free = _free(opened, kind)
    by_prime = bool(free and free.by_prime)
    free = free if free and free.size else None
    if free and free.size == opened.K.order:
        return _LeftOut(free, ())
    before = free.residues if free else _outside(opened)[:0].T
    length, places = _longest_anywhere(opened, longest), list[_Place]()
    if kind != "any":
        if length < longest:
            places = [(0, [NOTHING])] if _is_there(opened, length + 1, 0) else []
            if kind == "zeros":
                zeros = _zeros(_chains(opened, length + 1), length + 1, opened.size)
                places = [*places, *zeros] if zeros else []
        if not places and not free:
            return _NOTHING._replace(by_prime=by_prime)
        while length < longest and any(_is_there(opened, length + 1, residue) for residue, _ in places):
            length += 1
    places = [place for place in places for _ in range(opened.K.order)]
    everywhere = _and_lines(places, _chains(opened, length))
    return _LeftOut(free, _chosen(opened, everywhere, length, before), by_prime)


def _and_lines(places: Sequence[_Place], chains: ExactLFT) -> Iterator[_Place]:
    """Places, then others outside of the range at which chains have no pole."""
    yield from places
    for beta in _LINES:
        residue = pow(beta, -1, chains.M.prime)
        if _has_value(chains, residue):
            yield residue, [flint.arb(1) / beta]


@lru_cache(maxsize=1)  # chains of all kinds are asked for one after the other
def _longest_anywhere(opened: _Opened, longest: int) -> int:
    """The most columns of chains that there are at any beta, up to so many."""
    anywhere, length = int(np.random.default_rng(2).integers(1, opened.K.M.prime)), 1
    while length < longest and _is_there(opened, length + 1, anywhere):
        length += 1
    return length


@lru_cache(maxsize=64)
def _chains(opened: _Opened, length: int) -> ExactLFT:
    """Those of so many columns, in R."""
    return opened.K if length == 1 else _longer(_chains(opened, length - 1), opened.lft, opened.size)


def _is_there(opened: _Opened, length: int, residue: int) -> bool:
    """Whether there is a chain at 1/beta."""
    line = _Line(_chains(opened, length), length, residue, ())
    return _with_chain(np.zeros((opened.size, 0), dtype=np.int64), line, _outside(opened)) is not None


@lru_cache(maxsize=1)
def _outside(opened: _Opened) -> Residues:
    """Rows that are zero on R."""
    prime = opened.K.M.prime
    return modular.null_space(value_at_random(opened.K, 1).T, prime).T


def _chosen(opened: _Opened, places: Iterable[_Place], longest: int, before: Residues) -> list[_Line]:
    """Lines of the longest chains whose directions are independent beside R and others."""
    lines = list[_Line]()
    for residue, values in places:
        for length in range(min(longest, opened.K.order - before.shape[1]), 0, -1):
            line = _Line(_chains(opened, length), length, residue, values)
            grown = _with_chain(before, line, _outside(opened))
            if grown is not None:
                lines, before = [*lines, line], grown
                break
        if before.shape[1] == opened.K.order:
            break
    return lines


def _has_value(a: ExactLFT, s: int) -> bool:
    """Whether an LFT has no pole at 1/s."""
    n = a.order
    return matrices.is_regular(residues_of_pencil(a.M.residues[:n, :n], n, s, a.M.prime), a.M.prime)


def _zeros(chains: ExactLFT, length: int, size: int) -> list[tuple[int, list[Any]]]:
    """Residues of finite 1/beta, and values, at which there are more chains than at others.

    These beta are outside of the range.
    """
    system = _of_kernel(chains, length, size)
    try:
        residues, values, _ = eigenvalues(invariant_zeros(system, chains.order))
    except TooFewBitsError:
        return []
    if not matrices.carries_values():
        return [(residue, [NOTHING]) for residue in filter(None, residues)]
    outside = [x for x in values if x != 0 and abs(x) < 1]
    places = list[tuple[int, list[Any]]]()
    for residue in filter(None, residues):  # one inside of the range, or complex, has no value
        some = [x for x in outside if _is_zero_at(system, chains.order, residue, x)]
        if some:
            places.append((residue, some))
    return places


def _is_zero_at(system: ExactMatrix, n: int, residue: int, value: Any) -> bool:
    """Whether what is zero as a residue may be so as a ball: where the pencil has less rank."""
    try:
        at = pencil(system, n, residue, value)
        at @ null_space(at)[0]
    except TooFewBitsError:
        return False
    return True


def _of_kernel(chains: ExactLFT, length: int, size: int) -> ExactMatrix:
    """The system whose pencil is zero on chains: its outputs are C v, C A v, ..."""
    n = chains.order
    return chains.M[[*range(n), *range(n + length * size, chains.M.shape[0])]]


def _longer(chains: ExactLFT, opened: ExactLFT, size: int) -> ExactLFT:
    """Chains (..., A v, v; C v, ...) with one column more."""
    f, g, outputs = opened.order, chains.order, range(opened.M.shape[0] - opened.order)
    inputs = range(chains.M.shape[1] - g)
    M = after(selected(opened, outputs, range(size)), selected(chains, range(size), inputs)).M
    same = matrices.stacked([[matrices.zeros(chains.M.shape[0] - g, f, M.prime), chains.M[g:]]])
    end = f + g + size
    block = Block(opened.blocks[0].name, f + g)
    return reduce_exactly(ExactLFT(matrices.stacked([[M[:end]], [same], [M[end:]]]), (block,)))


def _with_chain(before: Residues, line: _Line, outside: Residues) -> Residues | None:
    """Columns with those of a chain in a direction of chance; None where they depend beside R."""
    size, (n, M) = outside.shape[1], (line.chains.order, line.chains.M)
    system = _of_kernel(line.chains, line.length, size).residues
    kernel = modular.null_space(residues_of_pencil(system, n, line.residue, M.prime), M.prime)
    numbers = np.random.default_rng(before.shape[1]).integers(1, M.prime, (kernel.shape[1], 1))
    numbers = modular.multiplied(kernel, numbers, M.prime)
    chain = modular.multiplied(M.residues[n : n + line.length * size], numbers, M.prime)
    V = np.hstack([before, chain.reshape(line.length, size).T])
    some = modular.multiplied(outside, V, M.prime)
    return V if modular.rank(some, M.prime) == V.shape[1] else None


def _chain(line: _Line, value: Any, before: Array, nominal: Array) -> ExactMatrix:
    """The columns of a line, far outside of columns before."""
    n, M, size = line.chains.order, line.chains.M, len(before)
    at = pencil(_of_kernel(line.chains, line.length, size), n, line.residue, value)
    kernel, _ = null_space(at)
    V = M[n : n + line.length * size] @ kernel
    if matrices.carries_values():
        rough = matrices.rough_values(V).reshape(line.length, size, -1)
        numbers = _far_outside(rough, before, nominal)
    else:
        numbers = np.random.default_rng(before.shape[1]).integers(1, 2**52, (V.shape[1], 1)).astype(float)
    v = V @ matrices.of_integers(numbers, M.prime)
    return matrices.stacked([[v[k : k + size] for k in range(0, line.length * size, size)]])


def _far_outside(chains: Array, K: Array, value: Array) -> Array:
    """Numbers (k, 1) for one of chains (length, size, k) that is far outside of columns (size, m).

    It is the best of some directions of chance, as doubles tell: any of them is right.
    """
    size = len(K)
    scale = channel_scales(value[:size, :size], value[:size, size:], value[size:, :size])
    K, chains = scale[:, None] * K, scale[:, None] * chains
    lengths = or_one(np.linalg.norm(chains[-1], axis=0))
    Q, R = np.linalg.qr(chains[-1] / lengths)
    outside = np.linalg.svd(K / or_one(np.linalg.norm(K, axis=0)))[0][:, K.shape[1] :]
    tries = np.random.default_rng(0).standard_normal((Q.shape[1], _TRIES))
    tries[:, 0] = np.linalg.svd(outside.T @ Q)[2][0]
    tries = np.linalg.lstsq(R, tries, rcond=None)[0] / lengths[:, None]
    tries = tries[:, tries.any(axis=0)]  # Q has more directions than chains that depend
    if not tries.size:
        raise TooFewBitsError("balls are too wide for the directions of chains.")
    vectors = (chains @ tries).transpose(2, 1, 0)
    spans = np.linalg.qr(vectors / or_one(np.linalg.norm(vectors, axis=1, keepdims=True)))[0]
    least = np.linalg.svd(outside.T @ spans, compute_uv=False)[:, -1]
    chosen = tries[:, [np.argmax(least)]]
    return np.asarray(np.round(chosen / np.abs(chosen).max() * 2.0**52))


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
