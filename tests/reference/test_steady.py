"""Steady joint rates against closed forms: gyrostat, dual-spin satellite, top.

Sources: Kane, Likins, Levinson, Spacecraft Dynamics (1983), section 3.6; Hughes, Spacecraft Attitude
Dynamics (1986), chapters 6 and 7. With the momentum h of a rotor along e and the inertia J of the whole,

    J omega' + omega x (J omega + h e) = torque,        h = J_e W.
"""

from collections.abc import Sequence

import numpy as np
import pytest

import mbdlft
from mbdlft import Inertia, Parameter, Revolute, RigidBody, Rotation, Scene, Spherical, Spin
from tests.close import CLOSED_FORM, CROSS, published, target
from tests.cross.test_mechanism import points_of

RATE = Parameter("W", 2000.0, low=1000.0, high=4000.0, unit="rpm")
AXIAL = Parameter("Ja", 0.1, percent=20, unit="kg m^2")
RPM = 2.0 * np.pi / 60.0
HUB, ACROSS = np.array([3.0, 4.0, 5.0]), 0.06


def rotor(axial: str | float = "Ja") -> RigidBody:
    return RigidBody(name="rotor", mass=5.0, inertia=Inertia(xx=ACROSS, yy=ACROSS, zz=axial))


def hub() -> RigidBody:
    inertia = dict(zip(("xx", "yy", "zz"), map(float, HUB), strict=True))
    return RigidBody(name="hub", mass=50.0, inertia=Inertia(**inertia))


