"""Rational fits of equilibria that depend on parameters, with a guaranteed bound."""

from mbdlft.fit.equilibrium import EquilibriumFit, fit_equilibrium

__all__ = ["EquilibriumFit", "fit_equilibrium"]
