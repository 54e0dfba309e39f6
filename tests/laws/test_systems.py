"""Laws of the algebra of systems: sampled, then connected by python-control = connected, then sampled.

Two models that share a parameter, a weight and a controller of python-control; 1000 random points and
all corners.
"""

from collections.abc import Callable
from typing import Any

import control
import numpy as np
import pytest

import mbdlft
from mbdlft import LFTModel, Parameter, System, append, connect, feedback, matrices_at, realize, series
from mbdlft.system import evidence, lft
from tests import kit
from tests.close import CLOSED_FORM, SCENARIO

K = Parameter("k", 40.0, low=30.0, high=60.0, unit="N/m")
M = Parameter("m", 3.0, percent=20, unit="kg")
C = Parameter("c", 0.4, percent=50)
ROWS = "0 1 0 0; -k/m -0.4/m 1/m 2/m; 1 0 0 0; -k/m 0 1/m 0.1"
CART = kit.plant(ROWS, [K, M], "p v", "force gust", "position load", name="cart")
SPRING = kit.plant("-c k/40 0; 1 -3*c c; 1 0 0.2", [C, K], "a b", "stroke", "pull", name="spring")
WEIGHT = control.tf([1.0, 2.0], [0.1, 1.0], name="weight", inputs=["r"], outputs=["e"])
CONTROLLER = control.ss(
    [[-5.0, 1.0], [0.0, -8.0]],
    [[1.0, 0.5], [0.2, 2.0]],
    [[3.0, 1.0], [0.0, -2.0]],
    [[0.1, 0.0], [0.0, 0.3]],
    name="controller",
    inputs=["y1", "y2"],
    outputs=["u1", "u2"],
)
ONE = control.ss([[-5.0]], [[1.0]], [[3.0]], [[0.1]], name="one", inputs=["y"], outputs=["u"])


def points(model: System, count: int = 1000) -> dict[str, np.ndarray]:
    inside, outer = mbdlft.random(model.parameters, count), mbdlft.corners(model.parameters)
    return {name: np.concatenate([inside[name], outer[name]]) for name in inside}


def known(model: System, at: dict[str, float]) -> dict[str, float]:
    return {name: at[name] for name in model.parameters.names}


def matrix(model: Any) -> np.ndarray:
    return np.block([[model.A, model.B], [model.C, model.D]])


def worst(model: System, build: Callable[..., Any], parts: tuple[System, ...]) -> float:
    """Largest error of an entry of [A B ; C D], relative to its largest size over the points."""
    at = points(model)
    samples = [dict(zip(at, values, strict=True)) for values in zip(*at.values(), strict=True)]
    expected = np.array(
        [matrix(build(*(part.at(known(part, one)) for part in parts))) for one in samples]
    )
    A, B, C_, D = matrices_at(model, at)
    found = np.block([[A, B], [C_, D]])
    assert found.shape == expected.shape
    size = np.max(np.abs(expected), axis=0)
    return float(np.max(np.abs(found - expected) / np.where(size > 0, size, 1.0)))


ARM = mbdlft.to_lft(mbdlft.load_scene("scenarios/two_link_arm.toml"), search=0.0)
MOTOR = kit.plant("-4*m3 4*m3; 1 0", [ARM.parameters["m3"]], "lag", "demand", "torque", name="motor")
PD = control.ss([[-50.0]], [[1.0]], [[-2e4]], [[500.0]], name="pd", inputs=["angle"], outputs=["command"])
NETWORK = {
    "cart.force": ["-spring.pull", "one.u"],
    "spring.stroke": "cart.position",
    "one.y": ["weight.e", "-cart.position"],
}


def network_of(cart: Any, spring: Any) -> Any:
    links = [
        ["cart.force", "-spring.pull", "one.u"],
        ["spring.stroke", "cart.position"],
        ["one.y", "weight.e", "-cart.position"],
    ]
    return control.interconnect(
        [cart, spring, WEIGHT, ONE],
        links,
        inplist=["weight.r", "cart.gust"],
        outlist=["cart.load", "one.u"],
    )


