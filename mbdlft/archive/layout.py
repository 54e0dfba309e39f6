"""The table of an archive: path, type and sizes of each item, as docs/archive-format.md lists them.

The path of a dataset is that below its group, such as ``states/name``; that of an attribute has the name
after ``@``, such as ``certificate@exact``, or ``@encoding_type`` for one of the group itself. The last
part of a path is the name of a field of a dataclass: `encode` and `record` make items of objects and
objects of items by the table, and `check_layout` compares a file with it before a number is read. Numbers
are little-endian; texts are arrays of UTF-8 bytes (dtype S), and a scalar is an array without axes.
"""

import hashlib
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from mbdlft.base.errors import ArchiveError

Items = dict[str, NDArray[Any]]
Made = TypeVar("Made")
MODEL_TYPE, SYSTEM_TYPE, SWEEP_TYPE, ANALYSIS_TYPE = "lft-model", "system", "sweep", "analysis"
VERSION, FIRST = "1.1", "1.0"
DIGEST, BLOCK_ROWS, TEXT = "@digest", "@block_rows", "text"
# names of the types in digests and messages, by the character and the size of numpy's
TYPES = {"f8": "float64", "f4": "float32", "i8": "int64", "i1": "int8", "u1": "uint8", "b1": "bool"}
_CODES = {name: code for code, name in TYPES.items()}
_FLOATS = ("float64", "float32")  # where the table says float; all such items of a group have one type
ROWS = (
    *("samples", "A", "B", "C", "D", "trim/value", "residual", "status"),
    *("poles/real", "poles/imaginary", "function/value"),
)


class Spec(NamedTuple):
    """Type and shape of an item, as they are known before it is read."""

    type: str
    shape: tuple[int, ...]


class Wanted(NamedTuple):
    """Type of an item, the names of its sizes, and whether it may be missing."""

    type: str
    sizes: tuple[str, ...]
    optional: bool = False


Layout = dict[str, Wanted]


def _wanted(table: str) -> Layout:
    """Lines of paths with ``: type sizes``; a path that ends in ``?`` may be missing."""
    layout = {}
    for line in filter(None, map(str.strip, table.splitlines())):
        paths, _, spec = line.partition(": ")
        kind, *sizes = spec.split()
        for path in paths.split():
            layout[path.rstrip("?")] = Wanted(kind, tuple(sizes), path.endswith("?"))
    return layout


_SIGNALS = """
    @encoding_type @encoding_version: text
    states/name states/unit: text x
    inputs/name inputs/unit: text u
    outputs/name outputs/unit: text y
    parameters/name parameters/unit: text p
"""
_SYSTEM = f"""{_SIGNALS}
    @time_domain @description?: text
    delta/parameter: int64 w
    parameters/role parameters/substitution: text p
    parameters/nominal parameters/low parameters/high parameters/reference: float64 p
    parameters/map: float64 p 3
"""
MATRICES = ("A", "B_w", "B_u", "C_z", "D_zw", "D_zu", "C_y", "D_yw", "D_yu")
_MATRICES = """
    A: float64 x x
    B_w: float64 x w
    B_u: float64 x u
    C_z: float64 z x
    D_zw: float64 z w
    D_zu: float64 z u
    C_y: float64 y x
    D_yw: float64 y w
    D_yu: float64 y u
"""
_SPARSE = """sparse@signals: int64
    sparse/row sparse/column sparse/block: int64 entries
    sparse/entry: float64 entries
    sparse/nonzero: bool sparse_rows sparse_columns"""
