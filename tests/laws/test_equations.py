"""A table of equations with kinks, jumps, implicit functions, units, scales: right, or the reason."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

import mbdlft
from mbdlft import MbdlftError
from mbdlft.base.errors import SceneError, TrimError
from mbdlft.base.samples import random
from mbdlft.dae import DaeDraft, reduce_index, start_point, trim
from mbdlft.dae.linear import trim_sizes, trimmed_points
from mbdlft.modelica import ModelicaTable, flat_model, operating_point, translate
from mbdlft.modelica.translation import notes_of_point
from mbdlft.system import LFTModel
from tests.attack.switches import K, check, slopes, text_of
from tests.close import CLOSED_FORM, roundoff, target
from tests.daes import dae_of
from tests.errors.table import refused

_KM, _DEG = 'Real x(unit="km"); Real z(unit="m"); ', 'Real x(unit="deg"); Real z; '  # before words
_RISES = "der(x) = u - x; "
# equations, start values, and what the message says if there is no model, or declarations
ROWS: list[tuple[str, dict[str, float], str]] = [
    ("der(x) = u - k*abs(x)", {}, "two slopes by 'x', -1 and 1"),
    ("der(x) = u - k*abs(x)", {"x": 1.0, "u": 1.0}, ""),
    ("der(x) = u - k*abs(x)", {"x": 1e-12, "u": 1e-12}, ""),
    ("der(x) = u - k*abs(x)", {"x": 1e12, "u": 1e12}, ""),
    ("der(x) = u - k*abs(x) - 2*x", {}, "two slopes by 'x', 1 and 3"),
    ("der(x) = u - x*abs(x) - k*x", {}, ""),
    ("der(x) = u - k*sign(x)", {}, "jumps from -1 to 1"),
    ("der(x) = u - abs(sign(x)*k)", {}, "jumps from 1 to 0"),
    ("der(x) = u - (if x >= 0 or z >= 0 then 3*x else x); der(z) = -z", {}, "two slopes by 'x', 3 and 1"),
    ("der(x) = u - max(0, sign(x) + sign(z) - 1); der(z) = -z", {}, "jumps from 0 to 1"),
    ("der(x) = u - min(max(0, x), max(0, -x)) - k*x", {}, ""),
    ("der(x) = u - max(0, x)*max(0, k*x) - k*x", {}, ""),
    ("der(x) = u - min(max(1, abs(x + 1)) - 1, 0) - k*x", {}, ""),
    ("der(x) = u - k*x - (if x < 0 and z < 0 and 2*x - 3*z > 0 then 5 else 0); der(z) = -z", {}, "jumps"),
    ("der(x) = u - k*x - (1 - sign(x)^2)*max(z, 0); der(z) = -z", {}, "two slopes by 'z', 0 and 1"),
    ("der(x) = u - k*x; z = sign(x + k - 1)", {}, "changes its branch inside of the range of k"),
    ("der(x) = u - k*x; z = max(sign(x), k)", {}, "changes its branch inside of the range of k"),
    ("der(x) = u - k*x; z = atan2(1, x)", {}, ""),
    ("der(x) = u - x*sin(z); k*(1.7*z - 0.85) = 0", {"z": 0.5}, ""),
    ("der(x) = u - x*exp(z); (2*z - sqrt(2))/k = 0", {"z": 0.7}, ""),
    ("der(x) = u - k*x; z = atan2(x, x - 1)", {}, "jumps from 6.28319 to 0"),
    ("der(x) = u - k*x; z = (x^4)^0.25", {}, "there is no linear model"),
    ("der(x) = u - k*x*sign(x - 3)", {}, ""),
    ("der(x) = u - max(k*x, 3*x)", {}, "two slopes by 'x', 3 and 1"),
    ("der(x) = u - max(k*x, -x)", {"x": 1.0, "u": 1.0}, ""),
    ("der(x) = u - min(k*x, 3*x + 9)", {"x": 1.0, "u": 1.0}, ""),
    ("der(x) = u - (if x > 0 then k*x else 2*x)", {}, "two slopes by 'x', 1 and 2"),
    ("der(x) = u - (if x > 0 then k*x else k*x + x^2)", {}, ""),
    ("der(x) = u - (if x > 0 then k*x + 1 else k*x)", {}, "jumps from 1 to 0"),
    ("der(x) = u - (if x > -1 then k*x else 2*x)", {}, ""),
    ("der(x) = u - (if k > 1 then x else 2*x)", {}, "changes its branch inside of the range of k"),
    ("der(x) = u - (if k > 0.5 then x else 2*x)", {}, ""),
    ("der(x) = u - abs(k - 2)*x", {}, ""),
    ("der(x) = u - abs(k - 1)*x", {}, "changes its branch inside of the range of k"),
    ("der(x) = u - max(k, 1)*x", {}, "changes its branch inside of the range of k"),
    ("der(x) = u - max(k, 0.5)*x", {}, ""),
    ("der(x) = u - sqrt(k^2)*x", {}, ""),
    ("der(x) = u - sqrt((1/k)^2)*x", {}, ""),
    ("der(x) = u - sqrt(k*(k*0.09))*x", {}, ""),
    ("der(x) = u - sqrt(2*k^2)*x", {}, ""),
    ("der(x) = u - sqrt(k)*x", {}, "sqrt(k) is not rational in the parameters k"),
    ("der(x) = u - sqrt(x)*k", {"x": 1.0, "u": 1.0}, ""),
    ("der(x) = u - sqrt(x)*k", {}, "no equilibrium was found"),
    ("der(x) = u - sqrt(abs(x))", {}, "there is no linear model"),
    ("der(x) = u - log(x)", {"x": 0.9}, ""),
    ("der(x) = u - 1/x", {}, "no equilibrium was found"),
    ("der(x) = u - k*sqrt(x^2 + 1e-12)", {}, "no equilibrium was found"),
    ("der(x) = u - z; z^3 + z = x", {"x": 2.0, "z": 1.0, "u": 1.0}, ""),
    ("der(x) = u - k*z; z*exp(z) = x", {"z": 0.1}, ""),
    ("der(x) = u - z; k*z + sin(z) = x", {"z": 0.1}, ""),
    (_RISES + "sin(z) = x/2", {"x": 1.0, "z": 0.5, "u": 1.0}, ""),
    (_RISES + "exp(z) = x + 1", {"z": 0.1}, ""),
    (_RISES + "k*z + sin(z) = x", {"x": 1.0, "z": 0.5, "u": 1.0}, "z depend on the parameters"),
    (_RISES + "z^2 = k^2*x", {"x": 4.0, "z": 2.0, "u": 4.0}, ""),
    (_RISES + "z^2 = k*x", {"x": 4.0, "z": 2.0, "u": 4.0}, "z depend on the parameters"),
    (_RISES + "z^2 = x", {"x": 1e-12, "z": 1e-6, "u": 1e-12}, ""),
    (_RISES + "z^2 = x", {"x": 1e12, "z": 1e6, "u": 1e12}, ""),
    (_RISES + "z^3 = x", {"x": 8.0, "z": 2.0, "u": 8.0}, ""),
    (_RISES + "z^3 = x", {}, "do not determine z there"),
    (
        _RISES + "cos(z) = x",
        {"x": 1.0, "u": 1.0},
        "do not determine z there. Give other start values of z",
    ),
    (_RISES + "sqrt(z) = k*x", {"x": 1.0, "z": 1.0, "u": 1.0}, ""),
    (_RISES + "z*abs(z) = x", {"x": 4.0, "z": 2.0, "u": 4.0}, ""),
    (_RISES + "max(z, 2*z) = x", {"x": 1.0, "z": 0.5, "u": 1.0}, ""),
    (_RISES + "max(z, 2*z) = x", {}, "two slopes by 'z', 2 and 1"),
    (_RISES + "atan(z) = k*x", {}, ""),
    (_RISES + "z + abs(z)/2 = x - k", {"x": 4.0, "z": 2.0, "u": 4.0}, ""),
    (_RISES + "sin(z/1e-12) = x + 0.5", {"z": 0.0}, ""),
    (_RISES + "1e-12*sin(z/1e12) = 1e-12*(x + 0.5)", {"z": 4e11}, ""),
    (_RISES + "1e12*z*exp(z) = 1e12*x", {"z": 0.1}, ""),
    ("1e-12*der(x) = 1e-12*(u - k*x)", {}, ""),
    ("1e12*der(x) = 1e12*(u - k*x*abs(x))", {"x": 1.0, "u": 1.0}, "x depend on the parameters"),
    ("der(x) = u - 1e-12*k*x", {}, ""),
    ("der(x) = 1e-12*u - 1e12*k*x - x^2", {}, ""),
    ("der(x) = u - k*x; z = 1000*x", {}, _KM),
    ("der(x) = u - k*x; z = x", {}, _KM + "the left side is in m, the right side in km"),
    ("der(x) = u - k*x; z = sin(x)", {}, _DEG + "sin of a value in deg"),
    ("der(x) = u - floor(x + 0.5)*k - x", {}, "floor of what is no number makes events"),
]


@pytest.mark.parametrize(("equations", "starts", "words"), ROWS)
def test_model_or_reason_is_right(equations: str, starts: dict[str, float], words: str) -> None:
    declared, end, words = words.rpartition("; ") if words.startswith("Real") else ("", "", words)
    text = text_of(equations, starts, declared + end)
    if words:
        with pytest.raises(MbdlftError) as error:
            mbdlft.linearize_dae(operating_point(*translate(flat_model(text))))
        assert words in str(error.value)
        return
    linear = mbdlft.linearize_dae(operating_point(*translate(flat_model(text))), search=0.0, prove=0.0)
    check(linear, {k: slopes(equations, {"z": 0.0} | starts, k) for k in K})


# Functions that switch at an equilibrium: branches that are one function, and errors for two slopes.

K_SWITCHED = mbdlft.Parameter("k", 1.0, percent=20)


def model(force, start: float = 0.0) -> mbdlft.LFTModel:
    """der(x) = u - force(k, x) around x = start."""
    draft = DaeDraft("switch")
    k, x, u = draft.parameter(K_SWITCHED), draft.variable("x", start=start), draft.input("u")
    draft.equation(draft.der(x), equals=u - force(k, x))
    draft.output("x")
    draft.output("force", force(k, x))
    structure = reduce_index(draft.dae())
    return mbdlft.linearize_dae(trim(structure, at={"x": start}, free=["u"]), prove=0.0)


test_no_linear_model_where_branches_meet = refused(
    r"""
