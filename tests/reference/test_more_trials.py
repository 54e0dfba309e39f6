"""Scenes of docs/trials.md, second part, against their energies at random values of all parameters."""

import tomllib
from collections.abc import Callable

import casadi as ca
import numpy as np
import pytest

import mbdlft
from tests.close import MECHANISM, target
from tests.reference.lagrange import Energies, about_y, spin, tilted, turned
from tests.reference.test_trials import FIRST, FOLDER, Values

_G = 9.81
FREE = ("position.x", "position.y", "position.z", "rotation.x", "rotation.y", "rotation.z")
X, Y, Z = (1, 0, 0), (0, 1, 0), (0, 0, 1)


def segway(p: Values) -> Energies:
    e = Energies(["roll.position", "lean.angle"], ["roll.force", "lean.torque"], [0, 0], {})
    rider = ca.vertcat(e.q[0], 0) + about_y(e.q[1])(0, p["l"])
    e.point(p["m"], rider, _G)
    e.T += (8 + 0.2 / 0.2**2) * e.v[0] ** 2 / 2 + 0.08 * p["m"] * p["l"] ** 2 * e.v[1] ** 2 / 2
    e.P = e.u[0] * e.v[0] + e.u[1] * e.v[1]
    return e


def ship_crane(p: Values) -> Energies:
    """In (y, z), turned about x: about_y with the other sign."""
    luff = np.deg2rad(p["luff"])
    names = ["roll.angle", "luffing.angle", "sway.angle"]
    e = Energies(names, ["luffing.torque", "wave.torque", ""], [0, luff, -luff], {1: 0})
    roll, boom = about_y(-e.q[0]), about_y(-e.q[0] - e.q[1])
    rope = about_y(-ca.sum1(e.q))
    root = roll(0, 9)
    e.point(9000, root + boom(10, 0), _G)
    e.point(p["m"], root + boom(22, 0) + rope(0, -p["L"]), _G)
    e.T += 6e7 * e.v[0] ** 2 / 2 + 3e5 * (e.v[0] + e.v[1]) ** 2 / 2
    e.V += 3e6 * _G * p["GM"] * e.q[0] ** 2 / 2
    e.R = 1e6 * e.v[0] ** 2 / 2 + 2000 * e.v[2] ** 2 / 2
    e.P = e.u[0] * e.v[1] + (e.u[1] + e.u[2]) * e.v[0]
    return e


def motorcycle(p: Values) -> Energies:
    names = ["body.position.x", "body.position.y", "body.angle"]
    names += ["telescope.position", "swingarm.angle"]
    inputs = ["front_tire.force", "rear_tire.force", "", ""]
    e = Energies(names, inputs, [0.6, 0, 0, -0.6, 0], {})
    up, along, pitch, slide, swing = ca.vertsplit(e.q)
    place, body, arm = ca.vertcat(along, up), about_y(pitch), about_y(pitch + swing)
    front = place + body(0.55, 0.3) + about_y(pitch - np.deg2rad(p["rake"]))(0, slide)
    pivot = place + body(-0.15, -0.2)
    rear = pivot + arm(-0.5, -0.1)
    e.point(p["m"], place, _G)
    e.point(18, front, _G)
    e.point(25, pivot + arm(-0.4, -0.05), _G)
    e.T += (0.2 * p["m"] + 0.6) * e.v[2] ** 2 / 2 + 1.2 * (e.v[2] + e.v[4]) ** 2 / 2
    e.V += p["kf"] * (slide + 0.6) ** 2 / 2 + 4000 * swing**2 / 2
    for k, (wheel, stiffness) in enumerate(((front, 140000), (rear, 150000))):
        e.V += stiffness * (wheel[1] - e.at_rest(wheel[1])) ** 2 / 2  # the height alone
        e.P += e.u[k] * e.rate(wheel[1])
    e.R = 900 * e.v[3] ** 2 / 2 + 250 * e.v[4] ** 2 / 2
    e.P += e.u[2] * e.v[3] + e.u[3] * e.v[4]
    return e


def launcher(p: Values) -> Energies:
    """Seen from the frame that accelerates with it, where all weighs thrust over mass more."""
    names = ["flight.position.y", "flight.position.x", "flight.angle"]
    names += ["gimbal.angle", "swing.angle"]
    e = Energies(names, ["gimbal.torque", "thrust.force"], [0] * 5, {1: p["T"]})
    x, z, pitch, gimbal, swing = ca.vertsplit(e.q)
    place, nozzle = ca.vertcat(x, z), about_y(pitch + gimbal)
    hinge, tank = place + about_y(pitch)(0, -12), place + about_y(pitch)(0, 4)
    weight = p["T"] / (50000 + 800 + p["mp"])
    e.point(50000, place, weight)
    e.point(800, hinge + nozzle(0, -0.9), weight)
    e.point(p["mp"], tank + about_y(pitch + swing)(0, -p["l"]), weight)
    e.T += 4e6 * e.v[2] ** 2 / 2 + 500 * (e.v[2] + e.v[3]) ** 2 / 2
    e.P = e.u[0] * e.v[3] + e.u[1] * ca.dot(nozzle(0, 1), e.rate(hinge))
    return e


