"""Sweeps in an archive: /sweeps/<name>, numeric trims and linearizations of many samples.

A row of a sweep is [samples, A, B, C, D, trim, residual, status, poles, values of functions], matrices
row by row. Each number has its place in the file before any is known: the datasets are made empty, their
chunks one behind the other, and rows are then written to their places, by any process and in any order;
HDF5 is not needed for that. So what is computed is written once. Behind each block of rows is a SHA-256.
"""

import errno
import hashlib
import os
import shutil
from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from h5py import h5d, h5p, h5s, h5t
from numpy.typing import NDArray

from mbdlft.archive import layout as layouts
from mbdlft.archive.archive import LIMIT, check_name, names_in, naming, read_one, rewrite
from mbdlft.archive.hdf5 import Part, Request, write_items
from mbdlft.archive.model import signal_values, signals_of
from mbdlft.base.arguments import arguments_checked
from mbdlft.base.array import Array
from mbdlft.base.errors import ArchiveError
from mbdlft.base.unit import Signal

SOLVED, SINGULAR, NO_EQUILIBRIUM, FUNCTION_FAILED = 0, 1, 2, 3
_CHUNK_BYTES, _CHUNK_ROWS = 2**19, 4096  # a chunk fits into the cache of HDF5 (1 MB)
GROUP = "mbdlft rows of an unfinished sweep"  # in the root, until it has its name
_WHOLE = ("samples", "residual", "status")  # never in single precision
_KINDS = {"<f8": h5t.IEEE_F64LE, "<f4": h5t.IEEE_F32LE, "i1": h5t.STD_I8LE}


@dataclass(frozen=True, slots=True)
class Layout:
    """Names and units of the numbers in each row of a sweep."""

    parameters: tuple[Signal, ...]
    states: tuple[Signal, ...]
    inputs: tuple[Signal, ...]
    outputs: tuple[Signal, ...]
    trim: tuple[Signal, ...]
    poles: bool = False  # whether there are the eigenvalues of A
    functions: tuple[str, ...] = ()  # names of numbers that a function of the user has computed
    single: bool = False  # whether matrices, trim, poles and these numbers are in single precision

    @property
    def matrix_shape(self) -> tuple[int, int]:
        """Shape of [A B ; C D]."""
        return (len(self.states) + len(self.outputs), len(self.states) + len(self.inputs))

    def parts(self, matrices: Array) -> dict[str, Array]:
        """A, B, C, D (N, ., .) by name, of [A B ; C D] (N, ., .): views of them."""
        n = len(self.states)
        above, below = matrices[:, :n], matrices[:, n:]
        return {"A": above[:, :, :n], "B": above[:, :, n:], "C": below[:, :, :n], "D": below[:, :, n:]}

    @property
    def shapes(self) -> dict[str, tuple[int, ...]]:
        """Shape of each dataset in one sample, in the order of a row."""
        signals = (self.parameters, self.states, self.inputs, self.outputs, self.trim, self.functions)
        sizes = dict(zip("pxuytf", map(len, signals), strict=True))
        left_out = ("poles/",) * (not self.poles) + ("function/",) * (not self.functions)
        return {
            path: tuple(sizes[name] for name in names)
            for path, names in layouts.ROW_SIZES.items()
            if not path.startswith(left_out)
        }

    @property
    def kinds(self) -> dict[str, str]:
        """Type of each dataset."""
        kind = "<f4" if self.single else "<f8"
        kinds = {key: "<f8" if key in _WHOLE else kind for key in self.shapes}
        return kinds | {"status": "i1"}

    @property
    def width(self) -> int:
        """Number of entries of a row."""
        return sum(int(np.prod(shape)) for shape in self.shapes.values())


def unpack(layout: Layout, rows: Array) -> dict[str, Array]:
    """The datasets (N, ...) by name that rows (N, width) consist of: views of them."""
    shapes = layout.shapes
    ends = np.cumsum([0, *(int(np.prod(shape)) for shape in shapes.values())])
    return {
        name: rows[:, start:stop].reshape(len(rows), *shape)
        for (name, shape), (start, stop) in zip(shapes.items(), pairwise(ends), strict=True)
    }


