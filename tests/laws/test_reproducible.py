"""Laws of processes that call functions, and of progress that is told."""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mbdlft
from mbdlft import Parameter, TrimError
from mbdlft.base import running, worker
from mbdlft.base.errors import WellPosednessError
from mbdlft.base.samples import check_points
from mbdlft.base.worker import NoProcessError, Worker
from mbdlft.batch import native as module
from mbdlft.batch import program_cache
from mbdlft.batch.rows import source_of
from mbdlft.cli.output import Progress, progress_of
from mbdlft.lft.lft import constant
from mbdlft.lft.program.native import Cache
from mbdlft.problem import trim
from mbdlft.system.regular import regularity
from tests.attack.cores import kinds
from tests.close import exact, roundoff
from tests.errors.scenes import cart
from tests.laws.random_loops import blocks_system

ROOT = Path(__file__).parents[2]
there = Worker({})


def test_results_come_across() -> None:
    a = np.arange(6.0).reshape(2, 3)
    assert np.array_equal(there.call("numpy:transpose", a), a.T)
    assert there.call("os:getpid") != os.getpid()
    assert there.call("os:getpid") == there.call("os:getpid")


def test_errors_come_across() -> None:
    with pytest.raises(ZeroDivisionError):
        there.call("operator:truediv", 1, 0)
    a = constant([[0.0]])
    with pytest.raises(WellPosednessError):
        there.call("mbdlft.lft.lft:inverse", a)


def test_a_process_that_ends_is_replaced() -> None:
    first = there.call("os:getpid")
    with pytest.raises(NoProcessError, match="ended"):
        there.call("os:_exit", 3)
    second = there.call("os:getpid")
    assert second not in (first, os.getpid())
    process = there.process
    assert process is not None
    process.kill()
    process.wait()
    assert there.call("os:getpid") != second


def test_ctrl_c_ends_the_process(monkeypatch: pytest.MonkeyPatch) -> None:
    first = there.call("os:getpid")

    def interrupted(stream: Any) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as change:
        change.setattr(worker, "_receive", interrupted)
        with pytest.raises(KeyboardInterrupt):
            there.call("time:sleep", 60)
    assert there.call("os:getpid") != first


@pytest.mark.skipif(not hasattr(signal, "pthread_kill"), reason="no signals to threads here")
@pytest.mark.parametrize("delay", [0.2, 1.5])
def test_ctrl_c_ends_the_tasks_of_a_crew(delay: float, tmp_path: Path) -> None:
    """Workers that start half a second after they are asked to are ended before, and while, they work."""
    program = f"""
import signal, threading, time
from mbdlft.base import worker
from mbdlft.robust.bisect.search import crew_of

start, interrupted = worker.Worker._start, False
def late(self):
    time.sleep(0.5)
    return start(self)
worker.Worker._start = late
signal.signal(signal.SIGINT, signal.default_int_handler)
main = threading.main_thread().ident
try:
    with crew_of(2, None, "test") as crew:
        threading.Timer({delay}, signal.pthread_kill, (main, signal.SIGINT)).start()
        crew(exec, [("import time; time.sleep(3.0); open('{tmp_path / "ended"}', 'w')",)] * 2)
except KeyboardInterrupt:
    interrupted = True
assert interrupted
"""
    subprocess.run([sys.executable, "-c", program], cwd=ROOT, check=True)
    assert not (tmp_path / "ended").exists()


def test_a_fork_has_its_own() -> None:
    """It neither speaks to the process of its parent, nor ends it."""
    program = """
import atexit, os
from mbdlft.base.worker import Worker
call = Worker({}).call
first = call("os:getpid")
child = os.fork()
if child == 0:
    assert call("os:getpid") != first
    atexit._run_exitfuncs()
    os._exit(0)
assert os.waitpid(child, 0)[1] == 0
assert call("os:getpid") == first
"""
    if not hasattr(os, "fork"):
        pytest.skip("there are no forks here")
    subprocess.run([sys.executable, "-W", "ignore", "-c", program], cwd=ROOT, check=True)


