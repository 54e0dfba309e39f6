"""Sweeps in an archive: /sweeps/<name>, numeric trims and linearizations of many samples.

A row of a sweep is [samples, A, B, C, D, trim, residual, status], matrices row by row.
"""

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
from mbdlft.store.archive import _names, _opened, check_name, chosen_name, rewrite
from mbdlft.store.model import _read_signals, _write_signals

TYPE, VERSION = "sweep", "1.0"
SOLVED, SINGULAR, NO_EQUILIBRIUM = 0, 1, 2
MEANINGS = (
    "0: solved; 1: not converged, the efforts or accelerations cannot be solved for; "
    "2: no equilibrium, the efforts do not hold it"
)
_CHUNK_BYTES, _CHUNK_ROWS = 2**19, 4096
_MATRICES = ("A", "B", "C", "D")


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
    check_name(Path(path), "sweep", name)

    def fill(archive: Any) -> None:
        group = archive.require_group("sweeps").create_group(name)
        group.attrs["encoding_type"] = TYPE
        group.attrs["encoding_version"] = VERSION
        if model:
            group.attrs["model"] = model
        if scene:
            group.create_group("provenance").attrs["scene"] = scene
        for what in ("parameters", "states", "inputs", "outputs", "trim"):
            _write_signals(group.create_group(what), getattr(layout, what))
        for key, shape in layout.shapes.items():
            kind = "i1" if key == "status" else "<f8"
            size = max(1, int(np.prod(shape))) * np.dtype(kind).itemsize
            rows = max(1, min(count, _CHUNK_ROWS, _CHUNK_BYTES // size))
            chunks = (rows, *shape) if all(shape) else None
            group.create_dataset(
                key, (count, *shape), dtype=kind, chunks=chunks, fletcher32=chunks is not None
            )
        group["status"].attrs["meaning"] = MEANINGS
        start = 0
        for part in parts:
            for key, values in unpack(layout, part).items():
                if values.size:
                    group[key][start : start + len(part)] = values
            start += len(part)
        if start != count:
            raise ArchiveError(f"{path}: sweep {name!r}: expected {count} rows, got {start}.")

    rewrite(Path(path), fill, f"sweeps/{name}", large=True, beside=beside)


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
    file = Path(path)
    with _opened(file) as archive:
        return _names(file, archive, "sweeps")


def load_sweep(
    path: str | Path, name: str | None = None, start: int = 0, stop: int | None = None
) -> Sweep:
    """Read a sweep, or some of its rows, from an archive.

    Parameters
    ----------
    path : file
    name : str, optional
        May be left out if the archive has one sweep.
    start, stop : int
        The rows to read, as in a slice; by default all.

    Returns
    -------
    Sweep

    Raises
    ------
    ArchiveError
        The file is missing, truncated, foreign or newer, or the sweep is missing or incomplete.
    """
    file = Path(path)
    name = chosen_name(file, "sweep", sweep_names(file), name)
    with _opened(file) as archive:
        try:
            return _read(archive["sweeps"][name], name, slice(start, stop))
        except KeyError as error:
            raise ArchiveError(f"{file}: sweep {name!r} is not whole: {error.args[0]}.") from None


def _read(group: Any, name: str, rows: slice) -> Sweep:
    """Some rows of the sweep in a group of an archive."""
    if group.attrs.get("encoding_type") != TYPE:
        raise ArchiveError(
            f"sweep {name!r}: encoding_type is {group.attrs.get('encoding_type')!r}, expected {TYPE!r}."
        )
    version = str(group.attrs.get("encoding_version"))
    if version.partition(".")[0] != VERSION.partition(".")[0]:
        raise ArchiveError(
            f"sweep {name!r}: encoding_version is {version}, this mbdlft reads up to {VERSION}."
        )
    what = ("parameters", "states", "inputs", "outputs", "trim")
    layout = Layout(**{key: _read_signals(group[key]) for key in what})
    count = len(group["status"])
    for key, shape in layout.shapes.items():
        if group[key].shape != (count, *shape):
            raise ArchiveError(
                f"sweep {name!r}: {key} has shape {group[key].shape}, expected {(count, *shape)}."
            )
    values = {key: group[key][rows] for key in layout.shapes}
    return Sweep(
        name=name,
        layout=layout,
        samples=values["samples"],
        trim=values["trim/value"],
        residual=values["residual"],
        status=values["status"],
        model=str(group.attrs.get("model", "")),
        **{key: values[key] for key in _MATRICES},
    )
