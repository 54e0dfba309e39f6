"""Laws of parameters: the map physical <-> delta works both ways, on arrays, and meets its ends."""

from fractions import Fraction
from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import mbdlft
from mbdlft.base.parameter import to_internal
from tests.close import error, exact, roundoff

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
