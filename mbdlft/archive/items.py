"""What a model or a sweep consists of in a file: arrays by path, and the digest of all of them.

The path of a dataset is that below its group, such as ``states/name``; that of an attribute has the name
after ``@``, such as ``certificate@exact``, or ``@encoding_type`` for one of the group itself. Numbers are
little-endian; texts are arrays of UTF-8 bytes (dtype S), and a scalar is an array without axes.
"""

import hashlib
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbdlft.base.array import Array
from mbdlft.base.errors import ArchiveError

Items = dict[str, NDArray[Any]]
DIGEST = "@digest"
TEXT = "text"
# names of the types in digests and messages, by the character and the size of numpy's
TYPES = {"f8": "float64", "f4": "float32", "i8": "int64", "i1": "int8", "u1": "uint8", "b1": "bool"}


class Spec(NamedTuple):
    """Type and shape of an item, as they are known before it is read."""

    type: str
    shape: tuple[int, ...]


def type_name(values: NDArray[Any]) -> str:
    """The name of the type of an item, as in `TYPES`, or ``text``."""
    kind = values.dtype.kind
    return TEXT if kind == "S" else TYPES[f"{kind}{values.dtype.itemsize}"]


def digest(items: Mapping[str, NDArray[Any]], left_out: Sequence[str] = ()) -> str:
    """SHA-256 of the canonical content of a group, in hexadecimal digits.

    The items are taken in the order of the UTF-8 bytes of their paths, without the digest itself and
    those of `left_out`. Of each, the path, the name of its type, its sizes with commas between them, and
    its content go into the hash, the first three with a zero byte behind them. The content of numbers is
    their little-endian bytes in row-major order, that of texts each text with a zero byte behind it.
    """
    found = hashlib.sha256()
    for path in sorted(items, key=str.encode):
        if path == DIGEST or path in left_out:
            continue
        values = items[path]
        for part in (path, type_name(values), ",".join(map(str, values.shape))):
            found.update(part.encode() + b"\0")
        if values.dtype.kind == "S":
            found.update(b"".join(text + b"\0" for text in values.ravel().tolist()))
        else:
            little = values.astype(values.dtype.newbyteorder("<"), copy=False)
            found.update(little.tobytes())
    return found.hexdigest()


def check_digest(items: Items, left_out: Sequence[str] = ()) -> None:
    """Raise an error unless the digest of a group is that of its items.

    Raises
    ------
    ArchiveError
        The content is not what was written.
    """
    stored, found = word(items, DIGEST), digest(items, left_out)
    if stored != found:
        raise ArchiveError(
            f"is damaged or was changed: its digest is {stored!r}, that of its content {found!r}. Write "
            "it again, or take it from a backup; a tool that changes an item writes the new digest."
        )


def texts(values: Sequence[str]) -> NDArray[Any]:
    """An item (n,) of texts.

    Raises
    ------
    ArchiveError
        A text is not UTF-8, or has a zero byte.
    """
    return np.array([_encoded(value) for value in values], dtype=_bytes_type(values))


def text(value: str) -> NDArray[Any]:
    """An item without axes that is one text; errors as those of `texts`."""
    return np.array(_encoded(value), dtype=_bytes_type([value]))


def _bytes_type(values: Sequence[str]) -> str:
    """The type of texts as long as the longest; nothing has the length 1."""
    return f"S{max([1, *(len(_encoded(value)) for value in values)])}"


def _encoded(value: str) -> bytes:
    try:
        encoded = value.encode("utf-8")
    except UnicodeEncodeError:
        encoded = b"\0"
    if b"\0" in encoded:
        raise ArchiveError(f"the text {value[:60]!r} is not UTF-8, or has a zero byte.")
    return encoded


def words(items: Items, path: str) -> list[str]:
    """The texts of an item.

    Raises
    ------
    ArchiveError
        A text is not UTF-8.
    """
    try:
        return [entry.decode("utf-8") for entry in items[path].ravel().tolist()]
    except UnicodeDecodeError as error:
        raise ArchiveError(f"{path} is not UTF-8 text: {error}.") from None


def word(items: Items, path: str, default: str = "") -> str:
    """The text of an item without axes, or the default if there is none."""
    return words(items, path)[0] if path in items else default


def floats(items: Items, path: str) -> Array:
    """The float64 numbers of an item."""
    return np.array(items[path], dtype=np.float64)


def integers(items: Items, path: str) -> tuple[int, ...]:
    """The integers of an item (n,)."""
    return tuple(int(value) for value in items[path])
