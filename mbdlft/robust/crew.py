"""Who does the work of a search: this process, processes of this machine, or a Dask cluster.

A search gives its tasks in batches that do not depend on who computes them, and gets results in the
order of the tasks. So its answer does not, either.
"""

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from importlib import import_module
from typing import Any

from mbdlft.base.errors import AnalysisError
from mbdlft.base.running import one_thread
from mbdlft.base.worker import Pool

Task = tuple[Any, ...]


class Crew:
    """Applies functions to tasks, in this process."""

    def map(self, function: Callable[..., Any], tasks: Sequence[Task]) -> list[Any]:
        """Results in the order of the tasks."""
        return [function(*task) for task in tasks]


ALONE = Crew()


class _Processes(Crew):
    """Processes of this machine, which are started when there are two tasks at a time."""

    def __init__(self, workers: int, stack: ExitStack) -> None:
        self.workers, self.stack = workers, stack
        self.pool: Pool | None = None

    def map(self, function: Callable[..., Any], tasks: Sequence[Task]) -> list[Any]:
        if len(tasks) < 2:
            return super().map(function, tasks)
        if self.pool is None:
            what = "the analysis", "part of the box", "Take fewer workers."
            pool = Pool(f"{__name__}:alone", self.workers, what)
            self.pool = self.stack.enter_context(pool)
        results = dict(self.pool.run({k: (function, task) for k, task in enumerate(tasks)}))
        return [results[k] for k in range(len(tasks))]


class _Cluster(Crew):
    """A Dask cluster."""

    def __init__(self, client: Any) -> None:
        self.client = client

    def map(self, function: Callable[..., Any], tasks: Sequence[Task]) -> list[Any]:
        futures = [self.client.submit(alone, function, task, pure=False) for task in tasks]
        return list(self.client.gather(futures))


def alone(function: Callable[..., Any], task: Task) -> Any:
    """What a worker does."""
    with one_thread():
        return function(*task)


@contextmanager
def crew_of(workers: int | None, client: Any, what: str) -> Iterator[Crew]:
    """Those who do the work: `with crew_of(...) as crew`."""
    if client is not None:
        try:
            import_module("distributed")  # an optional extra
        except ImportError:
            raise AnalysisError(f"{what}: a cluster needs Dask: pip install 'mbdlft[cluster]'.") from None
        yield _Cluster(client)
        return
    if workers is not None and (isinstance(workers, bool) or not workers >= 1):
        raise AnalysisError(f"{what}: expected at least 1 worker, got {workers}.")
    # some systems do not tell which cores this process may use
    allowed = os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else ()
    count = workers or len(allowed) or os.cpu_count() or 1
    with ExitStack() as stack:
        yield _Processes(count, stack) if count > 1 else ALONE
