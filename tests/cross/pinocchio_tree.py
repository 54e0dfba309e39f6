"""The tree of a scene in pinocchio, at one value of its parameters.

Only the description of the scene is read. Every joint becomes joints of pinocchio, one for each of its
coordinates (a ball: one of three), at the configuration of the equilibrium; fixed joints are placements.
"""

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import pinocchio as pin

import mbdlft
from mbdlft.base.expression import evaluate, parse
from mbdlft.base.unit import parse_unit
from mbdlft.multibody.joint import Joint


class Place(NamedTuple):
    """A frame held by a joint of pinocchio."""

    joint: int
    frame: pin.SE3

    def then(self, frame: pin.SE3) -> "Place":
        return Place(self.joint, self.frame * frame)


@dataclass
class Tree:
    """The tree of pinocchio in the making; coordinates by joint of the scene."""

    values: dict[str, float]
    bodies: dict[str, object]
    model: pin.Model = field(default_factory=pin.Model)
    q: list[float] = field(default_factory=list)
    place: dict[str, Place] = field(default_factory=lambda: {"ground": Place(0, pin.SE3.Identity())})
    coordinates: dict[str, list[int]] = field(default_factory=dict)

    def value(self, source: float | str) -> float:
        return float(evaluate(parse(source), self.values))

    def vector(self, sources: tuple[float | str, ...]) -> np.ndarray:
        return np.array([self.value(source) for source in sources])

    def port(self, name: str) -> tuple[str, np.ndarray]:
        """Name of the body of a port, and the position of the port in the frame of the body."""
        body, _, port = name.partition(".")
        described = self.bodies.get(body)
        if port in ("", "origin"):
            return body, np.zeros(3)
        if port == "center_of_mass":
            return body, self.vector(described.center_of_mass)
        return body, self.vector(described.ports[port])

    def at_port(self, name: str) -> Place:
        body, position = self.port(name)
        return self.place[body].then(pin.SE3(np.eye(3), position))

    # joints ----------------------------------------------------------------------------------

    def turn(self, place: Place, axis: np.ndarray, angle: float) -> Place:
        """One rotation."""
        joint = self._add(place, pin.JointModelRevoluteUnaligned(axis), [angle])
        return Place(joint, pin.SE3.Identity())

    def slide(self, place: Place, axis: np.ndarray, position: float) -> Place:
        """One translation."""
        joint = self._add(place, pin.JointModelPrismaticUnaligned(axis), [position])
        return Place(joint, pin.SE3.Identity())

    def ball(self, place: Place) -> Place:
        """Three rotations."""
        joint = self._add(place, pin.JointModelSpherical(), [0.0, 0.0, 0.0, 1.0])
        return Place(joint, pin.SE3.Identity())

    def _add(self, place: Place, kind: object, q: list[float]) -> int:
        self.q += q
        name = f"joint {self.model.njoints}"
        return self.model.addJoint(place.joint, kind, place.frame, name)

    def join(self, joint: Joint) -> None:
        first = self.model.nv
        place = self._moved(joint, self.at_port(joint.parent))
        self.coordinates[joint.name] = list(range(first, self.model.nv))
        child, position = self.port(joint.child)
        self.place[child] = place.then(pin.SE3(np.eye(3), -position))
        at = self.place[child]
        self.model.appendBodyToJoint(at.joint, self.inertia(self.bodies[child]), at.frame)

    def _moved(self, joint: Joint, place: Place) -> Place:
        """The frame of the child's port, from that of the parent's."""
        tilt = np.eye(3)
        for rotation in joint.orientation:
            tilt = tilt @ rotation_about(unit_vector(rotation.axis), self.value(rotation.angle))
        tilted = pin.SE3(tilt, np.zeros(3))
        if joint.kind == "free":
            for axis, position in zip(np.eye(3), self.vector(joint.position), strict=True):
                place = self.slide(place, axis, position)
            return self.ball(place.then(tilted))
        place = place.then(tilted)
        if joint.kind == "fixed":
            turn = rotation_about(unit_vector(joint.axis), self.value(joint.position))
            return place.then(pin.SE3(turn, np.zeros(3)))
        if joint.kind == "spherical":
            return self.ball(place)
        position = self.each(joint.position)
        axes, turns = coordinate_axes(joint)
        for axis, turning, at in zip(axes, turns, position, strict=True):
            place = (self.turn if turning else self.slide)(place, axis, at)
        return place

    def each(self, given: float | str | tuple[float | str, ...]) -> np.ndarray:
        return self.vector(given if isinstance(given, tuple) else (given,))

    def inertia(self, body: object) -> pin.Inertia:
        """Mass, center and inertia about the center, moved there from the point where it is given."""
        mass = self.value(body.mass)
        if body.kind == "point_mass":
            return pin.Inertia(mass, np.zeros(3), np.zeros((3, 3)))
        _, center = self.port(f"{body.name}.center_of_mass")
        _, point = self.port(f"{body.name}.{body.inertia.about}")
        matrix = np.zeros((3, 3))
        for i, a in enumerate("xyz"):
            for j, b in enumerate("xyz"):
                matrix[i, j] = self.value(getattr(body.inertia, min(a, b) + max(a, b)) or 0.0)
        d = pin.skew(center - point)
        return pin.Inertia(mass, center, matrix + mass * d @ d)


def coordinate_axes(joint: Joint) -> tuple[list[np.ndarray], list[bool]]:
    """Unit vectors of the coordinates of a joint with axes, and which of them are rotations."""
    if joint.kind == "universal":
        return [unit_vector(joint.axis1), unit_vector(joint.axis2)], [True, True]
    axis = unit_vector(joint.axis)
    if joint.kind == "revolute":
        return [axis], [True]
    if joint.kind == "prismatic":
        return [axis], [False]
    if joint.kind == "cylindrical":
        return [axis, axis], [False, True]
    x = np.roll(np.abs(axis), 1)  # for a normal along x, y or z: y, z or x
    if np.count_nonzero(axis) > 1:
        x = np.zeros(3)
        x[np.argmin(np.abs(axis))] = 1.0
        x = unit_vector(x - np.dot(x, axis) * axis)
    return [x, np.cross(axis, x), axis], [False, False, True]


def rotation_about(axis: np.ndarray, angle: float) -> np.ndarray:
    return pin.exp3(axis * angle)


def unit_vector(direction: tuple[float, ...]) -> np.ndarray:
    return np.array(direction) / np.linalg.norm(direction)


def plant(scene: mbdlft.Scene, point: dict[str, float]) -> Tree:
    """All joints and bodies, from the ground outward."""
    values = {"pi": np.pi, "deg": np.pi / 180.0}
    for name, constant in scene.constants.items():
        plain = isinstance(constant, float)
        values[name] = constant if plain else constant.value * parse_unit(constant.unit).factor
    for p in scene.parameters:
        values[p.name] = float(point[p.name]) * parse_unit(p.unit).factor
    tree = Tree(values, {body.name: body for body in scene.bodies})
    # pinocchio wants depth first: everything that a joint carries stands right behind it
    pending = ["ground"]
    while pending:
        body = pending.pop()
        for joint in (j for j in scene.joints if j.child.partition(".")[0] == body):
            tree.join(joint)
        pending += [
            joint.child.partition(".")[0]
            for joint in scene.joints
            if joint.parent.partition(".")[0] == body
        ]
    assert len(tree.place) == len({*tree.bodies, "ground"}), "the joints are not a tree"
    return tree
