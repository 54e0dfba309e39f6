"""The certificate is small for exact models, refuses wrong ones, and never compares rounding."""

import re
from collections.abc import Callable, Iterable
from dataclasses import replace
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mbdlft
from mbdlft import Inertia, Parameter, RigidBody, Scene, Spin
from mbdlft.base.samples import check_points
from mbdlft.lft.lft import LFT, delta
from mbdlft.lft.sparse import SparseLFT
from mbdlft.matrix.relations import matrix_problem, problem_of_matrix
from mbdlft.multibody.assembly import assemble
from mbdlft.multibody.to_problem import choose_signals, problem_of_scene
from mbdlft.order.reduction import in_scales
from mbdlft.pipeline import certification, forms, stages
from mbdlft.pipeline.certification import MOST_ROUNDINGS, Checked, certificate, values_at_points
from mbdlft.pipeline.models import build, exact_lower_bound
from mbdlft.pipeline.stages import DROPPED, _Check
from mbdlft.problem.linearization import relinearize
from mbdlft.problem.references import entry_sizes
from mbdlft.problem.relations import Problem
from mbdlft.problem.sx.tapes import term_sizes
from mbdlft.show.report.sentences import checked_beside
from scenarios import two_link_arm
from tests import kit
from tests.attack import frames
from tests.close import CLOSED_FORM, SAME_MESH, SCENARIO, roundoff, target


def pan_tilt(offset: float) -> mbdlft.Scene:
    """Pan about the vertical carries no torque: its trim is zero by cancellation."""
    return kit.scene(
        "pan_tilt",
        mbdlft.Angle("tilt", 0, -60, 60),
        kit.body("yoke", 1, zz=0.01),
        kit.body("camera", 2, (0.004, 0.009, 0.008), center_of_mass=(0.04, offset, 0)),
        kit.hinge("pan", "ground", "yoke", (0, 0, 1)),
        kit.hinge("tilt", "yoke", "camera", (0, 1, 0), position="tilt"),
        gravity=(0, 0, -9.81),
    )


def error_of(problem: Problem, lft: LFT, trim: LFT) -> float:
    return _Check(problem).model(lft, trim)


def refused(scene: Scene, wrong: Iterable[Callable[[LFT], LFT]] = ()) -> mbdlft.LFTModel:
    """Its model, of which all of these changes are refused: planted bugs."""
    problem, model = problem_of_scene(scene), mbdlft.to_lft(scene, search=0.0)
    for change in wrong:
        with pytest.raises(mbdlft.AnalysisError, match="Two derivations contradict each other"):
            error_of(problem, change(model.lft), model.trim.lft)
    return model


def times(a: LFT, gain: np.ndarray) -> LFT:
    """With factors of the inputs."""
    return LFT(a.M11, a.M12 * gain, a.M21, a.M22 * gain, a.blocks)


def nozzle() -> mbdlft.Scene:
    """A cart under a thrust that a given force balances: its nozzle moves it by its angle alone."""
    held = {"preload": 0.0}
    return kit.scene(
        "nozzle",
        Parameter("m", 2.0, percent=20, unit="kg"),
        Parameter("F", 5.0, percent=30, unit="N"),
        kit.point("slide", 1.0),
        kit.body("cart", "m", (1.0, 1.0, 1.0)),
        kit.body("nozzle", 0.5, (0.2, 0.3, 0.2)),
        kit.rail("up", "ground", "slide", (0, 0, 1), **held),
        kit.rail("aside", "slide", "cart", (1, 0, 0), **held),
        kit.hinge("hinge", "cart", "nozzle", (0, 1, 0), **held),
        kit.force("thrust", "nozzle", (0, 0, 1)),
        kit.force("drag", "cart", (0, 0, -1), frame="ground", magnitude="F"),
        inputs=["hinge.torque"],
        outputs=["aside.position"],
        states="needed",
    )


def test_a_state_that_is_seen_through_an_unknown_load_only() -> None:
    """The fourth derivative of the place is the thrust over the masses, times torque over inertia."""
    model = mbdlft.to_lft(nozzle(), search=0.0)
    assert len(model.states) == 4
    for m, F in ((1.7, 4.0), (2.4, 6.0)):
        plant = model.at(m=m, F=F)
        response = plant.C @ np.linalg.matrix_power(plant.A, 3) @ plant.B
        target(response, [[F / (m + 0.5) / 0.3]], CLOSED_FORM)


def rolling_ball() -> mbdlft.Scene:
    """8 repetitions become 7 by a search."""
    return mbdlft.load_scene("scenarios/ball_turntable.toml")


