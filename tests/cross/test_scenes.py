"""Scenes of rigid bodies in files, of scenarios/ and of docs/trials.md, in 150 digits."""

from pathlib import Path

import pytest

import mbdlft
from tests.cross.test_mechanism import equals_truth

ROOT = Path(__file__).parents[2]
OTHERS = {"diff_drive", "lander", "motorcycle"}  # supports, tires that relax, wheels that share a force


def rigid(folder: str) -> list[mbdlft.Scene]:
    texts = [path.read_text("utf-8") for path in sorted((ROOT / folder).glob("*.toml"))]
    scenes = [mbdlft.scene_from_toml(text) for text in texts if "mbdlft-scene/1" in text]
    kinds = {"ground", "point_mass", "rigid"}
    return [scene for scene in scenes if {body.kind for body in scene.bodies} <= kinds]


SCENARIOS = [scene for scene in rigid("scenarios") if scene.name not in OTHERS]


@pytest.mark.parametrize("scene", SCENARIOS + rigid("docs/trials"), ids=lambda scene: str(scene.name))
def test_a_scene_equals_maximal_coordinates(scene: mbdlft.Scene) -> None:
    equals_truth(scene)
