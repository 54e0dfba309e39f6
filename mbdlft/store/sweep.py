"""Sweeps in an archive: /sweeps/<name>, numeric trims and linearizations of many samples.

A row of a sweep is [samples, A, B, C, D, trim, residual, status], matrices row by row.
"""

import hashlib
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mbdlft.base.array import Array
from mbdlft.base.errors import ArchiveError
from mbdlft.base.signal import Signal
from mbdlft.store.archive import LIMIT, check_name, names_in, read_one, rewrite
from mbdlft.store.copying import write_items
from mbdlft.store.hdf5 import Part
from mbdlft.store.helper import Request, said_of
from mbdlft.store.items import DIGEST, Items, check_digest, digest, text, texts, word
from mbdlft.store.layout import BLOCK_ROWS, ROWS, SWEEP_TYPE, VERSION
from mbdlft.store.model import characters, signals_of

SOLVED, SINGULAR, NO_EQUILIBRIUM = 0, 1, 2
MEANINGS = (
    "0: solved; 1: not converged, the efforts or accelerations cannot be solved for; "
    "2: no equilibrium, the efforts do not hold it"
)
_CHUNK_BYTES, _CHUNK_ROWS = 2**19, 4096
_BLOCK_ROWS = 4096
_MATRICES = ("A", "B", "C", "D")
_SIGNALS = ("parameters", "states", "inputs", "outputs", "trim")


@dataclass(frozen=True, slots=True)
class Layout:
    """Names and units of the numbers in each row of a sweep."""

    parameters: tuple[Signal, ...]
    states: tuple[Signal, ...]
    inputs: tuple[Signal, ...]
    outputs: tuple[Signal, ...]
    trim: tuple[Signal, ...]

    @property
    def matrix_shape(self) -> tuple[int, int]:
        """Shape of [A B ; C D]."""
        return (
            len(self.states) + len(self.outputs),
            len(self.states) + len(self.inputs),
        )

    @property
    def shapes(self) -> dict[str, tuple[int, ...]]:
        """Shape of each dataset in one sample, in the order of a row."""
        x, u, y = len(self.states), len(self.inputs), len(self.outputs)
        return {
            "samples": (len(self.parameters),),
            "A": (x, x),
            "B": (x, u),
            "C": (y, x),
            "D": (y, u),
            "trim/value": (len(self.trim),),
            "residual": (),
            "status": (),
        }

    @property
    def width(self) -> int:
        """Number of entries of a row."""
        return sum(int(np.prod(shape)) for shape in self.shapes.values())


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Sweep:
    """Numeric trims and linearizations at N samples; rows that failed are NaN.

    Attributes
    ----------
    name : str
    layout : Layout
        Names and units of parameters, states, inputs, outputs and trimmed efforts.
    samples : array (N, n_p), physical values in the units of the parameters
    A, B, C, D : arrays (N, nx, nx), (N, nx, nu), (N, ny, nx), (N, ny, nu)
    trim : array (N, nt)
    residual : array (N,)
        Residual of the trim, relative to the largest effort; for a model, the error in its certificate.
    status : int8 array (N,)
        0 solved, 1 not converged, 2 no equilibrium.
    model : name of the model in the same archive, or "" for a scene
    """

    name: str
    layout: Layout
    samples: Array
    A: Array
    B: Array
    C: Array
    D: Array
    trim: Array
    residual: Array
    status: NDArray[np.int8]
    model: str


def pack(
    layout: Layout, samples: Array, matrices: Array, trim: Array, residual: Array, status: Array
) -> Array:
    """Rows (N, width) of samples (N, n_p), [A B ; C D] (N, ., .), trim (N, nt), residual, status (N,)."""
    n, count = len(layout.states), len(samples)
    parts = (
        samples,
        matrices[:, :n, :n], matrices[:, :n, n:], matrices[:, n:, :n], matrices[:, n:, n:],
        trim, residual, status,
    )  # fmt: skip
    return np.concatenate([np.asarray(part).reshape(count, -1) for part in parts], axis=1)


