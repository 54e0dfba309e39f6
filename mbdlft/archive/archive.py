"""Archives as files: reading and listing their models, and writing them safely.

A new archive is made in memory (a large one on the disk), written beside the old one and put in its
place, under a lock: a file FILE.lock, which the system releases when a process dies. So a file is
complete or unchanged, whatever fails, and no writer loses the work of another.
"""

import contextlib
import os
import re
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from importlib.metadata import version
from io import BytesIO
from pathlib import Path
from typing import Any, TypeVar

import h5py

from mbdlft.archive import hdf5
from mbdlft.archive.model import KINDS, items_of_model, model_of_items
from mbdlft.archive.reading import LARGE, ask, image_of, said_of, seal_file, sealed
from mbdlft.base.arguments import arguments_checked
from mbdlft.base.errors import ArchiveError, MbdlftError
from mbdlft.system.model import System
from mbdlft.system.theta import DeltaThetaModel

Made = TypeVar("Made")
_PATIENCE = 120.0  # s; a writer that has not ended by then does not end
_ENDING, _SHOWN = ".part", 200  # of the name of a new file: letters of the name that it gets
_UNCHANGED = "The old file, if there was one, is unchanged."
LIMIT = 2**30  # bytes that reading may need, unless the caller allows more


@arguments_checked
def save(path: str | Path, model: System | DeltaThetaModel, name: str | None = None) -> None:
    """Write a model or a system into an archive under /models/<name>; other contents of the file stay.

    Parameters
    ----------
    path : file, made if it does not exist
        If it is a link, the file to which it leads is written.
    model : LFTModel, System, or DeltaThetaModel
    name : str, optional
        The name of the model by default; a model of that name is replaced.

    Raises
    ------
    ArchiveError
        The file exists and is not an archive of this major version, or something in it cannot be read
        and so would be lost, or it cannot be written. The old file is then unchanged.
    """
    file = Path(path)
    key = model.name if name is None else name
    check_name(file, "model", key)
    with naming(file, f"model {key!r}"):
        items = items_of_model(model)
        model_of_items(items, key)  # what could not be read again is not written
    rewrite(file, lambda new: hdf5.write_items(new["models"].create_group(key), items), f"models/{key}")


@contextmanager
def naming(file: Path, what: str) -> Iterator[None]:
    """In this context an ArchiveError gets the name of the file, and what it is about."""
    try:
        yield
    except ArchiveError as error:
        raise ArchiveError(f"{file}: {said_of(what, str(error))}") from None


def check_name(file: Path, kind: str, name: str) -> None:
    """Raise an error unless the name can be that of a group of an archive."""
    usable = isinstance(name, str) and bool(name) and name != "." and not set(name) & {"/", "\0"}
    try:
        usable = usable and len(name.encode("utf-8")) < 2**12
    except UnicodeEncodeError:
        usable = False
    if not usable:
        raise ArchiveError(
            f"{file}: {str(name)[:200]!r} cannot name a {kind}; a name is UTF-8 text without '/' and "
            "zero bytes, of less than 4096 bytes."
        )


def check_file(file: Path) -> None:
    """Raise an error if it is known before the work that an archive cannot be written here."""
    if file.exists():
        names_in(file, "models")
    elif not target_of(file).parent.is_dir():
        parent = target_of(file).parent
        raise ArchiveError(f"{file}: cannot be written: {parent} is not a folder.")


def rewrite(file: Path, fill: Callable[[Any], None], replaced: str, *, made: Path | None = None) -> None:
    """Put a new archive in place of a file: the old contents, with the group that `fill` writes.

    The group `replaced` of the old contents is left out. If there is a file `made`, it has that group
    already, on the same disk; the rest is put into it, and it is moved to its place. Otherwise an archive
    is made in memory first if the old one is not large. Other writers of the file wait.
    """
    target = target_of(file)
    if target.exists():
        image_of(file)  # a folder is no place for a lock, and needs none
    with locked(target):
        if made is None and _size(target) <= LARGE:
            image = BytesIO()
            _make(file, target, image, fill, replaced)
            put({target: sealed(image.getvalue())})
            return

        def make(path: Path) -> None:
            _make(file, target, path, fill, replaced, mode="w" if made is None else "r+")
            if path.stat().st_size <= LARGE:
                seal_file(path)

        put({target: make}, made)


