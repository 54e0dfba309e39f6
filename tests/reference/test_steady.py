"""Steady joint rates against closed forms: gyrostat, dual-spin satellite, top; the column of Ziegler.

Sources: Kane, Likins, Levinson, Spacecraft Dynamics (1983), section 3.6; Hughes, Spacecraft Attitude
Dynamics (1986), chapters 6 and 7. With the momentum h of a rotor along e and the inertia J of the whole,

    J omega' + omega x (J omega + h e) = torque,        h = J_e W.
"""

import numpy as np

import mbdlft
from mbdlft import Inertia, Parameter, RigidBody, Scene, Spin
from tests import kit
from tests.close import CLOSED_FORM, CROSS, published, target
from tests.cross.test_mechanism import points_of

RATE = Parameter("W", 2000.0, low=1000.0, high=4000.0, unit="rpm")
AXIAL = Parameter("Ja", 0.1, percent=20, unit="kg m^2")
RPM = 2.0 * np.pi / 60.0
HUB, ACROSS = np.array([3.0, 4.0, 5.0]), 0.06


def rotor(axial: str | float = "Ja") -> RigidBody:
    return kit.body("rotor", 5.0, (ACROSS, ACROSS, axial))


def hub() -> RigidBody:
    inertia = dict(zip(("xx", "yy", "zz"), map(float, HUB), strict=True))
    return kit.body("hub", 50.0, inertia=Inertia(**inertia))


def gyrostat() -> Scene:
    return kit.scene(
        "gyrostat",
        RATE,
        AXIAL,
        hub(),
        rotor(),
        kit.ball("attitude", "ground", "hub"),
        kit.hinge("wheel", "hub", "rotor", (0, 0, 1), rate="W"),
    )


def test_gyrostat_precesses_and_is_minimal() -> None:
    """J_x w_x' = -h w_y, J_y w_y' = h w_x: W twice, J_e three times, and no angle of the wheel."""
    model = mbdlft.to_lft(gyrostat(), search=0.0)
    assert model.certificate.minimal
    assert dict(zip([p.name for p in model.parameters], model.certificate.order, strict=True)) == {
        "Ja": 3,
        "W": 2,
    }
    assert [s.name for s in model.states][6:] == ["wheel.rate"]
    assert [s.name for s in model.outputs][3:] == ["wheel.rate"]
    for point in points_of(gyrostat()):
        A, B, _, _ = mbdlft.matrices_at(model, point)
        h, (Jx, Jy) = point["Ja"] * point["W"] * RPM, HUB[:2] + ACROSS
        expected = np.zeros((4, 4))
        expected[0, 1], expected[1, 0] = -h / Jx, h / Jy
        target(A[3:, 3:], expected, CLOSED_FORM)
        wheel = np.array([[1.0, -1.0], [-1.0, (HUB[2] + point["Ja"]) / point["Ja"]]]) / HUB[2]
        target(B[5:, 2:], wheel, CLOSED_FORM)


def test_motor_holds_the_rate_against_friction() -> None:
    """The torque at equilibrium is the damping times the rate; an actuator with a gear adds n J W."""
    scene = gyrostat()
    wheel = scene.joints[1].model_copy(
        update={"damping": 2e-4, "actuator_inertia": 3e-3, "gear_ratio": -30.0}
    )
    scene = scene.model_copy(update={"joints": (scene.joints[0], wheel)})
    model = mbdlft.to_lft(scene, search=0.0)
    assert "wheel.torque" in [signal.name for signal in model.trim.signals]
    for point in points_of(scene):
        W = point["W"] * RPM
        trim = dict(
            zip([s.name for s in model.trim.signals], np.ravel(mbdlft.trim_at(model, point)), strict=True)
        )
        target(trim["wheel.torque"], 2e-4 * W, CLOSED_FORM)
        A = mbdlft.matrices_at(model, point).A
        h = (point["Ja"] - 30.0 * 3e-3) * W
        target(A[3, 4], -h / (HUB[0] + ACROSS), CLOSED_FORM)


def test_dual_spin_satellite_nutates() -> None:
    """A platform that turns with the orbit, and a rotor: the axis nutates at (J_z n + h)/J in space."""
    n = 0.5
    body = kit.body("hub", 1.0, (3.0, 3.0, 5.0))
    scene = gyrostat().model_copy(
        update={"bodies": (body, rotor()), "spin": Spin(axis=(0, 0, 1), rate=n)}
    )
    model = mbdlft.to_lft(scene, search=0.0)
    for point in points_of(scene):
        across, along = 3.0 + ACROSS, 5.0 + point["Ja"]
        nutation = (along * n + point["Ja"] * point["W"] * RPM) / across  # in space
        poles = np.sort(np.abs(np.linalg.eigvals(mbdlft.matrices_at(model, point).A)))
        # rotations about x and y: nutation seen from the frame, and the axis of the momentum
        expected = np.sort([0.0, 0.0, 0.0, n, n, nutation - n, nutation - n])
        target(poles, expected, CROSS, nutation)


