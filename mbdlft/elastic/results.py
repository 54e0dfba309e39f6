"""A modal model of the results of a modal analysis, where the matrices are not to be had.

In a mode phi of unit mass of the structure held at its parent, the structure loads the parent with
w^2 phi' M R: so the participation factors are P = reaction / w^2.
"""

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike

from mbdlft.base.array import Array
from mbdlft.base.errors import StructureError
from mbdlft.elastic.model import FASTEST, SLOWEST, ModalModel
from mbdlft.elastic.rigid import Rigid, mass_matrix

_RESIDUAL = 1e-6  # of the rigid mass; results are printed with few digits


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
    """Modal model of frequencies, reactions at the parent and shapes at the ports.

    Parameters
    ----------
    frequencies : (n,) rad/s
        Of the structure held at its parent, ports free.
    reactions : (6, n) N, N m
        Force and torque about the origin that the structure puts on its support in each mode: minus the
        single-point constraint forces that finite-element programs print.
    shapes : (6, n) of each port
        Displacements and rotations, in the same modes.
    ports : (3,) of each port from the origin (m)
    mass, center, inertia : kg; (3,) from the origin, m; (3, 3) about the origin, kg m^2
    modal_masses : (n,), optional
        Generalized masses of the modes as they are given; 1 by default.

    Raises
    ------
    StructureError
        Shapes that do not fit, frequencies out of range, a port without mode shape, or participation
        factors that exceed the rigid mass.
    """
    w = _array("frequencies", frequencies, (np.size(frequencies),))
    n = len(w)
    if not n or np.any(w <= SLOWEST) or np.any(w >= FASTEST):
        raise StructureError(
            "frequencies: expected some between 0.0006 and 6e6 rad/s, in rad/s (not Hz, not "
            "squares), got "
            f"{w[(w <= SLOWEST) | (w >= FASTEST)][:1].tolist() or 'none'}."
        )
    masses = _array("modal_masses", np.ones(n) if modal_masses is None else modal_masses, (n,))
    if np.any(masses <= 0.0):
        raise StructureError(f"modal_masses: expected positive masses, got {masses.min():g}.")
    for name in {*shapes} ^ {*ports}:
        what = "position in `ports`" if name in shapes else "mode shapes in `shapes`"
        raise StructureError(f"port {name!r} has no {what}.")
    scale = 1.0 / np.sqrt(masses)
    order = np.argsort(w, kind="stable")
    participation = _array("reactions", reactions, (6, n)) * scale / w**2
    rigid = Rigid(
        float(_array("mass", mass, ())),
        _array("center", center, (3,)),
        _array("inertia", inertia, (3, 3)),
    )
    _check_residual(rigid, participation)
    found = {name: _array(f"shapes of {name!r}", shape, (6, n)) for name, shape in shapes.items()}
    return ModalModel(
        method="effective-mass",
        kept=n,
        frequencies=w[order],
        participation=participation[:, order],
        shapes={name: (shape * scale)[:, order] for name, shape in found.items()},
        ports={name: _array(f"ports of {name!r}", place, (3,)) for name, place in ports.items()},
        rigid=rigid,
        grounding=0.0,
    )


def _check_residual(rigid: Rigid, participation: Array) -> None:
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
            "has the eigenvalue "
            f"{smallest:.3g} of the rigid mass, the largest effective mass is {np.max(shares):.3g} "
            "of it. Check that the modes "
            "have unit mass (or give modal_masses), the point of the torques (the origin of the "
            "body), the "
            "units, and the mass, center and inertia."
        )


def _array(what: str, given: ArrayLike, shape: tuple[int, ...]) -> Array:
    try:
        found = np.array(given, dtype=float)
    except (TypeError, ValueError):
        raise StructureError(f"{what}: expected numbers of shape {shape}.") from None
    if found.shape != shape or not np.all(np.isfinite(found)):
        raise StructureError(
            f"{what}: expected finite numbers of shape {shape}, got the shape {found.shape}."
        )
    return found
