"""Loads of frames in units of their own, with few copies: parameters multiply few deflections."""

from pathlib import Path

import casadi as ca
import numpy as np
import pytest

import mbdlft
from mbdlft import Parameter
from mbdlft.exact.numbers import in_enough_bits
from mbdlft.lft.sampling import evaluate_at
from mbdlft.order.reduction import eliminated, reduce_exactly
from mbdlft.pipeline.extract.lifting import extract
from mbdlft.problem.relations import Lifted, LinearModel
from mbdlft.problem.scales import in_own_units
from tests import close
from tests.attack.frames import STEEL, Bar, Structure, scene_of
from tests.attack.loops import drawn

SCENARIOS = Path(__file__).parents[2] / "scenarios"
POST_AND_ARM = (Bar(-1, 0, 0, 0.0, ""), Bar(0, 1, 90, 1.2, "fixed"))


@pytest.mark.parametrize(
    ("names", "order"), [(("I", "h"), {"I": 18, "h": 67}), (("A", "I", "h"), {"A": 18, "I": 18, "h": 67})]
)
def test_second_moments_multiply_few_deflections(names: tuple[str, ...], order: dict[str, int]) -> None:
    """I 69 and h 139, or 141, with bending deflections as they are, and a copy of the loads for each."""
    values = {"h": 1.5, **STEEL}
    frame = Structure(POST_AND_ARM, 1, (1.0, -9.81, 2.0), (0.0, 0.0, 0.0), 0.0, values, names)
    model = mbdlft.to_lft(scene_of(frame), search=0.0, prove=0.0)
    assert {block.name: block.size for block in model.lft.blocks} == order


def _weighed(parameter: Parameter) -> LinearModel:
    """rate = u/p - (3/p + p) x, by loads f = p^2/4 and 3 f of springs in a row, and a multiplier."""
    p, q, f, one = ca.SX.sym("p"), ca.SX.sym("q", 2), ca.SX.sym("f", 2), ca.SX.sym("one")
    rate, m, x, u, loads = (
        ca.SX.sym(name, n) for name, n in (("rate", 1), ("m", 1), ("x", 1), ("u", 1), ("loads", 2))
    )
    springs = ca.vertcat(p * q[0] - f[0], p * q[1] - f[1], q[0] + q[1] - one * p, f[1] - 3 * f[0])
    trim = LinearModel(springs, f, ca.vertcat(q, f), one, p, (parameter,))
    residual = ca.vertcat(p * rate + 3 * x - p * m + loads[0] + loads[1], p * m - u)
    lifted = Lifted(loads, ca.vertcat(x, x), (0, 1), trim)
    signals, known = ca.vertcat(rate, m), ca.vertcat(x, u)
    return LinearModel(residual, ca.SX(0, 1), signals, known, p, (parameter,), 1, lifted)


def test_loads_in_their_own_units_are_the_same_model() -> None:
    """The loads are made with fewer powers of the parameter."""
    model = _weighed(Parameter("p", 2.0, low=1.0, high=3.0))
    scaled = in_own_units(model)
    assert in_own_units(model) is scaled
    assert scaled.lifted
    assert model.lifted
    counts = [
        sum(ca.depends_on(m.lifted.trim.residual[k], m.p) for k in range(4)) for m in (model, scaled)
    ]
    assert counts[1] < counts[0]
    made = in_enough_bits(
        lambda: reduce_exactly(eliminated(extract(model).lft, 2, [0])).rounded(), "loads"
    )
    for p in (1.0, 2.5, 3.0):
        value = evaluate_at(made, np.array([[p - 2.0]]))[0]
        close.roundoff(value[0], np.array([-3.0 / p - p, 1.0 / p]))


@pytest.mark.parametrize(
    "parameter", [Parameter("p", 2.0, low=-1.0, high=3.0), mbdlft.Angle("p", 30.0, low=20.0, high=40.0)]
)
def test_parameters_that_may_be_zero_scale_nothing(parameter: Parameter) -> None:
    """Loads in powers of it are not determined there; the tangent of an angle is zero at nominal."""
    model = _weighed(parameter)
    assert in_own_units(model) is model


def test_loads_with_each_parameter_once_keep_their_units() -> None:
    """Units of their own are fewer channels of no copy; the order is 15 with them."""
    scene = mbdlft.load_scene(SCENARIOS / "tasks" / "delta_robot.toml")
    assert mbdlft.to_lft(scene, search=0.0, prove=0.0).order == 9


def test_levers_of_mechanisms_keep_their_units() -> None:
    """They have 18 channels more in units of their own, before the relations are closed, and 26 after."""
    model = mbdlft.to_lft(drawn(19, flat=False)[0], search=0.0, prove=0.0)
    assert model.order == 19


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