def unpack(layout: Layout, rows: Array) -> dict[str, Array]:
    """The datasets (N, ...) by name that rows (N, width) consist of."""
    shapes = layout.shapes
    ends = np.cumsum([0, *(int(np.prod(shape)) for shape in shapes.values())])
    return {
        name: rows[:, start:stop].reshape(len(rows), *shape)
        for (name, shape), (start, stop) in zip(shapes.items(), pairwise(ends), strict=True)
    }


def save_sweep(
    path: str | Path,
    name: str,
    layout: Layout,
    count: int,
    parts: Iterable[Array],
    *,
    model: str = "",
    scene: str = "",
    beside: Path | None = None,
) -> None:
    """Write a sweep of `count` rows, which come in parts (n, width), into an archive.

    The other contents of the file stay; a sweep of this name is replaced. One part at a time is in
    memory. The new file is in the folder `beside` until it is complete, so that the archive is complete
    or unchanged.

    Raises
    ------
    ArchiveError
        The parts do not have `count` rows, or `save` would raise an error.
    """
    file = Path(path)
    check_name(file, "sweep", name)
    try:
        items = _head(layout, model, scene)
    except ArchiveError as error:
        raise ArchiveError(f"{file}: {said_of(f'sweep {name!r}', str(error))}") from None

    def fill(archive: Any) -> None:
        group = archive.require_group("sweeps").create_group(name)
        _make_rows(group, layout, count)
        kind = text(MEANINGS)
        write_items(group["status"], {"@meaning": kind})
        items["status@meaning"] = kind
        blocks, start = _Blocks(), 0
        for part in parts:
            for key, values in unpack(layout, part).items():
                if values.size:
                    group[key][start : start + len(part)] = values
            blocks.add(part)
            start += len(part)
        if start != count:
            raise ArchiveError(f"{file}: sweep {name!r}: expected {count} rows, got {start}.")
        items["blocks"] = blocks.digests()
        items[DIGEST] = text(digest(items))
        del items["status@meaning"]
        write_items(group, items)

    rewrite(file, fill, f"sweeps/{name}", large=True, beside=beside)


def _head(layout: Layout, model: str, scene: str) -> Items:
    """All items of a sweep but its rows."""
    items: Items = {"@encoding_type": text(SWEEP_TYPE), "@encoding_version": text(VERSION)}
    items[BLOCK_ROWS] = np.array(_BLOCK_ROWS, dtype="<i8")
    if model:
        items["@model"] = text(model)
    if scene:
        items["provenance/scene"] = characters(scene)
    for what in _SIGNALS:
        items[f"{what}/name"] = texts([signal.name for signal in getattr(layout, what)])
        items[f"{what}/unit"] = texts([signal.unit for signal in getattr(layout, what)])
    return items


