"""Laws of equilibria with unknown positions: what is found holds, against forms written out by hand."""

from typing import Any

import casadi as ca
import mpmath
import numpy as np
import pytest

import mbdlft
from mbdlft import Inertia, Parameter, Revolute, RigidBody, Scene
from mbdlft.multibody.equilibrium import conditions
from mbdlft.problem.equations import Equations, equation_function, load_value, physical_symbols
from tests import kit
from tests.close import SCENARIO, exact, roundoff, target
from tests.equilibria import Known, known_equilibrium
from tests.laws.test_weights import forces_turned_on_the_way
from tests.seeds import some

STARTS = 30
G = 9.81


def pendulum(position: float = 1.0, **fields: Any) -> Scene:
    """A point mass that hangs 0.8 m under a hinge with a spring, relaxed at `position`."""
    hinge = {"preload": 0.0, "stiffness": 20.0, **fields}
    return kit.scene(
        "pendulum",
        Parameter("m", 2.0, percent=40, unit="kg"),
        kit.point("bob", "m", ports={"top": (0, 0, 0.8)}),
        kit.hinge("hinge", "ground", "bob.top", (1, 0, 0), position=position, **hinge),
        gravity=(0, 0, -G),
    )


def chain(count: int, **fields: Any) -> Scene:
    """Point masses of 1 kg on links of 1 m, one under the other."""
    return kit.scene(
        "chain",
        *(kit.point(f"b{k}", 1.0, ports={"top": (0, 0, 1)}) for k in range(count)),
        *(
            kit.hinge(
                f"j{k}",
                "ground" if k == 0 else f"b{k - 1}",
                f"b{k}.top",
                (1, 0, 0),
                position=0.3,
                preload=0.0,
            )
            for k in range(count)
        ),
        gravity=(0, 0, -G),
        **fields,
    )


def solved(known: Known, seed: int) -> None:
    """An equilibrium is found, and the equations of the model hold there without further ado."""
    point = mbdlft.find_equilibrium(known.scene, starts=STARTS, seed=seed)
    found = mbdlft.at_equilibrium(known.scene, point)
    trim = mbdlft.solve_trim(mbdlft.assemble(found))
    sizes = max([1.0, *(abs(value) for value in point.efforts.values())])
    names = [signal.name for signal in trim.signals]
    target(trim.values, [point.efforts[name] for name in names], SCENARIO, scale=sizes)


@pytest.mark.parametrize("seed", some((0, 3), range(8)))
def test_random_scenes(seed: int) -> None:
    solved(known_equilibrium(seed), seed)


@pytest.mark.long
def test_a_thousand_random_scenes() -> None:
    failures = {}
    for seed in range(1000):
        try:
            solved(known_equilibrium(seed), seed)
        except mbdlft.TrimError as error:
            failures[seed] = str(error)
    assert len(failures) <= 5, failures
    assert all("misses" in text for text in failures.values()), failures


def test_spring_and_gravity() -> None:
    """k (theta - 1) + m g L sin(theta) = 0 to 50 digits, at several masses."""
    mpmath.mp.dps = 50
    for mass in (1.3, 2.0, 2.7):
        point = mbdlft.find_equilibrium(pendulum(), {"m": mass})

        def moment(theta: mpmath.mpf, mass: float = mass) -> mpmath.mpf:
            return 20 * (theta - 1) + mpmath.mpf(mass) * mpmath.mpf(G) * mpmath.mpf(0.8) * mpmath.sin(
                theta
            )

        roundoff(point.positions["hinge.angle"], float(mpmath.findroot(moment, 0.5)))
        assert point.parameters == {"m": mass}
        assert point.undetermined == ()


def test_cable() -> None:
    """A mass on a slide hangs on a cable off the axis: sqrt(x^2 + 0.3^2) to 50 digits."""
    mpmath.mp.dps = 50

    def force(x: mpmath.mpf) -> mpmath.mpf:
        length = mpmath.sqrt(x * x + mpmath.mpf(0.3) ** 2)
        return -150 * (length - mpmath.mpf(0.45)) * x / length - 2 * mpmath.mpf(G)

    x = float(mpmath.findroot(force, -0.5))
    point = mbdlft.find_equilibrium(cable(rest_length=0.45))
    roundoff(point.positions["slide.position"], x, kappa=10.0)
    # the same rope, given by its force density where it is declared, 0.5 m long
    same = cable(force_density=150.0 * (1 - 0.45 / 0.5))
    point = mbdlft.find_equilibrium(same)
    roundoff(point.positions["slide.position"], x, kappa=10.0)
    moved = mbdlft.at_equilibrium(same, point)
    length = float(np.hypot(x, 0.3))
    roundoff(float(moved.loads[0].force_density), 150.0 * (1 - 0.45 / length), kappa=10.0)


