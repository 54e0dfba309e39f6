"""Two profiles of random testing: fast is repeatable and is the default, deep is for the night.

No test reads or leaves native code in the folder of the user.
"""

import os
from typing import Any

import pytest
from hypothesis import HealthCheck, settings

from mbdlft.base.worker import NoProcessError
from mbdlft.pipeline import stages

os.environ["MBDLFT_CACHE"] = ""

settings.register_profile(
    "fast",
    max_examples=25,
    derandomize=True,
    deadline=None,
    suppress_health_check=[HealthCheck.too_slow],
)
settings.register_profile("deep", max_examples=500, deadline=None, print_blob=True)
settings.load_profile(os.environ.get("MBDLFT_HYPOTHESIS", "fast"))


@pytest.fixture
def search_here(monkeypatch: pytest.MonkeyPatch) -> None:
    """A search in this process, where a bug can be planted."""

    def nowhere(*_: Any) -> None:
        raise NoProcessError

    monkeypatch.setattr(stages, "same_everywhere", nowhere)
