"""The command line in one process: tables, JSON, figures, exit codes."""

import json
from pathlib import Path

import numpy as np
import pytest

import mbdlft
from mbdlft.cli import options
from mbdlft.order import work
from tests import kit
from tests.close import CLOSED_FORM, roundoff
from tests.errors.robots import written
from tests.scenarios.commands import Call, Output

ROOT = Path(__file__).parents[2]
ARM = str(ROOT / "scenarios" / "two_link_arm.toml")
PNG = b"\x89PNG\r\n\x1a\n"


def test_figure_of_an_undamped_system(tmp_path: Path, output: Output) -> None:
    """m = k = 1 rings at 1 rad/s without end: all figures are drawn, and the table says it."""
    scene, figure = tmp_path / "scene.toml", tmp_path / "figure.png"
    slide = kit.rail("slide", "ground", "mass", (0, 1, 0), stiffness=1.0)
    scene.write_text(mbdlft.scene_to_toml(kit.scene("oscillator", kit.point("mass", 1.0), slide)))
    files = [f"bode={figure}.b.png", f"poles={figure}.p.png", f"step={figure}.s.png", str(figure)]
    plots = [word for file in files for word in ("--plot", file)]
    out = output("linearize", str(scene), "-o", str(tmp_path / "o.h5"), *plots)
    for file in files:
        assert Path(file.rpartition("=")[2]).read_bytes().startswith(PNG)
    assert "not asymptotically stable at nominal: poles are on the axis" in out
    assert "0 +- 1j" in out
    model = mbdlft.load(tmp_path / "o.h5")
    (omega,) = mbdlft.response_frequencies(model)
    assert np.min(np.abs(omega - 1.0)) > 0.9e-4
    assert np.all(np.isfinite(mbdlft.frequency_response(model, {}, omega)))


def test_figure_that_fails_takes_neither_table_nor_archive_away(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, call: Call
) -> None:
    archive, figure = tmp_path / "arm.h5", tmp_path / "arm.png"

    def fails(*_: object, **__: object) -> None:
        raise mbdlft.AnalysisError("the figure cannot be drawn.")

    monkeypatch.setattr("mbdlft.show.figures.responses.drawn_samples", fails)
    command = ("linearize", ARM, "--search", "0", "-o", str(archive), "--plot", str(figure))
    code, out, err = call(*command)
    assert (code, err) == (2, "mbdlft: the figure cannot be drawn.\n")
    assert "lower bound 16" in out
    assert mbdlft.load(archive).order == 17
    code, out, err = call(*command, "--json")
    assert (code, json.loads(out)["order"]) == (2, 17)
    command = ("response", str(archive), "-o", str(figure), "--samples", "20", "--json")
    code, out, err = call(*command)
    assert (code, len(json.loads(out)["points"])) == (2, 2)


def test_linearize_stores_a_program(tmp_path: Path, call: Call, output: Output) -> None:
    archive = tmp_path / "arm.h5"
    command = ("linearize", ARM, "--search", "0", "--program")
    code, _, err = call(*command)
    assert code == 2
    assert "--program: it is stored in an archive; give one with -o" in err
    output(*command, "-o", str(archive))
    model = mbdlft.load(archive)
    assert model.known_program is not None
    _, out, _ = call("show", str(archive))
    assert f"stored program: {model.known_program.length} instructions" in out


def test_a_figure_that_fails_takes_no_other_away(tmp_path: Path, call: Call) -> None:
    first, second = tmp_path / "first.png", tmp_path / "second.png"
    plots = ("--plot", f"trim:theta={first}", "--plot", f"order={second}")
    code, out, err = call("linearize", ARM, "--search", "0", *plots)
    assert code == 2
    assert "unknown parameter 'theta'" in err
    assert "lower bound 16" in out
    assert str(first) not in out
    assert not first.exists()
    assert second.read_bytes().startswith(PNG)


def test_linearize_writes_archive_figure_and_table(tmp_path: Path, output: Output) -> None:
    archive, figure = tmp_path / "arm.h5", tmp_path / "arm.png"
    out = output("linearize", ARM, "-o", str(archive), "--plot", str(figure))
    for word in ("shoulder.angle (rad)", "elbow.torque (N m)", "kg m^2", "[0.16, 0.24]", "lower bound"):
        assert word in out
    assert "order 16, lower bound 16: minimal: proved" in out
    assert "at 229 points and corners" in out
    assert "seconds: read" in out
    assert "UNSTABLE at nominal: 2 of 4 modes grow, the fastest by e in 0.3221 s" in out
    assert figure.read_bytes().startswith(PNG)
    assert mbdlft.load(archive).order == 16
    shown = output("show", str(archive))
    assert "order 16, lower bound 16: minimal: proved" in shown
    assert "condition " in shown
    assert "poles at nominal" in shown
    assert "UNSTABLE at nominal" in shown
    assert "made 20" in shown


