"""Bad differential-algebraic models: each is refused by class, and by the names of what is wrong."""

import re
from typing import Any

import casadi as ca
import numpy as np
import pytest

import mbdlft
from mbdlft.analyze import sector_bounds
from mbdlft.base import Angle, Parameter
from mbdlft.base.errors import AnalysisError, NotRationalError, SceneError, StructureError, TrimError
from mbdlft.base.formula import formula_value
from mbdlft.dae import Dae, DaeDraft, from_casadi, reduce_index, simulate, trim
from mbdlft.dae.dae import check_units
from mbdlft.pipeline import delta_theta, linearize_dae
from mbdlft.problem.sx.constants import root
from mbdlft.system import ThetaFunction
from tests.close import CLOSED_FORM, CROSS, roundoff, target
from tests.daes import dae_of, example_1, example_2, pendulum
from tests.errors.table import refused, says


def bad(
    variables: str,
    *,
    inputs: str = "",
    outputs: str = "",
    parameters: tuple[Parameter, ...] = (),
    **equations: str,
) -> Dae:
    """Variables and inputs, and what vanishes by names of equations."""
    laws = (f"{name}: {residual}" for name, residual in equations.items())
    return dae_of("bad", variables, *laws, inputs=inputs, outputs=outputs, parameters=parameters)


def law_in(units: str, residual: str) -> None:
    """Check the units of x and y in one law."""
    x, y = units.split(", ")
    check_units(bad(f"x[{x}] y[{y}]", law=residual, other="x - 1", parameters=(THETA,)))


def declared(**fields: object) -> Dae:
    d = DaeDraft("bad")
    d.variable("y", **fields)  # type: ignore[arg-type]
    return d.dae()


def within(low: float, high: float) -> Dae:
    """x follows the parameter p, from 1.8 to 2.2, and has a range."""
    d = DaeDraft("bad")
    x = d.variable("x", start=2.0, minimum=low, maximum=high)
    d.equation(d.der(x), equals=d.parameter(P) - x)
    d.output("x")
    return d.dae()


P, WIDE = Parameter("p", 2.0, percent=10), Parameter("p", 2.0, percent=30)
THETA = Angle("theta", 30.0, plus=10.0, unit="deg")
SINE: dict[str, Any] = {
    "variables": "x",
    "inputs": "u",
    "outputs": "x",
    "parameters": (Parameter("p", 0.5, percent=10),),
    "rate": "der(x) - u - p + sin(x)",
}


@pytest.mark.parametrize("told", [{"nominal": 1e-10}, {"start": 2e-10}], ids=["nominal", "start"])
def test_an_equation_that_is_flat_at_the_start_holds_to_rounding_of_its_own_terms(
    told: dict[str, Any],
) -> None:
    """A start far below 1 tells the size, too: a fit of x within 1e-6 of 1 is far from 2e-10."""
    d = DaeDraft("flat")
    p = d.parameter(Parameter("p", 8.0, percent=10))
    x = d.variable("x", **told)
    d.equation(d.der(x), equals=1e-30 * p - x**3)
    d.output("x")
    A = mbdlft.matrices_at(linearize_dae(d.dae(), fit=1e-6), {"p": 8.0}).A
    assert abs(A[0, 0] + 3 * 4e-20) <= 1e-5 * 1.2e-19  # the tolerance of the fit


@pytest.mark.parametrize(("low", "high", "ratio"), [(0.4, 2.0, 3), (0.45, 3.0, 3)])
def test_an_equilibrium_stays_on_its_branch_where_newton_leaps(
    low: float, high: float, ratio: float
) -> None:
    roots = f"(z - p)*(z - {ratio}*p)"
    p = Parameter("p", 1.0, low=low, high=high)
    dae = bad("x z=1", inputs="u=1", outputs="x", parameters=(p,), rate="der(x) - u + x*z", roots=roots)
    model = linearize_dae(dae, search=0.0)
    assert model.certificate.exact
    values = np.array([low, 1.3, high])
    A = mbdlft.matrices_at(model, {"p": values}).A[:, 0, 0]
    target(A, -values, CROSS)


def test_a_fit_that_is_near_at_samples_is_not_said_to_be_far() -> None:
    p = Parameter("p", 0.9, low=0.5, high=0.9999)
    structure = reduce_index(bad("x=0.5", outputs="x", parameters=(p,), rate="der(x) - p + sin(x)"))
    with pytest.raises(TrimError, match=r"fits have errors of .* at samples, but poles or larger errors"):
        trim(structure, fit=1e-6)
    with pytest.raises(TrimError, match=r"is within 9e-10 at samples.* came down to"):
        trim(structure, fit=1e-9)


