"""Random scenes against their Lagrangian: state space, trim, certificate, regrouping."""

from functools import cache
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings

import mbdlft
from benchmarks.cases.lagrangian import Reference, lagrangian, state_space
from mbdlft.problem.references import NEGLIGIBLE
from mbdlft.system.sampled import deltas_of
from tests import close
from tests.seeds import some
from tests.strategies import random_scene, scenes

SEEDS = some(range(12), range(24))
SOME = some(range(0, 12, 3), range(0, 24, 3))
Points = dict[str, np.ndarray]


class Case(NamedTuple):
    """A scene with its model and its reference at points of the parameters."""

    scene: mbdlft.Scene
    model: mbdlft.LFTModel
    points: Points
    reference: Reference


def points_of(scene: mbdlft.Scene) -> Points:
    """The nominal values, three random points and three corners."""
    random = np.random.default_rng(len(scene.parameters))
    return {
        p.name: np.array(
            [p.nominal, *random.uniform(p.low, p.high, 3), *random.choice([p.low, p.high], 3)]
        )
        for p in scene.parameters
    }


def case_of(scene: mbdlft.Scene) -> Case:
    points = points_of(scene)
    return Case(scene, mbdlft.to_lft(scene, search=0.0), points, lagrangian(scene, points))


@cache
def case(seed: int) -> Case:
    return case_of(random_scene(seed))


# the comparison ------------------------------------------------------------------------------


def matrices(model: mbdlft.LFTModel, points: Points) -> np.ndarray:
    """[A B ; C D] (N, ., .)."""
    A, B, C, D = mbdlft.matrices_at(model, points)
    stacked = np.block([[A, B], [C, D]])
    return stacked if stacked.ndim == 3 else stacked[None]


def condition(matrix: np.ndarray) -> float:
    """Smallest condition number over all scalings of rows and columns (Bauer 1963)."""
    if not matrix.size:
        return 1.0
    product = np.abs(np.linalg.inv(matrix)) @ np.abs(matrix)
    return float(np.max(np.abs(np.linalg.eigvals(product))))


def rounding(lft: mbdlft.LFT, deltas: np.ndarray) -> np.ndarray:
    """Change of each entry of the value when every entry of the LFT is rounded: / eps (N, ., .)."""
    spread = np.repeat(deltas, [block.size for block in lft.blocks], axis=1)[:, None, :]
    inverse = np.linalg.inv(np.eye(lft.order) - lft.M11 * spread)
    left = np.abs((lft.M21 * spread) @ inverse)
    right = np.abs(np.swapaxes(spread, 1, 2) * (inverse @ lft.M12))
    inner = left @ (np.abs(lft.M11) @ right + np.abs(lft.M12))
    return np.abs(lft.M22) + np.abs(lft.M21) @ right + inner


def compare(model: mbdlft.LFTModel, points: Points, reference: Reference) -> None:
    """The model and its trim equal the reference to roundoff; every joint in its own unit of mass.

    With q scaled by the root of its own entry of M, all entries of M are of order one. Rounding is
    measured by the condition of M, by the size of the terms of K, and by that of the LFT.
    """
    deltas = deltas_of(model, points)
    compare_state_space(model, matrices(model, points), reference, rounding(model.lft, deltas))
    joint = index_of(reference)
    order = [joint[signal.name] for signal in model.trim.signals]
    trim, expected = np.atleast_2d(mbdlft.trim_at(model, points)), reference.effort[:, order]
    noise = rounding(model.trim.lft, deltas)[:, :, 0]
    for k, row in enumerate(order):
        size = max(np.max(np.abs(part)) for part in (noise[:, k], reference.force[:, row]))
        close.roundoff(trim[:, k], expected[:, k], scale=size)


