"""Only what a transfer needs is modeled, and the transfer stays the same."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mbdlft
from benchmarks.needs import Transfer, instructions, requests, transfers
from mbdlft.base.errors import AnalysisError, SceneError
from mbdlft.batch.rows import source_of
from mbdlft.multibody.coupling import Gear
from mbdlft.multibody.force import Tire
from tests import kit
from tests.close import roundoff
from tests.seeds import some

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

LARGE = ("balloon_gondola", "four_bar", "solar_arrays")


def scene_of(name: str, source: str, target: str, states: str) -> mbdlft.Scene:
    scene = mbdlft.load_scene(SCENARIOS / f"{name}.toml")
    chosen: dict[str, Any] = {"inputs": (source,), "outputs": (target,), "states": states}
    return scene.model_copy(update=chosen)


@pytest.mark.parametrize(
    ("name", "source", "target", "all_of_them", "needed"),
    some([row for row in TRANSFERS if row[0] not in ("four_bar", "solar_arrays")], TRANSFERS),
)
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


def test_rows_of_a_sweep_have_the_states_of_the_model() -> None:
    rows_have_states(scene_of("launcher_slosh", "gimbal.torque", "flight.angle", "needed"))
    rows_have_states(drive())


def rows_have_states(scene: mbdlft.Scene) -> None:
    model = mbdlft.to_lft(scene, search=0.0)
    values = mbdlft.random(model.parameters, 4)
    points = np.stack([values[p.name] for p in model.parameters], axis=1)
    numeric, evaluated = (source_of(given) for given in (scene, model))
    assert numeric.layout == evaluated.layout
    for found, expected in zip(numeric.rows(points)[:2], evaluated.rows(points)[:2], strict=True):
        roundoff(found, expected, kappa=1e3)


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


# States that no output sees together are gone, exactly.


def drive(*more: Any, outputs: tuple[str, ...] = ("motor.rate", "load.rate")) -> mbdlft.Scene:
    """A motor that turns a drum through a soft gear."""
    return kit.scene(
        "drive",
        mbdlft.Parameter("n", 5.0, low=4.0, high=6.0),
        mbdlft.Parameter("J", 0.3, percent=50, unit="kg m^2"),
        mbdlft.Parameter("k", 300.0, percent=30, unit="N m/rad"),
        mbdlft.Ground(ports={"load": (0.2, 0, 0)}),
        kit.body("rotor", 1.0, zz=0.01),
        kit.body("drum", 3.0, zz="J"),
        kit.hinge("motor", "ground", "rotor", (0, 0, 1)),
        kit.hinge("load", "ground.load", "drum", (0, 0, 1), preload=0),
        Gear(name="shaft", joints=("motor", "load"), ratio="n", stiffness="k", damping=0.02, preload=0),
        *more,
        inputs=["motor.torque", "load.torque"],
        outputs=outputs,
        states="needed",
    )


SECOND = (
    kit.body("blade", 1.0, zz=0.02),
    kit.hinge("fan", "ground", "blade", (0, 0, 1), damping=0.01),
    Gear(name="second", joints=("fan", "motor"), ratio="n^2", stiffness=70.0, damping=0.01, preload=0),
)


def car() -> mbdlft.Scene:
    """A body on two wheels with tires that slip, at the speed v."""
    across, tire = {"axis": (0, 1, 0)}, {"radius": "r", "camber": 0, "force": 0}
    wheels = {"front": 4e4, "rear": 5e4}
    return kit.scene(
        "car",
        mbdlft.Parameter("v", 20.0, low=10.0, high=30.0, unit="m/s"),
        mbdlft.Parameter("m", 1200.0, percent=20, unit="kg"),
        mbdlft.Ground(ports={"center": (0, 0, 0.3)}),
        kit.point("slider", 0),
        *(kit.body(name, 0, (0.5, 0.8, 0.5)) for name in wheels),
        kit.body("car", "m", (300.0, 1500.0, 1500.0), ports={"front": (1.2, 0, 0), "rear": (-1.5, 0, 0)}),
        kit.rail("aside", "ground.center", "slider", **across, preload=0),
        kit.hinge("heading", "slider", "car", (0, 0, 1), preload=0),
        *(kit.hinge(f"spin_{x}", f"car.{x}", x, **across, rate="v/r", preload=0) for x in wheels),
        *(Tire(name=f"tire_{x}", child=x, **across, **tire, cornering=c) for x, c in wheels.items()),
        velocity=("v", 0, 0),
        constants={"r": mbdlft.Constant(value=0.3, unit="m")},
        inputs=["heading.torque"],
        outputs=["heading.rate"],
        states="needed",
    )


def both_of(scene: mbdlft.Scene) -> tuple[mbdlft.LFTModel, mbdlft.LFTModel]:
    every = scene.model_copy(update={"states": "all"})
    return tuple(mbdlft.to_lft(s, search=0.0) for s in (scene, every))  # type: ignore[return-value]


def same_transfers(part: mbdlft.LFTModel, whole: mbdlft.LFTModel) -> dict[str, Any]:
    values, frequencies = mbdlft.random(whole.parameters, 5), np.array([0.3, 4.0, 250.0])
    expected = mbdlft.frequency_response(whole, values, frequencies)
    roundoff(mbdlft.frequency_response(part, values, frequencies), expected, kappa=1e6)
    return values


def test_twist_of_a_drive() -> None:
    part, whole = both_of(drive())
    names = ["motor.angle - n load.angle", "motor.rate", "load.rate"]
    assert [(s.name, s.unit) for s in part.states] == list(
        zip(names, ["rad", "rad/s", "rad/s"], strict=True)
    )
    values = same_transfers(part, whole)
    n, J, k, c = values["n"], values["J"], values["k"], 0.02
    zero, one = np.zeros(5), np.ones(5)
    motor = np.array([-k, -c * one, c * n]) / 0.01
    expected = np.array([[zero, one, -n], motor, np.array([n * k, n * c, -n * n * c]) / J])
    roundoff(mbdlft.matrices_at(part, values).A, np.moveaxis(expected, 2, 0), kappa=1e3)


def test_a_coefficient_may_divide() -> None:
    """Gears with ratios n and n^2 on both sides of a motor: one of them divides, whatever goes."""
    part, whole = both_of(drive(*SECOND, outputs=("motor.rate", "load.rate", "fan.rate")))
    same_transfers(part, whole)
    assert len(part.states) == 5
    assert part.states[0].name == "load.angle - n^-1 motor.angle"


def test_heading_of_a_car() -> None:
    """Whitcomb and Milliken (1956): v_y of the car itself, and its rate of yaw."""
    part, whole = both_of(car())
    assert [s.name for s in part.states] == ["aside.velocity - v heading.angle", "heading.rate"]
    values = same_transfers(part, whole)
    v, m, (a, b), (f, r) = values["v"], values["m"], (1.2, 1.5), (4e4, 5e4)
    across = [-(f + r) / (m * v), -(a * f - b * r) / (m * v) - v]
    yaw = [-(a * f - b * r) / (1501.0 * v), -(a * a * f + b * b * r) / (1501.0 * v)]
    expected = np.moveaxis(np.array([across, yaw]), 2, 0)
    roundoff(mbdlft.matrices_at(part, values).A, expected, kappa=1e3)


def test_both_wings_of_a_satellite_are_one() -> None:
    path = Path(__file__).parents[2] / "scenarios" / "solar_arrays.toml"
    chosen: dict[str, Any] = {"inputs": ("wheel_z.torque",), "outputs": ("flight.rotation.z",)}
    scene = mbdlft.load_scene(path).model_copy(update=chosen | {"states": "needed"})
    names = [s.name for s in mbdlft.to_lft(scene, search=0.0).states]
    assert len(names) == 10
    assert "left.mode1.displacement - right.mode1.displacement" in names


def test_what_is_not_seen_alone_goes_where_modes_are_other_functions() -> None:
    """Of a rolling disk: its heading, which no output sees, and what follows from it."""
    path = Path(__file__).parents[2] / "scenarios" / "rolling_disk.toml"
    chosen: dict[str, Any] = {
        "outputs": ("base.velocity.x", "base.angular_acceleration.z"),
        "states": "needed",
    }
    scene = mbdlft.load_scene(path)
    part, whole = (
        mbdlft.to_lft(scene.model_copy(update=chosen | more), search=0.0)
        for more in ({}, {"states": "all"})
    )
    assert set(part.states) <= set(whole.states)
    same_transfers(part, whole)


def test_a_speed_loop() -> None:
    """PI with a filter: tuned where the twist is a state; else the mode is named, and what to do."""
    controller = mbdlft.synthesis.tunable_pid("C", "e", "u", filter=100.0, scale=1.0)
    goal = mbdlft.synthesis.tracking_goal("r", "e", time=0.5)
    wires = [["drive.motor.torque", "u"], ["e", "r", "-drive.motor.rate"]]
    part, whole = both_of(drive())
    how: dict[str, Any] = {"starts": 1, "prove": False}
    assert mbdlft.tune([part, controller], [goal], wires, **how).soft < 1.0
    with pytest.raises(AnalysisError, match=r"stays on the axis.*states = 'needed'"):
        mbdlft.tune([whole, controller], [goal], wires, **how)
