"""Hostile matrix files: npz, HDF5, Matrix Market, OP4; matrices, or a StructureError in time."""

import io
import tempfile
import zipfile
from functools import cache
from pathlib import Path

import h5py
import numpy as np
import scipy.io
import scipy.sparse as sp

from mbdlft import StructureError
from mbdlft.elastic import load_matrices, load_nastran, save_matrices
from tests.archive.test_matrix_files import turned
from tests.attack.mutations import changed, check_message, damaged

MEMORY = 2**26
BULK = "".join(f"GRID    {n:<8d}        {n:<8.1f}0.      0.\n" for n in (1, 2))


@cache
def files(form: str) -> dict[str, bytes]:
    """The files of a model in a format."""
    mass, stiffness, nodes = turned()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        if form == "op4":
            from pyyeti.nastran import op4  # takes seconds

            op4.write(str(folder / "a.op4"), {"maa": np.eye(12), "kaa": 2.0 * np.eye(12)})
            (folder / "a.bdf").write_text(BULK)
        elif form == "mtx":
            for what, matrix in (("mass", mass), ("stiffness", stiffness)):
                scipy.io.mmwrite(folder / f"a.{what}.mtx", sp.coo_array(matrix), precision=17)
            places = zip(np.asarray(nodes.numbers), np.asarray(nodes.coordinates), strict=True)
            lines = [" ".join([str(n), *map(repr, at.tolist()), "1 2 3 4 5 6"]) for n, at in places]
            (folder / "a.nodes.txt").write_text("\n".join(lines))
        else:
            save_matrices(folder / f"a.{form}", turned())
        return {path.name: path.read_bytes() for path in sorted(folder.iterdir())}


def attack(seed: int, folder: Path) -> str:
    """Damage the files of one format, or make them lie about their sizes, and load them."""
    random = np.random.default_rng(seed)
    form = ("npz", "npz", "h5", "mtx", "mtx", "op4")[int(random.integers(6))]
    made = dict(files(form))
    name = list(made)[int(random.integers(len(made)))]
    if random.random() < 0.25:
        made = _lies(form, made, random)
    elif form == "mtx" or name.endswith(".bdf"):
        made[name] = changed(made[name].decode("latin-1"), random).encode("latin-1", "replace")
    else:
        made[name] = damaged(made[name], random)
    for key, data in made.items():
        (folder / key).write_bytes(data)
    try:
        if form == "op4":
            load_nastran(folder / "a.op4", folder / "a.bdf", limit=MEMORY)
        else:
            load_matrices(folder / ("a.mass.mtx" if form == "mtx" else f"a.{form}"), limit=MEMORY)
    except StructureError as error:
        check_message(error)
        return f"{form} refused"
    return f"{form} read"


def _lies(form: str, made: dict[str, bytes], random: np.random.Generator) -> dict[str, bytes]:
    """Files that unpack to much, say that they are large, have objects, or lead elsewhere."""
    kind = int(random.integers(3))
    if form == "npz":
        image = io.BytesIO()
        with zipfile.ZipFile(image, "w", zipfile.ZIP_DEFLATED) as archive:
            if kind == 0:  # a bomb
                header = io.BytesIO()
                np.lib.format.write_array_header_1_0(
                    header, {"descr": "<f8", "fortran_order": False, "shape": (2**25,)}
                )
                archive.writestr("numbers.npy", header.getvalue() + bytes(2**28))
            elif kind == 1:  # a size that is not there
                header = io.BytesIO()
                np.lib.format.write_array_header_1_0(
                    header, {"descr": "<f8", "fortran_order": False, "shape": (2**40, 2**20)}
                )
                archive.writestr("numbers.npy", header.getvalue())
            else:  # a pickle
                objects = io.BytesIO()
                np.save(objects, np.array([{}], dtype=object), allow_pickle=True)
                archive.writestr("numbers.npy", objects.getvalue())
        return {"a.npz": image.getvalue()}
    if form == "h5":
        image = io.BytesIO(made["a.h5"])
        with h5py.File(image, "r+") as archive:
            del archive["numbers"]
            if kind == 0:
                archive.create_dataset("numbers", (2**20, 2**20), "<i8", chunks=(2**10, 2**10))
            elif kind == 1:
                archive["numbers"] = h5py.ExternalLink("/etc/hostname", "/")
            else:
                archive["numbers"] = archive["coordinates"].ref
        return {"a.h5": image.getvalue()}
    if form == "mtx":
        head = ("array real general\n1000000 1000000\n", "coordinate real general\n9 9 999999999999\n",
                "coordinate complex general\n1 1 1\n1 1 1 1\n")[kind]  # fmt: skip
        return {**made, "a.mass.mtx": b"%%MatrixMarket matrix " + head.encode()}
    numbers = np.frombuffer(made["a.op4"][:16], "<i4").copy()
    numbers[1 + kind] = 2**30
    return {**made, "a.op4": numbers.tobytes() + made["a.op4"][16:]}
