"""Errors of parameters, angles and units: class and message."""

import math

from mbdlft import Angle
from mbdlft.base.unit import parse_unit
from tests.errors.table import refused

INSIDE = "the nominal must lie strictly inside the range"


test_messages = refused(
    r"""
Parameter('m', 1, **{'unit': 'kg', **{'low': 3, 'high': 2}})
    => parameter 'm': … low must be less than high, got low = 3.0 kg, high = 2.0 kg.
Parameter('m', 1, **{'unit': 'kg', **{'low': 1, 'high': 1}})
    => parameter 'm': … low must be less than high, got low = 1.0 kg, high = 1.0 kg.
Parameter('m', 1, **{'unit': 'kg', **{'low': 2, 'high': 3}})
    => parameter 'm': … the nominal must lie strictly inside the range, got nominal = 1.0, range [2.0,
        3.0] kg.
Parameter('m', 1, **{'unit': 'kg', **{'low': 1, 'high': 3}})
    => parameter 'm': … the nominal must lie strictly inside the range, got nominal = 1.0, range [1.0,
        3.0] kg.
Parameter('m', 1, **{'unit': 'kg', **{'low': 0, 'high': 1}})
    => parameter 'm': … the nominal must lie strictly inside the range, got nominal = 1.0, range [0.0,
        1.0] kg.
Parameter('m', 1, **{'unit': 'kg', **{'plus': 1, 'minus': -0.5}})
    => parameter 'm': … the nominal must lie strictly inside the range, got nominal = 1.0, range [1.5,
        2.0] kg.
Parameter('m', 1, **{'unit': 'kg', **{}})
    => parameter 'm': … give the range in exactly one way: low and high, percent, or plus (and minus);
        got 0 of them.
Parameter('m', 1, **{'unit': 'kg', **{'low': 0, 'high': 2, 'percent': 10}})
    => parameter 'm': … give the range in exactly one way: low and high, percent, or plus (and minus);
        got 2 of them.
Parameter('m', 1, **{'unit': 'kg', **{'plus': 1, 'percent': 10}})
    => parameter 'm': … give the range in exactly one way: low and high, percent, or plus (and minus);
        got 2 of them.
Parameter('m', 1, **{'unit': 'kg', **{'low': 0, 'percent': 10, 'minus': 1}})
    => parameter 'm': … give the range in exactly one way: low and high, percent, or plus (and minus);
        got 3 of them.
Parameter('m', 1, **{'unit': 'kg', **{'minus': 1}}) => parameter 'm': … minus is given without plus.
Parameter('m', 1, **{'unit': 'kg', **{'high': 2}}) => parameter 'm': … low is missing.
Parameter('m', 1, **{'unit': 'kg', **{'low': 0}}) => parameter 'm': … high is missing.
Parameter('m', 1, **{'unit': 'kg', **{'low': 0, 'high': math.inf}})
    => parameter 'm': … values must be finite, got nominal 1.0, low 0.0, high inf.
Parameter('m', 1, **{'unit': 'kg', **{'low': math.nan, 'high': 2}})
    => parameter 'm': … values must be finite
Parameter('m', 1, **{'unit': 'kg', **{'percent': math.nan}}) => parameter 'm': … values must be finite
Parameter('m', 1, **{'unit': 'kg', **{'percent': 10, 'role': 'known'}})
    => parameter 'm': … role is one of uncertain, scheduled, design; got 'known'.
Parameter('m', 1, **{'unit': 'kg', **{'percent': 10, 'substitution': 'third-angle'}})
    => parameter 'm': … substitution is one of identity, half-angle, quarter-angle; got 'third-angle'.
Parameter("m", 0.0, percent=20) => parameter 'm': … percent
Parameter('m', 1.0, 0.5, 2.0, unit=None) => parameter 'm': unit: expected a text, got None.
Parameter('m', 1.0, 0.5, 2.0, unit=3) => parameter 'm': unit: expected a text, got 3.
Parameter('m', 1.0, 0.5, 2.0, unit=['kg']) => parameter 'm': unit: expected a text, got ['kg'].
Parameter('m', 1.0, 0.5, 2.0, role=None) => parameter 'm': role: expected a text, got None.
Parameter('m', 1.0, 0.5, 2.0, role=3) => parameter 'm': role: expected a text, got 3.
Parameter('m', 1.0, 0.5, 2.0, role=['kg']) => parameter 'm': role: expected a text, got ['kg'].
Parameter('m', 1.0, 0.5, 2.0, substitution=None)
    => parameter 'm': substitution: expected a text, got None.
Parameter('m', 1.0, 0.5, 2.0, substitution=3) => parameter 'm': substitution: expected a text, got 3.
Parameter('m', 1.0, 0.5, 2.0, substitution=['kg'])
    => parameter 'm': substitution: expected a text, got ['kg'].
Angle('t', 1.0, 0.5, 2.0, unit=None) => got None.
Angle('t', 1.0, 0.5, 2.0, unit=[]) => got [].
Angle('t', 1.0, 0.5, 2.0, substitution=None) => got None.
Angle('t', 1.0, 0.5, 2.0, substitution=[]) => got [].
Parameter("m", 1.0, 0.5, 1.5, unit="kg", substitution="half-angle") => parameter 'm' … kg
> Parameter({}, 1.0, percent=10) => SceneError:
"" => parameter '': a name is made of letters, digits and underscores
"2m" => parameter '2m': a name is made of letters, digits and underscores
"m 1" => parameter 'm 1': a name is made of letters, digits and underscores
"m-1" => parameter 'm-1': a name is made of letters, digits and underscores
"m.1" => parameter 'm.1': a name is made of letters, digits and underscores
> (lambda name, kind: kind(name, 1.0, 0.5, 2.0))({}) => SceneError:
3, Parameter => parameter 3: name: expected a text, got 3.
3, Angle => parameter 3: name: expected a text, got 3.
None, Parameter => parameter None: name: expected a text, got None.
None, Angle => parameter None: name: expected a text, got None.
> Parameter("m", {}, 0.0, 2.0) => SceneError:
"abc" => parameter 'm'
None => parameter 'm'
[1.0] => parameter 'm'
10**400 => parameter 'm'
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
"kg*" => unit 'kg*'
"/" => unit '/'
"kg // m" => unit 'kg // m'
"* m" => unit '* m'
"mm^-999" => unit 'mm^-999'
> Parameter("m", 1.0, percent=10, unit={}) => SceneError: parameter 'm' … unit
"kgg"
""
"m^2.5"
> Angle("t", **{"nominal": 1.0, "low": 0.5, "high": 2.0, {}}) => SceneError: parameter 't':
"nominal": 'abc' => nominal: expected a number, got
"nominal": [1.0] => nominal: expected a number, got
"nominal": 10**400 => nominal: expected a number, got
"low": 'abc' => low: expected a number, got
"low": [1.0] => low: expected a number, got
"low": 10**400 => low: expected a number, got
"high": 'abc' => high: expected a number, got
"high": [1.0] => high: expected a number, got
"high": 10**400 => high: expected a number, got
"reference": 'abc' => reference: expected a number, got
"reference": [1.0] => reference: expected a number, got
"reference": 10**400 => reference: expected a number, got
"""
)


def test_angle_just_inside_its_reach():
    assert Angle("theta", 0, -179.9, 179.9).is_angle
    assert Angle("theta", 0, -359.9, 359.9, substitution="quarter-angle").is_angle
