"""Matrices of the literature: values against fractions, orders against the table, bounds proved.

1. the value of the model is the matrix, at 1 000 random points and at corners
2. the order is not below the bound, and the search reaches the order of the table
3. the bound in exact arithmetic is that of the table, and that of double precision is not above it
4. none of this depends on how the entries are written
"""

from collections.abc import Callable
from fractions import Fraction

import numpy as np
import pytest

import mbdlft
from benchmarks.cases.orders import CASES, Case, points
from benchmarks.cases.rewrite import exact_value, exact_values, rewritten
from mbdlft import LFTModel, MatrixProblem
from tests.close import SCENARIO, target

WORK = {"O7": 3.0}  # no bound meets its order, so nothing but the budget ends the search
ENOUGH = 20.0  # for the others: the search ends at the bound, or when nothing new is found
REWRITTEN_WORK = 10.0
WAYS_OF_WRITING = 3  # the benchmark takes 100
SLOW = ("O7", "O8", "O11")  # seconds each

Realize = Callable[..., LFTModel]
LONG = ("O7", "O8")  # their searches end with their work, not at the bound


def law_values(
    realize: Realize, case: Case, rows: list[list[str]], expected: np.ndarray, inside: int
) -> LFTModel:
    model = realize(case.problem(rows))
    samples = points(case, inside)
    values = {name: np.array([sample[name] for sample in samples]) for name in samples[0]}
    blocks = mbdlft.matrices_at(model, values)
    upper = np.concatenate([blocks.A, blocks.B], axis=2)
    actual = np.concatenate([upper, np.concatenate([blocks.C, blocks.D], axis=2)], axis=1)
    for i in range(expected.shape[1]):
        for j in range(expected.shape[2]):
            target(actual[:, i, j], expected[:, i, j], SCENARIO)
    return model


def with_search(problem: MatrixProblem, work: float = ENOUGH) -> LFTModel:
    return mbdlft.realize(problem, search=WORK.get(problem.name, work))


@pytest.mark.parametrize(
    "case",
    [
        pytest.param(case, marks=pytest.mark.long if case.name in LONG else (), id=case.name)
        for case in CASES
    ],
)
def test_values_are_those_of_the_matrix(case: Case) -> None:
    expected = exact_values(case.matrix, points(case, 1000))
    for realize in (mbdlft.realize, with_search):
        model = law_values(realize, case, case.matrix, expected, 1000)
        certificate = model.certificate
        assert certificate.max_relative_error <= SCENARIO
        assert all(a >= b for a, b in zip(certificate.order, certificate.lower_bound, strict=True))
        assert sum(certificate.lower_bound) <= case.bound
    assert sum(certificate.lower_bound) == case.bound
    assert certificate.exact_bound
    assert model.order <= case.order
    assert certificate.minimal == (case.order == case.proved)


@pytest.mark.parametrize(
    "case",
    [pytest.param(case, id=case.name, marks=[pytest.mark.long] * (case.name in SLOW)) for case in CASES],
)
def test_the_way_of_writing_does_not_matter(case: Case) -> None:
    samples = points(case, 50)
    expected = exact_values(case.matrix, samples)
    for seed in range(WAYS_OF_WRITING):
        rows = rewritten(case.matrix, seed)
        at = {name: Fraction(7 * k + 3, 11 + k) for k, name in enumerate(samples[0])}
        assert [[exact_value(text, at) for text in row] for row in rows] == [
            [exact_value(text, at) for text in row] for row in case.matrix
        ]
        assert sum(mbdlft.exact_lower_bound(case.problem(rows)).values()) == case.bound
        seconds = REWRITTEN_WORK if case.order == case.proved else 0.5  # no proof ends the search
        model = law_values(
            lambda problem, seconds=seconds: with_search(problem, seconds), case, rows, expected, 50
        )
        assert model.order == case.order
