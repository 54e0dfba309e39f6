"""Files of matrices with their node table: npz, HDF5, Matrix Market, NASTRAN.

An npz or HDF5 file has `numbers` (n,), `coordinates` (n, 3), `dof` (N, 2), `axes` (n, 3, 3) if they are
not those of the coordinates, and for each of the two matrices `mass` and `stiffness` either a dense array
or the lower triangle in coordinate form: `mass.row`, `mass.column`, `mass.value`, counted from 0.

A model in the Matrix Market format is three files: the matrices NAME.mass.mtx and NAME.stiffness.mtx, and
the node table NAME.nodes.txt. The table has one row `number x y z component component ...` for each node,
in the order of the rows of the matrices.

Matrices of NASTRAN are OP4 files and DMIG cards of punch files, with the GRID cards of a bulk data file,
read with pyYeti, the extra `mbdlft[nastran]`. (pyNastran 1.4 needs numpy older than 2.)
"""

import importlib
import io
import re
import struct
import warnings
import zipfile
from collections.abc import Mapping
from math import prod
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import scipy.io
import scipy.sparse as sp

from mbdlft.base.arguments import arguments_checked
from mbdlft.base.array import Array
from mbdlft.base.errors import MbdlftError, StructureError, unknown_name
from mbdlft.base.worker import arrays_of, content_of
from mbdlft.elastic.nodes import Indices, Nodes, every_dof
from mbdlft.elastic.partition import FiniteElements

_MATRICES = ("mass", "stiffness")
_TABLE = ("numbers", "coordinates", "dof")
_HDF5 = (".h5", ".hdf5")
LIMIT = 2**31  # bytes that arrays may need, unless the caller allows more
_PYYETI = ("pyyeti.nastran.bulk", "pyyeti.nastran.op4", "pyyeti.nastran.n2p")
_SECONDS, _BYTES_PER_SECOND, _MEMBERS = 5, 10**7, 100  # limits of reading a file
_BLOCK = 2**22  # bytes of an npz file that are unpacked at once
_INCLUDED = 500  # most files that INCLUDE statements name
_GRID_TABLE = ("dof", "numbers", "coordinates", "axes")
_NASTRAN_BYTES_PER_SECOND = 10**6  # its reader is slower
_INCLUDE = re.compile(rb"""^[ \t]*include\s+('[^']*'|"[^"]*"|\S+)[^\n]*$""", re.IGNORECASE | re.MULTILINE)
# of a card that is read, or a continuation: Python reads 1_0 as 10. The first and the last field of a
# card may be a name that begins with + or *, so a number with a sign is before column 73 or comma 8
_UNDERSCORE = re.compile(
    rb"""^(?:grid|cord|extrn|dmig|spoint|[+*, \t])(?:[^$\n]*?(?<![\w+*])|(?:[^,$\n]*,){1,7}[ \t]*\+"""
    rb"""|[^,$\n]{0,65}[ \t]\+)([\d.]+_\d[^\s,]*)""",
    re.IGNORECASE | re.MULTILINE,
)
_COORDINATES = ("row", "column", "value")
_ROW = "expected the number of a node, x, y, z and its components 1 to 6"


@arguments_checked
def load_matrices(path: str | Path, *, limit: int = LIMIT) -> FiniteElements:
    """Load matrices and node table of a file.

    Parameters
    ----------
    path : NAME.npz, NAME.h5, or NAME.mass.mtx with NAME.stiffness.mtx and NAME.nodes.txt beside it
    limit : int
        Most bytes that the arrays may need.
    """
    file = Path(path)
    try:
        if file.suffix in (".npz", *_HDF5) and not file.is_file():
            content_of(file, StructureError, 0)
        if file.suffix == ".npz":
            return _elements(_npz(file, limit))
        if file.suffix in _HDF5:  # the library can loop or end the process on damaged files
            arrays = arrays_of(
                f"{__name__}:arrays_of_hdf5",
                {"path": str(file.absolute()), "limit": limit},
                seconds=_SECONDS + file.stat().st_size // _BYTES_PER_SECOND,
                memory=4 * limit,
                error=StructureError,
                libraries=("h5py",),
            )
            return _elements(arrays)
        if file.name.endswith(".mass.mtx"):
            return _matrix_market(file, limit)
    except StructureError as error:
        text = str(error)
        raise StructureError(text if text.startswith(f"{file}: ") else f"{file}: {text}") from None
    except Exception as error:  # what the libraries raise for damaged files has no common class
        why = str(error) or type(error).__name__
        raise StructureError(f"{file}: cannot be read: {why}") from None
    raise StructureError(
        f"{file}: expected a name that ends in .npz, .h5, .hdf5 or .mass.mtx. NASTRAN files: "
        "load_nastran."
    )


