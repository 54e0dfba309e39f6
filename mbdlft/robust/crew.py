"""Who does the work of a search: this process, processes of this machine, or a Dask cluster.

A search gives its tasks in batches that do not depend on who computes them, and gets results in the
order of the tasks. So its answer does not, either. A worker process runs this module: it reads numbers of
tasks from its input, one a line, and answers each line when the result is in its file. It ends when its
input ends, so that no process stays when the analysis is killed.
"""

import contextlib
import json
import os
import pickle
import signal
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from importlib import import_module
from pathlib import Path
from typing import Any

from mbdlft.base.errors import AnalysisError, MbdlftError
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
        self.workers, self.stack, self.count = workers, stack, 0
        self.folder: Path | None = None
        self.pool: Pool | None = None

    def map(self, function: Callable[..., Any], tasks: Sequence[Task]) -> list[Any]:
        if len(tasks) < 2:
            return super().map(function, tasks)
        if self.folder is None or self.pool is None:
            self.folder = Path(self.stack.enter_context(tempfile.TemporaryDirectory()))
            what = "the analysis", "part of the box", "Take fewer workers."
            pool = Pool("mbdlft.robust.crew", self.folder, self.workers, what)
            self.pool = self.stack.enter_context(pool)
        numbers = range(self.count, self.count + len(tasks))
        self.count += len(tasks)
        for number, task in zip(numbers, tasks, strict=True):
            task_file(self.folder, number).write_bytes(pickle.dumps((function, task)))
        for _ in self.pool.run(numbers):
            pass
        return [pickle.loads(result_file(self.folder, k).read_bytes()) for k in numbers]


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


def task_file(folder: Path, number: int) -> Path:
    """The file of a task."""
    return folder / f"task-{number}"


def result_file(folder: Path, number: int) -> Path:
    """The file of its result."""
    return folder / f"result-{number}"


@contextmanager
def crew_of(workers: int | None, client: Any, what: str) -> Iterator[Crew]:
    """Those who do the work: `with crew_of(...) as crew`.

    Raises
    ------
    AnalysisError
        The number of workers is no number above 0, or Dask is not installed.
    """
    if client is not None:
        try:
            import_module("distributed")  # an optional extra
        except ImportError:
            raise AnalysisError(
                f"{what}: a cluster needs Dask: pip install 'mbdlft[cluster]'."
            ) from None
        yield _Cluster(client)
        return
    if workers is not None and (isinstance(workers, bool) or not workers >= 1):
        raise AnalysisError(f"{what}: expected at least 1 worker, got {workers}.")
    # some systems do not tell which cores this process may use
    allowed = os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else ()
    count = workers or len(allowed) or os.cpu_count() or 1
    with ExitStack() as stack:
        yield _Processes(count, stack) if count > 1 else ALONE


def main(folder: Path) -> None:
    """Compute tasks until the input ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the search, which then ends this
    for line in sys.stdin:
        number = int(line)
        file = result_file(folder, number)
        try:
            function, task = pickle.loads(task_file(folder, number).read_bytes())
            beside = file.with_suffix(".part")
            beside.write_bytes(pickle.dumps(alone(function, task)))
            beside.replace(file)
            answer: dict[str, object] = {"task": number}
        except MbdlftError as error:
            answer = {"error": type(error).__name__, "message": str(error)}
        except FileNotFoundError:  # the analysis has ended
            return
        with contextlib.suppress(BrokenPipeError):
            sys.stdout.write(json.dumps(answer) + "\n")
            sys.stdout.flush()


if __name__ == "__main__":
    main(Path(sys.argv[1]))
