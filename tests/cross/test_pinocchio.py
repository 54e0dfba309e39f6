"""Random mechanisms against pinocchio, trimmed and linearized again at random points and corners.

The planted bugs at the end show that the same comparison finds what it should.
"""

from collections.abc import Callable
from importlib import import_module
from itertools import count

import casadi as ca
import numpy as np
import pytest

import mbdlft
from mbdlft.multibody.force import BodyWrench
from mbdlft.multibody.joint.move import Ball, Hinge, Slide, Turned
from mbdlft.multibody.spatial import move_wrench
from tests import close
from tests.cross.pinocchio_model import SIGNALS, Linear, pinocchio_model
from tests.mechanisms import MOST_BODIES, random_mechanism

SEEDS = range(12)
HARD = (144, 273)  # one coordinate; an acceleration that nothing drives
MANY = range(300)
POINTS = 4
FREE_MOVES, CARRIED = mbdlft.Free.moves, Hinge.carried
_LEAST = 1e-3  # masses and lengths are of order one: what is smaller has cancelled
ASSEMBLE = import_module("mbdlft.multibody.assembly.newton_euler")
WEIGHTS = import_module("mbdlft.multibody.assembly.weights")
Point = dict[str, float]


def small_mechanism(seed: int) -> mbdlft.Scene:
    return random_mechanism(seed, bodies=2 + seed % 4)


# the comparison ------------------------------------------------------------------------------


def points_of(scene: mbdlft.Scene) -> list[Point]:
    """The nominal values, random points and corners."""
    random = np.random.default_rng(len(scene.bodies))
    found = [{p.name: p.nominal for p in scene.parameters}]
    for k in range(POINTS):
        inside = {p.name: random.uniform(p.low, p.high) for p in scene.parameters}
        corner = {p.name: random.choice([p.low, p.high]) for p in scene.parameters}
        found.append(inside if k % 2 else corner)
    return found


