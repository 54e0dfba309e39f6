"""Rational matrices F(p) = N(p) / d(p) modulo primes, fractions from residues, and relations.

What is computed in residues modulo several primes is put together by the Chinese remainder theorem and
rational reconstruction (Wang 1981), and one more prime confirms it. All primes are below 2^31, so that
products of two residues are integers of 64 bits.

**Relations.** Rows [D N] with D(p) y = N(p) u are a null space of [F ; -I]: of its values at random
points, in all monomials up to a total degree. D and N of least degree can need far fewer repetitions
than F, and y is an unknown signal, which costs none.
"""

import itertools
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property, lru_cache
from typing import NamedTuple

import flint
import numpy as np
from numpy.typing import NDArray

from mbdlft.exact.modular import Residues, inverses, multiplied, null_space, powers_of, rank, row_echelon
from mbdlft.order.work import Work, exact_elimination

Terms = Mapping[tuple[int, ...], Fraction]  # coefficients of a polynomial by exponents
Fractions = NDArray[np.object_]

_FIRST = 2**31 - 1  # primes from here down
_MOST_PRIMES, _MOST_UNLUCKY = 64, 2  # primes; primes without a result
_MOST_UNKNOWNS, _MOST_DEGREE = 1600, 4  # of relations
_VALUE = 150.0  # operations for a monomial at a point, and a fifth of them for each entry
_RESIDUE = 2e4  # operations for that of a fraction; half of them for each prime that lifts it
_EXTRA = 10  # equations beyond the number of unknowns


