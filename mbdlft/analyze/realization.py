"""A system as matrices whose stability is asked for, and what is said when its nominal is not stable."""

from collections.abc import Mapping, Sequence

import numpy as np

from mbdlft.analyze.characteristic import Realization, is_stable_at
from mbdlft.base.array import Array
from mbdlft.base.errors import AnalysisError
from mbdlft.base.parameter import to_physical
from mbdlft.system.system import System

_AXIS = 1e-9  # of the size of a pole, or of the largest: nearer to the axis, it is said to lie on it


def realization(
    model: System, inputs: Sequence[int] = (), outputs: Sequence[int] = ()
) -> Realization:
    """The matrices of a system with parameters only, and of the channels whose gain is asked for."""
    blocks = [block for block in model.lft.blocks if block.size]
    i, j = list(outputs), list(inputs)
    return Realization(
        tuple(block.name for block in blocks),
        tuple(block.size for block in blocks),
        model.A,
        model.B_w,
        model.C_z,
        model.D_zw,
        model.B_u[:, j],
        model.D_zu[:, j],
        model.C_y[i],
        model.D_yw[i],
        model.D_yu[np.ix_(i, j)],
    )


def check_nominal(model: System, what: str) -> None:
    """Raise an AnalysisError that names the pole unless the model at delta = 0 is proved to be stable."""
    if not len(model.A):
        return
    poles, shapes = np.linalg.eig(model.A)
    if np.max(poles.real) < 0.0 and is_stable_at(realization(model), np.zeros(_count(model))):
        return
    worst = int(np.argmax(poles.real))
    pole, size = poles[worst], float(np.max(np.abs(poles)))
    moving = np.abs(shapes[:, worst])
    names = [model.states[k].name for k in np.argsort(-moving)[:3] if moving[k] > 0.1 * max(moving)]
    where = f"{pole.real:.4g}{pole.imag:+.4g}j rad/s, in which {', '.join(names)} move"
    if abs(pole.real) <= _AXIS * max(abs(pole), size):
        raise AnalysisError(
            f"{what}: model {model.name!r}: the nominal model has a pole on the imaginary axis, {where}: "
            "no range is robustly stable. Close a loop around this mode, give it damping, or leave out "
            "the state, if nothing that is asked for depends on it."
        )
    raise AnalysisError(
        f"{what}: model {model.name!r}: the nominal model is unstable, with the pole {where}. Close "
        "the loop with a controller that stabilizes it, such as feedback(model, controller), first."
    )


def check_parameters(model: System, what: str) -> None:
    """Raise an AnalysisError if Delta is empty."""
    if not model.order:
        raise AnalysisError(
            f"{what}: model {model.name!r} has no parameter and no uncertain block: there is no margin. "
            "Its poles say all."
        )


def physical(model: System, names: Sequence[str], delta: Array) -> dict[str, float]:
    """Physical values of all parameters by name, those without a delta at nominal."""
    given = dict(zip(names, delta.tolist(), strict=True))
    return {p.name: float(to_physical(p, given.get(p.name, 0.0))) for p in model.parameters}


def shares(names: Sequence[str], parts: Array) -> Mapping[str, float]:
    """Parts of a sum, none negative, by name; they add up to 1."""
    total = float(np.sum(np.abs(parts)))
    found = np.abs(parts) / total if total > 0.0 else np.zeros(len(parts))
    return dict(zip(names, found.tolist(), strict=True))


def _count(model: System) -> int:
    return len([block for block in model.lft.blocks if block.size])
