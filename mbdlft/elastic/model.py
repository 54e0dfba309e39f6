"""From mass and stiffness matrices to a body in modal form, held at its parent."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.linalg
import scipy.sparse as sp

from mbdlft.base.array import Array
from mbdlft.base.errors import StructureError, unknown_name
from mbdlft.elastic.eigen import MASSLESS
from mbdlft.elastic.matrices import checked
from mbdlft.elastic.nodes import DIRECTIONS, Nodes
from mbdlft.elastic.partition import partition
from mbdlft.elastic.reduction import Candidates, Reduced, Structure, candidates
from mbdlft.elastic.rigid import Rigid, rigid_properties
from mbdlft.elastic.select import Limit, chosen

METHODS = ("hurty", "craig-bampton", "effective-mass")
SLOWEST, FASTEST = 6e-4, 6e6  # rad/s: 0.0001 Hz and 1 MHz; no structure is beyond
_GROUNDED = 1e-3  # frequency of a rigid motion on what grounds it, of the first mode
# of the largest possible entry: an effective mass that would be the rounding of the rigid mass
_NOTHING = float(np.sqrt(np.finfo(float).eps))
_MASSLESS = 1e-10  # of the rigid mass: a bar has no inertia about its own axis
_CANCELLED = 1e3 * float(np.finfo(float).eps)  # of the terms that cancel in a rigid motion


@dataclass(frozen=True, slots=True, eq=False)
class ModalModel:
    """A structure held at its parent, by modes of unit mass.

    Attributes
    ----------
    method : one of ``hurty``, ``craig-bampton``, ``effective-mass``
    kept : number of modes that were chosen; the first two methods add one for each motion of the ports
    frequencies : (n,) rad/s, ascending
    participation : (6, n), participation factors about the origin (kg^1/2, kg^1/2 m)
    shapes : (6, n) of each port (kg^-1/2, kg^-1/2 m^-1)
    ports : (3,) of each port from the origin (m)
    rigid : mass, center of mass and inertia about the origin
    grounding : largest frequency (rad/s) of a rigid motion on what is left of supports in the stiffness;
        0 in an exact model
    """

    method: str
    kept: int
    frequencies: Array
    participation: Array
    shapes: Mapping[str, Array]
    ports: Mapping[str, Array]
    rigid: Rigid
    grounding: float


def modal_model(
    mass_matrix: Any,
    stiffness_matrix: Any,
    nodes: Nodes,
    parent: Any,
    ports: Mapping[str, Any],
    *,
    method: str = "hurty",
    modes: int | None = None,
    frequency: float | None = None,
    effective_mass: float | None = None,
) -> ModalModel:
    """Modal form of a finite-element model that is free in space: M = 1, K = diag(w^2).

    Parameters
    ----------
    mass_matrix, stiffness_matrix : (N, N), dense or sparse, symmetric
        Of the free structure (no supports), in m, kg and s.
    nodes : Nodes
    parent : node number, several, or an `Interface`
        Where the body is held: its origin. Several nodes are made rigid.
    ports : mapping of names to the same
    method : ``hurty``, ``craig-bampton`` or ``effective-mass``
        The first two keep modes with all interfaces fixed, and the constraint modes of the ports: exact
        for static loads at the ports. The third keeps the modes with free ports.
    modes, frequency, effective_mass : one of them
        How many of these modes; up to which frequency (rad/s); or as few as make the effective mass at
        least this fraction, between 0 and 1, of the rigid one in each direction.

    Raises
    ------
    StructureError
        Data that are not those of a free structure, or interfaces that it does not have.

    Source: equations (4.21) to (4.41) of the two-port models in `tests/reference/flexible.py`, with any
    number of ports; a last eigenproblem is a constant change of coordinates.
    """
    if method not in METHODS:
        raise StructureError(unknown_name("method", str(method), METHODS))
    limit = Limit(modes, frequency, effective_mass)
    structure = _structure(mass_matrix, stiffness_matrix, nodes, parent, ports)
    at = structure.at
    held = candidates(structure, "effective-mass", nodes)
    first = _first_frequency(held)
    bodily = at.rigid.T @ (structure.mass @ at.rigid)
    rigid = rigid_properties(nodes, at, bodily)
    grounding = _grounding(structure, bodily, first)
    found = held if method == "effective-mass" else candidates(structure, method, nodes)
    kept, reduced = chosen(found, limit, np.diag(bodily))
    w, coupling, ports_move = _modal(reduced)
    size = np.sqrt(np.maximum(np.diag(bodily), 0.0))[:, None]
    coupling[np.abs(coupling) <= _NOTHING * size] = 0.0
    participation = np.zeros((6, len(w)))
    participation[list(at.directions)] = coupling
    # rotations times the size of the structure are comparable with displacements
    reach = np.max(np.linalg.norm(np.asarray(nodes.coordinates) - at.origin, axis=1))
    extent = np.where(np.array(at.directions) < 3, 1.0, reach if reach > 0.0 else 1.0)
    shapes = {}
    for name, place in at.ports.items():
        moved = ports_move[place.start - at.interior : place.stop - at.interior]
        scaled = np.abs(moved) * extent[:, None]
        moved[scaled <= _NOTHING * np.max(scaled)] = 0.0
        shapes[name] = np.zeros((6, len(w)))
        shapes[name][list(at.directions)] = moved
    return ModalModel(
        method=method,
        kept=kept,
        frequencies=w,
        participation=participation,
        shapes=shapes,
        ports=at.positions,
        rigid=rigid,
        grounding=grounding,
    )


def _structure(
    mass_matrix: Any, stiffness_matrix: Any, nodes: Nodes, parent: Any, ports: Mapping[str, Any]
) -> Structure:
    rows = len(np.asarray(nodes.dof))
    matrices = (checked("mass", mass_matrix, rows), checked("stiffness", stiffness_matrix, rows))
    at = partition(nodes, parent, ports)
    if not at.interior:
        raise StructureError(
            "all nodes belong to interfaces; nothing is left to deform. Refine the mesh."
        )
    mass, stiffness = (sp.csr_array(at.expand.T @ matrix @ at.expand) for matrix in matrices)
    return Structure(mass, stiffness, at)


def _first_frequency(held: Candidates) -> float:
    """The lowest frequency (rad/s) of the structure held at its parent, ports free."""
    found = held.modes(1).frequencies
    if not len(found):
        raise StructureError("mass matrix: nothing that can move has mass; no frequency is finite.")
    first = float(found[0])
    if not SLOWEST < first < FASTEST:
        raise StructureError(
            f"the first frequency is {first / (2.0 * np.pi):.3g} Hz; expected one between 0.0001 "
            "Hz and 1 MHz. The units "
            "of the matrices do not fit together: give m, kg, s, N, or convert consistent units "
            "(mm, t, s, N) with "
            "mbdlft.to_si."
        )
    return first


def _grounding(structure: Structure, bodily: Array, first: float) -> float:
    """The largest frequency (rad/s) of a rigid motion on what is left of supports."""
    rigid, stiffness = structure.at.rigid, structure.stiffness
    energy = np.diag(rigid.T @ (stiffness @ rigid))
    rounding = _CANCELLED * np.diag(np.abs(rigid).T @ (abs(stiffness) @ np.abs(rigid)))
    mass = np.diag(bodily)
    left = np.where(np.abs(energy) > rounding, energy, 0.0)
    floor = _MASSLESS * np.max(mass)
    w = np.sqrt(np.maximum(left, 0.0) / np.maximum(mass, floor))
    worst = int(np.argmax(w))
    if w[worst] > _GROUNDED * first:
        raise StructureError(
            f"the rigid motion {DIRECTIONS[structure.at.directions[worst]]} deforms the structure: "
            "on its stiffness "
            f"it would have the frequency {w[worst] / (2.0 * np.pi):.3g} Hz (first mode "
            f"{first / (2.0 * np.pi):.3g} Hz). Write "
            "the matrices of the free structure, without supports; check the coordinates and axes "
            "of the nodes "
            "and the order of the rows."
        )
    return float(w[worst])


def _modal(reduced: Reduced) -> tuple[Array, Array, Array]:
    """w (q,), P (r, q) and the motion (e, q) of the ports, in coordinates with M = 1, K = diag(w^2)."""
    scale = 1.0 / np.sqrt(np.diag(reduced.stiffness))
    mass, stiffness = (matrix * np.outer(scale, scale) for matrix in reduced[:2])
    mu, vectors = scipy.linalg.eigh(0.5 * (mass + mass.T), 0.5 * (stiffness + stiffness.T))
    mu, vectors = mu[::-1], vectors[:, ::-1]
    if mu[-1] <= MASSLESS * mu[0]:
        raise StructureError(
            "mass matrix: a coordinate that is kept has no mass (a rotation of a port where the "
            "masses are "
            "lumped). Use a consistent mass matrix, more modes, or the method 'effective-mass'."
        )
    w = 1.0 / np.sqrt(mu)
    basis = scale[:, None] * vectors * w
    coupling, ports = reduced.coupling.T @ basis, reduced.ports @ basis
    # a mode has no sign of its own: that of its largest participation is made positive
    size = np.maximum(np.max(np.abs(coupling), axis=1, keepdims=True), np.finfo(float).tiny)
    largest = np.argmax(np.abs(coupling) / size, axis=0)
    sign = np.where(coupling[largest, np.arange(len(w))] < 0.0, -1.0, 1.0)
    return w, coupling * sign, ports * sign
