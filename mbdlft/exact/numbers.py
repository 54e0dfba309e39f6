"""Numbers whose zeros are decided exactly: a residue modulo a prime decides, a ball carries the value.

An `Exact` is a real number twice: as a ball of FLINT, which holds it with hundreds of bits, and as its
image under a ring homomorphism into the integers modulo a prime P. What is not zero modulo P is not zero;
what is zero modulo P is zero but for a chance of about 1e-18 in each decision. No threshold takes part.

The homomorphism is that of the numbers as they are written. Decimals are fractions. P = 1 modulo
360 10^9, so that there is an element of order 360 10^9: cosines and sines of angles of up to nine
decimals of a degree are made of its powers, and all their relations hold, cos 60 deg = 1/2 among them.
The exponential of i times a decimal is transcendental (Lindemann): cosines and sines of other angles are
made of powers of any one element, that of the largest angle of which all of a problem are multiples.
Square roots: those of 2, 3 and 5 are sums of cosines; P is chosen such that the others of a problem
exist, and any of their signs is a homomorphism. Where these would be too many, the directions with the
longest decimals are taken as the rational unit vectors that agree with them in 70 digits.

A number whose residue is zero and whose ball is not around zero says that P does not tell the numbers
of this problem apart. The next precision has another P.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property, lru_cache
from math import gcd, isqrt, lcm, pi
from typing import Any, NamedTuple, TypeVar

import flint
import numpy as np

from mbdlft.base.errors import AnalysisError
from mbdlft.exact.operators import Operators

Made = TypeVar("Made")

BITS = 384  # of balls, at first
MOST_BITS = 5120
RESIDUES_ALONE = 2  # bits, with which no balls are computed

_TURN = 360 * 10**9  # parts of a turn that have residues of their own
_FIRST = 2**60 // _TURN  # P is above 2^60
_MOST_ROOTS = 12  # each doubles the number of primes that are tried
_MOST_PRIMES = 2_000_000  # that are tried: for as many square roots as a problem can have
_FEW_BITS = 2**20  # odd factor of the numerator of a binary fraction
_SIMPLE, _ROUNDINGS = 10**5, Fraction(2, 2**52)  # most of a denominator, and distance to it
LARGEST_ANGLE = 1e4  # rad; doubles beyond are not dense enough to tell a billionth of a degree
_SEED = 12345678910111213141
_NEAR = 4.0 * 2.0**-52  # of an angle (rad): this near to one of nine decimals of a degree it is that


@dataclass(slots=True, eq=False, repr=False)
class Exact(Operators):
    """A real number as a ball and as a residue; it is zero, or equal to another, by its residue."""

    ball: Any
    residue: Any

    def __bool__(self) -> bool:
        return bool(self.residue != 0)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Exact) and bool(self.residue == other.residue)

    def __hash__(self) -> int:
        return int(self.residue)

    def __float__(self) -> float:
        return float(self.ball)

    def __repr__(self) -> str:
        return f"Exact({float(self.ball)!r})"

    def __add__(self, other: "Exact") -> "Exact":
        residue, ball = self.residue + other.residue, self.ball + other.ball
        return Exact(ball if residue != 0 else zero_of(ball), residue)

    def __neg__(self) -> "Exact":
        return Exact(-self.ball, -self.residue)

    def __mul__(self, other: "Exact") -> "Exact":
        return Exact(self.ball * other.ball, self.residue * other.residue)

    def __truediv__(self, other: "Exact") -> "Exact":
        return Exact(self.ball / other.ball, self.residue / other.residue)


NOTHING = flint.arb(0)


class TooFewBitsError(AnalysisError):
    """Balls have become too wide for doubles, or a prime does not tell: more bits, and another prime."""

    bits = 0  # that are enough, where it is known


def zero_of(ball: Any) -> Any:
    """Zero, for a ball of a number whose residue is; a TooFewBitsError if zero is not in the ball."""
    if ball is not NOTHING and not ball.contains(NOTHING):
        raise TooFewBitsError(f"{float(ball)!r} is zero modulo a prime.")
    return NOTHING


class Constant(NamedTuple):
    """How a number is made: `kind` of "rational", "root", "cosine", "sine" or "pi" times an argument.

    The argument of a cosine or sine is an angle in degrees, unless `in_radians`. The number "unit" is a
    component of `direction` (3,) with unit length, by its position.
    """

    kind: str
    argument: Fraction
    in_radians: bool = False
    direction: tuple[Fraction, ...] = ()

    @property
    def radicand(self) -> Fraction | None:
        """What it has the square root of, if it has one."""
        if self.kind == "unit":
            return sum((x * x for x in self.direction), Fraction(0))
        return self.argument if self.kind == "root" else None


def decimal(value: float | str) -> Fraction:
    """The fraction that a number is as it is written; a double as the shortest decimal it prints as."""
    if isinstance(value, np.floating | int):
        value = float(value)
    return Fraction(value if isinstance(value, str) else repr(value))


@lru_cache(maxsize=4096)
def constant_of(value: float) -> Fraction:
    """The fraction that a double in code stands for: numbers of users do not come here but as text.

    A binary fraction of few bits is itself. One within two roundings of a simple fraction is that, such
    as an entry of the mass matrix of a beam. Others are the decimals that they print as.
    """
    binary = Fraction(value)
    numerator = abs(binary.numerator)
    if numerator // (numerator & -numerator or 1) < _FEW_BITS:
        return binary
    simple = binary.limit_denominator(_SIMPLE)
    return simple if abs(simple - binary) <= _ROUNDINGS * abs(binary) else decimal(value)


def cosine_of(angle: float) -> Constant:
    """The cosine of an angle (rad)."""
    degrees = _degrees(angle)
    if degrees is not None:
        return Constant("cosine", degrees)
    return Constant("cosine", decimal(angle), in_radians=True)


def sine_of(angle: float) -> Constant:
    """The sine of an angle (rad)."""
    return cosine_of(angle)._replace(kind="sine")


def _degrees(angle: float) -> Fraction | None:
    """The angle in degrees if it has at most nine decimals there."""
    if abs(angle) > LARGEST_ANGLE:
        return None
    degrees = Fraction(round(angle * 180.0 / pi * 1e9), 10**9)
    near = abs(float(degrees) * pi / 180.0 - angle) <= _NEAR * max(1.0, abs(angle))
    return degrees if near else None


def in_enough_bits(make: Callable[[], Made], owner: str) -> Made:
    """What is made in as many bits as it takes."""
    bits = BITS
    while True:
        try:
            with precision(bits):
                return make()
        except TooFewBitsError as error:
            if bits >= MOST_BITS:
                raise AnalysisError(
                    f"{owner}: numbers that are not zero cannot be told from zero in {bits} bits. Terms "
                    "cancel nearly, such as an axis that is nearly parallel to another one: make equal "
                    "what is meant to be equal."
                ) from None
            bits = max(2 * bits, error.bits)


def ask_for_bits(bits: int) -> None:
    """A TooFewBitsError if balls have fewer bits."""
    if flint.ctx.prec < bits:
        error = TooFewBitsError(f"balls of {flint.ctx.prec} bits are not begun with.")
        error.bits = bits
        raise error


@contextmanager
def precision(bits: int) -> Iterator[None]:
    """Balls of so many bits in what is done inside."""
    with flint.ctx.workprec(bits):
        yield


def index_of(bits: int) -> int:
    """Of the prime in so many bits: more of them are another prime, too, as one may not tell."""
    return (bits // BITS // 2).bit_length()


_index: ContextVar[int | None] = ContextVar("the index of the prime", default=None)


@contextmanager
def prime_of(index: int | None) -> Iterator[None]:
    """The prime of an index in what is done inside, in any bits; None: that of the bits."""
    token = _index.set(index)
    try:
        yield
    finally:
        _index.reset(token)


@contextmanager
def half_precision() -> Iterator[None]:
    """Balls of half as many bits."""
    with precision(flint.ctx.prec // 2):
        yield


class Field:
    """The numbers of one problem: a prime, and residues and balls of its constants."""

    def __init__(self, constants: Iterable[Constant] = ()) -> None:
        constants = tuple(constants)
        kinds = {(c.kind, r) for c in constants if (r := c.radicand) is not None}
        base = _coprime_base({r for _, r in kinds})
        # square roots of numbers have to exist, those of directions need not
        needed = {
            factor
            for factor in base
            for kind, r in kinds
            if kind == "root" and r.numerator * r.denominator % factor == 0
        }
        self.base = sorted(needed | set(base[: max(0, _MOST_ROOTS - len(needed))]))
        index = _index.get()
        self.prime = _prime(tuple(self.base), index_of(flint.ctx.prec) if index is None else index)
        # one over the largest angle (rad) of which all are multiples
        self._parts_of_radian = lcm(*(c.argument.denominator for c in constants if c.in_radians))

    def residue(self, value: Fraction | int) -> Any:
        """The residue of a fraction."""
        if isinstance(value, int):
            return flint.nmod(value % self.prime, self.prime)
        top, bottom = value.numerator % self.prime, value.denominator % self.prime
        return flint.nmod(top, self.prime) / flint.nmod(bottom, self.prime)

    def rational(self, value: Fraction | int) -> Exact:
        """A fraction as an exact number."""
        if value == 1:
            return self.one
        ball, residue = flint.arb(flint.fmpq(value.numerator, value.denominator)), self.residue(value)
        return Exact(ball if residue else zero_of(ball), residue)

    def decimals(self, values: Iterable[float]) -> list[Exact]:
        """Numbers as they are written."""
        return [self.rational(decimal(value)) for value in values]

    def of(self, constant: Constant) -> Exact:
        """A constant as an exact number."""
        if constant.kind == "rational":
            return self.rational(constant.argument)
        if constant.kind == "root":
            return self._root(constant.argument)
        if constant.kind == "unit":
            return self._unit(constant)
        if constant.kind == "pi":  # transcendental, too
            residue = self.residue(constant.argument) * self.residue(_SEED + 1)
            return Exact(self.rational(constant.argument).ball * flint.arb.pi(), residue)
        return self._circle(constant)

    @cached_property
    def one(self) -> Exact:
        return Exact(flint.arb(1), self.residue(1))

    @cached_property
    def zero(self) -> Exact:
        return self.rational(0)

    @cached_property
    def _part(self) -> int:
        """An element of order 360 10^9, the residue of exp(i 1e-9 deg)."""
        generator = 2
        while True:
            element = pow(generator, (self.prime - 1) // _TURN, self.prime)
            if all(pow(element, _TURN // q, self.prime) != 1 for q in (2, 3, 5)):
                return element
            generator += 1

    def _cosine(self, degrees: Fraction, *, of_sine: bool = False) -> int:
        power = int(degrees * 10**9) % _TURN
        return self._half_sum(pow(self._part, power, self.prime), of_sine=of_sine)

    def _half_sum(self, z: int, *, of_sine: bool) -> int:
        inverse, p = pow(z, -1, self.prime), self.prime
        if not of_sine:
            return (z + inverse) * pow(2, -1, p) % p
        i = pow(self._part, _TURN // 4, p)
        return (z - inverse) * pow(2 * i, -1, p) % p

    def _circle(self, constant: Constant) -> Exact:
        angle = flint.arb(flint.fmpq(constant.argument.numerator, constant.argument.denominator))
        of_sine = constant.kind == "sine"
        if constant.in_radians:
            power = constant.argument * self._parts_of_radian
            assert power.denominator == 1
            z = pow(_SEED, power.numerator % (self.prime - 1), self.prime)
            residue = self._half_sum(z, of_sine=of_sine)
        else:
            angle = angle * flint.arb.pi() / 180
            residue = self._cosine(constant.argument, of_sine=of_sine)
        value = flint.nmod(residue, self.prime)
        ball = angle.sin() if of_sine else angle.cos()
        return Exact(ball if residue else zero_of(ball), value)

    def _unit(self, constant: Constant) -> Exact:
        radicand, k = constant.radicand, int(constant.argument)
        assert radicand is not None
        cofactor = radicand.numerator * radicand.denominator
        for factor in self.base:
            while cofactor % factor == 0:
                cofactor //= factor
        if isqrt(cofactor) ** 2 == cofactor:
            return self.rational(constant.direction[k]) / self._root(radicand)
        return self.rational(_rational_unit(constant.direction)[k])

    def _root(self, radicand: Fraction) -> Exact:
        ball = flint.arb(flint.fmpq(radicand.numerator, radicand.denominator)).sqrt()
        # sqrt(a / b) = sqrt(a b) / b
        cofactor, residue = radicand.numerator * radicand.denominator, self.residue(1)
        for factor in self.base:
            power = 0
            while cofactor % factor == 0:
                cofactor, power = cofactor // factor, power + 1
            residue *= self.residue(factor ** (power // 2))
            if power % 2:
                residue *= self._root_of_factor(factor)
        residue *= self.residue(isqrt(cofactor))
        return Exact(ball, residue / self.residue(radicand.denominator))

    def _root_of_factor(self, factor: int) -> Any:
        if factor == 2:
            return flint.nmod(2 * self._cosine(Fraction(45)) % self.prime, self.prime)
        if factor == 3:
            return flint.nmod(2 * self._cosine(Fraction(30)) % self.prime, self.prime)
        if factor == 5:
            return flint.nmod((4 * self._cosine(Fraction(36)) - 1) % self.prime, self.prime)
        return self.residue(factor).sqrt()


def _coprime_base(radicands: Iterable[Fraction]) -> list[int]:
    """Coprime whole numbers, no squares, of whose powers and of squares the radicands are made."""
    base: list[int] = []
    waiting = [r.numerator * r.denominator for r in radicands if r > 0]
    waiting = [2, 3, 5, *waiting] if waiting else []
    while waiting:
        number = waiting.pop()
        root = isqrt(number)
        if root * root == number:
            if root > 1:
                waiting.append(root)
            continue
        for k, other in enumerate(base):
            common = gcd(number, other)
            if common > 1:
                del base[k]
                waiting += [
                    factor for factor in (common, number // common, other // common) if factor > 1
                ]
                break
        else:
            base.append(number)
    return sorted(set(base))


@lru_cache(maxsize=256)
def _rational_unit(direction: tuple[Fraction, ...]) -> tuple[Fraction, ...]:
    """A rational vector of length one along a direction but for 2^-240: a stereographic projection.

    Directions that quarter turns and reflections make of each other have the same numbers.
    """
    order = sorted(range(3), key=lambda k: abs(direction[k]))
    with precision(2 * BITS):
        sizes = (abs(direction[k]) for k in order)
        x, y, z = (flint.arb(flint.fmpq(d.numerator, d.denominator)) for d in sizes)
        height = (x * x + y * y + z * z).sqrt() + z  # above the pole
        s, t = (Fraction(int((a / height * 2**240).mid().floor().fmpz()), 2**240) for a in (x, y))
    square = s * s + t * t
    components = {k: c / (1 + square) for k, c in zip(order, (2 * s, 2 * t, 1 - square), strict=True)}
    return tuple(components[k] if direction[k] >= 0 else -components[k] for k in range(3))


@lru_cache(maxsize=64)
def _prime(base: Sequence[int], others: int) -> int:
    """A prime above 2^60, 1 modulo 360 10^9, modulo which all numbers are squares, after some others."""
    for k in range(_FIRST + 1, _FIRST + _MOST_PRIMES):
        p = k * _TURN + 1
        if all(pow(number % p, (p - 1) // 2, p) == 1 for number in base) and flint.fmpz(p).is_prime():
            if not others:
                return p
            others -= 1
    raise AnalysisError(
        f"exact numbers: no prime was found modulo which {len(base)} square roots exist. Write some "
        "directions with lengths that are decimals, such as [0.6, 0.8, 0]."
    )
