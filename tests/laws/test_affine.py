"""Laws of moving affine deltas.

1. the value stays, on either side of what is inside
2. which deltas are affine, and which have no poles
3. masses of a planar chain inside of its lengths have the order that can be counted by hand
4. an order that opens small blocks first reaches 48 on three links in space, with the same values
5. a result that is wrong once it is finished is refused
"""

import time

import numpy as np
import pytest

from benchmarks.cases.chains import chain
from mbdlft.bound.degree import lower_bound
from mbdlft.lft.evaluate import evaluate_at
from mbdlft.lft.lft import LFT, constant, delta, inverse, stack_columns, stack_rows, transpose
from mbdlft.multibody.assembly import assemble
from mbdlft.multibody.to_problem import problem_of_scene
from mbdlft.pipeline.build import build
from mbdlft.pipeline.extract import extract
from mbdlft.pipeline.realization import _solved
from mbdlft.problem.linearize import linearize
from mbdlft.reduce import affine
from mbdlft.reduce import commuting as commute
from mbdlft.reduce.affine import is_affine, is_polynomial, move_affine
from mbdlft.reduce.commuting import reduce_commuting
from mbdlft.reduce.reduce import reduce_order
from mbdlft.reduce.same_value import is_same
from tests.close import SCENARIO, roundoff, target
from tests.laws.turned import forces_turned_on_the_way


def relations(links: int, *, spatial: bool) -> LFT:
    """Of forces that turn on the way in: there is something left to find."""
    with forces_turned_on_the_way():
        equations = assemble(chain(links, spatial=spatial))
    return reduce_order(extract(linearize(equations, range(links), range(links))).lft)


def example() -> LFT:
    """m stands outside of two copies of p, q and t; p is a square, t is a pole."""
    m, p, q, t = (constant([[0.7]]) + delta(name) for name in "mpqt")
    pole = inverse(t)
    return reduce_order(stack_rows(m @ p @ p @ q, stack_columns(m) @ q @ pole @ p, q @ m))


def law_value(a: LFT, outside: tuple[str, ...], moved: tuple[str, ...]) -> LFT:
    changed = move_affine(a, outside, moved)
    assert changed is not None
    points = np.random.default_rng(3).uniform(-0.5, 0.5, (20, len(a.blocks)))
    roundoff(evaluate_at(changed, points), evaluate_at(a, points), 1e3)
    return changed


@pytest.mark.parametrize("outside", [(), ("p",), ("p", "q")])
def test_value_stays(outside: tuple[str, ...]) -> None:
    for a in (example(), transpose(example())):
        law_value(a, outside, ("m", "t"))


def test_planted_slope_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    right = affine.fix
    monkeypatch.setattr(
        affine, "fix", lambda a, values: right(a, {k: 1.01 * v for k, v in values.items()})
    )
    with pytest.raises(AssertionError, match="relative error"):
        law_value(example(), ("p",), ("m",))


def test_what_is_affine() -> None:
    a = example()
    assert [name for name, _ in a.blocks if is_affine(a, name)] == ["m", "q"]
    assert [name for name, _ in a.blocks if is_polynomial(a, name)] == ["m", "p", "q"]


@pytest.mark.parametrize("links", [2, 3, 4])
def test_masses_inside_of_lengths(links: int) -> None:
    """Mass k: k + 1 directions; length: 2; angle 0: two poles, n directions; angle k: 2 (n - k)."""
    a = relations(links, spatial=False)
    lengths, masses = ([f"{kind}{k}" for k in range(links)] for kind in "Lm")
    found = law_value(a, tuple(lengths), tuple(masses))
    expected = {f"m{k}": k + 1 for k in range(links)} | dict.fromkeys(lengths, 2)
    expected |= {f"t{k}": 4 * (links - k) if k else 2 * links for k in range(links)}
    assert dict(found.blocks) == expected


def test_too_many_channels_on_the_way_are_refused() -> None:
    a, masses = relations(3, spatial=False), ("m0", "m1", "m2")
    assert move_affine(a, (), masses, most=2 * a.order) is not None
    assert move_affine(a, (), masses, most=5) is None


def law_small_blocks_first(seed: int) -> int:
    a = relations(3, spatial=True)
    search = commute._Search(lower_bound(a), lambda: False, a)
    found = commute._pass(a, search, commute.ORDERED[0], seed)
    points = np.random.default_rng(6).uniform(-1.0, 1.0, (50, len(a.blocks)))
    target(evaluate_at(found, points), evaluate_at(a, points), SCENARIO)
    return found.order


def test_small_blocks_first() -> None:
    """n-D reduction alone: 58; no LFT has less than 44."""
    assert min(law_small_blocks_first(seed) for seed in (1, 2, 3)) == 48


def test_planted_pass_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """A step with a wrong value, and a check that lets it pass."""
    right = commute.choose

    def wrong(*arguments: object) -> LFT:
        a = right(*arguments)  # type: ignore[arg-type]
        return LFT(a.M11, a.M12, 1.001 * a.M21, a.M22, a.blocks)

    monkeypatch.setattr(commute, "choose", wrong)
    monkeypatch.setattr(commute, "_keeps", lambda candidate, search: True)
    with pytest.raises(AssertionError, match="relative error"):
        law_small_blocks_first(2)


def test_wrong_when_finished_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """Right as an LFT, but what it becomes has another value."""
    a = relations(3, spatial=False)

    def finish(found: LFT) -> LFT:
        return found if found.order == a.order else 1.001 * np.eye(found.shape[0]) @ found

    def smallest() -> LFT:
        return reduce_commuting([a], lower_bound(a), 0.5, lambda found, stop: 0, finish).lft

    assert smallest() is a
    monkeypatch.setattr(commute, "_keeps", lambda one, search: is_same(one, search.as_it_is))
    assert smallest().order < a.order


def test_finished_relations_of_a_chain_are_kept() -> None:
    """Solving for accelerations makes no right result wrong."""
    scene = chain(3, spatial=False)
    problem = problem_of_scene(scene)
    form = problem.forms[0]
    a = reduce_order(extract(form.relations).lft)
    search = commute._Search(
        lower_bound(a),
        lambda: False,
        a,
        lambda found: _solved(problem, form, found),
    )
    found = move_affine(a, ("L0", "L1", "L2"), ("m0", "m1", "m2"))
    assert found is not None
    assert commute._keeps(found, search)


def law_budget() -> None:
    """A search of half a second ends about then, also where one look at all parameters takes longer."""
    start = time.thread_time()
    build(chain(10, spatial=False), 0.0)
    middle = time.thread_time()
    build(chain(10, spatial=False), 0.5)
    assert time.thread_time() - middle < 1.5 * (middle - start) + 1.5


def test_budget() -> None:
    law_budget()


def test_planted_search_that_never_stops_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    right = commute._moved
    monkeypatch.setattr(commute, "_moved", lambda a, stop: right(a, lambda: False))
    with pytest.raises(AssertionError):
        law_budget()