def cable(**spring: Any) -> Scene:
    return kit.scene(
        "cable",
        kit.point("cart", 2.0),
        mbdlft.Ground(ports={"hook": (0.3, 0, 0)}),
        kit.rail("slide", "ground", "cart", (0, 0, 1), position=-0.4, preload=0.0),
        kit.spring("rope", "ground.hook", "cart", stiffness=150.0, **spring),
        gravity=(0, 0, -G),
    )


def test_all_equilibria_of_a_double_pendulum() -> None:
    """Each link hangs or stands: four equilibria, with as many growing modes as links that stand."""
    scene = chain(2)
    points = mbdlft.find_equilibrium(scene, starts=60, seed=1, every=True)
    assert len(points) == 4
    for point in points:
        first = point.positions["j0.angle"]
        second = first + point.positions["j1.angle"]
        standing = sum(float(np.cos(angle)) < 0 for angle in (first, second))
        roundoff(np.sin([first, second]), np.zeros(2))
        assert int(np.sum(mbdlft.eigenvalues_at(scene, point).real > 0.1)) == standing


def test_linear_model_at_an_equilibrium() -> None:
    """A = [0 1; -(k + m g L cos)/(m L^2) 0] where the pendulum sags to."""
    scene = pendulum()
    point = mbdlft.find_equilibrium(scene)
    model = mbdlft.to_lft(mbdlft.at_equilibrium(chain(1), mbdlft.find_equilibrium(chain(1))))
    roundoff(model.A, [[0, 1], [-G, 0]])
    theta = point.positions["hinge.angle"]
    squared = (20 + 2 * G * 0.8 * np.cos(theta)) / (2 * 0.64)
    eigenvalues = mbdlft.eigenvalues_at(scene, point)
    roundoff(np.sort(np.abs(eigenvalues.imag)), [np.sqrt(squared)] * 2)


def four_bar(
    kind: str = "revolute",
    lengths: tuple[float, ...] = (0.5, 1.0, 0.7),
    hook: tuple[float, ...] = (0.0, 0.9, 0.0),
    angles: tuple[float, ...] = (1.0, -1.0, -1.4),
    **crank: Any,
) -> Scene:
    """A crank of 0.5 m, a coupler of 1 m and a rocker of 0.7 m; 0.9 m between the fixed hinges."""

    def bar(name: str, length: float) -> RigidBody:
        return kit.body(
            name, 1.0, (0.1, 0.1, 0.1), center_of_mass=(0, 0.5 * length, 0), ports={"tip": (0, length, 0)}
        )

    def hinge(name: str, parent: str, position: float, **more: Any) -> Revolute:
        return kit.hinge(name, parent, name, (1, 0, 0), position=position, **more)

    axis = {"axis": (1, 0, 0)} if kind == "revolute" else {}
    return kit.scene(
        "four_bar",
        *map(bar, "abc", lengths),
        mbdlft.Ground(ports={"hook": hook}),
        hinge("a", "ground", angles[0], **crank),
        hinge("b", "a.tip", angles[1], preload=0.0),
        hinge("c", "b.tip", angles[2], preload=0.0),
        kit.loop("close", kind, "c.tip", "ground.hook", **axis),
        gravity=(0, 0, -G),
    )


@pytest.mark.parametrize("kind", ["revolute", "spherical"])
def test_loop_is_closed(kind: str) -> None:
    """The joint between coupler and rocker lies on two circles."""
    points = mbdlft.find_equilibrium(four_bar(kind), starts=20, every=True)
    assert len(points) == 2
    crank, hook = 0.5 * np.exp(1j), 0.9
    apart = abs(hook - crank)
    along = (1.0 - 0.7**2 + apart**2) / (2 * apart)
    both = along + 1j * np.array([1, -1]) * np.sqrt(1.0 - along**2)
    corners = crank + both * (hook - crank) / apart
    expected = {np.round(float(np.angle((corner - crank) / np.exp(1j))), 9) for corner in corners}
    found = {np.round(point.positions["b.angle"], 9) for point in points}
    assert found == expected
    for point in points:
        torque = mbdlft.solve_trim(mbdlft.assemble(mbdlft.at_equilibrium(four_bar(kind), point))).values
        roundoff(torque[0], point.efforts["a.torque"], kappa=100.0)


