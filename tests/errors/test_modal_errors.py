"""Errors of finite-element data: matrices, node tables, interfaces, units, files, catalogue bodies."""

from collections.abc import Callable
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp

import mbdlft
from tests.errors.table import refused, says
from tests.reference.frames import frame, straight, tee

pytestmark = pytest.mark.usefixtures("read_here")

ROOT = Path(__file__).parents[2]
N = 30  # coordinates of the beam of `broken`: 5 nodes, 10 to 50


def broken(
    change: Callable[[Any, Any], None] | None = None,
    parent: Any = 10,
    ports: Any = None,
    nodes: mbdlft.Nodes | None = None,
    **options: Any,
) -> Any:
    """Modal model of a beam of four elements with its matrices changed."""
    mass, stiffness, table = straight(4)
    if change:
        change(mass, stiffness)
    chosen = {"modes": 3} if not set(options) & {"modes", "frequency", "effective_mass"} else {}
    return mbdlft.modal_model(
        mass, stiffness, nodes or table, parent, {"tip": 50} if ports is None else ports,
        **chosen, **options,
    )  # fmt: skip


def entry(which: int, i: int, j: int, value: float) -> Callable[[Any, Any], None]:
    def change(*matrices: Any) -> None:
        matrices[which][i, j] = value

    return change


def scaled(which: int, factor: float) -> Callable[[Any, Any], None]:
    def change(*matrices: Any) -> None:
        matrices[which][:] *= factor

    return change


def support(_: Any, stiffness: Any) -> None:
    stiffness[13, 13] += 1e4


def lighter(mass: Any, _: Any) -> None:
    mass[7, 7] *= 0.5


def weightless(mass: Any, _: Any) -> None:
    mass[range(3), range(3)] = -50.0


def tied(mass: Any, _: Any) -> None:
    """Masses that couple a displacement to the rotation of another node."""
    mass[6, 22] = mass[22, 6] = 0.01


def spun(mass: Any, _: Any) -> None:
    """Negative rotary inertia that the rigid inertia does not show."""
    mass[9, 9] -= 0.02
    mass[15, 15] -= 0.02
    mass[9, 15] += 0.02
    mass[15, 9] += 0.02


def negative(_: Any, stiffness: Any) -> None:
    stiffness[25:, 25:] *= 0.3


def cut(_: Any, stiffness: Any) -> None:
    """The outer half of the beam is not connected to the inner."""
    stiffness[:18, 18:] = stiffness[18:, :18] = 0.0
    small = straight(2, 1.0).stiffness_matrix
    stiffness[:18, :18] = small
    stiffness[18:, 18:] = straight(1, 0.5).stiffness_matrix


def of(mass: Any, stiffness: Any) -> Any:
    return mbdlft.modal_model(mass, stiffness, straight(4).nodes, 10, {"tip": 50}, modes=3)


def lumped(*masses: float) -> Any:
    """Three nodes in a row with these masses: a rotation has none in any motion that is kept."""
    nodes = mbdlft.Nodes([1, 2, 3], np.zeros((3, 3)), mbdlft.every_dof([1, 2, 3], (1,)))
    stiffness = np.array([[1, -1, 0], [-1, 2, -1], [0, -1, 1.0]])
    return mbdlft.modal_model(np.diag(masses), stiffness, nodes, 1, {"tip": 3}, modes=1)


def only(elements: Any, *components: int, nodes: Any = ()) -> Any:
    """The structure with these components of displacements, at some nodes only."""
    dof = np.asarray(elements.nodes.dof)
    kept = np.isin(dof[:, 1], components) | ~np.isin(dof[:, 0], nodes or dof[:, 0])
    table = mbdlft.Nodes(elements.nodes.numbers, elements.nodes.coordinates, dof[kept])
    at = np.ix_(kept, kept)
    return mbdlft.FiniteElements(elements.mass_matrix[at], elements.stiffness_matrix[at], table)


