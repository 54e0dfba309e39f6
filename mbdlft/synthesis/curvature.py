"""Second derivatives of gains with respect to free values.

A gain is the largest singular value sigma of G = Z [A B ; C D] Y, with its vectors u and v. Values move
it by dG_k = Z L E_k R Y, and twice by Z L (E_k T E_l + E_l T E_k) R Y, where T goes from q to v with all
of the loop between. Other singular values add to this (Stewart, Sun, Matrix Perturbation Theory, 1990):
those of [0 G ; G* 0], with vectors w_j = (u_j, +-v_j)/sqrt 2 and values +-sigma_j, and w_j = (u_j, 0) or
(0, v_j) with zeros, in

    d2 sigma = Re u* d2G v + 2 sum_j |w_j* [0 dG ; dG* 0] w|^2 / (sigma -+ sigma_j).
"""

from collections.abc import Sequence

import numpy as np

from mbdlft.base.array import Array
from mbdlft.synthesis.evaluation import SECOND, Place, responses_at
from mbdlft.synthesis.goals import Goal
from mbdlft.synthesis.loop import Closed, Family


def curvatures(family: Family, goals: Sequence[Goal], x: Array, at: Sequence[Place]) -> Array | None:
    """Second derivatives (k, values, values) of gains at places; None where a loop is singular.

    A second singular value that is nearly as large counts as the first, and does not repel it.
    """
    points = sorted({point for _, point, _ in at})
    few = family.at(points)
    if (closed := few.closed(x)) is None:
        return None
    second = np.zeros((len(at), len(x), len(x)))
    for goal in {place[0] for place in at}:
        own = [k for k, place in enumerate(at) if place[0] == goal]
        places = [(goal, points.index(point), omega) for _, point, omega in (at[k] for k in own)]
        second[own] = _of_goal(few, closed, goals, goal, places)
    return second


def _of_goal(
    family: Family, closed: Closed, goals: Sequence[Goal], goal: int, places: Sequence[Place]
) -> Array:
    at, n = responses_at(closed, goals, goal, places), family.states
    L, R = closed.L[at.points][:, :n], closed.R[at.points][:, :, :n]
    T = closed.T[at.points] + R @ at.inverse @ L
    # of each value: to v, from q, u_j* dG_k v, and v_j* dG_k* u
    before = np.tensordot(at.out[:, 0], family.moves, (1, 1))
    after = np.swapaxes(np.tensordot(at.into[:, :, 0], family.moves, (1, 2)), 1, 2)
    left, right = at.out @ after, np.conj(np.swapaxes(before @ at.into, 1, 2))
    second = (before @ T @ after).real
    k, first = at.sizes.shape[1], np.maximum(at.sizes[:, :1], 1e-300)
    a, b = left[:, :k], right[:, :k]
    moved = np.hstack(
        [0.5 * (a + b), 0.5 * (a - b), np.sqrt(0.5) * left[:, k:], np.sqrt(0.5) * right[:, k:]]
    )
    gaps = np.broadcast_to(first, moved.shape[:2]).copy()
    gaps[:, : 2 * k] += np.hstack([-at.sizes, at.sizes])
    gaps[:, :k][at.sizes >= SECOND * first] = np.inf
    others = (np.conj(np.swapaxes(moved, 1, 2)) / gaps[:, None]) @ moved
    return np.asarray((second + np.swapaxes(second, 1, 2) + 2.0 * others.real) / goals[goal].limit)
