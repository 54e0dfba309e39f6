"""Tires, wheels on rails, and feet: against equations by hand, and against wheels that roll."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mbdlft
from mbdlft import Ground, Inertia, Parameter, Scene, robust_stability, to_lft
from mbdlft.multibody import Creep, Rolling, Support, Tire
from mbdlft.multibody.force import Load
from tests import close, kit

FOLDER = Path(__file__).parents[2] / "scenarios"
SPEED = Parameter("v", 20.0, low=5.0, high=40.0, unit="m/s")
STIFF = Parameter("C", 60e3, percent=20, unit="N/rad")


def car(**law: Any) -> Scene:
    """A body in its plane on two tires: the bicycle model of a car."""
    tires = [
        Tire(name=n, child=f"body.{n}", axis=(0, 1, 0), radius=0.3, cornering="C", force=0.0, **law)
        for n in ("front", "rear")
    ]
    ports = {"front": (1.1, 0, 0), "rear": (-1.4, 0, 0)}
    return kit.scene(
        "car",
        SPEED,
        STIFF,
        kit.body("body", 1200.0, zz=1800.0, ports=ports),
        Ground(name="ground", ports={"up": (0, 0, 0.3)}),
        kit.planar("p", "ground.up", "body", (0, 0, 1), preload=(0, 0, 0)),
        *tires,
        velocity=("v", 0, 0),
        inputs=["p.force.y"],
        outputs=["p.velocity.y", "p.rate", "front.side_force", "rear.side_force"],
    )


def side_of_a_car(v: float, C: float, s: complex, length: float) -> np.ndarray:
    """Side velocity, yaw rate and side forces for a side force: Newton, Euler, and lagging slip."""
    m, J, a, b = 1200.0, 1800.0, 1.1, -1.4
    lag = 1.0 / (1.0 + length / v * s)
    # the velocity across the heading: v_y + x r - v psi, with psi = r/s; v_y in the axes of the scene
    slips = np.array([[1.0, a - v / s], [1.0, b - v / s]])
    forces = -C / v * lag * slips
    whole = np.diag([m * s, J * s]) - np.array([[1.0, 1.0], [a, b]]) @ forces
    motion = np.linalg.solve(whole, [1.0, 0.0])
    return np.concatenate([motion, forces @ motion])


@pytest.mark.parametrize("length", [0.0, 0.5])
def test_a_car_on_tires_is_that_of_textbooks(length: float) -> None:
    model = to_lft(car(**({"relaxation": length} if length else {})), search=0.0)
    names = [state.name for state in model.states]
    assert [name for name in names if "deflection" in name] == ["front.deflection", "rear.deflection"] * (
        length > 0.0
    )
    assert model.order == sum(model.certificate.lower_bound) == 4
    for v, C, s in ((7.0, 50e3, 3j), (38.0, 70e3, 0.5 + 9j)):
        found = kit.transfer(model, s, {"v": v, "C": C})
        close.target(found[:, 0], side_of_a_car(v, C, s, length), close.MECHANISM)


def unicycle(wheel: Load, m: float, J: float, R: float, v: float) -> Scene:
    """A wheel that moves aside and up, and leans."""
    return kit.scene(
        "unicycle",
        kit.point("slider", 0.0),
        kit.point("lift", 0.0),
        kit.body("wheel", m, xx=J),
        Ground(name="ground", ports={"up": (0, 0, R)}),
        kit.rail("y", "ground.up", "slider", (0, 1, 0), preload=0.0),
        kit.rail("z", "slider", "lift", (0, 0, 1), preload=0.0),
        kit.hinge("lean", "lift", "wheel", (1, 0, 0), preload=0.0),
        wheel,
        gravity=(0, 0, -9.81),
        velocity=(v, 0, 0),
        inputs=["lean.torque"],
        outputs=["lean.angle", "tire.side_force", "tire.force"],
    )


@pytest.mark.parametrize("length", [0.0, 0.4])
def test_a_wheel_that_leans_is_pushed_aside(length: float) -> None:
    """m y'' = F, J l'' = R F + (R - r) N l, F + F' length/v = -C (y' + R l')/v - C_g l."""
    R, r, m, J, C, camber, v, N = 0.3, 0.1, 20.0, 0.9, 9e3, 1e3, 12.0, 20.0 * 9.81
    law = {"relaxation": length} if length else {}
    wheel = Tire(
        name="tire", child="wheel", axis=(0, 1, 0), radius=R, crown=r, cornering=C, camber=camber, **law
    )
    scene = unicycle(wheel, m, J, R, v)
    model, s = to_lft(scene, search=0.0), 1.0 + 4j
    found = kit.transfer(model, s, {})
    lag = 1.0 + length / v * s
    by_y, by_lean = -C * s / v / lag, (-C * R * s / v - camber) / lag
    whole = np.array([[m * s**2 - by_y, -by_lean], [-R * by_y, J * s**2 - R * by_lean - (R - r) * N]])
    y, lean = np.linalg.solve(whole, [0.0, 1.0])
    wanted = np.array([lean, by_y * y + by_lean * lean, 0.0])
    close.target(found[:, 0], wanted, close.MECHANISM)
    (force,) = (
        x
        for signal, x in zip(model.trim.signals, np.ravel(mbdlft.trim_at(model, {})), strict=True)
        if signal.name == "tire.force"
    )
    assert np.isclose(force, N, rtol=close.CLOSED_FORM)


