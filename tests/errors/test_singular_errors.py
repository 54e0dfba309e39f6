"""What is singular or gains energy in the range is named; what is not is not refused."""

import warnings
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import mbdlft
from mbdlft.base.errors import MbdlftWarning
from mbdlft.base.expression import evaluate, parse, write
from mbdlft.lft.lft import LFT, Block
from mbdlft.multibody.scene import checks
from mbdlft.multibody.to_problem import problem_of_scene
from mbdlft.pipeline.certification import values_at_points
from mbdlft.problem.relations import Nouns
from mbdlft.system.sampled import check_regular_at
from tests import kit
from tests.errors.scenes import cart
from tests.errors.table import refused, says


def lever(low: float, high: float, nominal: float = 0.2) -> mbdlft.Scene:
    """A bar that a force at x holds: F = 0.3 m g/x."""
    return kit.scene(
        "lever",
        mbdlft.Parameter("x", nominal, low=low, high=high, unit="m"),
        kit.body("a", 1.0, (1, 1, 1), center_of_mass=(0.0, 0.3, 0.0), ports={"q": (0.0, "x", 0.0)}),
        kit.hinge("j", "ground", "a", (1.0, 0.0, 0.0), preload=0.0),
        kit.force("F", "a.q", (0.0, 0.0, 1.0), frame="body"),
        gravity=(0.0, 0.0, -9.81),
    )


def test_trim_that_is_singular_inside() -> None:
    model = mbdlft.to_lft(lever(0.01, 0.4), search=0.0)
    assert model.certificate.well_posed == "proved"
    assert abs(mbdlft.trim_at(model, {"x": 0.01})[0] - 0.3 * 9.81 / 0.01) < 1e-9


def test_matrix_that_is_singular_in_a_small_ball() -> None:
    """Found by steps down the slope of the determinant: no sample is near."""
    parameters = [mbdlft.Parameter(name, 0.5, 0.0, 1.0) for name in "ab"]
    row = "((a - 0.3137)^2 + (b - 0.7219)^2 - 0.001^2)"
    matrix = [["0", "1"], ["1", row]]  # has an inverse everywhere
    assert mbdlft.realize(matrix, parameters, search=0.0).certificate.well_posed == "proved"
    static = mbdlft.realize([[row + " - 1"]], parameters, search=0.0)
    with says(mbdlft.WellPosednessError, "is singular at a = 0.31", "b = 0.72", "vanishes there"):
        mbdlft.feedback(static, np.eye(1), sign=-1)


