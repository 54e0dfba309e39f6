"""Mechanisms of all kinds against their equations in maximal coordinates, in 150 digits.

Springs, loads, spin, closures of all kinds, imposed joints and sensors; rotors are in `test_steady.py`.
The truth has true gaps and cosines of closures, whose redundant rows stay.
"""

from collections.abc import Callable

import numpy as np
import pytest

import mbdlft
from tests.attack.mechanisms import check
from tests.cross.mechanisms import closed_by, open_tree
from tests.cross.mixed_mechanisms import mixed
from tests.cross.planar_mechanisms import PLANAR

_PLANAR = ("revolute", "spherical")  # kinds of closures that mechanisms in a plane have
CLOSED = {kind: seed for seed, kind in enumerate(mbdlft.multibody.loop.KINDS)}


def closed(kind: str, seed: int) -> mbdlft.Scene:
    scene = closed_by(kind, seed)
    return scene.model_copy(update={"sensors": scene.sensors[6:8]})


SCENES: dict[str, Callable[[], mbdlft.Scene]] = {
    **{f"tree {seed}": (lambda seed=seed: open_tree(seed)) for seed in range(5)},
    **{kind: (lambda kind=kind: closed(kind, CLOSED[kind])) for kind in CLOSED if kind not in _PLANAR},
    **PLANAR,
    "mixed": lambda: mixed(15),
}
MORE: dict[str, Callable[[], mbdlft.Scene]] = {
    # 11: zeros are not seen in 5120 bits
    **{f"mixed {seed}": (lambda seed=seed: mixed(seed)) for seed in range(1, 15) if seed != 11},
    **{
        f"{kind} {seed}": (lambda kind=kind, seed=seed: closed_by(kind, seed))
        for kind, first in CLOSED.items()
        for seed in (first, 2, 4, 5)
    },
}


def points_of(scene: mbdlft.Scene) -> list[dict[str, float]]:
    """Nominal, two random points, three corners."""
    random = np.random.default_rng(len(scene.name))
    found = [{p.name: p.nominal for p in scene.parameters}]
    found += [{p.name: random.uniform(p.low, p.high) for p in scene.parameters} for _ in range(2)]
    for _ in range(3):
        found.append({p.name: float(random.choice([p.low, p.high])) for p in scene.parameters})
    return found


def equals_truth(scene: mbdlft.Scene) -> mbdlft.LFTModel:
    """Entries of [A B ; C D] and the trim at a random point and at a corner."""
    model, points = mbdlft.to_lft(scene, search=0.0, prove=0.0), points_of(scene)
    check(scene, model, [points[1], points[3]])
    return model


@pytest.mark.parametrize("name", SCENES)
def test_a_mechanism_equals_maximal_coordinates(name: str) -> None:
    equals_truth(SCENES[name]())


@pytest.mark.long
@pytest.mark.parametrize("name", MORE)
def test_random_mechanisms_equal_maximal_coordinates(name: str) -> None:
    equals_truth(MORE[name]())


def test_scenes_cover() -> None:
    scenes = [make() for make in SCENES.values()]
    joints = {joint.kind for scene in scenes for joint in scene.joints}
    assert joints == {*mbdlft.multibody.joint.KINDS}
    on_ground = {"creep", "support", "tire"}  # in reference/test_wheels_on_ground.py
    loads = {load.kind for scene in scenes for load in scene.loads}
    assert loads == {*mbdlft.multibody.force.KINDS} - on_ground
    assert {sensor.kind for scene in scenes for sensor in scene.sensors} == {
        *mbdlft.multibody.sensor.KINDS
    }
    assert {loop.kind for scene in scenes for loop in scene.loops} == {*mbdlft.multibody.loop.KINDS}
    assert any(len(scene.loops) > 1 for scene in scenes)
    assert any(getattr(joint, "imposed", False) for scene in scenes for joint in scene.joints)
    named = {p.name for scene in scenes for p in scene.parameters}
    assert named >= {"m", "L", "k", "th", "rate"}