def test_a_wheel_on_a_rail_spins_as_it_leans() -> None:
    """Its axis tilts by l, about which it turns at v/R: a spin creep of l/R, beside that of yaw."""
    law = {"longitudinal": 1e4, "lateral": 3e3, "lateral_spin": 40.0, "force": None}
    wheel = Creep(name="rail", child="wheel", axis=(0, 1, 0), radius=0.3, **law)
    scene = unicycle(wheel, 20.0, 0.9, 0.3, 12.0)
    model = to_lft(scene.model_copy(update={"outputs": ("rail.side_force",)}), search=0.0)
    at, names = mbdlft.matrices_at(model, {}), [state.name for state in model.states]
    found = {name: at.C[0, k] for k, name in enumerate(names)}
    close.target(found["lean.angle"], -40.0 / 0.3, close.CLOSED_FORM)
    close.target(found["lean.rate"], -3e3 * 0.3 / 12.0, close.CLOSED_FORM)


def test_stiff_tires_roll_as_the_benchmark_bicycle() -> None:
    """The poles differ by what is given over the stiffness; a round tire is the same in both."""
    bicycle = mbdlft.load_scene(FOLDER / "bicycle.toml")
    rolling = [x.model_copy(update={"tire": 0.05}) for x in bicycle.contacts]

    def poles(scene: Scene) -> np.ndarray:
        return np.linalg.eigvals(mbdlft.matrices_at(to_lft(scene, search=0.0), {"v": 6.0}).A)

    wanted = poles(bicycle.model_copy(update={"contacts": tuple(rolling)}))
    wanted, errors = wanted[np.abs(wanted) > 1e-6], []
    for k in (1e7, 1e8):
        tires = [
            Tire(name=f"on_{x.name}", child=x.port, axis=x.axis, radius=x.radius, crown=x.tire,
                 stiffness=k, damping=1e4, cornering=k, relaxation=0.1)
            for x in rolling if isinstance(x, Rolling)
        ]  # fmt: skip
        loads = (*bicycle.loads, *tires)
        found = poles(bicycle.model_copy(update={"contacts": (), "loads": loads}))
        errors.append(max(np.min(np.abs(found - pole)) for pole in wanted))
    assert 8.0 < errors[0] / errors[1] < 12.0
    assert errors[1] < 1e-3


def test_a_tire_on_a_moving_road_is_felt_as_a_strut() -> None:
    """The half car is the same on tires: nothing in its plane sees that they push sideways."""
    scene = mbdlft.load_scene(FOLDER / "half_car.toml")
    tires = [
        Tire(name=load.name, parent=load.parent, child=load.child, axis=(0, 1, 0), radius=0.3, crown=0.1,
             stiffness=load.stiffness, damping=load.damping, cornering=9e4)
        if load.name.endswith("tire") else load
        for load in scene.loads
    ]  # fmt: skip
    on_tires = scene.model_copy(update={"loads": tuple(tires), "velocity": (20.0, 0.0, 0.0)})
    wanted, found = (mbdlft.matrices_at(to_lft(x, search=0.0), {"m": 700.0}) for x in (scene, on_tires))
    for name in "ABCD":
        close.target(getattr(found, name), getattr(wanted, name), close.CLOSED_FORM)


