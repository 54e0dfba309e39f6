"""Errors of contacts: what does not touch, slips, leans, or touches itself."""

from typing import Any

import pytest

import mbdlft
from mbdlft.multibody.contact import KINDS
from mbdlft.multibody.coupling import Gear
from mbdlft.multibody.force import KINDS as KINDS_OF_LOADS
from tests import kit
from tests.errors.table import refused


def wheel(kind: str = "rolling", contact: dict[str, Any] | None = None, **fields: Any) -> mbdlft.Scene:
    """A wheel of 0.5 m that rolls at 3 m/s along x below a frame."""
    touch = (
        {"port": "wheel", "axis": (0, 1, 0), "radius": 0.5} if kind == "rolling" else {"port": "frame"}
    )
    scene = kit.scene(
        "cart",
        kit.body("frame", 2.0, (0.1, 0.1, 0.1)),
        kit.body("wheel", 1.0, (0.1, 0.2, 0.1)),
        kit.free("base", "ground", "frame", position=(0, 0, fields.pop("height", 0.5))),
        kit.hinge("axle", "frame", "wheel", (0, 1, 0), rate=fields.pop("rate", 6.0)),
        KINDS[kind](name="touch", **{**touch, **(contact or {})}),
        velocity=(3.0, 0.0, 0.0),
        gravity=(0.0, 0.0, 0.0),
    )
    return kit.changed(scene, **fields)


def on_tire(speed: float | str = 3.0, **law: Any) -> mbdlft.Scene:
    """A wheel of 0.5 m on a tire, without a joint that turns it."""
    given = {"child": "wheel", "axis": (0, 1, 0), "radius": 0.5, "cornering": 1e4, **law}
    return kit.scene(
        "cart",
        mbdlft.Parameter("v", 5.0, low=0.0, high=9.0, unit="m/s"),
        kit.body("wheel", 1.0, (0.1, 0.2, 0.1)),
        kit.free("base", "ground", "wheel", position=(0, 0, 0.5)),
        KINDS_OF_LOADS["tire"](name="tire", **given),
        velocity=(speed, 0.0, 0.0),
        gravity=(0.0, 0.0, 0.0),
    )


def trolley(outputs: list[str], aside: float = 0.0, gears: tuple[Gear, ...] = ()) -> mbdlft.Scene:
    """Two wheels on one axle, at rest: what holds them along it is the sum of two forces; or in a row,
    where gears between them, and the ground, hold the same."""
    wheels = {"left": (0, 0.3, 0), "right": (0, -0.3, 0)}
    if gears:
        wheels = {"left": (0.3, 0, 0), "right": (-0.3, 0, 0)}
    round_ = mbdlft.Inertia(xx=0.1, yy=0.2, zz=0.1)
    bodies = [kit.body("frame", 2.0, inertia=round_, ports=wheels)]
    bodies += [kit.body(name, 1.0, inertia=round_) for name in wheels]
    joints = [kit.free("base", "ground", "frame", position=(0, 0, 0.5))]
    held = {"preload": 0.0} if gears else {}
    joints += [kit.hinge(f"axle_{name}", f"frame.{name}", name, (0, 1, 0), **held) for name in wheels]
    contacts = [KINDS["rolling"](name=name, port=name, axis=(0, 1, 0), radius=0.5) for name in wheels]
    return kit.scene(
        "trolley", *bodies, *joints, *contacts, *gears, outputs=outputs, gravity=(0.0, aside, -9.0)
    )


SHAFT = (Gear(name="shaft", joints=("axle_left", "axle_right"), ratio=1.0),)