def test_json_has_the_promised_keys(call: Call) -> None:
    code, out, _ = call("linearize", ARM, "--json", "--search", "0")
    found = json.loads(out)
    assert code == 0
    assert (found["order"], found["lower_bound"]) == (17, 16)
    assert found["raw_order"] >= found["order"]
    assert found["max_relative_error"] < CLOSED_FORM
    assert found["check_points"] == 229
    assert found["condition"] >= 1.0
    assert found["sign_changes"] >= 0
    stages = {
        "read",
        "assemble",
        "trim",
        "linearize",
        "reduce",
        "prove",
        "bound",
        "near relations",
        "check",
        "total",
    }
    assert set(found["seconds"]) == stages
    total = sum(found["seconds"].values()) - found["seconds"]["total"]
    roundoff(total, found["seconds"]["total"])
    assert sum(p["order"] for p in found["parameters"]) == 17
    assert found["stability"] == "unstable"
    assert len(found["poles"]) == 4
    assert sum(pole["real"] > 0.0 for pole in found["poles"]) == 2
    assert sum(p["gap"] for p in found["parameters"]) == 1


def test_default_budget_is_that_of_the_package() -> None:
    assert options.SEARCH == work.SEARCH


SERVO = """
format = "mbdlft-matrix/1"
name = "servo"
states = ["alpha", "q"]
inputs = ["fin"]
matrix = [[0, 1, 0], ["-k", "-m^2", 1]]

[parameters]
k = { nominal = 2.0, percent = 20 }
m = { nominal = 1.0, percent = 20 }
"""


@pytest.fixture
def servo(tmp_path: Path) -> str:
    (tmp_path / "servo.toml").write_text(SERVO, encoding="utf-8")
    return str(tmp_path / "servo.toml")


def test_realize_writes_archive_and_table(tmp_path: Path, servo: str, call: Call, output: Output) -> None:
    archive = tmp_path / "servo.h5"
    out = output("realize", servo, "-o", str(archive), "--search", "20")
    assert "order 3, lower bound 3: minimal: proved (bound in exact arithmetic)" in out
    assert "against the matrix itself at 105 points and corners" in out
    assert "seconds: read" in out
    model = mbdlft.load(archive)
    assert model.certificate.exact_bound
    assert [signal.name for signal in model.states] == ["alpha", "q"]
    shown = output("show", str(archive))
    assert "minimal: proved (bound in exact arithmetic)" in shown
    code, out, _ = call("realize", servo, "--json", "--search", "0")
    found = json.loads(out)
    assert (code, found["name"], found["lower_bound"]) == (0, "servo", 3)
    assert found["exact_bound"] is True
    stages = {"read", "resolve", "reduce", "bound", "near relations", "prove", "check", "total"}
    assert set(found["seconds"]) == stages


PAIR = """
format = "mbdlft-matrix/1"
name = "pair"
matrix = [
    ["7*L^2 + m*(2 + 3*L + 5*L^2)", "m*(1 - 2*L)", "m*(3 + L)"],
    ["m*(1 - 2*L)", "2*m", "-m"],
]

[parameters]
L = { nominal = 0.4, percent = 20 }
m = { nominal = 0.6, percent = 20 }
"""


def test_bound_by_pairs_is_printed(tmp_path: Path, call: Call) -> None:
    file, archive = tmp_path / "pair.toml", str(tmp_path / "pair.h5")
    file.write_text(PAIR, encoding="utf-8")
    arguments = ("realize", str(file), "--search", "0.5")
    _, out, _ = call(*arguments, "-o", archive)
    words = "order 5, lower bound 5 (4 one by one, 1 more together): minimal: proved"
    words += " (the 4 in exact arithmetic)"
    assert words in out
    assert words in call("show", archive)[1]
    found = json.loads(call(*arguments, "--json")[1])
    assert (found["order"], found["lower_bound"], found["order_bound"]) == (5, 4, 5)
    assert found["minimal"] is True