_EVIDENCE = """
    trim/name trim/unit: text t
    trim/nominal: float64 t
    certificate/order certificate/lower_bound certificate/raw_order certificate/doubtful?: int64 p
    certificate@max_relative_error: float64
    certificate@truncation_error? certificate@fit_error_bound? certificate@rounding_ratio?: float64
    certificate@check_points certificate@seed certificate@order_bound?: int64
    certificate@exact certificate@exact_bound?: bool
    provenance@mbdlft provenance@casadi provenance@numpy provenance@h5py provenance@created: text
"""
_SYSTEM_1_1 = f"""{_SYSTEM}
    @digest: text
    delta/name delta/kind: text b
    delta/rows delta/columns: int64 b
"""
_MODEL_1_1 = f"""{_SYSTEM_1_1} {_EVIDENCE}
    provenance@scene? certificate@well_posed: text
    provenance/scene: uint8 characters
    certificate/open?: float64 open p 2
    certificate/by_terms?: int64 by_terms 2
    certificate/unmoved?: int64 unmoved 2
    certificate/near?: text near
    certificate/accelerations?: int64 accelerations
    certificate/driven?: int64 driven
    certificate/beside?: int64 beside
    certificate/momenta?: int64 u
    certificate/rigid_motions?: int64 y
    certificate/evidence/number certificate/evidence/basis: text evidence
"""
_TRIM_LFT = """
    trim/lft/delta/parameter: int64 tw
    trim/lft/D_zw: float64 tz tw
    trim/lft/D_zu: float64 tz 1
    trim/lft/D_yw: float64 t tw
    trim/lft/D_yu: float64 t 1
"""
_TRIM_BLOCKS = """
    trim/lft/delta/name trim/lft/delta/kind: text tb
    trim/lft/delta/rows trim/lft/delta/columns: int64 tb
"""
_THETA = """
    theta/name theta/unit theta/text: text f
    theta/count: int64 f
    theta/signal theta/argument: text a
    theta/low theta/high: float64 a
    theta/initial: float64 x
    theta/zeta_at_start: float64 f
"""
_TABLES = """
    theta/tables: int64 f
    theta/table/count theta/table/pairs: int64 tables
    theta/table/breakpoint theta/table/value: float64 points
    theta/table/below theta/table/above: float64 tables
    theta/table/slope: float64 pieces 2
"""
_PROGRAM = """
    program/operation: int8 i
    program/left program/right: int64 i
    program/numbers: float64 number
    program/result: int64 result
    program/pivots: int64 pivot 2
"""
_SWEEP = f"""{_SIGNALS}
    @model?: text
    trim/name trim/unit: text t
    samples: float64 N p
    A: float N x x
    B: float N x u
    C: float N y x
    D: float N y u
    trim/value: float N t
    residual: float64 N
    status: int8 N
"""
_SWEEP_1_1 = f"""{_SWEEP}
    @digest: text
    @block_rows: int64
    blocks: uint8 blocks 32
    provenance/scene?: uint8 c
"""
_ANALYSIS = """
    @encoding_type @encoding_version @digest: text
    @model @model_digest @kind @reason: text
    @lower @upper @frequency @work: float64
    @proved?: bool
    worst/name: text p
    worst/value: float64 p
    rates/name?: text r
    rates/value?: float64 r
    sensitivity/name: text q
    sensitivity/value: float64 q
    delta/name delta/kind: text b
    delta/rows delta/columns: int64 b
    delta/real delta/imaginary: float64 e
    leave_out: text o
    fixed?: text fb
    inputs?: text u
    outputs?: text y
    motion?: float64 t d
"""
# proofs: what is optional was in them, and is in the claim or follows from it
_BOXES = """
    boxes@k? boxes@gain? boxes@shift? boxes@slope?: float64
    boxes/log: int64 n
    boxes/inputs?: text u
    boxes/outputs?: text y
"""
_INTERVALS = """
    intervals@k? intervals@beta?: float64
    intervals/low intervals/at intervals/high: float64 i
    intervals/D_real intervals/D_imaginary intervals/G_real intervals/G_imaginary: float64 i m m
    intervals/log?: int64 n
    intervals/fixed?: text if
    intervals/inputs?: text u
    intervals/outputs?: text y
"""
_FORM = """
    form@k? form@gain?: float64
    form@time: float64
    form@degree? form@order?: int64
    form/P: float64 v v
    form/X form/Y: float64 s s
    form/states: float64 fx fx
    form/channels: float64 w
    form/inputs?: text u
    form/outputs?: text y
"""
_POLYNOMIAL = """
    polynomial@degree: int64
    polynomial/orders: int64 pq
    polynomial/V: float64 pv pt
    polynomial/G: float64 pg pp pp
    polynomial/states: float64 px px
"""
_LYAPUNOV = """
    lyapunov/log: int64 n
    lyapunov/degrees: int64 ly lq
    lyapunov/states: float64 ly lx lx
"""
# what a group needs, by type and version: all of "", and of the others what it has the beginning of
_CONDITION = "certificate@condition: float64\ncertificate@sign_changes: int64"
_TRANSFERS = "certificate/frequencies: float64 frequency\ncertificate@transfer_error: float64"
_LFT_PARTS = {**dict.fromkeys(MATRICES, _MATRICES), "sparse": _SPARSE}
_MODEL_PARTS = {
    **_LFT_PARTS,
    **dict.fromkeys(("certificate@condition", "certificate@sign_changes"), _CONDITION),
    **dict.fromkeys(("certificate/frequencies", "certificate@transfer_error"), _TRANSFERS),
    **{"theta/": _THETA, "theta/table": _TABLES, "program/": _PROGRAM},
}
_SWEEP_PARTS = {
    "poles/": "poles/real poles/imaginary: float N x",
    "function/": "function/name: text f\nfunction/value: float N f",
}
_ANALYSIS_PARTS = {
    "boxes": _BOXES,
    "intervals": _INTERVALS,
    "form": _FORM,
    "polynomial": _POLYNOMIAL,
    "lyapunov": _LYAPUNOV,
}
_LAYOUTS: dict[tuple[str, str], dict[str, Layout]] = {
    key: {beginning: _wanted(table) for beginning, table in parts.items()}
    for key, parts in {
        (MODEL_TYPE, FIRST): {
            "": _SYSTEM + _EVIDENCE + "provenance@scene: text",
            "trim/lft/": _TRIM_LFT,
            **_MODEL_PARTS,
        },
        (MODEL_TYPE, VERSION): {"": _MODEL_1_1, "trim/lft/": _TRIM_LFT + _TRIM_BLOCKS, **_MODEL_PARTS},
        (SYSTEM_TYPE, VERSION): {"": _SYSTEM_1_1, **_LFT_PARTS},
        (SWEEP_TYPE, FIRST): {"": _SWEEP, **_SWEEP_PARTS},
        (SWEEP_TYPE, VERSION): {"": _SWEEP_1_1, **_SWEEP_PARTS},
        (ANALYSIS_TYPE, VERSION): {"": _ANALYSIS, **_ANALYSIS_PARTS},
    }.items()
}
# sizes of each item of a row of a sweep, in the order of a row
ROW_SIZES = {
    path: section[path].sizes[1:]
    for path in ROWS
    for section in _LAYOUTS[SWEEP_TYPE, VERSION].values()
    if path in section
}


