"""Laws of the search that uses commutation."""

import itertools
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import mbdlft
from benchmarks import ablation
from benchmarks.cases.chains import chain
from benchmarks.cases.orders import CASES
from mbdlft.base.errors import WellPosednessError
from mbdlft.base.running import one_thread
from mbdlft.lft.lft import LFT, Block, constant, delta, inverse, stack_columns, stack_rows
from mbdlft.lft.sampling import evaluate_at
from mbdlft.multibody.assembly import assemble
from mbdlft.multibody.to_problem import problem_of_scene
from mbdlft.order import search
from mbdlft.order.reduction import in_scales, reduce_exactly, reduce_order
from mbdlft.order.restriction import restricted_exactly
from mbdlft.order.search import Budget, Truth, find_smallest, is_same, part_of_either
from mbdlft.order.work import Work
from mbdlft.pipeline import stages
from mbdlft.pipeline.forms import candidates, closing
from mbdlft.problem.relations import linearize
from mbdlft.system.model import LFTModel
from tests.close import CLOSED_FORM, SCENARIO, roundoff, target
from tests.extracted import exactly, extracted, lower_bound
from tests.extracted import with_bits as with_bits
from tests.laws.lfts import lfts
from tests.laws.test_weights import forces_turned_on_the_way
from tests.seeds import some

# Laws of what results are compared with.


def relations(links: int, *, spatial: bool) -> LFT:
    """Of forces that turn on the way in: there is something left to find."""
    with forces_turned_on_the_way():
        equations = assemble(chain(links, spatial=spatial))
    return reduce_order(extracted(linearize(equations, range(links), range(links))))


def in_another_basis(a: LFT) -> LFT:
    """An LFT of equal value with a mass restricted."""
    restricted = restricted_exactly(reduce_exactly(exactly(a)), "m1", is_transposed=True)
    assert restricted is not None
    return in_scales(restricted.rounded())


def finishing(a: LFT, close: Callable[[LFT], LFT]) -> search._Level:
    return search._level_of_relations(a, close, None, search._Proof({}, a, None))


def test_wrong_when_closed_is_refused() -> None:
    """Right as an LFT, but what it becomes has another value."""
    a, right = relations(3, spatial=False), Work()

    def close(one: LFT) -> LFT:
        return one if one.order == a.order else 1.001 * np.eye(one.shape[0]) @ one

    moved = in_another_basis(a)
    assert moved.order != a.order
    for level, is_kept in ((finishing(a, close), False), (finishing(a, lambda one: one), True)):
        assert level.keeps(right, moved) == is_kept


def test_closed_relations_of_a_chain_are_kept() -> None:
    """Solving for accelerations makes no right result wrong."""
    scene = chain(3, spatial=False)
    problem = problem_of_scene(scene)
    (found,) = candidates(problem, problem.forms)
    a = found.relations
    level = finishing(a, closing(found.form))
    assert level.keeps(Work(), in_another_basis(a))


# Laws of the search that uses commutation.


@pytest.fixture(autouse=True)
def as_models_are_made() -> Iterator[None]:
    with one_thread():
        yield


WORK = 20.0  # far more than needed: all cases end at their bound


def smallest(plain: LFT, work: float = WORK) -> LFT:
    return find_smallest([plain], lower_bound(plain), Budget(work)).lft


def parameter(name: str, nominal: float) -> LFT:
    return constant([[nominal]]) + delta(name)


def power(a: LFT, exponent: int) -> LFT:
    return a if exponent == 1 else power(a, exponent - 1) @ a


def numbers(value: float) -> LFT:
    return constant([[value]])


def case(name: str) -> LFT:
    d1, d2, d3, d4, d5 = (parameter(f"d{k}", 0.3 + 0.1 * k) for k in range(1, 6))
    a, b, c = parameter("a", 0.4), parameter("b", 0.5), parameter("c", 0.6)
    if name == "O1":
        first = stack_columns(numbers(4.0) @ power(d1, 2) @ d3, numbers(3.0) @ d1, numbers(0.0))
        second = stack_columns(d3 @ d5, numbers(5.0) @ power(d2, 2) @ d4, d2 @ power(d4, 2))
        return stack_rows(first, second)
    if name == "O2":
        return power(1.0 + power(a, 2) + b @ a, 5) - power(1.0 + a + b, 3)
    if name == "O3":
        return stack_rows(d1 @ d2 @ d3, d2 @ d3 @ d1, d3 @ d1 @ d2)
    assert name == "O13"
    rows = (
        (5.0 * np.eye(1) @ a - 1.0, -10.0 * np.eye(1) @ (1.0 + b), 1.0 + b),
        (10.0 * np.eye(1) @ (1.0 + power(c, 2)), -1.0 - a @ b @ c, c),
        (numbers(1.0), numbers(1.0), numbers(0.0)),
    )
    return stack_rows(*(stack_columns(*row) for row in rows))


