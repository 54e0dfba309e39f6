"""The items of a group: arrays by path, their digest, and what docs/archive-format.md lists, as tables.

The path of a dataset is that below its group, such as ``states/name``; that of an attribute has the name
after ``@``, such as ``certificate@exact``, or ``@encoding_type`` for one of the group itself. Numbers are
little-endian; texts are arrays of UTF-8 bytes (dtype S), and a scalar is an array without axes. Type and
sizes of each item are compared with the tables before a number in it is read.
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


MODEL_TYPE, SYSTEM_TYPE, SWEEP_TYPE, ANALYSIS_TYPE = "lft-model", "system", "sweep", "analysis"
VERSION, FIRST = "1.1", "1.0"


class Wanted(NamedTuple):
    """Type of an item, the names of its sizes, and whether it may be missing."""

    type: str
    sizes: tuple[str, ...]
    optional: bool = False


Layout = dict[str, Wanted]


def _wanted(*lines: str) -> Layout:
    """Lines of paths with ``: type, sizes``; a path that ends in ``?`` may be missing."""
    layout = {}
    for line in lines:
        paths, _, rest = line.partition(": ")
        kind, *sizes = rest.split()
        for path in paths.split():
            layout[path.rstrip("?")] = Wanted(kind, tuple(sizes), path.endswith("?"))
    return layout


_ENCODING = _wanted("@encoding_type @encoding_version: text")
_SIGNALS = _wanted(
    "states/name states/unit: text x",
    "inputs/name inputs/unit: text u",
    "outputs/name outputs/unit: text y",
    "parameters/name parameters/unit: text p",
)
_SYSTEM = {
    **_ENCODING,
    **_wanted("@time_domain @description?: text"),
    **_SIGNALS,
    **_wanted(
        "delta/parameter: int64 w",
        "parameters/role parameters/substitution: text p",
        "parameters/nominal parameters/low parameters/high parameters/reference: float64 p",
        "parameters/map: float64 p 3",
        "A: float64 x x",
        "B_w: float64 x w",
        "B_u: float64 x u",
        "C_z: float64 z x",
        "D_zw: float64 z w",
        "D_zu: float64 z u",
        "C_y: float64 y x",
        "D_yw: float64 y w",
        "D_yu: float64 y u",
    ),
}
_BLOCKS = ("delta/name delta/kind: text b", "delta/rows delta/columns: int64 b")
_TRIM_BLOCKS = tuple(line.replace("delta/", "trim/lft/delta/")[:-1] + "tb" for line in _BLOCKS)
_TRIM_LFT = _wanted(
    "trim/lft/delta/parameter: int64 tw",
    "trim/lft/D_zw: float64 tz tw",
    "trim/lft/D_zu: float64 tz 1",
    "trim/lft/D_yw: float64 t tw",
    "trim/lft/D_yu: float64 t 1",
)
_EVIDENCE = {
    **_wanted(
        "trim/name trim/unit: text t",
        "trim/nominal: float64 t",
        "certificate/order certificate/lower_bound certificate/raw_order: int64 p",
        "certificate/doubtful?: int64 p",
        "certificate@max_relative_error: float64",
        "certificate@truncation_error? certificate@fit_error_bound? certificate@condition?: float64",
        "certificate@check_points certificate@seed: int64",
        "certificate@order_bound? certificate@sign_changes?: int64",
        "certificate@exact certificate@exact_bound?: bool",
        "provenance@mbdlft provenance@casadi provenance@numpy provenance@h5py: text",
        "provenance@created: text",
    ),
}
_FIRST_MODEL = {**_SYSTEM, **_EVIDENCE, **_wanted("provenance@scene: text")}
_DIGEST = _wanted(f"{DIGEST}: text")
_SYSTEM_1_1 = {**_SYSTEM, **_wanted(*_BLOCKS), **_DIGEST}
_MODEL_1_1 = {
    **_SYSTEM_1_1,
    **_EVIDENCE,
    **_wanted(
        "provenance/scene: uint8 characters",
        "certificate@well_posed: text",
        "certificate/open?: float64 open p 2",
        "certificate@transfer_error?: float64",
        "certificate/frequencies?: float64 frequency",
        "certificate/by_terms?: int64 by_terms 2",
        "certificate/near?: text near",
        "certificate/evidence/number certificate/evidence/basis: text evidence",
    ),
}
THETA = _wanted(
    "theta/name theta/unit theta/text: text f",
    "theta/count: int64 f",
    "theta/signal theta/argument: text a",
    "theta/low theta/high: float64 a",
    "theta/initial: float64 x",
    "theta/zeta_at_start: float64 f",
)
TABLES = _wanted(
    "theta/tables: int64 f",
    "theta/table/count theta/table/pairs: int64 tables",
    "theta/table/breakpoint theta/table/value: float64 points",
    "theta/table/below theta/table/above: float64 tables",
    "theta/table/slope: float64 pieces 2",
)
PROGRAM = _wanted(
    "program/operation: int8 i",
    "program/left program/right: int64 i",
    "program/numbers: float64 number",
    "program/result: int64 result",
    "program/pivots: int64 pivot 2",
)
ROWS = (
    *("samples", "A", "B", "C", "D", "trim/value", "residual", "status"),
    *("poles/real", "poles/imaginary", "function/value"),
)
_SWEEP = {
    **_ENCODING,
    **_SIGNALS,
    **_wanted(
        "@model?: text",
        "trim/name trim/unit: text t",
        "samples: float64 N p",
        "A: float N x x",
        "B: float N x u",
        "C: float N y x",
        "D: float N y u",
        "trim/value: float N t",
        "residual: float64 N",
        "status: int8 N",
    ),
}
_FLOATS = (
    "float64",
    "float32",
)  # where a layout says float; all such items of a group have one type
_POLES = _wanted("poles/real poles/imaginary: float N x")
_FUNCTION = _wanted("function/name: text f", "function/value: float N f")
BLOCK_ROWS = "@block_rows"
_SWEEP_1_1 = {
    **_SWEEP,
    **_wanted(f"{BLOCK_ROWS}: int64", "blocks: uint8 blocks 32", "provenance/scene?: uint8 c"),
    **_DIGEST,
}
_ANALYSIS = {
    **_ENCODING,
    **_DIGEST,
    **_wanted(
        "@model @model_digest @kind @reason: text",
        "@lower @upper @frequency @work: float64",
        "@proved: bool",
        "worst/name: text p",
        "worst/value: float64 p",
        "delta/name delta/kind: text b",
        "delta/rows delta/columns: int64 b",
        "delta/real delta/imaginary: float64 e",
        "sensitivity/name: text q",
        "sensitivity/value: float64 q",
        "leave_out: text o",
        "boxes@k? boxes@gain? boxes@shift? boxes@slope?: float64",
        "boxes/log?: int64 n",
        "boxes/inputs?: text u",
        "boxes/outputs?: text y",
        "intervals@beta?: float64",
        "intervals/low? intervals/at? intervals/high?: float64 i",
        "intervals/D_real? intervals/D_imaginary?: float64 i m m",
        "intervals/G_real? intervals/G_imaginary?: float64 i m m",
        "rates/name?: text r",
        "rates/value?: float64 r",
        "motion?: float64 t d",
        "form@k? form@gain? form@time?: float64",
        "form/P?: float64 v v",
        "form/X? form/Y?: float64 s s",
        "form/states?: float64 x x",
        "form/channels?: float64 w",
        "form/inputs?: text fu",
        "form/outputs?: text fy",
    ),
}
_LAYOUTS = {
    (ANALYSIS_TYPE, VERSION): _ANALYSIS,
    (MODEL_TYPE, FIRST): _FIRST_MODEL,
    (MODEL_TYPE, VERSION): _MODEL_1_1,
    (SYSTEM_TYPE, VERSION): _SYSTEM_1_1,
    (SWEEP_TYPE, FIRST): _SWEEP,
    (SWEEP_TYPE, VERSION): _SWEEP_1_1,
}


def encoding_of(kind: object, version: object, kinds: tuple[str, ...]) -> str:
    """The version by whose layout a group is read: that of its own, or the newest that is known here.

    Raises
    ------
    ArchiveError
        The type is not one of `kinds`, or the version is newer than what can be read.
    """
    if kind not in kinds:
        expected = " or ".join(map(repr, kinds))
        raise ArchiveError(f"encoding_type is {kind!r}, expected {expected}.")
    major, _, minor = version.partition(".") if isinstance(version, str) else ("", "", "")
    if not (major.isdecimal() and minor.isdecimal() and len(major) + len(minor) < 9):
        raise ArchiveError(f"encoding_version is {version!r}, expected {VERSION!r}.")
    if int(major) > 1:
        raise ArchiveError(f"encoding_version is {version}, this mbdlft reads up to {VERSION}.")
    return FIRST if (int(major), int(minor)) == (1, 0) else VERSION


def check_layout(specs: Mapping[str, Spec], kind: str, version: str) -> None:
    """Raise an error unless a group has what a type of this version needs, of types and sizes that agree.

    `specs` are the items of the group; items that the layout does not know may have any size.

    Raises
    ------
    ArchiveError
        Something is missing, or has another type or shape.
    """
    if (kind, version) not in _LAYOUTS:
        raise ArchiveError(f"encoding_version is {version}, and {kind!r} exists since {VERSION}.")
    layout = dict(_LAYOUTS[kind, version])
    if kind == MODEL_TYPE and any(path.startswith("trim/lft/") for path in specs):
        layout |= {**_TRIM_LFT, **(_wanted(*_TRIM_BLOCKS) if version != FIRST else {})}
    if kind == MODEL_TYPE and any(path.startswith("theta/") for path in specs):
        layout |= THETA
        if any(path.startswith("theta/table") for path in specs):
            layout |= TABLES
    if kind == MODEL_TYPE and any(path.startswith("program/") for path in specs):
        layout |= PROGRAM
    if kind == SWEEP_TYPE:
        for name, more in (("poles/", _POLES), ("function/", _FUNCTION)):
            layout |= more if any(path.startswith(name) for path in specs) else {}
    number = specs["A"].type if kind == SWEEP_TYPE and "A" in specs else ""
    number = number if number in _FLOATS else _FLOATS[0]
    sizes = {"1": 1, "2": 2, "3": 3, "32": 32}
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


def _called(path: str) -> str:
    """A path in words."""
    group, at, name = path.partition("@")
    if not at:
        return f"the dataset '{path}'"
    return f"the attribute '{name}'" + (f" of '{group}'" if group else "")
