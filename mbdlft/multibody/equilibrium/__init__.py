"""Equilibria with positions as unknowns: numbers at one value of the parameters, or rational fits."""

from mbdlft.multibody.equilibrium.find import EquilibriumPoint as EquilibriumPoint
from mbdlft.multibody.equilibrium.find import find_equilibrium as find_equilibrium
from mbdlft.multibody.equilibrium.fitted import fit_positions as fit_positions
from mbdlft.multibody.equilibrium.write import at_equilibrium as at_equilibrium
from mbdlft.multibody.equilibrium.write import eigenvalues_at as eigenvalues_at
