"""The command `sweep`."""

import json
from pathlib import Path

import numpy as np
import pytest

import mbdlft
from benchmarks.cases.arm import closed_form
from tests.close import CLOSED_FORM, exact, target
from tests.scenarios.commands import Call
from tests.scenarios.test_cli import ARM


@pytest.mark.parametrize("kind", ["grid", "random", "file"])
def test_samples_of_each_kind(tmp_path: Path, kind: str, call: Call) -> None:
    archive, table = tmp_path / "a.h5", tmp_path / "s.csv"
    table.write_text("theta1, m1\n50.0,2.5\n60.0,3.5\n", encoding="utf-8")
    options = {
        "grid": ("--grid", "theta1=5", "--grid", "m1=2"),
        "random": ("--random", "10", "--seed", "4"),
        "file": ("--file", str(table)),
    }[kind]
    code, out, err = call("sweep", ARM, *options, "-o", str(archive), "--name", kind)
    assert (code, err) == (0, "")
    count = 2 if kind == "file" else 10
    assert f"{kind}: {count} samples, {count} solved, 0 not converged, 0 without" in out
    found = mbdlft.load_sweep(archive, kind)
    assert len(found.status) == count
    values = {p.name: found.samples[:, k] for k, p in enumerate(found.layout.parameters)}
    state, torques = closed_form(values)
    target(np.concatenate([found.A, found.B], axis=2), state, CLOSED_FORM)
    target(found.trim, torques, CLOSED_FORM)


def test_model_of_an_archive(tmp_path: Path, call: Call) -> None:
    archive = tmp_path / "a.h5"
    model = mbdlft.to_lft(mbdlft.load_scene(ARM), search=0.0)
    mbdlft.save(archive, model)
    command = ("sweep", str(archive), "--random", "20", "-o", str(archive), "--json")
    code, out, err = call(*command)
    assert (code, err) == (0, "")
    assert json.loads(out)["solved"] == 20
    found = mbdlft.load_sweep(archive)
    exact(found.A, mbdlft.matrices_at(model, mbdlft.random(model.parameters, 20)).A)
    assert mbdlft.model_names(archive) == ("two_link_arm",)
    code, out, err = call("show", str(archive))
    assert (code, err) == (0, "")
    assert "sweeps: two_link_arm" in out


def test_poles_and_a_function_in_single_precision(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, call: Call
) -> None:
    (tmp_path / "my_margin.py").write_text(
        "import numpy as np\ndef lag(part):\n    return {'lag': np.sqrt(part.samples['m1'] - 2.5)}\n",
        encoding="utf-8",
    )
    archive = tmp_path / "a.h5"
    (tmp_path / "arm.toml").write_bytes(Path(ARM).read_bytes())
    monkeypatch.chdir(tmp_path)
    command = ("sweep", "arm.toml", "--grid", "m1=5", "-o", str(archive), "--poles", "--float32")
    code, out, err = call(*command, "--function", "my_margin:lag")
    assert (code, err) == (0, "")
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


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ((), "expected exactly one of --grid, --random and --file"),
        (("--random", "3", "--grid", "m1=2"), "expected exactly one of"),
        (("--grid", "m1=2", "--seed", "3"), "--seed: only --random has a seed"),
        (("--grid", "m1"), "--grid m1: expected NAME=COUNT"),
        (("--random", "3", "--model", "x"), "only an archive has models"),
    ],
)
def test_bad_options(tmp_path: Path, options: tuple[str, ...], text: str, call: Call) -> None:
    code, out, err = call("sweep", ARM, *options, "-o", str(tmp_path / "a.h5"))
    assert (code, out) == (2, "")
    assert text in err
