"""Transmission zeros at samples of the parameters."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from mbdlft.analyze.samples import Names, transfers_at
from mbdlft.analyze.staircase import Plant, finite_zeros, scaled, seen
from mbdlft.base.array import ArrayLike
from mbdlft.base.errors import AnalysisError
from mbdlft.system.system import System


def zeros(
    system: System,
    values: Mapping[str, ArrayLike] | None = None,
    *,
    outputs: Names = None,
    inputs: Names = None,
) -> tuple[NDArray[np.complex128], ...]:
    """Transmission zeros: s at which G(s) = C (s I - A)^-1 B + D loses rank, infinite ones left out.

    Modes that the inputs do not reach, or the outputs do not see, are no zeros: they are taken out first.
    Ranks are decided at the rounding of the scaled matrices.

    Parameters
    ----------
    system : System or LFTModel
    values : mapping of names to physical values, numbers or arrays (N,); the others are nominal
    outputs, inputs : names of channels; all by default
        Zeros of one transfer: one name of each.

    Returns
    -------
    tuple of N complex arrays, rad/s, each sorted by size
        The number of zeros may differ between samples. It is empty for a G that is zero.

    Raises
    ------
    StructureError, WellPosednessError
        As `matrices_at`; a name of a channel is unknown.
    AnalysisError
        There are no inputs or no outputs.
    """
    found: list[NDArray[np.complex128]] = []
    for A, B, C, D in zip(*transfers_at(system, values, outputs, inputs, "zeros"), strict=True):
        plant = seen(scaled(Plant(A, B, C, D))[0])
        try:
            found.append(_sorted(finite_zeros(plant).astype(complex), real=np.isrealobj(plant.A)))
        except np.linalg.LinAlgError:
            raise AnalysisError(
                f"model {system.name!r}: zeros: the eigenvalues of a reduced pencil were not found."
            ) from None
    return tuple(found)


def _sorted(found: NDArray[np.complex128], *, real: bool) -> NDArray[np.complex128]:
    """Zeros by size; those of a real system in pairs that are equal to the last digit."""
    if real:
        upper = found[found.imag > 0.0]
        found = np.concatenate([found[found.imag == 0.0], upper, np.conj(upper)])
    return found[np.lexsort((-found.imag, found.real, np.abs(found)))]
