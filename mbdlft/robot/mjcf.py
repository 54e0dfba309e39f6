"""Robots of MJCF files, as the package mujoco compiles them: defaults, includes and shapes are resolved.

MuJoCo turns a body by the joints of the body one after the other, each about its own point. The first
joint stands where the body stands in its parent; links without mass are between the joints. An actuator
on a joint has the length gear q and exerts the torque or force

    gear (gain control + bias_0 + bias_1 gear q + bias_2 gear qdot) - gear^2 damping qdot

and the inertia gear^2 armature moves with the joint. The control is constant at rest, so that the effort
of the joint, the input of the scene, is gear gain control up to a constant. Feedback of position and
velocity is a spring and a damper: with kp = -bias_1, kv = -bias_2,

    tau = M qddot + (stiffness + gear^2 kp) q + (damping + gear^2 kv) qdot + g(q)

Contents of a file that a scene cannot have are refused where they move or push bodies, else listed in the
report. Source: MuJoCo documentation, chapters Computation (section Actuation model) and XML reference.

A fixed tendon, which becomes a coupling, has the length L = c1 q1 + c2 q2 + ... of the coordinates of
its joints. With a spring and a damper its force is -k (L - L_s) - d L_dot, where L_s is the end of the
range of slack lengths beyond which L is; inside of the range the spring is slack. An equality holds
L - L_0 = a + b (L' - L'_0) with another tendon, or L - L_0 = a, rigidly; lengths with a 0 are those of
the reference of the file.
"""

import math
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

from mbdlft.base.array import Array
from mbdlft.base.errors import SceneError, check_known
from mbdlft.robot import robot
from mbdlft.robot.mjcf_model import (
    Compiled,
    compiled,
    loads_of,
    loops_of,
    mimics_of,
    sensors_of,
    sites_of,
)
from mbdlft.robot.urdf import Element

_EQUALITIES = ("CONNECT", "WELD", "JOINT", "TENDON")


def _problems(model: Compiled) -> Iterator[str]:
    """Sentences on what moves or pushes the bodies in a way of its own."""
    if model.arrays.nflex:
        yield f"flex {model.name_of('FLEX', 0)!r} is a deformable body."
    for body in np.flatnonzero(model.arrays.body_plugin >= 0).tolist():
        yield f"body {model.body(body)!r} has a plugin, whose forces are unknown."
    for joint in np.flatnonzero(np.any(model.arrays.jnt_stiffnesspoly != 0.0, axis=1)).tolist():
        yield f"joint {model.joint(joint)!r} has a nonlinear spring."
    for joint in np.flatnonzero(model.arrays.jnt_springyield > 0.0).tolist():
        yield f"joint {model.joint(joint)!r} has a spring that yields."
    for tendon in np.flatnonzero(np.any(model.arrays.tendon_stiffnesspoly != 0.0, axis=1)).tolist():
        yield f"tendon {model.name_of('TENDON', tendon)!r} has a nonlinear spring."
    for tendon in np.flatnonzero(model.arrays.tendon_springyield > 0.0).tolist():
        yield f"tendon {model.name_of('TENDON', tendon)!r} has a spring that yields."
    for joint in range(model.arrays.njnt):
        armature = model.arrays.dof_armature[model.arrays.jnt_dofadr[joint]]
        if model.kind(joint) == "floating" and armature != 0.0:
            yield (
                f"the free joint {model.joint(joint)!r} has an armature, {armature:g}: its body would be "
                "heavier to move than to lift."
            )
    for k in range(model.arrays.neq):
        kind = model.word("mjtEq", model.arrays.eq_type[k])
        if model.arrays.eq_active0[k] and kind not in _EQUALITIES and not model.disabled("EQUALITY"):
            yield f"equality {model.name_of('EQUALITY', k)!r} is of the type {kind.lower()}."


