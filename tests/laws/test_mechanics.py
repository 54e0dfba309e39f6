"""Laws of mechanics that every model of a scene obeys."""

from functools import cache

import casadi as ca
import numpy as np
import pytest

import mbdlft
from mbdlft.base.parameter import Parameter
from mbdlft.problem.equations import equation_function, load_value, physical_symbols
from mbdlft.problem.trim import trim_efforts
from tests import close

MASSES = (
    Parameter("m", 3.0, percent=30, unit="kg"),
    Parameter("L", 0.8, low=0.6, high=1.1, unit="m"),
    mbdlft.Angle("theta", 25.0, low=-30.0, high=70.0, unit="deg"),
)
POINTS = mbdlft.random(MASSES, 6, 1)
XYZ = ("x", "y", "z")
INERTIA = mbdlft.Inertia(xx=0.3, yy=0.4, zz=0.5, xy=0.05, xz=-0.02, yz=0.03)
KAPPA = 1e3  # condition of the mass matrices below, at most


def body(name: str, mass: float | str = "m", **ports: object) -> mbdlft.RigidBody:
    return mbdlft.RigidBody(
        name=name,
        mass=mass,
        center_of_mass=(0.1, "-0.3*L", 0.2),
        inertia=INERTIA,
        ports={"tip": (0.2, "-L", 0.1), **ports},
    )


def at_points(scene: mbdlft.Scene) -> tuple[mbdlft.LFTModel, tuple[np.ndarray, ...]]:
    """A model, and A, B, C, D at random points and at all corners."""
    model = mbdlft.to_lft(scene, search=0.0)
    outer = mbdlft.corners(MASSES)
    points = {p.name: np.concatenate([POINTS[p.name], outer[p.name]]) for p in MASSES}
    return model, mbdlft.matrices_at(model, points)


def picked(
    matrix: np.ndarray, signals: tuple[mbdlft.Signal, ...], *names: str, axis: int = 1
) -> np.ndarray:
    """Rows (axis 1) or columns (axis 2) of the named signals, at all points."""
    index = [signal.name for signal in signals]
    return np.take(matrix, [index.index(name) for name in names], axis=axis)


# conservative scenes -------------------------------------------------------------------------


def conservative(*, damping: float = 0.0, pull: str = "ground") -> mbdlft.Scene:
    """Revolute and prismatic joints, springs, gravity, buoyancy, and a pull of the scene."""
    return mbdlft.Scene(
        name="conservative",
        gravity=(1.0, -2.0, -9.0),
        parameters=MASSES,
        bodies=(body("a"), body("b", 2.0), body("c", "0.5*m"), body("d", 1.5)),
        joints=(
            mbdlft.Revolute(
                name="ja", parent="ground", child="a", axis=(1, 2, 0), position="theta"
            ),
            mbdlft.Prismatic(
                name="jb", parent="a.tip", child="b", axis=(0, 1, 3), stiffness=40, position=0.2
            ),
            mbdlft.Revolute(
                name="jc", parent="b.tip", child="c", axis=(0, 0, 1), position="-theta",
                damping=damping, preload=2.0,
            ),
            mbdlft.Revolute(name="jd", parent="a", child="d.tip", axis=(1, 0, 1), stiffness=3),
        ),
        loads=(
            mbdlft.Force(
                name="pull", port="c.tip", direction=(1, 1, -1), frame=pull, magnitude=7.0
            ),
            mbdlft.Buoyancy(name="float", port="d", displaced_mass="0.4*m"),
            mbdlft.Torque(name="balance", port="c", direction=(0.1, 0.2, 1)),
        ),
        sensors=(mbdlft.Accelerometer(name="felt", port="c.tip"),),
        inputs=("ja.torque", "jb.force", "jc.torque", "jd.torque"),
    )  # fmt: skip


def mass_and_stiffness(scene: mbdlft.Scene) -> tuple[np.ndarray, np.ndarray]:
    """M and K (N, n, n) with M qddot + K q = efforts, for the joints in the order of the states."""
    model, (A, B, _, _) = at_points(scene)
    n = len(model.states) // 2
    joints = [signal.name.partition(".")[0] for signal in model.states[:n]]
    efforts = [signal.name.partition(".")[0] for signal in model.inputs]
    M = np.linalg.inv(B[:, n:, [efforts.index(joint) for joint in joints]])
    return M, -M @ A[:, n:, :n]


