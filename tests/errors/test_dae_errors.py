"""Bad differential-algebraic models: each is refused by class, and by the names of what is wrong."""

import casadi as ca
import numpy as np
import pytest

import mbdlft
from mbdlft.analyze import sector_bounds
from mbdlft.base import Angle, Parameter
from mbdlft.base.errors import AnalysisError, NotRationalError, SceneError, StructureError, TrimError
from mbdlft.base.formula import formula_value
from mbdlft.dae import DaeDraft, from_casadi, reduce_index, simulate, trim
from mbdlft.dae.dae import check_units
from mbdlft.pipeline import delta_theta, linearize_dae
from mbdlft.system import ThetaFunction
from tests.close import CROSS, roundoff, target
from tests.daes import example_1, example_2, pendulum
from tests.errors.table import refused


def _draft(*names: str) -> tuple[DaeDraft, list[ca.SX]]:
    d = DaeDraft("bad")
    return d, [d.variable(name) for name in names]


def test_numerically_singular_is_named_not_solved() -> None:
    d, (a, b, x) = _draft("a", "b", "x")
    d.equation(a + b, "one", equals=1)
    d.equation(2 * a + 2 * b, "two", equals=2)
    d.equation(d.der(x), "three", equals=a)
    with pytest.raises(StructureError, match=r"whatever the parameters are.*'one', 'two'.*a, b"):
        reduce_index(d.dae())


def test_missing_start_values_are_said_to_be_missing() -> None:
    d, (x, z) = _draft("x", "z")
    u = d.input("u", start=1)
    d.equation(d.der(x), "rate", equals=u - x)
    d.equation(z * z, "square", equals=x)
    d.output("z")
    message = r"near the start values.*'square' do not determine z there. Give other start values of z"
    with pytest.raises(StructureError, match=message) as raised:
        reduce_index(d.dae())
    assert "twice" not in str(raised.value)
    d = DaeDraft("bad")
    x, z, y = d.variable("x", start=0.0), d.variable("z", start=0.0), d.variable("y")
    d.equation(d.der(x), "rate", equals=-x)
    d.equation(z * y, "product", equals=x)
    d.equation(y * y * y * (1 + x), "cube", equals=x)
    with pytest.raises(StructureError, match=r"Give other start values of y, or"):
        reduce_index(d.dae())


@pytest.mark.parametrize(("low", "high", "ratio"), [(0.4, 2.0, 3), (0.45, 3.0, 3)])
def test_an_equilibrium_stays_on_its_branch_where_newton_leaps(
    low: float, high: float, ratio: float
) -> None:
    d = DaeDraft("branches")
    p = d.parameter(Parameter("p", 1.0, low=low, high=high))
    x, z, u = d.variable("x"), d.variable("z", start=1.0), d.input("u", start=1)
    d.equation(d.der(x), "rate", equals=u - x * z)
    d.equation((z - p) * (z - ratio * p), "two roots", equals=0)
    d.output("x")
    model = linearize_dae(d.dae(), search=0.0)
    assert model.certificate.exact
    values = np.array([low, 1.3, high])
    A = mbdlft.matrices_at(model, {"p": values}).A[:, 0, 0]
    target(A, -values, CROSS)


def test_a_fit_that_is_near_at_samples_is_not_said_to_be_far() -> None:
    d = DaeDraft("near")
    p, x = d.parameter(Parameter("p", 0.9, low=0.5, high=0.9999)), d.variable("x", start=0.5)
    d.equation(d.der(x), "rate", equals=p - ca.sin(x))
    d.output("x")
    with pytest.raises(TrimError, match=r"fits have errors of .* at samples, but poles or larger errors"):
        trim(reduce_index(d.dae()), fit=1e-6)
    with pytest.raises(TrimError, match=r"is within 9e-10 at samples.* came down to"):
        trim(reduce_index(d.dae()), fit=1e-9)


