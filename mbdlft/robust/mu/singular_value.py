"""Bounds of the structured singular value of a system: at frequencies, and on bands of frequency.

On a band, the multipliers of one of its frequencies prove the bound (`mbdlft.robust.mu.intervals`).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbdlft.base.arguments import arguments_checked
from mbdlft.base.array import Array, ArrayLike
from mbdlft.base.errors import AnalysisError
from mbdlft.base.running import one_thread
from mbdlft.lft.block import Block
from mbdlft.robust.evidence import Multipliers
from mbdlft.robust.mu import coverage
from mbdlft.robust.mu.intervals import channels_matrix, interval_around
from mbdlft.robust.mu.multipliers import squared, structure_of, upper_bound
from mbdlft.robust.mu.small_delta import SmallDelta, small_delta
from mbdlft.robust.realization import check_constant, check_parameters, left_out, stable_states
from mbdlft.system.model import System

_NOTHING = 1e-6  # of the norm: less is nothing
_TOLERANCE = 1e-7  # of a skew bound
Complex = NDArray[np.complex128]
_MOST = 600  # bands
_LEAST = 0.01  # of the largest bound: bounds below this are not told apart
_NARROW = 0.05  # of a frequency: a band below this is tried again with a larger bound
_AGAIN = 5  # bounds that are tried for a narrow band, the last of them 31 gaps larger
_WIDE = 1.0 / 8.0  # of the logarithm of high/low: no band is wider


@dataclass(frozen=True, slots=True, eq=False)
class StructuredSingularValue:
    """Bounds of mu at frequencies, each with what shows it.

    Attributes
    ----------
    frequencies : array (N,), rad/s
    lower : array (N,)
        1 over the norm of `deltas`, of those blocks that are not fixed; 0 where none was found.
    upper : array (N,)
        Proved at each of the frequencies by its D and G, up to rounding; nothing is said between them.
        inf: fixed blocks alone may make I - M Delta singular.
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


@arguments_checked
def structured_singular_value(
    system: System, frequencies: ArrayLike, *, fixed: Sequence[str] = ()
) -> StructuredSingularValue:
    """mu(M(j omega)) = 1/min{||Delta|| : det(I - M Delta) = 0}, M from w to z, at frequencies.

    Parameters
    ----------
    system : System or LFTModel
        Delta may have real and complex repeated blocks and full complex ones, mixed.
    frequencies : array (N,), rad/s; infinity is allowed
    fixed : sequence of str
        Blocks whose norm stays below 1: the smallest norm of the others is looked for (skew mu). With a
        full block between inputs and outputs, the only one that is not fixed, mu is the worst-case gain.

    Returns
    -------
    StructuredSingularValue
        For a guarantee between the frequencies use `robust_stability`.
    """
    omega = np.atleast_1d(np.asarray(frequencies))
    if omega.dtype.kind not in "iuf" or omega.ndim != 1 or np.any(np.isnan(omega)):
        raise AnalysisError(
            f"model {system.name!r}: frequencies: expected numbers (rad/s), got {frequencies!r}."
        )
    check_parameters(system, "structured_singular_value")
    kept, blocks = coverage.check_fixed(system, fixed), system.lft.blocks
    grows = np.array([block.name not in kept for block in blocks], dtype=bool)
    if not np.any(grows):
        raise AnalysisError(
            f"structured_singular_value: model {system.name!r}: expected a block that is not fixed."
        )
    structure, all_grow = structure_of(blocks), bool(np.all(grows))
    bounds: list[tuple[Multipliers, SmallDelta]] = []
    with one_thread():
        for w in omega:
            M = channels_at(system, float(w))
            if all_grow:
                starts = [high for high, _ in bounds[-1:]]
                last = upper_bound(squared(M, structure), structure, starts=starts)
            else:
                last = _skew_bound(M, blocks, grows)
            bounds.append((last, small_delta(M, blocks, last.beta, grows)))
    return StructuredSingularValue(
        omega.astype(float),
        np.array([min(low.bound, high.beta) for high, low in bounds]),
        np.array([high.beta for high, _ in bounds]),
        np.array([low.delta for _, low in bounds]),
        np.array([high.D for high, _ in bounds]),
        np.array([high.G for high, _ in bounds]),
    )


