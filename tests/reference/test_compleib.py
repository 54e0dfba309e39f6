"""Static and first-order H-infinity controllers for plants of the literature.

The plants are those of the report F. Leibfritz, COMPleib: COnstrained Matrix-optimization Problem
library, University of Trier, 2004. The numbers were written down from memory and not compared with the
report again; what speaks for them is that the norms which several tools have found are reached. HE1 and
HE2 are helicopters, REA2 a chemical reactor, NN1 an academic plant, AC3 a transport aircraft. Where the
report has no performance channels, w drives each state, and u is added to the last entries of z = x.
Norms are the best of these tools.
"""

from typing import Any

import numpy as np
import pytest

import mbdlft
from mbdlft.synthesis import gain_goal, tunable_gain, tunable_state_space, tune
from mbdlft.synthesis.bound import full_order_bound
from mbdlft.synthesis.loop import network
from mbdlft.system import state_space

R = np.sqrt(0.5)
A, B, C, B1, C1, D12 = "A", "B", "C", "B1", "C1", "D12"
PLANTS: dict[str, dict[str, Any]] = {
    "HE1": {
        A: [
            [-0.0366, 0.0271, 0.0188, -0.4555],
            [0.0482, -1.01, 0.0024, -4.0208],
            [0.1002, 0.3681, -0.707, 1.42],
            [0, 0, 1, 0],
        ],
        B: [[0.4422, 0.1761], [3.5446, -7.5922], [-5.52, 4.49], [0, 0]],
        C: [[0, 1, 0, 0]],
        B1: [[0.0468, 0], [0.0457, 0.0099], [0.0437, 0.0011], [-0.0218, 0]],
        C1: [[2 * R, 0, 0, 0], [0, R, 0, 0]],
        D12: [[R, 0], [0, R]],
    },
    "HE2": {
        A: [
            [-0.0649, 0.0787, 0.1705, -0.5616],
            [0.0386, -0.939, 4.2277, 0.0198],
            [0.1121, -0.4254, -0.7968, 0],
            [0, 0, 1, 0],
        ],
        B: [[-0.9454, 0.5313], [-8.6476, -10.769], [19.0824, -2.8959], [0, 0]],
        C: [[1, 0, 0, 0], [0, 0, 0, 1]],
    },
    "REA2": {
        A: [
            [1.38, -0.2077, 6.715, -5.676],
            [-0.5814, -4.29, 0, 0.675],
            [1.067, 4.273, -6.654, 5.893],
            [0.048, 4.273, 1.343, -2.104],
        ],
        B: [[0, 0], [5.679, 0], [1.136, -3.146], [1.136, 0]],
        C: [[1, 0, 1, -1], [0, 1, 0, 0]],
    },
    "NN1": {A: [[0, 1, 0], [0, 0, 1], [0, 13, 0]], B: [[0], [0], [1]], C: [[0, 5, -1], [-1, -1, 0]]},
    "AC3": {
        A: [
            [0, 0, 1, 0, 0],
            [0, -0.154, -0.0042, 1.54, 0],
            [0, 0.249, -1, -5.2, 0],
            [0.0386, -0.996, -0.0003, -0.117, 0],
            [0, 0.5, 0, 0, -0.5],
        ],
        B: [[0, 0], [-0.744, -0.032], [0.337, -1.12], [0.02, 0], [0, 0]],
        C: [[0, 1, 0, 0, -1], [0, 0, 1, 0, 0], [0, 0, 0, 1, 0], [1, 0, 0, 0, 0]],
    },
}


def problem(name: str, order: int) -> tuple[Any, ...]:
    """Systems, goals, and connections."""
    data = {key: np.array(value, dtype=float) for key, value in PLANTS[name].items()}
    n, nu, ny = len(data[A]), data[B].shape[1], len(data[C])
    data = {B1: np.eye(n), C1: np.eye(n), D12: np.eye(n)[:, n - nu :], **data}
    nw, nz = data[B1].shape[1], len(data[C1])
    w, z, u, y = (
        [f"{label}{k}" for k in range(count)]
        for label, count in zip("wzuy", (nw, nz, nu, ny), strict=True)
    )
    plant = state_space(
        data[A],
        np.hstack([data[B1], data[B]]),
        np.vstack([data[C1], data[C]]),
        np.block([[np.zeros((nz, nw)), data[D12]], [np.zeros((ny, nw + nu))]]),
        inputs=w + u,
        outputs=z + y,
        name="P",
    )
    read, drive = [f"k{name}" for name in y], [f"k{name}" for name in u]
    K = tunable_state_space("K", read, drive, order) if order else tunable_gain("K", read, drive)
    wired = [*zip(read, y, strict=True), *zip(u, drive, strict=True)]
    return [plant, K], [gain_goal(w, z)], wired


@pytest.mark.parametrize(
    ("name", "least"),
    [("HE1", 0.0738), ("HE2", 2.4182), ("REA2", 1.1349), ("NN1", 13.132), ("AC3", 2.9675)],
)
def test_full_order_bounds(name: str, least: float) -> None:
    systems, goals, wired = problem(name, 0)
    opened = network(systems, wired, goals)
    assert 0.985 < full_order_bound(opened, goals) / least < 0.999


def test_the_bound_of_a_direct_path() -> None:
    """z = 2 w + w/(s + 1 - k): fast feedback leaves the direct path."""
    names = {"inputs": ["w", "u"], "outputs": ["z", "y"], "name": "P"}
    plant = state_space([[-1]], [[1, 1]], [[1], [1]], [[2, 0], [0, 0]], **names)
    opened = network(
        [plant, tunable_gain("K", "e", "v")], [["e", "y"], ["u", "v"]], [gain_goal("w", "z")]
    )
    assert 1.95 < full_order_bound(opened, [gain_goal("w", "z")]) <= 2.0


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "order", "norm"),
    [
        *(("HE1", 0, 0.15382), ("HE1", 1, 0.10937), ("REA2", 0, 1.14894), ("NN1", 0, 13.8471)),
        ("AC3", 0, 3.4027),
    ],
)
def test_structured_norms(name: str, order: int, norm: float) -> None:
    made = tune(*problem(name, order), prove=False)
    found = float(mbdlft.hinf_norm(made.goals[0].loop, tolerance=1e-9).upper[0])
    assert found < 1.001 * norm
    assert found > made.goals[0].least
    assert abs(found / made.goals[0].tuned - 1.0) < 1e-4
