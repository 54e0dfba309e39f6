"""The pendulum of example 1 of the source paper: m L^2 qdd = T - d qd - m g L cos(position) q."""

from pathlib import Path

import mbdlft

SCENE = Path(__file__).parents[2] / "scenarios" / "pendulum.toml"
GRAVITY, DAMPING = 9.81, 0.05
POSITIONS = {"hanging": ("0.0", 1.0), "horizontal": ("90*deg", 0.0), "inverted": ("180*deg", -1.0)}


def pendulum(position: str) -> mbdlft.LFTModel:
    """The model at one position, a number or text of the scene."""
    text = SCENE.read_text(encoding="utf-8")
    assert "position = 0.0\n" in text
    return mbdlft.to_lft(
        mbdlft.scene_from_toml(text.replace("position = 0.0\n", f'position = "{position}"\n')), search=0.0
    )
