"""HDF5 files, as strictly as possible: what they are made of is checked before a number is read.

What this file does with a damaged file may end in any way that the HDF5 library finds, also not at all.
So `mbdlft.archive.reading` lets a process of its own do it, unless the file has an intact seal.
"""

from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import Any, NamedTuple

import h5py
import numpy as np
from h5py import h5a, h5d, h5l, h5o, h5t, h5z
from numpy.typing import NDArray

from mbdlft.archive import layout
from mbdlft.base.errors import ArchiveError

FORMAT, VERSION = "mbdlft-archive", "1.1"
FAILURES = (
    OSError,
    RuntimeError,
    KeyError,
    ValueError,
    OverflowError,
    TypeError,
    AttributeError,
    IndexError,
    MemoryError,
    SystemError,
    ZeroDivisionError,
)  # what h5py raises for damaged files
_LONG_TEXT = "text of variable length"
_NUMBERS = (
    (h5t.IEEE_F64LE, "float64"),
    (h5t.IEEE_F32LE, "float32"),
    (h5t.STD_I64LE, "int64"),
    (h5t.STD_I8LE, "int8"),
    (h5t.STD_U8LE, "uint8"),
    (h5t.py_create(np.dtype(bool), logical=True), "bool"),
)
_FILTERS = (h5z.FILTER_DEFLATE, h5z.FILTER_SHUFFLE, h5z.FILTER_FLETCHER32)
_STORED = (h5d.COMPACT, h5d.CONTIGUOUS, h5d.CHUNKED)
_MOST_LINKS, _DEEPEST = 100_000, 16  # a model has 100 objects, four deep


class LongTextError(Exception):
    """Text of variable length is met, which only the helper reads: the library can loop on its heap."""


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
    long_text: bool = True  # whether text of variable length may be read here


class Part(NamedTuple):
    """The items of a group; of a sweep the rows from `first`, and how many it has in `total`."""

    items: layout.Items
    first: int = 0
    total: int = 0


def member_names(archive: Any, parent: str) -> list[str]:
    """Sorted names of the members of a group of the root; none if the root has no such group."""
    if parent not in names_of(archive):
        return []
    group = member(archive, parent)
    if not isinstance(group, h5py.Group):
        raise ArchiveError(f"/{parent} is not a group.")
    names = names_of(group)
    for name in names:
        check_link(group, name)
    return sorted(names)


def read_group(archive: Any, request: Request, name: str) -> Part:
    """The items of a group such as ``/models/arm``; of a sweep, whole blocks that have its rows."""
    group = member(member(archive, request.parent), name)
    if not isinstance(group, h5py.Group):
        raise ArchiveError(f"{group.name} is not a group.")
    objects = dict(_items_of(group))
    if not request.long_text and any(spec.type == _LONG_TEXT for _, spec in objects.values()):
        raise LongTextError
    heads = {path: _attribute(objects[path][0], path) for path in objects if path[:1] == "@"}
    kind = _word(heads.get("@encoding_type"))
    written = _word(heads.get("@encoding_version"))
    version = layout.encoding_of(kind, written, request.kinds)
    specs = {path: spec for path, (_, spec) in objects.items()}
    if version == "1.0":
        specs = {
            path: layout.Spec(layout.TEXT if spec.type == _LONG_TEXT else spec.type, spec.shape)
            for path, spec in specs.items()
        }
    elif long := [path for path, spec in specs.items() if spec.type == _LONG_TEXT]:
        raise ArchiveError(f"{long[0]} is {_LONG_TEXT}, expected text of fixed length.")
    layout.check_layout(specs, kind, version)
    first, stop, count = 0, 0, 0
    if kind == layout.SWEEP_TYPE:
        count = specs["status"].shape[0]
        size = int(heads[layout.BLOCK_ROWS][()]) if version != "1.0" else 1
        first, stop = _blocks(slice(request.start, request.stop), count, size)
    total, items, limit = 0, {}, request.limit
    for path, (item, _) in objects.items():
        rows_read = slice(first, stop) if kind == layout.SWEEP_TYPE and path in layout.ROWS else None
        total += _bytes(item, path, rows_read, limit)
        if total > limit:
            raise ArchiveError(
                f"needs more than {limit} bytes of memory at {path}. Is it damaged? If not, read it with "
                "a larger limit, or fewer rows of a sweep at a time."
            )
        items[path] = _values(item, path, rows_read)
    return Part(items, first, count)


