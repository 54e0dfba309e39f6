"""State matrices at all combinations of values of the parameters: LPV models on a grid."""

import csv
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from io import BytesIO, StringIO
from math import prod
from typing import TYPE_CHECKING, Any

import numpy as np

from mbdlft.base.array import Array
from mbdlft.base.errors import AnalysisError, StructureError, check_known
from mbdlft.base.samples import grid as grid_of
from mbdlft.export.matlab import cells, column, matlab_image, signals
from mbdlft.export.names import check_plain_model, identifiers
from mbdlft.system.model import LFTModel, System
from mbdlft.system.points import matrices_at, trim_at

if TYPE_CHECKING:
    from control import StateSpace

Counts = int | Mapping[str, int]
_MOST_NUMBERS = 2**24  # of all matrices: 134 MB
_MOST_SYSTEMS = 2**15  # objects of python-control; each takes some 0.1 ms
_PARTS = ("A", "B", "C", "D")


@dataclass(frozen=True, slots=True, eq=False)
class Grid:
    """State matrices on a grid of N points.

    Attributes
    ----------
    counts : values of each parameter, in the order of the names; N is their product
    values : by name (N,), in the units of the parameters; the last parameter runs first
    matrices : A (N, nx, nx), B (N, nx, nu), C (N, ny, nx), D (N, ny, nu)
    trim : array (N, nt), or nothing
    """

    counts: tuple[int, ...]
    values: Mapping[str, Array]
    matrices: tuple[Array, Array, Array, Array]
    trim: Array | None


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
    StructureError
        The model has complex or full blocks or complex entries.
    WellPosednessError
        The model is singular at a point.
    """
    import control  # here because it is slow to import

    found = matrices_on(model, counts, _MOST_SYSTEMS)
    names = {
        "states": [s.name.replace(".", "_") for s in model.states],
        "inputs": [s.name.replace(".", "_") for s in model.inputs],
        "outputs": [s.name.replace(".", "_") for s in model.outputs],
    }
    name = model.name.replace(".", "_")
    return [
        control.ss(*matrices, name=f"{name}_{k}", **names)
        for k, matrices in enumerate(zip(*found.matrices, strict=True))
    ]


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
    found = matrices_at(model, asked)
    if not values:  # one point, without an axis
        A, B, C, D = (matrix[None] for matrix in found)
    else:
        A, B, C, D = found
    trim = None
    if isinstance(model, LFTModel) and model.trim.lft is not None:
        trim = trim_at(model, asked).reshape(points, nt)
    return Grid(tuple(numbers.values()), values, (A, B, C, D), trim)


def _counts_of(model: System, counts: Counts) -> dict[str, int]:
    """Numbers of values by name, of all parameters in their order."""
    names = model.parameters.names
    given = dict(counts) if isinstance(counts, Mapping) else dict.fromkeys(names, counts)
    check_known("parameter", given, names, f"model {model.name!r}: grid", AnalysisError)
    wrong = [counts] if not isinstance(counts, Mapping) else list(given.values())
    for n in wrong:
        if isinstance(n, bool) or not isinstance(n, int | np.integer) or n < 1:
            raise AnalysisError(
                f"model {model.name!r}: grid: expected a whole number of values of at least 1, got {n!r}."
            )
    return {name: int(given.get(name, 1)) for name in names}


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
    """The grid as a table: one point a line; columns are parameters, ``A_1_1`` and so on, and the trim.

    Raises
    ------
    StructureError
        A parameter or a trimmed quantity has the name of another column.
    """
    names, parts = list(grid.values), [_columns(grid)]
    for letter, matrices in zip(_PARTS, grid.matrices, strict=True):
        rows, columns = matrices.shape[1:]
        names += [f"{letter}_{i + 1}_{j + 1}" for i in range(rows) for j in range(columns)]
        parts.append(matrices.reshape(len(matrices), rows * columns))
    if grid.trim is not None and isinstance(model, LFTModel):
        names += [s.name for s in model.trim.signals]
        parts.append(grid.trim)
    twice = sorted(name for name, count in Counter(names).items() if count > 1)
    if twice:
        raise StructureError(
            f"model {model.name!r}: the columns of the table clash: {', '.join(twice)} would stand there "
            "twice. Rename the parameters, or export the grid as .npz or .mat."
        )
    stream = StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(names)
    writer.writerows([repr(x) for x in row] for row in np.hstack(parts).tolist())
    return stream.getvalue().encode()


def grid_mat(model: System, grid: Grid) -> bytes:
    """The grid for MATLAB and Octave: A (nx, nx, N1, N2, ...) with an axis for each parameter.

    Raises
    ------
    StructureError
        The names of two parameters become the same identifier.
    """
    found = identifiers(model.parameters.names, f"model {model.name!r}: MATLAB")
    items: dict[str, Any] = {"format": "mbdlft-grid/1", "name": model.name}
    for letter, matrices in zip(_PARTS, grid.matrices, strict=True):
        # the points are the first axis here and the last ones there
        shaped = matrices.reshape(*grid.counts, *matrices.shape[1:])
        items[letter] = np.moveaxis(shaped, (-2, -1), (0, 1))
    for what in ("states", "inputs", "outputs"):
        items[what] = signals(getattr(model, what))
    items["parameters"] = {
        "name": cells([p.name for p in model.parameters]),
        "identifier": cells([found[p.name] for p in model.parameters]),
        "unit": cells([p.unit for p in model.parameters]),
        "count": column(grid.counts),
    }
    axes = {name: np.unique(grid.values[name]) for name in found}
    items["axes"] = {found[name]: column(values.tolist()) for name, values in axes.items()}
    if grid.trim is not None and isinstance(model, LFTModel):
        shaped = grid.trim.reshape(*grid.counts, len(model.trim.signals))
        items["trim"] = {
            **signals(model.trim.signals),
            "value": np.moveaxis(shaped, -1, 0),
        }
    return matlab_image(items)


def _columns(grid: Grid) -> Array:
    """Values (N, np)."""
    count = len(grid.matrices[0])
    return np.stack(list(grid.values.values()), axis=1) if grid.values else np.zeros((count, 0))


def _texts(names: list[str]) -> Any:
    """An array of texts that needs no pickle."""
    return np.array(names, dtype=str)