def encode(kind: str, values: Mapping[str, Any]) -> Items:
    """Items of values by path, of the types of the table; a value that is None is left out."""
    layout = {path: w for section in _LAYOUTS[kind, VERSION].values() for path, w in section.items()}
    values = {"@encoding_type": kind, "@encoding_version": VERSION, **values}
    return {path: _item(path, layout[path], value) for path, value in values.items() if value is not None}


def _item(path: str, wanted: Wanted, value: Any) -> NDArray[Any]:
    if wanted.type == TEXT:
        return text(value) if isinstance(value, str) else texts(list(value))
    if isinstance(value, str):  # a long one: its bytes, as attributes have no room for it
        return np.frombuffer(text(value).tobytes() if value else b"", dtype=np.uint8)
    array = np.asarray(value)
    if array.dtype.kind == "c":
        raise ArchiveError(f"{path} has an entry that is complex, and archives hold real entries.")
    sizes = wanted.sizes[array.ndim :]
    if array.size == 0 and sizes:  # nested sequences that are empty have no inner sizes
        array = array.reshape(*array.shape, *(int(n) if n.isdecimal() else 0 for n in sizes))
    code = _CODES[_FLOATS[0] if wanted.type == "float" else wanted.type]
    return np.array(array, dtype=f"<{code}", order="C")