def test_what_a_search_makes_with_lost_digits_is_not_used(monkeypatch: pytest.MonkeyPatch) -> None:
    """A planted search: one repetition less, and a billionth off."""
    right = stages._smallest

    def lossy(*arguments: Any) -> Any:
        found = right(*arguments)
        a = next(iter(found.lfts))
        return found._replace(lfts=(LFT(a.M11, a.M12, (1.0 + 1e-9) * a.M21, a.M22, a.blocks),))

    monkeypatch.setattr(stages, "_smallest", lossy)
    model = mbdlft.to_lft(rolling_ball())
    assert (model.order, model.certificate.order_bound) == (8, 7)
    assert model.certificate.max_relative_error <= SCENARIO

    def lossy_at_last(*arguments: Any) -> Any:
        found = right(*arguments)
        a, *others = found.lfts
        longer = LFT(a.M11, a.M12, 2.0 * a.M21, a.M22, a.blocks)
        return found._replace(lfts=(longer, a, *others))

    monkeypatch.setattr(stages, "_smallest", lossy_at_last)  # the one on the way to it is right
    assert mbdlft.to_lft(rolling_ball()).order == 7
    monkeypatch.setattr(stages, "_smallest", lossy)
    monkeypatch.setattr(stages, "_loses_digits", lambda *_: False)
    assert mbdlft.to_lft(rolling_ball()).order == 8  # the check of the certificate refuses it, too


