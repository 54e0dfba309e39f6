"""Who does the work of a search: this process, processes of this machine, or a Dask cluster."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any


class Crew:
    """Applies functions to tasks, in this process."""

    def map(self, function: Callable[..., Any], tasks: Sequence[tuple[Any, ...]]) -> list[Any]:
        """Results in the order of the tasks."""
        return [function(*task) for task in tasks]


@contextmanager
def crew_of(workers: int, client: Any, what: str) -> Iterator[Crew]:
    """Those who do the work."""
    yield Crew()
