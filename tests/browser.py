"""The browser that tests drive; where there is none they are skipped."""

import functools
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest

from benchmarks.cases import browser as found
from benchmarks.cases.browser import Loaded as Loaded

SIZE = 650, 400  # pixels: software draws them, and pages of twice the width take twice the time


@functools.cache
def chromium() -> str:
    """The program; the test that asks for it is skipped where there is none."""
    pytest.importorskip("playwright", reason="playwright is not installed")
    program = found.chromium()
    if program is None:
        pytest.skip("there is no Chromium; .ci/run installs it")
    return program


@contextmanager
def browser() -> Iterator[Any]:
    """A function that loads a file as a `Loaded` page; more options start a browser of its own."""
    with found.browser(chromium(), SIZE) as load:
        yield load
