"""Parts wired to a whole: in the LFT, and in numbers at points.

With u and y all inputs and outputs of the parts, w and z those of the whole,

    0 = K_y y + K_u u + E w,        z = F y + G u

Feedback, series, sums, products, selections and inversions of channels are choices of these matrices.
"""

from collections.abc import Sequence
from itertools import compress
from typing import NamedTuple

import numpy as np

from mbdlft.base.array import Array
from mbdlft.base.errors import WellPosednessError
from mbdlft.lft.lft import LFT, as_plain, constant, eliminate, of_kinds, select, stack_diagonal
from mbdlft.order.reduction import reduce_order
from mbdlft.system.model import System

_SHARE = 0.1  # of a direction that a loop does not determine: signals above it are named


class Wiring(NamedTuple):
    """The matrices above: K_y (nu, ny), K_u (nu, nu), E (nu, nw), F (nz, ny), G (nz, nu)."""

    Ky: Array
    Ku: Array
    E: Array
    F: Array
    G: Array


class Values(NamedTuple):
    """[A B ; C D] of the whole at points (N, ., .), what errors of the parts make of it, and its terms.

    Terms (., .) are the largest sizes that entries would have at the points if nothing cancelled; sizes
    (., .) are those that rounding of the parts is relative to.
    """

    whole: Array
    errors: Array
    terms: Array
    sizes: Array


def plain_wiring(systems: Sequence[System], inputs: int, outputs: int) -> Wiring:
    """Nothing wired: 0 = -u, z = 0; arrays to be filled."""
    nu, ny = (sum(len(getattr(s, side)) for s in systems) for side in ("inputs", "outputs"))
    return Wiring(
        np.zeros((nu, ny)),
        -np.eye(nu),
        np.zeros((nu, inputs)),
        np.zeros((outputs, ny)),
        np.zeros((outputs, nu)),
    )


def beside_gains(
    systems: Sequence[System], wiring: Wiring
) -> tuple[Sequence[System], Array, Array, Array, Array]:
    """The systems that are more than real numbers, with K_y, E, F of these, and what w does to z beside.

    All of them, where the others are a loop that determines nothing.
    """
    kept = [bool(system.states or system.order or system.lft.is_complex) for system in systems]
    u, y = (
        np.repeat(kept, [len(getattr(system, side)) for system in systems])
        for side in ("inputs", "outputs")
    )
    D = stack_diagonal(
        *(
            np.zeros((len(system.outputs), len(system.inputs))) if is_kept else system.lft.M22
            for system, is_kept in zip(systems, kept, strict=True)
        )
    ).M22
    by_u = wiring.G + wiring.F @ D
    try:
        both = -np.linalg.solve(wiring.Ku + wiring.Ky @ D, np.hstack([wiring.Ky[:, y], wiring.E]))
    except np.linalg.LinAlgError:
        return systems, wiring.Ky, wiring.E, wiring.F, wiring.G
    Ky, E = np.hsplit(both, [np.count_nonzero(y)])
    return list(compress(systems, kept)), Ky[u], E[u], wiring.F[:, y] + by_u @ Ky, by_u @ E


def wire(systems: Sequence[System], wiring: Wiring, what: str) -> LFT:
    """The LFT of [A B ; C D] of the whole, not reduced; states are those of the parts in their order."""
    rows, columns = _states_first(systems)
    both = select(stack_diagonal(*(system.lft for system in systems)), rows, columns)
    nx = sum(len(system.states) for system in systems)
    (nu, ny), nw, nz = wiring.Ky.shape, wiring.E.shape[1], len(wiring.F)
    first = np.zeros((nu + nx + nz, nx + ny))
    first[:nu, nx:], first[nu + nx :, nx:] = wiring.Ky, wiring.F
    first[nu : nu + nx, :nx] = np.eye(nx)
    last = np.zeros((nx + nu, nu + nx + nw))
    last[:nx, nu : nu + nx], last[nx:, :nu] = np.eye(nx), np.eye(nu)
    direct = np.zeros((nu + nx + nz, nu + nx + nw))
    direct[:nu, :nu], direct[:nu, nu + nx :], direct[nu + nx :, :nu] = wiring.Ku, wiring.E, wiring.G
    relations = constant(first) @ both @ last + direct
    try:
        solved = eliminate(relations, nu)
    except WellPosednessError:
        raise WellPosednessError(
            f"{what}: the loop is singular at nominal: it does not determine "
            f"{', '.join(_undetermined(systems, relations.M22[:nu, :nu]))}. Somewhere in it a direct "
            "feed-through must change, for example by a state in the controller."
        ) from None
    return select(solved, np.arange(nu, nu + nx + nz), np.arange(nx + nw))


def _undetermined(systems: Sequence[System], loop: Array) -> list[str]:
    """Inputs of parts in the direction in which a loop is singular."""
    names = [f"{signal.name} of {system.name}" for system in systems for signal in system.inputs]
    direction = np.abs(np.linalg.svd(loop)[2][-1])
    return [name for name, size in zip(names, direction, strict=True) if size > _SHARE]


