"""What cannot be shown is one message, and no page is written."""

from pathlib import Path

import numpy as np
import pytest

import mbdlft
from mbdlft.base.errors import ArchiveError, SceneError, TrimError, WellPosednessError
from mbdlft.cli.files import _scene
from mbdlft.show.viewer.data import _modes, view_data
from mbdlft.show.viewer.drawing import draw
from mbdlft.show.viewer.page import _filled
from mbdlft.show.viewer.poses import scene_poses
from mbdlft.show.viewer.stills import scene_picture
from tests import kit
from tests.errors.table import MessageError, refused

ROOT = Path(__file__).parents[2]
PENDULUM = ROOT / "scenarios" / "pendulum.toml"


def pendulum() -> mbdlft.Scene:
    return mbdlft.load_scene(PENDULUM)


def with_sensor(fields: str) -> str:
    text = PENDULUM.read_text(encoding="utf-8")
    return text.replace("[linearize]", f"[sensors.place]\n{fields}\n[linearize]")


test_messages = refused(
    r"""
draw(scene_poses(pendulum()), np.array([np.inf, 2.0])) => a position is not finite at nominal
_modes("pendulum", np.array([[0.0, 1.0], [np.inf, 0.0]]), [0])
    => WellPosednessError: 'pendulum': an entry of the linear model is not
_filled({"name": "far", "size": float("nan")}, "", "") => 'far': a number of the page is not finite
mbdlft.view(pendulum(), [1.0]) => TrimError: view: expected values by name, such as {'L': 1.0}, got
mbdlft.show.scene_of(mbdlft.realize([[1.0]])) => was not made of one scene alone
mbdlft.view(pendulum()).save(tmp_path) => cannot be written: Is a directory
_scene(tmp_path / "{a.toml|a.urdf}", None) => {0}: cannot be read
_scene(tmp_path / "a.h5", None) => ArchiveError: a.h5: cannot be read
> mbdlft.view(mbdlft.scene_from_toml(with_sensor({}))) => SceneError:
'kind = "position"\nport = "bob"\nframe = "bod"' => frame: unknown body 'bod'
'kind = "joint_wrench"\njoint = "pivo"' => joint: unknown joint 'pivo'
> command("view", str(PENDULUM), {}) => MessageError:
"-o", "page.txt" => page.txt: expected the ending .html of a page, got '.txt'.
"-o", "nowhere/page.html" => nowhere is not a folder
"--model", "a" => --model a:
"--set", "m" => --set m: expected name=value
"--set", "n=1" => unknown parameter 'n'
> mbdlft.view(pendulum(), {}) => TrimError:
{"x": 1.0} => unknown parameter 'x'
{"m": 30.0} => m = 30 is outside its range [1.4, 2.6] kg
"""
)


def test_loads_that_are_nothing() -> None:
    """Buoyancy without gravity has no direction; pictures and pages leave it out."""
    bob, rail = kit.point("bob", 1.0), kit.rail("rail", "ground", "bob", (0, 1, 0))
    scene = kit.scene("void", bob, rail, mbdlft.Buoyancy(name="lift", port="bob", displaced_mass=0.0))
    (item,) = [item for item in view_data(scene)["items"] if item["group"] == "loads"]
    assert item["shapes"] == []
    assert "lift" not in scene_picture(scene)


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
