"""Inertial sensors of the links of an SDF model; each stands on a link without mass of its own."""

from collections.abc import Sequence
from typing import NamedTuple

from mbdlft.robot.description import RobotJoint, RobotLink, RobotSensor
from mbdlft.robot.elements import Element, name_of
from mbdlft.robot.sdf_frames import Frames
from mbdlft.robot.tree import unused
from mbdlft.robot.turns import angles_of, three


class Sensed(NamedTuple):
    """Links and joints on which sensors stand, and the sensors."""

    places: tuple[tuple[RobotLink, RobotJoint], ...]
    sensors: tuple[RobotSensor, ...]


def sensors_of(elements: Sequence[tuple[str, Element]], frames: Frames) -> Sensed:
    """An accelerometer and a gyro for each sensor of the type imu."""
    places: list[tuple[RobotLink, RobotJoint]] = []
    sensors: list[RobotSensor] = []
    taken: list[str] = []
    for scope, element in elements:
        for sensor in element.named("sensor"):
            if sensor.attributes.get("type") != "imu":
                continue
            name = unused(scope + name_of(sensor), taken)
            taken.append(name)
            at = frames.own(sensor, f"sensor {name!r}")
            link, parent = f"{name}_site", scope + name_of(element)
            weld = RobotJoint(
                f"weld_{link}", sensor.line, "fixed", parent, link, three(at.p), angles_of(at.R)
            )
            places.append((RobotLink(link, sensor.line, inertial=True), weld))
            sensors.append(RobotSensor(f"{name}_acceleration", "accelerometer", link))
            sensors.append(RobotSensor(f"{name}_rate", "gyro", link))
    return Sensed(tuple(places), tuple(sensors))
