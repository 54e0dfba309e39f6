"""Command lines that refuse, as rows of tables."""

from collections.abc import Callable
from pathlib import Path

import pytest

from tests.errors.scenes import changed
from tests.errors.table import MessageError
from tests.scenarios.commands import Call


@pytest.fixture
def command(monkeypatch: pytest.MonkeyPatch, call: Call, tmp_path: Path) -> Callable[..., None]:
    """A command line in an empty folder: exit code 2, and one message, which is raised, and no output."""
    monkeypatch.chdir(tmp_path)

    def refuse(*words: str) -> None:
        code, out, err = call(*words)
        assert (code, out) == (2, "")
        assert err.startswith("mbdlft: ")
        assert err.count("mbdlft: ") == 1
        assert err.endswith("\n")
        assert "Traceback" not in err
        raise MessageError(err)

    return refuse


@pytest.fixture
def arm_file(tmp_path: Path) -> Callable[..., str]:
    """The arm, with a text replaced, written as arm.toml."""

    def write(old: str = "", new: str = "") -> str:
        (tmp_path / "arm.toml").write_text(changed(old, new), encoding="utf-8")
        return "arm.toml"

    return write
