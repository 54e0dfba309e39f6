"""Laws of analyses of systems that are small, empty, or badly scaled; all were found by chance."""

from dataclasses import replace

import numpy as np

from mbdlft import Block, Parameter, check_stability, realize, robust_stability, verify, worst_case_gain
from mbdlft.robust.evidence import BoxProof
from tests.reference.robust_cases import of_matrices


def test_a_second_face_may_have_no_zeros_left() -> None:
    """Both faces were found before the first was taken; on the first no zero was left to say so."""
    A = np.array([[-1.0, -6, -4, 1], [5, -9, 1, -6], [-1, 3, -7, 0], [0, -2, 5, -5]]) / 4.0
    B = np.array([[0, -1, -2, -1, 1, 0, 2], [2, 1, -1, 1, 1, 0, 1], [1, 1, -1, 0, 0, 1, -1]])
    B = 0.41802266 * np.vstack([B, [[0, 0, 1, 0, -2, 0, -1]]])
    C = [[0, 0, -1, 0], [0, -1, -1, -1], [0, -1, 2, -1], [-1, 1, -1, 0]]
    C = np.array([*C, [2, 0, 0, 0], [-1, 2, 0, -1], [0, 1, -1, 1.0]])
    blocks = Block("d0", 3), Block("d1", 2), Block("d2", 2)
    system = of_matrices(A, B, C, np.zeros((7, 7)), *blocks)
    found = robust_stability(system)
    assert isinstance(found.proof, BoxProof)
    assert found.proof.log == (6, 9, 0)  # d1 and d2 are largest, then nothing is cut
    assert verify(system, found) == ""
    wrong = replace(found, proof=replace(found.proof, log=(5, 9, 0)))
    assert verify(system, wrong)


K = Parameter("k", 2.0, low=1.0, high=3.0)


def test_a_gain_that_is_zero_is_proved_with_little_work() -> None:
    """One over a bound of zero is not tried for ever."""
    matrix = [["0", "1", "0"], ["-k", "-1", "1"], ["0", "0", "0"]]
    system = realize(matrix, [K], states=2, inputs=["force"], outputs=["nothing"], search=0.0)
    found = worst_case_gain(system)
    assert found.lower == 0.0
    assert found.upper < 1e-299
    assert found.work < 0.1
    assert found.reason == ""
    assert verify(system, found) == ""


def test_a_system_without_states_is_stable() -> None:
    system = realize([["k/(k + 1)"]], [K], inputs=["u"], outputs=["y"], search=0.0)
    assert check_stability(system).sentence == "stable: it has no states"
