"""Second derivatives of gains with respect to free values.

A gain is the largest singular value sigma of G = Z [A B ; C D] Y, with its vectors u and v. Values move
it by dG_k = Z L E_k R Y, and twice by Z L (E_k T E_l + E_l T E_k) R Y, where T goes from q to v with all
of the loop between. Other singular values add to this (Stewart, Sun, Matrix Perturbation Theory, 1990):
those of [0 G ; G* 0], with vectors w_j = (u_j, +-v_j)/sqrt 2 and values +-sigma_j, and w_j = (u_j, 0) or
(0, v_j) with zeros, in

    d2 sigma = Re u* d2G v + 2 sum_j |w_j* [0 dG ; dG* 0] w|^2 / (sigma -+ sigma_j).

Where the frequency is that of a peak, it moves with the values: the second derivative gets

    - (d2 sigma/dx d omega) (d2 sigma/d omega dx) / (d2 sigma/d omega2).
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from mbdlft.base.array import Array
from mbdlft.synthesis.evaluation import SECOND, Complex, Flags, Place, Responses, responses_at
from mbdlft.synthesis.goals import Goal
from mbdlft.synthesis.loop import Closed, Family

_PAIRED = 0.5  # of the largest singular value: a second one above it is kept beside it, not in its bend


def curvatures(family: Family, goals: Sequence[Goal], x: Array, at: Sequence[Place]) -> Array | None:
    """Second derivatives (k, values, values) of gains at places; None where a loop is singular.

    A second singular value that is nearly as large counts as the first, and does not repel it.
    """
    second = np.zeros((len(at), len(x), len(x)))
    if (parts := _parts(family, goals, x, at, SECOND, is_moving=False)) is None:
        return None
    for own, _, found in parts:
        second[own] = found.second / goals[at[own[0]][0]].limit
    return second


class Bends(NamedTuple):
    """How gains bend beside places, and their second singular values with what couples them.

    The gain is the largest eigenvalue of [a b ; b* c]: a has the value and the slope of the first one,
    c = value + slope d, b = cross d. Where the second is small, c is -inf.
    """

    second: Array  # (k, values, values): of a
    value: Array  # (k,)
    slope: Array  # (k, values)
    cross: Complex  # (k, values)


def bends(
    family: Family, goals: Sequence[Goal], x: Array, at: Sequence[Place], moving: Flags
) -> Bends | None:
    """Of gains at places, some of them peaks that are `moving`; None where a loop is singular."""
    n, k = len(x), len(at)
    all_of = Bends(np.zeros((k, n, n)), np.full(k, -np.inf), np.zeros((k, n)), np.zeros((k, n), complex))
    if (parts := _parts(family, goals, x, at, _PAIRED, is_moving=True)) is None:
        return None
    for own, gains, found in parts:
        limit = goals[at[own[0]][0]].limit
        mixed, of_peak = found.second[:, :-1, -1], found.second[:, -1, -1]
        falls = moving[own] & (of_peak < 0.0)
        shares = np.where(falls, 1.0 / np.where(falls, -of_peak, 1.0), 0.0)[:, None, None]
        peak = shares * mixed[:, :, None] * mixed[:, None, :]
        all_of.second[own] = (found.second[:, :-1, :-1] + peak) / limit
        if gains.sizes.shape[1] > 1:
            pair = np.einsum("xqv,kq,kv->kx", family.moves, gains.out[:, 1], gains.into[:, :, 1]).real
            near = gains.sizes[:, 1] >= _PAIRED * gains.sizes[:, 0]
            all_of.value[own] = np.where(near, gains.sizes[:, 1] / limit, -np.inf)
            all_of.slope[own] = pair / limit
            all_of.cross[own] = np.conj(found.left[:, 1, :-1] + found.right[:, 1, :-1]) / (2.0 * limit)
    return all_of


class _Second(NamedTuple):
    """Second derivatives (k, values, values), the last by a moving frequency; u_j* dG v, v_j* dG* u."""

    second: Array
    left: Complex
    right: Complex


def _parts(
    family: Family, goals: Sequence[Goal], x: Array, at: Sequence[Place], alike: float, *, is_moving: bool
) -> Iterator[tuple[list[int], Responses, _Second]] | None:
    """Of each goal: which places are of it, responses there, and their derivatives."""
    points = sorted({point for _, point, _ in at})
    few = family.at(points)
    if (closed := few.closed(x)) is None:
        return None

    def of_goal(goal: int) -> tuple[list[int], Responses, _Second]:
        own = [k for k, place in enumerate(at) if place[0] == goal]
        here = [(goal, points.index(point), omega) for _, point, omega in (at[k] for k in own)]
        gains = responses_at(closed, goals, goal, here)
        return own, gains, _second(few, closed, gains, alike, is_moving=is_moving)

    return (of_goal(goal) for goal in sorted({place[0] for place in at}))


def _second(family: Family, closed: Closed, at: Responses, alike: float, *, is_moving: bool) -> _Second:
    """A second singular value that is at least a part `alike` of the first does not repel it."""
    n = family.states
    L, R = closed.L[at.points][:, :n], closed.R[at.points][:, :, :n]
    T = closed.T[at.points] + R @ at.inverse @ L
    # of each value: to v, from q, u_j* dG_k v, and v_j* dG_k* u
    before = np.tensordot(at.out[:, 0], family.moves, (1, 1))
    after = np.swapaxes(np.tensordot(at.into[:, :, 0], family.moves, (1, 2)), 1, 2)
    left, right = at.out @ after, np.conj(np.swapaxes(before @ at.into, 1, 2))
    second = (before @ T @ after).real
    second = second + np.swapaxes(second, 1, 2)
    if is_moving:
        row, column = np.conj(np.swapaxes(at.u, 1, 2)) @ at.row, at.column @ at.v
        turned = -1j * (row @ column)
        left = np.concatenate([left, turned[:, :, :1]], axis=2)
        right = np.concatenate([right, np.conj(np.swapaxes(turned[:, :1], 1, 2))], axis=2)
        row, column = row[:, :1] @ at.inverse, column[:, :, :1]
        mixed = np.swapaxes(row @ L @ after, 1, 2) + before @ R @ (at.inverse @ column)
        last = np.concatenate([mixed.imag, -2.0 * (row @ column).real], axis=1)
        second = np.concatenate([second, np.swapaxes(last[:, :-1], 1, 2)], axis=1)
        second = np.concatenate([second, last], axis=2)
    k, first = at.sizes.shape[1], np.maximum(at.sizes[:, :1], 1e-300)
    a, b = left[:, :k], right[:, :k]
    moved = np.hstack(
        [0.5 * (a + b), 0.5 * (a - b), np.sqrt(0.5) * left[:, k:], np.sqrt(0.5) * right[:, k:]]
    )
    gaps = np.broadcast_to(first, moved.shape[:2]).copy()
    gaps[:, : 2 * k] += np.hstack([-at.sizes, at.sizes])
    gaps[:, :k][at.sizes >= alike * first] = np.inf
    others = (np.conj(np.swapaxes(moved, 1, 2)) / gaps[:, None]) @ moved
    return _Second(np.asarray(second + 2.0 * others.real), left, right)
