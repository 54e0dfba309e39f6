"""The linear model of a scene at one value of its parameters, by pinocchio.

M a + K q + D v = efforts - T magnitudes - G (acceleration of the ground),      q, v, a of all joints
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pinocchio as pin

import mbdlft
from mbdlft.multibody.joint import Joint
from tests.cross.pinocchio_tree import Tree, plant, unit_vector

_TURN = ("torque", "angle", "rate", "acceleration")
_TURN_OF_SEVERAL = ("torque", "angle", "rate", "angular_acceleration")
_SLIDE = ("force", "position", "velocity", "acceleration")
_BALL = ("torque", "rotation", "rate", "angular_acceleration")


def _with(suffixes: str, names: tuple[str, ...]) -> list[tuple[str, ...]]:
    return [tuple(f"{name}.{suffix}" for name in names) for suffix in suffixes]


# effort, displacement, rate and acceleration of each coordinate, as docs/scenes.md names them
SIGNALS: dict[str, list[tuple[str, ...]]] = {
    "fixed": [],
    "revolute": [_TURN],
    "prismatic": [_SLIDE],
    "cylindrical": [_SLIDE, _TURN_OF_SEVERAL],
    "universal": _with("12", _TURN_OF_SEVERAL),
    "planar": [*_with("xy", _SLIDE), _TURN_OF_SEVERAL],
    "spherical": _with("xyz", _BALL),
    "free": [*_with("xyz", _SLIDE), *_with("xyz", _BALL)],
}


class Acting(NamedTuple):
    """A load of magnitude one: its wrench (6,) in the axes of a joint of pinocchio, about its origin."""

    name: str
    given: float | None
    joint: int
    wrench: np.ndarray
    turned: np.ndarray  # (6, 3) derivative by a small rotation of that joint's frame, in its axes


class Row(NamedTuple):
    """y = q_ q + v_ v + a_ a + load_ magnitudes + ground_ (acceleration of the ground)."""

    q_: np.ndarray
    v_: np.ndarray
    a_: np.ndarray
    load_: np.ndarray
    ground_: np.ndarray


@dataclass(frozen=True)
class Linear:
    """The model of a scene at one point; rows and columns by name of the signal.

    `trim` has the values of all unknowns; `unit` is the root of the inertia that each coordinate feels
    by itself, its natural unit.
    """

    value: np.ndarray
    rows: dict[str, int]
    columns: dict[str, int]
    trim: dict[str, float]
    unit: dict[str, float]

    def matrix(self, rows: list[str], columns: list[str]) -> np.ndarray:
        return self.value[[self.rows[name] for name in rows]][:, [self.columns[name] for name in columns]]


def pinocchio_model(scene: mbdlft.Scene, point: dict[str, float]) -> Linear:
    """The model at physical values of all parameters by name, in their units."""
    tree = plant(scene, point)
    gravity = tree.vector(scene.gravity)
    effective = gravity - tree.vector(scene.acceleration)
    model, q = tree.model, np.array(tree.q)
    model.gravity = pin.Motion(np.concatenate([effective, np.zeros(3)]))
    data, zero = model.createData(), np.zeros(model.nv)
    pin.computeJointJacobians(model, data, q)
    pin.updateFramePlacements(model, data)
    acting = [_acting(tree, data, load, gravity) for load in scene.loads]
    jacobians = [_wide(pin.getJointJacobian(model, data, k, pin.LOCAL), 6) for k in range(model.njoints)]
    T = -np.array([jacobians[load.joint].T @ load.wrench for load in acting])
    T = T.reshape(len(acting), model.nv).T
    free = pin.rnea(model, data, q, zero, zero)

    joints = [joint for joint in scene.joints if joint.kind != "fixed"]
    imposed = {k for joint in joints if joint.imposed for k in tree.coordinates[joint.name]}
    trim, magnitudes = _trim(tree, joints, acting, free, T)
    forces = [np.zeros(6) for _ in jacobians]
    for load, magnitude in zip(acting, magnitudes, strict=True):
        forces[load.joint] = forces[load.joint] + magnitude * load.wrench
    listed = pin.StdVec_Force()
    listed.extend([pin.Force(force) for force in forces])
    slopes = pin.computeRNEADerivatives(model, data, q, zero, zero, listed)
    K, D, M = (_wide(matrix, model.nv).copy() for matrix in slopes)
    for load, magnitude in zip(acting, magnitudes, strict=True):
        J = jacobians[load.joint]
        K -= magnitude * J.T @ load.turned @ J[3:]
    G = np.stack([_shaken(model, q, axis) for axis in np.eye(3)], axis=1)
    sensors = _Sensors(tree, data, q, effective, Row(K, D, M, T, G))
    for k, inertia in tree.reflected.items():
        M[k, k] += inertia
    for joint in joints:
        for k, stiffness, damping in zip(
            tree.coordinates[joint.name],
            tree.each(joint.stiffness),
            tree.each(joint.damping),
            strict=True,
        ):
            K[k, k] += stiffness
            D[k, k] += damping
    return _solved(scene, tree, joints, imposed, acting, Row(K, D, M, T, G), sensors, trim)


def _acting(tree: Tree, data: pin.Data, load: object, gravity: np.ndarray) -> Acting:
    """A load of magnitude one, and what a rotation of its joint's frame does to it."""
    place = tree.at_port(load.port)
    across = np.zeros((6, 3))
    if load.kind == "buoyancy":
        direction, frame, key, name = -gravity, "ground", load.displaced_mass, "displaced_mass"
    else:
        direction, frame, key, name = (unit_vector(load.direction), load.frame, load.magnitude, load.kind)
    if frame == "ground":
        direction = data.oMi[place.joint].rotation.T @ direction
        across[:3] = pin.skew(direction)  # R(w)' f = f - w x f = f + f x w
    else:
        direction = place.frame.rotation @ direction
    arm = pin.skew(place.frame.translation)
    wrench = np.concatenate([direction, arm @ direction])
    across[3:] = arm @ across[:3]
    if load.kind == "torque":
        wrench = np.concatenate([np.zeros(3), direction])
        across = np.concatenate([np.zeros((3, 3)), across[:3]])
    given = None if key is None else tree.value(key)
    return Acting(f"{load.name}.{name}", given, place.joint, wrench, across)