def gyrostat() -> Scene:
    return Scene(
        name="gyrostat",
        parameters=[RATE, AXIAL],
        bodies=[hub(), rotor()],
        joints=[
            Spherical(name="attitude", parent="ground", child="hub"),
            Revolute(name="wheel", parent="hub", child="rotor", axis=(0, 0, 1), rate="W"),
        ],
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
    """A platform that turns with the orbit, and a rotor: the axis nutates at (J_z n + h)/J in space.

    Seen from the frame, which turns with n, that is n less; and the axis of the momentum, which
    stands still in space, moves by -n.
    """
    n = 0.5
    body = RigidBody(name="hub", mass=1.0, inertia=Inertia(xx=3.0, yy=3.0, zz=5.0))
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
    top = RigidBody(
        name="top",
        mass=m,
        center_of_mass=(0, 0, length),
        inertia=Inertia(xx=J, yy=J, zz=2e-3, about="origin"),
    )
    scene = Scene(
        name="top",
        gravity=(0, 0, -g),
        parameters=[Parameter("W", limit, percent=50, unit="rad/s")],
        bodies=[RigidBody(name="cap", mass=0.0, inertia=Inertia(xx=0, yy=0, zz=0)), top],
        joints=[
            mbdlft.Universal(
                name="point", parent="ground", child="cap", axis1=(1, 0, 0), axis2=(0, 1, 0)
            ),
            Revolute(
                name="spin",
                parent="cap",
                child="top",
                axis=(0, 0, 3),
                rate="W",
                orientation=[Rotation(axis=(0, 0, 1), angle="25*deg")],
            ),
        ],
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


# Spinning frames against closed forms: flapping and lagging booms, a pendulum on a turntable.

M = mbdlft.Parameter("m", 2.0, percent=50, unit="kg")
LENGTH = mbdlft.Parameter("L", 0.8, low=0.5, high=1.2, unit="m")
OFFSET = mbdlft.Parameter("e", 0.2, low=0.05, high=0.4, unit="m")
RATE_SPIN = mbdlft.Parameter("rate", 2.0, low=0.5, high=4.0, unit="rad/s")
GRAVITY = 9.81
INERTIA = {"xx": 0.02, "yy": 0.3, "zz": 0.31}


def values_of(model: mbdlft.LFTModel) -> dict[str, np.ndarray]:
    """50 random points and all corners."""
    inside, outer = mbdlft.random(model.parameters, 50), mbdlft.corners(model.parameters)
    return {p.name: np.concatenate([inside[p.name], outer[p.name]]) for p in model.parameters}


def boom(axis: tuple[float, ...]) -> mbdlft.Scene:
    """A boom on a hinge at the distance e from the axis of the spin; about -y it flaps, z it lags."""
    return mbdlft.Scene(
        name="boom",
        spin=mbdlft.Spin(axis=(0, 0, 1), rate="rate"),
        parameters=[M, LENGTH, OFFSET, RATE_SPIN],
        bodies=[
            mbdlft.Ground(ports={"hinge": ("e", 0, 0)}),
            mbdlft.RigidBody(
                name="boom", mass="m", center_of_mass=("L", 0, 0), inertia=mbdlft.Inertia(**INERTIA)
            ),
        ],
        joints=[mbdlft.Revolute(name="j", parent="ground.hinge", child="boom", axis=axis, preload=0)],
    )


@pytest.mark.parametrize("axis", [(0, -1, 0), (0, 0, 1)])
def test_flapping_and_lagging_boom(axis: tuple[float, ...]) -> None:
    """Flap: w^2 = W^2 (Jz - Jx + e m L)/J; lag: w^2 = W^2 e m L/J.

    J, Jx, Jz are about the hinge. For a thin boom, Jx = 0 and Jz = J: flap is W sqrt(1 + e m L/J).
    """
    model = mbdlft.to_lft(boom(axis), search=0.0)
    v = values_of(model)
    A = mbdlft.matrices_at(model, v).A
    steiner = v["m"] * v["L"] ** 2
    if axis[2]:
        J, restoring = INERTIA["zz"] + steiner, 0.0
    else:
        J, restoring = INERTIA["yy"] + steiner, INERTIA["zz"] - INERTIA["xx"] + steiner
    expected = v["rate"] ** 2 * (restoring + v["e"] * v["m"] * v["L"]) / J
    target(A[:, 1, 0], -expected, CLOSED_FORM)
    target(A[:, 1, 1], np.zeros(len(J)), CLOSED_FORM, scale=1.0)


def test_pendulum_seen_from_a_turntable() -> None:
    """s^2 + 2 i W s + g/L - W^2 = 0 for x + i y: frequencies W0 - W and W0 + W."""
    scene = mbdlft.Scene(
        name="foucault",
        gravity=(0, 0, -GRAVITY),
        spin=mbdlft.Spin(axis=(0, 0, 1), rate="rate"),
        parameters=[M, LENGTH, RATE_SPIN],
        bodies=[mbdlft.PointMass(name="bob", mass="m", ports={"pivot": (0, 0, "L")})],
        joints=[
            mbdlft.Universal(
                name="j",
                parent="ground",
                child="bob.pivot",
                axis1=(1, 0, 0),
                axis2=(0, 1, 0),
                preload=(0, 0),
            )
        ],
    )
    model = mbdlft.to_lft(scene, search=0.0)
    v = values_of(model)
    A = mbdlft.matrices_at(model, v).A
    found = np.sort(np.abs(np.linalg.eigvals(A).imag), axis=1)[:, ::2]
    swing = np.sqrt(GRAVITY / v["L"])
    expected = np.sort(np.stack([np.abs(swing - v["rate"]), swing + v["rate"]], axis=1), axis=1)
    target(found, expected, CLOSED_FORM)


# Springs and axial loads against closed forms of textbooks.

K = mbdlft.Parameter("k", 90.0, low=60.0, high=150.0, unit="N/m")


def pin(name: str, parent: str, child: str, position: float | str = 0.0, **fields) -> mbdlft.Revolute:
    return mbdlft.Revolute(
        name=name, parent=parent, child=child, axis=(1, 0, 0), position=position, **fields
    )


def string(length: float | str, parameters: Sequence[mbdlft.Parameter], **fields: object) -> mbdlft.Scene:
    """A mass in the middle of a string of two springs, free along it and across it."""
    side = {"parent": "bead", "stiffness": "k", "damping": 3.0, **fields}
    opposite = f"-{length}" if isinstance(length, str) else -length
    return mbdlft.Scene(
        name="string",
        parameters=[M, K, *parameters],
        bodies=[
            mbdlft.Ground(ports={"left": (opposite, 0, 0), "right": (length, 0, 0)}),
            mbdlft.RigidBody(name="frame", mass=0),
            mbdlft.PointMass(name="bead", mass="m"),
        ],
        joints=[
            mbdlft.Prismatic(name="x", parent="ground", child="frame", axis=(1, 0, 0), preload=0),
            mbdlft.Prismatic(name="y", parent="frame", child="bead", axis=(0, 1, 0), preload=0),
        ],
        loads=[
            mbdlft.Spring(name="a", child="ground.left", **side),
            mbdlft.Spring(name="b", child="ground.right", **side),
        ],
    )


def test_mass_on_a_tight_string() -> None:
    """A mass in the middle of a tight string: 2 T/a across it, 2 k along it."""
    tension = mbdlft.Parameter("T", 20.0, percent=40, unit="N")
    scene = string("L", [LENGTH, tension], force_density="T/L")
    model = mbdlft.to_lft(scene, search=0.0)
    v = values_of(model)
    A = mbdlft.matrices_at(model, v).A
    nothing = np.zeros(len(A))
    expected = [
        [-2 * v["k"] / v["m"], nothing, -6.0 / v["m"], nothing],
        [nothing, -2 * v["T"] / v["L"] / v["m"], nothing, nothing],
    ]
    target(A[:, 2:], np.moveaxis(expected, 2, 0), CLOSED_FORM)


def test_mass_between_stretched_springs() -> None:
    """The tension of a spring that is 0.8 m long and 0.5 m at rest is k (0.8 - 0.5)."""
    model = mbdlft.to_lft(string(0.8, [], rest_length=0.5), search=0.0)
    v = values_of(model)
    across = mbdlft.matrices_at(model, v).A[:, 3, 1]
    target(across, -2.0 * v["k"] * (0.8 - 0.5) / 0.8 / v["m"], CLOSED_FORM)


@pytest.mark.parametrize(("frame", "sinking"), [("ground", 1.0), ("body", 0.0)])
def test_column_on_a_spring_under_an_axial_load(frame: str, sinking: float) -> None:
    """m L^2 qdd + (c - P L) q = 0 for a dead load P; a load that follows the column does nothing."""
    scene = mbdlft.Scene(
        name="column",
        parameters=[M, LENGTH, mbdlft.Parameter("P", 20.0, percent=90, unit="N")],
        bodies=[mbdlft.PointMass(name="tip", mass="m", ports={"foot": (0, 0, "-L")})],
        joints=[pin("foot", "ground", "tip.foot", stiffness=15.0, preload=0)],
        loads=[mbdlft.Force(name="P", port="tip", direction=(0, 0, -1), frame=frame, magnitude="P")],
    )
    model = mbdlft.to_lft(scene, search=0.0)
    v = values_of(model)
    stiffness = 15.0 - sinking * v["P"] * v["L"]
    expected = -stiffness / (v["m"] * v["L"] ** 2)
    size = float(np.max((15.0 + v["P"] * v["L"]) / (v["m"] * v["L"] ** 2)))
    target(mbdlft.matrices_at(model, v).A[:, 1, 0], expected, CLOSED_FORM, scale=size)


def ziegler(frame: str) -> mbdlft.LFTModel:
    """Two rods with masses 2 m and m at their ends, springs of 1 N m/rad, a load along the last rod."""
    rod = {"ports": {"foot": (0, 0, "-L")}}
    return mbdlft.to_lft(
        mbdlft.Scene(
            name="ziegler",
            parameters=[M, LENGTH, mbdlft.Parameter("P", 2.0, low=0.5, high=3.0, unit="N")],
            bodies=[
                mbdlft.PointMass(name="a", mass="2*m", **rod),
                mbdlft.PointMass(name="b", mass="m", **rod),
            ],
            joints=[
                pin("ja", "ground", "a.foot", stiffness=1.0, preload=0),
                pin("jb", "a", "b.foot", stiffness=1.0, preload=0),
            ],
            loads=[mbdlft.Force(name="P", port="b", direction=(0, 0, -1), frame=frame, magnitude="P")],
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
