"""Finite-element beams in bending, written down from their matrices, without mbdlft.

Appendices A and B of J. A. Perez, PhD thesis (ISAE, Toulouse, 2016); displacements and slopes of a node
are absolute, those of the superelement are turned into absolute ones here.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.linalg import eigh

Array = np.ndarray


class Mesh(NamedTuple):
    """Free beam: M, K (n, n), and the positions of [displacement, slope] of its two ends."""

    M: Array
    K: Array
    root: tuple[int, int]
    tip: tuple[int, int]


def hermite(length: float, stiffness: float, density: float) -> tuple[Array, Array]:
    """One cubic element, unknowns (v1, th1, v2, th2): equations (B.1) to (B.4)."""
    h = length
    M = np.array(
        [
            [156, 22 * h, 54, -13 * h],
            [22 * h, 4 * h**2, 13 * h, -3 * h**2],
            [54, 13 * h, 156, -22 * h],
            [-13 * h, -3 * h**2, -22 * h, 4 * h**2],
        ]
    )
    K = np.array(
        [
            [12, 6 * h, -12, 6 * h],
            [6 * h, 4 * h**2, -6 * h, 2 * h**2],
            [-12, -6 * h, 12, -6 * h],
            [6 * h, 2 * h**2, -6 * h, 4 * h**2],
        ]
    )
    return density * h / 420.0 * M, stiffness / h**3 * K


def mesh(lengths: Sequence[float], stiffness: float, density: float) -> Mesh:
    """Cubic elements of these lengths in a row."""
    n = 2 * (len(lengths) + 1)
    M, K = np.zeros((n, n)), np.zeros((n, n))
    for k, length in enumerate(lengths):
        at = slice(2 * k, 2 * k + 4)
        mass, stiff = hermite(length, stiffness, density)
        M[at, at] += mass
        K[at, at] += stiff
    return Mesh(M, K, (0, 1), (n - 2, n - 1))


def superelement(length: float, stiffness: float, density: float) -> Mesh:
    """One quintic element, equations (A.1) and (A.2), in (yP, thP, kP, yQ, thQ, kQ)."""
    h = length
    M = np.array(
        [
            [55440, 27720 * h, 462 * h**2, 27720, -5544 * h, 462 * h**2],
            [27720 * h, 18480 * h**2, 198 * h**3, 19800 * h, -3432 * h**2, 264 * h**3],
            [462 * h**2, 198 * h**3, 6 * h**4, 181 * h**2, -52 * h**3, 5 * h**4],
            [27720, 19800 * h, 181 * h**2, 21720, -3732 * h, 281 * h**2],
            [-5544 * h, -3432 * h**2, -52 * h**3, -3732 * h, 832 * h**2, -69 * h**3],
            [462 * h**2, 264 * h**3, 5 * h**4, 281 * h**2, -69 * h**3, 6 * h**4],
        ]
    )
    K = np.zeros((6, 6))
    K[2:, 2:] = [
        [6 * h**4, -30 * h**2, 8 * h**3, h**4],
        [-30 * h**2, 1200, -600 * h, 30 * h**2],
        [8 * h**3, -600 * h, 384 * h**2, -22 * h**3],
        [h**4, 30 * h**2, -22 * h**3, 6 * h**4],
    ]
    relative = np.eye(6)
    relative[3, :2] = [-1.0, -h]
    relative[4, 1] = -1.0
    M = density * h / 55440.0 * M
    K = stiffness / (70.0 * h**3) * K
    return Mesh(relative.T @ M @ relative, relative.T @ K @ relative, (0, 1), (3, 4))


def joined(meshes: Sequence[Mesh]) -> Mesh:
    """Meshes in a row: the tip of one is the root of the next."""
    first = meshes[0]
    for second in meshes[1:]:
        n = len(first.M)
        places = [
            dict(zip(second.root, first.tip, strict=True)).get(k, n + k) for k in range(len(second.M))
        ]
        kept = sorted({*range(n), *places})
        total = []
        for a, b in ((first.M, second.M), (first.K, second.K)):
            whole = np.zeros((n + len(b), n + len(b)))
            whole[:n, :n] = a
            whole[np.ix_(places, places)] += b
            total.append(whole[np.ix_(kept, kept)])
        tip = tuple(kept.index(places[k]) for k in second.tip)
        first = Mesh(total[0], total[1], first.root, (tip[0], tip[1]))
    return first


def clamped(beam: Mesh) -> Array:
    """Frequencies (rad/s) of a beam whose root is held."""
    free = [k for k in range(len(beam.M)) if k not in beam.root]
    at = np.ix_(free, free)
    return np.asarray(np.sqrt(eigh(beam.K[at], beam.M[at], eigvals_only=True)))


def response(beam: Mesh, omega: float) -> Array:
    """(3, 3): from accelerations of the root (across, angular) and a force at the tip to the
    acceleration of the tip, and the force and torque of the root on the beam."""
    root, n = list(beam.root), len(beam.M)
    free = [k for k in range(n) if k not in root]
    dynamic = beam.K - omega**2 * beam.M
    force = np.zeros((n, 3))
    force[beam.tip[0], 2] = 1.0
    u = np.zeros((n, 3))
    u[root, [0, 1]] = -1.0 / omega**2
    right = force[free] - dynamic[np.ix_(free, root)] @ u[root]
    u[free] = np.linalg.solve(dynamic[np.ix_(free, free)], right)
    held = dynamic[root] @ u - force[root]
    return np.vstack([-(omega**2) * u[beam.tip[0]], held])