@arguments_checked
def save_matrices(path: str | Path, elements: FiniteElements) -> None:
    """Write matrices, as lower triangles, and their node table into a file for `load_matrices`.

    Parameters
    ----------
    path : NAME.npz or NAME.h5
    elements : FiniteElements
    """
    file = Path(path)
    arrays: dict[str, Any] = {key: np.asarray(getattr(elements.nodes, key)) for key in (*_TABLE, "axes")}
    for name, matrix in zip(_MATRICES, elements[:2], strict=True):
        arrays |= _in_coordinates(name, sp.tril(sp.csr_array(matrix)))
    if file.suffix == ".npz":
        np.savez_compressed(file, **arrays)
    elif file.suffix in _HDF5:
        with h5py.File(file, "w") as archive:
            for name, array in arrays.items():
                archive.create_dataset(name, data=array, compression="gzip", shuffle=True)
    else:
        raise StructureError(f"{file}: expected a name that ends in .npz, .h5 or .hdf5.")


def _npz(file: Path, limit: int) -> dict[str, Any]:
    """Arrays of an npz file, of numbers only, each checked before it is unpacked."""
    arrays, total = {}, 0
    with zipfile.ZipFile(file) as archive:
        members = archive.infolist()
        if len(members) > _MEMBERS:
            raise StructureError(f"has {len(members)} arrays, expected at most {_MEMBERS}.")
        for member in members:
            name = member.filename.removesuffix(".npy")
            with archive.open(member) as stream:
                shape, columns, kind = _header(name, stream)
                size = prod(shape) * kind.itemsize
                total += size
                _check_size(name, total, limit)
                data, count = np.empty(size, dtype=np.uint8), 0
                while block := stream.read(_BLOCK):  # in one piece there would be two copies
                    if count + len(block) <= size:
                        data[count : count + len(block)] = np.frombuffer(block, np.uint8)
                    count += len(block)
            if count != size:
                raise StructureError(f"{name}: expected {size} bytes of {shape}, got {count}.")
            arrays[name] = data.view(kind).reshape(shape, order="F" if columns else "C")
    return arrays


def _header(name: str, stream: Any) -> tuple[tuple[int, ...], bool, "np.dtype[Any]"]:
    """Shape, whether columns come first, and type of an array in the format npy."""
    formats = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
    version = np.lib.format.read_magic(stream)
    if version not in formats:
        raise StructureError(f"{name}: has npy version {version}, expected 1.0 or 2.0.")
    shape, columns, kind = formats[version](stream)
    if kind.kind not in "iufb" or kind.hasobject:
        raise StructureError(f"{name}: expected numbers, got {kind}; objects are not read.")
    if any(size < 0 for size in shape):
        raise StructureError(f"{name}: has shape {shape}.")
    return shape, columns, kind


def _check_size(name: str, total: int, limit: int) -> None:
    """Raise a StructureError if arrays need too much memory."""
    if total > limit:
        raise StructureError(
            f"needs {total} bytes of memory at {name!r}, expected at most {limit}. Is it damaged? If "
            "not, give a larger limit."
        )


def arrays_of_hdf5(path: str, limit: int) -> dict[str, Any]:
    """Arrays of an HDF5 file by name, for `arrays_of`; numbers that are in the file itself only."""
    arrays, total = {}, 0
    with h5py.File(path, "r") as archive:
        for name in archive:
            if not isinstance(archive.get(name, getlink=True), h5py.HardLink):
                raise StructureError(f"{name!r} is a link to another place or file.")
            item = archive[name]
            if not isinstance(item, h5py.Dataset) or item.shape is None:
                raise StructureError(f"{name!r} is not an array.")
            if item.is_virtual or item.external:
                raise StructureError(f"{name!r} takes its numbers from another place or file.")
            if item.dtype.kind not in "iufb":
                raise StructureError(f"{name!r}: expected numbers, got {item.dtype}.")
            total += prod([item.dtype.itemsize, *item.shape])
            _check_size(name, max(total, prod([item.dtype.itemsize, *(item.chunks or ())])), limit)
            arrays[name] = item[()]
    return arrays


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
    keys = [f"{name}.{key}" for key in _COORDINATES]
    missing = [key for key in keys if key not in arrays]
    if missing:
        raise StructureError(
            f"{name!r} (dense) or {missing[0]!r} is missing. There are: {', '.join(sorted(arrays))}."
        )
    for key in keys[:2]:
        if arrays[key].dtype.kind not in "iu":
            raise StructureError(f"{key}: expected whole numbers, got {arrays[key].dtype}.")
    lower = _sparse(arrays, name, (rows, rows))
    if sp.triu(lower, 1).nnz:
        raise StructureError(f"{name}: expected the lower triangle, got an entry above the diagonal.")
    return lower + sp.tril(lower, -1).T