def ignored(model: Compiled) -> tuple[str, ...]:
    """Sentences on what the scene does not have, and what is left out without harm."""
    says: list[str] = []
    for count, what in (("ngeom", "shapes"), ("npair", "pairs of contacts")):
        if getattr(model.arrays, count):
            says.append(f"{getattr(model.arrays, count)} {what}: there are no contacts")
    off = [k for k in range(model.arrays.neq) if not model.arrays.eq_active0[k]]
    says += robot.said("equalities that do not act at first: {}", [_names(model, "EQUALITY", off)])
    if model.arrays.opt.viscosity or (model.arrays.opt.density and np.any(model.arrays.opt.wind)):
        says.append("forces of the medium (density, viscosity, wind)")
    nonlinear = {"springs": model.arrays.jnt_stiffnesspoly, "dampers": model.arrays.dof_dampingpoly}
    says += [f"parts of {what} that are not linear" for what, law in nonlinear.items() if np.any(law)]
    if model.arrays.nmocap:
        says.append(f"{model.arrays.nmocap} mocap bodies are fixed on the ground")
    return tuple(says)


def _names(model: Compiled, kind: str, numbers: Iterable[int]) -> str:
    """Names of objects, the first of many."""
    return robot.first_of([model.name_of(kind, number) for number in numbers])


class Drive(NamedTuple):
    """What actuators add to a joint: N m/rad, N m s/rad, kg m^2, or the same of forces."""

    stiffness: float = 0.0
    damping: float = 0.0
    inertia: float = 0.0


def driven(model: Compiled) -> tuple[dict[str, Drive], list[str], list[str]]:
    """What actuators add to joints, by name, and sentences on what acts and on what is left out."""
    joints: dict[str, Drive] = {}
    says, left_out, lawless = list[str](), list[str](), list[str]()
    for number in range(model.arrays.nactuator):
        name = model.name_of("ACTUATOR", number)
        transmission = model.word("mjtTrn", model.arrays.actuator_trntype[number])
        target = int(model.arrays.actuator_trnid[number][0])
        on_joint = transmission in ("JOINT", "JOINTINPARENT")
        if not on_joint or model.kind(target) not in ("revolute", "prismatic"):
            if transmission != "SITE" or model.arrays.actuator_trnid[number][1] >= 0:
                left_out.append(f"{name} ({transmission.lower()})")
            else:
                says.append(f"{name} acts at a site, {_at_site(model, number)} per unit of control")
            continue
        joint = model.joint(target)
        added, gain, known = _drive(model, number)
        before = joints.get(joint, Drive())
        joints[joint] = Drive(*(a + b for a, b in zip(before, added, strict=True)))
        says.append(
            f"{joint} is driven by {name}" + (f", {gain:.6g} per unit of control" if known else "")
        )
        if not known:
            lawless.append(name)
    ignored = [
        *robot.said("actuators that do not act on one hinge or slide: {}", left_out),
        *robot.said("laws and states of the actuators {}: what they exert is an input", lawless),
    ]
    return joints, says, ignored


def _at_site(model: Compiled, number: int) -> str:
    """The force and the torque of an actuator at a site for one unit of its control."""
    gear = model.arrays.actuator_gear[model.arrays.actuator_outadr[number]]
    gain = float(model.arrays.actuator_gainprm[number][0])
    sizes = ((math.hypot(*gear[:3]), "N"), (math.hypot(*gear[3:]), "N m"))
    return " and ".join(f"{gain * size:.6g} {unit}" for size, unit in sizes if size)


def _drive(model: Compiled, number: int) -> tuple[Drive, float, bool]:
    """What one actuator adds, effort per unit of control, and whether it has no more than that."""
    gear = float(model.arrays.actuator_gear[model.arrays.actuator_outadr[number]][0])
    gain_kind = model.word("mjtGain", model.arrays.actuator_gaintype[number])
    bias_kind = model.word("mjtBias", model.arrays.actuator_biastype[number])
    dynamics = model.word("mjtDyn", model.arrays.actuator_dyntype[number])
    stiffness = damping = 0.0
    if bias_kind == "AFFINE" and not model.disabled("ACTUATION"):
        _, slope, rate = (float(entry) for entry in model.arrays.actuator_biasprm[number][:3])
        stiffness, damping = -gear * gear * slope, -gear * gear * rate
    damping += gear * gear * float(model.arrays.actuator_damping[number])
    inertia = gear * gear * float(model.arrays.actuator_armature[number])
    known = gain_kind == "FIXED" and bias_kind in ("NONE", "AFFINE") and dynamics == "NONE"
    gain = gear * float(model.arrays.actuator_gainprm[number][0])
    if not all(map(math.isfinite, (stiffness, damping, inertia, gain))):
        name = model.name_of("ACTUATOR", number)
        raise SceneError(f"actuator {name!r}: with its gear of {gear:g} it adds what is not finite.")
    return Drive(stiffness, damping, inertia), gain, known


