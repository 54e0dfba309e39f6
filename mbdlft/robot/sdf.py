"""Robots of SDF files: one model, its links, joints, frames and nested models.

Poses are resolved by `mbdlft.robot.sdf_frames`. Of what moves the links, the reader knows the elements
that docs/robots.md lists; others that do so are refused. Source: SDFormat specification, versions 1.3
to 1.12.
"""

from collections.abc import Sequence

import numpy as np

from mbdlft.base.errors import SceneError, check_known
from mbdlft.robot import robot
from mbdlft.robot.make import AXIAL
from mbdlft.robot.sdf_frames import Frames, flag, frames_of, joints_of, scopes
from mbdlft.robot.urdf import Element, child_numbers, content_numbers, name_of, others

_USED = {
    "model": ("frame", "pose", "static", "include"),
    "link": ("inertial", "pose", "gravity", "kinematic", "must_be_base_link", "sensor"),
    "joint": ("parent", "child", "pose", "axis", "axis2"),
}
_REFUSED = {
    "model": ("include", "experimental:params"),
    "link": ("velocity_decay",),
    "joint": ("screw_thread_pitch", "thread_pitch", "gearbox_ratio"),
}


def read_sdf(top: Element, model: str | None = None) -> robot.Robot:
    """Read a robot from the elements of an SDF file; `model` says which one of several."""
    version = version_of(top)
    chosen, world = chosen_model(top, model)
    frames = frames_of(chosen, version)
    elements = [(scope, link) for scope, owner in scopes(chosen) for link in owner.named("link")]
    _refuse(chosen)
    links = robot.unique("link", [_link(scope, element, frames) for scope, element in elements])
    if not links:
        raise SceneError(f"line {chosen.line}: model {name_of(chosen)!r} has no links.")
    closed = joints_of(chosen, frames, links, version)
    joints = closed.tree
    static = flag(chosen, "static")
    bases = _bases(links, joints, frames, static)
    if static:
        joints = {name: joint._replace(kind="fixed") for name, joint in joints.items()}
    places, sensors = _sensors(elements, frames)
    for link, joint in (*places, *closed.sides):
        links[link.name], bases[joint.name] = link, joint
    weighed = zip(elements, links.values(), strict=False)
    unweighed = (link.name for (_, element), link in weighed if element.only("inertial") is None)
    assumed = robot.said("links without <inertial> have 1 kg and 1 kg m^2, as SDF says: {}", unweighed)
    if static:
        assumed.append("the model is static: none of its joints moves")
    # the joints with a drive, if others say that they have none: their largest effort is zero
    passive = [joint.name for joint in joints.values() if joint.effort == 0.0]
    driven = tuple(j.name for j in joints.values() if j.kind in AXIAL and j.name not in passive)
    gravity = child_numbers(world, "gravity", "world", 3)
    return robot.Robot(
        name=name_of(chosen),
        links=links,
        joints={**bases, **joints},
        loads=_weightless(elements, links),
        sensors=sensors,
        loops=closed.loops,
        gravity=robot.three(np.array(gravity)) if gravity else None,
        inputs=driven if passive and driven else None,
        others=others(chosen, _USED),
        assumed=tuple(assumed),
    )


def version_of(top: Element) -> tuple[int, int]:
    """Major and minor version."""
    text = top.attributes.get("version", "")
    major, dot, minor = text.partition(".")
    if not (dot and major.isdigit() and minor.isdigit() and int(major) == 1):
        raise SceneError(f"line {top.line}: <sdf>, version: expected 1.3 to 1.12, got {text!r}.")
    return int(major), int(minor)


def chosen_model(top: Element, name: str | None) -> tuple[Element, Element | None]:
    """The model with a name, or the only one, and the world in which it stands."""
    places: list[tuple[Element, Element | None]] = [(model, None) for model in top.named("model")]
    places += [(model, world) for world in top.named("world") for model in world.named("model")]
    names = [name_of(model) for model, _ in places]
    if not places:
        raise SceneError(f"line {top.line}: the file has no <model>.")
    if name is None:
        moving = [k for k, (model, _) in enumerate(places) if model.named("joint")]
        if len(places) > 1 and len(moving) != 1:
            raise SceneError(
                f"line {top.line}: the file has {len(places)} models: {', '.join(names)}. Choose one: "
                "model='...', on the command line --model."
            )
        return places[moving[0] if len(places) > 1 else 0]
    check_known("model", [name], names, "model")
    return places[names.index(name)]


