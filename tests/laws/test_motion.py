"""Motions of any size: what stays constant does, small ones are those of the linear model."""

from pathlib import Path
from typing import Any

import casadi as ca
import control
import numpy as np
import pytest

import mbdlft
from mbdlft import AnalysisError, Inertia, RigidBody, Scene, SceneError
from mbdlft.dae import Simulation, simulate
from mbdlft.multibody import Gear, Ground
from mbdlft.multibody.motion.equations import _whole, equations_of_motion, moved_reference
from tests import kit
from tests.close import CLOSED_FORM, KEPT, PINOCCHIO, target
from tests.cross.planar_mechanisms import driven_four_bar
from tests.robot_files import as_urdf, chain

ROOT = Path(__file__).parents[2]
TIMES = np.linspace(0.0, 10.0, 101)
DOWN = (0.0, 0.0, -9.81)
J = np.array([2.0, 3.0, 4.5])


def column(run: Simulation, name: str) -> np.ndarray:
    return run.states[:, run.state_names.index(name)]


def vectors(run: Simulation, name: str) -> np.ndarray:
    return np.column_stack([column(run, f"{name}.{axis}") for axis in "xyz"])


def turned(q: np.ndarray, v: np.ndarray) -> np.ndarray:
    """v (3,) of the body in the axes of the scene, for the rotation vector q = 2 tan(angle/2) axis."""
    return v + (np.cross(q, v) + 0.5 * np.cross(q, np.cross(q, v))) / (1.0 + q @ q / 4.0)


def kept(values: np.ndarray, size: float) -> None:
    """A quantity (N, ...) stays what it is at first."""
    assert np.max(np.abs(values - values[0])) <= KEPT * size


def test_a_free_body_keeps_its_momentum_and_energy() -> None:
    body = kit.body("b", 2.0, (J[0], J[1], J[2]))
    scene = kit.scene("free", body, kit.free("f", "ground", "b"))
    start = {"f.rate.x": 0.1, "f.rate.y": 0.2, "f.rate.z": 0.05, "f.velocity.x": 0.3}
    run = simulate(scene, TIMES, initial=start)
    rates = vectors(run, "f.rate")
    momenta = [turned(q, J * w) for q, w in zip(vectors(run, "f.rotation"), rates, strict=True)]
    kept(np.array(momenta), 0.7)
    kept(rates**2 @ J, 0.15)
    target(column(run, "f.position.x"), 0.3 * TIMES, 1e-8)


@pytest.mark.parametrize("kind", ["free", "spherical"])
def test_a_spring_of_a_ball_keeps_its_place(kind: str) -> None:
    """About one axis its torque is 2 k tan(angle/2), whose energy is -4 k log cos(angle/2)."""
    body = kit.body("b", 1.0, (J[0], J[1], J[2]))
    springs = (5.0, 0.0, 0.0)
    joint = (
        kit.free("f", "ground", "b", stiffness=(0.0, 0.0, 0.0, *springs))
        if kind == "free"
        else kit.ball("f", "ground", "b", stiffness=springs)
    )
    scene = kit.scene("sprung", body, joint)
    run = simulate(scene, TIMES, initial={"f.rotation.x": 0.8})
    q, w = column(run, "f.rotation.x"), column(run, "f.rate.x")
    assert np.min(q) < -0.79
    kept(0.5 * J[0] * w**2 - 4.0 * 5.0 * np.log(np.cos(np.arctan(0.5 * q))), 2.0)


def test_a_spherical_pendulum_keeps_its_energy_and_its_spin() -> None:
    """It turns by more than half a turn; gravity has no moment about the vertical."""
    arm, mass = np.array([0.1, 0.05, -0.8]), 2.0
    inertia = np.array([0.1, 0.2, 0.15])
    bob = kit.body("b", mass, (0.1, 0.2, 0.15), ports={"top": tuple(-arm)})
    ball = kit.ball("s", "ground", "b.top")
    scene = kit.scene("pendulum", bob, ball, gravity=DOWN)
    model = mbdlft.to_lft(scene, search=0.0)
    held = np.ravel(mbdlft.trim_at(model, {}))  # where it is declared
    push = {signal.name: -x for signal, x in zip(model.trim.signals, held, strict=True)}
    start = {"s.rotation.x": 1.0, "s.rate.y": 1.0, "s.rate.z": 0.3}
    run = simulate(scene, TIMES, initial=start, inputs=push)
    energies, spins = [], []
    for q, w in zip(vectors(run, "s.rotation"), vectors(run, "s.rate"), strict=True):
        r, rate = turned(q, arm), turned(q, np.cross(w, arm))
        energies.append(0.5 * (mass * rate @ rate + inertia @ w**2) + mass * 9.81 * r[2])
        spins.append((mass * np.cross(r, rate) + turned(q, inertia * w))[2])
    kept(np.array(energies), 16.0)
    kept(np.array(spins), 1.0)


