"""A function in a process that computes the same bits on every processor of one kind (x86-64, ARM).

Libraries of linear algebra choose kernels by the processor, and their sums then differ in the last bit.
For most results this is rounding. A search that follows Newton's method from far away is different: a
last bit leads to another path, and another path to another order. So it runs in a process of its own, in
which the libraries of numbers are told to use what every processor of this kind has: OpenBLAS one
kernel, MKL its compatible branch, numpy no instructions beyond its baseline, and the C library no fused
products.

One process is started when it is needed first, and kept; it ends with this one.
"""

import atexit
import io
import os
import pickle
import platform
import struct
import subprocess
import sys
from importlib import import_module
from pathlib import Path
from threading import Lock
from typing import IO, Any

import numpy as np

from mbdlft.base.apart import end_process, search_path

_KERNELS = {"x86_64": "Prescott", "amd64": "Prescott", "aarch64": "ARMV8", "arm64": "ARMV8"}
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
            [sys.executable, "-P", "-W", "ignore", "-m", "mbdlft.base.reproducible"],
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


def main() -> None:
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
            answer = True, getattr(import_module(module), name)(*arguments)
        except Exception as error:  # it is raised where it was asked for
            answer = False, error
        _send(answers, answer)


if __name__ == "__main__":
    main()
