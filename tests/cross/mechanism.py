"""The linear model of a scene with loads, spin, loops and sensors: Lagrange's equations with constraints.

    L(q, v) = sum 1/2 m |rdot + W x r|^2 + 1/2 omega.J omega - V,      omega = omega_rel + R'W
    d/dt dL/dv - dL/dq + dF/dv = Q(q) u + phi_q' lambda,       phi(q) = 0

W is the spin of the scene, F the dissipation; springs have the potential of their true length, loads
their virtual power, closures the true positions and directions. All coordinates of the tree stay;
redundant constraints too, as the motion is solved for by least squares. Nothing of the package
is used but the description of the scene.
"""

from dataclasses import dataclass
from typing import NamedTuple

import casadi as ca
import numpy as np

import mbdlft
from benchmarks.cases.lagrangian import rotation
from mbdlft.multibody.loop import Loop
from mbdlft.multibody.sensor import Sensor
from tests.cross.frames import Frames

AXES = "xyz"


class Measure(NamedTuple):
    """Expression of q, v, a and the acceleration of the ground; a cut reads its own equations."""

    names: tuple[str, ...]
    expression: ca.SX | None
    cut: int = 0


class Input(NamedTuple):
    """One entry of u: its name, and its value at equilibrium (None: unknown)."""

    name: str
    given: ca.SX | None


class Linear(NamedTuple):
    """The model at one point: [A B ; C D], the sizes of its terms, trim unknowns by name."""

    matrix: np.ndarray
    terms: np.ndarray
    trim: dict[str, float]


@dataclass(frozen=True)
class Mechanism:
    """Equations of one scene: `start` at rest without unknowns, `slopes` at the trim.

    `moved` has the inputs of coordinates whose displacement and rate are inputs, by their position.
    `turning` has the rates (n,) at equilibrium: joints may turn steadily.
    """

    scene: mbdlft.Scene
    inputs: tuple[Input, ...]
    states: tuple[str, ...]
    imposed: tuple[int, ...]
    moved: dict[int, tuple[str, str]]
    moving: int
    measures: tuple[Measure, ...]
    start: ca.Function
    slopes: ca.Function
    turning: ca.Function


