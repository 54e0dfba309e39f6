"""What is said of composed systems: evidence, names, ranges, blocks of other kinds, archives."""

import tomllib
from dataclasses import replace
from pathlib import Path

import control
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import mbdlft
from mbdlft import (
    LFT,
    ArchiveError,
    ComplexBlock,
    FullBlock,
    LFTModel,
    Parameter,
    System,
    append,
    as_system,
    connect,
    feedback,
    invert_channels,
    low_pass,
    matrices_at,
    realize,
    series,
    state_space,
)
from mbdlft.lft.lft import delta
from mbdlft.system import evidence, lft
from tests.close import CLOSED_FORM, exact, roundoff, target
from tests.errors.table import says
from tests.extracted import lower_bound
from tests.laws.test_systems import ARM, CART, CONTROLLER, ONE, SPRING, points
from tests.scenarios.commands import Output

GAIN = np.array([[120.0, 0.0], [0.0, 60.0]])


def whole(model: System, values: dict[str, object]) -> np.ndarray:
    A, B, C, D = matrices_at(model, values)
    return np.block([[A, B], [C, D]])


# evidence -----------------------------------------------------------------------------------------


def test_a_loop_of_certified_models_is_certified() -> None:
    loop = feedback(ARM, series(state_space(-30.0 * np.eye(2), GAIN, 30.0 * np.eye(2), 0.0), 1.0))
    assert isinstance(loop, LFTModel)
    c = loop.certificate
    assert c.exact
    assert c.order == tuple(size for _, size in loop.lft.blocks) == ARM.certificate.order
    assert c.lower_bound == tuple(lower_bound(loop.lft).values())
    assert 0.0 < ARM.certificate.max_relative_error <= c.max_relative_error < CLOSED_FORM
    assert c.condition == 0.0
    target(mbdlft.trim_at(loop, {"theta1": 60.0}), mbdlft.trim_at(ARM, {"theta1": 60.0}), 0.0)


def test_the_error_of_a_part_is_carried_through_the_loop() -> None:
    """The whole may be as wrong as a part moved by what its certificate allows makes it."""
    error = 1e-6
    doubtful = replace(CART, certificate=replace(CART.certificate, max_relative_error=error))
    moved = replace(
        CART,
        lft=LFT(CART.lft.M11, CART.lft.M12, CART.lft.M21, (1 + error) * CART.lft.M22, CART.lft.blocks),
    )
    at = points(CART, 20)
    found, wrong = (whole(feedback(part, CONTROLLER), at) for part in (CART, moved))
    size = np.max(np.abs(found), axis=0)
    change = np.max(np.abs(found - wrong)[:, size > 0] / size[size > 0])
    carried = feedback(doubtful, CONTROLLER).certificate.max_relative_error
    assert 0.1 * error < change < carried < 100 * error
    assert feedback(CART, CONTROLLER).certificate.max_relative_error < CLOSED_FORM


def test_a_whole_has_the_largest_ratio_of_its_parts_and_its_own() -> None:
    parts = [replace(CART, certificate=replace(CART.certificate, rounding_ratio=r)) for r in (0.0, 50.0)]
    own, of_part = (feedback(part, CONTROLLER).certificate.rounding_ratio for part in parts)
    assert 0.0 < own < of_part == 50.0


def test_a_whole_that_is_wrong_by_little_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """One entry of a loop is wrong by 1e-9 of itself."""

    def wrong(*asked: object) -> LFT:
        a = right(*asked)
        moved = np.ones(a.shape)
        moved[-1, 0] += 1e-9
        if a.order:
            return replace(a, M21=moved[:, :1] * a.M21, M22=moved[:, :1] * a.M22)
        return replace(a, M22=moved * a.M22)

    feedback(CART, CONTROLLER)
    right = evidence.wire
    monkeypatch.setattr(evidence, "wire", wrong)
    with pytest.raises(mbdlft.AnalysisError, match="times what rounding"):
        feedback(CART, CONTROLLER)


