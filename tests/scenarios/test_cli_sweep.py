"""The commands `sweep`, `simulate`, `view` and `report`, and commands that take robots as they stand."""

import json
from pathlib import Path

import numpy as np
import pytest

import mbdlft
from benchmarks.cases.arm import closed_form
from mbdlft.dae import simulate
from mbdlft.multibody.scene import load_scene
from tests.close import CLOSED_FORM, KEPT, exact, target
from tests.errors.test_robot_format_errors import MJCF, SDF
from tests.scenarios.commands import Call, Output
from tests.scenarios.test_cli import ARM


@pytest.mark.parametrize("kind", ["grid", "random", "file"])
def test_samples_of_each_kind(tmp_path: Path, kind: str, output: Output) -> None:
    archive, table = tmp_path / "a.h5", tmp_path / "s.csv"
    table.write_text("theta1, m1\n50.0,2.5\n60.0,3.5\n", encoding="utf-8")
    options = {
        "grid": ("--grid", "theta1=5", "--grid", "m1=2"),
        "random": ("--random", "10", "--seed", "4"),
        "file": ("--file", str(table)),
    }[kind]
    out = output("sweep", ARM, *options, "-o", str(archive), "--name", kind)
    count = 2 if kind == "file" else 10
    assert f"{kind}: {count} samples, {count} solved, 0 not converged, 0 without" in out
    found = mbdlft.load_sweep(archive, kind)
    assert len(found.status) == count
    values = {p.name: found.samples[:, k] for k, p in enumerate(found.layout.parameters)}
    state, torques = closed_form(values)
    target(np.concatenate([found.A, found.B], axis=2), state, CLOSED_FORM)
    target(found.trim, torques, CLOSED_FORM)


def test_model_of_an_archive(tmp_path: Path, output: Output) -> None:
    archive = tmp_path / "a.h5"
    model = mbdlft.to_lft(mbdlft.load_scene(ARM), search=0.0)
    mbdlft.save(archive, model)
    command = ("sweep", str(archive), "--random", "20", "-o", str(archive), "--json")
    out = output(*command)
    assert json.loads(out)["solved"] == 20
    found = mbdlft.load_sweep(archive)
    exact(found.A, mbdlft.matrices_at(model, mbdlft.random(model.parameters, 20)).A)
    assert mbdlft.model_names(archive) == ("two_link_arm",)
    out = output("show", str(archive))
    assert "sweeps: two_link_arm" in out


def test_poles_and_a_function_in_single_precision(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, call: Call, output: Output
) -> None:
    (tmp_path / "my_margin.py").write_text(
        "import numpy as np\ndef lag(part):\n    return {'lag': np.sqrt(part.samples['m1'] - 2.5)}\n",
        encoding="utf-8",
    )
    archive = tmp_path / "a.h5"
    (tmp_path / "arm.toml").write_bytes(Path(ARM).read_bytes())
    monkeypatch.chdir(tmp_path)
    command = ("sweep", "arm.toml", "--grid", "m1=5", "-o", str(archive), "--poles", "--float32")
    out = output(*command, "--function", "my_margin:lag")
    found = mbdlft.load_sweep(archive)
    m1 = found.samples[:, [p.name for p in found.layout.parameters].index("m1")]
    failed = int(np.sum(m1 < 2.5))
    assert failed > 0
    assert f"the function failed at {failed} samples" in out
    exact(np.isnan(found.values["lag"]), found.status == 3)
    assert found.A.dtype == np.float32
    assert found.poles is not None
    code, _, err = call(*command, "--function", "my_margin:leg")
    assert code == 2
    assert "unknown name 'leg'" in err


# The command `simulate`: motions beside the linear model, files, messages.

FOUR_BAR = str(Path(__file__).parents[2] / "scenarios" / "four_bar.toml")
ARM_FILE = str(Path(__file__).parents[2] / "scenarios" / "two_link_arm.toml")
ASKED = ("simulate", ARM_FILE, "--until", "0.5", "--set", "m1=3.2", "--json")


def test_the_linear_model_holds_for_small_motions(output: Output, tmp_path: Path) -> None:
    """Ten times smaller, it is ten times nearer; the table of the last run has all columns."""
    table, figure = tmp_path / "motion.csv", tmp_path / "motion.png"
    pushed = ("--input", "shoulder.torque=step:1@0.1", "--input", "elbow.torque=sine:2:5", "--initial")
    more = ("elbow.angle=0.05", "--amplitude", "0.1", "--amplitude", "0.01", "--steps", "50")
    out = output(*ASKED, *pushed, *more, "-o", str(table), "--plot", str(figure))
    large, small = json.loads(out)["runs"]
    assert 8.0 <= large["linear_error"] / small["linear_error"] <= 12.0
    lines = table.read_text(encoding="utf-8").splitlines()
    assert lines[0].split(",")[:3] == ["time", "shoulder.angle", "elbow.angle"]
    assert np.shape([[float(x) for x in line.split(",")] for line in lines[1:]]) == (51, 7)
    assert figure.read_bytes()[:4] == b"\x89PNG"


