"""What is known of accelerations and of free structures in a whole that has them as parts.

What acts on a part changes no relation of its signals. It leaves its momenta if it acts as springs
between its bodies do; and its motions as a rigid body are free if nothing that sees them acts on it.
"""

from collections.abc import Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from mbdlft.base.array import Array
from mbdlft.base.reach import in_reach
from mbdlft.system.model import LFTModel, System
from mbdlft.system.wiring import Wiring, beside_gains

Mask = NDArray[np.bool_]


class _Part(NamedTuple):
    """Of a system: how many rigid motions are known, and whether none is seen inside."""

    motions: int
    is_rigid: bool
    leaves: Mask  # (nu,), inputs that leave momenta
    is_blind: Mask  # (ny,), outputs that see no rigid motion
    is_sum: Mask  # (ny,), outputs that are sums of accelerations
    driven: Mask  # (nx,), states that accelerations drive
    beside: Mask  # (nx,), states of what is no structure
    feels: Mask  # (ny, nu), outputs that may feel the rigid motion that an input causes


def free_motions(systems: Sequence[System], wiring: Wiring) -> dict[str, Any]:
    """Fields of the certificate: sums of accelerations, what is free, driven, and beside it.

    Those of all free parts together. An input leaves momenta if it leads to none of a part that changes
    them; an output sees no rigid motion if none of a part that sees any leads to it. It feels that by an
    input if one that leads to it feels that by one to which the input leads. A part in which nothing is
    known is driven by accelerations if nothing else leads to it.
    """
    is_real = not any(system.lft.is_complex for system in systems)
    systems, Ky, E, F, direct = beside_gains(systems, wiring)
    parts = [_part(system) for system in systems]
    leaves = _joined([part.leaves for part in parts])
    is_blind = _joined([part.is_blind for part in parts])
    driven = _driven(parts, Ky, E)
    is_sum = _joined([part.is_sum | of for part, of in zip(parts, driven, strict=True)])
    states = _joined([part.driven | of for part, of in zip(parts, driven, strict=True)])
    beside = _joined([part.beside for part in parts])
    is_free = _joined([np.full(len(part.leaves), part.motions > 0) for part in parts])
    by_part = [np.ones((len(part.is_blind), len(part.leaves))) for part in parts]
    is_one = block_diag(np.zeros((0, 0)), *by_part) != 0.0
    leads = (Ky != 0.0) @ is_one
    is_moved = (E[in_reach(leads.T, ~leaves)] != 0.0).any(axis=0)
    fed = in_reach(leads, (Ky[:, ~is_blind] != 0.0).any(axis=1))
    is_seen = F[:, ~is_blind | is_one @ fed].any(axis=1)
    count = sum(part.motions for part in parts) if is_real else 0
    is_rigid = all(part.is_rigid for part in parts) and not np.any(fed & is_free)
    momenta, motions = np.where(is_moved, 0, count), np.where(is_seen, -count, count)
    unmoved = np.zeros((len(F), E.shape[1]), dtype=np.bool_)
    if count and is_rigid and np.any(is_moved):
        back = (is_one @ (Ky != 0.0)).T
        fed_by = np.array([in_reach(leads, column != 0.0) for column in E.T])
        led_by = np.array([in_reach(back, row != 0.0) for row in F]).reshape(F.shape)
        feels = led_by @ block_diag(*(part.feels for part in parts)) @ fed_by.T
        unmoved = is_moved & (feels == 0.0)
    proved = F.any(axis=1) & ~(F[:, ~is_sum].any(axis=1) | direct.any(axis=1))
    return {
        "accelerations": tuple(np.flatnonzero(proved).tolist()),
        "momenta": tuple(momenta.tolist()) if np.any(momenta) else (),
        "rigid_motions": tuple(motions.tolist()) if count and is_rigid else (),
        "unmoved": tuple((i, j) for i, j in np.argwhere(unmoved).tolist()),
        "driven": tuple(np.flatnonzero(states).tolist()) if np.any(proved) else (),
        "beside": tuple(np.flatnonzero(beside).tolist()) if count or np.any(proved) else (),
    }


def _driven(parts: Sequence[_Part], Ky: Array, E: Array) -> list[bool]:
    """Which parts are driven by accelerations, and by others that are, alone."""
    driven = [not part.motions and not np.any(part.is_sum) and len(part.leaves) > 0 for part in parts]
    ends = np.cumsum([0, *(len(part.leaves) for part in parts)])
    while True:
        is_sum = _joined([part.is_sum | of for part, of in zip(parts, driven, strict=True)])
        others = np.asarray(E.any(axis=1) | Ky[:, ~is_sum].any(axis=1))
        left = [of and not others[a:b].any() for of, (a, b) in zip(driven, pairwise(ends), strict=True)]
        if left == driven:
            return driven
        driven = left


def _joined(masks: Sequence[Mask]) -> Mask:
    return np.concatenate([np.zeros(0, dtype=np.bool_), *masks])


def _part(system: System) -> _Part:
    nu, ny = len(system.inputs), len(system.outputs)
    known = system.certificate if isinstance(system, LFTModel) else None
    momenta, motions = (known.momenta, known.rigid_motions) if known else ((), ())
    count = max(map(abs, momenta + motions), default=0)
    leaves = np.equal(momenta or [0] * nu, count)
    is_sum = np.isin(range(ny), known.accelerations if known else ())
    states = np.arange(len(system.states))
    feels = ~leaves & np.ones((ny, 1), dtype=np.bool_)
    feels[tuple(np.array(known.unmoved if known else (), dtype=int).reshape(-1, 2).T)] = False
    return _Part(
        count,
        not count or bool(motions),
        leaves,
        np.equal(motions or [-count] * ny, count),
        is_sum,
        np.isin(states, known.driven if known else ()),
        np.isin(states, known.beside if known else ()) | (not count and not np.any(is_sum)),
        feels,
    )