def test_feet_sink_until_they_carry() -> None:
    """Positions as unknowns: a mass on two feet that carry nothing where it is declared sinks m g/k."""
    feet = [
        Support(name=name, child=f"plate.{name}", stiffness=k, side_stiffness=50.0, force=0.0)
        for name, k in (("left", 2000.0), ("right", 3000.0))
    ]
    scene = kit.scene(
        "plate",
        kit.body("plate", 10.0, (1, 1, 1), ports={"left": (0, 0.3, 0), "right": (0, -0.3, 0)}),
        kit.rail("lift", "ground", "plate", (0, 0, 1), preload=0.0),
        *feet,
        gravity=(0, 0, -10.0),
    )
    point = mbdlft.find_equilibrium(scene)
    assert np.isclose(point.positions["lift.position"], -100.0 / 5000.0, rtol=close.CLOSED_FORM)
    carried = {load.name: load.force for load in mbdlft.at_equilibrium(scene, point).loads}
    assert np.isclose(carried["left"], 40.0, rtol=close.CLOSED_FORM)
    assert np.isclose(carried["right"], 60.0, rtol=close.CLOSED_FORM)


# R. S. Sharp, J. Mech. Eng. Sci. 13(5), 1971, Tables 1 to 3, model 1: speed in ft/s; capsize; weave and
# wobble in 1/s and rad/s
SHARP = """
 10  -3.56   2.01  1.63  -5.20 55.7
 20  -2.83  -0.18  2.09  -5.91 55.8
 30  -0.13  -3.36  4.56  -6.42 55.5
 50   0.08  -6.59 11.4   -6.52 54.6
 70   0.08  -3.97 16.8   -5.70 54.0
100   0.07  -1.82 19.2   -3.94 54.3
130   0.05  -1.13 20.4   -2.24 55.6
160   0.04  -0.96 21.2   -0.82 57.5
"""


def test_the_motorcycle_has_the_roots_of_sharp() -> None:
    """To two units of the last printed digit: his load of the front wheel is 0.7 % off his statics."""
    model = to_lft(mbdlft.load_scene(FOLDER / "motorcycle.toml"), search=0.0)
    for line in SHARP.split("\n")[1:-1]:
        speed, capsize, *pairs = line.split()
        roots = np.linalg.eigvals(mbdlft.matrices_at(model, {"v": 0.3048 * float(speed)}).A)
        for printed in ([capsize, "0.00"], pairs[:2], pairs[2:]):
            real, imag = map(float, printed)
            nearest = roots[np.argmin(np.abs(roots - complex(real, imag)))]
            for text, value in zip(printed, (nearest.real, nearest.imag), strict=True):
                assert abs(value - float(text)) <= 2.0 * 0.1 ** len(text.partition(".")[2])


def test_a_short_relaxation_tends_to_none() -> None:
    """The motorcycle leans, steers and turns as without the lag, but for what its length gives."""
    scene, s, answers = mbdlft.load_scene(FOLDER / "motorcycle.toml"), 2.0 + 9j, list[np.ndarray]()
    for length in (None, 1e-4, 1e-3):
        loads = tuple(x.model_copy(update={"relaxation": length}) for x in scene.loads)
        model = to_lft(scene.model_copy(update={"loads": loads}), search=0.0)
        answers.append(kit.transfer(model, s, {"c": 3.0}))
    small, large = (np.max(np.abs(x - answers[0]) / np.abs(answers[0])) for x in answers[1:])
    assert 9.0 < large / small < 11.0
    assert large < 0.01


# the wheelset: m y'' + 2 f_y (y'/v - a) + k_y y = 0, J a'' + 2 f_x b (b a'/v + c y/r) + k_a a = 0
MASS, YAW, B, R, K_YAW = 1250.0, 700.0, 0.75, 0.46, 1.5e6


def critical_speed(c: float, f_x: float, f_y: float, k: float) -> float:
    """Where Routh's determinant of the four equations of first order vanishes, in closed form."""
    side, turn = 2.0 * f_y, 2.0 * f_x * B**2
    c3, c2, c1 = MASS * turn + YAW * side, MASS * K_YAW + YAW * k, side * K_YAW + turn * k
    c4, c0 = MASS * YAW, k * K_YAW + 4.0 * f_x * f_y * c * B / R
    return float(np.sqrt(side * turn * c1 * c3 / (c4 * c1**2 + c0 * c3**2 - c1 * c2 * c3)))


