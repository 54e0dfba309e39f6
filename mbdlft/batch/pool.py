"""Worker processes of this machine; a worker that dies is replaced, and its shard computed again."""

import contextlib
import json
import os
import queue
import subprocess
import sys
import threading
from collections import deque
from collections.abc import Iterator, Sequence
from pathlib import Path

from mbdlft.base import errors
from mbdlft.base.errors import AnalysisError

_DEATHS = 3  # workers that may die over one shard before the sweep stops


def finished_shards(folder: Path, shards: Sequence[int], workers: int) -> Iterator[int]:
    """Have worker processes compute shards; yield each shard as soon as it is finished.

    Raises
    ------
    AnalysisError
        Workers died again and again over one shard.
    MbdlftError
        A worker raised this error.
    """
    todo, answers = deque(shards), queue.SimpleQueue[int | Exception]()
    running: list[subprocess.Popen[str]] = []
    stop = threading.Event()
    threads = [
        threading.Thread(target=_drive, args=(folder, todo, answers, running, stop), daemon=True)
        for _ in range(min(workers, len(shards)))
    ]
    try:
        for thread in threads:
            thread.start()
        for _ in shards:
            answer = answers.get()
            if isinstance(answer, Exception):
                raise answer
            yield answer
    finally:
        stop.set()
        for process in list(running):
            process.kill()
        for thread in threads:
            thread.join()


def _drive(
    folder: Path,
    todo: deque[int],
    answers: "queue.SimpleQueue[int | Exception]",
    running: list[subprocess.Popen[str]],
    stop: threading.Event,
) -> None:
    """Run one worker process until all shards are computed; start another one whenever it dies.

    `todo` are the shards that nobody has taken; finished shards, or an error, are put into `answers`.
    """
    deaths: dict[int, int] = {}
    died: int | None = None
    while not stop.is_set():
        if not todo:
            return
        # if the worker was killed, closing the pipe to it raises an error
        with contextlib.suppress(BrokenPipeError), _start(folder) as process:
            running.append(process)
            try:
                died = _serve(process, todo, answers, stop)
            finally:
                running.remove(process)
                process.kill()
        if died is not None and not stop.is_set():
            deaths[died] = deaths.get(died, 0) + 1
            if deaths[died] >= _DEATHS:
                answers.put(
                    AnalysisError(
                        f"sweep: {_DEATHS} workers died over shard {died} (exit code "
                        f"{process.returncode}). Was there too little memory? What is finished is kept: "
                        "the same sweep goes on from it, with fewer workers if you like."
                    )
                )
                return
            todo.appendleft(died)


def _serve(
    process: subprocess.Popen[str],
    todo: deque[int],
    answers: "queue.SimpleQueue[int | Exception]",
    stop: threading.Event,
) -> int | None:
    """Give shards to a worker, one at a time; return the shard over which it died, or None."""
    assert process.stdin is not None
    assert process.stdout is not None
    while not stop.is_set():
        try:
            shard = todo.popleft()
        except IndexError:
            return None
        try:
            process.stdin.write(f"{shard}\n")
            process.stdin.flush()
            line = process.stdout.readline()
        except OSError:
            return shard
        if not line.endswith("\n"):
            return shard
        answer = json.loads(line)
        if "error" in answer:
            answers.put(getattr(errors, answer["error"])(answer["message"]))
            stop.set()
            return None
        answers.put(shard)
    return None


def _start(folder: Path) -> subprocess.Popen[str]:
    """Start a worker process for the sweep in this folder."""
    # each worker has one core; several threads of linear algebra would wait for each other
    single = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}
    # modules that this process can import, such as that of a user's function
    found = {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    return subprocess.Popen(
        [sys.executable, "-m", "mbdlft.batch.worker", str(folder)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, **single, **found},
    )
