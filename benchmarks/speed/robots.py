"""Robotics tools on a chain of rigid links: pinocchio, MuJoCo and Drake, as their users would have it.

Each builds its model once. A sample sets what varies (masses, centers, inertias, lengths) in place, asks
for the slope of gravity's torques and for the mass matrix; these are solved with for all samples
together, and written into arrays that are there already.
"""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np

from benchmarks.speed.motion import GRAVITY, Link
from benchmarks.speed.systems import System

Array = np.ndarray
Samples = Mapping[str, Array]
Method = Callable[[Samples], Any]
FORWARD, CENTRAL = 1e-8, 1e-5  # steps with the smallest errors of these differences
_TURNED = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])


class Rigid(NamedTuple):
    """All bodies of a link as one: mass (N,), center (N, 3), principal moments (N, 3), offset (N, 3)."""

    mass: Array
    center: Array
    inertia: Array
    offset: Array
    varies: bool
    longer: bool


def rigid(link: Link, count: int) -> Rigid:
    """The sum of the bodies of a link; their centers are on one of its axes."""

    def full(x: Any) -> Array:
        return np.broadcast_to(np.asarray(x, dtype=float), (count,))

    masses = [full(body.mass) for body in link.bodies]
    centers = [np.stack([full(x) for x in body.center], axis=-1) for body in link.bodies]
    mass = sum(masses)
    center = sum(m[:, None] * c for m, c in zip(masses, centers, strict=True)) / mass[:, None]
    inertia = np.zeros((count, 3))
    for body, m, c in zip(link.bodies, masses, centers, strict=True):
        d = c - center
        own = np.stack([full(x) for x in body.inertia], axis=-1)
        inertia = inertia + own + m[:, None] * (np.sum(d * d, axis=1)[:, None] - d * d)
    numbers = [x for body in link.bodies for x in (body.mass, *body.center, *body.inertia)]
    return Rigid(
        mass,
        center,
        inertia,
        np.stack([full(x) for x in link.offset], axis=-1),
        any(np.ndim(x) for x in numbers),
        any(np.ndim(x) for x in link.offset),
    )


class Told(NamedTuple):
    """What a tool is told: angles (N, n), and the links."""

    angles: Array
    links: list[Link]
    rigid: list[Rigid]

    def changes(self) -> tuple[list[int], list[int]]:
        """Links whose inertia and links whose place varies."""
        return (
            [k for k, body in enumerate(self.rigid) if body.varies],
            [k for k, body in enumerate(self.rigid) if body.longer],
        )


def told(system: System, samples: Samples) -> Told:
    """Links at samples."""
    assert system.links is not None
    count = len(next(iter(samples.values())))
    links = system.links(system.in_radians(samples, np.pi / 180.0))
    angles = np.stack([np.broadcast_to(link.angle, (count,)) for link in links], axis=-1)
    return Told(np.ascontiguousarray(angles), links, [rigid(link, count) for link in links])


def nominal(system: System) -> Told:
    """Links at nominal: one sample."""
    return told(system, {p.name: np.array([p.nominal]) for p in system.parameters})


def assembled(links: list[Link], mass: Array, slope: Array) -> Array:
    """[A B ; C D] (N, 3 n, 3 n) of the mass matrix and the slope of gravity's torques (N, n, n)."""
    count, n = mass.shape[:2]
    eye = np.eye(n)
    stiffness = np.diag([link.stiffness for link in links])
    right = np.empty((count, n, 2 * n))
    right[:, :, :n], right[:, :, n:] = -(slope + stiffness), eye
    solved = np.linalg.solve(mass, right)
    values = np.zeros((count, 3 * n, 3 * n))
    values[:, :n, n : 2 * n] = values[:, 2 * n :, :n] = eye
    values[:, n : 2 * n, :n] = solved[:, :, :n]
    values[:, n : 2 * n, 2 * n :] = solved[:, :, n:]
    damping = np.array([link.damping for link in links])
    if np.any(damping):
        values[:, n : 2 * n, n : 2 * n] = -solved[:, :, n:] * damping
    return values


