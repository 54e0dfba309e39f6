"""A consistent point of a loop, order after order: closed forms of a slider crank."""

import casadi as ca
import numpy as np
import pytest

import mbdlft
from mbdlft.dae import DaeDraft, reduce_index, start_point
from mbdlft.dae.alias import eliminate_aliases
from mbdlft.dae.dae import Dae
from mbdlft.dae.index import Entry, differentiated
from mbdlft.dae.initial import guessed, point_by_orders
from mbdlft.dae.newton import System
from mbdlft.problem.sx.constants import in_doubles
from tests.close import roundoff

CRANK, ROD, ANGLE, SPEED = 0.4, 1.1, 0.3, 2.0


def slider_crank(guess: float) -> Dae:
    """Entries of the rotations of crank and rod are variables, and no start is known of them."""
    d = DaeDraft("crank")
    m = d.parameter(mbdlft.Parameter("m", 2.0, percent=20))
    phi, w = d.variable("phi", start=ANGLE, fixed=True), d.variable("w", start=SPEED, fixed=True)
    x = d.variable("x", start=-0.7 * np.sign(np.cos(guess)))  # of the other assembly
    psi, force = d.variable("psi", start=guess), d.variable("force")
    arms = [[d.variable(f"R{k}{i}") for i in range(2)] for k in range(2)]
    for (c, s), angle in zip(arms, (phi, psi), strict=True):
        d.equation(c, equals=ca.cos(angle))
        d.equation(s, equals=ca.sin(angle))
    (c, s), (e, f) = arms
    d.equation(CRANK * s + ROD * f, "closure")
    d.equation(x, equals=CRANK * c + ROD * e)
    d.equation(w, equals=d.der(phi))
    v = d.variable("v")
    d.equation(v, equals=d.der(x))
    d.equation(m * d.der(v), equals=force)
    d.equation(d.der(w), equals=-force)
    d.output("x")
    return d.dae()


@pytest.mark.parametrize(("guess", "side"), [(0.2, 1.0), (2.8, -1.0)])
def test_the_assembly_and_the_rates_are_those_near_the_starts(guess: float, side: float) -> None:
    dae, _ = eliminate_aliases(slider_crank(guess))
    d = differentiated(dae)
    known = point_by_orders(d, [], np.array([2.0]), {"psi"})
    assert known is not None
    names = [v.name for v in dae.variables]
    psi, x, rate = (known[Entry(names.index(n), k)] for n, k in (("psi", 0), ("x", 0), ("x", 1)))
    sine, slope = -CRANK / ROD * np.sin(ANGLE), -CRANK / ROD * np.cos(ANGLE) * SPEED
    cosine = side * np.sqrt(1.0 - sine**2)
    roundoff([np.sin(psi), np.cos(psi)], [sine, cosine])
    roundoff(x, CRANK * np.cos(ANGLE) + ROD * cosine)
    roundoff(rate, -CRANK * np.sin(ANGLE) * SPEED - ROD * sine * slope / cosine)
    values = np.array([known[entry] for entry in d.symbols])
    residual = ca.vertcat(*d.residuals.values())
    symbols = [ca.vertcat(*d.symbols.values()), dae.p]
    missed = ca.Function("missed", symbols, [in_doubles(residual)])(values, [2.0])
    roundoff(missed.full()[:, 0], np.zeros(missed.numel()))


def test_the_start_of_a_structure_is_that_assembly() -> None:
    at = start_point(reduce_index(slider_crank(2.8), preferred=["psi", "phi"]))
    assert np.cos(at.nominal["psi"]) < -0.9
    roundoff(at.nominal["phi"], ANGLE)


def test_a_guess_goes_from_one_equation_to_the_next() -> None:
    a, b, c, q = ca.SX.sym("a"), ca.SX.sym("b"), ca.SX.sym("c"), ca.SX.sym("q")
    system = System(ca.vertcat(c - a * b, 2 * b - ca.cos(a)), ca.vertcat(a, b, c), q)
    z = guessed(system, np.array([0.5, 7.0, 9.0]), np.array([0.0]), [[0], [2], [1]])
    roundoff(z, [0.5, np.cos(0.5) / 2, np.cos(0.5) / 4])
