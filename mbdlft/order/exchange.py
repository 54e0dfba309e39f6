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
exist at any beta are used, and those that are longer at single values of beta, which are zeros of what
leads to C v, ... All beta are outside of the range, which is from -1 to 1, or infinite.
"""

from collections.abc import Iterator, Sequence
from itertools import islice, permutations, product
from typing import Any, NamedTuple

import flint
import numpy as np

from mbdlft.base.array import Array
from mbdlft.exact import matrices
from mbdlft.exact.matrices import ExactMatrix, Residues
from mbdlft.exact.numbers import BITS, TooFewBitsError, ask_for_bits
from mbdlft.exact.pencils import invariant_zeros, null_space, pencil, real_eigenvalues, residues_of_pencil
from mbdlft.exact.reachable import reachable_bases
from mbdlft.exact.rounding import channel_scales, or_one
from mbdlft.lft.lft import Block
from mbdlft.order.lower_bound import exact_degrees
from mbdlft.order.reduction import ExactLFT, eliminated, reduce_exactly, transposed
from mbdlft.order.restriction import (
    after,
    in_order,
    independent_columns,
    krylov,
    selected,
    value_at_random,
)

_LINES = (100, -100, 200, -200, 300, -300, 400, -400)  # values beta, in units of the range
_TRIES = 100  # directions of chance
_MOST_PAIRS = 8  # of residues and values of zeros, that are tried


def with_exchanges(a: ExactLFT) -> ExactLFT:
    """An LFT of equal value, smaller where repetitions of one delta can be exchanged for fewer."""
    found: ExactLFT | None = a
    while found is not None:
        a = found
        found = next((b for plan in plans(a) if (b := _exchanged(a, plan)) is not None), None)
    return a


class Plan(NamedTuple):
    """Repetitions of the first delta that go, and choices of lines of the second one that they go for.

    `opened` is the LFT in the second delta, with the channels of the first one as signals, transposed if
    that is so, and K spans R in it.
    """

    first: str
    second: str
    is_transposed: bool
    opened: ExactLFT
    K: ExactLFT
    choices: "Sequence[Sequence[_Line]]"


def plans(a: ExactLFT) -> Iterator[Plan]:
    """Exchanges that residues allow, those of the delta furthest above its degree first."""
    degrees, M = exact_degrees(a), a.M
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
            if len(columns) < reached:
                continue
            try:
                K = krylov(opened, size, columns)
                choices = [x for x in _lines(opened, K, lost) if sum(line.length for line in x) == lost]
            except TooFewBitsError:
                _ask_once()
                continue
            if choices := [lines for lines in choices if len(lines) < lost]:
                yield Plan(first, second, side, opened, K, choices)


def _ask_once() -> None:
    """A TooFewBitsError again with the bits at first: all is made with twice as many then, not more."""
    ask_for_bits(2 * BITS)


def _exchanged(a: ExactLFT, plan: Plan) -> ExactLFT | None:
    """The LFT after an exchange; None where that does not make it smaller."""
    others = [block for block in a.blocks if block.name not in (plan.first, plan.second)]
    block = Block(plan.first, plan.K.M.shape[1] - plan.K.order)
    for lines in plan.choices:
        for values in islice(product(*(line.values for line in lines)), _MOST_PAIRS):
            try:
                inner = _along_lines(plan.opened, plan.K, lines, values)
                if inner is not None:
                    closed = ExactLFT(inner.M, (*inner.blocks, block, *others))
                    result = reduce_exactly(in_order(closed, [block.name for block in a.blocks]))
                    return transposed(result) if plan.is_transposed else result
            except TooFewBitsError:  # or a zero is not the one of the residue
                if all(len(line.values) == 1 for line in lines):
                    _ask_once()
    return None


def _along_lines(
    opened: ExactLFT, K: ExactLFT, lines: Sequence["_Line"], values: Sequence[Any]
) -> ExactLFT | None:
    """(w', u) -> (z', y) with P that is zero on chains at 1/beta; None with more poles than lines."""
    nominal, V = (matrices.rough_values(x.M[x.order :, x.order :]) for x in (opened, K))
    try:
        chains = list[ExactMatrix]()
        for line, value in zip(lines, values, strict=True):
            chains.append(_chain(line, value, V, nominal))
            V = np.hstack([V, matrices.rough_values(chains[-1])])
        inner = _in_coordinates(opened, K, null_space(matrices.stacked([chains]).T)[0].T)
    except (ZeroDivisionError, np.linalg.LinAlgError):  # P K is singular at nominal, or A overflows
        return None
    return inner if inner.order - opened.order <= len(lines) else None  # others may be in the range


def _in_one(a: ExactLFT, first: str, second: str) -> ExactLFT:
    """The LFT in the second delta, with the channels of the first one, then of others, as signals."""
    spans = {block.name: span for block, span in zip(a.blocks, a.parts, strict=True)}
    channels = [*range(a.order)[spans[second]], *range(a.order)[spans[first]]]
    others = [k for k in range(a.order) if k not in set(channels)]
    rows, columns = ([*channels, *others, *range(a.order, count)] for count in a.M.shape)
    block = next(block for block in a.blocks if block.name == second)
    return ExactLFT(a.M[rows][:, columns], (block,))


class _Line(NamedTuple):
    """A chain of so many columns at 1/beta, a residue that is one of some values.

    `chains` is an LFT (v, ...) -> (..., A v, v; C v, ...) with v in R.
    """

    chains: ExactLFT
    length: int
    residue: int
    values: Sequence[Any]


def _lines(opened: ExactLFT, K: ExactLFT, count: int) -> Iterator[list[_Line]]:
    """Lines of long chains that make so many directions superfluous, by residues."""
    prime, size = opened.M.prime, K.M.shape[0] - K.order
    outside = matrices.null_space(value_at_random(K, 1).T, prime).T  # rows that are zero on R
    nothing = np.zeros((size, 0), dtype=np.int64)
    anywhere = int(np.random.default_rng(2).integers(1, prime))
    chains, longer = [K], K
    while len(chains) < count:
        longer = _longer(longer, opened, size)
        if _with_chain(nothing, _Line(longer, len(chains) + 1, anywhere, ()), outside) is None:
            yield _chosen(_special(longer, len(chains) + 1, size), chains, outside, count)
            break
        chains.append(longer)
    if len(chains) > 1:
        yield _chosen([], chains, outside, count)


def _chosen(
    special: Sequence[_Line], chains: Sequence[ExactLFT], outside: Residues, count: int
) -> list[_Line]:
    """Lines whose directions are independent outside of R: special ones, then the longest at any beta."""
    prime = chains[0].M.prime
    choices = [[line] for line in special for _ in range(count // line.length)]
    for beta in _LINES:
        residue, value = pow(beta, -1, prime), flint.arb(1) / beta
        if not _has_value(chains[-1], residue):
            continue
        lengths = reversed([*enumerate(chains, 1)])
        choices.append([_Line(chain, length, residue, [value]) for length, chain in lengths])
    lines, before = list[_Line](), np.zeros((outside.shape[1], 0), dtype=np.int64)
    for choice in choices:
        for line in choice:
            grown = _with_chain(before, line, outside)
            if grown is not None and grown.shape[1] <= count:
                lines, before = [*lines, line], grown
                break
    return lines


def _has_value(a: ExactLFT, s: int) -> bool:
    """Whether an LFT has no pole at 1/s."""
    n = a.order
    return matrices.is_regular(residues_of_pencil(a.M.residues[:n, :n], n, s, a.M.prime), a.M.prime)


def _special(chains: ExactLFT, length: int, size: int) -> list[_Line]:
    """Values 1/beta at which there are more chains than at others, with beta outside of the range."""
    system = _of_kernel(chains, length, size)
    try:
        residues, values = real_eigenvalues(invariant_zeros(system, chains.order))
    except TooFewBitsError:
        return []
    outside = [x for x in values if abs(x) < 1]
    lines = list[_Line]()
    for residue in residues:  # one of a value inside of the range, or of a complex one, has none
        some = [x for x in outside if _is_zero_at(system, chains.order, residue, x)]
        if some:
            lines.append(_Line(chains, length, residue, some))
    return lines


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
    prime, n = opened.M.prime, opened.order
    count = chains.M.shape[0] - chains.order
    step = selected(opened, range(opened.M.shape[0] - n), range(size)).M
    step = matrices.stacked([[step, matrices.zeros(step.shape[0], count - size, prime)]])
    same = matrices.stacked([[matrices.zeros(count, n, prime), matrices.identity(count, prime)]])
    M = matrices.stacked([[step[: n + size]], [same], [step[n + size :]]])
    return reduce_exactly(after(ExactLFT(M, opened.blocks), chains))


def _with_chain(before: Residues, line: _Line, outside: Residues) -> Residues | None:
    """Columns with those of a chain in a direction of chance; None where they depend beside R."""
    size, (n, M) = outside.shape[1], (line.chains.order, line.chains.M)
    system = _of_kernel(line.chains, line.length, size).residues
    kernel = matrices.null_space(residues_of_pencil(system, n, line.residue, M.prime), M.prime)
    numbers = np.random.default_rng(before.shape[1]).integers(1, M.prime, (kernel.shape[1], 1))
    numbers = matrices.multiplied(kernel, numbers, M.prime)
    chain = matrices.multiplied(M.residues[n : n + line.length * size], numbers, M.prime)
    V = np.hstack([before, chain.reshape(line.length, size).T])
    some = matrices.multiplied(outside, V, M.prime)
    return V if matrices.rank(some, M.prime) == V.shape[1] else None


def _chain(line: _Line, value: Any, before: Array, nominal: Array) -> ExactMatrix:
    """The columns of a line, far outside of columns before."""
    n, M, size = line.chains.order, line.chains.M, len(before)
    at = pencil(_of_kernel(line.chains, line.length, size), n, line.residue, value)
    kernel, _ = null_space(at)
    V = M[n : n + line.length * size] @ kernel
    rough = matrices.rough_values(V).reshape(line.length, size, -1)
    v = V @ matrices.of_integers(_far_outside(rough, before, nominal), M.prime)
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
