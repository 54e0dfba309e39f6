"""Laws of the search for a smaller LFT of a model: what it may cost, and what it leaves alone."""

import itertools
import time
from pathlib import Path

import numpy as np
import pytest

import mbdlft
from benchmarks import ablation
from benchmarks.cases.chains import chain
from benchmarks.cases.orders import CASES
from mbdlft.base.running import heard
from mbdlft.pipeline import stages
from mbdlft.pipeline.models import build
from mbdlft.pipeline.stages import CUT_OFF
from mbdlft.system.model import LFTModel
from tests.close import CLOSED_FORM, SCENARIO, target
from tests.cross.mechanisms import open_tree
from tests.seeds import some

SCENARIOS = Path(__file__).parents[2] / "scenarios"
WORK = 20.0  # far more than needed: all cases end at their bound


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


def searched(work: float = 1.0) -> LFTModel:
    """The first matrix of the literature; 8 of its 10 repetitions are left after the search."""
    return mbdlft.realize(CASES[0].problem(), search=work)


@pytest.mark.long
def test_no_clock(monkeypatch: pytest.MonkeyPatch) -> None:
    """The same bits under a clock that runs as it likes."""
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


@pytest.mark.parametrize("seed", some([2], [1, 3]))
def test_more_work_never_ends_above_less(seed: int) -> None:
    """Bounds, restrictions and exchanges have the whole work each."""
    scene = open_tree(seed)
    orders = [mbdlft.to_lft(scene, search=work).order for work in (0.0, 0.01, 0.1, 0.3, 2.0)]
    assert orders == sorted(orders, reverse=True)
    assert orders[-1] < orders[1] < orders[0]


def test_a_search_does_little_more_than_its_work() -> None:
    scene = open_tree(1)
    for most in (0.1, 0.5):
        told = list[tuple[float, float]]()
        with heard(lambda *done, told=told: told.append(done)):
            mbdlft.to_lft(scene, search=most, prove=0.0)
        assert 0.0 < max(done for done, own in told if own == most) < 1.5 * most + 0.3


def test_a_limit_in_seconds_cuts_off() -> None:
    """It says so, and the result is the model without a search."""
    scene, said = open_tree(2), list[str]()
    plain = mbdlft.to_lft(scene, search=0.0)
    cut = build(scene, search=2.0, seconds=0.0, progress=said.append).model
    assert CUT_OFF in said
    assert cut.order == plain.order
    said.clear()
    build(scene, search=0.05, progress=said.append)
    assert CUT_OFF not in said


def test_what_is_left_out_of_the_search_is_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = open_tree(2)
    made = [("tree", lambda work: mbdlft.to_lft(scene, search=work))]
    monkeypatch.setattr(ablation, "cases", lambda: iter(made))
    orders = [ablation.measure(2.0, parts)["tree"].order for parts in ablation._LEFT_OUT.values()]
    assert orders[0] == min(orders) < max(orders[1:])
    assert len(set(orders)) > 2


def test_very_large_models_are_not_searched(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = mbdlft.load_scene(SCENARIOS / "two_link_arm.toml")
    assert mbdlft.to_lft(scene).order == 16
    monkeypatch.setattr(stages, "_MOST_SEARCHED", 16)
    assert mbdlft.to_lft(scene).order == 17
