"""NASTRAN: a superelement of NX NASTRAN against what that program printed, and files of pyYeti's writer.

The superelement (`inboard`, 4 boundary nodes in two coordinate systems, 8 component modes) comes with
pyYeti, BSD license, pyyeti/tests/nas2cam_extseout; the numbers are those of its output file: the weight
check of the g-set about the origin of the basic system, and the eigenvalues with the boundary fixed.
"""

import tracemalloc
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import pyyeti
import scipy.sparse as sp
from pyyeti.nastran import bulk, op4

import mbdlft
from mbdlft import FiniteElements, Interface, load_nastran, modal_model, to_si
from mbdlft.base.errors import StructureError
from mbdlft.elastic import files
from mbdlft.elastic.nodes import transport
from mbdlft.elastic.partition import mass_matrix
from tests.close import exact, published, roundoff
from tests.errors.table import says
from tests.reference.frames import tee

INBOARD = Path(pyyeti.__file__).parent / "tests" / "nas2cam_extseout" / "inboard.op4"
EIGENVALUES = (
    "1.483160e3", "1.483542e3", "2.204734e4", "1.960809e5", "1.978078e5", "4.324796e5", "1.395851e6",
    "1.717815e6",
)  # fmt: skip
WEIGHT = {
    (0, 0): "1.755052e0",
    (0, 4): "2.632578e2",
    (1, 5): "1.825251e3",
    (3, 3): "1.148825e5",
    (3, 4): "-2.737877e5",
    (4, 4): "2.305948e6",
    (4, 5): "-3.937911e4",
}


