"""Models and grids of their matrices as files of other tools, chosen by the ending of the name.

All files of a call are written, or none. A grid (an LPV model) has the state matrices at all combinations
of values of the parameters.
"""

import csv
import os
import re
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from io import BytesIO, StringIO
from math import prod
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mbdlft.archive.archive import put, save, target_of, writing
from mbdlft.base.arguments import arguments_checked
from mbdlft.base.array import Array
from mbdlft.base.errors import AnalysisError, StructureError, check_known, naming
from mbdlft.base.samples import grid as grid_of
from mbdlft.export import matlab
from mbdlft.export.c import c_texts, julia_text
from mbdlft.export.fmi import fmu_image
from mbdlft.export.modelica import modelica_text
from mbdlft.export.names import RESERVED, check_plain_model, identifier, identifiers
from mbdlft.system.model import LFTModel, System
from mbdlft.system.sampled import in_control, matrices_at, trim_at
from mbdlft.system.theta import DeltaThetaModel

if TYPE_CHECKING:
    from control import StateSpace


MODEL_SUFFIXES = (".mat", ".c", ".fmu", ".jl", ".mo")
GRID_SUFFIXES = (".mat", ".csv", ".npz")
_UNCHANGED = "Old files are unchanged."
_SIGNED, _HEAD = b"Written by mbdlft", 4096  # in the first bytes of every text
Counts = int | Mapping[str, int]
_MOST_NUMBERS = 2**24  # of all matrices: 134 MB
_MOST_SYSTEMS = 2**15  # objects of python-control; each takes some 0.1 ms
_PARTS = ("A", "B", "C", "D")


@arguments_checked
def export_model(
    path: str | Path,
    model: System | DeltaThetaModel,
    counts: Counts | None = None,
    archive: str | Path | None = None,
    fmi: int = 3,
) -> tuple[Path, ...]:
    """Write a model for another tool; the ending of the name says for which.

    Parameters
    ----------
    path : file
        ``.mat``: the numbers, with a script ``NAME.m`` and a function ``NAME_at.m`` beside it for MATLAB
        and Octave; ``.c``: C99, with a header; ``.fmu``: a functional mock-up unit with C and its
        binary for this machine (see `mbdlft.export.fmi`), which needs a C compiler;
        ``.jl``: a Julia script that reads an archive, and for nonlinear functions calls the C that is
        written beside it; ``.mo``: a Modelica model of a linear model, with its parameters.
    model : LFTModel, System or DeltaThetaModel
        Of the last, derivatives and outputs with the nonlinear functions, too; for MATLAB in a third
        file ``NAME_rates.m``.
    counts : int, or mapping of names to int, optional
        Write state matrices at all combinations of so many evenly spaced values of each parameter
        (those that a mapping does not name are nominal) instead of the model: ``.mat``, ``.csv`` or
        ``.npz``.
    archive : file, optional
        For ``.jl``: where the model is stored under its name; else it is saved beside, as ``NAME.h5``.
    fmi : 3 or 2
        For ``.fmu``: FMI 3.0 or 2.0.

    Returns
    -------
    tuple of Path
        The files that were written. All of them are complete, or the old ones are unchanged.

    Raises
    ------
    StructureError
        The ending or the name of the file is unknown to the tool, the model has complex or full blocks
        that it does not know, names become the same, or there is no C compiler.
    ArchiveError
        A file cannot be written, or would take the place of one beside `path` that was not exported.
    """
    file = Path(path)
    with naming(file):
        return _exported(file, model, counts, archive, fmi)


def _exported(
    file: Path,
    model: System | DeltaThetaModel,
    counts: Counts | None,
    archive: str | Path | None,
    fmi: int,
) -> tuple[Path, ...]:
    suffix = check_suffix(file, grid=counts is not None)
    if counts is not None:
        write, linear = {".mat": grid_mat, ".csv": grid_csv, ".npz": grid_npz}[suffix], _linear(model)
        return _written({file: write(linear, matrices_on(linear, counts))})
    if suffix == ".jl":
        return _written_julia(file, model, archive)
    if suffix == ".fmu":
        return _written({file: fmu_image(_linear(model), file.stem, fmi)})
    if suffix == ".mo":
        return _written({file: f"// {_SIGNED.decode()}\n{modelica_text(_linear(model))}".encode()})
    return _written(_matlab(file, model) if suffix == ".mat" else _c(file, model))