@pytest.fixture(scope="module")
def wheelset() -> mbdlft.LFTModel:
    return to_lft(mbdlft.load_scene(FOLDER / "wheelset.toml"), search=0.0)


def test_a_wheelset_hunts_above_its_critical_speed(wheelset: mbdlft.LFTModel) -> None:
    names = ["aside.position", "yaw.angle", "aside.velocity", "yaw.rate"]
    for c, f_x, f_y, k in ((0.1, 7.0, 6.0, 0.4), (0.2, 5.0, 4.0, 0.3), (0.15, 8.0, 7.0, 0.5)):
        v = critical_speed(c, f_x * 1e6, f_y * 1e6, k * 1e6)
        for factor, is_stable in ((1.0 - 1e-9, True), (1.0 + 1e-9, False)):
            point = {"conicity": c, "f_x": f_x, "f_y": f_y, "k_y": k, "v": factor * v}
            poles = np.linalg.eigvals(mbdlft.matrices_at(wheelset, point).A)
            assert (np.max(poles.real) < 0.0) == is_stable
        matrix = np.array([
            [0, 0, 1, 0], [0, 0, 0, 1],
            [-k * 1e6 / MASS, 2e6 * f_y / MASS, -2e6 * f_y / (v * MASS), 0],
            [-2e6 * f_x * c * B / R / YAW, -K_YAW / YAW, 0, -2e6 * f_x * B**2 / (v * YAW)],
        ])  # fmt: skip
        at = mbdlft.matrices_at(wheelset, {**point, "v": v})
        rows = [[state.name for state in wheelset.states].index(name) for name in names]
        close.target(at.A[np.ix_(rows, rows)], matrix, close.CLOSED_FORM)


def test_spin_creep_couples_yaw_with_the_side() -> None:
    """F_y = -f_y y - f_ys s and M = f_ys y - f_s s of both wheels, with y = y'/v - a and s = a'/v."""
    scene, v, both, alone = mbdlft.load_scene(FOLDER / "wheelset.toml"), 15.0, 2e4, 60.0
    spun = [x.model_copy(update={"lateral_spin": both, "spin": alone}) for x in scene.loads]
    outputs = (*(scene.outputs or ()), "left.side_force", "right.force_ahead")
    more = scene.model_copy(update={"loads": tuple(spun), "outputs": outputs})
    names = ["aside.position", "yaw.angle", "aside.velocity", "yaw.rate"]
    plain, found = (
        mbdlft.matrices_at(model, {"v": v}) for model in (to_lft(x, search=0.0) for x in (scene, more))
    )
    added = np.array([
        [0, 0, 0, -2 * both / v / MASS], [0, -2 * both / YAW, 2 * both / v / YAW, -2 * alone / v / YAW]
    ])  # fmt: skip
    states = [state.name for state in to_lft(scene, search=0.0).states]
    rows = [states.index(name) for name in names]
    difference = (found.A - plain.A)[np.ix_(rows[2:], rows)]
    close.target(difference, added, close.CLOSED_FORM, 1e3)
    side = [0.0, 6e6, -6e6 / v, -both / v]
    ahead = [7e6 * -0.1 / R, 0.0, 0.0, -7e6 * B / v]  # of the right wheel, which runs ahead as it yaws
    close.target(found.C[2, rows], np.array(side), close.CLOSED_FORM, 1e7)
    close.target(found.C[3, rows], np.array(ahead), close.CLOSED_FORM, 1e7)


