"""Steps of the searches for worst cases, each against its closed form or a difference."""

import numpy as np
import pytest

from mbdlft import Parameter, System, realize
from mbdlft.robust import ascent
from mbdlft.robust.ascent import (
    UNDAMPED,
    Peak,
    _path,
    at_delta,
    bisected,
    crossing_on_ray,
    peak_at,
    push_right,
    slope_at,
)
from mbdlft.robust.realization import realization
from tests.close import CORES, NORM, exact, finite_difference, target

HALF = 1e-6  # step of a difference


def first_order() -> System:
    """One pole: -2 + a - b/2."""
    ranges = [Parameter(name, 0.0, low=-1.0, high=1.0) for name in "ab"]
    matrix = [["-2+a-b/2", "1"], ["1+a/4", "0"]]
    return realize(matrix, ranges, states=1, inputs=["u"], outputs=["y"])


def test_a_pole_is_pushed_to_the_corner_to_which_its_slopes_point() -> None:
    delta, pole, _ = push_right(realization(first_order()), np.zeros(2), -2.0 + 0.0j, 40)
    exact(delta, [1.0, -1.0])
    target(pole, -0.5, CORES)


def test_a_pole_is_followed_to_the_smallest_box_in_which_it_reaches_the_axis() -> None:
    """-2 + a - b/2 = 0 at a = -b = 4/3."""
    first = next(_path(realization(first_order()), np.zeros(2), -2.0 + 0.0j, 10.0))
    target(first, [4.0 / 3.0, -4.0 / 3.0], CORES)


def test_computed_poles_that_are_rounding_are_not_believed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Doubles see the pole beyond the axis from 0.5 on, balls from 4/3 on: 6 halvings of what is left."""
    monkeypatch.setattr(ascent, "abscissa", lambda _, delta: float(np.max(delta)) - 0.5)
    model, end = realization(first_order()), np.array([2.0, -2.0])
    size = crossing_on_ray(model, end, 10.0).size
    assert 4.0 / 3.0 <= size <= 4.0 / 3.0 + 1.5 / 2**6
    assert crossing_on_ray(model, end, 10.0, below=1.0).size == np.inf


def test_a_pole_that_comes_through_infinity_has_no_frequency(monkeypatch: pytest.MonkeyPatch) -> None:
    """Poles -1/(1 - a/3) and -2/(1 - a/3), det(I - Delta D) > 0 beyond a = 3; doubles see it late."""
    monkeypatch.setattr(ascent, "abscissa", lambda _, delta: float(np.max(delta)) - 7.50001)
    matrix = [["-1/(1-a/3)", "0", "1"], ["0", "-2/(1-a/3)", "1"], ["1", "1", "0"]]
    system = realize(
        matrix, [Parameter("a", 0.0, low=-0.4, high=0.4)], states=2, inputs=["u"], outputs=["y"]
    )
    found = crossing_on_ray(realization(system), np.array([9.0]), 9.0)
    target(found.size, 7.50001, CORES)
    assert found.frequency == np.inf


def test_a_search_on_a_ray_ends_where_nothing_better_is_left() -> None:
    """Of 40 halvings two are made: then all of what is left is above 0.5."""
    asked: list[float] = []

    def is_beyond(t: float) -> bool:
        asked.append(t)
        return t > 0.9

    bisected(is_beyond, 0.0, 1.0, 40, most=0.6)
    exact(asked, [0.5, 0.75])
    target(bisected(is_beyond, 0.0, 1.0, 40), 0.9, 1e-10)


def test_the_slope_of_a_damping_ratio_is_its_difference() -> None:
    pole, gradient = -0.3 + 2.0j, np.array([0.7 - 0.4j, -0.2 + 1.1j])
    ahead, behind = (UNDAMPED.value(pole + step * gradient) for step in (HALF, -HALF))
    finite_difference(UNDAMPED.slope(pole, gradient), (ahead - behind) / (2.0 * HALF))


def test_the_slope_of_a_gain_is_its_difference() -> None:
    """The peak of (1 + a/4)/(s + 2 - a + b/2) is at rest."""
    model, at = realization(first_order(), [0], [0]), np.array([0.2, -0.3])
    peak = peak_at(model, at)
    target(peak.gain, 1.05 / (2.0 - 0.2 - 0.15), NORM)
    expected = []
    for step in HALF * np.eye(2):
        gains = [
            abs(plant.D - plant.C @ np.linalg.solve(plant.A, plant.B)).item()
            for plant in (at_delta(model, at + sign * step) for sign in (1.0, -1.0))
            if plant is not None
        ]
        expected.append((gains[0] - gains[1]) / (2.0 * HALF))
    finite_difference(slope_at(model, Peak(peak.gain, 0.0, at)), expected)
