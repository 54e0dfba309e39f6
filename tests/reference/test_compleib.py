"""Static and first-order H-infinity controllers for plants of the literature.

The plants are those of F. Leibfritz, COMPleib: COnstrained Matrix-optimization Problem library,
University of Trier, 2004. The numbers of AC4 and AC8 were taken from a public copy of its data file, with
which those of AC3, HE1 and HE2 agree; REA2 and NN1 were not compared. HE1 and HE2 are helicopters, REA2 a
chemical reactor, NN1 an academic plant, AC3 a transport aircraft, AC4 a missile (Fares, Apkarian, Noll,
International Journal of Control 74, 2001), AC8 a transport aircraft in cruise (Gangsaas et al., IEEE
Transactions on Automatic Control 31, 1986). Where the library has no performance channels, w drives each
state, and u is added to the last entries of z = x. Norms are the best of several tools.
"""

import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mbdlft
from mbdlft.synthesis import gain_goal, tunable_gain, tunable_state_space, tune
from mbdlft.synthesis.bound import full_order_bound
from mbdlft.synthesis.loop import network
from mbdlft.synthesis.tuning import Tuner
from mbdlft.system import state_space

A, B, C, B1, C1, D11, D12, D21 = "A", "B", "C", "B1", "C1", "D11", "D12", "D21"
PLANTS = tomllib.loads(Path(__file__).with_name("compleib.toml").read_text(encoding="utf-8"))


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
