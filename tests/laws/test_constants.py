"""Laws of constants in CasADi SX, and of literals."""

import math
import pickle
from fractions import Fraction
from itertools import product

import casadi as ca
import flint
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import mbdlft
from mbdlft import Parameter, realize
from mbdlft.base import expression
from mbdlft.base.errors import NotRationalError, SceneError
from mbdlft.base.expression import Number, evaluate, parse
from mbdlft.base.parameter import to_internal
from mbdlft.exact.numbers import Constant, precision
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
from tests.close import error, exact, roundoff
from tests.daes import dae_of
from tests.extracted import with_bits as with_bits

A, B = Parameter("a", 0.5, 0.3, 0.8), Parameter("b", 1.5, 1.0, 2.0)
decimals = st.integers(-(10**6), 10**6).map(lambda k: k / 1000.0)


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


def test_a_literal_with_more_digits_than_a_double_keeps_them() -> None:
    """Its double is a whole number, and it is not."""
    _, (known,) = constants_in(ca.SX(literal(expression.Literal("3.00000000000000000001"))))
    assert known.argument == 3 + Fraction(1, 10**20)
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
    third = literal(Fraction(1, 3))
    assert is_zero(sqrt(third) * sqrt(third) - third)
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
        law = "der(v) = -4*x - x**3 - number(0.3)*tanh(v/number(0.2))"
        dae = dae_of("valve", "x v", "der(x) = v", law, outputs="x")
        form = mbdlft.delta_theta(dae, search=0.0, prove=0.0)
        return [name for function in form.functions for name in function.signals]

    before = arguments()
    constant.cache_clear()
    assert arguments() == before == ["omega.x", "omega.v"]


def test_large_terms_that_cancel_are_zero() -> None:
    """In doubles 0.1 + 0.2 - 0.3 is 5.6e-17, which a large factor makes 5.6e-4."""
    tenths, large = literal(0.1) + literal(0.2) - literal(0.3), ca.SX(literal(1e13))
    assert is_zero(large * tenths)
    assert not is_zero(large * (tenths + literal(1e-17)))


# Expressions; `tests/attack/expressions.py` has values of drawn texts against Python's.


@pytest.mark.parametrize("text", ["(a^2)^3", "(-a)^2", "-a^2", "a/(b/c)", "a - (b - c)", "sin(a + 1)"])
def test_written_text_is_read_back(text: str) -> None:
    tree = expression.parse(text)
    assert expression.parse(expression.write(tree)) == tree


def test_nothing_is_run_as_code() -> None:
    for text in ("__import__('os')", "().__class__", "a if b else c", "a[0]", "lambda: 1", "a;b"):
        with pytest.raises(SceneError):
            expression.evaluate(expression.parse(text), {})


# Laws of parameters: the map physical <-> delta works both ways, on arrays, and meets its ends.

SIZES = st.floats(1e-9, 1e9)


@st.composite
def parameters(draw: st.DrawFn) -> mbdlft.Parameter:
    if draw(st.booleans()):
        quarter = draw(st.booleans())
        reach = 350.0 if quarter else 170.0
        nominal = draw(st.floats(-180.0, 180.0))
        low = nominal - draw(st.floats(1.0, reach))
        high = nominal + draw(st.floats(1.0, reach))
        return mbdlft.Angle(
            "t", nominal, low, high, substitution="quarter-angle" if quarter else "half-angle"
        )
    nominal = draw(st.floats(-1e6, 1e6))
    size = draw(SIZES) * max(abs(nominal), 1e-3) * 1e-3
    return mbdlft.Parameter("p", nominal, plus=size, minus=size * draw(st.floats(0.05, 20.0)))


@given(parameters())
def test_ends_and_nominal(p: mbdlft.Parameter) -> None:
    kappa = 1e3 * (1 + max(abs(p.low), abs(p.high)) / (p.high - p.low)) / (1 - abs(p.map.a1))
    found = mbdlft.to_delta(p, [p.low, p.nominal, p.high])
    roundoff(found, [-1.0, 0.0, 1.0], kappa)
    assert abs(p.map.a1) < 1


@given(parameters(), st.lists(st.floats(-1.0, 1.0), min_size=1, max_size=5))
def test_there_and_back(p: mbdlft.Parameter, deltas: list[float]) -> None:
    grid = np.array(deltas).reshape(1, -1)
    physical = mbdlft.to_physical(p, grid)
    assert physical.shape == grid.shape
    size = max(abs(p.low), abs(p.high), p.high - p.low)
    width = size / (p.high - p.low)
    back = mbdlft.to_delta(p, physical)
    roundoff(back, grid, 1e4 * width / (1 - abs(p.map.a1)) ** 2, scale=1.0)
    assert np.all((physical >= p.low - 1e-6 * size) & (physical <= p.high + 1e-6 * size))
    assert np.all(np.diff(mbdlft.to_physical(p, np.linspace(-1, 1, 9))) > 0)


