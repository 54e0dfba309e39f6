"""Errors of fits of equilibria: each says where, what was got, and what to try."""

from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np

from mbdlft.multibody.equilibrium.fit import fit_equilibrium
from tests.errors.table import refused


def residual(f: Callable[[Any, Any], Any], unknowns: int = 1, parameters: int = 1) -> ca.Function:
    t, p = ca.SX.sym("t", unknowns), ca.SX.sym("p", parameters)
    return ca.Function("arm", [t, p], [f(t, p)])


LEVER = residual(lambda t, p: t + t**3 - p)
ROOT = residual(lambda t, p: t - ca.sqrt(p))


def fit(function: ca.Function, low: float, nominal: float, high: float, start: float) -> None:
    fit_equilibrium(function, [nominal], [low], [high], [start], 1e-6, names=["m"])


test_messages = refused(
    r"""
> {} => TrimError:
fit_equilibrium(LEVER, [0.5], [0], [1], [0.1], 1e-3, names=["a", "b"])
    => StructureError: names has 2 entries, the residual takes 1
fit_equilibrium(LEVER, [1], [0], [2], [0.7], 1e-6, largest_degree=1)
    => up to degree 1 is within 9e-07 at samples, as a proof of 1e-06 needs; the errors came down to
fit_equilibrium(LEVER, [1], [0], [2], [0.7], 1e-9, most_pieces=2)
    => is proved on … % of the box only, with 2 pieces; no error
fit_equilibrium(LEVER, [1], [0], [2], [0.7], 1e-17) =~ does not carry|no rational fit|proved on
> fit_equilibrium(LEVER, *{}) => StructureError:
([0.5, 1], [0], [1], [0.1], 1e-3) => 'arm': nominal has 2 entries, the residual takes 1
([0.5], [0], [1, 2], [0.1], 1e-3) => high has 2 entries
([0.5], [0], [1], [0.1, 0], 1e-3) => 1 unknowns, but start has 2 entries
([0.5], [1], [0], [0.1], 1e-3) => expected low <= nominal <= high and low < high
([2.0], [0], [1], [0.1], 1e-3) => expected low <= nominal <= high and low < high
([0.5], [0.5], [0.5], [0.1], 1e-3) => low < high for at least one parameter
([0.5], [0], [np.nan], [0.1], 1e-3) => high [nan]
([0.5], [0], [1], [np.inf], 1e-3) => expected finite numbers and a positive tolerance
([0.5], [0], [1], [0.1], 0.0) => expected finite numbers and a positive tolerance, got 0.0
> (lambda function, box, start: fit(function, *box, start))({}) => TrimError:
residual(lambda t, p: t * t + p), (1, 2, 3), 1.0
    => equilibrium of 'arm': … no root … start = [1.0] at m = 2. G
residual(lambda t, p: t * (1 - p)), (0, 1, 2), 0.0
    => equilibrium of 'arm': … no root was found from start
residual(lambda t, p: t**3 + 1e-9 * t - p), (-1, 0, 1), 0.0 =~ equilibrium of 'arm': .*folds|singular
residual(lambda t, p: t * t - p), (-1, 1, 2), 1.0
    => equilibrium of 'arm': … near m = … , t = … the branch folds
residual(lambda t, p: t * (t - p)), (-1, 1, 2), 0.0
    => equilibrium of 'arm': … the branch bifurcates: df/dt is
ROOT, (-1, 1, 2), 1.0 => equilibrium of 'arm': … the branch ends: the residual is not finite beyond
residual(lambda t, p: 1 - p * t), (-1, 1, 2), 1.0
    => equilibrium of 'arm': … goes to infinity … another reference
> fit(residual(lambda t, p: {}), 0.5, 1.0, 1.5, 1.0) => NotRationalError: integer
t - {ca.exp(p)|p**2.5}
"""
)