def test_a_reduction_that_loses_a_direction_is_left_out() -> None:
    """In doubles it does, of ranges far to one side: the result has more channels, and the values."""
    ranges = [
        Parameter("p", 1.25, low=0.9, high=1.25 * (1.0 + 3e-8)),
        Parameter("q", 2.5, low=1.25, high=2.5e6),
    ]
    matrix = [["q/p", "(p - 1.4)/(2 + p)"], ["0", "p^2/(p + 1)"]]
    model = realize(matrix, ranges, inputs=["a", "b"], outputs=["c", "d"], search=0.0)
    found = -model
    at = mbdlft.corners(model.parameters)
    target(matrices_at(found, at).D, -matrices_at(model, at).D, CLOSED_FORM)
    assert max(found.certificate.order) <= max(found.certificate.raw_order)
    assert found.certificate.rounding_ratio < 10.0


def test_a_system_without_evidence_gives_none() -> None:
    bare = System(CART.name, CART.lft, CART.states, CART.inputs, CART.outputs, CART.parameters)
    assert type(feedback(bare, CONTROLLER)) is System
    assert type(feedback(CART, CONTROLLER)) is LFTModel
    assert type(as_system(ONE) * 2.0) is System
    assert type(append(bare, SPRING)) is System


def test_what_cancels_is_not_taken_for_structure() -> None:
    """0.1 + 0.2 - 0.3 of one function, and a model times its inverse: what is left is rounding."""
    k = CART.parameters["k"]
    three = [
        mbdlft.realize([["1/(k+1)"]], [k], name=n, inputs=[f"{n}.u"], outputs=[f"{n}.y"]) for n in "abc"
    ]
    none = np.array([[0.1, 0.2, -0.3]]) @ append(*three) @ np.ones((3, 1))
    model = mbdlft.realize([["k", "1"], ["2", "k^2"]], [k], inputs=["a", "b"], outputs=["a", "b"])
    unit = invert_channels(model, ["a", "b"]) * model
    for found in (none, unit):
        assert found.order == 0
        assert found.certificate.lower_bound == (0,)
    target(unit.D_yu, np.eye(2), CLOSED_FORM)
    both = append(CART * uncertain(), SPRING)
    assert both.certificate.lower_bound == (2, 2, 2)


def test_gains_of_a_system_without_evidence() -> None:
    bare = System(CART.name, CART.lft, CART.states, CART.inputs, CART.outputs, CART.parameters)
    found = mbdlft.tunable(bare, ["k"])
    assert type(found.plant) is System
    exact(found.plant.lft.M22, mbdlft.tunable(CART, ["k"]).plant.lft.M22)


def test_a_truncated_part_leaves_no_guarantee() -> None:
    small = replace(CART, certificate=replace(CART.certificate, exact=False, truncation_error=0.01))
    loop = feedback(small, CONTROLLER)
    assert not loop.certificate.exact
    assert loop.certificate.truncation_error == np.inf
    fitted = replace(CART, certificate=replace(CART.certificate, exact=False, fit_error_bound=1e-4))
    found = append(fitted, SPRING).certificate
    assert not found.exact
    assert (found.fit_error_bound, found.truncation_error) == (1e-4, 0.0)


def test_provenance_is_toml_of_the_operation_and_the_texts() -> None:
    loop = feedback(CART, CONTROLLER, sign=1)
    text = tomllib.loads(loop.provenance.scene)
    assert (text["operation"], text["sign"]) == ("feedback", 1)
    assert [part["name"] for part in text["parts"]] == ["cart", "controller"]
    assert mbdlft.matrix_from_toml(text["parts"][0]["text"]).name == "cart"
    nested = tomllib.loads(append(loop, SPRING).provenance.scene)["parts"][0]["text"]
    assert tomllib.loads(nested) == text


def test_trims_of_two_models_stand_side_by_side() -> None:
    other = as_system(
        replace(ARM, name="other"),
        inputs={s.name: f"other.{s.name}" for s in ARM.inputs},
        outputs={s.name: f"other.{s.name}" for s in ARM.outputs},
    )
    both = append(ARM, other)
    assert both.trim.signals[0].name == f"{ARM.name}.{ARM.trim.signals[0].name}"
    alone = mbdlft.trim_at(ARM, {"theta2": 100.0})
    target(mbdlft.trim_at(both, {"theta2": 100.0}), np.concatenate([alone, alone]), CLOSED_FORM)
    exact(both.trim.nominal, [*ARM.trim.nominal, *ARM.trim.nominal])
    assert both.certificate.raw_order == tuple(2 * n for n in ARM.certificate.raw_order)
    assert both.states[0].name == f"{ARM.name}.{ARM.states[0].name}"
    assert len({s.name for s in both.states}) == 2 * len(ARM.states)


