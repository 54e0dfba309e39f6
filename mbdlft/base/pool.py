"""Worker processes of this machine; a worker that dies is replaced, and its task computed again.

A worker is a module that reads numbers of tasks from its input, one a line, and answers each with one
line of JSON when its result is in a file of the folder.
"""

import contextlib
import json
import os
import queue
import subprocess
import sys
import threading
from collections.abc import Iterator, Sequence
from pathlib import Path
from types import TracebackType

from mbdlft.base import errors
from mbdlft.base.errors import AnalysisError

_DEATHS = 3  # workers that may die over one task before the work stops


class Pool:
    """Processes that run a module on tasks of a folder: `with Pool(...) as pool`.

    Parameters
    ----------
    module : str
    folder : Path
    workers : int
    what : tuple of str
        For messages: the work, what a task is, and what to do when workers die.
    """

    def __init__(self, module: str, folder: Path, workers: int, what: tuple[str, str, str]) -> None:
        self.module, self.folder, self.what = module, folder, what
        self.todo: queue.SimpleQueue[int | None] = queue.SimpleQueue()
        self.answers: queue.SimpleQueue[int | Exception] = queue.SimpleQueue()
        self.running: list[subprocess.Popen[str]] = []
        self.stop = threading.Event()
        self.threads = [threading.Thread(target=self._drive, daemon=True) for _ in range(workers)]

    def __enter__(self) -> "Pool":
        for thread in self.threads:
            thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.stop.set()
        for process in list(self.running):
            process.kill()
        for _ in self.threads:
            self.todo.put(None)
        for thread in self.threads:
            thread.join()

    def run(self, tasks: Sequence[int]) -> Iterator[int]:
        """Have tasks computed; yield each as soon as it is finished.

        Raises
        ------
        AnalysisError
            Workers died again and again over one task.
        MbdlftError
            A worker raised this error.
        """
        for task in tasks:
            self.todo.put(task)
        for _ in tasks:
            answer = self.answers.get()
            if isinstance(answer, Exception):
                raise answer
            yield answer

    def _drive(self) -> None:
        """Run one worker process until there are no tasks; start another one whenever it dies."""
        deaths: dict[int, int] = {}
        task = self.todo.get()
        while task is not None and not self.stop.is_set():
            code, died = None, task
            # if the worker was killed, closing the pipe to it raises an error
            with contextlib.suppress(BrokenPipeError), _start(self.module, self.folder) as process:
                self.running.append(process)
                try:
                    task = self._serve(process, task)
                finally:
                    self.running.remove(process)
                    process.kill()
                code = process.wait()
            if task is None or self.stop.is_set():
                return
            died = task
            deaths[died] = deaths.get(died, 0) + 1
            if deaths[died] >= _DEATHS:
                work, unit, advice = self.what
                self.answers.put(
                    AnalysisError(
                        f"{work}: {_DEATHS} workers died over {unit} {died} (exit code {code}). Was "
                        f"there too little memory? {advice}"
                    )
                )
                return

    def _serve(self, process: "subprocess.Popen[str]", task: int | None) -> int | None:
        """Give tasks to a worker, one at a time; return the task over which it died, or None."""
        assert process.stdin is not None
        assert process.stdout is not None
        while task is not None and not self.stop.is_set():
            try:
                process.stdin.write(f"{task}\n")
                process.stdin.flush()
                line = process.stdout.readline()
            except OSError:
                return task
            if not line.endswith("\n"):
                return task
            answer = json.loads(line)
            if "error" in answer:
                self.answers.put(getattr(errors, answer["error"])(answer["message"]))
                self.stop.set()
                return None
            self.answers.put(task)
            task = self.todo.get()
        return None


def _start(module: str, folder: Path) -> "subprocess.Popen[str]":
    """Start a worker process."""
    # each worker has one core; several threads of linear algebra would wait for each other
    single = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}
    # modules that this process can import, such as that of a user's function
    found = {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    return subprocess.Popen(
        [sys.executable, "-m", module, str(folder)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, **single, **found},
    )
