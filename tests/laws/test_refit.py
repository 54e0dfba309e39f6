"""Laws of repetitions left out by Newton's method."""

from collections.abc import Iterator
from itertools import permutations
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import mbdlft
from benchmarks.cases.chains import chain
from mbdlft import load_scene, to_lft
from mbdlft.base.running import one_thread
from mbdlft.exact.numbers import BITS, precision
from mbdlft.lft.lft import (
    LFT,
    Block,
    constant,
    delta,
    fix,
    inverse,
    stack_columns,
    stack_rows,
    transpose,
    with_blocks,
)
from mbdlft.lft.sampling import evaluate, evaluate_at
from mbdlft.multibody.assembly import assemble
from mbdlft.multibody.to_problem import choose_signals, problem_of_scene
from mbdlft.order import reduction
from mbdlft.order import refit as newton
from mbdlft.order.circles import circle_values, fit_of, independent, scaled
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
from mbdlft.pipeline.models import build
from mbdlft.problem.relations import linearize
from tests.close import SCENARIO, roundoff, target
from tests.cross.mechanisms import open_tree
from tests.extracted import exactly, lower_bound, reduced
from tests.laws.test_search import case
from tests.strategies import random_scene

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
    return independent(with_blocks(reduce_order(fix(whole, others)), sorted(names)), Work())


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


# Laws of channels with independent functions of the deltas.

KAPPA_INDEPENDENT = 1e3


def word(names: tuple[str, ...]) -> LFT:
    product = constant([[1.0]])
    for name in names:
        product = product @ delta(name)
    return product


def shuffled(seed: int, *, poles: bool) -> LFT:
    """Two rows of three entries; each word stands in two entries in two orders of its factors."""
    random = np.random.default_rng(seed)
    total = constant(random.standard_normal((2, 3)))
    for _ in range(4):
        names = tuple(random.choice(["a", "b", "c"], size=int(random.integers(2, 4))))
        orders = list(permutations(names))
        for _ in range(2):
            left, right = random.integers(-2, 3, (2, 1)), random.integers(-2, 3, (1, 3))
            total = total + left @ word(orders[random.integers(len(orders))]) @ right
    if poles:
        total = stack_rows(total, total) @ stack_rows(
            inverse(constant([[2.0]]) + word(("a", "b"))), [[1.0]], word(("b", "a"))
        )
    return reduce_order(total)


def rank_of_functions(a: LFT) -> int:
    """Dimension of the span of 1 and Y Delta at real points, from the definition."""
    rows = []
    for point in np.random.default_rng(5).uniform(-1.0, 1.0, (a.order + 10, len(a.blocks))):
        deltas = np.diag(np.repeat(point, [block.size for block in a.blocks]))
        Y = a.M21 @ np.linalg.inv(np.eye(a.order) - deltas @ a.M11)
        rows.append(np.hstack([np.eye(a.shape[0]), Y @ deltas]))
    return int(np.linalg.matrix_rank(np.vstack(rows), tol=1e-9))


def law(a: LFT) -> LFT:
    found = independent(a, Work())
    points = np.random.default_rng(4).uniform(-0.9, 0.9, (20, len(a.blocks)))
    roundoff(evaluate_at(found, points), evaluate_at(a, points), KAPPA_INDEPENDENT)
    for side in (found, transpose(found)):
        assert rank_of_functions(side) == side.order + side.shape[0]
    return found


@given(st.integers(0, 10_000), st.booleans())
def test_value_stays_and_functions_are_independent(seed: int, poles: bool) -> None:
    a = shuffled(seed, poles=poles)
    found = law(a)
    assert found.order <= a.order
    assert [name for name, _ in found.blocks] == [name for name, _ in a.blocks]


def test_orders_of_factors() -> None:
    """[a b, b a] has four channels as words, and two as functions."""
    a = reduce_order(stack_columns(word(("a", "b")), word(("b", "a"))))
    assert (a.order, law(a).order) == (4, 2)
    assert law(transpose(a)).order == 2


@pytest.mark.parametrize("a", [constant([[1.0, 2.0]]), delta("a"), word(("a", "b"))])
def test_independent_comes_back(a: LFT) -> None:
    assert independent(a, Work()) is a


def test_units_do_not_matter() -> None:
    """Outputs in micrometres beside outputs in tons."""
    a = reduce_order(stack_columns(word(("a", "b")), word(("b", "a"))))
    b = reduce_order(stack_rows(1e6 * np.eye(1) @ a, 1e-6 * np.eye(1) @ a))
    found = law(b)
    assert (b.order, found.order) == (4, 2)
    values, expected = (evaluate_at(one, np.array([[0.3, -0.7]])) for one in (found, b))
    roundoff(values[:, 1], expected[:, 1], KAPPA_INDEPENDENT)


def test_scene() -> None:
    """What n-D reduction and opening the blocks with bases leave, on every CPU."""
    scene = random_scene(4)
    plain = build(scene, 0.0).model.lft
    found = same_values(plain)
    assert (plain.order, found.order) == (10, 8)
    assert sum(mbdlft.to_lft(scene, search=1.0).certificate.order) <= 8


def test_large_scene() -> None:
    """N-D reduction leaves 62 to 72, as the kernels of the CPU round; never more come back."""
    plain = build(random_scene(14), 0.0).model.lft
    assert same_values(plain).order <= plain.order


def same_values(plain: LFT) -> LFT:
    found = independent(plain, Work())
    points = np.random.default_rng(6).uniform(-1.0, 1.0, (50, len(plain.blocks)))
    target(evaluate_at(found, points), evaluate_at(plain, points), SCENARIO)
    return found


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
