"""Rolling without slip: the benchmark bicycle, discs, skates and balls, against published equations."""

from pathlib import Path

import numpy as np
import pytest

import mbdlft
from mbdlft import (
    Free,
    Inertia,
    Parameter,
    Revolute,
    RigidBody,
    Scene,
    robust_stability,
    to_lft,
    worst_case,
)
from mbdlft.multibody import KnifeEdge, Planar, Rolling
from tests import close
from tests.attack.contacts import attack

BICYCLE = mbdlft.load_scene(Path(__file__).parents[2] / "scenarios" / "bicycle.toml")
# Meijaard, Papadopoulos, Ruina, Schwab, Proc. R. Soc. A 463 (2007), equation (5.3) and Table 2
M = [[80.81722, 2.31941332208709], [2.31941332208709, 0.29784188199686]]
C1 = [[0.0, 33.86641391492494], [-0.85035641456978, 1.68540397397560]]
K0 = [[-80.95, -2.59951685249872], [-2.59951685249872, -0.80329488458618]]
K2 = [[0.0, 76.59734589573222], [0.0, 2.65431523794604]]
WEAVE, CAPSIZE = 4.292382536341, 6.024262015388
EIGENVALUES = {  # weave, capsize, castering
    0.0: (3.13164324790656, 5.53094371765393, -3.13164324790656),
    5.0: (-0.77534188219585 + 4.46486771378823j, -0.32286642900409, -14.07838969279822),
}


@pytest.fixture(scope="module")
def bicycle() -> mbdlft.LFTModel:
    return to_lft(BICYCLE, search=0.0)


def test_the_bicycle_has_the_published_matrices(bicycle: mbdlft.LFTModel) -> None:
    names = [state.name for state in bicycle.states]
    assert names == ["lean.rotation.x", "steer.angle", "lean.rate.x", "rear.rate", "steer.rate"]
    q, r, g = [0, 1], [2, 4], 9.81
    for v in (0.0, 1.0, 7.0):
        at = mbdlft.matrices_at(bicycle, {"v": v})
        mass = np.linalg.inv(at.B[r])
        close.target(mass, np.array(M), close.CROSS)
        close.target(-mass @ at.A[np.ix_(r, r)], v * np.array(C1), close.CROSS, 80.0)
        wanted = g * np.array(K0) + v**2 * np.array(K2)
        close.target(-mass @ at.A[np.ix_(r, q)], wanted, close.CROSS, 800.0)


def test_positions_on_which_others_depend_are_states() -> None:
    """The way aside depends on the heading, and all rates on lean and steer; nothing on the way ahead."""
    model = to_lft(BICYCLE.model_copy(update={"outputs": ("lean.position.y",)}), search=0.0)
    positions = ["lean.position.y", "lean.rotation.x", "lean.rotation.z", "steer.angle"]
    assert [s.name for s in model.states] == [*positions, "lean.rate.x", "rear.rate", "steer.rate"]


@pytest.mark.parametrize("v", EIGENVALUES)
def test_the_bicycle_has_the_published_eigenvalues(bicycle: mbdlft.LFTModel, v: float) -> None:
    found = np.linalg.eigvals(mbdlft.matrices_at(bicycle, {"v": v}).A)
    for wanted in EIGENVALUES[v]:
        assert np.min(np.abs(found - wanted)) < close.SIMULATED


def test_the_bicycle_has_the_eigenvalues_of_the_published_matrices(bicycle: mbdlft.LFTModel) -> None:
    for v in range(11):
        stiffness = 9.81 * np.array(K0) + v**2 * np.array(K2)
        both = -np.linalg.solve(np.array(M), np.hstack([stiffness, v * np.array(C1)]))
        wanted = np.linalg.eigvals(np.block([[np.zeros((2, 2)), np.eye(2)], [both]]))
        found = np.linalg.eigvals(mbdlft.matrices_at(bicycle, {"v": v}).A)
        assert max(np.min(np.abs(found - pole)) for pole in wanted) < close.MECHANISM * 20.0


@pytest.mark.long
def test_the_self_stable_range_is_proved() -> None:
    """Inside of the published speeds all is stable, and just outside of them not."""
    constants = {name: BICYCLE.constants[name] for name in BICYCLE.constants}
    constants |= {
        "c": mbdlft.Constant(value=0.08, unit="m"),
        "m_B": mbdlft.Constant(value=85.0, unit="kg"),
    }

    def between(low: float, high: float) -> mbdlft.Bounds:
        speed = Parameter("v", 5.2, low=low, high=high, unit="m/s")
        scene = BICYCLE.model_copy(update={"constants": constants, "parameters": (speed,)})
        return robust_stability(to_lft(scene, search=0.0), leave_out="cyclic", gap=1e-5)

    assert between(WEAVE + 1e-4, CAPSIZE - 1e-4).lower > 1.0
    assert between(WEAVE - 1e-4, 5.5).upper < 1.0
    assert between(5.0, CAPSIZE + 1e-4).upper < 1.0


def test_the_bicycle_is_proved_to_balance_itself_for_trails_and_masses_in_their_ranges() -> None:
    """From 4.5 to 5.7 m/s with 5 % of the trail and of the mass of the rider: all poles but that of the
    speed are left of the axis."""
    others = [p for p in BICYCLE.parameters if p.name != "v"]
    speed = Parameter("v", 5.1, low=4.5, high=5.7, unit="m/s")
    model = to_lft(BICYCLE.model_copy(update={"parameters": (speed, *others)}), search=0.0)
    bounds = worst_case(model, "real part", leave_out="cyclic", gap=0.05)
    assert bounds.lower <= bounds.upper < 0.0


