"""Norms of structures that fly freely, whose nutation is hardly damped: against 60 digits.

And of one mode beside poles on or right of the axis that another channel sees, in any coordinates; and of
free chains that a force between two of their masses moves, or one from outside.
"""

from pathlib import Path

import numpy as np
import scipy.linalg

import mbdlft
from mbdlft import System, state_space
from mbdlft.base.array import Array
from mbdlft.response.modes import samples_at, spectrum
from tests.light import FINITE, free_flyer, peak_of_60_digits
from tests.oscillators import free_chain

MOST = 1e-6  # relative error of a norm, and of responses in time to their largest
OF_CHAINS = 1e-3  # stiff springs beside soft ones: rounding of A changes the damping of slow modes


def attack(seed: int, folder: Path) -> str:
    """Eight channels of one structure: six are finite, two integrate the other torque."""
    if seed % 2:
        return unseen(np.random.default_rng(seed))
    if seed % 4 == 2:
        return moved_within(np.random.default_rng(seed))
    if seed % 8 == 4:
        return drifting(np.random.default_rng(seed))
    system = free_flyer(seed)
    seen = spectrum(samples_at(system).A[0])
    assert np.array_equal(seen.on_axis, seen.at_zero), seen
    for (y, u), is_finite in FINITE.items():
        found = mbdlft.hinf_norm(system, outputs=y, inputs=u)
        assert np.isfinite(found.lower[0]) == is_finite, (y, u, found.reason)
        if is_finite:
            expected = peak_of_60_digits(seed, y, u, seen.poles)
            assert abs(found.lower[0] / expected - 1.0) <= MOST, (y, u, found.lower[0], expected)
    return "right"


def moved_within(random: np.random.Generator) -> str:
    """A free chain: norms and responses in time are those of its stretches alone."""
    model, truth = free_chain(random)
    times = np.linspace(0.0, 75.0 / np.min(np.abs(np.linalg.eigvals(truth.A))), 61)
    for k, name in enumerate(("place.x", "felt.x")):
        found, own = mbdlft.hinf_norm(model, outputs=name), mbdlft.hinf_norm(truth, outputs=f"y{k}")
        assert found.lower[0] <= own.upper[0] * (1.0 + OF_CHAINS), (found, own)
        assert own.lower[0] <= found.upper[0] * (1.0 + OF_CHAINS), (found, own)
    for respond in (mbdlft.step_response, mbdlft.impulse_response):
        moved, expected = (respond(system, {}, times).values[0, :, 0, 0] for system in (model, truth))
        assert np.max(np.abs(moved - expected)) <= MOST * np.max(np.abs(expected)), respond
    return "right, moved within"


def drifting(random: np.random.Generator) -> str:
    """Free chains by places beside their first mass: a force moves each place without end."""
    blocks = []
    for _ in range(int(random.integers(1, 3))):
        n = int(random.integers(2, 6))
        k, masses = 10.0 ** random.uniform(-3, 3, n - 1), 10.0 ** random.uniform(-2, 2, n)
        ends = np.diff(np.eye(n), axis=0)
        places, back = np.eye(n), np.eye(n)
        places[1:, 0], back[1:, 0] = 1.0, -1.0
        K = ends.T @ (k[:, None] * np.delete(np.eye(n), 0, axis=0))  # of x1, x2 - x1, ...
        K[:, 1:] -= ends.T[:, 1:] @ (k[1:, None] * np.eye(n - 1)[:-1])
        slopes = -back @ (K / masses[:, None])
        A = np.block([[np.zeros((n, n)), np.eye(n)], [slopes, 10.0 ** random.uniform(-5, -2) * slopes]])
        force, place = (int(x) for x in random.integers(n, size=2))
        blocks.append((A, back[:, force] / masses[force], places[place]))
    A = scipy.linalg.block_diag(*(each[0] for each in blocks))
    B = np.concatenate([np.append(0.0 * force, force) for _, force, _ in blocks])[:, None]
    C = np.concatenate([np.append(place, 0.0 * place) for _, _, place in blocks])[None]
    found = mbdlft.hinf_norm(state_space(A, B, C, np.zeros((1, 1))))
    assert np.isinf(found.lower[0]), found
    return "right, drifting"


def unseen(random: np.random.Generator) -> str:
    """One mode from u to y in closed form; others, up to three times, from w to z."""
    system, peak = beside_poles(random)
    seen = mbdlft.hinf_norm(system, outputs="y", inputs="u")
    assert abs(seen.lower[0] / peak - 1.0) <= MOST, (seen.lower[0], peak, seen.reason)
    is_stable = np.all(np.linalg.eigvals(samples_at(system).A[0]).real < -1e-9)
    assert is_stable or np.isinf(mbdlft.hinf_norm(system, outputs="z", inputs="w").lower[0])
    return "right, with poles that are not seen"


def beside_poles(random: np.random.Generator) -> tuple[System, float]:
    """The system, and the norm from u to y; all entries are exact in doubles."""
    omega, damping = 2.0 ** random.integers(-3, 6), 2.0 ** -random.integers(1, 23)
    mode = np.array([[0.0, 1.0], [-(omega**2), -2.0 * damping * omega]])
    other = 2.0 ** random.integers(-3, 6)
    pole = (
        np.zeros((1, 1)),
        np.array([[0.5]]),
        np.array([[-16.0]]),
        other * np.array([[0.0, 1.0], [-1, 0]]),
    )
    block = pole[int(random.integers(4))]
    count = int(random.integers(1, 4))
    chain = np.kron(np.eye(count), block) + np.kron(np.eye(count, k=1), np.eye(len(block)))
    n = 2 + len(chain)
    A, B, C = np.zeros((n, n)), np.zeros((n, 2)), np.zeros((2, n))
    A[:2, :2], A[2:, 2:] = mode, chain
    B[1, 0] = B[-1, 1] = C[0, 0] = C[1, 2] = 1.0
    shared = random.integers(-2, 3, (2, len(chain)))
    if random.random() < 0.5:
        A[:2, 2:] = shared
    else:
        A[2:, :2] = shared.T
    A, B, C = in_other_coordinates(random, A, B, C)
    system = state_space(A, B, C, np.zeros((2, 2)), inputs=["u", "w"], outputs=["y", "z"], name="poles")
    return system, 1.0 / (2.0 * damping * omega**2 * np.sqrt(1.0 - damping**2))


def in_other_coordinates(random: np.random.Generator, A: Array, B: Array, C: Array) -> list[Array]:
    """T A T^-1, T B, C T^-1 with a T of whole numbers, whose inverse is one, too: nothing is rounded."""
    for _ in range(4 * len(A)):
        i, j = random.choice(len(A), 2, replace=False)
        factor = float(random.choice([-1, 1]))
        A, B, C = A.copy(), B.copy(), C.copy()
        A[i], B[i] = A[i] + factor * A[j], B[i] + factor * B[j]
        A[:, j], C[:, j] = A[:, j] - factor * A[:, i], C[:, j] - factor * C[:, i]
    return [A, B, C]
