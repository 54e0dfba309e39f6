"""A solar panel on a fork, meshed with scikit-fem (the extra `bodies`); the script writes solar_panel.h5.

    python -m bodies.solar_panel            # write the data of the catalogue body
    python -m bodies.solar_panel --check    # print the first frequencies on finer meshes

The elements are solids of second order (27 nodes). The material is isotropic, with the properties of
`PARTS`:

    K_ij = int lambda d_i u d_j v + mu d_j u d_i v + delta_ij mu grad u . grad v,   M = int rho u v
"""

import sys
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np
import scipy.sparse as sp
import skfem
from numpy.typing import NDArray

from mbdlft import FiniteElements, Nodes, every_dof, modal_model, save_matrices

Array = NDArray[np.float64]


class Part(NamedTuple):
    """Modulus (Pa), Poisson's ratio and density (kg/m^3) of a solid that is equivalent to a part."""

    modulus: float
    poisson: float
    density: float


PARTS = {"fork": Part(1.5e10, 0.3, 500.0), "panel": Part(5.0e9, 0.3, 160.0)}
THICKNESS, LENGTH = 0.025, 2.8
EDGE = 0.8  # x of the inner edge of the panel
X = (0.0, 0.15, 0.3, 0.4, 0.6, EDGE, 1.2, 1.6, 2.0, 2.4, LENGTH)
Y = (-0.6, -0.4, -0.3, -0.05, 0.05, 0.3, 0.4, 0.6)


def mesh(cuts: int = 1) -> skfem.MeshHex:
    """Hexahedra of the fork and the panel; each length of the grid is cut into `cuts` parts."""
    x, y = (_cut(lines, cuts) for lines in (X, Y))
    grid = skfem.MeshHex.init_tensor(x, y, np.array([0.0, THICKNESS]) - THICKNESS / 2)
    center = np.mean(grid.p[:, grid.t], axis=1)
    across = np.abs(center[1])
    stem = (center[0] < 0.3) & (across < 0.05)
    bar = (center[0] > 0.3) & (center[0] < 0.4) & (across < 0.4)
    arms = (center[0] > 0.4) & (center[0] < EDGE) & (across > 0.3) & (across < 0.4)
    kept = stem | bar | arms | (center[0] > EDGE)
    return grid.remove_elements(np.flatnonzero(~kept))


def elements(cuts: int = 1) -> FiniteElements:
    """Matrices and node table, with three displacements at each node."""
    basis = skfem.Basis(mesh(cuts), skfem.ElementHex2())
    mass = skfem.BilinearForm(lambda u, v, w: _field(w, "density") * u * v).assemble(basis)
    blocks = [[skfem.BilinearForm(_stiffness(i, j)).assemble(basis) for j in range(3)] for i in range(3)]
    count = mass.shape[0]
    # the rows are sorted by node, with three displacements each
    order = np.arange(3 * count).reshape(3, count).T.ravel()
    stiffness = sp.csr_array(sp.block_array(blocks))[order][:, order]
    stiffness = 0.5 * (stiffness + stiffness.T)
    coordinates = np.round(basis.doflocs.T, 12)  # the coordinates of midpoints are rounded sums
    numbers = np.arange(1, count + 1)
    nodes = Nodes(numbers, coordinates, every_dof(numbers, (1, 2, 3)))
    return FiniteElements(sp.csr_array(sp.kron(mass, sp.eye_array(3))), stiffness, nodes)


def interfaces(data: FiniteElements) -> tuple[list[int], list[int]]:
    """Nodes of the root of the fork, and of the middle of the outer edge."""
    x, y, _ = np.asarray(data.nodes.coordinates).T
    numbers = np.asarray(data.nodes.numbers)
    root, tip = numbers[x == 0.0], numbers[(x == LENGTH) & (np.abs(y) <= 0.05)]
    return root.tolist(), tip.tolist()


def main() -> None:
    """Write the data, or print the first frequencies on finer meshes."""
    if "--check" in sys.argv:
        for cuts in (1, 2, 3):
            data = elements(cuts)
            root, tip = interfaces(data)
            model = modal_model(*data, root, {"tip": tip}, method="effective-mass", modes=6)
            print(cuts, data.mass_matrix.shape[0], np.round(model.frequencies / (2 * np.pi), 4))
        return
    data = elements()
    root, tip = interfaces(data)
    path = Path(__file__).with_suffix(".h5")
    save_matrices(path, data)
    print(f"{path}: {data.mass_matrix.shape[0]} coordinates, parent = {root}, tip = {tip}")


def _cut(lines: tuple[float, ...], cuts: int) -> Array:
    """The grid lines (m) with each distance between two of them cut into `cuts` parts."""
    steps = [np.linspace(a, b, cuts + 1)[1:] for a, b in pairwise(lines)]
    return np.concatenate([[lines[0]], *steps])


def _field(w, name: str) -> Array:  # type: ignore[no-untyped-def]
    """A property of the material at the points of integration."""
    values = [getattr(PARTS[part], name) for part in ("fork", "panel")]
    return np.where(w.x[0] < EDGE, *values)


def _stiffness(i: int, j: int):  # type: ignore[no-untyped-def]
    """The bilinear form of the block (i, j) of the stiffness matrix."""

    def form(u, v, w):  # type: ignore[no-untyped-def]
        modulus, poisson = _field(w, "modulus"), _field(w, "poisson")
        mu = modulus / (2.0 * (1.0 + poisson))
        lame = modulus * poisson / ((1.0 + poisson) * (1.0 - 2.0 * poisson))
        # row i has the test function v along i, column j the displacement u along j
        density = lame * v.grad[i] * u.grad[j] + mu * v.grad[j] * u.grad[i]
        return density + (mu * sum(u.grad[k] * v.grad[k] for k in range(3)) if i == j else 0.0)

    return form


if __name__ == "__main__":
    main()