def gripper(p: Values) -> Energies:
    """In (x, y), turned about z: about_y with the other sign."""
    names = ["motor.angle", "knuckle.angle", "pivot.angle"]
    e = Energies(names, ["motor.torque", "grip.force"], [0] * 3, {1: 0})
    crank, finger = about_y(-e.q[0]), about_y(-e.q[0] - e.q[1])
    rocker = about_y(-e.q[2])
    drive, pivot = ca.DM([0, 0.02]), ca.DM([0, 0.05])
    knuckle = drive + crank(0.06, 0.02)
    tip = knuckle + finger(0.06, -0.02)
    e.point(0.08, drive + crank(0.03, 0.01))
    e.point(0.1, knuckle + finger(0.02, 0))
    e.point(0.05, pivot + rocker(0.03, 0.015))
    e.T += (3e-5 + p["J"]) * e.v[0] ** 2 / 2 + 5e-5 * (e.v[0] + e.v[1]) ** 2 / 2
    e.T += 2e-5 * e.v[2] ** 2 / 2
    far = ca.norm_2(tip - ca.DM([0.12, 0]))
    e.V = p["k"] * (far - e.at_rest(far)) ** 2 / 2
    e.R = 0.01 * e.v[0] ** 2 / 2 + e.rate(far) ** 2 / 2
    e.P = e.u[0] * e.v[0] + e.u[1] * ca.dot(finger(0, -1), e.rate(tip))
    e.gaps = knuckle + finger(-0.01, 0.04) - pivot - rocker(0.05, 0.03)
    return e


def dual_arm(p: Values) -> Energies:
    s, bend = np.deg2rad(p["s"]), np.deg2rad(p["e"])
    joints = [f"{part}_{side}" for side in ("left", "right") for part in ("shoulder", "elbow")]
    names = [f"orbit.{part}" for part in FREE] + [f"{joint}.angle" for joint in joints]
    rest = [0.0] * 6 + [s, bend, -s, -bend]
    e = Energies(names, [f"{joint}.torque" for joint in joints], rest, {})
    place, R = e.q[:3], tilted(e.q[3:6])
    e.body(800, np.diag([300, 350, 400]), [0, 0, 0], place, R)
    for k, side in enumerate((0.5, -0.5)):
        upper = R @ turned(Z, e.q[6 + 2 * k])
        fore = upper @ turned(Z, e.q[7 + 2 * k])
        shoulder = place + R @ ca.DM([0.6, side, 0])
        elbow = shoulder + upper @ ca.DM([1.4, 0, 0])
        e.body(20, np.diag([0.2, 3, 3]), [0.7, 0, 0], shoulder, upper)
        e.body(12, np.diag([0.1, 2, 2]), [0.6, 0, 0], elbow, fore)
        e.point(p["payload"] * (k == 0), elbow + fore @ ca.DM([1.2, 0, 0]))
    e.P = ca.dot(e.u, e.v[6:])
    return e


def gimbal(p: Values) -> Energies:
    names = [f"flight.{part}" for part in FREE] + ["yaw.angle", "roll.angle", "tilt.angle"]
    inputs = ["yaw.torque", "roll.torque", "tilt.torque", "thrust.force"]
    inputs += [f"moment_{axis}.torque" for axis in "xyz"]
    e = Energies(names, inputs, [0] * 8 + [np.deg2rad(p["tilt"])], {})
    place, R = e.q[:3], tilted(e.q[3:6])
    yoke = R @ turned(Z, e.q[6])
    arm = yoke @ turned(X, e.q[7])
    camera = arm @ turned(Y, e.q[8])
    mount = place + R @ ca.DM([0.05, 0, -0.06])
    elbow = mount + yoke @ ca.DM([-0.05, 0, -0.07])
    e.body(2, np.diag([0.02, 0.02, 0.04]), [0, 0, 0], place, R, _G)
    e.body(0.15, np.diag([2e-4, 2e-4, 1e-4]), [-0.04, 0, -0.03], mount, yoke, _G)
    e.body(0.1, np.diag([1e-4] * 3), [0.02, 0.03, 0], elbow, arm, _G)
    lens = elbow + arm @ ca.DM([0.05, 0, 0])
    e.body(0.35, np.diag([3e-4, p["J"], 4e-4]), [p["c"], 0, 0], lens, camera, _G)
    e.R = 0.001 * e.v[6] ** 2 / 2
    e.P = ca.dot(e.u[:3], e.v[6:]) + e.u[3] * ca.dot(R[:, 2], e.v[:3])
    e.P += ca.dot(e.u[4:], spin(R, e))
    return e