def test_no_error_is_relative_to_what_the_integrator_leaves(output: Output) -> None:
    """The four-bar linkage, at rest, moved by 3e-16 rad, and the linear model was off by all of it."""
    (run,) = json.loads(output("simulate", FOUR_BAR, "--steps", "20", "--json"))["runs"]
    assert run["linear_error"] == 0.0
    assert 0.0 < run["largest"] < 1e-13


def test_a_sine_of_a_road_has_its_rate(call: Call) -> None:
    """The damper of a tire feels it; a rate that is given by itself stays."""
    file, pushed = (
        ARM_FILE.replace("two_link_arm", "half_car"),
        "--input=front_road.position=sine:0.001:60",
    )
    times = np.linspace(0.0, 1.0, 401)
    moved = {"front_road.position": 0.001 * np.sin(60.0 * times)}
    for more, rate in (((), 0.06 * np.cos(60.0 * times)), (("--input=front_road.velocity=0",), 0.0)):
        _, out, _ = call("simulate", file, pushed, *more, "--until", "1", "--json")
        run = simulate(mbdlft.load_scene(file), times, inputs={**moved, "front_road.velocity": rate})
        target(json.loads(out)["runs"][0]["largest"], np.max(np.abs(run.outputs)), KEPT)


# Commands take robots as they stand, and say on stderr what is ignored and assumed.

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


def test_view_shows_a_robot(place: Path, output: Output) -> None:
    pytest.importorskip("k3d", reason="pages need k3d: '.[viewer]'")
    output("view", "two.sdf", "-o", "two.html")
    assert "two" in (place / "two.html").read_text(encoding="utf-8")


# The commands `view` and `report`.

SCENARIOS = Path(__file__).parents[2] / "scenarios"

CAPSULE = "<capsule><radius>1</radius><length>2</length></capsule>"


@pytest.fixture
def place_page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_view_of_scene_robot_and_archive(place_page: Path, call: Call) -> None:
    """The name of the page is that of the source; an archive has the scene of its model."""
    arm = mbdlft.load_scene(SCENARIOS / "two_link_arm.toml")
    mbdlft.save("arm.h5", mbdlft.to_lft(arm, search=0.0, prove=0.0))
    for source in (SCENARIOS / "pendulum.toml", SCENARIOS / "desk_arm.urdf", Path("arm.h5")):
        code, said, _ = call("view", str(source))
        assert (code, said.strip()) == (0, f"page: {source.stem}.html")
    text = (place_page / "arm.html").read_text(encoding="utf-8")
    assert "<title>two_link_arm</title>" in text
    assert text == mbdlft.view(arm).html
    page = (place_page / "desk_arm.html").read_text(encoding="utf-8")
    assert '"name":"shoulder"' in page


def test_view_of_a_robot_and_of_a_scene_with_its_shapes(place_page: Path, call: Call) -> None:
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
    page = (place_page / "two.html").read_text(encoding="utf-8")
    assert '"capsule":[1.0,2.0]' in page
    assert '"sphere"' not in page.partition('id="data"')[2]
    command = ["import", "two.sdf", "--model", "a", "-o", "a.toml"]
    assert call(*command)[0] == 0
    assert call("view", "a.toml")[0] == 0
    assert '"sphere":1.0' not in (place_page / "a.html").read_text(encoding="utf-8")
    one = text.partition("<model name='b'>")[0] + "</world></sdf>"
    Path("one.sdf").write_text(one, encoding="utf-8")
    assert call("view", "a.toml", "--robot", "one.sdf")[0] == 0
    assert '"sphere":1.0' in (place_page / "a.html").read_text(encoding="utf-8")


def test_values_of_view(place_page: Path, call: Call) -> None:
    command = ["view", str(SCENARIOS / "pendulum.toml"), "--set", "m=2.5", "-o", "p.html"]
    assert call(*command)[0] == 0
    text = (place_page / "p.html").read_text(encoding="utf-8")
    assert '"value":2.5' in text
    assert '"point":[0.8,2.5]' in text


GAIN = """
format = "mbdlft-matrix/1"
name = "gain"
matrix = [["-k", "1"], ["1", "0"]]
states = 1
parameters.k = { nominal = 2.0, percent = 20 }
"""


def test_report_of_an_archive_and_of_a_matrix(place_page: Path, call: Call) -> None:
    pendulum = mbdlft.load_scene(SCENARIOS / "pendulum.toml")
    mbdlft.save("p.h5", mbdlft.to_lft(pendulum, search=0.0, prove=0.0))
    code, said, _ = call("report", "p.h5", "-o", "told.html")
    assert (code, said.strip()) == (0, "page: told.html")
    text = (place_page / "told.html").read_text(encoding="utf-8")
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
