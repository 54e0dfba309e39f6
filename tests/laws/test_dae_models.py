"""Laws of Delta-Theta forms, equilibria and sectors."""

import math
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest

import mbdlft
from mbdlft.analyze import sector_bounds
from mbdlft.base import Angle, Parameter
from mbdlft.base.formula import NUMPY, formula_value
from mbdlft.dae import (
    Dae,
    DaeDraft,
    evaluate_form,
    formula_function,
    linear,
    reduce_index,
    simulate,
    trim,
)
from mbdlft.dae.theta.separation import Arrange
from mbdlft.pipeline import delta_theta, linearize_dae
from mbdlft.system import DeltaThetaModel, ThetaFunction
from tests.close import CLOSED_FORM, CROSS, EPS, SIMULATED, exact, target
from tests.daes import chain, coupled_inertias, dae_of, example_1, example_2, pendulum, servo

TIMES = np.linspace(0.0, 1.0, 11)
P = Parameter("p", 2.0, percent=20)
MASS_AND_SPRING = [
    Parameter("m", 2.0, percent=20, unit="kg"),
    Parameter("k", 300.0, percent=20, unit="N/m"),
]
CASES = {
    "example_1": (example_1, {"u": np.cos(TIMES)}, {}),
    "example_2": (example_2, {"tau": 50 * np.sin(TIMES)}, {"J1.phi": 0.3}),
    "pendulum": (pendulum, {"f": 2.0}, {"x": 0.3}),
    "coupled": (coupled_inertias, {"tau": np.sin(TIMES)}, {}),
    "servo": (servo, {"demand": 15.0 * np.sign(0.5 - TIMES)}, {"wl": 1.0}),
}


@pytest.mark.parametrize("count", [2, pytest.param(100, marks=pytest.mark.long)])
@pytest.mark.parametrize("arrange", ["fewest", "blocks"])
@pytest.mark.parametrize("case", CASES)
def test_simulations_agree(case: str, arrange: Arrange, count: int) -> None:
    make, inputs, initial = CASES[case]
    s = reduce_index(make())
    model = delta_theta(s, arrange, search=0.0, prove=0.0)
    drawn = np.random.default_rng(1)
    for _ in range(count):
        p = {q.name: float(drawn.uniform(q.low, q.high)) for q in s.dae.parameters}
        given = {"inputs": inputs, "parameters": p, "initial": initial}
        a, b = simulate(s, TIMES, **given), simulate(model, TIMES, **given)  # type: ignore[arg-type]
        assert a.state_names == b.state_names
        for k in range(a.states.shape[1]):
            target(b.states[:, k], a.states[:, k], SIMULATED)
        target(b.outputs, a.outputs, SIMULATED)
        assert np.max(np.abs(a.outputs)) > 0


def test_initial_values_that_are_fixed_and_initial_equations() -> None:
    d = DaeDraft("initial")
    x, y, v = d.variable("x", start=2.0, fixed=True), d.variable("y", start=5.0), d.variable("v")
    d.equation(d.der(x), equals=v)
    d.equation(d.der(y), equals=x - y)
    d.equation(v, equals=-x * y)
    d.initially(d.der(y), equals=1)
    d.output("y")
    s = simulate(d.dae(), [0.0, 1e-3])
    target(s.states[0], [2.0, 1.0], CLOSED_FORM)


def test_values_of_a_form() -> None:
    given = ({"J1.phi": 0.4, "J2.w": 2.0}, {"tau": 7.0}, {"p1": 11.0, "p2": 2.5})
    for arrange in ("fewest", "blocks"):
        rates, outputs = evaluate_form(delta_theta(example_2(), arrange), *given)  # type: ignore[arg-type]
        torque = 100 * 0.4 * (1 + 0.4**2 / 0.25)
        expected = {"J1.phi": 0, "J1.w": (7 - torque) / 11, "J2.phi": 2, "J2.w": torque / 2.5}
        target([rates[name] for name in expected], list(expected.values()), CLOSED_FORM)
        assert set(outputs) == {"phi"}


def test_values_are_given_for_aliases() -> None:
    alias = dae_of("alias", "x y", "der(x) = u - 2*x", "y = -x", inputs="u", outputs="y")
    at = trim(reduce_index(alias), {"y": 3.0}, free=["u"])
    assert at.nominal["u"] == -6.0
    assert at.nominal["y"] == 3.0


def test_simulation_against_a_closed_form() -> None:
    s = simulate(example_1(), TIMES, inputs={"u": 1.0}, parameters={"p1": 1.6, "p2": 3.5})
    x = 1 - np.exp(-TIMES / 1.6)
    target(s.states[:, 0], x, SIMULATED)
    target(s.outputs[:, 0], np.sin(4 * 3.5 * x) / 3.5, SIMULATED)