@given(lfts(2, 2, most=2, scales=(1.0,)), st.integers(0, 100))
def test_values_stay_and_the_order_does_not_grow(a: LFT, seed: int) -> None:
    plain = reduce_order(a)
    small = smallest(plain, 0.05)
    assert small.order <= plain.order
    points = np.random.default_rng(seed).uniform(-1, 1, (5, len(plain.blocks)))
    roundoff(evaluate_at(small, points), evaluate_at(plain, points), 1e6)


def test_no_work_changes_nothing() -> None:
    plain = reduce_order(case("O3"))
    assert smallest(plain, 0.0) is plain


@pytest.mark.parametrize(
    ("spatial", "links", "order"), some([(False, 2, 15), (False, 3, 30)], [(True, 2, 21)])
)
def test_minimal_orders_of_chains(spatial: bool, links: int, order: int) -> None:
    """Reached, and recognized as the smallest: the search then ends."""
    model = mbdlft.to_lft(chain(links, spatial=spatial), search=WORK)
    assert model.order == order == model.certificate.order_bound
    assert model.certificate.minimal
    assert model.certificate.max_relative_error <= CLOSED_FORM
    plain = mbdlft.to_lft(chain(links, spatial=spatial), search=0.0)
    inside = mbdlft.random(model.parameters, 1000, seed=9)
    outer = mbdlft.random(model.parameters, 300, seed=10)
    outer = {p.name: np.where(outer[p.name] > p.nominal, p.high, p.low) for p in model.parameters}
    values = {name: np.concatenate([inside[name], outer[name]]) for name in inside}
    for found, expected in zip(
        mbdlft.matrices_at(model, values), mbdlft.matrices_at(plain, values), strict=True
    ):
        target(found, expected, SCENARIO)


def test_forms_that_use_other_parameters() -> None:
    """Where terms cancel by commutation only, one form has a parameter that another has not."""
    text = "(a + b)*(c - b) - a*c + b*a - c*b + b*b + c*c*a"
    parameters = [mbdlft.Parameter(name, 0.5, 0.2, 0.9) for name in "abc"]
    model = mbdlft.realize([[text]], parameters)
    assert model.certificate.order == (1, 0, 2)
    assert model.certificate.minimal


def test_restrictions_find_the_least_order() -> None:
    """The mass of the lander stands eight times, and six times in a basis that depends on the height."""
    model = mbdlft.to_lft(mbdlft.load_scene("scenarios/lander.toml"), search=0.3)
    assert model.order == 19
    assert model.certificate.minimal


def test_singular_results_are_refused() -> None:
    """(p / p) H has the value of H where p is not zero, and p vanishes on the range."""
    plain = reduce_order(case("O3"))
    p = constant([[0.5]]) + delta("d1")
    singular = plain @ (inverse(p) @ p)
    level = search._level_of_closed(plain, None, search._Proof({}, plain, None))
    assert level.keeps(Work(), plain)
    assert not level.keeps(Work(), singular)


def searched(work: float = 1.0) -> LFTModel:
    """The first matrix of the literature; 8 of its 10 repetitions are left after the search."""
    return mbdlft.realize(CASES[0].problem(), search=work)


@pytest.mark.long
@pytest.mark.usefixtures("search_here")
def test_no_clock(monkeypatch: pytest.MonkeyPatch) -> None:
    """The same bits under a clock that runs as it likes; the search is done where the clock is."""
    quick = searched()
    assert quick.order == 8
    ticks = itertools.count()
    for clock in ("time", "monotonic", "perf_counter", "process_time", "thread_time"):
        monkeypatch.setattr(time, clock, lambda: 10.0 * next(ticks))
    slow = searched()
    assert quick.certificate.order_bound == slow.certificate.order_bound
    assert quick.lft.blocks == slow.lft.blocks
    for part in ("M11", "M12", "M21", "M22"):
        assert np.array_equal(getattr(quick.lft, part), getattr(slow.lft, part))


def test_budget() -> None:
    """A search does little more than its work, also where one look at all parameters is more."""
    for a in (relations(6, spatial=False), reduce_order(case("O2"))):
        for most in (0.02, 0.1):
            counted: list[Work] = []

            def count(*arguments: Any, counted: list[Work] = counted) -> Work:
                counted.append(Work(*arguments))
                return counted[-1]

            with pytest.MonkeyPatch.context() as patch:
                patch.setattr(search, "Work", count)
                find_smallest([a], dict.fromkeys((name for name, _ in a.blocks), 0), Budget(most))
            assert 0.0 < counted[0].spent < 1.5 * most + 0.3


