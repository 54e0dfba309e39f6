"""Notes and warnings of commands: in the text, and in the JSON."""

import json
from pathlib import Path
from typing import Any

import pytest

import mbdlft
from tests import kit
from tests.scenarios.commands import Call, Output

LEANS = {"position": "20*deg"}


def pole(*more: Any, pivot: Any = LEANS, mass: Any = 0.1, J: Any = 0.01, **fields: Any) -> mbdlft.Scene:
    """A pole that leans on a cart; it has a constant and a port that nothing uses."""
    return kit.scene(
        "pole",
        kit.point("cart", 1.0),
        kit.body(
            "pole", mass, xx=J, center_of_mass=(0, 0, 0.5), ports={"tip": (0, 0, 1), "eye": (0, 0, 0.9)}
        ),
        kit.rail("track", "ground", "cart", (0, 1, 0)),
        kit.hinge("pivot", "cart", "pole", (1, 0, 0), **pivot),
        mbdlft.Position(name="seen", port="pole.tip"),
        *more,
        **{"gravity": (0, 0, -9.81), "constants": {"spare": 2.0}, "inputs": ["track.force"], **fields},
    )


HELD = "note: pivot.torque holds the equilibrium with -0.1678 N m at nominal, and is no input"

Patch, Capture = pytest.MonkeyPatch, pytest.CaptureFixture[str]


def written(tmp_path: Path, scene: mbdlft.Scene | None = None) -> str:
    file = tmp_path / "pole.toml"
    file.write_text(mbdlft.scene_to_toml(scene or pole()), encoding="utf-8")
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
    "changed",
    [
        {"inputs": ["track.force", "pivot.torque"]},
        {"pivot": {"preload": 0}},
        {"pivot": LEANS | {"stiffness": 30}},  # its static load
    ],
)
def test_no_note_where_all_is_said(changed: dict[str, Any], tmp_path: Path, output: Output) -> None:
    out = output("check", written(tmp_path, pole(**changed)))
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
        spring = kit.spring("s", "ground.end", "b", stiffness=9.0)
        joint = kit.rail("j", "ground", "b", (0, 0, 1), preload=0)
        on_spring = kit.scene("s", ground, kit.point("b", 1.0), joint, spring, gravity=(0, 0, -9.81))
        assert ("in compression at nominal: spring 's'" in " ".join(mbdlft.notes(on_spring))) is pushed


def test_what_is_used_and_changes_nothing(tmp_path: Path, call: Call) -> None:
    """A parameter that cancels, a sensor that is no output."""
    p, unused = (
        mbdlft.Parameter("p", 1, percent=5, unit="kg m^2"),
        mbdlft.Parameter("unused", 1, percent=5),
    )
    scene = pole(p, unused, J="0.01 + 0*p", outputs=["pivot.angle"])
    code, out, _ = call("linearize", written(tmp_path, scene))
    out = " ".join(out.split())
    assert code == 0
    assert "parameter 'p' has no effect on this model." in out
    assert "parameter 'unused' is declared and not used." in out
    assert "parameter 'unused' has no effect" not in out
    assert "sensor 'seen' is declared, and none of its signals is an output." in out


@pytest.mark.filterwarnings("always::mbdlft.base.errors.MbdlftWarning")
@pytest.mark.parametrize("command", ["check", "trim", "poles", "response", "linearize"])
def test_json_of_every_command_has_warnings(command: str, tmp_path: Path, call: Call) -> None:
    scene = pole(pivot={"preload": 0, "damping": -2.0})
    code, out, err = call(command, written(tmp_path, scene), "--json")
    said = "joint 'pivot': damping is negative in the range: -2 N m s/rad."
    assert code == 0
    assert f"mbdlft: warning: {said}" in err
    assert json.loads(out)["warnings"][0] == said


def test_sweep_says_that_it_replaces_rows(tmp_path: Path, call: Call) -> None:
    scene = pole(mbdlft.Parameter("m", 0.1, percent=5, unit="kg"), mass="m")
    file, archive = written(tmp_path, scene), str(tmp_path / "rows.h5")
    wanted = ("sweep", file, "--random", "3", "-o", archive, "--workers", "1")
    code, _, err = call(*wanted)
    assert (code, "replaced" in err) == (0, False)
    code, out, err = call(*wanted, "--seed", "1", "--json")
    assert code == 0
    assert "mbdlft: warning:" in err
    assert "the sweep 'pole' that is stored there is replaced" in err
    assert "is replaced" in json.loads(out)["warnings"][0]


def test_long_lists_of_zeros_are_short(output: Output) -> None:
    out = output("check", "scenarios/solar_arrays.toml")
    (line,) = [line for line in out.splitlines() if line.startswith("zero at equilibrium")]
    assert "more (--json has all)" in line
    assert line.count(",") == 5
