"""Directions that an exchange leaves out at no cost: those that no output sees at a value of b.

In the words of `mbdlft.order.exchange`, let v in R(beta) have A v = alpha v and C v = 0. If P v = 0, then
S has a pole at beta, but P A S and C S have none there, as P A v = alpha P v. No repetition of b is
needed for it, and beta may be in the range, too.

All such v, and what takes their place at poles of higher order, are the motions in R that no output of
any chain sees. Multiplication by s = 1/b and by A act on the space of them as two matrices that commute.
P may be zero on any part of it that both keep. In the words of docs/pairs.md, the eigenvalues are points
(a, b) at which F is not its double dual, and a part that is long enough leads to the degrees.

Any points that are single will do, complex ones in pairs: as many as there is room for are the kernel of
one polynomial of s and A together. Modulo the prime it is a product of factors, in balls one of real
roots and pairs of that degree: which are the same does not matter. Where no factors fill the room,
those modulo another prime may (`mbdlft.pipeline.smaller`).
"""

from collections.abc import Iterable, Iterator, Sequence
from itertools import combinations, compress, islice
from math import prod
from typing import Any, NamedTuple

import flint
import numpy as np

from mbdlft.exact import matrices, modular
from mbdlft.exact.matrices import ExactMatrix
from mbdlft.exact.modular import Residues
from mbdlft.exact.numbers import NOTHING, RESIDUES_ALONE, TooFewBitsError, precision, zero_of
from mbdlft.exact.pencils import (
    factors,
    independent,
    minimal_polynomial,
    motions_without_outputs,
    null_space,
    pencil,
    roots,
    with_single_roots,
)
from mbdlft.order.reduction import ExactLFT

_OF_S, _OF_A = 3.0, 7.0  # the sum of these times both matrices tells points apart
_WEIGHTS = 2**20
MOST_VALUES = 8  # of points and lines, that are tried
_MOST_TOGETHER = 80  # motions: a kernel of more in balls takes seconds, and may be tried in vain


class Motions(NamedTuple):
    """Motions that no output sees: multiplication by s and by A, and their vectors z (size, count)."""

    s: ExactMatrix
    A: ExactMatrix
    z: ExactMatrix

    @property
    def both(self) -> ExactMatrix:
        """The sum of both matrices whose eigenvalues stand for points."""
        one = np.eye(self.z.shape[1])
        of_s, of_A = (matrices.of_integers(k * one, self.z.prime) for k in (_OF_S, _OF_A))
        return of_s @ self.s + of_A @ self.A

    def residues(self) -> "Motions":
        """The same as residues alone."""
        return Motions(*(matrices.of_residues(a.residues, a.prime) for a in self))


class Point(NamedTuple):
    """One or more that are taken together, as the roots of a polynomial.

    Its coefficients, but for the highest, which is one: residues, and balls that may be theirs.
    """

    residues: tuple[int, ...]
    values: Sequence[Sequence[Any]]


class Unobservable(NamedTuple):
    """So many columns that cost nothing, of points; without points they are all motions.

    Modulo other primes there may be more.
    """

    motions: Motions
    points: Sequence[Point]
    residues: Residues
    by_prime: bool = False

    @property
    def size(self) -> int:
        """How many columns."""
        return len(self.residues.T)

    def values(self) -> Iterator[tuple[Sequence[Any], ...]]:
        """Those of all points, each another one."""
        return _different([some for _, some in self.points])

    def columns(self, values: Sequence[Sequence[Any]], outside: Residues) -> ExactMatrix:
        """Those for values of the points (size, count); a TooFewBitsError for one of another residue."""
        if not self.points:
            return self.motions.z
        if not matrices.carries_values():
            return matrices.of_residues(self.residues, self.motions.z.prime)
        points = [(residues, value) for (residues, _), value in zip(self.points, values, strict=True)]
        return _kept_at(self.motions, points, outside, self.size)[0]