def test_sleeping_top_becomes_stable() -> None:
    """A top on its point: upright and stable for J_e W > 2 sqrt(J m g l), and not below."""
    m, length, J, g = 0.5, 0.1, 6e-3, 9.81
    limit = 2.0 * np.sqrt(J * m * g * length) / 2e-3
    top = kit.body("top", m, (J, J, 2e-3), about="origin", center_of_mass=(0, 0, length))
    scene = kit.scene(
        "top",
        Parameter("W", limit, percent=50, unit="rad/s"),
        kit.body("cap", 0.0, (0, 0, 0)),
        top,
        kit.cross("point", "ground", "cap", axis1=(1, 0, 0), axis2=(0, 1, 0)),
        kit.hinge("spin", "cap", "top", (0, 0, 3), rate="W", orientation=[kit.turn((0, 0, 1), "25*deg")]),
        gravity=(0, 0, -g),
        inputs=["point.torque.1"],
        outputs=["point.angle.1"],
    )
    model = mbdlft.to_lft(scene, search=0.0)
    for W in (0.99 * limit, 1.01 * limit):
        poles = np.linalg.eigvals(model.at(W=W).A)
        roots = np.roots([J, -2e-3 * W, m * g * length])  # w^2 J - w J_e W + m g l = 0
        wanted = np.concatenate([1j * roots, -1j * np.conj(roots), [0.0]])
        found = np.array([wanted[int(np.argmin(np.abs(wanted - pole)))] for pole in poles])
        target(np.max(np.abs(poles - found)), 0.0, CROSS, np.max(np.abs(wanted)))
        assert (np.max(poles.real) > 0.1) == (limit > W)


# The column of Ziegler: a load that follows it, and flutter.

M = mbdlft.Parameter("m", 2.0, percent=50, unit="kg")
LENGTH = mbdlft.Parameter("L", 0.8, low=0.5, high=1.2, unit="m")


def values_of(model: mbdlft.LFTModel) -> dict[str, np.ndarray]:
    """50 random points and all corners."""
    inside, outer = mbdlft.random(model.parameters, 50), mbdlft.corners(model.parameters)
    return {p.name: np.concatenate([inside[p.name], outer[p.name]]) for p in model.parameters}


def pin(name: str, parent: str, child: str, position: float | str = 0.0, **fields) -> mbdlft.Revolute:
    return kit.hinge(name, parent, child, (1, 0, 0), position=position, **fields)


def ziegler(frame: str) -> mbdlft.LFTModel:
    """Two rods with masses 2 m and m at their ends, springs of 1 N m/rad, a load along the last rod."""
    rod = {"ports": {"foot": (0, 0, "-L")}}
    return mbdlft.to_lft(
        kit.scene(
            "ziegler",
            M,
            LENGTH,
            mbdlft.Parameter("P", 2.0, low=0.5, high=3.0, unit="N"),
            kit.point("a", "2*m", **rod),
            kit.point("b", "m", **rod),
            pin("ja", "ground", "a.foot", stiffness=1.0, preload=0),
            pin("jb", "a", "b.foot", stiffness=1.0, preload=0),
            kit.force("P", "b", (0, 0, -1), frame=frame, magnitude="P"),
        ),
        search=0.0,
    )


def ziegler_errors(frame: str = "body") -> None:
    """M = m L^2 [3 1; 1 1], K = [2c - PL, PL - c; -c, c] for the angles to the vertical."""
    model = ziegler(frame)
    v = values_of(model)
    A = mbdlft.matrices_at(model, v).A[:, 2:, :2]
    to_vertical = np.array([[1.0, 0.0], [1.0, 1.0]])
    load, one = v["P"] * v["L"], np.ones(len(A))
    K = np.moveaxis(np.array([[2 - load, load - 1], [-one, one]]), 2, 0)
    mass = (v["m"] * v["L"] ** 2)[:, None, None] * np.array([[3.0, 1.0], [1.0, 1.0]])
    expected = -np.linalg.inv(to_vertical) @ np.linalg.solve(mass, K) @ to_vertical
    target(A, expected, CLOSED_FORM)


def test_column_of_ziegler() -> None:
    ziegler_errors()


def test_flutter_load_of_the_column_of_ziegler() -> None:
    """P L/c = 7/2 - sqrt(2) = 2.086: the discriminant of the frequencies vanishes there."""
    model = ziegler("body")
    loads = np.linspace(2.0, 2.2, 41)
    A = mbdlft.matrices_at(model, {"m": np.full(41, 2.0), "L": np.ones(41), "P": loads}).A
    square = A[:, 2:, :2]
    discriminant = np.trace(square, axis1=1, axis2=2) ** 2 - 4 * np.linalg.det(square)
    polynomial = np.polynomial.Polynomial.fit(loads, discriminant, 2)
    flutter = min(polynomial.roots().real)
    published(round(flutter, 3), "2.086")
    target(flutter, 3.5 - np.sqrt(2.0), CLOSED_FORM)