def check_whole(archive: Any, *, long_text: bool) -> None:
    """Find all that is in a file."""
    for _, item in _walk(archive, "", {}, 0, strict=False):
        kinds = [h5a.open(item.id, name.encode()).get_type() for name in attribute_names(item)]
        if isinstance(item, h5py.Dataset):
            kinds.append(item.id.get_type())
        if not long_text and any(map(_has_long, kinds)):
            raise LongTextError


def _has_long(kind: Any) -> bool:
    """Whether a type has data of variable length, which are on a heap."""
    if isinstance(kind, h5t.TypeStringID):
        return bool(kind.is_variable_str())
    return bool(kind.detect_class(h5t.VLEN)) or bool(kind.detect_class(h5t.STRING))


def check_format(archive: Any, *, long_text: bool = True) -> None:
    """Raise an ArchiveError unless this is an archive of a version that can be read."""
    form, text = (_root_text(archive, name, long_text) for name in ("format", "format_version"))
    if form != FORMAT:
        raise ArchiveError(
            f"is not an mbdlft archive: root attribute 'format' is {form!r}, expected {FORMAT!r}."
        )
    major = text.partition(".")[0] if text is not None else ""
    if not major.isdecimal() or len(major) > 9:
        raise ArchiveError(f"'format_version' is {text!r}, expected {VERSION!r}.")
    if int(major) > int(VERSION.partition(".")[0]):
        raise ArchiveError(
            f"has format version {text}, this mbdlft reads up to {VERSION}. Install a newer mbdlft."
        )


def opened(image: bytes | Path) -> Any:
    """A file, or the content of one, opened for reading."""
    return h5py.File(BytesIO(image) if isinstance(image, bytes) else image, "r")


def _items_of(group: Any) -> Iterator[tuple[str, tuple[Any, layout.Spec]]]:
    """Path, object and specification of each item of a group; the object of an attribute is its owner."""
    for path, item in _walk(group, "", {}, 0, strict=True):
        for name in attribute_names(item):
            if "@" in name:
                raise ArchiveError(f"{path}@{name}: a name with '@' cannot be that of an item.")
            yield f"{path}@{name}", (item, _attribute_spec(item, path, name))
        if isinstance(item, h5py.Dataset):
            yield path, (item, layout.Spec(_type(path, item.id.get_type()), _shape(path, item.shape)))


def _walk(
    group: Any, path: str, seen: dict[Any, str], depth: int, *, strict: bool
) -> Iterator[tuple[str, Any]]:
    """Path and object of a group, and of all that is in it; nothing is read."""
    address = h5o.get_info(group.id).addr
    if address in seen or depth > _DEEPEST:
        raise ArchiveError(f"{path} is linked twice, or lies too deep.")
    seen[address] = path
    yield path, group
    if len(seen) > _MOST_LINKS:
        raise ArchiveError("has more objects than an archive.")
    if isinstance(group, h5py.Dataset):
        _check_storage(path, group.id.get_create_plist())
        return
    for name in names_of(group):
        inner = f"{path}/{name}" if path else name
        if strict and "@" in name:
            raise ArchiveError(f"{inner}: a name with '@' cannot be that of an item.")
        item = member(group, name)
        if not isinstance(item, h5py.Group | h5py.Dataset):
            raise ArchiveError(f"{inner} is a type and not data.")
        yield from _walk(item, inner, seen, depth + 1, strict=strict)


