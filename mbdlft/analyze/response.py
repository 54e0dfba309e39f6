"""Frequency responses of many samples of a model at once."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mbdlft.base.array import Array
from mbdlft.base.errors import AnalysisError
from mbdlft.lft.evaluate import chunks
from mbdlft.system.model import LFTModel, matrices_at


def frequency_response(
    model: LFTModel, values: Mapping[str, ArrayLike], omega: ArrayLike
) -> NDArray[np.complex128]:
    """G(j omega) = C (j omega I - A)^-1 B + D at samples of the parameters.

    Parameters
    ----------
    model : LFTModel
    values : mapping of names to physical values, numbers or arrays (N,); the others are nominal
    omega : array (n_omega,), rad/s

    Returns
    -------
    complex array (N, n_omega, ny, nu)
        Unit of entry (i, j): unit of output i over unit of input j. N = 1 for numbers.

    Raises
    ------
    AnalysisError
        j omega is an eigenvalue of A at one of the samples, or `omega` has what is not a finite number.
    """
    frequencies = np.atleast_1d(np.asarray(omega))
    if frequencies.dtype.kind not in "iuf" or not np.all(np.isfinite(frequencies)):
        raise AnalysisError(
            f"model {model.name!r}: omega: expected finite frequencies (rad/s), got {omega!r}."
        )
    A, B, C, D = (
        matrix if matrix.ndim == 3 else matrix[None] for matrix in matrices_at(model, values)
    )
    eye = np.eye(A.shape[-1])
    response = np.empty((len(A), len(frequencies), *D.shape[-2:]), dtype=complex)
    for part in chunks(len(A), max(1, A.shape[-1] + max(D.shape[-2:]))):
        right = B[part].astype(complex)
        for k, w in enumerate(frequencies):
            try:
                response[part, k] = (
                    C[part] @ np.linalg.solve(1j * w * eye - A[part], right) + D[part]
                )
            except np.linalg.LinAlgError:
                raise AnalysisError(
                    f"model {model.name!r}: omega = {w:g} rad/s is a pole at one of the samples, where "
                    "the response is infinite. Leave this frequency out or add damping."
                ) from None
    return response


def singular_values(response: NDArray[np.complex128]) -> Array:
    """Singular values (..., min(ny, nu)) of a `response` (..., ny, nu), largest first; its unit."""
    return np.asarray(np.linalg.svd(response, compute_uv=False), dtype=float)