def _refuse(model: Element) -> None:
    """Raise a SceneError for an element that changes the motion in a way that a scene does not have."""
    for _, owner in scopes(model):
        for link in owner.named("link"):
            if flag(link, "kinematic"):
                raise SceneError(f"line {link.line}: {link.called()}: <kinematic> is not read.")
        for element in (owner, *owner.named("link"), *owner.named("joint")):
            for child in element.children:
                if child.tag in _REFUSED[element.tag] and _acts(child):
                    raise SceneError(
                        f"line {child.line}: {element.called()}: <{child.tag}> is not read: it is not a "
                        "part of a scene. Take it out of the file"
                        + (", or put what it includes there." if child.tag == "include" else ".")
                    )


def _acts(element: Element) -> bool:
    """Whether an element has an effect: one whose numbers are all zero has none."""
    try:
        return any(content_numbers(child, "", 1)[0] for child in element.children) or not element.children
    except SceneError:
        return True


def _link(scope: str, element: Element, frames: Frames) -> robot.RobotLink:
    name = f"{scope}{name_of(element)}"
    where = f"inertial of link {name!r}"
    inertial = element.only("inertial")
    ones = {"xx": 1.0, "yy": 1.0, "zz": 1.0, "xy": 0.0, "xz": 0.0, "yz": 0.0}
    if inertial is None:
        return robot.RobotLink(name, element.line, inertial=True, mass=1.0, inertia=ones)
    if inertial.attributes.get("auto", "false") in ("true", "1"):
        raise SceneError(
            f"line {inertial.line}: {where}: auto = 'true' asks for the mass of its shapes, which are "
            "not read. Write <mass> and <inertia>."
        )
    if inertial.only("fluid_added_mass"):
        raise SceneError(f"line {inertial.line}: {where}: <fluid_added_mass> is not read.")
    mass, inertia = inertial.only("mass"), inertial.only("inertia")
    pose = frames.own(inertial, where)
    entries = dict(ones)
    for child in inertia.children if inertia else ():
        if child.tag.removeprefix("i") in entries:
            (entries[child.tag.removeprefix("i")],) = content_numbers(child, where, 1)
    return robot.RobotLink(
        name=name,
        line=element.line,
        inertial=True,
        mass=content_numbers(mass, where, 1)[0] if mass else 1.0,
        center=robot.three(pose.p),
        rpy=robot.angles_of(pose.R),
        inertia=entries,
    )


def _sensors(
    elements: Sequence[tuple[str, Element]], frames: Frames
) -> tuple[list[robot.Side], tuple[robot.RobotSensor, ...]]:
    """An accelerometer and a gyro for each sensor of the type imu, each on a link of its own."""
    places: list[robot.Side] = []
    sensors: list[robot.RobotSensor] = []
    taken: list[str] = []
    for scope, element in elements:
        for sensor in element.named("sensor"):
            if sensor.attributes.get("type") != "imu":
                continue
            name = robot.unused(scope + name_of(sensor), taken)
            taken.append(name)
            at = frames.own(sensor, f"sensor {name!r}")
            link, parent = f"{name}_site", scope + name_of(element)
            places.append(robot.welded(link, f"weld_{link}", parent, at.p, at.R, sensor.line))
            sensors.append(robot.RobotSensor(f"{name}_acceleration", "accelerometer", link))
            sensors.append(robot.RobotSensor(f"{name}_rate", "gyro", link))
    return places, tuple(sensors)


def _bases(
    links: dict[str, robot.RobotLink],
    joints: dict[str, robot.RobotJoint],
    frames: Frames,
    static: bool,  # noqa: FBT001
) -> dict[str, robot.RobotJoint]:
    """Joints from the ground to links that no joint carries: free ones, unless the model is static."""
    carried = {joint.child for joint in joints.values()}
    roots = [name for name in links if name not in carried]
    bases: dict[str, robot.RobotJoint] = {}
    for root in roots:
        name = robot.unused("root_joint" if len(roots) == 1 else f"root_joint_{root}", {*joints, *bases})
        at, kind = frames.in_world(root), "fixed" if static else "floating"
        bases[name] = robot.RobotJoint(
            name, 0, kind, robot.WORLD, root, robot.three(at.p), robot.angles_of(at.R)
        )
    return bases


def _weightless(
    elements: list[tuple[str, Element]], links: dict[str, robot.RobotLink]
) -> tuple[robot.RobotLoad, ...]:
    """Loads that hold the links on which gravity does not act."""
    names = (f"{scope}{name_of(e)}" for scope, e in elements if not flag(e, "gravity", default=True))
    return tuple(
        robot.RobotLoad(f"{name}_weightless", "buoyancy", name, displaced=links[name].mass)
        for name in names
        if links[name].mass
    )
