"""A function in a process of its own, with limits of its time and memory: for readers of foreign files.

A library that parses the bytes of somebody else may loop, ask for all memory, or end the process. There
it may: the function returns arrays by name, which come back as bytes; or its failure is an error here.

A function in a process that computes the same bits on every processor of one kind (x86-64, ARM).

Libraries of linear algebra choose kernels by the processor, and their sums then differ in the last bit.
For most results this is rounding. A search that follows Newton's method from far away is different: a
last bit leads to another path, and another path to another order. So it runs in a process of its own, in
which the libraries of numbers are told to use what every processor of this kind has: OpenBLAS one
kernel, MKL its compatible branch, numpy no instructions beyond its baseline, and the C library no fused
products.

One process is started when it is needed first, and kept; it ends with this one.

Worker processes of this machine; a worker that dies is replaced, and its task computed again.

A worker is a module that reads numbers of tasks from its input, one a line, and answers each with one
line of JSON when its result is in a file of the folder.

The content of files of other people: read with a limit, from files only.
"""

import atexit
import contextlib
import io
import json
import os
import pickle
import platform
import queue
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from importlib import import_module
from pathlib import Path
from threading import Lock
from types import TracebackType
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from mbdlft.base import errors, running
from mbdlft.base.errors import AnalysisError, MbdlftError

_CLOCK, _START = (
    10.0,
    60.0,
)  # times the seconds of the processor, and s: the machine may have other work


def arrays_of(
    target: str, arguments: dict[str, Any], *, seconds: int, memory: int, error: type[MbdlftError]
) -> dict[str, NDArray[Any]]:
    """What a function returns in another process: arrays by name.

    Parameters
    ----------
    target : str
        ``module:function``; the function takes the arguments by name.
    arguments : plain data
    seconds : time of the processor
    memory : bytes

    Raises
    ------
    MbdlftError of the class `error`
        The function raised any error, or did not end within its limits.
    """
    limits = {"seconds": seconds, "memory": memory}
    try:
        done = subprocess.run(
            [sys.executable, "-P", "-m", "mbdlft.base.worker", "once"],
            input=json.dumps({"target": target, "arguments": arguments, **limits}).encode(),
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            timeout=_START + _CLOCK * seconds,
            env={**os.environ, "PYTHONPATH": search_path(), "OPENBLAS_NUM_THREADS": "1"},
            check=False,
        )
    except (OSError, TypeError) as failure:
        raise error(
            f"cannot be read: the process that reads it does not start: {failure}."
        ) from None
    except subprocess.TimeoutExpired:
        raise error(_ended("it did not end", seconds, memory)) from None
    kind, body = done.stdout[:1], done.stdout[1:]
    if kind == b"e":
        raise error(body.decode("utf-8", "replace"))
    if kind != b"a" or done.returncode:
        raise error(_ended(f"exit code {done.returncode}", seconds, memory))
    with np.load(io.BytesIO(body), allow_pickle=False) as found:
        return dict(found)


def search_path() -> str:
    """`PYTHONPATH` for a process that imports this package as this one does."""
    root = str(Path(__file__).parents[2])
    return os.pathsep.join([root, *filter(None, [os.environ.get("PYTHONPATH")])])


def _ended(how: str, seconds: int, memory: int) -> str:
    return (
        f"cannot be read: its reader did not end as it should ({how}), with {seconds} s of the processor "
        f"and {memory // 2**20} MB of memory. Is the file damaged?"
    )


def limit_process(seconds: float, memory: int, *, for_good: bool) -> None:
    """Limit what this process may use from now on, where the system can; it leaves no image when it dies.

    `seconds` are of the processor, `memory` is in bytes. Limits that are not `for_good` can be changed.
    """
    try:
        import resource
    except ImportError:
        return
    used = resource.getrusage(resource.RUSAGE_SELF)
    limits = {resource.RLIMIT_CPU: int(used.ru_utime + used.ru_stime + seconds) + 1}
    with contextlib.suppress(OSError, ValueError, IndexError):
        pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
        limits[resource.RLIMIT_AS] = pages * os.sysconf("SC_PAGE_SIZE") + memory
    with contextlib.suppress(OSError, ValueError):
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    for what, most in limits.items():
        with contextlib.suppress(OSError, ValueError):
            last = most if for_good else resource.getrlimit(what)[1]
            resource.setrlimit(what, (most, last))


