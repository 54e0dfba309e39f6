"""Comparisons refuse what is wrong, NaN, and a promise of rounding that another kernel may break."""

import numpy as np
import pytest

from tests.close import CROSS, TRUNCATED, Method, target


@pytest.mark.parametrize(
    ("error", "bound", "message"),
    [
        (2e-9, CROSS, "relative error 2.00e-09, promised 1e-09"),
        (np.nan, CROSS, "relative error nan"),
        (2e-10, CROSS, "within a factor of 10 of 1e-09: another kernel"),
        (2e-9, TRUNCATED, "promised 1e-09"),
        (-2e-10, CROSS, "within a factor of 10"),
    ],
)
def test_refused(error: float, bound: float, message: str) -> None:
    with pytest.raises(AssertionError, match=message):
        target([1.0 + error, 0.5], [1.0, 0.5], bound)


def test_promises_with_room_and_promises_of_methods_are_kept() -> None:
    target([1.0 + 0.9e-10], [1.0], CROSS)
    target([1.0 + 0.9e-9], [1.0], Method(1e-9))
