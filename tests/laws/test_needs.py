"""Only what a transfer needs is modeled, and the transfer stays the same.

1. The states that are left out do not change the transfer, at any value of the parameters.
2. One transfer never costs more than everything: states, instructions, channels, order.
3. What is left out wrongly is found by the check of the model.
"""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.sparse import csr_array

import mbdlft
from benchmarks.needs import Transfer, instructions, requests, transfers
from mbdlft.base.errors import AnalysisError, SceneError
from mbdlft.batch.rows import source_of
from mbdlft.problem import needs as need
from tests.close import roundoff

SCENARIOS = Path(__file__).parents[2] / "scenarios"
FREQUENCIES = np.array([0.03, 0.7, 11.0])
TRANSFERS = (
    # scene, input, output, states, those that are needed
    ("two_link_arm", "shoulder.torque", "elbow.angle", 4, 4),
    ("launcher_slosh", "gimbal.torque", "flight.angle", 10, 6),
    ("launcher_slosh", "thrust.force", "accelerometer.z", 10, 0),
    ("balloon_gondola", "hook.torque.y", "flight.position.x", 22, 8),
    ("balloon_gondola", "lift.displaced_mass", "flight.position.z", 22, 2),
    ("crane", "rail.force", "hook.y", 6, 4),
    ("gimbal", "yaw.torque", "pitch.angle", 6, 5),
    ("four_bar", "wrist.torque", "lamp.z", 2, 2),
    ("solar_arrays", "wheel_z.torque", "flight.rotation.z", 36, 10),
)


def scene_of(name: str, source: str, target: str, states: str) -> mbdlft.Scene:
    scene = mbdlft.load_scene(SCENARIOS / f"{name}.toml")
    chosen: dict[str, Any] = {"inputs": (source,), "outputs": (target,), "states": states}
    return scene.model_copy(update=chosen)


@pytest.mark.parametrize(("name", "source", "target", "all_of_them", "needed"), TRANSFERS)
def test_same_transfer_for_less(
    name: str, source: str, target: str, all_of_them: int, needed: int
) -> None:
    scenes = [scene_of(name, source, target, states) for states in ("all", "needed")]
    whole, part = (mbdlft.to_lft(scene, search=0.0) for scene in scenes)
    assert (len(whole.states), len(part.states)) == (all_of_them, needed)
    named = {state for state in part.states if " - " not in state.name}  # from a free mode
    assert named <= set(whole.states)
    assert part.trim.nominal == whole.trim.nominal
    values = mbdlft.random(whole.parameters, 5)
    expected = mbdlft.frequency_response(whole, values, FREQUENCIES)
    roundoff(mbdlft.frequency_response(part, values, FREQUENCIES), expected, kappa=1e6)
    assert part.order <= whole.order
    assert sum(part.certificate.raw_order) <= sum(whole.certificate.raw_order)


LARGE = ("balloon_gondola", "four_bar", "solar_arrays")


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=[pytest.mark.long] * (name in LARGE))
        for name in sorted({name for name, *_ in TRANSFERS})
    ],
)
def test_one_transfer_never_costs_more_than_everything(name: str) -> None:
    source, target = next(row[1:3] for row in TRANSFERS if row[0] == name)
    scene = mbdlft.load_scene(SCENARIOS / f"{name}.toml")
    scenes = [asked for _, asked in requests(Transfer(lambda: scene, source, target))]
    models = [mbdlft.to_lft(scene, search=0.0) for scene in scenes]
    for costs in (
        [len(model.states) for model in models],
        [instructions(scene) for scene in scenes],
        [sum(model.certificate.raw_order) for model in models],
        [model.order for model in models],
    ):
        assert costs == sorted(costs, reverse=True), costs


@pytest.mark.parametrize("planted", ["not seen", "not driven"])
def test_a_state_that_is_missing_is_found(planted: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Planted bug: entries of the relations are lost, so that states seem to do nothing."""
    scene = scene_of("launcher_slosh", "gimbal.torque", "flight.angle", "needed")
    right = need._pattern

    def blind(m: Any) -> csr_array:
        rows = right(m).tolil()
        if planted == "not seen":
            rows[: m.residual.numel(), m.unknown.numel() : m.unknown.numel() + 10] = 0.0
        else:
            rows[: m.residual.numel(), m.unknown.numel() + 10 :] = 0.0
        return csr_array(rows)

    monkeypatch.setattr(need, "_pattern", blind)
    with pytest.raises(AnalysisError, match="differs from the nonlinear equations"):
        mbdlft.to_lft(scene, search=0.0)


def test_rows_of_a_sweep_have_the_states_of_the_model() -> None:
    scene = scene_of("launcher_slosh", "gimbal.torque", "flight.angle", "needed")
    model = mbdlft.to_lft(scene, search=0.0)
    values = mbdlft.random(model.parameters, 4)
    points = np.stack([values[p.name] for p in model.parameters], axis=1)
    numeric, evaluated = (source_of(given) for given in (scene, model))
    assert numeric.layout == evaluated.layout
    for found, expected in zip(numeric.rows(points)[:2], evaluated.rows(points)[:2], strict=True):
        roundoff(found, expected)


def test_scene_files_say_which_states() -> None:
    scene = scene_of("crane", "rail.force", "hook.y", "needed")
    text = mbdlft.scene_to_toml(scene)
    assert 'states = "needed"' in text
    assert mbdlft.scene_from_toml(text) == scene
    assert "states" not in mbdlft.scene_to_toml(scene.model_copy(update={"states": "all"}))
    with pytest.raises(SceneError, match="states: expected 'all' or 'needed', got 'some'"):
        mbdlft.scene_from_toml(text.replace('"needed"', '"some"'))


def test_names_of_needed_states() -> None:
    model = mbdlft.to_lft(
        scene_of("balloon_gondola", "lift.displaced_mass", "flight.position.z", "needed"), search=0.0
    )
    assert [s.name for s in model.states] == ["flight.position.z", "flight.velocity.z"]


def test_one_degree_of_freedom_without_inputs_and_outputs() -> None:
    """A mode alone: xddot + 2 zeta omega xdot + omega^2 x = 0."""
    omega, zeta = 3.0, 0.01
    mode = mbdlft.Mode(frequency=omega, damping=zeta, participation=[0, 0, 0.1, 0, 0, 0])
    inertia = mbdlft.Inertia(xx=1, yy=1, zz=1)
    body = mbdlft.FlexibleBody(name="mast", mass=1, inertia=inertia, modes=[mode])
    held = mbdlft.Fixed(name="clamp", parent="ground", child="mast")
    model = mbdlft.to_lft(mbdlft.Scene(name="mode", bodies=[body], joints=[held]))
    assert (model.lft.shape, model.inputs, model.outputs) == ((2, 2), (), ())
    poles = np.sort_complex(np.linalg.eigvals(model.A))
    expected = omega * (-zeta + 1j * np.sqrt(1.0 - zeta**2) * np.array([-1.0, 1.0]))
    roundoff(poles, expected)


def test_benchmark_at_its_smallest(capsys: pytest.CaptureFixture[str]) -> None:
    rows = transfers(["launcher_slosh"], repeats=1)
    assert [row.states for row in rows] == [10, 10, 6]
    assert capsys.readouterr().out.count('"system": "launcher_slosh"') == len(rows)