def reduced(a: LFT) -> LFT:
    """The LFT of equal value that `reduce_order` gives, beside blocks of any kind.

    One with complex entries comes back as it is.
    """
    if a.is_plain:
        return reduce_order(a)
    if a.is_complex:
        return a
    plain, full = as_plain(a)
    return of_kinds(reduce_order(plain), full, a)


def _states_first(systems: Sequence[System]) -> tuple[list[int], list[int]]:
    """Rows and columns of diag([A B ; C D], ...) in the order [all x ; all y] and [all x ; all u]."""
    orders: tuple[list[int], list[int]] = ([], [])
    for side, order in enumerate(orders):
        states, signals, start = list[int](), list[int](), 0
        for system in systems:
            nx, n = len(system.states), system.lft.shape[side]
            states += range(start, start + nx)
            signals += range(start + nx, start + n)
            start += n
        order += [*states, *signals]
    return orders


def wired_values(
    systems: Sequence[System],
    values: Sequence[Array],
    errors: Sequence[float],
    sizes: Sequence[Array],
    wiring: Wiring,
) -> Values:
    """The whole by state-space formulas from the values (N, ., .) of its systems, without the LFT.

    `errors` has for each system the error of an entry relative to its largest size over the points, and
    `sizes` (., .) what rounding of its entries is relative to. Those of the whole are of first order:
    d whole = L dS R, with dS those of the systems. A LinAlgError says that the loop is singular at one of
    the points.
    """
    S = _side_by_side(systems, values)
    largest = [np.max(np.abs(value), axis=0, initial=0.0) for value in values]
    dS = _side_by_side(systems, [e * size[None] for e, size in zip(errors, largest, strict=True)])[0]
    scales = _side_by_side(systems, [size[None] for size in sizes])[0]
    nx = sum(len(system.states) for system in systems)
    (nu, ny), nw = wiring.Ky.shape, wiring.E.shape[1]
    C, D = S[:, nx:, :nx], S[:, nx:, nx:]
    loop = wiring.Ku + wiring.Ky @ D
    solved = np.linalg.inv(loop)
    E = np.broadcast_to(wiring.E, (len(S), nu, nw))
    u = -solved @ np.concatenate([wiring.Ky @ C, E], axis=2)  # from [x ; w]
    x = np.broadcast_to(np.eye(nx, nx + nw), (len(S), nx, nx + nw))
    R = np.concatenate([x, u], axis=1)  # [x ; u]
    read = S @ R  # [xdot ; y]
    whole = np.concatenate([read[:, :nx], wiring.F @ read[:, nx:] + wiring.G @ u], axis=1)
    back = -solved @ wiring.Ky  # u of an addition to y
    to_x = np.concatenate([np.broadcast_to(np.eye(nx), (len(S), nx, nx)), S[:, :nx, nx:] @ back], 2)
    through = wiring.F @ (np.eye(ny) + D @ back) + wiring.G @ back
    to_z = np.concatenate([np.zeros((len(S), len(wiring.F), nx)), through], axis=2)
    L = np.concatenate([to_x, to_z], axis=1)
    # sizes if nothing cancelled
    R_terms = np.abs(solved) @ np.concatenate([np.abs(wiring.Ky) @ np.abs(C), np.abs(E)], axis=2)
    read_terms = np.abs(S) @ np.concatenate([np.abs(x), R_terms], axis=1)
    seen = np.abs(wiring.F) @ read_terms[:, nx:] + np.abs(wiring.G) @ R_terms
    terms = np.max(np.concatenate([read_terms[:, :nx], seen], axis=1), axis=0)
    by_parts, by_errors = (np.abs(L) @ change @ np.abs(R) for change in (scales, dS))
    # elimination of u is off by rounding of the sizes of its factors
    off = np.abs(solved) @ _sizes_of_factors(loop) @ np.abs(u)
    to_rows = np.concatenate([S[:, :nx, nx:], wiring.F @ S[:, nx:, nx:] + wiring.G], axis=1)
    sizes = np.maximum(by_parts, np.abs(to_rows) @ off)
    return Values(whole, by_errors, terms, np.maximum(terms, np.max(sizes, axis=0)))


def _sizes_of_factors(matrices: Array) -> Array:
    """|L| |U| of matrices (N, n, n), with the rows where they were: at least |L U|."""
    from scipy.linalg import lu  # here because it is slow to import

    factors = (lu(matrix, permute_l=True) for matrix in matrices)
    return np.array([np.abs(left) @ np.abs(right) for left, right in factors]).reshape(matrices.shape)


def _side_by_side(systems: Sequence[System], values: Sequence[Array]) -> Array:
    """Values (N, ., .) of all parts as one [A B ; C D]."""
    rows, columns = _states_first(systems)
    S, i, j = np.zeros((len(values[0]), len(rows), len(columns)), dtype=np.result_type(*values)), 0, 0
    for value in values:
        S[:, i : i + value.shape[1], j : j + value.shape[2]] = value
        i, j = i + value.shape[1], j + value.shape[2]
    return S[:, rows][:, :, columns]
