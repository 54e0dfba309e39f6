"""Linear models of robots at rest by the tools that know their formats: pinocchio, MuJoCo, Drake.

At rest      M qddot + D qdot + K q = effort,      K = d (inverse dynamics) / dq

Nothing of mbdlft is used, but for the positions of the scene, for the names of its inputs, and for what
the report of a file says to be left out: contacts, tendons along paths. Couplings of joints are relations
of the displacements.
"""

import xml.etree.ElementTree as ET
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks.cases.robots import by_pinocchio
from mbdlft import LFTModel
from mbdlft.multibody.scene.scene import Scene

_STEP = 2e-3  # rad or m, of differences of the sixth order
_WEIGHTS = ((1, 45.0 / 60.0), (2, -9.0 / 60.0), (3, 1.0 / 60.0))
_LOOKS = ("visual", "collision", "sensor", "plugin", "contact", "self_collide", "velocity_decay")
_EFFORTS = {"revolute": "torque", "prismatic": "force"}


class Reference(NamedTuple):
    """The linear model at rest: the efforts of its coordinates, by name in the scene, and (n, n)."""

    efforts: tuple[str, ...]
    M: np.ndarray
    K: np.ndarray
    D: np.ndarray


Answer = Reference | str  # or why there is none


def positions_of(scene: Scene) -> dict[str, float]:
    """Positions of the joints that turn or slide, by name."""
    return {joint.name: joint.position for joint in scene.joints if joint.kind in _EFFORTS}


def efforts_of(scene: Scene) -> dict[str, list[str]]:
    """Names of the efforts of all joints that move, by name of the joint."""
    return {
        joint.name: [f"{joint.name}.{freedom.effort.name}" for freedom in joint.freedoms]
        for joint in scene.joints
        if joint.freedoms
    }


def following(rest: Reference, scene: Scene, model: LFTModel) -> Reference:
    """The model of the coordinates that are states, where others follow them by rigid couplings."""
    states = {signal.name for signal in model.states}
    rigid = [coupling for coupling in scene.couplings if coupling.stiffness is None]
    own = {
        f"{j.name}.{f.effort.name}": f"{j.name}.{f.measures[0].name}"
        for j in scene.joints
        for f in j.freedoms
    }
    relations = np.zeros((len(rigid), len(rest.efforts)))
    for row, coupling in zip(relations, rigid, strict=True):
        for term, (joint, freedom) in zip(coupling.terms(), coupling.freedoms(scene.joints), strict=True):
            row[rest.efforts.index(f"{joint.name}.{freedom.effort.name}")] = term.sign * float(
                term.source
            )
    kept = np.array([own[name] in states for name in rest.efforts])
    G = np.eye(len(kept))[:, kept]
    G[~kept] = -np.linalg.solve(relations[:, ~kept], relations[:, kept])
    labels = tuple(name for name, stays in zip(rest.efforts, kept, strict=True) if stays)
    return Reference(labels, *(G.T @ matrix @ G for matrix in (rest.M, rest.K, rest.D)))


def across(vector: np.ndarray) -> np.ndarray:
    """The matrix (3, 3) of the cross product with a vector (3,)."""
    x, y, z = vector
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def by_pinocchio_of(file: Path, scene: Scene) -> Answer:
    """From pinocchio, which reads the URDF file itself."""
    text = file.read_text(encoding="utf-8")
    own = efforts_of(scene)
    try:
        joints = _urdf_joints(text)
    except ET.ParseError as error:
        return f"no XML for others: {error}"
    plain = {name.replace(".", "_"): name for name in joints}
    positions = {plain[name]: value for name, value in positions_of(scene).items()}
    try:
        rest = by_pinocchio(text, positions, free=False)
    except (ValueError, RuntimeError) as error:
        return f"pinocchio: {error}"
    names = [own.get(name.replace(".", "_"), []) for name in rest.coordinates]
    if any(len(efforts) != 1 for efforts in names) or len(names) != len(rest.M):
        return "joints with several coordinates, which pinocchio orders in its own way"
    return Reference(tuple(efforts for (efforts,) in names), rest.M, rest.K, rest.D)


def _urdf_joints(text: str) -> list[str]:
    return [str(joint.get("name")) for joint in ET.fromstring(text).findall("joint")]


