"""Laws of the smallest rank of the channels of an affine delta.

1. the value stays, with fewer repetitions, where words, search and independence leave them
2. every candidate has the slope of the value where its delta is zero
3. what its channels feed to themselves goes by Newton's method
4. nothing is found where there is nothing: at the bound, in a delta that is not affine, among too many
5. an LFT is found whatever the units of its rows and columns
"""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from mbdlft.base.running import one_thread
from mbdlft.lft.lft import LFT, Block
from mbdlft.lft.sampling import evaluate_at
from mbdlft.order import min_rank as module
from mbdlft.order import refit as newton
from mbdlft.order.min_rank import lower_ranks
from mbdlft.order.refit import refit
from mbdlft.order.rewriting import open_block
from mbdlft.order.work import Work
from tests.close import roundoff
from tests.extracted import lower_bound
from tests.laws.test_refit import KAPPA, chain_in_space, in_other_units

ENTRIES = 1000
STARTS = 120


@pytest.fixture(autouse=True)
def few_starts(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setattr(module, "_STARTS", STARTS)
    with one_thread():  # as models are made
        yield


def candidates(a: LFT, entries: int = ENTRIES, least: int = 0, seed: int = 0) -> Iterator[LFT]:
    return lower_ranks(a, lower_bound(a), least, entries, seed, Work())


def values(a: LFT) -> Any:
    return evaluate_at(a, np.random.default_rng(7).uniform(-1.0, 1.0, (50, len(a.blocks))))


def slope(a: LFT, name: str) -> Any:
    """Of the value in one delta, where it is zero: (w, u) -> (z, y) is [A B ; C D]."""
    size, opened = dict(a.blocks)[name], values(open_block(a, name))
    return opened[:, size:, :size] @ opened[:, :size, size:]


def is_right(found: LFT, a: LFT, scale: Any = 1.0) -> bool:
    try:
        roundoff(values(found) / scale, values(a) / scale, KAPPA)
    except AssertionError:
        return False
    return True


def same_slopes(a: LFT, name: str) -> None:
    found = list(candidates(a))
    assert found
    for candidate in found:
        assert dict(candidate.blocks)[name] < dict(a.blocks)[name]
        roundoff(slope(candidate, name), slope(a, name), KAPPA)


@pytest.mark.parametrize("angle", ["t2", pytest.param("t1", marks=pytest.mark.long)])
def test_slopes(angle: str) -> None:
    same_slopes(chain_in_space(4, "m3", angle), "m3")


@pytest.mark.parametrize(
    ("links", "names", "before", "after"), [(4, ("m3", "t1"), 16, 15), (4, ("m3", "t2"), 17, 16)]
)
def test_with_newton(
    monkeypatch: pytest.MonkeyPatch, links: int, names: tuple[str, ...], before: int, after: int
) -> None:
    monkeypatch.setattr(newton, "fewer", lambda *_, **__: iter(()))
    a = chain_in_space(links, *names)
    found = refit([a], lower_bound(a), after, lambda one: is_right(one, a), 0, Work(40.0))
    assert (a.order, found.order) == (before, after)


@pytest.mark.long
def test_units() -> None:
    other, scale = in_other_units(chain_in_space(6, "m5", "t3"))
    orders = (
        one.order
        for seed in range(8)  # a start that leads there on one CPU does not on another
        for one in candidates(other, least=21, seed=seed)
        if is_right(one, other, scale)
    )
    assert 21 in orders


def test_nothing_to_find() -> None:
    a = chain_in_space(4, "m3", "t2")
    sizes = {block.name: block.size for block in a.blocks}
    assert not list(lower_ranks(a, sizes, 0, ENTRIES, 0, Work()))
    assert not list(lower_ranks(a, sizes | {"t2": 1}, 0, ENTRIES, 0, Work()))  # not affine
    assert not list(candidates(a, entries=20))
    assert not list(candidates(a, least=a.order))
    assert not list(lower_ranks(a, lower_bound(a), 0, ENTRIES, 0, Work(0.0)))


def test_nothing_in_a_generic_lft() -> None:
    random = np.random.default_rng(3)
    M = 0.3 * random.standard_normal((8, 9))
    M[3:5, 3:5], M[:3, 3:5] = 0.0, 0.0  # affine in the second delta, which feeds outputs alone
    a = LFT(M[:5, :5], M[:5, 5:], M[5:, :5], M[5:, 5:], (Block("a", 3), Block("b", 2)))
    assert not list(lower_ranks(a, {"a": 1, "b": 1}, 0, ENTRIES, 0, Work()))