> model(lambda k, x: {}) => TrimError: equation … der(x) …
ca.fmin(k * x, 0) => two slopes by 'x', 1 and 0 … switches … smooth
ca.if_else(x < 0, -x, x + 2) => jumps from -2 to 0 … switches … smooth
ca.if_else(ca.sin(x) > 0, x, 2 * x) => two slopes … switches … smooth
ca.if_else(x == 0, 1, x) => jumps … switches … smooth
> model(lambda k, x: k * {}) => MbdlftError: there is no linear model. Linearize beside it
ca.asin(x + 1)
# Of a state that is at the end of a range, or of a function that jumps there.
> model(lambda k, x: {}) => NotRationalError: changes its branch … range of k
ca.fabs(x - k), {0.8|1.2}
ca.fmax(x, k), {0.8|1.2}
ca.if_else(x >= k, 2 * x, x + k), {0.8|1.2}
ca.sqrt(x * x - 2 * k * x + k * k), {0.8|1.2}
ca.sqrt(2 * x * x - 4 * k * x + 2 * k * k), {0.8|1.2}
ca.sign(k - 0.8) * x, 1.0
ca.if_else(k > 0.8, k, 7) * x, 1.0
"""
)


@pytest.mark.parametrize("no", ["2*x + 3*z > 0", "z > 0 and 2*x + 3*z <= z/2", "x + 3*z == 0"])
def test_sides_that_contradict_each_other_are_no_branches(no: str) -> None:
    rate = f"u - k*x - (if x < 0 and z <= 0 and {no} then 5 else 0)"
    text = text_of(f"der(x) = {rate}; der(z) = -z", {"z": 0.0})
    linear = mbdlft.linearize_dae(trim(reduce_index(translate(flat_model(text))[0])))
    target(mbdlft.matrices_at(linear, {"k": 1.1}).A, np.diag([-1.1, -1.0]), CLOSED_FORM)


@pytest.mark.parametrize(
    ("force", "start", "slope"),
    [
        (lambda k, x: ca.fmax(x * x, x * x * x) + k * x, 0.0, lambda k: -k),
        (lambda k, x: ca.if_else(x != 0, k * x, -x), 0.0, lambda k: -k),
        (lambda k, x: k * ca.sign(x) * ca.fabs(x), 0.0, lambda k: -k),
        (lambda k, x: ca.if_else(x > 0, k * x, -k * ca.fabs(x)), 0.0, lambda k: -k),
        (lambda k, x: ca.if_else(x == 0, 5, k * x), -2.0, lambda k: -k),
        (lambda k, x: ca.if_else(x != 0, k * x, 5), 2.0, lambda k: -k),
        (lambda k, x: ca.fmax(k, x) * x, 0.5, lambda k: -k),  # k > x in the whole range
        (lambda k, x: ca.if_else(k * k > 0.5, 3 * x, x), 0.0, lambda k: -3 + 0 * k),
        (lambda k, x: ca.sqrt(k * (k * ca.SX(0.3) / 7)) * x, 0.5, lambda k: -k * np.sqrt(0.3 / 7)),
        (lambda k, x: ca.sqrt((k - 3) * (k - 3)) * x, 0.5, lambda k: k - 3),
    ],
)
def test_branches_that_are_one_function_or_stay_in_the_range(force, start, slope) -> None:
    linear = model(force, start)
    assert linear.certificate.exact
    for k in (0.8, 1.0, 1.13, 1.2):
        A, _, C, _ = mbdlft.matrices_at(linear, {"k": k})
        target(A, np.array([[slope(k)]]), CLOSED_FORM)
        target(C, np.array([[1.0], [-slope(k)]]), CLOSED_FORM)


@pytest.mark.parametrize(
    ("factor", "value"),
    [
        (lambda k: ca.fabs(k - 0.8), lambda k: k - 0.8),
        (lambda k: ca.fabs(k - 1.2), lambda k: 1.2 - k),
        (lambda k: ca.fmax(k, 0.8) - ca.fmin(1.2, k * k / 1.2), lambda k: k - k * k / 1.2),
        (lambda k: ca.if_else(k >= 0.8, k, 7), lambda k: k),
        (lambda k: ca.if_else(k < 0.8, 7, k), lambda k: k),
        (lambda k: ca.fabs((k - 0.8) * (1.2 - k)), lambda k: (k - 0.8) * (1.2 - k)),
        (lambda k: ca.sqrt(k * k - 1.6 * k + 0.64), lambda k: k - 0.8),
        (lambda k: ca.sqrt(2 * k * k - 8 * k + 8), lambda k: np.sqrt(2) * (2 - k)),
        (lambda k: ca.sqrt((k**4 - 2 * k * k + 1) / (4 * k * k + 4 * k + 1)) * 0 + k, lambda k: k),
        (
            lambda k: ca.sqrt((k**2 + 2 * k + 1) / (4 * k * k + 4 * k + 1)),
            lambda k: (k + 1) / (2 * k + 1),
        ),
    ],
)
def test_what_is_one_rational_function_up_to_the_ends_of_the_range(factor, value) -> None:
    linear = model(lambda k, x: factor(k) * x, 0.5)
    assert linear.certificate.exact
    for k in (0.8, 1.0, 1.13, 1.2):
        target(mbdlft.matrices_at(linear, {"k": k})[0], np.array([[-value(k)]]), CLOSED_FORM)


@pytest.mark.parametrize(
    ("force", "right"),
    [
        (lambda k, x: ca.fabs(k + x), lambda k: -1.0),  # x = 1 - k
        (lambda k, x: ca.fmax(k * x, 0), lambda k: -k),  # x = 1 / k
        (lambda k, x: ca.if_else(x < 0.5, 9 * x, k * x - k / 2), lambda k: -k),  # x = 1 / k + 1 / 2
    ],
)
def test_an_equilibrium_that_depends_on_the_parameters_stays_on_its_branch(force, right) -> None:
    draft = DaeDraft("switch")
    k, x, u = draft.parameter(K_SWITCHED), draft.variable("x", start=1.0), draft.input("u", start=1.0)
    draft.equation(draft.der(x), equals=u - force(k, x))
    draft.output("x")
    linear = mbdlft.linearize_dae(draft.dae())
    for k in (0.8, 1.0, 1.13, 1.2):
        target(mbdlft.matrices_at(linear, {"k": k})[0], np.array([[right(k)]]), CLOSED_FORM)


def test_a_root_that_is_a_cosine_at_the_equilibrium() -> None:
    laws = "z = (k*cos(angle))**2", "der(x) = u - sqrt(z)*x"
    given = {"inputs": "u", "outputs": "x", "parameters": [mbdlft.Angle("angle", 0, -60, 60), K_SWITCHED]}
    linear = mbdlft.linearize_dae(dae_of("slope", "x z=1", *laws, **given))
    for degrees, k in ((-50.0, 0.8), (0.0, 1.0), (60.0, 1.13)):
        A = mbdlft.matrices_at(linear, {"angle": degrees, "k": k})[0]
        target(A, np.array([[-k * np.cos(np.deg2rad(degrees))]]), CLOSED_FORM)


def test_decisions_do_not_depend_on_the_scale_of_an_equation() -> None:
    def made(times: float) -> mbdlft.LFTModel:
        law = f"number({times})*der(z) = number({times})*(x - z - p*sqrt(z))"
        given = {"outputs": "z", "parameters": [mbdlft.Parameter("p", 1.0, percent=20)]}
        dae = dae_of("tank", "x=1 z=0.4", "der(x) = u - p*sqrt(x)", law, inputs="u=1", **given)
        return mbdlft.linearize_dae(dae, fit=1e-6)

    assert made(1e-12).order == made(1e12).order == made(1.0).order


@pytest.mark.parametrize(
    ("function", "at", "slope"), [("sin", 0.3, 1 / np.cos(np.arcsin(0.3))), ("exp", 1.3, 1 / 1.3)]
)
def test_implicit_functions_with_slopes_that_are_numbers(function: str, at: float, slope) -> None:
    laws = "der(x) = k*(u - x)", f"{function}(z) = x"
    given = {"inputs": f"u={at}", "outputs": "z", "parameters": [K_SWITCHED]}
    dae = dae_of("implicit", f"x={at} z=0.4", *laws, **given)
    C = mbdlft.matrices_at(mbdlft.linearize_dae(dae), {})[2]
    target(C, np.array([[slope]]), CLOSED_FORM)


def test_a_saturated_function_beside_one_that_switches_keeps_the_digits_that_it_has() -> None:
    """1 - tanh(5.2)^2 loses four digits: "a bug" was told, as max(z, z/2) hid what rounding does."""
    laws = "der(x) = k*(u - x)", "1.5*fmax(z, z/2) = tanh(x)"
    given = {"inputs": "u=5.2", "outputs": "z", "parameters": [K_SWITCHED]}
    C = mbdlft.linearize_dae(dae_of("saturated", "x=5.2 z=0.6", *laws, **given)).at().C
    slope = 1.0 / np.cosh(5.2) ** 2
    roundoff(C, np.array([[slope / 1.5]]), kappa=1.0 / slope)


def test_rounding_counts_where_its_coefficient_is_not_zero() -> None:
    """1 - tanh(7.7)^2 loses seven digits, and 1 - k is zero at nominal: "a bug" was told."""
    laws = "der(x) = u - x", "w = hypot(x, 1)", "z = (1 - k)*tanh(x)"
    given = {"inputs": "u=7.7", "outputs": "z", "parameters": [K_SWITCHED]}
    C = mbdlft.linearize_dae(dae_of("saturated", "x=7.7 w=7.7 z", *laws, **given)).at(k=1.2).C
    slope = 1.0 / np.cosh(7.7) ** 2
    roundoff(C, np.array([[-0.2 * slope]]), kappa=1.0 / slope)


def test_an_unknown_far_below_one_that_is_zero_needs_no_nominal_value() -> None:
    """Beside its slope of 1e12 that of u was taken for nothing: u was held, and w balanced the rate."""
    laws = "der(x) = u - exp(w/number(1e-12))/(1 + k)", "w/number(1e-12) + sin(w/number(1e-12)) = x - 2"
    dae = dae_of("small", "x=2 w", *laws, inputs="u", outputs="x", parameters=[K_SWITCHED])
    linear = mbdlft.linearize_dae(trim(reduce_index(dae), {"x": 2.0}, free=["u"]))
    target(linear.at().A, np.array([[-0.25]]), CLOSED_FORM)


@pytest.mark.parametrize("unit", [1.0, 1e6])
def test_which_state_is_held_depends_on_no_unit(unit: float) -> None:
    """The sum of charges that balance is 1000050: the large one gives way, not the small one."""
    balance = f"k*(number({unit})*a + 10*b - number(1000050))"
    variables = f"a={1e6 / unit} b=1"
    dae = dae_of("sum", variables, f"der(a) = {balance}", f"der(b) = {balance}", parameters=[K_SWITCHED])
    assert trim(reduce_index(dae)).nominal["b"] == 1.0


def test_a_slope_that_is_rounding_of_its_terms_determines_nothing() -> None:
    laws = "der(x) = number(0.1)*x + number(0.2)*x - number(0.3)*x - z", "der(z) = u - k*z"
    dae = dae_of("free", "x=3 z", *laws, inputs="u", outputs="x", parameters=[K_SWITCHED])
    assert trim(reduce_index(dae)).nominal["x"] == 3.0


MODEL = """model M
  parameter Real p(min = 1, max = 2) = 1.5;
  Real x;
  input Real u(start = {start});
  output Real y = x ^ 2;
