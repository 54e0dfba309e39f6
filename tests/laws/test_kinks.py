"""Functions that switch at an equilibrium: branches that are one function, and errors for two slopes."""

import casadi as ca
import numpy as np
import pytest

import mbdlft
from mbdlft.base.errors import TrimError
from mbdlft.dae import DaeDraft, reduce_index, trim
from mbdlft.modelica import flat_model, operating_point, translate
from tests.close import CLOSED_FORM, target

K = mbdlft.Parameter("k", 1.0, percent=20)


def model(force, start: float = 0.0) -> mbdlft.LFTModel:
    """der(x) = u - force(k, x) around x = start."""
    draft = DaeDraft("switch")
    k, x, u = draft.parameter(K), draft.variable("x", start=start), draft.input("u")
    draft.equation(draft.der(x), equals=u - force(k, x))
    draft.output("x")
    structure = reduce_index(draft.dae())
    return mbdlft.linearize_dae(trim(structure, at={"x": start}, free=["u"]))


@pytest.mark.parametrize(
    ("force", "slopes"),
    [
        (lambda k, x: k * ca.fabs(x), "two slopes by 'x', -1 and 1"),
        (lambda k, x: k * ca.sign(x), "jumps from -1 to 1"),
        (lambda k, x: ca.fmax(k * x, 3 * x), "two slopes"),
        (lambda k, x: ca.fmin(k * x, 0), "two slopes by 'x', 1 and 0"),
        (lambda k, x: ca.if_else(x < 0, -x, x + 2), "jumps from -2 to 0"),
        (lambda k, x: ca.if_else(x <= 0, x, 2 * x), "two slopes by 'x', 1 and 2"),
        (lambda k, x: ca.if_else(ca.sin(x) > 0, x, 2 * x), "two slopes"),
        (lambda k, x: ca.if_else(x == 0, 1, x), "jumps"),
        (lambda k, x: ca.if_else(x != 0, x, -x), "two slopes by 'x', -1 and 1"),
    ],
)
def test_no_linear_model_where_two_branches_meet(force, slopes: str) -> None:
    with pytest.raises(TrimError, match=rf"equation .*der\(x\).*{slopes}.*switches.*smooth"):
        model(force)


@pytest.mark.parametrize(
    ("force", "start", "slope"),
    [
        (lambda k, x: ca.if_else(x < 0, -x * x, x * x) + k * x, 0.0, lambda k: -k),
        (lambda k, x: x * ca.fabs(x) + k * x, 0.0, lambda k: -k),
        (lambda k, x: ca.fmax(x * x, x * x * x) + k * x, 0.0, lambda k: -k),
        (lambda k, x: k * ca.fabs(x), -2.0, lambda k: k),
        (lambda k, x: ca.if_else(x == 0, 5, k * x), -2.0, lambda k: -k),
        (lambda k, x: ca.if_else(x != 0, k * x, 5), 2.0, lambda k: -k),
        (lambda k, x: ca.fmax(k, x) * x, 0.5, lambda k: -k),  # k > x in the whole range
        (lambda k, x: ca.fabs(k - 2) * x, 0.5, lambda k: k - 2),
        (lambda k, x: ca.if_else(k * k > 0.5, 3 * x, x), 0.0, lambda k: -3 + 0 * k),
        (lambda k, x: ca.sqrt(1 / k * (1 / k)) * x, 0.5, lambda k: -1 / k),
        (lambda k, x: ca.sqrt(k * (k * ca.SX(0.3) / 7)) * x, 0.5, lambda k: -k * np.sqrt(0.3 / 7)),
        (lambda k, x: ca.sqrt((k - 3) * (k - 3)) * x, 0.5, lambda k: k - 3),
    ],
)
def test_branches_that_are_one_function_or_stay_in_the_range(force, start, slope) -> None:
    linear = model(force, start)
    assert linear.certificate.exact
    for k in (0.8, 1.0, 1.13, 1.2):
        target(mbdlft.matrices_at(linear, {"k": k})[0], np.array([[slope(k)]]), CLOSED_FORM)


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
    ("force", "at"),
    [
        *((lambda k, x: ca.fabs(x - k), at) for at in (0.8, 1.2)),
        *((lambda k, x: ca.fmax(x, k), at) for at in (0.8, 1.2)),
        *((lambda k, x: ca.if_else(x >= k, 2 * x, x + k), at) for at in (0.8, 1.2)),
        *((lambda k, x: ca.sqrt(x * x - 2 * k * x + k * k), at) for at in (0.8, 1.2)),
        *((lambda k, x: ca.sqrt(2 * x * x - 4 * k * x + 2 * k * k), at) for at in (0.8, 1.2)),
        (lambda k, x: ca.sign(k - 0.8) * x, 1.0),
        (lambda k, x: ca.if_else(k > 0.8, k, 7) * x, 1.0),
    ],
)
def test_a_kink_at_the_end_of_the_range_is_refused(force, at: float) -> None:
    """Of a state that is at the end of a range, or of a function that jumps there."""
    with pytest.raises(mbdlft.base.NotRationalError, match=r"changes its branch .* range of k"):
        model(force, at)


