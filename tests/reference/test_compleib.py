"""Static and first-order H-infinity controllers for plants of the literature.

The plants are those of F. Leibfritz, COMPleib: COnstrained Matrix-optimization Problem library,
University of Trier, 2004. The numbers of AC4 and AC8 were taken from a public copy of its data file, with
which those of AC3, HE1 and HE2 agree; REA2 and NN1 were not compared. HE1 and HE2 are helicopters, REA2 a
chemical reactor, NN1 an academic plant, AC3 a transport aircraft, AC4 a missile (Fares, Apkarian, Noll,
International Journal of Control 74, 2001), AC8 a transport aircraft in cruise (Gangsaas et al., IEEE
Transactions on Automatic Control 31, 1986). Where the library has no performance channels, w drives each
state, and u is added to the last entries of z = x. Norms are the best of several tools.
"""

from typing import Any

import numpy as np
import pytest

import mbdlft
from mbdlft.synthesis import gain_goal, tunable_gain, tunable_state_space, tune
from mbdlft.synthesis.bound import full_order_bound
from mbdlft.synthesis.loop import network
from mbdlft.synthesis.tuning import Tuner
from mbdlft.system import state_space

R = np.sqrt(0.5)
A, B, C, B1, C1, D11, D12, D21 = "A", "B", "C", "B1", "C1", "D11", "D12", "D21"
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
    "AC4": {
        A: [[-0.876, 1, -0.1209, 0], [8.9117, 0, -130.75, 0], [0, 0, -150, 0], [-1, 0, 0, -0.05]],
        B: [[0], [0], [150], [0]],
        C: [[-1, 0, 0, 0], [0, -1, 0, 0]],
        B1: [[0, 0], [0, 0], [0, 0], [0, 1]],
        C1: [[-0.25, 0, 0, 3.487], [0, 0, -3, 0]],
        D11: [[0, 0.25], [0, 0]],
        D12: [[0], [3]],
        D21: [[0, 1], [0.01, 0]],
    },
    "AC8": {
        A: [
            [-0.01365, 0.178, 0.00017, -0.561, -0.03726, 0, 0.01365, -0.01311, 0],
            [-0.01516, -0.752, 1.001, 0.00127, -0.06311, 0, 0.01516, 0.05536, 0],
            [0.00107, 0.07896, -0.8725, 0, -3.399, 0, -0.00107, -0.00581, 0],
            [0, 0, 1, 0, 0, 0, 0, 0, 0],
            [0, 0, 0, 0, -20, 10.72, 0, 0, 0],
            [0, 0, 0, 0, 0, -50, 0, 0, 0],
            [0, 0, 0, 0, 0, 0, -0.4447, 0, 0],
            [0, 0, 0, 0, 0, 0, 0, -0.4447, 0.0044],
            [0, 0, 0, 0, 0, 0, 0, -0.0044, -0.4447],
        ],
        B: [[0], [0], [0], [0], [0], [50], [0], [0], [0]],
        C: [
            [0.00646, 0.3203, -0.03358, 0, -0.1032, 0, -0.00646, -0.02358, 0],
            [1, 0, 0, 0, 0, 0, -1, 0, 0],
            [-0.01365, 0.178, 0.00017, -0.561, -0.03726, 0, 0.01365, -0.01311, 0],
            [0, -13.58, 0, 13.58, 0, 0, 0, 0, 0],
            [0, 0, 1, 0, 0, 0, 0, 0, 0],
        ],
        B1: [
            [0, 0, 0, 1, 0, 0, 0, 0, 0, 0],
            *([0] * 10 for _ in range(4)),
            [0, 0, 0, 0, 50, 0, 0, 0, 0, 0],
            [0.9431, *[0] * 9],
            [0, 1.155, *[0] * 8],
            [0, -48.82, *[0] * 8],
        ],
        C1: [
            [0.00323, 0.16015, -0.01679, 0, -0.0516, 0, -0.00323, -0.01179, 0],
            [0.5, 0, 0, 0, 0, 0, -0.5, 0, 0],
        ],
        D12: [[0.5], [0.5]],
        D21: np.eye(10)[[7, 5, 6, 9, 8]],
    },
}


def problem(name: str, order: int) -> tuple[Any, ...]:
    """Systems, goals, and connections."""
    data = {key: np.array(value, dtype=float) for key, value in PLANTS[name].items()}
    n, nu, ny = len(data[A]), data[B].shape[1], len(data[C])
    data = {B1: np.eye(n), C1: np.eye(n), D12: np.eye(n)[:, n - nu :], **data}
    nw, nz = data[B1].shape[1], len(data[C1])
    data = {D11: np.zeros((nz, nw)), D21: np.zeros((ny, nw)), **data}
    w, z, u, y = (
        [f"{label}{k}" for k in range(count)]
        for label, count in zip("wzuy", (nw, nz, nu, ny), strict=True)
    )
    plant = state_space(
        data[A],
        np.hstack([data[B1], data[B]]),
        np.vstack([data[C1], data[C]]),
        np.block([[data[D11], data[D12]], [data[D21], np.zeros((ny, nu))]]),
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


@pytest.mark.parametrize(
    ("name", "x", "printed"),
    [
        ("HE2", [282.708, -492.9584, 174.407, -304.0432], 3.9044),
        ("AC3", [65.02, 22.947, -131.65, 54.323, 102.54, 44.085, -194.54, 86.066], 3.4027),
    ],
)
def test_flat_and_narrow_valleys_are_followed(name: str, x: list[float], printed: float) -> None:
    """From values whose norms are 0.15 and 1.7 % larger; the gain of AC3 is flat at the end."""
    systems, goals, wired = problem(name, 0)
    tuner = Tuner(network(systems, wired, goals), goals, np.zeros((1, 0)))
    begun = tuner.at(np.array(x))
    assert begun.look.soft > 1.001 * printed
    assert tuner.polished(begun).look.soft < 0.9995 * printed


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "order", "norm"),
    [
        *(("HE1", 0, 0.15382), ("HE1", 1, 0.10937), ("REA2", 0, 1.14894), ("NN1", 0, 13.8471)),
        *(("HE2", 0, 3.9044), ("AC3", 0, 3.4027), ("AC4", 0, 0.935467), ("AC4", 1, 0.557438)),
        *(("AC8", 0, 2.00501), ("AC8", 1, 1.6503)),
    ],
)
def test_structured_norms(name: str, order: int, norm: float) -> None:
    made = tune(*problem(name, order), prove=False)
    found = float(mbdlft.hinf_norm(made.goals[0].loop, tolerance=1e-9).upper[0])
    assert found < 1.001 * norm
    assert found > made.goals[0].least
    assert abs(found / made.goals[0].tuned - 1.0) < 1e-4
