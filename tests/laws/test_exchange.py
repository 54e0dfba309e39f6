"""Laws of repetitions of one delta that are exchanged for fewer of another, in exact numbers."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import flint
import numpy as np
import pytest

from mbdlft import to_lft
from mbdlft.exact import matrices
from mbdlft.exact.modular import done
from mbdlft.exact.numbers import BITS, RESIDUES_ALONE, TooFewBitsError, ask_for_bits, precision
from mbdlft.lft.lft import LFT, Block
from mbdlft.lft.sampling import evaluate
from mbdlft.multibody.to_problem import problem_of_scene
from mbdlft.order.exchange import Exchange, _along, _far_outside, _left_out, _LeftOut, _opened, _zeros
from mbdlft.order.lower_bound import at_random, exact_degrees
from mbdlft.order.paths import Impossible, Node, Path, exchanged, path_below
from mbdlft.order.reduction import ExactLFT, transposed
from mbdlft.order.restriction import Step
from mbdlft.order.work import UNIT, Work
from mbdlft.pipeline import forms, smaller, stages
from mbdlft.pipeline.forms import Candidate, candidate_of, candidates, restricted
from mbdlft.pipeline.smaller import Restricted, restrictions, smaller_candidates
from mbdlft.problem.relations import Form, Problem
from scenarios import two_link_arm
from tests.close import SCENARIO, target
from tests.cross.mechanisms import open_tree
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
    # two of the mass for two of the angle, and back for six by lines of six and of four at infinity
    79: ({"m1": 6, "theta2": 26}, {"m1": 6, "theta2": 22}),
}


def plain_of(seed: int) -> tuple[Problem, Candidate]:
    """Without exchanges."""
    problem = problem_of_scene(random_scene(seed))
    candidate = restricted(problem, problem.forms[0])
    assert candidate is not None
    return problem, candidate


def made(seed: int) -> tuple[Candidate, Candidate | None]:
    """Without exchanges, and with them."""
    problem, candidate = plain_of(seed)
    return candidate, next(smaller_candidates(problem, start(candidate), 0, Work(2.0)), None)


def start(candidate: Candidate) -> list[Restricted]:
    """No block of it is restricted."""
    return restrictions(candidate, dict(candidate.lft.blocks), 0, Work())[:1]


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
    if seed != 79:  # it takes more bits, which have another prime
        values = [at_random(exact(x))[exact(x).order :, exact(x).order :] for x in (plain, smaller)]
        assert np.array_equal(*values)
    points = {name: np.linspace(-1.0, 1.0, 5) * (-1) ** k for k, name in enumerate(before)}
    target(evaluate(smaller.lft, points), evaluate(plain.lft, points), SCENARIO)


def test_relations_are_extracted_once() -> None:
    """From a candidate that is known the same is made, in no fewer bits."""
    problem, first = plain_of(243)
    steps = [Step("theta3", is_transposed=True, of_relations=True)]
    form = problem.forms[0]
    assert first.exactly is not None
    bits, relations = first.exactly
    others = (2 * bits, relations), (bits // 2, transposed(relations))
    expected = restricted(problem, form, steps)
    assert expected is not None
    for exactly in (first.exactly, *others):
        found = restricted(problem, form, steps, known=replace(first, exactly=exactly))
        assert found is not None
        assert found.exactly is not None
        assert found.exactly[0] == max(bits, exactly[0])
        assert np.array_equal(exact(found).M.residues, exact(expected).M.residues)
        assert np.array_equal(found.lft.M11, expected.lft.M11)


def test_one_exchange_there_leads_to_one_back() -> None:
    """It gains nothing of its own; all ends at the bound."""
    a = start(plain_of(79)[1])[0].lft
    there = Exchange("m1", "theta2", True, "any", (1, 1, 1, 1))
    back = Exchange("theta2", "m1", True, "infinite", (6, 4))
    assert path_below([Node(a)], a.order, 28, Work(2.0))[:3] == (0, (there, back), 28)
    assert path_below([Node(a)], a.order, a.order, Work(2.0))[:3] == (0, (), a.order)
    with precision(RESIDUES_ALONE):  # the smallest on the way, and not the last
        assert exchanged(a, (there,)) == (a, None)


@pytest.mark.parametrize(("seed", "order"), [(4, 27), (1, 42)])
def test_zeros_of_trees(seed: int, order: int) -> None:
    """Zeros with chains of two, and chains of one at a zero of longer ones."""
    problem = problem_of_scene(open_tree(seed))
    candidate = restricted(problem, problem.forms[0])
    assert candidate is not None
    _, path, wanted, *_ = path_below(
        [Node(start(candidate)[0].lft)], candidate.lft.order, order, Work(2.0)
    )
    assert wanted <= order
    assert any(exchange.kind == "zeros" for exchange in path)
    smaller = next(smaller_candidates(problem, start(candidate), order, Work(2.0)))
    assert smaller.lft.order < candidate.lft.order  # in balls, doubles choose the directions
    points = {name: np.linspace(-1.0, 1.0, 5) for name, _ in smaller.lft.blocks}
    target(evaluate(smaller.lft, points), evaluate(candidate.lft, points), SCENARIO)


def test_what_is_not_possible_is_not_tried_again() -> None:
    """A path ends where no chains are; other chains than residues foretell are used, and told.

    Zeros, which may not be real, can be left out. What is known of a start costs no work again.
    """
    candidate = plain_of(146)[1]
    a, node, work = exact(candidate), Node(start(candidate)[0].lft), Work(2.0)
    first, path, order, *_ = path_below([node], a.order, 9, work)
    (exchange,), spent, nothing = path, work.spent, (0, (), a.order)
    assert (first, exchange.kind, order) == (0, "zeros", 9)
    assert path_below([node], a.order, 9, work)[:3] == (first, path, order)
    assert work.spent == spent > 0.0
    assert path_below([node], a.order, 9, work, with_zeros=False)[:3] == nothing
    assert path_below([node], a.order, 9, work, {(a.blocks, exchange)})[:3] == nothing
    longer, other_side = exchange._replace(lengths=(3,)), exchange._replace(is_transposed=False)
    with precision(BITS):
        b, failed = exchanged(a, (longer, exchange))
        assert (b.order, failed) == (9, (a.blocks, longer))
        b, failed = exchanged(a, (exchange, longer))
        assert (b.order, failed) == (9, (b.blocks, longer))
        assert exchanged(a, (other_side, exchange)) == (a, (a.blocks, other_side))


def test_a_path_that_is_not_possible_is_not_made_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """Another one is looked for."""
    problem, candidate = plain_of(79)
    tried = list[Path]()

    def failing(a: ExactLFT, path: Path) -> tuple[ExactLFT, Impossible]:
        tried.append(path)
        return a, (a.blocks, path[0])

    monkeypatch.setattr(smaller, "exchanged", failing)
    assert not [*smaller_candidates(problem, start(candidate), 28, Work(2.0))]
    assert len(set(tried)) == len(tried) > 1


def test_what_is_of_no_use_is_not_made_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """Singular somewhere, say: other exchanges follow."""
    problem, candidate = plain_of(79)
    first = list[Exchange]()

    def useless(_: Problem, __: Restricted, then: Any) -> None:
        first.append(then.args[0][0])

    monkeypatch.setattr(smaller, "_made", useless)
    assert not [*smaller_candidates(problem, start(candidate), 28, Work(2.0))]
    assert len(set(first)) == len(first) > 1


def test_candidates_are_made_when_they_are_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    """A mass on one side and exchanges, then without these, then exchanges alone; none below a bound."""
    problem, candidate = plain_of(93)
    known = restrictions(candidate, exact_degrees(exact(candidate)), 0, Work())
    made = list[int]()

    def counted(problem: Problem, form: Form, steps: Sequence[Step], **others: Any) -> Candidate | None:
        made.append(len(steps))
        return candidate_of(problem, form, steps, **others)

    monkeypatch.setattr(forms, "candidate_of", counted)
    found = smaller_candidates(problem, known, 0, Work(2.0))
    assert [(next(found).lft.order, len(made)) for _ in range(3)] == [(9, 1), (10, 2), (9, 3)]
    assert made == [1, 1, 0]
    assert next(smaller_candidates(problem, known, 10, Work(2.0))).lft.order == 10


def test_the_work_of_exchanges_is_what_is_done_in_residues() -> None:
    """A look has a part of it, and ends with the attempt in which this is spent."""
    candidate = plain_of(93)[1]
    for most in (0.02, 0.08):
        node, work = Node(start(candidate)[0].lft), Work(most)
        before = done.operations
        path_below([node], exact(candidate).order, 0, work)
        assert 0.5 * most < work.spent < most + 0.05
        assert 0.6 * work.spent < (done.operations - before) / UNIT < work.spent


def test_a_path_of_too_much_work_is_not_made() -> None:
    """In balls an exchange takes some times as long as in residues; what it takes is spent."""
    problem, candidate = plain_of(79)
    lft, looked, made = start(candidate)[0].lft, Work(2.0), Work(2.0)
    assert path_below([Node(lft, units=0.5)], lft.order, 28, looked).order == lft.order
    assert path_below([Node(lft)], lft.order, 28, looked := Work(2.0)).order == 28
    assert [*smaller_candidates(problem, start(candidate), 28, made)]
    assert made.spent > 2.0 * looked.spent > 0.0


def test_coordinates_are_found_in_few_bits(monkeypatch: pytest.MonkeyPatch) -> None:
    """In those that the LFT was made in where fewer are not enough."""
    a, used = exact(plain_of(93)[1]), list[int]()

    def coordinates(a: ExactLFT, *_: object) -> LFT:
        used.append(flint.ctx.prec)
        ask_for_bits(2 * BITS)
        return a.rounded()

    monkeypatch.setattr(forms, "in_good_coordinates", coordinates)
    with precision(4 * BITS):
        forms._in_few_bits(a, np.zeros((1, len(a.blocks))), 0.0)
    assert used == [BITS, 4 * BITS]


def test_values_are_tried_one_after_the_other() -> None:
    """A residue does not tell which ball is its own: that of another zero is not taken for it."""
    a = exact(plain_of(146)[1])
    with precision(BITS):
        opened = _opened(a, "theta2", "m1", is_transposed=True)
        assert opened is not None
        left_out = _left_out(opened, 2, "zeros")
        assert left_out.free is None
        other = [flint.arb(1) / 3]
        results = [_along(a, opened, with_values(left_out, some)) for some in ([], other)]
        assert [x and x.order for x in results] == [9, 9]
        with pytest.raises(TooFewBitsError):
            _along(a, opened, with_values(left_out, other, others=False))


def with_values(left_out: _LeftOut, some: list[Any], *, others: bool = True) -> _LeftOut:
    """With other values of lines first."""
    return left_out._replace(
        lines=[line._replace(values=[*some, *(others * line.values)]) for line in left_out.lines]
    )


def test_a_zero_inside_of_the_range_is_no_line() -> None:
    """Its residue was tried with the values of others, and its directions were taken for theirs."""
    prime = FIELD.prime
    M = matrices.of_integers(np.array([[8, 0], [0, 1], [4, 0], [0, 4], [0, 0]]), prime)  # zeros 2, 1/4
    quarter = pow(4, -1, prime)
    four = matrices.of_integers(np.diag([4, 4, 4, 4, 1]), prime)
    M = four.solve(M)
    ((residue, values),) = _zeros(ExactLFT(M, (Block("b", 2),)), 1, 2)
    assert residue == quarter
    assert float(values[0]) == 0.25


def test_directions_of_chains_that_depend() -> None:
    """The direction that is farthest outside is one that they do not have; those of zero have none."""
    chains, K = np.array([[[1.0, 1.0], [0.0, 0.0], [0.0, 0.0]]]), np.array([[1.0], [0.0], [-1.0]])
    assert _far_outside(chains, K, np.eye(4)).all()
    with pytest.raises(TooFewBitsError):
        _far_outside(0.0 * chains, K, np.eye(4))


def test_models_are_searched_from_exchanges() -> None:
    """49 repetitions become 46 by a line of four, balanced."""
    assert dict(to_lft(random_scene(32)).lft.blocks)["theta3"] == 40


@pytest.mark.parametrize(("seed", "most", "of"), [(93, 1, {True, False}), (203, 2, {True})])
def test_residues_foretell_restrictions(seed: int, most: int, of: set[bool]) -> None:
    """Of relations and of the closed LFT; in balls they have the same blocks and the same value."""
    problem = problem_of_scene(random_scene(seed))
    (candidate,) = candidates(problem, problem.forms[:1])
    value = at_random(exact(candidate))[exact(candidate).order :, exact(candidate).order :]
    known = restrictions(candidate, exact_degrees(exact(candidate)), 0, Work())
    assert known[0].steps == ()
    assert max(len(small.steps) for small in known) == most
    assert {step.of_relations for small in known for step in small.steps if step.name} == of
    for small in known:
        assert np.array_equal(at_random(small.lft)[small.lft.order :, small.lft.order :], value)
        in_balls = restricted(problem, candidate.form, small.steps, known=candidate)
        assert in_balls is not None
        assert exact(in_balls).blocks == small.lft.blocks


@pytest.mark.parametrize(("seed", "order"), [(93, 9), (172, 13), (1, 7)])
def test_blocks_are_restricted_before_they_are_exchanged(seed: int, order: int) -> None:
    """A mass or a length on one side, and two of another parameter for one of it.

    The last one goes on from the second LFT of its order.
    """
    model = to_lft(random_scene(seed))
    assert model.order == order
    assert model.certificate.minimal


def test_what_is_of_no_use_is_followed_by_the_next(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without exchanges, if the smallest one has lost digits."""
    lost = stages._what_is_lost
    monkeypatch.setattr(stages, "_what_is_lost", lambda a, *others: a.order < 10 or lost(a, *others))
    assert to_lft(random_scene(93)).order == 10