def is_symmetric(matrix: np.ndarray) -> None:
    close.roundoff(matrix, np.swapaxes(matrix, 1, 2), KAPPA)


def without_balance(scene: mbdlft.Scene) -> mbdlft.Scene:
    """A torque of the body has no potential; the joint's own effort has one."""
    joints = tuple(joint.model_copy(update={"preload": None}) for joint in scene.joints)
    return scene.model_copy(update={"loads": scene.loads[:2], "joints": joints})


def test_mass_is_symmetric_positive_definite_and_stiffness_symmetric() -> None:
    M, K = mass_and_stiffness(without_balance(conservative()))
    is_symmetric(M)
    is_symmetric(K)
    assert np.min(np.linalg.eigvalsh(M)) > 0
    assert np.max(np.abs(K)) > 1.0


@pytest.mark.parametrize("scene", [conservative(), without_balance(conservative(pull="body"))])
def test_a_follower_has_no_potential(scene: mbdlft.Scene) -> None:
    with pytest.raises(AssertionError):
        is_symmetric(mass_and_stiffness(scene)[1])


def odd_part(scene: mbdlft.Scene) -> float:
    """Largest odd coefficient of det(s I - A): zero where the eigenvalues come in +- pairs."""
    _, (A, *_) = at_points(scene)
    size = np.linalg.norm(A, 2, axis=(1, 2))
    return max(float(np.max(np.abs(np.poly(a / s)[1::2]))) for a, s in zip(A, size, strict=True))


def test_eigenvalues_without_damping_come_in_pairs() -> None:
    close.roundoff(odd_part(conservative()), 0.0, KAPPA)
    close.roundoff(odd_part(conservative(pull="body")), 0.0, KAPPA)


def test_damping_breaks_the_pairs() -> None:
    with pytest.raises(AssertionError):
        close.roundoff(odd_part(conservative(damping=0.5)), 0.0, KAPPA)


# momentum ------------------------------------------------------------------------------------


def floating() -> mbdlft.Scene:
    """A free base with an arm, a slide and a ball; no gravity, so rest needs no loads."""
    measures = (mbdlft.Momentum(name="momentum"), mbdlft.CenterOfMass(name="center"))
    return mbdlft.Scene(
        name="floating",
        parameters=MASSES,
        bodies=(body("base"), body("arm", 2.0), body("mass", "0.5*m"), body("hand", 1.5)),
        joints=(
            mbdlft.Free(
                name="j0", parent="ground", child="base.tip", position=(1, "L", 0.5),
                orientation=(mbdlft.Rotation(axis=(1, 1, 0), angle="theta"),),
            ),
            mbdlft.Revolute(
                name="j1", parent="base", child="arm", axis=(1, 2, 0), position="theta",
                preload=0, stiffness=5, damping=1, actuator_inertia=0.2,
            ),
            mbdlft.Prismatic(
                name="j2", parent="arm.tip", child="mass", axis=(0, 1, 3), preload=0,
                stiffness=40, damping=2, actuator_inertia=0.3,
            ),
            mbdlft.Spherical(
                name="j3", parent="base.tip", child="hand", preload=(0, 0, 0),
                stiffness=(1, 2, 3), actuator_inertia=(0.1, 0.2, 0.1),
            ),
        ),
        loads=(
            mbdlft.Force(name="fx", port="hand.tip", direction=(1, 0, 0), frame="ground", magnitude=0),
            mbdlft.Force(name="fb", port="mass", direction=(1, 2, 2), magnitude=0),
            mbdlft.Torque(name="tz", port="arm", direction=(0, 0, 1), frame="ground", magnitude=0),
        ),
        sensors=(
            *measures,
            mbdlft.JointWrench(name="held", joint="j0"),
            mbdlft.Velocity(name="hand_moves", port="hand.tip"),
        ),
        inputs=("j1.torque", "j2.force", "j3.torque.x", "fx.force", "fb.force", "tz.torque"),
    )  # fmt: skip


@cache
def floating_at_points():
    return at_points(floating())


MOMENTUM = tuple(f"momentum.{part}.{axis}" for part in ("linear", "angular") for axis in XYZ)


def momentum_changes() -> tuple[mbdlft.LFTModel, np.ndarray]:
    """d/dt of [linear, angular] momentum (N, 6, states + inputs)."""
    model, (A, B, C, _) = floating_at_points()
    momentum = picked(C, model.outputs, *MOMENTUM)
    return model, momentum @ np.concatenate([A, B], axis=2)


