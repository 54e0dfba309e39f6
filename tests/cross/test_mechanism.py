"""Mechanisms of all kinds against their equations in maximal coordinates, in 150 digits.

Springs, loads, spin, closures of all kinds, imposed joints and sensors; rotors are in `test_steady.py`.
The truth has true gaps and cosines of closures, whose redundant rows stay.
"""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import mbdlft
from tests import close, kit
from tests.attack.mechanisms import check
from tests.attack.mechanisms import points_of as points_of_drawn
from tests.cross.mechanisms import closed_by, open_tree, with_angle_held
from tests.cross.mixed_mechanisms import mixed
from tests.cross.planar_mechanisms import PLANAR
from tests.cross.steady_mechanisms import second_bearing, spinning
from tests.seeds import some
from tests.strategies import random_scene

_PLANAR = ("revolute", "spherical")  # kinds of closures that mechanisms in a plane have
CLOSED = {kind: seed for seed, kind in enumerate(mbdlft.multibody.loop.KINDS)}


def closed(kind: str, seed: int) -> mbdlft.Scene:
    scene = closed_by(kind, seed)
    scene = with_angle_held(scene) if kind == "fixed" else scene
    return scene.model_copy(update={"sensors": scene.sensors[6:8]})


SCENES: dict[str, Callable[[], mbdlft.Scene]] = {
    **{f"tree {seed}": (lambda seed=seed: open_tree(seed)) for seed in (0, 2, 3)},
    **{kind: (lambda kind=kind: closed(kind, CLOSED[kind])) for kind in CLOSED if kind not in _PLANAR},
    **PLANAR,
    "mixed": lambda: mixed(0),
}

LONG = ("four-bar, coupler held", "four-bar, rocker held")


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


@pytest.mark.parametrize("name", some([name for name in SCENES if name not in LONG], LONG))
def test_a_mechanism_equals_maximal_coordinates(name: str) -> None:
    equals_truth(SCENES[name]())


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


# Scenes of rigid bodies in files, of scenarios/ and of docs/trials.md, in 150 digits.

ROOT = Path(__file__).parents[2]
OTHERS = {"diff_drive", "lander", "motorcycle"}  # supports, tires that relax, wheels that share a force


def rigid(folder: str) -> list[mbdlft.Scene]:
    texts = [path.read_text("utf-8") for path in sorted((ROOT / folder).glob("*.toml"))]
    scenes = [mbdlft.scene_from_toml(text) for text in texts if "mbdlft-scene/1" in text]
    kinds = {"ground", "point_mass", "rigid"}
    return [scene for scene in scenes if {body.kind for body in scene.bodies} <= kinds]


_ALL = rigid("scenarios")
LARGE = [scene for scene in _ALL if scene.name in ("ur5", "whipple_bicycle")]
SCENARIOS = [scene for scene in _ALL if scene not in LARGE and scene.name not in OTHERS]


@pytest.mark.parametrize(
    "scene", some(SCENARIOS, LARGE + rigid("docs/trials")), ids=lambda scene: str(scene.name)
)
def test_a_scene_equals_maximal_coordinates(scene: mbdlft.Scene) -> None:
    equals_truth(scene)


# Random scenes against maximal coordinates; another description of the same one changes nothing.

SEEDS = some((1, 3), range(40))
SOME = some((6,), range(0, 24, 3))


