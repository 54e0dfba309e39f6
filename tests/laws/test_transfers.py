"""Laws of transfer functions as certificates compare them."""

from dataclasses import replace

import numpy as np
import pytest

import mbdlft
from mbdlft.multibody.to_problem import problem_of_scene
from mbdlft.pipeline.certification import measure_error
from mbdlft.problem import references
from mbdlft.problem.relations import Problem
from tests.close import EPS, EVALUATION, roundoff
from tests.reference.chain_of_beams import scene as beams


@pytest.fixture(scope="module")
def arm() -> Problem:
    return problem_of_scene(mbdlft.load_scene("scenarios/two_link_arm.toml"))


def test_of_a_mass_and_a_spring() -> None:
    m, d, k, w = 2.0, 0.3, 8.0, np.array([0.0, 0.5, 2.0, 40.0])
    matrices = np.array([[[0.0, 1, 0], [-k / m, -d / m, 1 / m], [1, 0, 0], [-k / m, -d / m, 1 / m]]])
    position = 1.0 / (k - m * w**2 + 1j * w * d)
    expected = np.stack([position, -(w**2) * position], axis=1)[None, :, :, None]
    roundoff(references.transfers(matrices, 2, w), expected)
    # m v' + d v + k x - f, x' - v: solved for nothing
    slopes = np.array([[[1.0, 0, 0, -1, 0], [0, m, k, d, -1], [0, 0, 1, 0, 0], [0, 1, 0, 0, 0]]])
    roundoff(references.implicit_transfers(slopes, (2, 3, 2), w), expected)


def test_frequencies_are_around_the_poles_and_beside_them() -> None:
    A = np.array([[0.0, 1.0, 0.0], [-400.0, 0.0, 0.0], [0.0, 0.0, -0.5]])
    found = references.frequencies_of(A[None])
    assert found[0] < 0.1
    assert found[-1] > 20.0
    poles = np.abs(np.linalg.eigvals(A))
    assert np.min(np.abs(found[:, None] / poles - 1.0)) > 0.009
    for nothing in (np.zeros((1, 0, 0)), np.zeros((3, 2, 2))):
        assert np.all(references.frequencies_of(nothing) > 0.0)
    first = found[3] * 1.001
    again = references.frequencies_of(np.array([A, np.diag([-0.5, -first, -20.0])]))
    assert np.min(np.abs(again / first - 1.0)) > 0.009


def test_what_errors_are_relative_to() -> None:
    truth = np.zeros((1, 2, 3, 2), dtype=complex)
    truth[0, :, 0] = [[1.0, 0.1], [1e-3, 1e-4]]  # within the quiet of its row
    truth[0, :, 1] = [[1.0, 1.0], [1e-9, 0.0]]  # below it
    for row, size in ((0, 1e-3), (1, references.QUIET)):
        found = truth.copy()
        found[0, 1, row, 1] += 1e-8
        roundoff(references.largest_of_rows(found, truth), 1e-8 / size, kappa=1e8)
    found = truth.copy()
    found[0, :, 2] = 1.0  # a row of zeros has no size
    assert references.largest_of_rows(found, truth) == 0.0


def test_references_agree(arm: Problem) -> None:
    at, states = arm.reference(), len(arm.states)
    frequencies = references.frequencies_of(at.values[:1, :states, :states])
    digits = at.transfers_in_digits([0, 5], frequencies)
    assert references.largest_of_rows(at.transfers([0, 5], frequencies), digits) < 100.0 * EVALUATION
    assert (
        references.largest_of_rows(references.transfers(at.values[[0, 5]], states, frequencies), digits)
        < 1e-12
    )


def test_references_of_a_matrix_agree() -> None:
    problem = mbdlft.MatrixProblem(
        matrix=[["-1 - a", "2", "1"], ["-2", "-3*b", "0"], ["1", "b", "0"], ["1e9 + a", "1", "-1e9"]],
        parameters=[mbdlft.Parameter("a", 1, 0.5, 2), mbdlft.Parameter("b", 1, 0.5, 2)],
        states=["x1", "x2"],
    )
    model = mbdlft.realize(problem)
    assert 0.0 < model.certificate.transfer_error < 1e-12