def mechanism(scene: mbdlft.Scene) -> Mechanism:
    """The equations of a scene as functions of the physical values of its parameters."""
    p = {parameter.name: ca.SX.sym(parameter.name) for parameter in scene.parameters}
    f = Frames(scene, p)
    n = f.q.numel()
    a, ground = ca.SX.sym("a", n), ca.SX.sym("ground", 3)
    spin = ca.SX.zeros(3)
    if scene.spin:
        spin = ca.SX(np.array(scene.spin.axis) / np.linalg.norm(scene.spin.axis))
        spin = spin * f.value(scene.spin.rate)
    unknown = [entry == "unknown" for entry in scene.acceleration]
    given = (0.0 if hidden else a for a, hidden in zip(scene.acceleration, unknown, strict=True))
    load = f.vector(scene.gravity) - f.vector(tuple(given)) - ground

    inputs, efforts, imposed = _joint_inputs(scene, f)
    power, potential, dissipated, loads = _loads(scene, f)
    symbols = ca.vertcat(efforts, *(symbol for _, symbol in loads), ground)
    inputs += [entry for entry, _ in loads]
    driven = {
        f.first[joint.name] + k: tuple(f"{joint.name}.{m.name}" for m in freedom.measures[:2])
        for joint in scene.joints
        for k, freedom in enumerate(joint.freedoms)
        if getattr(joint, "imposed", False) == "motion"
    }
    inputs += [
        Input(f"ground.acceleration.{axis}", None if hidden else ca.SX(0))
        for axis, hidden in zip(AXES, unknown, strict=True)
    ]

    lagrangian = _bodies(scene, f, spin, load) - potential
    momentum = ca.gradient(lagrangian, f.v)
    e = ca.jtimes(momentum, f.v, a) + ca.jtimes(momentum, f.q, f.v) - ca.gradient(lagrangian, f.q)
    e += ca.gradient(dissipated, f.v) - ca.gradient(power, f.v) - _effort_forces(scene, f, efforts)
    phi = ca.vertcat(*(_closure(loop, f) for loop in scene.loops), ca.SX(0, 1))
    multipliers = ca.SX.sym("lambda", phi.numel())
    e -= ca.jtimes(phi, f.q, multipliers, True)

    measures = _joint_measures(scene, f, a)
    measures += [_sensor(sensor, f, a, spin, load) for sensor in scene.sensors]
    y = ca.vertcat(*(m.expression for m in measures if m.expression is not None))
    moved = ca.vertcat(f.q, f.v, a)
    given = ca.vertcat(*(0.0 if entry.given is None else entry.given for entry in inputs))
    at = ca.vertcat(*p.values(), ca.SX(0, 1))
    around = [moved, symbols, multipliers, at]
    rest = ca.jacobian(e, ca.vertcat(symbols, multipliers))
    start = ca.Function("start", around, [ca.densify(part) for part in (e, rest, given, phi)])
    jacobians = (
        ca.jacobian(e, moved),
        ca.jacobian(e, symbols),
        ca.jacobian(phi, f.q),
        ca.jacobian(y, moved),
        ca.jacobian(y, symbols),
    )
    slopes = ca.Function("slopes", around, [ca.densify(part) for part in jacobians])
    names = [
        [f"{joint.name}.{freedom.measures[order].name}" for freedom in joint.freedoms]
        for order in range(2)
        for joint in scene.joints
    ]
    states = tuple(name for part in names for name in part)
    turning = ca.SX.zeros(n)
    for joint in scene.joints:
        if getattr(joint, "rate", None) is not None:
            turning[f.first[joint.name]] = f.value(joint.rate)
    return Mechanism(
        scene,
        tuple(inputs),
        states,
        imposed,
        driven,
        f.count,
        tuple(measures),
        start,
        slopes,
        ca.Function("turning", [at], [turning]),
    )


