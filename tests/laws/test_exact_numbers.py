"""Laws of exact numbers."""

from collections.abc import Sequence
from fractions import Fraction
from functools import reduce
from math import gcd, isqrt, prod, radians

import flint
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mbdlft.base.errors import AnalysisError
from mbdlft.exact import numbers as module
from mbdlft.exact.matrices import from_rows
from mbdlft.exact.numbers import (
    BITS,
    Constant,
    Exact,
    Field,
    TooFewBitsError,
    ask_for_bits,
    constant_of,
    cosine_of,
    decimal,
    in_enough_bits,
    precision,
    prime_of,
    sine_of,
)
from mbdlft.pipeline.extract.graph import SignalGraph
from mbdlft.problem.sx.constants import double
from tests.close import roundoff
from tests.extracted import with_bits as with_bits

FIELD = Field()
rationals = st.fractions(min_value=-100, max_value=100, max_denominator=99)
angles = st.integers(-(400 * 10**9), 400 * 10**9).map(lambda k: Fraction(k, 10**9))
in_radians = st.fractions(min_value=-10, max_value=10, max_denominator=10**6).map(
    lambda x: Fraction(round(x * 10**12), 10**12)
)


def is_consistent(value: Exact) -> bool:
    """Whether a zero residue goes with a ball about zero, and no other does."""
    if value:
        return not value.ball.contains(0)
    return bool(value.ball.contains(0))


def cosine(degrees: Fraction, field: Field = FIELD) -> Exact:
    return field.of(Constant("cosine", degrees))


def sine(degrees: Fraction, field: Field = FIELD) -> Exact:
    return field.of(Constant("sine", degrees))


# 1. fractions --------------------------------------------------------------------------------------


@given(rationals, rationals, rationals)
def test_residues_are_a_field(x: Fraction, y: Fraction, z: Fraction) -> None:
    a, b, c = map(FIELD.rational, (x, y, z))
    half = FIELD.rational(Fraction(5, 2))
    assert a * b + c - half == FIELD.rational(x * y + z - Fraction(5, 2))
    assert -(c - a * b) == FIELD.rational(x * y - z)
    assert bool(a) == bool(x)
    assert (a == b) == (x == y)
    if y:
        assert a / b == FIELD.rational(x / y)
        assert a / b * b == a
    for found in (a + b, a * b - c, (a + b) * (a - b) - a * a + b * b):
        assert is_consistent(found)
        assert not found or found.ball.rel_accuracy_bits() > BITS - 40


def test_zero_has_a_ball_that_is_zero() -> None:
    third = FIELD.rational(Fraction(1, 3))
    left = third + third + third - FIELD.one
    assert not left
    assert left.ball == 0
    assert hash(left) == hash(FIELD.zero)
    assert third != Fraction(1, 3)
    assert repr(third) == "Exact(0.3333333333333333)"


def test_a_number_is_the_decimal_it_is_written_as() -> None:
    assert decimal(0.1) == Fraction(1, 10)
    assert decimal("1.00000000000000000001") == 1 + Fraction(1, 10**20)
    assert decimal(np.float64(0.3)) == Fraction(3, 10)
    assert decimal(7) == 7


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        (0.375, Fraction(3, 8)),
        (2.0**40, Fraction(2**40)),
        (1.0 / 3.0, Fraction(1, 3)),
        (0.1, Fraction(1, 10)),
        (9.80665, Fraction(980665, 100000)),
        (1.0 / 420.0, Fraction(1, 420)),
        (0.12345678901234, Fraction("0.12345678901234")),
    ],
)
def test_a_double_in_code_is_what_was_meant(value: float, expected: Fraction) -> None:
    assert constant_of(value) == expected
    assert constant_of(-value) == -expected


# 2. random expressions -----------------------------------------------------------------------------

CONSTANTS = [
    *(Constant("cosine", Fraction(text)) for text in ("36", "72", "22.5", "0.000000001", "17.3")),
    *(Constant("sine", Fraction(text)) for text in ("18", "54", "7.25", "33.123456789")),
    Constant("cosine", Fraction("0.7"), in_radians=True),
    Constant("sine", Fraction("0.7"), in_radians=True),
    *(Constant("root", Fraction(text)) for text in ("2", "5", "10", "7", "0.35", "14")),
    Constant("pi", Fraction(1, 180)),
    *(
        Constant("unit", Fraction(k), direction=(Fraction(1), Fraction(-2), Fraction(1, 3)))
        for k in range(3)
    ),
]
ALL = Field(CONSTANTS)