def _linear(model: System | DeltaThetaModel) -> System:
    """The model, for what has linear models only."""
    if isinstance(model, DeltaThetaModel):
        raise StructureError(
            f"model {model.name!r} has nonlinear functions. Linearize it around an equilibrium "
            "(linearize_dae), or export model.linear; .c, .jl and .mat take the functions, too."
        )
    return model


def check_suffix(file: Path, *, grid: bool) -> str:
    """The ending of the name of a file; a StructureError unless it exists."""
    suffix = file.suffix.lower()
    known = GRID_SUFFIXES if grid else MODEL_SUFFIXES
    if suffix not in known:
        also = MODEL_SUFFIXES if grid else GRID_SUFFIXES
        here, there = ("a grid", "a model") if grid else ("a model", "a grid (--grid)")
        raise StructureError(
            f"{file}: unknown ending {suffix!r}. {here} is written as {', '.join(known)}; "
            f"{there} as {', '.join(also)}."
        )
    return suffix


def _matlab(file: Path, model: System | DeltaThetaModel) -> dict[Path, bytes]:
    """The .mat file, its script and its functions."""
    stem = file.stem
    if not re.fullmatch("[A-Za-z][A-Za-z0-9_]{0,59}", stem) or stem in RESERVED:
        raise StructureError(
            f"{file}: {stem!r} cannot name a script of MATLAB, which is written beside it: ASCII "
            f"letters, digits and underscores, a letter first. Call it {identifier(stem)}.mat."
        )
    linear: System = model.linear if isinstance(model, DeltaThetaModel) else model
    script, evaluation = matlab.m_texts(linear, stem)
    items = matlab.items_of_matlab(linear)
    texts = {file.with_suffix(".m"): script, file.with_name(f"{stem}_at.m"): evaluation}
    if isinstance(model, DeltaThetaModel):
        items["theta"] = matlab.items_of_theta(model)
        texts[file.with_name(f"{stem}_rates.m")] = matlab.rates_text(model, stem)
    return {file: matlab.matlab_image(items), **{path: t.encode() for path, t in texts.items()}}


def _c(file: Path, model: System | DeltaThetaModel) -> dict[Path, bytes]:
    """The source and its header."""
    source, header = c_texts(model, file.stem)
    return {file: source.encode(), file.with_suffix(".h"): header.encode()}


def _written_julia(
    file: Path, model: System | DeltaThetaModel, archive: str | Path | None
) -> tuple[Path, ...]:
    """The script, the C that it calls for nonlinear functions, and the archive unless there is one."""
    beside = file.with_suffix(".h5")
    at = Path(archive) if archive is not None else beside
    try:
        place = os.path.relpath(at.resolve(), file.parent.resolve())
    except ValueError:  # on another drive
        place = str(at.resolve())
    files = {file: julia_text(model, file.stem, Path(place).as_posix()).encode()}
    if isinstance(model, DeltaThetaModel):
        files |= _c(file.with_suffix(".c"), model)
    if archive is None:
        _targets(files)  # an error is known before the archive is written
        save(beside, model)
    return (*_written(files), *((beside,) if archive is None else ()))


def _written(images: Mapping[Path, bytes]) -> tuple[Path, ...]:
    """Write all files, or none."""
    put(dict(zip(_targets(images), images.values(), strict=True)), unchanged=_UNCHANGED)
    return tuple(images)


def _targets(files: Iterable[Path]) -> list[Path]:
    """Where files are written; others than the first take the place of files of mbdlft only."""
    targets = [target_of(file) for file in files]
    for k, target in enumerate(targets):
        with writing(target, _UNCHANGED):
            if target.is_dir():
                raise IsADirectoryError(0, "it is a folder")
            if k and target.exists() and not _is_ours(target):
                raise FileExistsError(0, "it exists, and mbdlft has not written it")
    return targets


