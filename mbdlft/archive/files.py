"""Files that are complete or unchanged: a lock, a new file beside the old one, and its place.

The lock is a file beside the archive, FILE.lock, and the system releases it when a process dies.
"""

import contextlib
import os
import re
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from mbdlft.base.errors import ArchiveError

_PATIENCE = 120.0  # s; a writer that has not ended by then does not end
_ENDING = ".part"


def target_of(file: Path) -> Path:
    """The file itself, or what it leads to if it is a link.

    Raises
    ------
    ArchiveError
        The link leads to itself.
    """
    if not file.is_symlink():
        return file
    target = Path(os.path.realpath(file))
    if target.is_symlink():
        raise ArchiveError(f"{file}: cannot be written: it is a link that leads to itself.")
    return target


@contextmanager
def locked(file: Path) -> Iterator[None]:
    """A context in which no other process writes a file; it waits for one that does.

    Raises
    ------
    ArchiveError
        The lock cannot be made, or another process holds it for minutes.
    """
    beside = file.with_name(f"{file.name}.lock")
    end = time.monotonic() + _PATIENCE
    try:
        handle = _open(beside)
        while not (_try_lock(handle) and _is_same(handle, beside)):
            os.close(handle)
            if time.monotonic() > end:
                raise ArchiveError(
                    f"{file}: cannot be written: another process holds {beside} for "
                    f"{_PATIENCE:g} s. Does it still run?"
                )
            time.sleep(0.02)
            handle = _open(beside)
    except OSError as error:
        if isinstance(error, ArchiveError):
            raise
        raise ArchiveError(
            f"{file}: cannot be written: {error.strerror or error}. The old file, if there was one, is "
            "unchanged."
        ) from None
    try:
        _remove_leftovers(file)
        yield
    finally:
        # unlinked before it is released: whoever waits sees that its lock is that of no file any more
        with contextlib.suppress(OSError):
            beside.unlink()
        os.close(handle)


def _open(file: Path) -> int:
    return os.open(file, os.O_RDWR | os.O_CREAT | getattr(os, "O_CLOEXEC", 0), 0o666)


def _try_lock(handle: int) -> bool:
    """Whether this process now has the lock of an open file."""
    try:
        import fcntl
    except ImportError:  # Windows
        import msvcrt

        try:
            msvcrt.locking(handle, msvcrt.LK_NBLCK, 1)  # type: ignore[attr-defined]
        except OSError:
            return False
        return True
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True


def _is_same(handle: int, file: Path) -> bool:
    """Whether an open file is still the one of its name."""
    try:
        found = file.stat()
    except FileNotFoundError:
        return False
    own = os.fstat(handle)
    return (own.st_ino, own.st_dev) == (found.st_ino, found.st_dev)


def _remove_leftovers(file: Path) -> None:
    """Remove new files of writers that were killed: under the lock nobody else writes one."""
    pattern = re.compile(re.escape(f".{file.name}.") + r"[a-z0-9_]{8}" + re.escape(_ENDING))
    with contextlib.suppress(OSError):
        for path in list(file.parent.iterdir()):
            if pattern.fullmatch(path.name):
                path.unlink(missing_ok=True)


def put(file: Path, image: bytes | Callable[[Path], None], made: Path | None = None) -> None:
    """Put a complete file in place of the old one, or leave the old one as it is.

    `image` is the content of the file, or a function that writes it to a path: that of a new file beside
    the old one, or of the file `made`, which has a part of the content already and stays if this fails.

    Raises
    ------
    ArchiveError
        The file cannot be written.
    """
    temporary: Path | None = None
    try:
        if made is None:
            handle, temporary_name = tempfile.mkstemp(
                prefix=f".{file.name}.", suffix=_ENDING, dir=file.parent
            )
            temporary = Path(temporary_name)
        else:
            handle = os.open(made, os.O_RDWR | getattr(os, "O_BINARY", 0))
        new = temporary or made
        assert new is not None
        with os.fdopen(handle, "r+b") as stream:
            if isinstance(image, bytes):
                stream.write(image)
                stream.flush()
            else:
                image(new)
            os.fsync(stream.fileno())
        new.chmod(permissions_of(file))
        new.replace(file)
    except (OSError, RuntimeError) as error:
        if isinstance(error, ArchiveError):
            raise
        reason = getattr(error, "strerror", None) or error
        raise ArchiveError(
            f"{file}: cannot be written: {reason}. The old file, if there was one, is unchanged."
        ) from None
    finally:
        if temporary is not None:
            with contextlib.suppress(OSError):
                temporary.unlink(missing_ok=True)


def permissions_of(file: Path) -> int:
    """Permissions of a file; those of new files of this process if it does not exist."""
    if file.exists():
        return file.stat().st_mode & 0o777
    mask = os.umask(0)
    os.umask(mask)
    return 0o666 & ~mask