def end_process(process: "subprocess.Popen[bytes]") -> None:
    """End a process, and close the streams to and from it."""
    process.kill()
    for stream in (process.stdin, process.stdout):
        if stream is not None:
            with contextlib.suppress(OSError):
                stream.close()
    process.wait()


def answer_once() -> None:
    """Call the function that standard input names, and write what it returns to standard output."""
    asked = json.load(sys.stdin)
    output = sys.stdout.buffer
    sys.stdout = sys.stderr  # libraries may print
    module, _, name = asked["target"].partition(":")
    function = getattr(import_module(module), name)
    limit_process(asked["seconds"], asked["memory"], for_good=True)
    try:
        image = io.BytesIO()
        np.savez(image, **function(**asked["arguments"]))
    except MbdlftError as error:
        output.write(b"e" + str(error).encode("utf-8", "replace"))
    except Exception as error:  # readers raise what they like
        text = f"cannot be read: {str(error) or type(error).__name__}"
        output.write(b"e" + text.encode("utf-8", "replace"))
    else:
        output.write(b"a" + image.getvalue())
    output.flush()


_KERNELS = {"x86_64": "Prescott", "amd64": "Prescott", "aarch64": "ARMV8", "arm64": "ARMV8"}
_OFTEN = 0.2  # s
_LENGTH = struct.Struct("<Q")  # bytes of the message that follows


class NoProcessError(OSError):
    """There is no such process here: no Python to start, or it ended before it had answered."""


def same_everywhere(target: str, *arguments: Any) -> Any:
    """What a function returns in a process with the same arithmetic on every processor of one kind.

    Parameters
    ----------
    target : str
        ``module:function`` of this package.
    arguments
        What `pickle` can carry, as the result.

    Raises
    ------
    NoProcessError
    Exception
        What the function raises.
    """
    with _LOCKS.setdefault(os.getpid(), Lock()):
        was_there = os.getpid() in _PROCESSES
        try:
            is_result, answer = _answer(target, arguments)
        except NoProcessError:
            if not was_there:
                raise
            is_result, answer = _answer(target, arguments)  # it may have ended since the last call
    if not is_result:
        raise answer
    return answer


# by this process: a fork begins without them
_LOCKS: dict[int, Lock] = {}
_PROCESSES: dict[int, "subprocess.Popen[bytes]"] = {}


def _answer(target: str, arguments: tuple[Any, ...]) -> tuple[bool, Any]:
    """Whether the function returned, and what it returned or raised."""
    process = _process()
    assert process.stdin is not None
    assert process.stdout is not None
    try:
        _send(process.stdin, (target, arguments))
        is_result, answer = _receive(process.stdout)
        while is_result is None:  # how much is done, in between
            running.pass_on(*answer)
            is_result, answer = _receive(process.stdout)
    except (OSError, EOFError) as error:
        _end(process)
        raise NoProcessError(f"the process that computes {target} ended: {error}") from None
    except BaseException:  # Ctrl-C: the next call starts another one
        _end(process)
        raise
    return is_result, answer


