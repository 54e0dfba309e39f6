"""Errors of the values of a scene: units, physics, rationality, denominators over the range."""

import subprocess
import sys

import pytest

from mbdlft import Inertia, Parameter, Revolute, RigidBody, Scene, SceneError, assemble
from tests import kit
from tests.errors.scenes import arm, cart, spinner
from tests.errors.table import refused, says

SECONDS = 120.0  # the program is stopped then: it hangs
MASS, LENGTH = 'mass = "m1"', 'ports.tip = [0, "L1", 0]'


test_messages = refused(
    r"""
> {} => NotRationalError:
arm('position = "theta1"', 'position = "L1"') => SceneError: joint 'shoulder', position = 'L1' … m
Parameter("a", 10, 0, 20, unit="deg")
    => SceneError: parameter 'a': a parameter in deg is an angle; declare it as an Angle.
arm('mass = "m3"', 'mass = "m3 - 4"') => accepted
assemble(spinner(xx=1.0, yy=1.0, zz=2.0)) => accepted
assemble(spinner(xx=0.0)) => accepted
assemble(Scene(name='s', bodies=[RigidBody(name='b', mass=1.0)], joints=[Prismatic(name='j',
    parent='ground', child='b', axis=(1, 0, 0))]))
    => accepted
> arm('position = "theta1"', 'position = "{}"') => NotRationalError: joint 'shoulder', position =
{0.5*theta1|theta1/2|2/theta1|theta1*theta2|theta1^2|theta1^-1|pi*theta1}
    => '{0}': an angle parameter can be multiplied by an integer only
sin(theta1) => 'sin(theta1)': sin(theta1) is not
90*deg - 2*(theta1 - theta2) => accepted
> {} => NotRationalError:
arm(MASS, 'mass = "m1/(L1 - 1)"')
    => SceneError: body 'link1', mass = 'm1/(L1 - 1)': division by zero in a constant.
arm(MASS, 'mass = "m1^2/(m1/(L1 - 1))"')
    => SceneError: body 'link1', mass = 'm1^2/(m1/(L1 - 1))': division by zero in a constant.
arm(MASS, 'mass = "m1*sqrt(-L1)"')
    => SceneError: body 'link1', mass = 'm1*sqrt(-L1)': sqrt of the negative number -1.0.
> arm({}) => SceneError:
MASS, 'mass = "m11"'
    => body 'link1', mass = 'm11': unknown name 'm11'. Did you mean 'm1'? Existing: J1, L1,
MASS, 'mass = "m1/(m1*zz)"'
    => body 'link1', mass = 'm1/(m1*zz)': unknown name 'zz'. Existing: J1, L1,
'"rho1*L1"', '"rho*L1"'
    => body 'link1', center_of_mass.y = 'rho*L1': unknown name 'rho'. Did you mean 'rho1'?
'position = "theta1"', 'position = "theta"'
    => joint 'shoulder', position = 'theta': unknown name 'theta'. Did you mean 'theta2'?
"0.0, -9.81]", '0.0, "-g"]' => scene 'two_link_arm', gravity.z = '-g': unknown name 'g'.
> arm({}) => SceneError:
MASS, 'mass = "L2"' => body 'link1', mass = 'L2': the unit does not fit: expected kg, got m.
MASS, 'mass = "1/2.0 [m^4]"'
    => A unit belongs to the number before it: behind a divisor it divides … such as 1.0 [kg]/2.0.
MASS, 'mass = "m1*m3"' => the unit does not fit: expected kg, got kg^2.
MASS, 'mass = "m1/m3"' => the unit does not fit: expected kg, got 1.
MASS, 'mass = "L1"' => body 'link1', mass = 'L1': the unit does not fit: expected kg, got m.
MASS, 'mass = "m1 + L2"' => mass = 'm1 + L2': kg and m are added; units do not fit.
MASS, 'mass = "m1 - J1"' => mass = 'm1 - J1': kg and kg m^2 are added; units do not fit.
'{ xx = "J1" }', '{ xx = "m1*L2" }'
    => body 'link1', inertia.xx = 'm1*L2': the unit does not fit: expected kg m^2, got kg m.
LENGTH, 'ports.tip = [0, "m1", 0]'
    => body 'link1', ports.tip.y = 'm1': the unit does not fit: expected m, got kg.
"stiffness = 0.1", 'stiffness = "m3"'
    => joint 'shoulder', stiffness = 'm3': the unit does not fit: expected N m/rad, got kg.
"damping = 0.1", 'damping = "m3"'
    => joint 'shoulder', damping = 'm3': the unit does not fit: expected N m s/rad, got kg.
"0.0, -9.81]", '0.0, "-L2"]'
    => scene 'two_link_arm', gravity.z = '-L2': the unit does not fit: expected m s^-2, got m.
MASS, 'mass = "theta1"'
    => body 'link1', mass = 'theta1': 'theta1' has unit 'deg', which does not fit. An angle parameter
        can be the position of a joint, or in an orientation. Elsewhere … t = tan(theta1/2) in its place
"stiffness = 0.1", 'stiffness = "0.1*theta2"'
    => joint 'shoulder', stiffness = '0.1*theta2': 'theta2' has unit 'deg', which does not fit.
'position = "theta1"', 'position = "L2"'
    => joint 'shoulder', position = 'L2': 'L2' is not an angle. Give the parameter the unit 'deg' or
        'rad' (in Python: declare it as an Angle).
'position = "theta1"', 'position = "theta1 + rho1"' => 'rho1' is not an angle.
> arm({}) => SceneError:
"mass = 2.0", "mass = -2.0"
    => body 'link2': mass [kg] is negative: -2. Correct the values.
MASS, 'mass = "m1 - 0.6*m3"'
    => body 'link1': mass [kg] is negative in the range, at m1 = … m3 = … Narrow the ranges, or correct
'mass = "m3"', 'mass = "m3 - 4.5"'
    => body 'load': mass [kg] is negative in the range, at m3 = … Narrow the ranges, or correct
> assemble(cart(5.0, [Parameter('k', 2, 1, 3, unit='kg')], joint={'actuator_inertia': {}})) =>
    SceneError: joint 'rail' … actuator_inertia … negative
-3.0
"k - 1.5"
> (lambda parameters, inertia: assemble(spinner(parameters, **inertia)))({}) => SceneError: body
    'rotor':
[], {"xx": -1.0}
    => inertia.xx [kg m^2] about the center of mass is negative: -1. Correct the values.
[J], {"xx": "J - 0.6"}
    => inertia.xx [kg m^2] about the center of mass is negative in the range, at J = … Narrow the ranges
[], {"xx": 1.0, "yy": 1.0, "zz": 1.0, "xy": 2.0}
    => a minor of the second moments of mass that follow from the inertia is negative: -15. Correct
[J], {"xx": 1.0, "yy": 1.0, "zz": 1.0, "xz": "2*J - 1"}
    => a minor of the second moments of mass that follow from the inertia is negative in the range, at J
[], {"xx": 1.0, "yy": 1.0, "zz": 3.0}
    => inertia.xx + inertia.yy - inertia.zz [kg m^2] about the center of mass is negative (triangle
        inequality): -1. Correct the values.
[J], {"xx": 0.25, "yy": 0.75, "zz": "J"}
    => inertia.xx + inertia.yy - inertia.zz [kg m^2] about the center of mass is negative (triangle
        inequality) in the range, at J = … Narrow the ranges
> arm({}) => SceneError:
"axis = [1, 0, 0]", "axis = [0, 0, 1]"
    => body 'link1': inertia.zz; body 'link2': inertia.xy, inertia.xz, inertia.yy, inertia.yz,
        inertia.zz: needed, because the joints let the body turn in a way that feels it. Give the
        entries (kg m^2); the products are 0 once xx, yy and zz are all given.
"{ xx = 0.1 }", "{ yy = 0.1 }" => body 'link2': inertia.xx: needed
"axis = [1, 0, 0]", "axis = [1, 1, 0]" => body 'link1': inertia.xy, inertia.yy
> arm({}) => NotRationalError: body 'link1',
MASS, 'mass = "sqrt(m1)"'
    => mass = 'sqrt(m1)': sqrt(m1) is not rational in m1. … takes constants only; declare the whole root
'{ xx = "J1" }', '{ xx = "J1*cos(rho1)" }'
    => inertia.xx = 'J1*cos(rho1)': cos … takes constants only; declare the whole root
> assemble(cart({}, [Parameter('m', 3, 2, 4, unit='kg'), Parameter('k', 2.5, 2, 3.3, unit='kg')])) =>
    WellPosednessError: body 'cart', mass: …
"1/(m - 3.1)^2" => (m - 3.1)^2 vanishes in the range, near m = 3.1 kg, … Narrow the range or write the
"(m - 3.1)^-2"
    => the denominator (m - 3.1) vanishes in the range, near m = 3.1 kg, … Narrow the range or write the
"1/((m - 3.1)*(m - 3.1))" => vanishes in the range, near m = 3.1 kg, … Narrow the range or write the
"1/(m - k)" => the denominator (m - k) vanishes in the range, near k = … Narrow the range or write the
"1 + 1/(k - 2)"
    => the denominator (k - 2) vanishes in the range, near k = 2 … Narrow the range or write the
"1/(m*m - 6.2*m + 9.61)" => vanishes in the range, near m = … Narrow the range or write the
> assemble(cart("2.5*" + {}, [Parameter(p, 3, 2, 4) for p in "mk"])) => SceneError:
{"1/(m - 4.1)^2"|"1/(m + k)"|"1/(m*m - 6.2*m + 9.62)"} => accepted
> assemble(cart({}, [Angle('unused', 0, -1, 1)], constants={'area': Constant(value=4.0, unit='m^2'),
    'side': Constant(value=2.0, unit='m'), 'rho': Constant(value=1.5, unit='kg/m'), 'turn': 0.7})) =>
    SceneError:
"{rho*sqrt(area)|rho*sqrt(side)^2/sqrt(area)*side|2*sin(turn)}" => accepted
> assemble(cart({}, [Parameter('s', 1.0, 0.5, 1.5)], constants={'area': Constant(value=4.0, unit='m^2'),
    'm': Constant(value=4.0, unit='kg'), 'l': Constant(value=0.5, unit='m')})) => SceneError: body
    'cart',
"2*sqrt(area)"
    => mass = '2*sqrt(area)': … expected kg, got m. A number that multiplies a value with a unit is a
        plain
"sqrt(m)" => mass = 'sqrt(m)': … expected kg, got kg^1/2.
"2*l"
    => mass = '2*l': … expected kg, got m. A number that multiplies a value with a unit is a plain
        factor.
"l" => mass = 'l': … expected kg, got m.
"m*(2*l)/l + 3*l" => mass = 'm*(2*l)/l + 3*l': … kg and m are added
"2/l" => mass = '2/l': … expected kg, got m^-1.
"3*s*l" => mass = '3*s*l': … expected kg, got m.
"1 + s" => mass = '1 + s': … expected kg, got 1.
"m*sin(l)" => mass = 'm*sin(l)': … sin of a value in m; it takes plain numbers and angles.
"l^2*(1 - l)" => mass = 'l^2*(1 - l)': … expected kg, got m^3.
> assemble(cart({}, [Parameter('s', 0.7, 0.5, 0.9)], constants={'half': 0.5, 'm': Constant(value=4.0,
    unit='kg'), 'l': Constant(value=0.5, unit='m')})) => SceneError:
"{2.5|2*s|2*(1 + s)|m*(1 - s)|m + 0.5|0.5*m*l/l|2*half*s^2|3/(1 + s)}" => accepted
> {} => SceneError:
assemble(cart(" - ".join(p.name for p in PARTS), PARTS))
    => body 'cart': mass [kg] is negative in the range, at a0 = 9.5 kg
rotor("{xx|yy|zz}", 24.0) => inertia.{0} [kg m^2] about the center of mass is negative: -1.
rotor("{xx|yy|zz}", 25.0) => accepted
> arm('inertia = { xx = 0.1 }', {}) => SceneError:
'inertia = { xx = 0.1, about = "origin" }'
    => body 'link2': inertia.xx [kg m^2] about the center of mass is negative in the range, at L2 = 1.2
        m: -0.62.
'inertia = { xx = 0.8, about = "origin" }' => accepted
"""
)

J = Parameter("J", 1.0, 0.5, 1.5, unit="kg m^2")
PARTS = [Parameter("a0", 10.0, 9.5, 11.0, unit="kg")]
PARTS += [Parameter(f"a{k}", 0.9, 0.1, 1.1, unit="kg") for k in range(1, 10)]


def rotor(entry, value):
    """A body with this moment about its origin, on a hinge about that axis; its center is far from it."""
    axis = tuple(float(letter == entry[0]) for letter in "xyz")
    center = tuple(5.0 * (1.0 - component) for component in axis)
    body = kit.body("rotor", 0.5, center_of_mass=center, about="origin", **{entry: value})
    assemble(kit.scene("scene", body, kit.hinge("hinge", "ground", "rotor", axis)))


def test_huge_multiple_of_an_angle_does_not_hang():
    program = (
        "from mbdlft import MbdlftError\n"
        "from tests.errors.scenes import arm\n"
        "try:\n"
        """    arm('position = "theta1"', 'position = "1e30*theta1"')\n"""
        "except MbdlftError as error:\n"
        "    print(error)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, timeout=SECONDS, check=True
    )
    assert "joint 'shoulder', position" in done.stdout
