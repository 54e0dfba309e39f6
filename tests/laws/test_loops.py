"""Laws of robust stability with nonlinear functions inside: the circle criterion, regions that hold."""

from collections.abc import Callable
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

import mbdlft
from mbdlft import Bounds, Parameter
from mbdlft.analyze import (
    SafeRegion,
    robust_performance,
    robust_stability,
    safe_region,
    verify,
    with_sectors,
    worst_case_gain,
)
from mbdlft.base import AnalysisError
from mbdlft.dae import Dae, DaeDraft, simulate
from mbdlft.pipeline import delta_theta
from mbdlft.system import DeltaThetaModel, matrices_at
from tests.close import target
from tests.daes import dae_of, pendulum

GAP = 0.002
WORK = 0.5  # that finds what the default finds


def lags(k: float, f: Callable[[ca.SX], ca.SX], most: float) -> Dae:
    """1/(s + 1)^3 with the feedback k f(y)."""
    d = DaeDraft("lags")
    x = [d.variable(f"x{i}", minimum=-most, maximum=most) for i in range(3)]
    u = d.input("u")
    d.equation(d.der(x[0]), equals=u - x[0] - d.number(k) * f(x[2]))
    for i in (1, 2):
        d.equation(d.der(x[i]), equals=x[i - 1] - x[i])
    d.output("y", x[2], "1")
    return d.dae()


def oscillator(k: float, damping: float) -> Dae:
    """Unit mass and spring, with the force k sin(x)."""
    law = f"der(v) = -x - 2*number({damping})*v + number({k})*sin(x)"
    limits = {"minimum": -3.2, "maximum": 3.2}
    return dae_of("oscillator", "x v", "der(x) = v", law, outputs="x", **limits)


def clipped(x: ca.SX) -> ca.SX:
    return ca.SX(ca.fmin(ca.fmax(x, -1), 1))


def test_the_circle_criterion_of_three_lags() -> None:
    """Re 1/(1 + jw)^3 >= -1/4, at w = 1: the sector [0, 4) is proved, and no larger one."""
    model = delta_theta(lags(4.0, clipped, 2.0), search=0.0)
    system = with_sectors(model)
    assert [p.role for p in system.parameters] == ["nonlinear"]
    bounds = robust_stability(system, gap=GAP)
    assert bounds.rates == {"theta_der_x0": np.inf}
    assert 1.0 - GAP <= bounds.lower <= 1.0
    assert bounds.upper >= 1.0
    below = with_sectors(delta_theta(lags(3.9, clipped, 2.0), search=0.0))
    assert robust_stability(below, work=WORK).lower >= 1.0
    assert not verify(system, bounds)


@pytest.mark.parametrize("damping", [0.1, pytest.param(0.3, marks=pytest.mark.long)])
def test_the_circle_criterion_of_an_oscillator(damping: float) -> None:
    """Slopes of sin are in [-1, 1]: the limit is one over the peak of 1/(s^2 + 2 z s + 1)."""
    limit = 2 * damping * np.sqrt(1 - damping**2)
    found = robust_stability(
        with_sectors(delta_theta(oscillator(0.5 * limit, damping), search=0.0)), gap=GAP
    )
    assert 2.0 * (1.0 - GAP) <= found.lower <= 2.0


def machine() -> DeltaThetaModel:
    """Friction, a spring that stiffens, a table, a product; masses and a gain that are uncertain."""
    d = DaeDraft("machine")
    m = d.parameter(Parameter("m", 1.0, percent=10))
    c = d.parameter(Parameter("c", 2.0, percent=10))
    x, v, w = (d.variable(name, minimum=-2, maximum=2) for name in "xvw")
    u = d.input("u")
    curve = d.table(x, [-2, -1, 0, 0.5, 2], [-0.3, -0.2, 0, 0.15, 0.3], beyond="lines")
    d.equation(d.der(x), equals=v)
    d.equation(m * d.der(v), equals=u - 4 * x - c * v - d.number(0.2) * ca.tanh(v) - curve + 0.3 * w)
    d.equation(d.der(w), equals=-3 * w + d.number(0.1) * x * v - x / 2)
    d.output("x")
    return delta_theta(d.dae(), search=0.0)


