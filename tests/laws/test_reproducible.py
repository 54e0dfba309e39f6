"""Laws of the process whose arithmetic is the same on every processor of one kind.

1. results, errors and Ctrl-C come across, and a process that ends is another one at the next call
2. bits are the same whatever kernels this process has, where those of this process differ
3. a search finds the same LFT, bit by bit, whatever kernels this process has
4. without such a process a search is done here, and says so
"""

import json
import os
import platform
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mbdlft
from mbdlft.base import worker
from mbdlft.base.errors import WellPosednessError
from mbdlft.base.worker import NoProcessError, Worker, same_everywhere, settings
from mbdlft.lft.lft import constant
from mbdlft.order.search import IN_PROCESS
from mbdlft.pipeline.models import build
from tests.attack.cores import kinds

ROOT = Path(__file__).parents[2]


def test_results_come_across() -> None:
    a = np.arange(6.0).reshape(2, 3)
    assert np.array_equal(same_everywhere("numpy:transpose", a), a.T)
    assert same_everywhere("os:getpid") != os.getpid()
    assert same_everywhere("os:getpid") == same_everywhere("os:getpid")


def test_a_process_begins_before_its_first_call() -> None:
    worker = Worker({})
    worker.begin("wave")
    first = worker.process
    worker.begin("this")  # it runs
    assert worker.process is first is not None
    for module, there in (("wave", True), ("this", False)):
        assert worker.call("builtins:eval", f"{module!r} in __import__('sys').modules") is there
    worker.begin("no_such_module_at_all")
    worker.end()
    worker.begin("no_such_module_at_all")
    assert first.wait() is not None
    worker.end()


def test_errors_come_across() -> None:
    with pytest.raises(ZeroDivisionError):
        same_everywhere("operator:truediv", 1, 0)
    a = constant([[0.0]])
    with pytest.raises(WellPosednessError):
        same_everywhere("mbdlft.lft.lft:inverse", a)


def test_a_process_that_ends_is_replaced() -> None:
    first = same_everywhere("os:getpid")
    with pytest.raises(NoProcessError, match="ended"):
        same_everywhere("os:_exit", 3)
    second = same_everywhere("os:getpid")
    assert second not in (first, os.getpid())
    os.kill(second, signal.SIGKILL)
    assert same_everywhere("os:getpid") != second


def test_what_ends_with_the_process_is_tried_once_more() -> None:
    """It kills the first process, which the second one does not find any more."""
    first = same_everywhere("os:getpid")
    with suppress(ProcessLookupError):
        same_everywhere("os:kill", first, signal.SIGKILL)
    assert same_everywhere("os:getpid") != first


def test_ctrl_c_ends_the_process(monkeypatch: pytest.MonkeyPatch) -> None:
    first = same_everywhere("os:getpid")

    def interrupted(stream: Any) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as change:
        change.setattr(worker, "_receive", interrupted)
        with pytest.raises(KeyboardInterrupt):
            same_everywhere("time:sleep", 60)
    assert same_everywhere("os:getpid") != first


def test_a_fork_has_its_own() -> None:
    """It neither speaks to the process of its parent, nor ends it."""
    program = """
import atexit, os
from mbdlft.base.worker import same_everywhere
first = same_everywhere("os:getpid")
child = os.fork()
if child == 0:
    assert same_everywhere("os:getpid") != first
    atexit._run_exitfuncs()
    os._exit(0)
assert os.waitpid(child, 0)[1] == 0
assert same_everywhere("os:getpid") == first
"""
    if not hasattr(os, "fork"):
        pytest.skip("there are no forks here")
    subprocess.run([sys.executable, "-W", "ignore", "-c", program], cwd=ROOT, check=True)


def test_files_of_the_folder_are_not_imported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The folder of the user may have any names; they are not modules of the process."""
    monkeypatch.delenv("PYTHONPATH", raising=False)
    (tmp_path / "numpy.py").write_text("raise SystemExit(7)\n", encoding="utf-8")
    with elsewhere(tmp_path):
        assert same_everywhere("operator:add", 1, 2) == 3


@contextmanager
def elsewhere(folder: Path) -> Iterator[None]:
    """In a folder, with a process of this alone."""
    before = Path.cwd()
    os.chdir(folder)
    try:
        with pytest.raises(NoProcessError):
            same_everywhere("os:_exit", 0)
        yield
    finally:
        os.chdir(before)


PROGRAM = """
import hashlib, json, numpy as np, mbdlft
from mbdlft.base.worker import same_everywhere
random = np.random.default_rng(0)
a = random.standard_normal((60, 60))
def digest(*found):
    return hashlib.sha256(b"".join(one.tobytes() for one in found)).hexdigest()
here, there = digest(np.linalg.inv(a)), digest(same_everywhere("numpy.linalg:inv", a))
lft = mbdlft.to_lft(mbdlft.load_scene({scene!r}), search=0.1).lft
print(json.dumps([here, there, digest(lft.M11, lft.M12, lft.M21)]))
"""


@pytest.mark.long
def test_bits_do_not_depend_on_the_kernels() -> None:
    """A search from the scene whose order depended on the processor, and an inverse."""
    if len(kinds()) < 2:
        pytest.skip("this processor has the kernels of one kind only")
    scene = str(ROOT / "scenarios" / "spinning_satellite.toml")
    running = [
        subprocess.Popen(
            [sys.executable, "-c", PROGRAM.format(scene=scene)],
            env={**os.environ, "OPENBLAS_CORETYPE": kind, "PYTHONPATH": str(ROOT)},
            stdout=subprocess.PIPE,
            text=True,
        )
        for kind in kinds()
    ]
    here, there, searched = zip(*(json.loads(one.communicate()[0]) for one in running), strict=True)
    assert len(set(here)) > 1  # or this test shows nothing
    assert len(set(there)) == 1
    assert len(set(searched)) == 1


def test_settings_name_what_this_machine_has() -> None:
    assert settings()["OPENBLAS_NUM_THREADS"] == "1"
    own, umath = settings().get("NPY_DISABLE_CPU_FEATURES", ""), np._core._multiarray_umath
    assert own.split() == list(umath.__cpu_dispatch__)
    if platform.machine() == "x86_64":
        assert same_everywhere("os:getenv", "OPENBLAS_CORETYPE") == "Prescott"


def test_without_a_process_the_search_is_done_here(monkeypatch: pytest.MonkeyPatch) -> None:
    """As in an application that brings its own Python along."""
    scene, stages = mbdlft.load_scene(ROOT / "scenarios" / "two_link_arm.toml"), list[str]()
    expected = mbdlft.to_lft(scene, search=1.0)
    with pytest.raises(NoProcessError):
        same_everywhere("os:_exit", 0)
    monkeypatch.setattr(sys, "executable", "/usr/bin/another_program")
    with pytest.raises(NoProcessError, match="not an interpreter"):
        same_everywhere("os:getpid")
    found = build(scene, search=1.0, progress=stages.append).model
    assert found.order == expected.order == 16
    assert IN_PROCESS in stages
