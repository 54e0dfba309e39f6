"""The H-infinity norm of one stable system, by the imaginary eigenvalues of a Hamiltonian matrix.

A level is above all singular values if and only if its Hamiltonian matrix has no eigenvalue on the
imaginary axis (Boyd, Balakrishnan, Kabamba, Mathematics of Control, Signals, and Systems 2, 1989);
midpoints between those that are there give the next level (Bruinsma, Steinbuch, Systems & Control
Letters 14, 1990).
"""

import numpy as np
from numpy.typing import NDArray

from mbdlft.base.array import Array
from mbdlft.response.resolvent import resolvent
from mbdlft.response.staircase import Plant
from mbdlft.system.points import StateMatrices

_EPS = float(np.finfo(float).eps)
_AXIS = 1e-4  # of its size: an eigenvalue as near to the axis may be on it; its frequency is tried
_ROUNDS = 60  # of the level; far more than are needed


def peak_of(plant: Plant, tolerance: float) -> tuple[float, float, float, str]:
    """The norm of a system without poles on or right of the axis.

    Parameters
    ----------
    plant : Plant
    tolerance : float [1]
        Relative distance of the bounds.

    Returns
    -------
    lower, upper : float
        A singular value at the frequency, and a level that none reaches, up to rounding.
    frequency : float (rad/s)
    reason : str
        Why there is no such level; then `upper` is inf.
    """
    at_infinity = float(np.linalg.norm(plant.D, 2)) if plant.D.size else 0.0
    poles = np.linalg.eigvals(plant.A) if len(plant.A) else np.zeros(0, dtype=complex)
    omega = np.unique(np.concatenate([[0.0], np.abs(poles.imag), np.abs(poles)]))
    gains = _gains(plant, omega)
    best = int(np.argmax(gains))
    lower, frequency = float(gains[best]), float(omega[best])
    if at_infinity > lower:
        lower, frequency = at_infinity, np.inf
    if lower == 0.0:
        return 0.0, 0.0, 0.0, ""
    for _ in range(_ROUNDS):
        level = lower * (1.0 + tolerance)
        near = _near_axis(plant, level)
        if not len(near):
            return lower, level, frequency, ""
        ends = np.concatenate([[0.0], near, [2.0 * near[-1]]])
        tried = np.concatenate([0.5 * (ends[1:] + ends[:-1]), near])
        gains = _gains(plant, tried)
        best = int(np.argmax(gains))
        if gains[best] > lower:
            lower, frequency = float(gains[best]), float(tried[best])
        # between two eigenvalues on the axis the gain would be above the level
        if gains[best] < level:
            return lower, level, frequency, ""
    return lower, np.inf, frequency, f"no level without eigenvalues on the axis in {_ROUNDS} rounds"


def _gains(plant: Plant, omega: Array) -> Array:
    """Largest singular values (F,) at frequencies (F,)."""
    values = resolvent(
        StateMatrices(*(matrix[None] for matrix in plant)), (1j * omega[None]).astype(complex)
    )[0]
    sizes: Array = np.linalg.svd(values, compute_uv=False)[..., 0]
    return sizes


def _near_axis(plant: Plant, level: float) -> NDArray[np.float64]:
    """Rising frequencies (rad/s) of eigenvalues of the Hamiltonian matrix that may be on the axis."""
    A, B, C, D = plant
    if not len(A):
        return np.zeros(0)
    R = level**2 * np.eye(D.shape[1]) - np.conj(D.T) @ D
    inside = A + B @ np.linalg.solve(R, np.conj(D.T) @ C)
    right = level * B @ np.linalg.solve(R, np.conj(B.T))
    left = np.conj(C.T) @ (np.eye(len(D)) + D @ np.linalg.solve(R, np.conj(D.T))) @ C / level
    H = np.block([[inside, right], [-left, -np.conj(inside.T)]])
    found = np.linalg.eigvals(H)
    near = np.abs(found.real) <= _AXIS * np.abs(found) + 16.0 * _EPS * float(np.linalg.norm(H))
    return np.unique(np.abs(found[near].imag))