def closed_rates(
    model: DeltaThetaModel, x: np.ndarray, values: dict[str, float]
) -> tuple[np.ndarray, np.ndarray]:
    """Rates (n, N) and omega of a model whose functions do not depend on each other, without inputs."""
    A, B, C, D = matrices_at(model.linear, values)
    inputs = [s.name for s in model.linear.inputs]
    zeta = [inputs.index(name) for name in model.zeta]
    read = C[len(model.outputs) :]
    omega = read @ x
    assert not np.any(D[len(model.outputs) :][:, zeta])
    names = [s.name for s in model.linear.outputs[len(model.outputs) :]]
    theta = mbdlft.theta_values(model.functions, dict(zip(names, omega, strict=True)), check=False)
    constant = B[:, [inputs.index("one")]] if model.has_one else 0.0
    return A @ x + B[:, zeta] @ np.array([*theta.values()]) + constant, omega


def proved(model: DeltaThetaModel, ranges: dict[str, tuple[float, float]]) -> tuple[Bounds, SafeRegion]:
    system = with_sectors(model, ranges)
    bounds = robust_stability(system, rates=np.inf, gap=0.3, work=WORK)
    assert bounds.lower >= 1.0
    return bounds, safe_region(system, bounds, ranges)


def test_no_motion_leaves_a_safe_region() -> None:
    model = machine()
    ranges = dict.fromkeys(model.omega, (-1.2, 1.5))
    bounds, region = proved(model, ranges)
    small = dict.fromkeys(model.omega, (-1.2e-3, 1.2e-3))
    target(1e-6 * safe_region(with_sectors(model, ranges), bounds, small).P, region.P, 1e-5)
    n, drawn = len(region.states), np.random.default_rng(2)
    assert region.states == tuple(s.name for s in model.linear.states)
    x = drawn.standard_normal((n, 3000))
    x *= drawn.uniform(0, 1, 3000) ** (1 / n) / np.sqrt(np.einsum("in,ij,jn->n", x, region.P, x))
    for _ in range(10):
        values = {p.name: drawn.uniform(p.low, p.high) for p in model.linear.parameters}
        rates, omega = closed_rates(model, x, values)
        assert np.all(np.abs(omega) <= 1.2)
        assert np.all(np.einsum("in,ij,jn->n", rates, region.P, x) < 0.0)
    for k in range(3):
        start = dict(zip(region.states, x[:, k] / np.sqrt(region.value(x[:, k])), strict=True))
        motion = simulate(model, np.linspace(0, 30, 61), parameters=values, initial=start)
        V = [region.value(state) for state in motion.states]
        assert abs(V[0] - 1.0) < 1e-9
        assert np.all(np.diff(V) < 1e-9)
        assert V[-1] < 1e-3
    assert region.value({"x": region.extents["x"]}) >= 1.0 - 1e-9
    largest = max(abs(row @ np.linalg.inv(region.P) @ row) for row in read_rows(model))
    assert 1.2**2 * 0.99 < largest <= 1.2**2


def read_rows(model: DeltaThetaModel) -> np.ndarray:
    return matrices_at(model.linear, {}).C[len(model.outputs) :]


def test_with_slopes_any_two_motions_approach_each_other() -> None:
    """With a constant force there is no equilibrium at zero, and it depends on the parameters."""
    m = Parameter("m", 1.0, percent=20)
    laws = ("der(x) = v", "m*der(v) = 1 - 4*x - 2*v - x**3/100 - atan(v)/2")
    pressed = dae_of("pressed", "x v", *laws, outputs="x", parameters=[m], minimum=-4, maximum=4)
    model = delta_theta(pressed, search=0.0)
    assert model.has_one
    bounds, region = proved(model, dict.fromkeys(model.omega, (-3.0, 3.0)))
    drawn = np.random.default_rng(4)
    a, b = drawn.uniform(-3, 3, (2, 2, 1000))
    for m_value in (0.8, 1.0, 1.2):
        one, two = (closed_rates(model, x, {"m": m_value})[0] for x in (a, b))
        assert np.all(np.einsum("in,ij,jn->n", a - b, region.P, one - two) < 0.0)
    with pytest.raises(AnalysisError, match="constant input, and no equilibrium at zero"):
        with_sectors(model, of="sector")
    assert bounds.proved


