"""The weights in another order of products, against forces that are turned on the way in."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache, partial
from importlib import import_module
from types import SimpleNamespace
from unittest.mock import patch

import pytest

import mbdlft
from benchmarks.cases.chains import chain
from mbdlft.multibody.assembly import assembly
from mbdlft.pipeline.models import build
from mbdlft.problem.equations import rounded
from tests import close
from tests.cross.mechanisms import open_tree
from tests.laws import turned
from tests.laws.turned import one_order_only
from tests.strategies import random_scene

LONG = partial(pytest.param, marks=pytest.mark.long)
SEEDS = [(random_scene, 3), (open_tree, 10)]
MORE = [(random_scene, 14), (random_scene, 20), (open_tree, 4), (open_tree, 6)]


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


def compare(scene: mbdlft.Scene) -> None:
    with products_only():
        one = mbdlft.to_lft(scene, search=0.0)
    turned.compare(scene, one, close.CROSS)


@pytest.mark.parametrize(("draw", "seed"), [*SEEDS, *(LONG(*case) for case in MORE)])
def test_both_ways_are_one_model(draw: Callable[[int], mbdlft.Scene], seed: int) -> None:
    compare(draw(seed))


@cache
def spatial_chain(links: int) -> mbdlft.LFTModel:
    """The model without any search."""
    return build(chain(links, spatial=True), 0.0).model


@pytest.mark.parametrize(("links", "reached"), [(3, 47), (4, 84), LONG(5, 129), LONG(6, 183)])
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
        mbdlft.Revolute(
            name=name,
            parent=parent,
            child=child,
            axis=(0, 0, 1),
            position="t1" if name == "inner" else 0.3,
        )
        for name, parent, child in (("inner", "ground", "base"), ("outer", "base.top", "table"))
    ]
    bodies = [
        mbdlft.RigidBody(
            name=name,
            mass=3.0,
            center_of_mass=(0.1, 0.0, 0.0),
            inertia=mbdlft.Inertia(xx=1.0, yy=1.0, zz=1.0),
            ports={"top": (0.2, 0.3, 0.5)},
        )
        for name in ("base", "table")
    ]
    joints = [
        joint.model_copy(update={"parent": "table.top"}) if joint.name == "joint0" else joint
        for joint in scene.joints
    ]
    return scene.model_copy(update={"joints": (*joints, *turned), "bodies": (*scene.bodies, *bodies)})


def test_turns_about_the_vertical_are_not_felt() -> None:
    compare(turret())


def wheeled(axis: tuple[float, float, float]) -> mbdlft.Scene:
    """A chain in space with a steady wheel whose center of mass is on its axis, off its joint."""
    scene = chain(3, spatial=True)
    wheel = mbdlft.RigidBody(
        name="wheel",
        mass=0.5,
        center_of_mass=tuple(0.3 * x for x in axis),
        inertia=mbdlft.Inertia(xx=0.2, yy=0.2, zz=0.2, about="center_of_mass"),
    )
    spin = mbdlft.Revolute(name="spin", parent="link1.tip", child="wheel", axis=axis, rate="W")
    return scene.model_copy(
        update={
            "bodies": (*scene.bodies, wheel),
            "joints": (*scene.joints, spin),
            "parameters": (*scene.parameters, mbdlft.Parameter("W", 30.0, percent=20, unit="rad/s")),
        }
    )


@pytest.mark.parametrize("axis", [(1, 0, 0), (0, 1, 0), (0, 0, -1)])
def test_wheels_whose_center_of_mass_is_off_their_joint(axis: tuple[float, float, float]) -> None:
    compare(wheeled(axis))
