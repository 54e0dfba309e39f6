"""Laws of active damping begin where the rule says: poles in closed form, and the trap."""

from typing import Any

import numpy as np
import pytest

import mbdlft
from mbdlft.synthesis import (
    TunableSystem,
    acceleration_feedback,
    gain_goal,
    inertia_pd,
    integral_force_feedback,
    positive_position_feedback,
    tune,
)
from mbdlft.system import state_space
from tests.close import CLOSED_FORM, FITTED, target

W, XI, M = 7.0, 0.15, 3.0


def mode(w: float = W) -> mbdlft.System:
    """Position, rate and acceleration of M (s^2 + w^2) q = u."""
    D = [[0.0], [0.0], [1.0 / M]]
    C = [[1.0, 0.0], [0.0, 1.0], [-(w**2), 0.0]]
    names = {"inputs": ["u"], "outputs": ["q", "qdot", "a"], "name": "mode"}
    return state_space([[0.0, 1.0], [-(w**2), 0.0]], [[0.0], [1.0 / M]], C, D, **names)


def wired(plant: mbdlft.System, law: TunableSystem) -> list[list[str]]:
    """Of a law with the outputs v: they are all that drives the plant."""
    sensed, driving = law.channels
    return [
        *([f"K.{name}", f"{plant.name}.{name}"] for name in sensed),
        *([s.name, v] for s, v in zip(plant.inputs, driving, strict=True)),
    ]


def polynomial(plant: mbdlft.System, law: TunableSystem) -> np.ndarray:
    """That of the poles of the loop, with the values that the law begins at."""
    return np.poly(
        mbdlft.connect(
            [plant, law.with_values({})], wired(plant, law), inputs=[], outputs=law.channels[1]
        ).A
    )


def damped(b: float = W, xi: float = XI) -> np.ndarray:
    return np.array([1.0, 2.0 * xi * b, b**2])


LAWS: dict[str, Any] = {
    "pd": (mode(0.0), inertia_pd("K", "q", "qdot", "v", inertia=M, frequency=W, damping=XI), damped()),
    "position": (
        mode(),
        positive_position_feedback("K", "q", "v", mass=M, frequency=W, damping=XI),
        np.polymul(damped(), damped()),
    ),
    "filtered acceleration": (
        mode(),
        acceleration_feedback("K", "a", "v", mass=M, frequency=W, damping=XI, filtered=True),
        np.polymul(damped(), damped()),
    ),
    "acceleration": (
        mode(),
        acceleration_feedback("K", "a", "v", mass=M, frequency=W, damping=XI, leak=0.0),
        np.polymul(damped(), [1.0, 0.0]),
    ),
}


@pytest.mark.parametrize("name", LAWS)
def test_poles_are_those_of_the_rule(name: str) -> None:
    plant, controller, expected = LAWS[name]
    powers = W ** np.arange(len(expected))
    target(polynomial(plant, controller) / powers, expected / powers, CLOSED_FORM)


def test_an_inertia_of_several_axes() -> None:
    """J q'' = u: J (s^2 + 2 xi w s + w^2) q = 0."""
    J = np.array([[4.0, 1.0, 0.0], [1.0, 3.0, 0.0], [0.0, 0.0, 2.0]])
    q, rates, u = (["q1", "q2", "q3"], ["w1", "w2", "w3"], ["u1", "u2", "u3"])
    pd = inertia_pd("K", q, rates, u, inertia=J, frequency=W, damping=XI)
    assert len(pd.free) == 10
    gains = pd.with_values({}).D_yu
    target(gains, -np.hstack([W**2 * J, 2.0 * XI * W * J]), CLOSED_FORM)


@pytest.mark.parametrize("share", [0.1, 0.6, 1.0])
def test_integral_force_feedback_damps_a_mode_up_to_its_bound(share: float) -> None:
    """Of F = d (s^2 + z^2)/(s^2 + w^2) v, with d < 0; the largest damping is (w - z)/(2 z)."""
    z, d = 5.0, -2.0
    xi = share * (W - z) / (2.0 * z)
    names = {"inputs": ["u"], "outputs": ["F"], "name": "strut"}
    strut = state_space([[0, 1], [-(W**2), 0]], [[0.0], [1.0]], [[d * (z**2 - W**2), 0]], [[d]], **names)
    law = integral_force_feedback("K", "F", "v", frequency=W, zero=z, damping=xi, direct=d)
    found = polynomial(strut, law)
    target(found, [1.0, found[1], W**2, found[1] * z**2], CLOSED_FORM, W**3)
    # (s + a) divides it with the rest s^2 + 2 xi b s + b^2
    if share < 1.0:
        pair = max(np.roots(found), key=np.imag)
        target([-pair.real / abs(pair)], [xi], CLOSED_FORM)
    else:  # a double pair, with a gain in closed form
        target([found[1]], [W * np.sqrt(W / z)], CLOSED_FORM)


def chain() -> mbdlft.System:
    """Masses 4, 1, 0.5 kg on the ground, in a row on springs; an actuator between the second and third.

    The received load is what the third puts on the actuator with its spring, the transmitted one that of
    the second on the first.
    """
    m, k = np.array([4.0, 1.0, 0.5]), np.array([100.0, 400.0, 50.0])
    rows = np.array([[1.0, 0.0, 0.0], [-1.0, 1.0, 0.0], [0.0, -1.0, 1.0]])
    K, force = rows.T @ np.diag(k) @ rows, np.array([0.0, -1.0, 1.0])
    A = np.block([[np.zeros((3, 3)), np.eye(3)], [-K / m[:, None], np.zeros((3, 3))]])
    zero = np.zeros(3)
    C = np.array([[*(-k[2] * rows[2]), *zero], [*(k[1] * rows[1]), *zero]])
    B = np.concatenate([zero, force / m])[:, None]
    names = {"inputs": ["u"], "outputs": ["received", "transmitted"], "name": "chain"}
    return state_space(A, B, C, [[1.0], [0.0]], **names)


def test_the_transmitted_load_is_the_trap_of_integral_force_feedback() -> None:
    plant = chain()
    poles = np.unique(np.round(np.abs(np.linalg.eigvals(plant.A)), 9))
    received, transmitted = (
        integral_force_feedback("K", load, "v", frequency=poles[1], zero=0.0, damping=0.05, leak=0.01)
        for load in ("received", "transmitted")
    )
    assert np.max(np.roots(polynomial(plant, received)).real) < -1e-3
    assert np.max(np.roots(polynomial(plant, transmitted)).real) > 1e-1


def test_a_law_is_a_start_of_a_tuner() -> None:
    """What is fixed stays; a tuning that begins at values has their controllers."""
    plant = mode()
    law = acceleration_feedback("K", "a", "v", mass=M, frequency=W, damping=XI, filtered=True)
    goals, how = [gain_goal("d", "mode.q")], {"starts": 1, "prove": False}
    loop = [["u", "v", "d"], ["K.a", "mode.a"]]
    made = tune([plant, law], goals, loop, **how)
    assert set(made.values) == {"K.a0", "K.a1", "K.b0"}
    again = tune([plant, law], goals, loop, initial=made.values, **how)
    start, end = (
        mbdlft.hinf_norm(mbdlft.connect([plant, K], loop, inputs=["d"], outputs=["mode.q"])).lower[0]
        for K in (law.with_values({}), again.controllers[0])
    )
    target([mbdlft.hinf_norm(again.goals[0].loop).lower[0]], [end], FITTED)
    assert end < 0.9 * start