@pytest.fixture(autouse=True)
def here(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """The reader works in this process, where pyYeti is already imported; one test starts a worker."""
    if "dmig" in request.node.name:
        return

    def called(function: str, arguments: dict[str, Any], **_: Any) -> dict[str, Any]:
        return dict(getattr(files, function.partition(":")[2])(**arguments))

    monkeypatch.setattr(files, "arrays_of", called)


def inboard() -> FiniteElements:
    return load_nastran(INBOARD, INBOARD.with_suffix(".pch"), mass="MXX", stiffness="KXX")


def test_superelement_has_the_frequencies_that_nastran_printed() -> None:
    model = modal_model(*inboard(), (3, 11, 19, 27), {}, method="effective-mass", modes=8)
    for found, printed in zip(model.frequencies**2, EIGENVALUES, strict=True):
        published(float(found), printed)


def test_superelement_has_the_rigid_mass_that_nastran_printed() -> None:
    model = modal_model(*inboard(), Interface((3, 11, 19), (0.0, 0.0, 0.0)), {"p": 27}, modes=4)
    found = mass_matrix(model.rigid)
    for (i, j), printed in WEIGHT.items():
        published(float(found[i, j]), printed)


def test_units_are_converted() -> None:
    """Frequencies do not change, masses are in kg and lengths in m."""
    data = inboard()
    in_files = modal_model(*data, 3, {"p": 19}, modes=8)
    in_si = modal_model(*to_si(data, "mm", "t"), 3, {"p": 19}, modes=8)
    roundoff(in_si.frequencies, in_files.frequencies, kappa=1e6)
    roundoff(in_si.rigid.mass, 1e3 * in_files.rigid.mass)
    roundoff(in_si.rigid.center, 1e-3 * in_files.rigid.center)
    roundoff(in_si.ports["p"], 1e-3 * in_files.ports["p"])


def grid_cards(fe: FiniteElements, system: int = 0) -> str:
    cards = ["CORD2R,5,0,1.,2.,3.,1.,3.,3.\n,1.,2.,4."] if system else []
    nodes = fe.nodes
    for number, (x, y, z) in zip(np.asarray(nodes.numbers), np.asarray(nodes.coordinates), strict=True):
        cards.append(f"GRID,{number},,{x:.6f},{y:.6f},{z:.6f},{system or ''}")
    return "\n".join(cards) + "\n"


@pytest.mark.parametrize("form", ["binary", "text", "bigmat"])
def test_op4_files_of_another_writer(tmp_path: Path, form: str) -> None:
    fe = tee(2)
    path, table = tmp_path / "tee.op4", tmp_path / "tee.bdf"
    table.write_text(grid_cards(fe))
    op4.write(
        str(path), {"mgg": fe.mass_matrix, "kgg": fe.stiffness_matrix},
        binary=form != "text", sparse="bigmat" if form == "bigmat" else "dense",
    )  # fmt: skip
    found = load_nastran(path, table, mass="MGG", stiffness="KGG")
    exact(found.nodes.dof, fe.nodes.dof)
    roundoff(found.mass_matrix.toarray(), fe.mass_matrix)
    roundoff(found.stiffness_matrix.toarray(), fe.stiffness_matrix)


def test_dmig_cards_and_axes_of_nodes(tmp_path: Path) -> None:
    """Matrices in a turned coordinate system of the nodes."""
    fe = tee(2)
    # columns are the axes of system 5: z along the basic y, x along the basic z
    axes = np.array([[0.0, 1, 0], [0, 0, 1], [1, 0, 0]])
    rotate = np.kron(np.eye(2 * len(fe.nodes)), axes)
    index = pd.MultiIndex.from_arrays(np.asarray(fe.nodes.dof).T, names=["id", "dof"])
    frames = {
        name: pd.DataFrame(rotate.T @ matrix @ rotate, index=index, columns=index)
        for name, matrix in (("maa", fe.mass_matrix), ("kaa", fe.stiffness_matrix))
    }
    path = tmp_path / "tee.pch"
    bulk.wtdmig(str(path), frames)
    with path.open("a") as stream:
        stream.write(grid_cards(fe, 5))
    found = load_nastran(path, path)
    a = modal_model(*fe, 10, {"right": 50}, modes=4)
    b = modal_model(*found, 10, {"right": 50}, modes=4)
    roundoff(b.frequencies, a.frequencies, kappa=1e6)
    roundoff(b.shapes["right"] @ b.shapes["right"].T, a.shapes["right"] @ a.shapes["right"].T, 1e6)
    roundoff(mass_matrix(b.rigid), mass_matrix(a.rigid), kappa=1e6)
    assert np.max(np.abs(np.asarray(found.nodes.axes) - np.eye(3))) > 0.5
    roundoff(transport(b.ports["right"]), transport(a.ports["right"]))


def test_coordinates_without_mass_and_stiffness_are_left_out(tmp_path: Path) -> None:
    fe = tee(2)
    dof = np.asarray(fe.nodes.dof)
    plane = sp.diags_array(np.isin(dof[:, 1], (1, 2, 6)).astype(float))
    path, table = tmp_path / "tee.op4", tmp_path / "tee.bdf"
    table.write_text(grid_cards(fe))
    op4.write(
        str(path), {"maa": plane @ fe.mass_matrix @ plane, "kaa": plane @ fe.stiffness_matrix @ plane}
    )
    found = load_nastran(path, table)
    assert set(np.asarray(found.nodes.dof)[:, 1].tolist()) == {1, 2, 6}
    body = mbdlft.flexible_body("tee", *found, 10, {"right": 50}, modes=2)
    assert body.inertia.xx is None
    assert all(mode.participation[2] == 0.0 for mode in body.modes)


def test_dmig_cards_become_sparse_matrices() -> None:
    """A symmetric chain of 4,000 coordinates: a dense matrix would take 128 MB."""
    size = 4000

    def columns(name: str, beside: float) -> list[list[Any]]:
        below = [["", k + 1, 0, beside, ""] for k in range(1, size)]
        cards = [[name, k, 0, "", k, 0, 2.0, "", *below[k - 1][1:]] for k in range(1, size)]
        return [[name, 0, 6, 2, 0, "", "", ""], *cards, [name, size, 0, "", size, 0, 2.0, ""]]

    tracemalloc.start()
    dof, mass, stiffness = files._dmig([*columns("maa", 0.5), *columns("KAA", -1.0)], "MAA", "KAA")
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 3e7
    exact(dof, [(k, 0) for k in range(1, size + 1)])
    for matrix, beside in ((mass, 0.5), (stiffness, -1.0)):
        off = np.full(size - 1, beside)
        right = sp.diags_array([off, np.full(size, 2.0), off], offsets=(-1, 0, 1))
        assert abs(matrix - right).max() == 0.0
    with pytest.raises(StructureError, match="two values for one entry"):
        files._dmig([["m", 0, 6, 2], ["m", 1, 1, "", 2, 1, 3.0], ["m", 2, 1, "", 1, 1, 3.0]], "m", "m")
    with pytest.raises(StructureError, match="form 9 and type 2, expected form 1, 2 or 6"):
        files._dmig([["m", 0, 9, 2]], "m", "m")


def test_included_files_lie_below_the_folder(tmp_path: Path) -> None:
    fe = tee(2)
    path, table = tmp_path / "tee.op4", tmp_path / "model" / "tee.bdf"
    (tmp_path / "model" / "parts").mkdir(parents=True)
    op4.write(str(path), {"maa": fe.mass_matrix, "kaa": fe.stiffness_matrix})
    lines = grid_cards(fe).splitlines(keepends=True)
    table.write_text("include 'parts/\n  first.bdf'\n" + "".join(lines[4:]))
    (tmp_path / "model" / "parts" / "first.bdf").write_text("INCLUDE 'second.bdf'\n" + "".join(lines[:2]))
    (tmp_path / "model" / "parts" / "second.bdf").write_text("".join(lines[2:4]))
    found = load_nastran(path, table)
    exact(found.nodes.coordinates, fe.nodes.coordinates)
    (tmp_path / "tee.bdf").write_text("".join(lines))
    for name, why in INCLUDED.items():
        table.write_text(f"INCLUDE '{name}'\n")
        with says(StructureError, "INCLUDE", why):
            load_nastran(path, table)


INCLUDED = {
    "../tee.bdf": "reads files below",
    "/etc/hostname": "reads files below",
    "tee.bdf": "reads a file once",
    "a\0b": "cannot be read: embedded null",
    "x" * 5000: "cannot be read: [Errno 36]",
}


def test_included_files_end(tmp_path: Path) -> None:
    """Twice the next in each of 40 files were 2^40 files; a chain of 1,500 was a RecursionError."""
    for count, times, why in ((40, 2, "reads a file once"), (1500, 1, "at most 500 files")):
        for k in range(count):
            (tmp_path / f"{k}.bdf").write_text(f"INCLUDE '{k + 1}.bdf'\n" * times)
        (tmp_path / f"{count}.bdf").write_text("")
        with says(StructureError, "INCLUDE", why):
            load_nastran(tmp_path / "0.bdf", tmp_path / "0.bdf")


GRID = "GRID,1,,0.,0.,0.\n"


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("GRID,1.5,,0.,0.,0.\n", "GRID and EXTRN: expected numbers of nodes from 0 to"),
        ("GRID,99999999999999999999,,0.,0.,0.\n", "got 1e+20"),
        ("GRID,1,,0.,0.,1.O\n", "GRID 1: expected a number, got '1.O'"),
        ("CORD2R,5,0,1.,2.,3.,1.,3.,x\n,1.,2.,4.\n" + GRID, "CORD2R 5: expected a number, got 'x'"),
        ("CORD2R,5,0,1.,2.,3.,1.,3.,3.\n,1.,2.,4.\nGRDSET,,5\n" + GRID, "GRDSET is not read"),
        (GRID + "EXTRN,1,123456.5\n", "got 123456.5"),
        (GRID + "EXTRN,1,THRU,6,1\n", "EXTRN 1: expected a number, got 'THRU'"),
    ],
)
def test_cards_that_would_be_read_as_others(text: str, why: str, tmp_path: Path) -> None:
    """Words were 0, 1.5 was 1, and coordinates in the system of a GRDSET were those of the basic one."""
    op4.write(str(tmp_path / "a.op4"), {"maa": np.eye(6), "kaa": np.eye(6)})
    (tmp_path / "a.bdf").write_text(text)
    with says(StructureError, "a.bdf: cannot be read as bulk data", why):
        load_nastran(tmp_path / "a.op4", tmp_path / "a.bdf")