def test_internal_forces_do_not_change_momentum() -> None:
    model, change = momentum_changes()
    signals = (*model.states, *model.inputs)
    inner = [s.name for s in signals if s.name not in ("fx.force", "fb.force", "tz.torque")]
    found = picked(change, signals, *inner, axis=2)
    close.roundoff(found, np.zeros_like(found), KAPPA, scale=40.0)  # the stiffest spring


def test_external_forces_change_momentum_by_themselves() -> None:
    model, change = momentum_changes()
    inputs = change[:, :, len(model.states) :]
    pull, thrust, torque = (
        picked(inputs, model.inputs, name, axis=2)[:, :, 0]
        for name in ("fx.force", "fb.force", "tz.torque")
    )
    east, up = np.eye(3)[0], np.eye(3)[2]
    close.roundoff(pull[:, :3], np.broadcast_to(east, (len(pull), 3)), KAPPA)
    close.roundoff(pull[:, 3], np.zeros(len(pull)), KAPPA)  # r x east has no eastern part
    close.roundoff(torque, np.tile(np.concatenate([np.zeros(3), up]), (len(torque), 1)), KAPPA)
    close.roundoff(np.linalg.norm(thrust[:, :3], axis=1), np.ones(len(thrust)), KAPPA)
    # a force has no torque along itself, whatever its arm is
    along = np.einsum("ni,ni->n", thrust[:, :3], thrust[:, 3:])
    close.roundoff(along, np.zeros(len(thrust)), KAPPA)


def test_center_of_mass_moves_as_momentum_over_mass() -> None:
    model, (A, _, C, _) = floating_at_points()
    center = picked(C, model.outputs, *(f"center.{axis}" for axis in XYZ))
    momentum = picked(C, model.outputs, *MOMENTUM[:3])
    m = np.concatenate([POINTS["m"], mbdlft.corners(MASSES)["m"]])
    close.roundoff(center @ A, momentum / (1.5 * m + 3.5)[:, None, None], KAPPA)


def test_wrench_of_the_joint_of_a_free_body_is_zero() -> None:
    """What nothing holds feels nothing: a free joint has no constraint and no effort."""
    model, (_, _, C, D) = floating_at_points()
    names = [f"held.{part}.{axis}" for part in ("force", "torque") for axis in XYZ]
    for matrix in (C, D):
        held = picked(matrix, model.outputs, *names)
        close.roundoff(held, np.zeros_like(held), KAPPA, scale=40.0)


# at rest -------------------------------------------------------------------------------------


def specific_force(scene: mbdlft.Scene) -> np.ndarray:
    """What accelerometers would read at rest at nominal, from the nonlinear equations."""
    equations = mbdlft.assemble(scene)
    nominal = np.array([[p.nominal for p in equations.parameters]])
    efforts, _ = trim_efforts(equations, nominal)
    symbols, p, cosine, sine = physical_symbols(equations.parameters)
    none = [ca.SX(s.numel(), 1) for s in (equations.xdot, equations.x, equations.z)]
    load = load_value(equations, p)
    _, output = equation_function(equations)(*none, ca.DM(efforts[0]), load, p, cosine, sine)
    values = ca.Function("rest", [symbols], [ca.densify(output)])(nominal[0]).full()[:, 0]
    return picked(values[None, :, None], equations.y_signals, *(f"felt.{a}" for a in XYZ))[0, :, 0]


def test_accelerometer_at_rest_reads_minus_gravity() -> None:
    """In the axes of its body: turned by theta about (1, 2, 0), and back about z."""
    scene = conservative()
    gravity, felt = np.array(scene.gravity), specific_force(scene)
    theta = np.deg2rad(25.0)
    first = turn(np.array([1.0, 2.0, 0.0]) / np.sqrt(5.0), theta)
    second = turn(np.array([0.0, 0.0, 1.0]), -theta)
    close.roundoff(felt, -(first @ second).T @ gravity, KAPPA)


def turn(axis: np.ndarray, angle: float) -> np.ndarray:
    """Rotation about a unit axis."""
    skew = np.cross(np.eye(3), axis)
    return np.eye(3) + np.sin(angle) * skew + (1.0 - np.cos(angle)) * skew @ skew