def test_a_pendulum_keeps_its_length_and_energy() -> None:
    s = simulate(reduce_index(pendulum(0.9)), TIMES, initial={"x": 0.9, "vx": 0.0})
    x, vx = s.states.T
    y = -np.sqrt(1.5**2 - x**2)
    energy = 0.5 * vx**2 * (1 + (x / y) ** 2) + 9.81 * y
    target(energy, np.full(len(x), energy[0]), SIMULATED)


def test_equal_functions_are_shared_and_parameters_taken_out() -> None:
    laws = ("der(x) = u - sin(p*x + y)*p", "der(y) = -3*y - sin(p*x + y)/p + sin(2*p*x + 2*y)*x")
    model = delta_theta(dae_of("shared", "x y", *laws, inputs="u", outputs="x", parameters=[P]))
    texts = sorted(f.text for f in model.functions)
    assert texts == ["sin(2*a1)*x", "sin(a1)"]
    assert len(model.omega) == 2
    A, B, C, D = mbdlft.matrices_at(model.linear, {"p": 2.2})
    argument = [s.name for s in model.linear.outputs].index("omega1")
    target(C[argument], [2.2, 1.0], CLOSED_FORM)
    assert not np.any(D[argument])
    assert np.count_nonzero(A) == 1
    assert B.shape == (2, 3)


def test_coefficients_of_divisors_are_divided_by() -> None:
    laws = ("der(x) = -x/(p*exp(y))", "der(y) = -3*y")
    model = delta_theta(dae_of("divisors", "x y", *laws, outputs="x", parameters=[P]))
    assert dict(model.linear.lft.blocks) == {"p": 1}
    values = np.array([1.7, 2.0, 2.3])
    target(mbdlft.matrices_at(model.linear, {"p": values}).B[:, 0, 0], -1 / values, CLOSED_FORM)


def test_arguments_that_depend_on_each_other_are_not_counted_twice() -> None:
    laws = ("der(x) = -x + (x + y)*(x - y)*sin(2*x)", "der(y) = -y")
    model = delta_theta(dae_of("dependent", "x y", *laws, outputs="x"))
    assert (len(model.functions), len(model.omega)) == (1, 2)


def test_archives_keep_functions(tmp_path: Path) -> None:
    for make in (example_2, servo, pendulum):
        model = delta_theta(make(), search=0.0)
        mbdlft.save(tmp_path / "a.h5", model)
        again = mbdlft.load(tmp_path / "a.h5", model.name)
        assert isinstance(again, DeltaThetaModel)
        assert again.functions == model.functions
        assert again.has_one == model.has_one
        exact(again.initial, model.initial)
        exact(again.zeta_at_start, model.zeta_at_start)
        exact(again.linear.lft.M22, model.linear.lft.M22)
        assert again.linear.certificate == model.linear.certificate


def test_texts_are_their_functions() -> None:
    texts = {
        "sin(a)*b - a/(b**2 + 1)": lambda a, b: np.sin(a) * b - a / (b**2 + 1),
        "t = a - b; where(t > 0, t, -2*t)": lambda a, b: np.where(a > b, a - b, 2 * (b - a)),
        "min(max(a, -0.5), 0.5) + abs(b)": lambda a, b: np.clip(a, -0.5, 0.5) + np.abs(b),
        "-a**2 - (a - (b - a))": lambda a, b: -(a**2) - (a - (b - a)),
    }
    points = np.random.default_rng(0).uniform(-2, 2, (2, 50))
    for text, function in texts.items():
        expected = function(*points)
        target(formula_value(text, dict(zip("ab", points, strict=True))), expected, CLOSED_FORM)
        symbolic = formula_function("f", ["a", "b"], text)
        target(np.array(symbolic(*points)).ravel(), expected, CLOSED_FORM)


def test_functions_of_sx_become_texts() -> None:
    from mbdlft.dae.text import formula_of

    a, b = ca.SX.sym("a"), ca.SX.sym("b")
    shared = ca.sin(a * b + 1) * ca.exp(-a)
    for expression in (
        shared / (1 + shared) - a / (b - a) / 3,
        ca.if_else(a > b, a - (b - 1), -a) * 2,
        -(a**3) + ca.fmin(a, b) ** 2 - ca.sqrt(1 + a * a),
        a / (b * (a / (b + 1))),
        (a + b) ** 4,
    ):
        text, _ = formula_of(expression, [a, b], ["a", "b"])
        points = np.random.default_rng(0).uniform(0.5, 2, (2, 20))
        expected = np.array(ca.Function("f", [a, b], [expression])(*points)).ravel()
        found = formula_value(text, dict(zip("ab", points, strict=True)), NUMPY)
        target(found, expected, CLOSED_FORM)