def test_nearly_the_same_equations_are_something_else() -> None:
    near = bad("a b", one="a + b - 1", two="a + number(1.000000000000001)*b - 2")
    assert len(reduce_index(near).unknowns) == 2


def test_initial_values_that_contradict_equations() -> None:
    dae = dae_of("initial", "x=2 y=5", "der(x) = -y", "square: y = x*x", fixed=True)
    with pytest.raises(StructureError, match=r"no consistent initial point.*'square'.*fix fewer"):
        simulate(dae, [0.0, 1.0])


test_messages = refused(
    r"""
> {} => AnalysisError:
reduce_index(pendulum(0.6), states=["x", "y"]) => StructureError: cannot be a state
reduce_index(pendulum(0.6), states=["z"]) => SceneError: unknown variable 'z'
sector_bounds(delta_theta(example_2(), 'blocks').functions[0], -1.0, 1.0) => has 2 arguments
sector_bounds(delta_theta(example_2()).functions[0]) => is not finite
simulate(pendulum(0.6), [0.0, 1.0], initial={"x": 5.0}) => no consistent initial values
> simulate(example_1(), {}) => SceneError:
[0.0, np.inf] => times are at least two increasing numbers
[0.0, 1.0], inputs={"u": np.nan} => 'u': expected finite numbers, up to 1e+100
[0.0, 1.0], inputs={"u": [0.0, -1e300]} => 'u': expected finite numbers, up to 1e+100
[0.0] => increasing
[{0.0|1.0}, 0.0] => increasing
[0.0, 1.0], inputs={"v": 0.0} => unknown
[0.0, 1.0], parameters={"q": 1.0} => unknown
[0.0, 1.0], initial={"z": 0.0} => unknown
[0.0, 1.0], inputs={"u": [1.0, 2.0, 3.0]} => has shape
> declared({}) => SceneError: 'y'
nominal=0.0
minimum=2.0, maximum=1.0
start=np.nan
unit="parsec" => … parsec
> bad({}) => SceneError:
"x x" => 'x' is declared twice
"x", inputs="u", one="der(u)" => 'u' is an input … 'u' a variable
"x", odd="x + SX.sym('stranger')" => unknown symbol 'stranger'
"x", law="x - 1e400" => model 'bad', equation 'law': the number inf in an equation is not finite
> reduce_index(bad({})) => StructureError:
"a b x", one="a + b - 1", two="2*a + 2*b - 2", three="der(x) - a"
    =~ whatever the parameters are.*'one', 'two'.*a, b
"x z", inputs="u=1", outputs="z", rate="der(x) - u + x", square="z*z - x"
    =~ ^(?!.*twice).*near the start values.*'square' do not determine z there. Give other start values
"x=0 z=0 y", rate="der(x) + x", product="z*y - x", cube="y*y*y*(1 + x) - x"
    => Give other start values of y, or
"a b", parameters=(P,), one="root(2)*a + p*b - 1", two="2*a + root(2)*p*b - 2"
    => 'one', 'two' contradict each other
"x y", one="der(x) + der(y) + x", two="2*der(x) + 2*der(y) + y"
    => 'one', 'two' have a combination without … this combination, a constraint
"a b c", first="a*a - 1", second="sin(a)", third="b + c*a"
    => b, c are in too few … 'third' … 'first', 'second' are too many for a
"a b", only="a*b - 1" => 1 equations for 2 unknowns
"a b", one="a - b", again="a - b" => 'again' says what others say already of a, b
"a b", one="a - 1", other="a - 2" => 'other' contradicts
"x F v", inputs="u", one="der(x) - v", two="der(v) - F", three="x - 2*u" => der(u), der(u, 2)
"x y", inputs="u", one="x - u", two="der(x) + y" => x is the input u
"x[m]", rate="der(x) - x" => SceneError: equation 'rate': m s^-1 and m are added
"x[m] F[N]", law="F - 3*sin(x)", rate="der(x) - 1" => SceneError: a function of a value in m
> law_in({}) => SceneError:
"km, m", "x - y" => equation 'law': km and m are added
"rad, deg", "sin(x) + sin(y)" => 'law': a function of a value in deg
"ms, s", "fmin(x, y)" => equation 'law': ms and s are added or compared
"km, m/s", "der(x) - y" => 1000 m s^-1 and m s^-1 are added
"km, m/ms", "der(x) - y" => accepted
"1/s, Hz", "x - y" => s^-1 and Hz are added
"km, m", "x - number(0.001)*y" => accepted
"mV, kOhm uA", "x - 5*y" => accepted
"mm, m", "y*x - y*y" => 0.001 m^2 and m^2 are
"mm^2, mm", "sqrt(x) - y" => accepted
"mm^2, m", "sqrt(x) - y" => 0.001 m and m are added
> delta_theta(bad("x", inputs="u", outputs="x", {})) => NotRationalError:
parameters=(P,), rate="der(x) - u + exp(p)*x" => 'rate' … parameters p … own … exact; or … guaranteed
parameters=(THETA,), rate="der(x) + theta*x" => the angle 'theta' stands outside of sin and cos
> {} => TrimError:
delta_theta(bad("x y", rate="der(x) - y", circle="x*x + y*y + y + 2"))
    => StructureError: no consistent initial point … 'circle'
linearize_dae(bad(**SINE)) => NotRationalError: x depend on the parameters … 'rate'
linearize_dae(bad(**SINE), {"u": 3.0}) => no equilibrium … u = 3 … 'rate'
linearize_dae(bad(**SINE), {"v": 3.0}) => SceneError: unknown variable 'v'
linearize_dae(bad(**SINE), free=["x"]) => SceneError: unknown input 'x'
linearize_dae(bad("x=0.7", rate="der(x) - p + exp(x)", parameters=(P,)), fit=1e-6)
    => NotRationalError: exp has no rule in rational fits
linearize_dae(bad("x=1e-5", outputs="x", rate="der(x) - 1e-20*p + x*x", parameters=(WIDE,)), fit=1e-6)
    => x without a `nominal` of its size … nothing can be proved
linearize_dae(bad("x", outputs="x", rate="der(x) - p", parameters=(P,))) => no unknown is left in 'rate'
linearize_dae(bad("x", inputs="u", rate="der(x) - u + p*x**(1/3)", parameters=(P,)))
    => 'rate' (inf); inf: a value or a slope
linearize_dae(bad("x=0.7", rate="der(x) - sin(theta) + x**3", parameters=(THETA,)), fit=1e-6)
    => NotRationalError: 'bad', fit of the equilibrium: it depends on the angle theta
linearize_dae(bad("x=0.7", rate="der(x) - q + x*x", parameters=(Parameter("q", 1, 0, 2),)), fit=1e-6)
    => 'bad': near q = … the branch folds
# what balances a kink has it, too; a slope may be zero at nominal
linearize_dae(trim(reduce_index(bad("x=1", inputs="u", outputs="x",
    rate="der(x) + p*fmax(x, number(1)) - u", parameters=(P,))), {"x": 1.0}, free=["u"]))
    => has two slopes by 'x', 0 and 2 at this equilibrium, where fmax(x, 1) switches
linearize_dae(trim(reduce_index(bad("x=1", inputs="u", outputs="x",
    rate="der(x) + (p - 2)*fabs(x - number(1)) - u", parameters=(P,))), {"x": 1.0}, free=["u"]))
    =~ has two slopes by 'x', (-?0.0?[1-9]\d*) and (?!\1)
# a quotient of whole numbers is no double: that these jump, from 0 to 0, was told
linearize_dae(bad("x=-158400 z", inputs="u=-158400", outputs="z", rate="der(x) + x - u",
    law="z - ((x/792000)**2 + 1)**1.5*fmax(x/792000, number(-0.2))"), {"x": -158400.0})
    => has two slopes by 'x'
linearize_dae(bad("x=5 z", inputs="u=5", outputs="z", rate="der(x) + x - u",
    law="z - fmax(2/x + 1/x, 3/x + x - 5)"), {"x": 5.0})
    => has two slopes by 'x', -0.88 and 0.12
linearize_dae(bad("x=324900", inputs="u=1.14", outputs="x", rate="(lambda v: der(x) - u + 2*v"
    " + if_else(v > number(0.57), (v - number(0.57))**2, 0))(x/570000)")) => accepted
linearize_dae(bad("x=0 w", rate="der(x) + x", law="w + tanh(w) - if_else(x > 0, 7, number(0.42))"))
    => jumps from -6.58 to 0 at this
# equilibria and initial points are in the ranges of variables, at all values of the parameters
linearize_dae(within(2.3, np.inf))
    => model 'bad': x = 2 is outside its range [2.3, inf] 1 at p = 2. Give other values
linearize_dae(within(-np.inf, 2.1)) => x = 2.14072 is outside its range [-inf, 2.1] 1 at p = 2.14072.
linearize_dae(within({0.0|1.8}, {np.inf|2.2 - 1e-11})) => accepted
start_point(reduce_index(within(0.0, 1.0))) => x = 2 is outside its range [0, 1]
delta_theta(within(2.1, 3.0)) => x = 2 is outside its range
delta_theta(within(-1.0, 1.9)) => x = 2 is outside its range
delta_theta(within(2.0, 3.0)) => accepted
simulate(within(0.0, 3.0), [0.0, 1.0], parameters={"p": {3.0|np.nan}})
    => SceneError: model 'bad', simulate: p = … is outside its range [1.8, 2.2]
simulate(within(0.0, 1.5), [0.0, 1.0], initial={"x": {2.0|-0.5}})
    => TrimError: model 'bad': x = … is outside its range
trim(reduce_index(bad("x v", turning="der(x) - v", pulled="der(v) - 1 + v + sin(x)")), {"v": 0.5},
    moving=["x"])
    => cannot move in an equilibrium: equation 'pulled' changes
> formula_value({}, {"a": 1.0}) => SceneError:
"__import__('os')" => is not allowed
# the number of arguments is that of the function, and numbers are doubles
"sin(a, 2)" => sin has 2 arguments, expected 1
"sin()" => sin has 0 arguments, expected 1
"min(a)" => min has 1 arguments, expected 2
"where(a > 0, 1)" => where has 2 arguments, expected 3
"9**9**9*0 + a" => has no value: Numerical result out of range
"a/0" => has no value: float division by zero
"1e400*a" => a number is larger than a double can be
{"-"*50000 + "a"|"+".join(["a"]*60000)|"(" * 3000 + "a" + ")" * 3000} => cannot be read
"-"*500 + "a" => accepted
"{a.real|[a]|a if a else a}" => is not allowed
"eval(a)" => unknown function 'eval'
"b" => unknown name 'b'
"a +" => cannot be read
"r = a" => the last part is its value
"import os; a" => expected parts
"b = a = 5; a + b" => expected parts
"abs((0 - 8)**(1/3))*a" => has no value: a root of a negative number
"'a'" => is not allowed
"a @ a" => is not allowed
"""
)