def test_more_work_never_ends_above_less() -> None:
    """No step depends on the whole work, and the LFTs on the way are there, the smallest first."""
    plain = reduce_order(case("O3"))
    bound = dict.fromkeys((name for name, _ in plain.blocks), 0)
    results = [find_smallest([plain], bound, Budget(work)) for work in (0.0, 0.01, 0.02, 0.05)]
    orders = [result.lft.order for result in results]
    assert orders == sorted(orders, reverse=True)
    assert orders[-1] < orders[0] == plain.order
    assert results[-1].larger[-1] is plain


def test_a_limit_in_seconds_cuts_off() -> None:
    """It says so, and the result is one of the ways to write the model."""
    plain = reduce_order(case("O2"))
    bound = dict.fromkeys((name for name, _ in plain.blocks), 0)
    cut = find_smallest([plain], bound, Budget(5.0, 0.0))
    assert cut.is_cut_off
    assert cut.lft is plain
    assert not find_smallest([plain], bound, Budget(0.05)).is_cut_off


def test_a_part_that_fails_leaves_what_was_there(monkeypatch: pytest.MonkeyPatch) -> None:
    """The result says why; mistakes of programs are not hidden."""
    plain = reduce_order(case("O2"))

    def failing(*_: Any) -> Any:
        raise WellPosednessError("singular on the way")

    monkeypatch.setattr(search, "refit", failing)
    bound = dict.fromkeys((name for name, _ in plain.blocks), 0)
    result = find_smallest([plain], bound, Budget(0.5))
    assert result.dropped == "singular on the way"
    assert result.lft.order <= plain.order
    points = np.zeros((1, len(plain.blocks)))
    target(evaluate_at(result.lft, points), evaluate_at(plain, points), CLOSED_FORM)
    monkeypatch.setattr(search, "refit", lambda: None)
    with pytest.raises(TypeError):
        find_smallest([plain], bound, Budget(0.5))


def test_what_is_left_out_of_the_search_is_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    """A search runs in a process of its own, where nothing can be left out from here."""
    scene = mbdlft.load_scene("scenarios/gimbal.toml")
    made = [("gimbal", lambda work: mbdlft.to_lft(scene, search=work))]
    monkeypatch.setattr(ablation, "cases", lambda: iter(made))
    asked: list[LFT] = []
    ablation.measure(1.0, {"refit": lambda forms, *_: asked.append(forms[0]) or forms[0]})
    assert asked


# Candidates of the search are compared with values, entry by entry, not with what is only rounding.

SCENARIOS = Path(__file__).parents[2] / "scenarios"


def with_row_that_cancels() -> LFT:
    """[d1 d2 ; 0], the zero as (d1 + 0.1)(d2 + 0.7) - d2 d1 - 0.7 d1 - 0.1 d2 - 0.07."""
    first, second = delta("d1"), delta("d2")
    product = (first + constant([[0.1]])) @ (second + constant([[0.7]]))
    rest = second @ first + constant([[0.7]]) @ first + constant([[0.1]]) @ second
    return stack_rows(first @ second, product - (rest + constant([[0.07]])))


def with_zero_row(value: float = 0.0, factor: float = 1.0) -> LFT:
    """[d1 d2 ; value] times a factor."""
    blocks = (Block("d1", 1), Block("d2", 1))
    M11, M12 = np.array([[0.0, 1.0], [0.0, 0.0]]), np.array([[0.0], [1.0]])
    return LFT(M11, M12, factor * np.array([[1.0, 0.0], [0.0, 0.0]]), np.array([[0.0], [value]]), blocks)


def test_rounding_is_no_value() -> None:
    truth = Truth(with_row_that_cancels, part_of_either)
    _, values, _ = truth.values
    assert 0.0 < np.max(np.abs(values[:, 1])) < 1e-15
    assert is_same(with_zero_row(), truth, Work())


@pytest.mark.parametrize(("value", "factor"), [(1e-12, 1.0), (0.0, 1.0 + 1e-10)])
def test_small_errors_are_found(value: float, factor: float) -> None:
    truth = Truth(with_row_that_cancels, part_of_either)
    assert not is_same(with_zero_row(value, factor), truth, Work())


def test_very_large_models_are_not_searched(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = mbdlft.load_scene(SCENARIOS / "two_link_arm.toml")
    assert mbdlft.to_lft(scene).order == 16
    monkeypatch.setattr(stages, "_MOST_SEARCHED", 16)
    assert mbdlft.to_lft(scene).order == 17