FUNCTIONS = {
    "sin(a)": (-3.0, 3.0),
    "a*(4*a**2 + 1)": (-0.5, 0.5),
    "tanh(a/0.1)": (-1.0, 1.0),
    "min(max(a, -1), 1)": (-4.0, 4.0),
    "exp(a) - 1": (-1.0, 1.0),
    "abs(a)*a": (-1.0, 2.0),
    "atan(a)": (-1.0, 1.0),
    "a/(1 + a**2)": (-2.0, 2.0),
}


@pytest.mark.parametrize("text", FUNCTIONS)
def test_sectors_and_slopes_hold_and_are_close(text: str) -> None:
    low, high = FUNCTIONS[text]
    f = ThetaFunction("f", ("s",), ("a",), text, ((-np.inf, np.inf),))
    found = sector_bounds(f, low, high)
    a = np.linspace(low, high, 4001)
    a = a[np.abs(a) > 1e-6]
    value = formula_value(text, {"a": a})
    ratio, slope = value / a, np.diff(value) / np.diff(a)
    for (least, most), of in ((found.sector, ratio), (found.slope, slope), (found.values, value)):
        assert least <= np.min(of)
        assert np.max(of) <= most
        width = max(np.ptp(of), 1.0)
        assert np.min(of) - least < 0.02 * width
        assert most - np.max(of) < 0.02 * width


def _lever() -> Dae:
    return dae_of(
        "lever",
        "q[rad]=0.5 w[rad/s] x[m] v[m/s]",
        "q: der(q) = w",
        "w: m*der(w)*number(0.16) = tau - m*4*sin(q)",
        "x: der(x) = v",
        "v: m*der(v) = -k*x - m*number(9.81)*(1 + 3*x)",
        inputs="tau[N m]",
        outputs="q x",
        parameters=[*MASS_AND_SPRING, Angle("theta", 30.0, plus=10.0)],
    )


def test_an_equilibrium_that_is_rational_stays_in_the_model() -> None:
    laws = ("x: der(x) = v", "v: m*der(v) = -k*x - 5*x*x*v - m*number(9.81) + u*x")
    given = {"inputs": "u[N/m]", "outputs": "x", "parameters": MASS_AND_SPRING}
    model = linearize_dae(dae_of("sagging", "x[m] v[m/s]", *laws, **given))
    values = {"m": np.array([1.7, 2.0, 2.3]), "k": np.array([250.0, 300.0, 350.0])}
    A, B, _, _ = mbdlft.matrices_at(model, values)
    sag = -values["m"] * 9.81 / values["k"]
    target(A[:, 1, 0], -values["k"] / values["m"], CLOSED_FORM)
    target(A[:, 1, 1], -5 * sag**2 / values["m"], CLOSED_FORM)
    target(B[:, 1, 0], sag / values["m"], CLOSED_FORM)
    target(mbdlft.trim_at(model, values)[:, 0], sag, CLOSED_FORM)
    assert model.certificate.minimal


@pytest.mark.parametrize(("at", "slope"), [(0.3, 0.6), (-0.3, 0.7), (1.7, 2.0)])
def test_conditions_of_numbers_are_decided(at: float, slope: float) -> None:
    """A choice and a table at an equilibrium that is a decimal."""
    d = DaeDraft("chosen")
    p = d.parameter(Parameter("p", 2.0, percent=20))
    x, u = d.variable("x"), d.input("u")
    chosen = ca.if_else(x > 0.1, x * x, d.number(0.7) * x)
    beyond = d.table(x, [-1.0, 1.1, 2.0], [5.0, 5.0, 3.56], "linear")
    d.equation(d.der(x), equals=u - p * chosen - beyond)
    d.output("x")
    model = linearize_dae(trim(reduce_index(d.dae()), {"x": at}, free=["u"]))
    steep = -1.6 if at > 1.1 else 0.0
    slope = 3.4 if at > 1.1 else slope
    A = mbdlft.matrices_at(model, {"p": [1.7, 2.2]}).A[:, 0, 0]
    target(A, -np.array([1.7, 2.2]) * slope - steep, CLOSED_FORM)