expressions = st.recursive(
    st.one_of(st.sampled_from(CONSTANTS), rationals),
    lambda inner: st.tuples(st.sampled_from("+-*"), inner, inner),
    max_leaves=10,
)


def value_of(node: object) -> Exact:
    if isinstance(node, Constant):
        return ALL.of(node)
    if isinstance(node, Fraction):
        return ALL.rational(node)
    operator, left, right = node
    a, b = value_of(left), value_of(right)
    return a + b if operator == "+" else a - b if operator == "-" else a * b


@precision(4 * BITS)
def law_random(node: object) -> None:
    """A number, and differences that are zero, or next to it, by the laws of a ring."""
    x = value_of(node)
    assert is_consistent(x)
    one, tiny = ALL.one, ALL.rational(Fraction(1, 2**200))
    assert not (x + one) * (x - one) - x * x + one
    assert (x + tiny) - x == tiny
    assert is_consistent((x + tiny) * (x - tiny) - x * x)
    if x:
        assert x / x == one


@pytest.mark.parametrize("constant", CONSTANTS, ids=str)
def test_balls_are_those_of_the_constants(constant: Constant) -> None:
    roundoff(float(ALL.of(constant)), double(constant), 10.0)
    assert ALL.of(constant).ball.rel_accuracy_bits() > BITS - 40


@given(expressions)
def test_residues_agree_with_balls(node: object) -> None:
    law_random(node)


# 3. relations --------------------------------------------------------------------------------------


@given(angles, angles)
def test_angles_in_degrees(a: Fraction, b: Fraction) -> None:
    for field in (FIELD, ALL):
        c, s = cosine(a, field), sine(a, field)
        assert c * c + s * s == field.one
        assert cosine(a + b, field) == c * cosine(b, field) - s * sine(b, field)
        assert sine(a + b, field) == s * cosine(b, field) + c * sine(b, field)
        assert cosine(a + 360, field) == c
        assert cosine(-a, field) == c
        assert sine(180 - a, field) == s
        assert cosine(90 - a, field) == s
        for found in (c, s, c - cosine(b, field), s + sine(b, field)):
            assert is_consistent(found)


def test_regular_polygons() -> None:
    """Cosines of parts of a turn add up to zero; of fewer of them they do not."""
    for n in (3, 5, 8, 9, 12, 25, 360):
        parts = [cosine(Fraction(360 * k, n)) for k in range(n)]
        total = reduce(lambda x, y: x + y, parts)
        assert not total
        assert total + parts[1]
    half, third = FIELD.rational(Fraction(1, 2)), cosine(Fraction(60))
    assert third == half
    assert sine(Fraction(30)) == half
    assert cosine(Fraction(36)) - cosine(Fraction(72)) == half
    assert not cosine(Fraction(90))
    assert cosine(Fraction(90)).ball == 0
    assert cosine(Fraction("60.000000001")) != half


@given(in_radians, in_radians)
def test_angles_in_radians(a: Fraction, b: Fraction) -> None:
    field = Field([Constant("cosine", angle, in_radians=True) for angle in (a, b)])

    def of(kind: str, angle: Fraction) -> Exact:
        return field.of(Constant(kind, angle, in_radians=True))

    c, s = of("cosine", a), of("sine", a)
    assert c * c + s * s == field.one
    assert of("cosine", a + b) == c * of("cosine", b) - s * of("sine", b)
    assert of("sine", 2 * a) == field.rational(2) * s * c
    assert is_consistent(c - of("cosine", b))
    if a:
        assert s
        assert c != cosine(Fraction(60), field)


def test_many_angles_in_radians_are_different() -> None:
    """Doubles beside short decimals, which are large multiples of what all are multiples of."""
    doubles = np.random.default_rng(0).uniform(0.1, 3.1, 30_000).tolist()
    constants = [Constant("cosine", decimal(x), in_radians=True) for x in (0.4, 0.35, *doubles)]
    field = Field(constants)
    assert len({int(field.of(constant).residue) for constant in constants}) == len(constants)


@pytest.mark.parametrize("degrees", [30.0, -60.0, 12.345678901, 1e-9, 359.999999999, 720.5])
def test_angles_that_are_degrees(degrees: float) -> None:
    expected = Constant("cosine", decimal(degrees))
    assert cosine_of(radians(degrees)) == expected
    assert sine_of(radians(degrees)) == expected._replace(kind="sine")


