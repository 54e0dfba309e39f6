"""Rolling without slip: the benchmark bicycle, discs, skates and balls, against published equations."""

from pathlib import Path

import numpy as np
import pytest

import mbdlft
from mbdlft import Parameter, Scene, robust_stability, to_lft, worst_case
from mbdlft.multibody import KnifeEdge, Rolling
from tests import close, kit

FOLDER = Path(__file__).parents[2] / "scenarios"
BICYCLE = mbdlft.load_scene(FOLDER / "bicycle.toml")
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


def of_the_paper(p: dict[str, float]) -> list[np.ndarray]:
    """M, C1, K0 and K2 by the 25 parameters: appendix A of Meijaard et al., z downward."""
    w, c, tilt = p["w"], p["c"], np.radians(p["tilt"])
    x, m, J = {"B": p["x_B"], "H": p["x_H"]}, {k: p[f"m_{k}"] for k in "RBHF"}, p
    z = {"R": -p["r_R"], "B": -p["z_B"], "H": -p["z_H"], "F": -p["r_F"]}
    x |= {"R": 0.0, "F": w}
    sine, cosine = np.sin(tilt), np.cos(tilt)
    zz = {"R": J["R_xx"], "B": J["B_zz"], "H": J["H_zz"], "F": J["F_xx"]}

    def whole(parts: str) -> tuple[float, float, float]:
        mass = sum(m[k] for k in parts)
        return mass, sum(m[k] * x[k] for k in parts) / mass, sum(m[k] * z[k] for k in parts) / mass

    m_T, _, z_T = whole("RBHF")
    T_xx = sum(J[f"{k}_xx"] + m[k] * z[k] ** 2 for k in "RBHF")
    T_xz = J["B_xz"] + J["H_xz"] - sum(m[k] * x[k] * z[k] for k in "BHF")
    T_zz = sum(zz[k] + m[k] * x[k] ** 2 for k in "RBHF")
    m_A, x_A, z_A = whole("HF")
    A_xx = sum(J[f"{k}_xx"] + m[k] * (z[k] - z_A) ** 2 for k in "HF")
    A_xz = J["H_xz"] - sum(m[k] * (x[k] - x_A) * (z[k] - z_A) for k in "HF")
    A_zz = sum(zz[k] + m[k] * (x[k] - x_A) ** 2 for k in "HF")
    u = (x_A - w - c) * cosine - z_A * sine
    about = m_A * u**2 + A_xx * sine**2 + 2.0 * A_xz * sine * cosine + A_zz * cosine**2
    A_x = -m_A * u * z_A + A_xx * sine + A_xz * cosine
    A_z = m_A * u * x_A + A_xz * sine + A_zz * cosine
    mu, front = c / w * cosine, J["F_yy"] / p["r_F"]
    spin, static = J["R_yy"] / p["r_R"] + front, m_A * u + mu * whole("RBHF")[1] * m_T
    both = mu * spin + front * cosine
    return [
        np.array([[T_xx, A_x + mu * T_xz], [A_x + mu * T_xz, about + 2.0 * mu * A_z + mu**2 * T_zz]]),
        np.array([
            [0.0, both + T_xz / w * cosine - mu * m_T * z_T],
            [-both, A_z / w * cosine + mu * (static + T_zz / w * cosine)],
        ]),
        np.array([[m_T * z_T, -static], [-static, -static * sine]]),
        np.array([[0.0, (spin - m_T * z_T) / w * cosine], [0.0, (static + front * sine) / w * cosine]]),
    ]  # fmt: skip


