"""Where the bodies of a scene are: homogeneous transforms from the ground, for every kind of joint.

Only the description of the scene is read. Rotations of balls are three turns in a row about x, y and z,
which differ from a small rotation vector at second order only: what is conjugate to a torque is
taken care of by `Ball`. A sensor of the wrench of a joint cuts it: six virtual coordinates, always zero,
between the joint and its child's port.
"""

from typing import NamedTuple

import casadi as ca
import numpy as np

import mbdlft
from benchmarks.cases.lagrangian import rotation, translation
from mbdlft.base.expression import evaluate, parse
from mbdlft.base.unit import parse_unit
from mbdlft.multibody.joint import Joint


class Ball(NamedTuple):
    """Three coordinates, from `first` on, whose efforts are a torque: omega = W(q) qdot."""

    first: int
    W: ca.SX


class Actuator(NamedTuple):
    """Inertia of an actuator: of a hinge by its frame and axis, otherwise of a coordinate.

    The rotor of a hinge turns `more` times as far as the child, beyond it.
    """

    inertia: ca.SX
    frame: ca.SX | None
    axis: np.ndarray | None
    coordinate: int
    more: ca.SX | float = 0.0


class Frames:
    """The bodies at the coordinates q of all joints, in the order of the scene, then virtual ones.

    Attributes
    ----------
    q, v : SX symbols (n,)
    placed : frame (4, 4) of each body by name
    first : position of the first coordinate of each joint
    cuts : position of the first virtual coordinate of each joint that is cut
    """

    def __init__(self, scene: mbdlft.Scene, p: dict[str, ca.SX]) -> None:
        self.values = _values(scene, p)
        self.bodies = {body.name: body for body in scene.bodies}
        self.first: dict[str, int] = {}
        count = 0
        for joint in scene.joints:
            self.first[joint.name], count = count, count + len(joint.freedoms)
        self.count = count
        wanted = {getattr(sensor, "joint", None) for sensor in scene.sensors} & set(self.first)
        self.cuts = {name: count + 6 * k for k, name in enumerate(sorted(wanted))}
        self.q = ca.SX.sym("q", count + 6 * len(wanted))
        self.v = ca.SX.sym("v", self.q.numel())
        self.placed: dict[str, ca.SX] = {"ground": ca.SX.eye(4)}
        self.balls: list[Ball] = []
        self.actuators: list[Actuator] = []
        waiting = list(scene.joints)
        while waiting:
            ready = [joint for joint in waiting if joint.parent.partition(".")[0] in self.placed]
            assert ready, "the joints are not a tree"
            for joint in ready:
                self._place(joint)
            waiting = [joint for joint in waiting if joint not in ready]

    def value(self, source: float | str) -> ca.SX:
        return ca.SX(evaluate(parse(source), self.values))

    def vector(self, sources: tuple[float | str, ...]) -> ca.SX:
        return ca.vertcat(*(self.value(source) for source in sources))

    def port(self, text: str) -> tuple[ca.SX, ca.SX]:
        """Frame (4, 4) of the body of a port, and the position (3,) of the port in the scene."""
        name, _, port = text.partition(".")
        frame = self.placed[name]
        return frame, (frame @ ca.vertcat(self.local(name, port), 1.0))[:3]

    def local(self, body: str, port: str) -> ca.SX:
        """Position (3,) of a port in the frame of its body."""
        if port in ("", "origin"):
            return ca.SX.zeros(3)
        if port == "center_of_mass":
            return self.vector(self.bodies[body].center_of_mass)
        return self.vector(self.bodies[body].ports[port])

    def rate(self, value: ca.SX) -> ca.SX:
        """Time derivative of a function of q."""
        return ca.reshape(ca.jtimes(ca.vec(value), self.q, self.v), value.shape)

    def turning(self, frame: ca.SX) -> ca.SX:
        """Angular velocity (3,) relative to the scene, in the frame."""
        spin = frame[:3, :3].T @ self.rate(frame[:3, :3])
        return ca.vertcat(spin[2, 1], spin[0, 2], spin[1, 0])

    def _place(self, joint: Joint) -> None:
        parent, _, at = joint.parent.partition(".")
        child, _, to = joint.child.partition(".")
        frame = self.placed[parent] @ translation(self.local(parent, at))
        frame = self._across(joint, frame)
        if joint.name in self.cuts:
            cut = self.q[self.cuts[joint.name] :][:6]
            frame = frame @ translation(cut[:3]) @ _three_turns(cut[3:])
        self.placed[child] = frame @ translation(-self.local(child, to))

    def _across(self, joint: Joint, frame: ca.SX) -> ca.SX:
        """The frame after the joint, from that before it."""
        turned = ca.SX.eye(4)
        for turn in joint.orientation:
            turned = turned @ rotation(_unit(turn.axis), self.value(turn.angle))
        k, kind = self.first[joint.name], joint.kind
        if kind == "free":
            place = self.vector(joint.position) + self.q[k : k + 3]
            return self._ball(frame @ translation(place) @ turned, k + 3, (0.0, 0.0, 0.0))
        frame = frame @ turned
        if kind == "fixed":
            return frame @ rotation(_unit(joint.axis), self.value(joint.position))
        inertia = joint.actuator_inertia
        if kind == "spherical":
            return self._ball(frame, k, inertia)
        if kind == "revolute":
            self.actuators.append(Actuator(self.value(joint.reflected_inertia), None, None, k))
            more = self.value(joint.gear_ratio) - 1.0
            return self._hinge(frame, k, joint.axis, joint.position, inertia, more)
        if kind == "prismatic":
            return self._slide(frame, k, joint.axis, joint.position, inertia)
        if kind == "universal":
            for i, axis in enumerate((joint.axis1, joint.axis2)):
                frame = self._hinge(frame, k + i, axis, joint.position[i], inertia[i])
            return frame
        if kind == "cylindrical":
            frame = self._slide(frame, k, joint.axis, joint.position[0], inertia[0])
            return self._hinge(frame, k + 1, joint.axis, joint.position[1], inertia[1])
        assert kind == "planar", kind
        for i, axis in enumerate(_plane(_unit(joint.axis))):
            frame = self._slide(frame, k + i, axis, joint.position[i], inertia[i])
        return self._hinge(frame, k + 2, joint.axis, joint.position[2], inertia[2])

    def _hinge(self, frame: ca.SX, k: int, axis, position, inertia, more=0.0) -> ca.SX:
        frame = frame @ rotation(_unit(axis), self.value(position) + self.q[k])
        self.actuators.append(Actuator(self.value(inertia), frame, _unit(axis), k, more))
        return frame

    def _slide(self, frame: ca.SX, k: int, axis, position, inertia) -> ca.SX:
        self.actuators.append(Actuator(self.value(inertia), None, None, k))
        return frame @ translation(ca.SX(_unit(axis)) * (self.value(position) + self.q[k]))

    def _ball(self, frame: ca.SX, k: int, inertia) -> ca.SX:
        turned = _three_turns(self.q[k : k + 3])
        self.balls.append(Ball(k, ca.jacobian(self.turning(turned), self.v[k : k + 3])))
        for i in range(3):
            self.actuators.append(Actuator(self.value(inertia[i]), None, None, k + i))
        return frame @ turned


