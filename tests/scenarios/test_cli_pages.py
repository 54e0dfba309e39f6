"""The commands `view` and `report`."""

from pathlib import Path

import pytest

import mbdlft
from tests.scenarios.commands import Call

SCENARIOS = Path(__file__).parents[2] / "scenarios"

CAPSULE = "<capsule><radius>1</radius><length>2</length></capsule>"


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_view_of_scene_robot_and_archive(place: Path, call: Call) -> None:
    """The name of the page is that of the source; an archive has the scene of its model."""
    arm = mbdlft.load_scene(SCENARIOS / "two_link_arm.toml")
    mbdlft.save("arm.h5", mbdlft.to_lft(arm, search=0.0, prove=0.0))
    for source in (SCENARIOS / "pendulum.toml", SCENARIOS / "desk_arm.urdf", Path("arm.h5")):
        code, said, _ = call("view", str(source))
        assert (code, said.strip()) == (0, f"page: {source.stem}.html")
    text = (place / "arm.html").read_text(encoding="utf-8")
    assert "<title>two_link_arm</title>" in text
    assert text == mbdlft.view(arm).html
    page = (place / "desk_arm.html").read_text(encoding="utf-8")
    assert '"name":"shoulder"' in page


def test_view_of_a_robot_and_of_a_scene_with_its_shapes(place: Path, call: Call) -> None:
    """One of two models of an SDF file; the scene that was made of it has the same page."""
    text = '<sdf version="1.9"><world name="w"><gravity>0 0 -3</gravity>'
    for name, shape in (("a", "<sphere><radius>1</radius></sphere>"), ("b", CAPSULE)):
        text += (
            f"<model name='{name}'><link name='l'><visual name='v'><geometry>{shape}</geometry>"
            "</visual></link><joint name='j' type='prismatic'><parent>world</parent><child>l</child>"
            "<axis><xyz>0 0 1</xyz></axis></joint></model>"
        )
    Path("two.sdf").write_text(text + "</world></sdf>", encoding="utf-8")
    code, _, said = call("view", "two.sdf")
    assert (code, "two.sdf: line 1: the file has 2 models: a, b" in said) == (2, True)
    assert call("view", "two.sdf", "--model", "b")[0] == 0
    page = (place / "two.html").read_text(encoding="utf-8")
    assert '"capsule":[1.0,2.0]' in page
    assert '"sphere"' not in page.partition('id="data"')[2]
    command = ["import", "two.sdf", "--model", "a", "-o", "a.toml"]
    assert call(*command)[0] == 0
    assert call("view", "a.toml")[0] == 0
    assert '"sphere":1.0' not in (place / "a.html").read_text(encoding="utf-8")
    one = text.partition("<model name='b'>")[0] + "</world></sdf>"
    Path("one.sdf").write_text(one, encoding="utf-8")
    assert call("view", "a.toml", "--robot", "one.sdf")[0] == 0
    assert '"sphere":1.0' in (place / "a.html").read_text(encoding="utf-8")


def test_values_of_view(place: Path, call: Call) -> None:
    command = ["view", str(SCENARIOS / "pendulum.toml"), "--set", "m=2.5", "-o", "p.html"]
    assert call(*command)[0] == 0
    text = (place / "p.html").read_text(encoding="utf-8")
    assert '"value":2.5' in text
    assert '"point":[0.8,2.5]' in text


GAIN = """
format = "mbdlft-matrix/1"
name = "gain"
matrix = [["-k", "1"], ["1", "0"]]
states = 1
parameters.k = { nominal = 2.0, percent = 20 }
"""


def test_report_of_an_archive_and_of_a_matrix(place: Path, call: Call) -> None:
    pendulum = mbdlft.load_scene(SCENARIOS / "pendulum.toml")
    mbdlft.save("p.h5", mbdlft.to_lft(pendulum, search=0.0, prove=0.0))
    code, said, _ = call("report", "p.h5", "-o", "told.html")
    assert (code, said.strip()) == (0, "page: told.html")
    text = (place / "told.html").read_text(encoding="utf-8")
    assert "None is stored in p.h5" in text
    Path("gain.toml").write_text(GAIN, encoding="utf-8")
    code, said, _ = call("report", "gain.toml")
    assert (code, said.strip()) == (0, "page: gain.html")


@pytest.mark.usefixtures("place")
def test_reports_that_cannot_be(call: Call) -> None:
    missile = str(SCENARIOS / "missile.toml")
    for command, words in (
        (["report", "nowhere.h5"], "nowhere.h5"),
        (["report", missile, "-o", "told.pdf"], "expected the ending .html of a page, got '.pdf'"),
        (["view", missile], "expected 'mbdlft-scene/1', got 'mbdlft-matrix/1'"),
    ):
        code, _, said = call(*command)
        assert code == 2
        assert words in said
    assert not list(Path().glob("*.html"))