def with_digest(items: Items) -> Items:
    """The items, with the digest of their content."""
    return {**items, DIGEST: text(digest(items))}


def of_fields(group: str, kind: str, owner: Any, left_out: Sequence[str] = ()) -> dict[str, Any]:
    """Values by path of the fields of an object: those items of a group that have their names."""
    values = {}
    for path in dict.fromkeys(p for section in _LAYOUTS[kind, VERSION].values() for p in section):
        name = re.split("[@/]", path)[-1]
        if path not in left_out and path.removesuffix(name)[:-1] == group and hasattr(owner, name):
            values[path] = getattr(owner, name)
    return values


def columns(group: str, names: Iterable[str], rows: Sequence[Any]) -> dict[str, Any]:
    """Values by path of some fields of several objects: an item for each field."""
    return {f"{group}/{name}": [getattr(row, name) for row in rows] for name in names}


def rows_of(items: Items, group: str, names: Iterable[str]) -> list[tuple[Any, ...]]:
    """The way back from `columns`: of each object the texts, numbers and lists of these fields."""
    fields_of_all = (
        words(items, path) if items[path].dtype.kind == "S" else items[path].tolist()
        for path in (f"{group}/{name}" for name in names)
    )
    return list(zip(*fields_of_all, strict=True))


def unique_names(items: Items, group: str) -> tuple[str, ...]:
    """The names of a group such as ``states``, each of which occurs once."""
    names = words(items, f"{group}/name")
    if len(set(names)) != len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise ArchiveError(f"{group}/name: {twice!r} stands twice.")
    return names


def record(made: type[Made], items: Items, group: str, **others: Any) -> Made:
    """A dataclass of the items of a group with the names of its fields; `others` are fields by name.

    A field that is neither keeps its default.
    """
    values = dict(others)
    for field in fields(made):  # type: ignore[arg-type]
        for path in (f"{group}/{field.name}".lstrip("/"), f"{group}@{field.name}"):
            if path in items and field.name not in values:
                value = plain(items, path)
                is_tuple = str(field.type).startswith("tuple") and isinstance(value, np.ndarray)
                values[field.name] = nested(value.tolist()) if is_tuple else value
    return made(**values)


def plain(items: Items, path: str) -> Any:
    """An item as a text, a number, a tuple of texts, or an array of numbers."""
    item = items[path]
    if item.dtype.kind == "S":
        entries = words(items, path)
        return entries if item.ndim else entries[0]
    return item if item.ndim else item.item()


def nested(value: Any) -> Any:
    """Tuples in place of lists."""
    return tuple(map(nested, value)) if isinstance(value, list) else value


def check_layout(specs: Mapping[str, Spec], kind: str, version: str) -> None:
    """Raise an error unless a group has what a type of this version needs, of types and sizes that agree.

    `specs` are the items of the group; items that the table does not know may have any size.
    """
    if (kind, version) not in _LAYOUTS:
        raise ArchiveError(f"encoding_version is {version}, and {kind!r} exists since {VERSION}.")
    number = specs["A"].type if kind == SWEEP_TYPE and "A" in specs else ""
    number = number if number in _FLOATS else _FLOATS[0]
    sizes = {"1": 1, "2": 2, "3": 3, "32": 32}
    for beginning, layout in _LAYOUTS[kind, version].items():
        if not any(path.startswith(beginning) for path in specs):
            continue
        for path, wanted in layout.items():
            if path not in specs:
                if not wanted.optional:
                    raise ArchiveError(f"is not whole: {_called(path)} is missing.")
                continue
            kind_found, shape = specs[path]
            expected_kind = number if wanted.type == "float" else wanted.type
            if kind_found != expected_kind:
                raise ArchiveError(
                    f"{_called(path)} has the type {kind_found}, expected {expected_kind}."
                )
            if len(shape) == len(wanted.sizes):
                for name, size in zip(wanted.sizes, shape, strict=True):
                    sizes.setdefault(name, size)
            expected = tuple(sizes.get(name, name) for name in wanted.sizes)
            if shape != expected:
                raise ArchiveError(f"{_called(path)} has shape {shape}, expected {expected}.")


