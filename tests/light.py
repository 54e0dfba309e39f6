"""Free-flying structures with a momentum wheel: their nutation is hardly damped; 60 digits."""

from typing import NamedTuple

import flint
import numpy as np

from mbdlft import System, state_space
from mbdlft.base.array import Array

_BITS = 260
_WIDTHS, _STEPS = 20.0, 60  # of the bracket around a peak, in half widths; golden sections of it
INPUTS, OUTPUTS = ("torque x", "torque z"), ("angle x", "angle z", "rate x", "rate z")
# an angle integrates the torque about the other axis, as momentum is kept; rates are finite
FINITE = {(y, u): y.startswith("rate") or y[-1] == u[-1] for y in OUTPUTS for u in INPUTS}


class Flyer(NamedTuple):
    """M q'' + (D + G) q' + K q = F u of angles x, y, z and modes: all (n, n)."""

    M: Array
    D: Array
    K: Array


def flyer(seed: int, fastest: float = 0.0) -> Flyer:
    """Three angles, two to four modes that turn with x and z or with y, momentum along y."""
    random = np.random.default_rng(seed)
    modes = int(random.integers(2, 5))
    n = 3 + modes
    M = np.eye(n)
    M[range(3), range(3)] = random.uniform(100.0, 400.0, 3)
    with_y = np.arange(modes) % 3 == 2
    sides = np.where(with_y, [[0.0], [1.0], [0.0]], [[1.0], [0.0], [1.0]])
    M[:3, 3:] = sides * random.uniform(1.0, 4.5, (3, modes))
    M[3:, :3] = M[:3, 3:].T
    omega = random.uniform(0.5, 4.0, modes)
    omega[0] = fastest or omega[0]
    D, K = np.zeros((n, n)), np.zeros((n, n))
    K[range(3, n), range(3, n)] = omega**2
    D[range(3, n), range(3, n)] = 2.0 * 10.0 ** random.uniform(-2.0, -1.0, modes) * omega
    momentum = random.uniform(6.0, 10.0)
    D[0, 2], D[2, 0] = momentum, -momentum
    return Flyer(M, D, K)


def free_flyer(seed: int, fastest: float = 0.0) -> System:
    """The system from torques to angles and rates; entries that are zero are so exactly."""
    M, D, K = flyer(seed, fastest)
    n = len(M)
    around_y = np.abs(M[1]) > 0.0
    inverse = np.zeros((n, n))
    for group in (np.flatnonzero(around_y), np.flatnonzero(~around_y)):
        inverse[np.ix_(group, group)] = np.linalg.inv(M[np.ix_(group, group)])
    A = np.block([[np.zeros((n, n)), np.eye(n)], [-inverse @ K, -inverse @ D]])
    B = np.vstack([np.zeros((n, 2)), inverse[:, [0, 2]]])
    C = np.eye(2 * n)[[0, 2, n, n + 2]]
    names = {"inputs": list(INPUTS), "outputs": list(OUTPUTS)}
    return state_space(A, B, C, np.zeros((4, 2)), name="flyer", **names)


def peak_of_60_digits(seed: int, y: str, u: str, poles: Array) -> float:
    """The largest gain of a channel, near the frequencies of poles that doubles say (rad/s)."""
    M, D, K = flyer(seed)
    n, i, j = len(M), {"x": 0, "z": 2}[y[-1]], {"x": 0, "z": 2}[u[-1]]
    with flint.ctx.workprec(_BITS):
        exact = [flint.acb_mat(X.astype(complex).tolist()) for X in (M, D, K)]
        torque = flint.acb_mat(n, 1, [int(k == j) for k in range(n)])

        def gain(omega: flint.arb) -> flint.arb:
            s = flint.acb(0, omega)
            motion = (exact[0] * (s * s) + exact[1] * s + exact[2]).solve(torque)[i, 0]
            return abs(motion * s if y.startswith("rate") else motion).mid()

        best = gain(flint.arb(1e-30))
        for pole in poles[poles.imag > 0.0]:
            low, high = (flint.arb(pole.imag + side * _WIDTHS * abs(pole.real)) for side in (-1.0, 1.0))
            part = (flint.arb(5).sqrt() - 1) / 2
            for _ in range(_STEPS):
                first, second = ((high - part * (high - low)).mid(), (low + part * (high - low)).mid())
                low, high = (low, second) if gain(first) > gain(second) else (first, high)
            best = max(best, gain(((low + high) / 2).mid()))
        return float(best)
