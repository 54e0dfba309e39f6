"""Archives as files: which models they hold, and writing that leaves a file complete or unchanged.

The whole file is made in memory, written beside the old one and put in its place.
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

FORMAT, VERSION = "mbdlft-archive", "1.0"
_LARGE = 2**26  # bytes from which on an archive is not held in memory
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
        raise ArchiveError(
            f"{file}: expected an LFTModel, got {type(model).__name__}. "
            "to_lft(scene) makes one of a scene."
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
    """Whether a name can be that of a group.

    Raises
    ------
    ArchiveError
        It cannot.
    """
    if not name or "/" in name or name == "." or not _is_text(name):
        raise ArchiveError(
            f"{file}: {name!r} cannot name a {kind}; a name is UTF-8 text without '/' and zero bytes."
        )


def check_file(file: Path) -> None:
    """Whether an archive can be written here, as far as can be seen beforehand.

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
    """Put an archive in place of a file: its contents but the group `replaced`, and what `fill` writes.

    A `large` archive is written to the disk as it is made, another one is made in memory first; it is in
    the folder `beside`, by default that of the file, until it is complete.

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
        May be left out when the archive has one model.

    Raises
    ------
    ArchiveError
        The file is missing, truncated, foreign or newer, or the model is not there or not whole.
    """
    file = Path(path)
    with _opened(file) as archive:
        names = _names(file, archive)
        if name is None:
            if len(names) != 1:
                raise ArchiveError(
                    f"{file}: give the name of a model. Existing: {', '.join(names) or 'none'}."
                )
            name = names[0]
        if name not in names:
            raise ArchiveError(f"{file}: " + unknown_name("model", name, names))
        return _read(file, archive, name)


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
    """An existing archive, in memory if it is not large; damage that HDF5 finds is an `ArchiveError`."""
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
    found = archive.attrs.get("format")
    if not isinstance(found, str) or found != FORMAT:
        raise ArchiveError(
            f"{file}: is not an mbdlft archive: root attribute 'format' is {found!r}, "
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
    """Names of the models, or of what another group holds."""
    found = archive.get(parent, {})
    if not isinstance(found, dict | h5py.Group):
        raise ArchiveError(f"{file}: /{parent} is not a group.")
    return tuple(sorted(found))


def _copy(old: Any, new: Any, replaced: str) -> None:
    """All contents of an archive but one group of a group; copying leaves no holes in the file."""
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
    """One model; whatever is missing or wrong inside becomes an `ArchiveError`."""
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

    `image` is what is in the file, or writes it.
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
    return file.stat().st_size if file.exists() else 0


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask


def _is_text(text: str) -> bool:
    try:
        text.encode("utf-8")
    except UnicodeEncodeError:
        return False
    return "\0" not in text