def _trim(
    tree: Tree, joints: list[Joint], acting: list[Acting], needed: np.ndarray, T: np.ndarray
) -> tuple[dict[str, float], np.ndarray]:
    """All unknowns by name, and the magnitudes of all loads: needed + T magnitudes = efforts."""
    given, columns, names, rows = needed.copy(), [], [], []
    for joint in joints:
        if joint.imposed:
            continue
        preload = [None] * 6 if joint.preload is None else tree.each(joint.preload)
        for k, signal, value in zip(
            tree.coordinates[joint.name], SIGNALS[joint.kind], preload, strict=False
        ):
            rows.append(k)
            if value is None:
                names.append(f"{joint.name}.{signal[0]}")
                columns.append(-np.eye(len(needed))[k])
            else:
                given[k] -= value
    magnitudes = np.array([0.0 if load.given is None else load.given for load in acting])
    given += T @ magnitudes
    unknown = [k for k, load in enumerate(acting) if load.given is None]
    names += [acting[k].name for k in unknown]
    columns += [T[:, k] for k in unknown]
    matrix = np.array(columns).reshape(len(names), len(needed)).T
    found, *_ = np.linalg.lstsq(matrix[rows], -given[rows], rcond=None)
    missed = matrix[rows] @ found + given[rows]
    assert np.linalg.norm(missed) <= 1e-9 * max(1.0, np.linalg.norm(given)), "no equilibrium"
    magnitudes[unknown] = found[len(found) - len(unknown) :]
    return dict(zip(names, found, strict=True)), magnitudes


def _shaken(model: pin.Model, q: np.ndarray, acceleration: np.ndarray) -> np.ndarray:
    """Efforts (nv,) that an acceleration of the ground asks for."""
    other = model.copy()
    other.gravity = pin.Motion(np.concatenate([-acceleration, np.zeros(3)]))
    zero = np.zeros(model.nv)
    return np.array(pin.rnea(other, other.createData(), q, zero, zero))


def _wide(matrix: np.ndarray, rows: int) -> np.ndarray:
    """A matrix (rows, nv); pinocchio drops the second axis where there is one coordinate."""
    return np.asarray(matrix).reshape(rows, -1)