def compare_state_space(
    model: mbdlft.LFTModel, actual: np.ndarray, reference: Reference, noise: np.ndarray
) -> None:
    """Kinematic rows by themselves, the others in the parts that act on q, qdot and u."""
    expected, joint = state_space(reference, model), index_of(reference)
    unit = np.sqrt(np.max(np.einsum("nii->ni", reference.M), axis=0))
    n, rows = len(unit), (*model.states, *model.outputs)
    accelerates = [
        n <= k < 2 * n or signal.name.endswith(".acceleration") for k, signal in enumerate(rows)
    ]
    close.roundoff(actual[:, ~np.array(accelerates)], expected[:, ~np.array(accelerates)])
    left = np.array([unit[joint[signal.name]] for signal in rows])[accelerates]
    columns = (*model.states, *model.inputs)
    right = np.array([unit[joint[signal.name]] for signal in columns])
    right[: 2 * n] = 1.0 / right[: 2 * n]
    actual, expected, noise = (
        part[:, accelerates] * left[:, None] * right for part in (actual, expected, noise)
    )
    kappa = max(condition(M) for M in reference.M)
    terms = np.max(reference.stiff / unit[:, None] / unit)
    for part, least in ((slice(n), terms), (slice(n, 2 * n), 0.0), (slice(2 * n, None), 0.0)):
        sizes = np.max(np.abs(expected[:, :, part])), np.max(noise[:, :, part]), least
        close.roundoff(actual[:, :, part], expected[:, :, part], kappa, max(sizes) or 1.0)


def index_of(reference: Reference) -> dict[str, int]:
    """Number of the joint of each signal."""
    names = {f"{joint.name}.acceleration": k for k, joint in enumerate(reference.joints)}
    return names | {name: k for part in range(3) for k, name in enumerate(reference.names(part))}


# the model is that of the Lagrangian ---------------------------------------------------------


@pytest.mark.parametrize("seed", SEEDS)
def test_model_and_trim_equal_the_lagrangian(seed: int) -> None:
    compare(*case(seed)[1:])


