"""The value of an operation on LFTs is the operation on their values.

1. value(a + b) = value(a) + value(b); likewise product, negative, difference, transpose, inverse
2. stacking stacks values; selecting selects
3. eliminate solves the first relations; star closes the loop
4. fix, then evaluate = evaluate
5. evaluating many points = one point at a time = the dense definition by loops
6. the order of construction does not change names or order of blocks
"""

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mbdlft.base.errors import StructureError, WellPosednessError
from mbdlft.lft import lft as algebra
from mbdlft.lft.lft import LFT, Block, constant, delta, fix
from mbdlft.lft.sampling import evaluate, evaluate_at
from tests.close import error, exact, roundoff
from tests.laws.lfts import lfts, points

KAPPA = 1e4  # condition of the loops that the generated LFTs reach
seeds = st.integers(0, 1000)


def value(a: LFT, at: dict[str, np.ndarray]) -> np.ndarray:
    """Values by the definition, one point at a time, with an explicit inverse."""
    count = len(next(iter(at.values())))
    found = np.zeros((count, *a.shape))
    for k in range(count):
        spread = [at[block.name][k] for block in a.blocks for _ in range(block.size)]
        Delta = np.diag(np.array(spread, dtype=float))
        loop = np.linalg.inv(np.eye(a.order) - a.M11 @ Delta) if a.order else np.zeros((0, 0))
        found[k] = a.M22 + a.M21 @ Delta @ loop @ a.M12
    return found


def law_sum(add: Callable[[LFT, LFT], LFT], a: LFT, b: LFT, at: dict[str, np.ndarray]) -> None:
    roundoff(value(add(a, b), at), value(a, at) + value(b, at), KAPPA)


def law_product(multiply: Callable[[LFT, LFT], LFT], a: LFT, b: LFT, at: dict[str, np.ndarray]) -> None:
    roundoff(value(multiply(a, b), at), value(a, at) @ value(b, at), KAPPA)


def law_inverse(inverse: Callable[[LFT], LFT], a: LFT, at: dict[str, np.ndarray]) -> None:
    product = value(inverse(a), at) @ value(a, at)
    roundoff(product, np.broadcast_to(np.eye(a.shape[0]), product.shape), KAPPA)


def law_eliminate(
    eliminate: Callable[[LFT, int], LFT], a: LFT, n: int, at: dict[str, np.ndarray]
) -> None:
    values = value(a, at)
    solved = -np.linalg.solve(values[:, :n, :n], values[:, :n, n:])
    read = values[:, n:, n:] + values[:, n:, :n] @ solved
    roundoff(value(eliminate(a, n), at), np.concatenate([solved, read], 1), KAPPA)


@given(lfts(2, 3), lfts(2, 3), lfts(3, 2), seeds)
def test_sum_difference_product_negative(a: LFT, b: LFT, c: LFT, seed: int) -> None:
    at = points(seed)
    law_sum(algebra.add, a, b, at)
    law_product(algebra.multiply, a, c, at)
    roundoff(value(a - b, at), value(a, at) - value(b, at), KAPPA, scale=_size(a, b, at))
    roundoff(value(-a, at), -value(a, at), KAPPA)
    roundoff(value(a - a, at), 0 * value(a, at), KAPPA, scale=_size(a, a, at))
    roundoff(value(1.5 * np.ones((4, 2)) @ a, at), 1.5 * np.ones((4, 2)) @ value(a, at), KAPPA)
    roundoff(value(np.ones((2, 3)) + a, at), 1.0 + value(a, at), KAPPA)
    roundoff(value(np.ones((2, 3)) - a, at), 1.0 - value(a, at), KAPPA, scale=1 + _size(a, a, at))


def _size(a: LFT, b: LFT, at: dict[str, np.ndarray]) -> float:
    return float(np.max(np.abs(value(a, at))) + np.max(np.abs(value(b, at))))


@given(lfts(3, 3), seeds)
def test_inverse_and_transpose(a: LFT, seed: int) -> None:
    at = points(seed)
    law_inverse(algebra.inverse, a, at)
    assert algebra.inverse(a).blocks == a.blocks
    roundoff(value(algebra.transpose(a), at), np.swapaxes(value(a, at), 1, 2), KAPPA)