def _process() -> "subprocess.Popen[bytes]":
    own = os.getpid()
    process = _PROCESSES.get(own)
    if process is not None and process.poll() is None:
        return process
    if getattr(sys, "frozen", False) or not Path(sys.executable or "").stem.startswith("py"):
        raise NoProcessError(f"{sys.executable!r} is not an interpreter of Python")
    try:
        process = subprocess.Popen(
            [sys.executable, "-P", "-W", "ignore", "-m", "mbdlft.base.worker", "calls"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env={**os.environ, **settings(), "PYTHONPATH": search_path()},
            start_new_session=True,  # Ctrl-C in a terminal is for this process alone
        )
    except OSError as error:
        raise NoProcessError(str(error)) from None
    _PROCESSES[own] = process
    atexit.register(_end, process)
    return process


def settings() -> dict[str, str]:
    """Variables of the environment that choose the arithmetic of the libraries of numbers."""
    chosen = {
        "OPENBLAS_NUM_THREADS": "1",
        "OMP_NUM_THREADS": "1",
        "MKL_NUM_THREADS": "1",
        "MKL_CBWR": "COMPATIBLE",
        "GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX2,-FMA,-FMA4",
    }
    umath = getattr(getattr(np, "_core", None), "_multiarray_umath", None)
    dispatched = getattr(umath, "__cpu_dispatch__", ())
    if dispatched:
        chosen["NPY_DISABLE_CPU_FEATURES"] = " ".join(dispatched)
    kernel = _KERNELS.get(platform.machine().lower())
    if kernel:
        chosen["OPENBLAS_CORETYPE"] = kernel
    return chosen


def _end(process: "subprocess.Popen[bytes]") -> None:
    """End a process of this one; a fork that ends leaves it alone."""
    if _PROCESSES.get(os.getpid()) is not process:
        return
    del _PROCESSES[os.getpid()]
    end_process(process)


def _send(stream: IO[bytes], message: Any) -> None:
    image = pickle.dumps(message, protocol=pickle.HIGHEST_PROTOCOL)
    stream.write(_LENGTH.pack(len(image)))
    stream.write(image)
    stream.flush()


def _receive(stream: IO[bytes]) -> Any:
    head = stream.read(_LENGTH.size)
    if len(head) < _LENGTH.size:
        raise EOFError("no answer")
    (length,) = _LENGTH.unpack(head)
    image = stream.read(length)
    if len(image) < length:
        raise EOFError("half an answer")
    return pickle.loads(image)


class _Telling:
    """It tells the other process how much of a budget is done, not too often."""

    def __init__(self, answers: IO[bytes]) -> None:
        self.answers, self.last = answers, 0.0

    def __call__(self, done: float, most: float) -> None:
        if time.monotonic() > self.last + _OFTEN:
            self.last = time.monotonic()
            _send(self.answers, (None, (done, most)))


def answer_calls() -> None:
    """Answer calls of standard input on standard output, until there are no more."""
    calls, answers = sys.stdin.buffer, sys.stdout.buffer
    sys.stdout = io.StringIO()  # libraries may print
    while True:
        try:
            target, arguments = _receive(calls)
        except EOFError:
            return
        module, _, name = target.partition(":")
        try:
            with running.heard(_Telling(answers)):
                answer = True, getattr(import_module(module), name)(*arguments)
        except Exception as error:  # it is raised where it was asked for
            answer = False, error
        _send(answers, answer)


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


LARGEST = 2**26  # bytes of a text; robots and scenes have a thousandth


def content_of(file: Path, error: type[MbdlftError], largest: int = LARGEST) -> bytes:
    """The bytes of a file.

    Raises
    ------
    MbdlftError of the class `error`
        The file cannot be read, is not a regular file, or has more than `largest` bytes.
    """
    try:
        if file.exists() and not (file.is_file() or file.is_dir()):
            raise error(f"{file}: cannot be read: it is not a regular file.")
        with file.open("rb") as stream:
            size = os.fstat(stream.fileno()).st_size
            found = stream.read(size) if size <= largest else b""
    except MbdlftError:
        raise
    except (OSError, ValueError) as failure:
        reason = getattr(failure, "strerror", None) or failure
        raise error(f"{file}: cannot be read: {reason}.") from None
    if size > largest:
        raise error(f"{file}: has more than {largest} bytes, expected a smaller file.")
    return found


if __name__ == "__main__":
    {"once": answer_once, "calls": answer_calls}[sys.argv[1]]()
