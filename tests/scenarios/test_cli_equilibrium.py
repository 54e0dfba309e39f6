"""The command line finds positions: tables with units, all equilibria, the scene that is written."""

import json
from pathlib import Path

import h5py
import numpy as np
import pytest

import mbdlft
from scenarios import sagging_arm
from tests import kit
from tests.close import roundoff
from tests.scenarios.commands import Call, Output


@pytest.fixture
def sagging(tmp_path: Path) -> str:
    file = tmp_path / "sagging_arm.toml"
    file.write_text(mbdlft.scene_to_toml(sagging_arm.scene()), encoding="utf-8")
    return str(file)


def pendulum(damping: float = 0.1, preload: float = 0.0, g: float = 9.81) -> str:
    bob = kit.point("bob", 2.0, ports={"top": (0, 0, 1)})
    hinge = kit.hinge(
        "hinge", "ground", "bob.top", (1, 0, 0), position=1.0, preload=preload, damping=damping
    )
    return mbdlft.scene_to_toml(kit.scene("pendulum", bob, hinge, gravity=(0, 0, -g)))


def test_positions_and_the_scene_there(sagging: str, tmp_path: Path, output: Output) -> None:
    written = tmp_path / "there.toml"
    out = output("trim", sagging, "--positions", "--set", "m=2.4", "-o", str(written))
    assert "sagging_arm: equilibrium 1" in out
    assert "hinge.angle" in out
    assert "0.526640989" in out
    assert "rad" in out
    assert "stable: decays with" in out
    scene = mbdlft.load_scene(written)
    point = mbdlft.find_equilibrium(scene, {"m": 2.4})
    roundoff(point.positions["hinge.angle"], 0.5266409894615065)
    out = output("trim", str(written), "--set", "m=2.4")


def test_all_equilibria(tmp_path: Path, call: Call, output: Output) -> None:
    file = tmp_path / "pendulum.toml"
    file.write_text(pendulum(), encoding="utf-8")
    out = output("trim", str(file), "--all", "--starts", "10")
    assert "equilibrium 2" in out
    assert "equilibrium 3" not in out
    assert out.count("; stable: decays with") == 1
    assert out.count("; unstable: grows with") == 1
    written = tmp_path / "there.toml"
    for form in ((), ("--json",)):
        _, out, _ = call("trim", str(file), "--all", "--starts", "10", "-o", str(written), *form)
        assert str(written) in "".join(out.split("\n"))
    assert json.loads(out)["scene"] == str(written)
    file.write_text(pendulum(0.0), encoding="utf-8")
    out = output("trim", str(file), "--positions")
    assert "neither stable nor unstable: something moves without damping" in out
    file.write_text(pendulum(g=0.0), encoding="utf-8")
    out = output("trim", str(file), "--positions")
    assert "not determined: hinge.angle" in out


def test_errors_say_where(sagging: str, tmp_path: Path, call: Call) -> None:
    file = tmp_path / "pendulum.toml"
    file.write_text(pendulum(preload=25.0), encoding="utf-8")
    code, _, err = call("trim", str(file), "--positions")
    assert code == 2
    assert "no equilibrium found from 30 starts" in err
    assert "hinge.torque misses -5.38 N m" in err
    code, _, err = call("trim", sagging, "--positions", "-o", str(tmp_path / "no" / "x.toml"))
    assert code == 2
    assert "x.toml: cannot be written: No such file" in err


def test_fit_is_shown(tmp_path: Path, output: Output) -> None:
    """`linearize` says that positions are fits, and so does the archive, by an attribute."""
    fitted = mbdlft.fit_positions(sagging_arm.scene(), ["hinge"], 1e-4)
    file, archive = tmp_path / "fitted.toml", tmp_path / "fitted.h5"
    file.write_text(mbdlft.scene_to_toml(fitted), encoding="utf-8")
    out = output("linearize", str(file), "-o", str(archive), "--search", "0")
    assert "not exact: positions are fits, within 7.71e-05 rad or m of the equilibrium" in out
    assert "minimal" not in out
    with h5py.File(archive) as stored:
        value = stored["models/sagging_arm/certificate"].attrs["fit_error_bound"]
    assert isinstance(value, np.float64)
    assert fitted.fit is not None
    assert float(value) == fitted.fit.bounds["hinge.angle"]


def test_scenario_in_python(capsys: pytest.CaptureFixture[str]) -> None:
    sagging_arm.main()
    out = capsys.readouterr().out
    assert "m = 2.0 kg: 0.5739 rad, decays with 0.039 rad/s" in out
    assert "fit for all m and k: within 7.7e-05 rad, order 6" in out
