"""Errors of parameters, angles and units: class and message."""

import math

import pytest

from mbdlft import Angle, Parameter, SceneError
from mbdlft.base.unit import parse_unit
from tests.errors.scenes import says

INSIDE = "the nominal must lie strictly inside the range"
ONE_WAY = "give the range in exactly one way: low and high, percent, or plus (and minus); got "


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"low": 3, "high": 2}, "low must be less than high, got low = 3.0 kg, high = 2.0 kg."),
        ({"low": 1, "high": 1}, "low must be less than high, got low = 1.0 kg, high = 1.0 kg."),
        ({"low": 2, "high": 3}, f"{INSIDE}, got nominal = 1.0, range [2.0, 3.0] kg."),
        ({"low": 1, "high": 3}, f"{INSIDE}, got nominal = 1.0, range [1.0, 3.0] kg."),
        ({"low": 0, "high": 1}, f"{INSIDE}, got nominal = 1.0, range [0.0, 1.0] kg."),
        ({"plus": 1, "minus": -0.5}, f"{INSIDE}, got nominal = 1.0, range [1.5, 2.0] kg."),
        ({}, f"{ONE_WAY}0 of them."),
        ({"low": 0, "high": 2, "percent": 10}, f"{ONE_WAY}2 of them."),
        ({"plus": 1, "percent": 10}, f"{ONE_WAY}2 of them."),
        ({"low": 0, "percent": 10, "minus": 1}, f"{ONE_WAY}3 of them."),
        ({"minus": 1}, "minus is given without plus."),
        ({"high": 2}, "low is missing."),
        ({"low": 0}, "high is missing."),
        (
            {"low": 0, "high": math.inf},
            "values must be finite, got nominal 1.0, low 0.0, high inf.",
        ),
        ({"low": math.nan, "high": 2}, "values must be finite"),
        ({"percent": math.nan}, "values must be finite"),
        (
            {"percent": 10, "role": "known"},
            "role is one of uncertain, scheduled, design; got 'known'.",
        ),
        (
            {"percent": 10, "substitution": "third-angle"},
            "substitution is one of identity, half-angle, quarter-angle; got 'third-angle'.",
        ),
    ],
)
def test_range_and_role(fields, message):
    with says(SceneError, "parameter 'm': ", message):
        Parameter("m", 1, **{"unit": "kg", **fields})


@pytest.mark.parametrize("name", ["", "2m", "m 1", "m-1", "m.1"])
def test_name(name):
    with says(SceneError, f"parameter {name!r}: a name is made of letters, digits and underscores"):
        Parameter(name, 1.0, percent=10)


def test_percent_of_zero_says_that_the_nominal_is_zero():
    with says(SceneError, "parameter 'm': ", "percent"):
        Parameter("m", 0.0, percent=20)


@pytest.mark.parametrize("field", ["unit", "role", "substitution"])
@pytest.mark.parametrize("value", [None, 3, ["kg"]])
def test_text_that_is_none(field, value):
    with says(SceneError, f"parameter 'm': {field}: expected a text, got {value!r}."):
        Parameter("m", 1.0, 0.5, 2.0, **{field: value})


@pytest.mark.parametrize("name", [3, None])
@pytest.mark.parametrize("kind", [Parameter, Angle])
def test_name_that_is_no_text(kind, name):
    with says(SceneError, f"parameter {name}: name: expected a text, got {name}."):
        kind(name, 1.0, 0.5, 2.0)


@pytest.mark.parametrize("value", ["abc", [1.0], 10**400])
@pytest.mark.parametrize("field", ["nominal", "low", "high", "reference"])
def test_number_of_an_angle_that_is_none(field, value):
    with says(SceneError, f"parameter 't': {field}: expected a number, got "):
        Angle("t", **{"nominal": 1.0, "low": 0.5, "high": 2.0, field: value})