def test_realize_says_what_is_not_used(tmp_path: Path, output: Output) -> None:
    file = tmp_path / "spare.toml"
    file.write_text(SERVO + "[constants]\nspare = 2.0\n", encoding="utf-8")
    out = output("realize", str(file))
    assert out.count("is declared and not used") == 1
    assert "'spare' is declared and not used" in out


def test_truncate_says_that_the_model_is_not_exact(tmp_path: Path, call: Call, output: Output) -> None:
    archive = tmp_path / "arm.h5"
    command = ("linearize", ARM, "--search", "60", "--truncate", "0.1", "-o", str(archive))
    out = output(*command)
    assert "not exact: values differ by at most" in out
    assert ", truncate " in out
    assert "minimal: proved" not in out
    assert "not exact" in call("show", str(archive))[1]
    found = json.loads(call(*command, "--json")[1])
    assert found["order"] < found["lower_bound"] == 16
    assert (found["exact"], found["minimal"]) == (False, False)
    assert 0.0 < found["truncation_error"] <= 0.1


def test_truncate_says_that_nothing_can_be_left_out(call: Call, output: Output) -> None:
    command = ("linearize", ARM, "--search", "0", "--truncate")
    out = output(*command, "1e-9")
    assert "note: no channel can be left out within 1e-09; nothing is truncated." in out
    assert "no channel can be left out" not in call(*command, "0.1")[1]


def test_trim_prints_the_torques(output: Output) -> None:
    out = output("trim", ARM, "--set", "theta1=90", "--set", "theta2=90")
    assert "-58.86" in out
    assert "N m" in out


def test_check_counts_the_states_that_the_model_has(output: Output) -> None:
    """Angles of rotors that no output asks for are none."""
    path = "scenarios/control_moment_gyros.toml"
    out = output("check", path, "--json")
    model = mbdlft.to_lft(mbdlft.load_scene(path), search=0.0)
    assert (
        json.loads(out)["states"]
        == len(model.states)
        < len(mbdlft.multibody.assemble(mbdlft.load_scene(path)).states)
    )


def test_check_says_what_is_not_used(tmp_path: Path, output: Output) -> None:
    out = output("check", ARM)
    assert "note" not in out
    text = (
        Path(ARM)
        .read_text(encoding="utf-8")
        .replace("[parameters]", '[parameters]\nspare = { nominal = 1.0, percent = 5, unit = "kg" }')
    )
    scene = tmp_path / "spare.toml"
    scene.write_text(text, encoding="utf-8")
    out = output("check", str(scene))
    assert "'spare' is declared and not used" in out


def test_version_and_help(call: Call, output: Output) -> None:
    assert call("--version")[1].strip() == f"mbdlft {mbdlft.__version__}"
    out = output("--help")
    for command in ("check", "trim", "linearize", "realize", "show", "poles", "response"):
        assert command in out


def test_import_of_a_robot(tmp_path: Path, output: Output) -> None:
    """The scene that is written is that of `load_robot`, and the report is printed."""
    file, scene = written(tmp_path), tmp_path / "crane.toml"
    out = output("import", str(file), "-o", str(scene),
        "--parameter", "load=1,2,3,kg", "--parameter", "theta=40,60,80,deg",
        "--set", "tip.left.mass=load", "--set", "swing.position=theta", "--vary", "arm.mass=20",
        "--moving", "slide", "--moving", "swing",
    )  # fmt: skip
    assert "ignored: Coulomb friction of slide: it is not linear" in out
    assert "assumed: links without <inertial> have no mass: rail" in out
    assert "crane: 5 bodies, 5 joints, 3 parameters." in out
    expected, _ = mbdlft.load_robot(
        file,
        parameters=[
            mbdlft.Parameter("load", 2.0, 1.0, 3.0, unit="kg"),
            mbdlft.Angle("theta", 60.0, 40.0, 80.0),
        ],
        values={"tip.left.mass": "load", "swing.position": "theta"},
        vary={"arm.mass": 20.0},
        moving=["slide", "swing"],
    )
    assert mbdlft.load_scene(scene) == expected
    out = output("check", str(scene))
    assert "slide.force" in out
    free = [str(file), "-o", str(scene), "--free-base", "--keep-unphysical"]
    out = output("import", *free)
    assert mbdlft.load_scene(scene).joints[0].kind == "free"
