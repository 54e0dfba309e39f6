"""What inputs that leave the momenta of a free structure do to it, without what rounding does to these.

Rounding of A and B changes the momenta, and 1/s^2 times this change moves what is free more than inputs
that conserve them do: positions drift, and norms are infinite. Which inputs conserve them is decided on
residues, and stands in the certificate.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from mbdlft.base.array import Array
from mbdlft.system.model import LFTModel, System
from mbdlft.system.sampled import StateMatrices, rates_of

_CONSERVED = 1e-6  # of terms: more is left of momenta, which rounding changes, where an input moves them


class Part(NamedTuple):
    """Some inputs, the matrices with these, and whether they leave all momenta, if there are any."""

    inputs: Sequence[int]  # among those of the whole matrices
    matrices: StateMatrices
    leaves_momenta: bool = True


def by_momenta(
    system: System, matrices: StateMatrices, inputs: Sequence[int] | None = None
) -> list[Part]:
    """All inputs of what is held; of what is free those that conserve its momenta, and others.

    `inputs` are those of the system that the matrices have; all by default.
    """
    A, B, C, D = matrices
    momenta = np.array(system.certificate.momenta if isinstance(system, LFTModel) else (), dtype=int)
    if not len(momenta):
        return [Part(range(B.shape[2]), matrices)]
    momenta = momenta if inputs is None else momenta[list(inputs)]
    conserving, others = (np.flatnonzero(chosen).tolist() for chosen in (momenta, momenta == 0))
    held = _held(A, B[:, :, conserving], int(np.max(momenta, initial=0)))
    parts = [
        Part(conserving, StateMatrices(held, B[:, :, conserving], C, D[:, :, conserving])),
        Part(others, StateMatrices(A, B[:, :, others], C, D[:, :, others]), leaves_momenta=False),
    ]
    return [part for part in parts if part.inputs]


def _held(A: Array, B: Array, count: int) -> Array:
    """A with what draws momenta to zero, where they stay zero by B: its responses are the same.

    With x' = v and L K = 0, K the stiffnesses, momenta are L v, and v' has -P (k^2 x + k v) more, where
    P = L' (L L')^-1 L and k is the frequency of the slowest mode. A sample that is held less than the
    others has more of such modes, or momenta that B changes, and stays as it is.
    """
    rates, held = rates_of(A, B), A.copy()
    if (count := min(count, len(rates))) == 0:
        return A
    x, v = np.array([*rates]), np.array([*rates.values()])
    K, n, all_of_v = A[:, v[:, None], x], len(x), np.concatenate([A, B], axis=2)[:, v]
    # regular, so L has the digits of soft springs beside stiff ones: [L M] [K E ; F 0] = [0 1]
    border = np.random.default_rng(0).standard_normal((len(A), n + count, n + count))
    border[:, :n, :n], border[:, n:, n:] = K.swapaxes(1, 2), 0.0
    border[np.linalg.slogdet(border)[0] == 0.0] = np.nan
    L = np.linalg.solve(border, np.eye(n + count)[:, n:])[:, :n].swapaxes(1, 2)
    across = np.linalg.solve(L @ L.swapaxes(1, 2), L).swapaxes(1, 2) @ L
    is_zero = np.abs(L @ all_of_v) <= _CONSERVED * (np.abs(L) @ np.abs(all_of_v))
    slowest = np.sort(np.abs(np.linalg.eigvals(A)), axis=1)[:, 2 * count :].min(axis=1, initial=np.inf)
    is_held = (np.isfinite(slowest) & is_zero.all(axis=(1, 2)))[:, None, None]
    k, P = (np.where(is_held, matrix, 0.0) for matrix in (slowest[:, None, None], across))
    held[:, v[:, None], x] -= k**2 * P / A[:, None, x, v]
    held[:, v[:, None], v] -= k * P
    return held
