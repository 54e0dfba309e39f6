"""Poles at samples of the parameters, and which of them lie on the imaginary axis to rounding."""

from collections.abc import Mapping
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbdlft.base.array import Array, ArrayLike
from mbdlft.base.errors import AnalysisError
from mbdlft.response.samples import samples_at
from mbdlft.system.model import System

Stability = Literal["stable", "marginal", "unstable"]
_EPS = float(np.finfo(float).eps)
_ROUNDING = 16.0 * _EPS  # times the number of states and the size of A: what rounding may do to A
_ZERO = 1e-5  # of the size of A: how far rounding may move three poles from zero
_CLEAR = 10.0  # times what rounding does to a pole, to first order: then its side is clear


class Spectrum(NamedTuple):
    """Poles of one matrix A.

    Attributes
    ----------
    poles : complex array (n,), rad/s
    on_axis : bool array (n,)
        A change of A by rounding may bring the pole onto the imaginary axis: its side is not known.
    at_zero : bool array (n,)
        A change of A by rounding may bring it to zero: that of an integrator. It is on the axis, too.
    """

    poles: NDArray[np.complex128]
    on_axis: NDArray[np.bool_]
    at_zero: NDArray[np.bool_]

    @property
    def stability(self) -> Stability:
        """``"unstable"``: a pole is right of the axis; ``"marginal"``: on it, and none is right."""
        if np.any((self.poles.real > 0.0) & ~self.on_axis):
            return "unstable"
        return "marginal" if np.any(self.on_axis) else "stable"

    @property
    def worst(self) -> complex:
        """The pole farthest right, the real part of those on the axis being zero; -inf without poles."""
        if not len(self.poles):
            return complex(-np.inf)
        cleaned = self.cleaned
        return complex(cleaned[np.argmax(cleaned.real)])

    @property
    def cleaned(self) -> NDArray[np.complex128]:
        """The poles without what rounding has left of real parts on the axis, and of zero."""
        found = np.where(self.on_axis, 1j * self.poles.imag, self.poles)
        return np.where(self.at_zero, 0.0, found)


def poles(system: System, values: Mapping[str, ArrayLike] | None = None) -> NDArray[np.complex128]:
    """Eigenvalues of A at samples of the parameters.

    Parameters
    ----------
    system : System or LFTModel
    values : mapping of names to physical values, numbers or arrays (N,); the others are nominal

    Returns
    -------
    complex array (N, nx), rad/s
        Of each sample by size; a pair has its positive frequency first. N = 1 for numbers.

    Raises
    ------
    StructureError, WellPosednessError
        As `matrices_at`.
    AnalysisError
        The eigenvalues were not found.
    """
    return eigenvalues(samples_at(system, values).A, system.name)


def eigenvalues(A: Array, name: str) -> NDArray[np.complex128]:
    """Sorted eigenvalues (N, n) of matrices A (N, n, n) of a model of this name."""
    try:
        found = np.linalg.eigvals(A).astype(complex)
    except np.linalg.LinAlgError:
        raise AnalysisError(
            f"model {name!r}: the eigenvalues of A were not found. Scale the states, or choose other "
            "values of the parameters."
        ) from None
    order = np.lexsort((-found.imag, found.real, np.abs(found)))
    return np.take_along_axis(found, order, axis=-1)


def spectrum(A: Array) -> Spectrum:
    """Poles of one matrix A (n, n), and which of them rounding does not let tell from the axis.

    A pole is on the axis if A - j omega I at its frequency omega has a singular value of the size of the
    rounding of A: then a matrix so near to A has the pole j omega. Double poles are judged rightly, too.
    """
    import scipy.linalg  # here because it is slow to import

    if not len(A):
        none = np.zeros(0, dtype=bool)
        return Spectrum(np.zeros(0, dtype=complex), none, none)
    found, left, right = scipy.linalg.eig(A, left=True, check_finite=False)
    order = np.lexsort((-found.imag, found.real, np.abs(found)))
    found, left, right = found[order], left[:, order], right[:, order]
    rounding = _ROUNDING * len(A) * float(np.linalg.norm(A))
    overlap = np.abs(np.sum(np.conj(left) * right, axis=0))
    unclear = np.abs(found.real) * overlap <= _CLEAR * rounding
    for k in np.flatnonzero(unclear):
        if k and found[k] == np.conj(found[k - 1]):
            unclear[k] = unclear[k - 1]
            continue
        shifted = A - 1j * found[k].imag * np.eye(len(A))
        # the least singular value is no larger than |(A - j omega I) v| of a unit vector v
        seen = float(np.linalg.norm(shifted @ right[:, k])) <= rounding
        unclear[k] = seen or np.linalg.svd(shifted, compute_uv=False)[-1] <= rounding
    small = unclear & (np.abs(found) <= _ZERO * float(np.linalg.norm(A)))
    if np.any(small):
        small &= bool(np.linalg.svd(A, compute_uv=False)[-1] <= rounding)
    return Spectrum(found, unclear, small)


def without_integrators(system: System, found: NDArray[np.complex128]) -> NDArray[np.complex128]:
    """Poles (N, nx) without those at zero, in one row.

    As many as the nominal system has at zero are taken for the same at the samples, if they are small.
    """
    seen = spectrum(samples_at(system).A[0])
    sizes = np.abs(found)
    small = _ZERO * max(float(np.max(np.abs(seen.poles), initial=0.0)), 1e-300)
    zero = (sizes <= small) & (np.arange(sizes.shape[1]) < np.sum(seen.at_zero))
    return found[~zero & (sizes > 0.0)]


def pole_text(pole: complex) -> str:
    """A pole, or a pair, with its unit."""
    pair = f" +- {abs(pole.imag):.6g}j" if pole.imag else ""
    return f"{pole.real:.6g}{pair} rad/s"
