"""Frequency responses of many samples of a model at once."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from mbdlft.analyze.resolvent import resolvent
from mbdlft.analyze.samples import samples_at
from mbdlft.base.array import Array, ArrayLike
from mbdlft.base.errors import AnalysisError
from mbdlft.system.system import System


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
