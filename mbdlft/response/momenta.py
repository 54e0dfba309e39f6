"""Free structures: what inputs that leave momenta do, and what outputs see that no rigid motion changes.

Rounding of A, B and C changes the momenta, and shows rigid motions to outputs. 1/s^2 times this change
is more than what is left far below the modes: positions drift, and norms are infinite. Which inputs leave
the momenta, and which outputs see no rigid motion, is decided on residues and is in the certificate.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbdlft.base.array import Array, ArrayLike
from mbdlft.response.modes import Names, chosen, transfers_at
from mbdlft.system.model import LFTModel, System
from mbdlft.system.sampled import StateMatrices, rates_of

Indices = NDArray[np.intp]
_CONSERVED = 1e-6  # of terms: more is left of momenta, which rounding changes, where an input moves them


class Part(NamedTuple):
    """Some outputs and inputs, numbers in the whole matrices, and the matrices of these."""

    outputs: Indices
    inputs: Indices
    matrices: StateMatrices
    leaves_momenta: bool  # all of them, if there are any


def parts_at(
    system: System, values: Mapping[str, ArrayLike] | None, outputs: Names, inputs: Names, what: str
) -> tuple[StateMatrices, list[Part]]:
    """The matrices of `transfers_at`, and their parts."""
    rows = chosen(system.name, "output", outputs, system.outputs, what)
    columns = chosen(system.name, "input", inputs, system.inputs, what)
    matrices = transfers_at(system, values, outputs, inputs, what)
    return matrices, by_momenta(system, matrices, rows, columns)


def by_momenta(
    system: System, matrices: StateMatrices, outputs: Sequence[int], inputs: Sequence[int]
) -> list[Part]:
    """What is held as a whole; of what is free the inputs that leave its momenta, and the others.

    The outputs by the others are those that see no rigid motion, and those that do. The matrices have
    these outputs and inputs of the system.
    """
    A, B, C, D = matrices
    momenta, motions = np.zeros(len(system.inputs), dtype=int), np.zeros(len(system.outputs), dtype=int)
    if isinstance(system, LFTModel):
        momenta[:], motions[:] = system.certificate.momenta or 0, system.certificate.rigid_motions or 0
    momenta, motions, parts = momenta[inputs], motions[outputs], list[Part]()
    moves, sees, is_free = momenta == 0, motions == 0, bool(np.any(momenta) or np.any(motions))
    for rows, columns, counts in (
        (sees | True, ~moves, momenta),
        (~sees, moves, motions),
        (sees, moves, motions),
    ):
        if np.any(rows) and np.any(columns):
            y, u = np.flatnonzero(rows), np.flatnonzero(columns)
            part = StateMatrices(A, B[:, :, u], C[:, y], D[:, y][:, :, u])
            of_inputs = counts is momenta
            count = int(np.max(counts[u if of_inputs else y]))
            held = part._replace(A=_held(part, count, of_inputs=of_inputs))
            parts.append(Part(y, u, held, of_inputs or not is_free))
    return parts


def _held(matrices: StateMatrices, count: int, *, of_inputs: bool) -> Array:
    """A with what draws to zero the momenta that B leaves, or rigid motions that C does not see.

    The responses are the same. With x' = v, and L K = 0 or K R' = 0, K the stiffnesses, momenta are L v,
    and rigid motions R. v' has -P (k^2 x + k v) more, where P = L' (L L')^-1 L, or with R, and k is the
    frequency of the slowest mode. A sample that is held less than the others has more of such modes, or
    momenta that B changes, or motions that C sees, and stays as it is.
    """
    A, B, C, _ = matrices
    rates, held = rates_of(A, B), A.copy()
    if (count := min(count, len(rates))) == 0:
        return A
    x, v = np.array([*rates]), np.array([*rates.values()])
    K, n, unit = A[:, v[:, None], x] * A[:, None, x, v], len(x), A[:, None, x, v]
    # regular, so L has the digits of soft springs beside stiff ones: [L M] [K E ; F 0] = [0 1]
    border = np.random.default_rng(0).standard_normal((len(A), n + count, n + count))
    border[:, :n, :n], border[:, n:, n:] = K.swapaxes(1, 2) if of_inputs else K, 0.0
    border[np.linalg.slogdet(border)[0] == 0.0] = np.nan
    L = np.linalg.solve(border, np.eye(n + count)[:, n:])[:, :n].swapaxes(1, 2)
    across = np.linalg.solve(L @ L.swapaxes(1, 2), L).swapaxes(1, 2) @ L
    if of_inputs:
        terms = np.concatenate([A, B], axis=2)[:, v]
    else:
        seen = np.concatenate([A, C], axis=1)
        terms = np.concatenate([seen[:, :, x] * unit, np.delete(seen, x, axis=1)[:, :, v]], axis=1)
        terms = terms.swapaxes(1, 2)
    is_zero = np.abs(L @ terms) <= _CONSERVED * (np.abs(L) @ np.abs(terms))
    slowest = np.sort(np.abs(np.linalg.eigvals(A)), axis=1)[:, 2 * count :].min(axis=1, initial=np.inf)
    is_held = (np.isfinite(slowest) & is_zero.all(axis=(1, 2)))[:, None, None]
    k, P = (np.where(is_held, matrix, 0.0) for matrix in (slowest[:, None, None], across))
    held[:, v[:, None], x] -= k**2 * P / unit
    held[:, v[:, None], v] -= k * P
    return held