def test_singular_for_all_parameters_with_irrational_numbers() -> None:
    d, (a, b) = _draft("a", "b")
    p = d.parameter(Parameter("p", 2.0, percent=10))
    root = ca.SX(mbdlft.problem.sx.constants.root(2.0))
    d.equation(root * a + p * b, "one", equals=1)
    d.equation(2 * a + root * p * b, "two", equals=2)
    with pytest.raises(StructureError, match="'one', 'two' depend on each other"):
        reduce_index(d.dae())
    # nearly the same is something else
    d, (a, b) = _draft("a", "b")
    d.equation(a + b, equals=1)
    d.equation(a + d.number(1.000000000000001) * b, equals=2)
    assert len(reduce_index(d.dae()).unknowns) == 2


def test_structurally_singular_is_named() -> None:
    d, (a, b, c) = _draft("a", "b", "c")
    d.equation(a * a, "first", equals=1)
    d.equation(ca.sin(a), "second", equals=0)
    d.equation(b + c * a, "third", equals=0)
    with pytest.raises(
        StructureError, match=r"b, c are in too few.*'third'.*'first', 'second' are too many for a"
    ):
        reduce_index(d.dae())


def test_numbers_of_equations_and_unknowns_differ() -> None:
    d, (a, b) = _draft("a", "b")
    d.equation(a * b, "only", equals=1)
    with pytest.raises(StructureError, match="1 equations for 2 unknowns"):
        reduce_index(d.dae())


def test_aliases_that_contradict_each_other() -> None:
    d, (a, b) = _draft("a", "b")
    d.equation(a, "one", equals=b)
    d.equation(a, "again", equals=b)
    with pytest.raises(StructureError, match=r"'again' says what others say already of a, b"):
        reduce_index(d.dae())
    d, (a, b) = _draft("a", "b")
    d.equation(a, "one", equals=1)
    d.equation(a, "other", equals=2)
    with pytest.raises(StructureError, match="'other' contradicts"):
        reduce_index(d.dae())


def test_derivatives_of_inputs() -> None:
    d, (x, F) = _draft("x", "F")
    v, u = d.variable("v"), d.input("u")
    d.equation(d.der(x), equals=v)
    d.equation(d.der(v), equals=F)
    d.equation(x, equals=2 * u)
    with pytest.raises(StructureError, match=r"der\(u\), der\(u, 2\)"):
        reduce_index(d.dae())
    d, (x,) = _draft("x")
    y, u = d.variable("y"), d.input("u")
    d.equation(x, equals=u)
    d.equation(d.der(x), equals=-y)
    with pytest.raises(StructureError, match=r"x is the input u"):
        reduce_index(d.dae())


def test_no_consistent_initial_point() -> None:
    d, (x, y) = _draft("x", "y")
    d.equation(d.der(x), "rate", equals=y)
    d.equation(x * x + y * y + y, "circle", equals=-2)
    with pytest.raises(StructureError, match=r"no consistent initial point.*'circle'"):
        delta_theta(d.dae())


def test_initial_values_that_contradict_equations() -> None:
    d = DaeDraft("initial")
    x, y = d.variable("x", start=2.0, fixed=True), d.variable("y", start=5.0, fixed=True)
    d.equation(d.der(x), equals=-y)
    d.equation(y, "square", equals=x * x)
    with pytest.raises(StructureError, match=r"no consistent initial point.*'square'.*fix fewer"):
        simulate(d.dae(), [0.0, 1.0])


test_messages = refused(
    r"""
> {} => AnalysisError:
reduce_index(pendulum(0.6), states=["x", "y"]) => StructureError: cannot be a state
reduce_index(pendulum(0.6), states=["z"]) => SceneError: unknown variable 'z'
sector_bounds(delta_theta(example_2(), 'blocks').functions[0], -1.0, 1.0) => has 2 arguments
sector_bounds(delta_theta(example_2()).functions[0]) => is not finite
> formula_value({}, {"a": 1.0}) => SceneError:
"__import__('os')" => is not allowed
# the number of arguments is that of the function, and numbers are doubles
"sin(a, 2)" => sin has 2 arguments, expected 1
"sin()" => sin has 0 arguments, expected 1
"min(a)" => min has 1 arguments, expected 2
"where(a > 0, 1)" => where has 2 arguments, expected 3
"9**9**9*0 + a" => has no value
"a/0" => has no value: float division by zero
"1e400*a" => a number is larger than a double can be
"-"*50000 + "a" => cannot be read
"+".join(["a"]*60000) => cannot be read
"(" * 3000 + "a" + ")" * 3000 => cannot be read
"-"*500 + "a" => accepted
"a.real" => is not allowed
"[a]" => is not allowed
"a if a else a" => is not allowed
"eval(a)" => unknown function 'eval'
"b" => unknown name 'b'
"a +" => cannot be read
"r = a" => the last part is its value
"import os; a" => expected parts
"'a'" => is not allowed
"a @ a" => is not allowed
"""
)


