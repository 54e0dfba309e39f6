"""One browser for all tests of pages; what a test has opened is closed at its end."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.browser import Loaded, browser


@pytest.fixture(scope="package")
def running() -> Iterator[Callable[..., Loaded]]:
    with browser() as load:
        yield load


@pytest.fixture
def load(running: Callable[..., Loaded]) -> Iterator[Callable[..., Loaded]]:
    """A function that loads a file; pages that stay open are drawn on and on."""
    pages: list[Any] = []

    def opened(file: Path, *more: str) -> Loaded:
        loaded = running(file, *more)
        pages.append(loaded.page)
        return loaded

    yield opened
    for page in pages:
        page.close()
