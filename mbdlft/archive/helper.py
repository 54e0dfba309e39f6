"""What is asked of a file, and the process that answers it when the file has no intact seal.

The HDF5 library can loop for ever or crash on a damaged file. Here it may: this process has limits of
its time and memory, and `mbdlft.archive.guard` starts another one when it has died.
"""

import contextlib
import json
import os
import sys
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbdlft.archive.copying import image_of_copy
from mbdlft.archive.hdf5 import (
    FAILURES,
    Part,
    check_format,
    check_whole,
    member_names,
    opened,
    read_group,
)
from mbdlft.base.apart import limit_process
from mbdlft.base.errors import ArchiveError, unknown_name

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