def test_outputs_that_depend_on_uncertain_channels_have_regions() -> None:
    """omega = p x: the range is of p x, so the region is smaller by the largest p."""
    p = Parameter("p", 1.0, percent=30)
    laws = ("der(x) = u - x - tanh(p*x + 0.1*v)", "der(v) = x/10 - v")
    scaled = dae_of("scaled", "x v", *laws, inputs="u", outputs="x", parameters=[p])
    model = delta_theta(scaled, search=0.0)
    ranges = {model.omega[0]: (-1.0, 1.0)}
    _, region = proved(model, ranges)
    corner = max(
        float(row @ np.linalg.inv(region.P) @ row)
        for value in (0.7, 1.3)
        for row in matrices_at(model.linear, {"p": value}).C[1:]
    )
    assert 0.5 < corner <= 1.0


def test_a_stored_proof_belongs_to_the_bounds_of_the_functions(tmp_path: Path) -> None:
    system = with_sectors(delta_theta(lags(2.0, clipped, 2.0), search=0.0), of="sector")
    bounds = robust_stability(system, work=WORK)
    mbdlft.save_analysis(tmp_path / "a.h5", system, bounds)
    again, stored = mbdlft.load_analysis(tmp_path / "a.h5")
    assert again.parameters == system.parameters
    assert not verify(again, stored)
    wider = with_sectors(delta_theta(lags(9.0, clipped, 2.0), search=0.0), of="sector")
    assert verify(wider, stored)
    gain = worst_case_gain(system, "u", "y", gap=0.1, work=WORK)
    assert gain.rates
    assert gain.upper >= 1.0 / (1.0 + 2.0 * 0.5)
    constant = robust_stability(
        mbdlft.realize([["-1 - a", "1"], ["1", "0"]], [Parameter("a", 1.0, 0.5, 1.5)], states=1)
    )
    assert "constant parameters" in verify(system, constant)


def test_what_has_no_bounds() -> None:
    model = delta_theta(oscillator(0.1, 0.3), search=0.0)
    with pytest.raises(AnalysisError, match=r"unknown argument 'omega\.y'"):
        with_sectors(model, {"omega.y": (-1, 1)})
    with pytest.raises(AnalysisError, match=r"with_sectors: .* not inside that of the function"):
        with_sectors(model, {"omega.x": (-5, 1)})
    with pytest.raises(AnalysisError, match=r"is not finite. Give one: ranges=.'omega"):
        with_sectors(delta_theta(pendulum(), search=0.0))
    with pytest.raises(AnalysisError, match="expected 'slope' or 'sector'"):
        with_sectors(model, of="disk")  # type: ignore[arg-type]
    jump = delta_theta(lags(1.0, ca.sign, 2.0), search=0.0)
    with pytest.raises(AnalysisError, match=r"no finite slope over the range of omega\.x2: it may jump"):
        with_sectors(jump)
    system = with_sectors(model)
    with pytest.raises(AnalysisError, match="stand for nonlinear functions, and move"):
        robust_performance(system)
    with pytest.raises(AnalysisError, match=r"expected the bounds of robust_stability"):
        safe_region(
            system,
            robust_stability(mbdlft.realize([["-1 - a"]], [Parameter("a", 1.0, 0.5, 1.5)], states=1)),
            {},
        )
    weak = with_sectors(delta_theta(oscillator(0.9, 0.3), search=0.0))
    small = robust_stability(weak, gap=0.3, work=WORK)
    with pytest.raises(AnalysisError, match=r"the proof is for 0.\d+ times the box"):
        safe_region(system, small, {"omega.x": (-1, 1)})
    with pytest.raises(AnalysisError, match="has no zero inside"):
        safe_region(system, robust_stability(system, gap=0.3, work=WORK), {"omega.x": (0.5, 1)})