# I - M11 Delta is [1 1 ; 1 1 + eps] at deltas of 1
EPS = float(np.finfo(float).eps)
NEARLY = LFT(
    [[0.0, -1.0], [-1.0, -EPS]], np.ones((2, 1)), np.ones((1, 2)), [[1.0]], (Block("p", 1), Block("q", 1))
)
PQ = [mbdlft.Parameter(name, 0.0, -2.0, 2.0, unit="m") for name in "pq"]
LOAD = mbdlft.Parameter("m", 2.0, percent=10, unit="kg")
SPRING = mbdlft.Parameter("k", 3.0, percent=10, unit="N/m")
test_messages = refused(
    r"""
> {} => WellPosednessError:
check_regular_at(halves(), np.array([[0.1], [0.5]]), [Parameter('p', 0.0, -1.0, 1.0)], "model 'm'")
    => model 'm': it is singular at p = 0.5, and … Choose other values
check_regular_at(NEARLY, np.array([[0.5, 0.5], [1.0, 1.0]]), PQ, "model 'm'")
    => singular to working precision (condition … e+16) at p = 2 m, q = 2 m
check_regular_at(NEARLY, np.array([[0.5, 0.5]]), PQ, "model 'm'") => accepted
to_lft(lever(-0.1, 0.4), search=0.0) => scene 'lever': … x = … Narrow the ranges
# What the proof does not look at is looked at where the model is checked.
values_at_points(halves(), [Parameter('p', 0.0, -1.0, 1.0)], np.array([[0.0], [1.0]]), Nouns('matrix',
    'm', 'the matrix', ''))
    => matrix 'm' … singular between the nominal values and p = 1.
realize([["2 [kg]*p"]], [Parameter("p", 1.0, 0.5, 2.0)])
    => SceneError: a number has a unit. Names of a matrix are plain values
# Numbers whose squares are no doubles.
> to_lft({}, search=0.0) => SceneError: too large, or too small, for doubles. Farthest from 1 is
cart("1e-310*m", [LOAD]) => body 'cart': mass = '1e-310*m' = 2e-310 kg. Give values
cart(1e-160, [SPRING], {"stiffness": "k"}) => body 'cart': mass = 1e-160 kg. Give
cart(2.0, [SPRING], {"stiffness": "k*1e305"}) => joint 'rail': stiffness = 'k*1e305' = 3e+305 N/m. Give
cart("1e200*m", [LOAD], {"stiffness": 1e-200})
    => body 'cart': mass = '1e200*m' = 2e+200 kg, joint 'rail': stiffness = 1e-200 N/m. Give
cart(1e-150) => accepted
> to_lft(lever(0.01, 0.4), prove={}) => AnalysisError: prove: expected units of work, such as 10, got
{-1.0|"much"|float("nan")|float("inf")|True}
> mbdlft.assemble(cart(2.0, [SPRING], {})) => MbdlftWarning: joint 'rail':
{"damping": -0.5} => damping is negative in the range: -0.5 N s/m.
{"stiffness": "k - 4.0"} => stiffness is negative in the range: -1.3 N/m.
> parse({}) => SceneError:
"2 [lb]" => expression '2 [lb]', column 3: unit 'lb': unknown symbol 'lb'.
"2 []" => expression '2 []', column 3: a unit is empty
"m [kg]" => expression 'm [kg]', column 3: expected an operator, got '[kg]'.
"[kg]" => expression '[kg]', column 1: expected a number before a unit, as in 1 [kg], got '[kg]'.
"2 [kg"
    => expression '2 [kg', column 3: expected a number, a name, an operator or a parenthesis, got '['.
"1e307 [km]" => expression '1e307 [km]', column 7: expected a finite number, got '[km]'.
"""
)


def halves() -> LFT:
    """1/(1 - 2 p)."""
    two, one = np.array([[2.0]]), np.ones((1, 1))
    return LFT(two, one, two, one, (Block("p", 1),))


def test_a_model_says_where_it_is_singular() -> None:
    """A model whose proof is taken away is looked at where it is asked for."""
    parameters = [mbdlft.Parameter("p", 0.0, -1.0, 1.0)]
    model = mbdlft.realize([["1/(3 - 2*p)"]], parameters, search=0.0)
    assert model.is_proved_regular
    doubtful = replace(model, lft=halves(), certificate=replace(model.certificate, well_posed="sampled"))
    for ask in (
        lambda: mbdlft.matrices_at(doubtful, {"p": [0.0, 0.5]}),
        lambda: doubtful.at(p=0.5),
        lambda: mbdlft.frequency_response(doubtful, {"p": 0.5}, [1.0]),
    ):
        with says(mbdlft.WellPosednessError, "model ", "it is singular at p = 0.5,"):
            ask()
    assert mbdlft.matrices_at(doubtful, {"p": 0.25}).D[0, 0] == 2.0


def test_a_point_that_50_digits_find_singular_is_named() -> None:
    """It said "at one of the points that are checked"."""
    mass, rail = (
        mbdlft.Parameter("m", 1.0, percent=20, unit="kg"),
        kit.rail("r", "ground", "p", (1, 0, 0)),
    )
    problem = problem_of_scene(kit.scene("rail", mass, kit.point("p", "m"), rail))
    with says(mbdlft.WellPosednessError, "the equations are singular at m = 0 kg, in 50 digits"):
        problem.reference().in_digits(np.zeros((1, 1)))


# units of numbers -----------------------------------------------------------------------------


def test_a_number_with_a_unit() -> None:
    assert evaluate(parse("2.5 [kg/m]*4"), {}) == 10.0
    assert evaluate(parse("10 [mm] + 2 [cm]"), {}) == 0.03
    assert abs(evaluate(parse("180 [deg]"), {}) - np.pi) < 1e-15
    text = write(parse("2 [kg mm]*x^2"))
    assert text == "(0.002 [kg m] * x^2)"
    assert write(parse(text)) == text