def test_units_that_do_not_fit() -> None:
    d = DaeDraft("units")
    x, F = d.variable("x", "m"), d.variable("F", "N")
    d.equation(d.der(x), "rate", equals=x)
    with pytest.raises(SceneError, match=r"equation 'rate': m s\^-1 and m are added"):
        reduce_index(d.dae())
    d = DaeDraft("units")
    x, F = d.variable("x", "m"), d.variable("F", "N")
    d.equation(F, "law", equals=3 * ca.sin(x))
    d.equation(d.der(x), "rate", equals=1)
    with pytest.raises(SceneError, match="a function of a value in m"):
        reduce_index(d.dae())
    d = DaeDraft("units")
    x = d.variable("x", "m")
    d.equation(d.der(x), "rate", equals=1)
    d.output("y", x, "kg")
    with pytest.raises(SceneError, match="output 'y': m and kg"):
        reduce_index(d.dae())


@pytest.mark.parametrize(
    ("units", "equation", "message"),
    [
        (("km", "m"), lambda d, x, y: x - y, r"equation 'law': km and m are added"),
        (("rad", "deg"), lambda d, x, y: ca.sin(x) + ca.sin(y), r"'law': a function of a value in deg"),
        (("ms", "s"), lambda d, x, y: ca.fmin(x, y), r"equation 'law': ms and s are added or compared"),
        (("km", "m/s"), lambda d, x, y: d.der(x) - y, r"1000 m s.-1 and m s.-1 are added"),
        (("km", "m/ms"), lambda d, x, y: d.der(x) - y, None),
        (("1/s", "Hz"), lambda d, x, y: x - y, r"s.-1 and Hz are added"),
        (("km", "m"), lambda d, x, y: x - d.number(0.001) * y, None),
        (("mV", "kOhm uA"), lambda d, x, y: x - 5 * y, None),
        (("mm", "m"), lambda d, x, y: y * x - y * y, r"0.001 m.2 and m.2 are"),
        (("mm^2", "mm"), lambda d, x, y: ca.sqrt(x) - y, None),
        (("mm^2", "m"), lambda d, x, y: ca.sqrt(x) - y, "0.001 m and m are added"),
    ],
)
def test_units_of_the_same_dimension_with_other_factors(units, equation, message) -> None:  # type: ignore[no-untyped-def]
    d = DaeDraft("factors")
    x, y = (d.variable(name, unit) for name, unit in zip("xy", units, strict=True))
    d.equation(equation(d, x, y), "law")
    d.equation(x, "other", equals=1)
    d.parameter(Angle("theta", 30.0, plus=10.0, unit="deg"))
    if message is None:
        check_units(d.dae())
    else:
        with pytest.raises(SceneError, match=message):
            check_units(d.dae())


def test_symbols_of_angles_are_in_rad() -> None:
    d = DaeDraft("angle")
    theta = d.parameter(Angle("theta", 30.0, plus=10.0, unit="deg"))
    x = d.variable("x", "rad")
    d.equation(x, "law", equals=ca.sin(theta) + d.number(0.3) * d.number(1))
    d.output("y", x - theta, "rad")
    check_units(d.dae())


def test_coefficients_that_are_not_rational() -> None:
    d, (x,) = _draft("x")
    p = d.parameter(Parameter("p", 2.0, percent=10))
    u = d.input("u")
    d.equation(d.der(x), "rate", equals=u - ca.exp(p) * x)
    d.output("x")
    with pytest.raises(NotRationalError, match=r"'rate'.*parameters p.*own.*exact; or.*guaranteed"):
        delta_theta(d.dae())
    d, (x,) = _draft("x")
    theta = d.parameter(Angle("theta", 30.0, plus=10.0))
    d.equation(d.der(x), "rate", equals=-theta * x)
    d.output("x")
    with pytest.raises(NotRationalError, match="angle 'theta' stands outside of sin and cos"):
        delta_theta(d.dae())


