"""The numbers of a robot by label, such as ``forearm_link.mass``, and the values that replace them.

A file gives the inertia J_c of a link l in axes c that are turned against those of the link. In the
axes of the link it is J_l = R_lc J_c R_lc' with R_lc = R_z(yaw) R_y(pitch) R_x(roll).
"""

import math
import re
from collections.abc import Iterable, Mapping

import numpy as np

from mbdlft.base.description import AXES, Quantity
from mbdlft.base.errors import SceneError, unknown_name
from mbdlft.base.parameter import Parameter
from mbdlft.robot.description import ENTRIES, Robot, RobotJoint, RobotLink, of_angles, said, three

Values = dict[str, Quantity]

HINGES = ("revolute", "continuous")
AXIAL = (*HINGES, "prismatic")  # the types with one coordinate
SPRINGS = ("stiffness", "damping", "actuator_inertia", "reflected_inertia")
SPRUNG = (*AXIAL, "spherical", "floating")  # those whose coordinates can have springs and dampers
PLANAR = ("position.x", "position.y", "position.angle")
TURNS = ("roll", "pitch", "yaw")
_ROUNDING = 1e-15  # rad: of a reader, which is no difference of the file
_UNITS = {"mass": "kg", "center_of_mass": "m", "inertia": "kg m^2", "origin": "m", "anchor": "m"}


def numbers(robot: Robot, right_angle: float, assumed: list[str]) -> Values:
    """The numbers of the file by label, with positions of zero.

    Sentences on what the file does not say are added to `assumed`. An angle that differs by less than
    `right_angle` (rad) from a multiple of a right angle is replaced by it.
    """
    values: Values = {}
    snapped: list[float] = []
    for link in robot.links.values():
        values[f"{link.name}.mass"] = link.mass
        values |= _labelled(f"{link.name}.center_of_mass", AXES, link.center)
        inertia = _inertia(link, right_angle, snapped)
        values |= _labelled(f"{link.name}.inertia", inertia, inertia.values())
    for joint in robot.joints.values():
        turns = [_angle(angle, right_angle, snapped) for angle in joint.rpy]
        values |= _labelled(f"{joint.name}.origin", (*AXES, *TURNS), (*joint.xyz, *turns))
        values |= _labelled(f"{joint.name}.anchor", AXES, joint.anchor)
        values |= {f"{joint.name}.{key}": value for key, value in _of_kind(joint).items()}
    if snapped:
        assumed.append(
            f"{len(snapped)} angles are multiples of 90 deg, from which the file differs by at most "
            f"{max(snapped):.1e} rad"
        )
    links, limited = robot.links.values(), ("revolute", "prismatic")
    free = (j.name for j in robot.joints.values() if j.kind in limited and j.lower is None)
    points = (link.name for link in links if link.mass and not any(link.inertia.values()))
    assumed += said(
        "links without <inertial> have no mass: {}", (k.name for k in links if not k.inertial)
    )
    assumed += said("joints without limits of position have none: {}", free)
    assumed += said("links with a mass and no inertia are point masses: {}", points)
    return values


def _labelled(owner: str, names: Iterable[str], entries: Iterable[Quantity]) -> Values:
    """Entries by the names that they have in an owner."""
    return {f"{owner}.{name}": entry for name, entry in zip(names, entries, strict=True)}


def _of_kind(joint: RobotJoint) -> Values:
    """Positions, springs, dampers and actuator inertias that the coordinates of a joint have."""
    values: Values = {}
    if joint.kind in AXIAL:
        values["position"] = joint.position
    if joint.kind in SPRUNG:
        values |= {"stiffness": joint.stiffness, "damping": joint.damping}
    if joint.kind in HINGES:
        values |= {"actuator_inertia": 0.0, "reflected_inertia": joint.reflected_inertia}
    elif joint.kind in ("prismatic", "spherical"):
        values["actuator_inertia"] = joint.reflected_inertia
    elif joint.kind == "planar":
        values |= dict.fromkeys(PLANAR, 0.0)
    return values


def _angle(angle: float, right_angle: float, snapped: list[float]) -> Quantity:
    """The angle (rad), or the multiple of 90 deg nearly equal to it; `snapped` gets the change."""
    quarters = round(angle / (math.pi / 2.0))
    difference = abs(angle - quarters * math.pi / 2.0)
    if difference > right_angle:
        return angle
    if difference > _ROUNDING:
        snapped.append(difference)
    return f"{90 * quarters}*deg" if quarters else 0.0


