"""Laws of repetitions of one delta that are exchanged for fewer of another, in exact numbers."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from mbdlft import to_lft
from mbdlft.exact import matrices
from mbdlft.exact.numbers import BITS, precision
from mbdlft.lft.lft import Block
from mbdlft.lft.sampling import evaluate
from mbdlft.multibody.to_problem import problem_of_scene
from mbdlft.order.exchange import _special, plans, with_exchanges
from mbdlft.order.lower_bound import at_random
from mbdlft.order.reduction import ExactLFT, transposed
from mbdlft.order.restriction import Step
from mbdlft.order.search import Smallest
from mbdlft.pipeline import stages
from mbdlft.pipeline.forms import Candidate, exchanged, restricted
from tests.close import SCENARIO, target
from tests.extracted import FIELD
from tests.extracted import with_bits as with_bits
from tests.strategies import random_scene

# repetitions after reduction, and after exchanges
CASES = {
    243: ({"r2": 2, "theta3": 14}, {"r2": 3, "theta3": 12}),  # of transposed relations
    542: (  # one line of four
        {"L1": 2, "L2": 1, "r3": 1, "theta4": 24},
        {"L1": 3, "L2": 1, "r3": 1, "theta4": 20},
    ),
    # lines of two at one value of a mass alone, one of three that are zeros, and at infinity
    146: ({"m1": 2, "theta2": 8}, {"m1": 3, "theta2": 6}),
    93: ({"m1": 4, "rho2": 1, "theta3": 6}, {"m1": 5, "rho2": 1, "theta3": 4}),
}


def made(seed: int) -> tuple[Candidate, Candidate | None]:
    """Without exchanges, and with them."""
    problem = problem_of_scene(random_scene(seed))
    candidate = restricted(problem, problem.forms[0])
    assert candidate is not None
    return candidate, exchanged(problem, candidate, (), candidate.lft.order)


def exact(candidate: Candidate) -> ExactLFT:
    assert isinstance(candidate.exact, ExactLFT)
    return candidate.exact


@pytest.mark.parametrize("seed", CASES)
def test_exchanges_keep_the_value(seed: int) -> None:
    plain, smaller = made(seed)
    assert smaller is not None
    before, after = CASES[seed]
    assert {name: size for name, size in exact(plain).blocks if size} == before
    assert dict(exact(smaller).blocks) == dict.fromkeys(dict(exact(plain).blocks), 0) | after
    values = [at_random(exact(x))[exact(x).order :, exact(x).order :] for x in (plain, smaller)]
    assert np.array_equal(*values)
    points = {name: np.linspace(-1.0, 1.0, 5) * (-1) ** k for k, name in enumerate(before)}
    target(evaluate(smaller.lft, points), evaluate(plain.lft, points), SCENARIO)
    with precision(BITS):
        assert not any(plans(exact(smaller)))


def test_relations_are_extracted_once() -> None:
    """From a candidate that is known, and from what was made in other bits, the same is made."""
    problem, first = problem_of_scene(random_scene(243)), made(243)[0]
    steps = [Step("theta3", is_transposed=True, of_relations=True)]
    form = problem.forms[0]
    assert first.exactly is not None
    bits, relations = first.exactly
    other = replace(first, exactly=(2 * bits, transposed(relations)))
    expected = restricted(problem, form, steps)
    assert expected is not None
    for known in (first, other):
        found = restricted(problem, form, steps, known=known)
        assert found is not None
        assert np.array_equal(exact(found).M.residues, exact(expected).M.residues)
        assert np.array_equal(found.lft.M11, expected.lft.M11)


def test_what_costs_more_than_its_lines_is_not_exchanged() -> None:
    """One line would do for two directions; with other poles than that it costs three repetitions."""
    plain, smaller = made(1220)
    with precision(BITS):
        assert any(plans(exact(plain)))
        assert with_exchanges(exact(plain)).blocks == exact(plain).blocks
    assert smaller is None


def test_a_zero_inside_of_the_range_is_no_line() -> None:
    """Its residue was tried with the values of others, and its directions were taken for theirs."""
    prime = FIELD.prime
    M = matrices.of_integers(np.array([[8, 0], [0, 1], [4, 0], [0, 4], [0, 0]]), prime)  # zeros 2, 1/4
    quarter = pow(4, -1, prime)
    four = matrices.of_integers(np.diag([4, 4, 4, 4, 1]), prime)
    M = four.solve(M)
    (line,) = _special(ExactLFT(M, (Block("b", 2),)), 1, 2)
    assert line.residue == quarter
    assert float(line.values[0]) == 0.25


def test_models_are_searched_from_exchanges() -> None:
    """Work for no step of a search: 49 repetitions become 46 by a line of four, balanced."""
    assert dict(to_lft(random_scene(32), search=1e-6).lft.blocks)["theta3"] == 40


def test_steps_are_exchanged(monkeypatch: pytest.MonkeyPatch) -> None:
    """What the steps of a search lead to is exchanged, too: here the first of them changes nothing."""

    def search(reduced: list[Candidate], *_: object, **__: object) -> Smallest:
        return Smallest(reduced[0].lft, 0, steps=((0, ()),))

    calls = []

    def after_the_first(*of: Any) -> Candidate | None:
        calls.append(of)
        return exchanged(*of) if len(calls) > 1 else None

    monkeypatch.setattr(stages, "exchanged", after_the_first)
    monkeypatch.setattr(stages, "_search", search)
    monkeypatch.setattr(stages, "_searched_exactly", lambda _, __, result, *___: result)
    assert to_lft(random_scene(557)).order == 9
