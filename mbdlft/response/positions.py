"""Accelerations as s^2 times positions: far below the modes the sum D + C (s I - A)^-1 B has no digits.

There a structure that is held hardly moves. C (s I - A)^-1 B is then nearly -D, and the sum, or that of
the terms of C x, loses all digits of w^2 x. So do the states of what an acceleration drives.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbdlft.base.array import Array
from mbdlft.exact.rounding import EPS
from mbdlft.response.momenta import frequencies_of
from mbdlft.system.sampled import StateMatrices, places_of, rates_of

_SAME = 8.0 * EPS  # of an entry: rows that differ by less are one; accelerometers have g in them, too
_CANCELED = 0.1  # of terms: where less is left, a digit is lost


class Place(NamedTuple):
    """The row of the position of an output that is an acceleration."""

    row: int
    until: Array  # (N,), rad/s: below, the position may have more digits


def with_positions(
    matrices: StateMatrices,
    proved: Sequence[int] = (),
    driven: Sequence[int] = (),
    beside: Sequence[int] = (),
) -> tuple[StateMatrices, dict[int, Place]]:
    """The matrices with positions of outputs that are accelerations as further outputs; their places.

    Output i is the acceleration of a position p if its row [C D] is that of the rate v in [A B], where
    the row of p says that its derivative is v. The row of one that is `proved` is a sum of those of
    rates, and its position the same sum of theirs. With `driven` states it is what positions drive in
    copies of these; states `beside`, these among them, are no places. Sums have no more digits than are
    left at the slowest pole. Behind the positions stand as many outputs C x with random weights, with
    which its terms do not cancel.
    """
    A, B, C, D = matrices
    states, outputs = A.shape[1], C.shape[1]
    derivatives, measured = (np.concatenate(pair, axis=2) for pair in ((A, B), (C, D)))
    rows: dict[int, Array] = {}
    rates = rates_of(A, B)
    for p, v in rates.items():
        largest = int(np.argmax(np.abs(derivatives[0, v])))
        for i in np.flatnonzero(measured[0, :, largest]).tolist():
            unit = measured[0, i, largest] / (derivatives[0, v, largest] or 1.0)
            apart = np.abs(measured[:, i] - unit * derivatives[:, v])
            if np.all(apart <= _SAME * np.abs(measured[:, i])):
                rows[i] = np.eye(states)[p] * unit / A[:, p, v, None]
    until = dict.fromkeys(rows, np.full(len(A), np.inf))
    if others := [i for i in proved if i not in rows]:
        rates = places_of(A, B, beside)
        until |= dict.fromkeys(others, frequencies_of(A, rates)[:, 0])
        sums = np.concatenate([C[:, others], A[:, driven]], axis=1)
        moved = _moved(sums, A, rates, [*driven])
        padding = (0, 0), (0, 0), (0, len(driven))
        rows = {i: np.pad(row, padding[1:]) for i, row in rows.items()}
        rows |= {i: moved[:, k] for k, i in enumerate(others)}
        copies = np.where(np.isfinite(moved), moved, 0.0)[:, len(others) :]
        A = np.concatenate([np.pad(A, padding), copies], axis=1)
        B, C = np.pad(B, (padding[0], padding[2], padding[0])), np.pad(C, padding)
    if not rows:
        return matrices, {}
    weights = np.random.default_rng(0).standard_normal(states)
    largest_terms = np.zeros((len(A), len(rows), A.shape[1]))
    largest_terms[:, :, :states] = weights * np.max(np.abs(C[:, [*rows], :states]), axis=2, keepdims=True)
    read = np.concatenate([np.stack([*rows.values()], axis=1), largest_terms], axis=1)
    none = np.zeros((len(A), 2 * len(rows), D.shape[2]))
    both = StateMatrices(A, B, np.concatenate([C, read], axis=1), np.concatenate([D, none], axis=1))
    return both, {i: Place(outputs + k, until[i]) for k, i in enumerate(rows)}


def _moved(sums: Array, A: Array, rates: Mapping[int, int], driven: list[int]) -> Array:
    """Rows (N, m, n) that are sums of those of rates, beside driven states, as sums of positions.

    Stiffnesses tell them. Behind the states stand what is left for the driven ones.
    """
    position, rate = [*rates], [*rates.values()]
    stiffness = A[:, rate][:, :, position]
    stiffness[np.linalg.slogdet(stiffness)[0] == 0.0] = np.nan  # none is left there
    turned, right = np.swapaxes(stiffness, 1, 2), np.swapaxes(sums[:, :, position], 1, 2)
    factors = np.linalg.solve(turned, right)
    factors += np.linalg.solve(turned, right - turned @ factors)
    factors = np.swapaxes(factors, 1, 2)
    read = np.zeros(sums.shape)
    read[:, :, position] = factors / A[:, None, position, rate]
    return np.concatenate([read, sums[:, :, driven] - factors @ A[:, rate][:, :, driven]], axis=2)


def from_positions(
    response: NDArray[np.complex128], D: Array, omega: Array, places: Mapping[int, Place]
) -> NDArray[np.complex128]:
    """A response (N, F, ny, nu) without the positions; accelerations are -w^2 x where these are small."""
    for i, (k, until) in places.items():
        by_position = -(omega[:, :, None] ** 2) * response[:, :, k]
        terms = np.abs(D[:, None, i]) + np.abs(response[:, :, k + len(places)])
        is_small = np.abs(by_position) < _CANCELED * terms
        is_small &= (np.abs(omega) < until[:, None])[:, :, None]
        response[:, :, i] = np.where(is_small, by_position, response[:, :, i])
    return response[:, :, : response.shape[2] - 2 * len(places)]
