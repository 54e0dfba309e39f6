"""Laws of constants in CasADi SX, and of literals.

1. with doubles in their places, expressions are what folding in doubles gives
2. directions have unit length, parallel ones are one, and zeros are zeros
3. functions of constants that are rational are, and have their relations otherwise
4. a literal is all of its digits
"""

import math
import pickle
from fractions import Fraction

import casadi as ca
import flint
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import mbdlft
from mbdlft import Parameter, realize
from mbdlft.base.errors import NotRationalError, SceneError
from mbdlft.base.expression import Number, evaluate, parse
from mbdlft.dae import DaeDraft
from mbdlft.exact.numbers import BITS, Constant, precision
from mbdlft.problem.sx import constants as module
from mbdlft.problem.sx.constants import (
    FUNCTIONS,
    constant,
    constants_in,
    cosine_sine,
    in_doubles,
    is_constant,
    is_zero,
    literal,
    numbers_of,
    root,
    unit_vector,
    without_zeros,
)
from tests.close import exact, roundoff

A, B = Parameter("a", 0.5, 0.3, 0.8), Parameter("b", 1.5, 1.0, 2.0)
decimals = st.integers(-(10**6), 10**6).map(lambda k: k / 1000.0)


@pytest.fixture(autouse=True)
def with_bits() -> object:
    with precision(BITS):
        yield


def value(expression: object) -> float:
    return float(numbers_of(ca.SX(expression))[0, 0])


# 1. doubles ----------------------------------------------------------------------------------------


@given(decimals, decimals, decimals)
def test_doubles_are_what_folding_gives(x: float, y: float, angle: float) -> None:
    p = ca.SX.sym("p")
    c, s = cosine_sine(angle)
    found = ca.SX(p + literal(x) * p + literal(y) * c - s * root(abs(y)))
    assert not is_constant(found)
    rounded = in_doubles(found)
    assert [symbol.name() for symbol in ca.symvar(rounded)] == ["p"]
    expected = 0.7 + x * 0.7 + y * math.cos(angle) - math.sin(angle) * math.sqrt(abs(y))
    size = abs(x) + abs(y) + math.sqrt(abs(y)) + 1.0
    roundoff(float(ca.Function("f", [p], [rounded])(0.7)), expected, 10.0, size)


@given(decimals)
def test_a_literal_is_next_to_its_double(x: float) -> None:
    assert value(literal(x)) == x
    assert value(literal(Fraction(str(x)))) == x


@pytest.mark.parametrize("x", [0.0, 1.0, -0.5, 3.25, 1.0 / 64.0, 1e6, 2.0**19])
def test_short_binary_fractions_stay_doubles(x: float) -> None:
    assert literal(x) == x
    assert isinstance(literal(x), float)


def test_one_symbol_for_each_number() -> None:
    assert ca.is_equal(ca.SX(literal(0.1)), ca.SX(literal(Fraction(1, 10))))
    assert not ca.is_equal(ca.SX(literal(0.1)), ca.SX(literal(0.2)))
    assert is_zero(literal(0.1) + literal(0.2) - literal(0.3))


NUMBERS = [
    Constant("rational", Fraction(-7, 100)),
    Constant("root", Fraction(3, 4)),
    Constant("cosine", Fraction(10)),
    Constant("sine", Fraction(1, 3), in_radians=True),
    Constant("pi", Fraction(1, 180)),
    Constant("unit", Fraction(2), direction=(Fraction(1), Fraction(0), Fraction(-2, 3))),
]


def test_a_symbol_says_what_it_stands_for() -> None:
    """Nothing is remembered: another process may have made it, and any number of others since."""
    symbols = [ca.SX.sym(constant(number).name()) for number in NUMBERS]
    assert constants_in(ca.vertcat(*symbols))[1] == tuple(NUMBERS)


@pytest.mark.parametrize(
    "name", ["constant 0", "constant", "constant rational x deg", "constant big 1 deg"]
)
def test_other_symbols_are_no_constants(name: str) -> None:
    assert not is_constant(ca.SX.sym(name))
    assert constants_in(ca.SX.sym(name))[1] == ()


@pytest.mark.parametrize("quarter", range(-5, 6))
def test_quarter_turns_are_numbers(quarter: int) -> None:
    angle = quarter * math.pi / 2.0
    assert cosine_sine(angle) == (float(round(math.cos(angle))), float(round(math.sin(angle))))


# 2. directions and zeros ----------------------------------------------------------------------------


@pytest.mark.parametrize(
    "direction", [(1.0, 2.0, 3.0), (0.1, 0.2, -0.2), (0.3, -0.4, 1e-9), (-0.6, 0.1, 0.7)]
)
def test_directions(direction: tuple[float, float, float]) -> None:
    found = unit_vector(direction)
    roundoff(numbers_of(found)[:, 0], np.array(direction) / np.linalg.norm(direction))
    assert is_zero(ca.dot(found, found) - 1.0)
    assert found.nnz() == np.count_nonzero(direction)
    doubled = unit_vector([Fraction(str(x)) * Fraction(-7, 3) for x in direction])
    assert is_zero(ca.cross(found, doubled))
    assert is_zero(found + doubled)
    off = [Fraction(str(x)) for x in direction]
    off[0] += Fraction(1, 10**30)
    assert not is_zero(ca.cross(found, unit_vector(off)))