def read_mjcf(file: Path, top: Element, keyframe: str | None = None) -> robot.Robot:
    """Read a robot from an MJCF file; `top` are its elements, `keyframe` gives the positions."""
    model = compiled(file, top)
    for problem in _problems(model):
        raise SceneError(f"{problem} A scene does not have this; take it out of the file.")
    positions = np.asarray(model.arrays.qpos0)
    if keyframe is not None:
        names = [model.name_of("KEY", k) for k in range(model.arrays.nkey)]
        check_known("keyframe", [keyframe], names, "keyframe")
        positions = np.asarray(model.arrays.key_qpos[names.index(keyframe)])
    drives, acts, left_out = driven(model)
    links, joints = _links(model), _joints(model, positions, drives)
    sites = sites_of(model)
    loops, sides = loops_of(model)
    couplings, tendons = couplings_of(model, positions, drives)
    for link, joint in (*sites.values(), *sides):
        links[link.name], joints[joint.name] = link, joint
    sensors, rates, unused_sensors = sensors_of(model)
    servos = (name for name, drive in drives.items() if drive.stiffness or drive.damping)
    assumed = [f"mujoco says: {text}" for text in model.warnings]
    assumed += robot.said("servos act as springs and dampers of {}", servos)
    assumed += [f"inputs: {'; '.join(acts)}"] if acts else []
    loads = loads_of(model, sites)
    inputs = (*drives, *(load.name for load in loads if load.kind != "buoyancy"))
    return robot.Robot(
        name=model.name,
        links=links,
        joints={name: joint._replace(mimic=mimics_of(model).get(name)) for name, joint in joints.items()},
        loads=loads,
        sensors=sensors,
        loops=loops,
        couplings=couplings,
        gravity=model.gravity,
        inputs=inputs or None,
        rates=rates,
        ignored=(*ignored(model), *tendons, *left_out, *unused_sensors),
        assumed=tuple(assumed),
    )


def _links(model: Compiled) -> dict[str, robot.RobotLink]:
    """The links of all bodies but the world, and those between the joints of one body."""
    links = {}
    for body in range(1, model.arrays.nbody):
        for name in model.between(body):
            links[name] = robot.RobotLink(name, 0, inertial=True)
        turned = robot.of_quaternion(model.arrays.body_iquat[body])
        moments = model.arrays.body_inertia[body]
        links[model.body(body)] = robot.RobotLink(
            name=model.body(body),
            line=0,
            inertial=True,
            mass=float(model.arrays.body_mass[body]),
            center=robot.three(model.arrays.body_ipos[body]),
            rpy=robot.angles_of(turned),
            inertia={
                **dict.fromkeys(("xy", "xz", "yz"), 0.0),
                **{2 * axis: float(moment) for axis, moment in zip("xyz", moments, strict=True)},
            },
        )
    return links


