"""Equilibria with positions as unknowns: numbers at one value of the parameters, or rational fits."""

from mbdlft.equilibrium.find import EquilibriumPoint as EquilibriumPoint
from mbdlft.equilibrium.find import find_equilibrium as find_equilibrium
from mbdlft.equilibrium.fitted import fit_positions as fit_positions
from mbdlft.equilibrium.write import at_equilibrium as at_equilibrium
from mbdlft.equilibrium.write import eigenvalues_at as eigenvalues_at
