"""Random scenes with an equilibrium that is known: efforts are computed at some positions, which are
then forgotten."""

from typing import Any, NamedTuple

import numpy as np

import mbdlft
from mbdlft.base.description import Quantity
from mbdlft.multibody.joint import KINDS as KINDS_OF_JOINTS
from mbdlft.multibody.joint import Joint, coordinate_label
from mbdlft.multibody.joint.kinds import AxisJoint
from tests import kit

KINDS = ("revolute", "revolute", "prismatic", "universal", "cylindrical", "planar", "spherical")
MOST_BODIES = 5


class Known(NamedTuple):
    """A scene whose positions are away from an equilibrium, and that equilibrium.

    `positions` (rad, m) are by coordinate, without those of balls; `passive` are the joints that nothing
    holds.
    """

    scene: mbdlft.Scene
    positions: dict[str, float]
    passive: tuple[str, ...]


def known_equilibrium(seed: int) -> Known:
    """A random tree of 1 to 5 bodies with springs, loads and gravity."""
    rng = np.random.default_rng(seed)
    count = int(rng.integers(1, MOST_BODIES + 1))
    bodies = [_body(rng, k) for k in range(count)]
    joints = [_joint(rng, k, "ground" if k == 0 else _port(rng, k)) for k in range(count)]
    loads = _loads(rng, count)
    held = {k for k in range(count) if rng.random() < 0.3}
    mass, gravity = mbdlft.Parameter("m", 2.0, percent=30, unit="kg"), tuple(rng.normal(0.0, 6.0, 3))
    scene = kit.scene(f"equilibrium{seed}", mass, *bodies, *joints, *loads, gravity=gravity)
    efforts = dict(_efforts(scene))
    forgotten = [
        joint if k in held else _forgotten(rng, joint, efforts) for k, joint in enumerate(joints)
    ]
    positions = {
        f"{joint.name}.{freedom.measures[0].name}": float(value)
        for k, joint in enumerate(joints)
        if k not in held
        for freedom, value in zip(joint.freedoms, _entries(joint, "position"), strict=False)
    }
    passive = tuple(joint.name for k, joint in enumerate(joints) if k not in held)
    return Known(scene.model_copy(update={"joints": tuple(forgotten)}), positions, passive)


def _efforts(scene: mbdlft.Scene) -> list[tuple[str, float]]:
    point = mbdlft.solve_trim(mbdlft.assemble(scene))
    return [(s.name, value) for s, value in zip(point.signals, point.values, strict=True)]


def _forgotten(rng: np.random.Generator, joint: Joint, efforts: dict[str, float]) -> Joint:
    """The joint at other positions, with the efforts that hold it at those it has."""
    preload, moved = [], []
    stiffness = _entries(joint, "stiffness")
    for k, freedom in enumerate(joint.freedoms):
        needed = efforts[f"{joint.name}.{freedom.effort.name}"]
        change = 0.0
        if coordinate_label("position", freedom) in joint.quantities():
            change = float(rng.uniform(-2.5, 2.5) if freedom.turns else rng.uniform(-0.8, 0.8))
            moved.append(float(_entries(joint, "position")[k]) + change)
        preload.append(needed - float(stiffness[k]) * change)
    update: dict[str, Any] = {"preload": _packed(joint, preload)}
    if moved:
        update["position"] = _packed(joint, moved)
    else:
        axis = rng.standard_normal(3)
        turn = mbdlft.Rotation(axis=tuple(axis), angle=float(rng.uniform(0.3, 2.5)))
        update["orientation"] = (*joint.orientation, turn)
    return joint.model_copy(update=update)


def _entries(joint: Joint, key: str) -> tuple[Quantity, ...]:
    given = getattr(joint, key, ())
    return given if isinstance(given, tuple) else (given,)


def _packed(joint: Joint, values: list[float]) -> Any:
    return tuple(values) if len(joint.freedoms) > 1 else values[0]


def _body(rng: np.random.Generator, k: int) -> mbdlft.RigidBody:
    moments = rng.uniform(0.2, 0.4, 3)
    mass = "m" if k == 0 and rng.random() < 0.3 else float(rng.uniform(0.5, 4.0))
    center, tip = (tuple(rng.uniform(-most, most, 3).tolist()) for most in (0.6, 0.9))
    return kit.body(f"b{k}", mass, moments.tolist(), center_of_mass=center, ports={"tip": tip})


def _port(rng: np.random.Generator, k: int) -> str:
    return f"b{rng.integers(0, k)}.tip"


def _joint(rng: np.random.Generator, k: int, parent: str) -> Joint:
    kind = KINDS[rng.integers(0, len(KINDS))]
    cls = KINDS_OF_JOINTS[kind]
    turns = [freedom.turns for freedom in cls.freedoms]
    fields: dict[str, Any] = {"name": f"j{k}", "parent": parent, "child": f"b{k}"}
    if issubclass(cls, AxisJoint):
        fields["axis"] = tuple(float(x) for x in rng.standard_normal(3))
    if "position" in cls.model_fields:
        fields["position"] = [
            float(rng.uniform(-3.0, 3.0) if turn else rng.uniform(-0.7, 0.7)) for turn in turns
        ]
        # slides have springs: gravity alone does not hold them in place
        fields["stiffness"] = [
            float(rng.uniform(30.0, 200.0)) if not turn or rng.random() < 0.3 else 0.0 for turn in turns
        ]
        for key in ("position", "stiffness"):
            fields[key] = tuple(fields[key]) if len(turns) > 1 else fields[key][0]
    if rng.random() < 0.3:
        axis = tuple(float(x) for x in rng.standard_normal(3))
        fields["orientation"] = [mbdlft.Rotation(axis=axis, angle=float(rng.uniform(-2.0, 2.0)))]
    joint: Joint = cls(**fields)
    return joint


def _loads(rng: np.random.Generator, count: int) -> list[Any]:
    loads, tip = list[Any](), f"b{count - 1}.tip"
    if rng.random() < 0.5:
        direction = tuple(rng.standard_normal(3).tolist())
        frame = ("ground", "body")[int(rng.integers(0, 2))]
        loads.append(kit.force("pull", tip, direction, frame=frame, magnitude=rng.uniform(1.0, 15.0)))
    if rng.random() < 0.5:
        stiffness, rest_length = rng.uniform(10.0, 60.0), rng.uniform(0.2, 1.0)
        loads.append(kit.spring("cable", "ground", tip, stiffness=stiffness, rest_length=rest_length))
    return loads
