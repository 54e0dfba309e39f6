"""Effective masses: which part of a body's mass moves in its modes, and the residual mass."""

from dataclasses import dataclass

import numpy as np

from mbdlft.base.array import Array
from mbdlft.elastic.model import ModalModel
from mbdlft.elastic.nodes import DIRECTIONS
from mbdlft.elastic.rigid import mass_matrix


@dataclass(frozen=True, slots=True, eq=False)
class EffectiveMasses:
    """Effective masses of the modes of a body, about its origin; `table()` writes them as a text.

    Attributes
    ----------
    frequencies : (n,) rad/s
    masses : (n, 6) kg for displacements, kg m^2 for rotations: squares of the participation factors
    rigid : (6, 6) mass matrix of the undeformed body about the origin; nan where it is not determined
    residual : (6, 6) rigid mass matrix minus that of all modes: this mass moves as if it were rigid
    """

    frequencies: Array
    masses: Array
    rigid: Array
    residual: Array

    @property
    def kept(self) -> Array:
        """(6,) effective mass of all modes over the rigid mass of each direction; nan if that is 0."""
        total = np.diag(self.rigid)
        has_mass = total > _NOTHING * np.nanmax(total)
        share = np.sum(self.masses, axis=0) / np.where(has_mass, total, 1.0)
        return np.where(has_mass, share, np.nan)

    def table(self) -> str:
        """One row for each mode: frequency (Hz), effective mass in percent of the rigid one."""
        total = np.diag(self.rigid)
        percent = 100.0 * self.masses / np.where(total > _NOTHING * np.nanmax(total), total, np.nan)
        head = "".join(f"{name:>8}" for name in DIRECTIONS)
        lines = [f"{'mode':>5}{'Hz':>12}{head}   (% of the rigid mass, about the origin)"]
        for k, (w, row) in enumerate(zip(self.frequencies, percent, strict=True), start=1):
            lines.append(f"{k:>5}{w / (2.0 * np.pi):>12.5g}{_row(row)}")
        lines.append(f"{'sum':>5}{'':>12}{_row(100.0 * self.kept)}")
        values = "".join(f"{entry:>10.4g}" for entry in total)
        lines.append(f"rigid mass (kg, kg m^2):{values}")
        return "\n".join(lines)


def effective_masses(model: ModalModel) -> EffectiveMasses:
    """Effective masses P_ck^2 of each mode k and direction c, and the residual mass R' M R - P P'.

    Parameters
    ----------
    model : ModalModel
    """
    rigid = mass_matrix(model.rigid)
    return EffectiveMasses(
        frequencies=model.frequencies,
        masses=model.participation.T**2,
        rigid=rigid,
        residual=rigid - model.participation @ model.participation.T,
    )


def _row(entries: Array) -> str:
    """Entries (6,) as columns of the table."""
    return "".join(f"{'-':>8}" if np.isnan(entry) else f"{entry:>8.2f}" for entry in entries)


_NOTHING = 1e-9  # a smaller mass, of the largest, is none: a bar has no inertia about its own axis