def test_equilibria() -> None:
    d, (x,) = _draft("x")
    p = d.parameter(Parameter("p", 0.5, percent=10))
    u = d.input("u")
    d.equation(d.der(x), "rate", equals=u + p - ca.sin(x))
    d.output("x")
    with pytest.raises(NotRationalError, match=r"x depend on the parameters.*'rate'"):
        linearize_dae(d.dae())
    with pytest.raises(TrimError, match=r"no equilibrium.*u = 3.*'rate'"):
        linearize_dae(d.dae(), {"u": 3.0})
    with pytest.raises(SceneError, match="unknown variable 'v'"):
        linearize_dae(d.dae(), {"v": 3.0})
    with pytest.raises(SceneError, match="unknown input 'x'"):
        linearize_dae(d.dae(), free=["x"])
    d, (x, v) = _draft("x", "v")
    d.equation(d.der(x), "turning", equals=v)
    d.equation(d.der(v), "pulled", equals=1 - v - ca.sin(x))
    with pytest.raises(TrimError, match="cannot move in an equilibrium: equation 'pulled' changes"):
        trim(reduce_index(d.dae()), {"v": 0.5}, moving=["x"])


def test_functions_outside_of_their_ranges() -> None:
    d = DaeDraft("limited")
    x, u = d.variable("x", minimum=-1.0, maximum=1.0), d.input("u")
    d.equation(d.der(x), equals=u - ca.sin(x))
    d.output("x")
    model = delta_theta(d.dae())
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


def test_simulations() -> None:
    for times in ([0.0], [0.0, 0.0], [1.0, 0.0]):
        with pytest.raises(SceneError, match="increasing"):
            simulate(example_1(), times)
    at = [0.0, 1.0]
    for given in ({"inputs": {"v": 0.0}}, {"parameters": {"q": 1.0}}, {"initial": {"z": 0.0}}):
        with pytest.raises(SceneError, match="unknown"):
            simulate(example_1(), at, **given)  # type: ignore[arg-type]
    with pytest.raises(SceneError, match="has shape"):
        simulate(example_1(), at, inputs={"u": [1.0, 2.0, 3.0]})
    with pytest.raises(AnalysisError, match="no consistent initial values"):
        simulate(pendulum(0.6), at, initial={"x": 5.0})


def test_descriptions() -> None:
    d, (x,) = _draft("x")
    with pytest.raises(SceneError, match="'x' is declared twice"):
        d.variable("x")
    with pytest.raises(SceneError, match="unknown variable 'u'"):
        d.der(d.input("u"))
    d.equation(x + ca.SX.sym("stranger"), "odd")
    with pytest.raises(SceneError, match="unknown symbol 'stranger'"):
        d.dae()
    for fields in ({"nominal": 0.0}, {"minimum": 2.0, "maximum": 1.0}, {"start": np.nan}):
        d, _ = _draft("x")
        d.variable("y", **fields)
        with pytest.raises(SceneError, match="'y'"):
            d.dae()
    d, _ = _draft("x")
    d.variable("y", "parsec")
    with pytest.raises(SceneError, match="parsec"):
        d.dae()


def test_builders() -> None:
    b = ca.DaeBuilder("b")
    x = b.add("x")
    b.eq(b.der(x), -x)
    with pytest.raises(SceneError, match="unknown parameter 'p'"):
        from_casadi(b, [Parameter("p", 1.0, percent=10)])


def test_a_trim_is_of_a_structure() -> None:
    d, (x,) = _draft("x")
    d.equation(d.der(x), "one", equals=1 - x**3)
    with pytest.raises(SceneError, match=r"trim: expected a Structure, .* got Dae"):
        trim(d.dae())  # type: ignore[arg-type]


def test_a_model_may_have_no_inputs_and_no_outputs() -> None:
    d, (x,) = _draft("x")
    d.equation(d.der(x), "one", equals=1 - x**3)
    structure = reduce_index(d.dae())
    assert delta_theta(structure, search=0.0).linear.lft.order == 0
    model = linearize_dae(trim(structure), search=0.0)
    roundoff(mbdlft.matrices_at(model, {}).A, np.array([[-3.0]]))
    assert (model.inputs, model.outputs) == ((), ())
