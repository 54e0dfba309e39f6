"""Laws of proofs of pairs and triples on residues.

1. where doubles see a pair clearly, residues prove it with the same numbers, and no other pair
2. the bound is the order of the smallest LFT where that is known
3. what rounding makes of nothing is not proved
"""

from collections.abc import Callable
from functools import cache

import numpy as np
import pytest

import mbdlft
from benchmarks.cases.orders import CASES
from mbdlft.exact.matrices import Residues
from mbdlft.exact.numbers import BITS, precision
from mbdlft.lft.lft import LFT
from mbdlft.matrix.relations import problem_of_matrix
from mbdlft.order import exact_pairs as module
from mbdlft.order.exact_degree import exact_degrees
from mbdlft.order.exact_pairs import is_constant, more_needed
from mbdlft.order.pairs import Triple, confirmation, joint_bound, pair_bounds
from mbdlft.order.reduction import ExactLFT
from mbdlft.order.work import Work
from mbdlft.pipeline.forms import candidates
from tests.extracted import lower_bound
from tests.laws.test_joint_bound import TWO_LETTERS, Word, words, words_of_two_letters
from tests.laws.test_joint_bound import known as known_in_doubles

Texts = list[list[str]]
RESIDUE = 1e-17  # what cancelling leaves of terms of size one


@pytest.fixture(autouse=True)
def with_bits() -> object:
    with precision(BITS):
        yield


def both(matrix: Texts | mbdlft.MatrixProblem) -> tuple[LFT, ExactLFT]:
    """The smallest LFT of a matrix before any search, in doubles and in exact numbers."""
    if not isinstance(matrix, mbdlft.MatrixProblem):
        names = sorted(
            {letter for row in matrix for text in row for letter in text if letter in "abcLm"}
        )
        parameters = [
            mbdlft.Parameter(name, 0.4 + 0.1 * k, -0.6, 1.4) for k, name in enumerate(names)
        ]
        matrix = mbdlft.MatrixProblem(matrix=matrix, parameters=parameters)
    problem = problem_of_matrix(matrix)
    found = candidates(problem, problem.forms)[0]
    return found.lft, found.exact


@cache
def o8() -> mbdlft.MatrixProblem:
    """O8 of the literature on order reduction, order 17 reached."""
    return next(case for case in CASES if case.name == "O8").problem()


def known(g: float, seed: int = 0, *, is_transposed: bool = False) -> Texts:
    """g [L^2 0 0 ; 0 0 0] + m N(L) as in `test_joint_bound.known`: 5 are needed, and 4 for g = 0."""
    random = np.random.default_rng(seed)
    numbers = random.uniform(0.5, 2.0, 9) * random.choice([-1, 1], 9)
    al, be, ga, de, ep, ze, et, ka, th = (f"({x!r})" for x in numbers.tolist())
    slope = f"m*({de} + {ep}*L)"
    rows = [
        [f"{g!r}*L^2 + m*({al} + {be}*L + {ga}*L^2)", slope, f"m*({ze} + {et}*L)"],
        [slope, f"{ka}*m", f"{th}*m"],
    ]
    return [list(row) for row in zip(*rows, strict=True)] if is_transposed else rows


def in_texts(terms: list[Word]) -> Texts:
    """A polynomial matrix of words, with two decimals of their vectors."""
    rows, columns = len(terms[0][0]), terms[0][2].shape[1]
    return [
        [
            " + ".join(
                f"({left[i, 0]:.2f})*({right[0, j]:.2f})*{'*'.join(letters)}"
                for left, letters, right in terms
            )
            for j in range(columns)
        ]
        for i in range(rows)
    ]


def law_same(matrix: Texts | mbdlft.MatrixProblem) -> int:
    """Pairs of doubles are those of residues; how many there are."""
    plain, exact = both(matrix)
    degrees = exact_degrees(exact)
    assert degrees == lower_bound(plain)
    found = pair_bounds(plain, degrees)
    confirmed = confirmation(exact, degrees, Work())
    for pair in found:
        assert confirmed(pair) == pair
    seen = {(pair.first, pair.second, pair.is_transposed) for pair in found}
    names = sorted(degrees)
    for k, first in enumerate(names):
        for second in names[k + 1 :]:
            for side in (False, True):
                needed = more_needed(exact, first, second, degrees, Work(), is_transposed=side)
                assert ((first, second, side) in seen) == (needed != (0, 0))
    return len(found)


def test_pairs_of_known_matrices() -> None:
    assert law_same(o8()) > 0
    for seed in range(3):
        assert law_same(known(1.0, seed)) > 0
        assert law_same(known(1.0, seed, is_transposed=True)) > 0
        assert law_same(known(0.0, seed)) == 0