def _make_rows(group: Any, layout: Layout, count: int) -> None:
    """The empty datasets of `count` rows."""
    for key, shape in layout.shapes.items():
        kind = "i1" if key == "status" else "<f8"
        size = max(1, int(np.prod(shape))) * np.dtype(kind).itemsize
        rows = max(1, min(count, _CHUNK_ROWS, _CHUNK_BYTES // size))
        chunks = (rows, *shape) if all(shape) else None
        group.create_dataset(
            key, (count, *shape), dtype=kind, chunks=chunks, fletcher32=chunks is not None
        )


class _Blocks:
    """The SHA-256 of each block of rows, which come in parts."""

    def __init__(self) -> None:
        self._done: list[bytes] = []
        self._open, self._rows = hashlib.sha256(), 0

    def add(self, rows: Array) -> None:
        """Take the next rows (n, width)."""
        while len(rows):
            part = rows[: _BLOCK_ROWS - self._rows]
            self._open.update(part.astype("<f8").tobytes())
            self._rows += len(part)
            rows = rows[len(part) :]
            if self._rows == _BLOCK_ROWS:
                self._done.append(self._open.digest())
                self._open, self._rows = hashlib.sha256(), 0

    def digests(self) -> NDArray[np.uint8]:
        """One digest (32,) for each block."""
        done = [*self._done, *([self._open.digest()] if self._rows else [])]
        return np.frombuffer(b"".join(done), dtype=np.uint8).reshape(-1, 32)


def sweep_names(path: str | Path) -> tuple[str, ...]:
    """Names of the sweeps in an archive, sorted.

    Parameters
    ----------
    path : file

    Raises
    ------
    ArchiveError
        The file is missing, truncated, foreign or newer.
    """
    return names_in(Path(path), "sweeps")


def load_sweep(
    path: str | Path,
    name: str | None = None,
    start: int | None = 0,
    stop: int | None = None,
    *,
    limit: int = LIMIT,
    isolated: bool = False,
) -> Sweep:
    """Read a sweep, or some of its rows, from an archive.

    Parameters
    ----------
    path : file
    name : str, optional
        May be left out if the archive has one sweep.
    start, stop : int
        The rows to read, as in a slice; by default all.
    limit, isolated : as in `load`

    Returns
    -------
    Sweep

    Raises
    ------
    ArchiveError
        The file is missing, truncated, changed, foreign or newer, or the sweep is missing or incomplete.
    """

    def make(part: Part, key: str) -> Sweep:
        _check_blocks(part.items, part.first, part.total)
        first, last, _ = slice(start, stop).indices(part.total)
        rows = slice(first - part.first, max(first, last) - part.first)
        return _sweep(part.items, key, rows)

    request = Request("read", "sweeps", "sweep", name, (SWEEP_TYPE,), limit, start, stop)
    return read_one(Path(path), request, make, isolated=isolated)


def _check_blocks(items: Items, first: int, count: int) -> None:
    """Raise an ArchiveError unless the digests are those of what was read; the first files have none."""
    if word(items, "@encoding_version") == "1.0":
        return
    check_digest(items, ROWS)
    size = int(items[BLOCK_ROWS])
    wanted = items["blocks"]
    if len(wanted) != -(-count // size):
        raise ArchiveError(f"blocks: expected {-(-count // size)} digests, got {len(wanted)}.")
    read = len(items["status"])
    parts = [np.asarray(items[key]).reshape(read, -1).astype("<f8") for key in ROWS]
    rows = np.concatenate(parts, axis=1)
    for start in range(0, read, size):
        found = hashlib.sha256(rows[start : start + size].tobytes()).digest()
        if found != wanted[(first + start) // size].tobytes():
            raise ArchiveError(
                f"is damaged or was changed: rows {first + start} to "
                f"{min(first + start + size, first + read) - 1} do not have their digest. Write it "
                "again, or take it from a backup."
            )


def _sweep(items: Items, name: str, rows: slice) -> Sweep:
    """Some of the rows that were read."""
    layout = Layout(**{what: signals_of(items, what) for what in _SIGNALS})
    status = items["status"]
    if np.any((status < SOLVED) | (status > NO_EQUILIBRIUM)):
        raise ArchiveError("status has a number that means nothing.")
    solved = status == SOLVED
    for key in ROWS[:-1]:
        values = items[key].reshape(len(status), -1)
        good = np.isfinite(values).all(axis=1)
        nothing = np.isnan(values).all(axis=1)
        if not np.all(good if key == "samples" else np.where(solved, good, nothing)):
            raise ArchiveError(
                f"{key} does not agree with status: rows that are solved have numbers, others NaN."
            )
    chosen = {key: items[key][rows] for key in ROWS}
    return Sweep(
        name=name,
        layout=layout,
        samples=chosen["samples"],
        trim=chosen["trim/value"],
        residual=chosen["residual"],
        status=chosen["status"],
        model=word(items, "@model"),
        **{key: chosen[key] for key in _MATRICES},
    )