@pytest.mark.parametrize(
    "card",
    [
        "GRID,2,,1_0.,0.,0.",
        "GRID,2,,0.,+1_0.,0.",
        "SPOINT,1_0",
        "GRID    2               1_0.    0.",
        "GRID    2               +1_0.   0.",
    ],
)
def test_an_underscore_is_no_digit(card: str, tmp_path: Path) -> None:
    """1_0 was 10; names may have underscores."""
    op4.write(str(tmp_path / "a.op4"), {"maa": np.eye(6), "kaa": np.eye(6)})
    named = "$ 1_0\nPARAM,A_1,1_0\nGRID,1,,0.,0.,0.,,,+1_0\n+1_0\n"
    (tmp_path / "a.bdf").write_text(named)
    assert load_nastran(tmp_path / "a.op4", tmp_path / "a.bdf").nodes.numbers.tolist() == [1]
    (tmp_path / "a.bdf").write_text(f"{named}{card}\n")
    with says(StructureError, "a.bdf: expected a number, got '1_0"):
        load_nastran(tmp_path / "a.op4", tmp_path / "a.bdf")


def test_scalar_points_by_their_first_and_last(tmp_path: Path) -> None:
    op4.write(str(tmp_path / "a.op4"), {"maa": np.eye(11), "kaa": np.eye(11)})
    (tmp_path / "a.bdf").write_text(GRID + "SPOINT,7,THRU,11\n")
    found = load_nastran(tmp_path / "a.op4", tmp_path / "a.bdf").nodes.dof
    exact(found, [(1, k) for k in range(1, 7)] + [(k, 0) for k in range(7, 12)])


@pytest.mark.parametrize("where", [(1.5, 1), (-1, 1), (1, 12), (1, 7), (1, 1.5), (2**60, 1)])
def test_dmig_of_numbers_that_are_none(where: tuple[float, float]) -> None:
    """Component 12 of node 1 was component 2 of node 2."""
    for card in (["m", *where, "", 1, 1, 3.0], ["m", 1, 1, "", *where, 3.0]):
        with says(StructureError, "matrix 'm': expected "):
            files._dmig([["m", 0, 6, 2], card], "m", "m")


@pytest.mark.parametrize("use", [to_si, lambda elements: modal_model(*elements, 10, {}, modes=1)])
def test_matrices_that_are_none(use: Any) -> None:
    """Structural damping in the stiffness was dropped; other sizes were an error of scipy."""
    fe = tee(2)
    for matrix, why in (
        (fe.stiffness_matrix * (1 + 0.02j), "stiffness matrix: expected a matrix of real numbers"),
        (fe.stiffness_matrix[:-1], "stiffness matrix: expected 42 x 42"),
        (np.nan * fe.stiffness_matrix, "stiffness matrix: expected finite entries"),
    ):
        with says(StructureError, why):
            use(fe._replace(stiffness_matrix=matrix))
