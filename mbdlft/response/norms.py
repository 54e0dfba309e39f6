"""H2 and H-infinity norms at samples of the parameters, with checks, or why they are infinite.

H2: tr(C P C') with A P + P A' + B B' = 0. H-infinity: a level gamma is above all singular values of
G(j omega) if and only if its Hamiltonian matrix

    H = [A + B R^-1 D'C, gamma B R^-1 B'; -C'(I + D R^-1 D')C/gamma, -(A + B R^-1 D'C)'],
    R = gamma^2 I - D'D,

has no eigenvalue on the imaginary axis (Boyd, Balakrishnan, Kabamba, Mathematics of Control, Signals, and
Systems 2, 1989). At midpoints between those on the axis the gain is larger: the next level (Bruinsma,
Steinbuch, Systems & Control Letters 14, 1990).
"""

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass

import flint
import numpy as np
from numpy.typing import NDArray

from mbdlft.base.arguments import arguments_checked
from mbdlft.base.array import Array, ArrayLike
from mbdlft.base.errors import AnalysisError
from mbdlft.exact.matrices import middles_of
from mbdlft.exact.rounding import EPS, eigenvalues_of
from mbdlft.response.frequency import resolvent
from mbdlft.response.modes import Names, Spectrum, balancing, pole_text, spectrum
from mbdlft.response.momenta import parts_at
from mbdlft.response.staircase import Plant, connected, exactly_seen, scaled, seen, without_one
from mbdlft.system.model import System
from mbdlft.system.sampled import StateMatrices

_APART = 1e-3  # of the norm: Gramians from both sides that differ by more are wrong
_AXIS = 1e-4  # of its size: an eigenvalue as near to the axis may be on it; its frequency is tried
# of the slowest pole, and of the fastest, from where on a system is compared with a smaller one; of its
# response, and of the terms of that, by which they may differ: smaller parts are rounding
_BELOW, _SLOWEST, _PLACES, _SAME, _OF_TERMS = 1e-2, 1e-9, 6, 1e-6, 1e-12
_BITS = 128  # of balls in which gains beside a lightly damped pole are computed
_ROUNDS = 60  # of the level; far more than are needed


@dataclass(frozen=True, slots=True, eq=False)
class PeakGain:
    """H-infinity norms of N samples, the largest singular value of G(j omega) over all frequencies.

    Attributes
    ----------
    lower : array (N,), in the unit of the gain: a singular value at `frequency`
    upper : array (N,): a level that no singular value reaches, as no eigenvalue of the Hamiltonian
        matrix is on the axis; checked, not proved: it holds up to rounding
    frequency : array (N,), rad/s; inf if the gain is largest at infinity
    reason : tuple of N texts, empty where the norm is finite
        Which pole makes it infinite.
    """

    lower: Array
    upper: Array
    frequency: Array
    reason: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class H2Norm:
    """H2 norms of N samples: the root of the integral of the squared impulse responses.

    Attributes
    ----------
    value : array (N,), in the unit of the gain times (rad/s)^(1/2)
    error : array (N,) [1]
        Relative difference of the norm by states (C P C') and by costates (B' Q B), which are equal.
    reason : tuple of N texts, empty where the norm is finite
    """

    value: Array
    error: Array
    reason: tuple[str, ...]


@arguments_checked
def hinf_norm(
    system: System,
    values: Mapping[str, ArrayLike] | None = None,
    *,
    outputs: Names = None,
    inputs: Names = None,
    tolerance: float = 1e-6,
) -> PeakGain:
    """H-infinity norm at samples of the parameters, between two bounds.

    gamma is above all singular values if and only if the Hamiltonian matrix of gamma has no eigenvalue on
    the imaginary axis (Boyd, Balakrishnan, Kabamba 1989); midpoints between those that are there give the
    next gamma (Bruinsma, Steinbuch 1990).

    Parameters
    ----------
    system : System or LFTModel
    values : mapping of names to physical values, numbers or arrays (N,); the others are nominal
    outputs, inputs : names of channels; all by default
    tolerance : float [1], from 1e-10 to 1
        Relative distance of the bounds, unless rounding needs more.

    Returns
    -------
    PeakGain
        Infinite with a pole on or right of the axis that the inputs reach and the outputs see.
    """
    if not 1e-10 <= tolerance < 1.0:
        raise AnalysisError(
            f"model {system.name!r}: hinf_norm: expected a tolerance from 1e-10 to 1, got {tolerance!r}."
        )
    matrices, _ = parts_at(system, values, outputs, inputs, "gains")
    peaks = [_peak(Plant(*each), tolerance) for each in zip(*matrices, strict=True)]
    lower, upper, frequency, reason = zip(*peaks, strict=True)
    return PeakGain(np.array(lower), np.array(upper), np.array(frequency), tuple(reason))