@given(lfts(2, 3), lfts(1, 3), lfts(2, 1), seeds)
def test_stacking_and_selecting(a: LFT, b: LFT, c: LFT, seed: int) -> None:
    at = points(seed)
    va, vb, vc = value(a, at), value(b, at), value(c, at)
    roundoff(value(algebra.stack_rows(a, b), at), np.concatenate([va, vb], 1), KAPPA)
    roundoff(value(algebra.stack_columns(a, c), at), np.concatenate([va, vc], 2), KAPPA)
    diagonal = np.zeros((len(va), 3, 6))
    diagonal[:, :2, :3], diagonal[:, 2:, 3:] = va, vb
    roundoff(value(algebra.stack_diagonal(a, b), at), diagonal, KAPPA)
    roundoff(value(algebra.select(a, [1, 0, 1], [2, 0]), at), va[:, [1, 0, 1]][:, :, [2, 0]], KAPPA)


@given(lfts(4, 4), st.integers(1, 4), seeds)
def test_eliminate(a: LFT, n: int, seed: int) -> None:
    law_eliminate(algebra.eliminate, a, n, points(seed))
    assert algebra.eliminate(a, n).order == a.order


@given(lfts(2, 2), seeds)
def test_fix_and_evaluate(a: LFT, seed: int) -> None:
    at = points(seed)
    given_names = {name: at[name] for name, _ in a.blocks}
    many = evaluate(a, given_names) if given_names else a.M22[None]
    roundoff(many, value(a, at)[: len(many)], KAPPA)
    for k in range(len(many) if given_names else 0):
        single = {name: float(column[k]) for name, column in given_names.items()}
        roundoff(evaluate(a, single), many[k], KAPPA)
        if a.blocks:
            first = a.blocks[0].name
            rest = {name: number for name, number in single.items() if name != first}
            fixed = fix(a, {first: single[first]})
            assert first not in dict(fixed.blocks)
            roundoff(evaluate(fixed, rest), many[k], KAPPA)


def test_evaluate_takes_the_thin_side_either_way() -> None:
    """Wide and tall LFTs go through different solves; both are the definition."""
    random = np.random.default_rng(3)
    for rows, columns in ((1, 6), (6, 1)):
        a = LFT(
            0.1 * random.standard_normal((4, 4)),
            random.standard_normal((4, columns)),
            random.standard_normal((rows, 4)),
            random.standard_normal((rows, columns)),
            (Block("a", 1), Block("b", 3)),
        )
        at = points(1, count=1100)
        roundoff(evaluate_at(a, np.stack([at["a"], at["b"]], 1)), value(a, at), KAPPA)


def test_names_are_identity_and_order_is_by_name() -> None:
    a, b = delta("a", 2), delta("b", 2)
    assert (a + b).blocks == (b + a).blocks == (Block("a", 2), Block("b", 2))
    assert (a + a).blocks == (Block("a", 4),)
    assert constant([[1.0, 2.0]]).blocks == ()
    exact(constant([[1.0, 2.0]]).M22, [[1.0, 2.0]])


def test_arrays_are_frozen_copies() -> None:
    source = np.eye(2)
    a = constant(source)
    source[0, 0] = 5.0
    exact(a.M22, np.eye(2))
    with pytest.raises(ValueError, match="read-only"):
        a.M22[0, 0] = 1.0


def test_bad_shapes_and_singular_values_are_errors() -> None:
    with pytest.raises(StructureError, match="cannot add shapes"):
        constant(np.eye(2)) + constant(np.eye(3))
    with pytest.raises(StructureError, match="cannot multiply shapes"):
        constant(np.eye(2)) @ constant(np.eye(3))
    with pytest.raises(StructureError, match="cannot invert shape"):
        algebra.inverse(constant(np.ones((2, 3))))
    with pytest.raises(WellPosednessError, match="singular"):
        algebra.inverse(delta("a", 2))
    with pytest.raises(WellPosednessError, match="singular at one of the points"):
        evaluate(algebra.inverse(constant(np.eye(1)) + delta("a")), {"a": np.array([-1.0])})
    assert error(evaluate(delta("a"), {"a": 0.5}), [[0.5]]) == 0.0
