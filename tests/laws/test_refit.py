"""Laws of repetitions left out by Newton's method."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.cases.chains import chain
from mbdlft import load_scene, to_lft
from mbdlft.base.running import one_thread
from mbdlft.exact.numbers import BITS, precision
from mbdlft.lft.lft import LFT, Block, fix, with_blocks
from mbdlft.lft.sampling import evaluate, evaluate_at
from mbdlft.multibody.assembly import assemble
from mbdlft.multibody.to_problem import choose_signals, problem_of_scene
from mbdlft.order import reduction
from mbdlft.order import refit as newton
from mbdlft.order.circles import circle_values, fit_of, scaled
from mbdlft.order.degree import least_more
from mbdlft.order.joint_bound import JointBound
from mbdlft.order.lower_bound import at_random, exact_degrees
from mbdlft.order.reduction import ExactLFT, reduce_exactly, reduce_order
from mbdlft.order.refit import fewer
from mbdlft.order.restriction import Step, restricted_exactly
from mbdlft.order.search import Budget, find_smallest
from mbdlft.order.work import Work
from mbdlft.pipeline.extract import extract
from mbdlft.pipeline.forms import restricted
from mbdlft.problem.relations import linearize
from tests.close import SCENARIO, roundoff
from tests.cross.mechanisms import open_tree
from tests.extracted import exactly, lower_bound, reduced
from tests.laws.test_search import case

KAPPA = 1e4
TRIES, SEEDS = 6, 8


@pytest.fixture(autouse=True)
def as_models_are_made() -> Iterator[None]:
    with one_thread(), precision(BITS):
        yield


def chain_in_space(links: int, *names: str) -> LFT:
    """Equations of motion with few parameters, after all that does not fit."""
    scene = chain(links, spatial=True)
    equations = assemble(scene)
    whole = reduced(linearize(equations, *choose_signals(scene, equations)))
    others = {name: 0.1 for name, _ in whole.blocks if name not in names}
    return with_blocks(reduce_order(fix(whole, others)), sorted(names))


def bound_of(links: int, *names: str) -> int:
    """The bound of two parameters of a chain by degrees and pairs, on residues."""
    scene = chain(links, spatial=True)
    equations = assemble(scene)
    with precision(BITS):
        a = reduce_exactly(extract(linearize(equations, *choose_signals(scene, equations))).lft)
    degrees = exact_degrees(a)
    pairs = JointBound(a, degrees).pairs(*names, Work())
    return sum(degrees[name] for name in names) + sum(least_more(names, pairs).values())


def in_other_units(a: LFT) -> tuple[LFT, Any]:
    """With rows and columns over 12 orders of magnitude, and the factors of the entries."""
    rows, columns = (10.0 ** np.linspace(-6, 6, side) for side in a.shape)
    scale = rows[:, None] * columns
    return LFT(a.M11, a.M12 * columns, rows[:, None] * a.M21, a.M22 * scale, a.blocks), scale


def refitted(a: LFT, least: int = 0) -> LFT:
    """As small as Newton's method makes it, compared with `a` at points of the range."""
    degrees, found = lower_bound(a), a
    points = np.random.default_rng(7).uniform(-1.0, 1.0, (50, len(a.blocks)))
    values = evaluate_at(a, points)
    seed = 0
    while seed < SEEDS and found.order > least:
        smaller = next(fewer(found, degrees, least, TRIES, seed, Work()), None)
        if smaller is None:
            seed += 1
            continue
        assert least <= smaller.order < found.order
        roundoff(evaluate_at(smaller, points), values, KAPPA)
        found = smaller
    return found


@pytest.mark.parametrize(
    ("links", "names", "before", "after"),
    [
        (3, ("m2", "t2"), 13, 12),
        (4, ("m3", "t1"), 16, 15),
        (4, ("m3", "t2"), 17, 16),
        pytest.param(6, ("m5", "t3"), 24, 21, marks=pytest.mark.long),
    ],
)
def test_two_parameters_are_at_the_bound(
    links: int, names: tuple[str, ...], before: int, after: int
) -> None:
    a = chain_in_space(links, *names)
    found = refitted(a, after)
    assert (a.order, found.order) == (before, after)
    assert after == bound_of(links, *names)


def test_nothing_below_the_degrees() -> None:
    a = chain_in_space(2, "m0", "t1")
    assert not list(fewer(a, {block.name: block.size for block in a.blocks}, 0, TRIES, 0, Work()))
    degrees = lower_bound(a)
    assert a.order == sum(degrees.values())
    below = {name: degree - 1 for name, degree in degrees.items()}
    assert not list(fewer(a, below, 0, TRIES, 0, Work()))


def test_nothing_in_a_generic_lft() -> None:
    random = np.random.default_rng(3)
    M = 0.3 * random.standard_normal((7, 8))
    a = LFT(M[:5, :5], M[:5, 5:], M[5:, :5], M[5:, 5:], (Block("a", 3), Block("b", 2)))
    assert not list(fewer(a, {"a": 1, "b": 1}, 0, TRIES, 0, Work()))


