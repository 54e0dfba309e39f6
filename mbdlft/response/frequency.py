"""Frequency responses of many samples at once, and the frequencies at which they are worth computing:
evenly spaced ones, and more around each pole.
"""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from mbdlft.base.array import Array, ArrayLike
from mbdlft.base.errors import AnalysisError
from mbdlft.response.resolvent import resolvent
from mbdlft.response.samples import Names, samples_at, transfers_at
from mbdlft.response.spectrum import eigenvalues, spectrum, without_integrators
from mbdlft.system.model import System
from mbdlft.system.points import StateMatrices

POINTS = 200  # evenly spaced in the logarithm
_DECADE = 10.0  # beyond the slowest and the fastest pole
_NEAREST = 1e-4  # of its frequency: no response is computed nearer to a pole without damping
_UNDAMPED = 1e-7  # damping below this is none
# distances from the frequency of a pole, in half widths of its peak: a peak lies at most an eighth of
# one from the nearest, and is 0.07 dB higher at most
_CENTER = np.array([0.0, 0.25, 0.5, 0.75, 1.0])
_BEYOND = 6  # more to either side, farther and farther apart, until the evenly spaced are as near
_INFINITE = 3.0  # a response that grows by more than this when a hundred times nearer is unbounded


def frequency_response(
    model: System, values: Mapping[str, ArrayLike], omega: ArrayLike
) -> NDArray[np.complex128]:
    """G(j omega) = C (j omega I - A)^-1 B + D at samples of the parameters.

    Parameters
    ----------
    model : System or LFTModel
    values : mapping of names to physical values, numbers or arrays (N,); the others are nominal
    omega : array (F,), or (N, F) with a row for each sample; rad/s

    Returns
    -------
    complex array (N, F, ny, nu)
        Unit of entry (i, j): unit of output i over unit of input j. N = 1 for numbers.

    Raises
    ------
    AnalysisError
        j omega is an eigenvalue of A at one of the samples (at most but for the last digits), or `omega`
        has what is not a finite number, or another number of rows.
    """
    frequencies = np.asarray(omega)
    if frequencies.dtype.kind not in "iuf" or not np.all(np.isfinite(frequencies)):
        raise AnalysisError(
            f"model {model.name!r}: omega: expected finite frequencies (rad/s), got {omega!r}."
        )
    matrices = samples_at(model, values)
    count = len(matrices.A)
    frequencies = np.atleast_1d(frequencies)
    if frequencies.ndim > 2 or (frequencies.ndim == 2 and len(frequencies) not in (1, count)):
        raise AnalysisError(
            f"model {model.name!r}: omega: expected frequencies (F,), or a row (N, F) for each of "
            f"{count} samples, got shape {frequencies.shape}."
        )
    rows = np.broadcast_to(frequencies, (count, frequencies.shape[-1]))
    response = resolvent(matrices, 1j * rows)
    poles = ~np.isfinite(response).all(axis=(2, 3))
    if np.any(poles):
        raise AnalysisError(
            f"model {model.name!r}: omega = {rows[poles][0]:g} rad/s is a pole at one of the samples, "
            "where the response is infinite. Leave this frequency out or add damping."
        )
    return response


def singular_values(response: NDArray[np.complex128]) -> Array:
    """Singular values (..., min(ny, nu)) of a `response` (..., ny, nu), largest first; its unit."""
    return np.asarray(np.linalg.svd(response, compute_uv=False), dtype=float)


def gain_unit(system: System) -> str:
    """Unit of the gain, or ``mixed units`` if the outputs or the inputs have several units."""
    pairs = {(y.unit, u.unit) for y in system.outputs for u in system.inputs}
    if len(pairs) != 1:
        return "mixed units"
    over, under = (f"({unit})" if " " in unit or "/" in unit else unit for unit in pairs.pop())
    return f"{over}/{under}"


def peaks(values: Array) -> Array:
    """Rows (N, F) with -inf where no peak is; all of them stay if there is none, as of integrators."""
    higher = (values[:, 1:-1] >= values[:, :-2]) & (values[:, 1:-1] >= values[:, 2:])
    found = np.full(values.shape, -np.inf)
    found[:, 1:-1] = np.where(higher, values[:, 1:-1], -np.inf)
    return found if np.any(np.isfinite(found)) else values


def response_frequencies(
    system: System,
    values: Mapping[str, ArrayLike] | None = None,
    low: float | None = None,
    high: float | None = None,
    points: int = POINTS,
) -> Array:
    """Frequencies for each sample: evenly spaced ones, and those around its own poles.

    Peaks of lightly damped modes are right to 0.1 dB at them. To a pole whose damping is below 1e-7 there
    is none nearer than a ten-thousandth of its frequency.

    Parameters
    ----------
    system : System or LFTModel
    values : mapping of names to physical values, numbers or arrays (N,); the others are nominal
    low, high : float, rad/s
        By default a decade below the slowest and above the fastest pole of all samples; poles at zero
        are left out.
    points : int
        Number of evenly spaced ones, on a logarithmic axis.

    Returns
    -------
    array (N, F), rad/s
        Rows rise, and some numbers stand twice where a pole has none to add; for `frequency_response`.

    Raises
    ------
    AnalysisError
        `low` and `high` are not positive, finite and rising, or `points` is less than 2.
    StructureError, WellPosednessError
        As `matrices_at`.
    """
    A = samples_at(system, values).A
    found = eigenvalues(A, system.name)
    first, last = frequency_range(system, found, low, high)
    if not isinstance(points, int | np.integer) or points < 2:
        raise AnalysisError(
            f"model {system.name!r}: expected at least 2 points of frequency, got {points!r}."
        )
    even = np.geomspace(first, last, int(points))
    if np.isrealobj(A):  # one of each pair is enough
        found = np.where(found.imag > 0.0, found, 0.0)
    pairs = int(np.max(np.sum(found != 0.0, axis=1), initial=0))
    found = np.take_along_axis(found, np.argsort(found == 0.0, axis=1, kind="stable"), axis=1)
    return np.stack([_around(even, row) for row in found[:, :pairs]])