def disc() -> Scene:
    """A rolling disc, upright: mass 2 kg, radius 0.4 m, thin, with a tire r."""
    return Scene(
        name="disc",
        gravity=(0.0, 0.0, -9.81),
        velocity=("W*0.4 [m]", 0.0, 0.0),
        parameters=[
            Parameter("W", 5.0, low=-20.0, high=20.0, unit="rad/s"),
            Parameter("r", 0.05, low=0.0, high=0.1, unit="m"),
        ],
        bodies=[
            # its pitch is its own, and nothing else feels it
            RigidBody(name="yoke", mass=0.0, inertia=Inertia(xx=0.0, yy=0.01, zz=0.0, unchecked=True)),
            RigidBody(name="disc", mass=2.0, inertia=Inertia(xx=0.08, yy=0.16, zz=0.08)),
        ],
        joints=[
            Free(name="base", parent="ground", child="yoke", position=(0.0, 0.0, 0.4)),
            Revolute(name="axle", parent="yoke", child="disc", axis=(0, 1, 0), rate="W", preload=0.0),
        ],
        contacts=[Rolling(name="touch", port="disc", axis=(0, 1, 0), radius=0.4, tire="r")],
        outputs=["base.rotation.x"],
    )


def test_a_rolling_disc_is_stable_above_its_critical_rate() -> None:
    """Lean l of an upright disc: (A + m R^2) l'' = (m g (R - r) - W^2 C (C + m R^2)/A) l, from the
    equations of a disc (Neimark and Fufaev, section III.5, with r = 0) and a round edge that shifts the
    contact: the normal force m g acts r nearer to the center."""
    model = to_lft(disc(), search=0.0)
    m, R, A, C, g = 2.0, 0.4, 0.08, 0.16, 9.81
    for W, r in ((0.0, 0.0), (5.0, 0.1), (12.0, 0.03), (-7.0, 0.02)):
        poles = np.linalg.eigvals(mbdlft.matrices_at(model, {"W": W, "r": r}).A)
        square = (m * g * (R - r) - W**2 * C * (C + m * R * R) / A) / (A + m * R * R)
        wanted = np.sqrt(complex(square))
        for pole in (wanted, -wanted):
            assert np.min(np.abs(poles - pole)) < 1e-6


def sleigh() -> Scene:
    """Chaplygin's sleigh: a knife edge at the origin, the center of mass b ahead of it."""
    return Scene(
        name="sleigh",
        velocity=("v", 0.0, 0.0),
        parameters=[
            Parameter("v", 2.0, low=-3.0, high=3.0, unit="m/s"),
            Parameter("b", 0.3, low=-0.5, high=0.5, unit="m"),
        ],
        bodies=[RigidBody(name="sled", mass=3.0, center_of_mass=("b", 0, 0), inertia=Inertia(zz=0.2))],
        joints=[Planar(name="base", parent="ground", child="sled", axis=(0, 0, 1), preload=(0, 0, 0))],
        contacts=[KnifeEdge(name="edge", port="sled", heading=(1, 0, 0))],
        inputs=["base.torque"],
        outputs=["base.rate"],
    )


def test_chaplygins_sleigh() -> None:
    """(J + m b^2) w' = -m b v w (Neimark and Fufaev, section III.2): one rate decides."""
    model = to_lft(sleigh(), search=0.0)
    at = mbdlft.matrices_at(model, {"v": 1.5, "b": 0.4})
    inertia = 0.2 + 3.0 * 0.4**2
    pole = -3.0 * 0.4 * 1.5 / inertia
    gain = at.C @ np.linalg.solve(2j * np.eye(len(at.A)) - at.A, at.B) + at.D
    assert np.isclose(gain[0, 0], 1.0 / inertia / (2j - pole), rtol=close.CLOSED_FORM)
    assert len(model.states) == 2  # the rate, and the speed along the edge


def test_a_ball_rolls_down_a_slope_with_five_sevenths() -> None:
    ball = Scene(
        name="ball",
        gravity=(0.0, 0.0, -9.81),
        bodies=[RigidBody(name="ball", mass=2.0, inertia=Inertia(xx=0.072, yy=0.072, zz=0.072))],
        joints=[Free(name="base", parent="ground", child="ball", position=(0, 0, 0.3))],
        contacts=[Rolling(name="touch", port="ball", radius=0.3)],
        inputs=["base.force.x"],
        outputs=["base.velocity.x", "touch.force.1", "touch.force.normal"],
    )
    model = to_lft(ball, search=0.0)
    at = mbdlft.matrices_at(model, {})
    assert np.isclose((at.C @ at.B)[0, 0], 5.0 / 7.0 / 2.0, rtol=close.CLOSED_FORM)
    assert np.isclose(at.D[1, 0], -2.0 / 7.0, rtol=close.CLOSED_FORM)  # the friction that turns it
    assert abs(at.D[2, 0]) < close.CROSS
    trim = dict(zip((s.name for s in model.trim.signals), mbdlft.trim_at(model, {}), strict=True))
    assert np.isclose(trim["touch.force.normal"], 2.0 * 9.81, rtol=close.CLOSED_FORM)


@pytest.mark.long
@pytest.mark.parametrize("seed", range(30))
def test_random_vehicles_equal_maximal_coordinates(seed: int, tmp_path: Path) -> None:
    assert attack(seed, tmp_path) in ("right", "refused")
