"""Messages say what was meant: signals, units, factors without units, equilibria of what accelerates."""

import pytest

import mbdlft
from mbdlft import SceneError
from mbdlft.base.errors import unknown_name
from mbdlft.base.expression import parse
from mbdlft.base.unit import parse_unit
from mbdlft.show.report.content import _said
from tests import kit
from tests.close import CLOSED_FORM, target
from tests.errors.table import refused, says

SIGNALS = (
    *("flight.rate.x", "flight.position.x", "flight.rotation.x"),
    *("road.position", "road.velocity", "pivot.angle", "pivot.rate", "push.force"),
)


def meant(*names: object) -> None:
    raise SceneError(unknown_name(*names))  # type: ignore[arg-type]


test_messages = refused(
    r"""
parse_unit("lb") => unknown symbol 'lb'. Existing
parse('1 kg') => of constants. … A unit stands in brackets, '1 [kg]'; a product has a sign, 1*name.
parse("a b") => of constants. … A product has a sign: * before b.
parse("a 2") =~ of constants\.$
parse('0.002 N m s/rad') => of constants. … A unit stands in brackets, '0.002 [N m s/rad]'
parse('{20 deg|20°}') => of constants. … Degrees are written 20*deg.
parse('2l') => of constants. … A product has a sign: 2*l.
mbdlft.scene_from_toml("mass = m") => not valid TOML: … Texts stand in quotes
> meant("signal", {}, SIGNALS) => SceneError:
"flight.x" => Did you mean 'flight.position.x'?
"road.rate" => Did you mean 'road.velocity'?
"pivot.position" => Did you mean 'pivot.angle'?
"pivot.theta" => Did you mean 'pivot.angle'?
"pivot.velocity" => Did you mean 'pivot.rate'?
"push.effort" => Did you mean 'push.force'?
"flight.velocity.x" => Did you mean 'flight.rate.x'?
"fligt.rate.x" => Did you mean 'flight.rate.x'?
"Pivot.Angle" => Did you mean 'pivot.angle'?
> meant({}) => SceneError:
"key", "hinge", ("fixed", "revolute", "planar") => Did you mean 'revolute'?
"key", "friction", ("orientation", "damping") => Did you mean 'damping'?
"key", "angle", ("damping", "position") => Did you mean 'position'?
"name", "g", ("deg", "l") =~ ^(?!.*Did you mean)
> parse_unit({}) => SceneError:
"metre" => unit 'metre': unknown symbol … Did you mean 'm'?
"Meters/s" => unit 'Meters/s': unknown symbol … Did you mean 'm'?
"kilometres" => unit 'kilometres': unknown symbol … Did you mean 'km'?
"kilograms" => unit 'kilograms': unknown symbol … Did you mean 'kg'?
"Nm" => unit 'Nm': unknown symbol … Did you mean 'N m'?
"degrees" => unit 'degrees': unknown symbol … Did you mean 'deg'?
"rad/sec" => unit 'rad/sec': unknown symbol … Did you mean 's'?
"KG" => unit 'KG': unknown symbol … Did you mean 'kg'?
"newton/m" => unit 'newton/m': unknown symbol … Did you mean 'N'?
"kNN" => unit 'kNN': unknown symbol … Did you mean 'N'?
> (lambda mass, unit: mbdlft.to_lft(mbdlft.Scene(name='s', parameters=[mbdlft.Parameter('m', 2.0,
    percent=10, unit=unit), mbdlft.Parameter('l', 2.0, percent=10, unit='m')],
    bodies=[mbdlft.PointMass(name='b', mass=mass)], joints=[mbdlft.Prismatic(name='j', parent='ground',
    child='b', axis=(1, 0, 0))])))({}) => SceneError: the unit does not fit …
"m", "1" => 'm' has no unit: declare it with unit = 'kg', or give a number a unit
"m*l", "1" => 'm' has no unit: declare it with unit = 'kg m^-1'
"2*l", "kg" => write it behind the number, such as 2.0 [kg m^-1], or declare
"l*l", "kg" => expected kg, got m^2.
"""
)


def test_motions_of_bodies_are_those_of_sensors() -> None:
    body = kit.point("cart", 1.0, ports={"top": (0, 0, 1)})
    for output, port in (("top.x", "cart.top"), ("cart.x", "cart")):
        scene = kit.scene("s", body, kit.rail("j", "ground", "cart", (1, 0, 0)), outputs=[output])
        with says(mbdlft.SceneError, f"signal {output!r}", f"port = {port!r} has the outputs"):
            mbdlft.to_lft(scene)


def test_a_rocket_accelerates() -> None:
    rocket = kit.scene(
        "rocket",
        kit.point("b", 2.0),
        kit.rail("up", "ground", "b", (0, 0, 1), preload=0),
        kit.force("thrust", "b", (0, 0, 1), magnitude=50.0),
        gravity=(0, 0, -9.81),
    )
    with says(mbdlft.TrimError, "up.force misses", "the scene's acceleration 'unknown'"):
        mbdlft.to_lft(rocket)
    flying = rocket.model_copy(update={"acceleration": (0.0, 0.0, "unknown")})
    found = mbdlft.trim_at(mbdlft.to_lft(flying, search=0.0), {})
    target(found, [50.0 / 2.0 - 9.81], CLOSED_FORM)


def test_why_a_gain_is_infinite() -> None:
    """A damper that may be negative: the reason is in the result, and in what verify says."""
    d = mbdlft.Parameter("d", 1.0, low=-0.5, high=2.5, unit="N s/m")
    scene = kit.scene(
        "s", d, kit.point("b", 1.0), kit.rail("j", "ground", "b", (1, 0, 0), stiffness=1.0, damping="d")
    )
    with pytest.warns(mbdlft.MbdlftWarning, match="damping is negative"):
        model = mbdlft.to_lft(scene, search=0.0)
    for found in (mbdlft.worst_case_gain(model), mbdlft.worst_case(model, "H2 norm")):
        assert found.lower == float("inf")
        assert "unstable at the worst case, a value inside the ranges" in found.reason
        wrong = mbdlft.verify(model, found)
        assert wrong == f"there is no proof: {found.reason}"
        said = " ".join(_said(found, wrong))
        assert "It is infinite: there is no bound to prove. Why: the system is unstable" in said
