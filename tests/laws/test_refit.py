"""Laws of repetitions left out by Newton's method.

1. the value stays, with fewer repetitions
2. chains with few parameters get to the bound by pairs, where words, search and independence do not
3. nothing is found where there is nothing: at the degree, or in a generic LFT
4. an LFT is found whatever the units of its rows and columns
5. a search has it, and refuses what has another value
"""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from benchmarks.cases.chains import chain
from mbdlft.base.running import one_thread
from mbdlft.exact.numbers import BITS, precision
from mbdlft.lft.lft import LFT, Block, fix, with_blocks
from mbdlft.lft.sampling import evaluate_at
from mbdlft.multibody.assembly import assemble
from mbdlft.multibody.to_problem import choose_signals
from mbdlft.order import min_rank, search
from mbdlft.order import refit as module
from mbdlft.order.circles import circle_values, fit_of, independent, scaled
from mbdlft.order.degree import least_more
from mbdlft.order.joint_bound import JointBound
from mbdlft.order.lower_bound import exact_degrees
from mbdlft.order.reduction import reduce_exactly, reduce_order
from mbdlft.order.refit import fewer
from mbdlft.order.search import Budget, find_smallest
from mbdlft.order.work import Work
from mbdlft.pipeline.extract import extract
from mbdlft.problem.relations import linearize
from tests.close import roundoff
from tests.extracted import lower_bound, reduced

KAPPA = 1e4
TRIES, SEEDS = 6, 8


@pytest.fixture(autouse=True)
def as_models_are_made() -> Iterator[None]:
    with one_thread():
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


@pytest.mark.long
def test_a_search_has_it(monkeypatch: pytest.MonkeyPatch) -> None:
    a = chain_in_space(6, "m5", "t3")
    monkeypatch.setattr(search, "rewritten", lambda *_: iter(()))  # it is not what is tested here
    assert searched(a, 20.0).order == 21
    for way in (module, min_rank):  # both ways get there
        monkeypatch.setattr(way, "unscaled", forgotten_scale)
    assert searched(a, 3.0).order == 24


def test_work_is_over() -> None:
    a = chain_in_space(3, "m2", "t2")
    assert not list(fewer(a, lower_bound(a), 0, TRIES, 0, Work(0.0)))


@pytest.mark.parametrize(("change", "is_finished"), [(1e-8, True), (1e-3, False)])
def test_what_converges_is_finished_without_work(
    change: float, is_finished: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "_OF_TRY", 0.0)
    a, random = chain_in_space(2, "m0", "t1"), np.random.default_rng(0)
    truth = circle_values(a, 200, random, Work())
    M, block = scaled(a, truth), a.slices()["t1"]
    M[block] += change * random.standard_normal(M[block].shape)
    fit = module._descend(fit_of(M, a.blocks, truth, Work()), a.blocks, block, truth, Work(0.0))
    assert (fit.size < 1e-13) == is_finished


def forgotten_scale(M: Any, kept: Any, a: LFT, truth: Any) -> LFT:
    return unscaled(M, kept, a, truth._replace(radii=np.ones_like(truth.radii)))


unscaled = module.unscaled