class _Sensors:
    """Rows of sensors over the coordinates of all joints of pinocchio."""

    def __init__(
        self, tree: Tree, data: pin.Data, q: np.ndarray, effective: np.ndarray, needed: Row
    ) -> None:
        self.tree, self.data, self.q = tree, data, q
        self.effective, self.needed = effective, needed

    def row(self, order: int, matrix: np.ndarray) -> Row:
        """matrix times displacements (0), rates (1) or accelerations (2), and nothing else."""
        rows = len(matrix)
        parts = [np.zeros_like(matrix) for _ in range(3)]
        parts[order] = matrix
        return Row(*parts, np.zeros((rows, self.needed.load_.shape[1])), np.zeros((rows, 3)))

    def port(self, port: str) -> tuple[np.ndarray, np.ndarray]:
        """Rotation to the axes of the ground, and motions (6, nv) [linear, angular] of a port in them."""
        place, model = self.tree.at_port(port), self.tree.model
        rotation = self.data.oMi[place.joint].rotation @ place.frame.rotation
        local = _wide(pin.getJointJacobian(model, self.data, place.joint, pin.LOCAL), 6)
        linear, angular = np.split(place.frame.inverse().action @ local, 2)
        return rotation, np.vstack([rotation @ linear, rotation @ angular])

    def measure(self, sensor: object) -> tuple[list[str], Row]:
        """Names of the components, and their rows."""
        kind, xyz = sensor.kind, ["x", "y", "z"]
        if kind == "joint_wrench":
            cut = self.tree.cuts[sensor.joint]
            row = Row(*(part[cut] for part in self.needed))
            return [f"{part}.{axis}" for part in ("force", "torque") for axis in xyz], row
        if kind == "momentum":
            model, data = self.tree.model, self.tree.model.createData()
            about_center = _wide(pin.computeCentroidalMap(model, data, self.q), 6)
            about_origin = about_center.copy()
            about_origin[3:] += pin.skew(data.com[0]) @ about_center[:3]
            names = [f"{part}.{axis}" for part in ("linear", "angular") for axis in xyz]
            return names, self.row(1, about_origin)
        if kind == "center_of_mass":
            model = self.tree.model
            moved = _wide(pin.jacobianCenterOfMass(model, model.createData(), self.q), 3)
            masses = [inertia.mass for inertia in model.inertias]
            # what is fixed to the ground has a mass and does not move; pinocchio leaves it out
            return xyz, self.row(0, moved * (sum(masses[1:]) / sum(masses)))
        rotation, motion = self.port(sensor.port)
        if kind == "gyro":
            return xyz, self.row(1, rotation.T @ motion[3:])
        if kind == "accelerometer":
            row = self.row(2, rotation.T @ motion[:3])
            # specific force a - g in axes that turn: -(R(w) R)' g = ... - R' (g x w)
            felt = -rotation.T @ pin.skew(self.effective) @ motion[3:]
            return xyz, row._replace(q_=felt, ground_=rotation.T)
        order = {"velocity": 1, "angular_rate": 1, "position": 0, "rotation": 0}.get(kind, 2)
        part = motion[:3] if kind in ("position", "velocity", "acceleration") else motion[3:]
        axes, _ = self.port(sensor.frame)
        return xyz, self.row(order, axes.T @ part)


def _solved(
    scene: mbdlft.Scene,
    tree: Tree,
    joints: list[Joint],
    imposed: set[int],
    acting: list[Acting],
    needed: Row,
    sensors: _Sensors,
    trim: dict[str, float],
) -> Linear:
    """Accelerations solved for, and every signal as a row over [q, v, u]."""
    names = [
        (k, tuple(f"{joint.name}.{name}" for name in signals), k in imposed)
        for joint in joints
        for k, signals in zip(tree.coordinates[joint.name], SIGNALS[joint.kind], strict=True)
    ]
    all_of = [k for k, *_ in names]
    n, loads = len(all_of), len(acting)
    at = {k: position for position, k in enumerate(all_of)}
    eye = np.eye(n)
    # each row of the dynamics; that of an imposed joint is a = u
    M, right = np.zeros((n, n)), np.zeros((n, 3 * n + loads + 3))
    for k, row in at.items():
        if k in imposed:
            M[row, row] = 1.0
        else:
            M[row] = needed.a_[k, all_of]
            right[row, :n], right[row, n : 2 * n] = -needed.q_[k, all_of], -needed.v_[k, all_of]
            right[row, 3 * n : 3 * n + loads] = -needed.load_[k]
            right[row, 3 * n + loads :] = -needed.ground_[k]
        right[row, 2 * n + row] = 1.0
    accelerations = np.linalg.solve(M, right)
    place = np.hstack([eye, np.zeros((n, 2 * n + loads + 3))])
    rate = np.roll(place, n, axis=1)
    rows: dict[str, np.ndarray] = {}
    columns: list[str] = [signals[1] for _, signals, _ in names]
    columns += [signals[2] for _, signals, _ in names]
    columns += [signals[3] if held else signals[0] for _, signals, held in names]
    columns += [load.name for load in acting]
    columns += [f"ground.acceleration.{axis}" for axis in "xyz"]
    for row, (_, signals, _) in enumerate(names):
        for name, part in zip(signals[1:], (place, rate, accelerations), strict=True):
            rows[name] = part[row]
        rows[f"d/dt {signals[1]}"], rows[f"d/dt {signals[2]}"] = rate[row], accelerations[row]
    for sensor in scene.sensors:
        components, seen = sensors.measure(sensor)
        value = seen.q_[:, all_of] @ place + seen.v_[:, all_of] @ rate
        value = value + seen.a_[:, all_of] @ accelerations
        value[:, 3 * n : 3 * n + loads] += seen.load_
        value[:, 3 * n + loads :] += seen.ground_
        rows |= {f"{sensor.name}.{c}": part for c, part in zip(components, value, strict=True)}
    unit = {name: float(np.sqrt(needed.a_[k, k])) for k, signals, _ in names for name in signals}
    return Linear(
        np.array(list(rows.values())),
        {name: k for k, name in enumerate(rows)},
        {name: k for k, name in enumerate(columns)},
        trim,
        unit,
    )
