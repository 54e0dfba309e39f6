"""The scheduled controllers of the arm: their gains by mechanics of its own, at many values."""

from itertools import product
from pathlib import Path

import numpy as np
import pytest

import mbdlft
from mbdlft.base.array import Array
from mbdlft.base.parameter import to_physical
from mbdlft.synthesis import load_tuning, scheduled
from mbdlft.synthesis.description import TuningTask
from mbdlft.system.model import LFTModel

FOLDER = Path(__file__).parents[2] / "scenarios" / "tasks"
FREQUENCIES = np.geomspace(1e-3, 1e3, 120)


def controller_of(task: TuningTask, model: LFTModel) -> mbdlft.System:
    (K,) = task.controllers
    names, functions = task.schedules[K.name]
    made = scheduled(K, [model.parameters[name] for name in names], functions)
    return made.with_values(task.initial)


def stiffness_and_mass(v: dict[str, float], zero: float) -> tuple[Array, Array]:
    """Of bodies at heights l1 cos(a) + l2 cos(b), with a = theta1 + zero and b = a + theta2."""
    a = np.deg2rad(v["theta1"] + zero)
    b = a + np.deg2rad(v["theta2"])
    M, K = np.array([[v["J1"] + 0.1, 0.1], [0.1, 0.1]]), 0.1 * np.eye(2)
    for m, l1, l2 in ((v["m1"], v["rho1"], 0.0), (2.0, 1.0, 0.5 * v["L2"]), (v["m3"], 1.0, v["L2"])):
        x, y = l1 * np.cos(a) + l2 * np.cos(b), l2 * np.cos(b)
        J = np.array([[x, y], [-l1 * np.sin(a) - l2 * np.sin(b), -l2 * np.sin(b)]])
        M, K = M + m * J.T @ J, K - 9.81 * m * np.array([[x, y], [y, y]])
    return K, M


def gammas(controller: mbdlft.System, model: LFTModel, deltas: Array, zero: float) -> Array:
    """Largest weighted error and torque, and real part of a pole, at each point."""
    found = []
    for delta in deltas:
        v = {p.name: float(to_physical(p, d)) for p, d in zip(model.parameters, delta, strict=True)}
        A, B, C, D = mbdlft.matrices_at(controller, {n: v[n] for n in controller.parameters.names})
        K, M = stiffness_and_mass(v, zero)
        upper = np.hstack([np.zeros((2, 2)), np.eye(2), np.zeros((2, len(A)))])
        middle = np.linalg.solve(M, np.hstack([-K - D, -0.1 * np.eye(2), C]))
        lower = np.hstack([-B, np.zeros((len(A), 2)), A])
        poles = np.linalg.eigvals(np.vstack([upper, middle, lower]))
        s = 1j * np.concatenate([FREQUENCIES, np.abs(poles), np.abs(poles.imag)])[:, None, None]
        law = C @ np.linalg.solve(s * np.eye(len(A)) - A, B + 0 * s) + D
        error = np.linalg.inv(np.eye(2) + np.linalg.solve(M * s**2 + 0.1 * np.eye(2) * s + K, law))
        weighted = np.linalg.norm((s + 1) / (2 * s + 0.02) * error, 2, axis=(1, 2))
        torque = np.linalg.norm(law @ error, 2, axis=(1, 2)) / 1500.0
        ends = np.linalg.norm(D, 2) / 1500.0
        found.append((np.max(weighted), max(np.max(torque), ends), np.max(poles.real)))
    return np.array(found)


@pytest.mark.parametrize(
    ("task", "zero", "most"),
    [
        ("arm_scheduled", 0.0, 1.0),
        ("arm_horizontal_scheduled", -90.0, 1.281),
        ("arm_hanging_scheduled", 180.0, 1.128),
    ],
)
def test_the_printed_pair_is_reached_at_many_points_of_the_whole_box(
    task: str, zero: float, most: float
) -> None:
    """gamma1 = 0.97 and gamma2 = 0.69 of Kassarian et al. 2023, section VI.D, or `most` of them."""
    read = load_tuning(FOLDER / f"{task}.toml")
    model = mbdlft.to_lft(mbdlft.load_scene(FOLDER / read.model), search=0.0)
    random, p = np.random.default_rng(5), len(model.parameters)
    corners = np.array(list(product((-1.0, 1.0), repeat=p)))
    inside = random.uniform(-1.0, 1.0, (120, p))
    found = gammas(controller_of(read, model), model, np.vstack([corners, inside]), zero)
    assert np.all(found[:, 2] < 0.0)
    assert np.max(found[:, 0]) <= 0.97 * most
    assert np.max(found[:, 1]) <= 0.69 * most
    # both goals decide
    assert np.max(found[:, 0]) > 0.9 * most
    assert np.max(found[:, 1]) > 0.6 * most
