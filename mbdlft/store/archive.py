"""Archives as files: reading and listing their models, and writing them safely.

A new archive is made in memory (a large one on the disk), written beside the old one and put in its
place. So a file is complete or unchanged, whatever fails.
"""

import contextlib
import os
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib.metadata import version
from io import BytesIO
from pathlib import Path
from typing import Any

import h5py

from mbdlft.base.errors import ArchiveError, MbdlftError, unknown_name
from mbdlft.store.model import read_model, write_model
from mbdlft.system.model import LFTModel
from mbdlft.system.system import System

FORMAT, VERSION = "mbdlft-archive", "1.0"
_LARGE = 2**26  # bytes; a larger archive is not read into memory
_SIGNATURE = b"\x89HDF\r\n\x1a\n"


def save(path: str | Path, model: LFTModel, name: str | None = None) -> None:
    """Write a model into an archive under /models/<name>; the other contents of the file stay.

    Parameters
    ----------
    path : file, made if it does not exist
    model : LFTModel
    name : str, optional
        The name of the model by default; a model of that name is replaced.

    Raises
    ------
    ArchiveError
        The file exists and is not an archive of this major version, or it cannot be written. The
        old file is then unchanged.
    """
    file = Path(path)
    if not isinstance(model, LFTModel):
        why = "A system without evidence has no place in archives of version 1.0; "
        raise ArchiveError(
            f"{file}: expected an LFTModel, got {type(model).__name__}. "
            f"{why if isinstance(model, System) else ''}to_lft(scene) makes one of a scene."
        )
    if not model.lft.is_plain:
        kinds = [f"{b.name} is a {b.kind} block" for b in model.lft.blocks if b.kind != "real"]
        raise ArchiveError(
            f"{file}: {', '.join(kinds) or 'an entry is complex'}, and archives of version 1.0 hold real "
            "parameters and real entries only."
        )
    key = model.name if name is None else name
    check_name(file, "model", key)
    for text in (model.description, model.provenance.scene):
        if not _is_text(text):
            raise ArchiveError(f"{file}: a text of the model is not UTF-8, or has a zero byte.")
    rewrite(
        file,
        lambda new: write_model(new["models"].create_group(key), model),
        f"models/{key}",
        large=_size(file) > _LARGE,
    )


def check_name(file: Path, kind: str, name: str) -> None:
    """Raise an error unless the name can be that of a group of an archive.

    Raises
    ------
    ArchiveError
        The name is empty, or has a slash or a zero byte.
    """
    if not name or "/" in name or name == "." or not _is_text(name):
        raise ArchiveError(
            f"{file}: {name!r} cannot name a {kind}; a name is UTF-8 text without '/' and zero bytes."
        )


def check_file(file: Path) -> None:
    """Raise an error if it is known before the work that an archive cannot be written here.

    Raises
    ------
    ArchiveError
        The file exists and is not an archive of this major version, or its folder does not exist.
    """
    if file.exists():
        with _opened(file) as archive:
            _names(file, archive)
    elif not file.parent.is_dir():
        raise ArchiveError(f"{file}: cannot be written: {file.parent} is not a folder.")


def rewrite(
    file: Path,
    fill: Callable[[Any], None],
    replaced: str,
    *,
    large: bool,
    beside: Path | None = None,
) -> None:
    """Put a new archive in place of a file: the old contents, with the group that `fill` writes.

    The group `replaced` of the old contents is left out. A `large` archive is written to the disk piece
    by piece, in the folder `beside` (by default that of the file) until it is complete; any other
    archive is made in memory first.

    Raises
    ------
    ArchiveError
        The file exists and is not an archive of this major version, or it cannot be written. The
        old file is then unchanged.
    """

    def make(target: BytesIO | Path) -> None:
        with h5py.File(target, "w", libver=("v110", "v110")) as new:  # metadata with checksums
            if file.exists():
                with _opened(file) as old:
                    _names(file, old)
                    _copy(old, new, replaced)
            new.attrs["format"] = FORMAT
            new.attrs["format_version"] = VERSION
            new.attrs["generator"] = f"mbdlft {version('mbdlft')}"
            new.require_group("models")
            fill(new)

    if large:
        _replace(file, make, beside)
        return
    image = BytesIO()
    make(image)
    _replace(file, image.getvalue())


def load(path: str | Path, name: str | None = None) -> LFTModel:
    """Read a model from an archive.

    Parameters
    ----------
    path : file
    name : str, optional
        May be left out if the archive has one model.

    Raises
    ------
    ArchiveError
        The file is missing, truncated, foreign or newer, or the model is missing or incomplete.
    """
    file = Path(path)
    with _opened(file) as archive:
        return _read(file, archive, chosen_name(file, "model", _names(file, archive), name))


def chosen_name(file: Path, kind: str, names: tuple[str, ...], name: str | None) -> str:
    """The name itself, or the only one of `names` if it is None.

    Raises
    ------
    ArchiveError
        The name is unknown; or it is None, and there is not exactly one.
    """
    if name is None:
        if len(names) != 1:
            raise ArchiveError(
                f"{file}: give the name of a {kind}. Existing: {', '.join(names) or 'none'}."
            )
        return names[0]
    if name not in names:
        raise ArchiveError(f"{file}: " + unknown_name(kind, name, names))
    return name


def model_names(path: str | Path) -> tuple[str, ...]:
    """Names of the models in an archive, sorted.

    Parameters
    ----------
    path : file

    Raises
    ------
    ArchiveError
        The file is missing, truncated, foreign or newer.
    """
    file = Path(path)
    with _opened(file) as archive:
        return _names(file, archive)


