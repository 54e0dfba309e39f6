"""Robots of MJCF files, as the package mujoco compiles them: defaults, includes and shapes are resolved.

MuJoCo turns a body by the joints of the body one after the other, each about its own point. The first
joint stands where the body stands in its parent; links without mass are between the joints. At rest

    tau = M qddot + (stiffness + gear^2 kp) q + (damping + gear^2 kv) qdot + g(q)

where kp and kv are the feedback of a position or velocity servo with `gear`. Source: MuJoCo
documentation, chapters Computation (section Actuation model) and XML reference.
"""

from pathlib import Path

import numpy as np

from mbdlft.base.array import Array
from mbdlft.base.errors import SceneError, unknown_name
from mbdlft.robot.description import WORLD, Robot, RobotJoint, RobotLink
from mbdlft.robot.elements import Element
from mbdlft.robot.mjcf_actuators import Driven, driven
from mbdlft.robot.mjcf_model import Compiled, compiled
from mbdlft.robot.mjcf_sites import loads_of, loops_of, mimics_of, sensors_of, sites_of
from mbdlft.robot.mjcf_unknown import ignored, refuse
from mbdlft.robot.tree import unused
from mbdlft.robot.turns import angles_of, of_quaternion, three


def read_mjcf(file: Path, top: Element, keyframe: str | None = None) -> Robot:
    """Read a robot from an MJCF file; `top` are its elements, `keyframe` gives the positions.

    Raises
    ------
    SceneError
        The package mujoco is not installed or does not compile the file, or the file has what a scene
        cannot have.
    """
    model = compiled(file, top)
    refuse(model)
    positions = _positions(model, keyframe)
    actuators = driven(model)
    links, joints = _links(model), _joints(model, positions, actuators)
    sites = sites_of(model)
    loops, sides = loops_of(model)
    for link, joint in (*sites.values(), *sides):
        links[link.name], joints[joint.name] = link, joint
    sensors, rates, unused_sensors = sensors_of(model)
    servos = [name for name, drive in actuators.joints.items() if drive.stiffness or drive.damping]
    assumed = [f"mujoco says: {text}" for text in model.warnings]
    if servos:
        assumed.append(f"servos act as springs and dampers of {', '.join(servos)}")
    if actuators.said:
        assumed.append(f"inputs: {'; '.join(actuators.said)}")
    loads = loads_of(model, sites)
    inputs = (*actuators.joints, *(load.name for load in loads if load.kind != "buoyancy"))
    return Robot(
        name=model.name,
        links=links,
        joints={
            name: joint._replace(mimic=mimics_of(model).get(name)) for name, joint in joints.items()
        },
        loads=loads,
        sensors=sensors,
        loops=loops,
        gravity=model.gravity,
        inputs=inputs or None,
        rates=rates,
        ignored=(*ignored(model), *actuators.ignored, *unused_sensors),
        assumed=tuple(assumed),
    )


def _positions(model: Compiled, keyframe: str | None) -> Array:
    """The positions (nq,) of the model, or those of a keyframe."""
    if keyframe is None:
        return np.asarray(model.of("qpos0"))
    names = [model.name_of("KEY", k) for k in range(model.count("nkey"))]
    if keyframe not in names:
        raise SceneError(f"keyframe: {unknown_name('keyframe', keyframe, names)}")
    return np.asarray(model.of("key_qpos")[names.index(keyframe)])


def _links(model: Compiled) -> dict[str, RobotLink]:
    """The links of all bodies but the world, and those between the joints of one body."""
    links = {}
    for body in range(1, model.count("nbody")):
        for name in model.between(body):
            links[name] = RobotLink(name, 0, inertial=True)
        turned = of_quaternion(model.of("body_iquat")[body])
        moments = model.of("body_inertia")[body]
        links[model.body(body)] = RobotLink(
            name=model.body(body),
            line=0,
            inertial=True,
            mass=float(model.of("body_mass")[body]),
            center=three(model.of("body_ipos")[body]),
            rpy=angles_of(turned),
            inertia={
                **dict.fromkeys(("xy", "xz", "yz"), 0.0),
                **{2 * axis: float(moment) for axis, moment in zip("xyz", moments, strict=True)},
            },
        )
    return links


