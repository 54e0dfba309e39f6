"""The command `simulate`: motions beside the linear model, files, messages."""

import json
from pathlib import Path

import numpy as np
import pytest

import mbdlft
from mbdlft.dae import simulate
from tests.close import KEPT, target
from tests.scenarios.commands import Call

ARM = str(Path(__file__).parents[2] / "scenarios" / "two_link_arm.toml")
ASKED = ("simulate", ARM, "--until", "0.5", "--set", "m1=3.2", "--json")


def test_the_linear_model_holds_for_small_motions(call: Call, tmp_path: Path) -> None:
    """Ten times smaller, it is ten times nearer; the table of the last run has all columns."""
    table, figure = tmp_path / "motion.csv", tmp_path / "motion.png"
    pushed = ("--input", "shoulder.torque=step:1@0.1", "--input", "elbow.torque=sine:2:5", "--initial")
    more = ("elbow.angle=0.05", "--amplitude", "0.1", "--amplitude", "0.01", "--steps", "50")
    code, out, err = call(*ASKED, *pushed, *more, "-o", str(table), "--plot", str(figure))
    assert (code, err) == (0, "")
    large, small = json.loads(out)["runs"]
    assert 8.0 <= large["linear_error"] / small["linear_error"] <= 12.0
    lines = table.read_text(encoding="utf-8").splitlines()
    assert lines[0].split(",")[:3] == ["time", "shoulder.angle", "elbow.angle"]
    assert np.shape([[float(x) for x in line.split(",")] for line in lines[1:]]) == (51, 7)
    assert figure.read_bytes()[:4] == b"\x89PNG"


def test_a_sine_of_a_road_has_its_rate(call: Call) -> None:
    """The damper of a tire feels it; a rate that is given by itself stays."""
    file, pushed = ARM.replace("two_link_arm", "half_car"), "--input=front_road.position=sine:0.001:60"
    times = np.linspace(0.0, 1.0, 401)
    moved = {"front_road.position": 0.001 * np.sin(60.0 * times)}
    for more, rate in (((), 0.06 * np.cos(60.0 * times)), (("--input=front_road.velocity=0",), 0.0)):
        _, out, _ = call("simulate", file, pushed, *more, "--until", "1", "--json")
        run = simulate(mbdlft.load_scene(file), times, inputs={**moved, "front_road.velocity": rate})
        target(json.loads(out)["runs"][0]["largest"], np.max(np.abs(run.outputs)), KEPT)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (
            ("--input", "shoulder.torque=stairs:1"),
            "--input shoulder.torque=stairs:1: expected NAME=number",
        ),
        (
            ("--input", "sholder.torque=1"),
            "unknown input 'sholder.torque'. Did you mean 'shoulder.torque'",
        ),
        (("--initial", "elbow.angel=1"), "unknown state 'elbow.angel'. Did you mean 'elbow.angle'"),
        (("--until", "-1"), "--until -1: expected a positive time (s)."),
        (("--plot", "motion.doc"), "the figure cannot be written"),
    ],
)
def test_bad_input_of_simulate_is_named(call: Call, words: tuple[str, ...], message: str) -> None:
    code, _, err = call(*ASKED, *words)
    assert code == 2
    assert message in " ".join(err.split())