@pytest.mark.parametrize("factor", [1e3, 2.0])
def test_a_singular_result_of_a_search_is_dropped(factor: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """The model before it stands, and a stage says why."""
    right = stages._smallest

    def singular(*arguments: Any) -> Any:
        smaller = right(*arguments)
        a = next(iter(smaller.lfts))
        return smaller._replace(lfts=(LFT(factor * a.M11, a.M12, a.M21, a.M22, a.blocks),))

    monkeypatch.setattr(stages, "_smallest", singular)
    said = list[str]()
    model = build(rolling_ball(), search=1.0, progress=said.append).model
    assert model.order == 8
    assert [stage for stage in said if stage.startswith(f"{DROPPED} (order 7: ")]


def test_a_frame_under_loads_that_is_sparse(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each displacement has a copy of the trim, and the bound is that of the dense model."""
    frame = frames.scene_of(frames.structure(0))
    dense = mbdlft.to_lft(frame, search=0.0)
    monkeypatch.setattr(forms, "_MOST_EXACT", 10)
    model = mbdlft.to_lft(frame, search=0.0)
    assert isinstance(model.lft, SparseLFT)
    assert model.certificate.lower_bound == dense.certificate.lower_bound
    assert model.certificate.max_relative_error <= SAME_MESH


def test_a_matrix_that_is_sparse(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of the matrix as it is written; what is written as its transpose is left out."""
    rows, parameters = (
        [["p/q", "q*r"], ["p*q", "r/p + q"]],
        [mbdlft.Parameter(n, 2.0, percent=20) for n in "pqr"],
    )
    dense = mbdlft.realize(rows, parameters, search=0.0)
    monkeypatch.setattr(forms, "_MOST_EXACT", 3)
    model = mbdlft.realize(rows, parameters, search=0.0)
    assert isinstance(model.lft, SparseLFT)
    assert model.certificate.lower_bound == dense.certificate.lower_bound
    assert model.certificate.max_relative_error <= SCENARIO
    assert exact_lower_bound(matrix_problem(rows, parameters)) == dict(
        zip("pqr", dense.certificate.lower_bound, strict=True)
    )


@pytest.mark.parametrize("mass", [2.0, 1e6, 1e10])
def test_a_wrong_input_matrix_is_refused_whatever_its_size(mass: float) -> None:
    """B = 1/(m L^2) is tiny beside A for a large mass; three times too large is wrong all the same."""
    scene = kit.scene(
        "pendulum",
        mbdlft.Parameter("m", mass, percent=20, unit="kg"),
        kit.body("bob", "m", xx=0, center_of_mass=(0, 0, -1)),
        kit.hinge("pivot", "ground", "bob", (1, 0, 0)),
        gravity=(0, 0, -9.81),
    )
    model = refused(scene, [partial(times, gain=np.array([1.0, 1.0, 3.0]))])
    assert model.certificate.max_relative_error <= SCENARIO


def planted(a: LFT) -> LFT:
    wrong = a.M21.copy()
    wrong[np.unravel_index(np.argmax(np.abs(wrong)), wrong.shape)] *= 1.001
    return LFT(a.M11, a.M12, wrong, a.M22, a.blocks)


def test_sizes_of_terms_do_not_cancel() -> None:
    import casadi as ca

    x = ca.SX.sym("x", 2)
    terms = ca.vertcat(x[0] * x[1] - x[0] * x[1] * 3, x[0] / x[1] - 2 * x[0], x[0] + (x[1] - 4 * x[0]))
    function = ca.Function("f", [x], [terms])
    points = np.array([[2.0, -3.0], [-1.0, 0.5]])
    expected = np.array([[6.0 + 18.0, 2.0 / 3.0 + 4.0, 13.0], [0.5 + 1.5, 2.0 + 2.0, 5.5]])
    roundoff(term_sizes(function, points), expected)
    y = ca.SX.sym("y", 2)
    of_two = ca.Function("f", [x[0], y], [y[1] - x[0] * y[0]])
    roundoff(term_sizes(of_two, points[:, :1], points)[:, 0], [3.0 + 4.0, 0.5 + 1.0])


def test_a_singularity_that_does_not_change_the_sign_is_found() -> None:
    """Two rails at an angle theta: det M = m^2 sin(theta)^2 is zero at theta = 0 only."""
    scene = kit.scene(
        "rails",
        mbdlft.Angle("theta", 5.0, -30.0, 40.0),
        kit.body("first", 0.0),
        kit.body("turned", 0.0),
        kit.point("second", 1.0),
        kit.rail("a", "ground", "first", (1, 0, 0)),
        kit.weld("t", "first", "turned", (0, 0, 1), position="theta"),
        kit.rail("b", "turned", "second", (1, 0, 0)),
    )
    with pytest.raises(mbdlft.WellPosednessError, match="the model is singular"):
        mbdlft.to_lft(scene, search=0.0)


AB = [mbdlft.Parameter(name, 0.0, low=-1.0, high=1.0) for name in "ab"]


def test_a_bound_that_the_model_contradicts_is_not_claimed() -> None:
    """A model with fewer repetitions than a bound shows that one of both is wrong."""
    lft = delta("a", 1) + delta("b", 1)
    problem = problem_of_matrix(mbdlft.matrix_problem([["a + b"]], AB))

    def claimed(degrees: dict[str, int], order_bound: int) -> mbdlft.Certificate:
        return certificate(
            lft,
            dict(lft.blocks),
            degrees,
            order_bound,
            problem,
            Checked(0.0, 1, 0.0, (), (), 1.0, 0, 0.0),
            0,
            boxes=(),
        )

    honest = claimed({"a": 1, "b": 1}, 2)
    assert honest.minimal
    assert honest.doubtful == (0, 0)
    together = claimed({"a": 0, "b": 1}, 3)
    assert (together.lower_bound, together.order_bound, together.minimal) == ((0, 1), 1, False)
    wrong = claimed({"a": 2, "b": 1}, 3)
    assert (wrong.lower_bound, wrong.order_bound, wrong.doubtful) == ((0, 1), 1, (1, 0))


def test_a_pole_between_nominal_and_a_point_is_found() -> None:
    """1/(1 + 2 delta) has other signs on both sides of its pole."""
    one = np.ones((1, 1))
    lft = LFT(-2.0 * one, one, one, one, (("a", 1),))
    nouns = problem_of_matrix(mbdlft.matrix_problem([["a"]], AB[:1])).nouns
    values_at_points(lft, AB[:1], np.array([[-0.4], [1.0]]), nouns)
    with pytest.raises(mbdlft.WellPosednessError, match=r"between the nominal values and a = -0\.6"):
        values_at_points(lft, AB[:1], np.array([[-0.4], [-0.6]]), nouns)


# rows and columns that are nothing but rounding ------------------------------------------------

BLOCK = kit.body(
    "block",
    "m",
    (0.31, 0.42, 0.53),
    xy=0.04,
    xz=0.03,
    yz=-0.02,
    center_of_mass=(0.11, 0.23, -0.37),
    ports={"tip": (0.3, -0.7, 0.1)},
)
WEIGHT = (mbdlft.Parameter("m", 2.0, percent=30, unit="kg"),)


THETA = mbdlft.Angle("theta", 20.0, plus=40.0)
SKEW = (2.0, -3.0, 5.0)


def unloaded() -> Scene:
    """The wrench of a free joint is zero, the sum of what two bodies need."""
    tilt = kit.turn((1.0, 2.0, 3.0), 0.7)
    return kit.scene(
        "free",
        *WEIGHT,
        THETA,
        BLOCK,
        BLOCK.model_copy(update={"name": "other"}),
        kit.free("base", "ground", "block.tip", orientation=(tilt,)),
        kit.hinge("pivot", "block", "other.tip", SKEW, position="theta", stiffness=3.0, preload=0.0),
        mbdlft.JointWrench(name="held", joint="base"),
    )


def along_an_axis() -> Scene:
    """A weight along the axis of a pivot: its torque is rounding, and so is all it does."""
    return kit.scene(
        "across",
        *WEIGHT,
        THETA,
        BLOCK,
        kit.hinge("pivot", "ground", "block", SKEW, position="theta"),
        mbdlft.Buoyancy(name="float", port="block.tip", displaced_mass=0.5),
        gravity=(-2.0, 3.0, -5.0),
    )


# Entries that are exactly zero: their rounding does not refuse a right model, nor accept a wrong ----

M = Parameter("m", 2.0, percent=50, unit="kg")
RATE = Parameter("rate", 2.0, percent=50, unit="rad/s")


def balanced_boom() -> Scene:
    """Without gravity the stiffness of a turning boom is W^2 m L^2 cos(2 th): zero at 45 degrees."""
    return kit.scene(
        "boom",
        M,
        RATE,
        kit.point("tip", "m", ports={"root": (-0.7, 0, 0)}),
        kit.hinge("j", "ground", "tip.root", (0, 1, 0), position="45*deg"),
        spin=Spin(axis=(0, 0, 1), rate="rate"),
    )


def driven_rail() -> Scene:
    """The acceleration of the rail is imposed, so nothing else drives it; solving mixes the rows."""
    arm = {"mass": 1.0, "center_of_mass": (0.1, 0.3, 0.2)}
    inertia = Inertia(xx=0.3, yy=0.4, zz=0.5, xy=0.1, xz=0.05, yz=-0.07)
    return kit.scene(
        "rail",
        M,
        RATE,
        RigidBody(name="a", **arm, inertia=inertia, ports={"tip": (0.2, 0.5, 0.1)}),
        RigidBody(name="b", **arm, inertia=inertia, ports={"tip": (0.2, 0.5, 0.1)}),
        kit.body("c", "m", center_of_mass=(0.3, 0.1, -0.2), inertia=inertia),
        kit.ball("ball", "ground", "a", imposed=True),
        kit.rail("rail", "a.tip", "b", (3, 1, 2), imposed=True),
        kit.hinge("j", "b.tip", "c", (1, -2, 1), stiffness=30.0),
        spin=Spin(axis=(1, 2, 3), rate="rate"),
    )


ZEROS = [unloaded, along_an_axis, balanced_boom, driven_rail]
ZEROS += [partial(pan_tilt, offset) for offset in (0.0, 0.015, 0.1, 1.0)]


@pytest.mark.parametrize("make", ZEROS)
def test_rounding_of_zero_does_not_refuse_a_model(make) -> None:
    assert mbdlft.to_lft(make(), search=0.0).certificate.max_relative_error <= SCENARIO


def test_what_is_compared_with_its_terms_is_listed(tmp_path: Path) -> None:
    """The stiffness of the boom is exactly zero; rounding in its place has no size of its own."""
    scene = balanced_boom()
    model = mbdlft.to_lft(scene, search=0.0)
    assert model.certificate.by_terms == ()  # zero in 50 digits, and in the model
    rounded = model.lft.M22.copy()
    rounded[1, 0] = 1e-17
    lft = replace(model.lft, M22=rounded)
    found = _Check(problem_of_scene(scene)).model(lft, model.trim.lft)
    assert found.by_terms == ((1, 0),)
    assert found.error <= SCENARIO
    model = replace(model, certificate=replace(model.certificate, by_terms=found.by_terms))
    mbdlft.save(tmp_path / "a.h5", model)
    assert mbdlft.load(tmp_path / "a.h5").certificate == model.certificate
    said = " ".join(str(part) for part in checked_beside(model))
    assert "and compared with these: dj.rate/dt by j.angle" in said


def test_sizes_of_entries_stay_up_when_these_cancel() -> None:
    scene = balanced_boom()
    equations = assemble(scene)
    signals = choose_signals(scene, equations)
    at = relinearize(equations, *signals, check_points(equations.parameters, 0))
    sizes = entry_sizes(equations, *signals, at)
    reference = np.max(np.abs(at.linear.matrices), axis=0)
    assert reference[1, 0] < SCENARIO < sizes[1, 0]
    assert np.all(sizes >= (1.0 - SCENARIO) * reference)


@pytest.mark.parametrize("make", [balanced_boom, driven_rail])
def test_a_wrong_model_is_refused_all_the_same(make) -> None:
    """Planted bugs: each column of the model off by a thousandth."""
    right = refused(make()).lft.M22
    gains = 1.0 + 1e-3 * np.eye(right.shape[1])[np.max(np.abs(right), axis=0) > SCENARIO]
    assert len(gains)
    refused(make(), [partial(times, gain=gain) for gain in gains])


def test_a_stiffness_where_there_is_none_is_refused() -> None:
    """Planted bug: the balanced boom with a stiffness of a thousandth of the terms that cancel."""

    def stiffer(a: LFT) -> LFT:
        wrong = a.M22.copy()
        wrong[1, 0] += 1e-3
        return replace(a, M22=wrong)

    refused(balanced_boom(), [stiffer])


# errors that rounding does not explain -----------------------------------------------------------

# parallel channels of a that cancel but for a billionth: y = N(a)/D(a) of degree 2
NEARLY_PARALLEL = (
    "(a*(a*(15/2) - 3))",
    "(a*(a*(63/64000000000) + 35999999997/8000000000) - 3/2)",
    "(a*(a*(29999999973/8000000000) - 25499999999/1000000000) + 4)",
)
OVER = "(a*(a*(-21/32000000000) - 11999999999/4000000000) + 1)"


def nearly_parallel() -> mbdlft.LFTModel:
    rows = [[f"{text}/{OVER}"] for text in NEARLY_PARALLEL]
    return mbdlft.realize(rows, [Parameter("a", 0.06578, -0.0897, 0.299)], search=0.0)


def test_channels_that_nearly_cancel_keep_their_digits() -> None:
    """Companion coordinates of a lose nine digits of their value, balanced ones none."""
    model = nearly_parallel()
    assert (model.order, model.certificate.order_bound) == (2, 2)
    values = np.linspace(-0.0897, 0.299, 50)
    truth = [[float(_fraction(text, a) / _fraction(OVER, a)) for text in NEARLY_PARALLEL] for a in values]
    errors = np.abs(mbdlft.matrices_at(model, {"a": values})[3][:, :, 0] - truth)
    explained = MOST_ROUNDINGS * 2.2e-16 * model.certificate.condition
    assert np.max(errors / np.max(np.abs(truth), axis=0)) <= explained <= 1e-10
    assert model.certificate.rounding_ratio <= 0.1 * MOST_ROUNDINGS


def test_a_condition_sees_channels_that_cancel(monkeypatch: pytest.MonkeyPatch) -> None:
    """Planted bug: coordinates stay as they are. The error is then in the condition that is stated."""
    monkeypatch.setattr(forms, "in_good_coordinates", lambda a, *_: in_scales(a.rounded()))
    monkeypatch.setattr(certification, "ACCEPTED", 1.0)  # it is 1e-5, about
    certificate = nearly_parallel().certificate
    assert certificate.max_relative_error > 1e-9
    assert certificate.max_relative_error <= MOST_ROUNDINGS * 2.2e-16 * certificate.condition


def _fraction(text: str, a: float) -> Fraction:
    """A text of integers and a, exactly."""
    numbers = re.sub(r"\d+", lambda digits: f"F({digits.group()})", text)
    return Fraction(eval(numbers, {"F": Fraction, "a": Fraction(a)}))


def test_a_derivation_that_is_wrong_by_a_billionth_is_refused() -> None:
    """Planted bugs: a row of the LFT is wrong by 1e-9 of itself, and the reference is not."""
    gains = 1.0 + 1e-9 * np.eye(6)[:, :, None]
    rows = [lambda a, g=gain: replace(a, M21=g * a.M21, M22=g * a.M22) for gain in gains]
    model = refused(two_link_arm.scene(), rows)
    assert len(model.lft.M22) == len(gains)
    assert model.certificate.rounding_ratio <= 0.1 * MOST_ROUNDINGS


def test_a_model_whose_digits_are_gone_is_refused_and_no_bug() -> None:
    """At a = 0.5 it is wrong by half a percent in doubles."""
    a = mbdlft.Parameter("a", 0.55, low=0.5, high=0.6)
    with pytest.raises(mbdlft.AnalysisError, match=r"Rounding explains that: (?!.*bug)"):
        mbdlft.realize([["1/(a - 0.49999999999999)"]], [a], search=0.0)
