"""Poles, numbers of a user's function, and single precision in sweeps.

1. poles are the roots of the characteristic polynomial; all that was there before stays in its bits
2. numbers of a function are its own, whoever computes them; where it fails, the status says so
3. in single precision each number is the nearest one, and samples and residuals stay as they are
4. a reader without mbdlft finds them, and digests hold
"""

from pathlib import Path

import h5py
import numpy as np
import pytest

import mbdlft
from benchmarks.cases.arm import SCENE
from mbdlft import Parameter, RandomSamples
from mbdlft.batch import staging
from mbdlft.batch.rows import Extra, source_digest
from mbdlft.batch.run import shard_rows
from tests.archive.plain_digest import digest, edit
from tests.close import CLOSED_FORM, exact, roundoff, target
from tests.errors.scenes import cart
from tests.errors.table import says

KEYS = ("samples", "A", "B", "C", "D", "trim", "residual", "status")
FUNCTIONS = """
import os
import numpy as np


def stiff(part):
    assert part.A.shape[1:] == (4, 4)
    return {"trace": np.trace(part.A @ part.A, axis1=1, axis2=2), "m1": part.samples["m1"],
            "fastest": np.max(part.poles.real, axis=1)}


def picky(part):
    if np.any(part.samples["m1"] > float(os.environ.get("MOST", 2.5))):
        raise ValueError("too heavy")
    return {"root": np.sqrt(part.samples["m1"] - 2.0)}
"""