def linear_at(m: Mechanism, model: mbdlft.LFTModel, point: dict[str, float]) -> Linear:
    """The linear model with the signals of `model`, at physical values by name.

    Constraint rows may be redundant: accelerations, motions and trim efforts do not depend on it.
    """
    at = np.array([point[p.name] for p in m.scene.parameters])
    n, nu = m.start.size1_out(0), len(m.inputs)
    none = np.zeros(3 * n)
    none[n : 2 * n] = m.turning(at).full().ravel()
    count = m.start.size1_out(3)
    e0, by_load, given, gap = (part.full() for part in m.start(none, np.zeros(nu), np.zeros(count), at))
    given = given[:, 0]
    assert np.max(np.abs(gap), initial=0.0) < _GAP, "the closures are open"
    # efforts of imposed coordinates and of cuts are what it takes
    free = [k for k in range(m.moving) if k not in m.imposed]
    held = np.eye(n)[:, [k for k in range(n) if k not in free]]
    unknown = [k for k, entry in enumerate(m.inputs) if entry.given is None]
    columns = np.hstack([by_load[:, unknown], by_load[:, nu:], held])
    offset = e0[:, 0] + by_load[:, :nu] @ given
    solved = _solved(columns, -offset)
    left = offset + columns @ solved
    assert np.max(np.abs(left)) <= _GAP * max(1.0, np.max(np.abs(offset))), "no equilibrium"
    u = given.copy()
    u[unknown] = solved[: len(unknown)]
    multipliers = solved[len(unknown) : len(unknown) + count]

    by_moved, by_u, G, y_moved, y_u = (part.full() for part in m.slopes(none, u, multipliers, at))
    K, D, M = (by_moved[:, k * n : (k + 1) * n] for k in range(3))
    known = m.imposed
    # unknown: accelerations, efforts of the held ones, multipliers
    size = n + held.shape[1] + count
    matrix, right = np.zeros((size, size)), np.zeros((size, 2 * n + nu))
    matrix[:n] = np.hstack([M, -held, -G.T])
    right[:n] = -np.hstack([K, D, by_u])
    right[:n, 2 * n + np.array(known, dtype=int)] = 0.0
    still = [k for k in range(n) if k not in free]
    for row, k in enumerate(still):
        matrix[n + row, k] = 1.0
        if k in known:
            right[n + row, 2 * n + k] = 1.0
    matrix[n + len(still) :, :n] = G
    answer = _solved(matrix, right)
    assert np.max(np.abs(matrix @ answer - right)) <= _GAP * max(1.0, np.max(np.abs(right)))
    outputs, sizes = _outputs(m, model, answer, y_moved, y_u)

    # motions that the closures leave, by the states of the model and the displacements that are inputs
    motions = _kernel(np.vstack([G, np.eye(n)[m.moving :]]))
    names = [signal.name for signal in model.states]
    rows = [m.states.index(name) for name in names]
    half = len(rows) // 2
    motions = motions @ np.linalg.inv(motions[[*rows[:half], *m.moved]])
    motions, followed = motions[:, :half], motions[:, half:]
    nz = 2 * half
    listed = [entry.name for entry in m.inputs]
    listed += [name for names in m.moved.values() for name in names]
    lift = np.zeros((2 * n + nu, nz + len(listed)))
    lift[:n, :half], lift[n : 2 * n, half:nz] = motions, motions
    lift[2 * n :, nz : nz + nu] = np.eye(nu)
    for k, names in enumerate(m.moved.values()):
        for order, name in enumerate(names):
            lift[order * n : (order + 1) * n, nz + listed.index(name)] = followed[:, k]
    picked = [*range(nz), *(nz + listed.index(signal.name) for signal in model.inputs)]
    turning = np.hstack([np.zeros((half, half)), np.eye(half), np.zeros((half, len(listed)))])
    moved = np.vstack([answer[rows[:half]], outputs])
    sizes = np.vstack([np.abs(answer[rows[:half]]), sizes])
    return Linear(
        np.vstack([turning, moved @ lift])[:, picked],
        np.vstack([turning, sizes @ np.abs(lift)])[:, picked],
        {listed[k]: u[k] for k in unknown},
    )


_GAP = 1e-9
_RANK = 1e-11