test_messages = refused(
    r"""
> assemble(wheel({})) => SceneError: contact 'touch' …
=> accepted
"knife_edge", {"heading": (1, 0, 0)} => accepted
height=0.6 => 'wheel' is 0.6 m above the plane at nominal, and the radius is 0.5 m … by 0.1 m
rate=5.0 => the rate of body 'wheel' does not fit the velocity [3, 0, 0] … slip by 0.5 m/s
contact={"port": "ground"} => is on the ground: it touches itself
contact={"radius": -0.5} => the radius must be positive, and it is -0.5 m
contact={"tire": 0.7} => the tire must have a radius from 0 to that of the wheel
contact={"axis": (1, 0, 0)} => joint 'axle' turns body 'wheel' steadily, so it must be a wheel about
contact={"axis": None, "tire": 0.1} => a ball has none, got 0.1
contact={"plane": "frame"} => expected 'ground' or one of its ports, got 'frame'
contact={"port": "frame", "axis": (0, 3, 4)} => is not across the normal of the plane, but 53.13 deg off
"knife_edge", {"heading": (1, 1, 0)} => does not fit the velocity [3, 0, 0] … slip by 2.121 m/s
contact={"port": "weel"} => unknown body 'weel'
spin=Spin(axis=(0, 0, 1), rate=1.0) => turns with the spin of the frame … the velocity [3.0, 0.0, 0.0]
> {} => SceneError:
to_lft(wheel("knife_edge", {"heading": (1, 0, 0)}, outputs=["touch.force.1"])) => unknown signal
to_lft(trolley(["left.force.2"])) => 'left.force.2' is not known, as contacts hold the same twice
to_lft(trolley(["left.force.normal", "right.force.1"])) => accepted
to_lft(trolley(["left.force.normal"], aside=-3.0)) => accepted
to_lft(trolley(["right.force.1"], aside=-3.0))
    => 'right.force.1' is not known: … has a part of left.force.2 … sum with right.force.2 only
notes(trolley(["right.force.1"], aside=-3.0)) => 'right.force.1' is not known: as the body turns
to_lft(trolley(["shaft.torque"], gears=SHAFT))
    => 'shaft.torque' is not known, as contacts hold the same twice
to_lft(trolley(["left.force.normal"], gears=SHAFT)) => accepted
> assemble(on_tire({})) => SceneError: load 'tire' …
=> accepted
speed="v" => the speed along axis x normal goes down to 0 m/s … has velocity = … Turn the axis round
speed="v", relaxation=0.2 => accepted
speed=-2.0, relaxation=0.2 => goes down to -2 m/s
axis=(1, 0, 0) => moves along the axis of the wheel with 3 m/s
axis=(0, 3, 4) => is not across the normal of the plane, but 53.13 deg off
radius=0.4 => 'wheel' is 0.5 m above the plane at nominal … misses the ground by 0.1 m
radius=0.0 => the radius must be positive
cornering=0.0 => the cornering must be positive, and it is 0 in the range
relaxation=-1.0 => the relaxation must be positive
crown=0.6 => the crown must have a radius from 0
child="weel" => unknown body 'weel'
> {} => TrimError:
find_equilibrium(on_tire()) => positions are not searched for where bodies roll, as load 'tire' does
find_equilibrium(wheel()) => positions are not searched for where bodies roll, as contact 'touch' does
"""
)


def test_gravity_that_a_tire_or_a_wheel_would_carry_is_missed_once() -> None:
    """Not where it is said to be zero, and not where the tire carries a force that is given."""
    for scene in (wheel(), on_tire()):
        forgotten = scene.model_copy(deep=True)
        forgotten.model_fields_set.discard("gravity")
        with pytest.warns(
            mbdlft.MbdlftWarning, match="there is no gravity, and (contact 'touch'|load 'tire')"
        ):
            mbdlft.assemble(forgotten)
        assert not [text for text in mbdlft.notes(scene) if "gravity" in text]
    planar = on_tire(force=0.0)
    planar.model_fields_set.discard("gravity")
    assert [text for text in mbdlft.notes(planar) if "no gravity" in text]


def test_a_note_says_which_forces_are_known_as_a_sum() -> None:
    (note,) = [x for x in mbdlft.notes(trolley(["left.force.1"])) if "known as sums only" in x]
    assert "the forces left.force.2, right.force.2, as contacts" in note
    assert not [x for x in mbdlft.notes(wheel()) if "known as sums only" in x]