def _matrix_market(file: Path, limit: int) -> FiniteElements:
    """Matrices and node table of `file`, NAME.mass.mtx, and of the two files beside it."""
    stem = file.name.removesuffix(".mass.mtx")
    stiffness, table = (file.with_name(stem + end) for end in (".stiffness.mtx", ".nodes.txt"))
    numbers, coordinates, dof = [], [], []
    lines = content_of(table, StructureError, limit).decode("utf-8").splitlines()
    for count, line in enumerate(lines, start=1):
        words = line.partition("#")[0].split()
        if not words:
            continue
        try:
            if any("_" in word or not word.isascii() for word in words):  # Python reads 1_0 as 10
                raise ValueError
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
    return FiniteElements(_market(file, limit), _market(stiffness, limit), nodes)


def _market(file: Path, limit: int) -> Any:
    """The matrix of a file; its sizes are checked before there is memory for it."""
    content_of(file, StructureError, limit)
    rows, columns, entries, form, field, _ = scipy.io.mminfo(file)
    if field not in ("real", "integer", "pattern"):
        raise StructureError(f"{file}: expected real numbers, got {field}.")
    if form == "coordinate" and entries > file.stat().st_size:
        raise StructureError(f"{file}: says that it has {entries} entries, more than it has bytes.")
    _check_size(file.name, 8 * (rows * columns if form == "array" else 3 * entries + rows), limit)
    return scipy.io.mmread(file)


@arguments_checked
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
    size = sum(len(_bulk_data(Path(path), limit)) for path in paths.values())
    arrays = arrays_of(  # pyYeti believes what a file says of its sizes
        f"{__name__}:arrays_of_nastran", {**paths, **names, "limit": limit},
        seconds=_SECONDS + size // _NASTRAN_BYTES_PER_SECOND,
        memory=2 * limit, error=StructureError, libraries=_PYYETI,
    )  # fmt: skip
    M, K = (_sparse(arrays, name, tuple(arrays[f"{name}.shape"].tolist())) for name in _MATRICES)
    dof, numbers, coordinates, axes = (arrays[key] for key in _GRID_TABLE)
    for name, matrix in ((mass, M), (stiffness, K)):
        if matrix.shape != (len(dof), len(dof)):
            raise StructureError(
                f"{Path(matrices)}: {name} is {matrix.shape[0]} x {matrix.shape[1]}, and {Path(bulk)} "
                f"has {len(dof)} coordinates. Give the bulk data of exactly the nodes of the matrices "
                "(an .asm or .pch file of EXTSEOUT)."
            )
    used = np.flatnonzero((abs(M) + abs(K)).sum(axis=1))
    nodes = Nodes(numbers, coordinates, dof[used], axes)
    return FiniteElements(M[used][:, used], K[used][:, used], nodes)


def _bulk_data(
    file: Path, limit: int, folder: Path | None = None, known: set[Path] | None = None
) -> bytes:
    """The bytes of bulk data, with what INCLUDE statements name put in their place.

    A name counts from the folder of the file that has it, or of the first file; all are below the latter,
    and none is read twice: files that include each other, or double each other, would not end.
    """
    if file.suffix.lower() == ".op4":
        return content_of(file, StructureError, limit)
    top, pieces, size = folder or file.resolve().parent, list[bytes](), 0
    known = {file.resolve()} if known is None else known
    for k, piece in enumerate(_INCLUDE.split(content_of(file, StructureError, limit))):
        if not k % 2:
            pieces.append(piece)
        else:
            name = b"".join(piece.split()).decode("latin-1").strip("'\"")
            places = [place / name for place in (file.resolve().parent, top)]
            try:
                path = next((place.resolve() for place in places if place.exists()), places[0].resolve())
            except (OSError, ValueError) as error:
                raise StructureError(f"{file}: INCLUDE {name!r} cannot be read: {error}.") from None
            if not path.is_relative_to(top):
                raise StructureError(f"{file}: INCLUDE reads files below {top} only, got {name!r}.")
            if path in known or len(known) > _INCLUDED:
                raise StructureError(
                    f"{file}: INCLUDE reads a file once, and at most {_INCLUDED} files, got {name!r}."
                )
            known.add(path)
            pieces.append(_bulk_data(path, limit - size, top, known))
        size += len(pieces[-1])
    return b"".join(pieces)


