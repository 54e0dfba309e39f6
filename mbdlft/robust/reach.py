"""The smallest deltas that make a loop singular at some frequency: what bounds a margin from above."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from mbdlft.base.array import Array
from mbdlft.robust.intervals import channels_matrix
from mbdlft.robust.loop import Loop
from mbdlft.robust.migration import by_damping
from mbdlft.robust.small_delta import SmallDelta, block_changes, delta_near, small_delta

_CORNERS = 4
_MOST = 24  # frequencies of poles
Complex = NDArray[np.complex128]


def nothing(loop: Loop) -> SmallDelta:
    """No delta."""
    shape = len(loop.structure.outputs), len(loop.structure.inputs)
    return SmallDelta(0.0, np.zeros(shape, dtype=complex), 1.0)


def matrix_and_slope(loop: Loop, omega: float) -> tuple[Complex, Complex]:
    """M(j omega) (n_z, n_w) without the zeros that make blocks square, and its slope by log omega."""
    A, B, C, _ = loop.channels
    place = np.ix_(loop.structure.inputs, loop.structure.outputs)
    M, _ = channels_matrix(loop.channels, omega)
    if not len(A) or not 0.0 < omega < np.inf:
        return M[place], np.zeros_like(M[place])
    shifted = 1j * omega * np.eye(len(A)) - A
    slope = -1j * omega * (C @ np.linalg.solve(shifted, np.linalg.solve(shifted, B)))
    return M[place], slope[place]


def best_near(
    loop: Loop, best: SmallDelta, omega: float, real: Array | None = None, starts: int = 1
) -> SmallDelta:
    """The better of what was known and of what is found near a frequency, and near real deltas."""

    def at(w: float) -> tuple[Complex, Complex]:
        return matrix_and_slope(loop, w)

    if 0.0 < omega < np.inf:
        found = delta_near(at, loop.blocks, loop.grows, omega, real, starts)
    else:
        found = small_delta(at(omega)[0], loop.blocks, np.inf, loop.grows)._replace(omega=omega)
    return found if found.bound > best.bound else best


def first_reached(loop: Loop) -> SmallDelta:
    """The smallest delta that is found from frequencies of the poles, and from corners."""
    best = nothing(loop)
    for omega in _places(loop.channels.A):
        best = best_near(loop, best, omega)
    if not best.bound:
        return best
    best = best_near(loop, best, best.omega, starts=3)
    count = sum(block.kind == "real" for block in loop.blocks)
    random = np.random.default_rng(0)
    for corner in np.sign(random.uniform(-1.0, 1.0, (_CORNERS if count else 0, count))):
        best = best_near(loop, best, best.omega, corner)
    return best


def _places(A: Array) -> list[float]:
    poles = np.linalg.eigvals(A) if len(A) else np.ones(1)
    return [float(w) for w in np.unique([*np.abs(poles[by_damping(poles)][:_MOST]), 0.0, np.inf])]


def by_name(loop: Loop, delta: Complex) -> dict[str, Any]:
    """Numbers and matrices of the blocks of a Delta (n_w, n_z)."""
    found: dict[str, Any] = {}
    z = w = 0
    for block in loop.blocks:
        part = delta[w : w + block.outputs, z : z + block.inputs]
        z, w = z + block.inputs, w + block.outputs
        if block.kind == "real":
            found[block.name] = float(part[0, 0].real)
        else:
            found[block.name] = complex(part[0, 0]) if block.kind == "complex" else part.copy()
    return found


def changes(loop: Loop, found: SmallDelta) -> Array:
    """How much the bound changes, to first order, as blocks grow by the same part (number of blocks,)."""
    M = matrix_and_slope(loop, found.omega)[0]
    return block_changes(M, loop.blocks, loop.grows, found)