@dataclass(frozen=True)
class RationalMatrix:
    """N / d in lowest terms, polynomials in so many parameters."""

    N: Sequence[Sequence[Terms]]  # p rows of q
    d: Terms
    parameters: int

    @cached_property
    def box(self) -> tuple[int, ...]:
        """One more than the degree in each parameter."""
        polynomials = [self.d, *itertools.chain(*self.N)]
        return tuple(
            1 + max((exponents[k] for terms in polynomials for exponents in terms), default=0)
            for k in range(self.parameters)
        )

    @cached_property
    def _numerators(self) -> tuple[Residues, Fractions]:
        """Places of all coefficients of N and d in one array, and whole numbers, which are fractions
        of these: over one denominator, that of all of them."""
        polynomials = [*itertools.chain(*self.N), self.d]
        terms = [((k, *e), x) for k, polynomial in enumerate(polynomials) for e, x in polynomial.items()]
        shared = math.lcm(*(x.denominator for _, x in terms))
        numerators = [x.numerator * (shared // x.denominator) for _, x in terms]
        places = np.ravel_multi_index(np.array([e for e, _ in terms]).T, (len(polynomials), *self.box))
        return places, np.array(numerators, dtype=object)

    def modulo(self, prime: int, work: Work) -> "Polynomials":
        """The same modulo a prime: N and d times one number."""
        places, numerators = self._numerators
        work.add(_RESIDUE * len(numerators))
        p, q = len(self.N), len(self.N[0])
        flat = np.zeros((p * q + 1) * math.prod(self.box), dtype=np.int64)
        flat[places] = numerators % prime
        *N, d = flat.reshape(-1, *self.box)
        return Polynomials(np.reshape(N, (p, q, *self.box)), d, Field(prime, work))


class Field:
    """Residues modulo a prime: linear algebra that is counted, and random points."""

    def __init__(self, prime: int, work: Work) -> None:
        self.prime, self.work, self._random = prime, work, np.random.default_rng(prime)

    def points(self, *shape: int) -> Residues:
        """Random, none zero."""
        return self._random.integers(1, self.prime, shape)

    def rank(self, a: Residues) -> int:
        self.work.add(exact_elimination(*a.shape))
        return rank(a, self.prime)

    def echelon(self, a: Residues) -> tuple[Residues, list[int]]:
        self.work.add(exact_elimination(*a.shape))
        return row_echelon(a, self.prime)

    def null_space(self, a: Residues) -> Residues:
        """Columns."""
        self.work.add(exact_elimination(*a.shape))
        return null_space(a, self.prime)

    def combinations(self, a: Residues, b: Residues) -> Residues | None:
        """X with X a = b; None if there is none, or more than one."""
        rows, pivots = self.echelon(np.vstack([a, b]).T)
        return rows[: len(a), len(a) :].T if pivots == list(range(len(a))) else None


class Polynomials(NamedTuple):
    """F = N / d, with coefficients in a field and all degrees in one box."""

    N: Residues  # (p, q, D_1 + 1, ..., D_K + 1)
    d: Residues  # (D_1 + 1, ..., D_K + 1)
    field: Field

    @property
    def T(self) -> "Polynomials":
        """The transpose."""
        return self._replace(N=self.N.swapaxes(0, 1))

    def at(self, a: Residues, points: Residues, kept: int | None = None) -> Residues:
        """Values (points, ...) of polynomials (..., D_1 + 1, ...), or coefficients in one parameter."""
        prime, K = self.field.prime, self.d.ndim
        values = np.broadcast_to(a, (len(points), *a.shape))
        for k in range(K - 1, -1, -1):
            if k == kept:
                values = np.moveaxis(values, -1, a.ndim - K + 1)
                continue
            powers = powers_of(points[:, k], a.shape[a.ndim - K + k], prime)
            powers = powers.reshape(len(powers), *[1] * (values.ndim - 2), -1)
            values = np.sum(values * powers % prime, axis=-1) % prime
        return values

    def constant_rows(self) -> Residues:
        """d times the identity, as rows (q, q * box)."""
        return np.multiply.outer(np.eye(self.N.shape[1], dtype=np.int64), self.d).reshape(
            self.N.shape[1], -1
        )

    def shifted(self, rows: Residues, k: int) -> Residues:
        """Rows times p_k; their degree in it is below that of F."""
        a = rows.reshape(len(rows), *self.N.shape[1:])
        return np.roll(a, 1, axis=2 + k).reshape(rows.shape)


def residue_of(x: Fraction, prime: int) -> int:
    """Modulo a prime that does not divide the denominator."""
    return x.numerator * pow(x.denominator, -1, prime) % prime


def image_of(a: Fractions, prime: int) -> Residues:
    """Of an array, modulo a prime."""
    flat = [residue_of(x, prime) for x in a.ravel().tolist()]
    return np.array(flat, dtype=np.int64).reshape(a.shape)


def along(a: Residues, axis: int, matrix: Residues, prime: int) -> Residues:
    """A matrix times the vectors along an axis."""
    moved = np.moveaxis(a, axis, 0)
    product = multiplied(matrix, moved.reshape(len(moved), -1), prime)
    return np.moveaxis(product.reshape(len(matrix), *moved.shape[1:]), 0, axis)


def low_relations(F: RationalMatrix, work: Work) -> list[list[Terms]] | None:
    """Rows of D (p, p) and N (p, q), side by side, of low degrees with D y = N u and D regular.

    None if the degrees are too high, or the work is over.
    """
    p, q = len(F.N), len(F.N[0])
    chosen: list[tuple[int, int]] | None = None  # degree, row of the null space of that degree
    monomials: list[tuple[int, ...]] = []  # those of a lower degree are the last ones

    def modulo(prime: int) -> Residues | None:
        nonlocal chosen, monomials
        f = F.modulo(prime, work)
        most = _MOST_DEGREE if chosen is None else max(degree for degree, _ in chosen)
        point, rows, numbers = f.field.points(1, F.parameters), [], []
        values: Residues = np.zeros((0, p), dtype=np.int64)
        for degree in range(most + 1):
            monomials = _monomials(F.box, degree)
            if len(monomials) * (p + q) > _MOST_UNKNOWNS or work.is_over:
                return None
            null = _null_rows(f, monomials)
            weights = _values(monomials, point, prime)[0]
            for number in sorted(range(len(null)), key=lambda k: _cost(null[k], monomials)):
                if chosen is not None and (degree, number) not in chosen:
                    continue
                at_point = np.sum(null[number, :, :p] * weights[:, None] % prime, axis=0) % prime
                if f.field.rank(np.vstack([values, at_point])) > len(values):
                    values = np.vstack([values, at_point])
                    numbers.append((degree, number))
                    rows.append(null[number])
            if len(rows) == p:
                chosen = numbers if chosen is None else chosen
                return np.array([np.pad(row, ((len(monomials) - len(row), 0), (0, 0))) for row in rows])
        return None

    entries = lifted(modulo, work)
    if entries is None:
        return None
    return [
        [{e: x for e, x in zip(monomials, entry, strict=True) if x} for entry in row.T] for row in entries
    ]


@lru_cache(maxsize=2 * _MOST_DEGREE)  # they are those of all primes
def _monomials(box: Sequence[int], most: int) -> list[tuple[int, ...]]:
    """Exponents of a total degree of at most so much, the highest first; some, if they are too many."""
    known = [(0, tuple[int, ...]())]
    for size in box:
        known = [(d + k, (*e, k)) for d, e in known for k in range(min(max(size, 2), most - d + 1))]
        if len(known) > _MOST_UNKNOWNS:
            break
    return [e for _, e in sorted(known, key=lambda pair: (-pair[0], pair[1]))]


def _values(monomials: Sequence[tuple[int, ...]] | Residues, points: Residues, prime: int) -> Residues:
    """(points, monomials)."""
    values = np.ones((len(points), len(monomials)), dtype=np.int64)
    for k, exponents in enumerate(np.array(monomials).T):
        values = values * powers_of(points[:, k], 1 + int(max(exponents)), prime)[:, exponents] % prime
    return values


def _at_points(f: "Polynomials", a: Residues, points: Residues) -> Residues:
    """Values (points, entries) of polynomials (..., D_1 + 1, ...) with few coefficients but zeros."""
    flat, prime = a.reshape(-1, f.d.size), f.field.prime
    used = np.flatnonzero(np.any(flat, axis=0))
    if not len(used):
        return np.zeros((len(points), len(flat)), dtype=np.int64)
    f.field.work.add(_VALUE * len(points) * len(used) * (1.0 + 0.2 * len(flat)))
    monomials = np.stack(np.unravel_index(used, f.d.shape), axis=1)
    return multiplied(_values(monomials, points, prime), flat[:, used].T, prime)


def _null_rows(f: "Polynomials", monomials: Sequence[tuple[int, ...]]) -> Residues:
    """Polynomial rows c (rows, monomials, p + q) with c [F ; -I] = 0, in echelon form."""
    (p, q), prime = f.N.shape[:2], f.field.prime
    unknowns = len(monomials) * (p + q)
    points = f.field.points((unknowns + _EXTRA) // q + 1, f.d.ndim)
    values = _at_points(f, np.concatenate([f.N.reshape(p * q, *f.d.shape), f.d[None]]), points)
    N, d = values[:, :-1].reshape(-1, p, q), values[:, -1]
    inverse = inverses(d, prime)
    minus = np.broadcast_to(-np.eye(q, dtype=np.int64) % prime, (len(points), q, q))
    F = np.concatenate([N * inverse[:, None, None] % prime, minus], axis=1).swapaxes(1, 2)
    equations = F[:, :, None] * _values(monomials, points, prime)[:, None, :, None] % prime
    return f.field.null_space(equations.reshape(-1, unknowns)).T.reshape(-1, len(monomials), p + q)


def _cost(row: Residues, monomials: Sequence[tuple[int, ...]]) -> tuple[int, int]:
    """Degrees of all terms of a row, and their number."""
    used = np.nonzero(row)[0].tolist()
    return sum(sum(monomials[k]) for k in used), len(used)


def lifted(modulo: Callable[[int], Residues | None], work: Work) -> Fractions | None:
    """Fractions whose residues a computation has modulo every prime; None if they do not come out."""
    modulus, unlucky = 1, 0
    residues: list[int] = []
    fractions: list[Fraction] | None = None
    for count, prime in enumerate(itertools.islice(primes(), _MOST_PRIMES)):
        result = modulo(prime)
        if result is None:
            unlucky += 1
            if unlucky > _MOST_UNLUCKY or work.is_over:
                return None
            continue
        new = result.ravel().tolist()
        work.add(0.5 * _RESIDUE * count * len(new))
        if fractions is not None and all(
            (x.denominator * r - x.numerator) % prime == 0 for x, r in zip(fractions, new, strict=True)
        ):
            entries = np.empty(len(fractions), dtype=object)
            entries[:] = fractions
            return entries.reshape(result.shape)
        inverse = pow(modulus, -1, prime)
        residues = [
            a + modulus * ((r - a) * inverse % prime)
            for a, r in zip(residues or [0] * len(new), new, strict=True)
        ]
        modulus *= prime
        fractions = _fractions(residues, modulus)
    return None


def _fractions(residues: Iterable[int], modulus: int) -> list[Fraction] | None:
    """The fractions a / b with a, b below sqrt(modulus / 2); None if one of them has none."""
    most = math.isqrt(modulus // 2)
    fractions = []
    for residue in residues:
        (r0, r1), (s0, s1) = (modulus, residue), (0, 1)
        while r1 > most:
            quotient = r0 // r1
            r0, r1, s0, s1 = r1, r0 - quotient * r1, s1, s0 - quotient * s1
        if not 0 < abs(s1) <= most:
            return None
        fractions.append(Fraction(r1, s1))
    return fractions


def primes() -> Iterator[int]:
    """From the largest down."""
    return (n for n in range(_FIRST, 1, -2) if flint.fmpz(n).is_prime())
