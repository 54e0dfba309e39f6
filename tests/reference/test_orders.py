"""Matrices of the literature: values against fractions, orders against the table, bounds proved."""

from collections.abc import Callable
from fractions import Fraction

import numpy as np
import pytest

import mbdlft
from benchmarks.cases.orders import CASES, Case, points
from benchmarks.cases.rewrite import exact_value, exact_values, rewritten
from mbdlft import LFTModel, MatrixProblem
from tests import kit
from tests.close import SCENARIO, target

WORK = {"O7": 3.0}  # no bound meets its order, so nothing but the budget ends the search
ENOUGH = 20.0  # for the others: the search ends at the bound, or when nothing new is found
REWRITTEN_WORK = 10.0
WAYS_OF_WRITING = 3  # the benchmark takes 100
SLOW = ("O1", "O7", "O8", "O11", "O12")  # seconds each

Realize = Callable[..., LFTModel]
LONG = ("O7", "O8")  # their searches end with their work, not at the bound
INSIDE = 250  # points beside the corners


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


def by_name(slow: tuple[str, ...]) -> pytest.MarkDecorator:
    """All cases; some of them are long."""
    return pytest.mark.parametrize(
        "case", [pytest.param(c, id=c.name, marks=[pytest.mark.long] * (c.name in slow)) for c in CASES]
    )


def law_certified(realize: Realize, case: Case) -> LFTModel:
    expected = exact_values(case.matrix, points(case, INSIDE))
    model = law_values(realize, case, case.matrix, expected, INSIDE)
    certificate = model.certificate
    assert certificate.max_relative_error <= SCENARIO
    assert all(a >= b for a, b in zip(certificate.order, certificate.lower_bound, strict=True))
    assert sum(certificate.lower_bound) <= case.bound
    return model


@by_name((*LONG, "O1", "O11"))
def test_values_are_those_of_the_matrix(case: Case) -> None:
    law_certified(mbdlft.realize, case)


@by_name((*LONG, "O1", "O11"))
def test_a_search_reaches_the_order_of_the_table(case: Case) -> None:
    model = law_certified(with_search, case)
    assert sum(model.certificate.lower_bound) == case.bound
    assert model.certificate.exact_bound
    assert model.order <= case.order
    assert model.certificate.minimal == (case.order == case.proved)


@by_name(SLOW)
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


# Degrees that can be counted by hand: parameters that stand in one place, linearly ------------------


def test_modulus_of_a_tree_of_beams() -> None:
    """A = -M^-1 (K_0 + E K_1): E is repeated as often as K_1 has rank, once for each elastic freedom."""
    section = {"density": 2700, "area": 4e-4, "I_z": 5e-8, "modulus": "E"}
    section["deformations"] = ["bending_y", "axial"]
    beams = [
        mbdlft.Beam(name=f"b{k}", length=1.0 + 0.1 * k, elements=3 - k % 2, **section) for k in range(3)
    ]
    joints = [
        kit.weld(
            f"f{k}", f"b{k - 1}.tip" if k else "hub", f"b{k}",
            orientation=[kit.turn((0, 0, 1), f"{20 + 10 * k}*deg")],
        )
        for k in range(3)
    ]  # fmt: skip
    scene = kit.scene(
        "tree of beams",
        mbdlft.Parameter("E", 70e9, percent=20, unit="Pa"),
        *(kit.body("hub", 40, (3, 4, 5)), *beams),
        *(kit.hinge("j", "ground", "hub", (0, 0, 1)), *joints),
    )
    model = mbdlft.to_lft(scene, search=0.0)
    freedoms = sum(3 * beam.elements for beam in beams)  # a deflection, a slope, an extension
    assert len(model.states) == 2 * (1 + freedoms)
    assert model.certificate.lower_bound == model.certificate.order == (freedoms,)
    assert model.certificate.exact_bound


def test_a_lag_of_every_mode() -> None:
    """Damping d in series with each of n oscillators: d is repeated n times, whatever else is there."""
    n = 6
    rows = [["0"] * (2 * n + 1) for _ in range(2 * n + 1)]
    for k in range(n):
        rows[2 * k][2 * k + 1] = "1"
        rows[2 * k + 1][2 * k] = f"-{(k + 1) ** 2}*1e{k}"
        rows[2 * k + 1][2 * k + 1] = f"-2*d*{k + 1}"
        rows[2 * k + 1][2 * n], rows[2 * n][2 * k] = "1", f"{k + 1}e-{k}"
    problem = mbdlft.MatrixProblem(
        matrix=rows,
        parameters=[mbdlft.Parameter("d", 0.01, low=0.005, high=0.03)],
        states=[f"x{k}" for k in range(2 * n)],
    )
    certificate = mbdlft.realize(problem, search=0.0).certificate
    assert certificate.order == certificate.lower_bound == (n,)