def _joints(
    model: Compiled, positions: Array, drives: Mapping[str, Drive]
) -> dict[str, robot.RobotJoint]:
    """The joints of all bodies; a body without joints is welded to its parent."""
    joints: dict[str, robot.RobotJoint] = {}
    for body in range(1, model.arrays.nbody):
        parent = model.arrays.body_parentid[body]
        at = model.arrays.body_pos[body]
        R = robot.of_quaternion(model.arrays.body_quat[body])
        outer = model.body(parent) if parent else robot.WORLD
        numbers = model.joints(body)
        if not numbers:
            name = robot.unused(f"weld_{model.body(body)}", {*joints, *model.joint_names})
            joints[name] = robot.RobotJoint(
                name, 0, "fixed", outer, model.body(body), robot.three(at), robot.angles_of(R)
            )
        inner = [*model.between(body), model.body(body)]
        for number, child in zip(numbers, inner, strict=False):
            made = _joint(model, number, outer, child, positions)
            anchor = np.array(made.anchor)
            start = positions[model.arrays.jnt_qposadr[number] :]
            turned = R
            if made.kind == "floating":  # its coordinates are the place of the body in the world
                at, turned = start[:3], robot.of_quaternion(start[3:7])
            elif made.kind == "spherical":
                turned = R @ robot.of_quaternion(start[:4])
            drive = drives.get(made.name, Drive())
            joints[made.name] = made._replace(
                xyz=robot.three(at + R @ anchor),
                rpy=robot.angles_of(turned),
                stiffness=made.stiffness + drive.stiffness,
                damping=made.damping + drive.damping,
                reflected_inertia=made.reflected_inertia + drive.inertia,
            )
            outer, at, R = child, np.zeros(3), np.eye(3)
    return joints


def _joint(model: Compiled, number: int, outer: str, child: str, positions: Array) -> robot.RobotJoint:
    """A joint without its place in its parent; positions are counted from the reference of the file."""
    kind = model.kind(number)
    address, dof = model.arrays.jnt_qposadr[number], model.arrays.jnt_dofadr[number]
    position = slack = 0.0
    lower = upper = effort = None
    if kind in ("revolute", "prismatic"):
        reference = float(model.arrays.qpos0[address])
        position = float(positions[address]) - reference
        slack = float(model.arrays.qpos_spring[address]) - reference
        if model.arrays.jnt_limited[number]:
            lower, upper = (float(end) - reference for end in model.arrays.jnt_range[number])
    if model.arrays.jnt_actfrclimited[number]:
        effort = float(np.max(np.abs(model.arrays.jnt_actfrcrange[number])))
    return robot.RobotJoint(
        name=model.joint(number),
        line=0,
        kind="continuous" if kind == "revolute" and lower is None else kind,
        parent=outer,
        child=child,
        anchor=robot.ZERO if kind == "floating" else robot.three(model.arrays.jnt_pos[number]),
        axis=robot.three(model.arrays.jnt_axis[number]),
        position=position,
        lower=lower,
        upper=upper,
        effort=effort,
        stiffness=0.0 if model.disabled("SPRING") else float(model.arrays.jnt_stiffness[number]),
        slack=slack,
        damping=0.0 if model.disabled("DAMPER") else float(model.arrays.dof_damping[dof]),
        reflected_inertia=float(model.arrays.dof_armature[dof]),
        friction=float(model.arrays.dof_frictionloss[dof]),
    )


_FORCES = ("stiffness", "damping", "armature", "frictionloss")


def couplings_of(
    model: Compiled, positions: Array, driven: Mapping[str, object]
) -> tuple[tuple[robot.RobotCoupling, ...], tuple[str, ...]]:
    """Couplings of fixed tendons at `positions` (nq,), and sentences on what is left out of tendons.

    `driven` are the joints with actuators. Of the joints of a rigid coupling the first without one is
    held by the tendon.
    """
    made: list[robot.RobotCoupling] = []
    for k in model.active("TENDON"):
        made.append(_rigid(model, k, {*driven, *(coupling.held for coupling in made)}))
    left_out, both = [], np.array([model.arrays.eq_obj1id, model.arrays.eq_obj2id])
    for tendon in range(model.arrays.ntendon):
        sprung = _sprung(model, tendon, positions)
        made += [sprung] if sprung else []
        lost = [key for key in _FORCES if getattr(model.arrays, f"tendon_{key}")[tendon]]
        lost = [key for key in lost if not sprung or key not in ("stiffness", "damping")]
        is_in_equality = any(tendon in both[:, k] for k in model.active("TENDON"))
        if lost or not (sprung or is_in_equality):
            name = model.name_of("TENDON", tendon)
            left_out.append(f"{name} with its {', '.join(lost)}" if lost else name)
    names: list[str] = []
    for coupling in made:
        names.append(robot.unused(coupling.name, (*model.joint_names, *names)))
    named = tuple(c._replace(name=name) for c, name in zip(made, names, strict=True))
    return named, (f"tendons {robot.first_of(left_out)}",) if left_out else ()


