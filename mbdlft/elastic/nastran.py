"""Matrices of NASTRAN: OP4 files and DMIG cards of punch files, with the GRID cards of a bulk data file.

The files are read with pyYeti, the extra `mbdlft[nastran]`. (pyNastran 1.4 needs numpy older than 2.)
"""

import importlib
from pathlib import Path
from typing import Any

import numpy as np
import scipy.sparse as sp

from mbdlft.base.array import Array
from mbdlft.base.errors import MbdlftError, StructureError, unknown_name
from mbdlft.base.worker import arrays_of, content_of
from mbdlft.elastic.files import LIMIT
from mbdlft.elastic.matrices import FiniteElements
from mbdlft.elastic.nodes import Indices, Nodes, every_dof

_TABLE = ("dof", "numbers", "coordinates", "axes")
_SECONDS, _BYTES_PER_SECOND = 5, 10**6


def load_nastran(
    matrices: str | Path,
    bulk: str | Path,
    *,
    mass: str = "MAA",
    stiffness: str = "KAA",
    limit: int = LIMIT,
) -> FiniteElements:
    """Load matrices and node table, in the units of the files (see `to_si`).

    Parameters
    ----------
    matrices : file
        NAME.op4 in any of its forms, or a punch file with DMIG cards.
    bulk : file
        Bulk data with the GRID and CORD2 cards of all nodes of the matrices. With an OP4 file the EXTRN
        card lists the rows of the matrices. Without this card, they are all six components of every GRID
        in the order of their numbers, then one for each SPOINT; the bulk data then must have no other
        nodes.
    mass, stiffness : names of the matrices
    limit : int
        Most bytes of a file, and half of the memory that its reader may need.

    Coordinates with neither mass nor stiffness (constrained by AUTOSPC) are left out.

    Raises
    ------
    StructureError
        pyYeti is not installed, a file cannot be read, or the matrices and nodes do not fit together.
    """
    try:
        importlib.import_module("pyyeti.nastran.op4")
    except ImportError as error:
        raise StructureError(
            f"NASTRAN files are read with pyYeti, which cannot be imported ({error}). Install it "
            "with: pip install 'mbdlft[nastran]'."
        ) from None
    names = {"mass": mass, "stiffness": stiffness}
    paths = {"matrices": str(Path(matrices)), "bulk": str(Path(bulk))}
    size = sum(len(content_of(Path(path), StructureError, limit)) for path in paths.values())
    found = arrays_of(  # pyYeti believes what a file says of its sizes
        f"{__name__}:arrays_of_nastran", {**paths, **names},
        seconds=_SECONDS + size // _BYTES_PER_SECOND, memory=2 * limit, error=StructureError,
    )  # fmt: skip
    pair = [_sparse(found, name) for name in ("mass", "stiffness")]
    dof, numbers, coordinates, axes = (found[key] for key in _TABLE)
    for name, matrix in zip((mass, stiffness), pair, strict=True):
        if matrix.shape != (len(dof), len(dof)):
            raise StructureError(
                f"{Path(matrices)}: {name} is {matrix.shape[0]} x {matrix.shape[1]}, and {Path(bulk)} "
                f"has {len(dof)} coordinates. Give the bulk data of exactly the nodes of the matrices "
                "(an .asm or .pch file of EXTSEOUT)."
            )
    M, K = (sp.csr_array(matrix) for matrix in pair)
    used = np.flatnonzero((abs(M) + abs(K)).sum(axis=1))
    nodes = Nodes(numbers, coordinates, dof[used], axes)
    return FiniteElements(M[used][:, used], K[used][:, used], nodes)


