"""Laws of moving affine deltas.

1. the value stays, on either side of what is inside
2. which deltas are affine, and which have no poles
3. masses of a planar chain inside of its lengths have the order that can be counted by hand
4. a result that is wrong once it is closed is refused
"""

from collections.abc import Callable

import numpy as np
import pytest

from benchmarks.cases.chains import chain
from mbdlft.lft.lft import LFT, constant, delta, inverse, stack_columns, stack_rows, transpose
from mbdlft.lft.sampling import evaluate_at
from mbdlft.multibody.assembly import assemble
from mbdlft.multibody.to_problem import problem_of_scene
from mbdlft.order import search
from mbdlft.order.reduction import reduce_order
from mbdlft.order.rewriting import is_affine, is_polynomial, move_affine
from mbdlft.order.work import Work
from mbdlft.pipeline.forms import candidates, closing
from mbdlft.problem.relations import linearize
from tests.close import roundoff
from tests.extracted import extracted
from tests.laws.turned import forces_turned_on_the_way


def relations(links: int, *, spatial: bool) -> LFT:
    """Of forces that turn on the way in: there is something left to find."""
    with forces_turned_on_the_way():
        equations = assemble(chain(links, spatial=spatial))
    return reduce_order(extracted(linearize(equations, range(links), range(links))))


def example() -> LFT:
    """m stands outside of two copies of p, q and t; p is a square, t is a pole."""
    m, p, q, t = (constant([[0.7]]) + delta(name) for name in "mpqt")
    pole = inverse(t)
    return reduce_order(stack_rows(m @ p @ p @ q, stack_columns(m) @ q @ pole @ p, q @ m))


def law_value(a: LFT, outside: tuple[str, ...], moved: tuple[str, ...]) -> LFT:
    changed = move_affine(a, outside, moved, Work())
    assert changed is not None
    points = np.random.default_rng(3).uniform(-0.5, 0.5, (20, len(a.blocks)))
    roundoff(evaluate_at(changed, points), evaluate_at(a, points), 1e3)
    return changed


@pytest.mark.parametrize("outside", [(), ("p",), ("p", "q")])
def test_value_stays(outside: tuple[str, ...]) -> None:
    for a in (example(), transpose(example())):
        law_value(a, outside, ("m", "t"))


def test_what_is_affine() -> None:
    a = example()
    assert [name for name, _ in a.blocks if is_affine(a, name, Work())] == ["m", "q"]
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
    assert move_affine(a, (), masses, Work(), most=2 * a.order) is not None
    assert move_affine(a, (), masses, Work(), most=5) is None


def finishing(a: LFT, close: Callable[[LFT], LFT]) -> search._Level:
    return search._level_of_relations(a, close, None, search._Proof({}, a, None))


def test_wrong_when_closed_is_refused() -> None:
    """Right as an LFT, but what it becomes has another value."""
    a, right = relations(3, spatial=False), Work()

    def close(one: LFT) -> LFT:
        return one if one.order == a.order else 1.001 * np.eye(one.shape[0]) @ one

    moved = move_affine(a, ("L0", "L1", "L2"), ("m0", "m1", "m2"), right)
    assert moved is not None
    assert moved.order < a.order
    for level, is_kept in ((finishing(a, close), False), (finishing(a, lambda one: one), True)):
        assert level.keeps(right, level.exact, moved) == is_kept


def test_closed_relations_of_a_chain_are_kept() -> None:
    """Solving for accelerations makes no right result wrong."""
    scene = chain(3, spatial=False)
    problem = problem_of_scene(scene)
    (found,) = candidates(problem, problem.forms)
    a = found.relations
    level = finishing(a, closing(found.form))
    moved = move_affine(a, ("L0", "L1", "L2"), ("m0", "m1", "m2"), Work())
    assert moved is not None
    assert level.keeps(Work(), level.exact, moved)
