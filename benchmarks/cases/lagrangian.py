"""The linear model of a scene from its Lagrangian: an independent derivation.

Only the description of the scene is read. Homogeneous 4 x 4 transforms from the ground give every
position and orientation as a function of the displacements q; velocities are derivatives of those.

    T(q, qdot) = sum 1/2 m vP.vP + m vP.(omega x d) + 1/2 omega.J omega, plus the actuators
    V(q)       = - sum m (gravity - acceleration).rC + sum 1/2 k q^2

At rest M qddot + D qdot + K q = u - dV/dq with M = d2T/dqdot2, K = d2V/dq2, D = damping.
"""

from dataclasses import dataclass

import casadi as ca
import numpy as np

import mbdlft
from mbdlft.base.expression import evaluate, parse
from mbdlft.base.unit import parse_unit
from mbdlft.multibody.body import Body
from mbdlft.multibody.joint import Joint

NAMES = {"revolute": ("torque", "angle", "rate"), "prismatic": ("force", "position", "velocity")}


@dataclass(frozen=True)
class Reference:
    """The model at N points of the parameters; joints that move, in the order of the scene.

    `force` and `stiff` bound the terms that are added up in the entries of `effort` and `K`: they
    stay up when the sum cancels, so rounding is measured by them.
    """

    joints: tuple[Joint, ...]
    M: np.ndarray  # (N, n, n)
    D: np.ndarray
    K: np.ndarray
    effort: np.ndarray  # (N, n)
    force: np.ndarray
    stiff: np.ndarray  # (N, n, n)

    def names(self, k: int) -> tuple[str, ...]:
        """Signals of the joints: efforts (0), displacements (1), rates (2)."""
        return tuple(f"{joint.name}.{NAMES[joint.kind][k]}" for joint in self.joints)


def lagrangian(scene: mbdlft.Scene, points: dict[str, np.ndarray]) -> Reference:
    """The reference at physical values of all parameters by name, in their units, arrays (N,)."""
    symbols = {p.name: ca.SX.sym(p.name) for p in scene.parameters}
    values = {"pi": np.pi, "deg": np.pi / 180.0}
    for name, constant in scene.constants.items():
        number, unit = (constant, "1") if isinstance(constant, float) else _plain(constant)
        values[name] = number * parse_unit(unit).factor
    for p in scene.parameters:
        values[p.name] = symbols[p.name] * parse_unit(p.unit).factor

    moving = tuple(joint for joint in scene.joints if joint.kind in NAMES)
    q, qdot = ca.SX.sym("q", len(moving)), ca.SX.sym("qdot", len(moving))
    energy = Energy(scene, values, moving, q, qdot)
    force, K = derivatives(energy.potential, q)
    _, M = derivatives(energy.kinetic, qdot)
    damping = ca.diag(ca.vertcat(*(energy.value(joint.damping) for joint in moving)))
    results = [M, damping, K, force, *energy.sizes()]
    arguments = [q, qdot, ca.vertcat(*symbols.values())]
    function = ca.Function("reference", arguments, [ca.densify(result) for result in results])

    count = max((len(array) for array in points.values()), default=1)
    columns = np.array([points[p.name] for p in scene.parameters]).reshape(-1, count).T
    rest = np.zeros(len(moving))
    at = [[part.full() for part in function(rest, rest, column)] for column in columns]
    found = [np.stack(parts) for parts in zip(*at, strict=True)]
    vectors = (3, 4)
    return Reference(moving, *(a[:, :, 0] if k in vectors else a for k, a in enumerate(found)))


