"""Thick cantilevers against the exact solution of Timoshenko's equations (mpmath)."""

import numpy as np
import pytest

import mbdlft
from mbdlft.multibody.body import Beam
from tests.close import THICK_BEAM, target
from tests.reference.beams import CLAMPED, FREE, frequencies

E, RHO, NU, K = 70e9, 2700.0, 0.3, 5.0 / 6.0
WIDTH, LENGTH = 0.3, 1.5  # m


def section(slenderness: float) -> dict[str, float]:
    """A rectangular section, by length over height."""
    h = LENGTH / slenderness
    return {"area": WIDTH * h, "I_z": WIDTH * h**3 / 12.0}


def exact(slenderness: float, count: int = 4) -> np.ndarray:
    own = section(slenderness)
    bending, line = E * own["I_z"], RHO * own["area"]
    highest = 130.0 * np.sqrt(bending / line) / LENGTH**2
    return frequencies(
        count, CLAMPED, FREE, length=LENGTH, line=line, bending=bending, rotary=RHO * own["I_z"],
        shear=K * E / (2.0 * (1.0 + NU)) * own["area"], highest=highest,
    )  # fmt: skip


def cantilever(slenderness: float, elements: int) -> mbdlft.Scene:
    body = Beam(
        name="beam",
        length=LENGTH,
        density=RHO,
        modulus=E,
        shear_modulus=E / (2.0 * (1.0 + NU)),
        shear_coefficient=K,
        deformations=("bending_y",),
        elements=elements,
        **section(slenderness),
    )
    return mbdlft.Scene(
        name="cantilever",
        bodies=[body],
        joints=[mbdlft.Fixed(name="root", parent="ground", child="beam")],
        inputs=["ground.acceleration.y"],
        outputs=["beam.bending_y.1.displacement"],
    )


def found(slenderness: float, elements: int, count: int = 4) -> np.ndarray:
    model = mbdlft.to_lft(cantilever(slenderness, elements), search=0.0)
    return np.sort(np.abs(np.linalg.eigvals(model.A).imag))[::2][:count]


@pytest.mark.parametrize("slenderness", [3.0, 10.0, 20.0])
def test_four_frequencies_of_a_thick_beam(slenderness: float) -> None:
    """With 4 elements to a few parts in a thousand; with more they converge to the exact ones."""
    expected = exact(slenderness)
    coarse, fine = (found(slenderness, n) / expected - 1.0 for n in (4, 12))
    target(fine, np.zeros(4), 0.01 * THICK_BEAM, 1.0)
    assert np.max(np.abs(coarse)) <= 1.5 * THICK_BEAM
    assert np.all(coarse >= -1e-9), "Rayleigh: a frequency of shape functions is not too low"


@pytest.mark.long
@pytest.mark.parametrize("slenderness", [3.0, 10.0, 20.0])
def test_forty_elements(slenderness: float) -> None:
    target(found(slenderness, 40) / exact(slenderness) - 1.0, np.zeros(4), 1e-4 * THICK_BEAM, 1.0)