def truss() -> Any:
    """A tetrahedron of six bars."""
    corners, stiffness = np.vstack([np.zeros(3), np.eye(3)]), np.zeros((12, 12))
    for a, b in combinations(range(4), 2):
        stretch = np.zeros((4, 3))
        stretch[b] = (corners[b] - corners[a]) / np.linalg.norm(corners[b] - corners[a])
        stretch[a] = -stretch[b]
        stiffness += 1e3 * np.outer(stretch, stretch)
    return np.eye(12), stiffness, points(corners)


def points(places: Any) -> mbdlft.Nodes:
    """Nodes with displacements only."""
    numbers = [*range(1, 1 + len(places))]
    return mbdlft.Nodes(numbers, places, mbdlft.every_dof(numbers, (1, 2, 3)))


@pytest.fixture
def saved(tmp_path: Path) -> Callable[..., Path]:
    """A file of arrays by name, or of a text."""

    def write(name: str, text: str = "", **arrays: Any) -> Path:
        file = tmp_path / name
        file.write_text(text)
        if arrays:
            np.savez(file, **arrays)
        return file

    return write


@pytest.fixture
def nastran(tmp_path: Path) -> Callable[..., Any]:
    """What is read of one node and matrices in x.op4, or in the first bytes of it in cut.op4."""
    from pyyeti.nastran import op4

    (tmp_path / "nodes.bdf").write_text("GRID    10              0.      0.      0.\n")
    op4.write(str(tmp_path / "x.op4"), {"maa": np.eye(6), "kbb": np.eye(6), "kcc": np.eye(5)})

    def load(file: str, nodes: str = "nodes.bdf", end: int = 0, **names: str) -> Any:
        (tmp_path / "cut.op4").write_bytes((tmp_path / "x.op4").read_bytes()[:end])
        return mbdlft.load_nastran(tmp_path / file, tmp_path / nodes, **names)

    return load