def _different(
    choices: Sequence[Sequence[Any]], before: tuple[Any, ...] = ()
) -> Iterator[tuple[Any, ...]]:
    """One of each of the choices, each another one."""
    if len(before) == len(choices):
        yield before
        return
    for value in choices[len(before)]:
        if not any(value is other for other in before):
            yield from _different(choices, (*before, value))


def unobservable(motions: Motions | None, outside: Residues, most: int) -> Unobservable | None:
    """As many of the columns as are independent beside R, at most; None without motions."""
    if motions is None:
        return None
    count, prime = motions.z.shape[1], motions.z.prime
    room = modular.rank(modular.multiplied(outside, motions.z.residues, prime), prime)
    if count <= most and room == count:
        return Unobservable(motions, (), motions.z.residues)
    known = _roots(motions)
    if count > _MOST_TOGETHER:
        known = known._replace(factors=())
    points = list(filter(None, [_together(known, prime, most)]))
    columns, counts = _kept_alone(motions, points, outside, most)
    if columns.shape[1] < most:
        points += _apart(motions, known, without_single=columns.shape[1] > 0)
        columns, counts = _kept_alone(motions, points, outside, most)
    used = [point for point, count in zip(points, counts, strict=True) if count]
    by_prime = columns.shape[1] < min(most, room, sum(map(len, known.factors)))
    return Unobservable(motions, used, columns.residues, by_prime)


def _kept_alone(
    motions: Motions, points: Sequence[Point], outside: Residues, most: int
) -> tuple[ExactMatrix, list[int]]:
    with precision(RESIDUES_ALONE):
        alone = [(residues, [NOTHING] * len(residues)) for residues, _ in points]
        return _kept_at(motions.residues(), alone, outside, most)


class _Roots(NamedTuple):
    """Roots of the polynomial of all points: residues, real ones, and those above the real axis.

    Single factors of residues, and which of the real and the complex roots are single.
    """

    residues: list[int]
    real: list[Any]
    above: list[Any]
    factors: Sequence[tuple[int, ...]]
    is_single: tuple[Sequence[bool], Sequence[bool]]


def _roots(motions: Motions) -> _Roots:
    both, prime = motions.both, motions.z.prime
    every = factors(both.residues, prime)
    residues = sorted(-factor[0] % prime for factor, _ in every if len(factor) == 1)
    single = [factor for factor, times in every if times == 1]
    if not matrices.carries_values():
        return _Roots(residues, [], [], single, ([], []))
    polynomial = minimal_polynomial(both)
    _, real, above = roots(with_single_roots(polynomial))
    slope = flint.acb_poly(polynomial.balls[:, 0].tolist()).derivative()
    is_single = [[not slope(flint.acb(x)).contains(0) for x in some] for some in (real, above)]
    return _Roots(residues, real, above, single, (is_single[0], is_single[1]))


def _of_one(x: Any) -> list[Any]:
    """The polynomial of a real root, but for its highest coefficient."""
    return [x] if x is NOTHING else [-x]


def _of_two(x: Any) -> list[Any]:
    """The same of a complex root and its conjugate."""
    return [x.real**2 + x.imag**2, -2 * x.real]


def _together(known: _Roots, prime: int, most: int) -> Point | None:
    """As many of the single points as there is room for; None if there are none.

    Their values are any real and complex points of as many.
    """
    sums: dict[int, tuple[tuple[int, ...], ...]] = {0: ()}
    for factor in known.factors:
        for total, some in tuple(sums.items()):
            if total + len(factor) <= most:
                sums.setdefault(total + len(factor), (*some, factor))
    for total in sorted(filter(None, sums), reverse=True):
        some_factors = (flint.nmod_poly([*factor, 1], prime) for factor in sums[total])
        residues = tuple(map(int, prod(some_factors, start=flint.nmod_poly([1], prime)).coeffs()))[:-1]
        if not matrices.carries_values():
            return Point(residues, [[NOTHING] * total])
        if values := [*islice(_polynomials(known, total, has_zero=not residues[0]), MOST_VALUES)]:
            return Point(residues, values)
    return None


