"""Sweeps in an archive: /sweeps/<name>, numeric trims and linearizations of many samples.

A row of a sweep is [samples, A, B, C, D, trim, residual, status, poles, values of functions], matrices
row by row.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mbdlft.archive.archive import LIMIT, check_name, names_in, naming, read_one, rewrite
from mbdlft.archive.hdf5 import Part, write_items
from mbdlft.archive.layout import (
    BLOCK_ROWS,
    DIGEST,
    FIRST,
    ROWS,
    SWEEP_TYPE,
    Items,
    check_digest,
    digest,
    encode,
    text,
    word,
    words,
)
from mbdlft.archive.model import signal_values, signals_of
from mbdlft.archive.reading import Request
from mbdlft.archive.rows import FUNCTION_FAILED, GROUP, NO_EQUILIBRIUM, SOLVED, Layout, digests_of
from mbdlft.base.array import Array
from mbdlft.base.errors import ArchiveError

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
    values |= {"function/name": layout.functions or None, BLOCK_ROWS: block_rows, "blocks": blocks}
    meaning = text(MEANINGS + _FUNCTION_MEANING * bool(layout.functions))
    with naming(file, f"sweep {name!r}"):
        items = encode(SWEEP_TYPE, values)
    items[DIGEST] = text(digest({**items, "status@meaning": meaning}))

    def fill(archive: Any) -> None:
        archive.require_group("sweeps")
        archive.move(GROUP, f"sweeps/{name}")
        group = archive["sweeps"][name]
        write_items(group["status"], {"@meaning": meaning})
        write_items(group, items)

    rewrite(file, fill, f"sweeps/{name}", made=rows)


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
    if word(items, "@encoding_version") == FIRST:
        return
    check_digest(items, ROWS)
    size = int(items[BLOCK_ROWS])
    wanted = items["blocks"]
    if len(wanted) != -(-count // size):
        raise ArchiveError(f"blocks: expected {-(-count // size)} digests, got {len(wanted)}.")
    read, keys = len(items["status"]), [key for key in ROWS if key in items]
    arrays = [np.asarray(items[key]).reshape(read, -1).astype("<f8") for key in keys]
    rows = np.concatenate(arrays, axis=1)
    for start, computed in zip(range(0, read, size), digests_of(rows, size), strict=True):
        if not np.array_equal(computed, wanted[(first + start) // size]):
            raise ArchiveError(
                f"is damaged or was changed: rows {first + start} to "
                f"{min(first + start + size, first + read) - 1} do not have their digest. Write it "
                "again, or take it from a backup."
            )


def _layout(items: Items) -> Layout:
    """Names and units of a sweep that was read."""
    return Layout(
        **{what: signals_of(items, what) for what in _SIGNALS},
        poles="poles/real" in items,
        functions=words(items, "function/name") if _OF_FUNCTION in items else (),
        single=items["A"].dtype.itemsize == 4,
    )


def _sweep(items: Items, name: str, rows: slice) -> Sweep:
    """Some of the rows that were read."""
    layout = _layout(items)
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
        model=word(items, "@model"),
        poles=poles,
        values=dict(zip(layout.functions, functions, strict=True)),
        **{key: chosen[key] for key in _MATRICES},
    )
