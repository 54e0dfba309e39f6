"""Sweeps give what trimming and linearizing at each sample gives, whoever computes them and how often."""

import os
import subprocess
import sys
import tracemalloc
from pathlib import Path

import h5py
import numpy as np
import pytest

import mbdlft
from benchmarks.cases.arm import SCENE, closed_form
from mbdlft import Angle, GridSamples, Parameter, RandomSamples
from mbdlft.base import worker
from mbdlft.batch import rows, run, staging
from mbdlft.batch.rows import Extra, source_digest
from mbdlft.batch.run import shard_rows
from mbdlft.batch.samples import points_of, samples_of
from tests.archive.plain_digest import digest, edit
from tests.close import CLOSED_FORM, exact, roundoff, target
from tests.errors.scenes import cart
from tests.errors.table import says

PARAMETERS = (
    Parameter("a", 1.0, low=0.0, high=3.0),
    Parameter("b", 2.0, percent=10),
    Angle("c", 10.0, low=-20.0, high=80.0),
)
KEYS = ("samples", "A", "B", "C", "D", "trim", "residual", "status")
SECONDS = 120
MEMORY = 2**27  # bytes
CLUSTER = """
import os, signal, sys
import mbdlft
from mbdlft.batch import staging
from distributed import Client, LocalCluster

if __name__ == "__main__":
    staging._SHARD_ROWS = 4096
    scene = mbdlft.load_scene(sys.argv[1])
    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as local:
        with Client(local) as client:
            victims = list(client.run(os.getpid).values())[:1]

            def kill(done, count):
                if done and victims:
                    os.kill(victims.pop(), signal.SIGKILL)

            samples = mbdlft.RandomSamples(int(sys.argv[3]), 5)
            report = mbdlft.sweep(scene, samples, sys.argv[2], client=client, progress=kill)
            assert not victims
            print(report.count, report.solved)
"""


@pytest.fixture
def small_shards(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(staging, "_SHARD_ROWS", 4096)


def arm() -> mbdlft.Scene:
    return mbdlft.load_scene(SCENE)


def drawn(count: int, seed: int = 0) -> dict[str, np.ndarray]:
    """What `RandomSamples` stand for: the parameters sorted by name, as in a model."""
    return mbdlft.random(sorted(arm().parameters, key=lambda p: p.name), count, seed)


def check_arm(found: mbdlft.Sweep, values: dict[str, np.ndarray]) -> None:
    state, torques = closed_form(values)
    target(np.concatenate([found.A, found.B], axis=2), state, CLOSED_FORM)
    target(found.trim, torques, CLOSED_FORM)
    exact(found.status, np.zeros(len(found.status)))


def same_numbers(a: mbdlft.Sweep, b: mbdlft.Sweep) -> None:
    for key in KEYS:
        exact(getattr(a, key), getattr(b, key))


def same(a: mbdlft.Sweep, b: mbdlft.Sweep) -> None:
    same_numbers(a, b)
    assert a.layout == b.layout


def test_a_sweep_that_another_one_computes_is_refused(tmp_path: Path) -> None:
    """The error names the process; the first one goes on, and another name is free."""
    file, refused = tmp_path / "a.h5", list[str]()

    def again(done: int, count: int) -> None:
        with pytest.raises(mbdlft.base.ArchiveError) as error:
            mbdlft.sweep(arm(), RandomSamples(5), file, name="q", workers=1)
        refused.append(str(error.value))

    mbdlft.sweep(arm(), RandomSamples(5), file, name="q", workers=1, progress=again)
    assert all(f"process {os.getpid()} computes this sweep now" in text for text in refused)
    assert len(refused) == 2
    assert all(".a.h5.q.sweep" in text for text in refused)
    assert mbdlft.sweep(arm(), RandomSamples(5), file, name="q", workers=1).solved == 5
    assert [path.name for path in tmp_path.iterdir()] == ["a.h5"]


def test_rows_of_a_model_are_its_values(tmp_path: Path) -> None:
    model = mbdlft.to_lft(arm(), search=0.0)
    values = mbdlft.random(model.parameters, 1500)
    mbdlft.sweep(model, RandomSamples(1500), tmp_path / "a.h5", workers=1)
    found = mbdlft.load_sweep(tmp_path / "a.h5")
    roundoff(found.A, mbdlft.matrices_at(model, values).A)
    roundoff(found.D, mbdlft.matrices_at(model, values).D)
    roundoff(found.trim, mbdlft.trim_at(model, values))
    assert found.model == model.name
    check_arm(found, values)
    exact(found.residual, np.full(1500, model.certificate.max_relative_error))


def test_singular_samples_of_a_model(tmp_path: Path) -> None:
    scene = cart("m", [Parameter("m", 1.0, low=0.5, high=2.0, unit="kg")])
    model = mbdlft.to_lft(scene, search=0.0)
    source = rows.ModelSource(model)
    # far outside the range, where the certificate says nothing: m = 0
    block = model.lft.blocks[0].size
    singular = np.linalg.eigvals(model.lft.M11).real
    assert block == len(singular) == 1
    points = np.array([[1.0], [0.7]])
    deltas = rows.deltas_of
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            rows, "deltas_of", lambda *a: np.where(deltas(*a) == 0.0, 1.0 / singular[0], deltas(*a))
        )
        matrices, _, residual, status = source.rows(points)
    exact(status, [1, 0])
    assert np.all(np.isnan(matrices[0]))
    assert np.isnan(residual[0])
    roundoff(matrices[1][:2, :2], model.at(m=0.7).A)