def test_rails_that_are_not_straight_steer_a_wheelset() -> None:
    """The wheelset runs over rails that are w aside: it creeps by its motion over them."""
    scene, v, c, s = mbdlft.load_scene(FOLDER / "wheelset.toml"), 30.0, 0.1, 1.0 + 8j
    bed = kit.body("bed", 0.0, (0, 0, 0))
    alignment = kit.rail("line", "ground", "bed", (0, 1, 0), imposed="motion")
    over = scene.model_copy(
        update={
            "bodies": (*scene.bodies, bed),
            "joints": (alignment, *scene.joints),
            "loads": tuple(x.model_copy(update={"parent": "bed"}) for x in scene.loads),
            "inputs": ("line.position", "line.velocity"),
            "outputs": ("aside.position", "yaw.angle"),
        }
    )
    found = kit.transfer(to_lft(over, search=0.0), s, {"v": v, "conicity": c}) @ [1.0, s]
    side, turn, steer = 2 * 6e6 / v, 2 * 7e6 * B**2 / v, 2 * 7e6 * B * c / R
    matrix = np.array([
        [MASS * s**2 + side * s + 0.4e6, -side * v], [steer, YAW * s**2 + turn * s + K_YAW]
    ])  # fmt: skip
    close.target(found, np.linalg.solve(matrix, [side * s, steer]), close.MECHANISM)


def test_a_slow_wheelset_follows_klingels_sine() -> None:
    """Free of springs and slow, it runs at the wavelength 2 pi sqrt(r b/c) (Klingel 1883)."""
    scene = mbdlft.load_scene(FOLDER / "wheelset.toml")
    joints = tuple(
        joint if joint.name == "spin" else joint.model_copy(update={"stiffness": 0.0})
        for joint in scene.joints
    )
    parameters = tuple(p for p in scene.parameters if p.name != "k_y")
    model = to_lft(scene.model_copy(update={"joints": joints, "parameters": parameters}), search=0.0)
    for c in (0.05, 0.2):
        poles = np.linalg.eigvals(mbdlft.matrices_at(model, {"v": 1.0, "conicity": c}).A)
        (rate,) = poles.imag[poles.imag > 0.0]
        assert np.isclose(2.0 * np.pi / rate, 2.0 * np.pi * np.sqrt(R * B / c), rtol=close.SIMULATED)


def test_the_critical_speed_is_proved(wheelset: mbdlft.LFTModel) -> None:
    """From 1 m/s to just below it a wheelset is stable, and up to just above it not."""
    scene = mbdlft.load_scene(FOLDER / "wheelset.toml")
    v = critical_speed(0.1, 7e6, 6e6, 0.4e6)
    constants = {p.name: mbdlft.Constant(value=p.nominal, unit=p.unit) for p in scene.parameters[1:]}

    def up_to(high: float) -> mbdlft.Bounds:
        speed = Parameter("v", 30.0, low=1.0, high=high, unit="m/s")
        update = {"constants": {**scene.constants, **constants}, "parameters": (speed,)}
        return robust_stability(to_lft(scene.model_copy(update=update), search=0.0), gap=1e-4)

    assert up_to(v - 0.01).lower > 1.0
    assert up_to(v + 0.01).upper < 1.0


def test_a_foot_on_a_point_holds_aside_and_one_on_a_plane_slides() -> None:
    """Of a body on one foot below its center: N = m g on the foot, which moves aside with the body."""
    m, J, h, k = 4.0, 0.3, 0.7, 900.0
    for side in (0.0, 400.0):
        law = {"stiffness": k, "damping": 2.0, "side_stiffness": side, "side_damping": 3.0}
        inertia = Inertia(xx=J, yy=J, zz=J)
        body = kit.body("body", m, inertia=inertia, ports={"foot": (0, 0, -h)})
        scene = kit.scene(
            "leg",
            body,
            kit.free("base", "ground", "body", position=(0, 0, h)),
            Support(name="foot", child="body.foot", **law),
            gravity=(0, 0, -10.0),
            inputs=["base.force.x", "base.force.z"],
            outputs=["base.position.x", "base.rotation.y", "base.position.z", "foot.force"],
        )
        s = 2.0 + 5j
        found = kit.transfer(to_lft(scene, search=0.0), s, {})
        foot = np.array([1.0, -h])  # its way aside, by x and the rotation about y
        law_aside = (side + 3.0 * s) * np.outer(foot, foot) - np.diag([0.0, m * 10.0 * h])
        x, turn = np.linalg.solve(np.diag([m, J]) * s**2 + law_aside, [1.0, 0.0])
        z = 1.0 / (m * s**2 + 2.0 * s + k)
        wanted = np.array([[x, 0], [turn, 0], [0, z], [0, -(k + 2.0 * s) * z]])
        close.target(found, wanted, close.MECHANISM)
