"""Random vehicles that roll against their equations in maximal coordinates, in 150 digits.

`tests/cross/rolling_mechanisms.py` draws frames on wheels, balls and knife edges, with forks that steer
and a load that swings, at rest and at a speed. The truth knows where wheels touch for any pose, and takes
derivatives by differences; multipliers are those of Lagrange and d'Alembert. All forces of contacts that
these determine are outputs; the others are refused, and so are those that get a part of these as bodies
turn.
"""

from pathlib import Path

import pytest

from mbdlft import Scene, SceneError, assemble
from mbdlft.multibody.to_problem import choose_signals, problem_of_scene
from tests.attack.mechanisms import answer, points_of
from tests.cross.maximal_model import contact_forces
from tests.cross.rolling_mechanisms import rolling


def attack(seed: int, folder: Path) -> str:
    """Build a model and compare it where the truth is known: at nominal, inside, and at a corner."""
    scene = rolling(seed)
    known, shared = contact_forces(scene, points_of(scene, seed)[0])
    for name in shared:
        asked = scene.model_copy(update={"outputs": (name,)})
        with pytest.raises(SceneError, match="contacts hold the same twice"):
            choose_signals(asked, assemble(asked))
    owners = {name.partition(".")[0] for name in shared}
    turning = [name for name in known if name.partition(".")[0] in owners and "normal" not in name]
    asked = scene.model_copy(update={"outputs": tuple(turning)})
    if turning and "as the body turns" in _refusal(asked):
        known = [name for name in known if name not in turning]
    return answer(scene.model_copy(update={"outputs": (*scene.outputs, *known)}), seed, shared)


def _refusal(scene: Scene) -> str:
    try:
        problem_of_scene(scene)
    except SceneError as error:
        return str(error)
    return ""