def test_springs_have_their_length_in_their_law() -> None:
    """Two hinges and a spring that becomes twice as long, beside gravity."""
    bar = kit.body("a", 1.5, (0.1, 0.1, 0.1), ports={"end": (0, 0, -0.7)})
    bob = kit.point("b", 0.8, ports={"top": (0, 0, 0.5)})
    scene = kit.scene(
        "double",
        Ground(ports={"wall": (0.0, 0.9, -0.4)}),
        bar,
        bob,
        kit.hinge("j", "ground", "a", (1, 0, 0)),
        kit.hinge("k", "a.end", "b.top", (1, 0, 0)),
        kit.spring("s", "b", "ground.wall", stiffness=20.0, rest_length=0.5),
        gravity=DOWN,
    )
    hold = mbdlft.trim_at(mbdlft.to_lft(scene, search=0.0), {})
    push = dict(zip(("j.torque", "k.torque"), -np.ravel(hold), strict=True))
    run = simulate(scene, TIMES, initial={"j.angle": 1.0, "k.rate": 0.5}, inputs=push)
    t1, t2 = column(run, "j.angle"), column(run, "j.angle") + column(run, "k.angle")
    w1, w2 = column(run, "j.rate"), column(run, "j.rate") + column(run, "k.rate")
    y = 0.7 * np.sin(t1) + 0.5 * np.sin(t2)
    z = -0.7 * np.cos(t1) - 0.5 * np.cos(t2)
    dy, dz = 0.7 * w1 * np.cos(t1) + 0.5 * w2 * np.cos(t2), 0.7 * w1 * np.sin(t1) + 0.5 * w2 * np.sin(t2)
    stretched = np.hypot(y - 0.9, z + 0.4) - 0.5
    energy = 0.05 * w1**2 + 0.4 * (dy**2 + dz**2) + 0.8 * 9.81 * z + 10.0 * stretched**2
    kept(energy, 20.0)


def test_a_loop_and_a_gear_stay_closed() -> None:
    """A four-bar with a flywheel behind a gear: its energy by the angles of its bars."""
    crank = {"mass": 1.0, "inertia": Inertia(xx=0.03, yy=0.03, zz=0.03), "center_of_mass": (0, 0, -0.3)}
    scene = kit.scene(
        "four-bar",
        Ground(ports={"other": (0.0, 0.9, 0.2)}),
        RigidBody(name="a", ports={"end": (0, 0, -0.6)}, **crank),
        RigidBody(name="b", ports={"end": (0, 0, -0.8)}, **crank),
        kit.body("c", 2.0, (1, 1, 1), ports={"far": (0, 0.9, 0)}),
        kit.body("w", 1.0, (0.02, 0.02, 0.02)),
        kit.hinge("j", "ground", "a", (1, 0, 0), preload=0.0),
        kit.hinge("k", "ground.other", "b", (1, 0, 0), preload=0.0),
        kit.hinge("m", "a.end", "c", (1, 0, 0), preload=0.0),
        kit.hinge("n", "ground", "w", (1, 0, 0), preload=0.0),
        kit.loop("l", "revolute", "c.far", "b.end", axis=(1, 0, 0)),
        Gear(name="g", joints=("n", "j"), ratio=-5.0),
        gravity=DOWN,
    )
    states = mbdlft.to_lft(scene, search=0.0).states
    start = {states[0].name: {"n": 4.0}.get(states[0].name[0], -0.8)}
    run = simulate(scene, TIMES, initial=start)
    a, b, c = (column(run, f"{name}.angle") for name in "jkm")
    wa, wb, wc = (column(run, f"{name}.rate") for name in "jkm")
    y = 0.6 * np.sin(a) + 0.9 * np.cos(a + c) - 0.9 - 0.8 * np.sin(b)
    z = -0.6 * np.cos(a) + 0.9 * np.sin(a + c) - 0.2 + 0.8 * np.cos(b)
    assert np.max(np.abs([y, z])) <= KEPT
    assert np.max(np.abs(column(run, "n.angle") + 5.0 * a)) <= KEPT
    assert np.max(np.abs(a)) > 0.5
    of_a, of_b = 0.03 + 0.09 + 2.0 * 0.36 + 25.0 * 0.02, 0.03 + 0.09
    kinetic = 0.5 * (of_a * wa**2 + of_b * wb**2 + (wa + wc) ** 2)
    kept(kinetic - 9.81 * ((0.3 + 1.2) * np.cos(a) + 0.3 * np.cos(b)), 18.0)