def _factors(model: Compiled, tendon: int) -> dict[str, float] | None:
    """The coefficients of a fixed tendon by the names of its joints; None of one along a path."""
    first, count = model.arrays.tendon_adr[tendon], model.arrays.tendon_num[tendon]
    factors: dict[str, float] = {}
    for place in range(first, first + count):
        if model.word("mjtWrap", model.arrays.wrap_type[place]) != "JOINT":
            return None
        name = model.joint(int(model.arrays.wrap_objid[place]))
        factors[name] = factors.get(name, 0.0) + float(model.arrays.wrap_prm[place])
    return factors


def _rigid(model: Compiled, equality: int, taken: set[str]) -> robot.RobotCoupling:
    """The relation of an equality of one tendon or two."""
    first, second = int(model.arrays.eq_obj1id[equality]), int(model.arrays.eq_obj2id[equality])
    constant, slope, *higher = (float(entry) for entry in model.arrays.eq_data[equality][:5])
    where = (
        f"equality {model.name_of('EQUALITY', equality)!r} of tendon {model.name_of('TENDON', first)!r}"
    )
    factors, others = _factors(model, first), _factors(model, second) if second >= 0 else {}
    if factors is None or others is None:
        raise SceneError(
            f"{where}: expected fixed tendons, got one along a path in space, whose length is not "
            "linear. A scene has no others; take it out of the file."
        )
    if any(higher):
        raise SceneError(
            f"{where}: expected a linear relation, polycoef = 'a b'. A scene has no others; take it out "
            "of the file."
        )
    for name, factor in others.items():
        factors[name] = factors.get(name, 0.0) - slope * factor
    factors = {name: factor for name, factor in factors.items() if factor}
    if len(factors) < 2:
        raise SceneError(
            f"{where}: expected two or more joints, got {', '.join(factors) or 'none'}. A joint that "
            "does not move is a fixed one; make it so in the file."
        )
    held = next((name for name in factors if name not in taken), next(iter(factors)))
    return robot.RobotCoupling(model.name_of("EQUALITY", equality), factors, held=held, offset=constant)


def _sprung(model: Compiled, tendon: int, positions: Array) -> robot.RobotCoupling | None:
    """The spring and the damper of a fixed tendon over two or more joints; None without them."""
    k, d = (
        0.0 if model.disabled(flag) else float(getattr(model.arrays, f"tendon_{key}")[tendon])
        for key, flag in (("stiffness", "SPRING"), ("damping", "DAMPER"))
    )
    factors = {name: c for name, c in (_factors(model, tendon) or {}).items() if c}
    if not (k or d) or len(factors) < 2:
        return None
    at = {model.joint(j): int(model.arrays.jnt_qposadr[j]) for j in range(model.arrays.njnt)}
    length = sum(c * float(positions[at[name]]) for name, c in factors.items())
    low, high = (float(end) for end in model.arrays.tendon_lengthspring[tendon])
    if low < high and k:
        if length in (low, high):
            raise SceneError(
                f"tendon {model.name_of('TENDON', tendon)!r}: its length {length:g} is the end of its "
                f"range of slack lengths [{low:g}, {high:g}], where its stiffness jumps from 0 to {k:g}: "
                "there is no linear model. Change springlength, or the positions, in the file."
            )
        k = k if length > high or length < low else 0.0
    # positions of the scene are counted from the reference of the file, where the tendon has length0
    slack = (low if length < low else high) - float(model.arrays.tendon_length0[tendon])
    return robot.RobotCoupling(
        model.name_of("TENDON", tendon), factors, stiffness=k, damping=d, offset=slack
    )
