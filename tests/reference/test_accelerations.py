"""Accelerations of chained beams against one structure in 50 digits."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import mbdlft
from mbdlft.lft import lft as module
from mbdlft.number.rounding import cleaned
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
    right: Callable[..., Any] = module.through

    def wrong(base: Any, left: Any, matrix: Any, given: Any, what: str) -> Any:
        total, solved = right(base, left, matrix, given, what)
        terms = np.abs(matrix) @ np.abs(solved) + np.abs(given)
        size = np.abs(np.linalg.inv(matrix)) @ terms
        kept = cleaned(solved, 0.25 * size)
        return cleaned(total, np.abs(base) + np.abs(left) @ size), kept

    monkeypatch.setattr(module, "through", wrong)
    assert largest_error(3, 6) > ACCELERATION