def test_a_second_block_is_restricted_where_the_first_gains_nothing() -> None:
    """A length on one side, 36 repetitions for 35, then on the other one: 31, the bound."""
    problem = problem_of_scene(open_tree(6))
    (candidate,) = candidates(problem, problem.forms[:1])
    known = restrictions(candidate, exact_degrees(exact(candidate)), 0, Work())
    assert min(known, key=lambda small: small.lft.order).steps == (
        Step("L", is_transposed=False, of_relations=True),
        Step("L", is_transposed=True, of_relations=True),
    )


def test_a_mass_is_moved_inside_of_lengths() -> None:
    """Its basis then leaves these outside: 16 repetitions of the arm, the bound, and 17 otherwise."""
    problem = problem_of_scene(two_link_arm.scene())
    (candidate,) = candidates(problem, problem.forms[:1])
    known = restrictions(candidate, exact_degrees(exact(candidate)), 0, Work())
    inside = [small for small in known if any(step.is_inside for step in small.steps)]
    value = at_random(exact(candidate))[exact(candidate).order :, exact(candidate).order :]
    for small in inside:
        assert np.array_equal(at_random(small.lft)[small.lft.order :, small.lft.order :], value)
    assert min(small.lft.order for small in inside) == 16
    assert min(small.lft.order for small in known if small not in inside) == 17