# MuJoCo --------------------------------------------------------------------------------------


def by_mujoco_of(file: Path, scene: Scene, start: np.ndarray | None = None) -> Answer:
    """From differences of the sixth order of what MuJoCo needs to hold the robot.

    `start` (nq,) are the coordinates of bodies that are free or on a ball, if not those of the file.
    """
    import mujoco

    if scene.loops:
        return "loops: MuJoCo has springs in them"
    model = mujoco.MjModel.from_xml_path(str(file))
    _only_rigid(model)
    data, n = mujoco.MjData(model), model.nv
    rest = model.qpos0.copy() if start is None else start.copy()
    labels: list[str] = []
    own, at = efforts_of(scene), positions_of(scene)
    for k in range(model.njnt):
        name = (model.joint(k).name or f"joint_{k}").replace(".", "_")
        labels += own[name]
        if name in at:
            address = model.jnt_qposadr[k]
            rest[address] = model.qpos0[address] + at[name]

    def held(q: np.ndarray, v: np.ndarray) -> np.ndarray:
        data.qpos, data.qvel = q, v
        mujoco.mj_forward(model, data)
        return np.array(data.qfrc_bias - data.qfrc_passive - data.qfrc_actuator)

    def moved(direction: np.ndarray, step: float) -> np.ndarray:
        q = rest.copy()
        mujoco.mj_integratePos(model, q, direction, step)
        return q

    still = np.zeros(n)
    K, D = np.zeros((n, n)), np.zeros((n, n))
    for k, direction in enumerate(np.eye(n)):
        for steps, weight in _WEIGHTS:
            h = steps * _STEP
            K[:, k] += weight * (held(moved(direction, h), still) - held(moved(direction, -h), still))
            D[:, k] += weight * (held(rest, h * direction) - held(rest, -h * direction))
    K, D = K / _STEP, D / _STEP
    load = held(rest, still)
    M = np.zeros((n, n))
    mujoco.mj_fullM(model, data, M)
    for k in np.flatnonzero(model.jnt_type == int(mujoco.mjtJoint.mjJNT_FREE)):
        first = int(model.jnt_dofadr[k])
        R = np.zeros(9)
        start = int(model.jnt_qposadr[k])
        mujoco.mju_quat2Mat(R, rest[start + 3 : start + 7])
        R = R.reshape(3, 3)
        # what holds a free body turns with it
        K[first : first + 3, first + 3 : first + 6] += R @ across(R.T @ load[first : first + 3])
    return Reference(tuple(labels), M, K, D)


def _only_rigid(model: Any) -> None:
    """Take out what the report says to be left out of the scene."""
    import mujoco

    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    model.opt.viscosity = model.opt.density = 0.0
    spatial = model.wrap_type[model.tendon_adr] != int(mujoco.mjtWrap.mjWRAP_JOINT)
    model.tendon_stiffness[spatial] = model.tendon_damping[spatial] = model.tendon_armature[:] = 0.0
    model.dof_dampingpoly[:] = 0.0
    model.tendon_dampingpoly[:] = 0.0
    model.actuator_dampingpoly[:] = 0.0
    on_joints = [int(kind) for kind in (mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT)]
    kinds = [int(kind) for kind in (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE)]
    affine = [int(kind) for kind in (mujoco.mjtBias.mjBIAS_NONE, mujoco.mjtBias.mjBIAS_AFFINE)]
    for k in range(model.nactuator):
        on_joint = int(model.actuator_trntype[k]) in on_joints
        if not (on_joint and int(model.jnt_type[model.actuator_trnid[k][0]]) in kinds):
            model.actuator_armature[k] = model.actuator_damping[k] = 0.0
            on_joint = False
        if not on_joint or int(model.actuator_biastype[k]) not in affine:
            model.actuator_biastype[k] = mujoco.mjtBias.mjBIAS_NONE
        model.actuator_gaintype[k] = mujoco.mjtGain.mjGAIN_FIXED
        model.actuator_gainprm[k] = 0.0
        model.actuator_forcelimited[k] = 0
    model.jnt_actfrclimited[:] = 0


# Drake ---------------------------------------------------------------------------------------