def _make(
    file: Path,
    old: Path,
    new: BytesIO | Path,
    fill: Callable[[Any], None],
    replaced: str,
    mode: str = "w",
) -> None:
    """Make a new archive of the old one, if there is one; `file` is its name in messages."""
    with h5py.File(new, mode, libver=("v110", "v110")) as archive:  # metadata with checksums
        if old.exists():
            _copy(file, old, archive, replaced)
        for name, text in (
            ("format", hdf5.FORMAT),
            ("format_version", hdf5.VERSION),
            ("generator", f"mbdlft {version('mbdlft')}"),
        ):
            kind = h5py.string_dtype("utf-8", len(text))
            archive.attrs.create(name, text.encode(), dtype=kind)
        archive.require_group("models")
        fill(archive)


def _copy(file: Path, old: Path, new: Any, replaced: str) -> None:
    """Copy an archive but one group, if all of it can be read."""
    image = image_of(old)
    parent, _, name = replaced.partition("/")
    try:
        ask(old, hdf5.Request("copy", parent, name=name))  # where the library may fail
    except ArchiveError as error:
        raise ArchiveError(
            str(error).replace(f"{old}: ", f"{file}: ", 1) + " Nothing is written."
        ) from None
    try:
        with hdf5.opened(image) as archive:
            hdf5.check_format(archive)
            hdf5.copy_all(archive, new, replaced)
    except ArchiveError as error:
        raise ArchiveError(f"{file}: {error} Nothing is written.") from None
    except hdf5.FAILURES as error:
        raise ArchiveError(
            f"{file}: something in it cannot be read, and would be lost: {error}. Nothing is written."
        ) from None


@arguments_checked
def load(path: str | Path, name: str | None = None, *, limit: int = LIMIT, isolated: bool = False) -> Any:
    """Read a model or a system from an archive.

    Parameters
    ----------
    path : file
    name : str, optional
        May be left out if the archive has one model.
    limit : int
        Most bytes that the arrays of the model may need.
    isolated : bool
        Whether to read in another process also what this library has written and nobody has changed:
        for files of people who may mean harm.

    Returns
    -------
    LFTModel; or System, if it was stored without evidence; or DeltaThetaModel
    """
    request = hdf5.Request("read", "models", "model", name, KINDS, limit)
    return read_one(
        Path(path), request, lambda part, key: model_of_items(part.items, key), isolated=isolated
    )


def read_one(
    file: Path, request: hdf5.Request, make: Callable[[hdf5.Part, str], Made], *, isolated: bool = False
) -> Made:
    """What is made of one member of an archive and of its name."""
    if request.name is not None and not isinstance(request.name, str):
        shown = repr(request.name)[:60]
        raise ArchiveError(f"{file}: expected the name of a {request.kind}, got {shown}.")
    answer = ask(file, request, isolated=isolated)
    (key,) = answer.names
    with naming(file, f"{request.kind} {key!r}"):
        return make(answer.part, key)


@arguments_checked
def model_names(path: str | Path) -> tuple[str, ...]:
    """Names of the models in the archive at `path`, sorted."""
    return names_in(Path(path), "models")


def names_in(file: Path, parent: str) -> tuple[str, ...]:
    """Sorted names of the members of a group of an archive."""
    return ask(file, hdf5.Request("names", parent)).names


def _size(file: Path) -> int:
    """Size of a file in bytes; 0 if it does not exist."""
    return file.stat().st_size if file.exists() else 0


def target_of(file: Path) -> Path:
    """The file itself, or what it leads to if it is a link."""
    if not file.is_symlink():
        return file
    target = Path(os.path.realpath(file))
    if target.is_symlink():
        raise ArchiveError(f"{file}: cannot be written: it is a link that leads to itself.")
    return target


