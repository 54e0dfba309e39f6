from functools import partial

import pytest

from tests.scenarios.commands import Call, run


@pytest.fixture
def call(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Call:
    """Run a command line."""
    return partial(run, monkeypatch, capsys)
