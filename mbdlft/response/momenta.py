"""Free structures: what inputs that leave momenta do, and what rigid motions move.

Rounding of A, B and C changes the momenta, holds rigid motions, and shows them to outputs. 1/s^2 times
this change is more than what is left far below the modes: positions drift, and norms are infinite. How
many rigid motions there are, which inputs leave the momenta, and which outputs see no rigid motion, is
decided on residues and is in the certificate.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbdlft.base.array import Array, ArrayLike
from mbdlft.base.reach import in_reach
from mbdlft.exact.rounding import EPS
from mbdlft.response.modes import Names, chosen, transfers_at
from mbdlft.system.model import LFTModel, System
from mbdlft.system.sampled import StateMatrices, places_of

Indices = NDArray[np.intp]
_CONSERVED = 1e-6  # of terms: more is left of momenta, which rounding changes, where an input moves them


class Part(NamedTuple):
    """Some outputs and inputs, numbers in the whole matrices, and the matrices of these."""

    outputs: Indices
    inputs: Indices
    matrices: StateMatrices
    is_own: NDArray[np.bool_]  # (rows, columns); the other entries are those of other parts
    leaves_momenta: bool  # all of them, if there are any
    until: Array  # (N,), rad/s: the slowest mode; from there on those of the model are as good


def parts_at(
    system: System, values: Mapping[str, ArrayLike] | None, outputs: Names, inputs: Names, what: str
) -> tuple[StateMatrices, list[Part]]:
    """The matrices of `transfers_at`, held if nothing sees motions or moves momenta, and their parts."""
    rows = chosen(system.name, "output", outputs, system.outputs, what)
    columns = chosen(system.name, "input", inputs, system.inputs, what)
    return by_momenta(system, transfers_at(system, values, outputs, inputs, what), rows, columns)


def by_momenta(
    system: System, matrices: StateMatrices, outputs: Sequence[int], inputs: Sequence[int] | None
) -> tuple[StateMatrices, list[Part]]:
    """What is held as a whole; of what is free the inputs that leave its momenta, and the others.

    With the first are entries by inputs whose rigid motions the output does not feel: these are left out.
    The outputs by the others are those that see no rigid motion, and those that do. The matrices have
    these outputs and inputs of the system; without inputs, B is the states that a motion starts from.
    """
    momenta, motions = np.zeros(len(system.inputs), dtype=int), np.zeros(len(system.outputs), dtype=int)
    unmoved = np.zeros((len(motions), len(momenta)), dtype=np.bool_)
    beside: Sequence[int] = ()
    if isinstance(system, LFTModel):
        known = system.certificate
        beside = known.beside
        momenta[:], motions[:] = known.momenta or 0, known.rigid_motions or 0
        unmoved[tuple(np.array(known.unmoved, dtype=int).reshape(-1, 2).T)] = True
    starts = inputs is None
    moves = np.ones(matrices.B.shape[2], dtype=bool) if starts else momenta[inputs] == 0
    is_still = ~moves & np.ones((len(outputs), 1), dtype=bool)
    if inputs is not None:
        is_still |= unmoved[np.ix_(outputs, inputs)]
    sees = motions[outputs] <= 0
    count = int(np.abs([0, *momenta, *motions]).max())
    slowest = np.full(len(matrices.A), np.inf)
    rates = places_of(matrices.A, np.zeros_like(matrices.B) if starts else matrices.B, beside)
    if count:
        slowest = frequencies_of(matrices.A, rates)[:, 2 * count :].min(axis=1, initial=np.inf)
    count_of_motions = min(count, len(rates)) if np.any(motions) else 0
    whole, held = _beside_motions(matrices, rates, count_of_motions, sees, slowest)
    parts = list[Part]()
    for rows, some, are_still in (
        (sees | True, matrices, True),
        (~sees, held, False),
        (sees, whole, False),
    ):
        y = np.flatnonzero(rows)
        u = np.flatnonzero(np.any(is_still[y] == are_still, axis=0))
        if len(y) and len(u):
            part = StateMatrices(some.A, some.B[:, :, u], some.C[:, y], some.D[:, y][:, :, u])
            if are_still:
                part = _held(part, beside, count, slowest, moves[u])
            is_own = is_still[np.ix_(y, u)] == are_still
            parts.append(Part(y, u, part, is_own, are_still or not count, slowest))
    if not np.any(sees):
        return held, parts
    return parts[0].matrices if parts and np.all(is_still) else matrices, parts


def frequencies_of(A: Array, rates: Mapping[int, int]) -> Array:
    """Sizes of poles (N, 2 n), rising, of positions and their rates: filters beside have their own."""
    own = np.array([*rates, *rates.values()], dtype=int)
    return np.asarray(np.sort(np.abs(np.linalg.eigvals(A[:, own[:, None], own])), axis=1))


def _kernel(K: Array, count: int) -> Array:
    """R (N, n, count) with K R = 0. Not finite, or any numbers, if there are more.

    [K E; F 0] [R; *] = [0; 1] is regular: R has the digits of soft springs beside stiff ones.
    """
    rows, columns = K.shape[1:]
    border = np.random.default_rng(0).standard_normal((len(K), rows + count, rows + count))
    border[:, :rows, :columns], border[:, rows:, columns:] = K, 0.0
    border[np.linalg.slogdet(border)[0] == 0.0] = np.nan
    unit = np.eye(rows + count)[:, rows:]
    solution = np.linalg.solve(border, unit)
    solution += np.linalg.solve(border, unit - border @ solution)
    return np.asarray(solution[:, :columns], dtype=float)


def _is_zero(terms: Array, R: Array, slowest: Array) -> NDArray[np.bool_]:
    """Of which samples terms R are nothing but rounding, and a mode is left: (N, 1, 1)."""
    sizes = np.max(np.abs(R), axis=1, keepdims=True, initial=0.0)  # what is zero is rounded to these
    is_zero = np.abs(terms @ R) <= _CONSERVED * np.sum(np.abs(terms), axis=2, keepdims=True) * sizes
    return np.asarray(np.isfinite(slowest) & is_zero.all(axis=(1, 2)))[:, None, None]


def _beside_motions(
    matrices: StateMatrices, rates: Mapping[int, int], count: int, sees: NDArray[np.bool_], slowest: Array
) -> tuple[StateMatrices, StateMatrices]:
    """The matrices in places beside the rigid motions R, and with these held for outputs that see none.

    With x' = v, K the stiffnesses, K R = 0, and R = 1 for as many places x1 as there are motions, states
    are x1, x - R x1, v1 and v - R v1. A has zeros for x1 and v1, and these are written. Held, v1' has
    -k^2 x1 - k v1 more, k the frequency of the slowest mode. A sample that is held less than the others,
    or whose other rows see motions, stays as it is.
    """
    A, B, C, D = matrices
    if count == 0:
        return matrices, matrices
    x, v = np.array([*rates]), np.array([*rates.values()])
    unit = A[:, x, v, None]
    observed = np.any(C[:, ~sees] != 0.0, axis=(0, 1))
    observed[x] = observed[v] = True
    observed = in_reach(np.any(A != 0.0, axis=0).T, observed)
    first, R = _motions(A[:, v[:, None], x] * unit.swapaxes(1, 2), count)
    observed[x] = False
    shown = np.concatenate([A[:, observed], C[:, ~sees]], axis=1)
    shown = np.concatenate([shown[:, :, x] * unit.swapaxes(1, 2), shown[:, :, v]], axis=1)
    is_free = _is_zero(shown, R, slowest)
    R = np.where(is_free, R, 0.0)
    R[:, first] = np.eye(len(first))
    T = np.tile(np.eye(A.shape[1]), (len(A), 1, 1))
    T[:, x[:, None], x[first]], T[:, v[:, None], v[first]] = unit * R / unit[:, None, first, 0], R
    beside, back = A @ T, 2.0 * np.eye(A.shape[1]) - T
    columns = np.concatenate([x[first], v[first]])
    beside[:, np.flatnonzero(observed)[:, None], columns] *= ~is_free
    beside = back @ beside
    beside[:, x] = A[:, x]
    held, k = beside.copy(), np.where(is_free[:, 0], slowest[:, None], 0.0)
    held[:, v[first], x[first]] -= k**2 / unit[:, first, 0]
    held[:, v[first], v[first]] -= k
    whole = StateMatrices(beside, back @ B, C @ T, D)
    return whole, whole._replace(A=held)


def _motions(K: Array, count: int) -> tuple[Indices, Array]:
    """Numbers of places, and R (N, n, count) with K R = 0 that is 1 for these.

    A column of zeros is a motion as it is: that of a joint to the ground of a chain. There may be more.
    """
    import scipy.linalg  # here because it is slow to import

    held = K.any(axis=(0, 1))
    first, others = np.flatnonzero(~held), np.flatnonzero(held)
    more = max(count - len(first), 0)
    R = np.zeros((len(K), K.shape[1], len(first) + more))
    R[:, first, range(len(first))] = 1.0
    if more:
        kernel = _kernel(K[:, :, others], more)
        of_all = np.nan_to_num(kernel).swapaxes(1, 2).reshape(-1, len(others))
        largest = scipy.linalg.qr(of_all, mode="r", pivoting=True)[-1][:more]
        scale = kernel[:, largest]
        scale[np.linalg.slogdet(scale)[0] == 0.0] = np.nan
        R[:, others, len(first) :] = kernel @ np.linalg.inv(scale)
        first = np.append(first, others[largest])
    return first, R


def _held(
    matrices: StateMatrices, beside: Sequence[int], count: int, slowest: Array, pushed: NDArray[np.bool_]
) -> StateMatrices:
    """The matrices with what draws momenta to zero: of inputs that leave them the responses are the same.

    With x' = v, and L K = 0, K the stiffnesses, momenta are L v. v' has -P (k^2 x + k v) more, where
    P = L' (L L')^-1 L, and k is the frequency of the slowest mode. A sample that is held less than the
    others has more of such modes, or momenta that B changes, and stays as it is. Of inputs that are
    `pushed`, and of states beside, what moves L v is left out, with the rigid motions R (L R)^-1 L v.
    """
    A, B, C, D = (matrix.copy() for matrix in matrices)
    rates = places_of(A, B, beside)
    if (count := min(count, len(rates))) == 0:
        return matrices
    x, v = np.array([*rates]), np.array([*rates.values()])
    unit = A[:, None, x, v]
    K = A[:, v[:, None], x] * unit
    L = _kernel(K.swapaxes(1, 2), count).swapaxes(1, 2)
    across = np.linalg.solve(L @ L.swapaxes(1, 2), L).swapaxes(1, 2) @ L
    kept = in_reach(np.any(A != 0.0, axis=0), np.any(B != 0.0, axis=(0, 2)))
    if np.any(pushed):
        kept &= np.isin(range(len(kept)), [*x, *v])
        fastest = frequencies_of(A, rates)[:, -1]
        slowest = np.where(slowest**2 > EPS * fastest**2, slowest, np.inf)  # R has digits
    terms = np.concatenate([A * kept, B * ~pushed], axis=2)[:, v].swapaxes(1, 2)
    is_held = _is_zero(terms, L.swapaxes(1, 2), slowest)
    if np.any(pushed):
        R = _kernel(K, count)
        for matrix, columns in ((A, np.flatnonzero(~kept)), (B, np.flatnonzero(pushed))):
            some = matrix[:, v[:, None], columns]
            rigid = R @ np.linalg.solve(L @ R, L @ some)
            matrix[:, v[:, None], columns] -= np.where(is_held, rigid, 0.0)
    k, P = (np.where(is_held, matrix, 0.0) for matrix in (slowest[:, None, None], across))
    A[:, v[:, None], x] -= k**2 * P / unit
    A[:, v[:, None], v] -= k * P
    return StateMatrices(A, B, C, D)