@pytest.mark.parametrize("switch", [lambda k: ca.fmax(k, 1.1), lambda k: ca.if_else(k < 1.1, k, 1.1)])
def test_a_switch_inside_the_range_is_refused(switch) -> None:
    with pytest.raises(mbdlft.base.NotRationalError, match=r"1.1\) changes its branch .* range of k"):
        model(lambda k, x: switch(k) * x, 0.5)


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
    k, x, u = draft.parameter(K), draft.variable("x", start=1.0), draft.input("u", start=1.0)
    draft.equation(draft.der(x), equals=u - force(k, x))
    draft.output("x")
    linear = mbdlft.linearize_dae(draft.dae())
    for k in (0.8, 1.0, 1.13, 1.2):
        target(mbdlft.matrices_at(linear, {"k": k})[0], np.array([[right(k)]]), CLOSED_FORM)


def test_a_root_that_is_a_cosine_at_the_equilibrium() -> None:
    draft = DaeDraft("slope")
    angle, k = draft.parameter(mbdlft.Angle("angle", 0, -60, 60)), draft.parameter(K)
    x, z, u = draft.variable("x"), draft.variable("z", start=1.0), draft.input("u")
    draft.equation(z, equals=(k * ca.cos(angle)) ** 2)
    draft.equation(draft.der(x), equals=u - ca.sqrt(z) * x)
    draft.output("x")
    linear = mbdlft.linearize_dae(draft.dae())
    for degrees, k in ((-50.0, 0.8), (0.0, 1.0), (60.0, 1.13)):
        A = mbdlft.matrices_at(linear, {"angle": degrees, "k": k})[0]
        target(A, np.array([[-k * np.cos(np.deg2rad(degrees))]]), CLOSED_FORM)


def test_decisions_do_not_depend_on_the_scale_of_an_equation() -> None:
    def made(times: float) -> mbdlft.LFTModel:
        draft = DaeDraft("tank")
        p = draft.parameter(mbdlft.Parameter("p", 1.0, percent=20))
        x, z = draft.variable("x", start=1.0), draft.variable("z", start=0.4)
        u, times_ = draft.input("u", start=1.0), draft.number(times)
        draft.equation(draft.der(x), equals=u - p * ca.sqrt(x))
        draft.equation(times_ * draft.der(z), equals=times_ * (x - z - p * ca.sqrt(z)))
        draft.output("z")
        return mbdlft.linearize_dae(draft.dae(), fit=1e-6)

    assert made(1e-12).order == made(1e12).order == made(1.0).order


@pytest.mark.parametrize(
    ("function", "at", "slope"), [(ca.sin, 0.3, 1 / np.cos(np.arcsin(0.3))), (ca.exp, 1.3, 1 / 1.3)]
)
def test_implicit_functions_with_slopes_that_are_numbers(function, at: float, slope) -> None:
    draft = DaeDraft("implicit")
    k, x, z = draft.parameter(K), draft.variable("x", start=at), draft.variable("z", start=0.4)
    u = draft.input("u", start=at)
    draft.equation(draft.der(x), equals=k * (u - x))
    draft.equation(function(z), equals=x)
    draft.output("z")
    C = mbdlft.matrices_at(mbdlft.linearize_dae(draft.dae()), {})[2]
    target(C, np.array([[slope]]), CLOSED_FORM)


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
    draft = DaeDraft("negative")
    p = draft.parameter(mbdlft.Parameter("p", -1.5, low=-2.0, high=-1.0))
    x, u = draft.variable("x", start=1.0), draft.input("u", start=1.5)
    draft.equation(draft.der(x), equals=u - ca.sqrt(p * (p * ca.SX(0.3) / 7)) * x)
    draft.output("x")
    linear = mbdlft.linearize_dae(draft.dae())
    expected = np.array([[-1.9 * np.sqrt(0.3 / 7)]])
    target(mbdlft.matrices_at(linear, {"p": -1.9})[0], expected, CLOSED_FORM)