def _is_ours(file: Path) -> bool:
    """Whether a text was written by an export."""
    with file.open("rb") as stream:
        return _SIGNED in stream.read(_HEAD)


@dataclass(frozen=True, slots=True, eq=False)
class Grid:
    """State matrices on a grid of N points."""

    # values of each parameter, in the order of the names; N is their product
    counts: tuple[int, ...]
    # by name (N,), in the units of the parameters; the last parameter runs first
    values: Mapping[str, Array]
    # A (N, nx, nx), B (N, nx, nu), C (N, ny, nx), D (N, ny, nu)
    matrices: tuple[Array, Array, Array, Array]
    trim: Array | None  # (N, nt), or nothing


@arguments_checked
def lpv_grid(model: System, counts: Counts) -> "list[StateSpace]":
    """State-space models at all combinations of evenly spaced values, bounds included.

    Parameters
    ----------
    model : System or LFTModel
    counts : int, or mapping of names to int
        Values of each parameter; those that a mapping does not name are nominal.

    Returns
    -------
    list of control.StateSpace
        In the order of ``mbdlft.base.grid``, which has the values: the last parameter runs first. Signals
        are named as by ``model.at``.

    Raises
    ------
    AnalysisError
        The grid has more than 32768 points or its matrices more than 2^24 numbers, a name is unknown,
        or a count is not a whole number of at least 1.
    WellPosednessError
        The model is singular at a point.
    """
    points = zip(*matrices_on(model, counts, _MOST_SYSTEMS).matrices, strict=True)
    return [in_control(model, matrices, f"{model.name}_{k}") for k, matrices in enumerate(points)]


