"""Sites of an MJCF file that sensors and thrusters use, and equalities that close loops or couple joints.

Such a site becomes a link without mass, welded to its body, so that what is measured and what acts
there is in the axes of the site.
"""

import numpy as np

from mbdlft.base.array import Array
from mbdlft.base.errors import SceneError
from mbdlft.robot.description import (
    WORLD,
    Mimic,
    RobotLoad,
    RobotLoop,
    RobotSensor,
)
from mbdlft.robot.mjcf_model import Compiled
from mbdlft.robot.tree import Side, aligned, unused, welded
from mbdlft.robot.turns import of_quaternion, three

Sites = dict[int, Side]
_INERTIAL = {"ACCELEROMETER": "accelerometer", "GYRO": "gyro"}


def sites_of(model: Compiled) -> Sites:
    """Links at the sites that inertial sensors and thrusters use, by number."""
    used = {int(model.of("sensor_objid")[k]) for k in _inertial(model)}
    used |= {int(model.of("actuator_trnid")[k][0]) for k in _thrusters(model)}
    return {number: _site(model, number) for number in sorted(used)}


def _inertial(model: Compiled) -> list[int]:
    """The accelerometers and gyros on bodies that are not the world."""
    return [
        k
        for k in range(model.count("nsensor"))
        if model.word("mjtSensor", model.of("sensor_type")[k]) in _INERTIAL
        and model.of("site_bodyid")[model.of("sensor_objid")[k]] > 0
    ]


def _thrusters(model: Compiled) -> list[int]:
    """The actuators that push and turn a site without reference."""
    return [
        k
        for k in range(model.count("nactuator"))
        if model.word("mjtTrn", model.of("actuator_trntype")[k]) == "SITE"
        and model.of("actuator_trnid")[k][1] < 0
        and model.of("site_bodyid")[model.of("actuator_trnid")[k][0]] > 0
    ]


def site_link(model: Compiled, number: int) -> str:
    """The name of the link at a site."""
    return unused(f"{model.name_of('SITE', number)}_site", model.body_names)


def _site(model: Compiled, number: int) -> Side:
    name, body = site_link(model, number), model.body(int(model.of("site_bodyid")[number]))
    weld = unused(f"weld_{name}", model.joint_names)
    R = of_quaternion(model.of("site_quat")[number])
    return welded(name, weld, body, model.of("site_pos")[number], R)


def sensors_of(model: Compiled) -> tuple[tuple[RobotSensor, ...], tuple[str, ...], tuple[str, ...]]:
    """Inertial sensors, joints whose rate is measured, and a sentence on the other sensors."""
    sensors, rates, others = [], [], []
    inertial = _inertial(model)
    taken = list(model.joint_names)
    for k in range(model.count("nsensor")):
        kind = model.word("mjtSensor", model.of("sensor_type")[k])
        number = int(model.of("sensor_objid")[k])
        if k in inertial:
            name = unused(model.name_of("SENSOR", k), taken)
            taken.append(name)
            sensors.append(RobotSensor(name, _INERTIAL[kind], site_link(model, number)))
        elif kind == "JOINTVEL":
            rates.append(model.joint(number))
        elif kind != "JOINTPOS":
            others.append(f"{model.name_of('SENSOR', k)} ({kind.lower()})")
    said = (f"sensors {', '.join(others)}",) if others else ()
    return tuple(sensors), tuple(dict.fromkeys(rates)), said


def loads_of(model: Compiled, sites: Sites) -> tuple[RobotLoad, ...]:
    """Thrusters at sites, and the forces that balance a part of the weight of bodies."""
    loads = []
    taken = [*model.joint_names, *(sensor.name for sensor in sensors_of(model)[0])]
    for k in _thrusters(model):
        site = int(model.of("actuator_trnid")[k][0])
        gear = model.of("actuator_gear")[model.of("actuator_outadr")[k]]
        name = unused(model.name_of("ACTUATOR", k), taken)
        taken.append(name)
        for kind, direction in (("force", gear[:3]), ("torque", gear[3:])):
            if np.any(direction):
                both = np.any(gear[:3]) and np.any(gear[3:])
                label = f"{name}_{kind}" if both else name
                loads.append(RobotLoad(label, kind, sites[site][0].name, three(direction)))
    for body in range(1, model.count("nbody")):
        displaced = float(model.of("body_gravcomp")[body] * model.of("body_mass")[body])
        if displaced and any(model.gravity):
            name = unused(f"{model.body(body)}_gravity_compensation", taken)
            loads.append(RobotLoad(name, "buoyancy", model.body(body), displaced=displaced))
    return tuple(loads)


def mimics_of(model: Compiled) -> dict[str, Mimic]:
    """The joints that an equality couples with another one, by name.

    Raises
    ------
    SceneError
        The coupling is not linear, or a joint is held by itself.
    """
    mimics = {}
    for k in _active(model, "JOINT"):
        first, second = int(model.of("eq_obj1id")[k]), int(model.of("eq_obj2id")[k])
        constant, slope, *higher = (float(entry) for entry in model.of("eq_data")[k][:5])
        where = f"equality {model.name_of('EQUALITY', k)!r} of joint {model.joint(first)!r}"
        if any(higher) or second < 0:
            raise SceneError(
                f"{where}: expected a linear coupling of two joints, polycoef = 'a b'. A scene has no "
                "others; take it out of the file, or make the joint a fixed one."
            )
        mimics[model.joint(first)] = Mimic(model.joint(second), slope, constant)
    return mimics


def loops_of(
    model: Compiled,
) -> tuple[tuple[RobotLoop, ...], tuple[Side, ...]]:
    """The loops that equalities of the types connect and weld close, and the links that they stand on."""
    loops: list[RobotLoop] = []
    sides: list[Side] = []
    for word, kind in (("CONNECT", "spherical"), ("WELD", "fixed")):
        for k in _active(model, word):
            name = unused(model.name_of("EQUALITY", k), model.joint_names)
            (a, at_a), (b, at_b), R = _ends(model, k, word)
            ends = (_body(model, a), _body(model, b), three(at_a), three(at_b))
            loop, own = aligned(RobotLoop(name, kind, *ends), R, model.body_names)
            loops.append(loop)
            sides += own
    return tuple(loops), tuple(sides)


def _ends(model: Compiled, k: int, word: str) -> tuple[tuple[int, Array], tuple[int, Array], Array]:
    """Two bodies with the points that an equality connects, and the axes of the second in the first."""
    first, second = int(model.of("eq_obj1id")[k]), int(model.of("eq_obj2id")[k])
    data = np.asarray(model.of("eq_data")[k])
    if model.of("eq_objtype")[k] == model.code("mjtObj", "SITE"):
        quats = [of_quaternion(model.of("site_quat")[s]) for s in (first, second)]
        a, b = (
            (int(model.of("site_bodyid")[s]), np.asarray(model.of("site_pos")[s]))
            for s in (first, second)
        )
        return a, b, np.asarray(quats[0] @ quats[1].T)
    if word == "CONNECT":
        return (first, data[:3]), (second, data[3:6]), np.eye(3)
    R = of_quaternion(data[6:10])
    return (first, data[3:6] + R @ data[:3]), (second, data[:3]), R


def _active(model: Compiled, word: str) -> list[int]:
    """The equalities of a type that act from the beginning."""
    code = model.code("mjtEq", word)
    return [
        k
        for k in range(model.count("neq"))
        if model.of("eq_type")[k] == code
        and model.of("eq_active0")[k]
        and not model.disabled("EQUALITY")
    ]


def _body(model: Compiled, number: int) -> str:
    return model.body(number) if number else WORLD
