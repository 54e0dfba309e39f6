"""Uniform beams held at both ends in some way: exact frequencies, by transfer matrices.

Timoshenko's beam under an axial tension N, with the energy int N w'^2/2, has with the amplitudes
[w, theta, M, H] of a vibration with the frequency omega

    w' = theta + (H - N w')/kGA,  theta' = M/EI,
    M' = -(H - N w') - rho I omega^2 theta,  H' = -rho A omega^2 w

where H is the force across the undeformed axis. Euler's beam has no rho I and infinite kGA. Lengths are
in units of L and forces in those of EI/L^2, so that no number is large: a minor of the transfer matrix
cancels its own size exp(kL) once, which is 1e5 for the fourth frequency, and leaves ten digits.
"""

from itertools import pairwise

import numpy as np
from scipy.linalg import expm
from scipy.optimize import brentq

FREE, CLAMPED, PINNED = (2, 3), (0, 1), (0, 2)  # of w, theta, M, H: those that vanish at an end


def frequencies(
    count: int,
    first: tuple[int, int],
    last: tuple[int, int],
    *,
    length: float,
    line: float,
    bending: float,
    shear: float = np.inf,
    rotary: float = 0.0,
    tension: float = 0.0,
    highest: float,
) -> np.ndarray:
    """The lowest `count` frequencies (rad/s), found by signs up to `highest`.

    `line` = rho A (kg/m), `bending` = E I (N m^2), `shear` = k G A (N), `rotary` = rho I (kg m).
    """
    free = [k for k in range(4) if k not in first]
    force = bending / length**2
    N, soft = tension / force, force / shear
    turned, sheared = (x / (1.0 + N * soft) for x in (1.0, soft))

    def determinants(omega: np.ndarray) -> np.ndarray:
        w2 = np.square(omega)
        change = np.zeros((*w2.shape, 4, 4))
        change[..., 0, 1], change[..., 0, 3], change[..., 1, 2] = turned, sheared, 1.0
        change[..., 2, 1], change[..., 2, 3] = N * turned - rotary * w2 / force, N * sheared - 1.0
        change[..., 3, 0] = -line * w2 * length**2 / force
        return np.asarray(np.linalg.det(expm(change)[..., last, :][..., free]))

    grid = np.linspace(0.0, highest, 40 * count)[1:]
    signs = np.sign(determinants(grid))
    brackets = [ends for ends, (a, b) in zip(pairwise(grid), pairwise(signs), strict=True) if a * b < 0]
    assert len(brackets) >= count, "give a higher frequency"
    return np.array([brentq(determinants, a, b, xtol=1e-12 * b) for a, b in brackets[:count]])