def state_space(reference: Reference, model: mbdlft.LFTModel) -> np.ndarray:
    """[A B ; C D] (N, ., .) with the states, inputs and outputs of a model, matched by name."""
    count, n = reference.M.shape[:2]
    inverse = np.linalg.inv(reference.M)
    eye, zero = np.broadcast_to(np.eye(n), (count, n, n)), np.zeros((count, n, n))
    moved = np.concatenate([-inverse @ reference.K, -inverse @ reference.D, inverse], axis=2)
    place, turn = (np.concatenate(rows, axis=2) for rows in ([eye, zero, zero], [zero, eye, zero]))
    efforts, displacements, rates = (reference.names(k) for k in range(3))
    accelerations = [f"{joint.name}.acceleration" for joint in reference.joints]
    row = dict(zip((*displacements, *rates), np.arange(2 * n), strict=True))
    column = row | dict(zip(efforts, 2 * n + np.arange(n), strict=True))
    states = [signal.name for signal in model.states]
    derivatives = np.concatenate([turn, moved], axis=1)[:, [row[name] for name in states]]
    measured = np.concatenate([place, turn, moved], axis=1)
    row |= dict(zip(accelerations, 2 * n + np.arange(n), strict=True))
    outputs = measured[:, [row[signal.name] for signal in model.outputs]]
    picked = [column[name] for name in (*states, *(signal.name for signal in model.inputs))]
    return np.concatenate([derivatives, outputs], axis=1)[:, :, picked]