@arguments_checked
def h2_norm(
    system: System,
    values: Mapping[str, ArrayLike] | None = None,
    *,
    outputs: Names = None,
    inputs: Names = None,
) -> H2Norm:
    """H2 norm at samples of the parameters: the root of tr(C P C'), with A P + P A' + B B' = 0.

    Parameters
    ----------
    system, values, outputs, inputs
        As of `hinf_norm`.

    Returns
    -------
    H2Norm
        Infinite with a direct path D, or with a pole on or right of the axis that the inputs reach and
        the outputs see.

    Raises
    ------
    AnalysisError
        The two ways to compute it differ by a thousandth.
    """
    norms = []
    for each in zip(*parts_at(system, values, outputs, inputs, "norms")[0], strict=True):
        value, error, reason = _h2(Plant(*each))
        if error > _APART:
            raise AnalysisError(
                f"model {system.name!r}: h2_norm: two ways to compute it differ by {error:.1e} of it: a "
                "pole is too near to the imaginary axis for double precision. Add damping."
            )
        norms.append((value, error, reason))
    values_found, errors, reasons = zip(*norms, strict=True)
    return H2Norm(np.array(values_found), np.array(errors), tuple(reasons))


def _seen_if_needed(plant: Plant) -> tuple[Plant, str]:
    """A system without poles on or right of the axis, or why there is none.

    Poles that the channels do not see leave it: those of states that no entries lead to, those that
    exact numbers show of few states, and simple ones whose vectors, in balls, do not tell the direction
    in from zero, or the one out. Of others the staircase decides at the rounding of the scaled matrices,
    if its response is the same: what it leaves out may be seen by entries of very different size.
    """
    whole = connected(plant)
    of_whole = spectrum(whole.A)
    if of_whole.stability == "stable":
        return whole, ""
    smaller, poles = _without_unseen(exactly_seen(whole))
    if poles.stability == "stable":
        if _is_same(smaller, whole):
            return smaller, ""
        smaller, poles = whole, of_whole
    how = "right of the imaginary axis" if poles.stability == "unstable" else "on the imaginary axis"
    return smaller, f"the pole {pole_text(poles.worst)} is {how}"


def _without_unseen(plant: Plant) -> tuple[Plant, Spectrum]:
    """A system without the poles on or right of the axis that it does not see, as far as doubles tell.

    And the poles that it has.
    """
    while (poles := spectrum(plant.A)).stability != "stable":
        unstable = poles.poles[poles.on_axis | (poles.poles.real > 0.0)]
        smaller = without_one(plant, unstable) or _least(plant)
        if len(smaller.A) == len(plant.A):
            break
        plant = connected(smaller)
    return plant, poles


def _is_same(smaller: Plant, whole: Plant) -> bool:
    """Whether responses at real s, at and below the poles of the smaller one, differ by rounding only."""
    largest = float(np.max(np.abs(eigenvalues_of(whole.A)), initial=0.0)) or 1.0
    least = float(np.min(np.abs(eigenvalues_of(smaller.A)), initial=largest)) if len(smaller.A) else 0.0
    for s in np.geomspace(max(_BELOW * least, _SLOWEST * largest), 1.25 * largest, _PLACES):
        (here, _), (there, terms) = (_response_at(plant, s) for plant in (smaller, whole))
        if np.any(np.abs(here - there) > _SAME * np.abs(there) + _OF_TERMS * terms):
            return False
    return True


def _response_at(plant: Plant, s: float) -> tuple[Array, Array]:
    """C (s I - A)^-1 B + D, and the sizes of its terms."""
    states = np.linalg.inv(s * np.eye(len(plant.A)) - plant.A)
    sizes = np.abs(plant.C) @ np.abs(states) @ np.abs(plant.B) + np.abs(plant.D)
    return plant.C @ states @ plant.B + plant.D, sizes


def _least(plant: Plant) -> Plant:
    """The part that the channels see, with channels as they were."""
    balanced, rows, columns = scaled(plant)
    minimal = seen(balanced)
    return Plant(minimal.A, minimal.B / columns, minimal.C / rows, plant.D)


