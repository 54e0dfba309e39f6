"""Joints whose motion is an input: displacement, rate and acceleration as three signals, and no state.

A road moves a wheel through the tire: its springs feel the displacement of the patch under it, its
dampers the rate, and what stands on the patch by a joint feels the acceleration. The three are one
motion. So a model has all of them that are felt: what lacks one would be the answer to another motion.
"""

from collections.abc import Sequence

import casadi as ca
import numpy as np

from mbdlft.base.errors import SceneError
from mbdlft.multibody.assembly.symbols import coordinate_owners
from mbdlft.multibody.assembly.tree import Link
from mbdlft.problem.equations import Equations, Moved, rows_of
from mbdlft.problem.linearize import LinearModel, linearize
from mbdlft.sx.residues import modulo_prime

_SEED = 20261124  # of the residues that stand for parameters


def moved_coordinates(links: tuple[Link, ...], inputs: Sequence[str]) -> tuple[Moved, ...]:
    """Coordinates of joints with ``imposed = "motion"``; `inputs` are the names of the entries of u."""
    found: list[Moved] = []
    k = 0
    for _, name, freedoms, kind in coordinate_owners(links):
        for freedom in freedoms:
            if kind == "motion":
                first, second, third = (
                    inputs.index(f"{name}.{measure.name}") for measure in freedom.measures
                )
                found.append(Moved(k, (first, second, third)))
            k += 1
    return tuple(found)


def with_motions(
    equations: Equations, inputs: Sequence[int], outputs: Sequence[int], *, is_default: bool
) -> list[int]:
    """The inputs with those of the motions that are felt, where the user names none.

    Raises
    ------
    SceneError
        The inputs have a part of a motion, and lack another part that is felt.
    """
    e, chosen = equations, list(inputs)
    if not e.moved:
        return chosen
    every = sorted({*chosen, *(k for moved in e.moved for k in moved.inputs)})
    relations = linearize(e, every, outputs)
    for moved in e.moved:
        felt = [k for order, k in enumerate(moved.inputs) if _is_felt(e, relations, moved, order)]
        if is_default:
            chosen += felt
            continue
        missing = [e.u_signals[k].name for k in felt if k not in chosen]
        asked = [e.u_signals[k].name for k in moved.inputs if k in chosen]
        if asked and missing:
            raise SceneError(
                f"scene {e.name!r}, inputs: {', '.join(asked)} moves something that also feels "
                f"{', '.join(missing)}: springs and outputs feel the position, dampers the rate, and "
                "masses that stand on the joint the acceleration. Add "
                f"{', '.join(missing)} to the inputs, the derivatives of the same motion; or use "
                "imposed = true, whose only input is the acceleration."
            )
    return chosen


def _is_felt(e: Equations, relations: LinearModel, moved: Moved, order: int) -> bool:
    """Whether anything but its own equations has the displacement (order 0) of a coordinate, its rate (1)
    or its acceleration (2)."""
    n, k = e.degrees_of_freedom, moved.coordinate
    signal = (e.x[k], e.x[n + k], e.xdot[n + k])[order]
    last = e.residual.numel() - 2 * len(e.moved) + 2 * e.moved.index(moved)
    own = {k, n + k, last, last + 1}
    rows = [row for row in range(relations.residual.numel()) if row not in own]
    both = ca.vertcat(rows_of(relations.residual, rows), relations.output)
    slopes = ca.jacobian(both, signal)
    return bool(np.any(modulo_prime(slopes, _SEED).residues != 0))
