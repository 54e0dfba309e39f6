"""The content of files of other people: read with a limit, from files only."""

import os
from pathlib import Path

from mbdlft.base.errors import MbdlftError

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
