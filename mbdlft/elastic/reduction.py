"""Component modes: reduced matrices of a structure held at its parent.

A structure has n interior coordinates, e of all ports and r of the parent; the n and e coordinates
together are the f free ones. The methods describe the motion by

    Hurty                 modes of n with e and r fixed; constraint modes of e; rigid modes of r
    Craig-Bampton         modes of n with e and r fixed; constraint modes of e and r
    effective mass        modes of f with r fixed; rigid modes of r (Imbert)
    static correction     the same, and what they lack of the deflections K^-1 by unit loads on e

These are equations (4.21) to (4.31), (4.36) to (4.38) and (4.41) of the source in
`tests/reference/flexible.py`. The first two methods span the same motions. The last is the residual
flexibility of R. H. MacNeal (1971) as motions of their own. Each method gives the matrices M, K (q, q) of
q elastic coordinates, their coupling P' (q, r) with the rigid motions, and the motion (e, q) of ports.
"""

from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from mbdlft.base.array import Array
from mbdlft.elastic.eigen import Modes, Solver, lowest_modes
from mbdlft.elastic.nodes import Nodes
from mbdlft.elastic.partition import Partition


class Reduced(NamedTuple):
    """Matrices of the elastic coordinates: mass and stiffness (q, q), coupling (q, r), ports (e, q)."""

    mass: Array
    stiffness: Array
    coupling: Array
    ports: Array


class Structure(NamedTuple):
    """Mass and stiffness matrices (f + r, f + r) of a structure, and its partition `at`."""

    mass: Any
    stiffness: Any
    at: Partition


class Candidates(NamedTuple):
    """The modes among which the user chooses, and what is made of them.

    `modes(count)` computes at least `count` modes, or all. `reduce` makes the reduced matrices of given
    modes; in these the modes come first, then the motions of the ports. `deflections()` are the columns
    (f, e) of K^-1 by unit loads on the ports, with the parent fixed and the ports free. `corrects` says
    that the motions of the ports depend on which modes there are.
    """

    modes: Callable[[int], Modes]
    reduce: Callable[[Modes], Reduced]
    deflections: Callable[[], Array]
    corrects: bool = False


def candidates(structure: Structure, method: str, nodes: Nodes) -> Candidates:
    """The modes from which a method of `modal_model` starts, and its reduction with them."""
    at, n = structure.at, structure.at.interior
    if method in ("effective-mass", "static-correction"):
        modes, solver = _computed(structure, nodes, at.free)
        deflections = cache(lambda: solver(np.eye(at.free)[:, n:]))
        if method == "effective-mass":
            return Candidates(modes, lambda modes: effective_mass(structure, modes), deflections)
        return Candidates(
            modes,
            lambda modes: static_correction(structure, modes, deflections()),
            deflections,
            corrects=True,
        )
    modes, solver = _computed(structure, nodes, n)
    none = lambda: np.zeros((at.free, 0))  # noqa: E731
    constraint = -solver(structure.stiffness[:n, n:].toarray())
    if method == "hurty":
        ports = constraint[:, : at.free - n]
        return Candidates(modes, lambda modes: hurty(structure, modes, ports), none)
    reduce = lambda modes: craig_bampton(structure, modes, constraint)  # noqa: E731
    return Candidates(modes, reduce, none)


def _computed(
    structure: Structure, nodes: Nodes, rows: int
) -> tuple[Callable[[int], Modes], Solver]:
    """A function that computes modes of the first `rows` coordinates with the others fixed, and K^-1.

    The function remembers the modes of its last call and computes new ones only where these are too few.
    """
    mass, stiffness = (matrix[:rows, :rows] for matrix in structure[:2])
    solver = Solver(stiffness, _names(structure, nodes))
    last: list[Modes] = []

    def modes(count: int) -> Modes:
        if not last or not (last[-1].complete or len(last[-1]) >= count):
            last.append(lowest_modes(mass, solver, stiffness, count))
        return last[-1]

    return modes, solver


