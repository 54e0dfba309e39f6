"""Accelerations of chained beams against one structure in 50 digits."""

import numpy as np
import pytest

import mbdlft
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


@pytest.mark.parametrize(
    ("beams", "elements"), [(1, 8), (2, 4), pytest.param(3, 6, marks=pytest.mark.long)]
)
def test_accelerations_of_chained_beams(beams: int, elements: int) -> None:
    assert largest_error(beams, elements) <= ACCELERATION