@contextmanager
def locked(file: Path, patience: float | None = None, busy: str = "") -> Iterator[None]:
    """A context in which no other process writes a file; it waits for one that does, so many seconds.

    `busy` says what that one does, if it does not end until then.
    """
    beside = file.with_name(f"{file.name}.lock")
    patience = _PATIENCE if patience is None else patience
    end = time.monotonic() + patience
    with writing(file):
        handle = _open(beside)
        while not (_try_lock(handle) and _is_same(handle, beside)):
            os.close(handle)
            if time.monotonic() > end:
                does = busy or f"holds {beside} for {patience:g} s. Does it still run?"
                raise ArchiveError(f"{file}: cannot be written: {_holder(beside)} {does}")
            time.sleep(0.02)
            handle = _open(beside)
        with contextlib.suppress(OSError):  # a full disk is told where the file itself is written
            os.write(handle, str(os.getpid()).encode())
    try:
        _remove_leftovers(file)
        yield
    finally:
        # unlinked before it is released: whoever waits sees that its lock is that of no file any more
        with contextlib.suppress(OSError):
            beside.unlink()
        os.close(handle)


def _holder(lock: Path) -> str:
    """Words for the process that has a lock: it has written its number."""
    with contextlib.suppress(OSError, ValueError):
        return f"process {int(lock.read_text(encoding='ascii'))}"
    return "another process"


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
        by_name = file.stat()
    except FileNotFoundError:
        return False
    by_handle = os.fstat(handle)
    return (by_handle.st_ino, by_handle.st_dev) == (by_name.st_ino, by_name.st_dev)


def _remove_leftovers(file: Path) -> None:
    """Remove new files of writers that were killed: under the lock nobody else writes one."""
    pattern = re.compile(re.escape(f".{file.name[:_SHOWN]}.") + r"[a-z0-9_]{8}" + re.escape(_ENDING))
    with contextlib.suppress(OSError):
        for path in list(file.parent.iterdir()):
            if pattern.fullmatch(path.name):
                path.unlink(missing_ok=True)


@contextmanager
def writing(file: Path, unchanged: str = _UNCHANGED) -> Iterator[None]:
    """In this context a failure of the system is an ArchiveError: a file cannot be written."""
    try:
        yield
    except (OSError, RuntimeError) as error:
        if isinstance(error, MbdlftError):
            raise
        reason = getattr(error, "strerror", None) or error
        raise ArchiveError(f"{file}: cannot be written: {reason}. {unchanged}") from None


def put(
    images: Mapping[Path, bytes | Callable[[Path], None]], made: Path | None = None, **unchanged: str
) -> None:
    """Put complete files in place of old ones, all or none; `unchanged` as in `writing`.

    An image is the content of a file, or a function that writes it to a path: that of a new file beside
    the old one, or of the file `made`, which has a part of the content already and stays if this fails.
    """
    new: list[Path] = []
    try:
        for file, image in images.items():
            with writing(file, **unchanged):
                if made is None:
                    handle, name = tempfile.mkstemp(
                        prefix=f".{file.name[:_SHOWN]}.", suffix=_ENDING, dir=file.parent
                    )
                else:
                    handle, name = os.open(made, os.O_RDWR | getattr(os, "O_BINARY", 0)), str(made)
                new.append(Path(name))
                with os.fdopen(handle, "r+b") as stream:
                    if isinstance(image, bytes):
                        stream.write(image)
                        stream.flush()
                    else:
                        image(new[-1])
                    os.fsync(stream.fileno())
                new[-1].chmod(permissions_of(file))
        for file, path in zip(images, new, strict=True):
            with writing(file, **unchanged):
                path.replace(file)
    finally:
        for temporary in new if made is None else ():
            with contextlib.suppress(OSError):
                temporary.unlink(missing_ok=True)


def permissions_of(file: Path) -> int:
    """Permissions of a file; those of new files of this process if it does not exist."""
    if file.exists():
        return file.stat().st_mode & 0o777
    mask = os.umask(0)
    os.umask(mask)
    return 0o666 & ~mask
