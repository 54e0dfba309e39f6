"""Weights that are felt in the axes of each lever, against the inward pass as it is in the books."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import cache, partial
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import patch

import casadi as ca
import numpy as np
import pytest

import mbdlft
from benchmarks.cases.chains import chain
from mbdlft.multibody.assembly import assembly
from mbdlft.multibody.assembly.kinematics import Motions, Passed, pass_inward
from mbdlft.multibody.assembly.newton_euler import Assembly
from mbdlft.multibody.assembly.weights import Weights
from mbdlft.pipeline.models import build
from mbdlft.problem.equations import rounded
from tests import close, kit
from tests.cross.mechanisms import open_tree
from tests.seeds import some
from tests.strategies import random_scene

# The inward pass as it is in the books: a displaced joint turns the forces that pass it.

_LEAST = 1e-3  # of its row: a smaller entry has cancelled


@contextmanager
def forces_turned_on_the_way() -> Iterator[None]:
    """Scenes are assembled with it, also where weights could be felt in the axes of each lever."""
    with patch.object(Weights, "passed", _pass), one_order_only():
        yield


@contextmanager
def one_order_only() -> Iterator[None]:
    """Scenes are assembled once, with the weights in one order of products."""
    with patch.object(Assembly, "second_order", lambda self: None):
        yield


def _pass(
    weights: Weights, moving: Motions, inertial: Mapping[str, ca.SX], loads: Mapping[str, ca.SX]
) -> Passed:
    return pass_inward(weights.placed, moving, {name: inertial[name] + loads[name] for name in inertial})


def compare(scene: mbdlft.Scene, one: mbdlft.LFTModel, bound: float) -> None:
    """A model of a scene has the values of that with forces turned on the way, at points and a corner."""
    with forces_turned_on_the_way():
        other = mbdlft.to_lft(scene, search=0.0)
    points = mbdlft.random(one.parameters, 5, seed=1)
    corner = {p.name: np.append(points[p.name], p.high) for p in one.parameters}
    for actual, expected in zip(
        mbdlft.matrices_at(one, corner), mbdlft.matrices_at(other, corner), strict=True
    ):
        size = np.abs(expected) if expected.ndim == 2 else np.max(np.abs(expected), axis=0)
        row = np.max(size, axis=1, keepdims=True, initial=0.0)
        scale = np.where(row > 0.0, np.maximum(size, _LEAST * row), 1.0)
        close.target(actual / scale, expected / scale, bound, scale=1.0)


# Weights that are felt in the axes of each lever, against forces that are turned on the way in.

CHAINS = (2, 3, 4, 6)
SEEDS = [0, 10, *(pytest.param(seed, marks=pytest.mark.long) for seed in (1, 2, 3, 4))]
SCENARIOS = Path(__file__).parents[2] / "scenarios"


def made(scene: mbdlft.Scene) -> mbdlft.LFTModel:
    """The model of a scene with weights that are felt."""
    with one_order_only():
        return mbdlft.to_lft(scene, search=0.0)


def compare_felt(scene: mbdlft.Scene, bound: float = close.CROSS) -> None:
    compare(scene, made(scene), bound)


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("draw", some([random_scene], [open_tree]))
def test_both_ways_are_one_model(draw: Callable[[int], mbdlft.Scene], seed: int) -> None:
    compare_felt(draw(seed))


def test_axes_may_be_opposite() -> None:
    scene = chain(3, spatial=False)
    first, second, third = scene.joints
    second = second.model_copy(update={"axis": (-1, 0, 0)})
    compare_felt(scene.model_copy(update={"joints": (first, second, third)}))


@pytest.mark.parametrize("name", ["launcher_bending", "launcher_slosh", "balloon_gondola"])
def test_both_ways_are_one_model_under_thrust_and_with_elastic_bodies(name: str) -> None:
    compare_felt(mbdlft.load_scene(SCENARIOS / f"{name}.toml"), close.ELASTIC)


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
    with forces_turned_on_the_way():
        other = mbdlft.to_lft(scene, search=0.0)
    assert made(scene).order < other.order


# The weights in another order of products, against forces that are turned on the way in.

LONG = partial(pytest.param, marks=pytest.mark.long)
DRAWN = [(random_scene, 3)]
MORE = [(open_tree, 10), (random_scene, 14), (random_scene, 20), (open_tree, 4), (open_tree, 6)]


@contextmanager
def products_only() -> Iterator[None]:
    """Scenes are assembled with the products alone, also where few angles are parameters."""
    module = import_module("mbdlft.multibody.to_problem")
    order = import_module("mbdlft.multibody.assembly.weights")

    def second_only(scene: mbdlft.Scene) -> SimpleNamespace:
        both = assembly(scene)
        exact = both.second_order()
        assert exact is not None
        none = {"second_order": lambda: None, "is_regular": lambda: False, "constraints": lambda: None}
        return SimpleNamespace(equations=rounded(exact), exact=exact, closure=both.closure, **none)

    with (
        patch.object(module, "assembly", second_only),
        patch.multiple(order, _LEAST_HINGES=3, _LEAST_ANGLES=0),
    ):
        yield


def compare_products(scene: mbdlft.Scene) -> None:
    with products_only():
        one = mbdlft.to_lft(scene, search=0.0)
    compare(scene, one, close.CROSS)


@pytest.mark.parametrize(("draw", "seed"), [*DRAWN, *(LONG(*case) for case in MORE)])
def test_products_are_the_same_model(draw: Callable[[int], mbdlft.Scene], seed: int) -> None:
    compare_products(draw(seed))


@cache
def spatial_chain(links: int) -> mbdlft.LFTModel:
    """The model without any search."""
    return build(chain(links, spatial=True), 0.0).model


@pytest.mark.parametrize(("links", "reached"), [(3, 47), LONG(4, 84), LONG(5, 129), LONG(6, 183)])
def test_fewer_repetitions_in_long_chains_in_space(links: int, reached: int) -> None:
    with one_order_only():
        alone = build(chain(links, spatial=True), 0.0).model.order
    smaller = spatial_chain(links).order
    assert smaller <= min(alone, reached)
    if links > 3:
        assert smaller < alone


def test_an_angle_meets_each_hinge_once() -> None:
    """With six links: 16 repetitions of each angle from the third on; a length, one for each hinge."""
    sizes = {block.name: block.size for block in spatial_chain(6).lft.blocks}
    assert [sizes[f"t{k}"] for k in range(6)] == [12, 14, 16, 16, 16, 16]
    assert [sizes[f"L{k}"] for k in range(6)] == [2, 5, 6, 7, 8, 9]


def with_fixed_angles(scene: mbdlft.Scene, count: int) -> mbdlft.Scene:
    """The scene with a number for the position of the first joints."""
    joints = [joint.model_copy(update={"position": 0.3}) for joint in scene.joints[:count]]
    return scene.model_copy(update={"joints": (*joints, *scene.joints[count:])})


@pytest.mark.parametrize(
    ("scene", "tried"),
    [
        (chain(4, spatial=True), True),
        (with_fixed_angles(chain(4, spatial=True), 1), True),
        (with_fixed_angles(chain(4, spatial=True), 2), False),
        (chain(3, spatial=True), False),
        (chain(4, spatial=False), False),  # the last term is zero
        (mbdlft.load_scene("scenarios/ur5.toml"), False),
    ],
    ids=["chain", "three angles", "two angles", "three hinges", "planar", "ur5"],
)
def test_only_where_it_gains(scene: mbdlft.Scene, tried: bool) -> None:
    assert (assembly(scene).second_order() is not None) == tried


def turret() -> mbdlft.Scene:
    """A chain in space on two turntables about the vertical, one on the other."""
    scene = chain(3, spatial=True)
    turned = [
        kit.hinge(name, parent, child, (0, 0, 1), position="t1" if name == "inner" else 0.3)
        for name, parent, child in (("inner", "ground", "base"), ("outer", "base.top", "table"))
    ]
    bodies = [
        kit.body(
            name, 3.0, (1.0, 1.0, 1.0), center_of_mass=(0.1, 0.0, 0.0), ports={"top": (0.2, 0.3, 0.5)}
        )
        for name in ("base", "table")
    ]
    joints = [
        joint.model_copy(update={"parent": "table.top"}) if joint.name == "joint0" else joint
        for joint in scene.joints
    ]
    return scene.model_copy(update={"joints": (*joints, *turned), "bodies": (*scene.bodies, *bodies)})


def test_turns_about_the_vertical_are_not_felt() -> None:
    compare_products(turret())


def wheeled(axis: tuple[float, float, float]) -> mbdlft.Scene:
    """A chain in space with a steady wheel whose center of mass is on its axis, off its joint."""
    scene = chain(3, spatial=True)
    wheel = kit.body(
        "wheel", 0.5, (0.2, 0.2, 0.2), about="center_of_mass", center_of_mass=tuple(0.3 * x for x in axis)
    )
    spin = kit.hinge("spin", "link1.tip", "wheel", axis, rate="W")
    return scene.model_copy(
        update={
            "bodies": (*scene.bodies, wheel),
            "joints": (*scene.joints, spin),
            "parameters": (*scene.parameters, mbdlft.Parameter("W", 30.0, percent=20, unit="rad/s")),
        }
    )


@pytest.mark.parametrize("axis", [(1, 0, 0), (0, 1, 0), (0, 0, -1)])
def test_wheels_whose_center_of_mass_is_off_their_joint(axis: tuple[float, float, float]) -> None:
    compare_products(wheeled(axis))
