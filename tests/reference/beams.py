"""Uniform beams held at both ends in some way: exact frequencies, by transfer matrices in mpmath.

Timoshenko's beam under an axial tension N, with the energy int N w'^2/2, has with the amplitudes
[w, theta, M, H] of a vibration with the frequency omega

    w' = theta + (H - N w')/kGA,  theta' = M/EI,
    M' = -(H - N w') - rho I omega^2 theta,  H' = -rho A omega^2 w

where H is the force across the undeformed axis. Euler's beam has no rho I and infinite kGA.
"""

from itertools import pairwise

import mpmath as mp
import numpy as np

FREE, CLAMPED, PINNED = (2, 3), (0, 1), (0, 2)  # of w, theta, M, H: those that vanish at an end


def frequencies(
    count: int,
    first: tuple[int, int],
    last: tuple[int, int],
    *,
    length: float,
    line: float,
    bending: float,
    shear: float = mp.inf,
    rotary: float = 0.0,
    tension: float = 0.0,
    highest: float,
) -> np.ndarray:
    """The lowest `count` frequencies (rad/s), found by signs up to `highest`.

    `line` = rho A (kg/m), `bending` = E I (N m^2), `shear` = k G A (N), `rotary` = rho I (kg m).
    """
    free = [k for k in range(4) if k not in first]

    def determinant(omega: mp.mpf) -> mp.mpf:
        w2 = mp.mpf(omega) ** 2
        soft = 1 / mp.mpf(shear)
        turned, sheared = (x / (1 + tension * soft) for x in (1, soft))
        slope = [0, turned, 0, sheared]
        moment = [tension * c for c in slope]
        moment[1] -= rotary * w2
        moment[3] -= 1
        rows = [slope, [0, 0, 1 / mp.mpf(bending), 0], moment, [-line * w2, 0, 0, 0]]
        matrix = mp.matrix(rows)
        transfer = mp.expm(matrix * length)
        part = mp.matrix(2, 2)
        for i, row in enumerate(last):
            for j, column in enumerate(free):
                part[i, j] = transfer[row, column]
        return mp.det(part)

    found: list[float] = []
    grid = np.linspace(0.0, highest, 40 * count)[1:]
    before = determinant(grid[0])
    for a, b in pairwise(grid):
        after = determinant(b)
        if before * after < 0:
            found.append(float(mp.findroot(determinant, (a, b), solver="anderson", tol=1e-30)))
        before = after
    assert len(found) >= count, "give a higher frequency"
    return np.array(found[:count])
