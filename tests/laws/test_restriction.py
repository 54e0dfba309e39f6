"""Laws of blocks that are restricted in exact numbers."""

from pathlib import Path

import numpy as np
import pytest

from mbdlft import load_scene, to_lft
from mbdlft.exact.numbers import BITS
from mbdlft.lft.lft import LFT, constant, delta, inverse, stack_columns, stack_rows
from mbdlft.lft.sampling import evaluate
from mbdlft.multibody.to_problem import problem_of_scene
from mbdlft.order import reduction
from mbdlft.order.lower_bound import at_random
from mbdlft.order.reduction import ExactLFT, reduce_exactly, reduce_order, transposed
from mbdlft.order.restriction import Step, _stays_outside, _varying, restricted_exactly, value_at_random
from mbdlft.pipeline.forms import candidates, restricted
from tests.attack.frames import scene_of, structure
from tests.close import SCENARIO, roundoff
from tests.cross.mechanisms import open_tree
from tests.extracted import exactly
from tests.extracted import with_bits as with_bits


def test_steps_in_exact_numbers_keep_digits() -> None:
    """What is left of a block has few zeros to keep: it comes in the coordinates of its signals."""
    problem = problem_of_scene(open_tree(29))
    step = Step("th", is_transposed=True, of_relations=True)
    found = restricted(problem, problem.forms[0], [step])
    assert found is not None
    assert isinstance(found.exact, ExactLFT)
    deltas = np.array([[0.0, 0.0, 0.0], [1.0, 1.0, 1.0], [-0.9, 0.8, 0.5]])
    assert reduction._lost(found.lft, deltas) < 0.2 * reduction._lost(found.exact.rounded(), deltas)


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


def test_values_at_random_of_some_outputs() -> None:
    """By the channels that they see, and by rows or columns; another way has all of them."""
    product = power(delta("d1"), 3) @ delta("d2")  # its output reads one of its channels
    below = stack_columns(product, inverse(numbers(2.0) + product), delta("d1"))
    whole = exactly(stack_rows(case("O1"), below, below @ case("O13")))
    for a in (whole, transposed(whole)):
        for count in (None, 1, 2):
            assert np.array_equal(value_at_random(a, 0, count), residues_of(a)[:count])


def test_outputs_that_vary() -> None:
    """One has no term of first order; a b - b a is zero, which channels do not show."""
    a, b = delta("a"), delta("b")
    whole = exactly(stack_rows(a @ b, a, a @ b - b @ a, numbers(2.0)))
    assert _varying(whole.M.residues, whole.blocks, whole.M.prime).tolist() == [0, 1]


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
    if name == "O3":
        return stack_rows(d1 @ d2 @ d3, d2 @ d3 @ d1, d3 @ d1 @ d2)
    assert name == "O13"
    rows = (
        (5.0 * np.eye(1) @ a - 1.0, -10.0 * np.eye(1) @ (1.0 + b), 1.0 + b),
        (10.0 * np.eye(1) @ (1.0 + power(c, 2)), -1.0 - a @ b @ c, c),
        (numbers(1.0), numbers(1.0), numbers(0.0)),
    )
    return stack_rows(*(stack_columns(*row) for row in rows))


@pytest.mark.parametrize("name", ["O1", "O3", "O13"])
def test_blocks_of_matrices(name: str) -> None:
    law_restricted(reduce_order(case(name)))


def test_a_basis_keeps_bits() -> None:
    """In columns of powers, that of a frame would need twice as many."""
    problem = problem_of_scene(scene_of(structure(880042)))
    step = Step("h", is_transposed=True, of_relations=True)
    found = restricted(problem, candidates(problem, problem.forms)[0].form, [step])
    assert found is not None
    assert found.exactly is not None
    assert found.exactly[0] == BITS


def test_polynomial_deltas_are_told() -> None:
    """No path leads from a channel back to it, and some lead from one to another one."""
    b = delta("b")
    for a, expected in ((power(b, 5), True), (b, False), (inverse(numbers(2.0) + power(b, 2)), False)):
        whole = reduce_exactly(exactly(delta("a") @ a))
        assert _stays_outside(whole, "a", whole.blocks[1]) is expected
        assert not _stays_outside(whole, "b", whole.blocks[1])


def test_a_result_that_has_lost_digits_is_made_again() -> None:
    """Voltages of patches stand in bending and in tension: 53 repetitions, 47 with a block restricted."""
    model = to_lft(load_scene(ROOT / "scenarios" / "piezo_beam.toml"))
    assert model.order == 47
    assert model.certificate.max_relative_error < SCENARIO


def test_a_block_at_its_degree_leads_to_the_bound() -> None:
    """An angle restricted on both sides, and repetitions exchanged: 29, where each alone ends at 30."""
    model = to_lft(open_tree(1004))
    assert dict(model.lft.blocks) == {"k": 5, "th": 24}
    assert model.certificate.minimal
