"""The pendulum of example 1 of the source paper: m L^2 qdd = T - d qd - m g L cos(position) q."""

from pathlib import Path

import numpy as np
import pytest

import mbdlft
from tests.close import CLOSED_FORM, target

SCENE = Path(__file__).parents[2] / "scenarios" / "pendulum.toml"
GRAVITY, DAMPING = 9.81, 0.05
POSITIONS = {"hanging": ("0.0", 1.0), "horizontal": ("90*deg", 0.0), "inverted": ("180*deg", -1.0)}


def pendulum(position: str) -> mbdlft.LFTModel:
    text = SCENE.read_text(encoding="utf-8")
    assert "position = 0.0\n" in text
    return mbdlft.to_lft(
        mbdlft.scene_from_toml(text.replace("position = 0.0\n", f'position = "{position}"\n')),
        search=0.0,
    )


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
