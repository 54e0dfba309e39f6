"""What the actuators of an MJCF file do to its joints.

An actuator on a joint has the length gear q and exerts the torque or force

    gear (gain control + bias_0 + bias_1 gear q + bias_2 gear qdot) - gear^2 damping qdot

and the inertia gear^2 armature moves with the joint. The control is constant at rest, so that the
effort of the joint, the input of the scene, is gear gain control up to a constant; the rest is a spring
and a damper.
"""

import math
from typing import NamedTuple

from mbdlft.robot.mjcf_model import Compiled


class Drive(NamedTuple):
    """What actuators add to a joint: N m/rad, N m s/rad, kg m^2, or the same of forces."""

    stiffness: float = 0.0
    damping: float = 0.0
    inertia: float = 0.0


class Driven(NamedTuple):
    """What actuators add to joints, by name, with sentences for the report."""

    joints: dict[str, Drive]
    said: tuple[str, ...]
    ignored: tuple[str, ...]


def driven(model: Compiled) -> Driven:
    """What the actuators on joints do; those on other things are sentences."""
    joints: dict[str, Drive] = {}
    said, left_out, lawless = [], [], []
    for number in range(model.count("nactuator")):
        name = model.name_of("ACTUATOR", number)
        transmission = model.word("mjtTrn", model.of("actuator_trntype")[number])
        target = int(model.of("actuator_trnid")[number][0])
        axial = transmission in ("JOINT", "JOINTINPARENT") and model.kind(target) in (
            "revolute",
            "prismatic",
        )
        if not axial:
            if transmission != "SITE" or model.of("actuator_trnid")[number][1] >= 0:
                left_out.append(f"{name} ({transmission.lower()})")
            else:
                said.append(f"{name} acts at a site, {_at_site(model, number)} per unit of control")
            continue
        joint = model.joint(target)
        added, gain, known = _drive(model, number)
        before = joints.get(joint, Drive())
        joints[joint] = Drive(*(a + b for a, b in zip(before, added, strict=True)))
        said.append(
            f"{joint} is driven by {name}" + (f", {gain:.6g} per unit of control" if known else "")
        )
        if not known:
            lawless.append(name)
    ignored = []
    if left_out:
        ignored.append(f"actuators that do not act on one hinge or slide: {', '.join(left_out)}")
    if lawless:
        ignored.append(
            f"laws and states of the actuators {', '.join(lawless)}: what they exert is an input"
        )
    return Driven(joints, tuple(said), tuple(ignored))


def _at_site(model: Compiled, number: int) -> str:
    """The force and the torque of an actuator at a site for one unit of its control."""
    gear = model.of("actuator_gear")[model.of("actuator_outadr")[number]]
    gain = float(model.of("actuator_gainprm")[number][0])
    sizes = ((math.hypot(*gear[:3]), "N"), (math.hypot(*gear[3:]), "N m"))
    return " and ".join(f"{gain * size:.6g} {unit}" for size, unit in sizes if size)


def _drive(model: Compiled, number: int) -> tuple[Drive, float, bool]:
    """What one actuator adds, effort per unit of control, and whether it has no more than that."""
    gear = float(model.of("actuator_gear")[model.of("actuator_outadr")[number]][0])
    gain_kind = model.word("mjtGain", model.of("actuator_gaintype")[number])
    bias_kind = model.word("mjtBias", model.of("actuator_biastype")[number])
    dynamics = model.word("mjtDyn", model.of("actuator_dyntype")[number])
    stiffness = damping = 0.0
    if bias_kind == "AFFINE" and not model.disabled("ACTUATION"):
        _, slope, rate = (float(entry) for entry in model.of("actuator_biasprm")[number][:3])
        stiffness, damping = -(gear**2) * slope, -(gear**2) * rate
    damping += gear**2 * float(model.of("actuator_damping")[number])
    inertia = gear**2 * float(model.of("actuator_armature")[number])
    known = gain_kind == "FIXED" and bias_kind in ("NONE", "AFFINE") and dynamics == "NONE"
    gain = gear * float(model.of("actuator_gainprm")[number][0])
    return Drive(stiffness, damping, inertia), gain, known
