from functools import partial

import pytest

from tests.scenarios.commands import Call, Output, run


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
