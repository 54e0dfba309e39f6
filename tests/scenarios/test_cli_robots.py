"""Commands take robots as they stand, and say on stderr what is ignored and assumed."""

import json
from pathlib import Path

import pytest

from mbdlft.multibody.scene import load_scene
from tests.errors.test_robot_format_errors import MJCF, SDF
from tests.scenarios.commands import Call

FILES = {"two.sdf": SDF, "one.xml": MJCF}


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    for name, text in FILES.items():
        (tmp_path / name).write_text(text, encoding="utf-8")
    return tmp_path


@pytest.mark.parametrize("name", FILES)
@pytest.mark.parametrize("command", ["check", "trim", "linearize"])
def test_robot_is_taken_as_it_stands(place: Path, name: str, command: str, call: Call) -> None:
    if name.endswith(".xml"):
        pytest.importorskip("mujoco", reason="MJCF needs mujoco")
    code, out, err = call(command, name, "--json")
    assert code == 0, err
    assert json.loads(out)["name"] == name.partition(".")[0]
    assert "ignored: 1 shapes" in err if name.endswith(".xml") else "assumed: gravity" in err


def test_import_takes_the_base_and_the_model(place: Path, call: Call) -> None:
    arguments = ["import", "two.sdf", "-o", "two.toml", "--fixed-base", "--model", "two"]
    assert call(*arguments)[0] == 0
    assert [joint.kind for joint in load_scene("two.toml").joints] == ["fixed", "revolute"]
    assert call("import", "two.sdf", "-o", "two.toml")[0] == 0
    assert load_scene("two.toml").joints[0].kind == "free"
    code, _, err = call("check", "two.sdf", "--model", "tow")
    assert code == 2
    assert "model: unknown model 'tow'. Did you mean 'two'?" in err


def test_view_shows_a_robot(place: Path, call: Call) -> None:
    pytest.importorskip("k3d", reason="pages need k3d: '.[viewer]'")
    code, _, err = call("view", "two.sdf", "-o", "two.html")
    assert (code, err) == (0, "")
    assert "two" in (place / "two.html").read_text(encoding="utf-8")