def arrays_of_nastran(matrices: str, bulk: str, mass: str, stiffness: str) -> dict[str, Any]:
    """The node table and two matrices in coordinate form, for `arrays_of`.

    Raises
    ------
    StructureError
        A file cannot be read.
    """
    cards = importlib.import_module("pyyeti.nastran.bulk")
    op4 = importlib.import_module("pyyeti.nastran.op4")
    grids = importlib.import_module("pyyeti.nastran.n2p")
    source, table = Path(matrices), Path(bulk)
    numbers, coordinates, axes = _grids(cards, grids, table)
    try:
        if source.suffix.lower() == ".op4":
            matrices_by_name = op4.read(str(source), sparse=(True, sp.coo_array.tocsr))
            pair = [_named(matrices_by_name, name) for name in (mass, stiffness)]
            dof = _rows(cards, table, numbers)
        else:
            frames = cards.rddmig(str(source))
            pair, dof = _of_cards([_named(frames, name) for name in (mass, stiffness)])
    except MbdlftError as error:
        raise StructureError(f"{source}: {error}") from None
    except Exception as error:  # pyYeti raises what it meets
        why = str(error) or type(error).__name__
        raise StructureError(f"{source}: cannot be read as NASTRAN matrices: {why}") from None
    arrays: dict[str, Any] = dict(zip(_TABLE, (dof, numbers, coordinates, axes), strict=True))
    for name, matrix in zip(("mass", "stiffness"), pair, strict=True):
        entries = sp.coo_array(matrix)
        arrays |= {f"{name}.row": entries.row, f"{name}.column": entries.col}
        arrays |= {f"{name}.value": entries.data, f"{name}.shape": np.array(entries.shape)}
    return arrays


def _sparse(arrays: dict[str, Any], name: str) -> Any:
    """A matrix of `arrays_of_nastran`."""
    row, column, value, shape = (
        arrays[f"{name}.{part}"] for part in ("row", "column", "value", "shape")
    )
    return sp.coo_array((value, (row, column)), tuple(shape.tolist()))


def _grids(cards: Any, grids: Any, table: Path) -> tuple[Indices, Array, Array]:
    """Numbers (n,), positions (n, 3) in the basic system and displacement axes (n, 3, 3) of all GRIDs."""
    try:
        uset, _ = cards.bulk2uset(str(table))
        entries = uset.iloc[:, 1:].to_numpy(dtype=float).reshape(-1, 6, 3)
        motions = np.asarray(grids.rbgeom_uset(uset)).reshape(-1, 6, 6)
        numbers = np.asarray(uset.index.get_level_values("id"), dtype=np.int64)[::6]
    except Exception as error:  # pyYeti raises what it meets
        raise StructureError(
            f"{table}: cannot be read as bulk data with GRID cards: {error}"
        ) from None
    # motions[:, :3, :3] are the displacements of each node, in its own axes, for unit displacements of
    # the structure in the basic system: the transposed axes
    return numbers, entries[:, 0], np.swapaxes(motions[:, :3, :3], 1, 2)


def _rows(cards: Any, table: Path, numbers: Indices) -> Indices:
    """Node and component (N, 2) of the rows of OP4 matrices."""
    extern = cards.rdcards(str(table), "extrn", no_data_return=None)
    if extern is not None:
        pairs = np.asarray(extern, dtype=np.int64).reshape(-1, 2)
        return np.array([(int(n), int(c)) for n, text in pairs for c in str(text)], dtype=np.int64)
    points = cards.rdcards(str(table), "spoint", no_data_return=None)
    scalar = np.asarray([] if points is None else points, dtype=np.int64).ravel()
    return np.vstack([every_dof(np.sort(numbers)), np.stack([scalar, 0 * scalar], axis=1)])


def _of_cards(frames: list[Any]) -> tuple[list[Any], Indices]:
    """Matrices (N, N) of two DMIG tables with the union of their rows, and these rows (N, 2)."""
    index = frames[0].index.union(frames[1].index)
    dof = np.array([(int(n), int(c)) for n, c in index], dtype=np.int64)
    full = [frame.reindex(index=index, columns=index, fill_value=0.0) for frame in frames]
    return [sp.csr_array(frame.to_numpy(dtype=float)) for frame in full], dof


def _named(matrices: dict[str, Any] | None, name: str) -> Any:
    """The matrix with this name, in upper or lower case."""
    known = {key.lower(): value for key, value in (matrices or {}).items()}
    if name.lower() not in known:
        raise StructureError(unknown_name("matrix", name, known))
    return known[name.lower()]
