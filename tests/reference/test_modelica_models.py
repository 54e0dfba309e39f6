"""Linear models of Modelica models against formulas from the physics, written here by hand."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from scipy.optimize import fsolve

import mbdlft
from mbdlft.modelica import operating_point
from mbdlft.pipeline.dae_models import linearize_dae
from mbdlft.system.model import LFTModel
from tests import kit
from tests.close import CROSS, target
from tests.modelica import flat

POINTS = 4
G = 9.81
Values = dict[str, float]


@cache
def model_of(name: str) -> LFTModel:
    dae, report, table = flat(name)
    return linearize_dae(operating_point(dae, report, table), search=0.0, prove=0.0)


def samples(model: LFTModel) -> list[Values]:
    drawn = mbdlft.random(model.parameters, POINTS, 5)
    return [{name: float(values[k]) for name, values in drawn.items()} for k in range(POINTS)]


def block_diagram(p: Values, s: complex) -> Any:
    return [[4.0 / (1.0 + p["p1"] * s)]]


def nonlinear_spring(p: Values, s: complex) -> Any:
    K = 100.0
    return [[K / ((p["p1"] * s**2 + K) * (p["p2"] * s**2 + K) - K**2)]]


def coupled_inertias(p: Values, s: complex) -> Any:
    return [[1.0 / ((p["J1"] + p["J2"]) * s**2 + 0.2 * s + 5.0)]]


def cartesian_pendulum(p: Values, s: complex) -> Any:
    m, L = p["m"], p["L"]
    return [[1.0 / (m * s**2 + 0.1 * s + m * G / L)]]


def motor_drive(p: Values, s: complex) -> Any:
    """Rotor and load at the slow side of the gear; Coulomb friction has the slope tau_c/w_0 at rest."""
    n, k, L, d = 20.0, 0.05, 1.5e-3, 0.05
    Z = np.array(
        [
            [p["R"] + L * s, n * k * s, 0.0],
            [-n * k, n**2 * 2e-4 * s**2 + d * s + p["c"], -(d * s + p["c"])],
            [0.0, -(d * s + p["c"]), p["J_load"] * s**2 + (0.02 + 0.3 / 0.5 + d) * s + p["c"]],
        ]
    )
    i, _, phi = np.linalg.solve(Z, [1.0, 0.0, 0.0])
    return [[s * phi], [i]]


def thermal_network(p: Values, s: complex) -> Any:
    sigma, between, T = 5.670374419e-8, 3.0 + p["G_gap"], 300.0
    slope, outside = (4.0 * p["area"] * sigma * x**3 for x in (T, 253.15))
    Z = np.array([[p["C_board"] * s + between, -between], [-between, 900.0 * s + between + slope]])
    return np.linalg.solve(Z, [[1.0, 0.0], [0.0, outside]])


def buck_converter(p: Values, s: complex) -> Any:
    """Around 12 V: the load of constant power is the conductance -P/v^2."""
    load = 1.0 / 8.0 - p["P"] / 12.0**2
    duty = (12.0 + 0.05 * (12.0 / 8.0 + p["P"] / 12.0)) / 24.0
    Y = load + 1.0 / (0.02 + 1.0 / (p["C"] * s))
    series = 0.05 + p["L"] * s
    v = 1.0 / (1.0 + series * Y)
    return [[24.0 * v, duty * v], [24.0 * v * Y, duty * v * Y]]


def first(p: Values, s: complex) -> Any:
    ratio, c = 10.0, 1e4
    Z = [[(ratio**2 + 2.0) * s**2 + 10.0 * s + c, -c], [-c, p["J_3"] * s**2 + c]]
    return [[s * np.linalg.solve(Z, [ratio, 0.0])[1]]]


def oscillator(p: Values, s: complex) -> Any:
    return [[1.0 / (p["m"] * s**2 + 1e4)], [1.0 / (p["m"] * s**2 + 10.0 * s + 1e4)]]


def two_masses(p: Values, s: complex) -> Any:
    G_12 = p["G"]
    Z = [[p["C1"] * s + G_12, -G_12], [-G_12, p["C2"] * s + G_12]]
    return np.linalg.solve(Z, [[1.0], [0.0]])


def machine_start(p: Values, s: complex) -> Any:
    """At rest the load has no slope."""
    Z = [[0.05 + 1.5e-3 * s, 0.67], [-0.67, (0.15 + p["J_load"]) * s]]
    i, w = np.linalg.solve(Z, [1.0, 0.0])
    return [[w], [i]]


def cauer_low_pass(p: Values, s: complex) -> Any:
    """A ladder, from its end to its beginning: impedances in series, admittances side by side."""
    admittance = p["c5"] * s + 1.0
    transfer = 1.0
    for shunt, bridge, coil in ((p["c3"], p["c4"], p["l2"]), (p["c1"], p["c2"], p["l1"])):
        series = 1.0 / (bridge * s + 1.0 / (coil * s))
        transfer /= 1.0 + series * admittance
        admittance = shunt * s + admittance / (1.0 + series * admittance)
    return [[transfer / (1.0 + admittance)]]


FORMULAS: list[Callable[[Values, complex], Any]] = [
    *(block_diagram, nonlinear_spring, coupled_inertias, cartesian_pendulum, motor_drive),
    *(thermal_network, buck_converter, first, oscillator, two_masses, machine_start),
    cauer_low_pass,
]
FREQUENCIES = {
    "thermal_network": (1e-4, 1e-2),
    "buck_converter": (3e2, 7e3, 1e5),
    "first": (3.0, 90.0),
    "oscillator": (30.0, 105.0),
}


@pytest.mark.parametrize("formula", FORMULAS, ids=lambda formula: formula.__name__)
def test_transfer_functions_are_those_of_the_formulas(formula: Callable[[Values, complex], Any]) -> None:
    model = model_of(formula.__name__)
    for p in samples(model):
        for w in FREQUENCIES.get(formula.__name__, (0.3, 2.0, 17.0)):
            s = 0.1 * w + 1j * w
            target(kit.transfer(model, s, p), formula(p, s), CROSS)


@pytest.mark.parametrize(
    ("name", "order"),
    [
        ("cauer_low_pass", 7),
        ("two_masses", 3),
        ("cartesian_pendulum", 2),
        ("coupled_inertias", 2),
        ("motor_drive", 3),
        ("thermal_network", 3),
    ],
)
def test_orders_are_their_proved_bounds(name: str, order: int) -> None:
    certificate = model_of(name).certificate
    assert model_of(name).order == order == sum(certificate.lower_bound)
    assert certificate.exact


def test_the_accelerated_mass_has_the_states_of_its_source() -> None:
    dae, report, table = flat("accelerate")
    point = operating_point(dae, report, replace(table, at={"step.y": 0.0}))
    model = linearize_dae(point, search=0.0, prove=0.0)
    for p in samples(model):
        s = 0.3 + 1j
        target(kit.transfer(model, s, p), [[1.0 / s**2], [p["m"]]], CROSS)


def test_modes_of_the_chua_circuit() -> None:
    model = model_of("chua_circuit")
    for p in samples(model):
        A = np.asarray(mbdlft.matrices_at(model, {k: [x] for k, x in p.items()}).A)[0]
        L, C1, C2, g, inner = p["L"], p["C1"], 100.0, 0.565, -0.757576
        expected = [
            [-12.5e-3 / L, 0.0, 1.0 / L],
            [0.0, -(g + inner) / C1, g / C1],
            [-1.0 / C2, g / C2, -g / C2],
        ]
        target(np.poly(A), np.poly(expected), CROSS)


# formulas of motion, and their derivatives by complex steps ------------------------------------


def slopes(f: Callable[[Any], Any], x: Any, scale: Any) -> Any:
    """The derivative (n, m) of f at x (m,), by complex steps: exact to rounding."""
    columns = []
    for k in range(len(x)):
        z = np.array(x, dtype=complex)
        z[k] += 1e-30j * scale[k]
        columns.append(np.imag(f(z)) / (1e-30 * scale[k]))
    return np.stack(columns, axis=1)


TABLE = np.array(
    [
        [-0.15, -0.40, 0.110],
        [-0.05, 0.09, 0.045],
        [0.05, 0.58, -0.035],
        [0.12, 0.91, -0.105],
        [0.19, 1.19, -0.195],
        [0.26, 1.36, -0.300],
    ]
)


def interpolated(alpha: Any, column: int) -> Any:
    k = int(np.searchsorted(TABLE[:, 0], np.real(alpha))) - 1
    (a, b), (y, z) = TABLE[k : k + 2, 0], TABLE[k : k + 2, column]
    return y + (z - y) * (alpha - a) / (b - a)


def aircraft(x: Any, p: Values) -> Any:
    """Rates of V, alpha, q, theta; x has elevator and thrust behind them."""
    V, alpha, q, theta, elevator, thrust = x
    m, S, c = 1200.0, 16.2, 1.49
    C_L = interpolated(alpha, 1)
    C_m = interpolated(alpha, 2) + p["C_mq"] * q * c / (2 * V) - 1.28 * elevator + p["x_cg"] * C_L
    pressure = 1.058 * V**2 / 2
    lift, drag = pressure * S * C_L, pressure * S * (0.032 + 0.054 * C_L**2)
    gamma = theta - alpha
    gamma_rate = (lift + thrust * np.sin(alpha) - m * G * np.cos(gamma)) / (m * V)
    V_rate = (thrust * np.cos(alpha) - drag - m * G * np.sin(gamma)) / m
    return np.array([V_rate, q - gamma_rate, pressure * S * c * C_m / p["I"], q])


def test_aircraft_with_tables() -> None:
    model = model_of("aircraft_longitudinal")
    for p in samples(model):
        found = fsolve(
            lambda z, p=p: aircraft([55.0, z[0], 0.0, z[0], z[1], z[2]], p)[:3],
            [0.02, 0.0, 1100.0],
            xtol=1e-14,
        )
        alpha, elevator, thrust = found
        x = np.array([55.0, alpha, 0.0, alpha, elevator, thrust])
        J = slopes(lambda z, p=p: aircraft(z, p), x, np.ones(6))
        s = 0.4 + 1.5j
        transfer = np.linalg.solve(s * np.eye(4) - J[:, :4], J[:, 4:])
        C = np.array([[1.0, 0.0, 0.0, 0.0], [0.0, -1.0, 0.0, 1.0]])
        target(kit.transfer(model, s, p), C @ transfer, CROSS)


def servo(x: Any, p: Values) -> Any:
    """Rates of s, v, p_a, p_b; x has the opening and the force behind them. The tank has no pressure."""
    s, v, p_a, p_b, opening, f = x
    k, leak, A, V = 2e-7, 2e-12, 1e-3, 5e-4
    forth = np.real(opening) >= 0
    q_a = k * opening * np.sqrt(p["p_s"] - p_a if forth else p_a)
    q_b = -k * opening * np.sqrt(p_b if forth else p["p_s"] - p_b)
    q_a, q_b = (q + leak * (p["p_s"] - 2.0 * own) for q, own in ((q_a, p_a), (q_b, p_b)))
    stiffness = p["bulk"] / V
    return np.array(
        [
            v,
            (A * (p_a - p_b) - 2e4 * s - 500.0 * v + f) / p["m"],
            stiffness * (q_a - A * v),
            stiffness * (q_b + A * v),
        ]
    )


def test_hydraulic_servo() -> None:
    """In the middle: the flow is linear in the opening, and its gain is a root of the supply."""
    dae, report, table = flat("hydraulic_servo")
    model = linearize_dae(operating_point(dae, report, table), search=0.0, prove=0.0)
    for p in samples(model):
        full = {"p_s": 1e7} | p
        x = np.array([0.0, 0.0, full["p_s"] / 2, full["p_s"] / 2, 0.0, 0.0])
        J = slopes(lambda z, p=full: servo(z, p), x, np.array([1.0, 1.0, 1e6, 1e6, 1.0, 1.0]))
        s = 20.0 + 60j
        transfer = np.linalg.solve(s * np.eye(4) - J[:, :4], J[:, 4:])
        target(kit.transfer(model, s, p), transfer[:1], CROSS)


# the same pendulum as a scene ------------------------------------------------------------------


def scene(m: mbdlft.Parameter, L: mbdlft.Parameter, damping: float) -> mbdlft.Scene:
    return kit.scene(
        "pendulum",
        m,
        L,
        kit.body("link", 0, xx=0, ports={"tip": (0, 0, "-L")}),
        kit.point("bob", "m"),
        kit.hinge("pivot", "ground", "link", (1, 0, 0), damping=damping),
        kit.weld("tip", "link.tip", "bob"),
        gravity=(0, 0, -G),
    )


def test_pendulum_of_a_multibody_library_is_that_of_the_scene() -> None:
    model = model_of("pendulum")
    # those that the hinge prefers: its angle, and its speed, which an equation says to be the rate
    assert [x.name for x in model.states] == ["hinge.phi", "der(hinge.phi)"]
    m, L = (model.parameters[name] for name in ("m", "L"))
    ours = mbdlft.to_lft(scene(m, L, 0.05), search=0.0)
    assert sum(model.certificate.lower_bound) == ours.order == 3
    for p in samples(model):
        s = 0.2 + 3.0j
        expected = kit.transfer(ours, s, p)[[y.name for y in ours.outputs].index("pivot.angle")]
        target(kit.transfer(model, s, p)[0], expected, CROSS)


def test_pendulum_in_cartesian_coordinates_is_that_of_the_scene() -> None:
    """A horizontal force on the mass is the torque L f, and its position is L phi."""
    model = model_of("cartesian_pendulum")
    assert len(model.states) == 2
    m, L = (model.parameters[name] for name in ("m", "L"))
    ours = mbdlft.to_lft(scene(m, L, 0.0), search=0.0)
    for p in samples(model):
        s = 0.2 + 3.0j
        angle = kit.transfer(ours, s, p)[[y.name for y in ours.outputs].index("pivot.angle")][0]
        # the drag of the air turns as the damping d L^2 of the joint
        own = kit.transfer(model, s, p)[0, 0]
        target(1.0 / own - 0.1 * s, 1.0 / (p["L"] ** 2 * angle), CROSS)