@pytest.mark.parametrize("seed", SEEDS)
def test_model_and_trim_equal_maximal_coordinates(seed: int) -> None:
    scene = random_scene(seed)
    check(scene, mbdlft.to_lft(scene, search=0.0, prove=0.0), points_of_drawn(scene, seed))


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
    check(scene, another, points_of_drawn(scene, seed))
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
    weld = kit.weld(
        "weld",
        f"{body.name}.split" if body.kind == "rigid" else body.name,
        "rest",
        (0.0, 0.0, 1.0),
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


# Rotors and gears against their equations in maximal coordinates, in 150 digits.
# The truth moves: its rotors turn, with matrices of inertia that turn with them. It knows nothing of
# symmetry, and agrees only because the linear model of what is symmetric does not depend on time.


def swing(mass: float) -> mbdlft.RigidBody:
    """A body with its center off the axes, and an eye that carries what turns on it."""
    return kit.body(
        "swing",
        mass,
        (0.4, 0.5, 0.3),
        xz=0.05,
        center_of_mass=(0.1, 0.2, -0.5),
        ports={"eye": (0.1, 0.0, -0.8)},
    )


def geared_wheel() -> mbdlft.Scene:
    """A wheel on a swing behind a gear: its center lies on its axis, and off the point of its joint."""
    return kit.scene(
        "geared_wheel",
        mbdlft.Parameter("W", 40.0, low=-20.0, high=90.0, unit="rad/s"),
        mbdlft.Parameter("n", 3.0, low=2.0, high=5.0),
        swing(3.0),
        kit.body("wheel", 1.5, (0.06, 0.06, 0.1), center_of_mass=(0.0, 0.0, 0.2)),
        kit.cross("cross", "ground", "swing", actuator_inertia=(0.2, 0.3)),
        kit.hinge(
            "motor",
            "swing.eye",
            "wheel",
            (0, 0, 1),
            orientation=[kit.turn((1, 1, 0), "40*deg")],
            rate="W",
            gear_ratio="n",
            actuator_inertia=0.02,
            reflected_inertia=0.01,
            damping=0.01,
        ),
        mbdlft.Momentum(name="whole"),
        mbdlft.JointWrench(name="cut", joint="cross"),
        gravity=(0.3, 0.0, -9.81),
        outputs=["motor.rate", "whole.angular.x", "whole.linear.y", "cut.torque.x", "cut.force.z"],
    )


def carried_rotor() -> mbdlft.Scene:
    """A frame that spins tilts a body, in which a geared joint turns an arm about a tilted axis."""

    def body(name: str, xx: float, yy: float, zz: float) -> mbdlft.RigidBody:
        return kit.body(name, 1.0, (xx, yy, zz))

    return kit.scene(
        "carried_rotor",
        mbdlft.Parameter("W", 2.0, low=0.5, high=4.0, unit="rad/s"),
        mbdlft.Parameter("n", -20.0, low=-30.0, high=-10.0),
        mbdlft.Parameter("J", 0.01, percent=40, unit="kg m^2"),
        mbdlft.Angle("g", 20.0, low=-40.0, high=60.0),
        body("body", 2.0, 3.0, 2.5),
        body("arm", 0.4, 0.7, 0.9),
        kit.hinge("tilt", "ground", "body", (1, 0, 0), position="g"),
        kit.hinge(
            "gear", "body", "arm", (0.0, 0.6, 0.8), position=0.6, actuator_inertia="J", gear_ratio="n"
        ),
        spin=mbdlft.Spin(axis=(0, 0, 1), rate="W"),
    )


def tower() -> mbdlft.Scene:
    """A gimbal with two rotors across each other on a swing, under gravity, without loads."""
    wheel = {"xx": 0.06, "yy": 0.06, "zz": "J"}
    return kit.scene(
        "tower",
        mbdlft.Parameter("W", 300.0, percent=40, unit="rpm"),
        mbdlft.Parameter("J", 0.1, percent=15, unit="kg m^2"),
        mbdlft.Angle("g", 20.0, low=-50.0, high=60.0),
        swing(6.0),
        kit.body("ring", 1.0, (0.03, 0.04, 0.05)),
        *(
            kit.body(name, 2.0, center_of_mass=(0, 0, 0.05), inertia=mbdlft.Inertia(**wheel))
            for name in ("first", "second")
        ),
        kit.ball("ball", "ground", "swing"),
        kit.hinge("gimbal", "swing.eye", "ring", (1, 0, 0), position="g"),
        kit.hinge("up", "ring", "first", (0, 0, 1), rate="W"),
        kit.hinge(
            "across",
            "ring",
            "second",
            (0, 0, 1),
            orientation=[kit.turn((0, 1, 0), "90*deg")],
            rate="-2*W",
            damping=0.01,
        ),
        gravity=(0.5, 0, -9.81),
        outputs=["up.angle", "across.angle", "gimbal.angle"],
    )


SCENES_STEADY: dict[str, Callable[[], mbdlft.Scene]] = {
    "carried rotor": carried_rotor,
    "geared wheel": geared_wheel,
    "second bearing": second_bearing,
    "tower": tower,
    "spinning": lambda: spinning(9),
}


@pytest.mark.parametrize("name", SCENES_STEADY)
def test_rotors_equal_maximal_coordinates(name: str) -> None:
    equals_truth(SCENES_STEADY[name]())


def test_angles_are_left_out_and_nothing_else_changes() -> None:
    """Without angles among the outputs the model has two states less: rows and columns of the same."""
    scene = tower()
    full = mbdlft.to_lft(scene, search=0.0)
    less = mbdlft.to_lft(scene.model_copy(update={"outputs": ("gimbal.angle", "up.rate")}), search=0.0)
    names = [signal.name for signal in full.states]
    left = [signal.name for signal in less.states]
    assert sorted(set(names) - set(left)) == ["across.angle", "up.angle"]
    kept = [names.index(name) for name in left]
    for point in points_of(scene):
        A, B, _, _ = mbdlft.matrices_at(full, point)
        a, b, _, _ = mbdlft.matrices_at(less, point)
        close.target(np.hstack([a, b]), np.hstack([A[np.ix_(kept, kept)], B[kept]]), close.CROSS)
        gone = [k for k in range(len(names)) if k not in kept]
        assert not np.any(A[:, gone])