def by_pinocchio(system: System) -> Method:
    """Analytical derivatives of inverse dynamics; they have the mass matrix, too."""
    import pinocchio as pin

    start = nominal(system)
    model = pin.Model()
    model.gravity = pin.Motion(np.array([0.0, 0.0, -GRAVITY, 0.0, 0.0, 0.0]))
    kinds = {"x": pin.JointModelRX, "y": pin.JointModelRY, "z": pin.JointModelRZ}
    for k, (link, body) in enumerate(zip(start.links, start.rigid, strict=True)):
        frame = pin.SE3(_TURNED if link.quarter else np.eye(3), body.offset[0])
        joint = model.addJoint(k, kinds[link.axis](), frame, f"joint{k}")
        inertia = pin.Inertia(body.mass[0], body.center[0], np.diag(body.inertia[0]))
        model.appendBodyToJoint(joint, inertia, pin.SE3.Identity())
    data, zero, n = model.createData(), np.zeros(model.nv), model.nv
    lower = np.tril_indices(n, -1)

    def method(samples: Samples) -> Array:
        now = told(system, samples)
        count = len(now.angles)
        slope, mass = np.empty((count, n, n)), np.empty((count, n, n))
        heavier, longer = now.changes()
        moments = {k: now.rigid[k].inertia[:, :, None] * np.eye(3) for k in heavier}
        given = [(k + 1, now.rigid[k].mass.tolist(), now.rigid[k].center, moments[k]) for k in heavier]
        places = [(k + 1, now.rigid[k].offset) for k in longer]
        Inertia, derivatives = pin.Inertia, pin.computeRNEADerivatives
        inertias, placements, angles = model.inertias, model.jointPlacements, now.angles
        for s in range(count):
            for joint, m, center, moment in given:
                inertias[joint] = Inertia(m[s], center[s], moment[s])
            for joint, offset in places:
                placements[joint].translation = offset[s]
            slope[s], _, mass[s] = derivatives(model, data, angles[s], zero, zero)
        mass[:, lower[0], lower[1]] = mass[:, lower[1], lower[0]]
        return assembled(now.links, mass, slope)

    return method


def _mjcf(start: Told) -> str:
    """The chain in the format of MuJoCo."""
    text = (
        f'<mujoco><compiler angle="radian"/><option gravity="0 0 {-GRAVITY!r}">'
        '<flag contact="disable" constraint="disable"/></option><worldbody>'
    )
    for link, body in zip(start.links, start.rigid, strict=True):
        quat = "0.7071067811865476 0 0.7071067811865476 0" if link.quarter else "1 0 0 0"
        axis = " ".join("1" if name == link.axis else "0" for name in "xyz")
        text += (
            f'<body pos="{_row(body.offset[0])}" quat="{quat}"><joint axis="{axis}"/>'
            f'<inertial pos="{_row(body.center[0])}" mass="{float(body.mass[0])!r}" '
            f'diaginertia="{_row(body.inertia[0])}"/>'
        )
    return text + "</body>" * len(start.links) + "</worldbody></mujoco>"


def _row(vector: Array) -> str:
    return " ".join(repr(float(x)) for x in vector)


def by_mujoco(system: System, *, central: bool = False) -> Method:
    """Differences of inverse dynamics: MuJoCo's own, to one side, or central ones.

    The mass matrix is MuJoCo's, without differences.
    """
    import mujoco

    model = mujoco.MjModel.from_xml_string(_mjcf(nominal(system)))
    data, n = mujoco.MjData(model), model.nv
    M, by_q = np.zeros((n, n)), np.zeros((n, n))

    def forward(_: Array) -> Array:
        mujoco.mjd_inverseFD(model, data, FORWARD, False, by_q, None, None, None, None, None, None)  # noqa: FBT003
        return by_q.T

    def both_sides(rest: Array) -> Array:
        inverse, torque, q = mujoco.mj_inverse, data.qfrc_inverse, data.qpos
        for j in range(n):
            q[j] = rest[j] + CENTRAL
            inverse(model, data)
            by_q[j] = torque
            q[j] = rest[j] - CENTRAL
            inverse(model, data)
            by_q[j] -= torque
            q[j] = rest[j]
        by_q[:] /= 2.0 * CENTRAL
        inverse(model, data)  # the mass matrix is that of the last call
        return by_q.T

    slope_at = both_sides if central else forward

    def method(samples: Samples) -> Array:
        now = told(system, samples)
        count = len(now.angles)
        slope, mass = np.empty((count, n, n)), np.empty((count, n, n))
        heavier, longer = now.changes()
        rows = [(k + 1, now.rigid[k]) for k in heavier]
        places = [(k + 1, now.rigid[k].offset) for k in longer]
        for s in range(count):
            for k, body in rows:
                model.body_mass[k] = body.mass[s]
                model.body_ipos[k] = body.center[s]
                model.body_inertia[k] = body.inertia[s]
            for k, offset in places:
                model.body_pos[k] = offset[s]
            data.qpos[:] = now.angles[s]
            slope[s] = slope_at(now.angles[s])
            mujoco.mj_fullM(model, data, M)
            mass[s] = M
        return assembled(now.links, mass, slope)

    return method