def encoding_of(kind: object, version: object, kinds: tuple[str, ...]) -> str:
    """The version by whose table a group is read: that of its own, or the newest that is known here."""
    if kind not in kinds:
        expected = " or ".join(map(repr, kinds))
        raise ArchiveError(f"encoding_type is {kind!r}, expected {expected}.")
    major, _, minor = version.partition(".") if isinstance(version, str) else ("", "", "")
    if not (major.isdecimal() and minor.isdecimal() and len(major) + len(minor) < 9):
        raise ArchiveError(f"encoding_version is {version!r}, expected {VERSION!r}.")
    if int(major) > 1:
        raise ArchiveError(f"encoding_version is {version}, this mbdlft reads up to {VERSION}.")
    return FIRST if (int(major), int(minor)) == (1, 0) else VERSION


def _called(path: str) -> str:
    """A path in words."""
    group, at, name = path.partition("@")
    if not at:
        return f"the dataset '{path}'"
    return f"the attribute '{name}'" + (f" of '{group}'" if group else "")


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
    content = hashlib.sha256()
    for path in sorted(items, key=str.encode):
        if path == DIGEST or path in left_out:
            continue
        values = items[path]
        for word_of_head in (path, type_name(values), ",".join(map(str, values.shape))):
            content.update(word_of_head.encode() + b"\0")
        if values.dtype.kind == "S":
            content.update(b"".join(text + b"\0" for text in values.ravel().tolist()))
        else:
            content.update(values.astype(values.dtype.newbyteorder("<"), copy=False).tobytes())
    return content.hexdigest()


def check_digest(items: Items, left_out: Sequence[str] = ()) -> None:
    """Raise an ArchiveError unless the digest of a group is that of its items: as it was written."""
    stored, computed = word(items, DIGEST), digest(items, left_out)
    if stored != computed:
        raise ArchiveError(
            f"is damaged or was changed: its digest is {stored!r}, that of its content {computed!r}. "
            "Write it again, or take it from a backup; a tool that changes an item writes the new digest."
        )


def texts(values: Sequence[str]) -> NDArray[Any]:
    """An item (n,) of texts, as long as the longest; one that is not UTF-8 is an ArchiveError."""
    encoded = [_encoded(value) for value in values]
    return np.array(encoded, dtype=f"S{max([1, *map(len, encoded)])}")


def text(value: str) -> NDArray[Any]:
    """An item without axes that is one text; errors as those of `texts`."""
    return texts([value]).reshape(())


def _encoded(value: str) -> bytes:
    try:
        encoded = value.encode("utf-8")
    except UnicodeEncodeError:
        encoded = b"\0"
    if b"\0" in encoded:
        raise ArchiveError(f"the text {value[:60]!r} is not UTF-8, or has a zero byte.")
    return encoded


def words(items: Items, path: str) -> tuple[str, ...]:
    """The texts of an item; one that is not UTF-8 is an ArchiveError."""
    try:
        return tuple(entry.decode("utf-8") for entry in items[path].ravel().tolist())
    except UnicodeDecodeError as error:
        raise ArchiveError(f"{path} is not UTF-8 text: {error}.") from None


def word(items: Items, path: str, default: str = "") -> str:
    """The text of an item without axes, or the default if there is none."""
    return words(items, path)[0] if path in items else default


def long_text(items: Items, path: str, first: str) -> str:
    """A text that is stored as bytes at a path, or, in the first files, as the attribute `first`."""
    if path not in items:
        return word(items, first)
    try:
        return items[path].tobytes().decode("utf-8")
    except UnicodeDecodeError as error:
        raise ArchiveError(f"{path} is not UTF-8 text: {error}.") from None