@settings(max_examples=2 * settings.default.max_examples // 5)  # type: ignore[union-attr]
@given(scenes())
def test_any_scene_equals_its_lagrangian(scene: mbdlft.Scene) -> None:
    compare(*case_of(scene)[1:])


@pytest.mark.parametrize("seed", SEEDS)
def test_certificate_is_roundoff(seed: int) -> None:
    """Entries are compared one by one, so an entry that is small in its row carries its rounding."""
    _, model, points, reference = case(seed)
    expected = state_space(reference, model)
    size = np.max(np.abs(expected), axis=0)
    row = np.max(size, axis=-1, keepdims=True)
    counted = np.where(size > NEGLIGIBLE * row, size, row)
    small = 1.0 / np.min(counted / np.where(row > 0, row, 1.0), initial=1.0, where=row > 0)
    noise = np.max(rounding(model.lft, deltas_of(model, points)), axis=0)
    small *= max(1.0, np.max(noise / np.where(row > 0, row, 1.0)))
    kappa = small * max(condition(M) for M in reference.M)
    close.roundoff(model.certificate.max_relative_error, 0.0, kappa)


# what must not matter ------------------------------------------------------------------------


@pytest.mark.parametrize("seed", SOME)
@pytest.mark.parametrize("turned", [False, True])
def test_splitting_a_body_changes_nothing(seed: int, *, turned: bool) -> None:
    same(case(seed), split(case(seed).scene, turned=turned))


@pytest.mark.parametrize("seed", SOME)
def test_order_of_siblings_changes_nothing(seed: int) -> None:
    scene, random = case(seed).scene, np.random.default_rng(seed)
    bodies = tuple(scene.bodies[k] for k in random.permutation(len(scene.bodies)))
    joints = tuple(scene.joints[k] for k in random.permutation(len(scene.joints)))
    same(case(seed), changed(scene, bodies=bodies, joints=joints, parameters=scene.parameters[::-1]))


def same(case: Case, scene: mbdlft.Scene) -> None:
    """Another description gives the same matrices, so neither order is below the other's bound."""
    model = mbdlft.to_lft(scene, search=0.0)
    compare(model, case.points, case.reference)
    for bounded, other in ((model, case.model), (case.model, model)):
        pairs = zip(bounded.certificate.lower_bound, other.certificate.order, strict=True)
        assert all(bound <= order for bound, order in pairs)


def split(scene: mbdlft.Scene, *, turned: bool) -> mbdlft.Scene:
    """The last body in two, joined by a fixed joint: a quarter and three quarters of everything.

    The frame of the second part is displaced, and turned by 90 deg about z if asked for.
    """
    body, shift = scene.bodies[-1], (0.2, -0.3, 0.1)

    def seen(position: tuple[float | str, ...]) -> tuple[str, str, str]:
        x, y, z = (f"{text(a)} - {text(b)}" for a, b in zip(position, shift, strict=True))
        return (y, f"-({x})", z) if turned else (x, y, z)

    quarter = {"mass": f"0.25*{text(body.mass)}", "ports": {**body.ports, "split": shift}}
    fields = {"name": "rest", "mass": f"0.75*{text(body.mass)}"}
    if body.kind == "rigid":
        given = body.inertia.given()
        quarter["inertia"] = changed(
            body.inertia, **{name: f"0.25*{text(value)}" for name, value in given.items()}
        )
        entries = {name: f"0.75*{text(value)}" for name, value in given.items()}
        if turned:
            source = {"xx": "yy", "yy": "xx", "zz": "zz", "xy": "xy", "xz": "yz", "yz": "xz"}
            sign = {"xy": "-", "yz": "-"}
            entries = {
                name: f"{sign.get(name, '')}0.75*{text(given[source[name]])}"
                for name in source
                if source[name] in given
            }
        about = body.inertia.about
        fields["center_of_mass"] = seen(body.center_of_mass)
        fields["inertia"] = mbdlft.Inertia(
            **entries, about=about if about == "center_of_mass" else "point"
        )
        fields["ports"] = {"point": seen(body.ports.get(about, (0.0, 0.0, 0.0)))}
    else:
        fields["ports"] = {"handle": seen((0.0, 0.0, 0.0))}
        quarter["ports"] = body.ports
    weld = mbdlft.Fixed(
        name="weld",
        parent=f"{body.name}.split" if body.kind == "rigid" else body.name,
        child="rest",
        axis=(0.0, 0.0, 1.0),
        position="90*deg" if turned else 0.0,
    )
    rest = mbdlft.RigidBody(**fields) if body.kind == "rigid" else mbdlft.PointMass(**fields)
    bodies = (*scene.bodies[:-1], changed(body, **quarter), rest)
    return changed(scene, bodies=bodies, joints=(*scene.joints, weld))


def text(source: float | str) -> str:
    return f"({source if isinstance(source, str) else repr(source)})"


def changed(item, **fields):
    """A copy of a description with other fields, checked again."""
    kept = {name: getattr(item, name) for name in type(item).model_fields}
    return type(item)(**{**kept, **fields})


# the scenes ----------------------------------------------------------------------------------


def test_scenes_repeat_and_cover() -> None:
    drawn = [random_scene(seed) for seed in range(60)]
    assert drawn[:10] == [random_scene(seed) for seed in range(10)]
    joints = [joint for scene in drawn for joint in scene.joints]
    bodies = [body for scene in drawn for body in scene.bodies]
    parameters = [p for scene in drawn for p in scene.parameters]
    assert {joint.kind for joint in joints} == {"revolute", "prismatic", "fixed"}
    assert {body.kind for body in bodies} == {"ground", "rigid", "point_mass"}
    assert {p.substitution for p in parameters} == {"identity", "half-angle", "quarter-angle"}
    assert {p.unit for p in parameters} >= {"kg", "g", "m", "mm", "deg", "rad", "%", "1"}
    assert any(np.count_nonzero(joint.axis) == 3 for joint in joints)
    abouts = {body.inertia.about for body in bodies if body.kind == "rigid"}
    assert abouts == {"center_of_mass", "origin", "tip", "side"}
    assert any("." in joint.child for joint in joints)
    moving = [sum(len(joint.freedoms) for joint in scene.joints) for scene in drawn]
    assert set(moving) == {1, 2, 3, 4, 5, 6}
    parents = [[joint.parent.partition(".")[0] for joint in scene.joints] for scene in drawn]
    assert any(len(set(names)) < len(names) for names in parents)