CASES: dict[str, tuple[Callable[[], System], Callable[..., Any], tuple[System, ...]]] = {
    "feedback": (
        lambda: feedback(CART, CONTROLLER),
        lambda cart: control.feedback(cart, CONTROLLER),
        (CART,),
    ),
    "feedback of two models": (
        lambda: feedback(CART["position", "force"], SPRING, sign=1),
        lambda cart, spring: control.feedback(cart, spring, sign=1),
        (CART["position", "force"], SPRING),
    ),
    "connect": (
        lambda: connect(
            [CART, SPRING, WEIGHT, ONE], NETWORK, inputs=["r", "gust"], outputs=["load", "one.u"]
        ),
        network_of,
        (CART, SPRING),
    ),
    "an arm, a motor that shares a mass, a weight and a controller": (
        lambda: connect(
            [ARM, MOTOR, WEIGHT, PD],
            [["shoulder.torque", "torque"], ["demand", "e", "-command"], ["angle", "shoulder.angle"]],
            inputs=["r", "elbow.torque"],
            outputs=["shoulder.angle", "elbow.angle", "command"],
        ),
        lambda arm, motor: control.interconnect(
            [arm, motor, WEIGHT, PD],
            [
                ["two_link_arm.shoulder_torque", "motor.torque"],
                ["motor.demand", "weight.e", "-pd.command"],
                ["pd.angle", "two_link_arm.shoulder_angle"],
            ],
            inplist=["weight.r", "two_link_arm.elbow_torque"],
            outlist=["two_link_arm.shoulder_angle", "two_link_arm.elbow_angle", "pd.command"],
        ),
        (ARM, MOTOR),
    ),
    "series": (
        lambda: series(WEIGHT, CART["position", "force"], SPRING, ONE),
        lambda cart, spring: control.series(control.ss(WEIGHT), cart, spring, ONE),
        (CART["position", "force"], SPRING),
    ),
    "product": (
        lambda: ONE * SPRING * CART["load", "gust"] * WEIGHT,
        lambda cart, spring: control.series(control.ss(WEIGHT), cart, spring, ONE),
        (CART["load", "gust"], SPRING),
    ),
    "sum": (
        lambda: SPRING - CART["position", "force"] / 2.0 + ONE,
        lambda cart, spring: spring - 0.5 * cart + ONE,
        (CART["position", "force"], SPRING),
    ),
    "lft": (
        lambda: lft(CART, SPRING, outputs=["position"], inputs=["gust"]),
        lambda cart, spring: control.ss(*_ports(cart, [1, 0], [0, 1])).lft(spring),
        (CART, SPRING),
    ),
    "append": (
        lambda: append(CART, SPRING, ONE),
        lambda cart, spring: control.append(cart, spring, ONE),
        (CART, SPRING),
    ),
}


def _ports(sample: Any, outputs: list[int], inputs: list[int]) -> tuple[np.ndarray, ...]:
    return sample.A, sample.B[:, inputs], sample.C[outputs], sample.D[np.ix_(outputs, inputs)]


def check(case: str) -> None:
    make, build, parts = CASES[case]
    model = make()
    assert isinstance(model, LFTModel)
    found = worst(model, build, parts)
    orders = dict(model.lft.blocks)
    print(f"{case}: orders {orders}, at least {model.certificate.lower_bound}, error {found:.1e}")  # noqa: T201
    assert found <= SCENARIO
    assert model.certificate.max_relative_error < CLOSED_FORM
    assert model.certificate.exact
    before = sum(np.array([dict(p.lft.blocks).get(n, 0) for n in orders]) for p in parts)
    assert np.all(np.array(list(orders.values())) <= before)


@pytest.mark.parametrize(
    "case",
    ["connect", *(pytest.param(case, marks=pytest.mark.long) for case in CASES if case != "connect")],
)
def test_connected_then_sampled(case: str) -> None:
    check(case)


def test_a_wrong_sign_in_the_wiring_is_caught(monkeypatch: pytest.MonkeyPatch) -> None:
    """The check of the evidence: LFT and state-space formulas are two computations."""
    right = evidence.wire
    monkeypatch.setattr(evidence, "wire", lambda parts, w, what: right(parts, w._replace(Ky=-w.Ky), what))
    with pytest.raises(mbdlft.AnalysisError):
        feedback(CART, CONTROLLER)


def test_what_is_missing() -> None:
    """Nothing moves without states, nothing varies without parameters or where they are not seen."""
    still = realize([["p"]], [Parameter("p", 1.0, low=0.5, high=2.0)], inputs=["u"], outputs=["y"])
    moved = mbdlft.dae.simulate(still, np.array([0.0, 1.0, 2.0]), inputs={"u": [1.0, 2.0, 3.0]})
    assert moved.outputs.ravel().tolist() == [1.0, 2.0, 3.0]
    assert "no states" in mbdlft.check_stability(still[[], []], prove=0.1).sentence
    fixed = realize([["-1", "1"], ["2", "0"]], [], states=1, inputs=["u"], outputs=["y"])
    assert float(mbdlft.export.casadi_function(fixed)()["C"]) == 2.0