def arrays_of_nastran(matrices: str, bulk: str, mass: str, stiffness: str, limit: int) -> dict[str, Any]:
    """The node table and two matrices in coordinate form, for `arrays_of`."""
    cards, op4, grids = map(importlib.import_module, _PYYETI)
    source, table = Path(matrices), Path(bulk)

    def text(file: Path) -> io.TextIOWrapper:  # without a name, so that pyYeti includes nothing
        data = _bulk_data(file, limit)
        if wrong := _UNDERSCORE.search(data):
            raise StructureError(f"{file}: expected a number, got {wrong[1].decode()!r}.")
        return io.TextIOWrapper(io.BytesIO(data), "utf-8")

    numbers, coordinates, axes = _grids(cards, grids, table, text(table))
    try:
        if source.suffix.lower() == ".op4":
            # pyYeti goes on where the last record ends early
            with warnings.catch_warnings(action="error", category=RuntimeWarning):
                matrices_by_name = op4.read(str(source), sparse=(True, sp.coo_array.tocsr))
            pair = [_named(matrices_by_name, name) for name in (mass, stiffness)]
            dof = _rows(cards, text(table), numbers)
        else:
            columns = cards.rdcards(text(source), "dmig", return_var="list", blank="")
            dof, *pair = _dmig(columns or [], mass, stiffness)
    except MbdlftError as error:
        raise StructureError(f"{source}: {error}") from None
    except (struct.error, ValueError, IndexError, RuntimeWarning) as error:  # numbers that are not there
        raise StructureError(
            f"{source}: cannot be read as NASTRAN matrices: it ends, or is damaged, inside of a matrix "
            f"({error}). Was it cut off, or copied as text? Copy or write it again."
        ) from None
    except Exception as error:  # pyYeti raises what it meets
        why = str(error) or type(error).__name__
        raise StructureError(f"{source}: cannot be read as NASTRAN matrices: {why}") from None
    arrays: dict[str, Any] = dict(zip(_GRID_TABLE, (dof, numbers, coordinates, axes), strict=True))
    for name, matrix in zip(_MATRICES, pair, strict=True):
        arrays |= _in_coordinates(name, matrix) | {f"{name}.shape": np.array(matrix.shape)}
    return arrays


def _in_coordinates(name: str, matrix: Any) -> dict[str, Any]:
    """Arrays of a sparse matrix in coordinate form."""
    entries = sp.coo_array(matrix)
    values = (entries.row, entries.col, entries.data)
    return {f"{name}.{key}": array for key, array in zip(_COORDINATES, values, strict=True)}


def _sparse(arrays: Mapping[str, Any], name: str, shape: tuple[int, int]) -> Any:
    """The csr_array of a matrix in coordinate form."""
    row, column, value = (np.asarray(arrays[f"{name}.{key}"]) for key in _COORDINATES)
    return sp.coo_array((value, (row, column)), shape).tocsr()


