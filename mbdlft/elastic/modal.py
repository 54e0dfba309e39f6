"""Bodies in modal form, held at their parent, from mass and stiffness matrices of free structures.

With the participation factors P and the rigid-body mass matrix R' M R (`partition`), the effective masses
of the modes are the squares of P, and R' M R - P P' is the residual mass.

A structure that is held at its parent and vibrates in a mode phi of unit mass loads the parent with
w^2 phi' M R. So P = reaction / w^2 for those who have the results of a modal analysis only.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.linalg
import scipy.sparse as sp

from mbdlft.base.arguments import arguments_checked
from mbdlft.base.array import Array, ArrayLike
from mbdlft.base.errors import StructureError, check_known
from mbdlft.elastic.nodes import DIRECTIONS, Nodes, finite
from mbdlft.elastic.partition import Rigid, checked, mass_matrix, partitioned, rigid_properties
from mbdlft.elastic.reduction import (
    MASSLESS,
    NO_MASS,
    Candidates,
    Limit,
    Reduced,
    Structure,
    candidates,
    chosen,
    first,
    static_correction,
)

METHODS = ("hurty", "craig-bampton", "effective-mass", "static-correction")
SLOWEST, FASTEST = 6e-4, 6e6  # rad/s: 0.0001 Hz and 1 MHz; no structure is beyond
_GROUNDED = 1e-3  # largest frequency of a rigid motion on the given stiffness, of the first mode
# a smaller participation factor, of the largest possible one, adds an effective mass below the rounding
# of the rigid mass
_NOTHING = float(np.sqrt(np.finfo(float).eps))
_MASSLESS = 1e-10  # a smaller inertia, of the rigid mass, is none: a bar about its own axis
_RESIDUAL = 1e-6  # negative residual mass that is rounding, of the rigid mass: printed digits are few
_RIGHT = 0.01  # a smaller error of a frequency is that of any truncation
# rounding of the energy of a rigid motion, of the terms that cancel in it
_CANCELLED = 1e3 * float(np.finfo(float).eps)


@dataclass(frozen=True, slots=True, eq=False)
class ModalModel:
    """A structure that is held at its parent, described by modes of unit mass.

    Attributes
    ----------
    method : one of ``hurty``, ``craig-bampton``, ``effective-mass``, ``static-correction``
    kept : number of modes that were chosen; all methods but ``effective-mass`` add one for each motion of
        the ports
    frequencies : (n,) rad/s, ascending
    participation : (6, n), participation factors about the origin (kg^1/2, kg^1/2 m)
    shapes : (6, n) for each port, its displacement and rotation (kg^-1/2, kg^-1/2 m^-1)
    ports : (3,) for each port, its position from the origin (m)
    rigid : mass, center of mass and inertia about the origin
    port_errors : for each port, by how much the frequencies are too high at most, relative to those with
        static correction, if the port carries a mass as large as that of the body
        Empty for the methods that need no correction, and where the matrices are not known.
    grounding : largest frequency (rad/s) that a rigid motion has on the given stiffness matrix; 0 if the
        matrix has no trace of supports
    """

    method: str
    kept: int
    frequencies: Array
    participation: Array
    shapes: Mapping[str, Array]
    ports: Mapping[str, Array]
    rigid: Rigid
    grounding: float
    port_errors: Mapping[str, float]

    def lacking(self) -> str | None:
        """A sentence on the port that must not carry a mass, or None if there is none."""
        worst = max(self.port_errors, key=lambda port: self.port_errors[port], default=None)
        if worst is None or self.port_errors[worst] <= _RIGHT:
            return None
        return (
            f"port {worst!r}: with a mass like that of the body there, frequencies are "
            f"up to {100.0 * self.port_errors[worst]:.2g} % too high: the modes lack a part of how the "
            "port gives way to a load. Take the method 'static-correction', which keeps the same "
            "modes, or 'hurty'."
        )


@arguments_checked
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
    """Bring a finite-element model that is free in space to modal form: M = 1, K = diag(w^2).

    Parameters
    ----------
    mass_matrix, stiffness_matrix : (N, N), dense or sparse, symmetric
        Matrices of the free structure (no supports), in m, kg and s.
    nodes : Nodes
    parent : node number, several, or an `Interface`
        Where the body is held: the origin of the body. Several nodes are made rigid.
    ports : mapping of names to nodes, given as for `parent`
    method : ``hurty``, ``craig-bampton``, ``effective-mass`` or ``static-correction``
        The first two keep modes with all interfaces fixed, and the constraint modes of the ports, which
        make the response to static loads at the ports exact. The third keeps the modes with free ports;
        it is for bodies whose ports carry nothing. The last adds to these what makes the response to
        static loads at the ports exact.
    modes, frequency, effective_mass : exactly one of them
        The number of modes; the highest frequency of a mode (rad/s); or the least fraction, between
        0 and 1, of the rigid mass that the effective mass of the modes reaches in each direction.

    Source: equations (4.21) to (4.41) of the two-port models in `tests/reference/flexible.py`, for any
    number of ports. In addition, a last eigenvalue problem decouples the coordinates of the source.
    """
    check_known("method", [str(method)], METHODS, error=StructureError)
    limit = Limit(modes, frequency, effective_mass)
    structure = _structure(mass_matrix, stiffness_matrix, nodes, parent, ports)
    at = structure.at
    free_ports = candidates(structure, "effective-mass", nodes)
    lowest = _first_frequency(free_ports)
    bodily = at.rigid.T @ (structure.mass @ at.rigid)
    rigid = rigid_properties(nodes, at, bodily)
    grounding = _grounding(structure, bodily, lowest)
    candidate_modes = free_ports if method == "effective-mass" else candidates(structure, method, nodes)
    kept, reduced = chosen(candidate_modes, limit, np.diag(bodily))
    w, coupling, ports_move = _modal(reduced)
    size = np.sqrt(np.maximum(np.diag(bodily), 0.0))[:, None]
    coupling[np.abs(coupling) <= _NOTHING * size] = 0.0
    participation = np.zeros((6, len(w)))
    participation[list(at.directions)] = coupling
    # a rotation times the size of the structure can be compared with a displacement
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
        port_errors={}
        if method != "effective-mass"
        else _port_errors(structure, free_ports, kept, rigid.mass),
    )


def _structure(
    mass_matrix: Any, stiffness_matrix: Any, nodes: Nodes, parent: Any, ports: Mapping[str, Any]
) -> Structure:
    """Checked matrices in the coordinates of the partition, from the arguments of `modal_model`."""
    rows = len(np.asarray(nodes.dof))
    matrices = (checked("mass", mass_matrix, rows), checked("stiffness", stiffness_matrix, rows))
    at = partitioned(nodes, parent, ports)
    if not at.interior:
        raise StructureError(
            "all nodes belong to interfaces; nothing is left to deform. Refine the mesh."
        )
    mass, stiffness = (sp.csr_array(at.expand.T @ matrix @ at.expand) for matrix in matrices)
    return Structure(mass, stiffness, at)


def _first_frequency(free_ports: Candidates) -> float:
    """The lowest frequency (rad/s) of the structure held at its parent, ports free."""
    frequencies = free_ports.modes(1).frequencies
    if not len(frequencies):
        raise StructureError("mass matrix: nothing that can move has mass; no frequency is finite.")
    lowest = float(frequencies[0])
    if not SLOWEST < lowest < FASTEST:
        raise StructureError(
            f"the first frequency is {lowest / (2.0 * np.pi):.3g} Hz; expected one between 0.0001 "
            "Hz and 1 MHz. The units of the matrices do not fit together: give m, kg, s, N, or "
            "convert consistent units (mm, t, s, N) with mbdlft.to_si."
        )
    return lowest


def _port_errors(
    structure: Structure, free_ports: Candidates, kept: int, mass: float
) -> dict[str, float]:
    """`ModalModel.port_errors` of the lowest modes with free ports; `mass` is that of the body (kg)."""
    at, modes = structure.at, first(free_ports.modes(kept), kept)
    both = (free_ports.reduce(modes), static_correction(structure, modes, free_ports.deflections()))
    errors = {}
    for name, place in at.ports.items():
        moving = sum(direction < 3 for direction in at.directions)
        rows = slice(place.start - at.interior, place.start - at.interior + moving)
        lowest = []
        for reduced in both:
            moved = reduced.ports[rows]
            loaded = reduced.mass + mass * (moved.T @ moved)
            scale = 1.0 / np.sqrt(np.diag(reduced.stiffness))
            scaled = [matrix * np.outer(scale, scale) for matrix in (loaded, reduced.stiffness)]
            inverse = scipy.linalg.eigh(*scaled, eigvals_only=True)
            lowest.append(1.0 / np.sqrt(inverse[-kept:]))
        errors[name] = float(np.max(lowest[0] / lowest[1] - 1.0))
    return errors


def _grounding(structure: Structure, bodily: Array, first: float) -> float:
    """The largest frequency (rad/s) that a rigid motion has on the stiffness matrix.

    The stiffness of a free structure resists no rigid motion; supports that were left in the matrix do.
    `bodily` is the mass matrix (r, r) of the rigid motions, `first` the first frequency (rad/s).
    """
    rigid, stiffness = structure.at.rigid, structure.stiffness
    energy = np.diag(rigid.T @ (stiffness @ rigid))
    rounding = _CANCELLED * np.diag(np.abs(rigid).T @ (abs(stiffness) @ np.abs(rigid)))
    mass = np.diag(bodily)
    resisting = np.where(np.abs(energy) > rounding, energy, 0.0)
    floor = _MASSLESS * np.max(mass)
    w = np.sqrt(np.maximum(resisting, 0.0) / np.maximum(mass, floor))
    worst = int(np.argmax(w))
    if w[worst] > _GROUNDED * first:
        raise StructureError(
            f"the rigid motion {DIRECTIONS[structure.at.directions[worst]]} deforms the structure: "
            f"on its stiffness it would have the frequency {w[worst] / (2.0 * np.pi):.3g} Hz "
            f"(first mode {first / (2.0 * np.pi):.3g} Hz). Write the matrices of the free "
            "structure, without supports; check the coordinates and axes of the nodes and the "
            "order of the rows."
        )
    return float(w[worst])


def _modal(reduced: Reduced) -> tuple[Array, Array, Array]:
    """w (q,), P (r, q) and the motion (e, q) of the ports, in coordinates with M = 1, K = diag(w^2).

    The reduced matrices have q elastic coordinates, r rigid motions, and e motions of the ports.
    """
    scale = 1.0 / np.sqrt(np.diag(reduced.stiffness))
    mass, stiffness = (matrix * np.outer(scale, scale) for matrix in reduced[:2])
    mu, vectors = scipy.linalg.eigh(0.5 * (mass + mass.T), 0.5 * (stiffness + stiffness.T))
    mu, vectors = mu[::-1], vectors[:, ::-1]
    if mu[-1] <= MASSLESS * mu[0]:
        raise StructureError(
            "mass matrix: a coordinate that is kept has no mass (a rotation of a port where the "
            "masses are lumped). Use a consistent mass matrix, more modes, or the method "
            "'effective-mass'."
        )
    w = 1.0 / np.sqrt(mu)
    basis = scale[:, None] * vectors * w
    coupling, ports = reduced.coupling.T @ basis, reduced.ports @ basis
    # phi and -phi are the same mode: the sign is chosen so that its largest participation is positive
    size = np.maximum(np.max(np.abs(coupling), axis=1, keepdims=True), np.finfo(float).tiny)
    largest = np.argmax(np.abs(coupling) / size, axis=0)
    sign = np.where(coupling[largest, np.arange(len(w))] < 0.0, -1.0, 1.0)
    return w, coupling * sign, ports * sign


# results of a modal analysis -----------------------------------------------------------------


def model_of_results(
    frequencies: ArrayLike,
    reactions: ArrayLike,
    shapes: Mapping[str, ArrayLike],
    ports: Mapping[str, ArrayLike],
    *,
    mass: float,
    center: ArrayLike,
    inertia: ArrayLike,
    modal_masses: ArrayLike | None = None,
) -> ModalModel:
    """Make a modal model of frequencies, reactions at the parent and mode shapes at the ports.

    Parameters
    ----------
    frequencies : (n,) rad/s
        Frequencies of the structure that is held at its parent, with its ports free.
    reactions : (6, n) N, N m
        Force and torque about the origin that the structure exerts on its support in each mode: minus
        the single-point constraint forces that finite-element programs print.
    shapes : (6, n) for each port
        Displacements and rotations of the port in these modes.
    ports : (3,) for each port, its position from the origin (m)
    mass, center, inertia : kg; (3,) from the origin, m; (3, 3) about the origin, kg m^2
    modal_masses : (n,), optional
        Generalized masses of the modes, in the scale of `reactions` and `shapes`; 1 by default.
    """
    w = finite("frequencies", frequencies, (np.size(frequencies),))
    n = len(w)
    if not n or np.any(w <= SLOWEST) or np.any(w >= FASTEST):
        raise StructureError(
            "frequencies: expected some between 0.0006 and 6e6 rad/s, in rad/s (not Hz, not "
            f"squares), got {w[(w <= SLOWEST) | (w >= FASTEST)][:1].tolist() or 'none'}."
        )
    masses = finite("modal_masses", np.ones(n) if modal_masses is None else modal_masses, (n,))
    if np.any(masses <= 0.0):
        raise StructureError(f"modal_masses: expected positive masses, got {masses.min():g}.")
    for name in {*shapes} ^ {*ports}:
        what = "position in `ports`" if name in shapes else "mode shapes in `shapes`"
        raise StructureError(f"port {name!r} has no {what}.")
    scale = 1.0 / np.sqrt(masses)
    order = np.argsort(w, kind="stable")
    participation = finite("reactions", reactions, (6, n)) * scale / w**2
    mass = float(finite("mass", mass, ()))
    rigid = Rigid(mass, finite("center", center, (3,)), finite("inertia", inertia, (3, 3)))
    total = mass_matrix(rigid)
    if np.max(np.abs(rigid.inertia - rigid.inertia.T)) > _RESIDUAL * np.max(np.abs(rigid.inertia)):
        raise StructureError("inertia: expected a symmetric matrix.")
    size = np.sqrt(np.maximum(np.diag(total), _RESIDUAL * np.max(np.diag(total))))
    residual = (total - participation @ participation.T) / np.outer(size, size)
    smallest = float(np.linalg.eigvalsh(residual)[0])
    if smallest < -_RESIDUAL:
        shares = np.sum(participation**2, axis=1) / size**2
        raise StructureError(
            "reactions: the participation factors exceed the rigid mass: the residual mass matrix "
            f"has the eigenvalue {smallest:.3g} of the rigid mass, the largest effective mass is "
            f"{np.max(shares):.3g} of it. Check that the modes have unit mass (or give "
            "modal_masses), the point of the torques (the origin of the body), the units, and the "
            "mass, center and inertia."
        )
    port_shapes = {name: finite(f"shapes of {name!r}", shape, (6, n)) for name, shape in shapes.items()}
    return ModalModel(
        method="effective-mass",
        kept=n,
        frequencies=w[order],
        participation=participation[:, order],
        shapes={name: (shape * scale)[:, order] for name, shape in port_shapes.items()},
        ports={name: finite(f"ports of {name!r}", place, (3,)) for name, place in ports.items()},
        rigid=rigid,
        grounding=0.0,
        port_errors={},
    )


# effective masses ------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class EffectiveMasses:
    """Effective masses of the modes of a body, about its origin; `table()` writes them as a text.

    Attributes
    ----------
    frequencies : (n,) rad/s
    masses : (n, 6) kg for displacements, kg m^2 for rotations: squares of the participation factors
    rigid : (6, 6) mass matrix of the undeformed body about the origin; nan where it is not determined
    residual : (6, 6) rigid mass matrix minus that of all modes: this mass moves as if it were rigid
    """

    frequencies: Array
    masses: Array
    rigid: Array
    residual: Array

    @property
    def _shares(self) -> Array:
        """(n, 6) effective masses over the rigid mass of each direction; nan if that is 0."""
        total = np.diag(self.rigid)
        return np.asarray(self.masses / np.where(total > NO_MASS * np.nanmax(total), total, np.nan))

    @property
    def kept(self) -> Array:
        """(6,) effective mass of all modes over the rigid mass of each direction; nan if that is 0."""
        return np.asarray(np.sum(self._shares, axis=0))

    def table(self) -> str:
        """One row for each mode: frequency (Hz), effective mass in percent of the rigid one."""
        head = "".join(f"{name:>8}" for name in DIRECTIONS)
        lines = [f"{'mode':>5}{'Hz':>12}{head}   (% of the rigid mass, about the origin)"]
        for k, (w, row) in enumerate(zip(self.frequencies, 100.0 * self._shares, strict=True), start=1):
            lines.append(f"{k:>5}{w / (2.0 * np.pi):>12.5g}{_row(row)}")
        lines.append(f"{'sum':>5}{'':>12}{_row(100.0 * self.kept)}")
        values = "".join(f"{entry:>10.4g}" for entry in np.diag(self.rigid))
        lines.append(f"rigid mass (kg, kg m^2):{values}")
        return "\n".join(lines)


@arguments_checked
def effective_masses(model: ModalModel) -> EffectiveMasses:
    """Effective masses P_ck^2 of each mode k and direction c, and the residual mass R' M R - P P'.

    Parameters
    ----------
    model : ModalModel
    """
    rigid = mass_matrix(model.rigid)
    return EffectiveMasses(
        frequencies=model.frequencies,
        masses=model.participation.T**2,
        rigid=rigid,
        residual=rigid - model.participation @ model.participation.T,
    )


def _row(entries: Array) -> str:
    """Entries (6,) as columns of the table."""
    return "".join(f"{'-':>8}" if np.isnan(entry) else f"{entry:>8.2f}" for entry in entries)