def test_the_reference_is_that_of_what_was_not_solved(arm: Problem) -> None:
    """A derivative that is wrong in all of A, B, C and D of the reference is found by transfers."""
    scene = mbdlft.load_scene("scenarios/two_link_arm.toml")
    at, right = arm.reference(), mbdlft.to_lft(scene, search=0.0).lft
    wrong, lft = 1.001 * at.values, replace(right, M21=1.001 * right.M21, M22=1.001 * right.M22)
    with pytest.raises(mbdlft.AnalysisError, match="a transfer function of the model differs from"):
        measure_error(arm, lft, None, replace(at, values=wrong))

    def in_digits(points: np.ndarray) -> np.ndarray:
        return wrong[[int(np.argmin(np.abs(arm.points - p).sum(axis=1))) for p in points]]

    with pytest.raises(mbdlft.AnalysisError, match="a transfer function of the model differs from"):
        measure_error(arm, lft, None, replace(at, values=wrong, in_digits=in_digits))
    found = measure_error(arm, right, None, at)
    assert 0.0 < found.transfer_error < 1e-12
    assert len(found.frequencies) == 8


PLANTED = 1.0 + 1e-9


def test_small_errors_are_no_rounding(arm: Problem) -> None:
    """A trim and a transfer function that are wrong by 1e-9, and states that are left out and matter."""
    model = mbdlft.to_lft(mbdlft.load_scene("scenarios/two_link_arm.toml"), search=0.0)
    at, trim = arm.reference(), model.trim.lft
    assert trim is not None
    measure_error(arm, model.lft, trim, at)
    wrong = replace(trim, M21=PLANTED * trim.M21, M22=PLANTED * trim.M22)
    with pytest.raises(mbdlft.AnalysisError, match=r"torque of the trim differs from .* rounding"):
        measure_error(arm, model.lft, wrong, at)

    def transfers_in_digits(some: list[int], frequencies: np.ndarray) -> np.ndarray:
        return PLANTED * at.transfers_in_digits(some, frequencies)

    moved = replace(
        at,
        transfers=lambda some, frequencies: PLANTED * at.transfers(some, frequencies),
        transfers_in_digits=transfers_in_digits,
    )
    with pytest.raises(mbdlft.AnalysisError, match=r"a transfer function .* rounding"):
        measure_error(arm, model.lft, trim, moved)
    with pytest.raises(mbdlft.AnalysisError, match=r"states that are left out .* rounding"):
        measure_error(arm, model.lft, trim, replace(at, omitted=lambda: 1e6))


def test_what_rounding_makes_of_transfers() -> None:
    """1/(s + a) with a changed by a rounding, where s is near the pole."""
    a, w = 1e-3, np.array([1e-6, 1.0])
    matrices = np.array([[[-a, 1.0], [1.0, 0.0]]])
    rounding = np.array([[1e-12, 0.0], [0.0, 0.0]])
    found = references.rounded_transfers(matrices, 1, w, rounding)[0, :, 0, 0]
    expected = (1e-12 + EPS * np.abs(1j * w + a)) / np.abs(1j * w + a) ** 2
    roundoff(found, expected)
    moved = matrices - rounding
    change = np.abs(references.transfers(moved, 1, w) - references.transfers(matrices, 1, w))[0, :, 0, 0]
    assert np.all(change <= 1.001 * found)


def test_rounding_is_counted_and_accepted() -> None:
    """A, B, C, D of many beams cannot be written in doubles with all digits of their accelerations."""
    certificate = mbdlft.to_lft(beams(3, 6), search=0.0).certificate
    assert certificate.max_relative_error < certificate.transfer_error < 1e-6


def test_without_states_or_inputs_nothing_is_recorded() -> None:
    certificate = mbdlft.realize([["1/(2 + a)"]], [mbdlft.Parameter("a", 0, -1, 1)]).certificate
    assert certificate.frequencies == ()
    assert certificate.transfer_error == 0.0
