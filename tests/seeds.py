"""Seeds of a test: a few in the default run, and more of them in the long one."""

from collections.abc import Iterable, Sequence
from typing import Any

import pytest


def some(few: Sequence[Any], more: Iterable[Any]) -> list[Any]:
    """Parameters: `few`, and those of `more` that are not among them, marked as long."""
    rest = [seed if isinstance(seed, tuple) else (seed,) for seed in more if seed not in few]
    return [*few, *(pytest.param(*seed, marks=pytest.mark.long) for seed in rest)]