def test_centered_ranges_are_affine() -> None:
    p = mbdlft.Parameter("m", 3.0, percent=20, unit="kg")
    assert p.map.a1 == 0.0
    roundoff([p.low, p.high, p.map.b1], [2.4, 3.6, 0.6])
    exact(mbdlft.to_delta(p, 3.0), 0.0)
    assert mbdlft.Parameter("m", 3.0, plus=0.5) == mbdlft.Parameter("m", 3.0, 2.5, 3.5)


def test_a_delta_that_no_value_has_is_infinite() -> None:
    """Without a warning; 3 here, where the worst case of a range without end is."""
    assert mbdlft.to_physical(mbdlft.Parameter("p", 1.0, 0.5, 2.0), 3.0) == np.inf
    assert mbdlft.Parameter("m", 3.0, plus=0.5, minus=1.0) == mbdlft.Parameter("m", 3.0, 2.0, 3.5)


def test_substitutions_by_their_definition() -> None:
    half = mbdlft.Angle("t", 30.0, -60.0, 150.0)
    roundoff(to_internal(half, 90.0), np.tan(np.radians(30.0)))
    paper = mbdlft.Angle("t", 70.0, 45.0, 90.0, reference=0.0)
    roundoff(to_internal(paper, 70.0), np.tan(np.radians(35.0)))
    quarter = mbdlft.Angle("t", 0.0, -180.0, 180.0, substitution="quarter-angle")
    roundoff(to_internal(quarter, 180.0), 1.0)
    assert error(mbdlft.to_physical(quarter, [-1.0, 1.0]), [-180.0, 180.0]) < 1e-12 * 1e3


@pytest.mark.parametrize(
    ("text", "factor", "dimension"),
    [
        ("kg", 1.0, (1, 0, 0)),
        ("g", 1e-3, (1, 0, 0)),
        ("mm", 1e-3, (0, 1, 0)),
        ("km", 1e3, (0, 1, 0)),
        ("t", 1e3, (1, 0, 0)),
        ("N m/rad", 1.0, (1, 2, -2)),
        ("kg*m^2", 1.0, (1, 2, 0)),
        ("kN/mm", 1e6, (1, 0, -2)),
        ("N m s/deg", 180.0 / np.pi, (1, 2, -1)),
        ("m s^-2", 1.0, (0, 1, -2)),
        ("1", 1.0, (0, 0, 0)),
        ("%", 0.01, (0, 0, 0)),
        ("rpm", np.pi / 30.0, (0, 0, -1)),
        ("Pa", 1.0, (1, -1, -2)),
        ("mJ", 1e-3, (1, 2, -2)),
        ("kW", 1e3, (1, 2, -3)),
        ("rev/min", np.pi / 30.0, (0, 0, -1)),
    ],
)
def test_units(text: str, factor: float, dimension: tuple[int, int, int]) -> None:
    from mbdlft.base.unit import parse_unit

    unit = parse_unit(text)
    roundoff(unit.factor, factor)
    assert unit.dimension == (*dimension, 0, 0)


PREFIXES = {"": 0, "n": -9, "u": -6, "m": -3, "c": -2, "d": -1, "k": 3, "M": 6, "G": 9}
EXACT = {"m": 0, "g": -3, "t": 3, "N": 0, "Pa": 0, "J": 0, "s": 0, "rad": 0}


def test_exact_units() -> None:
    """A decimal in a unit is a decimal in SI units: 1 mm^3 is 1e-9 m^3, in all digits."""
    from mbdlft.base.expression import parse
    from mbdlft.base.unit import parse_unit

    for (prefix, size), (name, own), power in product(PREFIXES.items(), EXACT.items(), (-9, -3, 1, 4)):
        unit = f"{prefix}{name}^{power}"
        expected = Fraction(10) ** (power * (size + own))
        assert parse_unit(unit).factor == float(expected)
        assert Fraction(repr(parse(f"0.1234567890123456789 [{unit} m]").value)) == (
            Fraction(1234567890123456789, 10**19) * expected
        )
    scene = mbdlft.Scene(
        name="two masses",
        constants={
            "c": mbdlft.Constant(value=2.7, unit="g"),
            "d": mbdlft.Constant(value=27.0, unit="cg"),
        },
        bodies=[],
    )
    values = scene.constant_values()
    assert (repr(values["c"]), repr(values["d"])) == ("0.0027", "0.00027")