@pytest.mark.parametrize(("least", "slope"), [(0.1, 3.0), (0.9, 5.0)])
def test_a_branch_whose_condition_has_numbers_only_is_no_function(least: float, slope: float) -> None:
    law = f"der(x) = -if_else(number(0.7) > number({least}), 3*p*x, 5*p*x)"
    model = delta_theta(dae_of("decided", "x", law, outputs="x", parameters=[P]))
    assert not model.functions
    target(mbdlft.matrices_at(model.linear, {"p": 2.2}).A, [[-2.2 * slope]], CLOSED_FORM)


def test_functions_of_functions_have_values() -> None:
    """They are so steep that Newton's method for all of them at once finds nothing."""
    d, values = DaeDraft("nested"), np.linspace(-2.0, 2.0, 9)
    x = d.variable("x")
    inner, known = x, values
    for k in range(4):
        outer = d.variable(f"v{k}")
        d.equation(outer, equals=ca.sin(20 * inner) + inner * inner)
        inner, known = outer, np.sin(20 * known) + known * known
    d.equation(d.der(x), equals=-inner)
    d.output("y", inner)
    form = delta_theta(d.dae(), "blocks", search=0.0)
    for at, value in zip(values, known, strict=True):
        target(evaluate_form(form, {"x": at})[1]["y"], value, SIMULATED)


def test_an_angle_can_be_a_parameter_and_an_input_free() -> None:
    s = reduce_index(_lever())
    at = trim(s, {"q": "theta"}, free=["tau"])
    model = linearize_dae(at)
    theta = np.radians([22.0, 30.0, 38.0])
    values = {"theta": np.degrees(theta), "m": np.array([1.7, 2.0, 2.2])}
    A = mbdlft.matrices_at(model, values).A
    target(A[:, 1, 0], -4 * np.cos(theta) / 0.16, CLOSED_FORM)
    target(at.nominal["tau"], 8 * np.sin(np.radians(30.0)), CLOSED_FORM)


def test_a_steady_motion_is_an_equilibrium() -> None:
    s = reduce_index(coupled_inertias())
    at = trim(s, {"w2": 5.0}, moving=["phi2", "phi1"])
    target(at.nominal["der(phi1)"], 15.0, CLOSED_FORM)


def test_order_of_a_chain_is_its_bound() -> None:
    model = delta_theta(chain(8), prove=0.0)
    certificate = model.linear.certificate
    assert certificate.minimal
    assert dict(model.linear.lft.blocks) == {"c": 8, "k": 8, "m": 8}
    assert (len(model.functions), len(model.omega)) == (8, 8)


def test_orders_of_a_heat_exchanger_and_an_induction_machine_are_their_bounds() -> None:
    """Six cells in counterflow; and fluxes whose currents are unknowns of the equations."""
    d, n = DaeDraft("exchanger"), 6
    U, hot, cold = (
        d.parameter(Parameter(name, x, percent=20)) for name, x in zip("Uhc", (2, 1.5, 1.2), strict=True)
    )
    a, b, q = ([d.variable(f"{name}{k}") for k in range(n)] for name in "abq")
    before, after = [d.input("T1"), *a], [*b[1:], d.input("T2")]
    for k in range(n):
        d.equation(q[k], equals=U * (a[k] - b[k]))
        d.equation(d.der(a[k]), equals=hot * (before[k] - a[k]) - q[k])
        d.equation(d.der(b[k]), equals=cold * (after[k] - b[k]) + q[k])
    d.output(f"a{n - 1}")
    d.output("b0")
    assert_minimal(d, 18)
    d = DaeDraft("machine")
    Rs, Rr, Ls, Lr, Lm, w = (
        d.parameter(Parameter(name, x, percent=percent))
        for name, x, percent in (
            ("Rs", 1.0, 20),
            ("Rr", 0.8, 20),
            ("Ls", 0.11, 5),
            ("Lr", 0.115, 5),
            ("Lm", 0.1, 5),
            ("w", 100.0, 50),
        )
    )
    flux = [d.variable(f"psi{k}") for k in range(4)]
    i = [d.variable(f"i{k}") for k in range(4)]
    for k in (0, 1):
        d.equation(flux[k], equals=Ls * i[k] + Lm * i[k + 2])
        d.equation(flux[k + 2], equals=Lm * i[k] + Lr * i[k + 2])
        d.equation(d.der(flux[k]), equals=d.input(f"u{k}") - Rs * i[k])
        d.equation(d.der(flux[k + 2]), equals=-Rr * i[k + 2] + (2 * k - 1) * w * flux[3 - k])
        d.output(f"i{k}")
    assert_minimal(d, 14)


def assert_minimal(draft: DaeDraft, order: int) -> None:
    model = linearize_dae(draft.dae())
    assert model.certificate.minimal
    assert model.order == order