def _peak(plant: Plant, tolerance: float) -> tuple[float, float, float, str]:
    """Lower and upper bound of a norm, the frequency, and why it is infinite."""
    stable, reason = _seen_if_needed(plant)
    if reason:
        return np.inf, np.inf, abs(spectrum(stable.A).worst.imag), reason
    lower, upper, frequency, reason = peak_of(stable, tolerance)
    poles = eigenvalues_of(stable.A)
    rounded = EPS * len(poles) * float(np.linalg.norm(stable.A))  # what a pole may be off by
    if 0.0 < frequency < np.inf and np.any(rounded > tolerance * np.abs(poles.real)):
        with suppress(ZeroDivisionError):  # at a pole on the axis that is not seen
            lower = _gain_in_balls(connected(plant), frequency)
        upper = max(upper, lower * (1.0 + tolerance))
    return lower, upper, frequency, reason


def _gain_in_balls(plant: Plant, omega: float) -> float:
    """The largest singular value beside a pole, where doubles lose the digits of its damping."""
    n = len(plant.A)
    with flint.ctx.workprec(_BITS):
        A, B, C = (flint.acb_mat(matrix.astype(complex).tolist()) for matrix in plant[:3])
        s = flint.acb_mat((1j * omega * np.eye(n)).tolist())
        G = C * (s - A).solve(B)
        values = middles_of(G)
    return float(np.linalg.norm(values + plant.D, 2))


def _h2(plant: Plant) -> tuple[float, float, str]:
    """A norm, the relative difference of two ways to it, and why it is infinite."""
    if np.any(plant.D):
        return np.inf, 0.0, "the direct path D is not zero"
    plant, reason = _seen_if_needed(plant)
    if reason:
        return np.inf, 0.0, reason
    _, B, C, _ = plant
    if not len(B):
        return 0.0, 0.0, ""
    P, Q = gramians(plant)
    Bh, Ch = np.conj(B.T), np.conj(C.T)
    by_states, by_costates = (float(np.trace(product).real) for product in (C @ P @ Ch, Bh @ Q @ B))
    mean = 0.5 * (by_states + by_costates)
    if mean <= 0.0:
        return 0.0, 0.0 if by_states == by_costates == 0.0 else np.inf, ""
    return float(np.sqrt(mean)), abs(by_states - by_costates) / (2.0 * mean), ""


def gramians(plant: Plant) -> tuple[Array, Array]:
    """P and Q (n, n) with A P + P A' + B B' = 0 and A'Q + Q A + C'C = 0, of a stable system.

    States have the scales that balance A: LAPACK takes others, as those of a stiff mode, for singular.
    """
    import scipy.linalg  # here because it is slow to import

    scale = balancing(plant.A)
    A, B, C = plant.A * scale / scale[:, None], plant.B / scale[:, None], plant.C * scale
    P = scipy.linalg.solve_continuous_lyapunov(A, -B @ np.conj(B.T))
    Q = scipy.linalg.solve_continuous_lyapunov(np.conj(A.T), -np.conj(C.T) @ C)
    return scale[:, None] * P * scale, Q / scale[:, None] / scale


def peak_of(plant: Plant, tolerance: float) -> tuple[float, float, float, str]:
    """The norm of a system without poles on or right of the axis, to a relative tolerance.

    Returned are a singular value; a level that none reaches, up to rounding; the frequency (rad/s) of
    the first; and, if there is no such level, and it is inf, why.
    """
    at_infinity = float(np.linalg.norm(plant.D, 2)) if plant.D.size else 0.0
    poles = eigenvalues_of(plant.A)
    # a complex system has other gains at negative frequencies
    sides = np.array([[1.0], [-1.0]])[: 1 + any(map(np.iscomplexobj, plant))]
    omega = np.unique(sides * np.concatenate([[0.0], np.abs(poles.imag), np.abs(poles)]))
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
        tried = (sides * np.concatenate([0.5 * (ends[1:] + ends[:-1]), near])).ravel()
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
    upper = level * B @ np.linalg.solve(R, np.conj(B.T))
    lower = np.conj(C.T) @ (np.eye(len(D)) + D @ np.linalg.solve(R, np.conj(D.T))) @ C / level
    H = np.block([[inside, upper], [-lower, -np.conj(inside.T)]])
    eigenvalues = eigenvalues_of(H)
    rounding = 16.0 * EPS * float(np.linalg.norm(H))
    near = np.abs(eigenvalues.real) <= _AXIS * np.abs(eigenvalues) + rounding
    return np.unique(np.abs(eigenvalues[near].imag))