def names_of(group: Any) -> list[str]:
    """Names of the links of a group."""
    if len(group) > _MOST_LINKS:
        raise ArchiveError(f"{group.name} has more members than a group of an archive.")
    names = list(group)
    for name in names:
        try:
            name.encode("utf-8")
        except UnicodeEncodeError:
            raise ArchiveError(f"{group.name} has a name that is not UTF-8: {name!r}.") from None
    return names


def check_link(group: Any, name: str) -> None:
    """Raise an ArchiveError unless a link is that of an object in this file."""
    if group.id.links.get_info(name.encode("utf-8")).type != h5l.TYPE_HARD:
        raise ArchiveError(
            f"{group.name}: {name!r} is a link to another place or file; an archive has none. Copy what "
            "it leads to into the file, if you know what it is."
        )


def member(group: Any, name: str) -> Any:
    """The object of a name in a group."""
    if not isinstance(group, h5py.Group):
        raise ArchiveError(f"{group.name} is not a group.")
    check_link(group, name)
    return group[name]


def _check_storage(path: str, how: Any) -> None:
    """Raise an ArchiveError unless the data are in this file, with filters that every library has."""
    if how.get_layout() not in _STORED:
        raise ArchiveError(f"{path} is a virtual dataset, which takes its numbers from elsewhere.")
    if how.get_external_count():
        raise ArchiveError(f"{path} has its numbers in another file.")
    for k in range(how.get_nfilters()):
        code = how.get_filter(k)[0]
        if code not in _FILTERS:
            raise ArchiveError(f"{path} has the filter {code}; gzip, shuffle, fletcher32 are read.")


def _type(path: str, kind: Any) -> str:
    """The name of the type of an item; other types are an ArchiveError."""
    if kind.committed():
        raise ArchiveError(f"{path} has a type that is stored elsewhere in the file.")
    if isinstance(kind, h5t.TypeStringID):
        return _LONG_TEXT if kind.is_variable_str() else layout.TEXT
    for known, name in _NUMBERS:
        if kind.equal(known):
            return name
    expected = ", ".join(name for _, name in _NUMBERS)
    raise ArchiveError(f"{path} has the type {kind.dtype}, expected {expected} or text.")


def _shape(path: str, shape: tuple[int, ...] | None) -> tuple[int, ...]:
    if shape is None:
        raise ArchiveError(f"{path} has no value.")
    return tuple(int(size) for size in shape)


def attribute_names(item: Any) -> list[str]:
    """Names of the attributes of a group or a dataset."""
    return list(item.attrs.keys())


def _attribute_spec(item: Any, path: str, name: str) -> layout.Spec:
    """Type and shape of an attribute."""
    attribute = h5a.open(item.id, name.encode("utf-8"))
    is_null = attribute.get_space().get_simple_extent_type() == h5py.h5s.NULL
    called = f"{path}@{name}"
    shape = _shape(called, None if is_null else attribute.shape)
    return layout.Spec(_type(called, attribute.get_type()), shape)


def _blocks(rows: slice, count: int, size: int) -> tuple[int, int]:
    """First and last row, with one more, of the blocks of `size` rows that have the `rows` in them."""
    if size < 1:
        raise ArchiveError(f"@block_rows is {size}, expected at least 1.")
    start, stop, _ = rows.indices(count)
    stop = max(start, stop)
    return start // size * size, min(count, -(-stop // size) * size)


def _bytes(item: Any, path: str, rows: slice | None, limit: int) -> int:
    """Bytes of an item when it is in memory, of a dataset also those of the chunk that is unpacked."""
    if "@" in path:
        attribute = h5a.open(item.id, path.partition("@")[2].encode("utf-8"))
        return int(attribute.get_storage_size())
    size = item.dtype.itemsize if item.dtype.kind != "O" else 16
    shape = list(item.shape)
    if rows is not None:
        shape[0] = rows.stop - rows.start
    whole = int(np.prod([size, *shape], dtype=object))
    chunk = int(np.prod([size, *(item.chunks or ())], dtype=object)) if item.chunks else 0
    return max(whole, chunk if chunk > limit else 0)