@pytest.mark.parametrize("cut", [1, 7, 60])
def test_samples_do_not_depend_on_the_cut(cut: int) -> None:
    counts = {"c": 4, "a": 5, "b": 3}
    for given, expected in (
        (GridSamples(counts), mbdlft.grid(PARAMETERS, counts)),
        (GridSamples({"b": 60}), mbdlft.grid(PARAMETERS, {"b": 60})),
        (RandomSamples(60, 9), mbdlft.random(PARAMETERS, 60, 9)),
    ):
        found = samples_of(PARAMETERS, given)
        parts = [points_of(found, PARAMETERS, k, min(60, k + cut)) for k in range(0, 60, cut)]
        exact(np.concatenate(parts), np.stack([expected[p.name] for p in PARAMETERS], axis=1))


@pytest.mark.usefixtures("small_shards")
def test_processes_and_a_killed_worker(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    given = RandomSamples(20_000, 5)
    mbdlft.sweep(arm(), given, tmp_path / "one.h5", workers=1)
    start, started = worker.Worker._start, []

    def short_life(of: worker.Worker) -> subprocess.Popen[bytes]:
        process = start(of)
        started.append(process.pid)
        if len(started) == 1:
            process.kill()
        return process

    monkeypatch.setattr(worker.Worker, "_start", short_life)
    seen: list[int] = []
    mbdlft.sweep(
        arm(), given, tmp_path / "two.h5", name="two_link_arm", workers=2,
        progress=lambda done, count: seen.append(done),
    )  # fmt: skip
    assert len(started) >= 3
    assert seen[0] == 0
    assert seen[-1] == 20_000
    assert seen == sorted(set(seen))
    one = mbdlft.load_sweep(tmp_path / "one.h5")
    same(mbdlft.load_sweep(tmp_path / "two.h5"), one)
    check_arm(one, drawn(20_000, 5))


@pytest.mark.usefixtures("small_shards")
def test_workers_that_always_die(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pool = worker.Pool
    monkeypatch.setattr(run, "Pool", lambda _, *more: pool("tests.dying:die", *more))
    with says(mbdlft.AnalysisError, "sweep: 3 workers died over shard", "the same sweep goes on"):
        mbdlft.sweep(arm(), RandomSamples(9000), tmp_path / "a.h5", workers=2)


@pytest.mark.usefixtures("small_shards")
def test_restart_forgets_what_is_there(tmp_path: Path) -> None:
    given, file = RandomSamples(9000), tmp_path / "a.h5"

    def interrupt(done: int, count: int) -> None:
        if done:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        mbdlft.sweep(arm(), given, file, workers=1, progress=interrupt)
    (folder,) = tmp_path.glob(".a.h5.two_link_arm.sweep")
    work = staging.opened(folder)
    at = staging.places(folder, work)
    zeros = 0.0 * at.read(staging.rows_file(folder), 0, 4096)
    staging.write_shard(folder, work, at, 0, zeros)  # planted: zeros, which a resumed sweep takes
    assert mbdlft.sweep(arm(), given, file, workers=1).resumed == 4096
    assert not np.any(mbdlft.load_sweep(file, stop=4096).A)
    with pytest.raises(KeyboardInterrupt):
        mbdlft.sweep(arm(), given, file, workers=1, progress=interrupt)
    with says(mbdlft.AnalysisError, "another sweep of this name is not finished", "--restart"):
        mbdlft.sweep(arm(), RandomSamples(9000, 1), file, workers=1)
    assert mbdlft.sweep(arm(), given, file, workers=1, restart=True).resumed == 0
    check_arm(mbdlft.load_sweep(file), drawn(9000))


@pytest.mark.usefixtures("small_shards")
def test_a_worker_of_a_killed_sweep_writes_nothing_into_another(tmp_path: Path) -> None:
    """It has read the plan, and writes when another sweep of this name has begun."""
    file = tmp_path / "a.h5"

    def interrupt(done: int, count: int) -> None:
        raise KeyboardInterrupt

    for seed, restart in enumerate((False, True)):
        with pytest.raises(KeyboardInterrupt):
            mbdlft.sweep(
                arm(), RandomSamples(9000, seed), file, workers=1, restart=restart, progress=interrupt
            )
        (folder,) = tmp_path.glob(".a.h5.two_link_arm.sweep*")
        if not restart:
            old = staging.opened(folder)
            at = staging.places(folder, old)
            rows = at.read(staging.rows_file(folder), 0, 4096)
    staging.write_shard(folder, old, at, 0, rows)
    report = mbdlft.sweep(arm(), RandomSamples(9000, 1), file, workers=1)
    assert report.resumed == 0
    check_arm(mbdlft.load_sweep(file), drawn(9000, 1))


@pytest.mark.long
@pytest.mark.usefixtures("small_shards")
def test_cluster_with_a_killed_worker(tmp_path: Path) -> None:
    pytest.importorskip("distributed")
    count, script = 30_000, tmp_path / "script.py"
    script.write_text(CLUSTER, encoding="utf-8")
    done = subprocess.run(
        [sys.executable, str(script), str(SCENE), str(tmp_path / "a.h5"), str(count)],
        cwd=tmp_path,
        env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
        timeout=SECONDS,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == [str(count), str(count)]
    mbdlft.sweep(arm(), RandomSamples(count, 5), tmp_path / "b.h5", workers=1)
    same(mbdlft.load_sweep(tmp_path / "a.h5"), mbdlft.load_sweep(tmp_path / "b.h5"))


def test_cluster_needs_dask(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def absent(name: str) -> None:
        raise ImportError(name)

    monkeypatch.setattr(run, "import_module", absent)
    with says(mbdlft.AnalysisError, "a cluster needs Dask: pip install 'mbdlft[cluster]'"):
        mbdlft.sweep(arm(), RandomSamples(5), tmp_path / "a.h5", client=object())


@pytest.mark.usefixtures("small_shards")
def test_memory_is_bounded(tmp_path: Path) -> None:
    tracemalloc.start()
    mbdlft.sweep(arm(), RandomSamples(60_000), tmp_path / "a.h5", workers=1)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert (tmp_path / "a.h5").stat().st_size > 60_000 * 8 * 40
    assert peak < MEMORY / 4


# Poles, numbers of a user's function, and single precision in sweeps.

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
    same_numbers(found, mbdlft.load_sweep(tmp_path / "b.h5"))
    assert mbdlft.load_sweep(tmp_path / "b.h5").poles is None


def test_another_file_of_a_function_is_another_function(module: str) -> None:
    Path("other.py").write_text(FUNCTIONS.replace("heavy", "light"), encoding="utf-8")
    Path("same.py").write_text(FUNCTIONS, encoding="utf-8")
    one, other, same = (source_digest(f"{name}:picky") for name in (module, "other", "same"))
    assert len({one, other}) == 2
    assert one == same


@pytest.mark.long
@pytest.mark.usefixtures("small_shards")
def test_numbers_of_a_function(tmp_path: Path, module: str) -> None:
    """In this process, in others, as a cluster computes them, and after an interruption."""
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
    same_numbers(other, found)
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
    matrices = [getattr(found, name) for name in ("A", "B", "C", "D", "residual")]
    for part in (found.poles, found.values["a"], *matrices):
        assert np.all(np.isnan(part[[0, 2, 3]]))
        assert np.all(np.isfinite(part[[1, 4]]))
    roundoff(found.A[[1, 4], 1, 0], [-3.0, -6.0])
    exact(found.samples[:, 0], values["f"])
    model = mbdlft.to_lft(arm(), search=0.0)
    mbdlft.sweep(model, RandomSamples(2000), tmp_path / "b.h5", workers=1, poles=True)
    rows = mbdlft.load_sweep(tmp_path / "b.h5")
    assert rows.poles is not None
    exact(rows.poles, np.sort(np.linalg.eigvals(rows.A).astype(complex), axis=1))
