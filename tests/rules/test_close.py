"""Comparisons refuse what is wrong, NaN, and a promise of rounding that another kernel may break."""

import numpy as np
import pytest

from tests.close import CROSS, EPS, HARD, TRUNCATED, Method, conditioned, roundoff, target


@pytest.mark.parametrize(
    ("error", "bound", "message"),
    [
        (2e-9, CROSS, "relative error 2.00e-09, promised 1e-09"),
        (np.nan, CROSS, "relative error nan"),
        (2e-10, CROSS, "within a factor of 10 of 1.0e-09: another kernel"),
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


@pytest.mark.parametrize("kappa", [1.0, 1e3])
def test_identities_and_conditioned_numbers_keep_their_room(kappa: float) -> None:
    for compare, bound in ((roundoff, 200.0 * EPS * kappa), (conditioned, HARD * EPS * kappa)):
        compare([1.0 + 0.09 * bound], [1.0], kappa)
        for error, message in ((0.2 * bound, "within a factor of 10"), (2.0 * bound, "condition 1")):
            with pytest.raises(AssertionError, match=message):
                compare([1.0 + error], [1.0], kappa)
