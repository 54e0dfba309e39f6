"""Springs, loads, spin, closures, imposed joints, sensors against Lagrange's constrained equations."""

from collections.abc import Callable
from functools import cache
from typing import NamedTuple

import numpy as np
import pytest

import mbdlft
from tests import close
from tests.cross.mechanism import Linear, linear_at, mechanism
from tests.cross.mechanisms import closed_loop, open_tree
from tests.cross.planar_mechanisms import PLANAR

RANDOM: dict[str, Callable[[], mbdlft.Scene]] = {
    **{f"tree {seed}": (lambda seed=seed: open_tree(seed)) for seed in range(5)},
    **{f"loop {seed}": (lambda seed=seed: closed_loop(seed)) for seed in range(4)},
}
SCENES = RANDOM | PLANAR
# others of their kind are there
SLOW = (*(f"tree {k}" for k in (1, 2, 3, 4)), *(f"loop {k}" for k in (0, 1, 3)))


def points_of(scene: mbdlft.Scene) -> list[dict[str, float]]:
    """Nominal, two random points, three corners."""
    random = np.random.default_rng(len(scene.name))
    found = [{p.name: p.nominal for p in scene.parameters}]
    found += [{p.name: random.uniform(p.low, p.high) for p in scene.parameters} for _ in range(2)]
    for _ in range(3):
        found.append({p.name: float(random.choice([p.low, p.high])) for p in scene.parameters})
    return found


class Case(NamedTuple):
    """A scene with its model, and the reference at points of the parameters."""

    scene: mbdlft.Scene
    model: mbdlft.LFTModel
    points: list[dict[str, float]]
    reference: list[Linear]


@cache
def case(name: str) -> Case:
    scene = SCENES[name]()
    model, equations, points = mbdlft.to_lft(scene, search=0.0), mechanism(scene), points_of(scene)
    return Case(scene, model, points, [linear_at(equations, model, point) for point in points])


def compare(model: mbdlft.LFTModel, points: list[dict[str, float]], reference: list[Linear]) -> None:
    """[A B ; C D] entry by entry, and the trim: efforts against the largest one at a point."""
    values = [mbdlft.matrices_at(model, point) for point in points]
    close.entries(
        [np.block([[v.A, v.B], [v.C, v.D]]) for v in values],
        [linear.matrix for linear in reference],
        [linear.terms for linear in reference],
    )
    names = [signal.name for signal in model.trim.signals]
    known = [k for k, name in enumerate(names) if name in reference[0].trim]
    assert len(known) == len(reference[0].trim)
    for point, linear in zip(points, reference, strict=True):
        trim = np.ravel(mbdlft.trim_at(model, point))[known]
        wanted = np.array([linear.trim[names[k]] for k in known])
        close.target(trim, wanted, close.MECHANISM, max(1.0, np.max(np.abs(wanted), initial=0.0)))


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.long] if name in SLOW else []) for name in SCENES]
)
def test_model_equals_lagrange(name: str) -> None:
    compare(*case(name)[1:])


def test_scenes_cover() -> None:
    scenes = [SCENES[name]() for name in SCENES if name not in SLOW]
    joints = {joint.kind for scene in scenes for joint in scene.joints}
    assert joints == {*mbdlft.multibody.joint.KINDS}
    on_ground = {"creep", "support", "tire"}  # in reference/test_wheels_on_ground.py
    loads = {load.kind for scene in scenes for load in scene.loads}
    assert loads == {*mbdlft.multibody.force.KINDS} - on_ground
    assert {sensor.kind for scene in scenes for sensor in scene.sensors} == {
        *mbdlft.multibody.sensor.KINDS
    }
    # those that slide, and the universal one, are in test_loop_kinds.py
    assert {loop.kind for scene in scenes for loop in scene.loops} >= {"fixed", "revolute", "spherical"}
    assert any(len(scene.loops) > 1 for scene in scenes)
    assert any(getattr(joint, "imposed", False) for scene in scenes for joint in scene.joints)
    named = {p.name for scene in scenes for p in scene.parameters}
    assert named >= {"m", "L", "k", "th", "rate"}
