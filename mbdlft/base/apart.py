"""A function in a process of its own, with limits of its time and memory: for readers of foreign files.

A library that parses the bytes of somebody else may loop, ask for all memory, or end the process. There
it may: the function returns arrays by name, which come back as bytes; or its failure is an error here.
"""

import contextlib
import io
import json
import os
import subprocess
import sys
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mbdlft.base.errors import MbdlftError

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
            [sys.executable, "-P", "-m", "mbdlft.base.apart"],
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


def main() -> None:
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


if __name__ == "__main__":
    main()