def test_repetitions_that_cancel_go() -> None:
    """The states of both parts keep their repetitions; what only outputs see goes."""
    assert (SPRING - SPRING).order <= 2 * SPRING.order
    static = mbdlft.realize([["k"]], [CART.parameters["k"]], name="k")
    assert (static - static).order == 0
    assert (static - static).certificate.order == (0,)


# names --------------------------------------------------------------------------------------------


def test_selection_by_names_numbers_and_slices() -> None:
    for key in (
        ("load", "gust"),
        (["load"], ["gust"]),
        (1, -1),
        (slice("load", None), slice(1, 2)),
        ("load", slice("gust", "gust")),
    ):
        one = CART[key]
        assert [s.name for s in (*one.inputs, *one.outputs)] == ["gust", "load"]
        exact(one.D_yu, CART.D_yu[1:, 1:])
        assert one.states == CART.states
    turned = CART[["load", "position"], :]
    exact(turned.C_y, CART.C_y[::-1])


def test_names_join_a_loop_partly() -> None:
    inner = as_system(ONE, inputs=["position"], outputs=["gust"])
    loop = feedback(CART, inner)
    expected = connect(
        [CART, inner],
        [["cart.gust", "gust_free", "-one.gust"], ["one.position", "cart.position"]],
        inputs=["force", "gust_free"],
        outputs=["position", "load"],
    )
    at = {"k": 50.0, "m": 3.2}
    target(whole(loop, at), whole(expected, at), CLOSED_FORM)


def test_equal_names_are_joined_without_connections() -> None:
    driver = as_system(ONE, outputs=["force"])
    found = connect([driver, CART], inputs=["y", "gust"], outputs=["position", "force"]).at(k=33.0)
    G = found(3.0j)
    target(G[0, 0], (CART["position", "force"] * driver).at(k=33.0)(3.0j), CLOSED_FORM)
    target(G[1, 0], ONE(3.0j), CLOSED_FORM)


def test_numbers_and_matrices_on_either_side() -> None:
    at = {"k": 52.0, "m": 2.9}
    _, B, C, D = matrices_at(CART, at)
    T = np.array([[1.0, 2.0]])
    roundoff(matrices_at(3.0 * CART, at).D, 3.0 * D)
    roundoff(matrices_at(CART * 3.0, at).B, 3.0 * B)
    roundoff(matrices_at(T @ CART, at).C, T @ C)
    roundoff(matrices_at(CART @ T.T, at).D, D @ T.T)
    roundoff(matrices_at(CART + 2.0, at).D, D + 2.0)
    roundoff(matrices_at(1.0 - CART, at).D, 1.0 - D)
    roundoff(matrices_at(-CART, at).C, -C)
    roundoff(matrices_at(np.eye(2) + CART, at).D, np.eye(2) + D)
    exact(matrices_at(CART - control.ss([], [], [], D), {}).A, CART.A)
    assert [s.name for s in (3.0 * CART).outputs] == ["position", "load"]
    assert [s.name for s in (CART @ T.T).inputs] == ["u0"]
    target(whole(feedback(CART, 2.0), at), whole(feedback(CART, 2.0 * np.eye(2)), at), 0.0)
    loop = feedback(1.0, CART)  # a number in front of a model: u - y
    roundoff(matrices_at(loop, at).D, np.linalg.inv(np.eye(2) + D))


def test_parameters_by_name() -> None:
    assert CART.parameters["k"] is CART.parameters[0]
    assert CART.parameters.names == ("k", "m")
    assert CART.parameters == tuple(CART.parameters)
    assert type(CART.parameters[:1]) is tuple
    exact(CART.at({"m": 3}).A, CART.at(m=3).A)
    exact(CART.at({"m": 3.1}, k=31.0).A, CART.at(m=3.1, k=31.0).A)


# ranges -------------------------------------------------------------------------------------------