def test_a_fit_has_its_bound_in_the_certificate() -> None:
    p, law = Parameter("p", 2.0, percent=30), "der(x) = u - fit(sqrt(p), 1e-6)*x"
    model = linearize_dae(dae_of("orifice", "x", law, inputs="u", outputs="x", parameters=[p]))
    assert not model.certificate.exact
    bound = model.certificate.fit_error_bound
    assert 0.0 < bound <= 1e-6
    values = np.linspace(1.4, 2.6, 50)
    A = mbdlft.matrices_at(model, {"p": values}).A[:, 0, 0]
    assert np.max(np.abs(A + np.sqrt(values))) <= bound
    assert np.max(np.abs(A + np.sqrt(values))) > CROSS


@pytest.mark.parametrize("asked", [{"at": {"x": 0.1}, "free": ["f"]}, {"fit": 1e-7}], ids=["free", "fit"])
def test_slopes_that_are_not_those_of_the_equations(monkeypatch: pytest.MonkeyPatch, asked: Any) -> None:
    """A derivation with one slope of 3e-5 too much is refused, also where the equilibrium is a fit."""
    parameters = [Parameter("m", 2.0, percent=20), Parameter("k", 50.0, percent=20)]
    laws = ("der(x) = v", "m*der(v) = f - k*x*(1 + 4*x*x) - 0.3*v + 1.5*m")
    dae = dae_of("spring", "x=0.1 v", *laws, inputs="f", outputs="x", parameters=parameters)
    moved = linear._Linear._moved
    assert mbdlft.linearize_dae(dae, search=0.0, **asked).certificate.rounding_ratio < 10.0

    def wrong(self: Any, stacked: ca.SX, small: ca.SX) -> ca.SX:
        rows = moved(self, stacked, small)
        return rows + ca.vertcat(0, 1e-5 * small[3], *[0] * (rows.numel() - 2))

    monkeypatch.setattr(linear._Linear, "_moved", wrong)
    with pytest.raises(mbdlft.AnalysisError, match="Two derivations contradict each other"):
        mbdlft.linearize_dae(dae, search=0.0, **asked)


@pytest.mark.parametrize(
    ("times", "pull", "read"),
    [
        (-1.0, lambda phi: ca.cos(phi), lambda phi: ca.sin(phi)),
        (-1.0, lambda phi: math.pi / 2 - phi, lambda phi: ca.sin(phi)),
        (-(2.0**0.5), lambda phi: ca.cos(phi) - ca.sin(phi), lambda phi: ca.sin(2.0 * phi)),
        (-(3.0**0.5) / 2, lambda phi: 0.5 - ca.sin(phi), lambda phi: ca.sin(3.0 * phi)),
        (-(3.0**0.5) / 2, lambda phi: ca.cos(phi) - 0.5, lambda phi: ca.sin(phi + math.pi / 6)),
        (-1.0, lambda phi: -ca.sin(phi), lambda phi: ca.sin(phi + math.pi / 2)),
    ],
)
def test_slopes_that_vanish_at_angles_in_doubles_do(times: float, pull: Any, read: Any) -> None:
    """der(w) = g pull(phi) - w + u where the slope of an output is the cosine of a right angle."""
    d = DaeDraft("arm")
    g, u = d.parameter(Parameter("g", 9.81, low=8.0, high=11.0)), d.input("u")
    phi, w = d.variable("phi", start=0.9), d.variable("w")
    d.equation(d.der(phi), equals=w)
    d.equation(d.der(w), equals=g * pull(phi) - w + u)
    d.output("x", read(phi))
    A, B, C, _ = mbdlft.matrices_at(linearize_dae(trim(reduce_index(d.dae()))), {"g": [8.0, 9.81, 11.0]})
    assert np.max(np.abs(C)) <= 100.0 * EPS
    target(A[:, 1, 0], times * np.array([8.0, 9.81, 11.0]), CLOSED_FORM)
    exact(B[:, :, 0], [[0.0, 1.0]] * 3)


@pytest.mark.parametrize("kept", [("u",), ("y",), ()])
def test_equations_without_states_and_without_inputs_or_outputs(kept: tuple[str, ...]) -> None:
    draft = mbdlft.dae.DaeDraft("static")
    p, y = draft.parameter(Parameter("p", 1.0, percent=10)), draft.variable("y")
    draft.equation(y, equals=p * (draft.input("u") if "u" in kept else 2))
    if "y" in kept:
        draft.output("y")
    model = mbdlft.linearize_dae(draft.dae())
    assert mbdlft.matrices_at(model, {})[3].shape == (kept.count("y"), kept.count("u"))