def _dmig(cards: list[list[Any]], *names: str) -> tuple[Any, ...]:
    """Node and component (N, 2) of the rows of all matrices, and the sparse matrices (N, N)."""
    by_name: dict[str, list[list[Any]]] = {}
    for card in cards:
        by_name.setdefault(str(card[0]), []).append(card)
    entries, forms = [], []
    for name in names:
        header, *columns = _named(by_name, name)
        forms.append(header[2])
        if header[2] not in (1, 2, 6) or header[3] not in (1, 2):
            raise StructureError(
                f"matrix {name!r} has form {header[2]} and type {header[3]}, expected form 1, 2 or 6 and "
                "real numbers, type 1 or 2."
            )
        count = [len(column[4::4]) for column in columns]
        where = [np.repeat([column[k] for column in columns], count) for k in (1, 2)]
        where += [np.concatenate([column[k::4] for column in columns]) for k in (4, 5)]
        where = [_whole(f"matrix {name!r}", where[k], 6 if k % 2 else 2**50) for k in range(4)]
        keys = [10 * where[k] + where[k + 1] for k in (2, 0)]
        entries.append((*keys, np.concatenate([column[6::4] for column in columns]).astype(float)))
    rows = np.unique(np.concatenate([keys for *both, _ in entries for keys in both]))
    matrices = []
    for name, form, (row, column, value) in zip(names, forms, entries, strict=True):
        i, j = np.searchsorted(rows, row), np.searchsorted(rows, column)
        if form == 6:  # one triangle, whichever
            i, j = np.maximum(i, j), np.minimum(i, j)
        if len(np.unique(i * len(rows) + j)) < len(i):
            raise StructureError(f"matrix {name!r} has two values for one entry.")
        lower = sp.csr_array(sp.coo_array((value, (i, j)), (len(rows), len(rows))))
        matrices.append(lower + sp.tril(lower, -1).T if form == 6 else lower)
    return np.stack(np.divmod(rows, 10), axis=1), *matrices


def _grids(cards: Any, grids: Any, table: Path, text: Any) -> tuple[Indices, Array, Array]:
    """Numbers (n,), positions (n, 3) in the basic system and displacement axes (n, 3, 3) of all GRIDs."""
    try:
        _check_cards(cards, text)
        uset, _ = cards.bulk2uset(text)
        entries = uset.iloc[:, 1:].to_numpy(dtype=float).reshape(-1, 6, 3)
        motions = np.asarray(grids.rbgeom_uset(uset)).reshape(-1, 6, 6)
        numbers = np.asarray(uset.index.get_level_values("id"), dtype=np.int64)[::6]
    except Exception as error:  # pyYeti raises what it meets
        raise StructureError(f"{table}: cannot be read as bulk data with GRID cards: {error}") from None
    # motions[:, :3, :3] are the displacements of each node, in its own axes, for unit displacements of
    # the structure in the basic system: the transposed axes
    return numbers, entries[:, 0], np.swapaxes(motions[:, :3, :3], 1, 2)


def _check_cards(cards: Any, text: Any) -> None:
    """Raise an error for what pyYeti leaves out: it reads words as 0, cuts 1.5 to 1, knows no GRDSET."""
    kinds, numbers = r"(grid|grdset|cord2[rcs]|extrn)\b", list[Any]()
    for card in cards.rdcards(text, kinds, regex=True, return_var="list", blank=0, keep_name=True) or ():
        name, words = card[0].upper().rstrip("*"), [field for field in card[1:] if isinstance(field, str)]
        if name == "GRDSET" and any(card[1:7]):
            raise StructureError("GRDSET is not read. Write its systems into the GRID cards.")
        if words:
            raise StructureError(f"{name} {card[1]}: expected a number, got {words[0]!r}.")
        numbers += card[1:] if name == "EXTRN" else card[1:2]
    _whole("GRID and EXTRN", numbers)


def _rows(cards: Any, text: Any, numbers: Indices) -> Indices:
    """Node and component (N, 2) of the rows of OP4 matrices."""
    extern = cards.rdcards(text, "extrn", no_data_return=None)
    if extern is not None:
        pairs = np.asarray(extern, dtype=np.int64).reshape(-1, 2)
        return np.array([(int(n), int(c)) for n, text in pairs for c in str(text)], dtype=np.int64)
    scalar = cards.rdspoints(text)
    return np.vstack([every_dof(np.sort(numbers)), np.stack([scalar, 0 * scalar], axis=1)])


def _whole(what: str, values: Any, most: int = 2**50) -> Indices:
    """Numbers of a file as integers; a conversion alone would cut 1.5 to 1."""
    numbers = np.asarray(values, dtype=float)
    wrong = numbers[~((numbers >= 0.0) & (numbers <= most) & (numbers == np.floor(numbers)))]
    if wrong.size:
        kind = "components" if most == 6 else "numbers of nodes"
        raise StructureError(f"{what}: expected {kind} from 0 to {most}, got {wrong[0]:.17g}.")
    return numbers.astype(np.int64)


def _named(matrices: dict[str, Any] | None, name: str) -> Any:
    """The matrix with this name, in upper or lower case."""
    known = {key.lower(): value for key, value in (matrices or {}).items()}
    if name.lower() not in known:
        raise StructureError(unknown_name("matrix", name, known))
    return known[name.lower()]