def _skew_bound(M: Complex, blocks: Sequence[Block], grows: NDArray[np.bool_]) -> Multipliers:
    """Multipliers for which M'k D M + j(GM - M'G) - D < 0, k = 1 of fixed blocks, 1/beta^2 of others."""
    loop = coverage.loop_of_matrix(M, blocks, grows)
    size = float(np.linalg.norm(M, 2))
    whole = squared(M, loop.structure)
    if size == 0.0:
        return Multipliers(0.0, np.eye(len(whole), dtype=complex), 0.0 * whole)
    of_growing = loop.grows[loop.owner]
    least = _NOTHING * max(
        float(np.linalg.norm(whole[np.ix_(of_growing, of_growing)], 2)), _NOTHING * size
    )
    k, multipliers = coverage.largest_size(loop, whole, 1.0 / least, None, _TOLERANCE)
    half = coverage.ends_of(loop, k)[1][loop.owner]
    return multipliers._replace(beta=1.0 / k if k else np.inf, G=multipliers.G * half[:, None] ** 2)


def channels_at(system: System, omega: float) -> Complex:
    """M(j omega) (n_z, n_w), from w to z; an error if j omega is a pole."""
    M = system.D_zw.astype(complex)
    if not np.isfinite(omega) or not len(system.A):
        return M
    try:
        return M + system.C_z @ np.linalg.solve(1j * omega * np.eye(len(system.A)) - system.A, system.B_w)
    except np.linalg.LinAlgError:
        raise AnalysisError(
            f"model {system.name!r}: omega = {omega:g} rad/s is a pole, where M is infinite. Leave this "
            "frequency out, or close a loop around the mode."
        ) from None


class MuBands(NamedTuple):
    """Bands side by side, and mu in them.

    Attributes
    ----------
    edges : array (N + 1,), rad/s
    upper : array (N,)
        Proved for all frequencies of the band; inf where nothing was proved.
    at, lower : array (N,)
        A frequency in the band, and the lower bound that was found there; 0 if Delta has parameters only,
        for which `robust_stability` finds better ones.
    """

    edges: Array
    upper: Array
    at: Array
    lower: Array


@arguments_checked
def mu_bands(
    system: System, low: float, high: float, *, gap: float = 0.05, leave_out: Sequence[str] = ()
) -> MuBands:
    """Bounds of the structured singular value for all frequencies between two.

    Parameters
    ----------
    system : System or LFTModel
        Nominally stable. Delta may have blocks of all kinds.
    low, high : float, rad/s
    gap : float
        The part by which a bound may be above the best of its multipliers at one frequency.
    leave_out : sequence of str
        States on which nothing else depends; ``"cyclic"`` for all integrators of this kind.
    """
    if not 0.0 < low < high < np.inf:
        raise AnalysisError(f"mu_bands: expected 0 < low < high (rad/s), got {low!r} and {high!r}.")
    check_parameters(system, "mu_bands")
    check_constant(system, "mu_bands")
    stay = stable_states(system, left_out(system, leave_out), "mu_bands")
    loop, blocks = coverage.loop_of(system, stay), system.lft.blocks
    channels, structure = loop.channels, loop.structure
    first = coverage.first_frequencies(channels.A)
    with one_thread():
        known = [
            upper_bound(channels_matrix(channels, w), structure, tolerance=0.1 * gap).beta
            for w in coverage.looks(first)
        ]
        floor, widest = _LEAST * max(known), float(np.log(high / low)) * _WIDE
        cut = [low, *np.exp(np.arange(np.log(low) + widest, np.log(high), widest))]
        todo = list(zip(cut, [*cut[1:], high], strict=True))[::-1]
        bands: list[tuple[float, float, float, float, float]] = []
        starts: tuple[Multipliers, ...] = ()
        while todo and len(bands) < _MOST:
            a, b = (float(end) for end in todo.pop())
            omega = coverage.middle(a, b, first)
            M = channels_matrix(channels, omega)
            last = upper_bound(M, structure, starts=starts, tolerance=0.1 * gap)
            beta, band = max(last.beta, floor), None
            for again in range(_AGAIN):
                beta *= 1.0 + gap * 2.0**again
                last = upper_bound(M, structure, starts=(last,), enough=beta)._replace(beta=beta)
                band = interval_around(channels, last, omega)
                if band is not None and band.high - band.low > _NARROW * omega:
                    break
            starts = (last,)
            lower = 0.0
            if not system.lft.is_plain:
                lower = small_delta(channels_at(system, omega), blocks, beta).bound
            if band is None or not band.high > band.low:
                bands.append((a, b, np.inf, omega, lower))
                continue
            start, stop = max(a, band.low), min(b, band.high)
            bands.append((start, stop, beta, omega, lower))
            todo += [(p, q) for p, q in ((stop, b), (a, start)) if q > p]
    bands += [(float(a), float(b), np.inf, float(np.sqrt(a * b)), 0.0) for a, b in todo]
    rows = np.array(sorted(bands)).T
    return MuBands(np.append(rows[0], rows[1, -1]), rows[2], rows[3], rows[4])
