"""Laws of the search that uses commutation.

1. values stay and the order does not grow
2. known minimal orders of the literature are reached, whatever the way of writing
3. a candidate with another value, or one that is singular on the range, is refused
"""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import mbdlft
from mbdlft.lft import commute
from mbdlft.lft.bound import lower_bound
from mbdlft.lft.commute import reduce_commuting
from mbdlft.lft.evaluate import evaluate_at
from mbdlft.lft.lft import LFT, constant, delta, inverse, stack_columns, stack_rows
from mbdlft.lft.reduce import reduce_order
from scenarios import two_link_arm
from tests.close import CLOSED_FORM, roundoff, target
from tests.laws.lfts import lfts
from tests.reference.arm import NAMES, closed_form, state_and_input

SECONDS = 20.0  # far more than needed: all cases end at their bound


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
    if name == "O5":
        quotient = inverse(1.0 + d1 + d2)
        return stack_rows(quotient, quotient)
    assert name == "O13"
    rows = (
        (5.0 * np.eye(1) @ a - 1.0, -10.0 * np.eye(1) @ (1.0 + b), 1.0 + b),
        (10.0 * np.eye(1) @ (1.0 + power(c, 2)), -1.0 - a @ b @ c, c),
        (numbers(1.0), numbers(1.0), numbers(0.0)),
    )
    return stack_rows(*(stack_columns(*row) for row in rows))


@pytest.mark.parametrize(
    ("name", "order"), [("O1", 8), ("O2", 15), ("O3", 3), ("O5", 2), ("O13", 6)]
)
def test_orders_of_the_literature(name: str, order: int) -> None:
    """Matrices of two and more parameters whose smallest order is known."""
    plain = reduce_order(case(name))
    bound = lower_bound(plain)
    small = reduce_commuting(plain, bound, SECONDS)
    assert small.order == order == sum(bound.values())
    points = np.random.default_rng(2).uniform(-0.9, 0.9, (50, len(plain.blocks)))
    roundoff(evaluate_at(small, points), evaluate_at(plain, points), 1e4)


def test_arm_reaches_its_bound_and_stays_exact() -> None:
    """16 repetitions, proved minimal, against the closed form at 1 000 points and all corners."""
    model = mbdlft.to_lft(two_link_arm.scene(), search=SECONDS)
    assert model.order == 16
    assert model.certificate.minimal
    inside, outer = mbdlft.random(model.parameters, 1000, seed=8), mbdlft.corners(model.parameters)
    values = {name: np.concatenate([inside[name], outer[name]]) for name in NAMES}
    expected, _ = closed_form(values)
    actual = state_and_input(model, values)
    for k in range(len(expected)):
        target(actual[k], expected[k], CLOSED_FORM)


@given(lfts(2, 2, most=2, scales=(1.0,)), st.integers(0, 100))
def test_values_stay_and_the_order_does_not_grow(a: LFT, seed: int) -> None:
    plain = reduce_order(a)
    small = reduce_commuting(plain, dict.fromkeys(dict(plain.blocks), 0), 0.05)
    assert small.order <= plain.order
    points = np.random.default_rng(seed).uniform(-1, 1, (5, len(plain.blocks)))
    roundoff(evaluate_at(small, points), evaluate_at(plain, points), 1e6)


def test_no_time_changes_nothing() -> None:
    plain = reduce_order(case("O3"))
    assert reduce_commuting(plain, lower_bound(plain), 0.0) is plain


def test_planted_candidates_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """One with a wrong entry, and one that is singular on the range though its value is right."""
    plain = reduce_order(case("O3"))

    def wrong(a: LFT, name: str, deadline: float) -> object:
        yield LFT(a.M11, a.M12, 1.001 * a.M21, a.M22, a.blocks)
        grown = inverse(constant([[0.5]]) + delta("d1")) @ (constant([[0.5]]) + delta("d1"))
        yield a @ grown

    monkeypatch.setattr(commute, "_candidates", wrong)
    monkeypatch.setattr(commute, "_SLACK", 100)
    assert reduce_commuting(plain, lower_bound(plain), 1.0) is plain