def matrices_on(model: System, counts: Counts, most: int | None = None) -> Grid:
    """The matrices at all points of a grid of at most `most` points; as `lpv_grid`."""
    check_plain_model(model, "a grid")
    numbers = _counts_of(model, counts)
    points = prod(numbers.values())
    nt = len(model.trim.signals) if isinstance(model, LFTModel) else 0
    entries = model.lft.M22.size + nt + len(numbers)
    said = " x ".join(str(n) for n in numbers.values() if n > 1) or "1"
    limit = min(_MOST_NUMBERS // max(entries, 1), most or _MOST_NUMBERS)
    if points > limit:
        raise AnalysisError(
            f"model {model.name!r}: a grid of {said} = {points:.6g} points of {entries} numbers each is "
            f"too large; at most {limit} points. Take fewer values, or only some parameters "
            "(--grid NAME=COUNT); the model itself is exact everywhere between them."
        )
    values = grid_of(model.parameters, numbers)
    asked: Mapping[str, Any] = values
    matrices = matrices_at(model, asked)
    if not values:  # one point, without an axis
        A, B, C, D = (matrix[None] for matrix in matrices)
    else:
        A, B, C, D = matrices
    trim = None
    if isinstance(model, LFTModel) and model.trim.lft is not None:
        trim = trim_at(model, asked).reshape(points, nt)
    return Grid(tuple(numbers.values()), values, (A, B, C, D), trim)


def _counts_of(model: System, counts: Counts) -> dict[str, int]:
    """Numbers of values by name, of all parameters in their order."""
    names = model.parameters.names
    by_name = dict(counts) if isinstance(counts, Mapping) else dict.fromkeys(names, counts)
    check_known("parameter", by_name, names, f"model {model.name!r}: grid", AnalysisError)
    wrong = [counts] if not isinstance(counts, Mapping) else list(by_name.values())
    for n in wrong:
        if isinstance(n, bool) or not isinstance(n, int | np.integer) or n < 1:
            raise AnalysisError(
                f"model {model.name!r}: grid: expected a whole number of values of at least 1, got {n!r}."
            )
    return {name: int(by_name.get(name, 1)) for name in names}


def grid_npz(model: System, grid: Grid) -> bytes:
    """The grid as arrays of numpy: values (N, np), A (N, nx, nx) and so on, names and units."""
    arrays: dict[str, Any] = dict(zip(_PARTS, grid.matrices, strict=True))
    arrays["counts"] = np.array(grid.counts, dtype=np.int64)
    arrays["values"] = _columns(grid)
    arrays["parameters"] = _texts([p.name for p in model.parameters])
    arrays["parameter_units"] = _texts([p.unit for p in model.parameters])
    for what in ("states", "inputs", "outputs"):
        arrays[what] = _texts([s.name for s in getattr(model, what)])
        arrays[f"{what.removesuffix('s')}_units"] = _texts([s.unit for s in getattr(model, what)])
    if grid.trim is not None and isinstance(model, LFTModel):
        arrays["trim"] = grid.trim
        arrays["trimmed"] = _texts([s.name for s in model.trim.signals])
        arrays["trimmed_units"] = _texts([s.unit for s in model.trim.signals])
    stream = BytesIO()
    np.savez_compressed(stream, **arrays)
    return stream.getvalue()


def grid_csv(model: System, grid: Grid) -> bytes:
    """The grid as a table: a point a line; columns are parameters, ``A_1_1`` and so on, and the trim."""
    names, tables = list(grid.values), [_columns(grid)]
    for letter, matrices in zip(_PARTS, grid.matrices, strict=True):
        rows, columns = matrices.shape[1:]
        names += [f"{letter}_{i + 1}_{j + 1}" for i in range(rows) for j in range(columns)]
        tables.append(matrices.reshape(len(matrices), rows * columns))
    if grid.trim is not None and isinstance(model, LFTModel):
        names += [s.name for s in model.trim.signals]
        tables.append(grid.trim)
    twice = sorted(name for name, count in Counter(names).items() if count > 1)
    if twice:
        raise StructureError(
            f"model {model.name!r}: the columns of the table clash: {', '.join(twice)} would stand there "
            "twice. Rename the parameters, or export the grid as .npz or .mat."
        )
    stream = StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(names)
    writer.writerows([repr(x) for x in row] for row in np.hstack(tables).tolist())
    return stream.getvalue().encode()


def grid_mat(model: System, grid: Grid) -> bytes:
    """The grid for MATLAB and Octave: A (nx, nx, N1, N2, ...) with an axis for each parameter."""
    names = identifiers(model.parameters.names, f"model {model.name!r}: MATLAB")
    items: dict[str, Any] = {"format": "mbdlft-grid/1", "name": model.name}
    for letter, matrices in zip(_PARTS, grid.matrices, strict=True):
        # the points are the first axis here and the last ones there
        shaped = matrices.reshape(*grid.counts, *matrices.shape[1:])
        items[letter] = np.moveaxis(shaped, (-2, -1), (0, 1))
    for what in ("states", "inputs", "outputs"):
        items[what] = matlab.signals(getattr(model, what))
    items["parameters"] = {
        "name": matlab.cells([p.name for p in model.parameters]),
        "identifier": matlab.cells([names[p.name] for p in model.parameters]),
        "unit": matlab.cells([p.unit for p in model.parameters]),
        "count": matlab.column(grid.counts),
    }
    axes = {name: np.unique(grid.values[name]) for name in names}
    items["axes"] = {names[name]: matlab.column(values.tolist()) for name, values in axes.items()}
    if grid.trim is not None and isinstance(model, LFTModel):
        shaped = grid.trim.reshape(*grid.counts, len(model.trim.signals))
        items["trim"] = {**matlab.signals(model.trim.signals), "value": np.moveaxis(shaped, -1, 0)}
    return matlab.matlab_image(items)


def _columns(grid: Grid) -> Array:
    """Values (N, np)."""
    count = len(grid.matrices[0])
    return np.stack(list(grid.values.values()), axis=1) if grid.values else np.zeros((count, 0))


def _texts(names: list[str]) -> Any:
    """An array of texts that needs no pickle."""
    return np.array(names, dtype=str)
