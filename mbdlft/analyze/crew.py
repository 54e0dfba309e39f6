"""Who does the work of a search: this process."""

from collections.abc import Callable, Sequence
from typing import Any


class Crew:
    """Applies functions to tasks, in this process."""

    def map(self, function: Callable[..., Any], tasks: Sequence[tuple[Any, ...]]) -> list[Any]:
        """Results in the order of the tasks."""
        return [function(*task) for task in tasks]