def errors(model: mbdlft.LFTModel, points: list[Point], references: list[Linear]) -> list[float]:
    """Largest relative errors of [A B ; C D] and of the trim.

    Every coordinate is in its natural unit, the root of its own inertia. An entry is compared with
    the largest of its row in the columns of its kind (displacements, rates, inputs) over all points.
    """
    names = [signal.name for signal in model.states]
    columns = names + [signal.name for signal in model.inputs]
    rows = [f"d/dt {name}" for name in names] + [signal.name for signal in model.outputs]
    n = len(names)
    actual, expected = [], []
    for point, reference in zip(points, references, strict=True):
        unit = np.array([references[0].unit.get(name, 1.0) for name in columns])
        unit[:n] = 1.0 / unit[:n]
        A, B, C, D = mbdlft.matrices_at(model, point)
        actual.append(np.block([[A, B], [C, D]]) * unit)
        expected.append(reference.matrix(rows, columns) * unit)
    difference, size = np.abs(np.array(actual) - expected), np.max(np.abs(expected), axis=0)
    whole = np.max(size, axis=1, initial=1.0)
    worst = 0.0
    for part in (slice(n // 2), slice(n // 2, n), slice(n, None)):
        scale = np.maximum(np.max(size[:, part], axis=1, initial=0.0), _LEAST * whole)
        worst = max(worst, float(np.max(difference[:, :, part] / scale[:, None])))
    return [worst, trim_error(model, points, references)]


def trim_error(model: mbdlft.LFTModel, points: list[Point], references: list[Linear]) -> float:
    """Largest error of an unknown, over the largest of its unit."""
    names = [signal.name for signal in model.trim.signals]
    assert all(set(names) == set(reference.trim) for reference in references)
    actual = np.array([np.atleast_1d(mbdlft.trim_at(model, point)) for point in points])
    expected = np.array([[reference.trim[name] for name in names] for reference in references])
    worst = 0.0
    for unit in {signal.unit for signal in model.trim.signals}:
        like = [k for k, signal in enumerate(model.trim.signals) if signal.unit == unit]
        scale = max(float(np.max(np.abs(expected[:, like]))), _LEAST)
        worst = max(worst, close.error(actual[:, like], expected[:, like], scale))
    return worst


def compare(scene: mbdlft.Scene) -> None:
    points = points_of(scene)
    model = mbdlft.to_lft(scene, search=0.0)
    found = errors(model, points, [pinocchio_model(scene, point) for point in points])
    close.target(found, [0.0, 0.0], close.CROSS, scale=1.0)


@pytest.mark.parametrize("seed", SEEDS)
def test_model_and_trim_equal_pinocchio(seed: int) -> None:
    compare(small_mechanism(seed))


@pytest.mark.parametrize("seed", HARD)
def test_hard_model_and_trim_equal_pinocchio(seed: int) -> None:
    compare(random_mechanism(seed))


@pytest.mark.long
@pytest.mark.parametrize("seed", MANY)
def test_large_model_and_trim_equal_pinocchio(seed: int) -> None:
    compare(random_mechanism(seed))


# planted bugs --------------------------------------------------------------------------------


def patched(owner: object, name: str, replacement: object) -> Callable[[pytest.MonkeyPatch], None]:
    return lambda monkeypatch: monkeypatch.setattr(owner, name, replacement)


def fluid_with_the_frame(load, values, magnitude, space):
    """Buoyancy along the gravity of the body at rest: it turns with the body."""
    body, r = space.port(load.port)
    force = -space.across(space.gravity, "ground", body) * magnitude
    return [BodyWrench(body, move_wrench(ca.horzcat(force, ca.SX(3, 1)), r))]


def always_follows(load, body, space):
    return ca.SX(np.array(load.direction) / np.linalg.norm(load.direction))


def own_axes(joint, values, at):
    """Translations of a free joint after its orientation."""
    *moves, ball = FREE_MOVES(joint, values, at)
    turned = [move for move in moves if isinstance(move, Turned)]
    return (*turned, *(move for move in moves if not isinstance(move, Turned)), ball)


def kinds(scene: mbdlft.Scene) -> set[str]:
    """Kinds of joints, loads and sensors."""
    return {item.kind for item in (*scene.joints, *scene.loads, *scene.sensors)}


def has(*wanted: str) -> Callable[[mbdlft.Scene], bool]:
    return lambda scene: kinds(scene) >= set(wanted)


def directed(kind: str) -> Callable[[mbdlft.Scene], bool]:
    """An unknown load of a kind that keeps its direction, on a body that turns."""
    return lambda scene: any(
        load.kind == kind and load.frame == "ground" and load.magnitude is None for load in scene.loads
    )


def driven(scene: mbdlft.Scene) -> bool:
    return any(name.startswith("ground.") for name in scene.inputs or ())


def heavy_ball(scene: mbdlft.Scene) -> bool:
    return any(j.kind == "spherical" and any(j.actuator_inertia) for j in scene.joints)


def heavy_hinge(scene: mbdlft.Scene) -> bool:
    return any(joint.kind == "revolute" and joint.actuator_inertia for joint in scene.joints)


def carried(kind: str) -> Callable[[mbdlft.Scene], bool]:
    """A joint of a kind on the first body, which turns about any axis."""
    return lambda scene: (
        scene.joints[0].kind == "free"
        and any(joint.kind == kind and body_of(joint.parent) == "b1" for joint in scene.joints)
    )


def body_of(port: str) -> str:
    return port.partition(".")[0]


def pushed(kind: str) -> Callable[[mbdlft.Scene], bool]:
    """A force on a body that a joint of a kind carries on another one."""
    return lambda scene: any(
        joint.kind == kind
        and body_of(joint.parent) != "ground"
        and body_of(joint.child) == body_of(load.port)
        for joint in scene.joints
        for load in scene.loads
        if load.kind == "force"
    )


def gravity(scene: mbdlft.Scene) -> bool:
    return any(scene.gravity)


def both(*conditions: Callable[[mbdlft.Scene], bool]) -> Callable[[mbdlft.Scene], bool]:
    return lambda scene: all(condition(scene) for condition in conditions)


PLANTED = {
    "a force of the scene follows the body": (
        patched(mbdlft.Force, "unit", always_follows),
        directed("force"),
    ),
    "a torque of the scene follows the body": (
        patched(mbdlft.Torque, "unit", always_follows),
        directed("torque"),
    ),
    "buoyancy turns with the body": (
        patched(mbdlft.Buoyancy, "wrenches", fluid_with_the_frame),
        both(has("buoyancy", "free"), gravity),
    ),
    "a slide does not move the line of a load": (
        patched(Slide, "wrench", lambda move, wrench: wrench),
        pushed("prismatic"),
    ),
    "a slide does not move the line of a weight": (
        patched(Slide, "offset", lambda move: ca.SX(3, 1)),
        both(carried("prismatic"), gravity),
    ),
    "weights do not turn": (
        patched(WEIGHTS, "_with_weights", lambda wrench, tilts, field: wrench),
        both(has("revolute"), gravity),
    ),
    "weights turn about the axis they had outside of a turn": (
        patched(WEIGHTS, "_turned_axis", lambda move, axis: axis),
        both(carried("universal"), gravity),
    ),
    "every actuator about a hinge counts twice": (
        patched(
            Hinge,
            "carried",
            lambda move, wrench, motion: CARRIED(move, CARRIED(move, wrench, motion), motion),
        ),
        heavy_hinge,
    ),
    "no actuator in a ball": (
        patched(Ball, "effort", lambda move, carried, _: carried[:, 1]),
        heavy_ball,
    ),
    "a ball turns the other way": (
        patched(Ball, "in_parent_axes", lambda move, v: Ball(move.at, 0).in_child_axes(v)),
        both(carried("spherical"), gravity),
    ),
    "axes of a plane exchanged": (
        patched(
            mbdlft.multibody.joint.kinds,
            "plane",
            lambda normal, plane=mbdlft.multibody.joint.kinds.plane: plane(normal)[::-1],
        ),
        has("planar"),
    ),
    "a free body moves along its own axes": (
        patched(mbdlft.Free, "moves", lambda joint, values, at: own_axes(joint, values, at)),
        lambda scene: any(j.kind == "free" and j.orientation for j in scene.joints),
    ),
    "an accelerometer that feels no gravity": (
        patched(
            mbdlft.Accelerometer,
            "measure",
            lambda sensor, view: view.small(sensor.port, 2)[1].displacement,
        ),
        both(has("accelerometer"), gravity),
    ),
    "the wrench on the parent": (
        patched(
            mbdlft.JointWrench, "measure", lambda sensor, view: -ca.vec(view.joint_wrench(sensor.joint))
        ),
        has("joint_wrench"),
    ),
    "momentum of the displacements": (
        patched(mbdlft.Momentum, "measure", lambda sensor, view: ca.vec(view.momentum(0))),
        has("momentum"),
    ),
    "the ground is shaken the other way": (
        patched(
            ASSEMBLE,
            "ground_motion",
            lambda *given, moved=ASSEMBLE.ground_motion: moved(*given[:-1], -given[-1]),
        ),
        driven,
    ),
}


def scene_with(condition: Callable[[mbdlft.Scene], bool]) -> mbdlft.Scene:
    return next(scene for seed in count() if condition(scene := small_mechanism(seed)))


@pytest.mark.parametrize("bug", PLANTED)
def test_planted_bug_is_found(bug: str, monkeypatch: pytest.MonkeyPatch) -> None:
    plant, condition = PLANTED[bug]
    scene = scene_with(condition)
    compare(scene)
    plant(monkeypatch)
    with pytest.raises(AssertionError):
        compare(scene)


# the scenes ----------------------------------------------------------------------------------


def test_mechanisms_repeat_and_cover() -> None:
    drawn = [random_mechanism(seed) for seed in range(100)]
    assert drawn[:10] == [random_mechanism(seed) for seed in range(10)]
    joints = [joint for scene in drawn for joint in scene.joints]
    loads = [load for scene in drawn for load in scene.loads]
    assert {joint.kind for joint in joints} == set(SIGNALS)
    assert {len(scene.joints) for scene in drawn} == set(range(2, MOST_BODIES + 1))
    assert {load.kind for load in loads} == {"force", "torque", "buoyancy"}
    frames = {(load.kind, load.frame) for load in loads if load.kind != "buoyancy"}
    assert len(frames) == 4
    unknown = {(load.kind, getattr(load, load.magnitude_key) is None) for load in loads}
    assert len(unknown) == 6
    sensors = {sensor.kind for scene in drawn for sensor in scene.sensors}
    assert sensors == set(mbdlft.multibody.sensor.KINDS)
    assert any(joint.orientation for joint in joints)
    assert any(getattr(joint, "imposed", False) for joint in joints)
    first = {scene.joints[0].kind for scene in drawn}
    assert first >= {"free", "revolute"}
    assert any(driven(scene) for scene in drawn)
