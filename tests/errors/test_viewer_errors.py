"""What cannot be shown is one message, and no page is written."""

import re
from pathlib import Path

import numpy as np
import pytest

import mbdlft
from mbdlft.base.errors import ArchiveError, SceneError, TrimError, WellPosednessError
from mbdlft.cli.files import _scene
from mbdlft.show.viewer.data import _modes, view_data
from mbdlft.show.viewer.drawing import draw
from mbdlft.show.viewer.page import _filled, scene_picture
from mbdlft.show.viewer.poses import scene_poses
from tests.errors.table import refused
from tests.scenarios.commands import run

ROOT = Path(__file__).parents[2]
PENDULUM = ROOT / "scenarios" / "pendulum.toml"


def pendulum() -> mbdlft.Scene:
    return mbdlft.load_scene(PENDULUM)


test_messages = refused(
    r"""
draw(scene_poses(pendulum()), np.array([np.inf, 2.0])) => a position is not finite at nominal
_modes("pendulum", np.array([[0.0, 1.0], [np.inf, 0.0]]), [0])
    => WellPosednessError: 'pendulum': an entry of the linear model is not
_filled({"name": "far", "size": float("nan")}, "", "") => 'far': a number of the page is not finite
mbdlft.view("pendulum.toml") => expected a Scene, got str. load_scene
mbdlft.show.scene_of(mbdlft.realize(mbdlft.load_matrix(ROOT / 'scenarios' / 'missile.toml'),
    search=0.0))
    => was not made of one scene alone
mbdlft.show.scene_of(1.0) => a float has no scene
mbdlft.view(pendulum()).save(tmp_path) => cannot be written: Is a directory
> mbdlft.view(pendulum(), {}) => TrimError:
{"x": 1.0} => unknown parameter 'x'
{"m": 30.0} => m = 30 is outside its range [1.4, 2.6] kg
"""
)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('port = "bob"', 'port = "bob"\nframe = "bod"', "frame: unknown body 'bod'"),
        (
            'kind = "position"\nport = "bob"',
            'kind = "joint_wrench"\njoint = "pivo"',
            "joint: unknown joint 'pivo'",
        ),
    ],
)
def test_scenes_that_cannot_be_drawn(old: str, new: str, words: str) -> None:
    text = PENDULUM.read_text(encoding="utf-8").replace(
        "[linearize]", '[sensors.place]\nkind = "position"\nport = "bob"\n\n[linearize]'
    )
    assert old in text
    with pytest.raises(SceneError, match=re.escape(words)):
        mbdlft.view(mbdlft.scene_from_toml(text.replace(old, new)))


def test_loads_that_are_nothing() -> None:
    """Buoyancy without gravity has no direction; pictures and pages leave it out."""
    scene = mbdlft.Scene(
        name="void",
        bodies=[mbdlft.PointMass(name="bob", mass=1.0)],
        joints=[mbdlft.Prismatic(name="rail", parent="ground", child="bob", axis=(0, 1, 0))],
        loads=[mbdlft.Buoyancy(name="lift", port="bob", displaced_mass=0.0)],
    )
    (item,) = [item for item in view_data(scene)["items"] if item["group"] == "loads"]
    assert item["shapes"] == []
    assert "lift" not in scene_picture(scene)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["-o", "page.txt"], "page.txt: expected the ending .html of a page, got '.txt'."),
        (["-o", "nowhere/page.html"], "nowhere is not a folder"),
        (["--model", "a"], "--model a: "),
        (["--set", "m"], "--set m: expected name=value"),
        (["--set", "n=1"], "unknown parameter 'n'"),
    ],
)
def test_options(
    arguments: list[str],
    words: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    code, _, said = run(monkeypatch, capsys, "view", str(PENDULUM), *arguments)
    assert code == 2
    assert words in said
    assert list(tmp_path.iterdir()) == []


def test_a_page_that_cannot_be_written_leaves_the_old_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(handle: int) -> None:
        raise OSError(28, "No space left on device")

    page = mbdlft.view(pendulum())
    page.save(tmp_path / "a.html")
    monkeypatch.setattr("os.fsync", full)
    with pytest.raises(SceneError, match="cannot be written: No space left on device"):
        mbdlft.show.Page("other", "other").save(tmp_path / "a.html")
    assert [path.name for path in tmp_path.iterdir()] == ["a.html"]
    assert (tmp_path / "a.html").read_text(encoding="utf-8") == page.html


def test_a_file_that_is_not_there(tmp_path: Path) -> None:
    for name, kind in (("a.toml", SceneError), ("a.urdf", SceneError), ("a.h5", ArchiveError)):
        with pytest.raises(kind):
            _scene(tmp_path / name, None)
