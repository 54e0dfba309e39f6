"""Notes and warnings of commands: in the text, and in the JSON."""

import json
from pathlib import Path

import pytest

import mbdlft
from tests.scenarios.commands import Call

POLE = """
format = "mbdlft-scene/1"
name = "pole"
gravity = [0, 0, -9.81]

[constants]
spare = 2.0

[bodies.cart]
kind = "point_mass"
mass = 1.0

[bodies.pole]
kind = "rigid"
mass = 0.1
center_of_mass = [0, 0, 0.5]
inertia = { xx = 0.01 }
ports.tip = [0, 0, 1]
ports.eye = [0, 0, 0.9]

[joints.track]
kind = "prismatic"
parent = "ground"
child = "cart"
axis = [0, 1, 0]

[joints.pivot]
kind = "revolute"
parent = "cart"
child = "pole"
axis = [1, 0, 0]
position = "20*deg"

[sensors.seen]
kind = "position"
port = "pole.tip"

[linearize]
inputs = ["track.force"]
"""
HELD = "note: pivot.torque holds the equilibrium with -0.1678 N m at nominal, and is no input"

Patch, Capture = pytest.MonkeyPatch, pytest.CaptureFixture[str]


def written(tmp_path: Path, text: str = POLE) -> str:
    file = tmp_path / "pole.toml"
    file.write_text(text, encoding="utf-8")
    return str(file)


@pytest.mark.parametrize("command", ["check", "linearize"])
def test_a_leaning_pole_is_held_by_something(command: str, tmp_path: Path, call: Call) -> None:
    code, out, _ = call(command, written(tmp_path))
    out = " ".join(out.split())
    assert code == 0
    assert HELD in out
    assert "preload = 0" in out
    assert "track.force holds" not in out
    assert "constant 'spare' is declared and not used" in out
    assert "port 'pole.eye' is declared and not used" in out
    assert "pole.tip" not in out.partition("note:")[2]


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('inputs = ["track.force"]', 'inputs = ["track.force", "pivot.torque"]'),
        ('position = "20*deg"', "preload = 0"),
        ('position = "20*deg"', 'position = "20*deg"\nstiffness = 30'),  # its static load
    ],
)
def test_no_note_where_all_is_said(old: str, new: str, tmp_path: Path, call: Call) -> None:
    code, out, _ = call("check", written(tmp_path, POLE.replace(old, new)))
    assert code == 0
    assert "holds the equilibrium" not in out.replace("efforts that hold", "")


def test_json_has_notes_and_warnings(tmp_path: Path, call: Call) -> None:
    code, out, _ = call("linearize", written(tmp_path), "--json")
    found = json.loads(out)
    assert code == 0
    assert any(note.startswith(HELD) for note in found["notes"])
    assert found["warnings"] == []


def test_notes_in_python(tmp_path: Path) -> None:
    """The same as on the command line; a spring that is pushed is told from one that pulls."""
    scene = mbdlft.load_scene(written(tmp_path))
    said = mbdlft.notes(scene)
    assert [text for text in said if text.startswith(HELD.removeprefix("note: "))]
    assert "constant 'spare' is declared and not used." in said
    for height, pushed in ((-1.0, True), (2.5, False)):
        ground = mbdlft.Ground(ports={"end": (0, 0, height)})
        spring = mbdlft.Spring(name="s", parent="ground.end", child="b", stiffness=9.0)
        body = mbdlft.PointMass(name="b", mass=1.0)
        joint = mbdlft.Prismatic(name="j", parent="ground", child="b", axis=(0, 0, 1), preload=0)
        on_spring = mbdlft.Scene(
            name="s", gravity=(0, 0, -9.81), bodies=[ground, body], joints=[joint], loads=[spring]
        )
        assert ("in compression at nominal: spring 's'" in " ".join(mbdlft.notes(on_spring))) is pushed


def test_what_is_used_and_changes_nothing(tmp_path: Path, call: Call) -> None:
    """A parameter that cancels, a sensor that is no output."""
    text = POLE.replace("xx = 0.01", 'xx = "0.01 + 0*p"')
    text += 'outputs = ["pivot.angle"]\n[parameters]\n'
    text += 'p = { nominal = 1, percent = 5, unit = "kg m^2" }\n'
    text += "unused = { nominal = 1, percent = 5 }\n"
    code, out, _ = call("linearize", written(tmp_path, text))
    out = " ".join(out.split())
    assert code == 0
    assert "parameter 'p' has no effect on this model." in out
    assert "parameter 'unused' is declared and not used." in out
    assert "parameter 'unused' has no effect" not in out
    assert "sensor 'seen' is declared, and none of its signals is an output." in out


@pytest.mark.filterwarnings("always::mbdlft.base.errors.MbdlftWarning")
@pytest.mark.parametrize("command", ["check", "trim", "poles", "response", "linearize"])
def test_json_of_every_command_has_warnings(command: str, tmp_path: Path, call: Call) -> None:
    text = POLE.replace('position = "20*deg"', "preload = 0\ndamping = -2.0")
    code, out, err = call(command, written(tmp_path, text), "--json")
    said = "joint 'pivot': damping is negative in the range: -2 N m s/rad."
    assert code == 0
    assert f"mbdlft: warning: {said}" in err
    assert json.loads(out)["warnings"][0] == said


def test_sweep_says_that_it_replaces_rows(tmp_path: Path, call: Call) -> None:
    text = (
        POLE.replace("mass = 0.1", 'mass = "m"')
        + '[parameters]\nm = { nominal = 0.1, percent = 5, unit = "kg" }\n'
    )
    file, archive = written(tmp_path, text), str(tmp_path / "rows.h5")
    wanted = ("sweep", file, "--random", "3", "-o", archive, "--workers", "1")
    code, _, err = call(*wanted)
    assert (code, "replaced" in err) == (0, False)
    code, out, err = call(*wanted, "--seed", "1", "--json")
    assert code == 0
    assert "mbdlft: warning:" in err
    assert "the sweep 'pole' that is stored there is replaced" in err
    assert "is replaced" in json.loads(out)["warnings"][0]


def test_long_lists_of_zeros_are_short(call: Call) -> None:
    code, out, _ = call("check", "scenarios/solar_arrays.toml")
    assert code == 0
    (line,) = [line for line in out.splitlines() if line.startswith("zero at equilibrium")]
    assert "more (--json has all)" in line
    assert line.count(",") == 5