equation
  der(x) = -x + u;
end M;
"""


@pytest.mark.parametrize(
    ("start", "value"), [("p", lambda p: p), ("2*p - 1", lambda p: 2 * p - 1), ("1.5", None)]
)
def test_start_values_of_parameters_stay_expressions(start: str, value) -> None:
    dae, report = translate(flat_model(MODEL.format(start=start)))
    linear = mbdlft.linearize_dae(operating_point(dae, report))
    for p in (1.0, 1.5, 1.9):
        C = 2 * (1.5 if value is None else value(p))
        named = {"p": p} if value else {}
        target(mbdlft.matrices_at(linear, named)[2], np.array([[C]]), CLOSED_FORM)


def test_an_input_may_be_given_as_a_parameter() -> None:
    draft = DaeDraft("given")
    draft.parameter(mbdlft.Parameter("p", 1.5, low=1.0, high=2.0))
    x, u = draft.variable("x"), draft.input("u")
    draft.equation(draft.der(x), equals=u - x)
    draft.output("y", x * x)
    linear = mbdlft.linearize_dae(trim(reduce_index(draft.dae()), at={"u": "p"}))
    target(mbdlft.matrices_at(linear, {"p": 1.9})[2], np.array([[3.8]]), CLOSED_FORM)


def test_a_root_of_a_square_of_a_negative_parameter_is_its_size() -> None:
    law = "der(x) = u - sqrt(p*(p*SX(0.3)/7))*x"
    given = {"outputs": "x", "parameters": [mbdlft.Parameter("p", -1.5, low=-2.0, high=-1.0)]}
    linear = mbdlft.linearize_dae(dae_of("negative", "x=1", law, inputs="u=1.5", **given))
    expected = np.array([[-1.9 * np.sqrt(0.3 / 7)]])
    target(mbdlft.matrices_at(linear, {"p": -1.9})[0], expected, CLOSED_FORM)


# Laws of linear models at start values that are no equilibrium, against slopes by hand.

START = ModelicaTable(point="start")
FALLING = """
model Falling
  parameter Real m(min=1, max=3) = 2;
  parameter Real c(min=5, max=9) = 6;
  Real s(start=0.5, fixed=true);
  Real v(start=0.25, fixed=true);
  input Real F(start=7);
  output Real a = der(v);