def by_drake_of(file: Path, scene: Scene) -> Answer:
    """From the automatic derivatives of Drake's inverse dynamics."""
    try:
        from pydrake.multibody.parsing import Parser
        from pydrake.multibody.plant import MultibodyPlant
    except ImportError:
        return "Drake is not installed"
    if scene.loops:
        return "loops"
    if any(body.kind == "rigid" and body.mass == 0.0 and body.inertia.xx for body in scene.bodies):
        return "a link has an inertia and no mass: Drake leaves it out"
    plant = MultibodyPlant(0.0)
    try:
        parser = Parser(plant)
        parser.AddModelsFromString(_bare(file), "sdf")
        plant.Finalize()
    except (RuntimeError, ValueError) as error:
        return "Drake: " + " ".join(str(error).split())[:200]
    return _drake_rest(plant, scene)


def _bare(file: Path) -> str:
    """The text of an SDF file without shapes and what else says nothing about the motion."""
    tree = ET.parse(file)
    for owner in [*tree.iter("link"), *tree.iter("model"), *tree.iter("joint")]:
        for child in list(owner):
            if child.tag in _LOOKS:
                owner.remove(child)
    return ET.tostring(tree.getroot(), encoding="unicode")


def _drake_rest(plant: Any, scene: Scene) -> Answer:
    """The linear model of a plant at rest; free bodies in their own axes."""
    from pydrake.autodiffutils import AutoDiffXd, ExtractGradient, ExtractValue, InitializeAutoDiff
    from pydrake.multibody.tree import MultibodyForces_

    own, at = efforts_of(scene), positions_of(scene)
    model = plant.GetModelInstanceByName(scene.name)
    values = plant.CreateDefaultContext()
    q = plant.GetPositions(values)
    rows: list[int] = []
    labels: list[str] = []
    free: list[tuple[int, Any]] = []
    for index in plant.GetJointIndices(model):
        joint = plant.get_joint(index)
        first, count = joint.velocity_start(), joint.num_velocities()
        if count == 6:
            child = joint.child_body().name().replace(".", "_")
            label = "root_joint" if "root_joint" in own else f"root_joint_{child}"
            free.append((first, joint.child_body()))
            labels += own[label][3:] + own[label][:3]
        elif count:
            name = joint.name().replace(".", "_")
            if len(own.get(name, [])) != count:
                return f"joint {joint.name()!r}: Drake has {count} coordinates"
            labels += own[name]
            if count == 1:
                q[joint.position_start()] = at[name]
        rows += range(first, first + count)
    n = plant.num_velocities()
    plant.SetPositions(values, q)
    plant_ad = plant.ToAutoDiffXd()
    context = plant_ad.CreateDefaultContext()
    N = np.column_stack([plant.MapVelocityToQDot(values, e) for e in np.eye(n)])
    seeds = np.hstack([N, np.zeros((len(q), n))])
    plant_ad.SetPositions(context, InitializeAutoDiff(q, gradient=seeds).ravel())
    still = InitializeAutoDiff(np.zeros(n), gradient=np.hstack([np.zeros((n, n)), np.eye(n)])).ravel()
    plant_ad.SetVelocities(context, still)
    forces = MultibodyForces_[AutoDiffXd](plant_ad)
    plant_ad.CalcForceElementsContribution(context, forces)
    held = plant_ad.CalcInverseDynamics(context, np.zeros(n), forces)
    both, load = (ExtractGradient(held.reshape(-1, 1)), ExtractValue(held.reshape(-1, 1)).ravel())
    K, D = both[:, :n], both[:, n:]
    M = plant.CalcMassMatrix(values)
    T = np.eye(n)
    for first, body in free:
        R = plant.EvalBodyPoseInWorld(values, body).rotation().matrix()
        turn, shift = slice(first, first + 3), slice(first + 3, first + 6)
        T[turn, turn] = R
        K[turn, turn] += R @ across(R.T @ load[turn]) @ R.T
        K[shift, turn] += R @ across(R.T @ load[shift]) @ R.T
    M, K, D = (T.T @ matrix @ T for matrix in (M, K, D))
    return Reference(tuple(labels), *(matrix[np.ix_(rows, rows)] for matrix in (M, K, D)))


REFERENCES: Mapping[str, Callable[[Path, Scene], Answer]] = {
    "URDF": by_pinocchio_of,
    "MJCF": by_mujoco_of,
    "SDF": by_drake_of,
}