def _solved(matrix: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Least squares; the residual is solved for once more, as sizes of rows differ by many orders."""
    first = np.linalg.lstsq(matrix, right, rcond=_RANK)[0]
    return first + np.linalg.lstsq(matrix, right - matrix @ first, rcond=_RANK)[0]


def _kernel(matrix: np.ndarray) -> np.ndarray:
    _, sizes, rows = np.linalg.svd(matrix)
    rank = int(np.sum(sizes > _RANK * np.max(sizes, initial=1.0)))
    return rows[rank:].T


def _outputs(
    m: Mechanism, model: mbdlft.LFTModel, answer: np.ndarray, y_moved: np.ndarray, y_u: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Rows of the outputs of a model by q, v and u, and the sizes of their terms."""
    n = y_moved.shape[1] // 3
    known = np.eye(2 * n, answer.shape[1])
    plain, sizes = (
        part[:, : 2 * n] @ known + part[:, 2 * n :] @ solved
        for part, solved in ((y_moved, answer[:n]), (np.abs(y_moved), np.abs(answer[:n])))
    )
    plain[:, 2 * n :] += y_u
    found, row = {}, 0
    # the effort that holds the virtual coordinates
    held = [k for k in range(n) if k >= m.moving or k in m.imposed]
    for measure in m.measures:
        if measure.expression is None:
            rows = answer[[n + held.index(measure.cut + k) for k in range(6)]]
            found |= dict(zip(measure.names, zip(rows, np.abs(rows), strict=True), strict=True))
            continue
        part = slice(row, row := row + measure.expression.numel())
        both = zip(plain[part], sizes[part], strict=True)
        found |= dict(zip(measure.names, both, strict=True))
    chosen = [found[signal.name] for signal in model.outputs]
    return np.array([a for a, _ in chosen]), np.array([a for _, a in chosen])


# energies ------------------------------------------------------------------------------------


def _bodies(scene: mbdlft.Scene, f: Frames, spin: ca.SX, load: ca.SX) -> ca.SX:
    """Kinetic energy of bodies and actuators, less the potential of the load."""
    found = ca.SX(0)
    for body in scene.bodies:
        if body.kind == "ground":
            continue
        mass, frame = f.value(body.mass), f.placed[body.name]
        point, center, inertia = _inertia(body, f)
        omega = f.turning(frame) + frame[:3, :3].T @ spin
        at = (frame @ ca.vertcat(point, 1.0))[:3]
        velocity = frame[:3, :3].T @ (f.rate(at) + ca.cross(spin, at))
        swing = ca.cross(omega, center - point)
        found += 0.5 * mass * ca.dot(velocity, velocity) + mass * ca.dot(velocity, swing)
        found += 0.5 * ca.dot(omega, inertia @ omega)
        found += mass * ca.dot(load, (frame @ ca.vertcat(center, 1.0))[:3])
    for actuator in f.actuators:
        speed = f.v[actuator.coordinate]
        if actuator.frame is not None:
            omega = f.turning(actuator.frame) + actuator.frame[:3, :3].T @ spin
            speed = ca.dot(ca.SX(actuator.axis), omega) + actuator.more * speed
        found += 0.5 * actuator.inertia * speed**2
    return found


def _inertia(body, f: Frames) -> tuple[ca.SX, ca.SX, ca.SX]:
    """Point and center of mass (3,) and inertia (3, 3) about the point, in the axes of the body."""
    if body.kind == "point_mass":
        return ca.SX.zeros(3), ca.SX.zeros(3), ca.SX.zeros(3, 3)
    entries = {
        name: f.value(getattr(body.inertia, name) or 0.0) for name in ("xx", "yy", "zz", "xy", "xz", "yz")
    }
    inertia = ca.SX.zeros(3, 3)
    for i, a in enumerate(AXES):
        for j, b in enumerate(AXES):
            inertia[i, j] = entries[min(a, b) + max(a, b)]
    return f.local(body.name, body.inertia.about), f.vector(body.center_of_mass), inertia


def _loads(scene: mbdlft.Scene, f: Frames) -> tuple[ca.SX, ca.SX, ca.SX, list[tuple[Input, ca.SX]]]:
    """Power of the loads, potential and dissipation of springs, and the inputs with their symbols."""
    power, potential, dissipated = ca.SX(0), ca.SX(0), ca.SX(0)
    found = []
    for item in scene.loads:
        size = ca.SX.sym(item.name)
        given = getattr(item, item.magnitude_key)
        value = None if given is None else f.value(given)
        if item.kind == "spring":
            r = f.port(item.child)[1] - f.port(item.parent)[1]
            length = ca.sqrt(ca.dot(r, r))
            relaxed = ca.substitute(length, f.q, ca.SX.zeros(f.q.numel()))
            k = f.value(item.stiffness)
            if item.rest_length is not None:
                value = ca.SX(0)
                potential += 0.5 * k * (length - f.value(item.rest_length)) ** 2
            else:
                potential += 0.5 * k * (length - relaxed) ** 2
            potential += size * relaxed * length
            dissipated += 0.5 * f.value(item.damping) * f.rate(length) ** 2
        elif item.kind == "strut":
            frame, at = f.port(item.parent)
            along = frame[:3, :3] @ ca.SX(np.array(item.direction) / np.linalg.norm(item.direction))
            length = ca.dot(along, f.port(item.child)[1] - at)
            away = length - ca.substitute(length, f.q, ca.SX.zeros(f.q.numel()))
            potential += 0.5 * f.value(item.stiffness) * away**2 - size * away
            dissipated += 0.5 * f.value(item.damping) * f.rate(length) ** 2
        elif item.kind == "buoyancy":
            potential += size * ca.dot(f.vector(scene.gravity), f.port(item.port)[1])
        else:
            frame, at = f.port(item.port)
            direction = ca.SX(np.array(item.direction) / np.linalg.norm(item.direction))
            if item.frame == "body":
                direction = frame[:3, :3] @ direction
            speed = f.rate(at) if item.kind == "force" else frame[:3, :3] @ f.turning(frame)
            power += size * ca.dot(direction, speed)
        found.append((Input(f"{item.name}.{item.signal.name}", value), size))
    return power, potential, dissipated, found


def _joint_inputs(scene: mbdlft.Scene, f: Frames) -> tuple[list[Input], ca.SX, tuple[int, ...]]:
    """Efforts of the joints, their symbols, and positions of the imposed coordinates."""
    inputs, imposed = [], []
    for joint in scene.joints:
        for freedom, preload in zip(joint.freedoms, _entries(joint, "preload"), strict=True):
            name = freedom.effort.name
            if joint.imposed:
                name, preload = freedom.measures[2].name, 0.0
                imposed.append(len(inputs))
            given = None if preload is None else f.value(preload)
            inputs.append(Input(f"{joint.name}.{name}", given))
    return inputs, ca.SX.sym("effort", len(inputs)), tuple(imposed)


def _effort_forces(scene: mbdlft.Scene, f: Frames, efforts: ca.SX) -> ca.SX:
    """Generalized forces (n,) of efforts, springs and dampers of the joints."""
    forces = ca.SX.zeros(f.q.numel())
    row = 0
    for joint in scene.joints:
        stiffness, damping = (_entries(joint, key) for key in ("stiffness", "damping"))
        for k, c in zip(stiffness, damping, strict=True):
            springs = f.value(k or 0.0) * f.q[row] + f.value(c or 0.0) * f.v[row]
            forces[row] = -springs if joint.imposed else efforts[row] - springs
            row += 1
    for ball in f.balls:
        part = slice(ball.first, ball.first + 3)
        forces[part] = ball.W.T @ forces[part]
    return forces


def _entries(joint, key: str) -> tuple[float | str | None, ...]:
    if not joint.freedoms:
        return ()
    given = getattr(joint, key, None)
    if given is None:
        return (None,) * len(joint.freedoms)
    return given if isinstance(given, tuple) else (given,)


def _closure(loop: Loop, f: Frames) -> ca.SX:
    """Gap of the ports, and directions that are no longer parallel, in the turned axes of the parent."""
    (parent, a), (child, b) = f.port(loop.parent), f.port(loop.child)
    tilt = parent
    for turn in loop.orientation:
        tilt = tilt @ rotation(np.array(turn.axis) / np.linalg.norm(turn.axis), f.value(turn.angle))
    turned = tilt[:3, :3].T @ child[:3, :3]
    axis = None if loop.axis is None else np.array(loop.axis) / np.linalg.norm(loop.axis)
    across = None if axis is None else ca.SX(np.linalg.svd(axis[None])[2][1:])
    rows = [b - a]
    if loop.kind in ("prismatic", "cylindrical"):
        rows = [across @ (tilt[:3, :3].T @ (b - a))]
    if loop.kind in ("revolute", "cylindrical"):
        rows.append(across @ turned @ ca.SX(axis))
    elif loop.kind in ("fixed", "prismatic"):
        rows.append(ca.vertcat(turned[2, 1], turned[0, 2], turned[1, 0]))
    elif loop.kind == "universal":
        first, second = (np.array(v) / np.linalg.norm(v) for v in (loop.axis1, loop.axis2))
        rows.append(ca.SX(first[None]) @ turned @ ca.SX(second) - float(first @ second))
    return ca.vertcat(*rows)


# what is measured ----------------------------------------------------------------------------


def _joint_measures(scene: mbdlft.Scene, f: Frames, a: ca.SX) -> list[Measure]:
    found = []
    for joint in scene.joints:
        for k, freedom in enumerate(joint.freedoms, start=f.first[joint.name]):
            names = tuple(f"{joint.name}.{measure.name}" for measure in freedom.measures)
            found.append(Measure(names, ca.vertcat(f.q[k], f.v[k], a[k])))
    return found


def _sensor(sensor: Sensor, f: Frames, a: ca.SX, spin: ca.SX, load: ca.SX) -> Measure:
    names = tuple(f"{sensor.name}.{part.name}" for part in sensor.components)
    kind = sensor.kind
    if kind == "joint_wrench":
        return Measure(names, None, f.cuts[sensor.joint])
    if kind == "momentum":
        return Measure(names, _momentum(f))
    if kind == "center_of_mass":
        masses = [(f.value(b.mass), _center(b, f)) for b in f.bodies.values() if b.kind != "ground"]
        return Measure(names, sum(m * r for m, r in masses) / sum(m for m, _ in masses))
    frame, at = f.port(sensor.port)
    velocity = f.rate(at)
    if kind == "gyro":
        return Measure(names, f.turning(frame) + frame[:3, :3].T @ spin)
    if kind == "accelerometer":
        moved = ca.jtimes(velocity, f.v, a) + f.rate(velocity)
        moved += 2 * ca.cross(spin, velocity) + ca.cross(spin, ca.cross(spin, at))
        return Measure(names, frame[:3, :3].T @ (moved - load))
    # small motions: the velocity with q, v or a in place of v
    turns = kind in ("rotation", "angular_rate", "angular_acceleration")
    speed = frame[:3, :3] @ f.turning(frame) if turns else velocity
    none = ca.SX.zeros(f.q.numel())
    slope = ca.substitute(ca.jacobian(speed, f.v), f.q, none)
    order = {"position": 0, "rotation": 0, "velocity": 1, "angular_rate": 1}.get(kind, 2)
    seen = ca.substitute(f.placed[sensor.frame][:3, :3], f.q, none)
    return Measure(names, seen.T @ (slope @ (f.q, f.v, a)[order]))


def _center(body, f: Frames) -> ca.SX:
    center = f.vector(body.center_of_mass) if body.kind == "rigid" else ca.SX.zeros(3)
    return (f.placed[body.name] @ ca.vertcat(center, 1.0))[:3]


def _momentum(f: Frames) -> ca.SX:
    """Linear and angular momentum relative to the scene, about its origin."""
    linear, angular = ca.SX.zeros(3), ca.SX.zeros(3)
    for body in f.bodies.values():
        if body.kind == "ground":
            continue
        mass, turned = f.value(body.mass), f.placed[body.name][:3, :3]
        point, center, inertia = _inertia(body, f)
        d = center - point
        central = inertia - mass * (ca.dot(d, d) * ca.SX.eye(3) - d @ d.T)
        velocity = mass * f.rate(_center(body, f))
        linear += velocity
        angular += ca.cross(_center(body, f), velocity)
        angular += turned @ (central @ f.turning(f.placed[body.name]))
    for actuator in f.actuators:
        if actuator.frame is not None:  # it turns with the child; the others move relative to the parent
            axis, turned = ca.SX(actuator.axis), actuator.frame[:3, :3]
            speed = ca.dot(axis, f.turning(actuator.frame)) + actuator.more * f.v[actuator.coordinate]
            angular += turned @ (axis * actuator.inertia * speed)
    return ca.vertcat(linear, angular)