def test_what_a_moved_base_carries_feels_its_acceleration_as_gravity() -> None:
    """A pendulum below a slide that is moved: its base is where the input says."""
    base, bob = kit.point("a", 0.0), kit.point("b", 1.0, ports={"top": (0, 0, 1)})
    slide = kit.rail("s", "ground", "a", (0, 0, 1), imposed="motion")
    joint = kit.hinge("j", "a", "b.top", (1, 0, 0))
    runs = []
    for lift in (0.0, 3.0):
        scene = kit.scene("lift", base, bob, slide, joint, gravity=(0, 0, lift - 9.81))
        inputs = {"s.position": 2.0 * TIMES, "s.acceleration": lift}
        runs.append(simulate(scene, TIMES, initial={"j.angle": 1.5}, inputs=inputs))
        target(column(runs[-1], "s.position"), 2.0 * TIMES, CLOSED_FORM)
    target(column(runs[1], "j.angle"), column(runs[0], "j.angle"), KEPT)


def test_a_moved_loop_stays_closed_where_its_input_jumps() -> None:
    """The bars of a parallelogram turn alike."""
    scene = driven_four_bar()
    crank = scene.joints[0].model_copy(update={"imposed": "motion"})
    scene = scene.model_copy(update={"joints": (crank, *scene.joints[1:])})
    run = simulate(scene, TIMES, inputs={"jl.angle": np.where(TIMES < 1.0, 0.0, 0.3)})
    size = column(run, "jl.angle")
    assert size[-1] == 0.3
    target(column(run, "jc.angle"), -size, KEPT)
    target(column(run, "jr.angle"), size, KEPT)


def test_whole_rotations_are_those_of_quaternions() -> None:
    random = np.random.default_rng(0)
    reference, q = random.standard_normal(4), random.standard_normal(3)
    reference /= np.linalg.norm(reference)
    w, *v = moved_reference(reference, q)
    whole = ca.evalf(_whole(ca.SX(reference), ca.SX(q))).full()[:, 0]
    target(whole, 2.0 * np.array(v) / w, CLOSED_FORM)


def test_accelerations_of_a_robot_are_those_of_pinocchio(tmp_path: Path) -> None:
    """Anywhere, at any rates and efforts."""
    pin = pytest.importorskip("pinocchio", reason="robots are compared with pinocchio: '.[robots]'")
    text, file = as_urdf(chain(1)), tmp_path / "chain.urdf"
    file.write_text(text, encoding="utf-8")
    scene, _ = mbdlft.load_robot(file, right_angle=0.0)
    m, model = equations_of_motion(scene, {}), pin.buildModelFromXML(text)
    n, random = m.z.numel(), np.random.default_rng(0)
    solve = ca.Function("a", [m.x, m.u, m.z], [m.residual])
    own = [signal.name.partition(".")[0] for signal in m.coordinates[:n]]
    order = [model.joints[model.getJointId(name)].idx_v for name in own]
    damping = np.array([getattr(joint, "damping", 0.0) for joint in scene.joints if joint.name in own])
    neutral = pin.neutral(model)
    still = pin.rnea(model, model.createData(), neutral, np.zeros(n), np.zeros(n))
    for _ in range(3):
        q, v, tau = random.uniform(-2.0, 2.0, (3, n))
        zero = solve(np.concatenate([q, v]), tau, 0.0).full()[:, 0]
        M = np.column_stack(
            [solve(np.concatenate([q, v]), tau, e).full()[:, 0] - zero for e in np.eye(n)]
        )
        full = [np.zeros(n) for _ in range(3)]
        for vector, values in zip(full, (q, v, tau - damping * v), strict=True):
            vector[order] = values
        at = pin.integrate(model, neutral, full[0])
        a = pin.aba(model, model.createData(), at, full[1], full[2] + still)
        target(np.linalg.solve(M, -zero), a[order], PINOCCHIO)


