"""Every command prints one JSON object when it is asked to, and the shell completes its names."""

import json
import subprocess
import sys
from pathlib import Path

import click
import pytest
from typer.main import get_command

import mbdlft
from mbdlft.cli.commands import app
from mbdlft.cli.output import time_left
from tests import kit
from tests.apart import printed
from tests.scenarios.commands import Call, Output
from tests.scenarios.test_cli_tuning import MODEL, TASK

ROOT = Path(__file__).parents[2]
ARM = "scenarios/two_link_arm.toml"
COMMANDS = get_command(app).commands  # type: ignore[attr-defined]
RUNS = {
    "check": [ARM],
    "trim": [ARM, "--set", "theta1=60"],
    "linearize": [ARM, "--search", "0"],
    "realize": ["scenarios/lateral_aircraft.toml", "--search", "0"],
    "show": ["arm.h5"],
    "poles": ["arm.h5"],
    "response": ["arm.h5", "--samples", "3"],
    "export": ["arm.h5", "-o", "arm.c"],
    "view": [ARM, "-o", "arm.html"],
    "report": ["arm.h5", "-o", "report.html"],
    "import": ["scenarios/desk_arm.urdf", "-o", "desk_arm.toml"],
    "body": ["bodies/solar_panel.toml"],
    "schema": [],
    "simulate": [ARM, "--input", "shoulder.torque=step:1", "--until", "0.1"],
    "sweep": ["arm.h5", "--random", "3", "-o", "arm.h5"],
    "margin": ["mass.h5", "--work", "1", "--no-save"],
    "wcgain": ["mass.h5", "--work", "1"],
    "worst": ["mass.h5", "--of", "damping", "--work", "1"],
    "verify": ["mass.h5"],
    "tune": ["task.toml", "--starts", "1", "--no-proof"],
}


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the arm, and a stable mass on a spring, in archives."""
    folder = tmp_path_factory.mktemp("json")
    for name in ("scenarios", "bodies"):
        (folder / name).symlink_to(ROOT / name)
    (folder / "model.toml").write_text(MODEL, encoding="utf-8")
    (folder / "task.toml").write_text(TASK, encoding="utf-8")
    arm = mbdlft.to_lft(mbdlft.load_scene(ROOT / ARM), search=0.0)
    mbdlft.save(folder / "arm.h5", arm)
    mass = kit.scene(
        "mass",
        mbdlft.Parameter("k", 2.0, percent=10, unit="N/m"),
        kit.point("m", 1.0),
        kit.rail("s", "ground", "m", (1, 0, 0), stiffness="k", damping=0.5),
    )
    model = mbdlft.to_lft(mass, search=0.0)
    mbdlft.save(folder / "mass.h5", model)
    mbdlft.save_analysis(folder / "mass.h5", model, mbdlft.robust_stability(model))
    return folder


def test_every_command_is_tried() -> None:
    assert set(RUNS) == set(COMMANDS)


@pytest.mark.parametrize("name", RUNS)
def test_command_prints_json(
    place: Path, monkeypatch: pytest.MonkeyPatch, name: str, output: Output
) -> None:
    monkeypatch.chdir(place)
    out = output(name, *RUNS[name], "--json")
    found = json.loads(out, parse_constant=lambda word: pytest.fail(f"{word} is not JSON"))
    assert found


def test_the_package_is_a_command() -> None:
    command = [sys.executable, "-m", "mbdlft", "--help"]
    said = subprocess.run(command, capture_output=True, text=True, check=True, cwd=ROOT).stdout
    assert all(name in said for name in COMMANDS)


def test_show_says_what_is_stored_and_from_when(
    place: Path, monkeypatch: pytest.MonkeyPatch, call: Call
) -> None:
    monkeypatch.chdir(place)
    model = mbdlft.load("mass.h5")
    mbdlft.save_analysis("mass.h5", model, mbdlft.robust_stability(model))
    _, out, _ = call("show", "mass.h5", "--json")
    found = json.loads(out)
    assert isinstance(model, mbdlft.LFTModel)
    assert found["models"][0]["created"] == model.provenance.created
    assert "robust stability" in [entry["kind"] for entry in found["analyses"]]
    _, out, _ = call("show", "mass.h5")
    assert f"made {model.provenance.created}" in out
    assert "analysis" in out


def test_shell_completes() -> None:
    """Commands first; the options of a command are its business, so one process is enough."""
    asked = {"_MBDLFT_COMPLETE": "complete_bash", "COMP_WORDS": "mbdlft lin", "COMP_CWORD": "1"}
    program = "from mbdlft.cli.commands import app; app(prog_name='mbdlft')"
    assert printed(program, **asked).split() == ["linearize"]


def test_help_lists_every_option_with_words() -> None:
    for name, command in COMMANDS.items():
        assert command.help, name
        for option in command.params:
            if isinstance(option, click.Option):
                assert option.help, (name, option.name)


@pytest.mark.parametrize(
    ("seconds", "done", "count", "words"),
    [
        (1.0, 0, 10, ""),
        (1.0, 10, 10, ""),
        (2.0, 1, 5, "about 8 s left"),
        (60.0, 1, 4, "about 3 min left"),
        (3600.0, 2, 5, "about 1 h 30 min left"),
    ],
)
def test_time_that_is_left(seconds: float, done: int, count: int, words: str) -> None:
    assert time_left(seconds, done, count) == words
