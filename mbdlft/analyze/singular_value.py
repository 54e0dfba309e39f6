"""The structured singular value of a system, frequency by frequency."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mbdlft.analyze.multipliers import squared, structure_of, upper_bound
from mbdlft.analyze.small_delta import small_delta
from mbdlft.base.array import Array
from mbdlft.base.errors import AnalysisError
from mbdlft.base.threads import one_thread
from mbdlft.system.system import System

Complex = NDArray[np.complex128]


@dataclass(frozen=True, slots=True, eq=False)
class StructuredSingularValue:
    """Bounds of mu at frequencies, each with what shows it.

    Attributes
    ----------
    frequencies : array (N,), rad/s
    lower : array (N,)
        1 over the norm of `deltas`; 0 where none was found.
    upper : array (N,)
        Proved at each of the frequencies by its D and G, up to rounding; nothing is said between them.
    deltas : complex array (N, n_w, n_z)
        Makes I - M Delta singular, where `lower` is not 0.
    D, G : complex arrays (N, n, n)
        Multipliers, full for repeated blocks; non-square blocks are filled up with zeros.
    """

    frequencies: Array
    lower: Array
    upper: Array
    deltas: Complex
    D: Complex
    G: Complex


def structured_singular_value(system: System, frequencies: ArrayLike) -> StructuredSingularValue:
    """mu(M(j omega)) = 1/min{||Delta|| : det(I - M Delta) = 0}, M from w to z, at frequencies.

    Parameters
    ----------
    system : System or LFTModel
        Delta may have real and complex repeated blocks and full complex ones, mixed.
    frequencies : array (N,), rad/s; infinity is allowed

    Returns
    -------
    StructuredSingularValue
        For a guarantee between the frequencies use `robust_stability`.

    Raises
    ------
    AnalysisError
        Delta is empty, a frequency is no number, or a pole lies on it.
    """
    omega = np.atleast_1d(np.asarray(frequencies))
    if omega.dtype.kind not in "iuf" or omega.ndim != 1 or np.any(np.isnan(omega)):
        raise AnalysisError(
            f"model {system.name!r}: frequencies: expected numbers (rad/s), got {frequencies!r}."
        )
    if not system.order:
        raise AnalysisError(
            f"structured_singular_value: model {system.name!r} has no parameter and no uncertain block."
        )
    structure, blocks = structure_of(system.lft.blocks), system.lft.blocks
    found, last = [], None
    with one_thread():
        for w in omega:
            M = channels_at(system, float(w))
            last = upper_bound(squared(M, structure), structure, start=last)
            found.append((last, small_delta(M, blocks, last.beta)))
    return StructuredSingularValue(
        omega.astype(float),
        np.array([min(low.bound, high.beta) for high, low in found]),
        np.array([high.beta for high, _ in found]),
        np.array([low.delta for _, low in found]),
        np.array([high.D for high, _ in found]),
        np.array([high.G for high, _ in found]),
    )


def channels_at(system: System, omega: float) -> Complex:
    """M(j omega) (n_z, n_w), from w to z.

    Raises
    ------
    AnalysisError
        j omega is a pole.
    """
    M = system.D_zw.astype(complex)
    if not np.isfinite(omega) or not len(system.A):
        return M
    try:
        return M + system.C_z @ np.linalg.solve(
            1j * omega * np.eye(len(system.A)) - system.A, system.B_w
        )
    except np.linalg.LinAlgError:
        raise AnalysisError(
            f"model {system.name!r}: omega = {omega:g} rad/s is a pole, where M is infinite. Leave this "
            "frequency out, or close a loop around the mode."
        ) from None
