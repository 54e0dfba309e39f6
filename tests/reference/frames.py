"""Space frames by the textbook: Euler-Bernoulli elements with consistent masses.

Matrices without any code of the package: Przemieniecki, Theory of matrix structural analysis, 1968,
chapters 5 and 11, without rotary inertia and shear. u, v, w, rx, ry, rz at every node.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbdlft import FiniteElements, Nodes

Array = NDArray[np.float64]


class Section(NamedTuple):
    """Density, area, moduli and moments of area of a bar (SI)."""

    rho: float = 2700.0
    A: float = 6e-4
    E: float = 7e10
    G: float = 2.7e10
    I_y: float = 4e-8
    I_z: float = 9e-8
    J: float = 3e-8


ALUMINUM = Section()


def element(s: Section, length: float) -> tuple[Array, Array]:
    """Mass and stiffness (12, 12) of a bar along x."""
    M, K = np.zeros((12, 12)), np.zeros((12, 12))
    for at, mass, stiffness in (
        ((0, 6), s.rho * s.A * length, s.E * s.A / length),
        ((3, 9), s.rho * (s.I_y + s.I_z) * length, s.G * s.J / length),
    ):
        block = np.ix_(at, at)
        M[block] += mass * np.array([[1 / 3, 1 / 6], [1 / 6, 1 / 3]])
        K[block] += stiffness * np.array([[1.0, -1.0], [-1.0, 1.0]])
    for at, sign, inertia in (((1, 5, 7, 11), 1.0, s.I_z), ((2, 4, 8, 10), -1.0, s.I_y)):
        a = length
        mass = np.array(
            [
                [156, 22 * a, 54, -13 * a],
                [22 * a, 4 * a**2, 13 * a, -3 * a**2],
                [54, 13 * a, 156, -22 * a],
                [-13 * a, -3 * a**2, -22 * a, 4 * a**2],
            ]
        )
        stiffness = np.array(
            [
                [12, 6 * a, -12, 6 * a],
                [6 * a, 4 * a**2, -6 * a, 2 * a**2],
                [-12, -6 * a, 12, -6 * a],
                [6 * a, 2 * a**2, -6 * a, 4 * a**2],
            ]
        )
        turn = np.diag([1.0, sign, 1.0, sign])
        block = np.ix_(at, at)
        M[block] += s.rho * s.A * a / 420.0 * turn @ mass @ turn
        K[block] += s.E * inertia / a**3 * turn @ stiffness @ turn
    return M, K


def frame(
    coordinates: Array, bars: Sequence[tuple[int, int]], section: Section = ALUMINUM
) -> FiniteElements:
    """Dense matrices of bars between nodes (counted from 0, numbered 10, 20, ...), and the node table."""
    coordinates = np.asarray(coordinates, dtype=float)
    n = len(coordinates)
    M, K = np.zeros((6 * n, 6 * n)), np.zeros((6 * n, 6 * n))
    for a, b in bars:
        along = coordinates[b] - coordinates[a]
        length = float(np.linalg.norm(along))
        x = along / length
        up = np.array([0.0, 0.0, 1.0]) if abs(x[2]) < 0.9 else np.array([0.0, 1.0, 0.0])
        y = np.cross(up, x) / np.linalg.norm(np.cross(up, x))
        turn = np.kron(np.eye(4), np.stack([x, y, np.cross(x, y)]))
        rows = [*range(6 * a, 6 * a + 6), *range(6 * b, 6 * b + 6)]
        mass, stiffness = element(section, length)
        M[np.ix_(rows, rows)] += turn.T @ mass @ turn
        K[np.ix_(rows, rows)] += turn.T @ stiffness @ turn
    return FiniteElements(M, K, Nodes(10 * np.arange(1, n + 1), coordinates))


def straight(count: int, length: float = 2.0, section: Section = ALUMINUM) -> FiniteElements:
    """A straight beam along x with `count` elements: nodes 10, 20, ... from the origin."""
    x = np.linspace(0.0, length, count + 1)
    bars = [(k, k + 1) for k in range(count)]
    return frame(np.stack([x, 0 * x, 0 * x], axis=1), bars, section)


def tee(count: int = 4) -> FiniteElements:
    """A T: a stem along x of `count` elements, then arms along +y and -y of as many each.

    Nodes: 10 at the foot, 10 (count + 1) at the crossing, then +y outward, then -y outward.
    """
    stem = [(0.3 * k, 0.0, 0.0) for k in range(count + 1)]
    cross = stem[-1][0]
    right = [(cross, 0.25 * k, 0.0) for k in range(1, count + 1)]
    left = [(cross, -0.25 * k, 0.0) for k in range(1, count + 1)]
    bars = [(k, k + 1) for k in range(count)]
    for start in (count + 1, 2 * count + 1):
        bars.append((count, start))
        bars += [(k, k + 1) for k in range(start, start + count - 1)]
    return frame(np.array([*stem, *right, *left]), bars)