@pytest.mark.parametrize("seed", range(12))
def test_pairs_of_words(seed: int) -> None:
    law_same(in_texts(words(np.random.default_rng(seed))))


def law_bound(expected: int, matrix: Texts | mbdlft.MatrixProblem) -> None:
    plain, exact = both(matrix)
    degrees, work = exact_degrees(exact), Work()
    assert joint_bound(plain, degrees, work, None, confirmation(exact, degrees, work)) == expected


def test_bounds_that_are_known() -> None:
    law_bound(17, o8())
    for is_transposed in (False, True):
        law_bound(5, known(1.0, is_transposed=is_transposed))
        law_bound(4, known(0.0, is_transposed=is_transposed))


@pytest.mark.parametrize("seed", TWO_LETTERS)
def test_triples(seed: int) -> None:
    """A confirmed bound is that of doubles."""
    matrix = in_texts(words_of_two_letters(np.random.default_rng(seed)))
    plain, exact = both(matrix)
    law_bound(joint_bound(plain, exact_degrees(exact)), matrix)


def law_rounding(g: float, *, is_confirmed: bool) -> int:
    """The bound for two inputs more that no delta changes, with rounding left; doubles see pairs."""
    plain, (_, exact) = known_in_doubles(g, 0), both(known(g))
    degrees, random = exact_degrees(exact), np.random.default_rng(0)
    left = RESIDUE * random.standard_normal((plain.order, 2))
    M22 = np.hstack([plain.M22, np.ones((plain.shape[0], 2))])
    rounded = LFT(plain.M11, np.hstack([plain.M12, left]), plain.M21, M22, plain.blocks)
    confirmed = confirmation(exact, degrees, Work()) if is_confirmed else None
    return joint_bound(rounded, degrees, confirmed=confirmed)


def test_pairs_that_rounding_makes_are_not_confirmed() -> None:
    assert law_rounding(0.0, is_confirmed=False) > 4
    assert law_rounding(0.0, is_confirmed=True) == 4


def law_work() -> None:
    """Nothing is proved when the work is over, and proofs are counted."""
    over, counted = Work(0.0), Work()
    over.add(1.0)
    assert over.is_over
    _, exact = both(known(1.0))
    degrees = exact_degrees(exact)
    for work, more in ((over, (0, 0)), (counted, (1, 1))):
        assert more_needed(exact, "L", "m", degrees, work, is_transposed=False) == more
    assert counted.spent > 0.0
    _, exact = both(in_texts(words_of_two_letters(np.random.default_rng(136))))
    degrees = exact_degrees(exact)
    for work, is_found in ((over, False), (counted, True)):
        names = ("a", "b", "c")
        assert is_constant(exact, names, degrees, work, is_transposed=True) == is_found


def test_work_is_counted() -> None:
    law_work()


def test_a_claim_is_looked_at_once() -> None:
    _, exact = both(o8())
    degrees, work = exact_degrees(exact), Work()
    confirmed, names = confirmation(exact, degrees, work), sorted(degrees)
    first = confirmed(Triple(*names[:3]))
    spent = work.spent
    assert confirmed(Triple(*names[:3])) is first
    assert work.spent == spent > 0.0


# planted bugs --------------------------------------------------------------------------------------


def powers_less(
    E: "module._Span",
    prime: int,
    *moves: dict[str, int],
    right: Callable[..., int] = module._inside,
) -> int:
    return right(E, prime, *({k: max(1, p - 1) for k, p in move.items()} for move in moves))


def few_samples(a: Residues, prime: int, right: Callable[..., int] = module.rank) -> int:
    return right(a[: len(a) // 2], prime)


def law_no_pairs() -> None:
    for seed in (2, 6, 8):
        law_same(in_texts(words(np.random.default_rng(seed))))


PLANTED: dict[str, tuple[object, str, object, Callable[[], None]]] = {
    "sections that need not vanish at infinity": (
        module,
        "_inside",
        powers_less,
        law_no_pairs,
    ),
    "a rank of half of the samples": (module, "rank", few_samples, lambda: law_bound(17, o8())),
    "all is constant": (
        module,
        "_inside",
        lambda E, prime, *moves: 0,
        lambda: law_bound(17, o8()),
    ),
}


@cache
def holds(law: Callable[[], None]) -> bool:
    law()
    return True


@pytest.mark.parametrize("bug", PLANTED)
def test_planted_bug_is_found(bug: str, monkeypatch: pytest.MonkeyPatch) -> None:
    owner, name, replacement, law = PLANTED[bug]
    assert holds(law)
    monkeypatch.setattr(owner, name, replacement)
    with pytest.raises(AssertionError):
        law()
