"""The elastic scenarios show what their files say, and have no pole that should not be there."""

from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import eigh

import mbdlft
from benchmarks import flexible as benchmark
from benchmarks.cases import beams
from benchmarks.cases import flexible as data
from tests.close import ARM_TABLE, CLOSED_FORM, MAST_TABLE, SAME_MESH, STABLE, target
from tests.seeds import some

SCENARIOS = Path(__file__).parents[2] / "scenarios"
NAMES = (
    "rotatory_spacecraft",
    "flexible_manipulator",
    "mast_observatory",
    "solar_arrays",
    "launcher_bending",
)


@cache
def scenario(name: str) -> mbdlft.LFTModel:
    return mbdlft.to_lft(mbdlft.load_scene(SCENARIOS / f"{name}.toml"), search=0.0)


@pytest.mark.parametrize("name", some(["mast_observatory", "launcher_bending"], NAMES))
def test_no_spurious_poles_in_the_whole_range(name: str) -> None:
    """300 samples: no pole in the right half plane, and none faster than at the corners."""
    model = scenario(name)
    values = mbdlft.random(model.parameters, 300, seed=1)
    poles = np.linalg.eigvals(mbdlft.matrices_at(model, values).A)
    fast = np.abs(poles) > data.RIGID  # those of rigid motion are split by rounding
    largest = np.max(np.abs(poles), axis=1, keepdims=True)
    assert np.max(np.where(fast, poles.real, 0.0) / largest) <= STABLE
    outer = mbdlft.matrices_at(model, mbdlft.corners(model.parameters)).A
    assert np.max(largest) <= (1.0 + STABLE) * np.max(np.abs(np.linalg.eigvals(outer)))


def test_spacecraft_with_four_different_appendages() -> None:
    """Against finite elements of the whole, assembled here, at 20 random points."""
    model = scenario("rotatory_spacecraft")
    values = mbdlft.random(model.parameters, 20, seed=4)
    bending = data.MODULUS * data.HEIGHT * data.THICKNESS**3 / 12.0
    for k in range(20):
        point = {name: float(x[k]) for name, x in values.items()}
        M, K = np.zeros((25, 25)), np.zeros((25, 25))
        M[0, 0] = data.HUB_INERTIA
        for j in range(4):
            length = point[f"L{j + 1}"]
            mesh = beams.mesh([length / 3] * 3, bending, data.DENSITY)
            mass = mesh.M.copy()
            mass[mesh.tip[0], mesh.tip[0]] += point[f"M{j + 1}"]
            mass[mesh.tip[1], mesh.tip[1]] += data.TIP_INERTIA
            place = np.zeros((8, 25))
            place[0, 0], place[1, 0] = data.HUB_RADIUS, 1.0
            place[2:, 1 + 6 * j : 7 + 6 * j] = np.eye(6)
            M += place.T @ mass @ place
            K += place.T @ mesh.K @ place
        expected = np.sqrt(eigh(K, M, eigvals_only=True)[1:])
        target(data.frequencies(model, **point) / expected, np.ones(24), SAME_MESH)


def test_a_single_different_appendage_is_seen_from_the_hub() -> None:
    model = scenario("rotatory_spacecraft")
    omega = np.linspace(4.0, 4.7, 71)

    def peaks(**values: float) -> int:
        gain = np.abs(mbdlft.frequency_response(model, values, omega)[..., 0, 0]).ravel()
        return int(np.sum((gain[1:-1] > gain[:-2]) & (gain[1:-1] > gain[2:])))

    assert peaks() == 0
    assert peaks(L1=1.15) == 1


@pytest.mark.parametrize("angle", data.ARM)
def test_manipulator_has_the_published_modes(angle: int) -> None:
    found = data.frequencies(scenario("flexible_manipulator"), elbow=float(angle), m_payload=0.1)
    target(found[:4] / data.ARM[angle], np.ones(4), ARM_TABLE)


def test_mast_has_the_published_modes() -> None:
    found = data.frequencies(scenario("mast_observatory"), lag=5e-4)
    target(found[:3] / data.MAST, np.ones(3), MAST_TABLE)


def test_arrays_are_seen_by_roll_or_by_yaw() -> None:
    """What the first frequency does to the yaw at 0 deg it does to the roll at 90 deg, and less."""
    model = scenario("solar_arrays")
    omega = np.array([3.0])

    def change(sun: float, axis: int) -> float:
        low, high = (
            mbdlft.frequency_response(model, {"sun": sun, "f1": f1}, omega).reshape(3, 5)
            for f1 in (0.22, 0.28)
        )
        return float(np.abs(high[axis, axis] - low[axis, axis]) / np.abs(low[axis, axis]))

    assert change(0.0, 0) > 50.0 * change(0.0, 2)
    assert change(90.0, 2) > 50.0 * change(90.0, 0)


def test_launcher_is_trimmed_and_bends() -> None:
    model = scenario("launcher_bending")
    values = mbdlft.random(model.parameters, 50, seed=3)
    thrust = [signal.name for signal in model.trim.signals].index("thrust.force")
    mass = 28.0 * values["line"] + values["m_slosh"] + 900.0
    found = mbdlft.trim_at(model, values)[:, thrust]
    target(found / (mass * (9.81 + values["a"])), np.ones(50), CLOSED_FORM)
    poles, modes = np.linalg.eig(model.A)
    bending = np.argmin(np.where(poles.imag > 8.0, poles.imag, np.inf))
    aft, nose = (model.C_y[k] @ modes[:, bending] for k in (1, 2))
    assert (aft / nose).real < -0.2  # a node between them


@pytest.mark.long
def test_benchmark_at_its_smallest(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(data, "SPACECRAFT", {4: data.SPACECRAFT[4]})
    monkeypatch.setattr(data, "ASSUMED", {5: data.ASSUMED[5]})
    monkeypatch.setattr(data, "large", lambda: data.spacecraft(2, parametric=True))
    monkeypatch.setattr(data, "REPETITIONS", {"length": 19, "section": 71})
    text = benchmark.tables(search=0.0)
    assert "| length | 12 | 19 | 19 | 19 (exact) |" in text
    assert "34 states and 8 parameters" in text
    monkeypatch.setattr(data, "ASSUMED", {5: data.SPACECRAFT[4]})
    with pytest.raises(AssertionError):
        benchmark.tables(search=0.0)
