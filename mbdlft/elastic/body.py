"""A `FlexibleBody` of a modal model."""

import warnings
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from mbdlft.base.errors import MbdlftWarning, StructureError
from mbdlft.elastic.model import ModalModel, modal_model
from mbdlft.elastic.nodes import Nodes
from mbdlft.multibody.body import FlexibleBody, Inertia, Mode


def flexible_body(
    name: str,
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
    damping: float | str | Sequence[float | str] = 0.0,
    prestress: str | None = None,
) -> FlexibleBody:
    """Make a flexible body of a scene from the matrices of a finite-element model.

    Parameters
    ----------
    name : str
    mass_matrix, stiffness_matrix, nodes, parent, ports, method, modes, frequency, effective_mass
        As in `modal_model`.
    damping : damping ratio [1], a number or an expression, of all modes; or a sequence with one for
        each mode of the body
    prestress : ``neglected`` or None, as for every elastic body

    Raises
    ------
    StructureError
        `modal_model` raises it, or the number of damping ratios is not that of the modes.
    """
    model = modal_model(
        mass_matrix,
        stiffness_matrix,
        nodes,
        parent,
        ports,
        method=method,
        modes=modes,
        frequency=frequency,
        effective_mass=effective_mass,
    )
    return modal_body(name, model, damping=damping, prestress=prestress)


def modal_body(
    name: str,
    model: ModalModel,
    *,
    damping: float | str | Sequence[float | str] = 0.0,
    prestress: str | None = None,
) -> FlexibleBody:
    """Make a flexible body of a scene from a modal model.

    Parameters
    ----------
    name : str
    model : ModalModel
    damping, prestress : as in `flexible_body`

    Raises
    ------
    StructureError
        The number of damping ratios is not that of the modes.

    Warns
    -----
    MbdlftWarning
        A port that carries a mass would make frequencies wrong by more than a percent: `lacking` of the
        model says which.
    """
    if lacking := model.lacking():
        warnings.warn(f"body {name!r}, {lacking}", MbdlftWarning, stacklevel=2)
    count = len(model.frequencies)
    ratios = [damping] * count if isinstance(damping, str | int | float) else list(damping)
    if len(ratios) != count:
        raise StructureError(
            f"body {name!r}: damping: expected one ratio or {count}, one for each mode, got "
            f"{len(ratios)}."
        )
    modes = [
        Mode(
            frequency=float(model.frequencies[k]),
            damping=float(ratio) if isinstance(ratio, int) else ratio,
            participation=tuple(map(float, model.participation[:, k])),
            shapes={port: tuple(map(float, shape[:, k])) for port, shape in model.shapes.items()},
        )
        for k, ratio in enumerate(ratios)
    ]
    rigid = model.rigid
    entries = {
        f"{'xyz'[i]}{'xyz'[j]}": float(rigid.inertia[i, j])
        for i in range(3)
        for j in range(i, 3)
        if not np.isnan(rigid.inertia[i, j])
    }
    return FlexibleBody(
        name=name,
        mass=rigid.mass,
        center_of_mass=tuple(map(float, rigid.center)),
        inertia=Inertia(**entries, about="origin"),
        ports={port: tuple(map(float, position)) for port, position in model.ports.items()},
        modes=tuple(modes),
        prestress=prestress,
    )
