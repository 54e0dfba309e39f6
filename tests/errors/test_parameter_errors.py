"""Errors of parameters, angles and units: class and message."""

import math

from mbdlft import Angle
from mbdlft.base.unit import parse_unit
from tests.errors.table import refused

INSIDE = "the nominal must lie strictly inside the range"


test_messages = refused(
    r"""
Parameter("m", 1, unit="kg") => SceneError: parameter 'm': … give the range in exactly one way: low and
    high, percent, or plus (and minus); got 0 of them.
Parameter("m", 0.0, percent=20) => parameter 'm': … percent
> Parameter("m", 1, unit="kg", {}) => SceneError: parameter 'm':
low=3, high=2 => low must be less than high, got low = 3.0 kg, high = 2.0 kg.
low=1, high=1 => low must be less than high, got low = 1.0 kg, high = 1.0 kg.
low=2, high=3 => the nominal must lie strictly inside the range, got nominal = 1.0, range [2.0, 3.0] kg.
low=1, high=3 => the nominal must lie strictly inside the range, got nominal = 1.0, range [1.0, 3.0] kg.
low=0, high=1 => the nominal must lie strictly inside the range, got nominal = 1.0, range [0.0, 1.0] kg.
plus=1, minus=-0.5
    => the nominal must lie strictly inside the range, got nominal = 1.0, range [1.5, 2.0] kg.
low=0, high=2, percent=10
    => give the range in exactly one way: low and high, percent, or plus (and minus); got 2 of them.
plus=1, percent=10
    => give the range in exactly one way: low and high, percent, or plus (and minus); got 2 of them.
low=0, percent=10, minus=1
    => give the range in exactly one way: low and high, percent, or plus (and minus); got 3 of them.
minus=1 => minus is given without plus.
high=2 => low is missing.
low=0 => high is missing.
low=0, high=math.inf => values must be finite, got nominal 1.0, low 0.0, high inf.
low=math.nan, high=2 => values must be finite
percent=math.nan => values must be finite
percent=10, role='known' => role is one of uncertain, scheduled, design; got 'known'.
percent=10, substitution='third-angle'
    => substitution is one of identity, half-angle, quarter-angle; got 'third-angle'.
> Parameter('m', 1.0, 0.5, 2.0, {}) => SceneError: parameter 'm':
{unit|role|substitution}={None|3|['kg']} => {0}: expected a text, got {1}.
> Angle('t', 1.0, 0.5, 2.0, {}) => SceneError:
{unit|substitution}={None|[]} => got {1}.
> {} => SceneError:
Parameter("m", 1.0, 0.5, 1.5, unit="kg", substitution="half-angle") => parameter 'm' … kg
> Parameter({}, 1.0, percent=10) => SceneError:
"" => parameter '': a name is made of letters, digits and underscores
"{2m|m 1|m-1|m.1}" => parameter '{0}': a name is made of letters, digits and underscores
> (lambda name, kind: kind(name, 1.0, 0.5, 2.0))({}) => SceneError:
{3|None}, {Parameter|Angle} => parameter {0}: name: expected a text, got {0}.
> Parameter("m", {}, 0.0, 2.0) => SceneError:
{"abc"|None|[1.0]|10**400} => parameter 'm'
> Angle("theta", 0, **{}) => SceneError: parameter 'theta': …
{"low": -181, "high": 10}
    => the range [-181.0, 10.0] deg reaches a singular point of the half-angle at -180 or 180 deg. Use
        substitution = 'quarter-angle'.
{"low": -10, "high": 180} => of the half-angle at -180 or 180 deg. Use substitution
{"low": -10, "high": 100, "reference": -90}
    => of the half-angle at -270 or 90 deg. Use substitution = 'quarter-angle'.
{"low": -3.2, "high": 1, "unit": "rad"}
    => of the half-angle at -3.14159 or 3.14159 rad. Use substitution
{"low": -400, "high": 10}
    => of the half-angle at -180 or 180 deg. Move the reference or narrow the range.
{"low": -361, "high": 10, "substitution": "quarter-angle"}
    => of the quarter-angle at -360 or 360 deg. Move the reference or narrow the range.
{"plus": 360, "substitution": "quarter-angle"} => of the quarter-angle at -360 or 360 deg.
{"low": -1, "high": 1, "substitution": "identity"}
    => substitution of an angle is 'half-angle' or 'quarter-angle', got 'identity'.
{"low": -1, "high": 1, "unit": "kg"} => an angle has unit 'deg' or 'rad', got 'kg'.
{} => give the range in exactly one way: low and high, percent, or plus (and minus); got 0 of them.
{"low": 1, "high": 2}
    => the nominal must lie strictly inside the range, got nominal = 0.0, range [1.0, 2.0] deg.
> parse_unit({}) => SceneError:
"kgg" => unit 'kgg': unknown symbol 'kgg'. Did you mean 'kg'? Existing:
"N m/furlong" => unit 'N m/furlong': unknown symbol 'furlong'. Existing:
"" => a unit is empty; write '1' for a dimensionless quantity.
"  " => a unit is empty; write '1' for a dimensionless quantity.
"m^2.5" => unit 'm^2.5' cannot be read at '.5'. Write symbols with integer powers
"(m)" => unit '(m)' cannot be read at '(m)'.
"m^" => unit 'm^' cannot be read at '^'.
"2 m" => unit '2 m' cannot be read at '2 m'.
> parse_unit({}) => SceneError:
"{kg*|/|kg // m|* m|mm^-999}" => unit '{0}'
> Parameter("m", 1.0, percent=10, unit={}) => SceneError: parameter 'm' … unit
{"kgg"|""|"m^2.5"}
> Angle("t", **{"nominal": 1.0, "low": 0.5, "high": 2.0, {}}) => SceneError: parameter 't':
"{nominal|low|high|reference}": {'abc'|[1.0]|10**400} => {0}: expected a number, got
"""
)


def test_angle_just_inside_its_reach():
    assert Angle("theta", 0, -179.9, 179.9).is_angle
    assert Angle("theta", 0, -359.9, 359.9, substitution="quarter-angle").is_angle
