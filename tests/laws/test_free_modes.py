"""States that no output sees together are gone, exactly.

1. A geared drive whose shaft gives way, its speeds seen: the twist is left of both angles, at any ratio.
2. A car on tires, its rate of yaw seen: the velocity across its own axis is left of heading and velocity.
3. A satellite with two equal wings about one axis: the wings move as one.
4. Without it, no controller of the speed is stable, which is said.
"""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mbdlft
from mbdlft.base.errors import AnalysisError
from mbdlft.batch.rows import source_of
from tests.close import roundoff

DRIVE = """
format = "mbdlft-scene/1"
name = "drive"
[parameters]
n = { nominal = 5.0, low = 4.0, high = 6.0 }
J = { nominal = 0.3, percent = 50, unit = "kg m^2" }
k = { nominal = 300.0, percent = 30, unit = "N m/rad" }
[bodies]
ground = { kind = "ground", ports.load = [0.2, 0, 0] }
rotor = { kind = "rigid", mass = 1.0, inertia = { zz = 0.01 } }
drum = { kind = "rigid", mass = 3.0, inertia = { zz = "J" } }
[joints]
motor = { kind = "revolute", parent = "ground", child = "rotor", axis = [0, 0, 1] }
load = { kind = "revolute", parent = "ground.load", child = "drum", axis = [0, 0, 1], preload = 0 }
[couplings.shaft]
kind = "gear"
joints = ["motor", "load"]
ratio = "n"
stiffness = "k"
damping = 0.02
preload = 0
[linearize]
inputs = ["motor.torque", "load.torque"]
outputs = ["motor.rate", "load.rate"]
states = "needed"
"""

SECOND = """
[bodies.blade]
kind = "rigid"
mass = 1.0
inertia = { zz = 0.02 }
[joints.fan]
kind = "revolute"
parent = "ground"
child = "blade"
axis = [0, 0, 1]
damping = 0.01
[couplings.second]
kind = "gear"
joints = ["fan", "motor"]
ratio = "n^2"
stiffness = 70.0
damping = 0.01
preload = 0
[linearize]"""

CAR = """
format = "mbdlft-scene/1"
name = "car"
velocity = ["v", 0, 0]
constants.r = { value = 0.3, unit = "m" }
[parameters]
v = { nominal = 20.0, low = 10.0, high = 30.0, unit = "m/s" }
m = { nominal = 1200.0, percent = 20, unit = "kg" }
[bodies]
ground = { kind = "ground", ports.center = [0, 0, 0.3] }
slider = { kind = "point_mass", mass = 0 }
front = { kind = "rigid", mass = 0, inertia = { xx = 0.5, yy = 0.8, zz = 0.5 } }
rear = { kind = "rigid", mass = 0, inertia = { xx = 0.5, yy = 0.8, zz = 0.5 } }
[bodies.car]
kind = "rigid"
mass = "m"
inertia = { xx = 300.0, yy = 1500.0, zz = 1500.0 }
ports = { front = [1.2, 0, 0], rear = [-1.5, 0, 0] }
[joints]
aside = { kind = "prismatic", parent = "ground.center", child = "slider", axis = [0, 1, 0], preload = 0 }
heading = { kind = "revolute", parent = "slider", child = "car", axis = [0, 0, 1], preload = 0 }
[linearize]
inputs = ["heading.torque"]
outputs = ["heading.rate"]
states = "needed"
""" + "".join(
    f"""
[joints.spin_{name}]
kind = "revolute"
parent = "car.{name}"
child = "{name}"
axis = [0, 1, 0]
rate = "v/r"
preload = 0
[loads.tire_{name}]
kind = "tire"
child = "{name}"
axis = [0, 1, 0]
radius = "r"
cornering = {cornering}
camber = 0
force = 0
"""
    for name, cornering in (("front", 4e4), ("rear", 5e4))
)


def both_of(text: str) -> tuple[mbdlft.LFTModel, mbdlft.LFTModel]:
    scene = mbdlft.scene_from_toml(text)
    every = scene.model_copy(update={"states": "all"})
    return tuple(mbdlft.to_lft(s, search=0.0) for s in (scene, every))  # type: ignore[return-value]


def same_transfers(part: mbdlft.LFTModel, whole: mbdlft.LFTModel) -> dict[str, Any]:
    values, frequencies = mbdlft.random(whole.parameters, 5), np.array([0.3, 4.0, 250.0])
    expected = mbdlft.frequency_response(whole, values, frequencies)
    roundoff(mbdlft.frequency_response(part, values, frequencies), expected, kappa=1e6)
    return values