def test_all_25_parameters_are_those_of_the_paper() -> None:
    scene = mbdlft.load_scene(FOLDER / "whipple_bicycle.toml")
    assert len(scene.parameters) == 26  # and the speed
    nominal = of_the_paper({p.name: p.nominal for p in scene.parameters})
    for found, printed in zip(nominal, (M, C1, K0, K2), strict=True):
        close.target(found, np.array(printed), close.CLOSED_FORM)
    model = to_lft(scene, search=0.0)
    assert (model.order, model.certificate.order_bound) == (72, 58)
    names = [state.name for state in model.states]
    q, r = [names.index(x) for x in ("lean.rotation.x", "steer.angle")], [2, 4]
    samples = mbdlft.random(scene.parameters, 5, seed=25)
    for k in range(5):
        point = {p.name: float(samples[p.name][k]) for p in scene.parameters}
        mass, damping, gravity, centrifugal = of_the_paper(point)
        at, v = mbdlft.matrices_at(model, point), point["v"]
        close.target(np.linalg.inv(at.B[r]), mass, close.CLOSED_FORM, 100.0)
        close.target(mass @ -at.A[np.ix_(r, r)], v * damping, close.CLOSED_FORM, 400.0)
        wanted = 9.81 * gravity + v**2 * centrifugal
        close.target(mass @ -at.A[np.ix_(r, q)], wanted, close.CLOSED_FORM, 8000.0)


WHIPPLE = mbdlft.load_scene(FOLDER / "whipple_bicycle.toml")


def between(low: float, high: float, keep: tuple[str, ...] = ()) -> mbdlft.LFTModel:
    """The bicycle from one speed to another; others than `keep` have their nominal values."""
    speed = Parameter("v", 5.1, low=low, high=high, unit="m/s")
    scene = fixed(WHIPPLE, ("v", *keep))
    kept = [p for p in scene.parameters if p.name != "v"]
    return to_lft(scene.model_copy(update={"parameters": (speed, *kept)}), search=0.0)


def fixed(scene: Scene, keep: tuple[str, ...]) -> Scene:
    """Numbers in place of all parameters that are not kept."""
    others = [p for p in scene.parameters if p.name not in keep]
    constants = {p.name: mbdlft.Constant(value=p.nominal, unit=p.unit) for p in others}
    return scene.model_copy(
        update={
            "constants": {**scene.constants, **constants},
            "parameters": tuple(p for p in scene.parameters if p.name in keep),
        }
    )


def test_the_self_stable_range_is_proved() -> None:
    """Inside of the published speeds all is stable, and just outside of them not."""
    for low, high, is_stable in (
        (WEAVE + 1e-5, CAPSIZE - 1e-5, True), (WEAVE - 1e-5, 5.5, False), (5.0, CAPSIZE + 1e-5, False),
    ):  # fmt: skip
        bounds = robust_stability(between(low, high), leave_out="cyclic", gap=1e-6)
        assert bounds.lower > 1.0 if is_stable else bounds.upper < 1.0


MASSES_AND_TRAIL = ("m_R", "m_B", "m_H", "m_F", "c")


@pytest.mark.long
def test_the_self_stable_range_is_proved_for_all_masses_and_trails() -> None:
    """Within 5 % of four masses and the trail the bicycle balances itself from 4.417 to 5.757 m/s, and at
    some corners no longer at 4.415 and 5.759 m/s."""
    inside = between(4.417, 5.757, MASSES_AND_TRAIL)
    assert robust_stability(inside, leave_out="cyclic", gap=1e-3).lower > 1.0
    bounds = worst_case(inside, "real part", leave_out="cyclic", gap=0.05)
    assert bounds.lower <= bounds.upper < 0.0
    for low, high in ((4.415, 5.5), (4.9, 5.759)):
        outside = between(low, high, MASSES_AND_TRAIL)
        assert robust_stability(outside, leave_out="cyclic", gap=1e-4).upper < 1.0


def sleigh() -> Scene:
    """Chaplygin's sleigh: a knife edge at the origin, the center of mass b ahead of it."""
    return kit.scene(
        "sleigh",
        Parameter("v", 2.0, low=-3.0, high=3.0, unit="m/s"),
        Parameter("b", 0.3, low=-0.5, high=0.5, unit="m"),
        kit.body("sled", 3.0, zz=0.2, center_of_mass=("b", 0, 0)),
        kit.planar("base", "ground", "sled", (0, 0, 1), preload=(0, 0, 0)),
        KnifeEdge(name="edge", port="sled", heading=(1, 0, 0)),
        velocity=("v", 0.0, 0.0),
        inputs=["base.torque"],
        outputs=["base.rate"],
    )