def by_drake(system: System) -> Method:
    """Automatic differentiation of gravity's torques; the mass matrix of the plant of floats."""
    from pydrake.autodiffutils import AutoDiffXd, ExtractGradient, InitializeAutoDiff
    from pydrake.math import RigidTransform, RollPitchYaw
    from pydrake.multibody.plant import MultibodyPlant
    from pydrake.multibody.tree import FixedOffsetFrame, RevoluteJoint, RotationalInertia, SpatialInertia

    start = nominal(system)
    plant = MultibodyPlant(0.0)
    plant.mutable_gravity_field().set_gravity_vector([0.0, 0.0, -GRAVITY])

    def inertia(body: Rigid, s: int) -> Any:
        return SpatialInertia.MakeFromCentralInertia(
            body.mass[s], body.center[s], RotationalInertia(*body.inertia[s])
        )

    def placed(body: Rigid, quarter: bool, s: int) -> Any:  # noqa: FBT001
        return RigidTransform(RollPitchYaw(0.0, np.pi / 2.0 if quarter else 0.0, 0.0), body.offset[s])

    before = plant.world_body()
    for k, (link, body) in enumerate(zip(start.links, start.rigid, strict=True)):
        frame = plant.AddFrame(
            FixedOffsetFrame(f"place{k}", before.body_frame(), placed(body, link.quarter, 0))
        )
        before = plant.AddRigidBody(f"link{k}", inertia(body, 0))
        axis = [float(name == link.axis) for name in "xyz"]
        plant.AddJoint(RevoluteJoint(f"joint{k}", frame, before.body_frame(), axis))
    plant.Finalize()
    n = plant.num_positions()
    smooth = plant.ToAutoDiffXd()
    contexts = (plant.CreateDefaultContext(), smooth.CreateDefaultContext())
    identity = np.eye(n)

    def method(samples: Samples) -> Array:
        now = told(system, samples)
        count = len(now.angles)
        slope, mass = np.empty((count, n, n)), np.empty((count, n, n))
        heavier, longer = now.changes()
        bodies = [
            (now.rigid[k], *(p.GetBodyByName(f"link{k}") for p in (plant, smooth))) for k in heavier
        ]
        places = [(k, *(p.GetFrameByName(f"place{k}") for p in (plant, smooth))) for k in longer]
        for s in range(count):
            for body, plain, wide in bodies:
                plain.SetSpatialInertiaInBodyFrame(contexts[0], inertia(body, s))
                # gravity's torques do not depend on moments of inertia
                wide.SetMass(contexts[1], body.mass[s])
                wide.SetCenterOfMassInBodyFrame(contexts[1], body.center[s])
            for k, plain, wide in places:
                pose = placed(now.rigid[k], now.links[k].quarter, s)
                plain.SetPoseInParentFrame(contexts[0], pose)
                wide.SetPoseInParentFrame(contexts[1], pose.cast[AutoDiffXd]())
            q = now.angles[s]
            plant.SetPositions(contexts[0], q)
            mass[s] = plant.CalcMassMatrix(contexts[0])
            smooth.SetPositions(contexts[1], InitializeAutoDiff(q, identity).ravel())
            torques = smooth.CalcGravityGeneralizedForces(contexts[1])
            slope[s] = -ExtractGradient(torques.reshape(n, 1))
        return assembled(now.links, mass, slope)

    return method