def frequency_range(
    system: System, poles: NDArray[np.complex128], low: float | None, high: float | None
) -> tuple[float, float]:
    """Lowest and highest frequency, rad/s; those that are not given by the poles (N, nx)."""
    sizes = np.abs(without_integrators(system, poles))
    first = float(np.min(sizes)) / _DECADE if low is None and len(sizes) else low
    last = float(np.max(sizes)) * _DECADE if high is None and len(sizes) else high
    if first is None:
        first = 0.1 if last is None else last / _DECADE**2
    if last is None:
        last = first * _DECADE**2
    for label, value in (("low", first), ("high", last)):
        if isinstance(value, bool) or not np.isreal(value) or not 0.0 < value < np.inf:
            raise AnalysisError(
                f"model {system.name!r}: frequencies: expected a positive finite {label} end (rad/s), "
                f"got {value!r}."
            )
    if not first < last:
        raise AnalysisError(
            f"model {system.name!r}: frequencies: expected low < high, got {first:g} and {last:g} rad/s."
        )
    return float(first), float(last)


def unbounded_frequencies(
    system: System,
    values: Mapping[str, ArrayLike] | None = None,
    *,
    outputs: Names = None,
    inputs: Names = None,
) -> tuple[Array, ...]:
    """Frequencies at which a response is infinite: those of poles on the axis that the channels see.

    Parameters
    ----------
    system : System or LFTModel
    values : mapping of names to physical values, numbers or arrays (N,); the others are nominal
    outputs, inputs : names of channels; all by default

    Returns
    -------
    tuple of N arrays, rad/s, each rising; 0 for integrators

    Raises
    ------
    AnalysisError, StructureError, WellPosednessError
        As `zeros`.
    """
    matrices = transfers_at(system, values, outputs, inputs, "responses")
    found = []
    for A, B, C, D in zip(*matrices, strict=True):
        seen = spectrum(A)
        largest = float(np.max(np.abs(seen.poles), initial=0.0))
        sizes = np.unique(np.abs(seen.cleaned.imag[seen.on_axis]))
        unit = np.where(sizes > 0.0, sizes, largest or 1.0)
        one = (matrix[None] for matrix in (A, B, C, D))
        apart = np.array([1e-2, 1e-4]) * _NEAREST
        omega = sizes[:, None] + unit[:, None] * np.where(
            sizes[:, None] > 0.0, apart, 100.0 * apart
        )
        gains = np.abs(resolvent(StateMatrices(*one), 1j * omega.reshape(1, -1))[0])
        gains = np.max(gains, axis=(1, 2), initial=0.0).reshape(-1, 2)
        kept = sizes[gains[:, 1] > _INFINITE * gains[:, 0]]
        # poles of one frequency that rounding has moved apart are one
        gaps = np.diff(kept, prepend=-np.inf) > _NEAREST * kept
        found.append(kept[gaps])
    return tuple(found)


def _around(even: Array, poles: NDArray[np.complex128]) -> Array:
    """Rising frequencies of one sample: `even` ones (P,), and clusters at its poles (nx,)."""
    first, last = even[0], even[-1]
    apart = np.log(last / first) / (len(even) - 1)
    center, half = np.abs(poles.imag)[:, None], np.abs(poles.real)[:, None]
    undamped = half < _UNDAMPED * center
    width = np.where(undamped, _NEAREST * center, half)
    ratio = np.maximum(apart * center / np.where(width > 0.0, width, 1.0), 2.0)
    beyond = ratio ** (np.arange(1, _BEYOND + 1) / _BEYOND)
    steps = np.concatenate([np.tile(_CENTER, (len(poles), 1)), beyond], axis=1)
    added = np.concatenate([center + width * steps, center - width * steps], axis=1)
    added = np.where((center > 0.0) & (added > first) & (added < last), added, first)
    return _off_axis(np.sort(np.concatenate([even, added.ravel()])), center[undamped])


def _off_axis(omega: Array, centers: Array) -> Array:
    """Rising frequencies, those that are too near to poles on the axis moved as far as is allowed."""
    for center in np.unique(centers[centers > 0.0]):
        near = np.abs(omega - center) < _NEAREST * center
        omega = np.where(
            near, center * (1.0 + np.where(omega < center, -1.0, 1.0) * _NEAREST), omega
        )
    return np.sort(omega)
