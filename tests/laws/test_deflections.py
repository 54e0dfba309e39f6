"""Loads of frames as the force method has them: a second moment multiplies axial deflections alone."""

from pathlib import Path

import casadi as ca
import numpy as np
import pytest

import mbdlft
from mbdlft import Parameter
from mbdlft.lft.sampling import evaluate_at
from mbdlft.order.reduction import eliminated, reduce_exactly
from mbdlft.pipeline.extract.lifting import extract
from mbdlft.problem.deflections import with_scaled_deflections, without_factor
from mbdlft.problem.relations import Lifted, LinearModel
from tests import close
from tests.attack.frames import STEEL, Bar, Structure, scene_of

SCENARIOS = Path(__file__).parents[2] / "scenarios"
POST_AND_ARM = (Bar(-1, 0, 0, 0.0, ""), Bar(0, 1, 90, 1.2, "fixed"))


@pytest.mark.parametrize(
    ("names", "order"), [(("I", "h"), {"I": 20, "h": 84}), (("A", "I", "h"), {"A": 20, "I": 20, "h": 90})]
)
def test_second_moments_multiply_few_deflections(names: tuple[str, ...], order: dict[str, int]) -> None:
    """I 69 and h 139, or 141, with the bending deflections as they are, and a copy of the loads for each.

    I 24 and h 95, or 110, with one for each, and A 38. With one for each that is free they become these,
    but A 33, which is 20 as a factor of all loads.
    """
    values = {"h": 1.5, **STEEL}
    frame = Structure(POST_AND_ARM, 1, (1.0, -9.81, 2.0), (0.0, 0.0, 0.0), 0.0, values, names)
    model = mbdlft.to_lft(scene_of(frame), search=0.0, prove=0.0)
    assert {block.name: block.size for block in model.lft.blocks} == order


def _springs(low: float) -> LinearModel:
    """A force f on springs p, p/2 and 3 in a row, which are 1 longer together."""
    parameter = Parameter("p", 2.0, low=low, high=4.0)
    p, q, f, one = ca.SX.sym("p"), ca.SX.sym("q", 3), ca.SX.sym("f"), ca.SX.sym("one")
    residual = ca.vertcat(p * q[0] - f, p * q[1] - 2 * f, 3 * q[2] - f, ca.sum1(q) - one)
    return LinearModel(residual, ca.SX(f), ca.vertcat(q, f), one, p, (parameter,))


def test_loads_do_not_depend_on_how_deflections_are_scaled() -> None:
    """f = 1/(3/p + 1/3); the parameter multiplies two springs before, and one signal after."""
    (trim,) = with_scaled_deflections(_springs(1.0))
    assert [k for k in range(4) if ca.depends_on(trim.residual[k], trim.p)] == [3]
    for p in (1.0, 2.5, 4.0):
        at = ca.SX(ca.substitute(trim.residual, ca.vertcat(trim.p, trim.known), ca.DM([p, 1.0])))
        offset = ca.DM(ca.substitute(at, trim.unknown, ca.DM.zeros(4)))
        f = ca.solve(ca.DM(ca.jacobian(at, trim.unknown)), -offset)[3]
        close.roundoff(float(f), 1.0 / (3.0 / p + 1.0 / 3.0))


def test_parameters_that_may_be_zero_scale_nothing() -> None:
    """Deflections times such a parameter are not determined where it is zero."""
    assert with_scaled_deflections(_springs(-1.0)) == ()


def test_a_factor_of_all_loads_leaves_them() -> None:
    """q = (b/a, a b) is b times (1/a, a)."""
    p, q, one = ca.SX.sym("p", 2), ca.SX.sym("q", 2), ca.SX.sym("one")
    residual = ca.vertcat(p[0] * q[0] - p[1] * one, q[1] - p[0] * p[1] * one)
    parameters = tuple(Parameter(name, 2.0, low=1.0, high=3.0) for name in "ab")
    trim, factor = without_factor(LinearModel(residual, q, q, one, p, parameters))
    assert (ca.is_equal(factor, p[1], 1), ca.depends_on(trim.residual, p[1])) == (True, False)
    solution = ca.vertcat(1 / p[0], p[0])
    left = ca.Function(
        "left", [p], [ca.substitute(trim.residual, ca.vertcat(q, one), ca.vertcat(solution, 1))]
    )
    close.roundoff(left([1.5, 2.5]).full(), np.zeros((2, 1)), scale=1.0)


def _displaced(by_load: float) -> LinearModel:
    """xdot = load (q_1 + 2 q_2 + q_3) + u, load (1 + b)/a, and q = (b x, q_0, x, x + c load q_1)."""
    a, b = (Parameter(name, 2.0, low=1.0, high=3.0) for name in "ab")
    p, x, q, u = ca.SX.sym("p", 2), ca.SX.sym("x"), ca.SX.sym("q", 4), ca.SX.sym("u")
    load, one, rate, loads = ca.SX.sym("load"), ca.SX.sym("one"), ca.SX.sym("rate"), ca.SX.sym("loads", 3)
    trim = LinearModel(p[0] * load - (1 + p[1]) * one, load, load, one, p, (a, b))
    follow = q - ca.vertcat(p[1] * x, q[0], x, x + by_load * loads[0])
    held = ca.vertcat(rate - loads[0] - 2 * loads[1] - loads[2] - u, follow)
    signals, known = ca.vertcat(rate, q), ca.vertcat(x, u)
    lifted = Lifted(loads, q[1:], (0, 0, 0), trim)
    return LinearModel(held, ca.SX(0, 1), signals, known, p, (a, b), 1, lifted)


@pytest.mark.parametrize(("by_load", "order"), [(0.0, {"a": 1, "b": 2}), (0.5, {"a": 2, "b": 3})])
def test_loads_have_a_copy_for_each_free_displacement(by_load: float, order: dict[str, int]) -> None:
    """Unless a load decides on the displacements, as on the third one of these."""
    opened = extract(_displaced(by_load)).lft
    model = reduce_exactly(eliminated(opened, 5, [0])).rounded()
    assert {block.name: block.size for block in model.blocks} == order
    for a, b in ((2.0, 2.0), (3.0, 1.5), (1.5, 2.5)):
        load = (1.0 + b) / a
        expected = load * (b + 2.0 + 1.0 + by_load * load * b)
        value = evaluate_at(model, np.array([[a - 2.0, b - 2.0]]))[0]
        close.roundoff(value[0], np.array([expected, 1.0]))


def test_displacements_in_proportion_have_copies_of_their_own() -> None:
    """They fall together, with a mass restricted to one channel; the order is 14 with one copy."""
    model = mbdlft.to_lft(mbdlft.load_scene(SCENARIOS / "four_bar.toml"), search=0.0, prove=0.0)
    assert model.order == 10