equation
  der(s) = v;
  m*(1 + s^2)*der(v) + c*s + v^3 = F;
end Falling;
"""


def linear(text: str, table: ModelicaTable = START) -> LFTModel:
    dae, report = translate(flat_model(text), table)
    return mbdlft.linearize_dae(operating_point(dae, report, table), search=0.0, prove=0.0)


def test_rates_of_the_start_are_in_the_slopes() -> None:
    model = linear(FALLING)
    points = {name: [model_value] for name, model_value in (("c", 8.0), ("m", 1.5))}
    for values in (points, random(model.parameters, 4, 3)):
        A, B, C, D = mbdlft.matrices_at(model, values)
        for k, (m, c) in enumerate(zip(values["m"], values["c"], strict=True)):
            s, v, inertia = 0.5, 0.25, m * 1.25
            rate = (7 - c * s - v**3) / inertia
            row = [-(c + 2 * m * s * rate) / inertia, -3 * v**2 / inertia]
            target(A[k], [[0, 1], row], CLOSED_FORM)
            target(C[k], [row], CLOSED_FORM)
            target(B[k], [[0], [1 / inertia]], CLOSED_FORM)
            target(D[k], [[1 / inertia]], CLOSED_FORM)


def test_initial_equations_give_states_that_depend_on_parameters() -> None:
    model = linear("""
    model Tank
      parameter Real k(min=1, max=3) = 2;
      Real x(start=3);
      Real y(start=1);
      input Real u(start=1);
      output Real z = x*y;
    initial equation
      k*x = 6;
    equation
      der(x) = u - x^2;
      der(y) = k*x^2 - y;
    end Tank;
    """)
    target(model.certificate.max_relative_error, 0.0, CLOSED_FORM, scale=1.0)
    (c,) = mbdlft.matrices_at(model, {"k": [1.25]}).C
    target(c, [[1.0, 6 / 1.25]], CLOSED_FORM)
    (a,) = mbdlft.matrices_at(model, {"k": [1.25]}).A
    target(a, [[-9.6, 0.0], [12.0, -1.0]], CLOSED_FORM)


def test_a_state_that_is_a_rate_has_the_start_of_its_variable() -> None:
    dae, report = translate(
        flat_model("""
        model Shafts
          Real phi1(start=0.2); Real phi2; Real w1(start=3); Real w2;
        equation
          w1 = der(phi1); w2 = der(phi2);
          2*der(w1) + der(w2) = -phi1 - w1^2;
          phi1 = 4*phi2;
        end Shafts;
        """)
    )
    at = operating_point(dae, report, replace(START, states=("phi1", "der(phi1)")))
    assert not at.at_rest
    target(
        np.array([at.nominal["phi1"], at.nominal["w1"], at.nominal["w2"]]), [0.2, 3.0, 0.75], CLOSED_FORM
    )
    target(np.array(at.nominal["der(w1)"]), -9.2 / 2.25, CLOSED_FORM)
    assert any("no equilibrium: der(" in note for note in notes_of_point(at))


def test_a_start_that_other_starts_overrule_is_said() -> None:
    text = """
    model Pendulum
      Real x(start=0.6); Real y; Real vx; Real vy; Real T;
    equation
      vx = der(x); vy = der(y);
      der(vx) = T*x; der(vy) = T*y - 9; x^2 + y^2 = 1;
    end Pendulum;
    """
    at = operating_point(*translate(flat_model(text)), START)
    assert "note: x is 1 and not its start 0.6, by" in notes_of_point(at)[-1]
    at = operating_point(*translate(flat_model(text.replace("Real y;", "Real y(start=-0.8);"))), START)
    target([at.nominal["x"], at.nominal["y"]], [0.6, -0.8], CLOSED_FORM)
    assert not any("not its start" in note for note in notes_of_point(at))


def test_what_is_given_replaces_starts_and_an_equilibrium_has_no_note() -> None:
    dae, report = translate(flat_model(FALLING))
    at = start_point(reduce_index(dae), {"s": 0.0, "v": 0.0, "F": 0.0})
    assert at.nominal["der(v)"] == 0.0
    assert notes_of_point(at) == []
    assert notes_of_point(operating_point(dae, report)) == []
    with pytest.raises(SceneError, match="free and moving are for an equilibrium"):
        operating_point(dae, report, ModelicaTable(point="start", free=("F",)))


def test_starts_that_contradict_the_equations_are_refused() -> None:
    text = FALLING.replace("der(s) = v;", "der(s) = v; s + b = 1;").replace(
        "input", "Real b(start=0, fixed=true); input"
    )
    with pytest.raises(TrimError, match=r"no consistent initial point was found; .* fix fewer of them"):
        linear(text)


def test_sizes_at_a_start_have_the_derivatives_among_the_unknowns() -> None:
    """c is zero, as its terms cancel; it has their size, and what is fixed has its own."""
    draft = DaeDraft("turned")
    k = draft.parameter(mbdlft.Parameter("k", 3.0, percent=20))
    v = draft.variable("v", start=2.0, fixed=True)
    w = draft.variable("w", start=1.0, fixed=True)
    a, b, c = (draft.variable(name) for name in "abc")
    draft.equation(draft.der(v), equals=k * v)
    draft.equation(draft.der(w), equals=-k * w)
    draft.equation(a, equals=draft.der(v))
    draft.equation(b, equals=draft.der(w))
    draft.equation(c, equals=0.5 * a + b)
    draft.output("c")
    at = start_point(reduce_index(draft.dae()))
    points = np.array([[3.0]])
    z = trimmed_points(at, points)
    made = trim_sizes(at, points, z)
    sizes = dict(zip((q.name for q in at.structure.quantities), made, strict=True))
    assert sizes["c"] >= 0.5 * sizes["a"] + sizes["b"] >= 6.0
    assert sizes["der(v)"] >= 12.0
    assert (sizes["v"], sizes["w"]) == (2.0, 1.0)