@pytest.mark.parametrize("angle", [0.7, 1.0, 3.0, 0.123456789])
def test_angles_that_are_no_degrees(angle: float) -> None:
    assert cosine_of(angle) == Constant("cosine", decimal(angle), in_radians=True)


def law_roots(radicands: Sequence[Fraction]) -> None:
    """sqrt(a) sqrt(b) = sqrt(a b), and sqrt(a)^2 = a; with cosines of 45, 30 and 36 degrees."""
    products = [x * y for x in radicands for y in radicands]
    field = Field([Constant("root", r) for r in (*radicands, *products, *map(Fraction, (2, 3, 5)))])
    roots = {r: field.of(Constant("root", r)) for r in (*radicands, *products)}
    for r, found in roots.items():
        assert found * found == field.rational(r)
        assert found.ball > 0
    for x in radicands:
        for y in radicands:
            difference = roots[x] * roots[y] - roots[x * y]
            assert is_consistent(difference), (x, y)
            assert not difference, (x, y)
            assert is_consistent(roots[x] - roots[y])
    two, three, five = (field.of(Constant("root", Fraction(k))) for k in (2, 3, 5))
    assert cosine(Fraction(45), field) * field.rational(2) == two
    assert sine(Fraction(60), field) * field.rational(2) == three
    assert cosine(Fraction(36), field) * field.rational(4) == five + field.one
    assert sine(Fraction(75), field) * field.rational(4) == two * (three + field.one)


ROOTS = [
    ["2", "3", "6", "0.5"],
    ["12", "18", "75", "0.2"],
    ["7", "14", "21", "0.35"],
    ["3.7", "0.037", "1.69", "2.25"],
    ["1000003", "2000006", "1/3", "4/9"],
]


@pytest.mark.parametrize("texts", ROOTS)
def test_square_roots(texts: list[str]) -> None:
    law_roots([Fraction(text) for text in texts])


@pytest.mark.parametrize("product", [(2, 3), (2, 5), (3, 5), (2, 3, 5)])
def test_roots_of_products_are_those_of_cosines(product: tuple[int, ...]) -> None:
    """Where no other root is there: sqrt 6 = 4 cos 45 cos 30."""
    field = Field([Constant("root", Fraction(prod(product)))])
    two, four = field.rational(2), field.rational(4)
    roots = {
        2: two * cosine(Fraction(45), field),
        3: two * cosine(Fraction(30), field),
        5: four * cosine(Fraction(36), field) - field.one,
    }
    expected = reduce(lambda x, y: x * y, (roots[k] for k in product))
    assert field.of(Constant("root", Fraction(prod(product)))) == expected


@given(st.lists(st.integers(1, 10**6), max_size=8))
def test_coprime_base(numbers: list[int]) -> None:
    """Coprime numbers that are no squares; each radicand is a square times some of them."""
    base = module._coprime_base({Fraction(n) for n in numbers})
    assert all(isqrt(b) ** 2 != b for b in base)
    assert all(gcd(x, y) == 1 for k, x in enumerate(base) for y in base[:k])
    for n in numbers:
        rest = n
        for b in base:
            while rest % b == 0:
                rest //= b
        assert isqrt(rest) ** 2 == rest


def law_directions(direction: Sequence[Fraction], *, is_rational: bool) -> None:
    """Components of unit vectors: of length one, and along the direction."""
    made = [Constant("unit", Fraction(k), direction=tuple(direction)) for k in range(3)]
    field = Field([] if is_rational else made)
    x, y, z = map(field.of, made)
    assert x * x + y * y + z * z == field.one
    length = sum((v * v for v in direction), Fraction(0))
    ball = flint.arb(flint.fmpq(length.numerator, length.denominator)).sqrt()
    for v, component in zip(direction, (x, y, z), strict=True):
        true = flint.arb(flint.fmpq(v.numerator, v.denominator)) / ball
        assert abs(component.ball - true) < flint.arb(2) ** (-230)
        if not is_rational:
            assert component.ball.overlaps(true)
    if not is_rational:
        a, b, c = map(field.rational, direction)
        assert x * b == y * a
        assert y * c == z * b


DIRECTIONS = [(1, 2, 3), (1, -1, 0), (0.6, 0.8, 0), (0.1, -0.2, -7), (0.123456, 0.654321, -0.3)]


