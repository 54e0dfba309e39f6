"""Norms of structures that fly freely, whose nutation is hardly damped: against 60 digits."""

from pathlib import Path

import numpy as np

import mbdlft
from mbdlft.response.modes import samples_at, spectrum
from tests.light import FINITE, free_flyer, peak_of_60_digits

MOST = 1e-6  # relative error of a norm


def attack(seed: int, folder: Path) -> str:
    """Eight channels of one structure: six are finite, two integrate the other torque."""
    system = free_flyer(seed)
    seen = spectrum(samples_at(system).A[0])
    assert np.array_equal(seen.on_axis, seen.at_zero), seen
    for (y, u), is_finite in FINITE.items():
        found = mbdlft.hinf_norm(system, outputs=y, inputs=u)
        assert np.isfinite(found.lower[0]) == is_finite, (y, u, found.reason)
        if is_finite:
            expected = peak_of_60_digits(seed, y, u, seen.poles)
            assert abs(found.lower[0] / expected - 1.0) <= MOST, (y, u, found.lower[0], expected)
    return "right"
