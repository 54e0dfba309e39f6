"""Files of matrices: what is written is read back, bit by bit."""

from pathlib import Path

import numpy as np
import pytest
import scipy.io
import scipy.sparse as sp

from mbdlft import FiniteElements, Nodes, load_matrices, save_matrices
from tests.close import exact
from tests.reference.frames import tee


def turned() -> FiniteElements:
    """A frame with axes of its own at every node."""
    mass, stiffness, nodes = tee(2)
    axes = np.broadcast_to([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]], (len(nodes), 3, 3))
    # one triangle is stored: the test asks for the same bits
    mass, stiffness = (np.tril(matrix) + np.tril(matrix, -1).T for matrix in (mass, stiffness))
    return FiniteElements(mass, stiffness, Nodes(nodes.numbers, nodes.coordinates, None, axes))


def same(found: FiniteElements, expected: FiniteElements) -> None:
    for name in ("numbers", "coordinates", "dof", "axes"):
        exact(getattr(found.nodes, name), getattr(expected.nodes, name))
    for a, b in zip(found[:2], expected[:2], strict=True):
        exact(sp.csr_array(a).toarray(), b)


@pytest.mark.parametrize("name", ["tee.npz", "tee.h5", "tee.hdf5"])
def test_round_trip(tmp_path: Path, name: str) -> None:
    expected = turned()
    save_matrices(tmp_path / name, expected)
    same(load_matrices(tmp_path / name), expected)


def test_dense_arrays(tmp_path: Path) -> None:
    mass, stiffness, nodes = turned()
    path = tmp_path / "tee.npz"
    np.savez(
        path, mass=mass, stiffness=stiffness, numbers=nodes.numbers,
        coordinates=nodes.coordinates, dof=nodes.dof, axes=nodes.axes,
    )  # fmt: skip
    same(load_matrices(path), turned())


def test_matrix_market(tmp_path: Path) -> None:
    mass, stiffness, nodes = tee(2)
    mass, stiffness = (np.tril(matrix) + np.tril(matrix, -1).T for matrix in (mass, stiffness))
    for name, matrix in (("mass", mass), ("stiffness", stiffness)):
        scipy.io.mmwrite(tmp_path / f"tee.{name}.mtx", sp.coo_array(matrix), precision=17)
    lines = ["# number, x, y, z, components", ""]
    for number, place in zip(np.asarray(nodes.numbers), np.asarray(nodes.coordinates), strict=True):
        lines.append(" ".join([str(number), *map(repr, place.tolist()), "1 2 3 4 5 6"]))
    (tmp_path / "tee.nodes.txt").write_text("\n".join(lines))
    found = load_matrices(tmp_path / "tee.mass.mtx")
    same(found, FiniteElements(mass, stiffness, nodes))
