"""Accelerations of chained beams against one structure in 50 digits."""

import flint
import numpy as np
import pytest

import mbdlft
from mbdlft.exact.matrices import ExactMatrix, rough_values
from mbdlft.exact.rounding import cleaned
from mbdlft.order.reduction import ExactLFT, eliminated
from mbdlft.pipeline import forms
from tests.close import ACCELERATION
from tests.reference.chain_of_beams import accelerations, response_in_many_digits, scene

OMEGA = [0.1, 10.0, 1000.0]


def largest_error(beams: int, elements: int) -> float:
    """Of an acceleration, relative to the largest of its row at its frequency."""
    model = mbdlft.to_lft(scene(beams, elements), search=0.0)
    expected = accelerations(beams, elements, OMEGA)
    size = np.max(np.abs(expected), axis=2, keepdims=True)
    error = np.abs(response_in_many_digits(model, OMEGA) - expected)
    return float(np.max(error / np.where(size > 0.0, size, 1.0)))


@pytest.mark.parametrize(("beams", "elements"), [(1, 12), (3, 6)])
def test_accelerations_of_chained_beams(beams: int, elements: int) -> None:
    assert largest_error(beams, elements) <= ACCELERATION


def test_zeros_by_a_threshold_are_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """Entries far below their terms were set to zero: 3 beams of 8 elements were wrong by 70 %."""

    def wrong(a: ExactLFT, count: int, rows: list[int]) -> ExactLFT:
        M, n, found = rough_values(a.M), a.order, eliminated(a, count, rows)
        inner, others = slice(n, n + count), [*range(n), *range(n + count, M.shape[1])]
        outside = [*range(n), *range(n + count, M.shape[0])]
        inverse = np.linalg.inv(M[inner, inner])
        solved = np.abs(inverse @ M[inner, others])
        terms = np.abs(M[inner, inner]) @ solved + np.abs(M[inner, others])
        size = np.abs(inverse) @ terms
        rest = np.abs(M[outside][:, others]) + np.abs(M[outside][:, inner]) @ size
        sizes = np.vstack([rest[:n], 0.25 * size, rest[n:]])[[*range(n), *(n + k for k in rows)]]
        lost = cleaned(rough_values(found.M), sizes) == 0.0
        residues, balls = found.M.residues.copy(), found.M.balls.copy()
        residues[lost], balls[lost] = 0, flint.arb(0)
        return ExactLFT(ExactMatrix(residues, balls, found.M.prime), found.blocks)

    monkeypatch.setattr(forms, "eliminated", wrong)
    with pytest.raises(mbdlft.AnalysisError, match="differs from the nonlinear equations"):
        largest_error(3, 6)
