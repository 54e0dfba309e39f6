"""Weights that are felt in the axes of each lever, against forces that are turned on the way in."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import mbdlft
from benchmarks.cases.chains import chain
from tests import close
from tests.cross.mechanisms import open_tree
from tests.laws import turned
from tests.laws.turned import one_order_only
from tests.strategies import random_scene

CHAINS = (2, 3, 4, 6)
SEEDS = [0, 10, *(pytest.param(seed, marks=pytest.mark.long) for seed in (1, 2, 3, 4))]
SCENARIOS = Path(__file__).parents[2] / "scenarios"


def made(scene: mbdlft.Scene) -> mbdlft.LFTModel:
    """The model of a scene with weights that are felt."""
    with one_order_only():
        return mbdlft.to_lft(scene, search=0.0)


def compare(scene: mbdlft.Scene, bound: float = close.CROSS) -> None:
    turned.compare(scene, made(scene), bound)


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("draw", [random_scene, open_tree])
def test_both_ways_are_one_model(draw: Callable[[int], mbdlft.Scene], seed: int) -> None:
    compare(draw(seed))


def test_axes_may_be_opposite() -> None:
    scene = chain(3, spatial=False)
    first, second, third = scene.joints
    second = second.model_copy(update={"axis": (-1, 0, 0)})
    compare(scene.model_copy(update={"joints": (first, second, third)}))


@pytest.mark.parametrize("name", ["launcher_bending", "launcher_slosh", "balloon_gondola"])
def test_both_ways_are_one_model_under_thrust_and_with_elastic_bodies(name: str) -> None:
    compare(mbdlft.load_scene(SCENARIOS / f"{name}.toml"), close.ELASTIC)


@pytest.mark.parametrize("links", CHAINS)
def test_planar_chain_is_small_without_search(links: int) -> None:
    """The McMillan degrees, and one more for each mass but the first; for 3 and 4 the minimum."""
    certificate = mbdlft.to_lft(chain(links, spatial=False), search=0.0).certificate
    masses = [name.startswith("m") and name != "m0" for name in names(links)]
    expected = np.array(certificate.lower_bound) + masses
    assert list(certificate.order) == list(expected)


def names(links: int) -> list[str]:
    return sorted(p.name for p in chain(links, spatial=False).parameters)


@pytest.mark.parametrize("spatial", [False, True])
def test_fewer_repetitions_than_with_forces_that_turn(spatial: bool) -> None:
    scene = chain(4, spatial=spatial)
    with turned.forces_turned_on_the_way():
        other = mbdlft.to_lft(scene, search=0.0)
    assert made(scene).order < other.order
