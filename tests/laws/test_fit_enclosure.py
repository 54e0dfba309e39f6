"""Enclosures of the distance of a fit from the root: they hold it, or they are infinite."""

import casadi as ca
import numpy as np

from mbdlft.base.expression import parse
from mbdlft.multibody.equilibrium import branches
from mbdlft.multibody.equilibrium.branches import system

LOW, HIGH = 0.99, 1.01


def distance(fit: str, radius: float) -> float:
    """The bound of |fit - p^(1/3)| that is proved on the box, looking at so large distances."""
    t, p = ca.SX.sym("t"), ca.SX.sym("p")
    cube = system(ca.Function("cube", [t, p], [t * t * t - p]), ["p"])
    box = np.array([[LOW]]), np.array([[HIGH]])
    found, _ = branches.enclose(cube, [parse(fit)], *box, np.array([radius]))
    return float(found[0, 0])


def test_a_bound_holds_the_distance() -> None:
    largest = 1.001 - LOW ** (1 / 3)
    assert largest <= distance("1.001", 0.01) < 0.01


def test_a_root_outside_of_the_radius_is_not_enclosed() -> None:
    """The step of Newton from 1.3 leads to 1.06: 0.24 is less than the distance of the root."""
    assert distance("1.3", 0.001) == np.inf


def test_a_slope_that_changes_too_much_encloses_nothing() -> None:
    """Within 0.5 of 1.3 the slope is a third and twice what it is there."""
    assert distance("1.3", 0.5) == np.inf