class Energy:
    """Kinetic and potential energy as functions of q, qdot and the parameters."""

    def __init__(
        self,
        scene: mbdlft.Scene,
        values: dict[str, float | ca.SX],
        moving: tuple[Joint, ...],
        q: ca.SX,
        qdot: ca.SX,
    ) -> None:
        self.values, self.q, self.qdot = values, q, qdot
        self.index = {joint.name: k for k, joint in enumerate(moving)}
        self.moving = moving
        self.bodies = {body.name: body for body in scene.bodies}
        self.load = self.vector(scene.gravity) - self.vector(scene.acceleration)
        self.kinetic, self.potential = ca.SX(0), ca.SX(0)
        # the mass that each joint carries, and all lengths of the scene
        self.carried = [ca.SX(0) for _ in moving]
        self.length = ca.SX(0)
        self.placed: dict[str, ca.SX] = {"ground": ca.SX.eye(4)}
        self.chain: dict[str, list[int]] = {"ground": []}
        waiting = list(scene.joints)
        while waiting:
            ready = [joint for joint in waiting if joint.parent.partition(".")[0] in self.placed]
            assert ready, "the joints are not a tree"
            for joint in ready:
                self.place(joint)
            waiting = [joint for joint in waiting if joint not in ready]

    def value(self, source: float | str) -> ca.SX:
        return ca.SX(evaluate(parse(source), self.values))

    def vector(self, sources: tuple[float | str, ...]) -> ca.SX:
        return ca.vertcat(*(self.value(source) for source in sources))

    def port(self, body: Body | None, port: str) -> ca.SX:
        """Position of a port in the frame of its body."""
        if port in ("", "origin") or body is None:
            return ca.SX.zeros(3)
        if port == "center_of_mass":
            return self.vector(body.center_of_mass)
        return self.vector(body.ports[port])

    def place(self, joint: Joint) -> None:
        """The frame of the child body, and the energy of the child, the spring and the actuator."""
        parent, _, at = joint.parent.partition(".")
        child, _, to = joint.child.partition(".")
        outboard = self.port(self.bodies.get(parent), at)
        inboard = self.port(self.bodies[child], to)
        axis = np.array(joint.axis) / np.linalg.norm(joint.axis)
        position = self.value(joint.position)
        displacement, k = ca.SX(0), self.index.get(joint.name)
        if k is not None:
            displacement = self.q[k]
            self.potential += 0.5 * self.value(joint.stiffness) * displacement**2
        if joint.kind == "prismatic":
            across = translation(ca.SX(axis) * (position + displacement))
            self.length += ca.fabs(position)
        else:
            across = rotation(axis, position + displacement)
        frame = self.placed[parent] @ translation(outboard) @ across @ translation(-inboard)
        self.placed[child] = frame
        self.chain[child] = self.chain[parent] + ([] if k is None else [k])
        self.length += ca.norm_1(outboard) + ca.norm_1(inboard)
        self.add_body(self.bodies[child], frame)
        if k is not None:
            reflected = self.value(joint.actuator_inertia)
            speed = self.qdot[k]
            if joint.kind == "revolute":
                speed = ca.dot(ca.SX(axis), self.angular_velocity(frame))
            self.kinetic += 0.5 * reflected * speed**2

    def add_body(self, body: Body, frame: ca.SX) -> None:
        """Newton-Euler energies about the point P where the inertia is given; C is P + d."""
        mass = self.value(body.mass)
        center, point, inertia = ca.SX.zeros(3), ca.SX.zeros(3), ca.SX.zeros(3, 3)
        if body.kind == "rigid":
            center = self.vector(body.center_of_mass)
            point = self.port(body, body.inertia.about)
            # entries that are not given are not seen by any motion
            entries = {
                name: self.value(getattr(body.inertia, name) or 0.0)
                for name in ("xx", "yy", "zz", "xy", "xz", "yz")
            }
            for i, a in enumerate("xyz"):
                for j, b in enumerate("xyz"):
                    inertia[i, j] = entries[min(a, b) + max(a, b)]
        omega = self.angular_velocity(frame)
        velocity = frame[:3, :3].T @ self.rate((frame @ ca.vertcat(point, 1.0))[:3])
        swing = ca.cross(omega, center - point)
        self.kinetic += 0.5 * mass * ca.dot(velocity, velocity) + mass * ca.dot(velocity, swing)
        self.kinetic += 0.5 * ca.dot(omega, inertia @ omega)
        self.potential -= mass * ca.dot(self.load, (frame @ ca.vertcat(center, 1.0))[:3])
        self.length += ca.norm_1(center)
        for k in self.chain[body.name]:
            self.carried[k] += mass

    def rate(self, value: ca.SX) -> ca.SX:
        """Time derivative of a function of q."""
        column = ca.jtimes(ca.vec(value), self.q, self.qdot)
        return ca.reshape(column, value.shape)

    def angular_velocity(self, frame: ca.SX) -> ca.SX:
        """Of a frame relative to the ground, in the frame: R'Rdot is its cross product."""
        rotation = frame[:3, :3]
        spin = rotation.T @ self.rate(rotation)
        return 0.5 * ca.vertcat(spin[2, 1] - spin[1, 2], spin[0, 2] - spin[2, 0], spin[1, 0] - spin[0, 1])

    def sizes(self) -> tuple[ca.SX, ca.SX]:
        """Bounds `force` and `stiff` of `Reference`, from the total length."""
        load = ca.norm_2(ca.densify(self.load))
        turns = [joint.kind == "revolute" for joint in self.moving]
        rows = range(len(turns))
        arms = [self.length if turning else 1.0 for turning in turns]
        force = [self.carried[k] * load * arms[k] for k in rows]
        stiff = ca.SX.zeros(len(turns), len(turns))
        for i in rows:
            stiff[i, i] = self.value(self.moving[i].stiffness)
            for j in rows:
                lighter = ca.fmin(self.carried[i], self.carried[j])
                arm = self.length if turns[i] and turns[j] else float(turns[i] or turns[j])
                stiff[i, j] += lighter * load * arm
        return ca.vertcat(*force), stiff


def _plain(constant: mbdlft.Constant) -> tuple[float, str]:
    return constant.value, constant.unit


def derivatives(energy: ca.SX, variables: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Gradient and Hessian."""
    hessian, gradient = ca.hessian(energy, variables)
    return gradient, hessian


def translation(r: ca.SX) -> ca.SX:
    """Transform (4, 4) by a vector."""
    frame = ca.SX.eye(4)
    frame[:3, 3] = r
    return frame


def rotation(axis: np.ndarray, angle: ca.SX) -> ca.SX:
    """Rotation about a unit axis by the quaternion [cos, axis sin] of half the angle."""
    w, v = ca.cos(0.5 * angle), ca.SX(axis) * ca.sin(0.5 * angle)
    frame = ca.SX.eye(4)
    frame[:3, :3] = (w * w - ca.dot(v, v)) * ca.SX.eye(3) + 2 * v @ v.T + 2 * w * ca.skew(v)
    return frame
