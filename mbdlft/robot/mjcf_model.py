"""An MJCF file as the package mujoco compiles it: arrays with names, and what stands beside the tree.

Sites that sensors and thrusters use become links without mass, welded to their bodies, so that what is
measured and what acts there is in the axes of the site. Equalities close loops or couple joints.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from mbdlft.base.array import Array
from mbdlft.base.errors import SceneError
from mbdlft.base.worker import arrays_of
from mbdlft.robot import robot
from mbdlft.robot.compiling import MEMORY
from mbdlft.robot.urdf import Element

_MOST = 10_000  # copies that a file may ask for
_SECONDS = 120  # of the processor, for compiling
_COPIES = ("replicate", "composite", "flexcomp")
_KINDS = {"FREE": "floating", "BALL": "spherical", "SLIDE": "prismatic", "HINGE": "revolute"}
_MEASURED: Mapping[str, str] = {
    "body_mass": "body", "body_inertia": "body", "body_pos": "body", "body_quat": "body",
    "body_ipos": "body", "body_iquat": "body", "jnt_pos": "joint", "jnt_axis": "joint",
    "jnt_stiffness": "joint", "jnt_range": "joint",
}  # fmt: skip
Sites = dict[int, robot.Side]
_INERTIAL = {"ACCELEROMETER": "accelerometer", "GYRO": "gyro"}


@dataclass(frozen=True)
class Compiled:
    """A compiled model: `arrays` is the MjModel, `library` the module mujoco.

    `warnings` is what the compiler says.
    """

    arrays: Any
    library: Any
    warnings: tuple[str, ...] = ()

    def code(self, enumeration: str, name: str) -> int:
        """The number of a constant, such as HINGE of mjtJoint."""
        kinds = getattr(self.library, enumeration)
        prefix = next(iter(kinds.__members__)).partition("_")[0]
        return int(kinds.__members__[f"{prefix}_{name}"].value)

    def word(self, enumeration: str, code: int) -> str:
        """The name of a constant without its prefix, such as HINGE."""
        return str(getattr(self.library, enumeration)(int(code)).name).partition("_")[2]

    def disabled(self, flag: str) -> bool:
        """Whether the options disable a part of the physics."""
        return bool(self.arrays.opt.disableflags & self.code("mjtDisableBit", flag))

    @property
    def name(self) -> str:
        return bytes(self.arrays.names).split(b"\0", 1)[0].decode("utf-8", "replace")

    @property
    def gravity(self) -> robot.Triple:
        return robot.ZERO if self.disabled("GRAVITY") else robot.three(self.arrays.opt.gravity)

    def name_of(self, kind: str, number: int) -> str:
        """The name that the file gives to an object, or its kind with its number."""
        code = getattr(self.library.mjtObj, f"mjOBJ_{kind}")
        return self.library.mj_id2name(self.arrays, code, int(number)) or f"{kind.lower()}_{number}"

    def names_of(self, kind: str, count: str) -> list[str]:
        """The names of all objects of a kind, all different."""
        names: list[str] = []
        for number in range(getattr(self.arrays, count)):
            names.append(robot.unused(self.name_of(kind, number), names))
        return names

    @cached_property
    def body_names(self) -> list[str]:
        """Names of the bodies, the world first."""
        return self.names_of("BODY", "nbody")

    @cached_property
    def joint_names(self) -> list[str]:
        return self.names_of("JOINT", "njnt")

    def body(self, number: int) -> str:
        return self.body_names[number]

    def joint(self, number: int) -> str:
        return self.joint_names[number]

    def joints(self, body: int) -> list[int]:
        """The joints of a body, in their order."""
        first, count = self.arrays.body_jntadr[body], self.arrays.body_jntnum[body]
        return [int(first) + k for k in range(int(count))]

    def kind(self, joint: int) -> str:
        """The kind of a joint: floating, spherical, prismatic or revolute."""
        return _KINDS[self.word("mjtJoint", self.arrays.jnt_type[joint])]

    def active(self, word: str) -> list[int]:
        """The equalities of a type that act from the beginning."""
        if self.disabled("EQUALITY"):
            return []
        of_type = self.arrays.eq_type == self.code("mjtEq", word)
        return [int(k) for k in np.flatnonzero(of_type & (self.arrays.eq_active0 != 0))]

    def between(self, body: int) -> list[str]:
        """Names of the links without mass after each joint of a body but the last."""
        return [
            robot.unused(f"{self.body(body)}_after_{self.joint(number)}", self.body_names)
            for number in self.joints(body)[:-1]
        ]


def compiled(file: Path, top: Element) -> Compiled:
    """The model of a file, compiled by the package mujoco; `top` are its elements."""
    pending = [top]
    while pending:  # more copies than any mechanism has are not tried
        element = pending.pop()
        pending += element.children
        counts = element.attributes.get("count", "") if element.tag in _COPIES else ""
        asked = np.prod([float(n) for n in counts.split() if n.isdigit()])
        if asked > _MOST:
            raise SceneError(
                f"line {element.line}: <{element.tag}> asks for {asked:g} copies, expected at most "
                f"{_MOST}."
            )
    try:
        import mujoco
    except ImportError:
        raise SceneError(
            "MJCF files are compiled by the package mujoco, which is not installed: pip install "
            "'mbdlft[mjcf]'."
        ) from None
    limits: dict[str, Any] = {"seconds": _SECONDS, "memory": MEMORY, "error": SceneError}
    arguments = {"path": str(file.resolve())}
    made = arrays_of("mbdlft.robot.compiling:binary", arguments, **limits, libraries=("mujoco",))
    arrays = mujoco.MjModel.from_binary_path("model.mjb", {"model.mjb": made["model"].tobytes()})
    warnings = made["warnings"].tobytes().decode()
    model = Compiled(arrays, mujoco, tuple(warnings.splitlines()))
    for array, owner in _MEASURED.items():
        bad = ~np.all(np.isfinite(np.atleast_2d(np.asarray(getattr(model.arrays, array)).T)), axis=0)
        if bad.any():
            name = getattr(model, owner)(int(np.argmax(bad)))
            raise SceneError(f"{owner} {name!r}: its {array.partition('_')[2]} is not finite.")
    return model


def sites_of(model: Compiled) -> Sites:
    """Links at the sites that inertial sensors and thrusters use, by number."""
    used = {int(model.arrays.sensor_objid[k]) for k in _inertial(model)}
    used |= {int(model.arrays.actuator_trnid[k][0]) for k in _thrusters(model)}
    sites = {}
    for number in sorted(used):
        name, body = site_link(model, number), model.body(int(model.arrays.site_bodyid[number]))
        weld = robot.unused(f"weld_{name}", model.joint_names)
        R = robot.of_quaternion(model.arrays.site_quat[number])
        sites[number] = robot.welded(name, weld, body, model.arrays.site_pos[number], R)
    return sites


def _inertial(model: Compiled) -> list[int]:
    """The accelerometers and gyros on bodies that are not the world."""
    return [
        k
        for k in range(model.arrays.nsensor)
        if model.word("mjtSensor", model.arrays.sensor_type[k]) in _INERTIAL
        and model.arrays.site_bodyid[model.arrays.sensor_objid[k]] > 0
    ]


def _thrusters(model: Compiled) -> list[int]:
    """The actuators that push and turn a site without reference."""
    return [
        k
        for k in range(model.arrays.nactuator)
        if model.word("mjtTrn", model.arrays.actuator_trntype[k]) == "SITE"
        and model.arrays.actuator_trnid[k][1] < 0
        and model.arrays.site_bodyid[model.arrays.actuator_trnid[k][0]] > 0
    ]


def site_link(model: Compiled, number: int) -> str:
    """The name of the link at a site."""
    return robot.unused(f"{model.name_of('SITE', number)}_site", model.body_names)


def sensors_of(model: Compiled) -> tuple[tuple[robot.RobotSensor, ...], tuple[str, ...], tuple[str, ...]]:
    """Inertial sensors, joints whose rate is measured, and a sentence on the other sensors."""
    sensors, rates, others = [], [], []
    inertial = _inertial(model)
    taken = list(model.joint_names)
    for k in range(model.arrays.nsensor):
        kind = model.word("mjtSensor", model.arrays.sensor_type[k])
        number = int(model.arrays.sensor_objid[k])
        if k in inertial:
            name = robot.unused(model.name_of("SENSOR", k), taken)
            taken.append(name)
            sensors.append(robot.RobotSensor(name, _INERTIAL[kind], site_link(model, number)))
        elif kind == "JOINTVEL":
            rates.append(model.joint(number))
        elif kind != "JOINTPOS":
            others.append(f"{model.name_of('SENSOR', k)} ({kind.lower()})")
    said = (f"sensors {', '.join(others)}",) if others else ()
    return tuple(sensors), tuple(dict.fromkeys(rates)), said


def loads_of(model: Compiled, sites: Sites) -> tuple[robot.RobotLoad, ...]:
    """Thrusters at sites, and the forces that balance a part of the weight of bodies."""
    loads = []
    taken = [*model.joint_names, *(sensor.name for sensor in sensors_of(model)[0])]
    for k in _thrusters(model):
        site = int(model.arrays.actuator_trnid[k][0])
        gear = model.arrays.actuator_gear[model.arrays.actuator_outadr[k]]
        name = robot.unused(model.name_of("ACTUATOR", k), taken)
        taken.append(name)
        for kind, direction in (("force", gear[:3]), ("torque", gear[3:])):
            if np.any(direction):
                both = np.any(gear[:3]) and np.any(gear[3:])
                label = f"{name}_{kind}" if both else name
                loads.append(robot.RobotLoad(label, kind, sites[site][0].name, robot.three(direction)))
    for body in range(1, model.arrays.nbody):
        displaced = float(model.arrays.body_gravcomp[body] * model.arrays.body_mass[body])
        if displaced and any(model.gravity):
            name = robot.unused(f"{model.body(body)}_gravity_compensation", taken)
            loads.append(robot.RobotLoad(name, "buoyancy", model.body(body), displaced=displaced))
    return tuple(loads)


def mimics_of(model: Compiled) -> dict[str, robot.Mimic]:
    """The joints that an equality couples linearly with another one, by name."""
    mimics = {}
    for k in model.active("JOINT"):
        first, second = int(model.arrays.eq_obj1id[k]), int(model.arrays.eq_obj2id[k])
        constant, slope, *higher = (float(entry) for entry in model.arrays.eq_data[k][:5])
        where = f"equality {model.name_of('EQUALITY', k)!r} of joint {model.joint(first)!r}"
        if any(higher) or second < 0:
            raise SceneError(
                f"{where}: expected a linear coupling of two joints, polycoef = 'a b'. A scene has no "
                "others; take it out of the file, or make the joint a fixed one."
            )
        mimics[model.joint(first)] = robot.Mimic(model.joint(second), slope, constant)
    return mimics


def loops_of(model: Compiled) -> tuple[tuple[robot.RobotLoop, ...], tuple[robot.Side, ...]]:
    """The loops that equalities of the types connect and weld close, and the links that they stand on."""
    loops: list[robot.RobotLoop] = []
    sides: list[robot.Side] = []
    for word, kind in (("CONNECT", "spherical"), ("WELD", "fixed")):
        for k in model.active(word):
            name = robot.unused(model.name_of("EQUALITY", k), model.joint_names)
            (a, at_a), (b, at_b), R = _ends(model, k, word)
            parent, child = (model.body(number) if number else robot.WORLD for number in (a, b))
            loop = robot.RobotLoop(name, kind, parent, child, robot.three(at_a), robot.three(at_b))
            loop, carriers = robot.aligned(loop, R, model.body_names)
            loops.append(loop)
            sides += carriers
    return tuple(loops), tuple(sides)


def _ends(model: Compiled, k: int, word: str) -> tuple[tuple[int, Array], tuple[int, Array], Array]:
    """Two bodies with the points that an equality connects, and the axes of the second in the first."""
    first, second = int(model.arrays.eq_obj1id[k]), int(model.arrays.eq_obj2id[k])
    data = np.asarray(model.arrays.eq_data[k])
    if model.arrays.eq_objtype[k] == model.code("mjtObj", "SITE"):
        quats = [robot.of_quaternion(model.arrays.site_quat[s]) for s in (first, second)]
        a, b = (
            (int(model.arrays.site_bodyid[s]), np.asarray(model.arrays.site_pos[s]))
            for s in (first, second)
        )
        return a, b, np.asarray(quats[0] @ quats[1].T)
    if word == "CONNECT":
        return (first, data[:3]), (second, data[3:6]), np.eye(3)
    R = robot.of_quaternion(data[6:10])
    return (first, data[3:6] + R @ data[:3]), (second, data[:3]), R
