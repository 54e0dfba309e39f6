"""Commands as a shell runs them, in this process."""

import sys
from collections.abc import Callable

import pytest

from mbdlft.cli.commands import main

Call = Callable[..., tuple[int, str, str]]  # exit code, output, errors
Output = Callable[..., str]


def run(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], *arguments: str
) -> tuple[int, str, str]:
    monkeypatch.setattr(sys, "argv", ["mbdlft", *arguments])
    code = 0
    try:
        main()
    except SystemExit as stop:
        code = int(stop.code or 0)
    captured = capsys.readouterr()
    return code, captured.out, captured.err
