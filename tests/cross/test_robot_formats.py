"""Robots of SDF and MJCF files against pinocchio, MuJoCo, and the same robots in other formats."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mbdlft
from benchmarks.cases.public import REFERENCES, across, by_mujoco_of, following
from benchmarks.cases.robots import by_pinocchio
from benchmarks.public_robots import difference, files, installed, outcome, table
from benchmarks.targets import PUBLIC
from mbdlft.multibody.scene.scene import Scene
from tests import random_mjcf
from tests.close import CLOSED_FORM, PINOCCHIO, target
from tests.robot_files import as_mjcf, as_sdf, as_urdf, chain

pytestmark = pytest.mark.usefixtures("read_here")

pytest.importorskip("mujoco", reason="MJCF needs mujoco: pip install -e '.[robots]'")
pytest.importorskip("pinocchio", reason="robots are compared with pinocchio: '.[robots]'")

ANGLE = 0.7
WRITTEN = {
    "urdf": as_urdf,
    "sdf": as_sdf,
    "sdf 1.6": lambda links: as_sdf(links, "1.6"),
    "sdf 1.4": lambda links: as_sdf(links, "1.4"),
    "xml": as_mjcf,
}


def model_of(folder: Path, form: str, seed: int) -> mbdlft.LFTModel:
    """The chain with its first angle and the mass of its last link as parameters."""
    file = folder / f"chain.{form.partition(' ')[0]}"
    file.write_text(WRITTEN[form](chain(seed)), encoding="utf-8")
    scene, _ = mbdlft.load_robot(
        file,
        parameters=[mbdlft.Angle("theta", 0.2, -1.0, 1.5, unit="rad")],
        values={"joint1.position": "theta", "joint0.position": 0.3},
        vary={"link2.mass": 20.0},
        right_angle=0.0,
    )
    return mbdlft.to_lft(scene, search=0.0)


def matrices(model: mbdlft.LFTModel, mass: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    point = {"theta": ANGLE, "link2_mass": mass}
    A, B, _, _ = mbdlft.matrices_at(model, point)
    return A, B, mbdlft.trim_at(model, point)


@pytest.mark.parametrize(("form", "seed"), [*((form, 1) for form in WRITTEN), ("sdf", 2), ("xml", 2)])
def test_chain_equals_pinocchio(tmp_path: Path, form: str, seed: int) -> None:
    links = chain(seed)
    A, B, efforts = matrices(model_of(tmp_path, form, seed), links[2].mass)
    text = as_urdf(links)
    rest = by_pinocchio(text, {"joint0": 0.3, "joint1": ANGLE}, free=False)
    inverse = np.linalg.inv(rest.M)
    target(B[3:], inverse, PINOCCHIO)
    target(A[3:, :3], -inverse @ rest.K, PINOCCHIO)
    target(A[3:, 3:], -inverse @ rest.D, PINOCCHIO)
    target(efforts, rest.effort, PINOCCHIO)


# what MJCF files can have ----------------------------------------------------------------------

FRAME = (
    '<mujoco><compiler angle="radian" autolimits="true"/><option gravity="0.5 0 -9.81"/>'
    "{more}<worldbody>{bodies}</worldbody>{rest}</mujoco>"
)
BAR = '<geom type="capsule" fromto="0 0 0 .1 .2 .4" size=".03"/>'
TENDONS = "fixed tendons: a spring, a damper beside a slack spring, and an equality"
CASES = {
    "a joint that an equality couples with another one": FRAME.format(
        more="",
        bodies=f'<body name="a"><joint name="j" axis="0 1 0"/>{BAR}<body name="b" pos=".1 .2 .4"><joint '
        f'name="k" axis="1 0 0" stiffness="2"/>{BAR}<body name="c" pos="0 0 .3"><joint name="l" '
        f'type="slide" axis="0 0 1" armature=".3"/>{BAR}</body></body></body>',
        rest='<equality><joint joint1="k" joint2="j" polycoef=".2 -1.5 0 0 0"/></equality>',
    ),
    TENDONS: FRAME.format(
        more="",
        bodies=f'<body name="a"><joint name="j" axis="0 1 0" stiffness="9"/>{BAR}<body name="b" '
        f'pos=".1 .2 .4"><joint name="k" axis="1 0 0" ref=".2"/>{BAR}<body name="c" pos="0 0 .3"><joint '
        f'name="l" type="slide" axis="0 0 1" armature=".3"/>{BAR}<body name="d" pos="0 0 .3"><joint '
        f'name="m" axis="1 1 0"/>{BAR}</body></body></body></body>',
        rest='<tendon><fixed name="t" stiffness="3" springlength=".1"><joint joint="j" coef="2"/><joint '
        'joint="k" coef="-1"/><joint joint="l" coef=".5"/></fixed><fixed name="u" stiffness="70" damping='
        '".4" springlength="-1 1"><joint joint="k" coef="2"/><joint joint="m" coef="1"/></fixed><fixed '
        'name="v"><joint joint="l" coef="2"/><joint joint="m" coef=".3"/></fixed></tendon>'
        '<equality><tendon tendon1="v" tendon2="t" polycoef="0 .4 0 0 0"/></equality>',
    ),
    "a hinge with a spring, a reference and a rotor": FRAME.format(
        more="",
        bodies='<body name="a" quat="1 .2 .3 .4"><joint name="j" axis="0 1 1" pos=".1 0 0" ref=".3" '
        f'springref=".5" stiffness="3" damping=".2" armature=".4" range="-2 2"/>{BAR}<body name="b" '
        f'pos=".1 .2 .4"><joint name="k" axis="1 0 0" armature=".2"/>{BAR}</body></body>',
        rest="",
    ),
    "three joints of one body, and a ball": FRAME.format(
        more='<default><joint damping=".1"/></default>',
        bodies='<body name="a" pos="0 0 1" euler=".3 .4 .5"><joint name="x" type="slide" axis="1 0 0"/>'
        '<joint name="y" type="slide" axis="0 1 .2"/><joint name="r" axis="0 0 1" pos=".1 .2 .3"/>'
        f'{BAR}<body name="b" pos=".1 .2 .4"><joint name="ball" type="ball" stiffness="2" '
        f'armature=".01"/>{BAR}</body></body>',
        rest="",
    ),
    "a free body that is turned, with an arm, thrusters and sensors": FRAME.format(
        more="",
        bodies=f'<body name="a" pos="1 2 3" quat=".5 .1 .7 .2"><freejoint name="f"/>{BAR}'
        f'<site name="s" pos="0 .1 0" euler=".1 .2 .3"/><body name="b" pos=".1 .2 .4" gravcomp=".7">'
        f'<joint name="j" axis="1 1 0" range=".2 1"/>{BAR}</body></body>',
        rest='<actuator><motor site="s" gear="0 0 2 0 0 .1"/><motor joint="j" gear="3"/></actuator>'
        '<sensor><gyro site="s"/><accelerometer name="acc" site="s"/><jointvel joint="j"/></sensor>',
    ),
    "servos": FRAME.format(
        more="",
        bodies=f'<body name="a"><joint name="j" axis="0 1 0"/>{BAR}<body name="b" pos=".1 .2 .4"><joint '
        f'name="k" axis="1 0 0"/>{BAR}</body></body>',
        rest='<actuator><position joint="j" kp="20" kv="3" gear="2"/><velocity joint="k" kv="4"/>'
        '<motor joint="k" gear="5" armature=".01"/></actuator>',
    ),
    "units, a fixed body and shapes of any density": FRAME.format(
        more="",
        bodies='<body name="a" euler="0 0 1.5707963267948966"><body name="w" pos="0 0 .3">'
        '<geom type="box" size=".1 .2 .3" density="500"/></body><joint name="j" axis="0 3 0"/>'
        f'<geom type="ellipsoid" size=".1 .2 .05" mass="2"/>{BAR}</body>',
        rest="",
    ).replace('compiler angle="radian"', 'compiler angle="radian" fusestatic="true"'),
}  # fmt: skip


def rest_of(file: Path) -> tuple[Scene, float, str]:
    """The scene of a file, and its largest error against MuJoCo."""
    scene, _ = mbdlft.load_robot(file)
    scene = Scene(**{**dict(scene), "inputs": None, "outputs": None})
    reference = by_mujoco_of(file, scene)
    assert not isinstance(reference, str), reference
    model = mbdlft.to_lft(scene, search=0.0)
    return scene, *difference(model, following(reference, scene, model))


@pytest.mark.parametrize("name", CASES)
def test_mjcf_equals_mujoco(tmp_path: Path, name: str) -> None:
    file = tmp_path / "robot.xml"
    file.write_text(CASES[name], encoding="utf-8")
    _, error, where = rest_of(file)
    assert error <= PUBLIC, where


def test_tendons_pull_as_in_mujoco(tmp_path: Path) -> None:
    """The Jacobian of the equality, and the efforts at rest beside springs."""
    import mujoco

    file = tmp_path / "robot.xml"
    text = CASES[TENDONS].replace("</mujoco>", '<actuator><motor joint="l"/></actuator></mujoco>')
    file.write_text(text, encoding="utf-8")
    scene, _ = mbdlft.load_robot(file)
    robot = mujoco.MjModel.from_xml_path(str(file))
    data = mujoco.MjData(robot)
    mujoco.mj_forward(robot, data)
    row = data.efc_J.reshape(data.nefc, robot.nv)[0]
    coupling = next(each for each in scene.couplings if each.stiffness is None)
    names = [joint.name for joint in scene.joints]
    factors = [coupling.factors.get(name, 0.0) for name in names]
    target(np.array(factors), row, CLOSED_FORM)
    load = data.qfrc_bias - data.qfrc_passive
    held = names.index("m")  # l has a drive, and m is the next one
    model = mbdlft.to_lft(Scene(**{**dict(scene), "inputs": None, "outputs": None}), search=0.0)
    trim = dict(zip((s.name for s in model.trim.signals), mbdlft.trim_at(model, {}), strict=True))
    pulled = load - load[held] / row[held] * row
    for k, joint in enumerate(scene.joints):
        if k != held:
            target(trim[f"{joint.name}.{joint.freedoms[0].effort.name}"], pulled[k], CLOSED_FORM)


SHORT = (20, 24, 36)  # with free bodies, balls, slides
LONG = [pytest.param(k, marks=pytest.mark.long) for k in range(60) if k not in SHORT]


@pytest.mark.parametrize("seed", [*SHORT, *LONG])
def test_random_mjcf_equals_mujoco_at_a_keyframe(tmp_path: Path, seed: int) -> None:
    """Bodies that are free and on balls are turned, hinges and slides away from their reference."""
    import mujoco

    file = tmp_path / "random.xml"
    text, random = random_mjcf.written(seed), np.random.default_rng(seed)
    model = mujoco.MjModel.from_xml_string(text)
    if model.nv == 0:
        pytest.skip("all bodies are welded")
    start = model.qpos0 + random.uniform(-1.0, 1.0, model.nq)
    mujoco.mj_normalizeQuat(model, start)
    file.write_text(random_mjcf.with_keyframe(text, start), encoding="utf-8")
    scene, _ = mbdlft.load_robot(file, keyframe="k", right_angle=0.0)
    scene = Scene(**{**dict(scene), "inputs": None, "outputs": None})
    reference = by_mujoco_of(file, scene, start)
    assert not isinstance(reference, str), reference
    error, where = difference(mbdlft.to_lft(scene, search=0.0), reference)
    assert error <= PUBLIC, where


def test_scene_of_thrusters_and_sensors(tmp_path: Path) -> None:
    file = tmp_path / "robot.xml"
    file.write_text(CASES["a free body that is turned, with an arm, thrusters and sensors"])
    scene, report = mbdlft.load_robot(file)
    assert scene.inputs == ("j.torque", "actuator_0_force.force", "actuator_0_torque.torque")
    assert scene.outputs is not None
    assert scene.outputs[-7:] == (
        "j.rate", "sensor_0.x", "sensor_0.y", "sensor_0.z", "acc.x", "acc.y", "acc.z",
    )  # fmt: skip
    model = mbdlft.to_lft(scene, search=0.0)
    D = mbdlft.matrices_at(model, {})[3]
    thrust = [signal.name for signal in model.inputs].index("actuator_0_force.force")
    acc = [signal.name for signal in model.outputs].index("acc.x")
    direct = D[acc : acc + 3, thrust]
    assert direct[2] > 0.0  # the thrust is along the z axis of the site, which the sensor has, too
    assert "limits of j exclude 0" in str(report)


def test_loop_of_four_bars_equals_the_energy_of_mujoco(tmp_path: Path) -> None:
    """One coordinate: its inertia is twice the kinetic energy at unit rate, its stiffness V''."""
    file = tmp_path / "four_bar.xml"
    file.write_text(FOUR_BAR, encoding="utf-8")
    scene, _ = mbdlft.load_robot(file)
    model = mbdlft.to_lft(scene, search=0.0)
    A, B, _, _ = mbdlft.matrices_at(model, {})
    inertia, torque, stiffness = by_energy(file)
    target(1.0 / B[1, 0], inertia, 1e-7)
    target(-A[1, 0] / B[1, 0], stiffness, 1e-6)
    target(mbdlft.trim_at(model, {})[0], torque, 1e-8)


FOUR_BAR = FRAME.format(
    more="",
    bodies='<body name="a"><joint name="ja" axis="0 1 0"/>'
    '<geom type="capsule" fromto="0 0 0 .3 0 .4" size=".02"/>'
    '<body name="b" pos=".3 0 .4"><joint name="jb" axis="0 1 0" stiffness=".7" springref=".2"/>'
    '<geom type="capsule" fromto="0 0 0 .6 0 .1" size=".02"/></body></body>'
    '<body name="c" pos=".8 0 0"><joint name="jc" axis="0 1 0" stiffness="2"/>'
    '<geom type="capsule" fromto="0 0 0 .1 0 .5" size=".02"/></body>',
    rest='<equality><connect body1="b" body2="c" anchor=".6 0 .1"/></equality>'
    '<actuator><motor joint="ja"/></actuator>',
)


def by_energy(file: Path) -> tuple[float, float, float]:
    """Inertia, torque and stiffness at the first joint of a four-bar, from its energies by MuJoCo."""
    import mujoco

    model = mujoco.MjModel.from_xml_path(str(file))
    model.opt.enableflags |= mujoco.mjtEnableBit.mjENBL_ENERGY
    data = mujoco.MjData(model)
    end, other = np.array([0.6, 0.0, 0.1]), np.array([0.1, 0.0, 0.5])

    def gap(q: np.ndarray) -> np.ndarray:
        data.qpos = q
        mujoco.mj_forward(model, data)
        b, c = (data.body(name) for name in "bc")
        held = b.xpos + b.xmat.reshape(3, 3) @ end - c.xpos - c.xmat.reshape(3, 3) @ other
        return np.array(held[[0, 2]])

    def slope(function: Any, q: np.ndarray, k: int, h: float = 1e-3) -> Any:
        e = h * np.eye(len(q))[k]
        return (8 * (function(q + e) - function(q - e)) - function(q + 2 * e) + function(q - 2 * e)) / (
            12 * h
        )

    def closed(first: float) -> np.ndarray:
        q = np.array([first, 0.0, 0.0])
        for _ in range(12):
            J = np.column_stack([slope(gap, q, k) for k in (1, 2)])
            q[1:] -= np.linalg.solve(J, gap(q))
        return q

    def potential(first: float) -> float:
        q = closed(first)
        gap(q)
        mujoco.mj_energyPos(model, data)
        return float(data.energy[0])

    q = closed(0.0)
    rates = np.linalg.solve(np.column_stack([slope(gap, q, k) for k in (1, 2)]), -slope(gap, q, 0))
    gap(q)
    M = np.zeros((3, 3))
    mujoco.mj_fullM(model, data, M)
    rate = np.array([1.0, *rates])
    h = 0.02
    V = {k: potential(k * h) for k in range(-3, 4)}
    torque = (45 * (V[1] - V[-1]) - 9 * (V[2] - V[-2]) + (V[3] - V[-3])) / (60 * h)
    stiffness = (270 * (V[1] + V[-1]) - 27 * (V[2] + V[-2]) + 2 * (V[3] + V[-3]) - 490 * V[0]) / (
        180 * h**2
    )
    return float(rate @ M @ rate), torque, stiffness


def test_warnings_of_the_compiler_are_reported_and_leave_no_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    file = tmp_path / "robot.xml"
    text = CASES["servos"].replace("<compiler", '<compiler settotalmass="3"')
    file.write_text(text, encoding="utf-8")
    _, report = mbdlft.load_robot(file)
    assert "settotalmass" in report.assumed[0]
    assert [path.name for path in tmp_path.iterdir()] == ["robot.xml"]


def test_cross_product() -> None:
    target(
        across(np.array([1.0, 2.0, 3.0])) @ [4.0, 5.0, 6.0], np.cross([1, 2, 3], [4, 5, 6]), CLOSED_FORM
    )


# other people's robots -------------------------------------------------------------------------


@pytest.mark.long
def test_robots_of_all_packages_that_are_installed() -> None:
    found = [outcome(file) for file in files(installed())]
    bad = [item for item in found if item.came not in ("equal", "refused", "loaded")]
    assert not bad, table(found)
    assert all(item.reason for item in found if item.came == "refused")
    assert set(REFERENCES) == {"URDF", "SDF", "MJCF"}
    if len(found) < 50:
        pytest.skip(f"only {len(found)} robots are installed: see PACKAGES of benchmarks.public_robots")
