"""Springs, loads, spin, closures, imposed joints, sensors against Lagrange's equations with constraints.

The planted bugs change the package: its certificate, which uses the same equations, does not see
them, and the comparison has to.
"""

from collections.abc import Callable
from functools import cache
from importlib import import_module
from typing import NamedTuple

import casadi as ca
import numpy as np
import pytest

import mbdlft
from mbdlft.multibody.force import Spring
from tests import close
from tests.cross.mechanism import Linear, linear_at, mechanism
from tests.cross.mechanisms import closed_loop, open_tree
from tests.cross.planar_mechanisms import PLANAR
from tests.wrong_loops import closures_at_rest, closures_on_one_body

assembling = import_module("mbdlft.multibody.assembly.newton_euler")

RANDOM: dict[str, Callable[[], mbdlft.Scene]] = {
    **{f"tree {seed}": (lambda seed=seed: open_tree(seed)) for seed in range(5)},
    **{f"loop {seed}": (lambda seed=seed: closed_loop(seed)) for seed in range(4)},
}
SCENES = RANDOM | PLANAR


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


@pytest.mark.parametrize("name", SCENES)
def test_model_equals_lagrange(name: str) -> None:
    compare(*case(name)[1:])


def test_scenes_cover() -> None:
    scenes = [SCENES[name]() for name in SCENES]
    joints = {joint.kind for scene in scenes for joint in scene.joints}
    assert joints == {*mbdlft.multibody.joint.KINDS}
    assert {load.kind for scene in scenes for load in scene.loads} == {*mbdlft.multibody.force.KINDS}
    assert {sensor.kind for scene in scenes for sensor in scene.sensors} == {
        *mbdlft.multibody.sensor.KINDS
    }
    # those that slide, and the universal one, are in test_loop_kinds.py
    assert {loop.kind for scene in scenes for loop in scene.loops} >= {"fixed", "revolute", "spherical"}
    assert any(len(scene.loops) > 1 for scene in scenes)
    assert any(getattr(joint, "imposed", False) for scene in scenes for joint in scene.joints)
    named = {p.name for scene in scenes for p in scene.parameters}
    assert named >= {"m", "L", "k", "th", "rate"}


# planted bugs --------------------------------------------------------------------------------

Patch = pytest.MonkeyPatch


def no_geometric_stiffness(patch: Patch) -> None:
    original = Spring.wrenches

    def wrong(self, values, magnitude, space):
        parts = original(self, values, ca.SX(0), space)
        tension = original(self, {"stiffness": 0.0, "damping": 0.0}, magnitude, _AtRest(space))
        return [
            mbdlft.multibody.force.BodyWrench(a.body, a.wrench + b.wrench)
            for a, b in zip(parts, tension, strict=True)
        ]

    patch.setattr(Spring, "wrenches", wrong)


class _AtRest:
    """What a load sees if the bodies do not move."""

    def __init__(self, space) -> None:
        self.space, self.elastic = space, 0.0

    def __getattr__(self, name: str):
        return getattr(self.space, name)

    def between(self, a: str, b: str) -> ca.SX:
        return self.space.between_at_rest(a, b)


def elastic_force_without_tension(patch: Patch) -> None:
    original = Spring.wrenches

    def wrong(self, values, magnitude, space):
        return original(self, values | {"stiffness": values["stiffness"] + magnitude}, magnitude, space)

    patch.setattr(Spring, "wrenches", wrong)


def spin_of(change: Callable[[ca.SX], ca.SX]) -> Callable[[Patch], None]:
    def plant(patch: Patch) -> None:
        original = assembling.ground_motion

        def wrong(*arguments):
            motion = original(*arguments)
            return ca.horzcat(change(motion[:, 0]), motion[:, 1:])

        patch.setattr(assembling, "ground_motion", wrong)

    return plant


def sign_of_coriolis(patch: Patch) -> None:
    from mbdlft.multibody.joint import move

    original = move._slide_motion()

    def wrong(motion, axis, q, v, a):
        return original(motion, axis, q, -v, a)

    patch.setattr(move, "_slide_motion", lambda: wrong)


def no_gyroscopic_term(patch: Patch) -> None:
    from mbdlft.multibody.joint import move

    original = move._hinge_motion()

    def wrong(motion, axis, v, a):
        # alpha without omega x axis v
        right = original(motion, axis, v, a)
        omega = right[:, 0] - axis * v
        return ca.horzcat(right[:, 0], right[:, 1] - ca.cross(omega, axis * v), right[:, 2])

    patch.setattr(move, "_hinge_motion", lambda: wrong)


def ground_force_turns(patch: Patch) -> None:
    from mbdlft.multibody.assembly.kinematics import View

    patch.setattr(View, "outward", lambda self, vector, body: self.across(vector, "ground", body))


def imposed_has_an_effort(patch: Patch) -> None:
    original = assembling._dynamics

    def wrong(links, symbols, values, view, u):
        rows, row = original(links, symbols, values, view, u), 0
        for link in links:
            for _ in link.joint.freedoms:
                if getattr(link.joint, "imposed", False):
                    rows[row] = 2.0 * symbols.a[row] - u[row]
                row += 1
        return rows

    patch.setattr(assembling, "_dynamics", wrong)


BUGS: dict[str, tuple[Callable[[Patch], None], tuple[str, ...]]] = {
    "no geometric stiffness of springs": (no_geometric_stiffness, ("tree 0", "guyed mast")),
    "tension not taken off the stiffness": (elastic_force_without_tension, ("tree 0", "guyed mast")),
    "no spin": (spin_of(lambda spin: 0.0 * spin), ("tree 1", "boom on a hub")),
    "spin the other way": (spin_of(lambda spin: -spin), ("tree 3", "slider in a turning slot")),
    "sign of Coriolis": (sign_of_coriolis, ("slider in a turning slot",)),
    "no gyroscopic term": (no_gyroscopic_term, ("tree 1", "tree 3")),
    "closures without geometric stiffness": (closures_at_rest, ("loop 0", "Watt", "slider-crank")),
    "closures act on one body": (closures_on_one_body, ("loop 1", "two loops")),
    "wind that turns with the body": (ground_force_turns, ("tree 0", "tree 2")),
    "imposed acceleration halved": (imposed_has_an_effort, ("shaken cart",)),
}


@pytest.mark.parametrize(
    ("bug", "name"), [(bug, name) for bug, (_, names) in BUGS.items() for name in names]
)
def test_planted_bug_is_found(bug: str, name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    scene, right, points, reference = case(name)
    compare(right, points, reference)
    BUGS[bug][0](monkeypatch)
    try:
        model = mbdlft.to_lft(scene, search=0.0)
    except mbdlft.TrimError:
        return  # there is an equilibrium, and the bug loses it
    with pytest.raises(AssertionError):
        compare(model, points, reference)
