"""The H2 norm at some deltas, and its slope.

With A P + P A' + B B' = 0 and A'Q + Q A + C'C = 0, h^2 = tr C P C', and to first order

    d h^2 = 2 tr(Q dA P) + 2 tr(Q dB B') + 2 tr(dC P C').
"""

from collections.abc import Callable

import numpy as np

from mbdlft.analyze.characteristic import Realization
from mbdlft.analyze.peak import at_delta
from mbdlft.base.array import Array


def h2_and_slope(model: Realization, delta: Array) -> tuple[float, Callable[[], Array]]:
    """The H2 norm, infinite with a direct path or without stability, and its slope by the deltas."""
    import scipy.linalg  # here because it is slow to import

    plant = at_delta(model, delta)
    none = np.zeros(len(delta))
    if plant is None or np.any(plant.D):
        return np.inf, lambda: none
    A, B, C, _ = plant
    if not len(A):
        return 0.0, lambda: none
    if not np.max(np.linalg.eigvals(A).real) < 0.0:
        return np.inf, lambda: none
    P = scipy.linalg.solve_continuous_lyapunov(A, -B @ B.T)
    Q = scipy.linalg.solve_continuous_lyapunov(A.T, -C.T @ C)
    value = float(np.sqrt(max(np.trace(C @ P @ C.T), 0.0)))

    def slope() -> Array:
        left, right = model.out_of(delta), model.into(delta)
        by_entry = np.block([[Q @ P, Q @ B], [C @ P, np.zeros((len(C), B.shape[1]))]])
        parts = np.einsum("ik,ij,kj->k", left, by_entry, right)
        return np.asarray(model.by_parameter(parts) / max(value, 1e-300))

    return value, slope