# warnings -------------------------------------------------------------------------------------


def test_a_spring_that_pushes_is_a_warning() -> None:
    spring = kit.spring("stay", "ground.wall", "cart", stiffness=-3.0, force_density=1.0)
    whole = kit.scene(
        "pushed",
        mbdlft.Ground(ports={"wall": (0.0, 1.0, 0.0)}),
        kit.point("cart", 1.0),
        kit.rail("rail", "ground", "cart", (0, 1, 0)),
        spring,
    )
    with pytest.warns(MbdlftWarning, match="load 'stay': stiffness is negative in the range: -3 N/m."):
        mbdlft.assemble(whole)


def test_a_mass_that_is_open_is_a_warning(monkeypatch: pytest.MonkeyPatch) -> None:
    right = checks.check_positive

    def in_two_parts(scene: mbdlft.Scene) -> tuple[checks.Outcome, ...]:
        return right(scene, 2)

    monkeypatch.setattr(checks, "check_positive", in_two_parts)
    parameters = [mbdlft.Parameter(n, 0.5, 0.0, 1.0) for n in "ab"]
    mass = "(a - 0.31)*(a - 0.31) + (b - 0.72)*(b - 0.72) + 0.01*(1 + a)"
    with pytest.warns(MbdlftWarning, match="not proved: whether mass .kg. is negative is open in"):
        mbdlft.assemble(cart(f"3.0*({mass})", parameters))


# refusals that were wrong ---------------------------------------------------------------------


def hinged(axis: tuple[float, float, float]) -> mbdlft.Scene:
    """A body on a hinge, closed on the ground by another hinge at the same place."""
    body = kit.body("b", 1.0, (1, 1, 1), ports={"p": (0, 0, 0)})
    return kit.scene(
        "two hinges",
        body,
        kit.point("tip", 0.5),
        kit.hinge("j", "ground", "b", (0.0, 0.0, 0.8)),
        kit.weld("weld", "b.p", "tip"),
        kit.loop("loop", "revolute", "ground", "b.p", axis=axis),
    )


def test_a_loop_of_one_coordinate() -> None:
    """A hinge across the first one lets nothing move, and the one along it changes nothing."""
    with pytest.raises(mbdlft.MbdlftError):
        mbdlft.to_lft(hinged((1.0, 0.0, 0.0)), search=0.0)
    along = mbdlft.to_lft(hinged((0.0, 0.0, 1.0)), search=0.0)
    assert len(along.states) == 2


def test_ports_of_a_loop_at_the_origin_of_the_scene() -> None:
    """The port is there by lengths that cancel up to rounding."""
    body = {"mass": 1.0, "inertia": mbdlft.Inertia(xx=1, yy=1, zz=1)}
    far = (0.1 + 0.2, 0.0, 0.0)
    scene = kit.scene(
        "back",
        mbdlft.RigidBody(name="a", ports={"p": far}, **body),
        mbdlft.RigidBody(name="b", ports={"q": (-0.3, 0.0, 0.0)}, **body),
        kit.hinge("i", "ground", "a", (0, 0, 1), stiffness=1.0),
        kit.hinge("j", "a.p", "b", (0, 0, 1), preload=0.0),
        kit.loop("loop", "spherical", "ground", "b.q"),
    )
    assert len(mbdlft.to_lft(scene, search=0.0).states) == 2


def test_a_spring_through_a_hinge() -> None:
    """Its torque is exactly zero, and what rounding makes of that is judged beside its stiffness."""
    body = kit.body("b", 0.0, yy=0.1, ports={"p": (0.0, 0.0, 0.462)})
    scene = kit.scene(
        "through",
        body,
        kit.body("c", 0.0, (0.4, 0.5, 0.4)),
        kit.hinge("j", "ground", "b", (0, 1, 0)),
        kit.ball("k", "b.p", "c"),
        kit.spring("l", "ground", "c", force_density=19.124),
    )
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert max(map(abs, mbdlft.solve_trim(mbdlft.assemble(scene)).values)) < 1e-14
        assert mbdlft.to_lft(scene, search=0.0).certificate.max_relative_error < 1e-11
