"""Reading a file in time: in this process if its seal is intact, and else in a process of its own.

A file that `mbdlft.archive` writes ends in a seal, the SHA-256 of all bytes before it. An intact seal
says that the file is what was written, to the last bit; so no damage can lead the HDF5 library astray,
and it is read at once, if all of its text is of fixed length. (Whoever means harm can make a seal, too;
the option `isolated` never trusts it.) A file without a seal (written or changed by another tool, before
format 1.1, or large) or with a wrong one is read by `mbdlft.archive.helper`, in a process with a limit
of time and memory that is kept for the next file.
"""

import atexit
import contextlib
import hashlib
import os
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

from mbdlft.archive.hdf5 import LongTextError
from mbdlft.archive.helper import Answer, Request, perform, receive, send, unpacked
from mbdlft.base.apart import end_process, search_path
from mbdlft.base.errors import ArchiveError

LARGE = 2**26  # bytes; a larger file is not read into memory, and has no seal
_SIGNATURE = b"\x89HDF\r\n\x1a\n"
_SEAL = b"mbdlft-seal\n"
_SECONDS = 60.0  # of the clock; the time of the processor ends long before
_lock = threading.Lock()
_helper: tuple[int, Any] | None = None  # the process that started the helper, and the helper


def sealed(image: bytes) -> bytes:
    """The content of a file with its seal behind it."""
    return image + _SEAL + hashlib.sha256(image).digest()


def seal_file(path: Path) -> None:
    """Put the seal behind the content of a file, of which a part at a time is in memory."""
    with path.open("r+b") as stream:
        found = hashlib.file_digest(stream, "sha256")
        stream.write(_SEAL + found.digest())


def is_sealed(image: bytes) -> bool:
    """Whether the content of a file ends in a seal that is right."""
    end = len(image) - 32
    return (
        image[end - len(_SEAL) : end] == _SEAL
        and hashlib.sha256(memoryview(image)[: end - len(_SEAL)]).digest() == image[end:]
    )


def ask(file: Path, request: Request, *, isolated: bool = False) -> Answer:
    """The answer to a request about a file.

    Raises
    ------
    ArchiveError
        The file is missing, damaged, foreign or newer, or has not what is asked for.
    """
    image = content_of(file)
    try:
        if isinstance(image, bytes) and is_sealed(image) and not isolated:
            with contextlib.suppress(LongTextError):
                return perform(request, image, long_text=False)
        return _asked(request, image)
    except ArchiveError as error:
        raise ArchiveError(f"{file}: {error}") from None


def content_of(file: Path) -> bytes | Path:
    """The content of a file, or the file itself if it is large.

    Raises
    ------
    ArchiveError
        It cannot be read, or does not begin like an HDF5 file.
    """
    try:
        if file.exists() and not file.is_file() and not file.is_dir():
            raise ArchiveError(f"{file}: cannot be read: it is not a regular file.")
        size = file.stat().st_size
        image = file if size > LARGE else file.read_bytes()
        with file.open("rb") as stream:
            signature = stream.read(len(_SIGNATURE))
    except ArchiveError:
        raise
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise ArchiveError(f"{file}: cannot be read: {reason}.") from None
    if signature != _SIGNATURE:
        raise ArchiveError(
            f"{file}: is not a whole HDF5 file ({size} bytes): it does not begin like one. Write it "
            "again, or take it from a backup. For a scene, use the commands check and linearize."
        )
    return image


def _asked(request: Request, image: bytes | Path) -> Answer:
    """The answer of the helper."""
    with _lock:
        helper = _started()
        timer = threading.Timer(_SECONDS, helper.kill)
        timer.daemon = True
        timer.start()
        try:
            inside = isinstance(image, bytes)
            head = {
                "request": request._asdict(),
                "path": "" if inside else os.fsencode(Path(image).absolute()).hex(),  # type: ignore[arg-type]
                "size": len(image) if isinstance(image, bytes) else -1,
            }
            with contextlib.suppress(BrokenPipeError):
                send(helper.stdin, head, *([image] if inside else []))
            reply = receive(helper.stdout)
            if reply is None:
                raise ArchiveError(_why(helper))
            if "error" in reply:
                raise ArchiveError(reply["error"])
            try:
                return unpacked(reply, helper.stdout)
            except (ValueError, TypeError, KeyError):
                raise ArchiveError(_why(helper)) from None
        except ArchiveError:
            raise
        except BaseException:
            _stop()
            raise
        finally:
            timer.cancel()


def _why(helper: Any) -> str:
    """The message when the helper has died; it is forgotten."""
    _stop()
    code = helper.returncode
    return (
        "is damaged: the HDF5 library did not end on it, or ended the process that read it (exit code "
        f"{code}). Write it again, or take it from a backup."
    )


def _started() -> Any:
    """The helper of this process; a new one if there is none or it has died."""
    global _helper
    if _helper is not None and _helper[0] == os.getpid() and _helper[1].poll() is None:
        return _helper[1]
    _stop()
    single = {
        "OPENBLAS_NUM_THREADS": "1",
        "PYTHONPATH": search_path(),
        "HDF5_USE_FILE_LOCKING": "FALSE",
    }
    try:
        process = subprocess.Popen(
            [sys.executable, "-P", "-m", "mbdlft.archive.helper"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env={**os.environ, **single},
            start_new_session=True,  # an interruption from the keyboard is for this process
        )
    except (OSError, TypeError, ValueError) as error:
        raise ArchiveError(
            f"has no intact seal, and the process that reads such files does not start: {error}."
        ) from None
    _helper = (os.getpid(), process)
    return process


def _stop() -> None:
    """End the helper, if this process has one."""
    global _helper
    if _helper is None:
        return
    owner, process = _helper
    _helper = None
    if owner == os.getpid():
        end_process(process)


atexit.register(_stop)