@pytest.mark.parametrize(
    ("hook", "angles", "count"),
    [((0.0, 0.0, -0.9), (-1.57, 0.0, 3.1), 2), ((0.0, 0.9, 0.0), (0.1, 0.0, 3.1), 8)],
)
def test_a_flat_loop_is_one_equilibrium(
    hook: tuple[float, ...], angles: tuple[float, ...], count: int
) -> None:
    """A parallelogram whose bars are all on a line: steps halve the way there, and ended 2e-5 off."""
    scene = four_bar("revolute", (0.5, 0.9, 0.5), hook, angles, preload=0.0)
    assert len(mbdlft.find_equilibrium(scene, starts=60, seed=1, every=True)) == count


def test_ball_finds_down() -> None:
    """A body on a ball joint hangs with its center under the ball; it may turn about the vertical."""
    tilt = kit.turn((1, 2, 3), 1.9)
    scene = kit.scene(
        "ball",
        kit.body("body", 1.5, (0.1, 0.2, 0.3), center_of_mass=(0.2, -0.3, 0.1)),
        kit.ball("ball", "ground", "body", orientation=[tilt], preload=(0.0, 0.0, 0.0)),
        gravity=(0, 0, -G),
    )
    point = mbdlft.find_equilibrium(scene, starts=20)
    assert set(point.undetermined) <= {f"ball.rotation.{axis}" for axis in "xyz"}
    assert point.undetermined
    moved = mbdlft.at_equilibrium(scene, point)
    R = np.eye(3)
    for turn in moved.joints[0].orientation:
        axis = np.asarray(turn.axis) / np.linalg.norm(turn.axis)
        cross = np.cross(np.eye(3), axis)
        R = R @ (np.eye(3) + np.sin(turn.angle) * cross + (1 - np.cos(turn.angle)) * cross @ cross)
    center = R @ [0.2, -0.3, 0.1]
    roundoff(center[:2], np.zeros(2), kappa=10.0)
    mbdlft.solve_trim(mbdlft.assemble(moved))


def test_a_parameter_may_be_unknown() -> None:
    """The mass with which the pendulum with a given torque is level: m = tau/(g L)."""
    scene = pendulum(position=float(np.pi / 2), stiffness=0.0, preload=2.3 * G * 0.8)
    point = mbdlft.find_equilibrium(scene, positions=["m"])
    roundoff(point.parameters["m"], 2.3, kappa=10.0)
    assert point.found == ("m",)
    moved = mbdlft.at_equilibrium(scene, point)
    roundoff(moved.parameters[0].nominal, 2.3, kappa=10.0)


def test_bounds_choose_the_equilibrium() -> None:
    scene = pendulum(stiffness=0.0)
    down = mbdlft.find_equilibrium(scene)
    up = mbdlft.find_equilibrium(scene, bounds={"hinge": (2.0, 4.0)}, starts=5)
    roundoff(down.positions["hinge.angle"], 0.0)
    roundoff(up.positions["hinge.angle"], np.pi)


def test_same_seed_same_result() -> None:
    known = known_equilibrium(3)
    first, second = (mbdlft.find_equilibrium(known.scene, starts=STARTS, seed=7) for _ in range(2))
    exact(list(first.positions.values()), list(second.positions.values()))


def test_parameters_stay_at_the_equilibrium() -> None:
    """A chain hangs straight for all masses, so its model keeps them and is exact."""
    scene = pendulum(stiffness=0.0)
    model = mbdlft.to_lft(mbdlft.at_equilibrium(scene, mbdlft.find_equilibrium(scene)), search=0.0)
    assert model.certificate.exact
    roundoff(mbdlft.matrices_at(model, {"m": 1.5}).A, [[0, 1], [-G / 0.8, 0]])


