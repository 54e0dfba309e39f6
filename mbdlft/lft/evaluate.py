"""Values of an LFT at one or many values of its deltas."""

from collections.abc import Iterator, Mapping

import numpy as np
from numpy.typing import ArrayLike

from mbdlft.errors import StructureError, WellPosednessError
from mbdlft.lft.lft import LFT, Array, check, check_name

_CHUNK, _CHUNK_ENTRIES = 512, 2**22  # samples and matrix entries that are held at once


def evaluate(a: LFT, deltas: Mapping[str, ArrayLike]) -> Array:
    """Values at deltas given by name, numbers or arrays of one length N; the others are 0.

    Parameters
    ----------
    a : LFT, shape (n_out, n_in)
    deltas : mapping of names to numbers [1] or arrays (N,)

    Returns
    -------
    array (n_out, n_in), or (N, n_out, n_in) if any delta is an array

    Raises
    ------
    StructureError
        A name is unknown, or the lengths differ.
    WellPosednessError
        I - M11 Delta is singular at one of the points.
    """
    for name in deltas:
        check_name(a, name)
    try:
        columns = np.broadcast_arrays(
            *(np.asarray(value, dtype=float) for value in deltas.values())
        )
    except ValueError:
        raise StructureError("evaluate: the arrays of deltas have different lengths.") from None
    single = not columns or columns[0].ndim == 0
    if not single and columns[0].ndim != 1:
        raise StructureError(
            f"evaluate: deltas are numbers or arrays of one axis, got shape {columns[0].shape}."
        )
    count = 1 if single else len(columns[0])
    points = np.zeros((count, len(a.blocks)))
    index = {block.name: k for k, block in enumerate(a.blocks)}
    for name, column in zip(deltas, columns, strict=True):
        points[:, index[name]] = column
    values = evaluate_at(a, points)
    return values[0] if single else values


def evaluate_at(a: LFT, points: ArrayLike) -> Array:
    """Values at many points: points (N, number of blocks) [1], result (N, n_out, n_in)."""
    p = np.asarray(points, dtype=float)
    check(
        p.ndim == 2 and p.shape[1] == len(a.blocks),
        f"points need shape (N, {len(a.blocks)}), got {p.shape}",
    )
    # only the rows and columns that depend on delta are solved for, on the thinner side
    rows, columns = np.flatnonzero(a.M21.any(axis=1)), np.flatnonzero(a.M12.any(axis=0))
    values = np.repeat(a.M22[None], len(p), axis=0)
    if not (a.order and len(rows) and len(columns)):
        return values
    wide = len(rows) < len(columns)
    inner, first = (a.M11.T, a.M21[rows].T) if wide else (a.M11, a.M12[:, columns])
    last = a.M12[:, columns].T if wide else a.M21[rows]
    spread = np.repeat(p, [block.size for block in a.blocks], axis=1)
    eye = np.eye(a.order)
    for chunk in chunks(len(p), a.order):
        d = spread[chunk]
        # (I - M11 Delta)^-1 M12 from the right, or its transpose from the left
        loop = eye - inner[None] * d[:, None, :]
        try:
            solved = np.linalg.solve(loop, np.broadcast_to(first, (len(d), *first.shape)))
        except np.linalg.LinAlgError:
            raise WellPosednessError("I - M11 Delta is singular at one of the points.") from None
        change = (last * d[:, None, :]) @ solved
        part = values[chunk]
        part[:, rows[:, None], columns] += np.swapaxes(change, 1, 2) if wide else change
    return values


def chunks(count: int, order: int) -> Iterator[slice]:
    """Slices of `count` samples whose order x order matrices fit into memory together."""
    size = max(1, min(_CHUNK, _CHUNK_ENTRIES // max(1, order * order)))
    for start in range(0, count, size):
        yield slice(start, start + size)