def test_files_of_the_folder_are_not_imported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The folder of the user may have any names; they are not modules of the process."""
    monkeypatch.delenv("PYTHONPATH", raising=False)
    (tmp_path / "numpy.py").write_text("raise SystemExit(7)\n", encoding="utf-8")
    with elsewhere(tmp_path):
        assert there.call("operator:add", 1, 2) == 3


@contextmanager
def elsewhere(folder: Path) -> Iterator[None]:
    """In a folder, with a process of this alone."""
    before = Path.cwd()
    os.chdir(folder)
    try:
        with pytest.raises(NoProcessError):
            there.call("os:_exit", 0)
        yield
    finally:
        os.chdir(before)


# How far work is: of an upper limit, never backwards, and without a part in the result.

SCENARIOS = Path(__file__).parents[2] / "scenarios"
SEARCHES = {
    "margin": lambda model: mbdlft.robust_stability(model, gap=1e-3, work=0.3),
    "gain": lambda model: mbdlft.worst_case_gain(model, "shoulder.torque", "tip.y", work=3.0),
    "poles": lambda model: mbdlft.worst_case(model, "damping", work=2.0),
    "mixed": lambda _: mbdlft.robust_stability(blocks_system(0, 5), work=0.15),
    "stability": lambda model: mbdlft.check_stability(model, 20, prove=2.0),
}


def pendulum() -> mbdlft.LFTModel:
    scene = mbdlft.load_scene(SCENARIOS / "double_pendulum_hanging.toml")
    return mbdlft.to_lft(scene, search=0.0)


@pytest.mark.parametrize("name", SEARCHES)
def test_searches_tell_what_they_have_done(name: str) -> None:
    model, told = pendulum(), list[tuple[float, float]]()
    with running.heard(lambda done, most: told.append((done, most))):
        found = SEARCHES[name](model)
    assert told[0][0] == 0.0
    assert len(told) > 1
    assert len({most for _, most in told}) == 1
    assert all(0.0 <= done <= most for done, most in told)
    best = 0.0
    for done, _ in told:  # parts of a batch begin where the batch began, and never before
        assert done >= 0.5 * best
        best = max(best, done)
    if hasattr(found, "work"):
        assert 0.5 * found.work <= best <= 2.0 * found.work + 1e-3
    again = SEARCHES[name](model)
    assert str(again) == str(found)


def test_a_search_is_heard() -> None:
    scene = mbdlft.load_scene(SCENARIOS / "ur5.toml")
    told: list[tuple[float, float]] = []
    with running.heard(lambda done, most: told.append((done, most))):
        mbdlft.to_lft(scene, search=0.3, prove=0.2)
    by_budget = {most: [done for done, own in told if own == most] for _, most in told}
    assert {0.3, 0.2} <= set(by_budget)
    # exchanges have an account of their own
    assert all(after in (0.0, max(before, after)) for before, after in pairwise(by_budget[0.3]))
    assert max(by_budget[0.3]) > 0.0


def test_a_proof_tells_what_it_has_done() -> None:
    model, told = pendulum(), list[float]()
    with running.heard(lambda done, most: told.append(done)):
        regularity(model.lft, 0.01)
    assert told
    assert told == sorted(told)


def test_nothing_is_told_where_nobody_listens_and_outside_of_a_budget() -> None:
    running.tell(1.0)
    running.pass_on(1.0, 2.0)
    with running.budget(3.0), running.after(1.0):
        running.tell(1.0)
    told: list[tuple[float, float]] = []
    with running.heard(lambda done, most: told.append((done, most))):
        running.tell(1.0)
        assert told == []
        with running.budget(3.0):
            with running.after(1.0), running.after(0.5), running.budget(7.0):
                running.tell(1.0)
                running.tell(9.0)
            running.pass_on(2.0, 5.0)
        running.pass_on(2.0, 5.0)
    assert told == [(0.0, 3.0), (2.5, 3.0), (3.0, 3.0), (2.0, 3.0), (2.0, 5.0)]


class Line:
    """What is shown, in place of a status of rich."""

    def __init__(self) -> None:
        self.texts: list[str] = []

    def update(self, text: str) -> None:
        self.texts.append(text)


def test_in_a_file_there_is_a_line_now_and_then(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    clock = [100.0]
    monkeypatch.setattr(time, "monotonic", lambda: clock[0])
    with progress_of("[arm]") as progress:
        for done in range(100):
            clock[0] += 1.0
            progress.worked(done, 100.0)
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 5
    assert lines[0] == "[arm], 19 % of the work that is allowed, at most about 1 min left"


def test_a_line_says_stage_share_and_time(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = [100.0]
    monkeypatch.setattr(time, "monotonic", lambda: clock[0])
    line: Any = Line()
    progress = Progress("[arm]", line)
    progress.stage("search")
    progress.worked(0.0, 4.0)
    for _ in range(40):
        clock[0] += 0.05
        progress.worked((clock[0] - 100.0) / 2.0, 4.0)
    assert line.texts[0] == r"\[arm]: search"
    assert line.texts[1] == r"\[arm]: search, 0 % of the work that is allowed"
    assert line.texts[-1].endswith("search, 25 % of the work that is allowed, at most about 6 s left")
    assert len(line.texts) < 25  # not at each step
    progress.worked(0.2, 4.0)  # a part that began earlier
    clock[0] += 1.0
    progress.worked(0.3, 4.0)
    assert "25 %" in line.texts[-1]
    progress.stage("prove")
    assert line.texts[-1] == r"\[arm]: prove"
    clock[0] += 1.0
    progress.counted(50, 100)  # 50 of an earlier run
    clock[0] += 10.0
    progress.counted(60, 100)
    assert line.texts[-1] == r"\[arm]: prove, 60 of 100, about 40 s left"


# Programs of scenes that were compiled before: the same bits, and nothing else is taken for one.

pytest.importorskip("llvmlite")


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    folder = tmp_path / "native"
    monkeypatch.setenv("MBDLFT_CACHE", str(folder))
    return folder


def scene(name: str) -> mbdlft.Scene:
    return mbdlft.load_scene(SCENARIOS / f"{name}.toml")


def nothing(*_: object) -> None:
    raise AssertionError("the scene is assembled")


@pytest.mark.parametrize("name", ["two_link_arm", "flexible_manipulator", "crane", "pendulum"])
def test_the_second_time_nothing_is_assembled(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    first = mbdlft.compile(scene(name), threads=1)
    with monkeypatch.context() as patch:
        for where in (module, program_cache):
            patch.setattr(where, "source_of", nothing)
        second = mbdlft.compile(scene(name), threads=1)
        assert (second.computes, second.reason) == ("equations", "")
        assert second.layout == first.layout
        assert second.parameters == first.parameters
        assert second.source.chunk == first.source.chunk
        at = check_points(second.parameters, 3)[:203]
        for part, other in zip(second.rows(at), first.rows(at), strict=True):
            exact(part, other)


def test_samples_without_a_solution() -> None:
    force = Parameter("f", 0.0, low=-1.0, high=1.0, unit="N")
    mass = Parameter("m", 1.0, low=0.0, high=2.0, unit="kg")
    values = {"f": np.array([0.0, 0.0, 0.5, 1.0, 0.0]), "m": np.array([0.0, 1.0, 1.0, 0.0, 0.5])}
    given = cart("m", [force, mass], {"preload": "f"})
    first, second = (mbdlft.compile(given) for _ in range(2))
    assert isinstance(second.source, program_cache.SceneSource)
    rows = second(values)
    assert rows.status.tolist() == [1, 0, 2, 2, 0]
    for part, other in zip(rows, first(values), strict=True):
        assert np.array_equal(part, other, equal_nan=True)
    for part in rows[:4]:
        assert np.all(np.isnan(part[[0, 2, 3]]))
    roundoff(rows.A[[1, 4], 1, 0], [-3.0, -6.0])


def test_loads_through_elastic_bodies_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    first, second = (mbdlft.compile(scene("solar_arrays"), threads=1) for _ in range(2))
    assert isinstance(second.source, program_cache.SceneSource)
    at = check_points(second.parameters, 3)[:20]
    for found in (first, second):
        found.rows(at)
    for where in (module, trim):  # planted: no wrench at all is too much
        monkeypatch.setattr(where, "CARRIED", Less())
    for found in (first, second):
        with pytest.raises(TrimError, match="is elastic and carries a load at equilibrium"):
            found.rows(at)


class Less(float):
    """A part of anything that is less than nothing."""

    def __mul__(self, _: object) -> float:
        return -1.0


def kept(folder: Path) -> int:
    return len(list(folder.glob("*.program")))


def test_what_is_another_program(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    mbdlft.compile(cart())
    mbdlft.compile(cart())
    assert kept(cache) == 1
    mbdlft.compile(cart(0.8))
    assert kept(cache) == 2
    with monkeypatch.context() as patch:
        patch.setattr(program_cache, "_package", lambda: "changed")
        mbdlft.compile(cart())
    assert kept(cache) == 3
    with monkeypatch.context() as patch:
        patch.setattr(program_cache, "_file", lambda _: __file__)  # a kind of a user
        mbdlft.compile(cart())
    assert kept(cache) == 4
    # a line for each file of the package
    files = len(list(Path(program_cache.__file__).parents[1].rglob("*.py")))
    assert program_cache._package().count("\n") + 1 == files
    assert program_cache._file(type(cart().bodies[0])) is None
    assert program_cache._file(Path) is not None
    monkeypatch.setattr(program_cache, "version", lambda _: "9")
    mbdlft.compile(cart())
    assert kept(cache) == 5


def test_what_is_not_as_it_was_written(cache: Path) -> None:
    expected = mbdlft.compile(cart(), threads=1).rows(np.zeros((3, 0)))
    (file,) = cache.glob("*.program")
    whole = file.read_bytes()
    for damage in (b"", whole[:50], whole[:-1], whole[:60] + b"!" + whole[61:]):
        file.write_bytes(damage)
        assert program_cache.remembered(cart()) is None
        found = mbdlft.compile(cart(), threads=1)
        assert file.read_bytes() == whole
        for part, other in zip(found.rows(np.zeros((3, 0))), expected, strict=True):
            exact(part, other)
    # whole, of this user, and nonsense
    for image in (b"nonsense", whole[32:90], b"PK\x05\x06" + bytes(18)):
        Cache(cache).put(file.stem, image, "program")
        assert program_cache.remembered(cart()) is None
    file.write_bytes(whole)
    file.chmod(0o666)
    assert program_cache.remembered(cart()) is None


def test_code_that_cannot_be_loaded(monkeypatch: pytest.MonkeyPatch) -> None:
    mbdlft.compile(cart())
    with monkeypatch.context() as patch:
        patch.setattr("mbdlft.lft.program.native.compile_native", lambda *_: 1 / 0)
        with pytest.warns(mbdlft.MbdlftWarning, match="LLVM failed: ZeroDivisionError"):
            assert mbdlft.compile(cart()).program is None
    assert source_of(cart()).layout == mbdlft.compile(cart()).layout


def test_without_a_folder(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MBDLFT_CACHE", "")
    for _ in range(2):
        assert not isinstance(mbdlft.compile(cart()).source, program_cache.SceneSource)


@pytest.mark.long
def test_orders_do_not_depend_on_the_kernels() -> None:
    """Of a scene whose order did, and an inverse whose last bits do."""
    if len(kinds()) < 2:
        pytest.skip("this processor has the kernels of one kind only")
    scene = str(SCENARIOS / "spinning_satellite.toml")
    running = [
        subprocess.Popen(
            [sys.executable, "-c", PROGRAM.format(scene=scene)],
            env={**os.environ, "OPENBLAS_CORETYPE": kind, "PYTHONPATH": str(ROOT)},
            stdout=subprocess.PIPE,
            text=True,
        )
        for kind in kinds()
    ]
    inverses, orders = zip(*(json.loads(one.communicate()[0]) for one in running), strict=True)
    assert len(set(inverses)) > 1  # or this test shows nothing
    assert set(map(tuple, orders)) == {(25, 25)}


PROGRAM = """
import json, numpy as np, mbdlft
a = np.random.default_rng(0).standard_normal((60, 60))
certificate = mbdlft.to_lft(mbdlft.load_scene({scene!r})).certificate
print(json.dumps([np.linalg.inv(a).tobytes().hex(), [sum(certificate.order), certificate.order_bound]]))
"""