def gondola(p: Values) -> Energies:
    names = [f"sky.{part}" for part in FREE] + [f"neck.rotation.{axis}" for axis in "xyz"]
    names += ["azimuth.angle", "elevation.angle"]
    inputs = ["azimuth.torque", "elevation.torque", "lift.displaced_mass"]
    e = Energies(names, inputs, [0] * 10 + [np.deg2rad(p["el"])], {})
    place, R, L = e.q[:3], tilted(e.q[3:6]), p["L"]
    train = R @ tilted(e.q[6:9])
    hull = train @ turned(Z, e.q[9])
    tube = hull @ turned((0, -1, 0), e.q[10])
    neck = place + R @ ca.DM([0, 0, -30])
    hook = neck + train @ ca.DM([0, 0, -L])
    e.body(1200, np.diag([1e5, 1e5, 2e5]), [0, 0, 0], place, R, _G)
    e.body(60, np.diag([5 * L * L, 5 * L * L, 1]), [0, 0, -L / 2], neck, train, _G)
    e.body(p["m"], np.diag([1200, 1100, p["J"]]), [0, 0, -1.5], hook, hull, _G)
    eye = hook + hull @ ca.DM([0, 0, -1.5])
    e.body(150, np.diag([200, 210, 40]), [0, 0, 0], eye, tube, _G)
    e.V += 300 * e.q[8] ** 2 / 2
    e.P = e.u[0] * e.v[9] + e.u[1] * e.v[10] + _G * e.u[2] * e.v[2]
    return e


def helicopter(p: Values) -> Energies:
    names = [f"flight.{part}" for part in FREE] + ["teeter.angle.1", "teeter.angle.2", "shaft.angle"]
    inputs = ["lift.force", "tail.force", "teeter.torque.1", "teeter.torque.2"]
    e = Energies(names, inputs, [0] * 9, {1: 0})
    e.speeds[8] = p["Omega"] * 2 * np.pi / 60
    place, R = e.q[:3], tilted(e.q[3:6])
    hub = R @ turned(X, e.q[6]) @ turned(Y, e.q[7])
    mast = place + R @ ca.DM([0, 0, p["h"]])
    inertia = np.array([[900, 0, 200], [0, 4000, 0], [200, 0, 3500]])
    e.body(p["m"], inertia, [0, 0, 0], place, R, _G)
    e.body(200, np.diag([400, 400, 800]), [0, 0, 0], mast, hub @ turned(Z, e.q[8]), _G)
    e.V += 40000 * (e.q[6] ** 2 + e.q[7] ** 2) / 2
    e.P = e.u[0] * ca.dot(hub[:, 2], e.rate(mast)) + e.u[2] * e.v[6] + e.u[3] * e.v[7]
    e.P += e.u[1] * ca.dot(R[:, 1], e.rate(place + R @ ca.DM([-6, 0, 1])))
    return e


def stewart(p: Values) -> Energies:
    """The stiffness of a leg is zero, so its tension stays: density times length at rest."""
    bodies = tomllib.loads((FOLDER / "stewart.toml").read_text(encoding="utf-8"))["bodies"]
    legs = range(1, 7)
    names = [f"motion.{part}" for part in FREE]
    inputs = [f"leg{k}.force_density" for k in legs]
    e = Energies(names, inputs, [0, 0, p["h"], 0, 0, 0], {})
    place, R, m = e.q[:3], tilted(e.q[3:6]), p["m"]
    e.body(m, np.diag([0.2 * m, 0.2 * m, 0.3 * m]), [0, 0, 0], place, R, _G)
    for k in legs:
        top = place + R @ ca.DM(bodies["table"]["ports"][f"p{k}"])
        length = ca.norm_2(top - ca.DM(bodies["ground"]["ports"][f"b{k}"]))
        e.P -= e.u[k - 1] * e.at_rest(length) * e.rate(length)
    return e


CASES = (
    *(segway, ship_crane, motorcycle, launcher, gripper),
    *(dual_arm, gimbal, gondola, helicopter, stewart),
)


@pytest.mark.parametrize("energies", CASES)
def test_more_scenes_of_the_trials_are_right(energies: Callable[[Values], Energies]) -> None:
    model = mbdlft.to_lft(mbdlft.load_scene(FOLDER / f"{energies.__name__}.toml"), search=0.0)
    samples = mbdlft.random(model.parameters, 2, seed=5)
    found = mbdlft.matrices_at(model, samples)
    inputs = [s.name for s in model.inputs]
    states = [s.name for s in model.states if s.unit in ("m", "rad")]
    for k in range(2):
        e = energies({name: float(column[k]) for name, column in samples.items()})
        own = [name for name in e.names if name in states]
        order = [states.index(name) for name in own]
        speeds = np.arange(len(model.states))[len(states) :][order]
        columns = [inputs.index(name) for name in e.inputs if name]
        by_position, by_rate, by_input = e.linear(own)
        target(found.A[k][np.ix_(speeds, order)], by_position, MECHANISM)
        target(found.A[k][np.ix_(speeds, speeds)], by_rate, MECHANISM)
        target(found.B[k][np.ix_(speeds, columns)], by_input, MECHANISM)


def test_every_scene_of_the_trials_is_compared() -> None:
    compared = {function.__name__ for function in (*FIRST, *CASES)} | {"wind_turbine"}
    assert {path.stem for path in FOLDER.glob("*.toml")} == compared
