"""Files of matrices with their node table: npz, HDF5, Matrix Market.

An npz or HDF5 file has `numbers` (n,), `coordinates` (n, 3), `dof` (N, 2), `axes` (n, 3, 3) if they are
not those of the coordinates, and for each of the two matrices `mass` and `stiffness` either a dense array
or the lower triangle in coordinate form: `mass.row`, `mass.column`, `mass.value`, counted from 0.

A model in the Matrix Market format is three files: the matrices NAME.mass.mtx and NAME.stiffness.mtx, and
the node table NAME.nodes.txt. The table has one row `number x y z component component ...` for each node,
in the order of the rows of the matrices.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import scipy.io
import scipy.sparse as sp

from mbdlft.base.errors import StructureError
from mbdlft.elastic.matrices import FiniteElements
from mbdlft.elastic.nodes import Nodes

_MATRICES = ("mass", "stiffness")
_TABLE = ("numbers", "coordinates", "dof")
_HDF5 = (".h5", ".hdf5")


def load_matrices(path: str | Path) -> FiniteElements:
    """Load matrices and node table of a file.

    Parameters
    ----------
    path : NAME.npz, NAME.h5, or NAME.mass.mtx with NAME.stiffness.mtx and NAME.nodes.txt beside it

    Raises
    ------
    StructureError
        The file cannot be read, or something is missing in it.
    """
    file = Path(path)
    try:
        if file.suffix == ".npz":
            with np.load(file, allow_pickle=False) as arrays:
                return _elements(dict(arrays))
        if file.suffix in _HDF5:
            with h5py.File(file, "r") as archive:
                return _elements({key: item[()] for key, item in archive.items()})
        if file.name.endswith(".mass.mtx"):
            return _matrix_market(file)
    except StructureError as error:
        raise StructureError(f"{file}: {error}") from None
    except (OSError, ValueError, TypeError, AttributeError) as error:
        raise StructureError(f"{file}: cannot be read: {error}") from None
    raise StructureError(
        f"{file}: expected a name that ends in .npz, .h5, .hdf5 or .mass.mtx. NASTRAN files: "
        "load_nastran."
    )


def save_matrices(path: str | Path, elements: FiniteElements) -> None:
    """Write matrices, as lower triangles, and their node table into a file for `load_matrices`.

    Parameters
    ----------
    path : NAME.npz or NAME.h5
    elements : FiniteElements

    Raises
    ------
    StructureError
        The name of the file has another ending.
    """
    file = Path(path)
    nodes = elements.nodes
    arrays: dict[str, Any] = {
        "numbers": np.asarray(nodes.numbers),
        "coordinates": np.asarray(nodes.coordinates),
        "dof": np.asarray(nodes.dof),
        "axes": np.asarray(nodes.axes),
    }
    for name, matrix in zip(_MATRICES, elements[:2], strict=True):
        lower = sp.coo_array(sp.tril(sp.csr_array(matrix)))
        arrays |= {
            f"{name}.row": lower.row,
            f"{name}.column": lower.col,
            f"{name}.value": lower.data,
        }
    if file.suffix == ".npz":
        np.savez_compressed(file, **arrays)
    elif file.suffix in _HDF5:
        with h5py.File(file, "w") as archive:
            for name, array in arrays.items():
                archive.create_dataset(name, data=array, compression="gzip", shuffle=True)
    else:
        raise StructureError(f"{file}: expected a name that ends in .npz, .h5 or .hdf5.")


def _elements(arrays: Mapping[str, Any]) -> FiniteElements:
    """Matrices and node table of the arrays of an npz or HDF5 file, by name."""
    for name in _TABLE:
        if name not in arrays:
            raise StructureError(
                f"{name!r} is missing. There are: {', '.join(sorted(arrays)) or 'none'}."
            )
    numbers, coordinates, dof = (arrays[name] for name in _TABLE)
    nodes = Nodes(numbers, coordinates, dof, arrays.get("axes"))
    mass, stiffness = (_matrix(name, arrays, len(np.asarray(nodes.dof))) for name in _MATRICES)
    return FiniteElements(mass, stiffness, nodes)


def _matrix(name: str, arrays: Mapping[str, Any], rows: int) -> Any:
    """The symmetric matrix (rows, rows) `name`, dense or sparse."""
    if name in arrays:
        return np.asarray(arrays[name])
    parts = [f"{name}.{part}" for part in ("row", "column", "value")]
    missing = [part for part in parts if part not in arrays]
    if missing:
        raise StructureError(
            f"{name!r} (dense) or {missing[0]!r} is missing. There are: {', '.join(sorted(arrays))}."
        )
    row, column, value = (np.asarray(arrays[part]) for part in parts)
    lower = sp.coo_array((value, (row, column)), (rows, rows)).tocsr()
    if sp.triu(lower, 1).nnz:
        raise StructureError(
            f"{name}: expected the lower triangle, got an entry above the diagonal."
        )
    return lower + sp.tril(lower, -1).T


def _matrix_market(file: Path) -> FiniteElements:
    """Matrices and node table of `file`, NAME.mass.mtx, and of the two files beside it."""
    stem = file.name.removesuffix(".mass.mtx")
    stiffness, table = (file.with_name(stem + end) for end in (".stiffness.mtx", ".nodes.txt"))
    numbers, coordinates, dof = [], [], []
    for count, line in enumerate(table.read_text(encoding="utf-8").splitlines(), start=1):
        words = line.partition("#")[0].split()
        if not words:
            continue
        try:
            number, place = int(words[0]), [float(word) for word in words[1:4]]
            components = [int(word) for word in words[4:]]
        except ValueError:
            raise StructureError(f"{table.name}, line {count}: {_ROW}, got {line!r}.") from None
        if len(place) != 3:
            raise StructureError(f"{table.name}, line {count}: {_ROW}, got {line!r}.")
        numbers.append(number)
        coordinates.append(place)
        dof += [(number, component) for component in components]
    nodes = Nodes(numbers, coordinates, dof)
    return FiniteElements(scipy.io.mmread(file), scipy.io.mmread(stiffness), nodes)


_ROW = "expected the number of a node, x, y, z and its components 1 to 6"