@pytest.fixture
def module(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """A file in the working folder, as a user has it; its name is that of the test's folder."""
    name = f"own_{abs(hash(tmp_path))}"
    (tmp_path / f"{name}.py").write_text(FUNCTIONS, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    return name


def arm() -> mbdlft.Scene:
    return mbdlft.load_scene(SCENE)


def same(a: mbdlft.Sweep, b: mbdlft.Sweep) -> None:
    for key in KEYS:
        exact(getattr(a, key), getattr(b, key))


def test_poles_of_a_cart(tmp_path: Path) -> None:
    """m s^2 + c s + k, as formulas have it, sorted: the lower half plane first."""
    m = Parameter("m", 1.0, low=0.5, high=2.0, unit="kg")
    scene = cart("m", [m])
    values = {"m": np.linspace(0.5, 2.0, 700)}
    mbdlft.sweep(scene, values, tmp_path / "a.h5", workers=1, poles=True)
    found = mbdlft.load_sweep(tmp_path / "a.h5")
    assert found.poles is not None
    square, damping = -found.A[:, 1, 0], -found.A[:, 1, 1]
    root = np.sqrt(np.asarray(damping**2 / 4.0 - square, dtype=complex))
    expected = np.sort(np.stack([-damping / 2 - root, -damping / 2 + root], axis=1), axis=1)
    roundoff(found.poles, expected, kappa=10.0)
    roundoff(square, 3.0 / values["m"])
    mbdlft.sweep(scene, values, tmp_path / "b.h5", workers=1)
    same(found, mbdlft.load_sweep(tmp_path / "b.h5"))
    assert mbdlft.load_sweep(tmp_path / "b.h5").poles is None


def test_another_file_of_a_function_is_another_function(module: str) -> None:
    Path("other.py").write_text(FUNCTIONS.replace("heavy", "light"), encoding="utf-8")
    Path("same.py").write_text(FUNCTIONS, encoding="utf-8")
    one, other, same = (source_digest(f"{name}:picky") for name in (module, "other", "same"))
    assert len({one, other}) == 2
    assert one == same


@pytest.mark.long
def test_numbers_of_a_function(tmp_path: Path, module: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """In this process, in others, as a cluster computes them, and after an interruption."""
    monkeypatch.setattr(staging, "_SHARD_ROWS", 4096)
    given, text = RandomSamples(9000, 3), f"{module}:stiff"
    report = mbdlft.sweep(arm(), given, tmp_path / "a.h5", workers=1, function=text, poles=True)
    assert (report.solved, report.failed) == (9000, 0)
    found = mbdlft.load_sweep(tmp_path / "a.h5")
    assert list(found.values) == ["trace", "m1", "fastest"]
    exact(found.values["m1"], found.samples[:, [p.name for p in found.layout.parameters].index("m1")])
    assert found.poles is not None
    target(found.values["trace"], np.sum(found.poles**2, axis=1).real, CLOSED_FORM)
    exact(found.values["fastest"], np.max(found.poles.real, axis=1))

    def interrupt(done: int, _: int) -> None:
        if done >= 4096:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        mbdlft.sweep(
            arm(), given, tmp_path / "b.h5", workers=1, function=text, poles=True, progress=interrupt
        )
    file = tmp_path / f"{module}.py"
    for what in ({"function": text}, {"function": text, "poles": True, "float32": True}):
        with says(mbdlft.AnalysisError, "another sweep of this name is not finished"):
            mbdlft.sweep(arm(), given, tmp_path / "b.h5", workers=1, **what)  # type: ignore[arg-type]
    file.write_text(FUNCTIONS + "\n# changed\n", encoding="utf-8")
    with says(mbdlft.AnalysisError, "another sweep of this name is not finished", "function"):
        mbdlft.sweep(arm(), given, tmp_path / "b.h5", workers=1, function=text, poles=True)
    file.write_text(FUNCTIONS, encoding="utf-8")
    report = mbdlft.sweep(arm(), given, tmp_path / "b.h5", workers=2, function=text, poles=True)
    assert report.resumed >= 4096
    other = mbdlft.load_sweep(tmp_path / "b.h5")
    same(other, found)
    exact(other.poles, found.poles)
    for name, values in found.values.items():
        exact(other.values[name], values)
    extra = Extra(poles=True, function=text, names=tuple(found.values))
    rows = shard_rows(mbdlft.scene_to_toml(arm()), 9000, extra, found.samples[:50])
    exact(rows[:, -3:], np.stack(list(found.values.values()), axis=1)[:50])


def test_where_a_function_fails(tmp_path: Path, module: str) -> None:
    """It raises an error at heavy samples, and gives no number below 2 kg; all else is as without it."""
    samples = {}
    p = next(p for p in arm().parameters if p.name == "m1")
    low, high = p.low, p.high
    samples["m1"] = low + (high - low) * np.array([0.1, 0.9, 0.2, 0.4, 0.8, 0.3])
    failing = samples["m1"] > (low + high) / 2
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("MOST", str((low + high) / 2))
        report = mbdlft.sweep(
            arm(), samples, tmp_path / "a.h5", workers=1, function=f"{module}:picky", poles=True
        )
    mbdlft.sweep(arm(), samples, tmp_path / "b.h5", workers=1)
    found, plain = mbdlft.load_sweep(tmp_path / "a.h5"), mbdlft.load_sweep(tmp_path / "b.h5")
    nothing = failing | (samples["m1"] < 2.0)
    exact(found.status, np.where(nothing, 3, 0))
    assert (report.solved, report.failed) == (np.sum(~nothing), np.sum(nothing))
    exact(np.isnan(found.values["root"]), nothing)
    roundoff(found.values["root"][~nothing], np.sqrt(samples["m1"][~nothing] - 2.0))
    for key in KEYS[:-1]:
        exact(getattr(found, key), getattr(plain, key))
    assert found.poles is not None
    assert np.all(np.isfinite(found.poles))
    edit(
        tmp_path / "a.h5",
        lambda g: g["status"].__setitem__(0, 3 - found.status[0]),
        "sweeps/" + found.name,
    )
    with says(mbdlft.ArchiveError, "do not have their digest"):
        mbdlft.load_sweep(tmp_path / "a.h5")


def test_single_precision(tmp_path: Path, module: str) -> None:
    given = RandomSamples(500, 3)
    options = {"workers": 1, "poles": True, "function": f"{module}:stiff"}
    mbdlft.sweep(arm(), given, tmp_path / "a.h5", **options)  # type: ignore[arg-type]
    mbdlft.sweep(arm(), given, tmp_path / "b.h5", float32=True, **options)  # type: ignore[arg-type]
    double, single = (mbdlft.load_sweep(tmp_path / name) for name in ("a.h5", "b.h5"))
    assert single.layout.single
    assert not double.layout.single
    for key in ("A", "B", "C", "D", "trim"):
        assert getattr(single, key).dtype == np.float32
        exact(getattr(single, key), getattr(double, key).astype(np.float32))
    for key in ("samples", "residual", "status"):
        exact(getattr(single, key), getattr(double, key))
    for name, values in double.values.items():
        exact(single.values[name], values.astype(np.float32))
    with h5py.File(tmp_path / "b.h5") as file:
        group = file["sweeps/two_link_arm"]
        assert group.attrs["digest"].decode() == digest(group)
        assert group["function/name"].asstr()[()].tolist() == ["trace", "m1", "fastest"]
        assert group["poles/imaginary"].dtype == np.float32
        assert group["poles/imaginary"].shape == (500, 4)
        exact(group["function/value"][:, 1], double.values["m1"].astype(np.float32))
    sizes = [(tmp_path / name).stat().st_size for name in ("a.h5", "b.h5")]
    assert sizes[1] < 0.7 * sizes[0]


def test_a_model_and_rows_without_a_solution(tmp_path: Path, module: str) -> None:
    """Functions see solved samples only; other rows keep their status, and have no poles."""
    force = Parameter("f", 0.0, low=-1.0, high=1.0, unit="N")
    mass = Parameter("m", 1.0, low=0.0, high=2.0, unit="kg")
    scene = cart("m", [force, mass], {"preload": "f"})
    values = {"f": np.array([0.0, 0.0, 0.5, 1.0, 0.0]), "m": np.array([0.0, 1.0, 1.0, 0.0, 0.5])}
    Path(f"{module}_b.py").write_text(
        "import numpy as np\ndef f(part):\n    assert np.all(part.samples['m'] > 0.4)\n"
        "    return {'a': part.A[:, 1, 0]}\n",
        encoding="utf-8",
    )
    report = mbdlft.sweep(
        scene, values, tmp_path / "a.h5", workers=1, poles=True, function=f"{module}_b:f"
    )
    assert (report.solved, report.not_converged, report.no_equilibrium, report.failed) == (2, 1, 2, 0)
    found = mbdlft.load_sweep(tmp_path / "a.h5")
    exact(found.status, [1, 0, 2, 2, 0])
    assert found.poles is not None
    for part in (found.poles, found.values["a"]):
        assert np.all(np.isnan(part[[0, 2, 3]]))
        assert np.all(np.isfinite(part[[1, 4]]))
    model = mbdlft.to_lft(arm(), search=0.0)
    mbdlft.sweep(model, RandomSamples(2000), tmp_path / "b.h5", workers=1, poles=True)
    rows = mbdlft.load_sweep(tmp_path / "b.h5")
    assert rows.poles is not None
    exact(rows.poles, np.sort(np.linalg.eigvals(rows.A).astype(complex), axis=1))