def test_units_of_outputs() -> None:
    d = DaeDraft("units")
    x = d.variable("x", "m")
    d.equation(d.der(x), "rate", equals=1)
    d.output("y", x, "kg")
    with says(SceneError, "output 'y': m and kg"):
        reduce_index(d.dae())


def test_symbols_of_angles_are_in_rad() -> None:
    d = DaeDraft("angle")
    theta = d.parameter(THETA)
    x = d.variable("x", "rad")
    d.equation(x, "law", equals=ca.sin(theta) + d.number(0.3) * d.number(1))
    d.output("y", x - theta, "rad")
    check_units(d.dae())


def test_functions_outside_of_their_ranges() -> None:
    limits = {"minimum": -1.0, "maximum": 1.0}
    model = delta_theta(dae_of("limited", "x", "der(x) = u - sin(x)", inputs="u", outputs="x", **limits))
    with pytest.raises(AnalysisError, match=r"outside of its range \[-1, 1\]"):
        mbdlft.theta_values(model.functions, {"omega.x": 1.5})
    with pytest.raises(AnalysisError, match="outside of its range"):
        simulate(model, np.linspace(0, 5, 6), inputs={"u": 2.0})
    with pytest.raises(AnalysisError, match="is not inside that of the function"):
        sector_bounds(model.functions[0], -2.0, 1.0)


def test_a_function_without_a_sector_has_none() -> None:
    free = ((-np.inf, np.inf),)
    cosine = sector_bounds(ThetaFunction("f", ("s",), ("a",), "cos(a)", free), -1.0, 1.0)
    assert cosine.sector == (-np.inf, np.inf)
    jump = sector_bounds(ThetaFunction("f", ("s",), ("a",), "where(a > 0.5, 1, 0)", free), -1, 1)
    assert jump.slope == (-np.inf, np.inf)
    assert jump.values == (0.0, 1.0)


def test_builders() -> None:
    b = ca.DaeBuilder("b")
    x = b.add("x")
    b.eq(b.der(x), -x)
    with says(SceneError, "unknown parameter 'p'"):
        from_casadi(b, [P])


def test_a_model_may_have_no_inputs_and_no_outputs() -> None:
    structure = reduce_index(bad("x", one="der(x) - 1 + x**3"))
    assert delta_theta(structure, search=0.0).linear.lft.order == 0
    model = linearize_dae(trim(structure), search=0.0)
    roundoff(mbdlft.matrices_at(model, {}).A, np.array([[-3.0]]))
    assert (model.inputs, model.outputs) == ((), ())
