"""States and channels near to one in size: modes that are pushed as much as they are seen."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbdlft.base.array import Array
from mbdlft.response.resolvent import balancing
from mbdlft.robust.characteristic import Realization

_DEPENDENT = 1e10  # condition of modes from which on states are only scaled


class Coordinates(NamedTuple):
    """What states are multiplied with, (n, n), and what back; powers of two.

    These are what channels (r,) are divided by, and time (rad/s) is multiplied with.
    """

    states: Array
    back: Array
    channels: Array
    time: float


def modal(model: Realization) -> Coordinates:
    """The modes of A, of one or two real states; scaled states if modes are nearly dependent."""
    n = len(model.A)
    if not n:
        return Coordinates(np.zeros((0, 0)), np.zeros((0, 0)), np.ones(len(model.D)), 1.0)
    scale = balancing(model.A)
    values, vectors = np.linalg.eig(model.A * scale / scale[:, None])
    sizes = np.abs(values[values != 0.0])
    time = float(2.0 ** np.round(np.mean(np.log2(sizes)))) if len(sizes) else 1.0
    columns: list[Array] = []
    owner: list[int] = []
    for k in np.flatnonzero(values.imag >= 0.0):
        parts = (vectors[:, k].real, vectors[:, k].imag)[: 1 + (values[k].imag > 0.0)]
        columns += parts
        owner += [int(k)] * len(parts)
    modes: Array = np.array(columns).T
    if np.linalg.cond(modes) > _DEPENDENT:
        modes, owner = np.eye(n), list(range(n))
    B, C = np.linalg.solve(modes, model.B / scale[:, None]), model.C * scale @ modes
    back: Array = scale[:, None] * modes * _between(C.T, np.asarray(B), np.array(owner))
    states = np.asarray(np.linalg.inv(back))
    channel = np.repeat(np.arange(len(model.sizes)), model.sizes)
    channels = _between((states @ model.B).T / time, model.C @ back, channel)
    return Coordinates(states, back, channels, time)


def turned(model: Realization, states: Array, back: Array) -> Realization:
    """The model with other states."""
    return model._replace(
        A=states @ model.A @ back,
        B=states @ model.B,
        C=model.C @ back,
        E=states @ model.E,
        G=model.G @ back,
    )


def _between(one: Array, other: Array, owner: NDArray[np.int64]) -> Array:
    """Powers of two that make rows of `one` times them and of `other` over them equal, by owners."""
    sizes = []
    for rows in (one, other):
        squares = np.bincount(
            owner, np.sum(rows**2, axis=1), minlength=int(np.max(owner, initial=-1)) + 1
        )
        sizes.append(np.sqrt(squares[owner]))
    both = (sizes[0] > 0.0) & (sizes[1] > 0.0)
    ratio = np.where(both, sizes[1], 1.0) / np.where(both, sizes[0], 1.0)
    return np.asarray(2.0 ** np.round(0.5 * np.log2(ratio)))