@pytest.mark.parametrize("is_rational", [False, True])
@pytest.mark.parametrize("direction", DIRECTIONS)
def test_directions(direction: tuple[float, ...], is_rational: bool) -> None:
    law_directions([decimal(x) for x in direction], is_rational=is_rational)


def test_many_directions_need_no_prime_of_their_own() -> None:
    """Those with the longest decimals become rational vectors; the others keep their square roots."""
    random = np.random.default_rng(0)
    directions = [
        tuple(Fraction(int(x), 10**6) for x in random.integers(-(10**6), 10**6, 3)) for _ in range(30)
    ]
    made = [Constant("unit", Fraction(k), direction=d) for d in directions for k in range(3)]
    simple = Constant("unit", Fraction(0), direction=(Fraction(1), Fraction(2), Fraction(3)))
    field = Field([*made, simple])
    values = [field.of(one) for one in made]
    for k in range(0, len(values), 3):
        x, y, z = values[k : k + 3]
        assert x * x + y * y + z * z == field.one
    found = field.of(simple)
    assert found * found == field.rational(Fraction(1, 14))


@given(st.permutations(range(3)), st.tuples(*[st.sampled_from([-1, 1])] * 3))
def test_quarter_turns_and_reflections_are_those_of_rational_directions(
    order: list[int], signs: tuple[int, ...]
) -> None:
    """Where roots are too many, a loop that closes by a quarter turn closes exactly."""
    direction = tuple(decimal(x) for x in (0.55280671, -0.35278514, -0.39412288))
    turned = tuple(sign * direction[k] for k, sign in zip(order, signs, strict=True))
    unit = module._rational_unit(direction)
    expected = tuple(sign * unit[k] for k, sign in zip(order, signs, strict=True))
    assert module._rational_unit(turned) == expected
    assert sum(x * x for x in unit) == 1


def test_pi_is_transcendental() -> None:
    pi, deg = (FIELD.of(Constant("pi", Fraction(x))) for x in ("1", "1/180"))
    assert pi == FIELD.rational(180) * deg
    assert pi * pi != FIELD.rational(10)
    assert is_consistent(pi - FIELD.rational(Fraction("3.14159265358979323846")))


def test_no_prime(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "_MOST_PRIMES", 1)
    primes = [2, 3, 5, 7, 11, 13, 17, 19, 23, 29, 31, 37, 41, 43, 47, 53, 59, 61, 67, 71]
    with pytest.raises(AnalysisError, match=r"no prime was found modulo which 20 square roots"):
        Field([Constant("root", Fraction(p)) for p in primes])


@pytest.mark.parametrize("field", [FIELD, Field([Constant("root", Fraction(7))])])
def test_whole_numbers_below_2_to_the_60_are_not_zero(field: Field) -> None:
    """A multiple of the prime is zero modulo it, so the least one is beyond: 1e-18 is the chance."""
    whole = min(field.prime, 2**60 - 1)
    assert field.rational(whole)
    assert field.prime < 2**62  # the sum of two residues fits int64


def test_a_prime_that_does_not_tell_is_replaced() -> None:
    """A sum, a product of matrices, a constant of a graph that only a prime takes for zero, or equal."""
    prime = FIELD.prime
    rest = FIELD.rational(prime - 1)
    row = from_rows([{0: rest, 1: FIELD.one}], 2, prime)
    graph = SignalGraph(1, FIELD)
    graph.constant(FIELD.one)
    for make in (
        lambda: FIELD.rational(prime),
        lambda: rest + FIELD.one,
        lambda: row @ from_rows([{0: FIELD.one}, {0: FIELD.one}], 1, prime),
        lambda: row[:, :1] + row[:, 1:],
        lambda: graph.constant(Exact(rest.ball + 2, FIELD.one.residue)),
    ):
        with pytest.raises(TooFewBitsError):
            make()

    def whole() -> Exact:
        field = Field()
        return field.rational(prime - 1) + field.one

    assert float(in_enough_bits(whole, "")) == float(prime)


def test_bits_that_are_asked_for_come_at_once() -> None:
    tried = list[int]()

    def make() -> None:
        tried.append(flint.ctx.prec)
        ask_for_bits(8 * BITS)

    in_enough_bits(make, "")
    assert tried == [BITS, 8 * BITS]


def test_a_prime_by_its_index() -> None:
    """That of the bits otherwise: twice as many have the next one."""
    first = Field().prime
    with precision(2 * BITS):
        second = Field().prime
        with prime_of(0):
            assert Field().prime == first != second
    with prime_of(1):
        assert Field().prime == second