def _values(scene: mbdlft.Scene, p: dict[str, ca.SX]) -> dict[str, float | ca.SX]:
    values: dict[str, float | ca.SX] = {"pi": np.pi, "deg": np.pi / 180.0}
    for name, constant in scene.constants.items():
        number, unit = (
            (constant.value, constant.unit) if isinstance(constant, mbdlft.Constant) else (constant, "1")
        )
        values[name] = number * parse_unit(unit).factor
    for parameter in scene.parameters:
        values[parameter.name] = p[parameter.name] * parse_unit(parameter.unit).factor
    return values


def _unit(axis) -> np.ndarray:
    return np.array(axis, dtype=float) / np.linalg.norm(axis)


def _plane(normal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """x and y of a plane: the next two axes, or the nearest projection of an axis comes first."""
    if np.count_nonzero(normal) == 1:
        x = np.roll(np.abs(normal), 1)
    else:
        projected = np.eye(3) - np.outer(normal, normal)
        x = _unit(projected[np.argmax(np.linalg.norm(projected, axis=1))])
    return x, np.cross(normal, x)


def _three_turns(q: ca.SX) -> ca.SX:
    x, y, z = np.eye(3)
    return rotation(x, q[0]) @ rotation(y, q[1]) @ rotation(z, q[2])
