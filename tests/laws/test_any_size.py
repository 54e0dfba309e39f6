"""Every scenario at any size: small motions are those of its model, and its forces keep its energy."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
from scipy.linalg import expm

import mbdlft
from mbdlft import FlexibleBody, Free, Ground, Inertia, Scene, load_scene
from mbdlft.base.array import Array
from mbdlft.base.description import Axis
from mbdlft.dae import simulate
from mbdlft.multibody import Beam, KnifeEdge, Mode, Position, Rolling, Spin, Tire
from mbdlft.multibody.motion.equations import Motion, equations_of_motion
from tests import kit
from tests.close import CLOSED_FORM, EPS, KEPT, target
from tests.cross.mechanisms import closed_loop, with_angle_held
from tests.cross.planar_mechanisms import driven_four_bar
from tests.motions import check_second_order

# forces that turn with a body have no potential; creep takes energy from the motion of the scene
_FOLLOWING = {"balloon_gondola", "launcher_bending", "launcher_slosh"}
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(16)


def scenes() -> list[str]:
    heads = ((path, path.read_text(encoding="utf-8")) for path in Path("scenarios").glob("*.toml"))
    return sorted(path.stem for path, text in heads if "mbdlft-scene/1" in text)


def undamped(item: Any) -> Any:
    """A scene, or an item of one, without damping."""
    fields = {key: getattr(item, key) for key in type(item).model_fields}
    changed: dict[str, Any] = {
        key: tuple(0.0 for _ in value) if isinstance(value, tuple) else 0.0
        for key, value in fields.items()
        if "damping" in key
    }
    nested = [key for key in ("bodies", "joints", "loads", "couplings", "modes") if fields.get(key)]
    for key in nested:
        if isinstance(fields[key], tuple):
            changed[key] = tuple(map(undamped, fields[key]))
    return item.model_copy(update=changed)


class Forces:
    """H a + h - f = 0 without multipliers and inputs, in functions of x = [q ; v] and a."""

    def __init__(self, m: Motion) -> None:
        n = len(m.coordinates) // 2
        q, v, a = m.x[:n], m.x[n:], m.z[:n]
        others = ca.vertcat(ca.SX(0, 1), ca.vec(m.z[n:]), m.u)
        needed = ca.substitute(m.residual[:n], others, ca.SX.zeros(others.numel()))
        # the acceleration of an imposed joint is an input
        free = [
            k for k in range(n) if ca.depends_on(needed[k], m.x) or ca.jacobian(needed[k], a).nnz() != 1
        ]
        still = ca.substitute(needed, ca.vertcat(v, a), ca.SX.zeros(2 * n))
        H = ca.jacobian(needed, a)[free, free]
        kinetic = 0.5 * ca.bilin(H, v[free], v[free])
        rate = ca.jtimes(kinetic, q, m.rates[:n]) + ca.jtimes(kinetic, v, a)
        efforts = (needed - still)[free]
        power = ca.vertcat(ca.dot(v[free], efforts), ca.dot(ca.fabs(v[free]), ca.fabs(efforts)))
        # still does the work (v, still) = (qdot, N^-T still)
        along = ca.solve(ca.jacobian(m.rates[:n], v).T, still)
        slopes = ca.jacobian(along, q)[free, free]
        outputs = [H, kinetic, rate, power, along, slopes]
        self.function = ca.Function("f", [m.x, a, m.references], [ca.densify(y) for y in outputs])
        self.moves = np.isin(np.arange(n), free)
        self.n, self.references = n, np.tile([1.0, 0.0, 0.0, 0.0], len(m.balls))

    def __call__(self, x: Array, a: Array) -> list[Array]:
        return [np.array(y.full()) for y in self.function(x, a, self.references)]

    def energy(self, x: Array) -> float:
        """With the potential as the work on the straight way from q = 0."""
        n, none = self.n, np.zeros(self.n)
        work = 0.0
        for node, weight in zip(0.5 * (_NODES + 1.0), 0.5 * _WEIGHTS, strict=True):
            work += weight * float(x[:n] @ self(np.concatenate([node * x[:n], none]), none)[4][:, 0])
        return work + self(x, none)[1].item()


def with_tip(body: Beam | FlexibleBody) -> Scene:
    """A free hub with an elastic body that holds a rigid one by its tip."""
    hub = kit.body("hub", 3.0, (1.0, 2.0, 1.5))
    off = {"inertia": Inertia(xx=0.3, yy=0.5, zz=0.4), "center_of_mass": (0.1, 0.2, 0.3)}
    tip = kit.body("tip", 0.5, **off)
    joints = [
        kit.free("f", "ground", "hub"),
        kit.weld("root", "hub", body.name),
        kit.weld("end", f"{body.name}.tip", "tip"),
    ]
    return kit.scene("tip", hub, body, tip, *joints)


_SIX = {
    "participation": (0.1, 0.4, 0.2, 0.1, 0.2, 0.3),
    "shapes": {"tip": (0.1, 0.5, 0.4, 0.7, 0.6, 0.8)},
}
_FLEXIBLE = {"mass": 2.0, "center_of_mass": (0.5, 0, 0), "inertia": Inertia(xx=1, yy=2, zz=2)}
_SECTION = {"I_y": 0.01, "I_z": 0.02, "shear_modulus": 9.0, "torsion_constant": 0.5, "elements": 1}
_BEAM = {"length": 1.5, "density": 1.0, "area": 1.0, "modulus": 9.0, **_SECTION}
_ELASTIC: list[Beam | FlexibleBody] = [
    Beam(name="thin", deformations=("axial", "bending_y", "bending_z"), **_BEAM),
    Beam(name="thick", rotary_inertia=True, prestress="axial", **_BEAM),
    FlexibleBody(
        name="modes", ports={"tip": (1, 0, 0)}, modes=[Mode(frequency=2.0, **_SIX)], **_FLEXIBLE
    ),
]
# the second has sensors that feel weight and the forces of a loop
_MADE: dict[str, Callable[[], Scene]] = {
    "driven": driven_four_bar,
    "felt": lambda: with_angle_held(closed_loop(5002)),
}
# the others have the same kinds of bodies, joints and loads
_FIRST = {
    *("ball_turntable", "bicycle", "control_moment_gyros", "driven", "felt", "half_car", "lander"),
    *("launcher_bending", "motorcycle", "piezo_beam", "rolling_disk", "solar_arrays"),
    *("spinning_satellite", "tower_crane", "wheelset"),
}


def _quick(names: Sequence[str]) -> list[Any]:
    return [name if name in _FIRST else pytest.param(name, marks=pytest.mark.long) for name in names]


@pytest.mark.parametrize(
    "item", [*_quick(scenes()), *_ELASTIC], ids=lambda item: getattr(item, "name", item)
)
def test_inertia_does_no_work_and_forces_have_a_potential(item: str | Beam | FlexibleBody) -> None:
    """d/dt (v'H v/2) = v'(H a + h) anywhere; the slopes of what is left by q are symmetric."""
    loaded = load_scene(f"scenarios/{item}.toml") if isinstance(item, str) else with_tip(item)
    name, scene = loaded.name, undamped(loaded)
    forces, random = Forces(equations_of_motion(scene, {})), np.random.default_rng(0)
    for _ in range(2):
        x, a = 0.3 * random.standard_normal(2 * forces.n), random.standard_normal(forces.n)
        x[forces.n :] *= forces.moves
        a *= forces.moves
        H, _, rate, power, along, slopes = forces(x, a)
        size = np.sum(np.abs(H)) + np.max(np.abs(along))
        target(H, H.T, CLOSED_FORM)
        if name == "wheelset":
            continue
        rounding = EPS * np.sum(np.abs(x[forces.n :]) @ np.abs(along))
        assert abs(rate - power[0]) <= CLOSED_FORM * power[1] + 10.0 * rounding
        if name not in _FOLLOWING:
            assert np.max(np.abs(slopes - slopes.T)) <= CLOSED_FORM * max(size, np.max(np.abs(slopes)))


@pytest.mark.parametrize("name", _quick([*scenes(), *_MADE]))
def test_small_motions_are_those_of_the_linear_model_to_second_order(name: str) -> None:
    scene = _MADE[name]() if name in _MADE else load_scene(f"scenarios/{name}.toml")
    check_second_order(scene, mbdlft.to_lft(scene, search=0.0, prove=0.0), 0)


@pytest.mark.parametrize("name", ["ball_turntable", "half_car", "lander"])
def test_energy_is_kept_for_ten_seconds(name: str) -> None:
    scene = undamped(load_scene(f"scenarios/{name}.toml"))
    m, random = equations_of_motion(scene, {}), np.random.default_rng(0)
    bodies = tuple(f"{body.name}." for body in scene.bodies)
    names = [m.coordinates[k].name for k in m.states]
    start = {name: 0.05 * random.standard_normal() for name in names if not name.startswith(bodies)}
    run, forces = simulate(scene, np.linspace(0.0, 10.0, 41), initial=start), Forces(m)
    energies = np.array([forces.energy(x) for x in run.states])
    motion = max(forces(x, np.zeros(forces.n))[1].item() for x in run.states)
    assert np.max(np.abs(energies - energies[0])) <= KEPT * motion


def test_a_disk_that_leans_rolls_on_a_circle() -> None:
    """The torque of its contact force about its center turns its momentum steadily."""
    mass, R, g, lean, W = 2.0, 0.4, 9.81, 0.4, 1.5
    A, C = mass * R**2 / 4, mass * R**2 / 2
    up, axis = np.array([0.0, 0.0, 1.0]), np.array([0.0, np.cos(lean), np.sin(lean)])
    down = -R * np.cross(np.cross(axis, up) / np.cos(lean), axis)  # from the center to the ground
    down = down if down[2] < 0.0 else -down

    def missing(spin: float) -> tuple[float, Array]:
        omega = W * up + spin * axis
        momentum = A * omega + (C - A) * axis * (axis @ omega)
        velocity = -np.cross(omega, down)
        force = mass * (np.cross(W * up, velocity) + g * up)
        return (np.cross(down, force) - np.cross(W * up, momentum))[0], omega

    first, second = missing(0.0)[0], missing(1.0)[0]
    spin = first / (first - second)
    wrong, omega = missing(spin)
    assert abs(wrong) <= CLOSED_FORM
    disk = kit.body("disk", mass, (A, C, A))
    scene = kit.scene(
        "circle",
        disk,
        kit.free("f", "ground", "disk", position=(0.0, 0.0, R)),
        Rolling(name="touch", port="disk", axis=(0, 1, 0), radius=R),
        Position(name="center", port="disk"),
        gravity=(0.0, 0.0, -g),
        outputs=["center.x", "center.y", "center.z"],
    )
    turn = np.array([[1, 0, 0], [0, np.cos(lean), np.sin(lean)], [0, -np.sin(lean), np.cos(lean)]])
    rates = turn @ omega
    start = {"f.rotation.x": 2.0 * np.tan(0.5 * lean)}
    start |= {f"f.rate.{axis}": rate for axis, rate in zip("xyz", rates, strict=True)}
    times = np.linspace(0.0, 5.0, 26)
    run = simulate(scene, times, initial=start)
    y = -np.cross(omega, down)
    radius = y[0] / W  # of the circle of the center, on the side to which it leans
    expected = [radius * np.sin(W * times), radius * (1.0 - np.cos(W * times))]
    target(run.outputs, np.column_stack([*expected, np.full(26, R * (np.cos(lean) - 1.0))]), KEPT)


def test_a_skate_runs_on_a_circle() -> None:
    """Nothing turns it or slows it down: at a rate w its heading turns, and its speed v stays ahead."""
    blade = kit.body("skate", 2.0, (1.0, 1.0, 0.5))
    joints = [kit.free("f", "ground", "skate")]
    edge = KnifeEdge(name="edge", port="skate", heading=(1, 0, 0))
    scene = kit.scene("skate", blade, *joints, edge)
    w, v, times = 2.0, 3.0, np.linspace(0.0, 4.0, 21)
    run = simulate(scene, times, initial={"f.rate.z": w, "f.velocity.x": v})
    x, y = (run.states[:, run.state_names.index(f"f.position.{axis}")] for axis in "xy")
    target(np.array([x, y]), v / w * np.array([np.sin(w * times), 1.0 - np.cos(w * times)]), KEPT)


def on_hub(spin: float, axis: Axis, **beam: Any) -> Scene:
    """A beam on a heavy hub, in a frame that spins."""
    hub = kit.body("hub", 1.0, (1e9, 1e9, 1e9), ports={"rim": (0.3, 0.0, 0.0)})
    rod = Beam(name="rod", length=2.0, density=1.0, area=1.0, modulus=30.0, **beam)
    joints = [
        kit.hinge("turn", "ground", "hub", axis),
        kit.weld("root", "hub.rim", "rod"),
        kit.weld("end", "rod.tip", "mass"),
    ]
    frame = Spin(axis=axis, rate=spin) if spin else None
    return kit.scene("hub", hub, rod, kit.point("mass", 0.5), *joints, spin=frame)


@pytest.mark.parametrize(
    ("axis", "deformations"),
    [((0, 0, 1), ["bending_y"]), ((0, 0, 1), ["bending_z"]), ((1, 0, 0), ["bending_y", "bending_z"])],
)
def test_a_beam_on_a_turning_hub_is_that_of_a_frame_that_spins(
    axis: Axis, deformations: list[str]
) -> None:
    """Centrifugal forces stiffen its bending or soften it, those of Coriolis couple both."""
    W, times = 6.0, np.linspace(0.0, 1.0, 11)
    beam = {"I_z": 1.0, "I_y": 1.0, "elements": 1, "deformations": tuple(deformations)}
    model = mbdlft.to_lft(on_hub(W, axis, **beam), search=0.0)
    A, names = mbdlft.matrices_at(model, {})[0], [state.name for state in model.states]
    own = [k for k, name in enumerate(names) if name.startswith("rod.")]
    begin = np.where(np.isin(np.arange(len(names)), own), 1e-6, 0.0) * np.arange(1, len(names) + 1)
    start = {"turn.rate": W} | {names[k]: begin[k] for k in own}
    run = simulate(on_hub(0.0, axis, **beam), times, initial=start, tolerance=1e-14)
    expected = np.array([expm(A * t) @ begin for t in times])
    places = [run.state_names.index(names[k]) for k in own]
    assert np.max(np.abs(run.states[:, places] - expected[:, own])) <= 2e-6 * np.max(np.abs(expected))


def test_a_tire_that_leans_pushes_along_the_ground() -> None:
    """With the slip of its point over the speed ahead, however far it leans."""
    V, R, C, mass, J, aside, ahead, lean = 8.0, 0.3, 900.0, 2.0, 0.1, 0.5, 0.7, 0.6
    massless = Inertia(xx=0, yy=0, zz=0)
    scene = kit.scene(
        "tire",
        Ground(ports={"center": (0, 0, R)}),
        kit.point("cart", 0),
        kit.point("slider", 0),
        kit.point("lift", 0),
        kit.body("yoke", 0, inertia=massless),
        kit.body("wheel", mass, (J, 0.2, J)),
        kit.rail("ahead", "ground.center", "cart", (1, 0, 0), preload=0.0),
        kit.rail("aside", "cart", "slider", (0, 1, 0), preload=0.0),
        kit.rail("up", "slider", "lift", (0, 0, 1), preload=0.0),
        kit.hinge("lean", "lift", "yoke", (1, 0, 0), preload=0.0),
        kit.hinge("spin", "yoke", "wheel", (0, 1, 0), rate=V / R, preload=0.0),
        Tire(name="tire", child="wheel", axis=(0, 1, 0), radius=R, cornering=C, camber=0.0, force=0.0),
        velocity=(V, 0, 0),
    )
    m = equations_of_motion(scene, {})
    names, still = [signal.name for signal in m.coordinates], np.zeros(m.z.numel())
    x = np.zeros(len(names))
    begin = {"lean.angle": lean, "aside.velocity": aside, "ahead.velocity": ahead}
    x[[names.index(name) for name in begin]] = [*begin.values()]
    f = ca.Function("f", [m.x, m.z, m.u], [m.residual, ca.jacobian(m.residual, m.z)])
    offset, slopes = (y.full() for y in f(x, still, []))
    force = -C * aside / (V + ahead)
    expected = [0.0, force / mass, 0.0, R * np.cos(lean) * force / J, 0.0]
    target(np.linalg.solve(slopes, -offset)[:, 0], np.array(expected), CLOSED_FORM)


@pytest.mark.parametrize(
    "name", ["motorcycle", pytest.param("motorcycle without relaxation", marks=pytest.mark.long)]
)
def test_tires_roll_in_any_direction(name: str) -> None:
    """The same motion with another heading: of the frame of the scene, which moves, it is far off."""
    scene = load_scene(f"scenarios/{name.partition(' ')[0]}.toml")
    if " " in name:
        loads = tuple(load.model_copy(update={"relaxation": None}) for load in scene.loads)
        scene = scene.model_copy(update={"loads": loads, "outputs": None})
    heading, times = 1.2, np.linspace(0.0, 1.0, 6)
    m = equations_of_motion(scene, {})
    names = [signal.name for signal in m.coordinates]
    states = [names[k] for k in m.states]
    base = next(joint.name for joint in scene.joints if isinstance(joint, Free))
    inner = [name for name in names if name.endswith((".angle", ".deflection"))]
    speed = {p.name: p.nominal for p in scene.parameters}[str(scene.velocity[0])]
    ahead = speed * np.array([np.cos(heading) - 1.0, np.sin(heading)])
    start = {next(name for name in states if "steer" in name and "rate" in name): 3.0}
    turned = start | {f"{base}.rotation.z": 2.0 * np.tan(0.5 * heading)}
    moved = {f"{base}.velocity.{axis}": v for axis, v in zip("xy", ahead, strict=True)}
    turned |= {name: v for name, v in moved.items() if name in states}
    runs = [simulate(scene, times, initial=each).states for each in (start, turned)]
    places = [names.index(name) for name in inner]
    straight, other = (run[:, places] for run in runs)
    assert np.max(np.abs(straight)) > 5e-3
    target(other, straight, KEPT)
