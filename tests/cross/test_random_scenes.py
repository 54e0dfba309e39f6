"""Random scenes against maximal coordinates; another description of the same one changes nothing."""

import numpy as np
import pytest

import mbdlft
from tests.attack.mechanisms import check, points_of
from tests.seeds import some
from tests.strategies import random_scene

SEEDS = some((1, 3, 4, 6, 9, 10), range(40))
SOME = some((4, 6), range(0, 24, 3))


@pytest.mark.parametrize("seed", SEEDS)
def test_model_and_trim_equal_maximal_coordinates(seed: int) -> None:
    scene = random_scene(seed)
    check(scene, mbdlft.to_lft(scene, search=0.0, prove=0.0), points_of(scene, seed))


@pytest.mark.parametrize("seed", SOME)
@pytest.mark.parametrize("turned", [False, True])
def test_splitting_a_body_changes_nothing(seed: int, *, turned: bool) -> None:
    scene = random_scene(seed)
    same(scene, split(scene, turned=turned), seed)


@pytest.mark.parametrize("seed", SOME)
def test_order_of_siblings_changes_nothing(seed: int) -> None:
    scene, random = random_scene(seed), np.random.default_rng(seed)
    bodies = tuple(scene.bodies[k] for k in random.permutation(len(scene.bodies)))
    joints = tuple(scene.joints[k] for k in random.permutation(len(scene.joints)))
    other = changed(scene, bodies=bodies, joints=joints, parameters=scene.parameters[::-1])
    same(scene, other, seed)


def same(scene: mbdlft.Scene, other: mbdlft.Scene, seed: int) -> None:
    """Another description gives the same matrices, so neither order is below the other's bound."""
    model, another = (mbdlft.to_lft(s, search=0.0) for s in (scene, other))
    check(scene, another, points_of(scene, seed))
    for bounded, reached in ((model, another), (another, model)):
        pairs = zip(bounded.certificate.lower_bound, reached.certificate.order, strict=True)
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
