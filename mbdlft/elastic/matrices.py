"""Mass and stiffness matrices as they come from a finite-element program: checks, and units."""

from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp

from mbdlft.base.errors import StructureError
from mbdlft.base.unit import parse_unit
from mbdlft.elastic.nodes import Nodes

_SYMMETRY = 1e-8  # asymmetry that is rounding, of the largest entry: files have few digits


class FiniteElements(NamedTuple):
    """Mass and stiffness matrix (N, N), dense or sparse, and the node table of their rows."""

    mass_matrix: Any
    stiffness_matrix: Any
    nodes: Nodes


def to_si(elements: FiniteElements, length: str = "mm", mass: str = "t") -> FiniteElements:
    """The same model in m, kg and s, from other units of length and mass with seconds.

    A unit of length is L meters and a unit of mass is m kilograms. With u = S u_SI, where S is 1/L for
    displacements and 1 for rotations, and energies in units of m L^2/s^2,

        M_SI = m L^2 S M S,   K_SI = m L^2 S K S

    Parameters
    ----------
    elements : FiniteElements
    length, mass : units, such as ``mm`` and ``t`` where forces are in N and moduli in MPa

    Raises
    ------
    StructureError
        `length` is not a unit of length, or `mass` is not one of mass.
    """
    L, m = _factor("length", length, "m"), _factor("mass", mass, "kg")
    nodes = elements.nodes
    component = np.asarray(nodes.dof)[:, 1]
    # a coordinate that belongs to no node (component 0) may have any scale
    scale = sp.diags_array(np.where(component <= 3, 1.0 / L, 1.0))
    matrices = [m * L**2 * (scale @ sp.csr_array(matrix) @ scale) for matrix in elements[:2]]
    coordinates = L * np.asarray(nodes.coordinates)
    mass_matrix, stiffness_matrix = matrices
    table = Nodes(nodes.numbers, coordinates, nodes.dof, nodes.axes)
    return FiniteElements(mass_matrix, stiffness_matrix, table)


def checked(what: str, matrix: Any, rows: int) -> Any:
    """The matrix as a symmetric csr_array (rows, rows): the mean of it and its transpose.

    Raises
    ------
    StructureError
        The shape is not that of the node table, an entry is not finite, or the matrix and its transpose
        differ by more than rounding.
    """
    try:
        given = sp.csr_array(matrix, dtype=float)
    except (TypeError, ValueError) as error:
        raise StructureError(
            f"{what} matrix: expected a matrix of real numbers: {error}."
        ) from None
    if given.ndim != 2 or given.shape != (rows, rows):
        raise StructureError(
            f"{what} matrix: expected {rows} x {rows}, one row for each dof of the node table, got "
            f"{' x '.join(map(str, given.shape))}. Give `dof` in the order of the rows."
        )
    if not np.all(np.isfinite(given.data)):
        raise StructureError(f"{what} matrix: expected finite entries, got nan or inf.")
    difference = abs(given - given.T)
    largest = abs(given).max() if given.nnz else 0.0
    if difference.nnz and difference.max() > _SYMMETRY * largest:
        entries = difference.tocoo()
        worst = int(np.argmax(entries.data))
        i, j = int(entries.row[worst]), int(entries.col[worst])
        raise StructureError(
            f"{what} matrix: not symmetric: entry ({i + 1}, {j + 1}) is {given[i, j]:g} and "
            f"({j + 1}, {i + 1}) is {given[j, i]:g}. A file may have one triangle only: add the "
            "transpose of what is off the diagonal."
        )
    return sp.csr_array(0.5 * (given + given.T))


def _factor(what: str, unit: str, si: str) -> float:
    """The unit over the SI unit `si` of the same dimension."""
    parsed = parse_unit(unit)
    if parsed.dimension != parse_unit(si).dimension:
        raise StructureError(
            f"to_si: {what}: expected a unit of {what} such as {si!r}, got {unit!r}."
        )
    return parsed.factor
