"""A modal model from the results of a modal analysis, for those who do not have the matrices.

A structure that is held at its parent and vibrates in a mode phi of unit mass loads the parent with
w^2 phi' M R, where the columns of R are its rigid motions. So the participation factors are
P = reaction / w^2.
"""

from collections.abc import Mapping

import numpy as np

from mbdlft.base.array import Array, ArrayLike
from mbdlft.base.errors import StructureError
from mbdlft.elastic.modal import FASTEST, SLOWEST, ModalModel, Rigid, mass_matrix
from mbdlft.elastic.nodes import finite

# negative residual mass that is rounding, of the rigid mass: printed digits are few
_RESIDUAL = 1e-6


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

    Raises
    ------
    StructureError
        Shapes of arrays do not fit, a frequency is out of range, a port has no mode shape, or the
        participation factors exceed the rigid mass.
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
    rigid = Rigid(
        float(finite("mass", mass, ())),
        finite("center", center, (3,)),
        finite("inertia", inertia, (3, 3)),
    )
    _check_residual(rigid, participation)
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


def _check_residual(rigid: Rigid, participation: Array) -> None:
    """Raise a StructureError if the modes, P (6, n), have more mass than the body in any direction."""
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