def _polynomials(known: _Roots, degree: int, *, has_zero: bool) -> Iterator[list[Any]]:
    """Coefficients, but for the highest, of polynomials of a degree with some single roots."""
    real, above = map(compress, (known.real, known.above), known.is_single)
    of_one = [flint.arb_poly([*_of_one(x), 1]) for x in real if x is not NOTHING]
    of_two = [flint.arb_poly([*_of_two(x), 1]) for x in above]
    start, left = flint.arb_poly([0, 1] if has_zero else [1]), degree - has_zero
    fewest = max(0, (left - len(of_one) + 1) // 2)
    for pairs in range(min(len(of_two), left // 2), fewest - 1, -1):
        for two in combinations(of_two, pairs):  # `product` would make all of them first
            for one in combinations(of_one, left - 2 * pairs):
                coefficients = prod((*two, *one), start=start).coeffs()[:-1]
                yield [NOTHING, *coefficients[1:]] if has_zero else coefficients


def _apart(motions: Motions, known: _Roots, *, without_single: bool) -> list[Point]:
    """Points with values that may be theirs: any real one, and two residues of two complex ones."""
    (residues, real, above), prime = known[:3], motions.z.prime
    if without_single:
        residues = [residue for residue in residues if (-residue % prime,) not in known.factors]
        real, above = (
            [x for x, is_single in zip(some, which, strict=True) if not is_single]
            for some, which in zip((real, above), known.is_single, strict=True)
        )
    of_one, of_two = [*map(_of_one, real)], [*map(_of_two, above)]
    if not matrices.carries_values():
        return [Point((-residue % prime,), [[NOTHING]]) for residue in residues]
    points, left = list[Point](), list[int]()
    for residue in residues:
        some = _values_of(motions, (-residue % prime,), of_one)
        if some and len(points) < len(real):
            points.append(Point((-residue % prime,), some))
        else:
            left.append(residue)
    for x, y in zip(left[::2], left[1::2], strict=False):
        pair = (x * y % prime, -(x + y) % prime)
        points.append(Point(pair, _values_of(motions, pair, of_two)))
    return points


def _values_of(
    motions: Motions, residues: tuple[int, ...], values: Sequence[Sequence[Any]]
) -> list[Sequence[Any]]:
    """Those that may belong to residues."""
    if residues == (0,):
        return [[NOTHING]]
    some = list[Sequence[Any]]()
    for value in values:
        try:
            if value != [NOTHING] and _kernels(motions, residues, value):
                some.append(value)
        except TooFewBitsError:
            continue
    return some


def motions_anywhere(chains: Iterable[tuple[ExactLFT, int]], size: int) -> Motions | None:
    """Those of chains so long that a longer one makes no difference; None if there are none.

    There may not be some at any s: those are left to the transposed LFT.
    """
    before = 0
    for system, n in _systems(chains, size):
        found = motions_without_outputs(system, n, 2 * size)
        if found is None or not found[0].residues.size:
            return None
        s, outputs = found
        if len(s.residues) == before:
            return _with_action(s, outputs)
        before = len(s.residues)
    return None


def motions_at_infinity(chains: Iterable[tuple[ExactLFT, int]], size: int) -> Motions | None:
    """Vectors of the same at s = 0, where there may be some at any s."""
    before = 0
    for system, n in _systems(chains, size):
        end = len(system.residues) - 2 * size
        outputs = system[end:] @ null_space(pencil(system[:end], n, 0, NOTHING))[0]
        columns, _ = independent(outputs[size:])
        if len(columns) in (0, before):
            nothing = matrices.zeros(before, before, system.prime)
            return _with_action(nothing, outputs[:, columns]) if columns else None
        before = len(columns)
    return None


def _systems(chains: Iterable[tuple[ExactLFT, int]], size: int) -> Iterator[tuple[ExactMatrix, int]]:
    """States, outputs C v, C A v, ... of each chain (v, ...), then A v and v; the number of states."""
    for chain, length in chains:
        n, end = chain.order, chain.order + length * size
        yield chain.M[[*range(n), *range(end, chain.M.shape[0]), *range(end - 2 * size, end)]], n


def _with_action(s: ExactMatrix, outputs: ExactMatrix) -> Motions | None:
    """With the matrix of A, of A z and z: a motion is told by z, s z, ...; None if it is not."""
    half = outputs.shape[0] // 2
    moved, z = outputs[:half], outputs[half:]
    columns, all_z, all_moved, count = z, z, moved, -1
    while len(rows := independent(all_z.T)[0]) < len(s.residues):
        if len(rows) == count:
            return None
        z, moved, count = z @ s, moved @ s, len(rows)
        all_z, all_moved = matrices.stacked([[all_z], [z]]), matrices.stacked([[all_moved], [moved]])
    return Motions(s, all_z[rows].solve(all_moved[rows]), columns)


def _kept_at(
    motions: Motions,
    points: Sequence[tuple[tuple[int, ...], Sequence[Any]]],
    outside: Residues,
    most: int,
) -> tuple[ExactMatrix, list[int]]:
    """Columns z of motions that both matrices keep, and how many of them belong to each of the points.

    These are all of a point, or else parts: what both make of one motion of chance, of as high an order
    as can be.
    """
    n, prime = motions.z.shape[1], motions.z.prime
    span, counts = matrices.zeros(n, 0, prime), list[int]()

    def fits(more: ExactMatrix) -> bool:
        count = more.shape[1]
        if not span.shape[1] < count <= most:
            return False
        beside = modular.multiplied(outside, (motions.z @ more).residues, prime)
        return modular.rank(beside, prime) == count

    for residues, value in points:
        before, kernels = span.shape[1], _kernels(motions, residues, value)
        if kernels and fits(whole := matrices.stacked([[span, kernels[-1]]])):
            span, kernels = whole, []
        while kernels and span.shape[1] < most:
            kernel = kernels[-1]
            weights = np.random.default_rng(span.shape[1]).integers(1, _WEIGHTS, (kernel.shape[1], 1))
            more = _kept(motions, span, kernel @ matrices.of_integers(weights.astype(float), prime))
            if fits(more):
                span = more
            else:
                kernels.pop()
        counts.append(span.shape[1] - before)
    return motions.z @ span, counts


def _kept(motions: Motions, span: ExactMatrix, motion: ExactMatrix) -> ExactMatrix:
    """A span with a motion, and all that both matrices make of it."""
    new = [motion]
    while new:
        motion = new.pop()
        more = matrices.stacked([[span, motion]])
        if modular.rank(more.residues, more.prime) == more.shape[1]:
            span, new = more, [*new, motions.s @ motion, motions.A @ motion]
    return span


def _kernels(motions: Motions, residues: tuple[int, ...], values: Sequence[Any]) -> list[ExactMatrix]:
    """Motions of higher and higher orders at the roots of a polynomial.

    A TooFewBitsError if what is zero as a residue is not so for the values.
    """
    both, n, prime, kernels = motions.both, motions.z.shape[1], motions.z.prime, list[ExactMatrix]()
    at = matrices.identity(n, prime)
    for residue, value in zip(reversed(residues), reversed(values), strict=True):
        if not residue:
            zero_of(value)
        at = pencil(-(at @ both), n, residue, value)
    power, vectors, count = at, null_space(at)[0], 0
    while vectors.shape[1] > count:
        power @ vectors  # which is zero if it is so in balls, too
        kernels.append(vectors)
        count, power = vectors.shape[1], power @ at
        vectors, _ = null_space(power)
    return kernels
