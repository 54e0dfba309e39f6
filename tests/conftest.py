"""Two profiles of random testing: fast is repeatable and is the default, deep is for the night.

No test reads or leaves native code in the folder of the user.
"""

import gc
import io
import os
from functools import partial
from importlib import import_module
from typing import Any

import pytest
from hypothesis import HealthCheck, settings

from mbdlft.base import worker
from mbdlft.elastic import files
from tests.scenarios.commands import Call, Output, run

os.environ["MBDLFT_CACHE"] = ""
os.fsync = lambda _: None  # of a loss of power no test knows, and each waits for the disk

settings.register_profile(
    "fast", max_examples=25, derandomize=True, deadline=None, suppress_health_check=[HealthCheck.too_slow]
)
settings.register_profile("deep", max_examples=500, deadline=None, print_blob=True)
settings.load_profile(os.environ.get("MBDLFT_HYPOTHESIS", "fast"))


gc.disable()  # modules and tests that are collected stay


def pytest_collection_finish() -> None:
    """Garbage is not looked for in what collected tests hold: half of the time of parsing all sources."""
    gc.freeze()
    gc.set_threshold(500_000, 20, 20)
    gc.enable()


@pytest.fixture
def call(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Call:
    """Run a command line."""
    return partial(run, monkeypatch, capsys)


@pytest.fixture
def output(call: Call) -> Output:
    """What a command line prints that ends well and says nothing else."""

    def printed(*words: str) -> str:
        code, out, err = call(*words)
        assert (code, err) == (0, "")
        return out

    return printed


@pytest.fixture
def read_here(monkeypatch: pytest.MonkeyPatch) -> None:
    """Files of others are read in this process, by what is sent between two: a second faster each."""

    def arrays_of(target: str, arguments: dict[str, Any], *, error: Any, **_: Any) -> Any:
        module, _, name = target.partition(":")
        try:
            kind, answer = "result", getattr(import_module(module), name)(**arguments)
        except Exception as failure:
            kind, answer = "error", failure
        stream = io.BytesIO()
        worker._send_arrays(stream, kind, answer)
        stream.seek(0)
        kind, answer = worker._receive_arrays(stream)
        if kind == "error":
            raise error(str(answer))
        return answer

    monkeypatch.setattr(files, "arrays_of", arrays_of)
    monkeypatch.setattr("mbdlft.robot.mjcf_model.arrays_of", arrays_of)
