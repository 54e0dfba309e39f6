"""Reading a file in time: in this process if its seal is intact, and else in a process of its own.

A file that `mbdlft.archive` writes ends in a seal, the SHA-256 of all bytes before it. An intact seal
says that the file is what was written, to the last bit; so no damage can lead the HDF5 library astray,
and it is read at once, if all of its text is of fixed length. (Whoever means harm can make a seal, too;
the option `isolated` never trusts it.) The HDF5 library can loop for ever or crash on a damaged file. So
a file without a seal (written or changed by another tool, before format 1.1, or large) or with a wrong
one is read in a process with a limit of time and memory, which is kept for the next file.
"""

import contextlib
import hashlib
from io import BytesIO
from pathlib import Path
from typing import Any, NamedTuple

import h5py
import numpy as np
from numpy.typing import NDArray

from mbdlft.archive import hdf5
from mbdlft.archive.layout import texts, words
from mbdlft.base.errors import ArchiveError, MbdlftError, check_known
from mbdlft.base.worker import EndedError, Limits, NoProcessError, Worker, content_of

LARGE = 2**26  # bytes; a larger file is not read into memory, and has no seal
_BACKUP = "Write it again, or take it from a backup."
_SIGNATURE = b"\x89HDF\r\n\x1a\n"
_SEAL = b"mbdlft-seal\n"
_SECONDS, _BYTES_PER_SECOND = 3, 2e7  # of the processor; no intact archive needs a tenth of it
_CLOCK = 60.0  # s; the time of the processor ends long before
_ROOM = 2**28  # bytes beside those that the caller allows
_NAMES, _ROWS = "/names", "/rows"  # beside the paths of items, which do not begin with a slash
_READER = Worker({"HDF5_USE_FILE_LOCKING": "FALSE"}, plain=True)


class Answer(NamedTuple):
    """Names of members, or the name of one with its items."""

    names: tuple[str, ...] = ()
    part: hdf5.Part = hdf5.Part({})


def ask(file: Path, request: hdf5.Request, *, isolated: bool = False) -> Answer:
    """The answer to a request about a file."""
    image = image_of(file)
    try:
        if isinstance(image, bytes) and is_sealed(image) and not isolated:
            with contextlib.suppress(hdf5.LongTextError):
                return perform(request._replace(long_text=False), image)
        return _asked(request, image)
    except MbdlftError as error:
        raise ArchiveError(f"{file}: {error}") from None


def image_of(file: Path) -> bytes | Path:
    """The content of a file, or the file itself if it is large."""
    try:
        size = file.stat().st_size
        image = file.absolute() if size > LARGE else content_of(file, ArchiveError)
        with file.open("rb") as stream:
            signature = stream.read(len(_SIGNATURE))
    except ArchiveError:
        raise
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise ArchiveError(f"{file}: cannot be read: {reason}.") from None
    if signature != _SIGNATURE:
        raise ArchiveError(
            f"{file}: is not a whole HDF5 file ({size} bytes): it does not begin like one. {_BACKUP} For "
            "a scene, use the commands check and linearize."
        )
    return image


def sealed(image: bytes) -> bytes:
    """The content of a file with its seal behind it."""
    return image + _SEAL + hashlib.sha256(image).digest()


def seal_file(path: Path) -> None:
    """Put the seal behind the content of a file, of which a part at a time is in memory."""
    with path.open("r+b") as stream:
        digest = hashlib.file_digest(stream, "sha256").digest()
        stream.write(_SEAL + digest)


def is_sealed(image: bytes) -> bool:
    """Whether the content of a file ends in a seal that is right."""
    end = len(image) - 32
    return (
        image[end - len(_SEAL) : end] == _SEAL
        and hashlib.sha256(memoryview(image)[: end - len(_SEAL)]).digest() == image[end:]
    )


def _asked(request: hdf5.Request, image: bytes | Path) -> Answer:
    """The answer from the other process."""
    size = _size(image)
    seconds = _SECONDS + size / _BYTES_PER_SECOND
    limits = Limits(seconds, 3 * (request.limit + size) + _ROOM, _CLOCK)
    try:
        items = _READER.call(f"{__name__}:items_apart", request, image, limits=limits)
    except EndedError as error:
        raise ArchiveError(
            "is damaged: the HDF5 library did not end on it, or ended the process that read it "
            f"({error.how}). {_BACKUP}"
        ) from None
    except NoProcessError as error:
        raise ArchiveError(
            f"has no intact seal, and the process that reads such files does not start: {error}."
        ) from None
    names, rows = tuple(words(items, _NAMES)), items.pop(_ROWS).tolist()
    del items[_NAMES]
    return Answer(names, hdf5.Part(items, *rows))


def items_apart(request: hdf5.Request, image: bytes | Path) -> dict[str, NDArray[Any]]:
    """The answer to a request as arrays; any failure of the libraries is an ArchiveError."""
    try:
        names, part = perform(request, image)
    except hdf5.FAILURES as error:
        if isinstance(error, ArchiveError):
            raise
        raise ArchiveError(f"cannot be read: {_short(error)}. {_BACKUP}") from None
    return {**part.items, _NAMES: texts(names), _ROWS: np.array([part.first, part.total])}


def perform(request: hdf5.Request, image: bytes | Path) -> Answer:
    """The answer to a request, for a file or its content."""
    try:
        with hdf5.opened(image) as archive:
            hdf5.check_format(archive, long_text=request.long_text)
            return _answer(request, archive, image)
    except ArchiveError:
        raise
    except hdf5.FAILURES as error:
        raise ArchiveError(
            f"is not a whole HDF5 file ({_size(image)} bytes): {_short(error)}. {_BACKUP}"
        ) from None


def _answer(request: hdf5.Request, archive: Any, image: bytes | Path) -> Answer:
    """The answer of an open archive."""
    names = tuple(hdf5.member_names(archive, request.parent))
    if request.what == "names":
        return Answer(names)
    if request.what == "copy":
        hdf5.check_whole(archive, long_text=request.long_text)
        if isinstance(image, bytes) and request.long_text:
            with h5py.File(BytesIO(), "w", libver=("v110", "v110")) as new:
                hdf5.copy_all(archive, new, f"{request.parent}/{request.name}")
        return Answer(names)
    name = chosen_name(request.kind, names, request.name)
    subject = f"{request.kind} {name!r}"
    try:
        part = hdf5.read_group(archive, request, name)
    except ArchiveError as error:
        raise ArchiveError(said_of(subject, str(error))) from None
    except hdf5.FAILURES as error:
        raise ArchiveError(
            f"{subject} is damaged: HDF5 cannot read it, or a checksum is not right: {_short(error)}. "
            f"{_BACKUP}"
        ) from None
    return Answer((name,), part)


def chosen_name(kind: str, names: tuple[str, ...], name: str | None) -> str:
    """The name itself, or the only one of `names` if it is None."""
    if name is None:
        if len(names) != 1:
            raise ArchiveError(f"give the name of the {kind}. Existing: {', '.join(names) or 'none'}.")
        return names[0]
    check_known(kind, [name], names, error=ArchiveError)
    return name


def said_of(subject: str, message: str) -> str:
    """A message about a model or a sweep, as a sentence."""
    return f"{subject} {message}" if message.startswith(("is ", "needs ")) else f"{subject}: {message}"


def _size(image: bytes | Path) -> int:
    return len(image) if isinstance(image, bytes) else image.stat().st_size


def _short(error: BaseException) -> str:
    return (str(error) or type(error).__name__)[:300]
