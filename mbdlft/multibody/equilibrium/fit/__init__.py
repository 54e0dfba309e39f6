"""Rational fits of equilibria that depend on parameters, with a guaranteed bound."""

from mbdlft.multibody.equilibrium.fit.equilibrium import EquilibriumFit, fit_equilibrium

__all__ = ["EquilibriumFit", "fit_equilibrium"]