def test_units() -> None:
    a = chain_in_space(3, "m2", "t2")
    other, _ = in_other_units(a)
    assert refitted(other, 12).order == refitted(a, 12).order == 12


def searched(a: LFT, work: float) -> LFT:
    return find_smallest([a], lower_bound(a), Budget(work)).lft


def test_a_search_has_it() -> None:
    assert searched(chain_in_space(4, "m3", "t2"), 2.0).order == 16


def test_work_is_over() -> None:
    a = chain_in_space(3, "m2", "t2")
    assert not list(fewer(a, lower_bound(a), 0, TRIES, 0, Work(0.0)))


@pytest.mark.parametrize(("change", "is_finished"), [(1e-8, True), (1e-3, False)])
def test_what_converges_is_finished_without_work(
    change: float, is_finished: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(newton, "_OF_TRY", 0.0)
    a, random = chain_in_space(2, "m0", "t1"), np.random.default_rng(0)
    truth = circle_values(a, a, 200, random, Work())
    M, block = scaled(a, truth), a.slices()["t1"]
    M[block] += change * random.standard_normal(M[block].shape)
    start = fit_of(M, a.blocks, truth, Work())
    fit = newton._descend(start, a.blocks, block, truth, Work(0.0))
    assert (fit.size < 1e-13) == is_finished
    assert newton._polished(start, a.blocks, block, truth, Work()).size < 1e-13


def test_a_fit_has_the_digits_of_its_source() -> None:
    """In coordinates of a condition of 1e3 an LFT has lost digits; all of its entries have them again."""
    a, random = chain_in_space(2, "m0", "t1"), np.random.default_rng(0)
    T = np.eye(a.order)
    for rows in a.slices().values():
        left, right = (np.linalg.qr(random.standard_normal(T[rows, rows].shape))[0] for _ in range(2))
        T[rows, rows] = left * np.logspace(0.0, 3.0, len(left)) @ right
    into = np.linalg.inv(T)
    lossy = LFT(into @ a.M11 @ T, into @ a.M12, a.M21 @ T, a.M22, a.blocks)
    truth = circle_values(lossy, a, 200, random, Work())
    start = fit_of(scaled(lossy, truth), a.blocks, truth, Work())
    assert start.size > 1e-13
    fit = newton._descend(start, a.blocks, a.slices()["t1"], truth, Work())
    assert fit.size < 1e-14


def test_steps_in_exact_numbers_keep_digits() -> None:
    """What is left of a block has few zeros to keep: it comes in the coordinates of its signals."""
    problem = problem_of_scene(open_tree(26))
    step = Step("th", is_transposed=False, of_relations=True)
    found = restricted(problem, problem.forms[0], [step])
    assert found is not None
    assert isinstance(found.exact, ExactLFT)
    deltas = np.array([[0.0, 0.0], [1.0, 1.0], [-0.9, 0.8]])
    assert reduction._lost(found.lft, deltas) < 0.2 * reduction._lost(found.exact.rounded(), deltas)


# Laws of blocks restricted in exact numbers.

ROOT = Path(__file__).parents[2]


def residues_of(a: ExactLFT) -> np.ndarray:
    """The value at random residues, which follow the order of the blocks."""
    n = a.order
    return at_random(a)[n:, n:]


def law_restricted(a: LFT) -> None:
    whole, restricted = reduce_exactly(exactly(a)), 0
    points = {name: np.linspace(-0.3, 0.4, 7) for name, _ in a.blocks}
    expected = evaluate(a, points)
    for name, size in whole.blocks:
        for side in (False, True):
            small = restricted_exactly(whole, name, is_transposed=side)
            if small is None:
                continue
            restricted += 1
            assert [b.name for b in small.blocks] == [b.name for b in whole.blocks]
            assert np.array_equal(residues_of(small), residues_of(whole))
            assert dict(small.blocks)[name] <= size
            roundoff(evaluate(small.rounded(), points), expected, 1e6, float(np.max(np.abs(expected))))
    assert restricted


@pytest.mark.parametrize("name", ["O1", "O3", "O13"])
def test_blocks_of_matrices(name: str) -> None:
    law_restricted(reduce_order(case(name)))


def test_a_result_that_has_lost_digits_is_made_again() -> None:
    """Voltages of patches stand in bending and in tension: 53 repetitions, 47 with a block restricted."""
    model = to_lft(load_scene(ROOT / "scenarios" / "piezo_beam.toml"))
    assert model.order == 47
    assert model.certificate.max_relative_error < SCENARIO


def test_a_block_at_its_degree_leads_to_the_bound() -> None:
    """An angle restricted on both sides, and a stiffness refitted: 29, where each alone ends at 30."""
    model = to_lft(open_tree(1004))
    assert dict(model.lft.blocks) == {"k": 5, "th": 24}
    assert model.certificate.minimal
