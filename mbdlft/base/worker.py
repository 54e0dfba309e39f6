"""Functions in processes of their own, for two reasons.

- A library that parses the bytes of somebody else may loop, ask for all memory, or end its process. There
  it may: `arrays_of` calls it in a process with limits of its time and memory, from which only arrays by
  name and the text of an error come back, as bytes. (A pickle could do what it likes here.)
- A machine has several cores: `Pool` gives them tasks; a process that dies is replaced, and its task
  computed again.

A process runs this module, reads calls from its input, and ends when its input ends.
"""

import atexit
import contextlib
import json
import os
import pickle
import queue
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor, as_completed
from importlib import import_module
from pathlib import Path
from typing import IO, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbdlft.base.errors import AnalysisError, MbdlftError
from mbdlft.base.running import heard, pass_on

LARGEST = 2**26  # bytes of a text; robots and scenes have a thousandth
_SINGLE = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}
_OFTEN = 0.2  # s between two messages on progress
_CLOCK = 10.0  # times the seconds of the processor: the machine may have other work
_START = 60.0  # s, to start Python and import libraries on a busy machine
_DEATHS = 3  # processes that may die over one task before the work stops
_LENGTH = struct.Struct("<Q")  # bytes of the message that follows


def cores() -> int:
    """Cores that this process may use; some systems do not tell which, and it is all of them."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def processes_of(workers: Any, what: str) -> int:
    """So many processes as a caller of `what` asks for; without a number, one for each core."""
    is_count = isinstance(workers, int | np.integer) and not isinstance(workers, bool) and workers >= 1
    if workers is not None and not is_count:
        raise AnalysisError(f"{what}: expected at least 1 worker, got {workers!r}.")
    return cores() if workers is None else int(workers)


class Limits(NamedTuple):
    """What a call may use: seconds of the processor, bytes of memory, seconds of the clock.

    The first two count from when the `libraries` are imported, which takes seconds on a new machine.
    """

    seconds: float
    memory: int
    clock: float
    libraries: tuple[str, ...] = ()


class NoProcessError(OSError):
    """There is no such process here: no Python to start, or it ended before it had answered."""


class EndedError(NoProcessError):
    """A process ended before it had answered; `how` says how."""

    def __init__(self, target: str, how: str) -> None:
        super().__init__(f"the process that computes {target} ended: {how}")
        self.how = how


class Worker:
    """A process that calls functions: the first call starts it; when it has ended, the next one.

    `environment` are variables beside those of this process. A `plain` one returns arrays by name as
    bytes, and errors as texts; of a `quiet` one nobody sees what it prints.
    """

    def __init__(
        self, environment: Mapping[str, str], *, plain: bool = False, quiet: bool = True
    ) -> None:
        self._environment, self._plain, self._quiet = dict(environment), plain, quiet
        # by the process that has them: a fork begins without
        self._locks: dict[int, threading.Lock] = {}
        self._processes: dict[int, subprocess.Popen[bytes]] = {}
        self._is_stopped = False

    @property
    def process(self) -> "subprocess.Popen[bytes] | None":
        """The process, if it runs."""
        process = self._processes.get(os.getpid())
        return process if process is not None and process.poll() is None else None

    def call(self, target: str, /, *arguments: Any, limits: Limits | None = None, **named: Any) -> Any:
        """What the function `target`, as ``module:function``, returns for these arguments."""
        with self._locks.setdefault(os.getpid(), threading.Lock()):
            process = self.process or self._start()
            assert process.stdin is not None
            assert process.stdout is not None
            receive = _receive_arrays if self._plain else lambda stream: pickle.loads(_receive(stream))
            try:
                with _killed_after(process, limits.clock if limits else 0.0) as late:
                    _send(
                        process.stdin, pickle.dumps((target, arguments, named, limits and tuple(limits)))
                    )
                    kind, answer = receive(process.stdout)
                    while kind == "done so far":
                        pass_on(*answer)
                        kind, answer = receive(process.stdout)
            except (OSError, EOFError):
                self.end()
                how = "it did not end" if late.is_set() else f"exit code {process.returncode}"
                raise EndedError(target, how) from None
            except BaseException:  # Ctrl-C: the next call starts another process
                self.end()
                raise
        if kind == "error":
            raise answer
        return answer

    def _start(self) -> "subprocess.Popen[bytes]":
        """Start a process; -P keeps the files of the folder from being imported as modules."""
        self.end()
        if getattr(sys, "frozen", False) or not Path(sys.executable or "").stem.startswith("py"):
            raise NoProcessError(f"{sys.executable!r} is not an interpreter of Python")
        search_path = [str(Path(__file__).parents[2]), *filter(None, [os.environ.get("PYTHONPATH")])]
        known = {"PYTHONPATH": os.pathsep.join(search_path), **_SINGLE, **self._environment}
        kind = "plain" if self._plain else "pickled"
        try:
            process = subprocess.Popen(
                [sys.executable, "-P", "-m", "mbdlft.base.worker", kind],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL if self._quiet else None,
                env={**os.environ, **known},
                start_new_session=True,  # Ctrl-C in a terminal is for this process alone
            )
        except OSError as error:
            raise NoProcessError(str(error)) from None
        self._processes[os.getpid()] = process
        if self._is_stopped:
            process.kill()
        atexit.register(self.end)
        return process

    def stop(self) -> None:
        """End the process that another thread waits for, and each that it starts later."""
        self._is_stopped = True
        if (process := self.process) is not None:
            process.kill()

    def end(self) -> None:
        """End the process of this one, if there is one; a fork leaves that of its parent alone."""
        process = self._processes.pop(os.getpid(), None)
        atexit.unregister(self.end)
        if process is None:
            return
        process.kill()
        for stream in (process.stdin, process.stdout):
            if stream is not None:
                with contextlib.suppress(OSError):
                    stream.close()
        process.wait()


@contextlib.contextmanager
def _killed_after(process: "subprocess.Popen[bytes]", seconds: float) -> Iterator[threading.Event]:
    """In this context a process is killed after some seconds, if not 0; the event says if it was."""
    late = threading.Event()

    def kill() -> None:
        late.set()
        process.kill()

    timer = threading.Timer(seconds, kill)
    timer.daemon = True
    if seconds > 0.0:
        timer.start()
    try:
        yield late
    finally:
        timer.cancel()


def arrays_of(
    target: str,
    arguments: dict[str, Any],
    *,
    seconds: int,
    memory: int,
    error: type[MbdlftError],
    libraries: tuple[str, ...] = (),
) -> dict[str, NDArray[Any]]:
    """The arrays by name that a function returns, in a process with limits that ends afterwards.

    `target` is ``module:function``, `seconds` are of the processor, and `memory` is in bytes; both
    count from when the `libraries` that the function needs are imported. If it raises any error, or
    does not end within its limits, that is an `error`.
    """
    reader = Worker({}, plain=True)
    limits = Limits(seconds, memory, _START + _CLOCK * seconds, libraries)
    try:
        arrays: dict[str, NDArray[Any]] = reader.call(target, limits=limits, **arguments)
    except EndedError as failure:
        raise error(
            f"cannot be read: its reader did not end as it should ({failure.how}), with {seconds} s of "
            f"the processor and {memory // 2**20} MB of memory. Is the file damaged?"
        ) from None
    except NoProcessError as failure:
        raise error(f"cannot be read: the process that reads it does not start: {failure}.") from None
    except MbdlftError as failure:
        raise error(str(failure)) from None
    finally:
        reader.end()
    return arrays


class Pool:
    """Processes that call the function `target`, ``module:function``: `with Pool(...) as pool`.

    `what` is for messages: the work, what a task is, and what to do when workers die.
    """

    def __init__(self, target: str, workers: int, what: tuple[str, str, str]) -> None:
        self.target, self.what = target, what
        self._stop = threading.Event()
        # modules that this process can import, such as that of a user's function
        path = os.pathsep.join(entry or str(Path.cwd()) for entry in sys.path)
        self._workers = [Worker({"PYTHONPATH": path}, quiet=False) for _ in range(workers)]
        self._idle = queue.SimpleQueue[Worker]()
        self._threads = ThreadPoolExecutor(workers)

    def __enter__(self) -> "Pool":
        for worker in self._workers:
            self._idle.put(worker)
        return self

    def __exit__(self, *error: object) -> None:
        self._stop.set()
        for worker in self._workers:
            worker.stop()
        self._threads.shutdown(cancel_futures=True)
        for worker in self._workers:
            worker.end()

    def run(self, tasks: Mapping[int, tuple[Any, ...]]) -> Iterator[tuple[int, Any]]:
        """Yield number and result of each task, given by its arguments, as soon as it is finished."""
        for future in as_completed(self._threads.submit(self._answer, *task) for task in tasks.items()):
            yield future.result()

    def _answer(self, number: int, arguments: tuple[Any, ...]) -> tuple[int, Any]:
        """The number and the result of a task, computed by the next worker that is idle."""
        (work, unit, advice), how = self.what, ""
        worker = self._idle.get()
        try:
            for _ in range(_DEATHS):
                try:
                    return number, worker.call(self.target, *arguments)
                except (EndedError, MemoryError) as error:
                    how = getattr(error, "how", "no memory")
                    worker.end()
                if self._stop.is_set():
                    break
        except NoProcessError as error:
            raise AnalysisError(f"{work}: no worker starts: {error}.") from None
        finally:
            self._idle.put(worker)
        raise AnalysisError(
            f"{work}: {_DEATHS} workers died over {unit} {number} ({how}). Was there too little "
            f"memory? {advice}"
        )


def _send(stream: IO[bytes], message: bytes) -> None:
    stream.write(_LENGTH.pack(len(message)))
    stream.write(message)
    stream.flush()


def _receive(stream: IO[bytes]) -> bytes:
    """A message, or an EOFError if the stream ends before it does."""
    head = stream.read(_LENGTH.size)
    if len(head) < _LENGTH.size:
        raise EOFError("no message")
    (length,) = _LENGTH.unpack(head)
    message = stream.read(length)
    if len(message) < length:
        raise EOFError("half a message")
    return message


def _send_arrays(stream: IO[bytes], kind: str, answer: Any) -> None:
    """Send an error as a text, or arrays as names, types, shapes, and then their bytes."""
    if kind == "error":
        text = str(answer) or type(answer).__name__
        text = text if isinstance(answer, MbdlftError) else f"cannot be read: {text}"
        _send(stream, json.dumps({"error": text}).encode())
        return
    arrays = {name: np.asarray(array) for name, array in answer.items()}
    heads = [[name, array.dtype.str, list(array.shape)] for name, array in arrays.items()]
    _send(stream, json.dumps({"arrays": heads}).encode())
    for array in arrays.values():
        stream.write(array.tobytes())
    stream.flush()


def _receive_arrays(stream: IO[bytes]) -> tuple[str, Any]:
    """What `_send_arrays` has sent, or an EOFError: the bytes may be any."""
    try:
        head = json.loads(_receive(stream))
        if "error" in head:
            return "error", MbdlftError(head["error"])
        arrays = {}
        for name, dtype, shape in head["arrays"]:
            size = int(np.prod([np.dtype(dtype).itemsize, *shape], dtype=object))
            arrays[name] = np.frombuffer(bytearray(stream.read(size)), dtype).reshape(shape)
        return "result", arrays
    except (ValueError, TypeError, KeyError) as error:
        raise EOFError(str(error)) from None


def _teller(answers: IO[bytes]) -> Callable[[float, float], None]:
    """A function that tells whoever asked how much of a budget is done, not too often."""
    last = 0.0

    def tell(done: float, most: float) -> None:
        nonlocal last
        if time.monotonic() > last + _OFTEN:
            last = time.monotonic()
            _send(answers, pickle.dumps(("done so far", (done, most))))

    return tell


def limit_process(seconds: float, memory: int) -> None:
    """Limit what this process may use from now on, where the system can; it leaves no image when it dies.

    `seconds` are of the processor, `memory` is in bytes.
    """
    try:
        import resource
    except ImportError:  # Windows
        return
    used = resource.getrusage(resource.RUSAGE_SELF)
    limits = {resource.RLIMIT_CPU: int(used.ru_utime + used.ru_stime + seconds) + 1}
    with contextlib.suppress(OSError, ValueError, IndexError):
        pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
        limits[resource.RLIMIT_AS] = pages * os.sysconf("SC_PAGE_SIZE") + memory
    for what, most in {**limits, resource.RLIMIT_CORE: 0}.items():
        with contextlib.suppress(OSError, ValueError):
            resource.setrlimit(what, (most, resource.getrlimit(what)[1] if most else 0))


def serve(*, plain: bool) -> None:
    """Answer calls of standard input on standard output, until there are no more."""
    calls, answers = sys.stdin.buffer, sys.stdout.buffer
    sys.stdout = sys.stderr  # libraries may print
    while True:
        try:
            target, arguments, named, limits = pickle.loads(_receive(calls))
        except EOFError:
            return
        module, _, name = target.partition(":")
        listening = contextlib.nullcontext() if plain else heard(_teller(answers))
        try:
            function = getattr(import_module(module), name)
            if limits is not None:
                seconds, memory, _, libraries = limits
                for library in libraries:
                    import_module(library)
                limit_process(seconds, memory)
            with listening:
                kind, answer = "result", function(*arguments, **named)
        except Exception as error:  # it is raised where it was asked for
            kind, answer = "error", error
        with contextlib.suppress(BrokenPipeError):  # whoever asked has ended
            if plain:
                _send_arrays(answers, kind, answer)
            else:
                _send(answers, pickle.dumps((kind, answer)))


def content_of(file: Path, error: type[MbdlftError], largest: int = LARGEST) -> bytes:
    """The bytes of a file of somebody else.

    If it cannot be read, is not a regular file, or has more than `largest` bytes, that is an `error`.
    """
    try:
        if file.exists() and not (file.is_file() or file.is_dir()):
            raise error(f"{file}: cannot be read: it is not a regular file.")
        with file.open("rb") as stream:
            size = os.fstat(stream.fileno()).st_size
            content = stream.read(size) if size <= largest else b""
    except MbdlftError:
        raise
    except (OSError, ValueError) as failure:
        reason = getattr(failure, "strerror", None) or failure
        raise error(f"{file}: cannot be read: {reason}.") from None
    if size > largest:
        raise error(f"{file}: has more than {largest} bytes, expected a smaller file.")
    return content


if __name__ == "__main__":
    serve(plain=sys.argv[1] == "plain")