def _joints(model: Compiled, positions: Array, actuators: Driven) -> dict[str, RobotJoint]:
    """The joints of all bodies; a body without joints is welded to its parent."""
    joints: dict[str, RobotJoint] = {}
    for body in range(1, model.count("nbody")):
        parent = model.of("body_parentid")[body]
        at = model.of("body_pos")[body]
        R = of_quaternion(model.of("body_quat")[body])
        outer = model.body(parent) if parent else WORLD
        numbers = model.joints(body)
        if not numbers:
            name = unused(f"weld_{model.body(body)}", {*joints, *model.joint_names})
            joints[name] = RobotJoint(
                name, 0, "fixed", outer, model.body(body), three(at), angles_of(R)
            )
        inner = [*model.between(body), model.body(body)]
        for number, child in zip(numbers, inner, strict=False):
            made = _joint(model, number, outer, child, positions)
            anchor = np.array(made.anchor)
            if made.kind == "floating":  # its coordinates are the place of the body in the world
                start = positions[model.of("jnt_qposadr")[number] :]
                at, turned = start[:3], of_quaternion(start[3:7])
            else:
                turned = R @ _ball(model, number, positions) if made.kind == "spherical" else R
            drive = actuators.joints.get(made.name)
            if drive:
                made = made._replace(
                    stiffness=made.stiffness + drive.stiffness,
                    damping=made.damping + drive.damping,
                    reflected_inertia=made.reflected_inertia + drive.inertia,
                )
            joints[made.name] = made._replace(xyz=three(at + R @ anchor), rpy=angles_of(turned))
            outer, at, R = child, np.zeros(3), np.eye(3)
    return joints


def _ball(model: Compiled, number: int, positions: Array) -> Array:
    """The rotation (3, 3) of a ball joint."""
    start = model.of("jnt_qposadr")[number]
    return of_quaternion(positions[start : start + 4])


def _joint(model: Compiled, number: int, outer: str, child: str, positions: Array) -> RobotJoint:
    """A joint without its place in its parent."""
    kind = model.kind(number)
    address = model.of("jnt_qposadr")[number]
    dof = model.of("jnt_dofadr")[number]
    free = kind == "floating"
    reference = 0.0 if kind in ("floating", "spherical") else float(model.of("qpos0")[address])
    lower, upper, effort = _limits(model, number, kind, reference)
    return RobotJoint(
        name=model.joint(number),
        line=0,
        kind="continuous" if kind == "revolute" and lower is None else kind,
        parent=outer,
        child=child,
        anchor=(0.0, 0.0, 0.0) if free else three(model.of("jnt_pos")[number]),
        axis=three(model.of("jnt_axis")[number]),
        position=0.0
        if kind in ("floating", "spherical")
        else float(positions[address]) - reference,
        lower=lower,
        upper=upper,
        effort=effort,
        stiffness=0.0 if model.disabled("SPRING") else float(model.of("jnt_stiffness")[number]),
        rest=_rest(model, number, kind, reference),
        damping=0.0 if model.disabled("DAMPER") else float(model.of("dof_damping")[dof]),
        reflected_inertia=float(model.of("dof_armature")[dof]),
        friction=float(model.of("dof_frictionloss")[dof]),
    )


def _rest(model: Compiled, number: int, kind: str, reference: float) -> float:
    """The position, from the reference, at which the spring of a hinge or slide is slack."""
    if kind in ("floating", "spherical"):
        return 0.0
    return float(model.of("qpos_spring")[model.of("jnt_qposadr")[number]]) - reference


def _limits(
    model: Compiled, number: int, kind: str, reference: float
) -> tuple[float | None, float | None, float | None]:
    """Lower and upper limit of the position from the reference, and the largest effort."""
    lower = upper = effort = None
    if model.of("jnt_limited")[number] and kind in ("revolute", "prismatic"):
        lower, upper = (float(end) - reference for end in model.of("jnt_range")[number])
    if model.of("jnt_actfrclimited")[number]:
        effort = float(np.max(np.abs(model.of("jnt_actfrcrange")[number])))
    return lower, upper, effort