def _inertia(link: RobotLink, right_angle: float, snapped: list[float]) -> Mapping[str, float]:
    """Entries of the inertia matrix in the axes of the link."""
    right = [round(angle / (math.pi / 2.0)) * math.pi / 2.0 for angle in link.rpy]
    is_right = [angle != 0.0 and _angle(angle, right_angle, snapped) != angle for angle in link.rpy]
    R_lc = of_angles(three(np.where(is_right, right, link.rpy)))
    if np.array_equal(R_lc, np.eye(3)):
        return link.inertia
    J_c = np.array([[link.inertia["".join(sorted(a + b))] for b in AXES] for a in AXES])
    J_l = R_lc @ J_c @ R_lc.T
    return {name: float(J_l[AXES.index(name[0]), AXES.index(name[1])]) + 0.0 for name in ENTRIES}


def varied(label: str, percent: float, file: Mapping[str, Quantity]) -> Parameter:
    """A parameter in a range of `percent` around a number of the file.

    Its name is the label with underscores for dots.
    """
    check_label("vary", label, file)
    number, match = file[label], re.search(rf"\.({'|'.join(_UNITS)})(\.[xyz]{{1,2}})?$", label)
    if match is None or not isinstance(number, float) or number == 0.0:
        raise SceneError(
            f"vary, {label!r}: expected a mass, an inertia or a length of the file that is not zero, got "
            f"{number!r}. Declare other parameters in `parameters`, and name them in `values`."
        )
    name = re.sub(r"\W", "_", label)
    return Parameter(
        name if name.isidentifier() else f"_{name}", number, percent=percent, unit=_UNITS[match[1]]
    )


def check_label(what: str, label: str, file: Mapping[str, Quantity]) -> None:
    """Raise a SceneError for a label that the robot does not have."""
    if label in file or (label.endswith(".preload") and f"{label[:-8]}.position" in file):
        return
    owners = {name for known in file for name in _owners(known)}
    nearby = [k for k in file if any(k.startswith(f"{name}.") for name in _owners(label))]
    if nearby:
        raise SceneError(f"{what}: {unknown_name('label', label, nearby)}")
    owner = label.partition(".")[0]
    raise SceneError(f"{what}, {label!r}: {unknown_name('link or joint', owner, owners)}")


def _owners(label: str) -> Iterable[str]:
    """Possible names of the link or joint of a label; names may have dots, so there can be two."""
    keys = "|".join((*_UNITS, "position", "preload", *SPRINGS))
    match = re.fullmatch(rf"(.+)\.(?:{keys})(?:\.\w+)?", label)
    return (match[1],) if match else (label.rpartition(".")[0], label.partition(".")[0])


def set_positions(robot: Robot, values: Values, chosen: set[str], assumed: list[str]) -> None:
    """Set the positions in `values` that the user did not choose and that are not zero.

    These are positions of mimic joints, and of joints whose limits exclude zero. `chosen` are the labels
    that the user chose; sentences on the positions are added to `assumed`.
    """
    for joint in robot.joints.values():
        label = f"{joint.name}.position"
        is_free = label not in chosen and joint.kind in AXIAL and joint.mimic is None
        if not (is_free and outside(joint)):
            continue
        if robot.loops:
            assumed.append(
                f"the limits of {joint.name} exclude the place where the file closes its loops; it stays "
                "there"
            )
            continue
        values[label] = middle = 0.5 * sum(end for end in (joint.lower, joint.upper) if end)
        assumed.append(
            f"the limits of {joint.name} exclude {joint.position:g}: its position is their middle, "
            f"{middle:.6g} {'m' if joint.kind == 'prismatic' else 'rad'}"
        )
    for joint in robot.joints.values():
        if joint.kind in AXIAL and joint.mimic and f"{joint.name}.position" not in chosen:
            values[f"{joint.name}.position"] = _follow(robot, joint, values, chosen, ())


def outside(joint: RobotJoint) -> bool:
    """Whether the position of a joint in its file is outside of its limits."""
    if joint.lower is None or joint.upper is None:
        return False
    return not joint.lower <= joint.position <= joint.upper


def _follow(
    robot: Robot, joint: RobotJoint, values: Values, chosen: set[str], seen: tuple[str, ...]
) -> Quantity:
    """Position of a mimic joint: multiplier * position of its leader + offset.

    `seen` are the mimic joints that led here.
    """
    label = f"{joint.name}.position"
    if joint.mimic is None or label in chosen:
        return values[label]
    name, multiplier, offset = joint.mimic
    where = f"line {joint.line}: joint {joint.name!r}, <mimic>"
    leader = robot.joints.get(name)
    if leader is None or leader.kind not in AXIAL:
        known = [other.name for other in robot.joints.values() if other.kind in AXIAL]
        raise SceneError(f"{where}: {unknown_name('joint', name, known)}")
    if name in (*seen, joint.name):
        raise SceneError(f"{where}: the joints {', '.join((*seen, joint.name))} mimic each other.")
    position = _follow(robot, leader, values, chosen, (*seen, joint.name))
    if isinstance(position, float | int):
        return multiplier * position + offset
    scaled = f"({position})" if multiplier == 1.0 else f"{multiplier:g}*({position})"
    return f"{scaled} + {offset!r}" if offset else scaled
