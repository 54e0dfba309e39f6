"""The commands `poles` and `response`: tables, JSON, figures, sources of all kinds."""

import json
from pathlib import Path

import numpy as np
import pytest

import mbdlft
from tests.close import CLOSED_FORM, NORM, PEAK, target
from tests.oscillators import oscillator, spring_and_mass
from tests.scenarios.commands import Output

ROOT = Path(__file__).parents[2]
ARM = str(ROOT / "scenarios" / "two_link_arm.toml")
LAG = """
format = "mbdlft-matrix/1"
name = "lag"
matrix = [["-k"]]
states = 1
parameters.k = { nominal = 1.0, low = -1.0, high = 3.0 }
"""
PNG = b"\x89PNG\r\n\x1a\n"


@pytest.fixture
def run(output: Output, monkeypatch, tmp_path) -> Output:
    """Run a command in an empty folder; its standard output."""
    monkeypatch.chdir(tmp_path)
    return output


@pytest.fixture
def spring(tmp_path) -> str:
    """An archive with a spring, and with a system without evidence."""
    mbdlft.save(tmp_path / "spring.h5", spring_and_mass())
    mbdlft.save(tmp_path / "spring.h5", oscillator(0.0, 3.0), "bare")
    return "spring.h5"


def test_poles_of_an_archive(run, spring) -> None:
    out = run("poles", spring, "--model", "spring", "--set", "k=5", "--samples", "30")
    assert "spring: poles at k = 5" in out
    assert "transmission zeros: none" in out
    assert "stable at nominal; no unstable point among" in out
    found = json.loads(run("poles", spring, "--model", "spring", "--set", "k=5", "--json"))
    (row,) = found["poles"]
    target([row["real"], row["imag"]], [-0.01, np.sqrt(5.0 - 1e-4)], CLOSED_FORM)
    target(row["time_constant"], 100.0, CLOSED_FORM)
    assert found["point"] == {"k": 5.0}
    assert (found["stability"], found["zeros"]) == ("stable", [])
    assert found["verdict"]["proved"] is False
    assert found["verdict"]["counterexample"] is None


def test_poles_of_a_system_without_evidence(run, spring) -> None:
    out = run("poles", spring, "--model", "bare")
    assert "0 +- 3j" in out
    assert "on the axis" in out
    assert "not asymptotically stable at nominal" in run("show", spring, "--name", "bare")


def test_poles_of_a_scene_and_of_a_matrix(run) -> None:
    found = json.loads(run("poles", ARM, "--set", "theta1=60", "--json", "--samples", "5"))
    arm = mbdlft.to_lft(mbdlft.load_scene(ARM), search=0.0)
    expected = mbdlft.poles(arm, {"theta1": 60.0})[0]
    target([row["real"] for row in found["poles"]], expected.real, CLOSED_FORM)
    assert found["verdict"]["nominal"] == "unstable"
    Path("lag.toml").write_text(LAG, encoding="utf-8")
    lag = json.loads(run("poles", "lag.toml", "--json"))
    assert lag["verdict"]["nominal"] == "stable"
    assert lag["verdict"]["counterexample"]["k"] == -1.0


def test_response_prints_norms_and_values(run, spring) -> None:
    words = ("response", spring, "--model", "spring", "--samples", "40", "--at", "1", "--at", "3")
    found = json.loads(run(*words, "--json"))
    nominal, worst = found["points"]
    zeta = 0.005
    expected = 1.0 / (2.0 * zeta * np.sqrt(1.0 - zeta**2) * 4.0)
    target(nominal["hinf"]["lower"], expected, NORM)
    assert nominal["hinf"]["upper"] >= nominal["hinf"]["lower"]
    target(nominal["peak"]["gain"], expected, PEAK)
    target(nominal["h2"]["value"], 1.0 / np.sqrt(4.0 * zeta * 8.0), CLOSED_FORM)
    assert worst["hinf"]["lower"] > nominal["hinf"]["lower"]
    model = spring_and_mass()
    values = mbdlft.random(model.parameters, 40, 0)
    highest = mbdlft.hinf_norm(model, values).lower
    target(worst["values"]["k"], values["k"][np.argmax(highest)], CLOSED_FORM)
    first, second = found["values"]
    target(first["size"], abs(1.0 / (3.0 + 0.02j)), CLOSED_FORM)
    target(second["phase_deg"], np.degrees(np.angle(1.0 / (-5.0 + 0.06j))), CLOSED_FORM)
    sizes = np.abs(1.0 / (values["k"] - values["m"] * 9.0 + 0.06j))
    target([second["lowest"], second["highest"]], [sizes.min(), sizes.max()], CLOSED_FORM)
    out = run(*words)
    assert "worst of 40 samples: k = " in out
    assert "force to position" in out


def test_response_says_why_a_norm_is_infinite(run, spring) -> None:
    out = run("response", spring, "--model", "bare")
    assert "H-infinity norm infinite: the pole 0 +- 3j rad/s is on the imaginary axis" in out
    found = json.loads(run("response", spring, "--model", "bare", "--json"))
    assert found["points"][0]["hinf"]["upper"] is None
    assert found["points"][0]["h2"]["value"] is None
    assert len(found["points"]) == 1


def test_one_channel_of_a_scene(run) -> None:
    words = ("response", ARM, "--input", "elbow.torque", "--output", "shoulder.angle")
    found = json.loads(run(*words, "--at", "2", "--json", "--samples", "5"))
    assert (found["inputs"], found["outputs"]) == (["elbow.torque"], ["shoulder.angle"])
    arm = mbdlft.to_lft(mbdlft.load_scene(ARM), search=0.0)
    target(
        found["values"][0]["size"],
        abs(mbdlft.frequency_response(arm, {}, [2.0])[0, 0, 0, 1]),
        CLOSED_FORM,
    )


def test_figures_of_both_commands(run, spring) -> None:
    words = ("response", spring, "--model", "spring", "--samples", "10", "-o", "f.png", "--kind")
    for kind in ("sigma", "bode", "step", "poles"):
        Path("f.png").unlink(missing_ok=True)
        assert "figure: f.png" in run(*words, kind)
        assert Path("f.png").read_bytes().startswith(PNG)
    for more in ((), ("--over", "k")):
        Path("f.png").unlink()
        assert "figure: f.png" in run("poles", spring, "--model", "spring", "-o", "f.png", *more)
        assert Path("f.png").read_bytes().startswith(PNG)
