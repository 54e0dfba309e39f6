"""Equilibria with positions as unknowns: numbers at one value of the parameters, or rational fits."""

from mbdlft.multibody.equilibrium.equilibria import EquilibriumPoint as EquilibriumPoint
from mbdlft.multibody.equilibrium.equilibria import find_equilibrium as find_equilibrium
from mbdlft.multibody.equilibrium.scenes import at_equilibrium as at_equilibrium
from mbdlft.multibody.equilibrium.scenes import eigenvalues_at as eigenvalues_at
from mbdlft.multibody.equilibrium.scenes import fit_positions as fit_positions
