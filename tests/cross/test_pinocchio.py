"""Random mechanisms against pinocchio, trimmed and linearized again at random points and corners."""

import numpy as np
import pytest

import mbdlft
from tests import close
from tests.cross.pinocchio_model import SIGNALS, Linear, pinocchio_model
from tests.mechanisms import MOST_BODIES, random_mechanism

SEEDS = range(12)
HARD = (144, 273)  # one coordinate; an acceleration that nothing drives
MANY = range(300)
POINTS = 4
_LEAST = 1e-3  # masses and lengths are of order one: what is smaller has cancelled
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


def driven(scene: mbdlft.Scene) -> bool:
    return any(name.startswith("ground.") for name in scene.inputs or ())


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