# displacements only, as in solid elements: one node is a ball joint, nodes on a line a hinge
SOLID = only(tee(3), 1, 2, 3, nodes=(10,))
BENT = frame(np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0.5]]), [(0, 1), (1, 2)])
CHAIN = np.array([[1, -1, 0], [-1, 2, -1], [0, -1, 1.0]])
ONE = {"numbers": [1], "coordinates": [[0, 0, 0.0]], "dof": [[1, 1]], "mass": [[1.0]]}
TWO = {**ONE, "dof": [[1, 1], [1, 2]], "mass": np.eye(2)}
MASS, STIFFNESS = straight(4)[:2]
TEXTS = 'format = "mbdlft-body/1"\ndescription = "d"\nsource = "s"\n'
POINT = 'body = { kind = "point_mass", mass = 2 }\n'
test_messages = refused(
    r"""
> {} => StructureError:
broken(parent=11) => parent: node 11 is not in the node table, which has 5 nodes
broken(ports={"tip": 60}) => port 'tip': node 60 is not in the node table
broken(parent={"root"|()|1.5}) => parent: expected the number of a node, several numbers
broken(ports={"tip": 10}) => node 10 belongs to parent and to port 'tip'.
broken(parent=Interface((10,), (0.0, np.inf, 0.0)))
    => parent: point: expected three coordinates (m), got (0.0, inf, 0.0).
broken(parent=(10, 20), ports={"tip": (30, 40, 50)}) => all nodes belong to interfaces
broken(method="guyan") => unknown method 'guyan'.
broken(modes=3, frequency=100.0) => got modes and frequency.
broken(modes={-1|True}) => modes: expected a whole number, 0 or more, got {0}.
broken(modes=19) => modes: 19 are asked for and there are 18
broken(frequency=0.0) => frequency: expected a positive number (rad/s), got 0.0.
broken(effective_mass=1.0) => effective_mass: expected a fraction of the rigid
broken(effective_mass=0.9999) => effective_mass: 0.9999 is asked for; 18 modes have 0.9
broken(method="effective-mass", modes=0)
    => no mode is kept, the first is at 36.5449 rad/s: ask for at least one.
broken(method="effective-mass", frequency=1.0) => no mode is kept, the first is at
modal_model(*straight(4), 10, {"tip": 50}) => expected one of modes … got none.
Nodes([], []) => node table: coordinates: expected the shape (0, 3)
Nodes([], np.zeros((0, 3))) => node table: expected at least one node, got none.
Nodes([1, 1], np.zeros((2, 3))) => node table: node 1 is given twice.
Nodes([1.5], np.zeros((1, 3))) => node table: numbers: expected whole numbers
Nodes([1], np.zeros((1, 2))) => coordinates: expected the shape (1, 3), got (1, 2).
Nodes([1], [[0, 0, np.nan]]) => coordinates: expected finite numbers
Nodes([1], [[0, 0, 0]], [[1, 7]]) => dof: component 7 of node 1; expected 1, 2, 3
Nodes([1], [[0, 0, 0]], [[2, 1]]) => dof: node 2 is not in the node table
Nodes([1], [[0, 0, 0]], [[1, 1], [1, 1]]) => component 1 of node 1 is there twice.
Nodes([1], [[0, 0, 0]], [[1, 1, 1]]) => dof: expected a row of two (node, component)
Nodes([1], [[0, 0, 0]], axes=[{2 * np.eye(3)|np.diag([1, 1, -1])}])
    => the axes of node 1 are not right-handed and orthonormal.
to_si(straight(2), length="kg") => to_si: length: expected a unit of length such as 'm', got 'kg'.
mbdlft.flexible_body("b", *straight(4), 10, {"tip": 50}, modes=3, damping=[0.1, 0.2])
    => body 'b': damping: expected one ratio or 9, one for each mode, got 2.
# Data given as modes, not as matrices: the check of the body itself.
mbdlft.assemble(mbdlft.Scene(name='s', bodies=[RigidBody(name='hub', mass=1, inertia=Inertia(xx=1, yy=1,
    zz=1)), FlexibleBody(name='p', mass=3, inertia=Inertia(xx=1, yy=1, zz=1), modes=[Mode(frequency=3.0,
    participation=(0, 0, 2.0, 0, 0, 0))])], joints=[mbdlft.Free(name='free', parent='ground',
    child='hub'), mbdlft.Fixed(name='fixed', parent='hub', child='p')]))
    => SceneError: 'p' … the participation factors exceed the rigid mass
of(MASS[:-1, :-1], STIFFNESS) => mass matrix: expected 30 x 30 … got 29 x 29
of(MASS, STIFFNESS[:, :-1]) => stiffness matrix: expected 30 x 30 … got 30 x 29
of("heavy", STIFFNESS) => mass matrix: expected a matrix of real numbers
lumped(1.0, 1.0, 0.0) => mass matrix: a coordinate that is kept has no mass
lumped(1.0, 0.0, 0.0) => mass matrix: nothing that can move has mass
(tmp_path / "box.toml").write_text(""), load_body(tmp_path / "box.toml")
    => SceneError: box.toml … format: expected 'mbdlft-body/1', got None.
load_body(body_of(tmp_path, POINT), modes=3)
    => SceneError: box.toml: 'modes' cannot be chosen: the body has no matrices.
mbdlft.elastic.catalogue.reduced_body(body_of(tmp_path, POINT))
    => SceneError: box.toml: the body has no matrices ('data').
load_body(ROOT / "bodies" / "solar_panel.toml", mode=3)
    => SceneError: solar_panel.toml: unknown choice 'mode'. Did you mean 'modes'?
> load_body(body_of(tmp_path, {})) => SceneError: box.toml …
"" => 'data' is missing.
"mass = 1\n" => unknown key 'mass'.
"body = 1\n" => body: expected a table, got 1.
"data = 1\nparent = 1\nports = {}\n" => data: expected a text, got 1.
'body = { kind = "rigid", mass = 1, modes = 1 }\n' => unknown key 'modes'
'data = "x.npz"\nparent = 1\nports = {}\n' => StructureError: x.npz: cannot be read
'data = "x.npz"\nparent = { node = 1 }\nports = {}\n'
    => StructureError: parent: expected nodes and, if need be, a point, got {'node': 1}.
# An arm with one mode, given by its results.
> results(**{}) => StructureError:
{"frequencies": []} => frequencies: expected some between
{"frequencies": [0.0]} => in rad/s (not Hz, not squares), got [0.0].
{"frequencies": [[1.0]]} => frequencies: expected the shape (1,), got (1, 1).
{"reactions": np.ones((3, 1))} => reactions: expected the shape (6, 1), got (3, 1).
{"reactions": "x"} => reactions: expected numbers of shape (6, 1).
{"shapes": {}} => port 'tip' has no mode shapes in `shapes`.
{"ports": {}} => port 'tip' has no position in `ports`.
{"shapes": {"tip": np.ones((6, 2))}} => shapes of 'tip': expected the shape (6, 1), got
{"modal_masses": [-1.0]} => modal_masses: expected positive masses, got -1.
{"inertia": [[1, 1, 0], [0, 1, 0], [0, 0, 1]]} => inertia: expected a symmetric matrix.
{"mass": 1.0} => reactions: the participation factors exceed the rigid mass
{"modal_masses": [0.1]} => reactions: the participation factors exceed the rigid mass
> broken({}) => StructureError:
entry(0, 3, 4, 0.5) => mass matrix: not symmetric: entry (4, 5) is 0.5 and (5, 4) is 0.
entry(1, 3, 4, 1e9) => stiffness matrix: not symmetric: entry (4, 5) is 1e+09
entry(0, 2, 2, np.nan) => mass matrix: expected finite entries, got nan or inf.
entry(1, 20, 20, -1.0) => stiffness matrix: component 3 of node 40 has a negative stiffness
entry(1, 20, 20, 0.0) => stiffness matrix: component 3 of node 40 has no stiffness (0)
spun => mass matrix: indefinite: a motion of the structure has negative
negative => stiffness matrix: indefinite: the structure held at the parent
cut => stiffness matrix: singular although the structure is held at the parent
scaled(0, -1.0) => mass matrix: indefinite: a motion of the structure has negative
entry(0, 20, 20, -5.0) => mass matrix: indefinite: a motion of the structure has negative
scaled(0, 0.0) => mass matrix: nothing that can move has mass
weightless => mass matrix: the mass of the structure is -47.
support => deforms the structure: on its stiffness it would have the frequency
lighter => mass matrix: the mass is not the same in all directions (x: 3.24 kg, y:
tied => mass matrix: not that of a body: in a rigid motion, the entry (x, ry)
scaled(1, 1e-14) => the first frequency is 5.82e-07 Hz; expected one between 0.0001 Hz
scaled(1, 1e14) => MHz.
> modal_model({}) => StructureError:
*SOLID, 10, {"p": 70}, modes=3 => parent: it does not hold rx, ry, rz, in which the port 'p' can move
*SOLID, 10, {}, modes=3 => no displacements that tell where its center of mass is along x
*SOLID, 70, {"p": 10}, modes=3 => port 'p': its nodes have no rx and no ry and no rz
*truss(), 1, {}, method="effective-mass", modes=3
    => stiffness matrix: singular although the structure is held
*truss(), (1, 2, 3), {}, method="effective-mass", modes=3 => accepted
np.eye(9), np.eye(9), points([[0, 0, 0], [1, 1, 0], [2, 2, 0]]), (1, 2, 3), {}, modes=1
    => parent: its nodes do not determine all of the motions
np.eye(6), np.eye(6), Nodes([1, 2], [[0, 0, 0], [1, 0, 0]], every_dof([1])), 1, {"tip": 2}, modes=1
    => port 'tip': node 2 has no coordinate in the matrices.
*only(straight(3), 4), 10, {}, modes=1 => the structure has no displacements at its parent
sp.eye_array(3), sp.csr_array(CHAIN), only(BENT, 2).nodes, 10, {}, method="effective-mass", modes=1
    => no displacements that tell where its center of mass is along x
> load_matrices({}) => StructureError:
tmp_path / "x.mat" => x.mat: expected a name that ends in .npz, .h5, .hdf5 or .mass.mtx.
tmp_path / "x.{npz|h5}" => x.{0}: cannot be read
tmp_path / "x.mass.mtx" => x.mass.mtx: … x.nodes.txt: cannot be read
saved("x.npz", "no archive") => x.npz: cannot be read
saved("a.npz", numbers=[1]) => a.npz: 'coordinates' is missing. There are: numbers.
saved("b.npz", **ONE) => b.npz: 'stiffness' (dense) or 'stiffness.row' is missing.
saved("c.npz", **TWO, **{"stiffness.row": [0], "stiffness.column": [1], "stiffness.value": [1.0]})
    => c.npz: stiffness: expected the lower triangle
saved("d.nodes.txt", "# nodes\n{1_0 0 0 0 1|1 0 0 0_1 1|1 0.0 0.0|1 a b c 1|1.5 0 0 0 1}\n").with_name(
    "d.mass.mtx") => d.nodes.txt, line 2: expected the number of a node … {0}
> {} => StructureError:
save_matrices(tmp_path / "x.txt", straight(2))
    => x.txt: expected a name that ends in .npz, .h5 or .hdf5.
nastran("x.op4") => x.op4: unknown matrix 'KAA'. Existing: kbb, kcc, maa.
nastran("x.op4", stiffness="kcc") => x.op4: kcc is 5 x 5 … has 6 coordinates
nastran("cut.op4", stiffness="kbb", end={216|224|650}) => cut.op4: cannot be read … ends, … cut off
nastran("cut.op4", stiffness="kbb", end=228) => cut.op4: unknown matrix 'kbb'
nastran("cut.op4", end={30|40}) => cut.op4: cannot be read as NASTRAN matrices … cut off
nastran("y.op4") => y.op4: cannot be read: No such file
nastran("x.op4", "none.bdf") => none.bdf: cannot be read: No such file
"""
)