def _values(item: Any, path: str, rows: slice | None) -> NDArray[Any]:
    """The values of an item, texts as bytes."""
    if "@" in path:
        return _attribute(item, path)
    if item.dtype.kind == "O":
        return _as_bytes(item.asstr()[()].ravel().tolist())
    values: NDArray[Any] = np.asarray(item[()] if rows is None else item[rows])
    return _plain(values)


def _attribute(item: Any, path: str) -> NDArray[Any]:
    """The value of an attribute, text as bytes."""
    value = item.attrs[path.partition("@")[2]]
    if isinstance(value, str):
        return np.array(value.encode("utf-8"))
    array = np.asarray(value)
    if array.dtype.kind == "O":
        return _as_bytes([str(text) for text in array.ravel()])
    return _plain(array)


def _plain(values: NDArray[Any]) -> NDArray[Any]:
    """Values without what h5py notes in their type."""
    return values.astype(values.dtype.str) if values.dtype.metadata else values


def _as_bytes(texts: list[str]) -> NDArray[Any]:
    encoded = [text.encode("utf-8") for text in texts]
    return np.array(encoded, dtype=f"S{max([1, *map(len, encoded)])}")


def _word(value: NDArray[Any] | None) -> str:
    """The text of an attribute; nothing, if it is no text."""
    if value is None or value.dtype.kind != "S" or value.ndim:
        return ""
    return bytes(value[()]).decode("utf-8", "replace")


def _root_text(archive: Any, name: str, long_text: bool) -> str | None:  # noqa: FBT001
    """An attribute of the root that is one text, or None."""
    if name not in attribute_names(archive):
        return None
    spec = _attribute_spec(archive, "", name)
    if spec.type not in (layout.TEXT, _LONG_TEXT) or spec.shape:
        return None
    if spec.type == _LONG_TEXT and not long_text:
        raise LongTextError
    return _word(_attribute(archive, f"@{name}"))


def write_items(group: Any, items: layout.Items) -> None:
    """Write items into an empty group, numbers and texts as they are, bytes and programs compressed."""
    for path, values in items.items():
        owner, at, name = path.partition("@")
        kind = h5py.string_dtype("utf-8", values.dtype.itemsize)
        stored = kind if values.dtype.kind == "S" else values.dtype
        if at:
            target = group.require_group(owner) if owner else group
            target.attrs.create(name, values.astype(stored), dtype=stored)
        else:
            is_program = path.startswith("program/")
            long = values.size and (values.dtype == np.uint8 or is_program)
            packed = {"compression": "gzip", "shuffle": is_program} if long else {}
            group.create_dataset(path, data=values.astype(stored), dtype=stored, **packed)


def copy_all(old: Any, new: Any, replaced: str) -> None:
    """Copy all contents of an archive but the group `replaced`, such as ``models/NAME``.

    HDF5 does not reuse the space of a group that is deleted, so the new file is made by copying.
    """
    parent, _, left_out = replaced.partition("/")
    _copy(old, new, parent)
    inner = new.require_group(parent)
    if parent not in names_of(old):
        return
    group = member(old, parent)
    if not isinstance(group, h5py.Group):
        raise ArchiveError(f"/{parent} is not a group.")
    _copy(group, inner, left_out)


def _copy(old: Any, new: Any, left_out: str) -> None:
    """Copy the members of a group but one, and its attributes, their types unchanged."""
    for name in attribute_names(old):
        attribute = h5a.open(old.id, name.encode("utf-8"))
        if attribute.get_type().get_class() == h5t.REFERENCE:
            raise ArchiveError(f"attribute {name!r} of {old.name} leads to another place.")
        new.attrs.create(name, old.attrs[name], dtype=attribute.dtype)
    for name in names_of(old):
        check_link(old, name)
        if name != left_out:
            old.copy(name, new)
