"""Directions that an exchange leaves out at no cost: those that no output sees at a value of b.

In the words of `mbdlft.order.exchange`, let v in R(beta) have A v = alpha v and C v = 0. If P v = 0, then
S has a pole at beta, but P A S and C S have none there, as P A v = alpha P v. No repetition of b is
needed for it, and beta may be in the range, too.

All such v, and what takes their place at poles of higher order, are the motions in R that no output of
any chain sees. Multiplication by s = 1/b and by A act on the space of them as two matrices that commute.
P may be zero on any part of it that both keep. In the words of docs/pairs.md, the eigenvalues are points
(a, b) at which F is not its double dual, and a part that is long enough leads to the degrees.
"""

from collections.abc import Iterable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

from mbdlft.exact import matrices
from mbdlft.exact.matrices import ExactMatrix, Residues
from mbdlft.exact.numbers import NOTHING, RESIDUES_ALONE, TooFewBitsError, carries_values, precision
from mbdlft.exact.pencils import eigenvalues, independent, motions_without_outputs, null_space, pencil
from mbdlft.order.reduction import ExactLFT

_OF_S, _OF_A = 3.0, 7.0  # the sum of these times both matrices tells points apart
_WEIGHTS = 2**20


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


# residues of a point, or of two that are complex, and values that may be theirs
_Points = tuple[tuple[int, ...], Sequence[Any]]


class Unobservable(NamedTuple):
    """So many columns that cost nothing, of points; without points they are all motions."""

    motions: Motions
    points: Sequence[_Points]
    residues: Residues

    @property
    def size(self) -> int:
        """How many columns."""
        return len(self.residues.T)

    def values(self) -> Iterator[tuple[Any, ...]]:
        """Those of all points, each another one."""
        return _different([some for _, some in self.points], ())

    def columns(self, values: Sequence[Any], outside: Residues) -> ExactMatrix:
        """Those for values of the points (size, count); a TooFewBitsError for one of another residue."""
        if not self.points:
            return self.motions.z
        if not carries_values():
            return matrices.of_residues(self.residues, self.motions.z.prime)
        points = [(residues, value) for (residues, _), value in zip(self.points, values, strict=True)]
        return _kept_at(self.motions, points, outside, self.size)[0]


def _different(
    choices: Sequence[Sequence[Any]], before: tuple[Any, ...] = ()
) -> Iterator[tuple[Any, ...]]:
    """One of each of the choices, each another one, or nothing."""
    if len(before) == len(choices):
        yield before
        return
    for value in choices[len(before)]:
        if value is NOTHING or not any(value is other for other in before):
            yield from _different(choices, (*before, value))


def unobservable(motions: Motions | None, outside: Residues, most: int) -> Unobservable | None:
    """As many of the columns as are independent beside R, at most; None if there are none."""
    if motions is None:
        return None
    count, prime = motions.z.shape[1], motions.z.prime
    beside = matrices.multiplied(outside, motions.z.residues, prime)
    if count <= most and matrices.rank(beside, prime) == count:
        return Unobservable(motions, (), motions.z.residues)
    points = _points(motions)
    with precision(RESIDUES_ALONE):
        alone = [(residues, NOTHING) for residues, _ in points]
        columns, counts = _kept_at(motions.residues(), alone, outside, most)
    used = [point for point, count in zip(points, counts, strict=True) if count]
    return Unobservable(motions, used, columns.residues) if used else None


def _points(motions: Motions) -> list[_Points]:
    """Points with values that may be theirs: any real one, and two residues of two complex ones."""
    residues, real, above = eigenvalues(motions.both)
    residues.sort()
    if not carries_values():
        return [((residue,), [NOTHING]) for residue in residues]
    points = list[_Points]()
    for residue in residues:
        some = _values_of(motions, (residue,), real)
        if some and len(points) < len(real):
            points.append(((residue,), some))
    others = [residue for residue in residues if not any(residue in known for known, _ in points)]
    pairs = list(zip(others[::2], others[1::2], strict=False))
    return [*points, *((pair, _values_of(motions, pair, above)) for pair in pairs)]


def _values_of(motions: Motions, residues: tuple[int, ...], values: Sequence[Any]) -> list[Any]:
    """Those that may belong to residues."""
    if residues == (0,):
        return [NOTHING]
    some = list[Any]()
    for value in values:
        try:
            if value is not NOTHING and _kernels(motions, residues, value):
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
    motions: Motions, points: Sequence[tuple[tuple[int, ...], Any]], outside: Residues, most: int
) -> tuple[ExactMatrix, list[int]]:
    """Columns z of motions that both matrices keep, and how many of them belong to each of the points.

    Each part is what both make of one motion of chance, of as high an order as can be.
    """
    n, prime = motions.z.shape[1], motions.z.prime
    span, counts = matrices.zeros(n, 0, prime), list[int]()
    for residues, value in points:
        before, kernels = span.shape[1], _kernels(motions, residues, value)
        while kernels and span.shape[1] < most:
            kernel = kernels[-1]
            weights = np.random.default_rng(span.shape[1]).integers(1, _WEIGHTS, (kernel.shape[1], 1))
            more = _kept(motions, span, kernel @ matrices.of_integers(weights.astype(float), prime))
            beside = matrices.multiplied(outside, (motions.z @ more).residues, prime)
            if span.shape[1] < more.shape[1] <= most and matrices.rank(beside, prime) == more.shape[1]:
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
        if matrices.rank(more.residues, more.prime) == more.shape[1]:
            span, new = more, [*new, motions.s @ motion, motions.A @ motion]
    return span


def _kernels(motions: Motions, residues: tuple[int, ...], value: Any) -> list[ExactMatrix]:
    """Motions of higher and higher orders at a point, or at two that are complex.

    A TooFewBitsError if what is zero as a residue is not so for the value.
    """
    both, n, prime, kernels = motions.both, motions.z.shape[1], motions.z.prime, list[ExactMatrix]()
    if len(residues) == 1:
        at = pencil(both, n, residues[0], value)
    else:
        first, second = residues
        total, times = 2 * value.real, value.real**2 + value.imag**2
        at = both @ pencil(both, n, (first + second) % prime, total)
        at = pencil(at, n, first * second % prime, times)
    power, vectors, count = at, null_space(at)[0], 0
    while vectors.shape[1] > count:
        power @ vectors  # which is zero if it is so in balls, too
        kernels.append(vectors)
        count, power = vectors.shape[1], power @ at
        vectors, _ = null_space(power)
    return kernels