@contextmanager
def _opened(file: Path) -> Iterator[Any]:
    """An existing archive, opened for reading, in memory if it is not large.

    Damage that HDF5 finds in it is an `ArchiveError`.
    """
    try:
        size = file.stat().st_size
        image = file if size > _LARGE else BytesIO(file.read_bytes())
        with file.open("rb") as stream:
            signature = stream.read(len(_SIGNATURE))
    except OSError as error:
        raise ArchiveError(f"{file}: cannot be read: {error.strerror}.") from None
    if size and signature != _SIGNATURE:
        raise ArchiveError(
            f"{file}: is not a whole HDF5 file ({size} bytes): it does not begin like one. Write it "
            "again, or take it from a backup. For a scene, use the commands check and linearize."
        )
    try:
        with h5py.File(image, "r") as archive:
            _check_format(file, archive)
            yield archive
    except MbdlftError:
        raise
    except (OSError, RuntimeError, KeyError, ValueError, OverflowError, TypeError) as error:
        raise ArchiveError(
            f"{file}: is not a whole HDF5 file ({size} bytes): {error}. Write it again, or take it "
            "from a backup."
        ) from None


def _check_format(file: Path, archive: Any) -> None:
    """Raise an ArchiveError unless the file is an archive of a version that can be read."""
    form = archive.attrs.get("format")
    if not isinstance(form, str) or form != FORMAT:
        raise ArchiveError(
            f"{file}: is not an mbdlft archive: root attribute 'format' is {form!r}, "
            f"expected {FORMAT!r}."
        )
    text = archive.attrs.get("format_version")
    major = text.partition(".")[0] if isinstance(text, str) else ""
    if not major.isdecimal():
        raise ArchiveError(f"{file}: 'format_version' is {text!r}, expected {VERSION!r}.")
    if int(major) > int(VERSION.partition(".")[0]):
        raise ArchiveError(
            f"{file}: has format version {text}, this mbdlft reads up to {VERSION}. Install a newer "
            "mbdlft."
        )


def _names(file: Path, archive: Any, parent: str = "models") -> tuple[str, ...]:
    """Sorted names of the models, or of the members of another group `parent`."""
    group = archive.get(parent, {})
    if not isinstance(group, dict | h5py.Group):
        raise ArchiveError(f"{file}: /{parent} is not a group.")
    return tuple(sorted(group))


def _copy(old: Any, new: Any, replaced: str) -> None:
    """Copy all contents of an archive but the group `replaced`, such as ``models/NAME``.

    HDF5 does not reuse the space of a group that is deleted, so the new file is made by copying.
    """
    parent = replaced.partition("/")[0]
    for attribute, value in old.attrs.items():
        new.attrs[attribute] = value
    for key in old:
        if key != parent:
            old.copy(key, new)
    inner = new.create_group(parent)
    for key in old.get(parent, {}):
        if f"{parent}/{key}" != replaced:
            old.copy(f"{parent}/{key}", inner, name=key)


def _read(file: Path, archive: Any, name: str) -> LFTModel:
    """One model; anything that is missing or wrong in it becomes an `ArchiveError`."""
    try:
        return read_model(archive["models"][name], name)
    except ArchiveError as error:
        raise ArchiveError(f"{file}: model {name!r}: {error}") from None
    except KeyError as error:
        raise ArchiveError(f"{file}: model {name!r} is not whole: {error.args[0]}.") from None
    except OSError as error:
        raise ArchiveError(
            f"{file}: model {name!r} is damaged: HDF5 cannot read it, or the checksum of its numbers "
            f"is not right: {error}. Write it again, or take it from a backup."
        ) from None
    except (
        MbdlftError,
        RuntimeError,
        ValueError,
        OverflowError,
        TypeError,
        AttributeError,
        IndexError,
    ) as error:
        raise ArchiveError(f"{file}: model {name!r} is not as specified: {error}") from None


def _replace(file: Path, image: bytes | Callable[[Path], None], beside: Path | None = None) -> None:
    """Put a complete file in place of the old one, or leave the old one as it is.

    `image` is the content of the file, or a function that writes it to a path.
    """
    temporary: Path | None = None
    try:
        handle, temporary_name = tempfile.mkstemp(
            prefix=f".{file.name}.", dir=beside or file.parent
        )
        temporary = Path(temporary_name)
        with os.fdopen(handle, "r+b") as stream:
            if isinstance(image, bytes):
                stream.write(image)
                stream.flush()
            else:
                image(temporary)
            os.fsync(stream.fileno())
        mode = file.stat().st_mode & 0o777 if file.exists() else 0o666 & ~_umask()
        temporary.chmod(mode)
        temporary.replace(file)
    except (OSError, RuntimeError) as error:
        reason = getattr(error, "strerror", None) or error
        raise ArchiveError(
            f"{file}: cannot be written: {reason}. The old file, if there was one, is unchanged."
        ) from None
    finally:
        if temporary is not None:
            with contextlib.suppress(OSError):
                temporary.unlink(missing_ok=True)


def _size(file: Path) -> int:
    """Size of a file in bytes; 0 if it does not exist."""
    return file.stat().st_size if file.exists() else 0


def _umask() -> int:
    """Permissions that new files of this process do not get."""
    mask = os.umask(0)
    os.umask(mask)
    return mask


def _is_text(text: str) -> bool:
    """Whether HDF5 can store the text."""
    try:
        text.encode("utf-8")
    except UnicodeEncodeError:
        return False
    return "\0" not in text