def test_a_controller_closes_the_loop() -> None:
    """An inverted pendulum falls, and stands with a filtered derivative."""
    bob = kit.point("b", 1.0, ports={"foot": (0, 0, -1.0)})
    joint = kit.hinge("j", "ground", "b.foot", (1, 0, 0))
    scene = kit.scene("stand", bob, joint, gravity=DOWN)
    filtered = control.ss([[-50.0]], [[1.0]], [[2500.0]], [[-80.0]])
    law = mbdlft.as_system(filtered, inputs=["j.angle"], outputs=["j.torque"])
    start = {"j.angle": 0.5}
    assert abs(column(simulate(scene, [0.0, 1.0], initial=start), "j.angle")[-1]) > 1.0
    run = simulate(scene, TIMES, initial=start, controller=law)
    assert abs(column(run, "j.angle")[-1]) < 1e-2
    with pytest.raises(SceneError, match=r"controller: unknown output 'j.angel'. Did you mean 'j.angle'"):
        simulate(scene, TIMES, controller=mbdlft.as_system(law, inputs=["j.angel"]))


def test_what_cannot_be_simulated_is_named() -> None:
    ball = kit.ball("s", "ground", "b.top")
    scene = kit.scene("thread", kit.point("b", 1.0, ports={"top": (0, 0, 1)}), ball)
    with pytest.raises(AnalysisError, match="do not determine the accelerations"):
        simulate(scene, TIMES)


def without_damping(scene: Scene) -> Scene:
    def still(part: Any) -> Any:
        return part.model_copy(update={key: 0.0 for key in type(part).model_fields if "damping" in key})

    kinds = ("bodies", "joints", "loads")
    return scene.model_copy(update={kind: tuple(map(still, getattr(scene, kind))) for kind in kinds})


@pytest.mark.parametrize("name", ["half_car", "lander"])
def test_a_scenario_without_damping_keeps_its_energy(name: str) -> None:
    """Of the largest kinetic energy; states begin at random, the potential is a line integral."""
    scene = without_damping(mbdlft.load_scene(ROOT / "scenarios" / f"{name}.toml"))
    m = equations_of_motion(scene, {})
    n = len(m.coordinates) // 2
    q, v, a = m.x[:n], m.x[n:], m.z[:n]
    rest = ca.vertcat(m.z[n:], m.u)
    R = ca.substitute(m.residual[:n], rest, ca.SX.zeros(rest.numel()))
    forces = ca.substitute(R, ca.vertcat(v, a), ca.SX.zeros(2 * n))
    inertia, rates = ca.jacobian(R, a), ca.jacobian(m.rates[:n], v)
    parts = [0.5 * ca.dot(v, inertia @ v), ca.dot(ca.solve(rates.T, forces), q)]
    energies = ca.Function("energies", [m.x, m.references], parts)
    still = np.tile([1.0, 0.0, 0.0, 0.0], len(m.balls))
    random, bodies = np.random.default_rng(0), tuple(f"{body.name}." for body in scene.bodies)
    names = [m.coordinates[k].name for k in m.states]
    start = {key: 0.02 * random.standard_normal() for key in names if not key.startswith(bodies)}
    run = simulate(scene, np.linspace(0.0, 10.0, 41), initial=start)
    nodes, weights = np.polynomial.legendre.leggauss(8)
    nodes, total, largest = (nodes + 1.0) / 2.0, [], 0.0
    for x in run.states:
        kinetic = float(energies(x, still)[0])
        along = [float(energies(np.concatenate([t * x[:n], x[n:]]), still)[1]) / t for t in nodes]
        total.append(kinetic + float(weights @ along) / 2.0)
        largest = max(largest, kinetic)
    kept(np.array(total), largest)