@pytest.mark.parametrize(
    ("field", "value"), [("unit", None), ("unit", []), ("substitution", None), ("substitution", [])]
)
def test_text_of_an_angle_that_is_none(field, value):
    with says(SceneError, f"got {value!r}."):
        Angle("t", 1.0, 0.5, 2.0, **{field: value})


@pytest.mark.parametrize("value", ["abc", None, [1.0], 10**400])
def test_nominal_that_is_not_a_number(value):
    with says(SceneError, "parameter 'm'"):
        Parameter("m", value, 0.0, 2.0)


def test_half_angle_of_a_mass():
    with says(SceneError, "parameter 'm'", "kg"):
        Parameter("m", 1.0, 0.5, 1.5, unit="kg", substitution="half-angle")


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        (
            {"low": -181, "high": 10},
            "the range [-181.0, 10.0] deg reaches a singular point of the half-angle at -180 or "
            "180 deg. Use substitution = 'quarter-angle'.",
        ),
        ({"low": -10, "high": 180}, "of the half-angle at -180 or 180 deg. Use substitution"),
        (
            {"low": -10, "high": 100, "reference": -90},
            "of the half-angle at -270 or 90 deg. Use substitution = 'quarter-angle'.",
        ),
        (
            {"low": -3.2, "high": 1, "unit": "rad"},
            "of the half-angle at -3.14159 or 3.14159 rad. Use substitution",
        ),
        (
            {"low": -400, "high": 10},
            "of the half-angle at -180 or 180 deg. Move the reference or narrow the range.",
        ),
        (
            {"low": -361, "high": 10, "substitution": "quarter-angle"},
            "of the quarter-angle at -360 or 360 deg. Move the reference or narrow the range.",
        ),
        (
            {"plus": 360, "substitution": "quarter-angle"},
            "of the quarter-angle at -360 or 360 deg.",
        ),
        (
            {"low": -1, "high": 1, "substitution": "identity"},
            "substitution of an angle is 'half-angle' or 'quarter-angle', got 'identity'.",
        ),
        ({"low": -1, "high": 1, "unit": "kg"}, "an angle has unit 'deg' or 'rad', got 'kg'."),
        ({}, f"{ONE_WAY}0 of them."),
        ({"low": 1, "high": 2}, f"{INSIDE}, got nominal = 0.0, range [1.0, 2.0] deg."),
    ],
)
def test_angle(fields, message):
    with says(SceneError, "parameter 'theta': ", message):
        Angle("theta", 0, **fields)


def test_angle_just_inside_its_reach():
    assert Angle("theta", 0, -179.9, 179.9).is_angle
    assert Angle("theta", 0, -359.9, 359.9, substitution="quarter-angle").is_angle


@pytest.mark.parametrize(
    ("unit", "message"),
    [
        ("kgg", "unit 'kgg': unknown symbol 'kgg'. Did you mean 'kg'? Existing: "),
        ("N m/furlong", "unit 'N m/furlong': unknown symbol 'furlong'. Existing: "),
        ("", "a unit is empty; write '1' for a dimensionless quantity."),
        ("  ", "a unit is empty; write '1' for a dimensionless quantity."),
        ("m^2.5", "unit 'm^2.5' cannot be read at '.5'. Write symbols with integer powers"),
        ("(m)", "unit '(m)' cannot be read at '(m)'."),
        ("m^", "unit 'm^' cannot be read at '^'."),
        ("2 m", "unit '2 m' cannot be read at '2 m'."),
    ],
)
def test_unit(unit, message):
    with says(SceneError, message):
        parse_unit(unit)


@pytest.mark.parametrize("unit", ["kg*", "/", "kg // m", "* m", "mm^-999"])
def test_unit_that_is_not_a_product_of_symbols(unit):
    with says(SceneError, f"unit {unit!r}"):
        parse_unit(unit)


@pytest.mark.parametrize("unit", ["kgg", "", "m^2.5"])
def test_unit_of_a_parameter_names_the_parameter(unit):
    with says(SceneError, "parameter 'm'", "unit"):
        Parameter("m", 1.0, percent=10, unit=unit)
