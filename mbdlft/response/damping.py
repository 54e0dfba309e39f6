"""Tables of modes: natural frequency, damping and time constant of each pole, with units."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbdlft.base.array import Array, ArrayLike
from mbdlft.base.errors import AnalysisError
from mbdlft.response.samples import samples_at
from mbdlft.response.spectrum import Stability, eigenvalues, spectrum
from mbdlft.system.model import System


class ModeRow(NamedTuple):
    """A real pole, or a conjugate pair, of one sample.

    Attributes
    ----------
    pole : rad/s; of a pair the one with positive frequency
    natural_frequency : its size, rad/s
    frequency : the same, Hz
    damping : -real part / size [1]; nan for a pole at zero
    time_constant : -1 / real part, s; negative if it grows, infinite on the axis
    on_axis : rounding does not let it be told from a pole on the imaginary axis
    """

    pole: complex
    natural_frequency: float
    frequency: float
    damping: float
    time_constant: float
    on_axis: bool


@dataclass(frozen=True, slots=True, eq=False)
class DampingTable:
    """Poles at N samples with their natural frequencies, damping and time constants, all (N, nx).

    Attributes
    ----------
    name : of the model
    A : array (N, nx, nx), states scaled
    poles : complex array, rad/s
        Sorted as by `poles`; the other arrays are in the same order.
    """

    name: str
    A: Array
    poles: NDArray[np.complex128]

    @property
    def natural_frequency(self) -> Array:
        """Sizes of the poles, rad/s."""
        return np.abs(self.poles)

    @property
    def frequency(self) -> Array:
        """Natural frequencies, Hz."""
        return np.abs(self.poles) / (2.0 * math.pi)

    @property
    def damping(self) -> Array:
        """Damping ratios [1]: -real part / size; nan for poles at zero."""
        with np.errstate(invalid="ignore"):
            return np.asarray(0.0 - self.poles.real / np.abs(self.poles))

    @property
    def time_constant(self) -> Array:
        """Time constants -1 / real part, s: negative if it grows, infinite on the axis."""
        with np.errstate(divide="ignore"):
            return np.where(self.poles.real == 0.0, np.inf, -1.0 / self.poles.real)

    def stability(self, sample: int = 0) -> Stability:
        """``"stable"``, ``"marginal"`` (a pole is on the axis, to rounding) or ``"unstable"``."""
        return spectrum(self.A[self._checked(sample)]).stability

    def rows(self, sample: int = 0) -> tuple[ModeRow, ...]:
        """Real poles and pairs of one sample, slowest first.

        Raises
        ------
        AnalysisError
            There is no such sample.
        """
        found = spectrum(self.A[self._checked(sample)])
        kept = (found.cleaned.imag >= 0.0) | ~np.isin(found.cleaned.conj(), found.cleaned)
        table = replace(self, poles=found.cleaned[kept])
        columns = table.natural_frequency, table.frequency, table.damping, table.time_constant
        rows = zip(table.poles, *columns, found.on_axis[kept], strict=True)
        return tuple(ModeRow(*(value.item() for value in row)) for row in rows)

    def __str__(self) -> str:
        head = (
            "pole (rad/s)              natural (rad/s)   (Hz)        damping    time constant (s)"
        )
        more = f", the first of {len(self.poles)} samples" if len(self.poles) > 1 else ""
        lines = [f"{self.name}: poles{more}", head]
        return "\n".join([*lines, *("  ".join(cells(row)) for row in self.rows())])

    def _checked(self, sample: int) -> int:
        if not -len(self.A) <= sample < len(self.A):
            raise AnalysisError(
                f"model {self.name!r}: there is no sample {sample} in a table of {len(self.A)}."
            )
        return sample


def damping_table(system: System, values: Mapping[str, ArrayLike] | None = None) -> DampingTable:
    """Natural frequency |p|, damping -Re p / |p| and time constant -1 / Re p of each pole p.

    Parameters
    ----------
    system : System or LFTModel
    values : mapping of names to physical values, numbers or arrays (N,); the others are nominal
        Such as `random`, `corners` or `grid` of mbdlft.base make them. Without values: nominal.

    Returns
    -------
    DampingTable

    Raises
    ------
    StructureError, WellPosednessError, AnalysisError
        As `poles`.
    """
    A = samples_at(system, values).A
    return DampingTable(system.name, A, eigenvalues(A, system.name))


def cells(row: ModeRow) -> tuple[str, str, str, str, str]:
    """A row as texts: pole, natural frequency in rad/s and in Hz, damping, time constant."""
    real, imaginary = row.pole.real, row.pole.imag
    pair = f" +- {imaginary:.6g}j" if imaginary else ""
    growth = "on the axis" if row.on_axis else f"{row.time_constant:.6g}"
    if not row.on_axis and row.time_constant < 0.0:
        growth = f"grows, {-row.time_constant:.6g}"
    damping = f"{row.damping:.4g}" if row.natural_frequency else "-"
    size, hertz = f"{row.natural_frequency:.6g}", f"{row.frequency:.6g}"
    first = f"{real:.6g}{pair}"
    return first.ljust(24), size.ljust(16), hertz.ljust(10), damping.ljust(9), growth