@pytest.mark.parametrize("angle", [1e20, 1e299, -1.7e308])
def test_an_angle_of_any_size(angle: float) -> None:
    entry = f"cos({angle!r})*a + sin({angle!r})"
    model = realize([[entry]], [Parameter("a", 1.0, 0.5, 1.5)], search=0.0)
    with precision(4000):
        written = flint.arb(repr(angle))
        expected = float(written.cos() + written.sin())
    roundoff(model.lft.M22, [[expected]])


def test_directions_of_rational_length_are_rational() -> None:
    found = unit_vector((3.0, 0.0, 4.0))
    exact(numbers_of(found)[:, 0], [0.6, 0.0, 0.8])
    assert is_zero(found[0] - literal(0.6))
    exact(numbers_of(unit_vector((0.0, -2.0, 0.0)))[:, 0], [0.0, -1.0, 0.0])
    assert unit_vector((0.0, -2.0, 0.0)).nnz() == 1


def test_zeros_are_exact() -> None:
    c, s = cosine_sine(0.3)
    third = literal(0.1)
    column = ca.vertcat(
        c * c + s * s - 1.0, third * third - literal(0.01), third, ca.SX(literal(1e-30)), 0.0
    )
    found = without_zeros(column)
    assert found.sparsity().get_triplet()[0] == [2, 3]
    assert not is_zero(column)
    assert is_zero(column[:2])
    assert not is_zero(c * c + s * s - 1.0 + literal(Fraction(1, 10**60)))


# 3. functions ---------------------------------------------------------------------------------------


def test_functions_of_constants() -> None:
    sqrt, sin, cos, atan = (FUNCTIONS[name] for name in ("sqrt", "sin", "cos", "atan"))
    assert sqrt(6.25) == 2.5
    assert is_zero(sqrt(literal(0.1) + literal(0.2)) - sqrt(0.3))
    assert is_zero(sin(0.3) * sin(0.3) + cos(0.3) * cos(0.3) - 1.0)
    assert is_zero(cos(module.pi_times(Fraction(1, 3))) - 0.5)
    roundoff(value(atan(0.4)), math.atan(0.4))
    roundoff(value(module.pi_times(2)), 2.0 * math.pi)
    with pytest.raises(SceneError, match=r"sqrt of the negative number -2\."):
        sqrt(-2.0)
    with pytest.raises(NotRationalError, match=r"sin takes constants only\."):
        sin(ca.SX.sym("p"))


# 4. literals ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("text", ["0.1", "123456789012345678", "1e-30", "0.30000000000000000001"])
def test_a_literal_keeps_its_text(text: str) -> None:
    node = parse(text)
    assert isinstance(node, Number)
    assert repr(node.value) == text
    assert node.value == float(text)
    assert repr(pickle.loads(pickle.dumps(node.value))) == text
    assert evaluate(node, {}) == float(text)


def test_long_literals() -> None:
    """Digits beyond those of a double tell numbers apart, and cancel where they are equal."""
    for text, order in (
        ("100000000000000001*a - 100000000000000000*a", 1),
        ("100000000000000001*a - 100000000000000001*a", 0),
        ("a + 1e13*b - 1e13*b", 1),
        ("a + 0.123456789012345678*b - 0.123456789012345678*b", 1),
        ("0.1*a + 0.2*a - 0.30000000000000000001*a", 1),
    ):
        model = realize([[text]], [A, B], search=0.0)
        assert model.order == order, text
        assert model.certificate.minimal
    last = realize([["100000000000000001*a - 100000000000000000*a"]], [A], search=0.0)
    roundoff(mbdlft.matrices_at(last, {"a": 0.7}).D, [[0.7]])


def test_a_form_does_not_depend_on_constants_that_were_made_before() -> None:
    """A constant may get another symbol later; its product with the reciprocal of the first is not 1."""

    def arguments() -> list[str]:
        draft = DaeDraft("valve")
        x, v = draft.variable("x"), draft.variable("v")
        draft.equation(draft.der(x), equals=v)
        friction = draft.number(0.3) * ca.tanh(v / draft.number(0.2))
        draft.equation(draft.der(v), equals=-4 * x - x**3 - friction)
        draft.output("x")
        form = mbdlft.delta_theta(draft.dae(), search=0.0, prove=0.0)
        return [name for function in form.functions for name in function.signals]

    before = arguments()
    constant.cache_clear()
    assert arguments() == before == ["omega.x", "omega.v"]


def test_large_terms_that_cancel_are_zero() -> None:
    """In doubles 0.1 + 0.2 - 0.3 is 5.6e-17, which a large factor makes 5.6e-4."""
    tenths, large = literal(0.1) + literal(0.2) - literal(0.3), ca.SX(literal(1e13))
    assert is_zero(large * tenths)
    assert not is_zero(large * (tenths + literal(1e-17)))
