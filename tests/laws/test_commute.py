"""Laws of the search that uses commutation.

1. values stay and the order does not grow
2. known minimal orders of the literature are reached, whatever the way of writing, and minimal
   orders of scenes are recognized
3. another basis of a block leaves the value, and has the score that it was chosen for
4. a result with another value, or one that is singular on the range, is refused
"""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import mbdlft
from benchmarks.cases.arm import NAMES, closed_form, state_and_input
from benchmarks.cases.chains import chain
from mbdlft.bound.degree import lower_bound
from mbdlft.bound.pairs import joint_bound
from mbdlft.lft.evaluate import evaluate_at
from mbdlft.lft.lft import LFT, Block, constant, delta, inverse, stack_columns, stack_rows
from mbdlft.reduce import basis
from mbdlft.reduce import commuting as commute
from mbdlft.reduce.commuting import reduce_commuting
from mbdlft.reduce.exchange import search_exchanges
from mbdlft.reduce.lines import Lines, lines_of, total_degree, values_on
from mbdlft.reduce.reduce import reduce_order
from scenarios import two_link_arm
from tests.close import CLOSED_FORM, SCENARIO, roundoff, target
from tests.laws.lfts import lfts

SECONDS = 20.0  # far more than needed: all cases end at their bound


def smallest(plain: LFT, seconds: float = SECONDS) -> LFT:
    bound = lower_bound(plain)
    return reduce_commuting(
        [plain], bound, seconds, lambda a, stop: joint_bound(a, bound, stop)
    ).lft


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
    small = smallest(plain)
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
    small = smallest(plain, 0.05)
    assert small.order <= plain.order
    points = np.random.default_rng(seed).uniform(-1, 1, (5, len(plain.blocks)))
    roundoff(evaluate_at(small, points), evaluate_at(plain, points), 1e6)


def test_no_time_changes_nothing() -> None:
    plain = reduce_order(case("O3"))
    assert smallest(plain, 0.0) is plain


@pytest.mark.parametrize(
    ("spatial", "links", "order"), [(False, 2, 15), (True, 2, 21), (False, 3, 30)]
)
def test_minimal_orders_of_chains(spatial: bool, links: int, order: int) -> None:
    """Reached, and recognized as the smallest: the search then ends."""
    model = mbdlft.to_lft(chain(links, spatial=spatial), search=SECONDS)
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


def around(a: LFT) -> tuple[LFT, Lines]:
    """The LFT around a point where nothing vanishes by chance, and lines for it."""
    shift = 0.05 + 0.1 * np.random.default_rng(5).random(len(a.blocks))
    return commute._around(a, shift), lines_of(lower_bound(a), 3)


def law_bases(a: LFT) -> int:
    """Every basis that is offered leaves the value, and has its score; returns how many there were."""
    start, lines = around(a)
    points = np.random.default_rng(4).uniform(-0.2, 0.2, (5, len(a.blocks)))
    expected, count = evaluate_at(start, points), 0
    for name, size in start.blocks:
        opened = basis.open_block(start, name)
        values = values_on(opened, lines, diagonal=True)
        for choice in basis.choices(values, size, 3, 1, np.random.default_rng(0)):
            changed = basis.choose_values(values, size, choice)
            if changed is None:
                continue
            made = basis.settle(basis.choose(opened, size, choice, 400), lines)
            assert total_degree(values_on(made, lines), lines) == total_degree(changed, lines)
            plain = basis.affine_form(opened, made, size, choice.size, lines)
            closed = basis.close_block(plain, Block(name, choice.size))
            roundoff(evaluate_at(closed, points), expected, 1e5)
            score = total_degree(changed, lines)
            found, moves = search_exchanges(changed, choice.size, lines, score, 0, 40, 1)
            for move in moves:
                made = basis.settle(basis.exchange(made, choice.size, move, 400), lines)
            assert total_degree(values_on(made, lines), lines) == found <= score
            closed = basis.close_block(made, Block(name, choice.size))
            roundoff(evaluate_at(closed, points), expected, 1e5)
            count += 1
    return count


@pytest.mark.parametrize("name", ["O1", "O3", "O13"])
def test_other_bases_leave_the_value(name: str) -> None:
    assert law_bases(reduce_order(case(name))) > 3


def test_planted_bases_are_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """A basis on one side only, and an exchange that forgets the other columns."""
    plain = reduce_order(case("O13"))
    right = basis._change

    def one_sided(a: LFT, S: LFT, T: LFT, largest: int) -> LFT:
        return right(a, S, 1.01 * np.eye(T.shape[0]) @ T, largest)

    monkeypatch.setattr(basis, "_change", one_sided)
    with pytest.raises(AssertionError):
        law_bases(plain)


def test_planted_affine_form_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """The difference of values at the wrong delta."""
    plain = reduce_order(case("O1"))
    law_bases(plain)
    right = basis.fix
    monkeypatch.setattr(basis, "fix", lambda a, values: right(a, dict.fromkeys(values, 1.01)))
    with pytest.raises(AssertionError, match="relative error"):
        law_bases(plain)


def test_planted_candidates_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """A wrong entry, and a result that is singular on the range though its value is right."""
    plain = reduce_order(case("O3"))
    right = commute.choose

    def wrong(opened: LFT, r: int, choice: basis.Choice, largest: int) -> LFT:
        a = right(opened, r, choice, largest)
        return LFT(a.M11, a.M12, 1.001 * a.M21, a.M22, a.blocks)

    assert smallest(plain, 5.0).order == 3
    monkeypatch.setattr(commute, "choose", wrong)
    monkeypatch.setattr(commute, "_moved", lambda a, stop: ())  # these would be enough here
    monkeypatch.setattr(commute, "independent", lambda a: a)
    monkeypatch.setattr(commute, "refit", lambda forms, *_: forms[0])
    assert smallest(plain, 1.0) is plain
    monkeypatch.setattr(commute, "_keeps", lambda candidate, search: True)
    small = smallest(plain, 1.0)
    points = np.random.default_rng(2).uniform(-0.9, 0.9, (50, len(plain.blocks)))
    with pytest.raises(AssertionError, match="relative error"):
        roundoff(evaluate_at(small, points), evaluate_at(plain, points), 1e4)


def test_singular_results_are_refused() -> None:
    """(p / p) H has the value of H where p is not zero, and p vanishes on the range."""
    plain = reduce_order(case("O3"))
    p = constant([[0.5]]) + delta("d1")
    singular = plain @ (inverse(p) @ p)
    search = commute._Search(lower_bound(plain), lambda: False, plain)
    assert commute._keeps(plain, search)
    assert not commute._keeps(singular, search)
