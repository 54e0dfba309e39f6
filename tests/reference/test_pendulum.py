"""The pendulum against its closed form, at three positions."""

import numpy as np
import pytest

import mbdlft
from benchmarks.cases.pendulum import DAMPING, GRAVITY, POSITIONS, pendulum
from tests.close import CLOSED_FORM, target


@pytest.mark.parametrize("name", POSITIONS)
def test_exact_minimal_and_of_the_right_sign(name: str) -> None:
    position, cosine = POSITIONS[name]
    model = pendulum(position)
    inside, outer = mbdlft.random(model.parameters, 100), mbdlft.corners(model.parameters)
    values = {p.name: np.concatenate([inside[p.name], outer[p.name]]) for p in model.parameters}
    m, L = values["m"], values["L"]
    matrices = mbdlft.matrices_at(model, values)
    stiffness = m * GRAVITY * L * cosine
    target(matrices.A[:, 1, 0], -stiffness / (m * L**2), CLOSED_FORM, scale=GRAVITY)
    target(matrices.A[:, 1, 1], -DAMPING / (m * L**2), CLOSED_FORM)
    target(matrices.B[:, 1, 0], 1 / (m * L**2), CLOSED_FORM)
    # the torque that holds it, and with it the sign of the angle
    sine = {"hanging": 0.0, "horizontal": 1.0, "inverted": 0.0}[name]
    torque = mbdlft.trim_at(model, values)[:, 0]
    target(torque, m * GRAVITY * L * sine, CLOSED_FORM, scale=float(np.max(m * GRAVITY * L)))
    assert np.all(np.sign(np.round(-matrices.A[:, 1, 0], 9)) == np.sign(cosine))
    assert model.certificate.minimal
    assert dict(model.lft.blocks) == {"L": 2, "m": 1}
