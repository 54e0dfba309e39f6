"""What is asked of a file, and the process that answers it when the file has no intact seal.

The HDF5 library can loop for ever or crash on a damaged file. Here it may: this process has limits of
its time and memory, and `mbdlft.archive.reading` starts another one when it has died.

Reading a file in time: in this process if its seal is intact, and else in a process of its own.

A file that `mbdlft.archive` writes ends in a seal, the SHA-256 of all bytes before it. An intact seal
says that the file is what was written, to the last bit; so no damage can lead the HDF5 library astray,
and it is read at once, if all of its text is of fixed length. (Whoever means harm can make a seal, too;
the option `isolated` never trusts it.) A file without a seal (written or changed by another tool, before
format 1.1, or large) or with a wrong one is read by `mbdlft.archive.reading`, in a process with a limit
of time and memory that is kept for the next file.
"""

import atexit
import contextlib
import hashlib
import json
import os
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbdlft.archive.hdf5 import (
    FAILURES,
    LongTextError,
    Part,
    check_format,
    check_whole,
    image_of_copy,
    member_names,
    opened,
    read_group,
)
from mbdlft.base.errors import ArchiveError, unknown_name
from mbdlft.base.worker import end_process, limit_process, search_path

_BACKUP = "Write it again, or take it from a backup."
_SECONDS, _BYTES_PER_SECOND = 3, 2e7  # of the processor; no intact archive needs a tenth of it
_ROOM = 2**28  # bytes beside those that the caller allows


class Request(NamedTuple):
    """What is asked of a file: the names in a group, a member of it, or whether it can be copied."""

    what: str  # names, read, copy
    parent: str
    kind: str = ""  # what messages call a member: model, sweep
    name: str | None = None
    kinds: tuple[str, ...] = ()
    limit: int = 2**30
    start: int | None = None
    stop: int | None = None


class Answer(NamedTuple):
    """Names of members, or the name of one with its items."""

    names: tuple[str, ...] = ()
    part: Part = Part({})


def perform(request: Request, image: bytes | Path, *, long_text: bool = True) -> Answer:
    """The answer to a request, for a file or its content.

    Raises
    ------
    ArchiveError
        The file is damaged, foreign or newer, or has not what is asked for.
    LongTextError
        There is text of variable length, and `long_text` is false.
    """
    try:
        with opened(image) as archive:
            check_format(archive, long_text=long_text)
            return _answer(request, archive, image, long_text=long_text)
    except ArchiveError:
        raise
    except FAILURES as error:
        size = len(image) if isinstance(image, bytes) else image.stat().st_size
        raise ArchiveError(
            f"is not a whole HDF5 file ({size} bytes): {_short(error)}. {_BACKUP}"
        ) from None


def chosen_name(kind: str, names: tuple[str, ...], name: str | None) -> str:
    """The name itself, or the only one of `names` if it is None.

    Raises
    ------
    ArchiveError
        The name is unknown; or it is None, and there is not exactly one.
    """
    if name is None:
        if len(names) != 1:
            raise ArchiveError(
                f"give the name of a {kind}. Existing: {', '.join(names) or 'none'}."
            )
        return names[0]
    if name not in names:
        raise ArchiveError(unknown_name(kind, name, names))
    return name


def said_of(subject: str, message: str) -> str:
    """A message about a model or a sweep, as a sentence."""
    return (
        f"{subject} {message}" if message.startswith(("is ", "needs ")) else f"{subject}: {message}"
    )


def _answer(request: Request, archive: Any, image: bytes | Path, *, long_text: bool) -> Answer:
    """The answer of an open archive."""
    names = tuple(member_names(archive, request.parent))
    if request.what == "names":
        return Answer(names)
    if request.what == "copy":
        check_whole(archive, long_text=long_text)
        if isinstance(image, bytes) and long_text:
            image_of_copy(archive, f"{request.parent}/{request.name}")
        return Answer(names)
    name = chosen_name(request.kind, names, request.name)
    subject = f"{request.kind} {name!r}"
    try:
        part = read_group(
            archive, request.parent, name, request.kinds, request.limit,
            slice(request.start, request.stop), long_text=long_text,
        )  # fmt: skip
    except ArchiveError as error:
        raise ArchiveError(said_of(subject, str(error))) from None
    except FAILURES as error:
        raise ArchiveError(
            f"{subject} is damaged: HDF5 cannot read it, or a checksum is not right: {_short(error)}. "
            f"{_BACKUP}"
        ) from None
    return Answer((name,), part)


def _short(error: BaseException) -> str:
    return (str(error) or type(error).__name__)[:300]


def send(stream: BinaryIO, head: dict[str, Any], *bodies: Any) -> None:
    """Write one message: its length, a head as JSON, and bytes."""
    text = json.dumps(head).encode()
    stream.write(len(text).to_bytes(8, "little") + text)
    for body in bodies:
        stream.write(body)
    stream.flush()


def receive(stream: BinaryIO) -> dict[str, Any] | None:
    """Read the head of one message; None at the end of the stream."""
    size = stream.read(8)
    if len(size) < 8:
        return None
    text = stream.read(int.from_bytes(size, "little"))
    try:
        head = json.loads(text)
    except ValueError:
        return None
    return head if isinstance(head, dict) else None


def packed(answer: Answer) -> tuple[dict[str, Any], list[Any]]:
    """An answer as the head and the bodies of a message."""
    items = answer.part.items
    head = {
        "names": list(answer.names),
        "items": [[path, item.dtype.str, list(item.shape)] for path, item in items.items()],
        "rows": [answer.part.first, answer.part.total],
    }
    return head, [item.tobytes() for item in items.values()]


def unpacked(head: dict[str, Any], stream: BinaryIO) -> Answer:
    """The answer of a head, whose bodies are read from the stream."""
    items: dict[str, NDArray[Any]] = {}
    for path, kind, shape in head["items"]:
        values = np.empty(shape, dtype=kind)
        data = stream.read(values.nbytes)
        items[path] = np.frombuffer(data, dtype=kind).reshape(shape)
    return Answer(tuple(head["names"]), Part(items, *head["rows"]))


def serve(requests: BinaryIO, answers: BinaryIO) -> None:
    """Answer requests until there are no more."""
    while (head := receive(requests)) is not None:
        request = Request(**{**head["request"], "kinds": tuple(head["request"]["kinds"])})
        image: bytes | Path = Path(os.fsdecode(bytes.fromhex(head["path"])))
        if head["size"] >= 0:
            image = requests.read(head["size"])
        size = len(image) if isinstance(image, bytes) else image.stat().st_size
        try:
            seconds, memory = (
                _SECONDS + size / _BYTES_PER_SECOND,
                3 * (request.limit + size) + _ROOM,
            )
            limit_process(seconds, memory, for_good=False)
            reply, bodies = packed(perform(request, image))
        except ArchiveError as error:
            reply, bodies = {"error": str(error)}, []
        except FAILURES as error:
            reply, bodies = {"error": f"cannot be read: {_short(error)}. {_BACKUP}"}, []
        with contextlib.suppress(BrokenPipeError):
            send(answers, reply, *bodies)


if __name__ == "__main__":
    serve(sys.stdin.buffer, sys.stdout.buffer)

LARGE = 2**26  # bytes; a larger file is not read into memory, and has no seal
_SIGNATURE = b"\x89HDF\r\n\x1a\n"
_SEAL = b"mbdlft-seal\n"
_CLOCK = 60.0  # of the clock; the time of the processor ends long before
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
        timer = threading.Timer(_CLOCK, helper.kill)
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
            [sys.executable, "-P", "-m", "mbdlft.archive.reading"],
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