@settings(max_examples=30, deadline=None)
@given(st.floats(0.0, 0.9), st.floats(0.1, 1.0), st.integers(0, 1000))
def test_another_range_is_the_same_model(low: float, width: float, seed: int) -> None:
    k = CART.parameters["k"]
    new = (k.low + low * (k.high - k.low), 0.0)
    new = (new[0], new[0] + width * (k.high - new[0]))
    model = CART.with_range(k=new)
    assert model.lft.blocks == CART.lft.blocks
    p = model.parameters["k"]
    assert (p.low, p.high) == new
    random = np.random.default_rng(seed)
    at = {"k": np.append(random.uniform(*new, 5), new), "m": np.array([2.6])}
    target(whole(model, at), whole(CART, at), CLOSED_FORM)
    c = model.certificate
    assert (c.lower_bound, c.order, c.exact) == (
        CART.certificate.lower_bound,
        CART.certificate.order,
        True,
    )
    assert CART.certificate.max_relative_error <= c.max_relative_error < CLOSED_FORM
    exact(whole(model, {}), whole(model, {"k": p.nominal}))


def test_an_error_counts_more_in_a_range_of_smaller_entries() -> None:
    """k/m is half as large where k is; without the old nominal, the middle is taken."""
    error = 1e-6
    doubtful = replace(CART, certificate=replace(CART.certificate, max_relative_error=error))
    narrow = doubtful.with_range(k=(30.0, 30.5))
    assert 1.5 * error < narrow.certificate.max_relative_error < 3.0 * error
    exact(narrow.parameters["k"].nominal, 30.25)
    exact(CART.with_range(k=(30.0, 50.0)).parameters["k"].nominal, 40.0)


def test_ranges_of_angles_move_the_trim() -> None:
    model = ARM.with_range({"theta1": (60.0, 80.0, 85.0)}, m3=(4.5, 5.0))
    target(
        model.trim.nominal,
        mbdlft.trim_at(ARM, {"theta1": 80.0, "m3": model.parameters["m3"].nominal}),
        CLOSED_FORM,
    )
    at = {"theta1": 61.0, "m3": 4.6, "theta2": 120.0}
    target(whole(model, at), whole(ARM, at), CLOSED_FORM)
    target(mbdlft.trim_at(model, at), mbdlft.trim_at(ARM, at), CLOSED_FORM)


# blocks of other kinds ----------------------------------------------------------------------------


def uncertain() -> System:
    """A multiplicative uncertainty 1 + 0.3 Delta of two channels, Delta a full block."""
    return as_system(0.3 * np.eye(2) @ delta(FullBlock("D", 2)) + np.eye(2), name="uncertain")


def test_uncertainty_survives() -> None:
    loop = feedback(CART * uncertain(), CONTROLLER)
    assert isinstance(loop, LFTModel)
    assert [b.kind for b in loop.lft.blocks] == ["full", "real", "real"]
    Delta = np.array([[0.3, 0.4j], [-0.2, 0.5]])
    values = {"D": Delta, "k": 35.0}
    A, B, C, D = matrices_at(CART, {"k": 35.0})
    factor = np.eye(2) + 0.3 * Delta
    expected = feedback(state_space(A, B @ factor, C, D @ factor), CONTROLLER)
    roundoff(whole(loop, values), whole(expected, {}), 1e2)
    target(whole(loop, {"k": 35.0}), whole(feedback(CART, CONTROLLER), {"k": 35.0}), CLOSED_FORM)
    many = whole(loop, {"D": np.stack([Delta, 0 * Delta]), "k": 35.0})
    roundoff(many[0], whole(loop, values), 1e2)
    assert loop.certificate.order == tuple(s for n, s in loop.lft.blocks if n != "D")
    roundoff(whole(loop.with_range(k=(31.0, 38.0)), values), whole(loop, values), 1e3)


def test_complex_deltas_add_up_and_are_reduced() -> None:
    part = as_system(delta(ComplexBlock("c", 1)), name="c")
    both = append(part, as_system(part, inputs=["v"], outputs=["w"]))
    assert both.lft.blocks == (ComplexBlock("c", 2),)
    exact(whole(both, {"c": 0.5j}), 0.5j * np.eye(2))
    assert (part - part).order == 0