def test_twist_of_a_drive() -> None:
    part, whole = both_of(DRIVE)
    names = ["motor.angle - n load.angle", "motor.rate", "load.rate"]
    assert [(s.name, s.unit) for s in part.states] == list(
        zip(names, ["rad", "rad/s", "rad/s"], strict=True)
    )
    values = same_transfers(part, whole)
    n, J, k, c = values["n"], values["J"], values["k"], 0.02
    zero, one = np.zeros(5), np.ones(5)
    motor = np.array([-k, -c * one, c * n]) / 0.01
    expected = np.array([[zero, one, -n], motor, np.array([n * k, n * c, -n * n * c]) / J])
    roundoff(mbdlft.matrices_at(part, values).A, np.moveaxis(expected, 2, 0), kappa=1e3)


def test_a_coefficient_may_divide() -> None:
    """Gears with ratios n and n^2 on both sides of a motor: one of them divides, whatever goes."""
    more = DRIVE.replace("[linearize]", SECOND).replace(', "load.rate"]', ', "load.rate", "fan.rate"]')
    part, whole = both_of(more)
    same_transfers(part, whole)
    assert len(part.states) == 5
    assert part.states[0].name == "load.angle - n^-1 motor.angle"


def test_rows_of_a_sweep_have_them_too() -> None:
    part, _ = both_of(DRIVE)
    values = mbdlft.random(part.parameters, 4)
    points = np.stack([values[p.name] for p in part.parameters], axis=1)
    numeric, evaluated = (source_of(x) for x in (mbdlft.scene_from_toml(DRIVE), part))
    assert numeric.layout == evaluated.layout
    for found, expected in zip(numeric.rows(points)[:2], evaluated.rows(points)[:2], strict=True):
        roundoff(found, expected, kappa=1e3)


def test_heading_of_a_car() -> None:
    """Whitcomb and Milliken (1956): v_y of the car itself, and its rate of yaw."""
    part, whole = both_of(CAR)
    assert [s.name for s in part.states] == ["aside.velocity - v heading.angle", "heading.rate"]
    values = same_transfers(part, whole)
    v, m, (a, b), (f, r) = values["v"], values["m"], (1.2, 1.5), (4e4, 5e4)
    across = [-(f + r) / (m * v), -(a * f - b * r) / (m * v) - v]
    yaw = [-(a * f - b * r) / (1501.0 * v), -(a * a * f + b * b * r) / (1501.0 * v)]
    expected = np.moveaxis(np.array([across, yaw]), 2, 0)
    roundoff(mbdlft.matrices_at(part, values).A, expected, kappa=1e3)


def test_both_wings_of_a_satellite_are_one() -> None:
    path = Path(__file__).parents[2] / "scenarios" / "solar_arrays.toml"
    chosen: dict[str, Any] = {"inputs": ("wheel_z.torque",), "outputs": ("flight.rotation.z",)}
    scene = mbdlft.load_scene(path).model_copy(update=chosen | {"states": "needed"})
    names = [s.name for s in mbdlft.to_lft(scene, search=0.0).states]
    assert len(names) == 10
    assert "left.mode1.displacement - right.mode1.displacement" in names


def test_what_is_not_seen_alone_goes_where_modes_are_other_functions() -> None:
    """Of a rolling disk: its heading, which no output sees, and what follows from it."""
    path = Path(__file__).parents[2] / "scenarios" / "rolling_disk.toml"
    chosen: dict[str, Any] = {
        "outputs": ("base.velocity.x", "base.angular_acceleration.z"),
        "states": "needed",
    }
    scene = mbdlft.load_scene(path)
    part, whole = (
        mbdlft.to_lft(scene.model_copy(update=chosen | more), search=0.0)
        for more in ({}, {"states": "all"})
    )
    assert set(part.states) <= set(whole.states)
    same_transfers(part, whole)


def test_a_speed_loop() -> None:
    """PI with a filter: tuned where the twist is a state; else the mode is named, and what to do."""
    controller = mbdlft.synthesis.tunable_pid("C", "e", "u", filter=100.0, scale=1.0)
    goal = mbdlft.synthesis.tracking_goal("r", "e", time=0.5)
    wires = [["drive.motor.torque", "u"], ["e", "r", "-drive.motor.rate"]]
    part, whole = both_of(DRIVE)
    how: dict[str, Any] = {"starts": 1, "prove": False}
    assert mbdlft.tune([part, controller], [goal], wires, **how).soft < 1.0
    with pytest.raises(AnalysisError, match=r"stays on the axis.*states = 'needed'"):
        mbdlft.tune([whole, controller], [goal], wires, **how)