def test_a_plane_model_tells_what_it_does_not_know() -> None:
    model = mbdlft.modal_model(*only(BENT, 2, 4, 6), 10, {}, method="effective-mass", modes=2)
    assert np.isnan(model.rigid.inertia[1, 1])


def test_nastran_files_need_a_package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "pyyeti.nastran.op4", None)
    with says(mbdlft.StructureError, "pyYeti, which cannot be imported", "mbdlft[nastran]"):
        mbdlft.load_nastran(tmp_path / "x.op4", tmp_path / "nodes.bdf")


def results(**changes: Any) -> Any:
    """A slender arm with one mode."""
    given = {
        "frequencies": [3.0], "reactions": 9.0 * np.array([[0, 0, 1.2, 0, -1.0, 0]]).T,
        "shapes": {"tip": np.ones((6, 1))}, "ports": {"tip": (1, 0, 0)}, "mass": 3.0,
        "center": (0.5, 0, 0), "inertia": np.diag([0.1, 1.5, 1.5]), **changes,
    }  # fmt: skip
    w, reactions, shapes, ports = (given.pop(k) for k in ("frequencies", "reactions", "shapes", "ports"))
    return mbdlft.model_of_results(w, reactions, shapes, ports, **given)


def body_of(folder: Path, text: str) -> Path:
    (folder / "box.toml").write_text(TEXTS + text)
    return folder / "box.toml"


def test_a_body_of_a_file_has_its_name(tmp_path: Path) -> None:
    assert mbdlft.load_body(body_of(tmp_path, POINT)) == mbdlft.PointMass(name="box", mass=2)