def test_chaplygins_sleigh() -> None:
    """(J + m b^2) w' = -m b v w (Neimark and Fufaev, section III.2): one rate decides."""
    model = to_lft(sleigh(), search=0.0)
    inertia = 0.2 + 3.0 * 0.4**2
    pole = -3.0 * 0.4 * 1.5 / inertia
    gain = kit.transfer(model, 2j, {"v": 1.5, "b": 0.4})
    assert np.isclose(gain[0, 0], 1.0 / inertia / (2j - pole), rtol=close.CLOSED_FORM)
    assert len(model.states) == 2  # the rate, and the speed along the edge


def test_a_ball_rolls_down_a_slope_with_five_sevenths() -> None:
    ball = kit.scene(
        "ball",
        kit.body("ball", 2.0, (0.072, 0.072, 0.072)),
        kit.free("base", "ground", "ball", position=(0, 0, 0.3)),
        Rolling(name="touch", port="ball", radius=0.3),
        gravity=(0.0, 0.0, -9.81),
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


def test_a_ball_is_held_on_an_inclined_plane() -> None:
    """On a slope of 3 in 4: the load is m g 3/5 along the slope, the ground carries m g 4/5."""
    ball = kit.scene(
        "ball",
        kit.body("ball", 2.0, (0.072, 0.072, 0.072)),
        kit.free("base", "ground", "ball", position=(-0.18, 0, 0.24), preload=(0,) * 6),
        kit.force("hold", "ball", (4, 0, 3), frame="ground"),
        Rolling(name="touch", port="ball", radius=0.3, normal=(-3, 0, 4)),
        gravity=(0.0, 0.0, -10.0),
        inputs=["hold.force"],
        outputs=["base.velocity.x", "base.velocity.z", "touch.force.normal"],
    )
    model = to_lft(ball, search=0.0)
    trim = dict(zip((s.name for s in model.trim.signals), mbdlft.trim_at(model, {}), strict=True))
    assert np.isclose(trim["hold.force"], 12.0, rtol=close.CLOSED_FORM)
    assert np.isclose(trim["touch.force.normal"], 16.0, rtol=close.CLOSED_FORM)
    at = mbdlft.matrices_at(model, {})
    close.target((at.C @ at.B)[:, 0], 5.0 / 14.0 * np.array([0.8, 0.6, 0.0]), close.CLOSED_FORM)


def test_two_wheels_on_an_axle_that_turns() -> None:
    """Centrifugal loads of the wheels cancel in each row; x and pitch by hand, as Lagrange has them."""
    scene = mbdlft.load_scene(FOLDER / "segway.toml")
    W = Parameter("W", 1.0, 0.5, 2.5, unit="rad/s")
    rate = mbdlft.Spin(axis=(0, 0, 1), rate="W")
    turning = scene.model_copy(update={"spin": rate, "parameters": (*scene.parameters, W)})
    model, R, b = to_lft(turning, search=0.0), 0.2, 0.3
    for m, h, d, w in ((100.0, 0.8, 0.6, 2.5), (50.0, 1.0, 0.3, 1.2)):
        first, tilts = np.array([[m + 6.0, m * h], [m * h, m * h**2]]), np.diag([0.0, 1.0])
        inertia = first + 12.0 * tilts + np.diag([0.12 / R**2, 0.0])
        stiffness = w**2 * (first + (12.0 - 2.0) * tilts) + m * 9.81 * h * tilts
        damping = 2.0 * d * np.outer([1 / R, -1], [1 / R, -1])
        moving = np.linalg.solve(inertia, np.hstack([stiffness, -damping]))
        yaw = -2.0 * d * (b / R) ** 2 / (2.0 + 2.0 * (0.03 + 3.0 * b**2) + 0.12 * (b / R) ** 2)
        wanted = [*np.linalg.eigvals(np.vstack([np.eye(4)[2:], moving])), yaw]
        found = np.linalg.eigvals(mbdlft.matrices_at(model, {"m": m, "h": h, "damping": d, "W": w}).A)
        close.target(np.sort(found), np.sort(wanted), close.CLOSED_FORM, 20.0)