def hurty(structure: Structure, modes: Modes, constraint: Array) -> Reduced:
    """Reduced matrices with fixed-interface modes and the constraint modes (n, e) of the ports.

    The elastic coordinates are relative to the rigid motion with the parent.
    """
    n, free = structure.at.interior, structure.at.free
    basis = np.zeros((free, len(modes) + free - n))
    basis[:n, : len(modes)] = modes.shapes
    basis[:n, len(modes) :] = constraint
    basis[n:, len(modes) :] = np.eye(free - n)
    return _projected(structure, basis)


def craig_bampton(structure: Structure, modes: Modes, constraint: Array) -> Reduced:
    """Reduced matrices with fixed-interface modes and the constraint modes (n, e + r) of all interfaces.

    The matrices of the whole structure are reduced first; then its parent is held.
    """
    n, free, k = structure.at.interior, structure.at.free, len(modes)
    size = structure.mass.shape[0]
    basis = np.zeros((size, k + size - n))
    basis[:n] = np.hstack([modes.shapes, constraint])
    basis[n:, k:] = np.eye(size - n)
    mass, stiffness = (basis.T @ (matrix @ basis) for matrix in structure[:2])
    # in these coordinates a rigid motion moves the interfaces only; the coordinates of the modes are zero
    rigid = np.vstack([np.zeros((k, structure.at.rigid.shape[1])), structure.at.rigid[n:]])
    elastic = slice(k + free - n)
    ports = np.hstack([np.zeros((free - n, k)), np.eye(free - n)])
    return Reduced(
        mass[elastic, elastic], stiffness[elastic, elastic], (mass @ rigid)[elastic], ports
    )


def effective_mass(structure: Structure, modes: Modes) -> Reduced:
    """Reduced matrices with modes of the structure that is held at its parent, with its ports free."""
    return _projected(structure, modes.shapes)


def static_correction(structure: Structure, modes: Modes, deflections: Array) -> Reduced:
    """Reduced matrices as `effective_mass`, with what the modes lack of the deflections (f, e).

    The rest K^-1 - phi phi'/w^2 of the flexibility is orthogonal to the modes, which stay as they are.
    Where it is the rounding of the flexibility, nothing is lacking.
    """
    moved = modes.shapes[structure.at.interior :]
    rest = deflections - modes.shapes @ (moved / modes.frequencies**2).T
    scale = 1.0 / np.sqrt(np.diag(deflections[structure.at.interior :]))
    flexibility = rest[structure.at.interior :] * np.outer(scale, scale)
    values, vectors = np.linalg.eigh(0.5 * (flexibility + flexibility.T))
    lacking = values > _COMPLETE
    own = (rest * scale) @ (vectors[:, lacking] / np.sqrt(values[lacking]))
    return _projected(structure, np.hstack([modes.shapes, own]))


_COMPLETE = 1e-9  # a smaller part of a flexibility is rounding of the matrices


def _projected(structure: Structure, basis: Array) -> Reduced:
    """Reduced matrices with the columns of `basis` (f, q), motions with the parent held."""
    free = structure.at.free
    inertia = structure.mass @ structure.at.rigid
    return Reduced(
        mass=basis.T @ (structure.mass[:free, :free] @ basis),
        stiffness=basis.T @ (structure.stiffness[:free, :free] @ basis),
        coupling=basis.T @ inertia[:free],
        ports=basis[structure.at.interior :],
    )


def _names(structure: Structure, nodes: Nodes) -> Callable[[int], str]:
    """A function that names a coordinate of the partition in words, for error messages."""
    dof, at = np.asarray(nodes.dof), structure.at

    def name(row: int) -> str:
        if row < at.interior:
            node, component = dof[at.rows[row]]
            return f"component {component} of node {node}"
        return next(f"port {port!r}" for port, place in at.ports.items() if row < place.stop)

    return name