def pack(layout: Layout, datasets: Mapping[str, Array], rows: Array) -> None:
    """Write datasets (N, ...) by name into rows (N, width), as they will be read."""
    kinds = layout.kinds
    for key, place in unpack(layout, rows).items():
        values = np.asarray(datasets[key])
        if kinds[key] != "<f4":
            place[...] = values
            continue
        with np.errstate(over="ignore"):
            place[...] = values.astype("<f4")
        large = np.isinf(place) & np.isfinite(values)
        if np.any(large):
            raise ArchiveError(
                f"{key} has the number {values[large][0]:g}, and single precision ends at 3.4e38. Store "
                "the sweep in double precision."
            )


def digests_of(rows: Array, block_rows: int) -> NDArray[np.uint8]:
    """The SHA-256 (., 32) of each block of rows (N, width)."""
    whole = np.ascontiguousarray(rows, dtype="<f8")
    digests = [
        hashlib.sha256(whole[start : start + block_rows].data).digest()
        for start in range(0, len(whole), block_rows)
    ]
    return np.frombuffer(b"".join(digests), dtype=np.uint8).reshape(-1, 32)


@dataclass(frozen=True, slots=True)
class Places:
    """Where the rows of a sweep are in its file."""

    layout: Layout
    count: int  # of rows
    starts: dict[str, int]  # bytes before the first row of each dataset that has numbers
    sizes: dict[str, int]  # bytes of each of these datasets

    def write(self, file: Path, first: int, rows: Array) -> None:
        """Write rows (n, width), of which the first has the number `first`, to their places."""
        kinds = self.layout.kinds
        with file.open("r+b", buffering=0) as stream:
            for key, values in unpack(self.layout, rows).items():
                if key in self.starts:
                    data = np.ascontiguousarray(values, dtype=kinds[key])
                    stream.seek(self.starts[key] + first * (data.nbytes // len(rows)))
                    _put(stream, data.reshape(-1).data.cast("B"))

    def read(self, file: Path, first: int, count: int) -> Array:
        """The rows (n, width) of these numbers; zeros where the file has none yet."""
        rows = np.empty((count, self.layout.width))
        kinds = self.layout.kinds
        with file.open("rb", buffering=0) as stream:
            for key, place in unpack(self.layout, rows).items():
                if key in self.starts:
                    size = place[:1].size * np.dtype(kinds[key]).itemsize
                    stream.seek(self.starts[key] + first * size)
                    data = stream.read(count * size)
                    place[...] = np.frombuffer(data, dtype=kinds[key]).reshape(place.shape)
        return rows

    def statuses(self, file: Path) -> NDArray[np.int8]:
        """The status of all rows (N,)."""
        return np.fromfile(file, dtype="i1", count=self.count, offset=self.starts["status"])


def _put(stream: Any, data: memoryview) -> None:
    while data:  # the system may take a part
        data = data[stream.write(data) :]


def make_rows(file: Path, layout: Layout, count: int) -> Places:
    """Make a file with the empty datasets of a sweep: as large as it will be, but nothing is written."""
    with h5py.File(file, "w", libver=("v110", "v110")) as new:
        group = new.create_group(GROUP)
        for key, shape in layout.shapes.items():
            parent, _, leaf = key.rpartition("/")
            kind = layout.kinds[key]
            how = h5p.create(h5p.DATASET_CREATE)
            rows = _rows_of_chunk(layout, key, count)
            if rows:
                how.set_chunk((rows, *shape))
                how.set_alloc_time(h5d.ALLOC_TIME_EARLY)
                how.set_fill_time(h5d.FILL_TIME_NEVER)
            owner = group.require_group(parent) if parent else group
            space = h5s.create_simple((count, *shape))
            h5d.create(owner.id, leaf.encode(), _KINDS[kind], space, how)
    return places_in(file, layout, count)


def _rows_of_chunk(layout: Layout, key: str, count: int) -> int:
    """Rows of a chunk; 0 for a dataset without numbers."""
    size = _row_bytes(layout, key)
    return max(1, min(count, _CHUNK_ROWS, _CHUNK_BYTES // size)) if size else 0


def check_room(folder: Path, layout: Layout, count: int) -> None:
    """Raise an OSError if the disk cannot hold these rows: their file would fill it."""
    size = count * sum(_row_bytes(layout, key) for key in layout.shapes)
    free = shutil.disk_usage(folder).free
    if size > free:
        raise OSError(errno.ENOSPC, f"it needs {size} bytes, and the disk has {free}")


def _row_bytes(layout: Layout, key: str) -> int:
    return int(np.prod(layout.shapes[key])) * np.dtype(layout.kinds[key]).itemsize


def places_in(file: Path, layout: Layout, count: int) -> Places:
    """Where the rows are in a file that `make_rows` has made."""
    starts, sizes = dict[str, int](), dict[str, int]()
    with h5py.File(file, "r") as archive:
        group = archive[GROUP]
        for key in layout.shapes:
            rows = _rows_of_chunk(layout, key, count)
            if not rows:
                continue
            chunks, size = -(-count // rows), rows * _row_bytes(layout, key)
            ends = [group[key].id.get_chunk_info(k).byte_offset for k in (0, chunks - 1)]
            if None in ends or ends[1] - ends[0] != (chunks - 1) * size:
                raise ArchiveError(f"{file}: chunks of {key} are not one behind the other.")
            starts[key], sizes[key] = ends[0], chunks * size
    return Places(layout, count, starts, sizes)


def reserve(file: Path) -> None:
    """Have the system reserve the disk for a whole file: rows are then written five times as fast."""
    if not hasattr(os, "posix_fallocate"):
        return
    with file.open("r+b") as stream:
        try:
            os.posix_fallocate(stream.fileno(), 0, file.stat().st_size)
        except OSError as error:
            if error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG):
                raise  # other systems of files cannot do it


def restore(file: Path, fresh: Path, places: Places) -> None:
    """Give a file of rows all that is not rows anew, from a fresh one: a writer was killed over it."""
    size = fresh.stat().st_size
    with fresh.open("rb") as new, file.open("r+b") as old:
        old.truncate(size)
        end = 0
        for key in sorted(places.starts, key=places.starts.__getitem__):
            _copy(new, old, end, places.starts[key])
            end = places.starts[key] + places.sizes[key]
        _copy(new, old, end, size)


def _copy(new: Any, old: Any, start: int, stop: int) -> None:
    new.seek(start)
    old.seek(start)
    old.write(new.read(stop - start))


MEANINGS = (
    "0: solved; 1: not converged, the efforts or accelerations cannot be solved for; "
    "2: no equilibrium, the efforts do not hold it"
)
_FUNCTION_MEANING = "; 3: solved, but the function of the user failed"
_MATRICES = ("A", "B", "C", "D")
_SIGNALS = ("parameters", "states", "inputs", "outputs", "trim")
_OF_FUNCTION = "function/value"


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
        0 solved, 1 not converged, 2 no equilibrium, 3 solved, but the function of the user failed.
    model : name of the model in the same archive, or "" for a scene
    poles : complex array (N, nx), or None
        Eigenvalues of A, sorted by their real, then their imaginary parts.
    values : mapping of names to arrays (N,)
        What the function of the user has computed.
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
    poles: NDArray[np.complex128] | None = None
    values: Mapping[str, Array] = field(default_factory=dict)


def finish_sweep(
    path: str | Path,
    name: str,
    layout: Layout,
    rows: Path,
    blocks: NDArray[np.uint8],
    block_rows: int,
    *,
    model: str = "",
    scene: str = "",
) -> None:
    """Make an archive of a file of rows (`make_rows`), and put it in place of an archive.

    Other contents of the archive stay. The file of `rows`, on the same disk, is moved; `blocks` (., 32)
    are the SHA-256 of each `block_rows` rows.
    """
    file = Path(path)
    check_name(file, "sweep", name)
    values: dict[str, Any] = {"@model": model or None, "provenance/scene": scene or None}
    for what in _SIGNALS:
        values |= signal_values(what, getattr(layout, what))
    values |= {
        "function/name": layout.functions or None,
        layouts.BLOCK_ROWS: block_rows,
        "blocks": blocks,
    }
    meaning = layouts.text(MEANINGS + _FUNCTION_MEANING * bool(layout.functions))
    with naming(file, f"sweep {name!r}"):
        items = layouts.encode(layouts.SWEEP_TYPE, values)
    items[layouts.DIGEST] = layouts.text(layouts.digest({**items, "status@meaning": meaning}))

    def fill(archive: Any) -> None:
        archive.require_group("sweeps")
        archive.move(GROUP, f"sweeps/{name}")
        group = archive["sweeps"][name]
        write_items(group["status"], {"@meaning": meaning})
        write_items(group, items)

    rewrite(file, fill, f"sweeps/{name}", made=rows)


@arguments_checked
def sweep_names(path: str | Path) -> tuple[str, ...]:
    """Names of the sweeps in the archive at `path`, sorted."""
    return names_in(Path(path), "sweeps")


@arguments_checked
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
    """

    def make(part: Part, key: str) -> Sweep:
        _check_blocks(part.items, part.first, part.total)
        first, last, _ = slice(start, stop).indices(part.total)
        rows = slice(first - part.first, max(first, last) - part.first)
        return _sweep(part.items, key, rows)

    request = Request("read", "sweeps", "sweep", name, (layouts.SWEEP_TYPE,), limit, start, stop)
    return read_one(Path(path), request, make, isolated=isolated)


def _check_blocks(items: layouts.Items, first: int, count: int) -> None:
    """Raise an ArchiveError unless the digests are those of what was read; the first files have none."""
    if layouts.word(items, "@encoding_version") == layouts.FIRST:
        return
    layouts.check_digest(items, layouts.ROWS)
    size = int(items[layouts.BLOCK_ROWS])
    wanted = items["blocks"]
    if len(wanted) != -(-count // size):
        raise ArchiveError(f"blocks: expected {-(-count // size)} digests, got {len(wanted)}.")
    read, keys = len(items["status"]), [key for key in layouts.ROWS if key in items]
    arrays = [np.asarray(items[key]).reshape(read, -1).astype("<f8") for key in keys]
    rows = np.concatenate(arrays, axis=1)
    for start, computed in zip(range(0, read, size), digests_of(rows, size), strict=True):
        if not np.array_equal(computed, wanted[(first + start) // size]):
            raise ArchiveError(
                f"is damaged or was changed: rows {first + start} to "
                f"{min(first + start + size, first + read) - 1} do not have their digest. Write it "
                "again, or take it from a backup."
            )


def _sweep(items: layouts.Items, name: str, rows: slice) -> Sweep:
    """Some of the rows that were read."""
    layout = Layout(
        **{what: signals_of(items, what) for what in _SIGNALS},
        poles="poles/real" in items,
        functions=layouts.words(items, "function/name") if _OF_FUNCTION in items else (),
        single=items["A"].dtype.itemsize == 4,
    )
    status = items["status"]
    last = FUNCTION_FAILED if layout.functions else NO_EQUILIBRIUM
    if np.any((status < SOLVED) | (status > last)):
        raise ArchiveError("status has a number that means nothing.")
    for key in layout.shapes:
        if key == "status":
            continue
        values = items[key].reshape(len(status), -1)
        good = np.isfinite(values).all(axis=1)
        nothing = np.isnan(values).all(axis=1)
        solved = (status == SOLVED) | ((status == FUNCTION_FAILED) & (key != _OF_FUNCTION))
        if not np.all(good if key == "samples" else np.where(solved, good, nothing)):
            raise ArchiveError(
                f"{key} does not agree with status: rows that are solved have numbers, others NaN."
            )
    chosen = {key: items[key][rows] for key in layout.shapes}
    functions = chosen[_OF_FUNCTION].T if layout.functions else ()
    poles = chosen["poles/real"] + 1j * chosen["poles/imaginary"] if layout.poles else None
    return Sweep(
        name=name,
        layout=layout,
        samples=chosen["samples"],
        trim=chosen["trim/value"],
        residual=chosen["residual"],
        status=chosen["status"],
        model=layouts.word(items, "@model"),
        poles=poles,
        values=dict(zip(layout.functions, functions, strict=True)),
        **{key: chosen[key] for key in _MATRICES},
    )