def test_complex_entries_are_kept() -> None:
    rotor = state_space([[-1.0 + 5.0j]], [[1.0]], [[1.0]], 0.0, name="rotor")
    loop = feedback(rotor, 2.0)
    exact(loop.A, [[-3.0 + 5.0j]])
    with says(mbdlft.StructureError, "its matrices are complex there, which python-control does"):
        loop.at()
    mixed = CART["position", "force"] * rotor
    found = whole(mixed, {"k": 41.0})
    assert np.iscomplexobj(found)
    roundoff(found[1:, :1], np.vstack([CART.at(k=41.0).B[:, :1], [[0.0]]]), 10)
    roundoff(found[:1, :1], np.array([[-1.0 + 5.0j]]))


def test_the_star_product_by_counts_is_that_by_names() -> None:
    by_name = lft(CART, SPRING, outputs=["load"], inputs=["gust"])
    by_count = lft(CART, SPRING, 1, 1)
    by_default = lft(CART, SPRING)
    for other in (by_count, by_default):
        exact(whole(other, {"k": 44.0}), whole(by_name, {"k": 44.0}))


def test_the_star_product_is_its_closed_form() -> None:
    """[a ; b] = U [c ; d], [d ; e] = L [b ; f], with b and d of size 1."""
    U, L = np.random.default_rng(3).standard_normal((2, 3, 3))
    upper = as_system(U, inputs=["c1", "c2", "d"], outputs=["a1", "a2", "b"])
    lower = as_system(L, inputs=["of_b", "f1", "f2"], outputs=["of_d", "e1", "e2"])
    loop = 1.0 - U[2, 2] * L[0, 0]
    of_b = np.concatenate([U[2, :2], U[2, 2] * L[0, 1:]]) / loop
    of_d = L[0, 0] * of_b + np.concatenate([np.zeros(2), L[0, 1:]])
    a = np.outer(U[:2, 2], of_d) + np.hstack([U[:2, :2], np.zeros((2, 2))])
    e = np.outer(L[1:, 0], of_b) + np.hstack([np.zeros((2, 2)), L[1:, 1:]])
    target(lft(upper, lower, 1, 1).D_yu, np.vstack([a, e]), CLOSED_FORM)


# archives -----------------------------------------------------------------------------------------


def test_the_command_line_says_that_no_bound_holds(tmp_path: Path, output: Output) -> None:
    certificate = replace(CART.certificate, exact=False, truncation_error=0.01)
    mbdlft.save(tmp_path / "a.h5", feedback(replace(CART, certificate=certificate), CONTROLLER))
    shown = " ".join(output("show", str(tmp_path / "a.h5")).split())
    assert "not exact: a part of it is truncated, and no bound of the error holds" in shown


def test_what_an_archive_does_not_hold(tmp_path: Path) -> None:
    file = tmp_path / "a.h5"
    rotor = state_space([[-1.0 + 5.0j]], [[1.0]], [[1.0]], 0.0)
    with says(ArchiveError, "has an entry that is complex, and archives hold real entries"):
        mbdlft.save(file, CART["position", "force"] * rotor)
    assert not file.exists()


# What operations on models say of their results: errors and channels of all parts are counted -------

K = Parameter("k", 40.0, low=30.0, high=60.0)
WRONG = 1e-3  # far above rounding


def with_error(model: LFTModel) -> LFTModel:
    return replace(model, certificate=replace(model.certificate, max_relative_error=WRONG))


def test_series_counts_channels_and_errors_of_both() -> None:
    plant = realize([["-k", "1"], ["1", "0"]], [K], states=1, inputs=["u"], outputs=["y"])
    filter_ = low_pass("0.1*k", parameters=[K])
    found = series(plant, "u", filter_).certificate
    raw = [np.sum(each.certificate.raw_order) for each in (plant, filter_)]
    assert min(raw) > 0
    assert np.sum(found.raw_order) == np.sum(raw)
    for parts in ((with_error(plant), filter_), (plant, with_error(filter_))):
        assert series(parts[0], "u", parts[1]).certificate.max_relative_error >= WRONG


def test_inversion_keeps_the_error_of_the_model() -> None:
    model = realize([["k", "1"], ["2", "3 + k"]], [K], inputs=["a.u", "b.u"], outputs=["a.y", "b.y"])
    found = invert_channels(with_error(model), ["a"]).certificate
    assert found.max_relative_error >= WRONG