def test_conditions_are_those_of_the_model() -> None:
    """Without springs between ports the displaced conditions are the residual of the model at rest."""
    for seed in (2, 5, 11):
        scene = known_equilibrium(seed).scene.model_copy(update={"loads": ()})
        d, first_order = conditions.displace(scene), mbdlft.assemble(scene)
        with forces_turned_on_the_way():
            of_any_size = mbdlft.assemble(scene)
        rng = np.random.default_rng(seed)
        n = d.q.numel()
        q, u = rng.normal(0.0, 0.4, n), rng.normal(0.0, 5.0, d.u.numel())
        rows = ca.Function("rows", [d.q, d.u, d.p], [d.rows, ca.jacobian(d.rows, d.q)])
        roundoff(rows(q, u, 2.3)[0].full(), needed_at_rest(of_any_size, q, u)[0], kappa=10.0)
        for actual, expected in zip(rows(0, u, 2.3), needed_at_rest(first_order, 0, u), strict=True):
            roundoff(actual.full(), expected, kappa=10.0)


def needed_at_rest(e: Equations, q: Any, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Residual of the efforts (n, 1) at displacements, and its derivative (n, n), where p is 2.3."""
    n = e.degrees_of_freedom
    symbols, p, cosine, sine = physical_symbols(e.parameters)
    residual, _ = equation_function(e)(e.xdot, e.x, e.z, e.u, load_value(e, p), p, cosine, sine)
    efforts = residual[n : 2 * n]
    slope = ca.jacobian(efforts, e.x)[:, :n]
    full = ca.Function("full", [e.xdot, e.x, e.u, symbols], [efforts, slope])
    found = full(0, ca.vertcat(q * np.ones(n), np.zeros(n)), u, 2.3)
    return found[0].full(), found[1].full()


def whirling(rate: float | str, **fields: Any) -> Scene:
    """A pendulum of 0.8 m on a vertical axis that spins: cos(theta) = g/(L rate^2)."""
    scene = pendulum(position=0.7, stiffness=0.0)
    return scene.model_copy(update={"spin": mbdlft.Spin(axis=(0, 0, 1), rate=rate), **fields})


def test_spinning_pendulum() -> None:
    points = mbdlft.find_equilibrium(whirling(5.0), starts=20, every=True)
    out = float(np.arccos(G / (0.8 * 25.0)))
    angles = sorted(abs(point.positions["hinge.angle"]) for point in points)
    roundoff(angles, [0.0, out, out, np.pi])
    for point in points:
        growing = bool(np.max(mbdlft.eigenvalues_at(whirling(5.0), point).real) > 0.1)
        assert growing == (np.abs(np.cos(point.positions["hinge.angle"])) > 0.9)


def test_fixed_joint_stays_fixed() -> None:
    scene = chain(1)
    scene = scene.model_copy(
        update={
            "bodies": (*scene.bodies, kit.point("tip", 0.5)),
            "joints": (*scene.joints, kit.weld("weld", "b0", "tip")),
        }
    )
    assert set(mbdlft.find_equilibrium(scene).positions) == {"j0.angle"}


def test_elastic_body_keeps_its_shape() -> None:
    """A panel with a mode sags on its hinge as a rigid one does; its model is there."""
    fields: dict[str, Any] = {
        "name": "panel",
        "mass": 2.0,
        "center_of_mass": (0, 0.5, 0),
        "inertia": Inertia(xx=0.3, yy=0.1, zz=0.3),
    }
    mode = mbdlft.Mode(frequency=20.0, damping=0.01, participation=(0, 0, 0.8, 0.5, 0, 0))
    bodies = [RigidBody(**fields), mbdlft.FlexibleBody(**fields, modes=[mode], prestress="neglected")]
    found = []
    for body in bodies:
        hinge = kit.hinge("hinge", "ground", "panel", (1, 0, 0), stiffness=40.0, preload=0.0)
        scene = kit.scene("panel", body, hinge, gravity=(0, 0, -G))
        found.append(mbdlft.find_equilibrium(scene))
        assert found[-1].undetermined == ()
        assert found[-1].efforts == {}
        model = mbdlft.to_lft(mbdlft.at_equilibrium(scene, found[-1]), search=0.0)
        assert model.certificate.max_relative_error <= SCENARIO
    roundoff(found[0].positions["hinge.angle"], found[1].positions["hinge.angle"])
    assert found[0].positions["hinge.angle"] < -0.1
